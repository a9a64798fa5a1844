"""The a_i of a form in their ranges: what they can be on the declared box, and A, C at the ends of the ranges.

z_(i,j)' = a_(i,j+1) z_(i,j+1) + ..,  y_i = a_(i,1) z_(i,1) + ..: a chain's (A, C) is linear in its a_(i,j), so that the
ends of their ranges are the vertices of a polytope that holds it for every input and parameter.
"""

from collections.abc import Mapping, Sequence
from fractions import Fraction
from itertools import product
from math import prod

import numpy as np
import sympy as sp

from hgogen.form import Form
from hgogen.rigor.bounds import LIMIT, Range, bound
from hgogen.rigor.box import box, exact
from hgogen.rigor.tape import NoTape
from hgogen.sentence import Reason, because

Corner = tuple[tuple[tuple[Fraction, ...], ...], tuple[Fraction, ...]]  # A (n, n) and C (n) of a chain

VARYING = 8  # a_i of a chain that may vary: their ends have 2^8 combinations


def chains(form: Form) -> tuple[tuple[sp.Expr, ...], ...]:
    """a_(i,1), .., a_(i,n_i) of each output, exact, constants at their values."""
    return tuple(tuple(exact(sp.sympify(a).xreplace(fixed(form))) for a in chain) for chain in form.gains)


def fixed(form: Form) -> Mapping[sp.Symbol, sp.Rational]:
    """The parameters without a range, at their values."""
    return form.system.constants


def signals(form: Form) -> tuple[sp.Symbol, ...]:
    """The states z, the inputs and the parameters."""
    return (*form.states, *form.system.inputs, *form.system.parameters)


def span(expression: sp.Expr, form: Form, boxes: int = LIMIT) -> Range | None:
    """The range of an expression on the declared box; None where there is no rule for it."""
    try:
        return bound(expression, box(signals(form)), boxes=boxes, relative=0.005)
    except NoTape:
        return None


def extents(chain: Sequence[sp.Expr], form: Form) -> tuple[Range, ...] | Reason:
    """The ranges of a chain's a_1..a_n on the declared box, or the reason why there are none."""
    ranges = []
    for i, a in enumerate(chain, 1):
        known = span(a, form)
        if not (known and known.defined and known.finite):
            return because("a_{i} = {a} has no finite range on the box", i=i, a=a)
        ranges.append(known)
    return tuple(ranges)


def corners(chain: Sequence[sp.Expr], form: Form) -> list[Corner] | Reason:
    """The pairs (A, C) of a chain at the ends of the ranges of its a_1..a_n, or the reason why there are none."""
    ranges = extents(chain, form)
    if isinstance(ranges, Reason):
        return ranges
    ends = [
        (Fraction(a),) if a.is_Rational else (Fraction(known.low), Fraction(known.high))
        for a, known in zip(chain, ranges, strict=True)
    ]
    if sum(len(pair) > 1 for pair in ends) > VARYING:
        return because("more than {most} of the a_i vary, whose ranges have too many vertices", most=VARYING)
    n = range(len(ends))
    return [
        (
            tuple(tuple(a[j] if j == i + 1 else Fraction(0) for j in n) for i in n),
            tuple(a[0] if j == 0 else Fraction(0) for j in n),
        )
        for a in product(*ends)
    ]


def several_corners(each: Sequence[Sequence[sp.Expr]], form: Form) -> list[tuple[np.ndarray, np.ndarray]] | Reason:
    """The pairs A (n, n) and C (q, n) of q chains at the ends of the ranges of all their a_i, arrays of fractions; or
    the reason why there are none."""
    ends = [corners(chain, form) for chain in each]
    known = [end for end in ends if not isinstance(end, Reason)]
    if len(known) < len(ends):
        return next(end for end in ends if isinstance(end, Reason))
    if prod(map(len, known)) > 2**VARYING:
        return because("more than {most} of the a_i vary, whose ranges have too many vertices", most=VARYING)
    pairs = []
    for one in product(*known):  # a chain's A and C beside those of the others
        sizes = [len(C) for _, C in one]
        A, C = (np.full((rows, sum(sizes)), Fraction(0), dtype=object) for rows in (sum(sizes), len(sizes)))
        for k, ((inner, shown), end) in enumerate(zip(one, np.cumsum(sizes).tolist(), strict=True)):
            at = slice(end - sizes[k], end)
            A[at, at], C[k, at] = inner, shown
        pairs.append((A, C))
    return pairs
