"""The second derivatives of the outputs in the Riccati equation of a minimum-energy estimator.

    Pi' = -Pi F - F'Pi - Pi Q^-1 Pi + C'R C - s D,    D = sum_j R_j (y_j - h_j) d2h_j/dz2
    P'  = F P + P F' + Q^-1 - P C'R C P + s P D P,    P = Pi^-1
    s = rate/max(rate, nu),    nu = |Pi^(-1/2) D Pi^(-1/2)|_F = sqrt(tr (P D)^2)

With s = 1 a large error takes more from Pi than there is, and Pi loses positive definiteness. As it stands, s D lies
between -rate Pi and rate Pi: P' <= F P + P F' + Q^-1 + rate P and Pi' <= -Pi F - F'Pi + C'R C + rate Pi, so both stay
finite and positive definite. Up to nu = rate the term is whole. A step of finite length need not follow: what is no
longer positive definite after it restarts at its first value, and the status says so.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import casadi as ca

from hgogen.discretisation.runge_kutta import RK4
from hgogen.discretisation.stability import Lengths
from hgogen.estimators.covariance import covariance_ode, information_ode, pack, pivots, solve, unpack
from hgogen.estimators.riccati_part import Around
from hgogen.graph import Graph
from hgogen.method import Explicit
from hgogen.part import Clock, Ode, Pieces
from hgogen.program import Bit, Block, Field, Place, Program, When, sym

RESTARTED = Bit(
    "COVARIANCE_RESTARTED",
    "a step left the covariance without positive variances: it restarted at its first value",
    "none if rare; if it comes again, shorten dt, lower curvature or raise Q",
)
VIEWS = {"information": ("S", information_ode), "covariance": ("P", covariance_ode)}


@dataclass(frozen=True, eq=False)
class Curved(Around):
    """A Riccati observer at theta = 1 with the term; `rate` (1/s): SX scalar, at most `fastest`."""

    rate: Graph
    fastest: float

    def equation(self, view: str) -> Ode:
        """The differential equation of z and Pi (its name is S), or of z and P."""
        name, ode = VIEWS[view]
        plain, n = ode(self.plain), self.plain.dynamics.n

        def rate(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
            slopes, X = plain.rhs(values, u, y, valid), unpack(values[name], n)
            z, dynamics = values[self.plain.z.name], self.plain.dynamics
            pull = valid * (y - dynamics.output(z, u)) / self.plain.R
            curvatures = dynamics.output_curvature(z, u)
            D = sum((pull[j] * curvature for j, curvature in enumerate(curvatures)), ca.SX(n, n))
            PD = X @ D if name == "P" else ca.horzcat(*(solve(X, D[:, j]) for j in range(n)))
            size = ca.sum1(ca.sum2(PD * PD.T))  # nu^2, which rounding can make negative
            share = self.rate / ca.sqrt(ca.fmax(self.rate**2, size))
            term = PD @ X if name == "P" else -D
            return {**slopes, name: slopes[name] + pack(share * term)}

        return Ode(plain.fields, rate)


def curved(part: Curved, method: Any, clock: Clock) -> Pieces:
    """The pieces of a step: by an explicit method in its own view, else by classical Runge-Kutta on (z, P)."""
    explicit = _explicit(method)
    plain = explicit.riccati(part.plain, clock)
    moves = explicit.step(part.equation(explicit.view), clock)
    covariance = next(field for field in plain.fields if field.name == VIEWS[explicit.view][0])
    return replace(
        plain,
        bits=(*plain.bits, RESTARTED),
        predict=(*moves.predict, *_kept_definite(covariance, part.plain.dynamics.n)),
    )


def curved_lengths(part: Curved, method: Any, dt: float) -> tuple[Lengths, Lengths]:
    """The step lengths of the observer without the term, and those of the term, which no other method is free of."""
    plain = replace(_explicit(method).riccati_lengths(part.plain, dt), other="")
    why = "beyond it the second derivatives of the output can take all of Pi in one step"
    return plain, Lengths(refused=1 / part.fastest, why=why, rule=plain.rule)


def _explicit(method: Any) -> Explicit:
    return method if isinstance(method, Explicit) else Explicit(RK4, "covariance")


def _kept_definite(covariance: Field, n: int) -> Program:
    """The packed symmetric matrix (n, n) as it was first where a pivot of L D L' is not positive."""
    place = Place("state", covariance.name)
    definite = reduce(ca.logic_and, (pivot > 0 for pivot in pivots(unpack(sym(*place, covariance.size), n))[1]))
    first = {place: ca.SX(ca.DM(covariance.initial)), Place("status", "COVARIANCE_RESTARTED"): ca.SX(1)}
    return (
        Block("is it positive definite?", {Place("work", "broken"): ca.logic_not(definite)}),
        When(Place("work", "broken"), (Block("a covariance that is none restarts", first),)),
    )
