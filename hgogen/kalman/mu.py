"""mu(I), how much growth of theta an innovation asks for: 0 for none, 1 for all of it.

A C1 smoothstep, exactly 0 below gamma_0 and 1 above gamma_1 as (6) asks, or the paper's logistic, which is never 0 and
so holds theta a little above 1. Source: Boizot, Busvelle, Gauthier 2010.
"""

from dataclasses import dataclass

import casadi as ca

from hgogen.graph import Graph
from hgogen.kalman.kalman_theorems import LOGISTIC, SMOOTHSTEP
from hgogen.observer import gain
from hgogen.program import Field, sym
from hgogen.reading.given import BadGain, positive
from hgogen.theorem import Hypothesis


@dataclass(frozen=True)
class Smoothstep:
    """mu = x^2 (3 - 2 x), x = (I - gamma_0)/(gamma_1 - gamma_0) clamped to [0, 1]: C1, satisfies (6) exactly."""

    gamma_0: float
    gamma_1: float
    equation: str = "mu 0 below gamma_0, 1 above gamma_1, a smoothstep between"
    hypothesis: Hypothesis = SMOOTHSTEP

    @property
    def gains(self) -> tuple[Field, ...]:
        """The two thresholds gamma_0 and gamma_1."""
        top = 1e6 * self.gamma_1
        return (
            gain("gamma_0", self.gamma_0, 0.0, top, "innovation below which theta decays", "y^2 s"),
            gain("gamma_1", self.gamma_1, 0.0, top, "innovation above which theta rises fully", "y^2 s"),
        )

    def of(self, innovation: Graph) -> Graph:
        """The SX scalar mu(I)."""
        low, high = sym("gain", "gamma_0"), sym("gain", "gamma_1")
        x = ca.fmin(ca.fmax((innovation - low) / ca.fmax(high - low, 1e-6 * self.gamma_1), 0), 1)
        return x * x * (3 - 2 * x)


@dataclass(frozen=True)
class Logistic:
    """mu = 1/(1 + exp(-slope (I - centre))): the paper's sigmoid, never exactly 0 or 1."""

    centre: float
    slope: float
    equation: str = "mu = 1/(1 + exp(-slope (I_d - centre)))"
    hypothesis: Hypothesis = LOGISTIC

    @property
    def gains(self) -> tuple[Field, ...]:
        """The centre and the slope."""
        return (
            gain("centre", self.centre, 0.0, 1e6 * self.centre, "innovation at which mu = 1/2", "y^2 s"),
            gain("slope", self.slope, 0.0, 1e6 * self.slope, "slope of the logistic", "1/(y^2 s)"),
        )

    def of(self, innovation: Graph) -> Graph:
        """The SX scalar mu(I); the exponent is clamped to +-80, where exp still is a float."""
        exponent = sym("gain", "slope") * (sym("gain", "centre") - innovation)
        return 1 / (1 + ca.exp(ca.fmin(ca.fmax(exponent, -80), 80)))


def smoothstep(gamma_0: float, gamma_1: float) -> Smoothstep:
    """mu for `adaptive`: 0 below gamma_0 > 0, 1 above gamma_1 > gamma_0 (y^2 s). Raises: `BadGain`."""
    positive("gamma_0", gamma_0)
    positive("gamma_1", gamma_1)
    if not gamma_0 < gamma_1:
        raise BadGain(f"gamma_0 = {gamma_0:g}", f"must be below gamma_1 = {gamma_1:g}")
    return Smoothstep(float(gamma_0), float(gamma_1))


def logistic(centre: float, slope: float) -> Logistic:
    """mu for `adaptive`: the paper's sigmoid, `centre` (y^2 s) and `slope` (1/(y^2 s)) positive. Raises: `BadGain`."""
    positive("centre", centre)
    positive("slope", slope)
    return Logistic(float(centre), float(slope))
