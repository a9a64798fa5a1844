"""What a record tells of parameters: the Fisher information that is left beside other unknowns.

With F the information on (parameters and offsets p, the others s), and A the Jacobian of what must be 0, of which the
columns of p and s are A_p and A_s,

    M = F_pp - [F_ps  A_p'] [[F_ss, A_s'], [A_s, 0]]^-1 [[F_sp], [A_p]]

is what is left on p when s fits best beside each p, all in units of ranges. To F_ss 1e-10 is added: a state that no
output shows is known to lie somewhere in its range. M^-1 sigma^2 is the covariance of p where residuals are white.

T. Soederstroem, P. Stoica, System Identification (1989), chapters 7 and 11.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from hgogen.identification.records import Log

Array = np.ndarray
SOMEWHERE = 1e-10


@dataclass(frozen=True, eq=False)
class Information:
    """`M` (q, q) of the parameters and offsets in their units, as above with sigma = 1; `residuals` (N, p) of each
    record, in the units of the outputs, NaN where nothing was measured; `tell`: of each output what its residuals tell,
    record after record, in the units of M."""

    M: Array
    residuals: tuple[Array, ...]
    tell: tuple[Array, ...]

    @property
    def outputs(self) -> tuple[Array, ...]:
        """The residuals of each output, record after record."""
        return tuple(column[np.isfinite(column)] for column in np.concatenate(self.residuals).T)


def eliminated(F: Any, A: Any, q: int) -> Array:
    """M (q, q), of the first q unknowns; F (v, v) and A (gaps, v) may be sparse."""
    F, A = ca.DM(F), ca.DM(A)
    A_p, A_s = A[:, :q], A[:, q:]
    rest = F[q:, q:] + SOMEWHERE * ca.DM.eye(F.shape[0] - q)
    K = ca.blockcat([[rest, A_s.T], [A_s, ca.DM(A.shape[0], A.shape[0])]])
    side = ca.vertcat(F[q:, :q], A_p)
    M = (F[:q, :q] - side.T @ ca.solve(K, side, "qr")).full()
    return np.asarray((M + M.T) / 2)


def tables(records: Sequence[Log], outputs: Sequence[Array]) -> tuple[Array, ...]:
    """Values of each output where it was measured, record after record, as tables (N, p) of the records."""
    made = [np.full(record.y.shape, np.nan) for record in records]
    for j, values in enumerate(outputs):
        begin = 0
        for record, table in zip(records, made, strict=True):
            there = np.isfinite(record.y[:, j])
            end = begin + int(there.sum())
            table[there, j] = values[begin:end]
            begin = end
    return tuple(made)
