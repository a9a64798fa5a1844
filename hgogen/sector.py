"""Whether a linear core decays with its output error behind a saturation or a dead zone whose level adapts.

    eps' = l (A eps - K i(eps_1)),   sigma' = l (-lambda sigma + r eps_1^2),   N = A - K C,   C = (1, 0, .., 0)

Dead zone, i(e) = e - s, s = sat e at +- sqrt sigma: V = eps'P eps + mu sigma, and -lambda sigma <= -lambda s^2,
s (eps_1 - s) >= 0 bound V' by l times the quadratic form in (eps, s)

    eps'(N'P + P N) eps + 2 eps'P K s + mu (r eps_1^2 - lambda s^2) + 2 tau s (eps_1 - s)

Saturation, i(e) = sat e = e - q: V = eps'P eps + mu max(eps_1^2 - sigma, 0). Where q = 0, V' = l eps'(N'P + P N) eps;
elsewhere sigma = (eps_1 - q)^2, q (eps_1 - q) >= 0, and V' is at most l times the form in (eps, q)

    eps'(N'P + P N) eps + 2 eps'P K q + mu (2 eps_1 C (N eps + K q) + lambda (eps_1 - q)^2 - r eps_1^2)
    + 2 tau q (eps_1 - q);  eps decays, and sigma after it

A form that is negative definite for some mu > 0, tau >= 0 proves exponential decay from any eps(0) and sigma(0) >= 0;
with it, terms of size L |eps| in eps', as a Lipschitz nonlinearity leaves them in scaled coordinates, are dominated for
l large enough. The idea of the forms: Alessandri, Zaccarian, "Stubborn state observers for linear time-invariant
systems", Automatica 88 (2018). Here P solves N'P + P N = -I, mu and tau are powers of two: sufficient, not necessary.
"""

from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from typing import Any, Literal

import numpy as np

from hgogen.check import Check, Verdict
from hgogen.definite import exact, positive
from hgogen.injection import companion
from hgogen.lmi import lyapunov

Shape = Literal["dead zone", "saturation"]

STATES = 12  # beyond it the exact Lyapunov equation has too many unknowns for a check that answers at once
_POWERS = range(-12, 13)  # of two, for mu and tau


@dataclass(frozen=True)
class Adaptation:
    """sigma' = l (-decay sigma + r e^2) of an injection of that `shape`."""

    shape: Shape
    decay: Fraction
    r: Fraction

    def form(self, K: Any, P: Any, mu: Any, tau: Any) -> Any:
        """The symmetric matrix (n + 1, n + 1) of the quadratic form, of K (n), P (n, n); of floats or of rationals."""
        n, (decay, r) = len(K), (type(mu)(self.decay), type(mu)(self.r))
        N, C = companion(K), np.array([mu * 0 + 1, *[mu * 0] * (n - 1)])
        slope, corner = np.outer(C, N[0]), np.outer(C, C)
        top, side = N.T @ P + P @ N, P @ K + tau * C
        if self.shape == "dead zone":
            top, last = top + mu * r * corner, -mu * decay - 2 * tau
        else:
            top = top + mu * (slope + slope.T + (decay - r) * corner)
            side, last = side + mu * (K[0] - decay) * C, mu * decay - 2 * tau
        return np.vstack([np.column_stack([top, side]), [*side, last]])


def decays(id: str, adaptation: Adaptation, K: np.ndarray) -> Check:
    """The check that the form of the gains K (n), A - K C Hurwitz, is negative definite for some mu and tau."""
    claim = f"the linear error core decays behind its {adaptation.shape}, from any initial error"
    fix = "Lower r." if adaptation.shape == "dead zone" else "Raise r."
    unknown = Check(id, claim, Verdict.UNKNOWN, "no quadratic proof was found for these lambda and r", fix=fix)
    exactly = np.array([Fraction(float(k)) for k in K])
    found = lyapunov(tuple(map(tuple, companion(exactly)))) if len(K) <= STATES else None
    if found is None:
        return unknown
    P = np.array(found.P)
    floats = P.astype(float)
    tried = ((2.0**i, 2.0**j) for i, j in product(_POWERS, _POWERS))
    worst = {pair: np.linalg.eigvalsh(adaptation.form(K, floats, *pair))[-1] for pair in tried}
    mu, tau = min(worst, key=lambda pair: worst[pair])
    gap = -adaptation.form(exactly, P, Fraction(mu), Fraction(tau))
    if not positive(exact(gap)):
        return unknown
    reason = f"by a quadratic form with mu = {mu:g}, tau = {tau:g}, in rational arithmetic"
    return Check(id, claim, Verdict.PROVED, reason)
