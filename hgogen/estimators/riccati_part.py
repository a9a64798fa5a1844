"""The structure of a Riccati observer as a part of an observer.

    z' = f(z, u) + P C' R_theta^-1 (y - h),   P' = F P + P F' + Q_theta - P C' R_theta^-1 C P

The views S = P^-1, P and its factors are the methods' choice. Source: Boizot, Busvelle, Gauthier, Automatica 46 (2010),
(4); with forgetting and measured coefficients, Hammouri, de Leon Morales, CDC 1990; with S_0 and Q_0, Salgado, Goodwin,
Middleton, International Journal of Control 47 (1988).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.linearised import jacobians_on_box
from hgogen.analysis.scaling import Scaling, scaling
from hgogen.estimators.theta import Theta
from hgogen.graph import Graph
from hgogen.part import Clock, Part, Pieces
from hgogen.program import Bit, Field, sym


@dataclass(frozen=True, eq=False)
class Riccati(Part):
    """The structure of a Riccati observer; S, P and L D L' are views of it, and the method chooses.

    z' = f(z, u, y) + P C' R_theta^-1 (y - h),   P' = F P + P F' + Q_theta + rho (P - P S_0 P) - P C' R_theta^-1 C P,
    Q_theta = theta^(1+g) Delta^-1 G diag(weights) G' Delta^-1, R_theta = theta^(g-1) delta R delta by `scaling`, where
    `weights` (k) and `R` (p) are SX, `factor` G (n, k), unit lower triangular where k = n; k = 0 is no noise.
    `z`: the field of the state (its box is the outer one); `covariance`: P(0); `cap`: the largest P_ii, and where the
    past is forgotten the diagonal of S_0^-1; `limited`: the bit that tells of it; `nominal`: (Q, R) as numbers.
    `forgetting`: the gain rho. `known`: of (z, u, y, valid), z with what is measured in the place of its estimate,
    where A(u, z) and b(z, u) are taken and F = A; without it F is the Jacobian. `period`: that of the inputs, where it
    is declared.
    """

    dynamics: Dynamics
    z: Field
    theta: Theta
    weights: Graph
    factor: np.ndarray
    R: Graph
    covariance: np.ndarray
    cap: np.ndarray
    limited: Bit
    nominal: tuple[np.ndarray, np.ndarray]
    forgetting: Field | None = None
    known: Callable[[Graph, Graph, Graph, Graph], Graph] | None = None
    period: float | None = None

    @cached_property
    def scaling(self) -> Scaling:
        """The scaling by which theta enters Q_theta and R_theta."""
        return scaling(self.dynamics.form, self.theta.scaled)

    def flow(self, z: Graph, u: Graph, y: Graph, valid: Graph) -> Graph:
        """The prediction's rate f (n)."""
        if self.known is None:
            return self.dynamics.flow(z, u)
        A, b = self.dynamics.affine(self.known(z, u, y, valid), u)
        return A @ z + b

    def jacobian(self, z: Graph, u: Graph, y: Graph, valid: Graph) -> Graph:
        """The matrix F (n, n) of the Riccati equation, SX."""
        if self.known is None:
            return self.dynamics.jacobian(z, u)
        return self.dynamics.affine(self.known(z, u, y, valid), u)[0]

    def slopes(self, samples: int, edge: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """F (k, n, n) and dh/dz (k, p, n) at points of the box, its corners by `edge` of each range inside."""
        return jacobians_on_box(self.dynamics, samples, affine=self.known is not None, edge=edge)

    def linearised(self, samples: int) -> tuple[np.ndarray, np.ndarray]:
        """F + rho/2 (k, n, n) and dh/dz (k, p, n) at points of the box: of P, rho is a growth of the model."""
        F, C = self.slopes(samples)
        return (F if self.forgetting is None else F + self.forgetting.initial[0] / 2 * np.eye(len(self.covariance))), C

    @property
    def rho(self) -> Graph:
        """The rate at which the past is forgotten, SX scalar; 0 for none."""
        return sym("gain", self.forgetting.name) if self.forgetting else ca.SX(0)

    def noise(self) -> Graph:
        """The process noise Q_theta (n, n), SX."""
        factor = self.scaled_factor()
        return factor @ ca.diag(self.scaling.process(self.theta.value) * self.weights) @ factor.T

    def scaled_factor(self) -> Graph:
        """The factor Delta^-1 G (n, k) of the process noise, SX."""
        return ca.diag(self.spread()) @ ca.sparsify(ca.SX(ca.DM(self.factor)))

    def spread(self) -> Graph:
        """The diagonal of Delta^-1 as an SX column."""
        return ca.vertcat(*self.scaling.spread(self.theta.value))


@dataclass(frozen=True, eq=False)
class Around(Part):
    """A Riccati observer, `plain`, whose step is carried out by another rule than the method's for it."""

    plain: Riccati


@dataclass(frozen=True, eq=False)
class AtSamples(Around):
    """A filter, in words `name`, that predicts and corrects as `build` says, the same by each method that does so."""

    name: str
    build: Callable[[Clock], Pieces]
