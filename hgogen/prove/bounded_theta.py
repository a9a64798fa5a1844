"""What is said of a bound, above which every theta converges, by whichever proof, or where there is none."""

from dataclasses import dataclass

from hgogen.check import Check, ClaimId, Verdict
from hgogen.sentence import Down, Reason, because, same


@dataclass(frozen=True)
class Nothing:
    """No bound, and why."""

    reason: Reason

    def __str__(self) -> str:
        return str(self.reason)


EXISTS = "in continuous time, without noise, the error converges exponentially for every theta above a bound"


def said(theta: float) -> str:
    """The claim that theta is above the bound."""
    return f"theta = {same(theta)} is above that bound"


def nothing(maker: str, theta: float, why: Reason) -> tuple[Check, Check]:
    """The two claims, where no bound is proved."""
    none, fix = because("no bound is proved"), "Validate by trials."
    return (
        Check(ClaimId(maker, "convergence"), EXISTS, Verdict.UNKNOWN, why, fix=fix),
        Check(ClaimId(maker, "theta"), said(theta), Verdict.UNKNOWN, none, fix=fix),
    )


def decays(rate: float, during: str = "") -> Reason:
    """That the error decays at a rate, or does `during` some times alone."""
    pattern = "the error decays at least like exp(-{rate} t) while the estimate keeps to its outer box"
    decay = because(pattern, rate=Down(rate, 2))
    return because("{during} {decay}", during=during, decay=decay) if during else decay
