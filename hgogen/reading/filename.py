"""The one rule for a name that becomes part of a path: of a model's file, a plant, a trial, a tuning.

It is one part of a path on every system: no separator, no "..", nothing that cannot be printed, no device of Windows.
"""

import re
import unicodedata
from typing import Any

from hgogen.errors import BadArgument

LONGEST = 100  # bytes in UTF-8: two of them and an ending fit the 255 that file systems take
_STRANGE = re.compile(r'[/\\:*?"<>|]')
_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)


class BadFileName(BadArgument):
    """A name, as it is shown, that cannot be part of a path."""

    text = "the name {what} {reason}; it becomes part of the names of files: take letters, digits, - and _"


def shown(name: Any) -> str:
    """A name in a sentence, quoted, the end of a long one left out."""
    return cut(repr(name))


def cut(text: str, most: int = 60) -> str:
    """A text in a sentence, the end of one of more than so many characters left out."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def fault(name: str) -> str:
    """Why a name cannot be part of a path; empty where it can."""
    if not name:
        return "is empty"
    if len(name.encode(errors="surrogatepass")) > LONGEST:
        return f"is longer than {LONGEST} bytes"
    if strange := next((c for c in name if not c.isprintable() or _STRANGE.match(c)), ""):
        return f"has {strange!r} in it"
    if name[0] in ".- ":
        return "begins with a dot, a hyphen or a space"
    if name[-1] in ". ":
        return "ends with a dot or a space"
    return "is that of a device on Windows" if _DEVICE.fullmatch(name) else ""


def demand(name: str) -> str:
    """The name. Raises: `BadFileName` where it cannot be part of a path."""
    if why := fault(name):
        raise BadFileName(shown(name), why)
    return name


def same(name: str) -> str:
    """Equal for names that some file system takes for one: those that differ in case, or in how accents are written."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())
