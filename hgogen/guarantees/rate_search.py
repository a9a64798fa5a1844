"""The gain of the least noise bound among those that are proved to have a wanted rate.

`gain_search` takes one norm for the rate and for noise, though each may have its own. So it is asked for less than the
rate, as little as leaves a gain of which a norm of its own proves the rate, with noise at a rate that is searched; of
these gains the one of the least bound is taken, which is found in floats. The rate is proved of rounded numbers.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
import sympy as sp

from hgogen.chains.columns import columns
from hgogen.form import Form
from hgogen.guarantees.argument import injected
from hgogen.guarantees.bounded_theta import Nothing
from hgogen.guarantees.common_norm import Falls, Flow
from hgogen.guarantees.gain_search import Open, Task, opened
from hgogen.guarantees.inclusion import Inclusion, Uncertain, with_gains
from hgogen.guarantees.noise_in_time import together_in_floats
from hgogen.guarantees.quadratic import Array
from hgogen.guarantees.slope_of_error import Slope
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
    """A gain K (n, p), with the entries of N in the `argument` of b, with a proof that the error `falls` at the rate;
    `worth`: its largest bound, about."""

    K: tuple[tuple[float, ...], ...]
    argument: tuple[float, ...]
    flow: Flow
    falls: Falls
    worth: float = _LARGE


@dataclass(frozen=True, eq=False)
class Search:
    """For gains of a form, of a `task` under noise of these `sizes` (p), written with `theta`; with the output error in
    the argument of b by `argument`, the entries of N at theta = 1, or none."""

    form: Form
    task: Task
    sizes: Array
    theta: float
    argument: tuple[float, ...] = ()

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

    @property
    def written(self) -> tuple[float, ...]:
        """The entries of N over their powers of theta, in as many digits as those of K."""
        places = columns(self.form, len(self.argument)) if self.argument else ()
        return tuple(self._short(x, at.power - 1) for x, at in zip(self.argument, places, strict=True))

    def _short(self, value: float, power: int) -> float:
        return float(f"{value / self.theta**power:.{_DIGITS}g}")

    def promise(self) -> float:
        """The worth with noise at about half of the rate, to two digits.

        Raises: `NoSolver`.
        """
        one = self.middle()
        return float(f"{one.worth:.2g}") if one else _LARGE

    def middle(self) -> Candidate | None:
        """That with noise at about half of the rate; None where none is found.

        Raises: `NoSolver`.
        """
        return self._slowest(math.sqrt(self.task.rate * self._fast) / 2)

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
        worth = together_in_floats(
            best.flow.error, self.sizes, self.task.rows, best.falls, 2 * noisy, self.task.fastest
        )
        return replace(best, worth=min(worth, _LARGE))

    def _at(self, less: float, noisy: float) -> Candidate | None:
        """The gain by one norm at so much of the rate, where it has the whole rate in its own."""
        K = self.task.gain(less * self.task.rate, noisy)
        if K is None or not np.isfinite(K).all():
            return None
        K = K / self.sizes
        entries = [self._short(K[at.row, at.chain], at.power) for at in columns(self.form, K.size)]
        error = error_of(self.form, [*map(Fraction, entries)], self.written)
        if isinstance(error, Nothing):
            return None
        flow = Flow(error, Fraction(self.theta))
        falls = flow.at(flow.theta, 2 * Fraction(self.task.rate))
        rows = tuple(map(tuple, np.reshape(entries, K.shape).tolist()))
        return Candidate(rows, self.written, flow, falls) if falls else None


def error_of(form: Form, K: Sequence[Fraction], argument: Sequence[float]) -> Inclusion | Nothing:
    """What the error obeys with a gain of these entries, and with those of N in the argument of b, or none."""
    error = with_gains(form, K)
    return injected(error, form, [sp.Rational(Fraction(x)) for x in argument]) if argument else error


def plain(form: Form, sizes: Array, narrower: int | None = None, argument: Sequence[float] = ()) -> Open | Reason:
    """What the error obeys before there is a gain, noise in its sizes (p), with half of the range of the slope of that
    number; or why there is nothing to design."""
    if len(form.leads) < len(form.blocks):
        return because("it is for outputs of which each has a chain of its own")
    without, ones = (error_of(form, [Fraction(k)] * form.n, argument) for k in (0, 1))
    if isinstance(without, Nothing) or isinstance(ones, Nothing):
        return because("{why}", why=without)
    chain = [k for k, size in enumerate(form.blocks) for _ in range(size)]
    parts = list[Uncertain]()
    for error in (without, ones):
        slopes = tuple(_half(slope) if k == narrower else slope for k, slope in enumerate(error.slopes))
        parts.append(replace(error, slopes=slopes).at(_ONE).floats)
    open_ = opened(*parts, heads=form.heads, chain=chain)
    C, D = (each / sizes[:, None] for each in (open_.C, open_.D))
    return replace(open_, C=C, D=D, B=open_.B * sizes, E=open_.E * sizes)


def _half(slope: Slope) -> Slope:
    """With half of its range: about its middle, but that of an entry of a Jacobian, which holds 0, about that."""
    centre = (slope.low + slope.high) / 2 if slope.entry is None else Fraction(0)
    return replace(slope, low=(slope.low + centre) / 2, high=(slope.high + centre) / 2)
