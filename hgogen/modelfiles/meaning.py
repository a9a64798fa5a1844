"""What a model file says it is, of which nothing is run."""

import ast
import tokenize
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hgogen.modelfiles.place import PYTHON
from hgogen.reading.languages import READERS


def summary(path: str) -> str:
    """What a model file says it is, the first sentence of its docstring or `meaning`; empty where it says nothing or
    cannot be read. Nothing of the file is run."""
    try:
        with tokenize.open(path) as stream:
            meaning = _MEANINGS[Path(path).suffix](stream.read())
    except (OSError, ValueError, SyntaxError, RecursionError):  # `load` tells what is wrong with it
        return ""
    return " ".join(meaning.partition("\n\n")[0].split()).partition(". ")[0].removesuffix(".")


def _docstring(text: str) -> str:
    return ast.get_docstring(ast.parse(text)) or ""


def _meaning(reader: Callable[[str], Any]) -> Callable[[str], str]:
    def meaning(text: str) -> str:
        table = reader(text)
        return str(table.get("meaning", "")) if isinstance(table, dict) else ""

    return meaning


_MEANINGS = {PYTHON: _docstring, **{suffix: _meaning(reader) for suffix, reader in READERS.items()}}
