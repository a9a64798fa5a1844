"""A rule: how one kind of claim is verified against the certificate's own plant, form and observer.

A rule takes what has to be shown from the plant and the form, never from the claim: the claim adds bounds, a bisection
or a witness.
"""

from collections.abc import Callable
from dataclasses import dataclass

from .context import Context, Shown
from .file import Claim, FormFile

Verify = Callable[[Context, Claim], Shown]
Keys = tuple[str, ...]
STEEP: Keys = ("box", "bound", "tree")  # evidence of the bound of a slope
POINT: Keys = ("expression", "witness")


@dataclass(frozen=True)
class Rule:
    """Which claims it verifies, and how.

    `maker`, `fact`: the claim's id before and after its dot, the latter without the `rows` numbers at its end; `kinds`:
    the forms on which it holds, none for any; `keys`: what the evidence may have; `rests`: the ids of the claims that
    it rests on; `about`: what it is about, for its sentence. In these two {maker} and {kind}, the form's, are put in.
    """

    maker: str
    fact: str
    verify: Verify
    keys: Keys = ()
    kinds: tuple[str, ...] = ()
    rows: int = 0
    verdict: str = "proved"
    rests: tuple[str, ...] = ()
    about: str = "the {kind} form"

    def takes(self, kind: str, claim: Claim) -> bool:
        """Whether it verifies a claim on a form of that kind."""
        if (self.maker, self.verdict) != (claim.maker, claim.verdict) or (self.kinds and kind not in self.kinds):
            return False
        return (claim.fact, len(claim.at)) == (self.fact, self.rows) if self.rows else claim.what == self.fact

    def named(self, text: str, kind: str) -> str:
        """A text of it with its maker and the form's kind put in."""
        return text.format(maker=self.maker, kind=kind)


@dataclass(frozen=True)
class Needed:
    """What a certificate of a form cannot leave out, whatever the verdicts: the claim of its `structure`, and those
    `beside` it where that is proved."""

    structure: str
    beside: Callable[[FormFile], tuple[str, ...]] = lambda form: ()


def of_observer(maker: str, fact: str, verify: Verify, keys: Keys = ()) -> Rule:
    """The rule of a claim about an observer's numbers alone, on a form of any kind."""
    return Rule(maker, fact, verify, keys, about="the {maker} observer")
