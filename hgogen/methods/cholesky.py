"""Prediction between samples, correction at a sample, with the covariance P = S S', S lower triangular.

    z  <- one classical Runge-Kutta step of z' = f(z, u)
    P  <- Phi P Phi' + h Q_theta,  Phi = I + hF + (hF)^2/2       (Gram-Schmidt on [Phi S, sqrt(h) W], W W' = Q_theta)
    at a valid sample, with r = R_theta/h, c = dh_j/dz:  alpha = r + c P c',  K = P c'/alpha,  P <- P - K c P  (Carlson)

The step equals that of `continuous_discrete` but for rounding. P is positive definite by construction, and the
covariance does not limit h. The entries of S span half the decades of P, at the cost of 2n square roots, and of
n (n + 1)/2 more with forgetting (`kalman_like`). Up to 7 states. An observer without a covariance is refused. Source:
Carlson, AIAA Journal 11 (1973).
"""

from dataclasses import dataclass

from hgogen.discretisation.runge_kutta import RK4, Tableau
from hgogen.discretisation.stability import Lengths
from hgogen.estimators.riccati_part import Riccati
from hgogen.estimators.square_root import RULE, SquareRoot
from hgogen.estimators.step_lengths import factored_lengths
from hgogen.method import NoCovariance
from hgogen.observer import Observer
from hgogen.part import Clock, Ode, Pieces

EQUATIONS = (
    "z <- z after classical Runge-Kutta of z' = f(z, u)",
    "P <- Phi P Phi' + h Q_theta, Phi = 1 + h F + (h F)^2/2, P = S S'",
    "at a sample of y_j: alpha = R_theta/h + c P c', K = P c'/alpha, c = dh_j/dz",
    "z <- z + K (y_j - h_j), P <- P - K c P",
)


@dataclass(frozen=True)
class Cholesky:
    """The method that predicts between samples and corrects at each sample, for a Riccati observer, with the covariance
    as P = S S'."""

    name: str = RULE
    equations: tuple[str, ...] = EQUATIONS
    prediction: Tableau = RK4

    def ode(self, part: Ode, clock: Clock) -> Pieces:
        """Raise `NoCovariance`: the method is for an observer with a covariance only."""
        raise NoCovariance("cholesky")

    def riccati(self, part: Riccati, clock: Clock) -> Pieces:
        """Return the filter's memory and statements: predict, then one scalar update for each output."""
        return SquareRoot(part, clock).pieces()

    def ode_lengths(self, part: Ode, observer: Observer, dt: float) -> Lengths:
        """Return no step lengths: the method refuses a part without a covariance."""
        return Lengths()

    def riccati_lengths(self, part: Riccati, dt: float) -> Lengths:
        """Return the step lengths up to which errors of the filter decay, predict and correct together."""
        return factored_lengths(part, dt)


cholesky = Cholesky()
