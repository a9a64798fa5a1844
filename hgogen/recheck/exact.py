"""The arithmetic of exact fractions, at a point."""

import math
from fractions import Fraction

from .arithmetic import Arithmetic, Undefined
from .tables import is_table, value_at

_LONGEST = 4096  # bits of an exact fraction; beyond it intervals answer


class NotExact(Exception):
    """A value that is no rational number, or too long a one."""


def _exact_power(x: Fraction, exponent: int) -> Fraction:
    if exponent < 0 and not x:
        raise Undefined("division by zero")
    if max(x.numerator.bit_length(), x.denominator.bit_length()) * abs(exponent) > _LONGEST:
        raise NotExact
    return x**exponent


def _exact_root(x: Fraction, exponent: Fraction) -> Fraction:
    if x < 0 or (x == 0 and exponent < 0):
        raise Undefined("a root of a negative number")
    q = exponent.denominator
    parts = [_whole_root(part, q) for part in (x.numerator, x.denominator)]
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


def _exact_function(name: str, args: tuple[Fraction, ...]) -> Fraction:
    if is_table(name):
        value = value_at(name, args)
        if value is None:
            raise NotExact
        return value
    if name in ("Min", "Max"):
        return min(args) if name == "Min" else max(args)
    if name == "Abs":
        return abs(args[0])
    if name == "side" and args[0] == 0:
        raise NotExact
    if name in ("sign", "side"):
        return Fraction((args[0] > 0) - (args[0] < 0))
    if name == "log":
        if args[0] <= 0:
            raise Undefined("the logarithm of zero or less")
        if args[0] == 1:
            return Fraction(0)
    if name in _AT_ZERO and args == (Fraction(0),):
        return Fraction(_AT_ZERO[name])
    raise NotExact


def _same(way: Fraction, a: Fraction, b: Fraction) -> Fraction:
    if a != b:
        raise NotExact
    return a


fractions = Arithmetic(lambda value: value, _exact_power, _exact_root, _exact_function, _same)
