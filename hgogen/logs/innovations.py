"""The innovations of an extended Kalman filter along a record, as a graph with exact derivatives.

    e_j = y_j - h_j(x-),   s_j = H_j P- H_j' + r_j,   x = x- + K e,   P = P- - K s K'      outputs one after the other
    x- = F(x, u),   P- = Phi P Phi' + q(Phi),   Phi = dF/dx                                a sample on

A missing sample is left out. An innovation costs (e^2/s + log s)/2, so that the sum is -log of the likelihood of the
record; with a corner c it is pulled to psi(e/sqrt(s)) sqrt(s), psi(r) = r/sqrt(1 + (r/c)^2), before it corrects, and
costs the integral of psi in the place of r^2/2: a sample that is far off then moves the estimate little.

Sources: F. C. Schweppe, IEEE Transactions on Information Theory 11 (1965); C. J. Masreliez, R. D. Martin, IEEE
Transactions on Automatic Control 22 (1977).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.analysis.dynamics import clamp
from hgogen.logs.records import Log
from hgogen.program import column

Array = np.ndarray
SURE = 1e-10  # of the unit of process noise: that of a coordinate that has none
AT_ONCE = 50  # samples that derivatives go back over without a second way there


def moved_by_noise(names: Sequence[str], states: Sequence[sp.Symbol], flow: Iterable[sp.Expr]) -> tuple[str, ...]:
    """The names of the states with noise of their own, all where there would be none: a state whose rate is by
    definition another one (x_i' = +-x_j) has none, since noise there would say that the definition is wrong."""
    by_definition = {*states, *(-x for x in states)}
    noisy = [name for name, row in zip(names, flow, strict=True) if row.expand() not in by_definition]
    return tuple(noisy or names)


@dataclass(frozen=True, eq=False)
class Innovations:
    """The filter, by CasADi functions of theta (q), what it depends on: `move` (x, u now, u then, theta) -> x a sample
    on, `read` (x, u, theta) -> y, `process` (theta, Phi) -> q (n, n), `sensor` theta -> r (p); `ends` (2, n), maybe
    infinite: within them a correction stays; `corner`: c, infinite for squares."""

    move: Any
    read: Any
    process: Any
    sensor: Any
    ends: Array
    corner: float = math.inf

    @property
    def n(self) -> int:
        """The number of states."""
        return int(self.move.size1_in(0))

    def along(self, record: Log, memory: Any, theta: Any, first: bool = True) -> tuple[Any, Any, Any]:
        """What the samples of a record cost (1, N), their e and s (p, N); `memory`: x- and P- at the first sample,
        which corrects unless it is not `first`."""
        N = len(record.y)
        there = np.isfinite(record.y)
        y, valid = np.where(there, record.y, 0.0), there.astype(float)
        valid[0] *= first
        columns = (record.u.T, record.u[np.minimum(np.arange(1, N + 1), N - 1)].T, y.T, valid.T)
        over = self._step.mapaccum("over", N, {"base": AT_ONCE})
        _, cost, e, s = over(memory, *columns, ca.repmat(theta, 1, N))
        return cost, e, s

    @cached_property
    def _step(self) -> Any:
        """(x- and P-, u now, u then, y, valid, theta) -> (x- and P- a sample on, cost, e, s)."""
        n, memory, theta = self.n, ca.SX.sym("memory", self.n * (self.n + 1)), ca.SX.sym("theta", *self.move.size_in(3))
        now, then = (ca.SX.sym(name, *self.move.size_in(1)) for name in ("now", "then"))
        y, valid = (ca.SX.sym(name, *self.read.size_out(0)) for name in ("y", "valid"))
        entries = (memory, now, then, y, valid, theta)
        x, P, *rest = self._corrected(memory[:n], ca.reshape(memory[n:], n, n), now, y, valid, theta)
        at = ca.SX.sym("x", n)
        moved = self.move(at, now, then, theta)
        linear = ca.Function("linear", [at, now, then, theta], [moved, ca.jacobian(moved, at)])
        moved, Phi = linear(x, now, then, theta)
        P = Phi @ P @ Phi.T + self.process(theta, Phi)
        return ca.Function("filter", list(entries), [ca.vertcat(moved, ca.vec(P)), *rest])

    def _corrected(self, before: Any, P: Any, u: Any, y: Any, valid: Any, theta: Any) -> tuple[Any, ...]:
        """x, P, and cost, e and s."""
        predicted, r, x, cost = self.read(before, u, theta), self.sensor(theta), before, ca.SX(0)
        H, errors, variances = ca.jacobian(predicted, before), [], []
        for j in range(predicted.numel()):
            row = H[j, :]
            s = row @ P @ row.T + r[j]
            e = y[j] - predicted[j] - row @ (x - before)
            gain = valid[j] * P @ row.T / s
            pulled, loss, c = e, e * e / s / 2, self.corner
            if c < math.inf:
                pulled = e / ca.sqrt(1 + e * e / (s * c**2))
                loss = c**2 * (ca.sqrt(1 + e * e / (s * c**2)) - 1)
            x, P = x + gain * pulled, P - gain @ (row @ P)
            cost += valid[j] * (loss + ca.log(s) / 2)
            errors.append(e)
            variances.append(s)
        x = column(clamp(x[i], *ends) for i, ends in enumerate(self.ends.T))
        return x, (P + P.T) / 2, cost, ca.vertcat(*errors), ca.vertcat(*variances)
