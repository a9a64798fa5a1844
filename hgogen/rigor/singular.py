"""Where, on a box, an expression may be undefined or not smooth, and what it reads that an equal one no longer has.

x/x is 1, which has a value where x/x has none. A Piecewise does not read a branch that is not taken, nor a Heaviside
its value at 0 elsewhere: what stands in these asks for nothing by itself, and each of them is one part.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction

import sympy as sp

from hgogen.rigor.box import Box, End, sides
from hgogen.rigor.glance import contains_zero, enclose
from hgogen.rigor.interpolation import Table
from hgogen.rigor.points import exact
from hgogen.rigor.search import is_defined
from hgogen.sentence import Reason, because

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


# index of the argument, between which numbers it keeps clear of singular points, what must hold (tan(m): of cos(m))
_SINGULAR: dict[type, tuple[int, End, End, str]] = {
    sp.log: (0, 0, math.inf, POSITIVE),
    sp.tan: (0, Fraction(-3, 2), Fraction(3, 2), NONZERO),
    **dict.fromkeys((sp.asin, sp.acos, sp.atanh), (0, -1, 1, "-1 < {of} < 1")),
    sp.acosh: (0, 1, math.inf, "{of} > 1"),
    sp.atan2: (1, 0, math.inf, POSITIVE),
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
        index, low, high, relation = _SINGULAR[type(node)]
        argument = node.args[index]
        least, most = enclose(argument, box)
        clear = low < least and (most < high or high == math.inf)
        return None if clear else Condition(relation, sp.cos(argument) if isinstance(node, sp.tan) else argument)
    if not isinstance(node, sp.Pow):
        return None if type(node) in _ENTIRE or isinstance(node, Table) else Condition("{of} is smooth", node)
    base = enclose(node.base, box)
    if node.exp.is_Integer:
        return Condition(NONZERO, node.base) if node.exp < 0 and contains_zero(base) else None
    if base[0] > 0 or (node.exp.is_Rational and node.exp > 0 and base[0] >= 0):
        return None
    return Condition(POSITIVE, node.base)


# --- what is lost

_CHOOSING = (sp.Piecewise, sp.Heaviside)
_ENDLESS = (sp.log, sp.tan, sp.atanh)  # no value where their condition fails; asin(1) and atan2(1, 0) have one


def lost(before: Iterable[sp.Expr], after: Iterable[sp.Expr], box: Box) -> sp.Expr | None:
    """A part of `before` that is not proved to be a finite real number on the box, and that `after` does not have.

    A part stays in `after` where it is read there, or something is that has no value in the same places, as 1/x**2 for
    1/x. What a point of the box takes out, as k = 0 the log(x) of k log(x), does not stay.
    """
    every = tuple(dict.fromkeys(part for row in before for part in parts(row)))
    rows = tuple(sides(exact(row), box)[0] for row in after)
    stays = {part for row in rows for part in parts(row)}
    needs = singular((*every, *rows), box)
    poles = {needs[part] for part in stays if part in needs and _endless(part)}

    def shares(part: sp.Expr) -> bool:
        return part in stays or singular((part,), box).get(part) in poles

    read = (part for part in every if _asks(part, needs))
    return next((part for part in read if not (shares(sides(exact(part), box)[0]) or is_defined(part, box))), None)


def doubtful(expressions: Iterable[sp.Expr], box: Box) -> tuple[sp.Expr, ...]:
    """The parts that are not proved to be finite real numbers on the box."""
    every = tuple(dict.fromkeys(part for e in expressions for part in parts(e)))
    needs = singular(every, box)
    return tuple(part for part in every if _asks(part, needs) and not is_defined(part, box))


def conditions(expressions: Iterable[sp.Expr], box: Box) -> tuple[Condition, ...]:
    """What must hold for the doubtful parts to have values: of 1/u that u != 0, of one that chooses that it has one."""
    asked = set[Condition]()
    for part in doubtful(expressions, box):
        needs = () if isinstance(part, _CHOOSING) else singular((part,), box).values()
        asked.update(needs or (Condition("{of} has a value", part),))
    return minimal(asked)


def parts(e: sp.Expr) -> Iterator[sp.Expr]:
    """The powers and functions whose values the expression reads, outermost first."""
    walk = sp.preorder_traversal(e)
    for node in walk:
        if isinstance(node, (sp.Pow, sp.Function)):
            yield node
        if isinstance(node, _CHOOSING):
            walk.skip()


def put_apart(expressions: Iterable[sp.Expr], put: Callable[[sp.Expr], sp.Expr]) -> Iterator[sp.Expr]:
    """Each part with `put` by itself, where the whole might lose it: (a - b)/(2 a - 2 b) with a = b + w is 1/2 at
    once. Of a Piecewise as well what it loses."""
    for part in dict.fromkeys(part for e in expressions for part in parts(e)):
        whole = put(part)
        yield whole
        if isinstance(part, _CHOOSING):
            within = (put(node) for node in part.atoms(sp.Pow, sp.Function) - {part})
            yield from (node for node in within if not whole.has(node))


def _asks(part: sp.Expr, needs: Mapping[sp.Expr, Condition]) -> bool:
    """Whether the part may ask for something, or choose what has no value, or nothing."""
    if not isinstance(part, _CHOOSING):
        return part in needs
    ends = not isinstance(part, sp.Piecewise) or part.args[-1].cond == sp.true
    return part in needs or not ends or any(node in needs for node in part.atoms(sp.Pow, sp.Function))


def _endless(part: sp.Expr) -> bool:
    return isinstance(part, _ENDLESS) or (part.is_Pow and bool(part.exp.is_Rational and part.exp.is_negative))
