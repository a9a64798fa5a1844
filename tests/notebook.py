"""`python tests/notebook.py` writes docs/whole_way.ipynb from docs/whole_way.md: the page is the source, its code the
cells."""

import json
import re
from typing import Any

from pages import PAGES, text

PAGE = "whole_way"
NOTEBOOK = PAGES[PAGE].with_suffix(".ipynb")


def cells(page: str) -> list[tuple[str, str]]:
    """The kind, "markdown" or "code", and the text of each part of a page."""
    parts = re.split(r"^```python\n(.*?)^```\n", page, flags=re.MULTILINE | re.DOTALL)
    kinds = ("markdown", "code")
    return [(kinds[k % 2], part.strip("\n")) for k, part in enumerate(parts) if part.strip()]


def notebook(page: str) -> str:
    """The notebook of a page, in version 4.5 of the format, without outputs."""
    made: list[dict[str, Any]] = []
    for k, (kind, source) in enumerate(cells(page)):
        cell: dict[str, Any] = {"cell_type": kind, "id": f"part-{k}", "metadata": {}}
        cell |= {"execution_count": None, "outputs": []} if kind == "code" else {}
        made.append({**cell, "source": source.splitlines(keepends=True)})
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    whole = {"cells": made, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(whole, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    NOTEBOOK.write_text(notebook(text(PAGE)), encoding="utf-8")
    print(f"wrote {NOTEBOOK}")
