"""The iterated correction of an extended Kalman filter, on P = S S': a sample's cost is minimised, not linearised once.

    minimise  J(w) = |w|^2 + (y_j - h_j(z + S w))^2/r,   r = R_j/h,   from w = 0
    by        w <- w + s (f rho/(r + |f|^2) - w),  f = S'c',  c = dh_j/dz at z + S w,  rho = y_j - h_j(z + S w) + f w

|w|^2 is the squared distance from the prediction in P^-1. With s = 1 it is the Gauss-Newton method, whose first pass is
the extended Kalman filter's correction; s is halved where J does not fall, so that no pass makes the estimate worse by
this cost. Then z <- z + S w, and P is corrected by the row at that estimate. An output that is linear in the state is
minimised in one pass. Source: Bell, Cathey, "The iterated Kalman filter update as a Gauss-Newton method", IEEE TAC 38
(1993); the halved steps, Skoglund, Hendeby, Axehill, "Extended Kalman filter modifications based on an optimization
view point", FUSION 2015.
"""

from dataclasses import dataclass, replace

import casadi as ca

from hgogen.estimators.factored import Moved
from hgogen.estimators.riccati_part import Riccati
from hgogen.estimators.square_root import RULE, carlson, square_root, symbols, written
from hgogen.estimators.unscented import linear
from hgogen.graph import Graph
from hgogen.part import Clock, Pieces
from hgogen.program import Block, Place, Program, sym


@dataclass(frozen=True, eq=False)
class Iterated:
    """A Kalman filter that corrects by `passes` passes, 1 or more, at each sample."""

    plain: Riccati
    passes: int


def iterated(part: Iterated, clock: Clock) -> Pieces:
    """The pieces of `square_root`, but for the corrections by outputs that are not linear in the state.

    Raises: `BadGain` for more states than it takes.
    """
    plain = square_root(part.plain, clock)
    corrections = (
        program if linear(part.plain, clock, j) else _update(part, clock, j) for j, program in enumerate(plain.update)
    )
    return replace(plain, update=tuple(corrections), rule=RULE)


@dataclass(frozen=True)
class _Sample:
    """The cost of a sample of an output and what a pass takes of it, at the offset w (n) in units of S."""

    part: Iterated
    clock: Clock
    output: int

    @property
    def S(self) -> Graph:
        """The factor (n, n) of P."""
        return symbols(self.part.plain)

    @property
    def moved(self) -> Moved:
        """The estimate before the sample."""
        return Moved(self.part.plain, self.clock)

    def row(self, w: Graph) -> Graph:
        """f = S'c' (n) at z + S w."""
        slope = self.part.plain.dynamics.output_jacobian(self.moved.z + self.S @ w, self.clock.u_now)
        return self.S.T @ slope[self.output, :].T

    def error(self, w: Graph) -> Graph:
        """y - h(z + S w), of which y - h(z) is the innovation."""
        dynamics, u = self.part.plain.dynamics, self.clock.u_now
        return (
            sym("work", "e")
            + dynamics.output(self.moved.z, u)[self.output]
            - dynamics.output(self.moved.z + self.S @ w, u)[self.output]
        )

    def cost(self, w: Graph) -> Graph:
        """J(w)."""
        return ca.sumsqr(w) + self.error(w) ** 2 / self.moved.variance(self.output)


def _update(part: Iterated, clock: Clock, output: int) -> Program:
    """The passes, each a block of its own, then z and S."""
    sample, n = _Sample(part, clock, output), part.plain.dynamics.n
    w, share, before = sym("work", "offset", n), sym("work", "share"), sym("work", "cost")
    begin = {Place("work", "offset"): ca.SX.zeros(n), Place("work", "share"): ca.SX(1)}
    f, r = sample.row(w), sample.moved.variance(output)
    target = f * (sample.error(w) + ca.dot(f, w)) / (r + ca.sumsqr(f))
    tried = w + share * (target - w)
    cost = sample.cost(tried)
    better = cost < before
    again = {
        Place("work", "offset"): ca.if_else(better, tried, w),
        Place("work", "cost"): ca.if_else(better, cost, before),
        Place("work", "share"): ca.if_else(better, 1, share / 2),
    }
    S, _ = carlson(sample.S, f, r)
    return (
        Block("begin at the prediction", {**begin, Place("work", "cost"): sample.cost(ca.SX.zeros(n))}),
        *(Block(f"pass {k + 1}", again) for k in range(part.passes)),
        Block(
            "correct by the offset, and P at the estimate",
            {Place("state", part.plain.z.name): sample.moved.z + sample.S @ w, **written(S)},
        ),
    )
