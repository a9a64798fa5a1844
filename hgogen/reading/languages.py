"""The languages of plain text in which a model may be written, by the ending of its file."""

import json
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from hgogen.reading.content import Unread, content_of

BYTES = 4_000_000  # of one model
SIGNALS = ("states", "inputs", "parameters", "outputs")  # the tables in which a model declares its plant


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
