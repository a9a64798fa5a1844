"""Return by how much an expression changes over one turn of a symbol, exactly, to find whether it is periodic."""

from typing import Any

import sympy as sp

_MOST = 720  # a float is taken for a multiple of pi by a fraction with at most this denominator
_DEEP = {"trig": False, "power_base": False, "power_exp": False, "log": False}


def exact_turn(period: Any) -> sp.Expr:
    """Return the period as a rational multiple of pi where its float is the one nearest to such a number, else as the
    rational of its shortest decimal."""
    share = sp.Rational(period / float(sp.pi)).limit_denominator(_MOST)
    turn = share * sp.pi
    return turn if share != 0 and float(turn) == period else sp.Rational(repr(period))


def advance(expression: sp.Expr, symbol: sp.Symbol, turn: sp.Expr) -> sp.Expr:
    """Return expression(symbol + turn) - expression(symbol), simplified: a number where that is constant.

    The sums in the arguments of functions are expanded, after which SymPy takes whole turns out of sines and the like.
    """
    if symbol not in expression.free_symbols:
        return sp.S.Zero
    change = sp.expand(expression.xreplace({symbol: symbol + turn}), **_DEEP) - sp.expand(expression, **_DEEP)
    change = sp.expand(change)
    return change if change.is_number else sp.simplify(sp.expand_trig(change))
