"""The Jacobians of a form, as numbers, at points of the declared ranges, with nominal parameters.

The pace of a plant on its box, and its linearisation there, scaled by its ranges:

    A = S^-1 (df/dx) S,   C = R^-1 (dh/dx) S,   S: half the ranges of the states, R: half those of the outputs

at the middle of the box of states and inputs, and at points that fill it evenly; parameters are nominal.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.manifold import projected_points, tangents
from hgogen.analysis.undefined import FIX, MAKER, undefined_slopes
from hgogen.check import Check, ClaimId, Verdict
from hgogen.errors import BadArgument, HgogenError
from hgogen.form import Form
from hgogen.graph import Graph, to_casadi
from hgogen.program import sym
from hgogen.rigor.box import box
from hgogen.rigor.singular import with_limited_slopes
from hgogen.sentence import Sentence, because
from hgogen.signal import Signal, resting, spread
from hgogen.system import System


class Singular(BadArgument):
    """The error that a model's Jacobian is finite at no sample point of the declared ranges."""

    text = (
        "the Jacobian of {what} has numbers that are not finite at {reason}, and at every other point of the declared "
        "ranges that was tried; correct the ranges, or the model"
    )


class NoDeterminant(BadArgument):
    """The error that a form's det dPhi/dx is undefined at every sample point."""

    text = "det dPhi/dx of {what} is a finite real number at no sample point of the box: {reason}"


def jacobians_on_box(
    dynamics: Dynamics, samples: int = 64, affine: bool = False, edge: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return F = d(A z + b)/dz (k, n, n) and dh/dz (k, p, n) at k sample points of the declared ranges of states and
    inputs: the middle, corners and random points, without those where F or dh/dz is not finite. A signal without a
    range is at its nominal value, or 0.

    `samples`: the number of corners and of random points; `affine`: F is A(u, z) alone; `edge`: the distance of the
    corners from the ends, as a share of each range. Raises: `Singular` where no point remains.
    """
    return jacobians_at(dynamics, _points(dynamics, samples, edge), affine)


def jacobians_at(dynamics: Dynamics, points: np.ndarray, affine: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return F = d(A z + b)/dz (k, n, n) and dh/dz (k, p, n) at those of the `points` (N, n + m), each a state and an
    input, where all entries are finite; `affine`: F is A(u, z) alone. Raises: `Singular` where there is no such
    point."""
    F, H = _jacobians(dynamics, points, affine)
    finite = np.isfinite(F).all(axis=(1, 2)) & np.isfinite(H).all(axis=(1, 2))
    if not finite.any():
        at = ", ".join(f"{name} = {value:g}" for name, value in _named(dynamics, points[0]).items())
        raise Singular(dynamics.form.system.name, at)
    return F[finite], H[finite]


def disturbances_on_box(dynamics: Dynamics, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return F = d(A z + b)/dz (k, n, n) and d(A z + b)/du (k, n, m) at the points of `jacobians_on_box` where both are
    finite."""
    points = _points(dynamics, samples)
    F, B = (
        flow_jacobians(dynamics)(points),
        _evaluated(dynamics, dynamics.input_jacobian(*_variables(dynamics)))(points),
    )
    finite = np.isfinite(F).all(axis=(1, 2)) & np.isfinite(B).all(axis=(1, 2))
    return F[finite], B[finite]


def flow_jacobians(dynamics: Dynamics) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function from points (k, n + m), each a state and an input, to F = d(A z + b)/dz (k, n, n); the points
    may be (k, n + m + q), with values of the q parameters that have a range. An entry may be infinite or NaN."""
    return _evaluated(dynamics, dynamics.jacobian(*_variables(dynamics)))


def _jacobians(dynamics: Dynamics, points: np.ndarray, affine: bool = False) -> tuple[np.ndarray, np.ndarray]:
    z, u = _variables(dynamics)
    F = ca.densify(dynamics.affine(z, u)[0]) if affine else dynamics.jacobian(z, u)
    return _evaluated(dynamics, F)(points), _evaluated(dynamics, dynamics.output_jacobian(z, u))(points)


def _named(dynamics: Dynamics, point: np.ndarray) -> dict[str, float]:
    names = map(str, (*dynamics.form.to_form, *dynamics.form.system.inputs))
    return dict(zip(names, point.tolist(), strict=True))


def largest_determinant(dynamics: Dynamics) -> float:
    """Return the largest |det dPhi/dx| in the middle, at corners and at random points of the box. Raises:
    `NoDeterminant` where it is finite at none of them."""
    values = _evaluated(dynamics, dynamics.determinant(*_variables(dynamics)))(_points(dynamics, 64))
    finite = values[np.isfinite(values)]
    if not finite.size:
        never = "an observer would never correct; narrow the ranges to where the plant's equations are defined"
        raise NoDeterminant(dynamics.form.system.name, never)
    return float(np.abs(finite).max())


def _variables(dynamics: Dynamics) -> tuple[Graph, Graph]:
    return sym("form", "z", dynamics.n), sym("form", "u", len(dynamics.form.system.inputs))


def _points(dynamics: Dynamics, samples: int, edge: float = 0.0) -> np.ndarray:
    """Return points (1 + 2 samples, n + m) of the box of states
    and inputs: its middle, corners and random points."""
    signals = [*dynamics.form.states, *dynamics.form.system.inputs]
    rng = np.random.default_rng(1)
    corners = edge + (1 - 2 * edge) * rng.integers(0, 2, size=(samples, len(signals)))
    points = np.vstack([np.full((1, len(signals)), 0.5), corners, rng.uniform(size=(samples, len(signals)))])
    lows, highs = np.array([*map(spread, signals)]).T
    points = lows + points * (highs - lows)
    z = projected_points(
        dynamics.invariants, dynamics.form.states, dynamics.form.system.nominal, points[:, : dynamics.n]
    )
    return np.hstack((z, points[: len(z), dynamics.n :]))


def _evaluated(dynamics: Dynamics, matrix: Graph) -> Callable[[np.ndarray], np.ndarray]:
    """Return the matrix (r, c) of z and u as a function of points (k, n + m)
    with the result (k, r, c). Parameters with a range are nominal, unless
    the points are (k, n + m + q) and contain their values."""
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
    """Return the checks `singular.NAME` of the equations (rate or output NAME) whose partial derivatives by the states
    may not be finite on the box. An observer that evaluates these derivatives at its estimate needs the checks.

    The derivatives of the form's equations are tested as they are written, and at sample points as the program computes
    them.
    """
    dynamics, sampled = Dynamics(replace(form, fallback=())), {}
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


# ---------------------------------------------------------------- pace


_POINTS = 32


@dataclass(eq=False)
class NoLinearisation(HgogenError):
    """The error that a plant has no linearisation on its declared ranges; `reason`: what is missing."""

    reason: str
    text = "the observability measure is not computed: {reason}"


@dataclass(frozen=True)
class Linear:
    """A linearisation at N points, scaled by half the ranges of states (S) and outputs (R): A = S^-1 df/dx S (N, n, n),
    C = R^-1 dh/dx S (N, p, n); `along`: orthonormal bases (N, n, n - k) of the directions along k invariants."""

    A: np.ndarray
    C: np.ndarray
    along: np.ndarray


@dataclass(frozen=True)
class Pace:
    """The time scales of a plant on its declared ranges: the shortest and the longest time in which a state crosses its
    range at its largest rate among sample points, and the fastest mode (1/time) of the linearisation there; 0 where no
    state has a rate."""

    shortest: float
    longest: float
    fastest: float


def pace(plant: System) -> Pace:
    """Return the time scales of a plant on its declared ranges. Raises: `NoLinearisation` where a state or an input has
    no range, or the model no value; `NoGraph`."""
    return linearisation_on_box(plant)[-1]


def linearisation_on_box(plant: System) -> tuple[np.ndarray, Linear, Pace]:
    """Return sample points (x, u) (N, n + m) of the declared ranges where the plant has a value, its linearisation at
    these points, and its time scales. Raises: as `pace`."""
    signals = (*plant.states, *plant.inputs)
    ranged(signals)
    points = _lattice(signals)
    x = projected_points(plant.invariants, plant.states, plant.nominal, points[:, : len(plant.states)])
    u = points[: len(x), len(plant.states) :]
    points = np.hstack((x, u))
    with np.errstate(all="ignore"):
        rates, slopes = _linearised(plant, x, u)
        known = np.isfinite(rates).all(1) & np.isfinite(slopes.A).all((1, 2)) & np.isfinite(slopes.C).all((1, 2))
        if not known.any():
            raise NoLinearisation(f"the model has no value at any of {_POINTS} points of the box")
        crossing = 2 * np.array([_half(s) for s in plant.states]) / np.abs(rates[known]).max(axis=0)
    moving = crossing[np.isfinite(crossing)]
    finite = Linear(slopes.A[known], slopes.C[known], slopes.along[known])
    fastest = np.abs(np.linalg.eigvals(finite.A)).max()
    return points[known], finite, Pace(float(min(moving, default=0)), float(max(moving, default=0)), float(fastest))


def linear(plant: System, x: np.ndarray, u: np.ndarray) -> Linear:
    """Return the linearisation of the plant at N states x (N, n) and inputs u (N, m), scaled by half the ranges as in
    `Linear`."""
    return _linearised(plant, x, u)[1]


def corrects_nothing(plant: System, x: Sequence[float]) -> bool:
    """Return whether an estimate that starts at the state x (n) is never corrected: no output has a partial derivative
    by the states there, and the plant is at rest."""
    u = np.array([[resting(signal) for signal in plant.inputs]])
    with np.errstate(all="ignore"):
        rate, slopes = _linearised(plant, np.array([x], dtype=float), u)
    return not rate.any() and not np.nan_to_num(slopes.C).any()  # a norm at 0 has 0/0, where the filter takes 0


def _linearised(plant: System, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, Linear]:
    """Return f (N, n), of a discrete plant f - x, and the scaled linearisation, at x (N, n), u (N, m)."""
    f, y, F, H, K = (np.array(part) for part in _functions(plant)(x.T, u.T))
    S = np.array([_half(s) for s in plant.states])
    n, count = len(plant.states), len(x)
    A = F.T.reshape(count, n, n).transpose(0, 2, 1) * S / S[:, None]  # CasADi counts by columns
    C = H.T.reshape(count, n, len(plant.outputs)).transpose(0, 2, 1) * S
    R = []  # without a declared range: half the range of the output's values, or the value where they are all equal
    for s, row in zip(plant.outputs, y, strict=True):
        if s.bounded:
            R.append(_half(s))
            continue
        values = row[np.isfinite(row)]
        half, size = (np.ptp(values) / 2, np.abs(values).max()) if len(values) else (0.0, 0.0)
        R.append(float(half or size or 1.0))
    invariant_slopes = K.T.reshape(count, n, len(plant.invariants)).transpose(0, 2, 1) * S
    return f.T - x if plant.discrete else f.T, Linear(A, C / np.array(R)[:, None], tangents(invariant_slopes))


def slopes(
    pairs: Sequence[tuple[sp.Expr, Signal]], signals: tuple[Signal, ...], nominal: Mapping[sp.Symbol, Any]
) -> np.ndarray:
    """Return the derivatives (N, k) of k `pairs`, each an expression and the signal by which it is differentiated, at
    the N sample points of `signals` where all have a value. `nominal`: the values of the other symbols. Raises:
    `NoLinearisation` where a signal has no range, or there is no such point; `NoGraph`."""
    ranged(signals)
    x = ca.SX.sym("x", len(signals))
    symbols = dict(zip(signals, ca.vertsplit(x), strict=True)) | {p: float(value) for p, value in nominal.items()}
    graphs = to_casadi([with_limited_slopes(expression, box(signals)) for expression, _ in pairs], symbols)
    each = [ca.jacobian(graph, symbols[signal]) for graph, (_, signal) in zip(graphs, pairs, strict=True)]
    function = ca.Function("slopes", [x], [ca.densify(ca.SX(ca.vertcat(*each)))])
    values = np.array(function(_lattice(signals).T)).reshape(len(pairs), _POINTS).T
    known = values[np.isfinite(values).all(axis=1)]
    if not len(known):
        raise NoLinearisation(f"the model has no value at any of {_POINTS} points of the box")
    return np.asarray(known)


@lru_cache(maxsize=32)  # each step of a plant asks for them
def _functions(plant: System) -> Any:
    """Return f, h, and df/dx, dh/dx, dc/dx as columns, c the invariants, as a CasADi function of x (n) and u (m)."""
    x, u = ca.SX.sym("x", len(plant.states)), ca.SX.sym("u", len(plant.inputs))
    symbols = dict(zip(plant.states, ca.vertsplit(x), strict=True))
    symbols |= dict(zip(plant.inputs, ca.vertsplit(u), strict=True)) if plant.inputs else {}
    symbols |= {p: float(value) for p, value in plant.nominal.items()}
    parts = (plant.flow, plant.output, plant.invariants)
    rows = ([with_limited_slopes(row, plant.box) for row in part] for part in parts)
    f, h, c = (ca.densify(ca.SX(ca.vertcat(*to_casadi(part, symbols)))) for part in rows)
    slopes = (ca.vec(ca.densify(ca.jacobian(part, x))) for part in (f, h, c))
    return ca.Function("f", [x, u], [f, h, *slopes])


def ranged(signals: tuple[Signal, ...]) -> None:
    """Demand that there are `signals` and that each has a range. Raises: `NoLinearisation`."""
    loose = [s.name for s in signals if not s.bounded]
    if loose or not signals:
        raise NoLinearisation(f"no range is declared for {', '.join(loose)}" if loose else "the plant has no states")


def _half(signal: Signal) -> float:
    low, high = signal.interval
    return (high - low) / 2


def _lattice(signals: tuple[Signal, ...]) -> np.ndarray:
    """Return points of the box (N, k): its middle, and those of
    Roberts' additive recurrence (2018), evenly spread."""
    k = len(signals)
    phi = 1.5
    for _ in range(60):  # the root of phi^(k+1) = phi + 1
        phi = (1 + phi) ** (1 / (k + 1))
    shares = (0.5 + np.arange(_POINTS)[:, None] * phi ** -np.arange(1.0, k + 1)) % 1
    low, high = np.array([s.interval for s in signals]).T
    return np.asarray(low + shares * (high - low))
