"""Points on the invariants c(x) = 0 of a plant, and directions along them.

    x <- x - V C' (C V C')^+ c,   C = dc/dx,   V = diag(half range)^2        Gauss-Newton, in units of the ranges

A point without a direction, such as q = 0 of a unit quaternion, is first moved by half the range of one state.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.graph import to_casadi
from hgogen.signal import Signal, spread

PASSES, CLOSE = 40, 1e-12


def onto(
    constraints: Sequence[sp.Expr], states: Sequence[Signal], values: Mapping[Any, Any], points: np.ndarray
) -> np.ndarray:
    """Return points (k, n) with c(x) = 0 near the given ones (N, n), k <= N: those from which the search converges.
    `values`: of the parameters."""
    if not constraints:
        return points
    x = ca.SX.sym("x", len(states))
    symbols = dict(zip(states, ca.vertsplit(x), strict=True)) | {p: float(value) for p, value in values.items()}
    c = ca.densify(ca.vertcat(*to_casadi(constraints, symbols)))
    evaluate = ca.Function("c", [x], [c, ca.densify(ca.jacobian(c, x))])
    low, high = np.array([*map(spread, states)]).T
    half = np.where(high > low, (high - low) / 2, 1.0)

    def nearest(point: np.ndarray) -> Any:
        for shift in (np.zeros(len(half)), *np.diag(half)):
            at = point + shift
            for _ in range(PASSES):
                value, slope = (np.array(part) for part in evaluate(at))
                scaled = slope * half
                size = np.abs(scaled).max()
                if not (np.isfinite(value).all() and size > CLOSE):
                    break
                if np.abs(value).max() <= CLOSE * size:
                    return at
                at = at - half * (np.linalg.pinv(scaled) @ value).ravel()
        return None

    reached = [at for at in map(nearest, points) if at is not None]
    return np.array(reached).reshape(-1, len(states))


def tangents(slopes: np.ndarray) -> np.ndarray:
    """Return orthonormal bases (N, n, n - k) of the directions along c = 0, from dc/dx (N, k, n) in scaled states."""
    *_, directions = np.linalg.svd(slopes)
    return np.swapaxes(directions[:, slopes.shape[1] :, :], 1, 2)
