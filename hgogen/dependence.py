"""Which states an expression depends on, after terms that cancel."""

import random
from collections.abc import Iterable

import sympy as sp

from hgogen.signal import Signal

# A derivative that is larger than this at a sample point, evaluated to 15 digits, is not zero.
_NOT_ZERO = 1e-9


def depends(expression: sp.Expr, symbol: Signal) -> bool:
    """Whether the expression changes with the symbol; a dependence that SymPy cannot simplify away counts."""
    if symbol not in expression.free_symbols:
        return False
    slope = expression.diff(symbol)
    return _nonzero_somewhere(slope) or sp.simplify(slope) != 0


def states_in(expression: sp.Expr, states: Iterable[Signal]) -> tuple[Signal, ...]:
    """The states that the expression depends on, in the given order."""
    return tuple(x for x in states if depends(expression, x))


def free_of(expression: sp.Expr, states: Iterable[Signal]) -> sp.Expr:
    """The same function written without the states, on which it does not depend.

    A state that no simplification removes is set to the first whole number at which the expression is finite.
    """
    states = set(states)
    if states.isdisjoint(expression.free_symbols):
        return expression
    expression = sp.simplify(expression)
    for state in sorted(states & expression.free_symbols, key=str):
        values = (expression.subs(state, value) for value in range(9))
        expression = next((value for value in values if not value.has(sp.nan, sp.zoo, sp.oo)), expression)
    return expression


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
