"""Multiple shooting: a plant on measured records as one nonlinear least-squares problem.

    minimise   1/2 sum_k sum_j ((y_k,j - h_j(x_k, u_k; p) - o_j)/s_j)^2
    subject to x_(k+1) = F(x_k, u_k, u_(k+1); p)

A record is cut into segments; the state where one begins is unknown, and the next begins where it ends. So short a
motion depends on its parameters nearly linearly, where that over a whole record may turn or grow many times.

A residual e costs e^2/2, or with a corner c the pseudo-Huber loss c^2 (sqrt(1 + (e/c)^2) - 1), which grows like c |e|
beyond c.

Sources: H. G. Bock, "Numerical treatment of inverse problems in chemical reaction kinetics", Springer Series in
Chemical Physics 18 (1981); of the loss: Charbonnier, Blanc-Feraud, Aubert, Barlaud, IEEE Trans. Image Processing 6
(1997).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from hgogen.identification.problem import Information, Problem, eliminated, tables
from hgogen.identification.records import Log
from hgogen.identification.whiteness import influence

Array = np.ndarray
_STEPS = 64  # of Runge and Kutta, in one graph of scalars


@dataclass(frozen=True, eq=False)
class Shooting(Problem):
    """The problem of a plant on records; `corner` (p): of each output, in units of its scale, None for squares."""

    corner: Array | None = None

    @cached_property
    def graph(self) -> tuple[Any, Any, Any]:
        """The unknowns, what the residuals cost, and the gaps between segments."""
        v, errors, gaps = self.followed
        if self.corner is None:
            return v, ca.sumsqr(errors) / 2, gaps
        c = ca.DM(self.corner[self.output])
        return v, ca.sum1(c**2 * (ca.sqrt(1 + (errors / c) ** 2) - 1)), gaps

    @cached_property
    def followed(self) -> tuple[Any, Any, Any]:
        """The unknowns (MX), the residuals where something was measured, and the gaps between segments, as columns."""
        v = ca.MX.sym("v", self.size)
        p, o, every = self.parts(v)
        errors, gaps = [], []
        for record, nodes in zip(self.records, every, strict=True):
            of_record, gap = self._of_record(record, nodes, p, o)
            errors.append(of_record)
            gaps.append(gap)
        return v, ca.vertcat(*errors), ca.vertcat(*gaps)

    def residuals(self, unknowns: Array) -> tuple[Array, ...]:
        """Those of each output where it was measured, record after record, over their scale."""
        v, errors, _ = self.followed
        return self.by_output(ca.Function("residuals", [v], [errors])(unknowns).full().ravel())

    def information(self, unknowns: Array, unit: Array) -> Information:
        """What is left where the states fit best beside each p with the gaps closed."""
        v, errors, gaps = self.followed
        at = ca.Function("at", [v], [ca.jacobian(errors, v), ca.jacobian(gaps, v)])
        J, A = (table @ ca.diag(unit) for table in at(unknowns))
        residuals = self.residuals(unknowns)
        units = [e * scale for e, scale in zip(residuals, self.scale, strict=True)]
        corners = (None,) * len(units) if self.corner is None else self.corner
        tell = [e if c is None else influence(e, c) for e, c in zip(residuals, corners, strict=True)]
        return Information(eliminated(J.T @ J, A, self.constants), tables(self.records, units), tuple(tell))

    def _of_record(self, record: Log, nodes: Any, p: Any, o: Any) -> tuple[Any, Any]:
        """The segments side by side, the last one filled up with samples that count for nothing."""
        L, count, N = self.length, nodes.shape[1], len(record.y)
        u = record.u[np.minimum(np.arange(count * L + 1), N - 1)]
        now, then = (part.reshape(count, L, -1) for part in (u[:-1], u[1:]))
        parts = -(-L * self.steps // _STEPS)
        read, at, size = [], nodes, -(-L // parts)
        for k in range(0, L, size):
            inputs = (part[:, k : k + size].reshape(count, -1).T for part in (now, then))
            seen, at = self._stretch(min(size, L - k)).map(count)(at, p, o, *inputs, record.dt)
            read.append(seen)
        table = ca.vec(ca.vertcat(*read))  # by segment, sample of it, and output
        place, output = np.nonzero(np.isfinite(record.y))
        errors = (table[(place * record.y.shape[1] + output).tolist()] - record.y[place, output]) / self.scale[output]
        return errors, ca.vec(nodes[:, 1:] - at[:, :-1])

    def _stretch(self, samples: int) -> Any:
        """(x, p, offsets, the samples' u, and then, dt) -> their y, x after them: one graph of scalars, whose second
        derivatives CasADi takes twice as fast as along a graph of the samples."""
        x, p, o = (ca.SX.sym("v", size) for size in (self.n, len(self.free), len(self.offset)))
        now, then = (ca.SX.sym("u", len(self.plant.inputs), samples) for _ in range(2))
        at, dt, read = x, ca.SX.sym("dt"), []
        for k in range(samples):
            read.append(self.reading(at, p, o, now[:, k]))
            at = self.step(at, p, now[:, k], then[:, k], dt)
        return ca.Function("stretch", [x, p, o, ca.vec(now), ca.vec(then), dt], [ca.vertcat(*read), at])
