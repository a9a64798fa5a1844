"""How far a number that a program computes may be from that of exact arithmetic: a running error analysis.

Each value v of exact arithmetic is in an interval, and |v~ - v| <= e, v~ what is computed of it. Round to nearest takes
at most u |v~| more, u = 2^-24 or 2^-53, and `tiny`, the smallest normal number, where a result underflows:

    v = a +- b  e = e_a + e_b                           v = a b    e = |a| e_b + |b| e_a + e_a e_b
    v = a / b   e = (e_a + |v| e_b)/(|b| - e_b)         v = f(a)   e = sup|f'| e_a
    each        + k (u (|v| + e) + tiny)

k is 1 of these operations, 0 of what is exact: -a, |a|, min, max, products with 1 and 2, whole numbers up to 2^24. A
constant that is none of these is rounded 8 times as a double, and once more. Of functions k is what a program's
functions are measured to err by, twice: no arithmetic here shows it. Source: N. J. Higham, Accuracy and Stability of
Numerical Algorithms, 2nd ed., 2002, section 3.3.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

from .arithmetic import Arithmetic, Dual, Undefined, dual, evaluate
from .interval import Interval, hull, intervals, point
from .text import Expression

_NONE, _ONE = point(Fraction(0)), point(Fraction(1))
_WHOLE = 2**24
_FOLDED = Fraction(8, 2**53) * (1 + Fraction(1, 2**40))  # of a constant, before it is rounded to the precision
_BITS = {"float": (24, 126), "double": (53, 1022)}  # of u and of the smallest normal number
_ANGLE = Fraction(200)  # up to which sin, cos and tan are measured
UNITS: Mapping[str, Fraction] = {  # u by which a function may err, twice its measured ulps, an ulp at most 2 u
    **{name: Fraction(8) for name in ("sqrt", "exp", "log", "sin", "cos", "asin", "acos", "atan", "cosh")},
    **{name: Fraction(14) for name in ("tanh", "asinh", "acosh", "atanh")},
    "tan": Fraction(16),
    "sinh": Fraction(10),
}
POWER = Fraction(6), Fraction(8)  # the same of x^k: so many, and so many for each k |log x|
PRECISIONS = tuple(_BITS)


@dataclass(frozen=True)
class Computed:
    """The interval of a value, and the largest error, an interval whose upper end counts; `number` of a value that is
    one, which the program has exactly."""

    real: str
    value: Interval
    error: Interval = _NONE
    number: Fraction | None = None

    @property
    def around(self) -> Interval:
        """Where the exact and the computed value are."""
        return self.value + _both(self.error)

    def beside(self, size: Interval) -> "Computed":
        """Of an exact value that may be so far beside."""
        return Computed(self.real, self.value + _both(size), self.error + size)

    def __add__(self, other: "Computed") -> "Computed":
        if self.number == 0 or other.number == 0:
            return other if self.number == 0 else self
        return self.rounded(self.value + other.value, self.error + other.error)

    def __sub__(self, other: "Computed") -> "Computed":
        return self.rounded(self.value - other.value, self.error + other.error)

    def __neg__(self) -> "Computed":
        return Computed(self.real, -self.value, self.error, None if self.number is None else -self.number)

    def __mul__(self, other: "Computed") -> "Computed":
        for one, factor in ((self, other), (other, self)):
            if factor.number in (1, 2):
                return self.rounded(factor.value * one.value, factor.value * one.error, Fraction(0))
        a, b = _size(self.value), _size(other.value)
        value = intervals.power(self.value, 2) if self is other else self.value * other.value
        return self.rounded(value, a * other.error + b * self.error + self.error * other.error)

    def __truediv__(self, other: "Computed") -> "Computed":
        value = self.value / other.value
        return self.rounded(value, (self.error + _size(value) * other.error) / _size(other.around))

    def rounded(self, value: Interval, inherited: Interval, units: Fraction = Fraction(1)) -> "Computed":
        """The result of an operation on it, which errs by so many u. Raises: `Undefined` of what may overflow."""
        bits, normal = _BITS[self.real]
        share, whole = units / 2**bits, _size(value) + inherited
        error = inherited + point(share * (1 + 2 * share * (units > 1))) * whole + point(units / 2**normal)
        if not (error.finite and (whole + error).at_most(Fraction(2) ** (normal + 1))):
            raise Undefined("a value that may overflow")
        return Computed(self.real, value, error)

    def through(self, name: str, units: Fraction) -> "Computed":
        """A function of it that is no operation."""
        slope = dual(intervals).function(name, (Dual(self.around, {0: _ONE}),)).slopes[0]
        return self.rounded(intervals.function(name, (self.value,)), _size(slope) * self.error, units)


def _size(value: Interval) -> Interval:
    size: Interval = intervals.function("Abs", (value,))
    return size


def _by_power(x: Interval, exponent: Fraction | int) -> Fraction:
    """The u by which x^exponent may err. Raises: `Undefined` where it is not bounded."""
    least, each = map(point, POWER)
    steep = least + each * point(abs(Fraction(exponent))) * _size(intervals.function("log", (x,)))
    high = steep.exactly[1]
    if not isinstance(high, Fraction):
        raise Undefined("a power whose error has no bound")
    return high


def _both(error: Interval) -> Interval:
    return hull(-error, error)


def constant(real: str, text: Expression) -> Computed:
    """A number that an expression without names says, which a program has as one constant. Raises: `Undefined`."""
    value: Interval = evaluate(text, {}, intervals)
    return Computed(real, value).rounded(value, _size(value) * point(_FOLDED))


def precision(real: str) -> Arithmetic:
    """The arithmetic of a program in a precision, of `PRECISIONS`."""

    def number(value: Fraction) -> Computed:
        if value.denominator == 1 and abs(value) <= _WHOLE:
            return Computed(real, point(value), number=value)
        return Computed(real, point(value)).rounded(point(value), point(abs(value) * _FOLDED))

    def power(x: Computed, exponent: int) -> Computed:
        size = _size(x.around)
        slope = intervals.power(size, exponent - 1) * point(abs(Fraction(exponent)))
        return x.rounded(intervals.power(x.value, exponent), slope * x.error, _by_power(size, exponent))

    def root(x: Computed, exponent: Fraction) -> Computed:
        units = UNITS["sqrt"] if exponent == Fraction(1, 2) else _by_power(x.around, exponent)
        slope = intervals.root(x.around, exponent - 1) * point(abs(exponent))
        return x.rounded(intervals.root(x.value, exponent), slope * x.error, units)

    def function(name: str, args: tuple[Computed, ...]) -> Computed:
        if name in ("Min", "Max"):
            first, second = args
            value = intervals.function(name, (first.value, second.value))
            return Computed(real, value, intervals.function("Max", (first.error, second.error)))
        (x,) = args
        if name == "Abs":
            return Computed(real, _size(x.value), x.error)
        if name not in UNITS:
            raise Undefined(f"how far {name} errs is not known")
        if name in ("sin", "cos", "tan") and not _size(x.around).at_most(_ANGLE):
            raise Undefined("an angle beyond those of which the error is measured")
        return x.through(name, UNITS[name])

    def no_hull(way: Computed, a: Computed, b: Computed) -> Computed:
        raise Undefined("no second slopes of Min and Max")

    return Arithmetic(number, power, root, function, no_hull)
