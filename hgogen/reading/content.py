"""The bytes of a file, up to a limit: no read is endless, in size or in time; the languages of plain-text models."""

import json
import os
import stat
import tomllib
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
    """A path of which the content was not read."""

    text = "{what}: {reason}"


def content_of(path: str | Path, most: int) -> bytes:
    """The content of a regular file, of `most` bytes at most. Raises: `Unread` where it is larger, is a folder, a pipe,
    a device or a socket, or is not there."""
    try:
        _demand_regular(path, os.stat(path))  # since opening a device may do something
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
    """Whether a file declares a plant, as far as it can be read: one with a fault in it may be meant to."""
    try:
        table = READERS[path.suffix](content_of(path, BYTES).decode("utf-8-sig"))
    except Unread:
        return False
    except (ValueError, RecursionError):
        return True
    return isinstance(table, dict) and any(isinstance(table.get(kind), dict) for kind in SIGNALS)
