"""Ranges of expressions on a box, in exact rational arithmetic: what they enclose is proved, not sampled.

Ends are Fractions or +-inf. A function without a rule here has the range (-inf, inf), which proves nothing. A
number is taken as the shortest decimal that stands for it: 0.1 is 1/10.
"""

import math
from collections.abc import Iterable, Mapping
from fractions import Fraction
from functools import reduce
from typing import TypeAlias

import sympy as sp

from hgogen.signal import Signal

End: TypeAlias = Fraction | float
Interval: TypeAlias = tuple[End, End]
Box: TypeAlias = Mapping[sp.Symbol, Interval]

EVERYTHING: Interval = (-math.inf, math.inf)
# Powers beyond this exponent would only cost time; exp is enclosed by powers of 2 and 3.
_EXPONENT = 1000
_HALF_PI: Interval = (Fraction(-11, 7), Fraction(11, 7))
# |tan t| <= 15 for |t| <= 3/2, where it is 14.1 at most.
_TAN = (Fraction(3, 2), Fraction(15))


def box(signals: Iterable[Signal]) -> dict[sp.Symbol, Interval]:
    """The closed box of the signals' declared ranges, exact; a signal without a range is unbounded."""
    return {s: EVERYTHING if s.low is None or s.high is None else (_exact(s.low), _exact(s.high)) for s in signals}


def enclose(expression: sp.Expr, box: Box) -> Interval:
    """An interval that holds the values of the expression on the box, where it and its parts are real."""
    if expression.is_Rational:
        value = Fraction(int(expression.p), int(expression.q))
        return value, value
    if expression.is_Float:
        value = _exact(float(expression))
        return value, value
    if isinstance(expression, sp.NumberSymbol):
        value, error = Fraction(str(expression.evalf(30))), Fraction(1, 10**28)  # evalf guarantees its digits
        return value - error, value + error
    if expression.is_Symbol:
        return box.get(expression, EVERYTHING)
    parts = [enclose(part, box) for part in expression.args if isinstance(part, sp.Expr)]
    if expression.is_Add:
        return reduce(_add, parts)
    if expression.is_Mul:
        return reduce(_multiply, parts)
    if expression.is_Pow:
        return _power(expression, parts[0], parts[1])
    return _function(expression, parts)


def contains_zero(interval: Interval) -> bool:
    """Whether zero lies in the closed interval."""
    return interval[0] <= 0 <= interval[1]


def finite(interval: Interval) -> bool:
    """Whether both ends are finite."""
    return not (_infinite(interval[0]) or _infinite(interval[1]))


def _exact(value: float) -> Fraction:
    return Fraction(repr(float(value)))


def _infinite(end: End) -> bool:
    # Not math.isinf(end): it goes through float(end), which overflows.
    return abs(end) == math.inf


def _add(a: Interval, b: Interval) -> Interval:
    return _plus(a[0], b[0]), _plus(a[1], b[1])


def _plus(a: End, b: End) -> End:
    # Not a + b alone: Fraction plus inf goes through float, too. No sum here is inf - inf.
    return a if _infinite(a) else b if _infinite(b) else a + b


def _multiply(a: Interval, b: Interval) -> Interval:
    ends = [_times(x, y) for x in a for y in b]
    return min(ends), max(ends)


def _times(a: End, b: End) -> End:
    if not a or not b:  # the ends of an unbounded interval are not reached: 0 * inf is 0 here
        return Fraction(0)
    if _infinite(a) or _infinite(b):
        return math.inf if (a > 0) == (b > 0) else -math.inf
    return a * b


def _power(node: sp.Expr, base: Interval, exponent: Interval) -> Interval:
    if node.base == sp.E:
        return _exp(exponent)
    if not node.exp.is_Rational or abs(node.exp) > _EXPONENT:
        return (Fraction(0), math.inf) if base[0] >= 0 else EVERYTHING
    p, q = int(node.exp.p), int(node.exp.q)
    if q != 1 and base[0] < 0:
        return EVERYTHING
    root = base if q == 1 else _fractional(base, abs(p) // q)
    whole = _integer(root, abs(p)) if q == 1 else root
    return whole if p > 0 else _reciprocal(whole)


def _integer(a: Interval, times: int) -> Interval:
    low, high = (end**times for end in a)
    if times % 2:
        return low, high
    return (Fraction(0), max(low, high)) if contains_zero(a) else (min(low, high), max(low, high))


def _fractional(a: Interval, whole: int) -> Interval:
    # t^r with whole < r < whole + 1 and t >= 0 lies between t^whole and t^(whole + 1).
    ends = [end**power for end in a for power in (whole, whole + 1)]
    return min(ends[:2]), max(ends[2:])


def _reciprocal(a: Interval) -> Interval:
    if a[0] > 0 or a[1] < 0:
        return _inverse(a[1]), _inverse(a[0])
    if a[0] == 0 and a[1] > 0:
        return _inverse(a[1]), math.inf
    if a[1] == 0 and a[0] < 0:
        return -math.inf, _inverse(a[0])
    return EVERYTHING


def _inverse(end: End) -> End:
    return Fraction(0) if _infinite(end) else 1 / end


def _exp(a: Interval) -> Interval:
    """2 < e < 3, so 2^floor(t) <= e^t <= 3^ceil(t) for t >= 0 and 3^floor(t) <= e^t <= 2^ceil(t) below."""
    low, high = a[0], a[1]
    if low < -_EXPONENT:
        least: End = Fraction(0)
    else:
        whole = math.floor(min(low, _EXPONENT))
        least = Fraction(2 if whole > 0 else 3) ** whole
    if high > _EXPONENT:
        return least, math.inf
    whole = math.ceil(max(high, -_EXPONENT))
    return least, Fraction(3 if whole > 0 else 2) ** whole


def _function(node: sp.Expr, parts: list[Interval]) -> Interval:
    kind, one = type(node), Fraction(1)
    if kind in (sp.sin, sp.cos, sp.tanh, sp.sign):
        return -one, one
    if kind is sp.Heaviside:
        return Fraction(0), one
    if kind is sp.exp:
        return _exp(parts[0])
    if kind is sp.cosh:
        return one, _plus(_exp(parts[0])[1], _exp(_negate(parts[0]))[1])
    if kind is sp.sinh:
        return _negate((Fraction(0), _exp(_negate(parts[0]))[1]))[0], _exp(parts[0])[1]
    if kind in (sp.atan, sp.asin):
        return _HALF_PI
    if kind in (sp.atan2, sp.acos):
        return -2 * _HALF_PI[1], 2 * _HALF_PI[1]
    if kind is sp.tan and -_TAN[0] <= parts[0][0] and parts[0][1] <= _TAN[0]:
        return -_TAN[1], _TAN[1]
    if kind is sp.log and parts[0][0] > 0:  # 1 - 1/t <= log t <= t - 1
        return _plus(one, -_inverse(parts[0][0])), _plus(parts[0][1], -one)
    if kind is sp.Abs:
        ends = [end if end >= 0 else -end for end in parts[0]]
        return (Fraction(0) if contains_zero(parts[0]) else min(ends)), max(ends)
    if kind is sp.Min:
        return min(low for low, _ in parts), min(high for _, high in parts)
    if kind is sp.Max:
        return max(low for low, _ in parts), max(high for _, high in parts)
    return EVERYTHING


def _negate(a: Interval) -> Interval:
    return -a[1], -a[0]
