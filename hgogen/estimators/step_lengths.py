"""Two limits of the step length: one above which errors grow without bound, and one at which they grow little more than
in continuous time.

A step of length h advances an error e' = M e at a fixed point as e <- T(h) e. At the points where M is stable,
    refused   the least h from which a T(h) has an eigenvalue beyond 1
    take      half of the largest h at which max over k of |T(h)^k| <= 1.5 max over t of |exp(M t)|, of each point
Below `refused` T(h)^k can still grow far before it decays: for an n-fold eigenvalue by a factor of 7, 98, 1656 for n =
2, 3, 4 by classical Runge-Kutta at 90 % of `refused`. |.| is the maximum row sum norm, in coordinates in which rows and
columns of M have about the same size (`balance`), so that the powers of a high gain have no effect. `take` proves
nothing: it is evaluated at a finite number of points. The factor one half allows for the points in between; trials of
the shipped models required it. Gains and parameters have their declared values; for other values both limits may be
shorter. With a method that is exact for the core, `take` is also at most half of the step that resolves the model where
it oscillates or grows, 1/|lambda| of its Jacobian.

M is the Jacobian of the right-hand side in the fields, at a measurement equal to the output of the estimate: it governs
small estimation errors. The points lie in the box and beyond its edges, where the argument of the model is clamped and
its columns are 0. A clamp passes between none and all of an error, and the points have both. Adaptive fields have the
values at which the core is the fastest.

For a filter that predicts and corrects, F and C at a point of its box, the steady step of length h maps an error by

    T(h) = (1 - P C'(h/R) C) R_4(hF),   P^-1 = (exp(rho h) Phi P Phi' + h Q)^-1 + (1 - exp(-rho h)) S_0 + C'(h/R) C,

with Phi = 1 + hF + (hF)^2/2 and the polynomial R_4 of classical Runge-Kutta instead of exp(hF) for the plant. As h -> 0
the error obeys e' = (F - P C'R^-1 C) e and never grows in e'P^-1 e. In this norm, with P of h -> 0, |T(h)^k| measures
the deviation of Phi and R_4 from exp(hF), and the size of the correction by one sample. The step must also resolve the
motion of z: R_4 has an error of 2 % per step for a mode that rotates by 1.2 rad in it. The corners lie slightly inside
the box, because a root or a fraction may be infinitely steep at its edge and no plant stays at the ends of all its
ranges. At a corner an error may grow tenfold, since a plant only passes it, but must decay, since a plant may also stay
near it. An F that reads measurements jumps from point to point: `take` is then half as long, which trials of the
shipped models required. Source of the doubling algorithm: Chu, Fan, Lin, Wang, International Journal of Control 77
(2004).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hgogen.analysis.linearised import jacobians_on_box
from hgogen.analysis.scaling import Scaling
from hgogen.discretisation.kernels import balance
from hgogen.discretisation.runge_kutta import HEUN, RK4
from hgogen.discretisation.stability import (
    AXIS,
    BY_TRIAL,
    GROWTH,
    WIDER,
    FrozenRiccati,
    Lengths,
    Limit,
    continuous,
    growth,
    longest,
    pace,
    polynomial,
)
from hgogen.estimators.core import core, nominal
from hgogen.estimators.riccati_part import Riccati
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.observer import Observer
from hgogen.part import Ode
from hgogen.program import address, sym
from hgogen.signal import spread

Array = np.ndarray
Flags = NDArray[np.bool_]
POINTS, EDGE = (
    12,
    0.005,
)  # corners of the box, and as many points inside; the corners' distance from the edges, of a range
FOLLOWED = 1.2  # largest |h lambda| of an oscillating mode: |exp(ix) - R_4(ix)| = x^5/120 is .02 there
PASSING = 10.0  # admissible growth of an error at a corner, relative to that in continuous time
SHIFTED = 0.25  # over the fastest eigenvalue of every F: no mode resonates with a shorter step
STILL = 1e-9  # of the fastest eigenvalue: a smaller eigenvalue of F counts as 0
FINE = 0.05  # over the fastest eigenvalue: a step that resolves every error
LONGEST = 100  # over the fastest eigenvalue of every F: the end of the search for `refused`
ROUNDING = 1e-7  # of an eigenvalue of T
DOUBLED, SETTLED = 50, 1e-12  # largest number of doublings of a covariance's steps, and a negligible change
SAMPLES = 16  # in a declared period of the input, whose linear interpolation has an error of 2 %
BOX_POINTS = 32  # corners, and as many points inside; twice as many with clamped states, a quarter with all clamped
INSIDE = 1e-6  # of a range: distance of corners from the edges, where a clamp has the slope 1
PUSH = 1e-9  # of the output: an error that opens a dead zone


@dataclass(frozen=True, eq=False)
class Frozen:
    """The error equation e' = M e linearised at points of the box, each with its constant M: M (k, N, N) at `points`
    (k, n + m) of the form's state and the input, e the error of the estimator's N stored variables.

    `core` (N, N) is the part of M that is linear in the variables and the measurement, 0 where there is none; `blind`
    (k, N, N) is M while samples are missing, that of the model; `names` are the coordinates of a point.
    """

    M: Array
    points: Array
    core: Array
    blind: Array
    names: tuple[str, ...]

    def at(self, index: int) -> str:
        """Return the text "x1 = .., u = .." of the point with this index."""
        return ", ".join(f"{name} = {value:.3g}" for name, value in zip(self.names, self.points[index], strict=True))


@lru_cache(maxsize=16)
def frozen(part: Ode, observer: Observer) -> Frozen:
    """Return the error matrices M of an estimator `part` at `box_points`, without the points at which M is not
    finite."""
    form, points = observer.form, box_points(observer.form)
    M, blind = errors_at(part, observer)(points)
    finite = np.isfinite(M).all(axis=(1, 2)) & np.isfinite(blind).all(axis=(1, 2))
    linear = core(part, len(form.system.outputs))
    line = np.zeros(M.shape[1:]) if linear is None else np.array(ca.DM(_numbers([linear.M], observer)[0]))
    return Frozen(M[finite], points[finite], line, blind[finite], tuple(map(str, (*form.to_form, *form.system.inputs))))


@lru_cache(maxsize=16)
def errors_at(part: Ode, observer: Observer) -> Callable[[Array], tuple[Array, Array]]:
    """Return a function from points (k, n + m) of state and input to two arrays (k, N, N): M of the error equation e' =
    M e, and M while samples are missing."""
    form, moving = observer.form, [field for field in part.fields if field.name not in part.frozen]
    values = {field.name: sym("state", field.name, field.size) for field in moving}
    x, u = ca.vertcat(*values.values()), sym("state", "u", len(form.system.inputs))
    values |= {name: ca.SX(ca.DM(numbers)) for name, numbers in part.frozen.items()}
    output = observer.dynamics.output(observer.z, u)
    reading = ca.SX.sym("reading", output.numel())
    pushed = output + PUSH * (1 + ca.fabs(output))

    def slope(valid: Graph) -> Graph:
        rates = part.rhs(values, u, reading, valid * ca.SX.ones(output.numel()))
        matrix = ca.jacobian(ca.vertcat(*(rates[field.name] for field in moving)), x)
        return ca.substitute([matrix], [reading], [pushed])[0]

    estimate, sampled, unsampled = _numbers([observer.z, slope(1), slope(0)], observer)
    readout = ca.Function("readout", [x, u], [ca.densify(ca.jacobian(estimate, x)), ca.densify(estimate)])
    error = ca.Function("error", [x, u], [ca.densify(sampled), ca.densify(unsampled)])

    def errors(points: Array) -> tuple[Array, Array]:
        z, inputs = points[:, : form.n].T, points[:, form.n :].T
        start = np.repeat(np.concatenate([field.initial for field in moving])[:, None], len(points), axis=1)
        slopes = _stacked(readout(start, inputs)[0], len(points))
        regular = np.isfinite(slopes).all(axis=(1, 2), keepdims=True)
        alike = bool((slopes == slopes[:1]).all())  # the estimate is linear in the fields of most observers
        inverse = np.linalg.pinv(np.where(regular, slopes, 0.0)[: 1 if alike else None]) + np.zeros((len(points), 1, 1))
        fields = start + np.einsum("kij,jk->ik", inverse, z - np.array(readout(start, inputs)[1]))
        M, blind = (np.where(regular, _stacked(matrix, len(points)), np.nan) for matrix in error(fields, inputs))
        return M, blind

    return errors


def slopes_without_samples(part: Ode, observer: Observer) -> Callable[[Array], Array]:
    """Return a function from points (k, n + m) of state and input to M (k, N, N) while samples are missing, as in
    `errors_at`."""
    errors = errors_at(part, observer)
    return lambda points: errors(points)[1]


def box_points(form: Form) -> Array:
    """Return points (k, n + m) of states and inputs: the middle, corners, points inside, and points with states beyond
    their ranges by the ranges' widths; a signal without a range has its nominal value, or 0."""
    signals, n = [*form.states, *form.system.inputs], form.n
    rng, size = np.random.default_rng(1), len(signals)
    corners = INSIDE + (1 - 2 * INSIDE) * rng.integers(0, 2, size=(BOX_POINTS, size))
    mixed, ends = rng.uniform(size=(2 * BOX_POINTS, size)), rng.integers(0, 2, size=(2 * BOX_POINTS, size))
    beyond = rng.integers(0, 2, size=mixed.shape).astype(bool)
    beyond[: BOX_POINTS // 4] = True
    beyond[:, n:] = False  # inputs are in their ranges
    shares = (
        np.full((1, size), 0.5),
        corners,
        rng.uniform(size=(BOX_POINTS, size)),
        np.where(beyond, 3.0 * ends - 1, mixed),
    )
    low, high = np.array([*map(spread, signals)]).T
    return np.asarray(low + np.vstack(shares) * (high - low))


def _numbers(graphs: list[Graph], observer: Observer) -> list[Graph]:
    values = nominal(observer)
    symbols = [s for s in ca.symvar(ca.veccat(*graphs)) if address(s)[0] in values]
    numbers = [ca.SX(float(values[place].reshape(-1)[index])) for place, index, _ in map(address, symbols)]
    substituted: list[Graph] = (
        ca.substitute([ca.SX(graph) for graph in graphs], symbols, numbers) if symbols else graphs
    )
    return substituted


def _stacked(wide: Graph, count: int) -> Array:
    numbers = np.array(wide)
    return np.ascontiguousarray(numbers.reshape(len(numbers), count, -1).swapaxes(0, 1))


SHARE = 0.5  # of the largest step length at which errors hardly grow
DEEPEST = 1 / 8  # of `refused`: the start of the search for `take`
SEARCH_END = 1e4  # over the fastest eigenvalue
HALVINGS = 12  # of the interval in which `refused` lies


class ErrorMap(Protocol):
    """A numerical method as a linear map of small errors: e' = M e becomes e <- T(h) e, for constant M (k, N, N). The
    method may integrate the part `core` (N, N) of M exactly; core and M are scaled by one diagonal matrix."""

    @property
    def exact(self) -> bool:
        """Whether the method integrates the linear core exactly, so that only the model's motion limits a step."""
        ...

    def transition(self, core: Array, M: Array, h: float) -> Array:
        """Return T(h) (k, N, N), e <- T(h) e, of errors e' = M e over a step of length h."""
        ...

    def refused(self, core: Array, M: Array) -> Array:
        """Return, for each stable M (k), the smallest h from which on T(h) has an eigenvalue beyond 1, else inf."""
        ...

    def __hash__(self) -> int:
        """Return a key of the cache of step lengths, equal for equal methods."""
        ...


def lengths(part: Ode, observer: Observer, dt: float, method: ErrorMap, core: Limit, rule: str = "") -> Lengths:
    """Return the step lengths, advised and refused, of an estimator `part`; `core`: the limit of its linear error core
    alone; `rule`: the name of the method, for reports. The advised length is expensive, and computed only if `dt` may
    exceed it."""
    errors, limits = _judged(part, observer), _limits(part, observer, method)
    tightest, at = core, int(limits.argmin()) if len(limits) else -1
    if limits.min(initial=math.inf) < core.dt:
        why = f"beyond it errors grow that decay in continuous time, of the estimate {errors.at(at)}"
        tightest = Limit(float(limits[at]), why, at)
    may_exceed = dt > SHARE * _shortest(errors.M, tightest.dt)
    take = _take(part, observer, method, tightest.dt) if may_exceed else math.inf
    take = min(take, SHARE * pace(errors.blind)) if method.exact else take
    return Lengths(refused=tightest.dt, take=take, why=tightest.why, basis=BY_TRIAL, rule=rule)


@lru_cache(maxsize=16)
def _judged(part: Ode, observer: Observer) -> Frozen:
    """Return the error matrices M of e' = M e at the points
    where M is stable, in coordinates that balance M."""
    errors = frozen(part, observer)
    decaying = stable(errors.M)
    scale = np.ones(errors.M.shape[-1])
    balance(np.abs(np.concatenate((errors.M, errors.core[None]))).max(axis=0).reshape(-1), scale)
    M, core = (X * scale / scale[:, None] for X in (errors.M[decaying], errors.core))
    return replace(errors, M=M, points=errors.points[decaying], core=core)


@lru_cache(maxsize=16)
def _limits(part: Ode, observer: Observer, method: ErrorMap) -> Array:
    errors = _judged(part, observer)
    return method.refused(errors.core, errors.M)


@lru_cache(maxsize=16)
def _take(part: Ode, observer: Observer, method: ErrorMap, refused: float) -> float:
    errors = _judged(part, observer)
    return longest_advised(errors.core, errors.M, method, refused)


def stable(M: Array) -> Array:
    """Return flags of the M (k, N, N) with all eigenvalues in the left half plane."""
    spectrum = np.linalg.eigvals(M)
    return np.asarray((spectrum.real < -AXIS * np.abs(spectrum).max(axis=1)[:, None]).all(axis=1))


def first_unstable(core: Array, M: Array, method: ErrorMap) -> Array:
    """Return limits (k), inf but for one: the smallest h at which some T(h) gets an eigenvalue outside the unit circle,
    at the index of that M."""
    limits, fastest = np.full(len(M), math.inf), _fastest(M)
    if not fastest:
        return limits

    def radius(h: float) -> Array:
        return np.asarray(np.abs(np.linalg.eigvals(method.transition(core, M, h))).max(axis=1))

    good, bad = 0.0, FINE / fastest
    while (radius(bad) <= 1 + ROUNDING).all():
        good, bad = bad, WIDER * bad
        if bad > SEARCH_END / fastest:
            return limits
    for _ in range(HALVINGS):
        middle = (good + bad) / 2
        good, bad = (middle, bad) if (radius(middle) <= 1 + ROUNDING).all() else (good, middle)
    limits[radius(bad).argmax()] = good
    return limits


def longest_advised(core: Array, M: Array, method: ErrorMap, refused: float) -> float:
    """Return the advised step length: half of the largest step up to which errors of the stable, balanced M (k, N, N)
    grow by at most `GROWTH` times as much as in continuous time, at least 1/16 of the step length `refused`; inf
    without a limit."""
    fastest = np.abs(np.linalg.eigvals(M)).max(axis=1, initial=0.0)
    if not fastest.any():
        return math.inf
    most = GROWTH * continuous(M, FINE / np.where(fastest > 0, fastest, 1.0))
    end = min(refused, SEARCH_END / _fastest(M))

    def grows(h: float) -> bool:
        return bool((growth(method.transition(core, M, h)) > most).any())

    largest = longest(grows, _shortest(M, refused), end)
    return SHARE * (end if math.isinf(largest) and end == refused else largest)


def _shortest(M: Array, refused: float) -> float:
    fastest = _fastest(M)
    return DEEPEST * refused if math.isfinite(refused) else FINE / fastest if fastest else math.inf


def _fastest(M: Array) -> float:
    return float(np.abs(np.linalg.eigvals(M)).max(initial=0.0))


# --- a filter that predicts and corrects


@dataclass(frozen=True, eq=False)
class ClosedLoops:
    """The closed loops F - P N of a filter at k points: F, N = C'R^-1 C, Q and the prior rho S_0 (k, n, n), in
    coordinates in which the steady P of the continuous filter is 1.

    `starts` (s, k, n, n): the initial values of P. With L = `back` (k, n, n), L P L' is the covariance in units of the
    state, `cap` (n) its cap, possibly inf. `most` (k): the admissible growth of an error relative to continuous
    time.
    """

    F: Array
    N: Array
    Q: Array
    prior: Array
    rho: float
    starts: Array
    back: Array
    cap: Array
    most: Array

    @property
    def continuous(self) -> Array:
        """The closed loop F - P N at the steady P = 1 (k, n, n)."""
        return np.asarray(self.F - self.N)

    def transition(self, h: float) -> Array:
        """Return T(h) (k, n, n), the error's map over predict and correct with the steady covariance of step h."""
        *_, (_, _, P) = _doubled(*self._step(h))
        return self._transition(h, P)

    def largest_shares(self, h: float) -> Array:
        """Return the largest P_ii/cap_i at each point (k), over all initial P and the steps 1, 2, 3, 4, 6, 8, .. until
        P is steady, for steps of length h."""
        return self._largest_shares(list(_doubled(*self._step(h))))

    def _largest_shares(self, doubled: Sequence[tuple[Array, Array, Array]], enough: float = 0.0) -> Array:
        """Return the largest P_ii/cap_i (k) of the covariance P, from the maps `doubled` of
        1, 2, 4, .. steps; the search ends once no later P_ii/cap_i can exceed `enough`. If
        P <= c P_s with c >= 1 and the steady P_s, no later P exceeds c P_s, since the step
        of c P is at most c times the step of P. c is at most the trace of P_s^-1 P."""
        settled, one = doubled[-1][2], np.eye(self.F.shape[-1])
        with np.errstate(all="ignore"):
            inverse, bound = _solved(settled, one), self._shares(settled).max(axis=1)
        half, now = self.starts, self.starts
        largest = np.zeros(len(self.F))
        with np.errstate(all="ignore"):
            for A, G, H in doubled:
                P = np.concatenate((now, half))
                stepped = H + A.swapaxes(1, 2) @ P @ _solved(one + G @ P, A)
                half, now = now, stepped[: len(now)]
                largest = np.maximum(largest, self._shares(stepped).max(axis=(0, 2)))
                later = np.maximum(1.0, (inverse * now).sum(axis=(2, 3))) * bound
                if (later <= enough).all():
                    break
        return largest

    def settles(self, h: float) -> Array:
        """Return, for each point (k), whether T(h) has all eigenvalues in the unit circle, both with the steady P and
        with the capped P."""
        *_, (_, _, P) = _doubled(*self._step(h))
        return _decays(self._transition(h, P)) & _decays(self._transition(h, self._capped(P)))

    def longest(self, end: float) -> float:
        """Return the largest step h up to which no error grows by more than `most`, and no P reaches its cap that does
        not do so for h -> 0 as well; inf if h would be beyond `end`."""
        model, loop = (np.abs(np.linalg.eigvals(M)).max(initial=0.0) for M in (self.F, self.continuous))
        fastest = max(model, loop)
        if not fastest or FINE / fastest > end:
            return math.inf
        start, coarse_end = FINE / fastest, SHIFTED / max(model, STILL * fastest)
        most = self.most * continuous(self.continuous, np.full(len(self.F), start))
        free = cache(lambda: self.largest_shares(start) <= 1)  # computed only where a cap is reached

        def grows(h: float) -> bool:
            doubled = list(_doubled(*self._step(h)))
            T = self._transition(h, doubled[-1][2])
            if (growth(T) > most).any():
                return True
            reached = ~(self._largest_shares(doubled, enough=1.0) <= 1)
            return bool(reached.any() and (free() & reached).any())

        return longest(grows, start, end, coarse_end)

    def refused(self, start: float) -> float:
        """Return the largest h above `start` up to which errors decay at one point at least; inf if errors decay for
        all h, or at no point already at `start`."""
        fastest = np.abs(np.linalg.eigvals(self.F)).max(initial=0.0)

        def lost(h: float) -> bool:
            return not self.settles(h).any()

        start = WIDER ** math.floor(math.log(start, WIDER))  # the same steps are tried for every start
        return longest(lost, start, LONGEST / fastest) if fastest and not lost(start) else math.inf

    def _step(self, h: float) -> tuple[Array, Array, Array]:
        """Return A, G, H (k, n, n) of the covariance's step of length
        h, P <- H + A' P (1 + G P)^-1 A, P before a sample."""
        grown = math.exp(min(self.rho * h, 100.0))  # the exponent at which nothing of the past is left
        Phi = polynomial(h * self.F, HEUN.polynomial)
        return (math.sqrt(grown) * Phi).swapaxes(1, 2), h * self.N + self._forgotten(h), h * self.Q

    def _transition(self, h: float, P: Array) -> Array:
        """Return the error's transition matrix T(h) (k, n, n)
        over predict and correct, with P before the sample."""
        one, information, forgotten = np.eye(self.F.shape[-1]), h * self.N, self._forgotten(h)
        corrected = one - _solved(one + P @ (information + forgotten), P @ information)
        return np.asarray(corrected @ polynomial(h * self.F, RK4.polynomial))

    def _forgotten(self, h: float) -> Array | float:
        return -math.expm1(-self.rho * h) / self.rho * self.prior if self.rho else 0.0

    def _capped(self, P: Array) -> Array:
        """Return P (k, n, n) after scaling the covariance's rows and columns by min(1, cap_i/P_ii)."""
        scale = 1 / np.maximum(self._shares(P), 1.0)
        scaling = np.linalg.solve(self.back, scale[..., None] * self.back)
        return np.asarray(scaling @ P @ np.swapaxes(scaling, 1, 2))

    def _shares(self, P: Array) -> Array:
        return np.asarray(((self.back @ P) * self.back).sum(axis=-1) / self.cap)


def factored_lengths(part: Riccati, dt: float) -> Lengths:
    """Return the step lengths of a predict-and-correct filter from its linearised closed loops at points of the box;
    they are equal for every factorisation of P.

    `take`: up to it no error grows much at any of the points, and a step resolves the motion of the model; inf if it is
    above `dt`. `refused`: above it errors decay at none of the points; inf if dt <= `take`.
    """
    F, C = part.slopes(POINTS, EDGE)
    jacobians = F if part.measured_state is None else jacobians_on_box(part.dynamics, POINTS, edge=EDGE)[0]
    low, peak = min(part.theta.late, part.theta.error_free or part.theta.peak), part.theta.peak
    every = merged_loops([closed_loops(part, F, C, theta, low) for theta in sorted({low, math.sqrt(low * peak), peak})])
    inputs = math.inf if part.period is None else part.period / SAMPLES
    share = 1.0 if part.measured_state is None else SHARE
    take = min(inputs, FOLLOWED * pace(jacobians), share * every.longest(dt / share))
    why = "beyond it no error settles, wherever in the declared box it was tried"
    refused = math.inf if dt <= take else every.refused(take)
    return Lengths(refused=refused, take=take, why=why, basis=BY_TRIAL)


def merged_loops(every: Sequence[ClosedLoops]) -> ClosedLoops:
    """Return several `ClosedLoops` that have one rho and one cap in common as one, with the points of all."""
    F, N, Q, prior, back, most = (
        np.concatenate([getattr(each, name) for each in every]) for name in ("F", "N", "Q", "prior", "back", "most")
    )
    starts = np.concatenate([each.starts for each in every], axis=1)
    return ClosedLoops(F, N, Q, prior, every[0].rho, starts, back, every[0].cap, most)


def closed_loops(part: Riccati, F: Array, C: Array, theta: float, start: float) -> ClosedLoops:
    """Return the closed loops of a filter at F (k, n, n), C (k, p, n) and a theta, at the points with a steady
    covariance. P starts at P(0), and at its steady value for theta = `start`."""
    Q, variances = part.typical
    rho = part.forgetting.initial[0] if part.forgetting is not None else 0.0
    n, scaling = len(Q), part.scaling
    prior = rho * np.diag(1 / part.cap) if rho else np.zeros((n, n))
    noise = scaling.process(theta) * Q * np.outer(scaling.spread(theta), scaling.spread(theta))
    steady = {each: _steady(part, F, C, each, rho) for each in {theta, start}}
    P, steady_start = steady[theta], steady[start]
    definite, settled = _definite(P), _definite(steady_start)
    starts = np.array([np.broadcast_to(part.covariance, F.shape), np.where(settled[:, None, None], steady_start, P)])
    F, C, P, starts = F[definite], C[definite], P[definite], starts[:, definite]
    corners = len(definite) // 2  # the points: the middle, the corners, and as many inside
    most = np.concatenate(([GROWTH], np.full(corners, PASSING), np.full(len(definite) - 1 - corners, GROWTH)))
    N = np.swapaxes(C, 1, 2) @ (C / scaling.variances(variances, theta)[:, None])
    L = np.linalg.cholesky(P)
    inverse = np.linalg.inv(L)
    turned, back = np.swapaxes(L, 1, 2), np.swapaxes(inverse, 1, 2)
    return ClosedLoops(
        inverse @ F @ L,
        turned @ N @ L,
        inverse @ noise @ back,
        turned @ prior @ L,
        rho,
        inverse @ starts @ back,
        L,
        np.full(n, np.inf) if rho else part.cap,
        most[definite],
    )


def _steady(part: Riccati, F: Array, C: Array, theta: float, rho: float) -> Array:
    """Return the steady P (k, n, n) of 0 = F P + P F' + rho (P - P S_0 P) + Q_theta - P C' R_theta^-1 C P at each F,
    C."""
    (Q, R), n, scaling = part.typical, len(part.cap), part.scaling
    if rho:
        C, R = np.concatenate((C, np.broadcast_to(np.eye(n), F.shape)), axis=1), np.concatenate((R, part.cap / rho))
    every = Scaling(scaling.states, (*scaling.outputs, *(0,) * (len(R) - len(scaling.outputs))), scaling.gauge)
    return FrozenRiccati.of(F + rho / 2 * np.eye(n), C, Q, R, every).steady(theta)


def _decays(T: Array) -> Flags:
    """Return whether each T (k, n, n) is finite and has no eigenvalue outside the unit circle."""
    finite = np.isfinite(T).all(axis=(1, 2))
    radius = np.abs(np.linalg.eigvals(np.where(finite[:, None, None], T, 0.0))).max(axis=1)
    return np.asarray(finite & (radius <= 1 + ROUNDING))


def _definite(P: Array) -> Flags:
    return np.array([bool(np.isfinite(X).all() and np.linalg.eigvalsh(X).min() > 0) for X in P], dtype=bool)


def _doubled(A: Array, G: Array, H: Array) -> Iterator[tuple[Array, Array, Array]]:
    """Yield A, G, H (k, n, n) of the maps P <- H + A' P (1 + G P)^-1 A over 1, 2, 4, .. steps
    (doubling algorithm), until H is the steady P; without a steady P, H becomes large or infinite."""
    one = np.eye(A.shape[-1])
    for _ in range(DOUBLED):
        yield A, G, H
        with np.errstate(all="ignore"):
            W = one + G @ H
            solved_A, solved_G = _solved(W, np.array((A, G)))
            more = A.swapaxes(1, 2) @ H @ solved_A
            G, H, A = G + A @ solved_G @ A.swapaxes(1, 2), H + (more + more.swapaxes(1, 2)) / 2, A @ solved_A
            if not (np.abs(more) > SETTLED * np.abs(H).max(axis=(1, 2), keepdims=True)).any():
                break
    yield A, G, H


def _solved(W: Array, B: Array) -> Array:
    """Return W^-1 B (.., n, n), NaN for a W that is singular or not finite."""
    W, B = np.broadcast_arrays(W, B)
    finite = np.isfinite(W)
    if finite.all():
        with suppress(np.linalg.LinAlgError):  # raised for a singular matrix
            return np.asarray(np.linalg.solve(W, B))
    good = finite.all(axis=(-2, -1))
    good[good] = np.abs(np.linalg.det(W[good])) > 0
    solution = np.full(B.shape, np.nan)
    solution[good] = np.linalg.solve(W[good], B[good])
    return solution
