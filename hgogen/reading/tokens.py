"""The words of an expression: numbers, names and signs, each with its column."""

import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from hgogen.errors import HgogenError

_TOKEN = re.compile(
    r"""\s*(?:(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)
    |(?P<name>[A-Za-z_][A-Za-z0-9_]*)
    |(?P<sign>\*\*|<=|>=|[-+*/(),<>&|])
    |(?P<end>\Z)
    |(?P<other>.))""",
    re.VERBOSE | re.ASCII | re.DOTALL,
)
_FIXES = {
    "^": "write ** for a power",
    ".": "a dot belongs in a number only; write * for a product",
    "=": "an expression has no =; inside Piecewise compare with < <= > >=",
    "!": "conditions know < <= > >= & | only",
    "~": "conditions know < <= > >= & | only",
    "[": "write parentheses ( )",
    "]": "write parentheses ( )",
    "{": "write parentheses ( )",
    "}": "write parentheses ( )",
    "'": "text is no value; write numbers and declared names",
    '"': "text is no value; write numbers and declared names",
    "\x00": "remove the NUL character",
}


@dataclass(eq=False)
class BadExpression(HgogenError):
    """A text outside the grammar, or without a finite real value; `column` counts from 1."""

    text: str
    column: int
    reason: str

    def __str__(self) -> str:
        start = max(0, min(self.column - 1, len(self.text)) - 30)
        shown = repr(self.text[start : start + 60])
        head, tail = "..." if start else "", "..." if start + 60 < len(self.text) else ""
        return f"expression {head}{shown}{tail}, column {self.column}: {self.reason}"


class Token(NamedTuple):
    """`kind`: number, name, sign, or end; `column` counts from 1."""

    kind: str
    text: str
    column: int


def tokens(text: str) -> Iterator[Token]:
    """The tokens of a text, the last of the kind "end".

    Raises: `BadExpression` for a character outside the grammar.
    """
    for match in _TOKEN.finditer(text):
        kind = str(match.lastgroup)
        token = Token(kind, match[kind], match.start(kind) + 1)
        if kind == "other":
            reason = f"{token.text!r} is not in the grammar; {_FIXES.get(token.text, 'remove it')}"
            if not token.text.isascii():
                name = unicodedata.name(token.text, "without a name")
                reason = f"{token.text!a} ({name}) is not in the grammar; write ASCII letters, digits and signs"
            raise BadExpression(text, token.column, reason)
        yield token
        if kind == "end":
            return
