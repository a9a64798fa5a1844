"""cot, sec, csc and their hyperbolic kin by sin, cos, sinh, cosh: SymPy turns tan(x + pi/2) into -cot(x) unasked."""

import sympy as sp

_MEANING = {
    sp.cot: lambda x: sp.cos(x) / sp.sin(x),
    sp.sec: lambda x: 1 / sp.cos(x),
    sp.csc: lambda x: 1 / sp.sin(x),
    sp.coth: lambda x: sp.cosh(x) / sp.sinh(x),
    sp.sech: lambda x: 1 / sp.cosh(x),
    sp.csch: lambda x: 1 / sp.sinh(x),
}


def without_reciprocals(expression: sp.Expr) -> sp.Expr:
    """The function written without cot, sec, csc, coth, sech, csch."""
    if not expression.has(*_MEANING):
        return expression
    return expression.replace(lambda node: type(node) in _MEANING, lambda node: _MEANING[type(node)](*node.args))
