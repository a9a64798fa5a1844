"""The arithmetic that verifies ranges: mpmath's intervals, outward rounded."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache, reduce
from typing import Any

from mpmath import libmp

from .arithmetic import Arithmetic, Undefined
from .tables import is_table, range_on

PRECISION = 80  # bits
_GUARD = 30  # bits computed beyond these, and then given away as a margin for the error of a function's value
_LARGEST = 2**16  # of an argument of exp and of the exponent of 2 of an angle

Ends = tuple[Any, Any]  # two numbers of mpmath, low and high
_DOWN, _UP = libmp.round_floor, libmp.round_ceiling
_INFINITE = (libmp.fninf, libmp.finf)


@dataclass(frozen=True)
class Interval:
    """The numbers from `ends[0]` to `ends[1]`; an end may be infinite, none is NaN."""

    ends: Ends

    def __add__(self, other: "Interval") -> "Interval":
        return Interval(libmp.mpi_add(self.ends, other.ends, PRECISION))

    def __neg__(self) -> "Interval":
        return Interval(libmp.mpi_neg(self.ends))

    def __sub__(self, other: "Interval") -> "Interval":
        return Interval(libmp.mpi_sub(self.ends, other.ends, PRECISION))

    def __mul__(self, other: "Interval") -> "Interval":
        return Interval(libmp.mpi_mul(self.ends, other.ends, PRECISION))

    def __truediv__(self, other: "Interval") -> "Interval":
        if other.sign == 0:
            raise Undefined("division by what may be zero")
        return Interval(libmp.mpi_div(self.ends, other.ends, PRECISION))

    @property
    def sign(self) -> int:
        """1 or -1 where every number has that sign, else 0."""
        low, high = self.ends
        return 1 if libmp.mpf_sign(low) > 0 else -1 if libmp.mpf_sign(high) < 0 else 0

    @property
    def exactly(self) -> tuple[Fraction | float, Fraction | float]:
        """The ends, as fractions or infinite."""
        return _exactly(self.ends[0]), _exactly(self.ends[1])

    @property
    def finite(self) -> bool:
        """Whether both ends are numbers."""
        return not any(end in (*_INFINITE, libmp.fnan) for end in self.ends)

    def at_least(self, bound: Fraction | float) -> bool:
        """Whether no number of the interval is below the bound."""
        return bool(libmp.mpf_ge(self.ends[0], _rounded(bound, _UP)))

    def at_most(self, bound: Fraction | float) -> bool:
        """Whether no number of the interval is above the bound."""
        return bool(libmp.mpf_le(self.ends[1], _rounded(bound, _DOWN)))


def _rounded(value: Fraction | float, direction: str) -> Any:
    """A number rounded in a direction; an infinite one as it is."""
    if not isinstance(value, Fraction):
        if math.isinf(value):
            return libmp.from_float(value)
        value = Fraction(value)
    return _quotient(value.numerator, value.denominator, direction)


@lru_cache(maxsize=1 << 14)  # a model's constants, and the ends that neighbouring boxes share
def _quotient(numerator: int, denominator: int, direction: str) -> Any:
    return libmp.from_rational(numerator, denominator, PRECISION, direction)


def point(value: Fraction) -> Interval:
    """The narrowest interval about a number."""
    return Interval((_rounded(value, _DOWN), _rounded(value, _UP)))


def between(low: Fraction | float, high: Fraction | float) -> Interval:
    """The interval from low to high, either of which may be infinite."""
    return Interval((_rounded(low, _DOWN), _rounded(high, _UP)))


def intersection(a: Interval, b: Interval) -> Interval:
    """What two enclosures of one value have in common."""
    return Interval((_larger(a.ends[0], b.ends[0]), _smaller(a.ends[1], b.ends[1])))


def hull(a: Interval, b: Interval) -> Interval:
    """The narrowest interval that holds both."""
    return Interval((_smaller(a.ends[0], b.ends[0]), _larger(a.ends[1], b.ends[1])))


def _smaller(a: Any, b: Any) -> Any:
    return a if libmp.mpf_le(a, b) else b


def _larger(a: Any, b: Any) -> Any:
    return b if libmp.mpf_le(a, b) else a


# --- functions


def _outward(value: Any, up: bool) -> Any:
    """A value with an error of a few units of its last place, moved outward by far more than that."""
    if value in (libmp.fzero, *_INFINITE):
        return value
    margin = libmp.mpf_shift(libmp.mpf_abs(value), -PRECISION)
    moved = libmp.mpf_add if up else libmp.mpf_sub
    return moved(value, margin, PRECISION + 2, _UP if up else _DOWN)


def _rising(
    function: Callable[..., Any], within: tuple[float, float] = (-math.inf, math.inf), complaint: str = "no value"
) -> Callable[[Interval], Interval]:
    """A function that rises, from its values at the ends of an argument that must be within a range."""

    def apply(x: Interval) -> Interval:
        if not (x.at_least(within[0]) and x.at_most(within[1])):
            raise Undefined(complaint)
        low, high = (function(end, PRECISION + _GUARD) for end in x.ends)
        if libmp.fnan in (low, high):
            raise Undefined("no value")
        return Interval((_outward(low, False), _outward(high, True)))

    return apply


def _levelling(function: Callable[..., Any], whole: Interval) -> Callable[[Interval], Interval]:
    """A function that rises within its `whole` range, of which an end stands for a value at too large an argument."""
    rising, largest = _rising(function), between(-_LARGEST, _LARGEST)

    def apply(x: Interval) -> Interval:
        low, high = (_larger(_smaller(end, largest.ends[1]), largest.ends[0]) for end in x.ends)
        values = intersection(rising(Interval((low, high))), whole)
        low = values.ends[0] if libmp.mpf_ge(x.ends[0], largest.ends[0]) else whole.ends[0]
        high = values.ends[1] if libmp.mpf_le(x.ends[1], largest.ends[1]) else whole.ends[1]
        return Interval((low, high))

    return apply


def _log(x: Interval) -> Interval:
    if x.sign <= 0:
        raise Undefined("the logarithm of what may be zero or less")
    return _rising(libmp.mpf_log)(x)


def _small(x: Interval) -> bool:
    """Whether an angle is small enough to be reduced at small cost."""
    return all(end == libmp.fzero or (end not in _INFINITE and end[2] + end[3] < 64) for end in x.ends)


def _sin(x: Interval) -> Interval:
    return _UNIT if not _small(x) else Interval(_turned(x.ends)[1])


def _cos(x: Interval) -> Interval:
    return _UNIT if not _small(x) else Interval(_turned(x.ends)[0])


@lru_cache(maxsize=1 << 10)  # the slope of one is the other, so that both are asked of an angle, and again
def _turned(angle: Ends) -> tuple[Ends, Ends]:
    cosine, sine = libmp.mpi_cos_sin(angle, PRECISION)
    return cosine, sine


def _tan(x: Interval) -> Interval:
    """Where the cosine keeps its sign and the interval is shorter than a period, tan rises."""
    width = libmp.mpf_sub(x.ends[1], x.ends[0], PRECISION, _UP)
    if not _small(x) or libmp.mpf_gt(width, libmp.from_int(3)) or _cos(x).sign == 0:
        raise Undefined("a pole of tan")
    first, last = (_sin(Interval((end, end))) / _cos(Interval((end, end))) for end in x.ends)
    return Interval((first.ends[0], last.ends[1]))


def _abs(x: Interval) -> Interval:
    return Interval(libmp.mpi_abs(x.ends, PRECISION))


def _sign(x: Interval) -> Interval:
    """The enclosure of sign(x), which rises from -1 over 0 to 1. Where x is 0 alone it is [-1, 1], which the slope of
    |x| may be."""
    low, high = (libmp.mpf_sign(end) for end in x.ends)
    return between(low, high) if low or high else _UNIT


def _side(x: Interval) -> Interval:
    """The slope of |x|: at the edge of a box the one within it, where x is 0 inside it, or all over it, [-1, 1]."""
    low, high = (libmp.mpf_sign(end) for end in x.ends)
    return point(Fraction(1 if high > 0 else -1)) if low * high >= 0 and (low or high) else _UNIT


def _jump(x: Interval) -> Interval:
    """The slope of a side: 0 where that is one number all over a box, else any: nothing is known of where it jumps."""
    side = _side(x)
    return between(-math.inf, math.inf) if side == _UNIT else point(Fraction(0))


def _cosh(x: Interval) -> Interval:
    return intersection(_rising_cosh(_abs(x)), between(1, math.inf))


def _atanh(x: Interval) -> Interval:
    one = libmp.from_int(1)
    if libmp.mpf_gt(x.ends[0], libmp.mpf_neg(one)) and libmp.mpf_lt(x.ends[1], one):
        return _rising(libmp.mpf_atanh)(x)
    raise Undefined("atanh at 1 or beyond")


def _atan2(y: Interval, x: Interval) -> Interval:
    """Away from the cut, by the quotient that has no pole."""
    half = _pi() * point(Fraction(1, 2))
    if x.sign > 0:
        return _atan(y / x)
    if y.sign:
        quarter = half if y.sign > 0 else -half
        return quarter - _atan(x / y)
    raise Undefined("atan2 on its cut")


_UNIT = between(-1, 1)
_ARC, _NOT_SO_LARGE = ((-1, 1), "an argument outside [-1, 1]"), ((-_LARGEST, _LARGEST), "too large an argument")
_atan = _rising(libmp.mpf_atan)
_rising_cosh = _rising(libmp.mpf_cosh, *_NOT_SO_LARGE)
_fallen_acos = _rising(lambda end, bits: libmp.mpf_neg(libmp.mpf_acos(end, bits)), *_ARC)


def _pi() -> Interval:
    return Interval(tuple(libmp.mpf_pi(PRECISION, way) for way in (_DOWN, _UP)))


def _chosen(choose: Callable[[Any, Any], Any]) -> Callable[..., Interval]:
    """What is chosen among all lows, and among all highs."""
    return lambda *args: Interval(
        (reduce(choose, [x.ends[0] for x in args]), reduce(choose, [x.ends[1] for x in args]))
    )


_FUNCTIONS: Mapping[str, Callable[..., Interval]] = {
    "pi": _pi,
    "exp": _levelling(libmp.mpf_exp, between(0, math.inf)),
    "log": _log,
    "sin": _sin,
    "cos": _cos,
    "tan": _tan,
    "atan": _atan,
    "atan2": _atan2,
    "asin": _rising(libmp.mpf_asin, *_ARC),
    "acos": lambda x: -_fallen_acos(x),
    "sinh": _rising(libmp.mpf_sinh, *_NOT_SO_LARGE),
    "cosh": _cosh,
    "tanh": _levelling(libmp.mpf_tanh, _UNIT),
    "acosh": _rising(libmp.mpf_acosh, (1, math.inf), "acosh below 1"),
    "atanh": _atanh,
    "asinh": _rising(libmp.mpf_asinh),
    "Abs": _abs,
    "sign": _sign,
    "side": _side,
    "jump": _jump,
    "Min": _chosen(_smaller),
    "Max": _chosen(_larger),
}


def _function(name: str, args: tuple[Interval, ...]) -> Interval:
    return _table(name, *args) if is_table(name) else _FUNCTIONS[name](*args)


@lru_cache(maxsize=1 << 10)  # a series that grows begins with the same values each time
def _table(name: str, *place: Interval) -> Interval:
    """The range of a table by its exact pieces."""
    ends = range_on(name, [x.exactly for x in place])
    if ends is None:
        raise Undefined("a derivative of a table where the one before jumps")
    return between(*ends)


def _exactly(end: Any) -> Fraction | float:
    if end in (*_INFINITE, libmp.fnan):
        return float(libmp.to_float(end))
    return Fraction(*map(int, libmp.to_rational(end)))


def _power(x: Interval, exponent: int) -> Interval:
    """x^k from the ends; an even power of an interval about zero begins at 0."""
    if exponent < 0:
        return point(Fraction(1)) / _power(x, -exponent)
    if exponent == 0:
        return point(Fraction(1))
    if exponent % 2 == 0:
        x = _abs(x)
    low, high = x.ends
    return Interval((_whole(low, exponent, _DOWN), _whole(high, exponent, _UP)))


def _whole(end: Any, exponent: int, direction: str) -> Any:
    if end == libmp.fninf:
        return end if exponent % 2 else libmp.finf
    return end if end == libmp.finf else libmp.mpf_pow_int(end, exponent, PRECISION, direction)


def _root(x: Interval, exponent: Fraction) -> Interval:
    """x^(p/q) of x >= 0, x > 0 for a negative exponent."""
    if not x.at_least(Fraction(0)):
        raise Undefined("a root of what may be negative")
    if exponent < 0:
        return point(Fraction(1)) / _root(x, -exponent)
    p, q = exponent.numerator, exponent.denominator
    root = _rising(lambda end, bits: end if end == libmp.finf else libmp.mpf_nthroot(end, q, bits))(x)
    return _power(intersection(root, between(0, math.inf)), p)


def _both(way: Interval, a: Interval, b: Interval) -> Interval:
    sign = _side(way).sign
    return hull(a, b) if not sign else a if sign > 0 else b


intervals = Arithmetic(point, _power, _root, _function, _both)
