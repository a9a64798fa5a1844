"""What an observer claims of its gain theta by a bound, above which every theta converges."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, Protocol

from hgogen.check import Check, ClaimId, Verdict
from hgogen.evidence.grounds import Grounds
from hgogen.intervals.digits import Down, Up, same
from hgogen.sentence import Reason, because


@dataclass(frozen=True)
class Nothing:
    """No bound, and why."""

    reason: Reason

    def __str__(self) -> str:
        return str(self.reason)


class Bound(Protocol):
    """Every theta above `theta` converges, the error at the `rate` (1/s) of a theta above it.

    `reason`: how the bound comes about. One with `evidence` beside these gives a certificate what `hgogen recheck`
    verifies (`evidence.grounds`).
    """

    @property
    def theta(self) -> Fraction:
        """The bound."""
        ...

    @property
    def numbers(self) -> Mapping[str, Any]:
        """What the observer is built with, beside theta."""
        ...

    @property
    def reason(self) -> Reason:
        """The bound in words."""
        ...

    def rate(self, theta: float) -> float:
        """r with |error(t)| <= c exp(-r t) |error(0)|."""
        ...


def checks(
    maker: str, theta: float, bound: Bound | Nothing, name: str = "theta", during: str = ""
) -> tuple[Check, Check]:
    """`MAKER.convergence`, that there is a bound; `MAKER.theta`, that theta, the gain of that `name`, is above it, so
    that the error decays, or does `during` some times alone."""
    exists = "in continuous time, without noise, the error converges exponentially for every theta above a bound"
    above = f"theta = {same(theta)} is above that bound"
    if isinstance(bound, Nothing):
        none, fix = because("no bound is proved"), "Validate by trials."
        return (
            Check(ClaimId(maker, "convergence"), exists, Verdict.UNKNOWN, bound.reason, fix=fix),
            Check(ClaimId(maker, "theta"), above, Verdict.UNKNOWN, none, fix=fix),
        )
    proof = because("above {bound}; exact arithmetic and outward-rounded intervals", bound=bound.reason)
    grounds = Grounds({name: theta, **bound.numbers}, bound)
    convergence = Check(ClaimId(maker, "convergence"), exists, Verdict.PROVED, proof, proofs=(grounds,))
    if Fraction(theta) > bound.theta:
        pattern = "the error decays at least like exp(-{rate} t) while the estimate keeps to its outer box"
        decay = because(pattern, rate=Down(bound.rate(theta), 2))
        decay = because("{during} {decay}", during=during, decay=decay) if during else decay
        reason = because("above {bound}; {decay}", bound=Up(bound.theta, below=theta), decay=decay)
        return convergence, Check(
            ClaimId(maker, "theta"), above, Verdict.PROVED, reason, proofs=(replace(grounds, fact=None),)
        )
    pattern = "not shown: {theta} is below the certified {bound}; the bound is sufficient, not necessary"
    low = because(pattern, theta=float(theta), bound=Up(bound.theta))
    return convergence, Check(
        ClaimId(maker, "theta"), above, Verdict.UNKNOWN, low, fix=f"Raise {name}, or validate by trials."
    )
