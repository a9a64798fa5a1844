"""The error of an estimator at fixed points of its box, e' = M e: its linear core and the model's Jacobian together.

M is the Jacobian of the right-hand side in the fields, the measurement being what the estimate would give: the error of
the estimate against a plant nearby. The points lie in the box and beyond its edges, where the argument of the model is
clamped and its columns are 0: a clamp passes a share of an error, between none and all of it, and the points have both.
Fields that adapt rest where the core is the fastest.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from hgogen.chains.core import core, nominal
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
