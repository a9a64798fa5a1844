"""The Jacobians of a form in numbers, at points of the declared box; parameters are nominal."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np

from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.undefined import FIX, MAKER, undefined_slopes
from hgogen.check import Check, ClaimId, Verdict
from hgogen.errors import BadArgument
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.program import sym
from hgogen.sentence import Sentence, because
from hgogen.signal import spread


class Singular(BadArgument):
    """A model whose Jacobian is finite at no point of the declared ranges that was tried."""

    text = (
        "the Jacobian of {what} has numbers that are not finite at {reason}, and at every other point of the declared "
        "ranges that was tried; correct the ranges, or the model"
    )


class NoDeterminant(BadArgument):
    """A form whose det dPhi/dx is undefined wherever it was asked."""

    text = "det dPhi/dx of {what} is a finite real number at no sample point of the box: {reason}"


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
        at = ", ".join(f"{name} = {value:g}" for name, value in _named(dynamics, points[0]).items())
        raise Singular(dynamics.form.system.name, at)
    return F[finite], H[finite]


def flow_jacobians(dynamics: Dynamics) -> Callable[[np.ndarray], np.ndarray]:
    """F (k, n, n) as a function of points (k, n + m), each a state and an input, or (k, n + m + q) with the values of
    the q parameters that have a range; not finite where there is none."""
    return _evaluated(dynamics, dynamics.jacobian(*_variables(dynamics)))


def _jacobians(dynamics: Dynamics, points: np.ndarray, affine: bool = False) -> tuple[np.ndarray, np.ndarray]:
    z, u = _variables(dynamics)
    F = ca.densify(dynamics.affine(z, u)[0]) if affine else dynamics.jacobian(z, u)
    return _evaluated(dynamics, F)(points), _evaluated(dynamics, dynamics.output_jacobian(z, u))(points)


def _named(dynamics: Dynamics, point: np.ndarray) -> dict[str, float]:
    """The coordinates of a point by their names."""
    names = map(str, (*dynamics.form.to_form, *dynamics.form.system.inputs))
    return dict(zip(names, point.tolist(), strict=True))


def largest_determinant(dynamics: Dynamics) -> float:
    """The largest |det dPhi/dx| in the middle, on corners and at random points of the box.

    Raises: `NoDeterminant` where it is finite at none of them.
    """
    values = _evaluated(dynamics, dynamics.determinant(*_variables(dynamics)))(_points(dynamics, 64))
    finite = values[np.isfinite(values)]
    if not finite.size:
        never = "an observer would never correct; narrow the ranges to where the plant's equations are defined"
        raise NoDeterminant(dynamics.form.system.name, never)
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
    dynamics, sampled = Dynamics(replace(form, held=())), {}
    points = _points(dynamics, 64)
    lost = ~np.isfinite(np.concatenate(_jacobians(dynamics, points), axis=1)).all(axis=2)
    pattern = "the program's derivatives of {row} by the states are finite on the declared ranges"
    for row, at in zip((*form.names, *(y.name for y in form.system.outputs)), lost.T, strict=True):
        if at.any():
            id, reason = ClaimId(MAKER, row), because("one of {row} is not", row=row)
            claim, point = Sentence.of(pattern, row=row), _named(dynamics, points[int(np.argmax(at))])
            sampled[id] = Check(id, claim, Verdict.REFUTED, reason, point, FIX, "it is taken for 0 there")
    known = undefined_slopes(form.system)
    settled = {check.id for check in (*form.checks, *known) if check.verdict is Verdict.REFUTED}
    new = {id: check for id, check in sampled.items() if id not in settled}
    return (*(check for check in known if check.id not in new), *new.values())
