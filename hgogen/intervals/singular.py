"""Where, on a box, an expression may be undefined or not smooth: roots, poles, logarithms, the unknown."""

from collections.abc import Callable, Iterable
from fractions import Fraction

import sympy as sp

from hgogen.intervals.box import Box
from hgogen.intervals.glance import Interval, contains_zero, enclose

_ONE, _THREE_HALVES = Fraction(1), Fraction(3, 2)


def _inside(end: Fraction) -> Callable[[Interval], bool]:
    return lambda t: -end < t[0] and t[1] < end


# (index of the argument, whether its range keeps clear of singular points, what must hold)
_SINGULAR: dict[type, tuple[int, Callable[[Interval], bool], str]] = {
    sp.log: (0, lambda t: t[0] > 0, "{} > 0"),
    sp.tan: (0, _inside(_THREE_HALVES), "cos({}) != 0"),
    sp.asin: (0, _inside(_ONE), "-1 < {} < 1"),
    sp.acos: (0, _inside(_ONE), "-1 < {} < 1"),
    sp.atanh: (0, _inside(_ONE), "-1 < {} < 1"),
    sp.acosh: (0, lambda t: t[0] > _ONE, "{} > 1"),
    sp.atan2: (1, lambda t: t[0] > 0, "{} > 0"),
}
# Defined everywhere; those that jump are the business of whoever needs continuity.
_ENTIRE = (
    *(sp.sin, sp.cos, sp.sinh, sp.cosh, sp.tanh, sp.atan, sp.asinh, sp.exp, sp.Abs),
    *(sp.sign, sp.floor, sp.ceiling, sp.frac, sp.Heaviside, sp.Piecewise),
)


def singular(expressions: Iterable[sp.Expr], box: Box) -> dict[sp.Expr, str]:
    """Parts that may be singular somewhere on the box, each with what must hold to exclude it."""
    nodes = {node for expression in expressions for node in expression.atoms(sp.Pow, sp.Function)}
    found = {node: _condition(node, box) for node in sorted(nodes, key=str)}
    return {node: condition for node, condition in found.items() if condition}


def _condition(node: sp.Expr, box: Box) -> str:
    """What must hold for `node` to be smooth; empty if outward-rounded intervals show that it does on the whole box."""
    if type(node) in _SINGULAR:
        index, clear, text = _SINGULAR[type(node)]
        return "" if clear(enclose(node.args[index], box)) else text.format(node.args[index])
    if not isinstance(node, sp.Pow):
        return "" if type(node) in _ENTIRE else f"{node} is smooth"
    base = enclose(node.base, box)
    if node.exp.is_Integer:
        return f"{node.base} != 0" if node.exp < 0 and contains_zero(base) else ""
    if base[0] > 0 or (node.exp.is_Rational and node.exp > 0 and base[0] >= 0):
        return ""
    return f"{node.base} > 0"
