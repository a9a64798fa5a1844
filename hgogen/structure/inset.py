"""Where slopes are taken: inside the ranges, where a table's argument may end on one of its points.

At a point a lookup takes the cell above it. Where the ranges end there, that cell lies beyond them: what is proved on
the ranges is not of its slope, which may be 0, and an estimate that is clamped to its range stays there. So slopes are
taken a little inside, in every state that such an argument reads, at both ends of its range.
"""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from itertools import product

import sympy as sp

from hgogen.algebra.axis import Axis
from hgogen.algebra.tabulated import Table
from hgogen.intervals.box import Box
from hgogen.intervals.rational import rational
from hgogen.signal import Signal

SHARE = Fraction(1, 2**18)  # of a range or its ends: 64 units in the last place of single precision
_CORNERS = 6  # signals of an argument, at most, whose corners tell what it attains


def inset(rows: Iterable[sp.Expr], states: Sequence[Signal], around: Box) -> tuple[tuple[float, float], ...]:
    """The range of each state in which slopes of the rows are taken; `around`: the ranges of all that they read."""
    tables = {node for row in rows for node in row.atoms(Table)}
    pairs = ((axis, e) for node in tables for axis, e in zip(node.cells.axes, node.args, strict=True))
    moved = {s for axis, e in pairs if _ends_on(axis, e, around) for s in e.free_symbols}
    return tuple(_inner(*s.interval) if s in moved and s.bounded else s.interval for s in states)


def _ends_on(axis: Axis, argument: sp.Expr, around: Box) -> bool:
    """Whether the largest value of an argument on the box may be a breakpoint, or be rounded to one."""
    sides = [(s, around[s]) for s in sorted(argument.free_symbols, key=str)]
    most = rational(argument, around)[1]
    if abs(most) == float("inf"):
        return False
    corners = product(*(ends for _, ends in sides)) if len(sides) <= _CORNERS else ()
    points = ({s: (end, end) for (s, _), end in zip(sides, corner, strict=True)} for corner in corners)
    least = max((rational(argument, point)[0] for point in points), default=axis.x[0])
    slack = SHARE * max(abs(Fraction(end)) for end in (least, most))
    return any(least - slack <= x <= most + slack for x in axis.x)


def _inner(low: float, high: float) -> tuple[float, float]:
    step = float(min(SHARE * Fraction(max(high - low, abs(low), abs(high))), Fraction(high - low) / 4))
    return low + step, high - step
