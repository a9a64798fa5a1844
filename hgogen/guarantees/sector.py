"""Whether a linear core decays with its output error behind a saturation or a dead zone whose level adapts.

    eps' = l (A eps - K i(eps_1)),   sigma' = l (-lambda sigma + r eps_1^2),   N = A - K C,   C = (1, 0, .., 0)

Dead zone, i(e) = e - s, s = sat e at +- sqrt sigma: V = eps'P eps + mu sigma, and -lambda sigma <= -lambda s^2,
s (eps_1 - s) >= 0 bound V' by l times the quadratic form in (eps, s)

    eps'(N'P + P N) eps + 2 eps'P K s + mu (r eps_1^2 - lambda s^2) + 2 tau s (eps_1 - s)

Saturation, i(e) = sat e = e - q: V = eps'P eps + mu max(eps_1^2 - sigma, 0). Where q = 0, V' = l eps'(N'P + P N) eps;
elsewhere sigma = (eps_1 - q)^2, q (eps_1 - q) >= 0, and V' is at most l times the form in (eps, q)

    eps'(N'P + P N) eps + 2 eps'P K q + mu (2 eps_1 C (N eps + K q) + lambda (eps_1 - q)^2 - r eps_1^2)
    + 2 tau q (eps_1 - q);  eps decays, and sigma after it

A form that is negative for some mu > 0, tau >= 0 proves exponential decay from any eps(0) and sigma(0) >= 0.

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

from hgogen.algebra.definite import Matrix, exact, positive
from hgogen.chains.injection import companion
from hgogen.check import Check, ClaimId, Verdict
from hgogen.evidence.grounds import Evidence, Grounds
from hgogen.form import Form
from hgogen.guarantees.lmi import STATES, lyapunov
from hgogen.guarantees.steepness import GROWTHS
from hgogen.sentence import because

FEW = 6  # states up to which several g are tried
_PAIRS = tuple((2.0**i, 2.0**j) for i, j in product(range(-12, 13), repeat=2))  # mu and tau


@dataclass(frozen=True)
class Shape:
    """What becomes of an output error e: i(e) is `injected` of (e, sat e), `text` in equations.

    `below`: whether r must be below lambda; `drift`: of (N, K, C, lambda, r), what the second term of V brings into the
    form over mu: (n, n), (n) and the corner; `kept`: over mu, what that term is at least or at most in the form, times
    2 eps_1 s and s^2 (q of the other); `most`: whether V falls no faster than sigma; `fix`: what may give a proof where
    there is none.
    """

    name: str
    text: str
    injected: Callable[[Any, Any], Any]
    below: bool
    drift: Callable[[Any, Any, Any, Any, Any], tuple[Any, Any, Any]]
    kept: tuple[int, int]
    most: bool
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


DEAD_ZONE = Shape(
    name="dead zone",
    text="(e - sat(e))",
    injected=_excess,
    below=True,
    drift=_squared,
    kept=(0, 1),
    most=True,
    fix="Lower r.",
)
SATURATION = Shape(
    name="saturation",
    text="sat(e)",
    injected=_within,
    below=False,
    drift=_beyond,
    kept=(1, -1),
    most=False,
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

    def value(self, P: Any, mu: Any) -> Any:
        """The symmetric matrix (n + 1, n + 1) of V, as far as a rate of it is asked for; of floats or of rationals."""
        side, corner = np.array([self.shape.kept[0] * mu, *[mu * 0] * (len(P) - 1)]), self.shape.kept[1] * mu
        return np.vstack([np.column_stack([P, side]), [*side, corner]])


@dataclass(frozen=True)
class Decay:
    """A proof that the linear core decays: in the coordinates `growth`^(i-1) eps_i the form is negative."""

    adaptation: Adaptation
    growth: Fraction
    P: Matrix
    mu: Fraction
    tau: Fraction

    def evidence(self, form: Form) -> Evidence:
        """The matrix P and the multipliers of the quadratic form, in scaled coordinates of integrators, the units of
        which are powers of their growth."""
        units = [self.growth**i for i in range(len(self.P))]
        return {"units": units, "P": self.P, "mu": self.mu, "tau": self.tau}


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
    size = float(solution.peak) + adaptation.shape.kept[0] * mus  # of V at most, over |eps|^2
    mu, tau = map(Fraction, _PAIRS[int(np.argmax(margins / size))])
    shown = positive(exact(-adaptation.form(N, gain, P, mu, tau)))
    return Decay(adaptation, growth, solution.P, mu, tau) if shown else None
