"""Which states an expression depends on, after terms that cancel."""

import random
from collections.abc import Iterable

import sympy as sp

from hgogen.signal import Signal

# A slope that is larger than this at a sample point, evaluated to 15 digits, is not zero.
_NOT_ZERO = 1e-9


def states_in(expression: sp.Expr, states: Iterable[Signal]) -> tuple[Signal, ...]:
    """The states that the expression depends on, in the given order; one that `simplify` keeps counts."""
    return tuple(x for x in states if _depends(expression, x))


def free_of(expression: sp.Expr, states: Iterable[Signal]) -> sp.Expr:
    """The same function written without the states, none of which is in `states_in`."""
    return expression if expression.free_symbols.isdisjoint(states) else sp.simplify(expression)


def _depends(expression: sp.Expr, symbol: Signal) -> bool:
    if symbol not in expression.free_symbols:
        return False
    # A slope of zero is not enough for independence: atan(x) + atan(1/x) jumps.
    return _nonzero_somewhere(expression.diff(symbol)) or symbol in sp.simplify(expression).free_symbols


def _nonzero_somewhere(expression: sp.Expr) -> bool:
    draw = random.Random(1)
    for _ in range(3):
        point = {s: sp.Rational(draw.randint(1, 97), 89) for s in sorted(expression.free_symbols, key=str)}
        try:
            value = expression.xreplace(point).evalf(15)
        except ValueError:  # Min or Max of a number that SymPy cannot compare
            continue
        if value.is_Float and abs(value) > _NOT_ZERO:
            return True
    return bool(expression.is_number and expression.is_nonzero)
