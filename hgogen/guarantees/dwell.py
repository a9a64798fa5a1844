"""How long a high gain must hold so that switching between two gains keeps the error's decay.

    V_l = eps_l'P eps_l,   eps_l = diag(1, 1/l, .., 1/l^(n-1)) S e:   V_l' <= -a(l) V_l,   a(l) = (l - 2 p L_b)/p > 0

by the bound of `certified`, p >= lambda_max(P), for both gains l. From theta to theta_low V is multiplied by
kappa (theta/theta_low)^(2 (n - 1)) at most, kappa = p/lambda_min(P), back by kappa. With at least a time T in theta
between two switches down, V falls from cycle to cycle by a factor below 1 where

    a(theta) T > log(kappa^2 (theta/theta_low)^(2 (n - 1)))

whatever makes the gains switch, and the error converges exponentially. Average dwell time: Hespanha, Morse, "Stability
of switched systems with average dwell-time", CDC 1999.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from math import inf

from flint import arb

from hgogen.algebra.definite import exact, number, smallest
from hgogen.check import Check, ClaimId, Verdict
from hgogen.evidence.grounds import Evidence, Grounds
from hgogen.form import Form
from hgogen.guarantees.bounded_theta import Nothing, checks
from hgogen.guarantees.certified import ThetaBound
from hgogen.intervals.digits import Up, same
from hgogen.sentence import NONE, because

_BETWEEN = (
    "in continuous time, without noise, the error decays exponentially between switches, in every gain above a bound"
)


@dataclass(frozen=True)
class Held:
    """What shows that a time is long enough: `least` <= lambda_min(P)."""

    least: Fraction

    def evidence(self, form: Form) -> Evidence:
        """The lower bound of the P in the claim of convergence."""
        return {"least": self.least}


def switching(maker: str, theta: float, low: float, hold: float, bound: ThetaBound | Nothing) -> tuple[Check, ...]:
    """`MAKER.convergence`, that there is a bound on a gain that stays, `MAKER.theta`, that `low` is above it, and
    `MAKER.hold`, that the time `hold` is long enough: too short a one may keep the gain switching for ever."""
    convergence, above = checks(maker, low, bound, "theta_low", "between switches")
    convergence = replace(convergence, claim=_BETWEEN)
    above = replace(above, claim=f"theta_low = {same(low)}, and theta with it, is above that bound")
    held = _held(ClaimId(maker, "hold"), theta, low, hold, bound)
    if isinstance(bound, Nothing):
        return convergence, above, held
    numbers = {"theta": theta, "theta_low": low, "hold": hold, **bound.numbers}
    facts = ((convergence, bound), (above, None), (held, *held.proofs))
    return tuple(replace(check, proofs=tuple(Grounds(numbers, fact) for fact in each)) for check, *each in facts)


def _held(id: ClaimId, theta: float, low: float, hold: float, bound: ThetaBound | Nothing) -> Check:
    claim = f"in continuous time hold = {same(hold)} is long enough: switching keeps the error's decay"
    unknown = Check(id, claim, Verdict.UNKNOWN, NONE, fix="Validate by trials.")
    if isinstance(bound, Nothing) or not Fraction(low) > bound.theta:
        return replace(unknown, reason=because("theta_low is not above a proved bound"))
    P, peak = bound.lyapunov.P, bound.lyapunov.peak
    least_of_P = smallest(exact(P))[0]
    condition = peak / least_of_P
    speed = (Fraction(theta) - 2 * peak * bound.lipschitz) / peak
    growth = condition**2 * (Fraction(theta) / Fraction(low)) ** (2 * (len(P) - 1))
    least = arb(number(growth)).log() / arb(number(speed))
    if arb(number(Fraction(hold))) > least:
        reason = because("above {least}, by outward-rounded balls", least=_up(least, hold))
        proofs = (Held(least_of_P),)
        return replace(unknown, verdict=Verdict.PROVED, reason=reason, fix="", proofs=proofs)
    reason = because("not shown: {least} is, and is sufficient, not necessary", least=_up(least))
    return replace(unknown, reason=reason, fix=f"Take hold > {_up(least)}, or validate by trials.")


def _up(value: arb, below: float = inf) -> Up:
    """In the model's unit of time."""
    return Up(float(value.upper()) * (1 + 1e-12), below=below)
