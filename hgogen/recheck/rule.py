"""A rule: how one question in one time model is verified against the certificate's own plant, form and observer.

A rule takes what has to be shown from the plant and the form, never from the claim: the claim adds bounds, a bisection
or a witness.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from .box import NotShown
from .chain import CARRIED, ON_CHAINS, structure
from .context import Context, Shown
from .file import Claim, FormFile

Verify = Callable[[Context, Claim], Shown]
Keys = tuple[str, ...]
STEEP: Keys = ("box", "bound", "tree")  # evidence of the bound of a slope
POINT: Keys = ("expression", "witness")
STRUCTURE = "{kind}.structure"  # the claim that a form is in chains


@dataclass(frozen=True)
class Rule:
    """Which claims it verifies, and how.

    `makers`: what a claim's id is before its dot, none for the form's kind; `facts`: what it is after that, without the
    numbers at its end, of which a kind of form has as many as `rows` says, none where that says nothing; `kinds`: the
    forms on which it holds, none for any; `keys`: what the evidence may have; `rests`: the ids of the claims that it
    rests on; `about`: what it is about, for its sentence. In these two {maker} and {kind}, the form's, are put in."""

    makers: Keys
    facts: Keys
    verify: Verify
    keys: Keys = ()
    kinds: Keys = ()
    rows: Mapping[str, int] = field(default_factory=dict, hash=False)
    verdict: str = "proved"
    rests: Keys = ()
    about: str = "the {kind} form"

    def takes(self, kind: str, claim: Claim) -> bool:
        """Whether it verifies a claim on a form of that kind."""
        rows = self.rows.get(kind, 0)
        fact, count = (claim.fact, len(claim.at)) if rows else (claim.what, 0)
        known = claim.maker in (self.makers or (kind,)) and fact in self.facts and count == rows
        return known and claim.verdict == self.verdict and (not self.kinds or kind in self.kinds)

    def needs(self, kind: str, claim: Claim) -> Keys:
        """The ids of the claims that a claim on a form of that kind rests on. Of a form that is carried to other
        coordinates the structure is no claim, but shown with each that rests on it."""
        return tuple(self.named(id, kind, claim) for id in self.rests if id != STRUCTURE or kind not in CARRIED)

    def named(self, text: str, kind: str, claim: Claim) -> str:
        """A text of it with the claim's maker and the form's kind put in."""
        return text.format(maker=claim.maker, kind=kind)

    def show(self, context: Context, claim: Claim) -> Shown:
        """What it shows of a claim that it takes. Raises: `NotShown`."""
        if STRUCTURE in self.rests and context.form.kind in CARRIED:
            observer = context.file.observer
            if observer is None or observer.name != claim.maker:
                raise NotShown("the file's observer is another")
            structure(context, claim)
        return self.verify(context, claim)


@dataclass(frozen=True)
class Needed:
    """What a certificate of a form cannot leave out, whatever the verdicts: the claim of its `structure`, and those
    `beside` it where that is proved."""

    structure: str
    beside: Callable[[FormFile], tuple[str, ...]] = lambda form: ()


def of_observer(makers: Keys, facts: Keys, verify: Verify, keys: Keys = (), *rests: str, kinds: Keys = ()) -> Rule:
    """The rule of claims about observers' numbers alone, on a form of any kind, or of these."""
    return Rule(makers, facts, verify, keys, kinds, rests=rests, about="the {maker} observer")


def on_chains(makers: Keys, facts: Keys, verify: Verify, keys: Keys = (), *rests: str) -> Rule:
    """The rule of claims about observers on a form in chains."""
    return of_observer(makers, facts, verify, keys, STRUCTURE, *rests, kinds=ON_CHAINS)
