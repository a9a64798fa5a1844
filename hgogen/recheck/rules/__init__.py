"""The rules by which claims are verified; each file of this folder has those of one kind of claim, as `RULES`.

A file may have `OBSERVERS`, what the observers that it knows are built with, and `NEEDED`, what a certificate of a kind
of form cannot leave out.
"""

from collections.abc import Mapping
from importlib import import_module
from pkgutil import iter_modules

from ..file import Built, Certificate, Claim
from ..gathering import merged, rules_of
from ..rule import Needed, Rule

_FILES = [import_module(f"{__name__}.{each.name}") for each in iter_modules(__path__)]
RULES: tuple[Rule, ...] = rules_of(_FILES)
OBSERVERS: Mapping[str, Built] = merged(_FILES, "OBSERVERS")
NEEDED: Mapping[str, Needed] = merged(_FILES, "NEEDED")
FORMS = frozenset((*NEEDED, *(kind for rule in RULES for kind in rule.kinds)))  # of which a rule says something


def rule_of(kind: str, claim: Claim) -> Rule | None:
    """The rule of a claim on a form of that kind; None where no rule verifies it."""
    return next((rule for rule in RULES if rule.takes(kind, claim)), None)


def rests(certificate: Certificate, claim: Claim) -> tuple[str, ...]:
    """The ids of the claims that this one rests on; any claim of a form rests on those of its coordinates."""
    kind, rule = certificate.form.kind, rule_of(certificate.form.kind, claim)
    own = rule.needs(kind, claim) if rule else ()
    coordinates = (other.id for other in certificate.claims if other.maker == "recast")
    return (*own, *(() if claim.maker == "recast" else coordinates))


def required(certificate: Certificate) -> tuple[str, ...]:
    """The ids of the claims that a certificate of this form cannot leave out, whatever their verdicts."""
    needed = NEEDED.get(certificate.form.kind)
    if needed is None:
        return ()
    known = certificate.claim(needed.structure)
    beside = needed.beside(certificate.form) if known is not None and known.verdict == "proved" else ()
    return (needed.structure, *beside)
