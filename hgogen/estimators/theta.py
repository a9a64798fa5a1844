"""The high-gain parameter theta of a Riccati observer: constant, decaying, or adaptive; values for observers.riccati.

    constant(theta)              theta = 1 is the plain extended Kalman filter
    decaying(theta_0, rate)      theta(t) = 1 + (theta_0 - 1) exp(-rate t)
    adaptive(theta_1, ...)       theta' = mu(I) F_0(theta) + rate (1 - mu(I)) (1 - theta),
                                 F_0 = theta^2/rise_time if theta <= theta_1, else (theta - 2 theta_1)^2/rise_time

The adaptive law is stepped by its exact sub-flows, because explicit Euler lets theta pass 2 theta_1, where F_0 > 0, and
escape: with s = mu dt/rise_time, first the rise (in closed form on each side of theta_1), then the decay by exp(-rate
(1 - mu) dt), then a clamp to [1, 2 theta_1]. mu(I) is how much growth of theta an innovation asks for, 0 for none and
1 for all of it: a C1 smoothstep, exactly 0 below gamma_0 and 1 above gamma_1 as (6) asks, or the paper's logistic,
which is never 0 and so holds theta a little above 1. A decaying theta scales the process noise alone, as its theorem
asks, unless `scaling` says otherwise; the others scale both noises. Source: Boizot, Busvelle, Gauthier 2010, (4)-(6);
decaying: Busvelle's slides, whose theorem (1) bounds the error of a filter by

    |e(t)|^2 <= R(lambda, c) exp(-a t) Lambda(theta_0, t, lambda) |e(0)|^2
    Lambda = theta_0^(2 (n - 1) + a/lambda) exp(-(a/lambda) theta_0 (1 - exp(-lambda t)))

for 0 < lambda <= lambda_0, the rate, theta_0 large enough for it and S(0) >= c. a > 0 and R are existential constants,
so they are arguments here. The slides print 0 <= lambda, but at lambda = 0 there is no a/lambda.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from hgogen.analysis.dynamics import Dynamics, inside
from hgogen.analysis.scaling import SCALED, Scaled
from hgogen.estimators.innovation import Innovation
from hgogen.estimators.kalman_theorems import ADAPTIVE, DECAYING, HIGH_GAIN, KALMAN, LOGISTIC, SCALED_AS, SMOOTHSTEP
from hgogen.graph import Graph
from hgogen.observer import gain
from hgogen.part import Clock, Jump, Part, Pieces
from hgogen.program import Block, Field, Place, When, scalar, sym
from hgogen.reading.given import BadGain, positive, real
from hgogen.sentence import same
from hgogen.theorem import Hypothesis, Theorem


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


class Theta(ABC):
    """A high-gain parameter, which is constant and moved by no part where its law says nothing else."""

    scaled: Scaled  # which noise it scales
    traces: tuple[str, ...] = ()  # scalar fields of the state worth recording

    @property
    def value(self) -> Graph:
        """The gain theta as an SX scalar, of a law that moves it the place `state.theta`."""
        return sym("state", "theta")

    @property
    @abstractmethod
    def peak(self) -> float:
        """The largest value it takes."""

    @property
    def late(self) -> float:
        """The value of theta while a large error lasts."""
        return self.peak

    @property
    def rest(self) -> float | None:
        """The value at which it rests, if it comes back to its peak from there."""
        return None

    def rise(self, theta: np.ndarray, dt: np.ndarray) -> np.ndarray:
        """Each theta (d) a time dt (d) later when it rises as fast as its law lets it."""
        return theta

    @property
    @abstractmethod
    def gains(self) -> tuple[Field, ...]:
        """The tunable gains of theta."""

    @abstractmethod
    def law(self, unit: str) -> str:
        """The law of theta for the banner; `unit`: the unit of time."""

    @property
    @abstractmethod
    def theorem(self) -> Theorem:
        """What is known of the Riccati observer with it."""

    def parts(self, dynamics: Dynamics, z: Field) -> tuple[Part, ...]:
        """The parts that move it, for the observer state of field `z`."""
        return ()


@dataclass(frozen=True)
class Constant(Theta):
    """See the module."""

    theta: float
    scaled: Scaled = "both"

    @property
    def peak(self) -> float:
        """The largest value, which is theta."""
        return self.theta

    @property
    def value(self) -> Graph:
        """The constant 1, or the gain."""
        return ca.SX(1) if self.theta == 1 else sym("gain", "theta")

    @property
    def gains(self) -> tuple[Field, ...]:
        """The gain theta, unless it is 1; step lengths are judged at its nominal value alone, which is its largest."""
        if self.theta == 1:
            return ()
        return (gain("theta", self.theta, 1.0, self.theta, "high-gain parameter"),)

    def law(self, unit: str) -> str:
        """The law for the banner."""
        return "theta = 1, an extended Kalman filter" if self.theta == 1 else "theta constant"

    @property
    def theorem(self) -> Theorem:
        """The theorem of the extended Kalman filter, or of the one with a high gain."""
        return KALMAN if self.theta == 1 else HIGH_GAIN


@dataclass(frozen=True)
class Decaying(Theta):
    """See the module."""

    theta_0: float
    rate: float
    scaled: Scaled = "process"
    traces: tuple[str, ...] = ("theta",)

    def law(self, unit: str) -> str:
        """The law for the banner."""
        return "theta(t) = 1 + (theta_0 - 1) exp(-rate t)"

    @property
    def theorem(self) -> Theorem:
        """The slides' theorem, with what it asks of the scaling."""
        return DECAYING.under(SCALED_AS[self.scaled])

    @property
    def peak(self) -> float:
        """The largest value, theta_0."""
        return self.theta_0

    @property
    def late(self) -> float:
        """The value while a large error lasts, which is 1."""
        return 1.0

    @property
    def gains(self) -> tuple[Field, ...]:
        """The rate, which stays above 0; theta_0 is the initial value of the state."""
        return (gain("rate", self.rate, 1e-3 * self.rate, 1e3 * self.rate, "rate at which theta decays to 1", "1/s"),)

    def parts(self, dynamics: Dynamics, z: Field) -> tuple[Part, ...]:
        """The exact decay."""
        return (Jump(self._pieces, {"theta": -sym("gain", "rate") * (self.value - 1)}),)

    def _pieces(self, clock: Clock) -> Pieces:
        theta, decay = sym("state", "theta"), sym("derived", "decay")
        factor = ca.exp(-sym("gain", "rate") * clock.dt)
        return Pieces(
            fields=(_theta_field(self.theta_0, self.theta_0),),
            derived=(scalar("decay", 0.0, meaning="exp(-rate dt)"),),
            tune=(Block("decay of theta over one step", {Place("derived", "decay"): factor}),),
            adapt=(Block("theta decays to 1", {Place("state", "theta"): 1 + (theta - 1) * decay}),),
        )


@dataclass(frozen=True)
class Adaptive(Theta):
    """See the module."""

    theta_1: float
    rise_time: float
    rate: float
    mu: Smoothstep | Logistic
    innovation: Innovation
    scaled: Scaled = "both"
    traces: tuple[str, ...] = ("theta", "innovation")

    def law(self, unit: str) -> str:
        """The law for the banner."""
        return (
            "theta' = mu(I_d) F_0(theta) + rate (1 - mu(I_d)) (1 - theta), by exact sub-flows; F_0 = theta^2/rise_time "
            "up to theta_1, then (theta - 2 theta_1)^2/rise_time; "
            + self.mu.equation
            + f"; I_d over d = {same(self.innovation.d)} {unit}"
        )

    @property
    def theorem(self) -> Theorem:
        """Theorem 5, with what it asks of mu and of the innovation."""
        return ADAPTIVE.under(self.mu.hypothesis, self.innovation.hypothesis)

    @property
    def peak(self) -> float:
        """The largest value, 2 theta_1."""
        return 2 * self.theta_1

    @property
    def rest(self) -> float:
        """The value at rest, 1."""
        return 1.0

    def rise(self, theta: np.ndarray, dt: np.ndarray) -> np.ndarray:
        """Each value after a time dt by the exact sub-flow at mu = 1."""
        return np.array(_risen()(theta[None], dt[None] / self.rise_time, self.theta_1)).ravel()

    @property
    def gains(self) -> tuple[Field, ...]:
        """theta_1, rise_time, rate and mu's; by the default method, step lengths are judged where theta rests, at
        twice the nominal theta_1, its largest, and at their geometric mean; by an explicit one at both ends and on the
        way of its fastest rise."""
        return (
            gain("theta_1", self.theta_1, 1.0, self.theta_1, "half the largest theta"),
            gain("rise_time", self.rise_time, 1e-3 * self.rise_time, 1e3 * self.rise_time, "Delta T", "s"),
            gain("rate", self.rate, 0.0, 1e3 * self.rate, "lambda, rate at which theta decays to 1", "1/s"),
            *self.mu.gains,
        )

    def parts(self, dynamics: Dynamics, z: Field) -> tuple[Part, ...]:
        """The innovation, then the law."""
        theta, theta_1, mu = self.value, sym("gain", "theta_1"), self.mu.of(sym("state", "innovation"))
        growth = ca.if_else(theta <= theta_1, theta, theta - 2 * theta_1) ** 2 / sym("gain", "rise_time")
        law = mu * growth + sym("gain", "rate") * (1 - mu) * (1 - theta)
        return (self.innovation.part(dynamics, z), Jump(self._pieces, {"theta": law}))

    def _pieces(self, clock: Clock) -> Pieces:
        theta, mu = sym("state", "theta"), sym("work", "mu")
        rests = ca.logic_and(mu <= 0, inside(theta, [(1.0, 1.0)]))  # where the law leaves theta at 1, bit for bit
        growth = {Place("work", "mu"): self.mu.of(sym("state", "innovation"))}
        risen = rise(theta, mu * clock.dt / sym("gain", "rise_time"), sym("gain", "theta_1"))
        decay = ca.exp(-sym("gain", "rate") * clock.dt * (1 - mu))
        fallen = 1 + (risen - 1) * decay
        top = 2 * sym("gain", "theta_1")
        block = Block(
            "theta by the exact sub-flows of its law: rise, then decay",
            {Place("state", "theta"): ca.fmin(ca.fmax(fallen, 1), top)},
            {"risen": risen, "decay": decay},
        )
        moves = Place("work", "moves")
        adapt = (
            Block("how much growth the innovation asks for, 0 to 1", growth),
            Block("is theta at rest?", {moves: ca.logic_not(rests)}),
            When(moves, (block,)),
        )
        return Pieces(fields=(_theta_field(1.0, self.peak),), adapt=adapt)


def rise(theta: Graph, s: Graph, theta_1: Graph) -> Graph:
    """theta after the time s under theta' = theta^2 up to theta_1, then theta' = (2 theta_1 - theta)^2; exact.

    `room` is the time to theta_1, 0 above it.
    """
    room = ca.fmax(1 / theta - 1 / theta_1, 0)
    below = 1 / ca.fmax(1 / theta - s, 1 / theta_1)
    gap = 2 * theta_1 - ca.fmax(theta, theta_1)
    above = 2 * theta_1 - gap / (1 + gap * (s - room))
    return ca.if_else(ca.logic_and(s <= room, theta <= theta_1), below, above)


@cache
def _risen() -> Any:
    """`rise` of numbers."""
    arguments = [ca.SX.sym(name) for name in ("theta", "s", "theta_1")]
    return ca.Function("rise", arguments, [rise(*arguments)])


def _theta_field(initial: float, peak: float) -> Field:
    return scalar("theta", initial, low=1.0, high=peak, meaning="high-gain parameter, 1: Kalman mode")


def constant(theta: float = 1.0, *, scaled: Scaled = "both") -> Constant:
    """A constant theta >= 1; `scaled`: as in `decaying`, of no effect on the gain. Raises: `BadGain`."""
    _at_least("theta", theta, 1.0)
    _known(scaled)
    return Constant(float(theta), scaled)


def decaying(theta_0: float, rate: float, *, scaled: Scaled = "process") -> Decaying:
    """theta decays from theta_0 >= 1 to 1 at `rate` > 0 (1/s).

    `scaled`: what theta scales, "process" noise alone, Q_theta = theta^2 Delta^-1 Q Delta^-1, as the slides' theorem
    asks, or "both", Q_theta = theta Delta^-1 Q Delta^-1 and R_theta = R/theta, as with any other theta. `error_bound`
    is the theorem's, for constants of which it says only that they exist.

    Raises: `BadGain`.
    """
    _at_least("theta_0", theta_0, 1.0)
    positive("rate", rate)
    _known(scaled)
    return Decaying(float(theta_0), float(rate), scaled)


def adaptive(
    theta_1: float,
    *,
    mu: Smoothstep | Logistic | tuple[float, float],
    innovation: Innovation,
    rise_time: float = 0.1,
    rate: float = 1.0,
) -> Adaptive:
    """theta between 1 and 2 theta_1 by the innovation.

    Args: `mu` a `smoothstep` or `logistic`, or the thresholds (gamma_0, gamma_1) of a smoothstep (y^2 s);
    `innovation` a value of `hgogen.innovation`; `rise_time` the paper's Delta T (s); `rate` its lambda (1/s).

    Raises: `BadGain`.
    """
    if isinstance(mu, tuple) and len(mu) == 2:
        mu = smoothstep(*mu)
    if not isinstance(mu, Smoothstep | Logistic):
        raise BadGain(f"mu = {mu!r}", "must be thresholds (gamma_0, gamma_1), theta.smoothstep or theta.logistic")
    if not isinstance(innovation, Innovation):
        raise BadGain(f"innovation = {innovation!r}", "must be innovation.staggered(...) or innovation.window(...)")
    _at_least("theta_1", theta_1, 1.0)
    positive("rise_time", rise_time)
    positive("rate", rate)
    return Adaptive(float(theta_1), float(rise_time), float(rate), mu, innovation)


def log_growth(theta_0: float, t: float, rate: float, *, n: int, a: float) -> float:
    """log Lambda(theta_0, t, rate) of n states; `rate` is lambda (1/s), `t` (s), `a` (1/s).

    Raises: `BadGain` for theta_0 < 1, t < 0, a number of states below 1, a rate or an a that is not above 0.
    """
    theta_0, t, rate, a = real("theta_0", theta_0), real("t", t), positive("rate", rate), positive("a", a)
    if not 1 <= theta_0 < math.inf:
        raise BadGain(f"theta_0 = {theta_0!r}", "must be a finite number, at least 1")
    if not 0 <= t < math.inf:
        raise BadGain(f"t = {t!r}", "must be a finite time from the start, not negative")
    if n not in range(1, 1 << 16):
        raise BadGain(f"n = {n!r}", "must be the number of states")
    power = 2 * (n - 1) + a / rate
    return power * math.log(theta_0) + a / rate * theta_0 * math.expm1(-rate * t)


def error_bound(theta_0: float, t: float, rate: float, *, n: int, a: float, R: float, initial: float = 1.0) -> float:
    """The bound on |e(t)| for |e(0)| = `initial`, with the constants `a` (1/s) and `R` of the theorem; infinite where
    no float holds it.

    Raises: `BadGain`, also for an R or an initial error that is not above 0.
    """
    grown = log_growth(theta_0, t, rate, n=n, a=a) - a * t + math.log(positive("R", R))
    exponent = grown / 2 + math.log(positive("initial", initial))
    return math.exp(exponent) if exponent < math.log(1.7e308) else math.inf


def _known(scaled: str) -> None:
    if scaled not in SCALED:
        raise BadGain(f"scaled = {scaled!r}", f"must be one of {', '.join(map(repr, SCALED))}: what theta scales")


def _at_least(name: str, value: float, low: float) -> None:
    if not low <= real(name, value) < float("inf"):
        raise BadGain(f"{name} = {value!r}", f"must be a finite number, at least {low:g}")
