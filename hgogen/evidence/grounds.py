"""What a claim stands on, as values that know their evidence: `evidence(form)` gives what a certificate holds of them.

Evidence is a mapping of exact values by name: numbers, expressions, texts, or lists and mappings of them. A value in it
that has evidence of its own stands for the names of that. It is None where a certificate cannot show the claim.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from hgogen.evidence.grammar import exactly
from hgogen.form import Form

Evidence = Mapping[str, Any]


@dataclass(frozen=True)
class ByForm:
    """The form itself, with its plant: the claim is verified of their equations alone."""

    def evidence(self, form: Form) -> Evidence:
        """No evidence beside the form."""
        return {}


@dataclass(frozen=True)
class Grounds:
    """What a claim about an observer stands on: the `numbers` by name that it is built with (numbers, expressions of
    parameters, sequences of them), and the `fact` that was established; None where it follows from another claim's."""

    numbers: Mapping[str, Any] = field(hash=False)
    fact: Any = field(hash=False)

    def evidence(self, form: Form) -> Evidence | None:
        """The evidence of the fact, None for a kind that has none; nothing where it follows from another claim's."""
        if self.fact is None:
            return {}
        return self.fact.evidence(form) if hasattr(self.fact, "evidence") else None


def texts(form: Form, value: Any) -> dict[str, Any] | None:
    """The evidence of a value as a certificate holds it, in texts; None where it, or what stands in it, has none."""
    parts = value.evidence(form)
    if parts is None:
        return None
    held: dict[str, Any] = {}
    for name, part in parts.items():
        inner = texts(form, part) if hasattr(part, "evidence") else {name: exactly(form, part)}
        if inner is None:
            return None
        held |= inner
    return held
