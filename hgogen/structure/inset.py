"""Where slopes are taken: inside the ranges, where a table's argument may end on one of its points.

At a point a lookup takes the cell above it. Where the ranges end there, that cell lies beyond them: what is proved on
the ranges is not of its slope, which may be 0, and an estimate that is clamped to its range stays there. So slopes are
taken a little inside, in every state that such an argument reads, at both ends of its range.

That moves no argument which is largest within the ranges, as min(v, 0) is at v = 0, nor in single precision one that is
far larger than the state which it reads, as v + 273.15. So the argument of a slope is held below that point as well.

A sum is rounded, too, past the first point of a table or the last: 0.1 + 0.7 is below 0.8 in doubles, 1.67 + 1990.28 in
single precision two steps above 1991.95. What is proved to keep off 0 would be 0 there. So it is held at those points.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from fractions import Fraction
from functools import lru_cache
from itertools import product
from math import inf

import sympy as sp

from hgogen.algebra.axis import Axis
from hgogen.algebra.lookup import FREE, Reach, above
from hgogen.algebra.tabulated import Table
from hgogen.intervals.box import Box, End
from hgogen.intervals.rational import rational
from hgogen.intervals.slope import KINKS
from hgogen.signal import Signal

SHARE = Fraction(1, 2**18)  # of a range or its ends: 64 units in the last place of single precision
_SPLITS = 32  # of the box of an argument with kinks
_CORNERS = 6  # signals of an argument, at most, whose corners tell what it attains


def inset(rows: Iterable[sp.Expr], states: Sequence[Signal], around: Box) -> tuple[tuple[float, float], ...]:
    """The range of each state in which slopes of the rows are taken; `around`: the ranges of all that they read."""
    tables = {node for row in rows for node in row.atoms(Table)}
    pairs = ((axis, e) for node in tables for axis, e in zip(node.cells.axes, node.args, strict=True))
    moved = {s for axis, e in pairs if _ends_on(axis, e, around) for s in e.free_symbols}
    return tuple(_inner(*s.interval) if s in moved and s.bounded else s.interval for s in states)


def reaches(rows: Iterable[sp.Expr], around: Box) -> dict[sp.Expr, tuple[Reach, ...]]:
    """The arguments between which derivatives of tables that jump are taken, of those that keep to any; `around`: as in
    `inset`."""
    sides = tuple(around.items())
    every = {node: _reaches(node, sides) for row in rows for node in row.atoms(Table)}
    return {node: places for node, places in every.items() if any(each != FREE for each in places)}


@lru_cache(maxsize=256)  # the same rows are asked for at each stage of a step
def _reaches(node: Table, sides: tuple[tuple[sp.Symbol, tuple[End, End]], ...]) -> tuple[Reach, ...]:
    cells = node.cells.holding()  # as it is computed
    parts = zip(cells.axes, cells.smooth, node.order, node.args, strict=True)
    return tuple(
        _reach(axis, [first <= order + 1 for first in smooth], e, dict(sides)) for axis, smooth, order, e in parts
    )


def _reach(axis: Axis, jumps: Sequence[bool], e: sp.Expr, around: Box) -> Reach:
    """A state itself is rounded as the points are: it needs no hold at a point where a lookup takes the cell within."""
    low, most = -_most(-e, around), _most(e, around)
    bottom, top = _bottom(axis, jumps, low), _top(axis, jumps, (low, most))
    last = float(axis.x[-1])
    return (bottom if bottom > last else -inf, top if top < last else inf) if e.is_Symbol else (bottom, top)


def _most(e: sp.Expr, around: Box) -> End:
    """A number above which an argument does not lie; by bisection where there are kinks, on which it may be largest
    while its slope there is not 0."""
    widths = {s: around[s][1] - around[s][0] for s in sorted(e.free_symbols, key=str)}
    sides = {s: Fraction(width) for s, width in widths.items() if width < inf}
    parts = [(rational(e, around)[1], {s: around[s] for s in widths})]
    for _ in range(_SPLITS if e.has(*KINKS) and sides else 0):
        _, part = parts.pop(max(range(len(parts)), key=lambda k: parts[k][0]))
        longest = max(sides, key=lambda s: (part[s][1] - part[s][0]) / sides[s])
        a, b = part[longest]
        halves = [{**part, longest: half} for half in ((a, (a + b) / 2), ((a + b) / 2, b))]
        parts += [(rational(e, half)[1], half) for half in halves]
    return max(top for top, _ in parts)


def _bottom(axis: Axis, jumps: Sequence[bool], low: End) -> float:
    """The last breakpoint that an argument does not fall below, of those where the slope jumps, where it may come near
    it: a lookup takes the cell above it by itself, but for an argument that is rounded below, and at the last."""
    k = max((k for k in range(bisect_right(axis.x, low)) if jumps[k]), default=-1)
    if k < 0 or low - _share(low, axis.x[k]) > axis.x[k]:
        return -inf
    return float(axis.x[k]) if k < len(axis.x) - 1 else above(float(axis.x[k]))


def _top(axis: Axis, jumps: Sequence[bool], ends: tuple[End, End]) -> float:
    """Below the first breakpoint that an argument in [low, most] does not pass, of those where the slope jumps, where
    it may come near it; the last itself, at which a lookup takes the cell below."""
    low, most = ends
    k = min((k for k in range(bisect_left(axis.x, most), len(axis.x)) if jumps[k]), default=-1)
    if -low == inf or k < 0:
        return inf
    end, share = axis.x[k], _share(low, axis.x[k])
    within = Fraction(0) if k == len(axis.x) - 1 else min(share, Fraction(end - low) / 4)
    return float(end - within) if end - share <= most else inf


def _share(end: End, point: Fraction) -> Fraction:
    """How near a point an argument may be rounded to it, or past it."""
    return SHARE * max(abs(Fraction(end)), abs(point)) if -inf < end < inf else Fraction(0)


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
