"""Change of an expression over one turn of an angle, computed exactly, to decide whether the expression is periodic.

A function that is the same a turn later has the same values on one turn as on the whole line, and so have its slopes:
proofs take one turn as the range of an angle. The ends of that range are rounded outward, so that it has no gap.
"""

import math
from decimal import Decimal
from fractions import Fraction
from functools import lru_cache
from typing import Any

import sympy as sp

_MOST = 720  # a float is taken for a multiple of pi by a fraction with at most this denominator
_FINE = 10**40  # parts of 1 to which a multiple of pi is rounded
_DIGITS = 13  # after the first digit of a period, of the ends of a turn
_DEEP = {"trig": False, "power_base": False, "power_exp": False, "log": False}


def exact_turn(period: Any) -> sp.Expr:
    """Return a period as an exact number: the rational multiple of pi whose nearest float it is, if there is one, else
    the rational of its shortest decimal."""
    return _multiple(period, sp.pi) or sp.Rational(repr(period))


def with_exact_pi(expression: sp.Expr) -> sp.Expr:
    """Return the expression with floats that are nearest to a multiple of pi or 1/pi, such as pi/180, replaced by this
    multiple."""
    known = {f: _multiple(float(f), sp.pi) or _multiple(float(f), 1 / sp.pi) for f in expression.atoms(sp.Float)}
    return expression.xreplace({f: exact for f, exact in known.items() if exact is not None})


def _multiple(number: float, unit: sp.Expr) -> sp.Expr | None:
    share = sp.Rational(number / float(unit)).limit_denominator(_MOST)
    return share * unit if share != 0 and float(share * unit) == number else None


def half_turn(period: float) -> Fraction:
    """Return a rational lower bound of half a period, for the exact period and for its float in the program."""
    exactly = sp.floor(exact_turn(period) * _FINE)
    return min(Fraction(int(exactly), _FINE), Fraction(period)) / 2


@lru_cache(maxsize=256)
def whole_turn(low: Fraction, high: Fraction, period: float) -> tuple[Fraction, Fraction]:
    """Return the range of an angle, the ends `low` and `high` rounded outward until it spans a whole exact period."""
    step = Fraction(10) ** (Decimal(repr(period)).adjusted() - _DIGITS)
    bottom, top = step * math.floor(low / step), step * math.ceil(high / step)
    while top - bottom < Fraction(int(sp.ceiling(exact_turn(period) * _FINE)), _FINE):
        bottom, top = bottom - step, top + step
    return bottom, top


def advance(expression: sp.Expr, symbol: sp.Symbol, turn: sp.Expr) -> sp.Expr:
    """Return the change expression(symbol + turn) - expression(symbol) over a period `turn`, simplified: a number if it
    is constant.

    The sums in the arguments of functions are expanded, after which SymPy removes whole turns from sines and the like.
    """
    if symbol not in expression.free_symbols:
        return sp.S.Zero
    change = sp.expand(expression.xreplace({symbol: symbol + turn}), **_DEEP) - sp.expand(expression, **_DEEP)
    change = sp.expand(change)
    return change if change.is_number else sp.simplify(sp.expand_trig(change))
