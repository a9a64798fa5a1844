"""An expression as a product of powers, by exact algebra, and which of the bases are never 0 for what they are made of.

e = number * prod base^k,   k whole;   exp(2 x) + 1 is never 0, nor is cosh(x)^2 - sinh(x)^2 = 1
"""

from dataclasses import dataclass
from typing import Any

import sympy as sp

from hgogen.algebra.branches import branches
from hgogen.algebra.field import Field, field
from hgogen.algebra.points import exact
from hgogen.algebra.powers import powers
from hgogen.algebra.rewrite import TooLarge, Writer
from hgogen.algebra.tape import NoTape

_OPERATIONS, _TERMS = 300, 200


@dataclass(frozen=True)
class Factor:
    """base^exponent; `definite`: the base is positive, or negative, for all real values of its symbols at which its
    parts are real."""

    base: sp.Expr
    exponent: int
    definite: bool


@dataclass(frozen=True)
class Factors:
    """number * prod factors: equal to the expression wherever that is defined."""

    number: sp.Expr
    factors: tuple[Factor, ...]


def factors(expression: sp.Expr) -> Factors | None:
    """The factors of an expression without angles and kinks; None where it has them, or is too large, or is 0."""
    if expression.count_ops() > _OPERATIONS:
        return None
    writer, e = Writer(), exact(expression)
    try:
        writer.measure(e)
        made, ((top, bottom),) = field(writer, [writer.write(e)])
        if made.angles or branches(made) or top.is_zero():
            return None
        whole = [(top, 1), (bottom, -1)]
        if all(definite(made, p) for p, _ in whole):  # exp(2000 x) + 1 has factors that are not
            return Factors(sp.S.One, tuple(Factor(made.expression(p), k, True) for p, k in whole))
        number, parts = powers(made, whole)
    except (TooLarge, NoTape, ZeroDivisionError):
        return None
    if sum(len(one.polynomial) for one in parts) > _TERMS or any(one.exponent.denominator != 1 for one in parts):
        return None
    irreducible = (Factor(made.expression(p.polynomial), int(p.exponent), definite(made, p.polynomial)) for p in parts)
    return Factors(number, tuple(irreducible))


def definite(field: Field, polynomial: Any) -> bool:
    """Terms of one sign, in squares and what is never negative, one of them never 0."""
    terms = list(polynomial.terms())
    if len({c > 0 for _, c in terms}) > 1:
        return False
    nonnegative = {root.index for root in field.roots if root.degree % 2 == 0}
    positive = {k for k, m in field.exponents.items() if not m.has(sp.log)}  # x**a is 0 at x = 0
    positive |= {k for k, g in enumerate(field.generators) if g.is_positive}
    read = [{k for k, d in enumerate(exponents) if d} for exponents, _ in terms]
    odd = {k for exponents, _ in terms for k, d in enumerate(exponents) if d % 2}
    return odd <= positive | nonnegative and any(one <= positive for one in read)
