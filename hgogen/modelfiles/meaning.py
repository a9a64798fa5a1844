"""What a model file says it is, of which nothing is run."""

import ast
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hgogen.modelfiles.place import PYTHON
from hgogen.reading.content import Unread, content_of
from hgogen.reading.languages import BYTES, READERS


def summary(path: str) -> str:
    """What a model file says it is, the first sentence of its docstring or `meaning`; empty where it says nothing or
    cannot be read. Nothing of the file is run."""
    try:
        meaning = _MEANINGS[Path(path).suffix](content_of(path, BYTES))
    except (Unread, ValueError, SyntaxError, RecursionError, MemoryError):  # `load` tells what is wrong with it
        return ""
    return " ".join(meaning.partition("\n\n")[0].split()).partition(". ")[0].removesuffix(".")


def _docstring(text: bytes) -> str:
    return ast.get_docstring(ast.parse(text)) or ""


def _meaning(reader: Callable[[str], Any]) -> Callable[[bytes], str]:
    def meaning(text: bytes) -> str:
        table = reader(text.decode("utf-8-sig"))
        return str(table.get("meaning", "")) if isinstance(table, dict) else ""

    return meaning


_MEANINGS = {PYTHON: _docstring, **{suffix: _meaning(reader) for suffix, reader in READERS.items()}}
