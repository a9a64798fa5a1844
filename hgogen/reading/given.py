"""What a user gives: a plant, an expression, switches, numbers, names; anything else is met with a sentence.

A masked entry of a NumPy array is missing, NaN, where numbers are taken. Gains, weights, variances and first estimates
have a value for each coordinate, in their order or by name:

    (0.1, 0.2)   {"w": 0.2, "q": 0.1}   {"q": {"q": 0.1, "w": 0.01}, "w": {"w": 0.2}}

A mapping has every name once, in any order; a key is a name, or a signal for its name. What is no mapping is left as it
is: the order of a sequence is that of the coordinates. Sizes of what enters a step are given by name alone."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from fractions import Fraction
from functools import lru_cache, wraps
from inspect import signature
from numbers import Real
from sys import float_info
from types import MappingProxyType
from typing import Any, TypeAlias, TypeVar, cast

import numpy as np
import sympy as sp

from hgogen.check import Check
from hgogen.errors import BadArgument, HgogenError, nearest
from hgogen.form import Form
from hgogen.program import Field
from hgogen.reading.files import cut, shown
from hgogen.sentence import same
from hgogen.system import System

S = TypeVar("S", bound=sp.Symbol)


@dataclass(eq=False)
class BadGain(HgogenError):
    """A gain of the wrong length, sign or kind; the sentence names it and the fix.

    `because`: the check that says why, where one does; `fix`: what to do then.
    """

    gain: str
    reason: str
    because: Check | None = None
    fix: str = ""

    def __str__(self) -> str:
        why = f": {self.because.reason}" if self.because else ""
        return f"{self.gain} {self.reason}{why}{f'; {self.fix}' if self.fix else ''}"


def reals(name: str, value: Any) -> np.ndarray:
    """A number or an array of numbers as floats, NaN where it is masked. Raises: `BadGain` for anything else."""
    try:
        array = np.asarray(unmasked(value))
        if value is None or array.dtype.kind in "USc":  # which numpy would turn into NaN, into numbers, or cut
            raise TypeError
        return np.asarray(array, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise BadGain(f"{name} = {value!r}", "must be a number or an array of numbers") from None


def real(name: str, value: Any) -> float:
    """A number as a float. Raises: `BadGain` for anything else."""
    array = reals(name, value)
    if array.ndim:
        raise BadGain(f"{name} of shape {array.shape}", "must be a single number")
    return float(array)


def positive(name: str, value: Any) -> float:
    """A number above 0 as a float. Raises: `BadGain` for anything else."""
    number = real(name, value)
    if not 0 < number < np.inf:
        raise BadGain(f"{name} = {value!r}", "must be a positive finite number")
    return number


def names(what: str, value: Any) -> tuple[Any, ...]:
    """Names, or signals for theirs, of which one may be given alone. Raises: `BadGain` for anything else."""
    if isinstance(value, str | sp.Symbol):
        return (value,)
    if not isinstance(value, Iterable):
        raise BadGain(f"{what} = {value!r}", "must be a name or several, such as ['a', 'b']")
    return tuple(value)


def signals_named(
    what: str, value: Any, signals: Iterable[S], unknown: Callable[[str, str], HgogenError]
) -> tuple[S, ...]:
    """The signals of these names, in their own order. Raises: `BadGain` for no names; for the name of none what
    `unknown` makes of it and of what to take instead."""
    every = {str(signal): signal for signal in signals}
    wanted = set(map(str, names(what, value)))
    for name in sorted(wanted.difference(every)):
        listed = f"there are {', '.join(every)}" if every else "there is none"
        raise unknown(name[:60], nearest(name, every, listed))
    return tuple(signal for name, signal in every.items() if name in wanted)


def among(value: object, choices: Iterable[str | None]) -> bool:
    """Whether a value is a text, or None, that is one of the choices; an array or a list is none."""
    return (value is None or isinstance(value, str)) and value in choices


def count(name: str, value: Any, low: int, high: int) -> int:
    """A whole number from `low` to `high`. Raises: `BadGain` for anything else."""
    number = real(name, value)
    if isinstance(value, bool) or not low <= number <= high or number != round(number):
        raise BadGain(f"{name} = {value!r}", f"must be a whole number, from {low} to {high}")
    return int(number)


def unmasked(value: Any) -> Any:
    """The value with NaN for each entry that is masked, in arrays inside of sequences as well. Raises: `TypeError`,
    `ValueError` where an array with a mask holds no numbers."""
    if isinstance(value, np.ma.MaskedArray):
        return np.ma.filled(value.astype(float), np.nan)
    if isinstance(value, list | tuple) and any(isinstance(each, list | tuple | np.ma.MaskedArray) for each in value):
        return [unmasked(each) for each in value]
    return value


def scalar(value: Any, what: str) -> sp.Expr:
    """The SymPy expression of a number or of an expression. Raises: `Misfit`."""
    try:
        expression = sp.sympify(value, strict=True)
    except (sp.SympifyError, TypeError):
        expression = None
    if not isinstance(expression, sp.Expr) or expression.is_Matrix:
        raise Misfit(what, value, "one expression, SymPy or text such as 'x1**2 - 1'")
    return expression


def limits(what: str, boxes: int, relative: float = 0.0) -> None:
    """Raise `Misfit` unless at least one box may be tried, and `relative` is a number from 0 on."""
    if isinstance(boxes, bool) or not isinstance(boxes, int) or boxes < 1:
        raise Misfit(f"{what}, boxes=", boxes, "a whole number from 1 on")
    if isinstance(relative, bool) or not isinstance(relative, int | float) or not 0 <= relative <= float_info.max:
        raise Misfit(f"{what}, relative=", relative, "a number from 0 on, such as 0.02")


# ---------------------------------------------------------------- door


Asked = TypeVar("Asked", bound=Callable[..., Any])
_ANSWERS = 64  # of each question are remembered


@dataclass(eq=False)
class Misfit(HgogenError):
    """A `value` where something else belongs; `wanted` says what to give in its place."""

    what: str
    value: Any
    wanted: str

    def __str__(self) -> str:
        return f"{self.what} was given {shown(self.value)}, of type {type(self.value).__name__}; give {self.wanted}"


def asks(kind: type | tuple[type, ...], wanted: str) -> Callable[[Asked], Asked]:
    """For a function whose first argument must be of a kind: for anything else it raises `Misfit`, which says what is
    `wanted`."""

    def guards(question: Asked) -> Asked:
        name = next(iter(signature(question).parameters))

        @wraps(question)
        def guarded(*args: Any, **options: Any) -> Any:
            first = args[0] if args else options.get(name)
            if not isinstance(first, kind):
                raise Misfit(question.__name__, first, wanted)
            return question(*args, **options)

        return cast(Asked, guarded)

    return guards


def demand_switch(what: str, value: object) -> None:
    """Raise `Misfit` for anything but True or False."""
    if not isinstance(value, bool | np.bool_):
        raise Misfit(what, value, "True or False")


def switches(question: Asked) -> Asked:
    """For a function with keywords that are switches, of type bool: for anything but True or False, which would count
    as one of them, it raises `Misfit`."""
    names = [each.name for each in signature(question).parameters.values() if each.annotation in (bool, "bool")]

    @wraps(question)
    def guarded(*args: Any, **options: Any) -> Any:
        for name in names:
            demand_switch(f"{question.__name__}, {name}=", options.get(name, False))
        return question(*args, **options)

    return cast(Asked, guarded) if names else question


asks_a_plant = asks(System, "a plant, an hg.System; of a model file it is hg.load(path).plant")


def remembers(question: Asked) -> Asked:
    """The function with its last answers, which do not change: a survey, the observers that are tried and each command
    ask the same of one plant, and of one form. What cannot be compared is asked anew."""

    @lru_cache(maxsize=_ANSWERS)
    def once(args: tuple[Any, ...], options: tuple[tuple[str, Any], ...]) -> Any:
        return question(*args, **dict(options))

    @wraps(question)
    def remembered(*args: Any, **options: Any) -> Any:
        pairs = tuple(options.items())
        try:
            hash((args, pairs))
        except TypeError:
            return question(*args, **options)
        return once(args, pairs)

    return cast(Asked, remembered)


# ---------------------------------------------------------------- named


Values: TypeAlias = Mapping[str, float] | Sequence[float]
Matrix: TypeAlias = Mapping[str, float | Mapping[str, float]] | Sequence[float] | np.ndarray
NOTHING: Mapping[str, Any] = MappingProxyType({})
_BLANK: Any = object()  # an entry of a matrix that its row leaves out
_LENGTH = 120  # of a definition in a sentence
Each = Mapping[str, float] | None
_SIZE = "must be a finite number, not negative"


class BadNames(BadArgument):
    """Values by name of which one is missing, unknown or given twice."""


def in_order(
    what: str,
    values: Any,
    names: Iterable[str],
    *,
    default: Mapping[str, Any] = NOTHING,
    aliases: Mapping[str, str] = NOTHING,
    elsewhere: Mapping[str, str] = NOTHING,
) -> Any:
    """The values of a mapping as a list in the order of `names`; anything but a mapping is returned as it is.

    `names`: a mapping to what a sentence calls them, where that is more than the name; `default`: the values of names
    that may be left out; `aliases`: other names for these; `elsewhere`: of names that are none of these, why.

    Raises: `BadNames`.
    """
    if not isinstance(values, Mapping):
        return values
    shown = dict(names) if isinstance(names, Mapping) else {name: name for name in names}
    named: dict[str, Any] = {}
    for key, value in values.items():
        name = key.name if isinstance(key, sp.Symbol) else key
        own = name if name in shown else aliases.get(name, name)
        if own not in shown:
            raise BadNames(what, f"names {cut(repr(name), _LENGTH)}, {elsewhere.get(name) or _unknown(name, shown)}")
        if own in named:
            raise BadNames(what, f"names {own} twice; give it once")
        named[own] = value
    complete = {**default, **named}
    missing = [text for name, text in shown.items() if name not in complete]
    if missing:
        needed = ", ".join(name for name in shown if name not in default)
        raise BadNames(what, f"has no value for {', '.join(missing)}; give one for each of {needed}")
    return [complete[name] for name in shown]


def _unknown(name: Any, shown: Mapping[str, str]) -> str:
    """The end of a sentence on a name that is none of those `shown`: the one that was meant, or all of them."""
    if not shown:
        return "but there are no names to give"
    spelled = str(name)[:60]
    close = [each for each in shown if each.lower() == spelled.lower()] or get_close_matches(spelled, shown, n=1)
    fix = f"did you mean {close[0]}?" if close else f"they are {', '.join(shown.values())}"
    return f"which is none of the names; {fix}"


def quadratic(what: str, values: Any, names: Iterable[str], **others: Mapping[str, str]) -> Any:
    """A diagonal (n), or a symmetric matrix (n, n) of rows by name, as lists in the order of `names`; anything but a
    mapping is returned as it is. `others` are those of `in_order`.

    An entry off the diagonal that stands in one of its two rows is the other's, too; in neither, it is 0.

    Raises: `BadNames`.
    """
    entries = in_order(what, values, names, **others)
    if entries is values or not any(isinstance(row, Mapping) for row in entries):
        return entries
    matrix = []
    for name, row in zip(names, entries, strict=True):
        if not isinstance(row, Mapping):
            reason = f"is no row by name, as others are; give {{{name} = {cut(str(row), _LENGTH)}}}"
            raise BadNames(f"{what} of {name}", reason)
        blank = {other: _BLANK for other in names if other != name}
        matrix.append(in_order(f"{what} of {name}", row, names, default=blank, **others))
    order = range(len(matrix))
    both = [[matrix[j][i] if matrix[i][j] is _BLANK else matrix[i][j] for j in order] for i in order]
    return [[0.0 if entry is _BLANK else entry for entry in row] for row in both]


def of_coordinates(what: str, values: Any, form: Form) -> Any:
    """A diagonal (n), or a symmetric matrix (n, n), of the form's coordinates by their names, `Form.names`: where z_i
    is minus a state, the values are of the state. Raises: `BadNames`, for the name of a state that is no coordinate
    with what to name in its place."""
    if not isinstance(values, Mapping):  # whose names need no definition: those of a phase form are long
        return values
    entry = zip(form.names, form.entry, strict=True)  # what is neither a state nor minus one is shown by its definition
    names = {name: name if str(e) in (name, f"-{name}") else f"{name} = {cut(str(e), _LENGTH)}" for name, e in entry}
    entries = quadratic(what, values, names, elsewhere=_no_coordinates(form, names))
    if not any(isinstance(row, Mapping) for row in values.values()):
        return entries
    mirrored = zip(form.signs, entries, strict=True)
    return [
        [0.0 - a if s != t and isinstance(a, Real) else a for t, a in zip(form.signs, row, strict=True)]
        for s, row in mirrored
    ]


def of_outputs(what: str, values: Any, form: Form) -> Any:
    """A value for each output of the plant. Raises: `BadNames`."""
    return in_order(what, values, names_of(form.system.outputs))


def names_of(signals: Iterable[sp.Symbol]) -> tuple[str, ...]:
    """The names of the signals."""
    return tuple(signal.name for signal in signals)


def by_name(field: Field) -> dict[str, float] | list[float] | float:
    """A field's values, by the names of its elements where they have some."""
    values = [float(value) for value in field.initial]
    if field.labels:
        return dict(zip(field.labels, values, strict=True))
    return values if field.size > 1 else values[0]


def written(field: Field) -> str:
    """A field's values as text: Q = {x1: 0.1, x2: 0.01}, theta = 5."""
    values = by_name(field)
    if isinstance(values, dict) and len(values) > 1:
        return f"{field.name} = {_braces({name: same(value) for name, value in values.items()})}"
    return f"{field.name} = {', '.join(map(same, field.initial))}"


def whole(name: str, matrix: np.ndarray, form: Form) -> tuple[str, ...]:
    """A line for the banner where a matrix (n, n) of the form's coordinates is no diagonal: its rows, of the states."""
    if not np.count_nonzero(matrix - np.diag(np.diag(matrix))):
        return ()
    rows = (matrix * np.outer(form.signs, form.signs) + 0.0).tolist()
    lines = [_braces(dict(zip(form.names, map(same, row), strict=True))) for row in rows]
    text = _braces(dict(zip(form.names, lines, strict=True)))
    return (f"{name} = {text}; the gain {name} is D of its factors",)


def _braces(values: Mapping[str, str]) -> str:
    return f"{{{', '.join(f'{name}: {value}' for name, value in values.items())}}}"


def _no_coordinates(form: Form, names: Mapping[str, str]) -> dict[str, str]:
    """The names to give in place of each state of the plant, as first declared or recast, or z_i, if no coordinate."""
    origin, entry = form.system.origin, dict(zip(names, form.entry, strict=True))
    advice = {z.name: f"which is {name} here; name {name}" for z, name in zip(form.states, names, strict=True)}
    for state in (*form.system.states, *(origin.plant.states if origin else ())):
        reading = [text for name, text in names.items() if text != name and state in entry[name].free_symbols]
        inside = ", ".join(reading or names.values())
        advice[state.name] = f"which is no coordinate of this form ({form.kind}); in its place give {inside}"
    return {name: sentence for name, sentence in advice.items() if name not in names}


def sizes(what: str, values: Each, names: Sequence[str], default: float = 0.0) -> list[Fraction]:
    """A size for each name, the default where none is given. Raises: `BadNames`, `BadGain`."""
    each = each_by_name(what, values, names, default)
    return [size(f"{what} of {name}", value) for name, value in zip(names, each, strict=True)]


def each_by_name(what: str, values: Each, names: Sequence[str], default: Any) -> list[Any]:
    """The values given for each name, or the default. Raises: `BadNames`."""
    if not isinstance(values, Mapping | None):
        raise BadNames(what, f"= {values!r} is no mapping from names to numbers")
    return list(in_order(what, values or {}, names, default=dict.fromkeys(names, default)))


def size(what: str, value: Any) -> Fraction:
    """A finite number, not negative. Raises: `BadGain` for anything else."""
    number = real(what, value)
    if isinstance(value, bool) or not 0 <= number < math.inf:
        raise BadGain(f"{what} = {value if isinstance(value, bool) else f'{number:g}'}", _SIZE)
    return Fraction(number)
