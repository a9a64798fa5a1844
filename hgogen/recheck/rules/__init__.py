"""The rules by which claims are verified; each file of this folder has those of one kind of claim, as `RULES`.

A file may have `OBSERVERS`, the parts of its observers, and `NEEDED`, the claims that a certificate of a kind of form
requires. Their keys are unique across files.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType
from typing import Any

from ..context import Needed, Rule
from ..file import Certificate, Claim, ObserverKeys
from ..text import RecheckError


@dataclass(eq=False)
class BadRules(RecheckError):
    """The error that a file of rules has none, or a key that another file has too."""

    file: str
    reason: str

    def __str__(self) -> str:
        return f"{self.file.rpartition('.')[2]}.py in the folder of rules {self.reason}"


def rules_of(files: Iterable[ModuleType]) -> tuple[Rule, ...]:
    """Return the rules of all `files`. Raises: `BadRules` for a file without rules."""
    every: list[Rule] = []
    for file in files:
        rules = getattr(file, "RULES", None)
        if not isinstance(rules, tuple) or not all(isinstance(rule, Rule) for rule in rules):
            raise BadRules(file.__name__, "has no RULES, a tuple of Rule: what its claims are verified by")
        every += rules
    return tuple(every)


def merged(files: Iterable[ModuleType], key: str) -> Mapping[str, Any]:
    """Return the union of the mappings that the `files` define under the name `key`. Raises: `BadRules` for an entry in
    two files."""
    rows: dict[str, Any] = {}
    where: dict[str, str] = {}
    for file in files:
        for name, row in getattr(file, key, {}).items():
            if name in rows:
                other = where[name].rpartition(".")[2]
                raise BadRules(file.__name__, f"has a row {name!r} in {key}, as {other}.py has; keep one of the two")
            rows[name], where[name] = row, file.__name__
    return rows


_FILES = [import_module(f"{__name__}.{each.name}") for each in iter_modules(__path__)]
RULES: tuple[Rule, ...] = rules_of(_FILES)
OBSERVERS: Mapping[str, ObserverKeys] = merged(_FILES, "OBSERVERS")
NEEDED: Mapping[str, Needed] = merged(_FILES, "NEEDED")
FORMS = frozenset((*NEEDED, *(kind for rule in RULES for kind in rule.kinds)))  # kinds of form with a rule


def rule_of(kind: str, claim: Claim) -> Rule | None:
    """Return the rule that verifies a claim on this kind of form, or None."""
    return next((rule for rule in RULES if rule.accepts(kind, claim)), None)


def assumed_claims(certificate: Certificate, claim: Claim) -> tuple[str, ...]:
    """Return the ids of the claims that a claim assumes; a claim about a form assumes the claims about the form's
    coordinates."""
    kind, rule = certificate.form.kind, rule_of(certificate.form.kind, claim)
    named = rule.needs(kind, claim, any(certificate.plant.periods)) if rule else ()
    coordinates = (other.id for other in certificate.claims if other.maker == "recast")
    return (*named, *(() if claim.maker == "recast" else coordinates))


def required(certificate: Certificate) -> tuple[str, ...]:
    """Return the ids of the claims that a certificate of this form requires, whatever their verdicts."""
    needed = NEEDED.get(certificate.form.kind)
    if needed is None:
        return ()
    known = certificate.claim(needed.structure)
    others = needed.others(certificate.form) if known is not None and known.verdict == "proved" else ()
    return (needed.structure, *others)
