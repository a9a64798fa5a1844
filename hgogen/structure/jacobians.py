"""The Jacobians of a form in numbers, at points of the declared box; parameters are nominal."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from hgogen.analysis.undefined import FIX, MAKER, undefined_slopes
from hgogen.check import Check, ClaimId, Verdict
from hgogen.errors import HgogenError
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.program import sym
from hgogen.sentence import Sentence, because
from hgogen.signal import spread
from hgogen.structure.dynamics import Dynamics


@dataclass(eq=False)
class Singular(HgogenError):
    """A model whose Jacobian is finite at no point of the declared ranges that was tried."""

    system: str
    point: dict[str, float]

    def __str__(self) -> str:
        at = ", ".join(f"{name} = {value:g}" for name, value in self.point.items())
        return (
            f"the Jacobian of {self.system} has numbers that are not finite at {at}, and at every other point of the "
            "declared ranges that was tried; correct the ranges, or the model"
        )


@dataclass(eq=False)
class NoDeterminant(HgogenError):
    """A form whose det dPhi/dx is undefined wherever it was asked."""

    system: str

    def __str__(self) -> str:
        return (
            f"det dPhi/dx of {self.system} is a finite real number at no sample point of the box: an observer would "
            "never correct; narrow the ranges to where the plant's equations are defined"
        )


def jacobians_on_box(
    dynamics: Dynamics, samples: int = 64, affine: bool = False, edge: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """F (k, n, n) and dh/dz (k, p, n) in the middle, on corners and at random points of the box of states and inputs;
    F = A(u, z) alone where that is `affine`. `edge`: how far the corners lie inside, of each range.

    Where a signal has no range the sample is its nominal value, or 0.

    Points where one of them is not finite are left out. Raises: `Singular` where none is left.
    """
    return jacobians_at(dynamics, _points(dynamics, samples, edge), affine)


def jacobians_at(dynamics: Dynamics, points: np.ndarray, affine: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """F (k, n, n) and dh/dz (k, p, n) at those of the `points` (k, n + m) of the box, each a state and an input, where
    all of them are finite.

    Raises: `Singular` where none is left.
    """
    F, H = _jacobians(dynamics, points, affine)
    finite = np.isfinite(F).all(axis=(1, 2)) & np.isfinite(H).all(axis=(1, 2))
    if not finite.any():
        raise Singular(dynamics.form.system.name, _named(dynamics, points[0]))
    return F[finite], H[finite]


def flow_jacobians(dynamics: Dynamics) -> Callable[[np.ndarray], np.ndarray]:
    """F (k, n, n) as a function of points (k, n + m), each a state and an input, or (k, n + m + q) with the values of
    the q parameters that have a range; not finite where there is none."""
    return _evaluated(dynamics, dynamics.jacobian(*_variables(dynamics)))


def not_finite(dynamics: Dynamics) -> dict[str, dict[str, float]]:
    """Of each row of the flow and of the output, by the name of its state or output, a point in the middle, on corners
    or inside of the box at which one of its derivatives is not a finite number."""
    points = _points(dynamics, 64)
    F, H = _jacobians(dynamics, points)
    rows = np.concatenate([F, H], axis=1)
    lost = ~np.isfinite(rows).all(axis=2)
    names = (*dynamics.form.names, *(y.name for y in dynamics.form.system.outputs))
    return {
        name: _named(dynamics, points[int(np.argmax(lost[:, i]))]) for i, name in enumerate(names) if lost[:, i].any()
    }


def _jacobians(dynamics: Dynamics, points: np.ndarray, affine: bool = False) -> tuple[np.ndarray, np.ndarray]:
    z, u = _variables(dynamics)
    F = _numbers(dynamics, ca.densify(dynamics.affine(z, u)[0]) if affine else dynamics.jacobian(z, u), points)
    return F, _numbers(dynamics, dynamics.output_jacobian(z, u), points)


def _named(dynamics: Dynamics, point: np.ndarray) -> dict[str, float]:
    """The coordinates of a point by their names."""
    names = map(str, (*dynamics.form.to_form, *dynamics.form.system.inputs))
    return dict(zip(names, point.tolist(), strict=True))


def largest_determinant(dynamics: Dynamics) -> float:
    """The largest |det dPhi/dx| in the middle, on corners and at random points of the box.

    Raises: `NoDeterminant` where it is finite at none of them.
    """
    graph = dynamics.determinant(*_variables(dynamics))
    values = _numbers(dynamics, graph, _points(dynamics, 64))
    finite = values[np.isfinite(values)]
    if not finite.size:
        raise NoDeterminant(dynamics.form.system.name)
    return float(np.abs(finite).max())


def _variables(dynamics: Dynamics) -> tuple[Graph, Graph]:
    return sym("form", "z", dynamics.n), sym("form", "u", len(dynamics.form.system.inputs))


def _points(dynamics: Dynamics, samples: int, edge: float = 0.0) -> np.ndarray:
    """Middle of the box, corners and random points, (1 + 2 samples, n + m)."""
    signals = [*dynamics.form.states, *dynamics.form.system.inputs]
    rng = np.random.default_rng(1)
    corners = edge + (1 - 2 * edge) * rng.integers(0, 2, size=(samples, len(signals)))
    points = np.vstack([np.full((1, len(signals)), 0.5), corners, rng.uniform(size=(samples, len(signals)))])
    lows, highs = np.array([*map(spread, signals)]).T
    return np.asarray(lows + points * (highs - lows))


def _numbers(dynamics: Dynamics, matrix: Graph, points: np.ndarray) -> np.ndarray:
    """The matrix (r, c) of z and u at each of k points, (k, r, c)."""
    return _evaluated(dynamics, matrix)(points)


def _evaluated(dynamics: Dynamics, matrix: Graph) -> Callable[[np.ndarray], np.ndarray]:
    """The matrix (r, c) of z and u as a function of points (k, n + m), (k, r, c); parameters with a range are nominal
    where the points do not go on with their values."""
    plant, inputs_end = dynamics.form.system.tunable, dynamics.n + len(dynamics.form.system.inputs)
    graph = ca.Function("F", [*_variables(dynamics), *(sym("plant", p.name) for p in plant)], [matrix])

    def numbers(points: np.ndarray) -> np.ndarray:
        states, inputs, values = np.split(points.T, (dynamics.n, inputs_end))
        parameters = values[:, None] if len(values) else (float(p.nominal or 0) for p in plant)
        wide = graph(states, inputs, *parameters)  # the matrices side by side
        return np.ascontiguousarray(np.array(wide).reshape(matrix.shape[0], len(points), -1).swapaxes(0, 1))

    return numbers


@lru_cache(maxsize=32)
def evaluated(form: Form) -> tuple[Check, ...]:
    """Return the checks `singular.NAME` of rows whose derivatives by the states may not be finite on the box, for an
    observer that evaluates them at the estimate; rows whose values may not be are among the form's own checks.

    Derivatives are those of the form's equations, as they are written, and, at points, of the program's.
    """
    sampled = {}
    for row, point in not_finite(Dynamics(replace(form, held=()))).items():
        id, reason = ClaimId(MAKER, row), because("one of {row} is not", row=row)
        pattern = "the program's derivatives of {row} by the states are finite on the declared ranges"
        claim = Sentence.of(pattern, row=row)
        sampled[id] = Check(id, claim, Verdict.REFUTED, reason, point, FIX, "it is taken for 0 there")
    known = undefined_slopes(form.system)
    settled = {check.id for check in (*form.checks, *known) if check.verdict is Verdict.REFUTED}
    new = {id: check for id, check in sampled.items() if id not in settled}
    return (*(check for check in known if check.id not in new), *new.values())
