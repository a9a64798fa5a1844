"""What an observer of a constant injection claims of its gain theta, by one norm for all slopes in continuous time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Protocol

from hgogen.check import Check, ClaimId, Verdict
from hgogen.evidence.grounds import Evidence, Grounds
from hgogen.form import Form
from hgogen.guarantees.bounded_theta import EXISTS, Nothing, decays, nothing, said
from hgogen.guarantees.common_norm import Flow
from hgogen.guarantees.endless_slopes import OneSided
from hgogen.guarantees.inclusion import Inclusion
from hgogen.intervals.digits import Up
from hgogen.sentence import Reason, because


class Falling(Protocol):
    """A proof that a function V of the error falls at `theta`, by V' <= -`alpha` V; `rate` (1/s): at which errors do.
    `written`: V in a certificate."""

    @property
    def theta(self) -> Fraction:
        """Where it falls."""
        ...

    @property
    def alpha(self) -> Fraction:
        """Its rate."""
        ...

    @property
    def rate(self) -> float:
        """r with |error(t)| <= c exp(-r t) |error(0)|."""
        ...

    @property
    def written(self) -> Evidence | None:
        """V, by name; None where a certificate cannot hold it."""
        ...


class Sought(Protocol):
    """Where functions of the `error` are sought that fall, at `theta` and beyond. `how`: what they are."""

    @property
    def error(self) -> Inclusion:
        """What the error obeys."""
        ...

    @property
    def theta(self) -> Fraction:
        """The declared one."""
        ...

    @property
    def how(self) -> str:
        """Words for a function."""
        ...

    @property
    def least(self) -> Falling | None:
        """At a theta close to the least; below the one at hand where there is a proof at that."""
        ...

    @property
    def fastest(self) -> Falling | None:
        """At theta, with a rate close to the largest."""
        ...

    @property
    def missing(self) -> Reason:
        """Why there is a proof at no theta."""
        ...

    def obstacle(self, states: Sequence[Any]) -> Reason:
        """Why there is none at theta."""
        ...


@dataclass(frozen=True)
class FromTheta:
    """A proof that every theta above `theta` converges: by the norm that falls there."""

    error: Inclusion
    falls: Falling

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

    falls: Falling

    def evidence(self, form: Form) -> Evidence | None:
        """alpha, and the P and S for it; the slopes are those of the claim of convergence."""
        function = self.falls.written
        return None if function is None else {"alpha": self.falls.alpha, **function}


def theta_checks(maker: str, form: Form, theta: float, error: Inclusion | Nothing) -> tuple[Check, Check]:
    """`MAKER.convergence`, that there is a bound; `MAKER.theta`, that theta is above it, with the rate there."""
    if isinstance(error, Nothing):
        return nothing(maker, theta, error.reason)
    sought = (OneSided if error.endless else Flow)(error, Fraction(theta))
    return claims(maker, form, sought, {"theta": theta, **error.numbers})


def claims(
    maker: str, form: Form, flow: Sought, numbers: Mapping[str, Any], name: str = "theta", during: str = ""
) -> tuple[Check, Check]:
    """The same of an observer of these numbers, theta the gain of that name; the error decays `during` some times."""
    try:
        return _claims(maker, form, flow, numbers, name, during)
    except OverflowError:
        return nothing(maker, float(flow.theta), because("the numbers of a proof are beyond the range of doubles"))


def _claims(
    maker: str, form: Form, flow: Sought, numbers: Mapping[str, Any], name: str, during: str
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
