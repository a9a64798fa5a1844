"""Whether a linear core decays with its output error behind a saturation or a dead zone whose level adapts.

    eps' = l (A eps - K i(eps_1)),   sigma' = l (-lambda sigma + r eps_1^2),   N = A - K C,   C = (1, 0, .., 0)

Dead zone, i(e) = e - s, s = sat e at +- sqrt sigma: V = eps'P eps + mu sigma, and -lambda sigma <= -lambda s^2,
s (eps_1 - s) >= 0 bound V' by l times the quadratic form in (eps, s)

    eps'(N'P + P N) eps + 2 eps'P K s + mu (r eps_1^2 - lambda s^2) + 2 tau s (eps_1 - s)

Saturation, i(e) = sat e = e - q: V = eps'P eps + mu max(eps_1^2 - sigma, 0). Where q = 0, V' = l eps'(N'P + P N) eps;
elsewhere sigma = (eps_1 - q)^2, q (eps_1 - q) >= 0, and V' is at most l times the form in (eps, q)

    eps'(N'P + P N) eps + 2 eps'P K q + mu (2 eps_1 C (N eps + K q) + lambda (eps_1 - q)^2 - r eps_1^2)
    + 2 tau q (eps_1 - q);  eps decays, and sigma after it

A form that is at most -eta I for some mu > 0, tau >= 0 proves exponential decay from any eps(0) and sigma(0) >= 0. With
a term of size L |eps| in eps', as a Lipschitz nonlinearity leaves it in scaled coordinates, V' keeps its sign for

    l eta > 2 (lambda_max(P) + m) L,   m = 0 of the dead zone, mu of the saturation;   there l > 2 lambda_max(P) L too.

P solves N'P + P N = -I in the coordinates g^(i-1) eps_i, g, mu and tau are powers of two: sufficient, not necessary.
The idea of the forms: Alessandri, Zaccarian, "Stubborn state observers for linear time-invariant systems", Automatica
88 (2018).
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import sympy as sp

from hgogen.algebra.definite import Matrix, exact, smallest
from hgogen.chains.injection import companion
from hgogen.chains.integrators import Integrators
from hgogen.check import Check, ClaimId, Verdict
from hgogen.evidence.enclosing import Steep
from hgogen.evidence.grounds import Evidence, Grounds
from hgogen.form import Form
from hgogen.guarantees.bounded_theta import Nothing
from hgogen.guarantees.certified import GROWTHS, slope
from hgogen.guarantees.lmi import STATES, lyapunov
from hgogen.intervals import outward
from hgogen.intervals.digits import Down, Up
from hgogen.sentence import Reason, because
from hgogen.structure.polytope import chains

FEW = 6  # states up to which several g are tried
_PAIRS = tuple((2.0**i, 2.0**j) for i, j in product(range(-12, 13), repeat=2))  # mu and tau


@dataclass(frozen=True)
class Shape:
    """What becomes of an output error e: i(e) is `injected` of (e, sat e), `text` in equations.

    `below`: whether r must be below lambda; `drift`: of (N, K, C, lambda, r), what the second term of V brings into the
    form over mu: (n, n), (n) and the corner; `share`: m over mu; `rest`: of (proof, l, L), the rate at which V falls
    beside (l eta - 2 (lambda_max(P) + m) L)/(lambda_max(P) + m); `fix`: what may give a proof where there is none.
    """

    name: str
    text: str
    injected: Callable[[Any, Any], Any]
    below: bool
    drift: Callable[[Any, Any, Any, Any, Any], tuple[Any, Any, Any]]
    share: int
    rest: Callable[["Decay", Fraction, Fraction], Fraction]
    fix: str


def _excess(e: Any, sat: Any) -> Any:
    """e - sat e."""
    return e - sat


def _within(e: Any, sat: Any) -> Any:
    """sat e."""
    return sat


def _squared(N: Any, K: Any, C: Any, decay: Any, r: Any) -> tuple[Any, Any, Any]:
    """(-lambda s^2 + r eps_1^2)."""
    return r * np.outer(C, C), 0 * C, -decay


def _beyond(N: Any, K: Any, C: Any, decay: Any, r: Any) -> tuple[Any, Any, Any]:
    """2 eps_1 C (N eps + K q) + lambda (eps_1 - q)^2 - r eps_1^2."""
    first = np.outer(C, N[0])
    return first + first.T + (decay - r) * np.outer(C, C), (K[0] - decay) * C, decay


def _level(one: "Decay", level: Fraction, lipschitz: Fraction) -> Fraction:
    """That of mu sigma, which takes its share of eta."""
    return level * min(one.margin / one.mu, one.adaptation.decay)


def _open(one: "Decay", level: Fraction, lipschitz: Fraction) -> Fraction:
    """That of eps'P eps, where q = 0."""
    return (level - 2 * one.peak * lipschitz) / one.peak


DEAD_ZONE = Shape(
    name="dead zone",
    text="(e - sat(e))",
    injected=_excess,
    below=True,
    drift=_squared,
    share=0,
    rest=_level,
    fix="Lower r.",
)
SATURATION = Shape(
    name="saturation",
    text="sat(e)",
    injected=_within,
    below=False,
    drift=_beyond,
    share=1,
    rest=_open,
    fix="Raise r.",
)


@dataclass(frozen=True)
class Adaptation:
    """sigma' = l (-decay sigma + r e^2) of an injection of that `shape`."""

    shape: Shape
    decay: Fraction
    r: Fraction

    def form(self, N: Any, K: Any, P: Any, mu: Any, tau: Any) -> Any:
        """The symmetric matrix (n + 1, n + 1) of the form, of N, P (n, n), K (n); of floats or of rationals. Of several
        mu and tau (k) as many matrices (k, n + 1, n + 1)."""
        number = Fraction if isinstance(mu, Fraction) else float
        n, (decay, r) = len(K), (number(self.decay), number(self.r))
        C = np.array([number(1), *[number(0)] * (n - 1)])
        block, column, corner = self.shape.drift(N, K, C, decay, r)
        of = np.multiply.outer
        top, side = N.T @ P + P @ N + of(mu, block), P @ K + of(tau, C) + of(mu, column)
        last = np.concatenate([side, np.asarray(mu * corner - 2 * tau)[..., None]], -1)
        return np.concatenate([np.concatenate([top, side[..., None]], -1), last[..., None, :]], -2)


@dataclass(frozen=True)
class Decay:
    """A proof that the linear core decays: in the coordinates `growth`^(i-1) eps_i the form is at most -`margin` I;
    `peak` >= lambda_max(P)."""

    adaptation: Adaptation
    growth: Fraction
    P: Matrix
    peak: Fraction
    margin: Fraction
    mu: Fraction
    tau: Fraction

    @property
    def weight(self) -> Fraction:
        """lambda_max(P) + m."""
        return self.peak + self.adaptation.shape.share * self.mu

    def evidence(self, form: Form) -> Evidence:
        """The matrix P and the multipliers of the quadratic form, in scaled coordinates of integrators, the units of
        which are powers of their growth."""
        units = [self.growth**i for i in range(len(self.P))]
        return {"units": units, "P": self.P, "mu": self.mu, "tau": self.tau}

    def least(self, lipschitz: Fraction) -> Fraction:
        """The bound on l."""
        return max(Fraction(1), 2 * lipschitz * max(self.weight / self.margin, self.peak))


@dataclass(frozen=True)
class SectorBound:
    """A proof that every theta > `theta` converges.

    `steep` proves that `lipschitz` >= |S dc/dw S^-1| on the box, in the coordinates of `decay`; `numbers` are what the
    observer is built with.
    """

    theta: Fraction
    decay: Decay
    lipschitz: Fraction
    steep: Steep
    numbers: Mapping[str, Any]

    def rate(self, theta: float) -> float:
        """r (1/s) with |error(t)| <= c exp(-r t) (|error(0)| + sqrt sigma(0)) at a theta above the bound; it is rounded
        down."""
        one, level = self.decay, Fraction(theta)
        left = (level * one.margin - 2 * one.weight * self.lipschitz) / one.weight
        return outward.number(min(left, one.adaptation.shape.rest(one, level, self.lipschitz)) / 2)[0]

    def evidence(self, form: Form) -> Evidence:
        """The evidence of the decay with its margin, and the bound of dc/dw."""
        one = self.decay
        return {**one.evidence(form), "peak": one.peak, "margin": one.margin, "slope": self.steep}

    @property
    def reason(self) -> Reason:
        """How the bound comes about."""
        pattern = (
            "{theta} = max(1, 2 L_b (lambda_max(P) + m)/eta, 2 L_b lambda_max(P)), lambda_max(P) + m <= {weight}, "
            "eta >= {eta}, L_b <= {L_b} in scaled states"
        )
        weight, eta = Up(self.decay.weight), Down(self.decay.margin)
        return because(pattern, theta=Up(self.theta), weight=weight, eta=eta, L_b=Up(self.lipschitz))

    def __str__(self) -> str:
        return str(self.reason)


def decays(adaptation: Adaptation, K: np.ndarray) -> tuple[Decay, ...]:
    """Proofs that the core of the gains K (n), A - K C Hurwitz, decays, one for each g that gives one."""
    growths = GROWTHS[: 0 if len(K) > STATES else 1 if len(K) > FEW else None]
    proofs = (_decay(adaptation, np.array([Fraction(float(k)) for k in K]), growth) for growth in growths)
    return tuple(one for one in proofs if one is not None)


def core_check(maker: str, adaptation: Adaptation, proofs: Iterable[Decay], numbers: Mapping[str, Any]) -> Check:
    """`MAKER.core`, that there is such a proof, of an observer that is built with the `numbers`."""
    id = ClaimId(maker, "core")
    claim = f"the linear error core decays behind its {adaptation.shape.name}, from any initial error"
    for one in proofs:
        pattern = "by a quadratic form with mu = {mu:g}, tau = {tau:g}, in rational arithmetic"
        reason = because(pattern, mu=float(one.mu), tau=float(one.tau))
        return Check(id, claim, Verdict.PROVED, reason, proofs=(Grounds(numbers, one),))
    reason = because("no quadratic proof was found for these lambda and r")
    return Check(id, claim, Verdict.UNKNOWN, reason, fix=adaptation.shape.fix)


def theta_bound(chain: Integrators, proofs: Iterable[Decay], numbers: Mapping[str, Any]) -> SectorBound | Nothing:
    """The smallest bound on theta that the proofs give with c, of an observer that is built with the `numbers`."""
    best: SectorBound | Nothing = Nothing(because("the linear core is not shown to decay"))
    (a,) = chains(chain.form)
    for one in proofs:
        units = tuple(one.growth**i for i in range(chain.n))
        scale = tuple(sp.Rational(s) * sp.Mul(*a[: i + 1]) for i, s in enumerate(units))
        steep = slope(chain.form, scale)
        if isinstance(steep, Nothing):
            return steep
        assert steep.high is not None
        bound = SectorBound(one.least(steep.high), one, steep.high, Steep(units, scale, steep), numbers)
        best = bound if isinstance(best, Nothing) or bound.theta < best.theta else best
    return best


def _decay(adaptation: Adaptation, K: Any, growth: Fraction) -> Decay | None:
    scale = np.array([growth**i for i in range(len(K))])
    N, gain = companion(K) * np.outer(scale, 1 / scale), K * scale
    solution = lyapunov(tuple(map(tuple, N)))
    if solution is None:
        return None
    P = np.array(solution.P)
    N_, K_, P_ = (array.astype(float) for array in (N, gain, P))
    mus, taus = np.array(_PAIRS).T
    margins = -np.linalg.eigvalsh(adaptation.form(N_, K_, P_, mus, taus))[:, -1]
    added = adaptation.shape.share * mus
    mu, tau = map(Fraction, _PAIRS[int(np.argmax(margins / (float(solution.peak) + added)))])
    margin = smallest(exact(-adaptation.form(N, gain, P, mu, tau)))[0]
    return Decay(adaptation, growth, solution.P, solution.peak, margin, mu, tau) if margin > 0 else None
