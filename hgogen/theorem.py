"""The theorem of an observer: its conclusion, its assumptions, and the verdict on each hypothesis.

An observer's case declares its theorem as data. A hypothesis is decided by checks of the form, the plant or the
observer, or by the construction of the observer. The others are about the plant in operation, and left to the user.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Annotated, NamedTuple

from hgogen.check import Check, ClaimId, Claims, Verdict, worst
from hgogen.sentence import NONE, Encoded, Reason, because, joined

YOURS = "left to you"
ANYWHERE = "from any initial state"


class Convergence(StrEnum):
    """The status of the convergence of an observer, from proved to unknown."""

    PROVED = "convergence proved in continuous time"
    ABOVE = "convergence proved in continuous time, for its theta"
    BELOW = "convergence proved in continuous time, for a larger theta only"
    UNKNOWN = "convergence unknown"


def convergence(observer: str, checks: Iterable[Check]) -> Convergence:
    """Return the status of an observer's convergence, from its own checks: that it converges for every large theta,
    that its theta is above the bound, and, for a switched gain, that it applies each gain for long enough. An observer
    without the second check needs the first only. If the second or the third is not proved, the status is BELOW."""
    known = {check.id.fact: check.verdict for check in checks if check.id.maker == observer}
    if known.get("convergence") is not Verdict.PROVED:
        return Convergence.UNKNOWN
    if "theta" not in known:
        return Convergence.PROVED
    enough = {known["theta"], known.get("hold", Verdict.PROVED)} == {Verdict.PROVED}
    return Convergence.ABOVE if enough else Convergence.BELOW


class Beyond(NamedTuple):
    """A stronger proof than the theorem, about the discretised observer: the `claims` that it decides, and `reason`,
    its subject."""

    claims: Claims
    reason: str


@dataclass(frozen=True)
class Hypothesis:
    """A hypothesis of a theorem.

    `claim`: a sentence; `checks`: the claims that decide it; `verdict`: the verdict without a check, by construction,
    None where only the user can know; `reason`: how it was reached, or what the user has to ensure, or what the checks
    do not cover, a constant text; `reference`: the place in the paper. With `optional`, it is dropped where no check
    makes such a claim. `beyond`: a proof of the step that makes it needless, or shows when it holds, and whose reason
    then replaces the other.
    """

    claim: str
    checks: tuple[Claims, ...] = ()
    verdict: Verdict | None = None
    reason: str = ""
    reference: str = ""
    optional: bool = False
    beyond: Beyond | None = None


@dataclass(frozen=True)
class Theorem:
    """A theorem about an observer: `conclusion`, under the `hypotheses`; `reference`: the paper and its number."""

    conclusion: Annotated[str, "what the theorem concludes"]
    hypotheses: tuple[Hypothesis, ...]
    reference: Annotated[str, "the paper and its number"]

    def under(self, *more: Hypothesis, start: str = ANYWHERE) -> "Theorem":
        """Return the theorem with further hypotheses; `start`: the set of initial states for which it then holds, by
        default any."""
        conclusion = self.conclusion.replace(ANYWHERE, start)
        return replace(self, conclusion=conclusion, hypotheses=(*self.hypotheses, *more))

    def with_chains(self) -> "Theorem":
        """Return the theorem for several outputs: its hypotheses about one chain are about one chain for each
        output."""
        instead = dict(zip(FORM, CHAINS, strict=False))
        return replace(self, hypotheses=tuple(instead.get(each, each) for each in self.hypotheses))


@dataclass(frozen=True)
class Row(Encoded):
    """A hypothesis of a theorem with its `verdict`, None where it is left to the user."""

    json_keys = "claim verdict=standing reason reason_data=reason.as_dict checks reference"

    claim: Annotated[str, "the hypothesis"]
    verdict: Verdict | None
    reason: Annotated[Reason, "how the verdict was reached, or what the user should see to"]
    checks: Annotated[tuple[ClaimId, ...], "the ids of the checks behind it"]
    reference: Annotated[str, "where the theorem says so"]

    @property
    def standing(self) -> str:
        """The verdict as text, or "left to you" where only the user can know."""
        return YOURS if self.verdict is None else str(self.verdict)


def rows(theorem: Theorem, checks: Iterable[Check]) -> tuple[Row, ...]:
    """Return the theorem's hypotheses, each with the worst verdict of the checks that decide it; a hypothesis without
    such a check is unknown."""
    known = tuple(checks)
    result = []
    for hypothesis in theorem.hypotheses:
        row, beyond = _row(hypothesis, known), hypothesis.beyond
        if row is None:
            continue
        if beyond is not None:  # a proof about the step replaces the advice on trials and status
            ids = [check.id for check in known if check.verdict is Verdict.PROVED and check.id in beyond.claims]
            row = replace(row, reason=because(beyond.reason), checks=(*row.checks, *ids)) if ids else row
        result.append(row)
    return tuple(result)


def _row(hypothesis: Hypothesis, known: Iterable[Check]) -> Row | None:
    deciding = [check for check in known if any(check.id in claims for claims in hypothesis.checks)]
    verdict, reason = hypothesis.verdict, because(hypothesis.reason)
    if deciding:
        least = worst(deciding)  # a hypothesis is as good as the worst of its checks
        single = len(deciding) == 1 or least.verdict is Verdict.PROVED
        worst_check = NONE if single else because("{verdict}: {check}", verdict=least.verdict, check=least.id)
        verdict, reason = least.verdict, joined(worst_check, reason)
    elif hypothesis.optional:
        return None
    elif hypothesis.checks:
        verdict, reason = Verdict.UNKNOWN, because("the form makes no such check")
    return Row(hypothesis.claim, verdict, reason, tuple(check.id for check in deciding), hypothesis.reference)


# Hypotheses that theorems on form (3) of Boizot, Busvelle, Gauthier 2010 have in common.

LIPSCHITZ = Hypothesis(
    "b is Lipschitz in the state, uniformly in the input", (Claims(fact="lipschitz"),), reference="section 2.2"
)
FORM = (
    Hypothesis(
        "z_i' = a_(i+1) z_(i+1) + b_i(z_1, .., z_i, u), y = a_1 z_1, up to a known offset",
        (
            *(Claims("triangular", "structure"), Claims("triangular", "offset")),
            *(Claims("phase", "chain"), Claims("uniform_chain", "structure")),
        ),
        reference="(3)",
    ),
    Hypothesis(
        "0 < a_m <= a_i <= a_M for every input and parameter in its range",
        (Claims("triangular", "a"), Claims("phase", "chain"), Claims("uniform_chain", "structure")),
        reference="(3)",
    ),
    LIPSCHITZ,
    Hypothesis(
        "Phi = (y, y', .., y^(n-1)) is a change of coordinates, with the derivatives of inputs in their ranges",
        (Claims("phase", "rank"), Claims("phase", "inverse"), Claims("phase", "inputs")),
        optional=True,
    ),
    Hypothesis(
        "xi is a change of coordinates, with u' in its range",
        tuple(Claims("uniform_chain", fact) for fact in ("slope", "smooth", "inputs")),
        optional=True,
    ),
    Hypothesis("z is a change of coordinates, and its ranges hold the plant's", (Claims("recast"),), optional=True),
)
CHAINS = (  # in place of the first two where each output has its chain
    Hypothesis(
        "z_(i,j)' = a_(i,j+1) z_(i,j+1) + b_(i,j), y_i = a_(i,1) z_(i,1), up to a known offset",
        (Claims("block_triangular", "structure"), Claims("block_triangular", "offset")),
        reference="(3), chain by chain",
    ),
    Hypothesis(
        "0 < a_m <= a_(i,j) <= a_M for every input and parameter in its range",
        (Claims("block_triangular", "a"),),
        reference="(3), chain by chain",
    ),
)
OPERATION = (
    Hypothesis(
        "the plant's state stays in its declared ranges",
        reason="outside of them the model is evaluated at their edge (status OUTSIDE_BOX tells of the estimate only)",
    ),
    Hypothesis(
        "the input is measured and stays in its declared range",
        reason="beyond it the observer takes the range's end (status CLAMPED_ and its name)",
    ),
    Hypothesis(
        "the model is exact: its parameters are the plant's and constant, no state jumps",
        reason="after a jump the theorem starts again",
        beyond=Beyond(
            Claims(fact="error"),
            "bounds what disturbances and parameters within their tolerances do to the step as it runs",
        ),
    ),
    Hypothesis(
        "y is measured without noise",
        reason="noise leaves an error that trials measure",
        beyond=Beyond(Claims(fact="noise"), "bounds what it does to the step as it runs"),
    ),
    Hypothesis(
        "y and the input are known at all times",
        verdict=Verdict.UNKNOWN,
        reason="a step takes samples of them: the theorem is of continuous time, and trials measure the difference",
        beyond=Beyond(Claims(fact="step"), "is of the samples that the step takes"),
    ),
    Hypothesis(
        "the gains have their declared values",
        reason="each can be tuned within its range, and what is known here is known of the declared value",
        beyond=Beyond(Claims(fact="tuned"), "is of a whole range"),
    ),
    Hypothesis(
        "the estimate does not touch its outer box",
        reason="watch the status STATE_LIMITED, which suspends the theorem",
        beyond=Beyond(Claims(fact="start"), "shows from which first errors it does not"),
    ),
    Hypothesis(
        "no projection onto the ranges and no restart from a sample: the estimate is not out of its ranges, nor its "
        "output far from y, for as long as the law of recovery waits (each fault count stays below its limit, in the "
        "state)",
        reason="watch the status PROJECTED_ONTO_RANGES and RESTARTED_FROM_SAMPLE; after one the theorem starts again",
    ),
)
HURWITZ = Hypothesis(
    "A - K C is Hurwitz", verdict=Verdict.PROVED, reason="by exact test or its poles; others are refused"
)


def large_theta(observer: str) -> Hypothesis:
    """Return the hypothesis that theta exceeds the bound that the check `OBSERVER.theta` proves."""
    reason = "of its declared value; it can be tuned down to 1"
    return Hypothesis("theta is large enough", (Claims(observer, "theta"),), reason=reason)
