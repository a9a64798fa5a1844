"""How fast a plant moves on its box, and its linearisation there, in shares of its ranges.

    A = S^-1 (df/dx) S,   C = R^-1 (dh/dx) S,   S: half the ranges of the states, R: half those of the outputs

at the middle of the box of states and inputs, and at points that fill it evenly; parameters are nominal.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.errors import HgogenError
from hgogen.graph import to_casadi
from hgogen.signal import Signal
from hgogen.system import System

_POINTS = 32


@dataclass(eq=False)
class NoSight(HgogenError):
    """A measure of how observable the states are from the outputs is not made; `reason`: what is missing."""

    reason: str

    def __str__(self) -> str:
        return f"how much the outputs show is not measured: {self.reason}"


@dataclass(frozen=True)
class Linear:
    """df/dx (n, n) and dh/dx (p, n) in half ranges, each at N points."""

    A: np.ndarray
    C: np.ndarray


@dataclass(frozen=True)
class Pace:
    """The pace of a plant on its box: the shortest and the longest time that a state takes to cross its range, at its
    fastest among fixed points, and the fastest mode of its linearisation there (1/time); 0 where nothing moves."""

    shortest: float
    longest: float
    fastest: float


def pace(plant: System) -> Pace:
    """The pace of a plant on its box.

    Raises: `NoSight` where a state or an input has no range, or the model no value; `NoGraph`.
    """
    return on_box(plant)[-1]


def on_box(plant: System) -> tuple[np.ndarray, Linear, Pace]:
    """Points of the box (N, n + m) where the model has a value, what it is linearised there, and its pace."""
    signals = (*plant.states, *plant.inputs)
    ranged(signals)
    points = _lattice(signals)
    x, u = points[:, : len(plant.states)], points[:, len(plant.states) :]
    with np.errstate(all="ignore"):
        rates, slopes = _linearised(plant, x, u)
        known = np.isfinite(rates).all(1) & np.isfinite(slopes.A).all((1, 2)) & np.isfinite(slopes.C).all((1, 2))
        if not known.any():
            raise NoSight(f"the model has no value at any of {_POINTS} points of the box")
        crossing = 2 * np.array([_half(s) for s in plant.states]) / np.abs(rates[known]).max(axis=0)
    moving = crossing[np.isfinite(crossing)]
    finite = Linear(slopes.A[known], slopes.C[known])
    fastest = np.abs(np.linalg.eigvals(finite.A)).max()
    return points[known], finite, Pace(float(min(moving, default=0)), float(max(moving, default=0)), float(fastest))


def linear(plant: System, x: np.ndarray, u: np.ndarray) -> Linear:
    """The linearisation at x (N, n), u (N, m)."""
    return _linearised(plant, x, u)[1]


def _linearised(plant: System, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, Linear]:
    """f (N, n), and the linearisation, at x (N, n), u (N, m)."""
    f, y, F, H = (np.array(part) for part in _functions(plant)(x.T, u.T))
    S = np.array([_half(s) for s in plant.states])
    n, count = len(plant.states), len(x)
    A = F.T.reshape(count, n, n).transpose(0, 2, 1) * S / S[:, None]  # CasADi counts by columns
    C = H.T.reshape(count, n, len(plant.outputs)).transpose(0, 2, 1) * S
    R = []  # without a range half of what an output takes on, or its size where it does not move
    for s, row in zip(plant.outputs, y, strict=True):
        if s.bounded:
            R.append(_half(s))
            continue
        values = row[np.isfinite(row)]
        half, size = (np.ptp(values) / 2, np.abs(values).max()) if len(values) else (0.0, 0.0)
        R.append(float(half or size or 1.0))
    return f.T, Linear(A, C / np.array(R)[:, None])


def slopes(
    pairs: Sequence[tuple[sp.Expr, Signal]], signals: tuple[Signal, ...], nominal: Mapping[sp.Symbol, Any]
) -> np.ndarray:
    """The derivative of each expression by its signal, of `signals`, at those points (N, k) of their box where all have
    a value.

    Raises: `NoSight` where a signal has no range, or there is no such point; `NoGraph`.
    """
    ranged(signals)
    x = ca.SX.sym("x", len(signals))
    symbols = dict(zip(signals, ca.vertsplit(x), strict=True)) | {p: float(value) for p, value in nominal.items()}
    graphs = to_casadi([expression for expression, _ in pairs], symbols)
    each = [ca.jacobian(graph, symbols[signal]) for graph, (_, signal) in zip(graphs, pairs, strict=True)]
    function = ca.Function("slopes", [x], [ca.densify(ca.SX(ca.vertcat(*each)))])
    values = np.array(function(_lattice(signals).T)).reshape(len(pairs), _POINTS).T
    known = values[np.isfinite(values).all(axis=1)]
    if not len(known):
        raise NoSight(f"the model has no value at any of {_POINTS} points of the box")
    return np.asarray(known)


def _functions(plant: System) -> Any:
    """f, h, df/dx and dh/dx, the latter as columns, as a function of x (n) and u (m)."""
    x, u = ca.SX.sym("x", len(plant.states)), ca.SX.sym("u", len(plant.inputs))
    symbols = dict(zip(plant.states, ca.vertsplit(x), strict=True))
    symbols |= dict(zip(plant.inputs, ca.vertsplit(u), strict=True)) if plant.inputs else {}
    symbols |= {p: float(value) for p, value in plant.nominal.items()}
    f, h = (ca.densify(ca.vertcat(*to_casadi(part, symbols))) for part in (plant.flow, plant.output))
    slopes = (ca.vec(ca.densify(ca.jacobian(part, x))) for part in (f, h))
    return ca.Function("f", [x, u], [f, h, *slopes])


def ranged(signals: tuple[Signal, ...]) -> None:
    """Raises: `NoSight` where a signal has no range, or there is none."""
    loose = [s.name for s in signals if not s.bounded]
    if loose or not signals:
        raise NoSight(f"no range is declared for {', '.join(loose)}" if loose else "the plant has no states")


def _half(signal: Signal) -> float:
    low, high = signal.interval
    return (high - low) / 2


def _lattice(signals: tuple[Signal, ...]) -> np.ndarray:
    """The middle of the box, and points of the additive recurrence of Roberts (2018), which fill it evenly."""
    k = len(signals)
    phi = 1.5
    for _ in range(60):  # the root of phi^(k+1) = phi + 1
        phi = (1 + phi) ** (1 / (k + 1))
    shares = (0.5 + np.arange(_POINTS)[:, None] * phi ** -np.arange(1.0, k + 1)) % 1
    low, high = np.array([s.interval for s in signals]).T
    return np.asarray(low + shares * (high - low))
