"""Answers as data: the sentence of a verdict, and any result in JSON.

A sentence is a constant pattern, which is the kind of sentence, and the values that it names.

    because("|det| >= {margin} on the box, {how}", margin=Down(sign.margin), how=sign.reason)

A value is a number, exact or float, `Down` or `Up` where it is a bound that is printed on the safe side, an expression,
a name, another sentence, or several of one of these. The text is formatted only for printing, so that no code parses a
number.

A proved bound is rounded to the safe side (`up`, `down`); the text of a gain reads back as the same number (`same`).

A result is a dataclass. Its keys in JSON are its fields, or those that its `json_keys` list; the meaning
of a key is in the type of the field, `dt: Annotated[float, "sampling period"]`, or in the docstring of the property.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from fractions import Fraction
from functools import cache
from string import Formatter
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

Why = TypeVar("Why")
MOST = 17  # digits in which any two floats differ


def up(value: float | Fraction, digits: int = 4, below: float | Fraction = math.inf) -> str:
    """Return the least number of `digits` significant digits, as text, that is not below the value. A value below the
    number `below` has as many more digits as the text needs to stay below that, up to `MOST`."""
    while True:
        text = _rounded(value, digits, ROUND_CEILING)
        if digits >= MOST or not value < below or Decimal(text) < Decimal(same(float(below))):
            return text
        digits += 1


def down(value: float | Fraction, digits: int = 4) -> str:
    """Return the largest number of `digits` significant digits, as text, that is not above the value."""
    return _rounded(value, digits, ROUND_FLOOR)


def same(value: float) -> str:
    """Return a float as text that reads back as the same float: in six digits if these suffice, else in more."""
    six_digits = f"{value:g}"
    return six_digits if float(six_digits) == value else repr(float(value))


def tidy(value: float) -> str:
    """Return a float as text: in 12 digits if these differ from it by rounding errors only, as 0.01 for 0.1 * 0.1, else
    by `same`."""
    twelve_digits = float(f"{value:.12g}")
    return same(twelve_digits if abs(twelve_digits - value) <= 4 * math.ulp(value) else value)


@dataclass(frozen=True)
class Up:
    """A number `value` that is printed rounded up, by `up` with its other arguments."""

    value: float | Fraction
    digits: int = 4
    below: float | Fraction = math.inf
    direction: ClassVar[str] = "up"

    def __str__(self) -> str:
        return up(self.value, self.digits, self.below)


@dataclass(frozen=True)
class Down:
    """A number `value` that is printed rounded down, by `down` to so many `digits`."""

    value: float | Fraction
    digits: int = 4
    direction: ClassVar[str] = "down"

    def __str__(self) -> str:
        return down(self.value, self.digits)


def _rounded(value: float | Fraction, digits: int, rounding: str) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        return f"{value:g}"
    exact = Fraction(value)
    rounded = Context(prec=digits, rounding=rounding).divide(Decimal(exact.numerator), Decimal(exact.denominator))
    plain = -4 <= rounded.adjusted() < digits  # as float's g: 0.0001, 1e-05
    return f"{rounded.normalize():f}" if plain or not rounded else f"{rounded.normalize():e}"


@dataclass(frozen=True)
class Sentence:
    """A `pattern`, as of `str.format`, and its `values` by name. For several values the format in the pattern is their
    separator: {conditions: and }; by default a comma. A sentence without a pattern is false."""

    json_keys: ClassVar[None] = None
    pattern: str
    values: tuple[tuple[str, Any], ...] = ()

    @classmethod
    def of(cls, pattern: str, /, **values: Any) -> Self:
        """Return the sentence of a constant `pattern`, such as "{x} is not 0", with the values by name."""
        return cls(pattern, tuple((name, _frozen(value)) for name, value in values.items()))

    def part(self, name: str) -> Any:
        """Return the value called `name` in the sentence."""
        return dict(self.values)[name]

    def __bool__(self) -> bool:
        return bool(self.pattern)

    def __str__(self) -> str:
        return self.written(plain)

    def written(self, text: Callable[[Any], str]) -> str:
        """Return the sentence as text, with each number, name and expression formatted by `text`."""
        return _Written(text).format(self.pattern, **dict(self.values))

    def as_dict(self) -> dict[str, Any]:
        """The pattern and its values by name; a rounded number as {its value, the direction of rounding}."""
        return {"pattern": self.pattern, "values": {name: _data(value) for name, value in self.values}}


class Reason(Sentence):
    """The reason of a verdict: how it was reached, as a sentence with its values."""


because = Reason.of
NONE = Reason("")


def joined(*reasons: Reason) -> Reason:
    """Return one reason whose text is the nonempty reasons, one after the other."""
    parts = tuple(filter(None, reasons))
    return because("{parts:; }", parts=parts) if len(parts) > 1 else next(iter(parts), NONE)


def by_reason(pairs: Iterable[tuple[str, Why]]) -> dict[Why, list[str]]:
    """Return the names by their reason; `pairs`: each name with its reason."""
    names: dict[Why, list[str]] = {}
    for name, reason in pairs:
        names.setdefault(reason, []).append(name)
    return names


def equations(values: Mapping[Any, Any]) -> tuple[Sentence, ...]:
    """Return a sentence for each name with its exact value: x = 1/3."""
    return tuple(Sentence.of("{name} = {value}", name=name, value=value) for name, value in values.items())


def point(values: Mapping[Any, Any]) -> tuple[Sentence, ...]:
    """Return a sentence for each coordinate of a point, in few digits: x = 0.333333."""
    return tuple(Sentence.of("{name} = {value:g}", name=name, value=float(value)) for name, value in values.items())


def plain(value: Any) -> str:
    """Return a value as text; the text of a float reads back as an equal float."""
    return same(value) if isinstance(value, float) else str(value)


class _Written(Formatter):
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


# --- results in JSON ----------------------------------------------------------------------------------------


class Encoded:
    """A result, a dataclass, as data for JSON; a dataclass whose `json_keys` is None is its text.

    `json_keys`: its keys with spaces between, by default its fields. A key is the name of a field or property;
    "key=path" reads it elsewhere, with dots between names and indices, and is None where something on the way is;
    "*path" has all keys of the value there, none where it is None; "key?" is left out where it is None.
    """

    json_keys: ClassVar[str] = ""

    def as_dict(self) -> dict[str, Any]:
        """Return the result as plain data for JSON."""
        data: dict[str, Any] = encoded(self)
        return data


class Key(NamedTuple):
    """A key of a result in JSON, "" for all keys of the value at `path`; `optional`: left out where it is None."""

    name: str
    path: str
    optional: bool = False


@cache
def keys_of(result: type) -> tuple[Key, ...]:
    """Return the keys of a result in JSON."""
    return tuple(map(_key, getattr(result, "json_keys", "").split() or [one.name for one in fields(result)]))


def _key(text: str) -> Key:
    name, _, path = text.partition("=")
    if name.startswith("*"):
        return Key("", name[1:])
    bare = name.rstrip("?")
    return Key(bare, path or bare, optional=name != bare)


def encoded(value: Any) -> Any:
    """Return a value as plain data for JSON; a number that is not finite is None."""
    if isinstance(value, Mapping):
        return {key: encoded(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [encoded(each) for each in value]
    if is_dataclass(value) and getattr(value, "json_keys", "") is not None:
        return _of_result(value)
    if hasattr(value, "tolist"):
        return encoded(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, str | int) else str(value)


def _of_result(value: Any) -> dict[str, Any]:
    data: dict[str, Any] = {}
    for key in keys_of(value.__class__):
        part = value
        for name in key.path.split("."):
            if part is not None:
                part = part[int(name)] if name.isdigit() else getattr(part, name)
        part = part() if callable(part) else part
        if key.name and not (key.optional and part is None):
            data[key.name] = encoded(part)
        elif not key.name:
            data |= {} if part is None else encoded(part)
    return data
