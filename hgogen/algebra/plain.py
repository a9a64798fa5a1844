"""Functions that SymPy brings in unasked, by those that every reader knows.

tan(x + pi/2) becomes -cot(x), and a choice between conditions (a piecewise expression compared in another's condition)
an ITE, "if c then a else b". The derivative of e sign(e), as of a drag v^2 sign(v), has a DiracDelta that |e| has not.
"""

from collections.abc import Callable
from functools import reduce

import sympy as sp

from hgogen.algebra.kinks import signed, unbent

_MEANING: dict[type, Callable[..., sp.Basic]] = {
    sp.cot: lambda x: sp.cos(x) / sp.sin(x),
    sp.sec: lambda x: 1 / sp.cos(x),
    sp.csc: lambda x: 1 / sp.sin(x),
    sp.coth: lambda x: sp.cosh(x) / sp.sinh(x),
    sp.sech: lambda x: 1 / sp.cosh(x),
    sp.csch: lambda x: 1 / sp.sinh(x),
    sp.sinc: lambda x: sp.sin(x) / x,
    sp.Mod: lambda x, y: x - y * sp.floor(x / y),
    sp.frac: lambda x: x - sp.floor(x),
    sp.ITE: lambda c, a, b: (c & a) | (~c & b),
    sp.Xor: lambda *args: reduce(lambda a, b: (a & ~b) | (~a & b), args),
    sp.Implies: lambda a, b: ~a | b,
    sp.Equivalent: lambda *args: sp.And(*args) | sp.And(*map(sp.Not, args)),
}
_VALUES = "give its values on the declared range as a table"
NEAREST = {  # what to write in the place of functions that no reader knows, by their names
    "erf": f"{_VALUES}, or take tanh(2*x/sqrt(pi)), which is within 0.04 of it",
    "erfc": f"{_VALUES}, or take 1 - tanh(2*x/sqrt(pi)), which is within 0.04 of it",
    "gamma": _VALUES,
    "Mod": "write x - p*floor(x/p); of an angle sin and cos need no Mod",
}


def plain(expression: sp.Expr) -> sp.Expr:
    """The function written without cot, sec, csc, coth, sech, csch, sinc, Mod, frac, its conditions with And, Or and
    Not alone, and with |e| in the place of e sign(e) where e is real."""
    if expression.has(*_MEANING):
        expression = expression.replace(lambda e: type(e) in _MEANING, lambda e: _MEANING[type(e)](*e.args))
    return expression.replace(_is_size, lambda e: unbent(signed(e))) if expression.has(sp.sign) else expression


def _is_size(e: sp.Basic) -> bool:
    """Whether it may be e sign(e): of log(x) it has no value at x < 0, where SymPy's |log(x)| has one."""
    return e.is_Mul and all(part.args[0].is_real for part in e.args if isinstance(part, sp.sign))
