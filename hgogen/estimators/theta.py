"""The high-gain parameter theta of a Riccati observer: constant, decaying, or adaptive; values for observers.riccati.

    constant(theta)              theta = 1 is the plain extended Kalman filter: local convergence
    decaying(theta_0, rate)      theta(t) = 1 + (theta_0 - 1) exp(-rate t)
    adaptive(theta_1, ...)       theta' = mu(I) F_0(theta) + rate (1 - mu(I)) (1 - theta),
                                 F_0 = theta^2/rise_time if theta <= theta_1, else (theta - 2 theta_1)^2/rise_time

The adaptive law is advanced by its exact sub-flows, because with explicit Euler theta could pass 2 theta_1, where
F_0 > 0, and diverge. With s = mu dt/rise_time, first comes the rise (in closed form on each side of theta_1), then the
decay by exp(-rate (1 - mu) dt), then a clamp to [1, 2 theta_1]. mu(I) in [0, 1] is the fraction of the growth law that
is active: a C1 smoothstep, exactly 0 below gamma_0 and 1 above gamma_1 as (6) requires, or the paper's logistic, which
is never 0 and keeps theta slightly above 1. A decaying theta scales the process noise alone, as its theorem requires,
unless `scaling` has another rule; the others scale both noises.

Each law has a theorem as data, whose constants d, theta_1, .. are existential: no theorem gives their values. The
slides' theorem on a decaying theta (1) bounds the error of a filter by

    |e(t)|^2 <= R(lambda, c) exp(-a t) Lambda(theta_0, t, lambda) |e(0)|^2
    Lambda = theta_0^(2 (n - 1) + a/lambda) exp(-(a/lambda) theta_0 (1 - exp(-lambda t)))

for a rate 0 < lambda <= lambda_0, a theta_0 large enough for this rate and S(0) >= c. a > 0 and R are existential
constants, so they are arguments here. The slides print 0 <= lambda, but at lambda = 0 there is no a/lambda. Sources:
Boizot, Busvelle, Gauthier, Automatica 46 (2010), with the numbers of its equations, (4)-(6); Gauthier, Kupka,
"Deterministic Observation Theory and Applications" (2001); Busvelle's slides on decaying theta.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from hgogen.analysis.dynamics import Dynamics, inside
from hgogen.analysis.scaling import SCALED, Scaled
from hgogen.check import Claims, Verdict
from hgogen.estimators import discrete
from hgogen.estimators.innovation import Innovation
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.observer import gain
from hgogen.part import Clock, Jump, Part, Pieces
from hgogen.program import Block, Field, Place, When, scalar, sym
from hgogen.reading.given import BadGain, positive, real
from hgogen.sentence import same
from hgogen.theorem import FORM, OPERATION, Hypothesis, Theorem

_DEFINITE = Hypothesis(
    "Q, S(0) are positive definite and R > 0",
    verdict=Verdict.PROVED,
    reason="else the observer is refused",
    reference="(4)",
)
_BUILT = (
    Hypothesis(
        "b is smooth and of compact support",
        verdict=Verdict.UNKNOWN,
        reason="its argument is clamped to the ranges, which bounds b and bends it at their edge",
        reference="section 2.2",
    ),
    _DEFINITE,
    Hypothesis(
        "the first estimate lies in the ranges", verdict=Verdict.PROVED, reason="else it is refused", reference="(4)"
    ),
)
_EXISTENTIAL = "the theorem's constants are existential: no number is known to be large or small enough"
_ANYWHERE = "the estimate converges exponentially from any initial state"


_OPERATION = (
    *OPERATION,
    Hypothesis(
        "the covariance does not touch its cap",
        reason="watch the status COVARIANCE_LIMITED: the cap is no part of the Riccati equation",
    ),
)


def _large(claim: str, reference: str) -> Hypothesis:
    return Hypothesis(claim, verdict=Verdict.UNKNOWN, reason=_EXISTENTIAL, reference=reference)


KALMAN = Theorem(
    "the estimate converges exponentially if the first error is small enough",
    (
        *FORM,
        *_BUILT,
        Hypothesis(
            "the first error is small enough",
            reason="how small is not known: the theorem's constants are existential: no number is known to be large or "
            "small enough",
            reference="(18)",
        ),
        *_OPERATION,
    ),
    "Boizot, Busvelle, Gauthier, Automatica 46 (2010), local inequality (17)",
)
LINEAR = Theorem(
    f"{_ANYWHERE}: the plant is linear",
    (
        Hypothesis(
            "z' = A z + b(u), y = C z + d(u), A and C constant, (C, A) observable, (A, Q) controllable",
            (Claims("riccati", "convergence"),),
            reference="section 7",
        ),
        Hypothesis(
            "Q has no negative eigenvalue, P(0) is positive definite and R > 0",
            verdict=Verdict.PROVED,
            reason="else the observer is refused",
        ),
        *_OPERATION,
    ),
    "Kalman, Bucy, New results in linear filtering and prediction theory, J. Basic Engineering 83 (1961), section 7",
)
HIGH_GAIN = Theorem(
    f"{_ANYWHERE}, for theta large enough",
    (*FORM, *_BUILT, _large("theta is large enough", "(16)"), *_OPERATION),
    "Boizot, Busvelle, Gauthier, Automatica 46 (2010), global inequality (16); Gauthier, Kupka 2001, chapter 6",
)
DECAYING = Theorem(
    f"{_ANYWHERE}, for theta_0 large and the rate small enough",
    (*FORM, *_BUILT, _large("0 < rate <= lambda_0, and theta_0 large enough for that rate", "theorem"), *_OPERATION),
    "Busvelle, Parallel high-gain and non high-gain extended Kalman filters (slides), theorem",
)
ADAPTIVE = Theorem(
    f"{_ANYWHERE} (theorem 5)",
    (
        *FORM,
        *_BUILT,
        Hypothesis(
            "theta(0) = 1 and 1 <= theta <= 2 theta_1",
            verdict=Verdict.PROVED,
            reason="by the exact flow of its law",
            reference="(4), (5)",
        ),
        _large("d, Delta T small, theta_1 large, lambda > 0 and gamma_1 small enough", "theorem 5, (18), (21)"),
        *_OPERATION,
    ),
    "Boizot, Busvelle, Gauthier, Automatica 46 (2010), theorem 5",
)

_MODIFIED = "R is not scaled, and Q_theta = theta^2 Delta^-1 Q Delta^-1"
SCALED_AS = {  # by the noises that theta scales
    "process": Hypothesis(
        _MODIFIED, verdict=Verdict.PROVED, reason="by construction", reference="the modified extended Kalman filter"
    ),
    "both": Hypothesis(
        _MODIFIED,
        verdict=Verdict.UNKNOWN,
        reason="here R/theta and theta Delta^-1 Q Delta^-1: with S/theta for the theorem's S the same observer at "
        "constant theta; while theta decays, S' here has the term rate (theta - 1)/theta S more",
        reference="the modified extended Kalman filter",
    ),
}

_LATE = replace(
    SCALED_AS["process"],
    verdict=Verdict.UNKNOWN,
    reason="the slides are of one output; chains of unequal length, aligned at their ends, have delta R delta",
)

SMOOTHSTEP = Hypothesis(
    "mu = 0 up to gamma_0, mu = 1 from gamma_1 on", verdict=Verdict.PROVED, reason="by its formula", reference="(6)"
)
LOGISTIC = Hypothesis(
    "mu = 0 up to gamma_0, mu = 1 from gamma_1 on",
    verdict=Verdict.REFUTED,
    reason="a logistic is never 0 nor 1; it holds theta a little above 1",
    reference="(6)",
)
OTHER_COORDINATES = Hypothesis(
    "the filter works in the coordinates z = Phi(x)",
    verdict=Verdict.REFUTED,
    reason="it stays in the plant's, where z_i' = a_(i+1) z_(i+1) + b_i is not shown",
    reference="(3)",
)
_READS = "b_(i,j) reads z_(k,l) for l <= "
ALIGNMENTS = {  # by the alignment of the chains
    "top": Hypothesis(
        f"{_READS}j only (top)",
        (Claims("block_triangular", "structure"),),
        reason="the paper is of one output; in Delta z, top, its inequalities are the same",
    ),
    "end": Hypothesis(
        f"{_READS}j + n_k - n_i only (end)",
        (Claims("block_triangular", "structure"),),
        reference="Boizot, thesis (2010), chapter 5",
    ),
    "cascade": Hypothesis(
        f"{_READS}j or j + n_k - n_i only",
        verdict=Verdict.UNKNOWN,
        reason="the chains are one after the other, and read each other as a whole",
    ),
}


def of_form(theorem: Theorem, form: Form, *, rank: str = "") -> Theorem:
    """Return `theorem` with the hypotheses that `form` adds: for chains of several outputs, and for coordinates other
    than the theorem's. For a discrete plant it is the theorem of the discrete-time filter. `rank`: why Q may be
    singular, else ""."""
    if form.system.discrete:
        return discrete.THEOREM
    if form.system.invariants and not rank:
        rank = "the step projects P and Q onto the invariants, where they are singular"
    if rank:
        singular = replace(_DEFINITE, verdict=Verdict.UNKNOWN, reason=rank)
        ranked = (singular if each is _DEFINITE else each for each in theorem.hypotheses)
        theorem = replace(theorem, hypotheses=tuple(ranked))
    if form.kind == "block_triangular":
        more = ALIGNMENTS.get(form.alignment)
        chains = theorem.with_chains().under(*((more,) if more else ()))
        late = form.alignment == "end" and len(set(form.blocks)) > 1
        instead = {SCALED_AS["process"]: _LATE} if late else {}
        return replace(chains, hypotheses=tuple(instead.get(each, each) for each in chains.hypotheses))
    return theorem if form.jacobian is None else theorem.under(OTHER_COORDINATES)


@dataclass(frozen=True)
class Smoothstep:
    """The growth fraction mu(I) of the adaptive law as a smoothstep of the innovation I: mu = x^2 (3 - 2 x), x = (I -
    gamma_0)/(gamma_1 - gamma_0) clamped to [0, 1]. C1; exactly 0 below `gamma_0`, 1 above `gamma_1` (y^2 s)."""

    gamma_0: float
    gamma_1: float
    equation: str = "mu 0 below gamma_0, 1 above gamma_1, a smoothstep between"
    hypothesis: Hypothesis = SMOOTHSTEP

    @property
    def gains(self) -> tuple[Field, ...]:
        """The tunable gains of mu: the thresholds gamma_0 and gamma_1 of the innovation (y^2 s)."""
        top = 1e6 * self.gamma_1
        return (
            gain("gamma_0", self.gamma_0, 0.0, top, "innovation below which theta decays", "y^2 s"),
            gain("gamma_1", self.gamma_1, 0.0, top, "innovation above which theta rises fully", "y^2 s"),
        )

    def fraction(self, innovation: Graph) -> Graph:
        """Return mu(I) in [0, 1] as an SX scalar, for the innovation I as an SX scalar."""
        low, high = sym("gain", "gamma_0"), sym("gain", "gamma_1")
        x = ca.fmin(ca.fmax((innovation - low) / ca.fmax(high - low, 1e-6 * self.gamma_1), 0), 1)
        return x * x * (3 - 2 * x)


@dataclass(frozen=True)
class Logistic:
    """The growth fraction mu(I) = 1/(1 + exp(-slope (I - centre))), I the innovation: the paper's sigmoid, never 0 or
    1."""

    centre: float
    slope: float
    equation: str = "mu = 1/(1 + exp(-slope (I_d - centre)))"
    hypothesis: Hypothesis = LOGISTIC

    @property
    def gains(self) -> tuple[Field, ...]:
        """The tunable gains of mu: `centre` (y^2 s) and `slope` (1/(y^2 s)) of the sigmoid."""
        return (
            gain("centre", self.centre, 0.0, 1e6 * self.centre, "innovation at which mu = 1/2", "y^2 s"),
            gain("slope", self.slope, 0.0, 1e6 * self.slope, "slope of the logistic", "1/(y^2 s)"),
        )

    def fraction(self, innovation: Graph) -> Graph:
        """Return mu(I), I the innovation, SX scalars; the exponent is clamped to +-80, where exp is finite in float."""
        exponent = sym("gain", "slope") * (sym("gain", "centre") - innovation)
        return 1 / (1 + ca.exp(ca.fmin(ca.fmax(exponent, -80), 80)))


def smoothstep(gamma_0: float, gamma_1: float) -> Smoothstep:
    """Growth fraction mu for `adaptive`: 0 for an innovation below gamma_0 > 0, 1 above gamma_1 > gamma_0 (y^2 s), a C1
    smoothstep between. Raises: `BadGain`."""
    positive("gamma_0", gamma_0)
    positive("gamma_1", gamma_1)
    if not gamma_0 < gamma_1:
        raise BadGain(f"gamma_0 = {gamma_0:g}", f"must be below gamma_1 = {gamma_1:g}")
    return Smoothstep(float(gamma_0), float(gamma_1))


def logistic(centre: float, slope: float) -> Logistic:
    """Growth fraction mu(I) = 1/(1 + exp(-slope (I - centre))) for `adaptive`, I the innovation; `centre` (y^2 s) and
    `slope` (1/(y^2 s)) are positive. Raises: `BadGain`."""
    positive("centre", centre)
    positive("slope", slope)
    return Logistic(float(centre), float(slope))


class Theta(ABC):
    """The high-gain parameter theta of a Riccati observer; by default constant."""

    scaled: Scaled  # the noises that theta scales
    traces: tuple[str, ...] = ()  # scalar fields of the state to log

    @property
    def value(self) -> Graph:
        """Theta as an SX scalar; for a varying theta the symbol of the state's field `theta`."""
        return sym("state", "theta")

    @property
    @abstractmethod
    def peak(self) -> float:
        """The largest value that theta can have."""

    @property
    def late(self) -> float:
        """The value of theta after a large estimation error has lasted much longer than its time constants."""
        return self.peak

    @property
    def error_free(self) -> float | None:
        """The value to which theta tends while the estimation error is 0, if theta can rise from there to `peak` again;
        else None."""
        return None

    def rise(self, theta: np.ndarray, dt: np.ndarray) -> np.ndarray:
        """Return theta (d) a time `dt` (d) after the values `theta` (d), at the fastest rise that its law permits."""
        return theta

    @property
    @abstractmethod
    def gains(self) -> tuple[Field, ...]:
        """The tunable gains of the law of theta."""

    @abstractmethod
    def law(self, unit: str) -> str:
        """The law of theta(t) as text for the banner of the generated code; `unit`: the text of the unit of time."""

    @property
    @abstractmethod
    def theorem(self) -> Theorem:
        """The convergence theorem of the Riccati observer with this law of theta."""

    def parts(self, dynamics: Dynamics, z: Field) -> tuple[Part, ...]:
        """Return the parts of the observer that change theta; `z`: the field of the estimated state."""
        return ()


@dataclass(frozen=True)
class Constant(Theta):
    """A constant theta, 1 for the extended Kalman filter; `scaled`: the noises that theta scales."""

    theta: float
    scaled: Scaled = "both"

    @property
    def peak(self) -> float:
        """The largest value of theta, here the constant itself."""
        return self.theta

    @property
    def value(self) -> Graph:
        """Theta as an SX scalar: the number 1, or the symbol of the gain `theta`."""
        return ca.SX(1) if self.theta == 1 else sym("gain", "theta")

    @property
    def gains(self) -> tuple[Field, ...]:
        """The gain theta unless it is 1; its range ends at the nominal value, for which step lengths are computed."""
        if self.theta == 1:
            return ()
        return (gain("theta", self.theta, 1.0, self.theta, "high-gain parameter"),)

    def law(self, unit: str) -> str:
        """The text for the banner that theta is constant, or that theta = 1, an extended Kalman filter."""
        return "theta = 1, an extended Kalman filter" if self.theta == 1 else "theta constant"

    @property
    def theorem(self) -> Theorem:
        """The convergence theorem: for theta = 1 the local one of the extended Kalman filter, else the global one of a
        high gain."""
        return KALMAN if self.theta == 1 else HIGH_GAIN


@dataclass(frozen=True)
class Decaying(Theta):
    """A theta that decays to 1, theta(t) = 1 + (theta_0 - 1) exp(-rate t), `rate` in 1/s; `scaled`: the noises that
    theta scales."""

    theta_0: float
    rate: float
    scaled: Scaled = "process"
    traces: tuple[str, ...] = ("theta",)

    def law(self, unit: str) -> str:
        """The equation of theta(t) as text for the banner."""
        return "theta(t) = 1 + (theta_0 - 1) exp(-rate t)"

    @property
    def theorem(self) -> Theorem:
        """The theorem of Busvelle's slides on a decaying theta, with its hypothesis on the noises that theta scales."""
        return DECAYING.under(SCALED_AS[self.scaled])

    @property
    def peak(self) -> float:
        """The largest value of theta, theta_0."""
        return self.theta_0

    @property
    def late(self) -> float:
        """The value of theta after a large error has lasted for long, 1."""
        return 1.0

    @property
    def gains(self) -> tuple[Field, ...]:
        """The gain `rate` (1/s), whose range excludes 0; theta_0 is the initial value of the state theta."""
        return (gain("rate", self.rate, 1e-3 * self.rate, 1e3 * self.rate, "rate at which theta decays to 1", "1/s"),)

    def parts(self, dynamics: Dynamics, z: Field) -> tuple[Part, ...]:
        """Return the part that multiplies theta - 1 by exp(-rate dt) at each step."""
        return (Jump(self._pieces, {"theta": -sym("gain", "rate") * (self.value - 1)}),)

    def _pieces(self, clock: Clock) -> Pieces:
        theta, factor = sym("state", "theta"), ca.exp(-sym("gain", "rate") * clock.passed)
        decay = factor if clock.varying else sym("derived", "decay")
        pieces = Pieces(
            fields=(_theta_field(self.theta_0, self.theta_0),),
            adapt=(Block("theta decays to 1", {Place("state", "theta"): 1 + (theta - 1) * decay}),),
        )
        if clock.varying:
            return pieces
        return replace(
            pieces,
            derived=(scalar("decay", 0.0, meaning="exp(-rate dt)"),),
            tune=(Block("decay of theta over one step", {Place("derived", "decay"): factor}),),
        )


@dataclass(frozen=True)
class Adaptive(Theta):
    """The theta that follows theta' = mu(I) F_0(theta) + rate (1 - mu(I)) (1 - theta), I the innovation, F_0 =
    theta^2/rise_time for theta <= theta_1, else (theta - 2 theta_1)^2/rise_time; `rate` (1/s), `rise_time` (s)."""

    theta_1: float
    rise_time: float
    rate: float
    mu: Smoothstep | Logistic
    innovation: Innovation
    scaled: Scaled = "both"
    traces: tuple[str, ...] = ("theta", "innovation")

    def law(self, unit: str) -> str:
        """The equations of theta' and mu, and the innovation's window, as text for the banner."""
        return (
            "theta' = mu(I_d) F_0(theta) + rate (1 - mu(I_d)) (1 - theta), by exact sub-flows; F_0 = theta^2/rise_time "
            "up to theta_1, then (theta - 2 theta_1)^2/rise_time; "
            + self.mu.equation
            + f"; I_d over d = {same(self.innovation.d)} {unit}"
        )

    @property
    def theorem(self) -> Theorem:
        """Theorem 5 of Boizot, Busvelle, Gauthier 2010, with its hypotheses on mu and on the innovation."""
        return ADAPTIVE.under(self.mu.hypothesis, self.innovation.hypothesis)

    @property
    def peak(self) -> float:
        """The largest value of theta, 2 theta_1."""
        return 2 * self.theta_1

    @property
    def error_free(self) -> float:
        """The value that theta reaches while the estimation error is 0: 1."""
        return 1.0

    def rise(self, theta: np.ndarray, dt: np.ndarray) -> np.ndarray:
        """Return the values of theta (d) after times `dt` (d) under theta' = F_0(theta), solved in closed form."""
        return np.array(_risen()(theta[None], dt[None] / self.rise_time, self.theta_1)).ravel()

    @property
    def gains(self) -> tuple[Field, ...]:
        """The gains theta_1, rise_time, rate, and the two of the growth fraction mu.

        The default method computes step lengths at theta = 1, at theta = 2 theta_1, the largest value, and at their
        geometric mean; an explicit Runge-Kutta method at both ends and along the fastest rise.
        """
        return (
            gain("theta_1", self.theta_1, 1.0, self.theta_1, "half the largest theta"),
            gain("rise_time", self.rise_time, 1e-3 * self.rise_time, 1e3 * self.rise_time, "Delta T", "s"),
            gain("rate", self.rate, 0.0, 1e3 * self.rate, "lambda, rate at which theta decays to 1", "1/s"),
            *self.mu.gains,
        )

    def parts(self, dynamics: Dynamics, z: Field) -> tuple[Part, ...]:
        """Return two parts of the observer: one computes the innovation I, the other advances theta by its law."""
        theta, theta_1, mu = self.value, sym("gain", "theta_1"), self.mu.fraction(sym("state", "innovation"))
        growth = ca.if_else(theta <= theta_1, theta, theta - 2 * theta_1) ** 2 / sym("gain", "rise_time")
        law = mu * growth + sym("gain", "rate") * (1 - mu) * (1 - theta)
        return (self.innovation.part(dynamics, z), Jump(self._pieces, {"theta": law}))

    def _pieces(self, clock: Clock) -> Pieces:
        theta, mu = sym("state", "theta"), sym("work", "mu")
        constant = ca.logic_and(mu <= 0, inside(theta, [(1.0, 1.0)]))  # the law would not change a bit of theta = 1
        growth = {Place("work", "mu"): self.mu.fraction(sym("state", "innovation"))}
        risen = rise(theta, mu * clock.passed / sym("gain", "rise_time"), sym("gain", "theta_1"))
        decay = ca.exp(-sym("gain", "rate") * clock.passed * (1 - mu))
        fallen = 1 + (risen - 1) * decay
        top = 2 * sym("gain", "theta_1")
        block = Block(
            "theta by the exact sub-flows of its law: rise, then decay",
            {Place("state", "theta"): ca.fmin(ca.fmax(fallen, 1), top)},
            {"risen": risen, "decay": decay},
        )
        changes = Place("work", "moves")
        adapt = (
            Block("how much growth the innovation asks for, 0 to 1", growth),
            Block("is theta at rest?", {changes: ca.logic_not(constant)}),
            When(changes, (block,)),
        )
        return Pieces(fields=(_theta_field(1.0, self.peak),), adapt=adapt)


def rise(theta: Graph, s: Graph, theta_1: Graph) -> Graph:
    """Return theta after the scaled time s = t/rise_time, in closed form, under theta' = theta^2 up to theta_1, then
    theta' = (2 theta_1 - theta)^2; SX scalars."""
    room = ca.fmax(1 / theta - 1 / theta_1, 0)
    below = 1 / ca.fmax(1 / theta - s, 1 / theta_1)
    gap = 2 * theta_1 - ca.fmax(theta, theta_1)
    above = 2 * theta_1 - gap / (1 + gap * (s - room))
    return ca.if_else(ca.logic_and(s <= room, theta <= theta_1), below, above)


@cache
def _risen() -> Any:
    arguments = [ca.SX.sym(name) for name in ("theta", "s", "theta_1")]
    return ca.Function("rise", arguments, [rise(*arguments)])


def _theta_field(initial: float, peak: float) -> Field:
    return scalar("theta", initial, low=1.0, high=peak, meaning="high-gain parameter, 1: Kalman mode")


def constant(theta: float = 1.0, *, scaled: Scaled = "both") -> Constant:
    """A constant theta >= 1 of the observer `riccati`. `scaled`: the noises that theta scales, "process" or "both"; the
    observer's gain is equal for either. Raises: `BadGain`."""
    _at_least("theta", theta, 1.0)
    _demand_scaling(scaled)
    return Constant(float(theta), scaled)


def decaying(theta_0: float, rate: float, *, scaled: Scaled = "process") -> Decaying:
    """A theta that decays from theta_0 >= 1 to 1 at `rate` > 0 (1/s).

    `scaled`: the noises that theta scales: "process" noise alone, Q_theta = theta^2 Delta^-1 Q Delta^-1, as the slides'
    theorem requires, or "both", Q_theta = theta Delta^-1 Q Delta^-1 and R_theta = R/theta, as with any other theta.
    `error_bound` is the bound of the theorem for given values of its existential constants.

    Raises: `BadGain`.
    """
    _at_least("theta_0", theta_0, 1.0)
    positive("rate", rate)
    _demand_scaling(scaled)
    return Decaying(float(theta_0), float(rate), scaled)


def adaptive(
    theta_1: float,
    *,
    mu: Smoothstep | Logistic | tuple[float, float],
    innovation: Innovation,
    rise_time: float = 0.1,
    rate: float = 1.0,
) -> Adaptive:
    """A theta that rises towards 2 theta_1 while the innovation is large, and decays to 1 while it is small.

    Args: `mu` a `smoothstep` or `logistic`, or the thresholds (gamma_0, gamma_1) of a smoothstep (y^2 s); `innovation`
    a value of `hgogen.innovation`; `rise_time` Delta T of the paper (s); `rate` lambda of the paper (1/s).

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
    """Return log Lambda = (2 (n - 1) + a/rate) log theta_0 - (a/rate) theta_0 (1 - exp(-rate t)), the growth factor in
    the error bound of a decaying theta, for n states; `rate` is lambda (1/s), `t` (s), `a` (1/s). Raises: `BadGain` for
    theta_0 < 1, t < 0, n < 1, or a rate or an a that is not positive."""
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
    """Return the bound sqrt(R exp(-a t) Lambda) |e(0)| on the error |e(t)| with a decaying theta, Lambda of
    `log_growth`, |e(0)| = `initial`; infinite beyond the range of floats. Raises: `BadGain`, also for an R or an
    initial error that is not positive."""
    grown = log_growth(theta_0, t, rate, n=n, a=a) - a * t + math.log(positive("R", R))
    exponent = grown / 2 + math.log(positive("initial", initial))
    return math.exp(exponent) if exponent < math.log(1.7e308) else math.inf


def _demand_scaling(scaled: str) -> None:
    if scaled not in SCALED:
        raise BadGain(f"scaled = {scaled!r}", f"must be one of {', '.join(map(repr, SCALED))}: what theta scales")


def _at_least(name: str, value: float, low: float) -> None:
    if not low <= real(name, value) < float("inf"):
        raise BadGain(f"{name} = {value!r}", f"must be a finite number, at least {low:g}")
