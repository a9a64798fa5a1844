"""The set on which the invariants c(x) = 0 of a plant hold: projections onto it, and its tangent directions.

    x <- x - V C' (C V C')^+ c,   C = dc/dx,   V = diag(half range)^2        Gauss-Newton, in units of the ranges

A point without a direction, such as q = 0 of a unit quaternion, or whose search leaves the ranges, is first moved by
half the range of one state.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.graph import Graph, to_casadi
from hgogen.rigor.box import box
from hgogen.rigor.invariant import divided, factors, finite_on, rate, restricted
from hgogen.signal import Signal, spread

PASSES, CLOSE = 40, 1e-12
_STARTS = 16  # random states from which one on the invariants is searched


def projection(
    constraints: Sequence[sp.Expr], states: Sequence[Signal], parameters: Sequence[sp.Symbol] = ()
) -> Callable[[np.ndarray, Sequence[float]], np.ndarray | None]:
    """Return the function that projects a point onto the set of invariants c(x) = 0: from a point (n) and values of the
    parameters to a point of the set near it, in the declared ranges if possible; None where the search does not
    converge. `constraints`: the expressions c."""
    x, p = ca.SX.sym("x", len(states)), ca.SX.sym("p", len(parameters))
    symbols = dict(zip((*states, *parameters), (*ca.vertsplit(x), *ca.vertsplit(p)), strict=True))
    c = ca.densify(ca.vertcat(*to_casadi(constraints, symbols)))
    evaluate = ca.Function("c", [x, p], [c, ca.densify(ca.jacobian(c, x))])
    low, high = np.array([*map(spread, states)]).T
    half = np.where(high > low, (high - low) / 2, 1.0)
    limited = np.array([s.bounded and s.period is None for s in states])
    first, last = np.where(limited, low - CLOSE * half, -np.inf), np.where(limited, high + CLOSE * half, np.inf)

    def nearest(point: np.ndarray, values: Sequence[float]) -> np.ndarray | None:
        outside = None
        for at in _zeros(evaluate, half, point, values):
            if (first <= at).all() and (at <= last).all():
                return at
            outside = at if outside is None else outside
        return outside

    return nearest


def _zeros(evaluate: ca.Function, half: np.ndarray, point: np.ndarray, values: Sequence[float]) -> Iterator[np.ndarray]:
    """Yield points (n) with c = 0, from a point and from those `half` a range (n) aside; `evaluate`: c and dc/dx."""
    for shift in (np.zeros(len(half)), *np.diag(half), *np.diag(-half)):
        at = point + shift
        for _ in range(PASSES):
            value, slope = (np.array(part) for part in evaluate(at, values))
            scaled = slope * half
            size = np.abs(scaled).max()
            if not (np.isfinite(value).all() and size > CLOSE):
                break
            if np.abs(value).max() <= CLOSE * size:
                yield np.asarray(at)
                break
            at = at - half * (np.linalg.pinv(scaled) @ value).ravel()


def projected_points(
    constraints: Sequence[sp.Expr], states: Sequence[Signal], values: Mapping[Any, Any], points: np.ndarray
) -> np.ndarray:
    """Return projections (k, n) of `points` (N, n) onto the set c(x) = 0, k <= N: those for which the search converges.
    `constraints`: the expressions c; `values`: those of the parameters."""
    if not constraints:
        return points
    nearest = projection(constraints, states, tuple(values))
    reached = [at for point in points if (at := nearest(point, [*map(float, values.values())])) is not None]
    return np.array(reached).reshape(-1, len(states))


def attracted_flow(
    flow: Graph, constraints: Sequence[sp.Expr], states: Sequence[Signal], symbols: Mapping[Any, Graph], rate: float
) -> Graph:
    """Return the flow (n) with a term that attracts to the set c(x) = 0: f - rate V C' (C V C')^-1 c, C = dc/dx, V a
    diagonal matrix of squared ranges, so that c' contains -rate c. An integrator that leaves c = 0 by its errors then
    returns, also where f alone would diverge from it."""
    if not constraints:
        return flow
    x = ca.vertcat(*(symbols[s] for s in states))
    c = ca.vertcat(*to_casadi(constraints, symbols))
    low, high = np.array([*map(spread, states)]).T
    V = ca.diag(ca.DM(np.where(high > low, (high - low) / 2, 1.0) ** 2))
    C = ca.jacobian(c, x)
    S = C @ V @ C.T
    return flow - rate * V @ C.T @ ca.solve(S + 1e-9 * ca.trace(S) * ca.SX.eye(c.numel()), c)  # some may be redundant


@lru_cache(maxsize=64)
def invariant_fault(
    invariants: tuple[sp.Expr, ...],
    states: tuple[Signal, ...],
    inputs: tuple[Signal, ...],
    nominal: tuple[tuple[Signal, sp.Rational], ...],
    flow: tuple[sp.Expr, ...],
) -> str:
    """Return the text of what is wrong with declared invariants c(x) = 0 and of the remedy; "" where the flow is proved
    to preserve c = 0, and each c has one factor that may be 0 on the ranges, with a nonzero gradient there. `nominal`:
    the values of the parameters."""
    values, rates = dict(nominal), dict(zip(states, flow, strict=True))
    around = box((*states, *inputs, *values), values)
    named = {f"invariant {k}, {row}": factors(row, states, around) for k, row in enumerate(invariants, 1)}
    if wrong := _zero_fault(named):
        return wrong
    constraints = [part for parts in named.values() for part, _ in parts]
    divisions = [divided(rate(c, rates), constraints) for c in constraints]
    for name, division in zip(named, divisions, strict=True):
        if division.remainder != 0:
            changes = f"is not kept by the flow, which changes it by {division.remainder} in a unit of time"
            return f"{name} = 0, {changes}; correct the flow, or leave it out"
    low, high = np.array([*map(spread, states)]).T
    shares = np.vstack((np.full(len(states), 0.5), np.random.default_rng(1).uniform(size=(_STARTS, len(states)))))
    points = projected_points(constraints, states, values, low + shares * (high - low))
    if not len(points):
        return "no state is found on its invariants; correct them, or declare ranges around some"
    fixed = {s: Fraction(float(v)) for s, v in (*values.items(), *((u, sum(spread(u)) / 2) for u in inputs))}
    places = [fixed | dict(zip(states, map(Fraction, map(float, point)), strict=True)) for point in points]
    on_them = [restricted(f, constraints) for f in flow]
    for name, division in zip(named, divisions, strict=True):
        if not finite_on((*on_them, *division.quotients), constraints, states, tuple(fixed), places):
            quotient = "where it is 0 the flow, or the flow's rate of it over it, is not finite, or it has no slope"
            return f"{name}, is not known to be kept: {quotient}; correct the flow, or leave it out"
    return ""


def _zero_fault(named: Mapping[str, Sequence[tuple[sp.Expr, int]]]) -> str:
    """Return what is wrong with the factors of invariants by name, each with its power, "" where each is one alone."""
    for name, parts in named.items():
        if not parts:
            return f"{name}, has no zero that depends on states in their ranges; write what they keep at 0"
        if len(parts) > 1:
            zeros = " or ".join(f"{part} = 0" for part, _ in parts)
            return f"{name}, is 0 where {zeros}; write the one where the plant is"
        if parts[0][1] > 1:
            return f"{name}, has no slope where it is 0; write {parts[0][0]}"
    return ""


def tangents(slopes: np.ndarray) -> np.ndarray:
    """Return orthonormal bases (N, n, n - k) of the tangent directions to c = 0, from dc/dx (N, k, n) in scaled
    states."""
    *_, directions = np.linalg.svd(slopes)
    return np.swapaxes(directions[:, slopes.shape[1] :, :], 1, 2)
