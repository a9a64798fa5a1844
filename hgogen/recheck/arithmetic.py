"""Evaluation of a certificate's expressions in any arithmetic, with derivatives, and exact fractions.

An arithmetic is a type with + - * / and the functions of `Arithmetic`. `dual` extends it to values with slopes, which
is forward differentiation.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial, reduce
from operator import add
from typing import Any, TypeVar

from .tables import is_table, next_of, value_at
from .text import OPERATIONS, Expression

Value = TypeVar("Value")


class Undefined(Exception):  # not an error of the user: the walk over the boxes catches it
    """The error that a value is not proved to be a finite real number on a box."""


class Unproved(Exception):
    """The error that a statement of the certificate is not confirmed; the text says which one and where."""


@dataclass(frozen=True)
class Arithmetic:
    """The operations on a kind of values other than + - * /: `number` from a Fraction; `power` with an integer
    exponent; `root` with a rational exponent; `function` by its name.

    `hull`, of a selector and two values: the first value if the selector is positive, the second if it is negative,
    else a value that contains both (the slope of Min and Max).
    """

    number: Callable[[Fraction], Any]
    power: Callable[[Any, int], Any]
    root: Callable[[Any, Fraction], Any]
    function: Callable[[str, tuple[Any, ...]], Any]
    hull: Callable[[Any, Any, Any], Any]


def evaluate(expression: Expression, values: Mapping[str, Any], arithmetic: Arithmetic) -> Any:
    """Return the value of an expression in an arithmetic, for these `values` of its names. Raises: `Undefined`, and the
    errors of the arithmetic."""
    computed: list[Any] = []
    for op, places, value in expression.instructions:
        args = [computed[place] for place in places]
        if op in OPERATIONS:
            computed.append(OPERATIONS[op](*args))
        elif op == "symbol":
            computed.append(values[str(value)])
        elif op in ("number", "power", "root"):
            computed.append(getattr(arithmetic, op)(*args, value))
        elif op == "raise":  # for a base above zero
            computed.append(arithmetic.function("exp", (args[1] * arithmetic.function("log", (args[0],)),)))
        else:
            computed.append(arithmetic.function(op, tuple(args)))
    return computed[expression.result]


def total(terms: Iterable[Value]) -> Value:
    """Return the sum of the terms, at least one."""
    whole: Value = reduce(add, terms)
    return whole


def determinant(rows: Sequence[Sequence[Any]]) -> Any:
    """Return the determinant of a matrix (n, n) in any arithmetic, n > 0, by expansion along the first row."""
    first, *others = rows
    if not others:
        return first[0]
    terms = []
    for j, x in enumerate(first):
        if x:  # skip entries that are exactly 0
            minor = determinant([[*row[:j], *row[j + 1 :]] for row in others])
            terms.append(-(x * minor) if j % 2 else x * minor)
    return total(terms) if terms else first[0]


@dataclass(frozen=True)
class Dual:
    """A dual number: a `value` with its partial derivatives, `slopes`, by the index of a name; a missing slope is
    zero."""

    value: Any
    slopes: Mapping[int, Any]

    def __add__(self, other: "Dual") -> "Dual":
        return Dual(self.value + other.value, _sum(self.slopes, other.slopes))

    def __neg__(self) -> "Dual":
        return Dual(-self.value, {k: -slope for k, slope in self.slopes.items()})

    def __sub__(self, other: "Dual") -> "Dual":
        return Dual(self.value - other.value, _sum(self.slopes, {k: -slope for k, slope in other.slopes.items()}))

    def __mul__(self, other: "Dual") -> "Dual":
        slopes = _sum(self.scaled(other.value), other.scaled(self.value))
        return Dual(self.value * other.value, slopes)

    def __truediv__(self, other: "Dual") -> "Dual":
        value = self.value / other.value
        rise = _sum(self.slopes, {k: -(value * slope) for k, slope in other.slopes.items()})
        return Dual(value, {k: slope / other.value for k, slope in rise.items()})

    def scaled(self, factor: Any) -> dict[int, Any]:
        """Return all slopes multiplied by a factor, as the chain rule needs them."""
        return {k: factor * slope for k, slope in self.slopes.items()}


def _sum(a: Mapping[int, Any], b: Mapping[int, Any]) -> dict[int, Any]:
    return {**a, **{k: a[k] + slope if k in a else slope for k, slope in b.items()}}


def dual(base: Arithmetic) -> Arithmetic:
    """Return the arithmetic of dual numbers (`Dual`) whose values and derivatives are in the arithmetic `base`."""

    def power(x: Dual, exponent: int) -> Dual:
        value = base.power(x.value, exponent)
        if not exponent or not x.slopes:
            return Dual(value, {})
        return Dual(value, x.scaled(base.number(Fraction(exponent)) * base.power(x.value, exponent - 1)))

    def root(x: Dual, exponent: Fraction) -> Dual:
        value = base.root(x.value, exponent)
        if not x.slopes:
            return Dual(value, {})
        lower = exponent - 1
        slope = base.power(x.value, int(lower)) if lower.denominator == 1 else base.root(x.value, lower)
        return Dual(value, x.scaled(base.number(exponent) * slope))

    def both(way: Dual, a: Dual, b: Dual) -> Dual:
        """Return the hull of a and b. Where `way` may be 0 the function jumps,
        so its partial derivatives in the names of `way` are unbounded."""
        jump = way.scaled(base.function("jump", (way.value,)))
        return Dual(base.hull(way.value, a.value, b.value), _sum(_either(way.value, a, b, base), jump))

    return Arithmetic(lambda value: Dual(base.number(value), {}), power, root, partial(_function, base), both)


def _function(base: Arithmetic, name: str, args: tuple[Dual, ...]) -> Dual:
    at = tuple(arg.value for arg in args)
    value = base.function(name, at)
    if not any(arg.slopes for arg in args):
        return Dual(value, {})
    if name in ("Min", "Max"):
        return reduce(lambda a, b: _extreme(name, a, b, base), args)
    if name == "atan2":
        y, x = args
        square = base.power(x.value, 2) + base.power(y.value, 2)
        return Dual(value, _sum(y.scaled(x.value / square), x.scaled(-y.value / square)))
    if is_table(name):
        rates = (base.function(next_of(name, k), at) if arg.slopes else None for k, arg in enumerate(args))
        return Dual(value, reduce(_sum, (arg.scaled(rate) for arg, rate in zip(args, rates, strict=True))))
    return Dual(value, args[0].scaled(_slope(name, args[0].value, value, base)))


def seeded(values: Mapping[str, Any], names: Iterable[str], arithmetic: Arithmetic) -> dict[str, Dual]:
    """Return the `values` by name as dual numbers for differentiation: each of `names` has the slope 1 at its own
    index."""
    places, one = {name: k for k, name in enumerate(names)}, arithmetic.number(Fraction(1))
    return {name: Dual(value, {places[name]: one} if name in places else {}) for name, value in values.items()}


def jacobian(
    rows: Iterable[Expression], values: Mapping[str, Any], names: Sequence[str], arithmetic: Arithmetic
) -> list[list[Any]]:
    """Return the Jacobian (n, m) of n expressions, `rows`, in m `names`, at the `values` of all names. Raises: as
    `evaluate`."""
    moving, zero, base = seeded(values, names, arithmetic), arithmetic.number(Fraction(0)), dual(arithmetic)
    slopes = [evaluate(row, moving, base).slopes for row in rows]
    return [[row.get(k, zero) for k in range(len(names))] for row in slopes]


def along(
    row: Expression, values: Mapping[str, Any], speeds: Mapping[str, Any], arithmetic: Arithmetic
) -> tuple[Any, Any]:
    """Return the value of an expression and its time derivative at the `values` of its names; `speeds`: the time
    derivatives of the names. Raises: as `evaluate`."""
    moving = {name: Dual(value, {0: speeds[name]} if name in speeds else {}) for name, value in values.items()}
    result = evaluate(row, moving, dual(arithmetic))
    return result.value, result.slopes.get(0, arithmetic.number(Fraction(0)))


def _extreme(name: str, a: Dual, b: Dual, base: Arithmetic) -> Dual:
    way = a.value - b.value if name == "Max" else b.value - a.value
    return Dual(base.function(name, (a.value, b.value)), _either(way, a, b, base))


def _either(way: Any, a: Dual, b: Dual, base: Arithmetic) -> dict[int, Any]:
    zero = base.number(Fraction(0))
    return {k: base.hull(way, a.slopes.get(k, zero), b.slopes.get(k, zero)) for k in sorted({*a.slopes, *b.slopes})}


def _slope(name: str, x: Any, value: Any, base: Arithmetic) -> Any:
    one = base.number(Fraction(1))
    if name in _OTHERS:
        factor, other = _OTHERS[name]
        return base.number(Fraction(factor)) * base.function(other, (x,))
    if name in _RATIONAL:
        return _RATIONAL[name](one, base.power(x, 2), base.power(value, 2), x, value)
    if name in _ROOTS:
        factor, at_zero, square = _ROOTS[name]
        inside = base.number(Fraction(at_zero)) + base.number(Fraction(square)) * base.power(x, 2)
        return base.number(Fraction(factor)) * base.root(inside, Fraction(-1, 2))
    raise Undefined(f"{name} has no slope")


# f' = factor * other(x). Only slopes contain `side`, the slope of Abs, and `jump`, that of `side`; sign has no slope.
_OTHERS = {
    "sin": (1, "cos"),
    "cos": (-1, "sin"),
    "sinh": (1, "cosh"),
    "cosh": (1, "sinh"),
    "Abs": (1, "side"),
    "side": (1, "jump"),
}
_RATIONAL: Mapping[str, Callable[..., Any]] = {
    "exp": lambda one, xx, ff, x, f: f,
    "log": lambda one, xx, ff, x, f: one / x,
    "tan": lambda one, xx, ff, x, f: one + ff,
    "tanh": lambda one, xx, ff, x, f: one - ff,
    "atan": lambda one, xx, ff, x, f: one / (one + xx),
    "atanh": lambda one, xx, ff, x, f: one / (one - xx),
}
# f' = factor / sqrt(at_zero + square x^2)
_ROOTS = {"asin": (1, 1, -1), "acos": (-1, 1, -1), "asinh": (1, 1, 1), "acosh": (1, -1, 1)}


# --- exact fractions, at a point

_LONGEST = 4096  # bits of an exact fraction; beyond it intervals answer


class NotExact(Exception):
    """The error that a value is not a rational number, or one with too many digits."""


def _exact_power(x: Fraction, exponent: int) -> Fraction:
    if exponent < 0 and not x:
        raise Undefined("division by zero")
    if max(x.numerator.bit_length(), x.denominator.bit_length()) * abs(exponent) > _LONGEST:
        raise NotExact
    return x**exponent


def _exact_root(x: Fraction, exponent: Fraction) -> Fraction:
    if x < 0 or (x == 0 and exponent < 0):
        raise Undefined("a root of a negative number")
    parts = [_whole_root(part, exponent.denominator) for part in (x.numerator, x.denominator)]
    return _exact_power(Fraction(*parts), exponent.numerator)


def _whole_root(value: int, q: int) -> int:
    root = round(value ** (1 / q)) if value < 2**50 else math.isqrt(value) if q == 2 else 0
    if root**q != value:
        raise NotExact
    return root


# f(0) of the functions with a rational value there
_AT_ZERO = {
    **dict.fromkeys(("sin", "tan", "asin", "atan", "sinh", "tanh", "asinh", "atanh"), 0),
    **dict.fromkeys(("cos", "exp", "cosh"), 1),
}
_EXACT: Mapping[str, Callable[..., Fraction]] = {"Min": min, "Max": max, "Abs": abs}


def _exact_function(name: str, args: tuple[Fraction, ...]) -> Fraction:
    if is_table(name) and (value := value_at(name, args)) is not None:
        return value
    if name in _EXACT:
        return _EXACT[name](*args)
    if name == "sign" or (name == "side" and args[0]):
        return Fraction((args[0] > 0) - (args[0] < 0))
    if name == "log" and args[0] <= 0:
        raise Undefined("the logarithm of zero or less")
    if name == "log" and args[0] == 1:
        return Fraction(0)
    if name in _AT_ZERO and args[0] == 0:
        return Fraction(_AT_ZERO[name])
    raise NotExact


def _equal(way: Fraction, a: Fraction, b: Fraction) -> Fraction:
    if a != b:
        raise NotExact
    return a


fractions = Arithmetic(lambda value: value, _exact_power, _exact_root, _exact_function, _equal)
