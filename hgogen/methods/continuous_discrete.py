"""The default for firmware: predict between samples, correct at a sample, covariance as P = L D L'.

    z  <- one classical Runge-Kutta step of z' = f(z, u)
    P  <- Phi P Phi' + h Q_theta,  Phi = I + h F + (h F)^2/2,  F at the step's midpoint      (Thornton)
    at a valid sample of y_j, with r = R_j/(theta h), c = dh_j/dz:
       alpha = r + c P c',  K = P c'/alpha,  z <- z + K (y_j - h_j),  P <- P - K c P          (Bierman)

No square root, positive definite by construction, no limit on h from the covariance. As the default it is for every
observer: one without a covariance has nothing to correct at a sample and goes by classical Runge-Kutta, as by `rk4`.
Source: Boizot, Busvelle, Gauthier, ECC 2009 (continuous-discrete case); the factored updates are Thornton's and
Bierman's.
"""

from dataclasses import dataclass
from fractions import Fraction

from hgogen.discretisation.lengths import Lengths
from hgogen.discretisation.runge_kutta import RK4, Tableau
from hgogen.guarantees.beside_stages import BesideStages
from hgogen.guarantees.entering import Entering
from hgogen.guarantees.inclusion import Inclusion, Uncertain
from hgogen.guarantees.inequality import Inequality, stagewise
from hgogen.guarantees.plant_step import PlantStep
from hgogen.kalman.chosen import chosen
from hgogen.kalman.factored import factored_lengths
from hgogen.kalman.riccati_part import Riccati
from hgogen.method import Explicit
from hgogen.observer import Observer
from hgogen.part import Clock, Ode, Pieces
from hgogen.sentence import NONE, Reason

EQUATIONS = (
    "z <- z after classical Runge-Kutta of z' = f(z, u)",
    "P <- Phi P Phi' + h Q_theta, Phi = 1 + h F + (h F)^2/2",
    "at a sample of y_j: alpha = R_j/(theta h) + c P c', K = P c'/alpha, c = dh_j/dz",
    "z <- z + K (y_j - h_j), P <- P - K c P",
)


@dataclass(frozen=True)
class ContinuousDiscrete:
    """P = L D L' of a Riccati observer by predict and correct; any other part by classical Runge-Kutta."""

    name: str = "continuous-discrete, L D L'"
    equations: tuple[str, ...] = EQUATIONS
    prediction: Tableau = RK4

    def obstacle(self, error: Inclusion) -> Reason:
        """None, as of every tableau."""
        return NONE

    def error_step(self, h: Fraction, e: Uncertain) -> Inequality:
        """Its stages."""
        return stagewise(RK4, h, e)

    def beside(self, plant: PlantStep, error: Inclusion, theta: Fraction) -> Entering:
        """As classical Runge-Kutta."""
        return BesideStages(plant, RK4).entering

    def ode(self, part: Ode, clock: Clock) -> Pieces:
        """The step of an ordinary differential equation by classical Runge-Kutta."""
        return Explicit(RK4, "information").ode(part, clock)

    def riccati(self, part: Riccati, clock: Clock) -> Pieces:
        """Predict, then one scalar update for each output, as statements or as loops."""
        return chosen(part, clock)

    def ode_lengths(self, part: Ode, observer: Observer, dt: float) -> Lengths:
        """The step lengths that classical Runge-Kutta admits."""
        return Explicit(RK4, "information").ode_lengths(part, observer, dt)

    def riccati_lengths(self, part: Riccati, dt: float) -> Lengths:
        """The step lengths that the closed loop of the filter admits."""
        return factored_lengths(part, dt)


continuous_discrete = ContinuousDiscrete()
