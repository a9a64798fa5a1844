"""The Jacobians of a form in numbers, at points of the declared box; parameters are nominal."""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from hgogen.errors import HgogenError
from hgogen.graph import Graph
from hgogen.program import sym
from hgogen.structure.dynamics import Dynamics


@dataclass(eq=False)
class Singular(HgogenError):
    """A model whose Jacobian is not finite at a point of the declared box, where an observer may evaluate it."""

    system: str
    point: dict[str, float]

    def __str__(self) -> str:
        at = ", ".join(f"{name} = {value:g}" for name, value in self.point.items())
        return (
            f"the Jacobian of {self.system} has numbers that are not finite at {at}, a point of the declared box; "
            "narrow the ranges so that they stay away from there, for a root by low = 1e-3 in place of 0"
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

    Raises: `Singular` where one of them is not finite.
    """
    return jacobians_at(dynamics, _points(dynamics, samples, edge), affine)


def jacobians_at(dynamics: Dynamics, points: np.ndarray, affine: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """F (k, n, n) and dh/dz (k, p, n) at `points` (k, n + m) of the box, each a state and an input.

    Raises: `Singular` where one of them is not finite.
    """
    z, u = _variables(dynamics)
    F = _numbers(dynamics, ca.densify(dynamics.affine(z, u)[0]) if affine else dynamics.jacobian(z, u), points)
    H = _numbers(dynamics, dynamics.output_jacobian(z, u), points)
    finite = np.isfinite(F).all(axis=(1, 2)) & np.isfinite(H).all(axis=(1, 2))
    if not finite.all():
        form = dynamics.form
        names = map(str, (*form.to_form, *form.system.inputs))
        point = points[int(np.argmin(finite))]
        raise Singular(form.system.name, dict(zip(names, point.tolist(), strict=True)))
    return F, H


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
    lows, highs = np.array([s.interval if s.bounded else (s.nominal or 0.0,) * 2 for s in signals]).T
    return np.asarray(lows + points * (highs - lows))


def _numbers(dynamics: Dynamics, matrix: Graph, points: np.ndarray) -> np.ndarray:
    """The matrix (r, c) of z and u at each of k points, (k, r, c)."""
    plant = [p for p in dynamics.form.system.parameters if p.bounded]
    graph = ca.Function("F", [*_variables(dynamics), *(sym("plant", p.name) for p in plant)], [matrix])
    states, inputs = points[:, : dynamics.n].T, points[:, dynamics.n :].T
    wide = graph(states, inputs, *(float(p.nominal or 0) for p in plant))  # the matrices side by side
    return np.ascontiguousarray(np.array(wide).reshape(matrix.shape[0], len(points), -1).swapaxes(0, 1))
