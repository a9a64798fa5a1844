"""Kinks that bend at the same place, with one side for all of them.

    2 max(v, 0) - (v where v > 0, else -v) = v

Proofs read kinks as norms (`algebra.kinks`), which add up where they are the same: the slope of this row is 1. A
program takes the slope of each kink by itself, at v = 0 half of 2 and 1, which leave 0, and of max(v + 1000, 0 + 1000)
what its own rounding makes of it. So where kinks share a norm an expression is computed as the proofs read it.
"""

from collections.abc import Iterable
from itertools import combinations

import sympy as sp

from hgogen.algebra.kinks import Norm, bent, unbent

_KINDS = (sp.Abs, sp.Min, sp.Max, sp.Piecewise)


def shared(expression: sp.Expr) -> sp.Expr:
    """The expression, with its kinks as the norms that they are where two of them are the same one."""
    # the parts that may bend by themselves: |e|, max, min and choices, and products with a sign
    signs = (node for node in expression.atoms(sp.Mul) if any(isinstance(part, sp.sign) for part in node.args))
    own = [_own(node) for node in {*expression.atoms(*_KINDS), *signs}]
    if all(a.isdisjoint(b) for a, b in combinations(own, 2)):
        return expression
    return unbent(bent(expression))


def _own(node: sp.Expr) -> set[sp.Expr]:
    """The norms that a part brings in, and those of a choice's conditions whatever its branches read."""
    every = _norms([node])
    if not isinstance(node, sp.Piecewise):
        return every - _norms(node.args)
    # what changes its sign where a choice takes another branch
    decides = (Norm(where.gts - where.lts) for _, where in node.args if hasattr(where, "gts"))
    return every - _norms(branch for branch, _ in node.args) | every & _norms(decides)


def _norms(expressions: Iterable[sp.Expr]) -> set[sp.Expr]:
    return {norm for e in expressions for norm in bent(e).atoms(Norm)}
