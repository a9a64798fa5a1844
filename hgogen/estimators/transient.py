"""Two step lengths of a method: from where on an error grows for ever, and one at which it hardly grows more than in
continuous time.

An error e' = M e at a fixed point becomes e <- T(h) e by a step of length h. Of the points where M is stable,
    refused   the least h from which a T(h) has an eigenvalue beyond 1
    take      half of the largest h at which max over k of |T(h)^k| <= 1.5 max over t of |exp(M t)|, of each point
Below `refused` T(h)^k can still grow far before it decays: of an n-fold eigenvalue 7, 98, 1656 fold for n = 2, 3, 4 by
classical Runge-Kutta at 90 % of `refused`. |.| is the largest sum of a row, in coordinates in which rows and columns of
M are of about the same size (`balance`), so that the powers of a high gain do not count. `take` proves nothing: it is
found at the points that are tried, between which an error moves on its way. For that is the half, which trials of the
shipped models asked for. Gains and parameters stand at their declared values: at others, to which they may be tuned,
both lengths may be shorter. By a method that is exact for the core, `take` is also at most half of what follows the
model where it oscillates or grows, 1/|lambda| of its own Jacobian. A filter's `take` is of `kalman.closed_loop`.

M is the Jacobian of the right-hand side in the fields, the measurement being what the estimate would give: the error of
the estimate against a plant nearby. The points lie in the box and beyond its edges, where the argument of the model is
clamped and its columns are 0: a clamp passes a share of an error, between none and all of it, and the points have both.
Fields that adapt rest where the core is the fastest.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol

import casadi as ca
import numpy as np

from hgogen.discretisation.growth import BY_TRIAL, GROWTH, WIDER, continuous, growth, longest
from hgogen.discretisation.kernels import balance
from hgogen.discretisation.stability import AXIS, Lengths, Limit, pace
from hgogen.estimators.core import core, nominal
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.observer import Observer
from hgogen.part import Ode
from hgogen.program import address, sym
from hgogen.signal import spread

Array = np.ndarray
POINTS = 32  # of each kind: corners, inside, and twice as many with states clamped; a quarter with all of them
INSIDE = 1e-6  # of a range: how far inside of it a corner lies, where a clamp has its slope
PUSH = 1e-9  # of the output, an error that opens a dead zone


@dataclass(frozen=True, eq=False)
class Frozen:
    """The matrices M (k, N, N) of the error at `points` (k, n + m) of the form's state and the input.

    `core` (N, N) is the linear core, 0 where there is none; `blind` (k, N, N) is M without samples, the model's own;
    `names` are those of the coordinates of a point.
    """

    M: Array
    points: Array
    core: Array
    blind: Array
    names: tuple[str, ...]

    def at(self, index: int) -> str:
        """A point in words."""
        return ", ".join(f"{name} = {value:.3g}" for name, value in zip(self.names, self.points[index], strict=True))


@lru_cache(maxsize=16)
def frozen(part: Ode, observer: Observer) -> Frozen:
    """The errors at fixed points of the box, without the points at which M is not finite."""
    form, points = observer.form, box_points(observer.form)
    M, blind = errors_at(part, observer)(points)
    finite = np.isfinite(M).all(axis=(1, 2)) & np.isfinite(blind).all(axis=(1, 2))
    linear = core(part, len(form.system.outputs))
    line = np.zeros(M.shape[1:]) if linear is None else np.array(ca.DM(_numbers([linear.M], observer)[0]))
    return Frozen(M[finite], points[finite], line, blind[finite], tuple(map(str, (*form.to_form, *form.system.inputs))))


@lru_cache(maxsize=16)
def errors_at(part: Ode, observer: Observer) -> Callable[[Array], tuple[Array, Array]]:
    """`Frozen.M` and `Frozen.blind` (k, N, N) as a function of points (k, n + m)."""
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

    estimate, seen, unseen = _numbers([observer.z, slope(1), slope(0)], observer)
    readout = ca.Function("readout", [x, u], [ca.densify(ca.jacobian(estimate, x)), ca.densify(estimate)])
    error = ca.Function("error", [x, u], [ca.densify(seen), ca.densify(unseen)])

    def errors(points: Array) -> tuple[Array, Array]:
        z, inputs = points[:, : form.n].T, points[:, form.n :].T
        start = np.repeat(np.concatenate([field.initial for field in moving])[:, None], len(points), axis=1)
        slopes = _stacked(readout(start, inputs)[0], len(points))
        regular = np.isfinite(slopes).all(axis=(1, 2), keepdims=True)
        alike = bool((slopes == slopes[:1]).all())  # of most observers the estimate is linear in their fields
        inverse = np.linalg.pinv(np.where(regular, slopes, 0.0)[: 1 if alike else None]) + np.zeros((len(points), 1, 1))
        fields = start + np.einsum("kij,jk->ik", inverse, z - np.array(readout(start, inputs)[1]))
        M, blind = (np.where(regular, _stacked(matrix, len(points)), np.nan) for matrix in error(fields, inputs))
        return M, blind

    return errors


def box_points(form: Form) -> Array:
    """Points (k, n + m) of states and inputs: the middle, corners, points inside, and points with states beyond their
    ranges by their widths; a signal without a range stays at its nominal value, or 0."""
    signals, n = [*form.states, *form.system.inputs], form.n
    rng, size = np.random.default_rng(1), len(signals)
    corners = INSIDE + (1 - 2 * INSIDE) * rng.integers(0, 2, size=(POINTS, size))
    mixed, ends = rng.uniform(size=(2 * POINTS, size)), rng.integers(0, 2, size=(2 * POINTS, size))
    beyond = rng.integers(0, 2, size=mixed.shape).astype(bool)
    beyond[: POINTS // 4] = True
    beyond[:, n:] = False  # inputs are in their ranges
    shares = (
        np.full((1, size), 0.5),
        corners,
        rng.uniform(size=(POINTS, size)),
        np.where(beyond, 3.0 * ends - 1, mixed),
    )
    low, high = np.array([*map(spread, signals)]).T
    return np.asarray(low + np.vstack(shares) * (high - low))


def _numbers(graphs: list[Graph], observer: Observer) -> list[Graph]:
    """The graphs with parameters, gains and the values derived from them replaced by their numbers."""
    known = nominal(observer)
    symbols = [s for s in ca.symvar(ca.veccat(*graphs)) if address(s)[0] in known]
    numbers = [ca.SX(float(known[place].reshape(-1)[index])) for place, index, _ in map(address, symbols)]
    substituted: list[Graph] = (
        ca.substitute([ca.SX(graph) for graph in graphs], symbols, numbers) if symbols else graphs
    )
    return substituted


def _stacked(wide: Graph, count: int) -> Array:
    """Matrices (r, count c) side by side as an array (count, r, c)."""
    numbers = np.array(wide)
    return np.ascontiguousarray(numbers.reshape(len(numbers), count, -1).swapaxes(0, 1))


SHARE = 0.5
DEEPEST = 1 / 8  # of `refused`: where the search for `take` ends
SHORT, LONGEST = 0.05, 1e4  # over the fastest eigenvalue: where a search begins and ends
HALVINGS = 12  # of the interval in which `refused` lies
ROUNDING = 1e-7  # of an eigenvalue of T


class Way(Protocol):
    """A method as it moves frozen errors: of the linear core (N, N) and M (k, N, N), which may be scaled alike."""

    @property
    def exact(self) -> bool:
        """Whether the core limits no step, so that nothing but the model's own motion asks for a short one."""
        ...

    def transition(self, core: Array, M: Array, h: float) -> Array:
        """T(h) (k, N, N)."""
        ...

    def refused(self, core: Array, M: Array) -> Array:
        """The least h for each stable M (k) from which T(h) has an eigenvalue beyond 1; inf where there is none."""
        ...

    def __hash__(self) -> int:
        """Equal ways are asked once."""
        ...


def lengths(part: Ode, observer: Observer, dt: float, way: Way, core: Limit, rule: str = "") -> Lengths:
    """The step lengths of a part of the observer; `core`: what its linear core alone admits, `rule` as in `Lengths`.

    The costly `take` is computed only for a step `dt` that may exceed it.
    """
    errors, limits = _judged(part, observer), _limits(part, observer, way)
    tightest, at = core, int(limits.argmin()) if len(limits) else -1
    if limits.min(initial=math.inf) < core.dt:
        why = f"beyond it errors grow that decay in continuous time, of the estimate {errors.at(at)}"
        tightest = Limit(float(limits[at]), why, at)
    may_exceed = dt > SHARE * _shortest(errors.M, tightest.dt)
    take = _advised(part, observer, way, tightest.dt) if may_exceed else math.inf
    take = min(take, SHARE * pace(errors.blind)) if way.exact else take
    return Lengths(refused=tightest.dt, take=take, why=tightest.why, basis=BY_TRIAL, rule=rule)


@lru_cache(maxsize=16)
def _judged(part: Ode, observer: Observer) -> Frozen:
    """The stable errors, in coordinates that are balanced."""
    errors = frozen(part, observer)
    decaying = stable(errors.M)
    scale = np.ones(errors.M.shape[-1])
    balance(np.abs(np.concatenate((errors.M, errors.core[None]))).max(axis=0).reshape(-1), scale)
    M, core = (X * scale / scale[:, None] for X in (errors.M[decaying], errors.core))
    return replace(errors, M=M, points=errors.points[decaying], core=core)


@lru_cache(maxsize=16)
def _limits(part: Ode, observer: Observer, way: Way) -> Array:
    errors = _judged(part, observer)
    return way.refused(errors.core, errors.M)


@lru_cache(maxsize=16)
def _advised(part: Ode, observer: Observer, way: Way, refused: float) -> float:
    errors = _judged(part, observer)
    return advised(errors.core, errors.M, way, refused)


def stable(M: Array) -> Array:
    """Which of the M (k, N, N) have all their eigenvalues in the left half plane."""
    spectrum = np.linalg.eigvals(M)
    return np.asarray((spectrum.real < -AXIS * np.abs(spectrum).max(axis=1)[:, None]).all(axis=1))


def first_unstable(core: Array, M: Array, way: Way) -> Array:
    """`Way.refused` by trying step lengths in turn, of which the first decides: inf for the other M."""
    limits, fastest = np.full(len(M), math.inf), _fastest(M)
    if not fastest:
        return limits

    def radius(h: float) -> Array:
        return np.asarray(np.abs(np.linalg.eigvals(way.transition(core, M, h))).max(axis=1))

    good, bad = 0.0, SHORT / fastest
    while (radius(bad) <= 1 + ROUNDING).all():
        good, bad = bad, WIDER * bad
        if bad > LONGEST / fastest:
            return limits
    for _ in range(HALVINGS):
        middle = (good + bad) / 2
        good, bad = (middle, bad) if (radius(middle) <= 1 + ROUNDING).all() else (good, middle)
    limits[radius(bad).argmax()] = good
    return limits


def advised(core: Array, M: Array, way: Way, refused: float) -> float:
    """The length `take` for stable, balanced M (k, N, N), or half an eighth of `refused`; inf where there is no
    limit."""
    fastest = np.abs(np.linalg.eigvals(M)).max(axis=1, initial=0.0)
    if not fastest.any():
        return math.inf
    most = GROWTH * continuous(M, SHORT / np.where(fastest > 0, fastest, 1.0))
    end = min(refused, LONGEST / _fastest(M))

    def grows(h: float) -> bool:
        return bool((growth(way.transition(core, M, h)) > most).any())

    largest = longest(grows, _shortest(M, refused), end)
    return SHARE * (end if math.isinf(largest) and end == refused else largest)


def _shortest(M: Array, refused: float) -> float:
    """The step length at which the search for `take` ends, which follows every M in any case."""
    fastest = _fastest(M)
    return DEEPEST * refused if math.isfinite(refused) else SHORT / fastest if fastest else math.inf


def _fastest(M: Array) -> float:
    return float(np.abs(np.linalg.eigvals(M)).max(initial=0.0))
