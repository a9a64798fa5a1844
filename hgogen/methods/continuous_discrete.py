"""The default for firmware: prediction between samples, correction at a sample, with the covariance P = L D L'.

    z  <- one classical Runge-Kutta step of z' = f(z, u)
    P  <- Phi P Phi' + h Q_theta,  Phi = I + h F + (h F)^2/2,  F at the step's midpoint      (Thornton)
    at a valid sample of y_j, with r = R_j/(theta h), c = dh_j/dz:
       alpha = r + c P c',  K = P c'/alpha,  z <- z + K (y_j - h_j),  P <- P - K c P          (Bierman)

It needs no square root, P is positive definite by construction, and the covariance does not limit h. It accepts every
observer: one without a covariance is integrated by classical Runge-Kutta, as by `rk4`. Source: Boizot, Busvelle,
Gauthier, ECC 2009 (continuous-discrete case); the factored updates are Thornton's and Bierman's.
"""

from dataclasses import dataclass

from hgogen.discretisation.stability import Lengths
from hgogen.estimators.factored import filter_pieces
from hgogen.estimators.riccati_part import Riccati
from hgogen.estimators.step_lengths import factored_lengths
from hgogen.method import Staged
from hgogen.part import Clock, Pieces

EQUATIONS = (
    "z <- z after classical Runge-Kutta of z' = f(z, u)",
    "P <- Phi P Phi' + h Q_theta, Phi = 1 + h F + (h F)^2/2",
    "at a sample of y_j: alpha = R_j/(theta h) + c P c', K = P c'/alpha, c = dh_j/dz",
    "z <- z + K (y_j - h_j), P <- P - K c P",
)


@dataclass(frozen=True)
class ContinuousDiscrete(Staged):
    """The method that predicts between samples and corrects at each sample, with the covariance as P = L D L'; an
    observer without a covariance is integrated by classical Runge-Kutta."""

    name: str = "continuous-discrete, L D L'"
    equations: tuple[str, ...] = EQUATIONS

    def riccati(self, part: Riccati, clock: Clock) -> Pieces:
        """Return the filter's memory and statements: predict, and a scalar update for each output."""
        return filter_pieces(part, clock)

    def riccati_lengths(self, part: Riccati, dt: float) -> Lengths:
        """Return the step lengths up to which errors of the filter decay, predict and correct together."""
        return factored_lengths(part, dt)


continuous_discrete = ContinuousDiscrete()
