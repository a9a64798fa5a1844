"""A claim in one line for the head of emitted code: its verdict, its id, and the number that its reason begins with."""

from collections.abc import Container
from numbers import Real
from typing import Any

import sympy as sp

from hgogen.check import Check, Verdict
from hgogen.intervals.digits import Down, Up
from hgogen.sentence import Sentence
from hgogen.step import Step


def document_name(step: Step) -> str:
    """The file that says what the head of the code leaves out: hypotheses, evidence, equations."""
    return f"{step.name}.md"


def in_short(check: Check, accepted: Container[str]) -> str:
    """The line; of a refuted claim that was accepted with what follows."""
    at = ", ".join(f"{name} = {value:g}" for name, value in check.witness.items())
    parts = [_clause(str(check.reason)) if _has_number(check.reason) else "", f"at {at}" if at else ""]
    taken = refuted_and_accepted(check, accepted)
    parts.append(f"so {consequence(check)}" if taken else "")
    said = "; ".join(filter(None, parts))
    return f"{verdict(check, accepted)}: {check.id}{f': {said}' if said else ''}"


def verdict(check: Check, accepted: Container[str]) -> str:
    """The verdict, and whether it was accepted."""
    return f"{check.verdict}{' (accepted by the user)' if refuted_and_accepted(check, accepted) else ''}"


def refuted_and_accepted(check: Check, accepted: Container[str]) -> bool:
    """Whether a user took a refuted claim on."""
    return check.id in accepted and check.verdict is Verdict.REFUTED


def consequence(check: Check) -> str:
    """What follows for him."""
    return check.consequence or "no convergence theorem is in force"


def _has_number(value: Any) -> bool:
    """Whether a sentence names a number, or a sentence in it does."""
    if isinstance(value, Sentence):
        return any(_has_number(each) for name, each in value.values if name != "boxes")  # of a search
    if isinstance(value, tuple):
        return any(map(_has_number, value))
    return isinstance(value, Real | Up | Down) or (isinstance(value, sp.Expr) and value.is_number)


def _clause(text: str) -> str:
    """A sentence up to its first comma or semicolon outside of parentheses."""
    depth = 0
    for k, sign in enumerate(text):
        depth += {"(": 1, ")": -1}.get(sign, 0)
        if sign in ",;" and depth == 0:
            return text[:k]
    return text
