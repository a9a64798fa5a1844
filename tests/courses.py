"""Courses of a plant within what a bound of its estimate assumes: many at once, and what an observer is given of them.

The plant is integrated by steps of half a period, whose own error is next to nothing beside any bound.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
import sympy as sp

import hgogen as hg
from hgogen.graph import to_casadi

Array = np.ndarray
HALVES = 2  # of a period


@dataclass(frozen=True, eq=False)
class Courses:
    """Of B plants over K calls: states `x` (B, K, n), inputs `u` (B, K, m), outputs `y` (B, K, p) at the samples, and
    what `late` and `early` samples, by half a period, hold of them (B, K, p); `calls` (B): up to which the plant keeps
    to its ranges."""

    x: Array
    u: Array
    y: Array
    late: Array
    early: Array
    calls: Array


@dataclass(frozen=True, eq=False)
class Walker:
    """Walks plants of a system with a period `dt`, as first declared, `clear` (n) of the ends of their ranges."""

    system: hg.System
    dt: float
    clear: Array

    def courses(self, first: Array, u: Array, d: Array, p: Array) -> Courses:
        """From states `first` (B, n), under inputs u (B, K, m) on lines between samples, disturbances d (B, K, n) that
        are held between them, parameters p (B, r)."""
        count, calls, _ = u.shape
        x, states = first.T, np.zeros((HALVES * calls + 1, len(first.T), count))
        states[0] = x
        u, d, p = (np.moveaxis(each, 0, -1) for each in (u, d, p))  # (.., B)
        move, h = self._move(count), self.dt / HALVES
        with np.errstate(all="ignore"):
            for k in range(calls):
                ahead = u[min(k + 1, calls - 1)] if calls else u
                for half in range(HALVES):
                    ends = [u[k] + (ahead - u[k]) * (half + side) / HALVES for side in (0, 1)]
                    x = np.asarray(move(x, *ends, d[k], p, h))
                    states[HALVES * k + half + 1] = x
        return self._measured(np.moveaxis(states, -1, 0), np.moveaxis(u, -1, 0))

    def _measured(self, states: Array, u: Array) -> Courses:
        """Of states at half periods (B, 2 K + 1, n)."""
        low, high = np.array([state.interval for state in self.system.states], dtype=float).T
        out = ~((states >= low + self.clear) & (states <= high - self.clear)).all(axis=2)
        calls = np.where(out.any(axis=1), (out.argmax(axis=1) - HALVES) // HALVES, u.shape[1])
        at = HALVES * np.arange(u.shape[1])
        with np.errstate(all="ignore"):
            rows = sp.lambdify(self.system.states, list(self.system.output), "numpy")(*np.moveaxis(states, -1, 0))
        y = np.nan_to_num(np.stack(rows, axis=-1), nan=0.0, posinf=0.0, neginf=0.0)
        y, late, early = (y[:, np.maximum(at + k, 0)] for k in (0, -1, 1))
        return Courses(states[:, at], u, y, late, early, np.maximum(calls, 0))

    @cached_property
    def _symbols(self) -> tuple[ca.SX, ca.SX, ca.SX, Mapping[sp.Symbol, ca.SX]]:
        groups = self.system.states, self.system.inputs, self.system.parameters
        x, u, p = (ca.SX.sym(name, len(group)) for name, group in zip("xup", groups, strict=True))
        pairs = ((s, each[i]) for group, each in zip(groups, (x, u, p), strict=True) for i, s in enumerate(group))
        return x, u, p, dict(pairs)

    def slopes(self, states: Array, u: Array, p: Array) -> Array:
        """Those of the flow that are not the same everywhere (B, k), at states (B, n), under inputs u (m)."""
        x, inputs, parameters, symbols = self._symbols
        flow = ca.vertcat(*to_casadi(self.system.flow, symbols))
        J = ca.Function("J", [x, inputs, parameters], [ca.densify(ca.vec(ca.jacobian(flow, x)))])
        values = np.asarray(J.map(len(states))(states.T, ca.repmat(u, 1, len(states)), ca.repmat(p, 1, len(states)))).T
        return values[:, np.ptp(values, axis=0) > 0]

    def _move(self, count: int) -> ca.Function:
        """(x, u at both ends, d, p, h) to x after h, of so many plants."""
        x, u, p, symbols = self._symbols
        flow = ca.Function("flow", [x, u, p], [ca.vertcat(*to_casadi(self.system.flow, symbols))])
        end, d, h = ca.SX.sym("end", u.shape[0]), ca.SX.sym("d", x.shape[0]), ca.SX.sym("h")
        k1 = flow(x, u, p) + d
        k2 = flow(x + h / 2 * k1, (u + end) / 2, p) + d
        k3 = flow(x + h / 2 * k2, (u + end) / 2, p) + d
        after = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + flow(x + h * k3, end, p) + d)
        return ca.Function("move", [x, u, end, d, p, h], [after]).map(count)
