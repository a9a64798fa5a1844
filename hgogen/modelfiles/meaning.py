"""What a model file says it is, of which nothing is run."""

import ast
from pathlib import Path

from hgogen.modelfiles.place import PYTHON
from hgogen.reading.content import Unread, content_of
from hgogen.reading.languages import BYTES, READERS


def summary(path: str) -> str:
    """What a model file says it is, the first sentence of its docstring or `meaning`; empty where it says nothing or
    cannot be read. Nothing of the file is run."""
    suffix = Path(path).suffix
    try:
        text = content_of(path, BYTES)
        if suffix == PYTHON:
            meaning = ast.get_docstring(ast.parse(text)) or ""
        else:
            table = READERS[suffix](text.decode("utf-8-sig"))
            meaning = str(table.get("meaning", "")) if isinstance(table, dict) else ""
    except (Unread, ValueError, SyntaxError, RecursionError, MemoryError):  # `load` tells what is wrong with it
        return ""
    return " ".join(meaning.partition("\n\n")[0].split()).partition(". ")[0].removesuffix(".")
