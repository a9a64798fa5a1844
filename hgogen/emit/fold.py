"""The files that a language makes of a step, of lines no wider than 110 columns: comments are filled, code is broken
where it nests least.
"""

# Takes apart: finished text, whose long lines it breaks.

import re
import textwrap
from collections.abc import Iterable, Mapping
from itertools import pairwise

from hgogen.emit.naming import renamed, says
from hgogen.emit.syntax import Syntax
from hgogen.step import Step
from hgogen.target import Recipe, Sources

COLUMNS = 110
_GLUE = "\0"  # a blank at which no line is broken
_MARKS = ("* ", "// ", "/// ", "//! ")  # inside a comment, or of one that ends with the line
_BREAK = re.compile(r"(?<=, )|(?<=\)[*/])(?=\()| (?=(?:[-+?:]|&&|\|\||else \{) )|(?<!else) (?=\{ )|(?<= = )(?=&)")
_LIST = re.compile(r"(.*?= [{\[])(.*)([}\]];)")  # of values, as a table has
_NESTED = re.compile(r"[()\[\]{}]")
_PRODUCT = re.compile(r"(?<=[\w)\]][*/])(?=[\w(])")  # where there is no such place


def folded(lines: Iterable[str]) -> list[str]:
    """The lines, of which a longer one becomes several; a preprocessor line stays as it is."""
    return [part for line in lines for part in _fold(line)]


def _fold(line: str) -> list[str]:
    if len(line) <= COLUMNS or line.startswith("#"):
        return [line]
    indent = line[: len(line) - len(line.lstrip())]
    text = line.strip()
    if mark := next((mark for mark in _MARKS if text.startswith(mark)), ""):  # a comment, whose items hang
        said = text[len(mark) :]
        inner = len(said) - len(said.lstrip())
        return _filled(text, indent, f"{mark}{' ' * (inner + 2 if inner else 0)}")
    if text.startswith("/*"):
        return _filled(text, indent, " * ")
    for mark, above in ((" /* ", "/* "), (" /**< ", "/** ")):
        code, inside, comment = text.partition(mark)
        if inside:
            return [*_fold(f"{indent}{above}{comment}"), *_fold(f"{indent}{code.rstrip()}")]
    if listed := _LIST.fullmatch(text):
        head, values, tail = listed.groups()
        deeper = f"{indent}    "
        lines = _one_a_line(values, deeper) if _NESTED.search(values) else _filled(values, deeper, "")
        return [f"{indent}{head}", *lines, f"{indent}{tail}"]
    return _broken(line, len(indent))


def _one_a_line(values: str, indent: str) -> list[str]:
    commas = [k for k, sign in enumerate(values) if values.startswith(", ", k) and not _depth(values[:k])]
    ends = [*(k + 1 for k in commas), len(values)]
    parts = (values[a:b].strip() for a, b in pairwise([0, *ends]))
    return [line for part in parts for line in _fold(f"{indent}{part}")]


def _filled(text: str, indent: str, hanging: str) -> list[str]:
    text = re.sub(r" \*/$", f"{_GLUE}*/", text)  # the end of a comment stays with its last word
    lines = textwrap.wrap(
        text, COLUMNS, initial_indent=indent, subsequent_indent=indent + hanging, break_on_hyphens=False
    )
    return [line.replace(_GLUE, " ") for line in lines]


def _broken(line: str, indent: int) -> list[str]:
    places = _places(_BREAK, line, indent) or _places(_PRODUCT, line, indent)
    if not places:
        return [line]
    right = [place for place in places if place > (COLUMNS + indent) // 2] or places
    at = min(right, key=lambda place: (_depth(line[:place]), line[place : place + 2] not in ("||", "? ", ": "), -place))
    return [line[:at].rstrip(), *_fold(" " * (indent + 4) + line[at:])] if indent < COLUMNS // 2 else [line]


def _places(pattern: re.Pattern[str], line: str, indent: int) -> list[int]:
    return [m.end() for m in pattern.finditer(line) if indent + 8 < m.end() <= COLUMNS]


def _depth(text: str) -> int:
    return text.count("(") + text.count("[") - text.count(")") - text.count("]")


def sources(step: Step, syntax: Syntax, files: Mapping[str, Iterable[str]], recipe: Recipe = ()) -> Sources:
    """Files of these lines, of which none is long, and the signals that the language calls otherwise."""
    texts = tuple((name, "\n".join(folded(lines)) + "\n") for name, lines in files.items())
    return Sources(texts, recipe, tuple(renamed(step, syntax).items()), tuple(filter(None, [says(step, syntax)])))
