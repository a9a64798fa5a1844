"""Lines of code with the names that they use, so that headers, casts and small functions follow from data and not from
the text; and the breaking of long lines."""

# Takes apart: finished text, of which it counts the paths and breaks the long lines.

import re
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

from hgogen.rigor.lookup import Lookup

Names = frozenset[str]


@dataclass(frozen=True)
class Uses:
    """The names that lines of emitted code use, by kind: `parameters` of the enclosing function, `helpers` (functions
    of `emit.helpers` and mathematical functions), `kernels` (matrix kernels, as name and size), `types` that may need a
    header, `lookups` (tables), `routines` (by their keys); `widest`: the largest integer to which a loop or a counter
    counts."""

    parameters: Names = frozenset()
    helpers: Names = frozenset()
    kernels: frozenset[tuple[str, int]] = frozenset()
    types: Names = frozenset()
    widest: int = 0
    lookups: frozenset[Lookup] = frozenset()
    routines: Names = frozenset()

    def __or__(self, other: "Uses") -> "Uses":
        return united((self, other))


_SETS = tuple(each.name for each in fields(Uses) if each.name != "widest")
NOTHING = Uses()
TRUTH = Uses(types=frozenset({"bool"}))


@dataclass(frozen=True)
class Code:
    """Lines of emitted code (`lines`), with the names and functions that the lines use (`uses`)."""

    lines: tuple[str, ...] = ()
    uses: Uses = NOTHING

    def __add__(self, other: "Code") -> "Code":
        return Code(self.lines + other.lines, self.uses | other.uses)

    def indented(self) -> "Code":
        """Return this code with each line indented by four spaces."""
        return Code(tuple(indented(self.lines)), self.uses)


def code(*lines: str, parameters: Iterable[str] = (), widest: int = 0) -> Code:
    """Return lines of text as `Code`; `parameters`: the parameters of the enclosing function that the lines use,
    `widest`: the largest integer to which the lines count."""
    return Code(lines, Uses(parameters=frozenset(parameters), widest=widest) if parameters or widest else NOTHING)


def joined(parts: Iterable[Code]) -> Code:
    """Return several pieces of code as one `Code`, in order."""
    parts = list(parts)
    return Code(tuple(line for part in parts for line in part.lines), united(part.uses for part in parts))


def braced(head: str, inner: Code) -> Code:
    """Return a block of code in braces: the line `head`, which ends in {, the indented body `inner`, and the closing
    brace."""
    return code(head) + inner.indented() + code("}")


def spaced(parts: Iterable[Code]) -> Code:
    """Return pieces of code as one `Code`, with an empty line between two pieces."""
    first, *others = parts
    return joined([first, *(code("") + part for part in others)])


def united(uses: Iterable[Uses]) -> Uses:
    """Return the union of several `Uses`; its `widest` is the largest of theirs."""
    distinct = {id(each): each for each in uses if each is not NOTHING}.values()
    if len(distinct) < 2:
        return next(iter(distinct), NOTHING)
    sets: dict[str, Any] = {name: frozenset().union(*(getattr(each, name) for each in distinct)) for name in _SETS}
    return Uses(**sets, widest=max(each.widest for each in distinct))


def indented(lines: Iterable[str], by: int = 4) -> list[str]:
    """Return the lines with `by` spaces before each."""
    return [" " * by + line if line else line for line in lines]


MAX_PATHS = 20  # paths through a function
_VARIABLE = re.compile(r"(?<![\w.>])[A-Za-z_]\w*")  # not behind a point or an arrow
_BRANCH = re.compile(r"\b(?:if|for|while|case)\b|&&|\|\||\?")


def paths(lines: Iterable[str]) -> int:
    """Return the cyclomatic complexity of a C function from its lines: 1 + the number of branches, &&, || and ?."""
    return 1 + len(_BRANCH.findall(_bare(lines)))


def variables(lines: Iterable[str]) -> set[str]:
    """Return the identifiers in lines of C, except names of struct members."""
    return set(_VARIABLE.findall(_bare(lines)))


def _bare(lines: Iterable[str]) -> str:
    return re.sub(r"/\*.*?\*/", "", " ".join(lines))


COLUMNS = 110
_GLUE = "\0"  # a blank at which no line is broken
_MARKS = ("* ", "// ", "/// ", "//! ")  # that begin a line in a block comment, or a line comment
_BREAK = re.compile(r"(?<=, )|(?<=\)[*/])(?=\()| (?=(?:[-+?:]|&&|\|\||else \{) )|(?<!else) (?=\{ )|(?<= = )(?=&)")
_LIST = re.compile(r"(.*?= [{\[])(.*)([}\]];)")  # an array with its values
_NESTED = re.compile(r"[()\[\]{}]")
_PRODUCT = re.compile(r"(?<=[\w)\]][*/])(?=[\w(])")  # where `_BREAK` has no place


def folded(lines: Iterable[str]) -> list[str]:
    """Return lines of C broken to at most `COLUMNS` characters: comments are refilled, code is broken where the fewest
    parentheses are open, preprocessor lines stay as they are."""
    return [part for line in lines for part in _fold(line)]


def _fold(line: str) -> list[str]:
    if len(line) <= COLUMNS or line.startswith("#"):
        return [line]
    indent = line[: len(line) - len(line.lstrip())]
    text = line.strip()
    if mark := next((mark for mark in _MARKS if text.startswith(mark)), ""):  # a comment, its items indented
        content = text[len(mark) :]
        inner = len(content) - len(content.lstrip())
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
