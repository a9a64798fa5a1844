"""Ranges with rational ends: no number of it overflows, underflows or is rounded towards the wrong side.

Sums, products and powers of exact ends are exact, up to what is rounded outward beyond `_BITS` bits; exp and the like
come from Arb at the ends, a number from Arb whole. Natural interval extension, without bisection:
R. E. Moore, R. B. Kearfott, M. J. Cloud, "Introduction to interval analysis", SIAM 2009, chapter 5.
"""

import math
from collections.abc import Callable
from fractions import Fraction
from functools import reduce
from typing import Any

import sympy as sp
from flint import arb, ctx, fmpq

from hgogen.algebra.balls import ends as of_ball
from hgogen.algebra.kinks import Norm
from hgogen.algebra.points import exact
from hgogen.algebra.pointwise import values
from hgogen.algebra.tape import NoTape, tape
from hgogen.algebra.variants import STEEP
from hgogen.intervals.box import EVERYTHING, Box, End
from hgogen.intervals.glance import Interval, enclose

_BITS = 512  # of an end, of the ends of functions
_PRECISIONS = (128, 512, 2048)  # of a number, until its sign is known
_STEEPEST = 10**6  # beyond it exp is left alone: its ends would have too many digits
_POWER = 64  # exponents beyond which ends are left to floats
_RISING: dict[type, Callable[[Any], Any]] = {
    sp.exp: arb.exp,
    sp.sinh: arb.sinh,
    sp.tanh: arb.tanh,
    sp.atan: arb.atan,
    sp.asinh: arb.asinh,
}
_BOUNDS: dict[type, Interval] = {
    sp.exp: (Fraction(0), math.inf),
    sp.tanh: (Fraction(-1), Fraction(1)),
    sp.atan: (Fraction(-2), Fraction(2)),
}


def rational(expression: sp.Expr, box: Box) -> Interval:
    """An interval that holds the values of the expression on the box, where it and its parts are real; as written and,
    of a polynomial, in factors."""
    e = exact(expression)
    low, high = _ends(e, box)
    if low < 0 < high and isinstance(e, sp.Add) and e.is_polynomial(*e.free_symbols):
        other = _ends(sp.factor(e), box)
        return max(low, other[0]), min(high, other[1])
    return low, high


def _ends(e: sp.Expr, box: Box) -> Interval:
    if e.is_Rational:
        return Fraction(e), Fraction(e)
    if e.is_Symbol:
        return box.get(e, EVERYTHING)
    if e.is_number:
        return _number(e)
    if e.is_Add:
        return reduce(_sum, (_ends(part, box) for part in e.args))
    if e.is_Mul:
        return reduce(multiplied, (_ends(part, box) for part in e.args))
    if e.is_Pow and e.exp.is_Integer and abs(e.exp) <= _POWER:
        return _short(raised(_ends(e.base, box), int(e.exp)))
    if isinstance(e, sp.Abs) or (isinstance(e, Norm) and len(e.args) == 1):
        return _size(_ends(e.args[0], box))
    if type(e) in _RISING:
        low, high = _ends(e.args[0], box)
        least, most = _BOUNDS.get(type(e), EVERYTHING)
        return max(least, _applied(_RISING[type(e)], low)[0]), min(most, _applied(_RISING[type(e)], high)[1])
    if isinstance(e, sp.cosh):
        low, high = _size(_ends(e.args[0], box))
        return max(Fraction(1), _applied(arb.cosh, low)[0]), _applied(arb.cosh, high)[1]
    low, high = fractions(enclose(e, box))
    return (max(low, Fraction(0)), high) if e.is_Pow and e.exp.is_Rational and e.exp.q % 2 == 0 else (low, high)


def _number(e: sp.Expr) -> Interval:
    """An enclosure of a number, in as many bits as it takes to decide its sign."""
    try:
        program = tape([e], ())
    except NoTape:
        return EVERYTHING
    enclosure: Interval = EVERYTHING
    for bits in _PRECISIONS:
        (ball,) = values(program, (), bits)
        if ball.is_finite():
            enclosure = of_ball(ball)
            if not ball.contains(0):
                break
    return enclosure


def _applied(function: Callable[[Any], Any], end: End) -> Interval:
    """A function's value at an end; the whole line where that has too many digits."""
    if not -_STEEPEST <= end <= _STEEPEST:
        return EVERYTHING
    before, ctx.prec = ctx.prec, _BITS
    try:
        exactly = Fraction(end)
        ball = function(arb(fmpq(exactly.numerator, exactly.denominator)))
        return of_ball(ball) if ball.is_finite() else EVERYTHING
    finally:
        ctx.prec = before


def _size(a: Interval) -> Interval:
    low, high = a
    return max(low, -high, Fraction(0)), max(-low, high)


def _sum(a: Interval, b: Interval) -> Interval:
    (low, high), (first, last) = a, b
    return _short(
        (-math.inf if -math.inf in (low, first) else low + first, math.inf if math.inf in (high, last) else high + last)
    )


def fractions(a: Interval) -> Interval:
    """The ends of an interval, the finite ones as fractions."""
    low, high = (end if end in (-math.inf, math.inf) else Fraction(end) for end in a)
    return low, high


def multiplied(a: Interval, b: Interval) -> Interval:
    """a b; an infinite end is a bound and no value, so 0 times it is 0."""
    ends = [_times(x, y) for x in a for y in b]
    return _short((min(ends), max(ends)))


def _times(x: End, y: End) -> End:
    if math.inf in (abs(x), abs(y)):
        return Fraction(0) if x == 0 or y == 0 else math.inf if (x > 0) == (y > 0) else -math.inf
    return x * y


def raised(a: Interval, n: int) -> Interval:
    """a^n for whole n; for n < 0 where a is not 0. The whole line for a power with too many digits."""
    if abs(n) > STEEP:
        return EVERYTHING
    if n < 0:
        low, high = _short(raised(a, -n))
        if low == 0 < high:
            return _over(high), math.inf
        if low < 0 == high:
            return -math.inf, _over(low)
        return EVERYTHING if low <= 0 <= high else (_over(high), _over(low))
    low, high = a if n % 2 else _size(a)
    return low**n, high**n


def _over(end: End) -> End:
    return Fraction(0) if abs(end) == math.inf else 1 / Fraction(end)


def _short(a: Interval) -> Interval:
    return _rounded(a[0], -1), _rounded(a[1], 1)


def _rounded(end: End, way: int) -> End:
    """The end in at most `_BITS` bits, outward."""
    if isinstance(end, float) or max(end.numerator.bit_length(), end.denominator.bit_length()) <= 2 * _BITS:
        return end
    shift = _BITS - end.numerator.bit_length() + end.denominator.bit_length()
    scaled = end * (Fraction(2) ** shift)
    return Fraction(math.ceil(scaled) if way > 0 else math.floor(scaled)) / (Fraction(2) ** shift)
