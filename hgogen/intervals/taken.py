"""Which cells of a table a program may take where its arguments are on a box: what proofs count.

Beyond its points a table is held, and its slope 0. Where an argument keeps within them on the box, that of a program
lies beyond by rounding alone: the program's derivatives go on there (`algebra.lookup`), and those of proofs end there.
Else both have the slope 0 as well. `between` decides for either. A program's go on also where the box is larger by no
more than the argument may be rounded, as that of z = 0.3 x is, with its ends outward; there proofs count both.
"""

from collections.abc import Sequence
from fractions import Fraction

import sympy as sp

from hgogen.algebra.axis import Axis
from hgogen.algebra.cells import Cells
from hgogen.algebra.tabulated import Stepped, Table, replaced
from hgogen.intervals.box import Box, Sides
from hgogen.intervals.lost import is_defined
from hgogen.intervals.rational import rational
from hgogen.intervals.rounding import rounded, rounding

_LARGE = 2.0**-6  # of a table: what is rounded by more keeps within nothing


def taken(expression: sp.Expr, around: Sides) -> sp.Expr:
    """The expression on a box with tables that know their ends there, and how far their arguments may be rounded."""
    return rounded(ended(expression, around.box), around)


def ended(expression: sp.Expr, box: Box) -> sp.Expr:
    """The expression on a box with tables that know their ends there."""
    return replaced(expression, lambda node: between(node, node.args, box))


def beyond(expression: sp.Expr, around: Sides) -> tuple[Fraction, str] | None:
    """A breakpoint on which the box ends, and its table, of which a program takes a derivative beyond; None without."""
    box = around.box
    for node in sorted(expression.atoms(Stepped), key=str):
        axes, jumps = rounded(ended(node, box), around).cells.axes, node.cells.smooth
        for axis, argument, first, order in zip(axes, node.args, jumps, node.order, strict=True):
            side = rational(argument, box)
            (a, b), (c, d) = axis.met(*side), axis.taken(*side)[1]
            at = next((k for k in (*range(c, a), *range(b, d)) if first[k] <= order), None)
            if at is not None:
                return axis.x[at], node.cells.name
    return None


def between(node: Table, arguments: Sequence[sp.Expr], box: Box, *, program: bool = False) -> Cells:
    """The table without its ends along the axes where its argument keeps within its points."""
    pairs = zip(node.cells.axes, arguments, strict=True)
    return node.cells.holding(*(axis.held and not _inside(axis, argument, box, program) for axis, argument in pairs))


def _inside(axis: Axis, argument: sp.Expr, box: Box, program: bool) -> bool:
    (low, high), first, last = rational(argument, box), axis.x[0], axis.x[-1]
    within = first <= low and high <= last
    if program and not within and low < last and high > first:
        error = rounding(argument, box)
        within = first - error <= low and high <= last + error and error < (last - first) * _LARGE
    return within and is_defined(argument, box)
