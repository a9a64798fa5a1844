"""Verdicts of claims: a mathematical failure is a value, not an exception.

`proved` needs exact or outward-rounded arithmetic; `refuted` carries a witness; `where` holds under a condition;
`generic` holds outside a set of measure zero; `unknown` means that no proof and no witness was found.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Any, ClassVar, Self

from hgogen.errors import HgogenError, nearest
from hgogen.registry import Displayed
from hgogen.sentence import Encoded, Reason, Sentence, because

ELSEWHERE = "hgogen check MODEL tells which forms it is in, and the form original is for any plant with finite slopes."


class Verdict(StrEnum):
    """A verdict on a claim: proved, refuted, true under a condition (`where`), true outside a set of measure zero
    (`generic`), or unknown."""

    PROVED = "proved"
    REFUTED = "refuted"
    WHERE = "where"
    GENERIC = "generic"
    UNKNOWN = "unknown"


class ClaimId(str):
    """The identifier of a claim, a text such as "triangular.a_3" of ("triangular", "a", 3).

    `maker`: the form, observer or question that makes the claim, "" for a name by the user; `fact`: the subject of the
    claim; `at`: the indices of a repeated fact, the chain before the state; `unqualified`: the text without the maker.
    The text is never parsed.
    """

    maker: str
    fact: str
    at: tuple[int, ...]
    unqualified: str

    def __new__(cls, maker: str, fact: str, *at: int) -> Self:
        unqualified = "_".join([fact, *map(str, at)])
        claim = super().__new__(cls, f"{maker}.{unqualified}" if maker else unqualified)
        claim.maker, claim.fact, claim.at, claim.unqualified = maker, fact, at, unqualified
        return claim

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.maker, self.fact, *self.at)


@dataclass(frozen=True)
class Claims:
    """The set of all claims by `maker` about `fact`, where "" matches any; a claim with a user's own name is in no such
    set."""

    maker: str = ""
    fact: str = ""

    def __contains__(self, id: ClaimId) -> bool:
        return bool(id.maker) and self.maker in ("", id.maker) and self.fact in ("", id.fact)


@dataclass(frozen=True)
class Check(Encoded, Displayed):
    """A claim with its verdict.

    `fix`: the user's remedy; `consequence`: what follows where a refuted claim is accepted; `proofs`: the proofs, and
    `disproof`: the refutation, values whose evidence a certificate holds (`analysis.evidence`); `subject`: the
    expression of the claim, such as a_i, if it has one.
    """

    json_keys = "id claim verdict reason reason_data=reason.as_dict witness fix=advice"

    id: Annotated[ClaimId, "stable name of the claim, for `accept`"]
    claim: Annotated[Sentence | str, "the claim, a sentence where expressions enter it"]
    verdict: Annotated[Verdict, "what is known of the claim"]
    reason: Annotated[Reason, "how the verdict was reached"]
    witness: Annotated[Mapping[str, float], "the point that refutes it"] = field(default_factory=dict, hash=False)
    fix: str = ""
    consequence: str = ""
    proofs: tuple[Any, ...] = field(default=(), compare=False, repr=False)
    disproof: Any = field(default=None, compare=False, repr=False)
    subject: Any = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        """Convert texts of a user's own check: its id to a claim without a maker, its reason to a reason without
        values."""
        if not isinstance(self.id, ClaimId):
            object.__setattr__(self, "id", ClaimId("", self.id))
        if not isinstance(self.reason, Reason):
            object.__setattr__(self, "reason", because("{text}", text=self.reason))

    @property
    def advice(self) -> str:
        """Advice to a user on a claim that is not proved, such as to accept it; "" where nothing can be advised."""
        if not self.consequence:
            return self.fix
        return f"{self.fix} Or accept {self.id}, knowing that {self.consequence}."

    @property
    def sentence(self) -> str:
        """The claim and the reason, without the verdict."""
        at = ", ".join(f"{name} = {value:g}" for name, value in self.witness.items())
        return f"{self.id}: {self.claim} ({self.reason}{'; at ' + at if at else ''})"

    def __str__(self) -> str:
        return f"{self.verdict:8} {self.sentence}"


@dataclass(eq=False)
class Refuted(HgogenError):
    """The error for an observer on a form of which a hypothesis is refuted, and the user does not accept it.

    `checks`: the refuted ones; `form`: the refused form with all its checks, if there is one; `accepted`: the accepted
    ids; `where`: the file and the key of the request; `plain`: whether that file is plain text; `other`: an observer or
    form that applies to the plant without accepting anything; `never`: why the observer cannot be built even if the
    refuted checks are accepted.
    """

    status: ClassVar[int] = 1
    checks: tuple[Check, ...]
    form: Any = None
    accepted: tuple[str, ...] = ()
    where: str = ""
    plain: bool = False
    other: str = ""
    never: str = ""

    def __str__(self) -> str:
        head = f"{self.where}: refuted" if self.where else "refuted"
        sentences = [f"{head}: {'; '.join(check.sentence for check in self.checks)}."]
        sentences += dict.fromkeys(check.fix for check in self.checks)
        # a form does not know which other forms apply
        elsewhere = ELSEWHERE if self.form is not None and not self.form.structured else ""
        ids = tuple(check.id for check in self.checks)
        option = f"accept = {json.dumps(ids)}" if self.plain else f"accept={ids!r}"  # in the syntax of the model's file
        known = "; ".join(dict.fromkeys(check.consequence for check in self.checks if check.consequence))
        offer = f"To build all the same, say {option}{f', knowing that {known}.' if known else ''}"
        sentences += [elsewhere, self.other, self.never or offer]
        return " ".join(filter(None, sentences))


@dataclass(eq=False)
class UnknownCheck(HgogenError):
    """The error for a name in `accept=` that is the id of no check."""

    id: str
    fix: str
    text = "accept names {id!r}, which is no check here; {fix}"


_FROM_WORST = (Verdict.REFUTED, Verdict.UNKNOWN, Verdict.WHERE, Verdict.GENERIC, Verdict.PROVED)


def worst(checks: Iterable[Check]) -> Check:
    """Return the check with the worst verdict, the first of equals; its verdict is the verdict on all claims
    together."""
    return min(checks, key=lambda check: _FROM_WORST.index(check.verdict))


def refuted(checks: Iterable[Check], accept: Iterable[str] = (), later: Iterable[ClaimId] = ()) -> tuple[Check, ...]:
    """Return the refuted checks whose ids are not in `accept`. `accept` may also name the claims `later`, which are
    checked after this call. Raises: `UnknownCheck` for any other name in it."""
    checks, accept = tuple(checks), (accept,) if isinstance(accept, str) else tuple(accept)
    known = (*(check.id for check in checks), *later)
    for name in accept:
        if not (isinstance(name, str) and name in known):
            raise UnknownCheck(str(name), nearest(str(name), known, f"the checks are {', '.join(known)}"))
    return tuple(check for check in checks if check.verdict is Verdict.REFUTED and check.id not in accept)


def demand(
    checks: Iterable[Check], accept: Iterable[str] = (), form: Any = None, later: Iterable[ClaimId] = ()
) -> None:
    """Raise `Refuted` if one of the `checks` of the `form` is refuted and not in `accept`, which may also name the
    claims `later`, which are checked after this call. Other verdicts do not stop building."""
    accept = (accept,) if isinstance(accept, str) else tuple(accept)
    unaccepted = refuted(checks, accept, later)
    if unaccepted:
        raise Refuted(unaccepted, form, accept)
