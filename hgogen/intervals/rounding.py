"""How far a program may compute the argument of a table from its exact value, in single precision.

A proof counts the cells that the program may take: v + 273.15 is rounded to a breakpoint that it does not reach, and
1000 v - 1099 by far more than a number of its size is. A running error bound: an operation adds a share of its result,
`UNIT`, to the errors of its operands, which it multiplies by its slopes.

N. J. Higham, "Accuracy and stability of numerical algorithms", 2nd edition, SIAM 2002, section 3.3.
"""

import math
from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache

import numpy as np
import sympy as sp

from hgogen.algebra.axis import Axis, Ends
from hgogen.algebra.cells import Cells
from hgogen.algebra.points import exact
from hgogen.algebra.tabulated import Table, replaced
from hgogen.algebra.tape import NoTape, tape
from hgogen.intervals.box import Box, End, Sides, sides
from hgogen.intervals.enclosure import enclose

UNIT = 2.0**-21  # 8 times what a number is rounded by in single precision
_TINY = 2.0**-120  # what is smaller may be lost


def rounded(expression: sp.Expr, around: Sides) -> sp.Expr:
    """The expression with tables that know how far their arguments may be rounded on a box."""

    def cells(node: Table) -> Cells:
        pairs = zip(node.cells.axes, node.args, strict=True)
        return node.cells.rounding(*(_sides(axis, e, around) for axis, e in pairs))

    return replaced(expression, cells)


def rounding(argument: sp.Expr, box: Box) -> End:
    """How far an argument may be rounded on a box; infinite where that is not known."""
    error = _error(*sides(exact(argument), box))
    return Fraction(error) if math.isfinite(error) else math.inf


def _sides(axis: Axis, argument: sp.Expr, around: Sides) -> Ends:
    """How far below and above. A signal by itself is rounded as breakpoints are: past none but one that is the same
    number in single precision as the end of its range."""
    error = _error(argument, around)
    most = Fraction(error) if math.isfinite(error) else math.inf
    if not argument.is_Symbol:
        return most, most
    high = around.ends[around.symbols.index(argument)][1]
    return Fraction(0), most if any(high < x <= high + most for x in axis.x) else Fraction(0)


@lru_cache(maxsize=4096)
def _error(e: sp.Expr, around: Sides) -> float:
    """A bound of the error of an expression, infinite where none is known."""
    if not e.args:
        return UNIT * _size(e, around) + _TINY
    if isinstance(e, sp.Piecewise):  # one branch or another
        branches = [part for part, _ in e.args]
        ranges = [_range(part, around) for part in branches]
        width = max(high for _, high in ranges) - min(low for low, _ in ranges)
        return _sure(width + max(_error(part, around) for part in branches))
    if not all(isinstance(part, sp.Expr) for part in e.args):
        return math.inf
    errors = [_error(part, around) for part in e.args]
    if isinstance(e, (sp.Add, sp.Mul)):
        sizes = [_size(part, around) for part in e.args]
        whole = [size + error for size, error in zip(sizes, errors, strict=True)]
        moved = sum(errors) if isinstance(e, sp.Add) else math.prod(whole) - math.prod(sizes)
        total = sum(whole) if isinstance(e, sp.Add) else math.prod(whole)
        return _sure(moved + len(whole) * UNIT * total + _TINY)
    return _through(e, errors, around)


def _through(e: sp.Expr, errors: Sequence[float], around: Sides) -> float:
    """Through a function: by its slopes, where it has any, or by its whole range."""
    moving = [(part, error, sp.Dummy(real=True)) for part, error in zip(e.args, errors, strict=True)]
    moving = [each for each in moving if each[0].free_symbols]
    stands = {part: dummy for part, _, dummy in moving}
    ends = [(low - error, high + error) for (low, high), error in ((_range(part, around), d) for part, d, _ in moving)]
    low, high = np.array(ends).reshape(len(moving), 2).T[:, :, None]
    try:
        program = tape([e.func(*(stands.get(part, part) for part in e.args))], stands.values())
    except NoTape:
        return math.inf
    (there,) = enclose(program, low, high, slopes=True)
    least, most = float(there.value[0][0]), float(there.value[1][0])
    assert there.slope is not None
    steep = np.maximum(np.abs(there.slope[0]), np.abs(there.slope[1]))[:, 0].tolist()
    moved = sum(slope * error for slope, (_, error, _) in zip(steep, moving, strict=True))
    return min(_sure(moved), _sure(most - least)) + UNIT * max(abs(least), abs(most)) + _TINY


def _size(e: sp.Expr, around: Sides) -> float:
    return max(map(abs, _range(e, around)))


@lru_cache(maxsize=4096)
def _range(e: sp.Expr, around: Sides) -> tuple[float, float]:
    """An interval of the values of an expression."""
    low, high = around.outer
    try:
        (there,) = enclose(tape([e], around.symbols), low[:, None], high[:, None])
    except NoTape:
        return -math.inf, math.inf
    return float(there.value[0][0]), float(there.value[1][0])


def _sure(number: float) -> float:
    return math.inf if math.isnan(number) else number
