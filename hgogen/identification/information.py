"""What a record tells of parameters: the Fisher information beside the states of the segments.

With J and A the Jacobians of the residuals and of the gaps in (parameters and offsets p, states s),

    M = J_p'J_p - [J_p'J_s  A_p'] [[J_s'J_s, A_s'], [A_s, 0]]^-1 [[J_s'J_p], [A_p]]

is the information on p that is left when s fits best beside each p with the gaps closed, all in units of ranges. To
J_s'J_s 1e-10 is added: a state that no output shows is known to lie somewhere in its range. M^-1 sigma^2 is the
covariance of p where residuals are white.

T. Soederstroem, P. Stoica, System Identification (1989), chapters 7 and 11.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hgogen.identification.shooting import Shooting

Array = np.ndarray
SOMEWHERE = 1e-10


@dataclass(frozen=True, eq=False)
class Information:
    """`M` (q, q) of the parameters and offsets in their units, as above with sigma = 1; `residuals` (N, p) of each
    record, in the units of the outputs, NaN where nothing was measured."""

    M: Array
    residuals: tuple[Array, ...]

    @property
    def outputs(self) -> tuple[Array, ...]:
        """The residuals of each output, record after record."""
        return tuple(column[np.isfinite(column)] for column in np.concatenate(self.residuals).T)


def residuals(problem: Shooting, unknowns: Array) -> tuple[Array, ...]:
    """Those of each output, record after record, at the unknowns (v), over the problem's scale."""
    v, every, _ = problem.graph
    values = ca.Function("residuals", [v], [every])(unknowns).full().ravel()
    return tuple(values[problem.output == j] for j in range(len(problem.plant.outputs)))


def information(problem: Shooting, unknowns: Array, unit: Array) -> Information:
    """At the unknowns (v), whose sizes are `unit` (v); the scale of the residuals is the problem's."""
    v, residuals, gaps = problem.graph
    at = ca.Function("at", [v], [residuals, ca.jacobian(residuals, v), ca.jacobian(gaps, v)])
    r, *slopes = at(unknowns)
    J, A = (table @ ca.diag(unit) for table in slopes)
    q = len(problem.free) + len(problem.offset)
    J_p, J_s, A_p, A_s = J[:, :q], J[:, q:], A[:, :q], A[:, q:]
    states = J_s.T @ J_s + SOMEWHERE * ca.DM.eye(J_s.shape[1])
    K = ca.blockcat([[states, A_s.T], [A_s, ca.DM(A.shape[0], A.shape[0])]])
    side = ca.vertcat(J_s.T @ J_p, A_p)
    M = (J_p.T @ J_p - side.T @ ca.solve(K, side, "qr")).full()
    return Information((M + M.T) / 2, tuple(_tables(problem, r.full().ravel())))


def _tables(problem: Shooting, residuals: Array) -> Iterator[Array]:
    begin = 0
    for record in problem.records:
        made, there = np.full(record.y.shape, np.nan), np.isfinite(record.y)
        made[there] = residuals[begin : begin + int(there.sum())]
        begin += int(there.sum())
        yield made * problem.scale
