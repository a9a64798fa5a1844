"""Files that the user names: their content up to a limit, and the names that become part of a path.

Such a name, of a model's file, a plant, a trial or a tuning, is one part of a path on every system: no separator, no
"..", nothing that cannot be printed, no device of Windows."""

import json
import os
import re
import stat
import tomllib
import unicodedata
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from hgogen.errors import BadArgument

KINDS = {
    stat.S_IFLNK: "a link",
    stat.S_IFDIR: "a folder",
    stat.S_IFREG: "a file",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
BYTES = 4_000_000  # of one model
SIGNALS = ("states", "inputs", "parameters", "outputs")  # the tables in which a model declares its plant


class Unread(BadArgument):
    """The error that the content of a path cannot be read, or is refused."""

    text = "{what}: {reason}"


def content_of(path: str | Path, most: int) -> bytes:
    """Return the content of a regular file of at most `most` bytes. Raises: `Unread` for a larger or missing file, a
    folder, a pipe, a device or a socket."""
    try:
        _demand_regular(path, os.stat(path))  # before opening: to open a device may have effects
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with open(handle, "rb") as stream:
            _demand_regular(path, os.fstat(handle))
            content = stream.read(most + 1)
    except FileNotFoundError:
        raise Unread(str(path), "there is no such file") from None
    except ValueError:  # a null byte
        raise Unread(str(path), "is no path") from None
    except OSError as error:
        raise Unread(str(path), f"cannot be read: {error.strerror}") from None
    if len(content) > most:
        raise Unread(str(path), f"is larger than {most} bytes; give a smaller file")
    return content


def _demand_regular(path: str | Path, status: os.stat_result) -> None:
    kind = stat.S_IFMT(status.st_mode)
    if kind == stat.S_IFDIR:
        raise Unread(str(path), "is a folder; give a file in it")
    if kind != stat.S_IFREG:
        reason = f"is {KINDS.get(kind, 'no file')}, whose content may have no end; write it to a file, and give that"
        raise Unread(str(path), reason)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"the key {next(name for name in names if names.count(name) > 1)!r} stands twice in one table")
    return table


def _no_constant(name: str) -> None:
    raise ValueError(f"{name} is no finite number")


READERS: dict[str, Callable[[str], Any]] = {
    ".toml": tomllib.loads,
    ".json": partial(json.loads, object_pairs_hook=_once, parse_constant=_no_constant),
}


def declares(path: Path) -> bool:
    """Return whether a TOML or JSON file declares a plant; a file with a syntax error counts as one, since it may be
    intended."""
    try:
        table = READERS[path.suffix](content_of(path, BYTES).decode("utf-8-sig"))
    except Unread:
        return False
    except (ValueError, RecursionError):
        return True
    return isinstance(table, dict) and any(isinstance(table.get(kind), dict) for kind in SIGNALS)


# ---------------------------------------------------------------- filename


LONGEST = 100  # bytes in UTF-8: two names and a suffix fit the 255 bytes of file systems
_STRANGE = re.compile(r'[/\\:*?"<>|]')
_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)


class BadFileName(BadArgument):
    """The error that a name cannot be part of a path."""

    text = "the name {what} {reason}; it becomes part of the names of files: take letters, digits, - and _"


def quoted(name: Any) -> str:
    """Return a value as text for a message, in quotes and shortened to 60 characters."""
    return cut(repr(name))


def cut(text: str, most: int = 60) -> str:
    """Return a text shortened to `most` characters, for a message."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def file_name_fault(name: str) -> str:
    """Return the reason why a name cannot be part of a path, "" if it can."""
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


def demand_file_name(name: str) -> str:
    """Return the name unchanged if it can be part of a path. Raises: `BadFileName` if not."""
    if why := file_name_fault(name):
        raise BadFileName(quoted(name), why)
    return name


def name_key(name: str) -> str:
    """Return a key of a file name, equal for names that differ only in case, or in the encoding of accents."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())
