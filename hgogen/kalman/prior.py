"""Whether the samples show more than the prior S_0 does, in every view of a covariance that forgets.

    s = lambda_max(S_0 P) <= sum_i P_ii S_0ii,      s < 1/2  if and only if  S - 2 S_0 is positive definite

The status bit is set where the sum is above 1/2 (of S, where a pivot of S - 2 S_0 is not positive): where it is not
set, s is at most 1/2 but for rounding, which is far from the other half. A limit of 1 would be at the mercy of rounding
and of Q_0, for s tends to 1 where nothing is seen of a state that stays.
"""

from functools import reduce
from typing import Literal

import casadi as ca
import numpy as np

from hgogen.graph import Graph
from hgogen.kalman.covariance import pivots, unpack
from hgogen.kalman.riccati_part import Riccati
from hgogen.program import Block, Place, column, sym

SHARE = 0.5


def prior_status(part: Riccati, variance: list[Graph]) -> Block:
    """The block that sets the status where the P_ii (`variance`), as shares of those of S_0^-1, add up to more than
    `SHARE`."""
    return _limit_status(ca.dot(column(variance), ca.SX(ca.DM(1 / part.cap))) > SHARE)


def prior_status_of_view(part: Riccati, view: Literal["information", "covariance"]) -> Block:
    """The block of `prior_status` for a method whose state is the symmetric matrix S or P itself."""
    n = part.dynamics.n
    matrix = unpack(sym("state", "S" if view == "information" else "P", n * (n + 1) // 2), n)
    if view == "covariance":
        return prior_status(part, [matrix[i, i] for i in range(n)])
    _, left = pivots(matrix - ca.SX(ca.DM(np.diag(1 / (SHARE * part.cap)))))
    return _limit_status(ca.logic_not(reduce(ca.logic_and, (d > 0 for d in left))))


def _limit_status(limited: Graph) -> Block:
    """The block that writes the condition `limited` to the status."""
    return Block("is the covariance near S_0^-1?", {Place("status", "COVARIANCE_LIMITED"): limited})
