"""Lines of C and what they use, so that headers, casts and helper functions follow from data, not from the text."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import reduce
from operator import or_
from string import Template

HEADERS = {"bool": "stdbool.h", "int32_t": "stdint.h", "int64_t": "stdint.h"}  # where C99 declares a type
Names = frozenset[str]


@dataclass(frozen=True)
class Uses:
    """What lines of C refer to: `parameters` of the function around them, `helpers` of `emit.cmath`, `kernels` (name,
    size), `types` of a standard header; `widest` is the largest count that they hold."""

    parameters: Names = frozenset()
    helpers: Names = frozenset()
    kernels: frozenset[tuple[str, int]] = frozenset()
    types: Names = frozenset()
    widest: int = 0

    def __or__(self, other: "Uses") -> "Uses":
        return Uses(
            self.parameters | other.parameters,
            self.helpers | other.helpers,
            self.kernels | other.kernels,
            self.types | other.types,
            max(self.widest, other.widest),
        )


NOTHING = Uses()
TRUTH = Uses(types=frozenset({"bool"}))


@dataclass(frozen=True)
class Code:
    """Lines of C with what they use."""

    lines: tuple[str, ...] = ()
    uses: Uses = NOTHING

    def __add__(self, other: "Code") -> "Code":
        return Code(self.lines + other.lines, self.uses | other.uses)

    def indented(self) -> "Code":
        """Every line four blanks to the right."""
        return Code(tuple(indented(self.lines)), self.uses)


def code(*lines: str, parameters: Iterable[str] = (), widest: int = 0) -> Code:
    """Lines that use these parameters, and count up to `widest`."""
    return Code(lines, Uses(parameters=frozenset(parameters), widest=widest))


def joined(parts: Iterable[Code]) -> Code:
    """One after the other."""
    parts = list(parts)
    return Code(tuple(line for part in parts for line in part.lines), united(part.uses for part in parts))


def braced(head: str, inner: Code) -> Code:
    """A line that ends in a brace, with what is inside."""
    return code(head) + inner.indented() + code("}")


def spaced(parts: Iterable[Code]) -> Code:
    """The same with an empty line between two."""
    first, *rest = parts
    return joined([first, *(code("") + part for part in rest)])


def united(uses: Iterable[Uses]) -> Uses:
    """All that any of them uses."""
    return reduce(or_, uses, NOTHING)


def filled(template: Template, values: Mapping[str, str | int]) -> Code:
    """A template with its holes filled, a count as `3u`; what it uses is what its holes stand for."""
    holes = {name: values[name] for name in template.get_identifiers()}
    counts = {name: value for name, value in holes.items() if isinstance(value, int)}
    text = template.substitute(holes | {name: f"{value}u" for name, value in counts.items()})
    types = frozenset(str(value) for value in holes.values() if value in HEADERS)
    return Code(tuple(text.strip("\n").split("\n")), Uses(types=types, widest=max(counts.values(), default=0)))


def indented(lines: Iterable[str], by: int = 4) -> list[str]:
    """Every line four blanks to the right."""
    return [" " * by + line if line else line for line in lines]
