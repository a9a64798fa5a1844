"""Where, on a box, an expression may be undefined or not smooth: roots, poles, logarithms, the unknown."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction

import sympy as sp

from hgogen.algebra.tabulated import Table
from hgogen.intervals.box import Box
from hgogen.intervals.glance import Interval, contains_zero, enclose
from hgogen.sentence import Reason, because

_ONE, _THREE_HALVES = Fraction(1), Fraction(3, 2)
POSITIVE, NONZERO = "{of} > 0", "{of} != 0"


@dataclass(frozen=True)
class Condition:
    """What must hold for a part of an expression to be smooth: a `relation`, with {of} for the expression."""

    relation: str
    of: sp.Expr

    @property
    def reason(self) -> Reason:
        """The condition in words."""
        return because(self.relation, of=self.of)

    def __str__(self) -> str:
        return str(self.reason)

    @property
    def failure(self) -> Reason:
        """The places where the condition fails, in words."""
        if self.relation == NONZERO:
            return because("at {of} = 0", of=self.of)
        return because("unless {condition}", condition=self.reason)

    def implies(self, other: "Condition") -> bool:
        """Whether the other one, which is not the same, says less."""
        return self.of == other.of and (self.relation, other.relation) == (POSITIVE, NONZERO)


def _inside(end: Fraction) -> Callable[[Interval], bool]:
    return lambda t: -end < t[0] and t[1] < end


def _positive(argument: sp.Expr) -> Condition:
    return Condition(POSITIVE, argument)


def _within_one(argument: sp.Expr) -> Condition:
    return Condition("-1 < {of} < 1", argument)


# index of the argument, whether its range keeps clear of singular points, what must hold of it
_SINGULAR: dict[type, tuple[int, Callable[[Interval], bool], Callable[[sp.Expr], Condition]]] = {
    sp.log: (0, lambda t: t[0] > 0, _positive),
    sp.tan: (0, _inside(_THREE_HALVES), lambda angle: Condition(NONZERO, sp.cos(angle))),
    sp.asin: (0, _inside(_ONE), _within_one),
    sp.acos: (0, _inside(_ONE), _within_one),
    sp.atanh: (0, _inside(_ONE), _within_one),
    sp.acosh: (0, lambda t: t[0] > _ONE, lambda argument: Condition("{of} > 1", argument)),
    sp.atan2: (1, lambda t: t[0] > 0, _positive),
}
# Defined everywhere; those that jump are the business of whoever needs continuity.
_ENTIRE = (
    *(sp.sin, sp.cos, sp.sinh, sp.cosh, sp.tanh, sp.atan, sp.asinh, sp.exp, sp.Abs),
    *(sp.sign, sp.floor, sp.ceiling, sp.frac, sp.Heaviside, sp.Piecewise),
)


def singular(expressions: Iterable[sp.Expr], box: Box) -> dict[sp.Expr, Condition]:
    """Parts that may be singular somewhere on the box, each with what must hold to exclude it."""
    nodes = {node for expression in expressions for node in expression.atoms(sp.Pow, sp.Function)}
    conditions = {node: _condition(node, box) for node in sorted(nodes, key=str)}
    return {node: condition for node, condition in conditions.items() if condition}


def reasons(conditions: Iterable[Condition]) -> tuple[Reason, ...]:
    """Each in words."""
    return tuple(each.reason for each in conditions)


def minimal(conditions: Iterable[Condition]) -> tuple[Condition, ...]:
    """Each once, in the order of their texts, without those that another one implies."""
    every = sorted(set(conditions), key=str)
    return tuple(each for each in every if not any(other.implies(each) for other in every))


def _condition(node: sp.Expr, box: Box) -> Condition | None:
    """What must hold for `node` to be smooth; None if outward-rounded intervals show that it does on the whole box."""
    if type(node) in _SINGULAR:
        index, clear, condition = _SINGULAR[type(node)]
        return None if clear(enclose(node.args[index], box)) else condition(node.args[index])
    if not isinstance(node, sp.Pow):
        return None if type(node) in _ENTIRE or isinstance(node, Table) else Condition("{of} is smooth", node)
    base = enclose(node.base, box)
    if node.exp.is_Integer:
        return Condition(NONZERO, node.base) if node.exp < 0 and contains_zero(base) else None
    if base[0] > 0 or (node.exp.is_Rational and node.exp > 0 and base[0] >= 0):
        return None
    return Condition(POSITIVE, node.base)
