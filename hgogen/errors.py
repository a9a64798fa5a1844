"""The base of every error hgogen raises: a sentence that names the thing and the fix."""

from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from typing import ClassVar


class HgogenError(Exception):
    """Base class; each error is a dataclass beside the code that raises it, its sentence made of its fields by `text`.

    Not a frozen one: Python itself writes `__traceback__` and `__notes__` on exceptions. `status`: with which a command
    ends, 2 for bad input, 1 for an answer that is no.
    """

    status: ClassVar[int] = 2
    text: ClassVar[str] = "{what} {reason}"

    def __str__(self) -> str:
        return self.text.format(self=self, **vars(self))


@dataclass(eq=False)
class BadArgument(HgogenError):
    """An error that says what was given, and what is wrong with it."""

    what: str
    reason: str


def nearest(name: str, known: Iterable[str], otherwise: str) -> str:
    """The end of a sentence on an unknown name: the known name that is nearest to it, or `otherwise`."""
    close = get_close_matches(str(name)[:60], list(known), n=1)
    return f"did you mean {close[0]}?" if close else otherwise
