"""One walk over a certificate's expressions for every arithmetic, and derivatives in any of them.

An arithmetic is a type with + - * / and the functions that `Arithmetic` lists. `dual` makes of it the arithmetic of
values with slopes, which is forward differentiation.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from typing import Any

from .tables import is_table, next_of
from .text import Expression


class Undefined(Exception):  # not an error of the user: the walk over the boxes catches it
    """A value is not a finite real number on this box, or no rule shows that it is."""


@dataclass(frozen=True)
class Arithmetic:
    """What a kind of value can do besides + - * /.

    `number`: of a Fraction; `power`: whole exponents; `root`: rational exponents; `function`: by name; `hull`: of two
    values the first where another is above zero, the second where it is below, else what holds both (the slope of Min
    and Max).
    """

    number: Callable[[Fraction], Any]
    power: Callable[[Any, int], Any]
    root: Callable[[Any, Fraction], Any]
    function: Callable[[str, tuple[Any, ...]], Any]
    hull: Callable[[Any, Any, Any], Any]


def evaluate(expression: Expression, values: Mapping[str, Any], arithmetic: Arithmetic) -> Any:
    """The value of an expression where its names have these values.

    Raises: `Undefined`, and what the arithmetic raises.
    """
    computed: list[Any] = []
    for op, places, value in expression.instructions:
        args = [computed[place] for place in places]
        computed.append(_apply(op, args, value, values, arithmetic))
    return computed[expression.result]


def _apply(op: str, args: list[Any], value: Any, values: Mapping[str, Any], arithmetic: Arithmetic) -> Any:
    if op in _OPERATIONS:
        return _OPERATIONS[op](*args)
    if op == "symbol":
        return values[value]
    if op == "number":
        return arithmetic.number(value)
    if op == "power":
        return arithmetic.power(args[0], value)
    if op == "root":
        return arithmetic.root(args[0], value)
    if op == "raise":  # for a base above zero
        return arithmetic.function("exp", (args[1] * arithmetic.function("log", (args[0],)),))
    return arithmetic.function(op, tuple(args))


_OPERATIONS: Mapping[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
}


@dataclass(frozen=True)
class Dual:
    """A value with its slopes; a slope that is missing is zero."""

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
        """The slopes times a factor: the chain rule."""
        return {k: factor * slope for k, slope in self.slopes.items()}


def _sum(a: Mapping[int, Any], b: Mapping[int, Any]) -> dict[int, Any]:
    return {**a, **{k: a[k] + slope if k in a else slope for k, slope in b.items()}}


def dual(base: Arithmetic) -> Arithmetic:
    """Values with slopes in another arithmetic."""

    def power(x: Dual, exponent: int) -> Dual:
        value = base.power(x.value, exponent)
        if not exponent or not x.slopes:
            return Dual(value, {})
        return Dual(value, x.scaled(base.number(Fraction(exponent)) * base.power(x.value, exponent - 1)))

    def root(x: Dual, exponent: Fraction) -> Dual:
        value = base.root(x.value, exponent)
        if not x.slopes:
            return Dual(value, {})
        rest = exponent - 1
        slope = base.power(x.value, int(rest)) if rest.denominator == 1 else base.root(x.value, rest)
        return Dual(value, x.scaled(base.number(exponent) * slope))

    def function(name: str, args: tuple[Dual, ...]) -> Dual:
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

    def both(way: Dual, a: Dual, b: Dual) -> Dual:
        """Where the way passes 0, what is chosen jumps, and has any slope in what moves the way."""
        jump = way.scaled(base.function("jump", (way.value,)))
        return Dual(base.hull(way.value, a.value, b.value), _sum(_either(way.value, a, b, base), jump))

    return Arithmetic(lambda value: Dual(base.number(value), {}), power, root, function, both)


def _extreme(name: str, a: Dual, b: Dual, base: Arithmetic) -> Dual:
    """Min or Max of two."""
    way = a.value - b.value if name == "Max" else b.value - a.value
    return Dual(base.function(name, (a.value, b.value)), _either(way, a, b, base))


def _either(way: Any, a: Dual, b: Dual, base: Arithmetic) -> dict[int, Any]:
    """The slopes of a where the way is above 0, those of b where it is below."""
    zero = base.number(Fraction(0))
    return {k: base.hull(way, a.slopes.get(k, zero), b.slopes.get(k, zero)) for k in sorted({*a.slopes, *b.slopes})}


def _slope(name: str, x: Any, value: Any, base: Arithmetic) -> Any:
    """df/dx of a function of one argument, from x and f(x)."""
    if name in _OTHERS:
        factor, other = _OTHERS[name]
        return base.number(Fraction(factor)) * base.function(other, (x,))
    one = base.number(Fraction(1))
    if name in _RATIONAL:
        return _RATIONAL[name](one, base.power(x, 2), base.power(value, 2), x, value)
    if name in _ROOTS:
        factor, at_zero, square = _ROOTS[name]
        inside = base.number(Fraction(at_zero)) + base.number(Fraction(square)) * base.power(x, 2)
        return base.number(Fraction(factor)) * base.root(inside, Fraction(-1, 2))
    raise Undefined(f"{name} has no slope")


# f' = factor * other(x). No text has a `side`, the slope of Abs, or a `jump`, that of a side; a sign has no slope.
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
