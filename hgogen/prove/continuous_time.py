"""What an observer of a constant injection claims of its gain theta, by one norm for all slopes in continuous time."""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from hgogen.analysis.evidence import Evidence, Grounds
from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Form
from hgogen.prove.bounded_theta import EXISTS, Nothing, decays, nothing, said
from hgogen.prove.common_norm import Falls, Flow, FunctionSearch
from hgogen.prove.endless_slopes import OneSided
from hgogen.prove.inclusion import Inclusion
from hgogen.sentence import Up, because


@dataclass(frozen=True)
class FromTheta:
    """A proof that every theta above `theta` converges: by the norm that falls there."""

    error: Inclusion
    falls: Falls

    @property
    def theta(self) -> Fraction:
        """The bound, which is proved to converge too."""
        return self.falls.theta

    def evidence(self, form: Form) -> Evidence | None:
        """How the slopes are bounded, theta, and the P and S at it."""
        function = self.falls.written
        return None if function is None else {"error": self.error, "least": self.theta, **function}


@dataclass(frozen=True)
class AtTheta:
    """A proof of the rate at which the error decays at the declared theta."""

    falls: Falls

    def evidence(self, form: Form) -> Evidence | None:
        """alpha, and the P and S for it; the slopes are those of the claim of convergence."""
        function = self.falls.written
        return None if function is None else {"alpha": self.falls.alpha, **function}


def theta_checks(maker: str, form: Form, theta: float, error: Inclusion | Nothing) -> tuple[Check, Check]:
    """`MAKER.convergence`, that there is a bound; `MAKER.theta`, that theta is above it, with the rate there."""
    if isinstance(error, Nothing):
        return nothing(maker, theta, error.reason)
    kind = OneSided if error.endless else Flow
    return claims(maker, form, kind(error, Fraction(theta)), {"theta": theta, **error.numbers})


def claims(
    maker: str, form: Form, flow: FunctionSearch, numbers: Mapping[str, Any], name: str = "theta", during: str = ""
) -> tuple[Check, Check]:
    """The same of an observer of these numbers, theta the gain of that name; the error decays `during` some times."""
    try:
        return _claims(maker, form, flow, numbers, name, during)
    except OverflowError:
        return nothing(maker, float(flow.theta), because("the numbers of a proof are beyond the range of doubles"))


def _claims(
    maker: str, form: Form, flow: FunctionSearch, numbers: Mapping[str, Any], name: str, during: str
) -> tuple[Check, Check]:
    theta, least = float(flow.theta), flow.least
    if least is None:
        return nothing(maker, theta, flow.missing)
    pattern = "above {bound}, by {how} for all slopes of b; exact arithmetic and outward-rounded intervals"
    proof = because(pattern, bound=Up(least.theta, 3, below=theta), how=flow.how)
    grounds = (Grounds(numbers, FromTheta(flow.error, least)),)
    convergence = Check(ClaimId(maker, "convergence"), EXISTS, Verdict.PROVED, proof, proofs=grounds)
    id, above = ClaimId(maker, "theta"), said(theta)
    if least.theta < flow.theta:
        reason, fact = because("above {bound}", bound=Up(least.theta, 3, below=theta)), None
        if flow.fastest is not None:
            decay = decays(flow.fastest.rate, during)
            reason, fact = because("{above}; {decay}", above=reason, decay=decay), AtTheta(flow.fastest)
        return convergence, Check(id, above, Verdict.PROVED, reason, proofs=(Grounds(numbers, fact),))
    pattern = "not shown: {theta} is below the certified {bound}; {why}"
    low = because(pattern, theta=theta, bound=Up(least.theta, 3), why=flow.obstacle(form.states))
    fix = f"Raise {name}, narrow the ranges of the states, or validate by trials."
    return convergence, Check(id, above, Verdict.UNKNOWN, low, fix=fix)
