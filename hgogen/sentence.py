"""A sentence of a verdict as data: a constant pattern, which is the kind of sentence, and the values that it names.

    because("|det| >= {margin} on the box, {how}", margin=Down(sign.margin), how=sign.reason)

A value is a number, exact or float, `Down` or `Up` where it is a bound that is printed on the safe side, an expression,
a name, another sentence, or several of one of these. The text is made where it is printed, so that no code reads a
number off it.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from string import Formatter
from typing import Any, Self

from hgogen.intervals.digits import Down, Up, same


@dataclass(frozen=True)
class Sentence:
    """A `pattern`, as of `str.format`, and its `values` by name. Of several values the pattern says, in the place of a
    format, what stands between them: {conditions: and }; by default a comma. Without a pattern it is false."""

    pattern: str
    values: tuple[tuple[str, Any], ...] = ()

    @classmethod
    def of(cls, pattern: str, /, **values: Any) -> Self:
        """The sentence with that pattern, a constant, and the values that it names."""
        return cls(pattern, tuple((name, _frozen(value)) for name, value in values.items()))

    def part(self, name: str) -> Any:
        """The value of that name."""
        return dict(self.values)[name]

    def __bool__(self) -> bool:
        return bool(self.pattern)

    def __str__(self) -> str:
        return self.written(plain)

    def written(self, text: Callable[[Any], str]) -> str:
        """The sentence as text, each number, name and expression in it as `text` writes it."""
        return _Written(text).format(self.pattern, **dict(self.values))

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"pattern": self.pattern, "values": {name: _data(value) for name, value in self.values}}


class Reason(Sentence):
    """Why a verdict is what it is."""


because = Reason.of
NONE = Reason("")


def joined(*reasons: Reason) -> Reason:
    """Those that say something, one after the other."""
    parts = tuple(filter(None, reasons))
    return because("{parts:; }", parts=parts) if len(parts) > 1 else next(iter(parts), NONE)


def equations(values: Mapping[Any, Any]) -> tuple[Sentence, ...]:
    """Each name with its value, exactly: x = 1/3."""
    return tuple(Sentence.of("{name} = {value}", name=name, value=value) for name, value in values.items())


def point(values: Mapping[Any, Any]) -> tuple[Sentence, ...]:
    """Each coordinate of a point, in few digits: x = 0.333333."""
    return tuple(Sentence.of("{name} = {value:g}", name=name, value=float(value)) for name, value in values.items())


def plain(value: Any) -> str:
    """A value as text; a float reads back as it is."""
    return same(value) if isinstance(value, float) else str(value)


class _Written(Formatter):
    """The format of a pattern whose values are those of a sentence."""

    def __init__(self, text: Callable[[Any], str]) -> None:
        self.text = text

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, Sentence):
            return value.written(self.text)
        if isinstance(value, tuple):
            return (format_spec or ", ").join(self.format_field(each, "") for each in value)
        return format(value, format_spec) if format_spec else self.text(value)


def _frozen(value: Any) -> Any:
    return value if isinstance(value, str) or not isinstance(value, Iterable) else tuple(map(_frozen, value))


def _data(value: Any) -> Any:
    if isinstance(value, Sentence):
        return value.as_dict()
    if isinstance(value, tuple):
        return [_data(each) for each in value]
    if isinstance(value, Down | Up):
        return {"value": _data(value.value), "rounded": value.direction}
    number = isinstance(value, int) or (isinstance(value, float) and math.isfinite(value))
    return value if number else plain(value)
