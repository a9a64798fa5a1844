"""How long a high gain must hold so that switching between two gains keeps the error's decay.

    V_l = eps_l'P_l eps_l,   eps_l = diag(theta^-p(i)) S e at theta = l:   V_l' <= -alpha_l V_l,   alpha_l >= 0

by a norm for each of the two gains l (`common_norm`). A switch multiplies eps by powers of the gains' ratio: with
eps_high = D eps_low, D = diag((low/high)^p(i)), V becomes at most `up` times what it was at a switch to the high gain,
and `down` times at one back,

    up P_low - D P_high D >= 0,   down P_high - D^-1 P_low D^-1 >= 0

With at least a time T in the high gain between two switches down, V falls from cycle to cycle by a factor below 1 where

    alpha_high T > log(up down)

whatever makes the gains switch, and the error converges exponentially. Average dwell time: Hespanha, Morse, "Stability
of switched systems with average dwell-time", CDC 1999.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from math import inf

import numpy as np
from flint import arb, fmpq_mat

from hgogen.analysis.evidence import Evidence, Grounds
from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Form
from hgogen.prove.bounded_theta import Nothing, nothing
from hgogen.prove.common_norm import Falls, Flow
from hgogen.prove.continuous_time import claims
from hgogen.prove.inclusion import Inclusion
from hgogen.prove.quadratic import Array, floats, rational
from hgogen.rigor.definite import nonnegative, number
from hgogen.sentence import Up, because, same

_BETWEEN = (
    "in continuous time, without noise, the error decays exponentially between switches, in every gain above a bound"
)
_ROUND = Fraction(1, 2**20)  # by what share `up` and `down` are larger than floats take them to be


@dataclass(frozen=True)
class Held:
    """What shows that a time is long enough: a norm that `falls` in the high gain, and what switches do to V."""

    falls: Falls
    up: Fraction
    down: Fraction

    @property
    def least(self) -> arb:
        """The time from which on it is, as a ball."""
        return arb(number(self.up * self.down)).log() / arb(number(self.falls.alpha))

    def evidence(self, form: Form) -> Evidence:
        """The norm of the high gain, with its alpha, and the two factors; the low gain's is in the claim of theta."""
        return {"alpha": self.falls.alpha, **self.falls.written, "up": self.up, "down": self.down}


def switching(
    maker: str, form: Form, theta: float, low: float, hold: float, error: Inclusion | Nothing
) -> tuple[Check, ...]:
    """`MAKER.convergence`, that there is a bound on a gain that stays, `MAKER.theta`, that `low` is above it, and
    `MAKER.hold`, that the time `hold` is long enough: too short a one may keep the gain switching for ever."""
    if isinstance(error, Nothing):
        known, held = nothing(maker, low, error.reason), _open(maker, hold)
    else:
        numbers = {"theta": theta, "theta_low": low, "hold": hold, **error.numbers}
        flow = Flow(error, Fraction(low))
        known = claims(maker, form, flow, numbers, "theta_low", "between switches")
        held = _open(maker, hold)
        if known[1].verdict is Verdict.PROVED:
            held = _held(held, flow, Fraction(theta), hold)
        held = replace(held, proofs=tuple(Grounds(numbers, proof) for proof in held.proofs))
    convergence, above = known
    convergence = replace(convergence, claim=_BETWEEN)
    above = replace(above, claim=f"theta_low = {same(low)}, and theta with it, is above that bound")
    return convergence, above, held


def _open(maker: str, hold: float) -> Check:
    claim = f"in continuous time hold = {same(hold)} is long enough: switching keeps the error's decay"
    why = because("theta_low is not above a proved bound")
    return Check(ClaimId(maker, "hold"), claim, Verdict.UNKNOWN, why, fix="Validate by trials.")


def _held(unknown: Check, flow: Flow, theta: Fraction, hold: float) -> Check:
    low = flow.fastest
    if low is None:
        return unknown
    above, P_low, ways = Flow(flow.error, theta), rational(low.weights.P), list[Held]()
    # by the fastest norm in the high gain, and by that of the low gain, which a switch changes less
    for high in (above.fastest, above.by(low.weights, low.alpha * theta / flow.theta)):
        if high is not None and high.alpha > 0:
            P_high = rational(high.weights.P)
            D = rational([(low.theta / high.theta) ** p for p in flow.error.layout.power])
            up, down = _factor(P_low, P_high * np.outer(D, D)), _factor(P_high, P_low / np.outer(D, D))
            ways.append(Held(high, up, down))
    if not ways:
        return replace(unknown, reason=because("no norm is found that falls in the high gain"))
    best = min(ways, key=lambda way: float(way.least.mid()))
    if arb(number(Fraction(hold))) > best.least:
        reason = because("above {least}, by outward-rounded balls", least=_up(best.least, hold))
        return replace(unknown, verdict=Verdict.PROVED, reason=reason, fix="", proofs=(best,))
    reason = because("not shown: {least} is, and is sufficient, not necessary", least=_up(best.least))
    return replace(unknown, reason=reason, fix=f"Take hold > {_up(best.least)}, or validate by trials.")


def _factor(P: Array, Q: Array) -> Fraction:
    """A short rational c with c P - Q >= 0, both positive definite."""
    half = np.linalg.inv(np.linalg.cholesky(floats(P)))
    c = Fraction(f"{np.linalg.eigvalsh(half @ floats(Q) @ half.T).max() * (1 + _ROUND):.9g}")
    while not nonnegative(fmpq_mat((P * number(c) - Q).tolist())):
        c *= 1 + _ROUND
    return c


def _up(value: arb, below: float = inf) -> Up:
    """In the model's unit of time."""
    return Up(float(value.upper()) * (1 + 1e-12), below=below)
