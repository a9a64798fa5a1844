"""Functions that SymPy brings in unasked, by those that every reader knows.

tan(x + pi/2) becomes -cot(x), and a choice between conditions (a piecewise expression compared in another's condition)
an ITE, "if c then a else b".
"""

from collections.abc import Callable
from functools import reduce

import sympy as sp

_MEANING: dict[type, Callable[..., sp.Basic]] = {
    sp.cot: lambda x: sp.cos(x) / sp.sin(x),
    sp.sec: lambda x: 1 / sp.cos(x),
    sp.csc: lambda x: 1 / sp.sin(x),
    sp.coth: lambda x: sp.cosh(x) / sp.sinh(x),
    sp.sech: lambda x: 1 / sp.cosh(x),
    sp.csch: lambda x: 1 / sp.sinh(x),
    sp.ITE: lambda c, a, b: (c & a) | (~c & b),
    sp.Xor: lambda *args: reduce(lambda a, b: (a & ~b) | (~a & b), args),
    sp.Implies: lambda a, b: ~a | b,
    sp.Equivalent: lambda *args: sp.And(*args) | sp.And(*map(sp.Not, args)),
}


def plain(expression: sp.Expr) -> sp.Expr:
    """The function written without cot, sec, csc, coth, sech, csch, and its conditions with And, Or and Not alone."""
    if not expression.has(*_MEANING):
        return expression
    return expression.replace(lambda node: type(node) in _MEANING, lambda node: _MEANING[type(node)](*node.args))
