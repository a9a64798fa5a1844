"""The gain of the least noise bound among those that are proved to have a wanted rate.

`gain_search` takes one norm for the rate and for noise, though each may have its own. So it is asked for less than the
rate, as little as leaves a gain of which a norm of its own proves the rate, with noise at a rate that is searched; of
these gains the one of the least bound is taken, which is found in floats. The rate is proved of rounded numbers.
"""

import math
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from hgogen.chains.columns import columns
from hgogen.form import Form
from hgogen.guarantees.bounded_theta import Nothing
from hgogen.guarantees.common_norm import Falls, Flow
from hgogen.guarantees.gain_search import Open, Task, opened
from hgogen.guarantees.inclusion import Inclusion, Slope, with_gains
from hgogen.guarantees.noise_in_time import together_in_floats
from hgogen.guarantees.quadratic import Array
from hgogen.sentence import Reason, because

_SLOW, _FAST, _SEARCHED = 1 / 8, 6, 8  # of the rates of noise: where they begin and end, and how many are tried
_OF_PACE = 1 / 10  # of the pace of slopes: as fast as it are rates of noise, however slow the wanted one
_LARGE = 1e30  # in the place of a bound, where there is no gain
_LESS = (1.02, 0.7, 0.4)  # of the rate, that the one norm is asked for first
_LEAST, _HALVINGS = 0.0, 6
_DIGITS = 6
_ONE = Fraction(1)


@dataclass(frozen=True)
class Candidate:
    """A gain K (n, p) with a proof that its error `falls` at the rate; `worth`: its largest bound, about."""

    K: tuple[tuple[float, ...], ...]
    flow: Flow
    falls: Falls
    worth: float = _LARGE


@dataclass(frozen=True, eq=False)
class Search:
    """For gains of a form, of a `task` under noise of these `sizes` (p), written with `theta`."""

    form: Form
    task: Task
    sizes: Array
    theta: float

    def best(self) -> Candidate | None:
        """That of the least worth; None where none is found.

        Raises: `NoSolver`.
        """
        tried = list[Candidate]()

        def worth(noisy: float) -> float:
            one = self._slowest(math.exp(noisy))
            tried.extend([one] if one else [])
            return one.worth if one else _LARGE

        from scipy.optimize import minimize_scalar  # which the solver needs as well

        ends = math.log(self.task.rate * _SLOW), math.log(self._fast * _FAST)
        minimize_scalar(worth, bounds=ends, method="bounded", options={"maxiter": _SEARCHED})
        return min(tried, key=lambda one: one.worth, default=None)

    @property
    def _fast(self) -> float:
        return max(self.task.rate, _OF_PACE * self.task.pace)

    def promise(self) -> float:
        """The worth with noise at about half of the rate, to two digits.

        Raises: `NoSolver`.
        """
        one = self._slowest(math.sqrt(self.task.rate * self._fast) / 2)
        return float(f"{one.worth:.2g}") if one else _LARGE

    def _slowest(self, noisy: float) -> Candidate | None:
        """With noise at that rate, the gain of the least rate in one norm that has the wanted one in its own."""
        start = next(((less, one) for less in _LESS if (one := self._at(less, noisy))), None)
        if start is None:
            return None
        (high, best), low = start, _LEAST
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            one = self._at(middle, noisy)
            low, high, best = (low, middle, one) if one else (middle, high, best)
        worth = together_in_floats(best.flow.error, self.sizes, self.task.rows, best.falls, 2 * noisy)
        return replace(best, worth=min(worth, _LARGE))

    def _at(self, less: float, noisy: float) -> Candidate | None:
        """The gain by one norm at so much of the rate, where it has the whole rate in its own."""
        K = self.task.gain(less * self.task.rate, noisy)
        if K is None or not np.isfinite(K).all():
            return None
        K = K / self.sizes
        places = columns(self.form, K.size)
        entries = [float(f"{K[at.row, at.chain] / self.theta**at.power:.{_DIGITS}g}") for at in places]
        error = with_gains(self.form, [*map(Fraction, entries)])
        if isinstance(error, Nothing):
            return None
        flow = Flow(error, Fraction(self.theta))
        falls = flow.at(flow.theta, 2 * Fraction(self.task.rate))
        rows = tuple(map(tuple, np.reshape(entries, K.shape).tolist()))
        return Candidate(rows, flow, falls) if falls else None


def plain(form: Form, sizes: Array, narrower: int | None = None) -> Open | Reason:
    """What the error obeys before there is a gain, noise in its sizes (p), with half of the range of the slope of that
    number; or why there is nothing to design."""
    if len(form.leads) < len(form.blocks):
        return because("it is for outputs of which each has a chain of its own")
    without, ones = (with_gains(form, [Fraction(k)] * form.n) for k in (0, 1))
    if isinstance(without, Nothing) or isinstance(ones, Nothing):
        return because("{why}", why=without)
    chain = [k for k, size in enumerate(form.blocks) for _ in range(size)]
    parts = (_parts(error, narrower) for error in (without, ones))
    open_ = opened(*parts, heads=form.heads, chain=chain)
    return replace(open_, C=open_.C / sizes[:, None], D=open_.D / sizes[:, None])


def _parts(error: Inclusion, narrower: int | None) -> tuple[Array, Array, Array]:
    """M, G and H in the form's own coordinates."""
    slopes = tuple(_half(slope) if k == narrower else slope for k, slope in enumerate(error.slopes))
    e = replace(error, slopes=slopes).at(_ONE).floats
    return e.M, e.G, e.H


def _half(slope: Slope) -> Slope:
    """With half of its range: about its middle, but that of an entry of a Jacobian, which holds 0, about that."""
    centre = (slope.low + slope.high) / 2 if slope.entry is None else Fraction(0)
    return replace(slope, low=(slope.low + centre) / 2, high=(slope.high + centre) / 2)
