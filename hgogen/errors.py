"""The base of every error hgogen raises: a sentence that names the thing and the fix."""

import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from typing import ClassVar


class HgogenError(Exception):
    """The base class of errors. Each error is a dataclass in the file that raises it, and formats `text` with its
    fields.

    Such a dataclass is not frozen, because Python writes `__traceback__` and `__notes__` on exceptions. `status`: the
    exit status of a command, 2 for bad input, 1 for an answer that is no.
    """

    status: ClassVar[int] = 2
    text: ClassVar[str] = "{what} {reason}"

    def __str__(self) -> str:
        return self.text.format(self=self, **vars(self))


@dataclass(eq=False)
class BadArgument(HgogenError):
    """The base class of errors about an argument or input `what`, with the `reason` why it cannot be used."""

    what: str
    reason: str


class ReportedWarning(UserWarning):
    """The base class of warnings about samples that a command does not print, because its report states the same
    fact."""


def is_ignored(category: type[Warning]) -> bool:
    """Return whether the user's warning filters ignore warnings of a `category` everywhere."""
    rules = (action for action, text, kind, module, line in warnings.filters if issubclass(category, kind) and not text)
    return next(rules, "default") == "ignore"


def nearest(name: str, known: Iterable[str], otherwise: str) -> str:
    """Return the end of a message about an unknown name: a hint at the most similar known name, or `otherwise`."""
    close = get_close_matches(str(name)[:60], list(known), n=1)
    return f"did you mean {close[0]}?" if close else otherwise
