"""The design of the filter of `observers.filtered_injection`: the least effect of noise on one state, at a requested
decay rate.

    e' = (M + G_b diag(d) H) e + B v,   |d_j| <= 1, |v| <= 1;   M and B of the filter's F, G and N H
    X > 0:  (M + rate) X + X (M + rate)' + B B'/(2 rate) + G_b diag(s) G_b' + X H' diag(1/s) H X <= 0,   s > 0

For slopes of b anywhere in their ranges the errors decay like exp(-rate t), and the error of the state is at most sqrt
(c X c') times the largest noise, whatever its course: P = X^-1 defines the norm. For a given filter this is a cone
program, proved in rationals (`questions`). In the filter and X together it has several minima: a search without
derivatives (SciPy's, which the solver needs as well) starts from a first filter and ends where no small change helps.
Its result counts only if it is proved, and better. By similarity G = (1, 0, .., 0), and F is tridiagonal with ones
below its diagonal.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from math import comb
from typing import Any

import numpy as np

from hgogen.estimators.integrators import Integrators, integrators
from hgogen.form import Form
from hgogen.prove.error_models import on_integrators
from hgogen.prove.inclusion import Inclusion, Layout, Nothing, state_row
from hgogen.prove.inequality import NOW, flow, noise_forms
from hgogen.prove.quadratic import Array, floats, inverse_root
from hgogen.prove.questions import Bounded, InputBound, bound_at, bound_in_floats
from hgogen.prove.semidefinite import feasible_weights
from hgogen.reading.given import BadGain, among, count, positive, requires_form
from hgogen.sentence import up

_NAME = "filtered_injection"
_STATES = 6  # of the chain, and of the filter
_DIGITS = 6  # of the filter's numbers
_TRIES = 400  # evaluations of the search
_PROOFS = 12  # of the best filters
_SPEEDS = (3.0, 6.0, 12.0, 24.0)  # of the first filters
_SIDE = 0.3  # relative size of the first simplex
_LARGE = 1e6  # the logarithm of a missing bound


@dataclass(frozen=True)
class InjectionFilter:
    """A designed filter of the observer `filtered_injection(form, theta=.., F=.., G=.., H=..)` with N = I: F (m, m), G
    (m), H (n, m). `rate` (1/s): errors decay like exp(-rate t); `bound`: the largest error of `state` for noise of at
    most 1, proved in continuous time for all partial derivatives of b in their ranges; `before`: this bound for the
    first filter of the search."""

    theta: float
    F: tuple[tuple[float, ...], ...]
    G: tuple[float, ...]
    H: tuple[tuple[float, ...], ...]
    rate: float
    state: str
    bound: Fraction
    before: Fraction

    @property
    def gains(self) -> dict[str, Any]:
        """The arguments theta, F, G and H of `filtered_injection`, by name."""
        return {"theta": self.theta, "F": self.F, "G": self.G, "H": self.H}

    def __str__(self) -> str:
        effect = f"noise of 1 moves {self.state} by {up(self.bound, 4)} at most, {up(self.before, 4)} before"
        return f"F = {self.F}, G = {self.G}, H = {self.H}: rate {self.rate:g} at theta = {self.theta:g}; {effect}"


def injected(chain: Integrators, F: np.ndarray, G: np.ndarray, pushed: np.ndarray) -> Inclusion | Nothing:
    """Return the error dynamics of the observer with a filter F (m, m), G (m) and `pushed` = N H (n, m) on a chain of
    integrators; or the reason why there are none."""
    n, m = pushed.shape
    order = (*range(n), *[0] * m)
    layout = Layout(order, order, (True,) * n + (False,) * m, tuple(range(n)))
    numbers = {"F": F, "G": G, "NH": pushed}
    measured = np.append(np.zeros(n), G)[:, None]
    return on_integrators(chain, layout, core(F, G, pushed), measured, numbers)


def core(F: np.ndarray, G: np.ndarray, pushed: np.ndarray) -> np.ndarray:
    """Return the matrix [A, N H; -G C, F] (n + m, n + m) of the linear part of the error of observer and filter,
    `pushed` = N H (n, m)."""
    n = len(pushed)
    return np.block([[np.diag(np.ones(n - 1), 1), pushed], [-np.outer(G, np.eye(n)[0]), F]])


@requires_form
def injection_filter(
    form: Form, *, theta: float, rate: float, state: str | None = None, size: int | None = None
) -> InjectionFilter:
    """Return a filter of the observer `filtered_injection` with `size` states, by default n, with which errors decay at
    `rate` and the effect of noise on one state is small.

    Args: `theta` > 0: the gain of the observer; `rate` (1/s) > 0; `state`: the state whose error is minimised, by
    default the last of the chain. Raises: `BadGain` for a form that is no chain of integrators of up to 6 states, or a
    rate that no first filter is proved to reach; `Misfit` for no form; `NoSolver`.
    """
    if form.system.wraps:
        fix = "design on the plant without its periods or invariants, for small errors"
        raise BadGain(form.system.name, f"has no filter that is designed: {form.system.wraps}", fix=fix)
    chain, level, wanted = integrators(_NAME, form), positive("theta", theta), positive("rate", rate)
    n, names = chain.n, form.names
    if n > _STATES:
        raise BadGain(_NAME, f"is for a chain of at most {_STATES} states, not of {n}")
    m = count("size", n if size is None else size, 1, _STATES)
    if not among(state, (None, *names)):
        raise BadGain(f"state = {state!r}", f"is none of {', '.join(names)}")
    search = _Search(chain, Fraction(level), Fraction(wanted), names.index(state) if state else n - 1, m)
    first = search.first
    before = search.proved(first)
    if before is None:
        reason = f"is not shown to be reached at theta = {level:g} by a first filter; raise theta, or lower the rate"
        raise BadGain(f"rate = {wanted:g}", reason)
    proofs = ((each, search.proved(each)) for each in search.improved(first))
    better = ((each, known) for each, known in proofs if known and known.bound < before.bound)
    (F, G, H), best = next(better, (first, before))
    F_rows, H_rows = (tuple(map(tuple, part.tolist())) for part in (F, H))
    counted = names[search.state]
    return InjectionFilter(level, F_rows, tuple(G.tolist()), H_rows, wanted, counted, best.bound, before.bound)


Filter = tuple[np.ndarray, np.ndarray, np.ndarray]  # F, G and H


@dataclass(frozen=True)
class _Search:
    """The search for a filter with `m` states that decays at `rate` and has a small
    noise gain to the error of state `state` (index from 0) of a chain, at `theta`."""

    chain: Integrators
    theta: Fraction
    rate: Fraction
    state: int
    m: int

    @property
    def first(self) -> Filter:
        """The filter to start from: that of alpha = 3, beta = 1, with all poles at -1, or
        a faster one of the same static gain with a smaller bound. With m < n its last
        state is injected into all later states; states beyond n are not injected."""
        n, m = self.chain.n, self.m
        at = [(i, min(i, m - 1)) for i in range(n)]
        filters = []
        for speed in _SPEEDS:
            H = np.zeros((n, m))
            for i, j in at:
                H[i, j] = comb(n, i + 1) * (1 if speed == _SPEEDS[0] else speed ** (j + 1))
            filters.append((-speed * np.eye(m) + np.eye(m, k=-1), np.eye(m)[0], H))
        return min(filters, key=lambda each: self._cost(self._numbers(each))[0])

    def proved(self, filter_: Filter) -> InputBound | None:
        query = self._query(filter_)
        return bound_at(*query) if query and bound_in_floats(*query) else None

    def improved(self, filter_: Filter) -> Iterator[Filter]:
        from scipy.optimize import minimize  # a dependency of the solver

        # filters and costs, and the coordinates of the best P
        known, W = list[tuple[float, np.ndarray]](), list[Array]()

        def cost(numbers: np.ndarray) -> float:
            value, coordinates = self._cost(numbers, *W)
            if value < min((other for other, _ in known), default=_LARGE):
                known.append((value, numbers.copy()))
                W[:] = [] if coordinates is None else [coordinates]
            return value

        start = self._numbers(filter_)
        simplex = np.vstack([start, start + np.diag(np.maximum(np.abs(start), _SIDE) * _SIDE)])
        options = {"maxfev": _TRIES, "adaptive": True, "initial_simplex": simplex}
        minimize(cost, start, method="Nelder-Mead", options=options)
        for _, numbers in known[: -_PROOFS - 1 : -1]:
            yield self._filter(np.array([float(f"{x:.{_DIGITS}g}") for x in numbers]))

    def _cost(self, numbers: np.ndarray, *coordinates: Array) -> tuple[float, Array | None]:
        """Return log(bound) in floats and the W = P^(-1/2) of its P; 1e6 and None without
        a bound. The search for P starts at the given W, else at that of the filter."""
        for W in (*coordinates, None):
            query = self._query(self._filter(numbers), W)
            known = query and bound_in_floats(*query)
            if known:
                return float(np.log(known[0])), known[1]
        return _LARGE, None

    def _query(self, filter_: Filter, W: Array | None = None) -> tuple[Bounded, Array, int, Array, Fraction] | None:
        error = injected(self.chain, *filter_)
        if isinstance(error, Nothing):
            raise BadGain(_NAME, f"has no bound here: {error}")
        scales = error.scales(self.theta)
        if scales is None:
            raise BadGain(_NAME, "has gains that are no numbers, and so no bound of what noise does")
        if np.linalg.eigvals(floats(error.N)).real.max() >= 0:
            return None
        e = error.at(self.theta)
        if W is None:
            weights = feasible_weights((flow(e).falls(NOW),), "an injection's filter")
            if weights is None:
                return None
            W = inverse_root(weights[0])
        return lambda alpha: noise_forms(e, alpha), W, 1, state_row(scales, self.state), 2 * self.rate

    def _numbers(self, filter_: Filter) -> np.ndarray:
        F, _, H = filter_
        return np.concatenate([np.diag(F), np.diag(F, 1), H.ravel()])

    def _filter(self, numbers: np.ndarray) -> Filter:
        m, n = self.m, self.chain.n
        F = np.diag(numbers[:m]) + np.diag(numbers[m : 2 * m - 1], 1) + np.eye(m, k=-1)
        return F, np.eye(m)[0], numbers[2 * m - 1 :].reshape(n, m)
