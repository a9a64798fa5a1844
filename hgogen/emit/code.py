"""Lines of code and what they use, so that headers, casts and helper functions follow from data, not from the text."""

# Takes apart: the lines of a function, whose paths it counts.

import re
from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any

from hgogen.rigor.lookup import Lookup

Names = frozenset[str]


@dataclass(frozen=True)
class Uses:
    """The names to which lines refer: `parameters` of the function around them, `helpers` of `emit.functions`,
    `kernels` (name, size), `types` that a language may have to be asked for; `widest` is the largest count that they
    hold; `lookups` are those of tables, `routines` the keys of those that are called."""

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
    """Lines with what they use."""

    lines: tuple[str, ...] = ()
    uses: Uses = NOTHING

    def __add__(self, other: "Code") -> "Code":
        return Code(self.lines + other.lines, self.uses | other.uses)

    def indented(self) -> "Code":
        """Every line four blanks to the right."""
        return Code(tuple(indented(self.lines)), self.uses)


def code(*lines: str, parameters: Iterable[str] = (), widest: int = 0) -> Code:
    """Lines that use these parameters, and count up to `widest`."""
    return Code(lines, Uses(parameters=frozenset(parameters), widest=widest) if parameters or widest else NOTHING)


def joined(parts: Iterable[Code]) -> Code:
    """The codes one after the other."""
    parts = list(parts)
    return Code(tuple(line for part in parts for line in part.lines), united(part.uses for part in parts))


def braced(head: str, inner: Code) -> Code:
    """A line that ends in a brace, with what is inside."""
    return code(head) + inner.indented() + code("}")


def spaced(parts: Iterable[Code]) -> Code:
    """The codes with an empty line between two."""
    first, *rest = parts
    return joined([first, *(code("") + part for part in rest)])


def united(uses: Iterable[Uses]) -> Uses:
    """The union of what they use."""
    every = {id(each): each for each in uses if each is not NOTHING}.values()
    if len(every) < 2:
        return next(iter(every), NOTHING)
    sets: dict[str, Any] = {name: frozenset().union(*(getattr(each, name) for each in every)) for name in _SETS}
    return Uses(**sets, widest=max(each.widest for each in every))


def indented(lines: Iterable[str], by: int = 4) -> list[str]:
    """Every line four blanks to the right."""
    return [" " * by + line if line else line for line in lines]


MOST = 20  # paths through a function
_VARIABLE = re.compile(r"(?<![\w.>])[A-Za-z_]\w*")  # not behind a point or an arrow
_BRANCH = re.compile(r"\b(?:if|for|while|case)\b|&&|\|\||\?")


def paths(lines: Iterable[str]) -> int:
    """Return the cyclomatic complexity of the lines of a function."""
    return 1 + len(_BRANCH.findall(_bare(lines)))


def variables(lines: Iterable[str]) -> set[str]:
    """Return the names in lines that are of no member of a struct."""
    return set(_VARIABLE.findall(_bare(lines)))


def _bare(lines: Iterable[str]) -> str:
    return re.sub(r"/\*.*?\*/", "", " ".join(lines))
