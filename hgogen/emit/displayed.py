"""Markdown: words in which it reads no mark, tables, and equations that are displayed."""

# Takes apart: words, in which Markdown would read marks of its own.

import re
from collections.abc import Iterable, Sequence

from hgogen.emit.formula import formulas

_MARKS = re.compile(r"[\\`*_{}\[\]<>|#$~]")


def plain(text: str) -> str:
    """Words in which Markdown reads no mark."""
    return _MARKS.sub(lambda mark: f"\\{mark[0]}", " ".join(text.splitlines()))


def displayed(lines: Iterable[str]) -> list[str]:
    """Each equation of lines by itself."""
    return [text for line in lines for formula in formulas(line) for text in ("$$", formula, "$$", "")]


def aligned(equations: Sequence[str]) -> list[str]:
    """Equations below each other."""
    rows = [f"{line} \\\\" for line in equations[:-1]] + list(equations[-1:])
    return ["$$", r"\begin{aligned}", *rows, r"\end{aligned}", "$$", ""]


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A table of cells that are Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return [f"| {' | '.join(line)} |" for line in lines]
