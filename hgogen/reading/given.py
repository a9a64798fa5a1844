"""Checks of user arguments: a plant, an expression, switches, numbers, names. A wrong argument raises an error with a
sentence.

A masked entry of a NumPy array is a missing number, NaN. Gains, weights, variances and first estimates have a value for
each coordinate, in their order or by name:

    (0.1, 0.2)   {"w": 0.2, "q": 0.1}   {"q": {"q": 0.1, "w": 0.01}, "w": {"w": 0.2}}

A mapping has every name once, in any order; a key is a name or a signal. A sequence has the order of the coordinates
and is not changed. Sizes of the inputs of a step are given by name only."""

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
from hgogen.reading.files import cut, quoted
from hgogen.sentence import tidy
from hgogen.system import System, demand_continuous

S = TypeVar("S", bound=sp.Symbol)


@dataclass(eq=False)
class BadGain(HgogenError):
    """The error that an argument, such as a gain, has the wrong length, sign or kind; the message names it and the fix.

    `because`: the check that gives the reason, or None; `fix`: the remedy in this case.
    """

    gain: str
    reason: str
    because: Check | None = None
    fix: str = ""

    def __str__(self) -> str:
        why = f": {self.because.reason}" if self.because else ""
        return f"{self.gain} {self.reason}{why}{f'; {self.fix}' if self.fix else ''}"


def reals(name: str, value: Any) -> np.ndarray:
    """Return a number or an array from the user as an array of floats, NaN where it is masked. Raises: `BadGain`, which
    names the argument `name`, for anything else."""
    try:
        array = np.asarray(unmasked(value))
        if value is None or array.dtype.kind in "USc":  # numpy would convert these to NaN or numbers, or truncate
            raise TypeError
        return np.asarray(array, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise BadGain(f"{name} = {value!r}", "must be a number or an array of numbers") from None


def real(name: str, value: Any) -> float:
    """Return a number from the user as a float. Raises: `BadGain`, which names the argument `name`, for anything
    else."""
    array = reals(name, value)
    if array.ndim:
        raise BadGain(f"{name} of shape {array.shape}", "must be a single number")
    return float(array)


def positive(name: str, value: Any) -> float:
    """Return a positive finite number from the user as a float. Raises: `BadGain`, which names the argument `name`, for
    anything else."""
    number = real(name, value)
    if not 0 < number < np.inf:
        raise BadGain(f"{name} = {value!r}", "must be a positive finite number")
    return number


def names(what: str, value: Any) -> tuple[Any, ...]:
    """Return names or signals from the user as a tuple; a single one needs no list. Raises: `BadGain`, which names the
    argument `what`, for anything else."""
    if isinstance(value, str | sp.Symbol):
        return (value,)
    if not isinstance(value, Iterable):
        raise BadGain(f"{what} = {value!r}", "must be a name or several, such as ['a', 'b']")
    return tuple(value)


def signals_named(
    what: str, value: Any, signals: Iterable[S], unknown: Callable[[str, str], HgogenError]
) -> tuple[S, ...]:
    """Return the `signals` that the user lists in `value`, by name or as signals, in the order of `signals`. Raises:
    `BadGain`, which names the argument `what`, if `value` holds no names; the error `unknown(name, suggestion)` for an
    unknown name."""
    every = {str(signal): signal for signal in signals}
    wanted = set(map(str, names(what, value)))
    for name in sorted(wanted.difference(every)):
        listed = f"there are {', '.join(every)}" if every else "there is none"
        raise unknown(name[:60], nearest(name, every, listed))
    return tuple(signal for name, signal in every.items() if name in wanted)


def among(value: object, choices: Iterable[str | None]) -> bool:
    """Return whether `value` is one of the choices, each a text or None; False for an array or a list."""
    return (value is None or isinstance(value, str)) and value in choices


def count(name: str, value: Any, low: int, high: int) -> int:
    """Return a whole number from the user, from `low` to `high`. Raises: `BadGain`, which names the argument `name`,
    for anything else."""
    number = real(name, value)
    if isinstance(value, bool) or not low <= number <= high or number != round(number):
        raise BadGain(f"{name} = {value!r}", f"must be a whole number, from {low} to {high}")
    return int(number)


def unmasked(value: Any) -> Any:
    """Return a value from the user with NaN in place of each masked entry, also in arrays inside sequences. Raises:
    `TypeError`, `ValueError` if a masked array holds no numbers."""
    if isinstance(value, np.ma.MaskedArray):
        return np.ma.filled(value.astype(float), np.nan)
    if isinstance(value, list | tuple) and any(isinstance(each, list | tuple | np.ma.MaskedArray) for each in value):
        return [unmasked(each) for each in value]
    return value


def scalar(value: Any, what: str) -> sp.Expr:
    """Return a number or an expression from the user as a SymPy expression. Raises: `Misfit` with `what`, the name of
    the argument."""
    try:
        expression = sp.sympify(value, strict=True)
    except (sp.SympifyError, TypeError):
        expression = None
    if not isinstance(expression, sp.Expr) or expression.is_Matrix:
        raise Misfit(what, value, "one expression, SymPy or text such as 'x1**2 - 1'")
    return expression


def demand_limits(what: str, boxes: int, relative: float = 0.0) -> None:
    """Check the limits of a bisection: raise `Misfit` unless the number of boxes is at least 1, and `relative` is a
    number from 0 on."""
    if isinstance(boxes, bool) or not isinstance(boxes, int) or boxes < 1:
        raise Misfit(f"{what}, boxes=", boxes, "a whole number from 1 on")
    if isinstance(relative, bool) or not isinstance(relative, int | float) or not 0 <= relative <= float_info.max:
        raise Misfit(f"{what}, relative=", relative, "a number from 0 on, such as 0.02")


# ---------------------------------------------------------------- decorators


Decorated = TypeVar("Decorated", bound=Callable[..., Any])
_ANSWERS = 64  # cached results of each function


@dataclass(eq=False)
class Misfit(HgogenError):
    """The error that an argument `what` has a `value` of the wrong kind; `wanted`: what to give instead."""

    what: str
    value: Any
    wanted: str

    def __str__(self) -> str:
        return f"{self.what} was given {quoted(self.value)}, of type {type(self.value).__name__}; give {self.wanted}"


def requires(
    kind: type | tuple[type, ...], wanted: str, plant_of: Callable[[Any], System] | None = None
) -> Callable[[Decorated], Decorated]:
    """Return a decorator for functions whose first argument must be of the type `kind`: another raises `Misfit`, with
    the fix "give `wanted`". With `plant_of`, the function from this argument to its plant, a plant that is not x' =
    f(x, u) raises `DiscretePlant`."""

    def guards(function: Decorated) -> Decorated:
        name = next(iter(signature(function).parameters))

        @wraps(function)
        def guarded(*args: Any, **options: Any) -> Any:
            first = args[0] if args else options.get(name)
            if not isinstance(first, kind):
                raise Misfit(function.__name__, first, wanted)
            if plant_of is not None:
                demand_continuous(plant_of(first), function.__name__)
            return function(*args, **options)

        return cast(Decorated, guarded)

    return guards


def demand_switch(what: str, value: object) -> None:
    """Raise `Misfit` for a `value` other than True or False of the argument `what`."""
    if not isinstance(value, bool | np.bool_):
        raise Misfit(what, value, "True or False")


def requires_switches(function: Decorated) -> Decorated:
    """Return the function with a check that its arguments of type bool are True or False. Raises: `Misfit`."""
    names = [each.name for each in signature(function).parameters.values() if each.annotation in (bool, "bool")]

    @wraps(function)
    def guarded(*args: Any, **options: Any) -> Any:
        for name in names:
            demand_switch(f"{function.__name__}, {name}=", options.get(name, False))
        return function(*args, **options)

    return cast(Decorated, guarded) if names else function


_PLANT = "a plant, an hg.System; of a model file it is hg.load(path).plant"
requires_any_plant = requires(System, _PLANT)
requires_plant = requires(System, _PLANT, lambda plant: plant)  # x' = f(x, u)
requires_form = requires(Form, "a form: hg.forms.triangular(plant)", lambda form: form.system)  # of such a plant


def cached(function: Decorated) -> Decorated:
    """Return the function with a cache of its last results, because surveys, candidate observers and commands repeat
    questions about a plant or form. Calls with unhashable arguments are not cached."""

    @lru_cache(maxsize=_ANSWERS)
    def once(args: tuple[Any, ...], options: tuple[tuple[str, Any], ...]) -> Any:
        return function(*args, **dict(options))

    @wraps(function)
    def remembered(*args: Any, **options: Any) -> Any:
        pairs = tuple(options.items())
        try:
            hash((args, pairs))
        except TypeError:
            return function(*args, **options)
        return once(args, pairs)

    return cast(Decorated, remembered)


def has_expressions(value: Any) -> bool:
    """Return whether a mapping of numbers by name contains an expression."""
    return isinstance(value, Mapping) and any(isinstance(each, str | sp.Basic) for each in value.values())


# ---------------------------------------------------------------- named


Values: TypeAlias = Mapping[str, float] | Sequence[float]
Matrix: TypeAlias = Mapping[str, float | Mapping[str, float]] | Sequence[float] | np.ndarray
NOTHING: Mapping[str, Any] = MappingProxyType({})
_OMITTED: Any = object()  # an entry that a row of a matrix omits
_LENGTH = 120  # of a definition in a sentence
Each = Mapping[str, float] | None
_SIZE = "must be a finite number, not negative"


class BadNames(BadArgument):
    """The error that in values by name a name is missing, unknown or occurs twice."""


def in_order(
    what: str,
    values: Any,
    names: Iterable[str],
    *,
    default: Mapping[str, Any] = NOTHING,
    aliases: Mapping[str, str] = NOTHING,
    elsewhere: Mapping[str, str] = NOTHING,
) -> Any:
    """Return the values of a mapping as a list in the order of `names`; anything but a mapping is returned unchanged.

    `names`: may map each name to its description in messages; `default`: the values of names that may be left out;
    `aliases`: other spellings of names; `elsewhere`: for names outside of `names`, the reason in the message.

    Raises: `BadNames`, which names the argument `what`.
    """
    if not isinstance(values, Mapping):
        return values
    labels = dict(names) if isinstance(names, Mapping) else {name: name for name in names}
    named: dict[str, Any] = {}
    for key, value in values.items():
        name = key.name if isinstance(key, sp.Symbol) else key
        canonical = name if name in labels else aliases.get(name, name)
        if canonical not in labels:
            raise BadNames(what, f"names {cut(repr(name), _LENGTH)}, {elsewhere.get(name) or _unknown(name, labels)}")
        if canonical in named:
            raise BadNames(what, f"names {canonical} twice; give it once")
        named[canonical] = value
    complete = {**default, **named}
    missing = [text for name, text in labels.items() if name not in complete]
    if missing:
        needed = ", ".join(name for name in labels if name not in default)
        raise BadNames(what, f"has no value for {', '.join(missing)}; give one for each of {needed}")
    return [complete[name] for name in labels]


def _unknown(name: Any, labels: Mapping[str, str]) -> str:
    if not labels:
        return "but there are no names to give"
    spelled = str(name)[:60]
    close = [each for each in labels if each.lower() == spelled.lower()] or get_close_matches(spelled, labels, n=1)
    fix = f"did you mean {close[0]}?" if close else f"they are {', '.join(labels.values())}"
    return f"which is none of the names; {fix}"


def quadratic(what: str, values: Any, names: Iterable[str], **others: Mapping[str, str]) -> Any:
    """Return the diagonal (n), or the rows (n, n), of a symmetric matrix in the order of `names`, from a mapping by
    name; anything but a mapping is returned unchanged. `others`: further arguments of `in_order`.

    An entry off the diagonal may be given in one of its two rows only; an entry in neither row is 0.

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
        blank = {other: _OMITTED for other in names if other != name}
        matrix.append(in_order(f"{what} of {name}", row, names, default=blank, **others))
    order = range(len(matrix))
    both = [[matrix[j][i] if matrix[i][j] is _OMITTED else matrix[i][j] for j in order] for i in order]
    return [[0.0 if entry is _OMITTED else entry for entry in row] for row in both]


def by_coordinate(what: str, values: Any, form: Form) -> Any:
    """Return the diagonal (n), or the rows (n, n), of a symmetric matrix in the order of the form's coordinates z, from
    a mapping by `Form.names`; anything but a mapping is returned unchanged. Where z_i is minus a state, the values are
    those of the state. Raises: `BadNames`; for a state that is no coordinate its message says which names to give
    instead."""
    if not isinstance(values, Mapping):  # skip the definitions of the names, which are long in a phase form
        return values
    entry = zip(form.names, form.entry, strict=True)  # a coordinate other than a state or its negative has a definition
    names = {name: name if str(e) in (name, f"-{name}") else f"{name} = {cut(str(e), _LENGTH)}" for name, e in entry}
    entries = quadratic(what, values, names, elsewhere=_no_coordinates(form, names))
    if not any(isinstance(row, Mapping) for row in values.values()):
        return entries
    mirrored = zip(form.signs, entries, strict=True)
    return [
        [0.0 - a if s != t and isinstance(a, Real) else a for t, a in zip(form.signs, row, strict=True)]
        for s, row in mirrored
    ]


def by_output(what: str, values: Any, form: Form) -> Any:
    """Return the values of a mapping by name of the plant's outputs, in the order of the outputs. Raises:
    `BadNames`."""
    return in_order(what, values, names_of(form.system.outputs))


def names_of(signals: Iterable[sp.Symbol]) -> tuple[str, ...]:
    """Return the names of the signals."""
    return tuple(signal.name for signal in signals)


def values_by_name(field: Field) -> dict[str, float] | list[float] | float:
    """Return the initial values of a field of the program: by name if its elements have names, else a list, or a single
    number."""
    values = [float(value) for value in field.initial]
    if field.labels:
        return dict(zip(field.labels, values, strict=True))
    return values if field.size > 1 else values[0]


def gains_by_name(gains: Iterable[Field]) -> dict[str, Any]:
    """Return the values of gains by name; for a gain with several elements, those by the names of states or outputs."""
    return {gain.name: values_by_name(gain) for gain in gains}


FACTORED = "y y'"  # the unit of the gain R where it is D of R = L D L'


def field_text(field: Field) -> str:
    """Return the initial values of a field of the program as text: Q = {x1: 0.1, x2: 0.01}, theta = 5."""
    values, name = values_by_name(field), f"D of {field.name} = L D L'" if field.unit == FACTORED else field.name
    if isinstance(values, dict) and len(values) > 1:
        return f"{name} = {_braces({name: tidy(value) for name, value in values.items()})}"
    return f"{name} = {', '.join(map(tidy, field.initial))}"


def matrix_line(name: str, matrix: np.ndarray, form: Form) -> tuple[str, ...]:
    """Return a line for the banner of the generated code with the rows, by state, of a matrix (n, n); () if it is
    diagonal."""
    if not np.count_nonzero(matrix - np.diag(np.diag(matrix))):
        return ()
    rows = (matrix * np.outer(form.signs, form.signs) + 0.0).tolist()
    lines = [_braces(dict(zip(form.names, map(tidy, row), strict=True))) for row in rows]
    text = _braces(dict(zip(form.names, lines, strict=True)))
    return (f"{name} = {text}; the gain {name} is D of its factors",)


def _braces(values: Mapping[str, str]) -> str:
    return f"{{{', '.join(f'{name}: {value}' for name, value in values.items())}}}"


def _no_coordinates(form: Form, names: Mapping[str, str]) -> dict[str, str]:
    origin, entry = form.system.origin, dict(zip(names, form.entry, strict=True))
    advice = {z.name: f"which is {name} here; name {name}" for z, name in zip(form.states, names, strict=True)}
    for state in (*form.system.states, *(origin.plant.states if origin else ())):
        reading = [text for name, text in names.items() if text != name and state in entry[name].free_symbols]
        inside = ", ".join(reading or names.values())
        advice[state.name] = f"which is no coordinate of this form ({form.kind}); in its place give {inside}"
    return {name: sentence for name, sentence in advice.items() if name not in names}


def sizes(what: str, values: Each, names: Sequence[str], default: float = 0.0) -> list[Fraction]:
    """Return exact nonnegative numbers, such as sizes of errors or noise, in the order of `names`, from a mapping by
    name; `default` for a missing name. Raises: `BadNames`, `BadGain`."""
    each = each_by_name(what, values, names, default)
    return [size(f"{what} of {name}", value) for name, value in zip(names, each, strict=True)]


def each_by_name(what: str, values: Each, names: Sequence[str], default: Any) -> list[Any]:
    """Return the values of a mapping by name in the order of `names`, `default` for a missing name. Raises:
    `BadNames`."""
    if not isinstance(values, Mapping | None):
        raise BadNames(what, f"= {values!r} is no mapping from names to numbers")
    return list(in_order(what, values or {}, names, default=dict.fromkeys(names, default)))


def size(what: str, value: Any) -> Fraction:
    """Return a finite nonnegative number from the user as an exact fraction. Raises: `BadGain`, which names the
    argument `what`, for anything else."""
    number = real(what, value)
    if isinstance(value, bool) or not 0 <= number < math.inf:
        raise BadGain(f"{what} = {value if isinstance(value, bool) else f'{number:g}'}", _SIZE)
    return Fraction(number)
