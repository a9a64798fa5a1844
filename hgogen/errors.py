"""The base of every error hgogen raises: a sentence that names the thing and the fix."""

from dataclasses import dataclass


class HgogenError(Exception):
    """Base class; each error is a dataclass beside the code that raises it, its text in `__str__`.

    Not a frozen one: Python itself writes `__traceback__` and `__notes__` on exceptions.
    """


@dataclass(eq=False)
class BadArgument(HgogenError):
    """What was given, and what is wrong with it."""

    what: str
    reason: str

    def __str__(self) -> str:
        return f"{self.what} {self.reason}"
