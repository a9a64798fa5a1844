"""Interval arithmetic for ranges by mpmath's intervals, rounded outward.

Taylor series below an order are an arithmetic over these intervals: c_0 + c_1 s + .. + c_(N-1) s^(N-1).
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache, partial, reduce
from operator import add
from typing import Any

from mpmath import libmp

from .arithmetic import Arithmetic, Undefined
from .tables import in_one_piece, is_table, next_of, range_on, table_of

PRECISION = 80  # bits
_GUARD = 30  # extra bits, a margin for the error of a function's value
_LARGEST = 2**16  # argument of exp, tanh, sinh and cosh

Ends = tuple[Any, Any]  # two numbers of mpmath, low and high
_DOWN, _UP = libmp.round_floor, libmp.round_ceiling
_INFINITE = (libmp.fninf, libmp.finf)


@dataclass(frozen=True)
class Interval:
    """The numbers between the two `ends`; an end may be infinite, none is NaN."""

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
        """The sign 1 or -1 of all numbers in the interval, 0 if they have no common sign."""
        low, high = self.ends
        return 1 if libmp.mpf_sign(low) > 0 else -1 if libmp.mpf_sign(high) < 0 else 0

    @property
    def exactly(self) -> tuple[Fraction | float, Fraction | float]:
        """The ends as fractions or infinities."""
        return _exactly(self.ends[0]), _exactly(self.ends[1])

    @property
    def finite(self) -> bool:
        """Return whether both ends are finite."""
        return not any(end in (*_INFINITE, libmp.fnan) for end in self.ends)

    def at_least(self, bound: Fraction | float) -> bool:
        """Return whether all numbers of the interval are at least the bound."""
        return bool(libmp.mpf_ge(self.ends[0], _rounded(bound, _UP)))

    def at_most(self, bound: Fraction | float) -> bool:
        """Return whether all numbers of the interval are at most the bound."""
        return bool(libmp.mpf_le(self.ends[1], _rounded(bound, _DOWN)))


def _rounded(value: Fraction | float, direction: str) -> Any:
    if not isinstance(value, Fraction):
        if math.isinf(value):
            return libmp.from_float(value)
        value = Fraction(value)
    return _quotient(value.numerator, value.denominator, direction)


@lru_cache(maxsize=1 << 14)  # a model's constants, and the ends that neighbouring boxes share
def _quotient(numerator: int, denominator: int, direction: str) -> Any:
    return libmp.from_rational(numerator, denominator, PRECISION, direction)


def point(value: Fraction) -> Interval:
    """Return the narrowest interval that contains a number."""
    return Interval((_rounded(value, _DOWN), _rounded(value, _UP)))


def between(low: Fraction | float, high: Fraction | float) -> Interval:
    """Return the interval from low to high; both ends may be infinite."""
    return Interval((_rounded(low, _DOWN), _rounded(high, _UP)))


def intersection(a: Interval, b: Interval) -> Interval:
    """Return the intersection of two intervals that both contain one value."""
    return Interval((_larger(a.ends[0], b.ends[0]), _smaller(a.ends[1], b.ends[1])))


def hull(a: Interval, b: Interval) -> Interval:
    """Return the narrowest interval that contains both."""
    return Interval((_smaller(a.ends[0], b.ends[0]), _larger(a.ends[1], b.ends[1])))


def _smaller(a: Any, b: Any) -> Any:
    return a if libmp.mpf_le(a, b) else b


def _larger(a: Any, b: Any) -> Any:
    return b if libmp.mpf_le(a, b) else a


# --- functions


def _outward(value: Any, up: bool) -> Any:
    if value in (libmp.fzero, *_INFINITE):
        return value
    margin = libmp.mpf_shift(libmp.mpf_abs(value), -PRECISION)
    shifted = libmp.mpf_add if up else libmp.mpf_sub
    return shifted(value, margin, PRECISION + 2, _UP if up else _DOWN)


def _rising(
    function: Callable[..., Any], within: tuple[float, float] = (-math.inf, math.inf), complaint: str = "no value"
) -> Callable[[Interval], Interval]:
    def apply(x: Interval) -> Interval:
        if not (x.at_least(within[0]) and x.at_most(within[1])):
            raise Undefined(complaint)
        low, high = (function(end, PRECISION + _GUARD) for end in x.ends)
        if libmp.fnan in (low, high):
            raise Undefined("no value")
        return Interval((_outward(low, False), _outward(high, True)))

    return apply


def _saturating(function: Callable[..., Any], whole: Interval) -> Callable[[Interval], Interval]:
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
    return all(end == libmp.fzero or (end not in _INFINITE and end[2] + end[3] < 64) for end in x.ends)


def _sin(x: Interval) -> Interval:
    return _UNIT if not _small(x) else Interval(_turned(x.ends)[1])


def _cos(x: Interval) -> Interval:
    return _UNIT if not _small(x) else Interval(_turned(x.ends)[0])


@lru_cache(maxsize=1 << 10)  # sin and cos of one angle are both needed, as each is the slope of the other
def _turned(angle: Ends) -> tuple[Ends, Ends]:
    cosine, sine = libmp.mpi_cos_sin(angle, PRECISION)
    return cosine, sine


def _tan(x: Interval) -> Interval:
    width = libmp.mpf_sub(x.ends[1], x.ends[0], PRECISION, _UP)
    if not _small(x) or libmp.mpf_gt(width, libmp.from_int(3)) or _cos(x).sign == 0:
        raise Undefined("a pole of tan")
    first, last = (_sin(Interval((end, end))) / _cos(Interval((end, end))) for end in x.ends)
    return Interval((first.ends[0], last.ends[1]))


def _abs(x: Interval) -> Interval:
    return Interval(libmp.mpi_abs(x.ends, PRECISION))


def _sign(x: Interval) -> Interval:
    """Return the enclosure of sign(x), which increases from -1 to 1; at x = 0 alone [-1, 1], the generalised derivative
    of |x|."""
    low, high = (libmp.mpf_sign(end) for end in x.ends)
    return between(low, high) if low or high else _UNIT


def _side(x: Interval) -> Interval:
    low, high = (libmp.mpf_sign(end) for end in x.ends)
    return point(Fraction(1 if high > 0 else -1)) if low * high >= 0 and (low or high) else _UNIT


def _jump(x: Interval) -> Interval:
    """Return the enclosure of the derivative of sign(x): 0 where x keeps its sign, else the whole real line."""
    side = _side(x)
    return between(-math.inf, math.inf) if side == _UNIT else point(Fraction(0))


def _atanh(x: Interval) -> Interval:
    one = libmp.from_int(1)
    if libmp.mpf_gt(x.ends[0], libmp.mpf_neg(one)) and libmp.mpf_lt(x.ends[1], one):
        return _rising(libmp.mpf_atanh)(x)
    raise Undefined("atanh at 1 or beyond")


def _atan2(y: Interval, x: Interval) -> Interval:
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
    return lambda *args: Interval(
        (reduce(choose, [x.ends[0] for x in args]), reduce(choose, [x.ends[1] for x in args]))
    )


_FUNCTIONS: Mapping[str, Callable[..., Interval]] = {
    "pi": _pi,
    "exp": _saturating(libmp.mpf_exp, between(0, math.inf)),
    "log": _log,
    "sin": _sin,
    "cos": _cos,
    "tan": _tan,
    "atan": _atan,
    "atan2": _atan2,
    "asin": _rising(libmp.mpf_asin, *_ARC),
    "acos": lambda x: -_fallen_acos(x),
    "sinh": _rising(libmp.mpf_sinh, *_NOT_SO_LARGE),
    "cosh": lambda x: intersection(_rising_cosh(_abs(x)), between(1, math.inf)),
    "tanh": _saturating(libmp.mpf_tanh, _UNIT),
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


@lru_cache(maxsize=1 << 10)  # the orders of a series share their first values
def _table(name: str, *place: Interval) -> Interval:
    ends = range_on(name, [x.exactly for x in place])
    if ends is None:
        raise Undefined("a derivative of a table where the one before jumps")
    return between(*ends)


def _exactly(end: Any) -> Fraction | float:
    if end in (*_INFINITE, libmp.fnan):
        return float(libmp.to_float(end))
    return Fraction(*map(int, libmp.to_rational(end)))


def _power(x: Interval, exponent: int) -> Interval:
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
    """Return x^(p/q) for an interval x >= 0; for a negative exponent p/q x must be > 0."""
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


intervals = Arithmetic(
    point,
    _power,
    _root,
    lambda name, args: _table(name, *args) if is_table(name) else _FUNCTIONS[name](*args),
    _both,
)


_ABSENT = point(Fraction(0))


@dataclass(frozen=True)
class Taylor:
    """A Taylor polynomial c_0 + c_1 s + .. with interval coefficients."""

    coefficients: tuple[Interval, ...]

    def __add__(self, other: "Taylor") -> "Taylor":
        return Taylor(tuple(_sum_of(pair) for pair in zip(self.coefficients, other.coefficients, strict=True)))

    def __neg__(self) -> "Taylor":
        return Taylor(tuple(a if a is _ABSENT else -a for a in self.coefficients))

    def __sub__(self, other: "Taylor") -> "Taylor":
        return self + -other

    def __mul__(self, other: "Taylor") -> "Taylor":
        a, b = self.coefficients, other.coefficients
        return Taylor(tuple(_sum_of(_product_of(a[i], b[k - i]) for i in range(k + 1)) for k in range(len(a))))

    def __truediv__(self, other: "Taylor") -> "Taylor":
        a, b, q = self.coefficients, other.coefficients, list[Interval]()
        for k in range(len(a)):
            q.append((a[k] - _sum_of(_product_of(b[i], q[k - i]) for i in range(1, k + 1))) / b[0])
        return Taylor(tuple(q))


def _sum_of(terms: Iterable[Interval]) -> Interval:
    there = [term for term in terms if term is not _ABSENT]
    return reduce(add, there) if there else _ABSENT


def _product_of(a: Interval, b: Interval) -> Interval:
    return _ABSENT if a is _ABSENT or b is _ABSENT else a * b


def padded_series(coefficients: Sequence[Interval], order: int) -> Taylor:
    """Return the series below t^order with these first coefficients, then zeros."""
    return Taylor((*coefficients, *[_ABSENT] * order)[:order])


def taylor(order: int) -> Arithmetic:
    """Return the arithmetic of power series below t^order with interval coefficients."""

    def number(value: Fraction) -> Taylor:
        return padded_series((point(value),), order)

    def power(x: Taylor, exponent: int) -> Taylor:
        result = reduce(Taylor.__mul__, [x] * abs(exponent), number(Fraction(1)))
        result = result if exponent >= 0 else number(Fraction(1)) / result
        return Taylor((intervals.power(x.coefficients[0], exponent), *result.coefficients[1:]))

    def function(name: str, args: tuple[Taylor, ...]) -> Taylor:
        if not args:
            return padded_series((intervals.function(name, ()),), order)
        if is_table(name):  # at a breakpoint a derivative may jump, and the series of neither piece is valid
            if not in_one_piece(name, [x.coefficients[0].exactly for x in args]):
                raise Undefined("no series where a table may be at one of its points")
            return _expanded(name, args, 0)
        if name in _RATIOS:
            a, rate = args[0].coefficients, _RATIOS[name](number(Fraction(1)), power(args[0], 2)).coefficients
            return Taylor((intervals.function(name, (a[0],)), *(_integral_term(a, rate, k) for k in range(1, order))))
        if name not in _SERIES:
            raise Undefined(f"no series of {name}")
        return Taylor(tuple(_SERIES[name](*(arg.coefficients for arg in args))))

    def both(way: Taylor, a: Taylor, b: Taylor) -> Taylor:
        return a if _way(way.coefficients[0]) > 0 else b

    return Arithmetic(number, power, _root_series, function, both)


def _expanded(name: str, args: tuple[Taylor, ...], k: int) -> Taylor:
    """Return the Taylor series of a table T in argument k and later ones, as T + d (T' + d/2 (T'' + ..)) with d = x -
    x_0."""
    if k == len(args):
        value = intervals.function(name, tuple(x.coefficients[0] for x in args))
        return padded_series((value,), len(args[0].coefficients))
    d, derivatives = Taylor((_ABSENT, *args[k].coefficients[1:])), [name]
    for _ in range(table_of(name)[0].degree):
        derivatives.append(next_of(derivatives[-1], k))
    *each, total = (_expanded(one, args, k + 1) for one in derivatives)
    for i, value in reversed([*enumerate(each, 1)]):
        total = value + d * Taylor(tuple(_product_of(_share(1, i), c) for c in total.coefficients))
    return total


def _root_series(x: Taylor, exponent: Fraction) -> Taylor:
    """Return the Taylor series of b = a^r for a = `x`, from the recurrence k a_0 b_k = sum over i of (r i - (k - i))
    a_i b_(k-i)."""
    a = x.coefficients
    b = [intervals.root(a[0], exponent)]
    for k in range(1, len(a)):
        terms = (_product_of(a[i], _share(exponent * i - (k - i), k) * b[k - i]) for i in range(1, k + 1))
        b.append(_sum_of(terms) / a[0])
    return Taylor(tuple(b))


@lru_cache(maxsize=1 << 12)
def _share(i: Fraction | int, k: int) -> Interval:
    return point(Fraction(i) / k)


def _integral_term(a: Sequence[Interval], f: Sequence[Interval], k: int) -> Interval:
    """Return coefficient k >= 1 of the Taylor series of the integral of a' f."""
    return _sum_of(_product_of(a[i], _share(i, k) * f[k - i]) for i in range(1, k + 1) if a[i] is not _ABSENT)


def _exp_series(a: Sequence[Interval]) -> list[Interval]:
    e = [intervals.function("exp", (a[0],))]
    for k in range(1, len(a)):
        e.append(_integral_term(a, e, k))
    return e


def _rotation_series(a: Sequence[Interval], names: tuple[str, str], way: int) -> tuple[list[Interval], list[Interval]]:
    """Return the Taylor series of sin a and cos a (`way` -1), or of sinh a and cosh a (`way` 1); `way` is the sign in
    cos' = -sin, cosh' = sinh."""
    s, c = ([intervals.function(name, (a[0],))] for name in names)
    for k in range(1, len(a)):
        rise, other = _integral_term(a, c, k), _integral_term(a, s, k)
        s.append(rise)
        c.append(other if way > 0 else -other)
    return s, c


_spread = partial(_rotation_series, names=("sinh", "cosh"), way=1)
_round = partial(_rotation_series, names=("sin", "cos"), way=-1)


def _tan_series(a: Sequence[Interval]) -> Sequence[Interval]:
    s, c = _round(a)
    return (Taylor(tuple(s)) / Taylor(tuple(c))).coefficients


def _tanh_series(a: Sequence[Interval]) -> list[Interval]:
    """Return the Taylor coefficients of t = tanh a, from t' = (1 - t^2) a'."""
    t, slope = [intervals.function("tanh", (a[0],))], list[Interval]()
    for k in range(1, len(a)):
        square = intervals.power(t[0], 2) if k == 1 else _sum_of(_product_of(t[i], t[k - 1 - i]) for i in range(k))
        slope.append(point(Fraction(1)) - square if k == 1 else -square)
        t.append(_integral_term(a, slope, k))
    return t


def _log_series(a: Sequence[Interval]) -> list[Interval]:
    value = [intervals.function("log", (a[0],))]
    for k in range(1, len(a)):
        terms = (_product_of(a[k - i], _share(i, k) * value[i]) for i in range(1, k))
        value.append((a[k] - _sum_of(terms)) / a[0])
    return value


def _angle_series(y: Sequence[Interval], x: Sequence[Interval]) -> list[Interval]:
    """Return the Taylor coefficients of a = atan2(y, x), from (x^2 + y^2) a' = y' x - x' y."""
    angle, square = [intervals.function("atan2", (y[0], x[0]))], intervals.power(x[0], 2) + intervals.power(y[0], 2)
    around = (Taylor(tuple(x)) * Taylor(tuple(x)) + Taylor(tuple(y)) * Taylor(tuple(y))).coefficients
    for k in range(1, len(x)):
        before = _sum_of(_product_of(around[k - i], _share(i, k) * angle[i]) for i in range(1, k))
        angle.append((_integral_term(y, x, k) - _integral_term(x, y, k) - before) / square)
    return angle


def _way(x: Interval) -> int:
    if not x.sign:
        raise Undefined("no series at a kink")
    return x.sign


def _chosen_series(a: Sequence[Interval], b: Sequence[Interval], way: int) -> Sequence[Interval]:
    return a if _way(a[0] - b[0]) == way else b


_SERIES: Mapping[str, Callable[..., Sequence[Interval]]] = {
    "exp": _exp_series,
    "log": _log_series,
    "sin": lambda a: _round(a)[0],
    "cos": lambda a: _round(a)[1],
    "tan": _tan_series,
    "sinh": lambda a: _spread(a)[0],
    "cosh": lambda a: _spread(a)[1],
    "tanh": _tanh_series,
    "atan2": _angle_series,
    "Abs": lambda a: a if _way(a[0]) > 0 else [-x for x in a],
    **dict.fromkeys(("sign", "side"), lambda a: padded_series((point(Fraction(_way(a[0]))),), len(a)).coefficients),
    "Max": lambda *each: reduce(lambda a, b: _chosen_series(a, b, 1), each),
    "Min": lambda *each: reduce(lambda a, b: _chosen_series(a, b, -1), each),
}
_INVERSE_ROOT = Fraction(-1, 2)
# The slope of a function of x, from 1 and x^2.
_RATIOS: Mapping[str, Callable[[Taylor, Taylor], Taylor]] = {
    "atan": lambda one, xx: one / (one + xx),
    "atanh": lambda one, xx: one / (one - xx),
    "asin": lambda one, xx: _root_series(one - xx, _INVERSE_ROOT),
    "acos": lambda one, xx: -_root_series(one - xx, _INVERSE_ROOT),
    "asinh": lambda one, xx: _root_series(one + xx, _INVERSE_ROOT),
    "acosh": lambda one, xx: _root_series(xx - one, _INVERSE_ROOT),
}
