"""A table as a piecewise polynomial, with exact numbers: its cells, their ranges, and where derivatives jump.

    f(t) = c_k0 + c_k1 (t - s_k) + c_k2 (t - s_k)^2 + c_k3 (t - s_k)^3     in cell k of its axis

and of two arguments, where it is bilinear between the lines of a grid,

    f(t, r) = c_k00 + c_k01 (r - s_l) + (t - s_k) (c_k10 + c_k11 (r - s_l))     in cell (k, l) of its axes

s_k is the start of cell k (`hgogen.algebra.axis`). A table is held at the ends of its axes, so f has a kink there where
its slope is not 0. A derivative by t jumps at breakpoints of t alone: across those of r it is as continuous as f. So
what jumps, and where, is told axis by axis. A cell, and the order of a derivative, has a number for each axis.
"""

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import product
from math import inf
from typing import Any

import numpy as np

from hgogen.algebra.axis import NEVER, Axis, Ends
from hgogen.algebra.definite import fraction
from hgogen.algebra.interpolation import DEGREES
from hgogen.algebra.piece import ZERO, Polynomial, coefficients, derivative, extremes, rational, value

Index = tuple[int, ...]
Spans = list[tuple[int, int]]  # of each axis the first and the last cell
Pieces = dict[Index, Polynomial]
_NOTHING = rational(ZERO)


@dataclass(frozen=True)
class Cells:
    """A table by its name, its kind, "linear" or "monotone", its axes, and its values: a number for each breakpoint,
    or a tuple of such, one for each of the next axis."""

    name: str
    kind: str
    axes: tuple[Axis, ...]
    values: tuple[Any, ...]

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        return hash((self.name, self.kind, self.axes, self.values))

    @property
    def points(self) -> tuple[Any, ...]:
        """What tells one table from another."""
        return self.kind, tuple(axis.x for axis in self.axes), self.values

    @property
    def plain(self) -> Index:
        """The order of the table itself."""
        return (0,) * len(self.axes)

    def holding(self, *held: bool) -> "Cells":
        """The same points, held at the ends of these axes; of all without any."""
        return self._with("held", held or (True,) * len(self.axes))

    def rounding(self, *rounded: Ends) -> "Cells":
        """The same points, with arguments that are rounded."""
        return self._with("rounded", rounded)

    def _with(self, name: str, values: Sequence[Any]) -> "Cells":
        pairs = zip(self.axes, values, strict=True)
        return replace(self, axes=tuple(replace(axis, **{name: value}) for axis, value in pairs))

    @cached_property
    def pieces(self) -> Pieces:
        """The polynomial of each cell, in the order of the cells."""
        return _pieces(self.kind, self.axes, np.array(self.values, dtype=object))

    def of_order(self, order: Index) -> Pieces:
        """The polynomials of a derivative of any order."""
        return _of_order(self, tuple(min(k, DEGREES[self.kind] + 1) for k in order))

    @property
    def orders(self) -> list[Index]:
        """The derivatives that are not 0 everywhere."""
        return list(product(range(DEGREES[self.kind] + 1), repeat=len(self.axes)))

    @cached_property
    def smooth(self) -> tuple[Index, ...]:
        """For each axis and each of its breakpoints the first derivative that jumps there, `NEVER` where none does."""
        values = np.array(self.values, dtype=object)
        return tuple(axis.smooth(axis.pieces(self.kind, np.moveaxis(values, k, 0))) for k, axis in enumerate(self.axes))

    @property
    def smoothness(self) -> Index:
        """For each axis, how many derivatives are continuous everywhere."""
        return tuple(min(each) - 1 for each in self.smooth)

    def met(self, box: Sequence[Ends]) -> Spans:
        """The cells that have more than an edge in common with a box; `Axis.met` along each axis."""
        return [axis.met(*side) for axis, side in zip(self.axes, box, strict=True)]

    def least_smooth(self, spans: Spans) -> Index:
        """For each axis the first derivative that jumps at a breakpoint between two cells, `NEVER` where none does."""
        return tuple(
            min(each[first:last], default=NEVER) for each, (first, last) in zip(self.smooth, spans, strict=True)
        )

    def continuous(self, spans: Spans, order: Sequence[int]) -> tuple[bool, ...]:
        """For each axis, whether a derivative has no jump at a breakpoint between two cells."""
        return tuple(k < smooth for k, smooth in zip(order, self.least_smooth(spans), strict=True))

    def at(self, place: Sequence[Fraction], order: Index) -> Fraction | None:
        """The value of a derivative; None where it jumps."""
        spans = self.met([(t, t) for t in place])
        if not all(self.continuous(spans, order)):
            return None
        cell = tuple(last for _, last in spans)
        d = [t - start for t, start in zip(place, self.starts(cell), strict=True)]
        number: Fraction = value(self.of_order(order)[cell], d)
        return number

    def starts(self, cell: Index) -> list[Fraction]:
        """The start of a cell along each axis."""
        return [axis.starts[k] for axis, k in zip(self.axes, cell, strict=True)]

    def taken(self, box: Sequence[Ends]) -> tuple[list[Ends], Spans]:
        """Where a program may compute arguments that are in a box, and the cells; `Axis.taken` along each axis."""
        sides, spans = zip(*(axis.taken(*side) for axis, side in zip(self.axes, box, strict=True)), strict=True)
        return list(sides), list(spans)

    def range(self, box: Sequence[Ends], order: Index) -> Ends | None:
        """Numbers between which a derivative lies on a box, with all its limits where it jumps, as far as a program may
        take it; None where one before it jumps as well."""
        return self.limits(box, order)[0]

    def limits(self, box: Sequence[Ends], order: Index) -> tuple[Ends | None, tuple[bool, ...]]:
        """The range of a derivative on a box, and for each axis whether it has no jump there, as far as a program may
        take it."""
        wide, spans = self.taken(box)
        smooth = self.least_smooth(spans)
        continuous = tuple(k < jump for jump, k in zip(smooth, order, strict=True))
        if any(jump < k for jump, k in zip(smooth, order, strict=True)):
            return None, continuous
        if all(continuous) and any(axis.rounded is not None for axis in self.axes):
            met = self.met(box)
            if all(self.continuous(met, order)):
                wide, spans = list(box), met
        return self._range(wide, spans, order), continuous

    def _range(self, box: Sequence[Ends], spans: Spans, order: Index) -> Ends:
        """Of a derivative on a box that meets the cells of `spans`."""
        whole, level, pieces = _whole(self, order)
        ends = [
            whole[cell]
            if cell in level or all(a < k < b for k, (a, b) in zip(cell, spans, strict=True))
            else self._over(pieces[cell], cell, spans, box)
            for cell in over(spans)
        ]
        sides = [side for side in ends if side is not None]
        if len(sides) < len(ends):
            return -inf, inf
        return fraction(min(least for least, _ in sides)), fraction(max(most for _, most in sides))

    def _over(self, piece: Polynomial, cell: Index, spans: Spans, box: Sequence[Ends]) -> tuple[Any, Any] | None:
        """The range of one cell on a box that meets those of `spans`; None of one without an end."""
        sides = [axis.part(k, span, *side) for axis, k, span, side in zip(self.axes, cell, spans, box, strict=True)]
        for k, side in enumerate(sides):
            if inf in (-side[0], side[1]):
                if not _constant(piece, k):
                    return None
                sides[k] = (_NOTHING, _NOTHING)
        return extremes(piece, sides)


def over(spans: Spans) -> Iterator[Index]:
    """The cells between the first and the last of each axis."""
    return product(*(range(first, last + 1) for first, last in spans))


def _pieces(kind: str, axes: Sequence[Axis], values: Any) -> Pieces:
    """Along the first axis polynomials whose coefficients are values on the others, of which each has its pieces."""
    if not axes:
        return {(): values}
    first, *rest = axes
    parts = [[_pieces(kind, rest, c) for c in piece] for piece in first.pieces(kind, values)]
    return {(k, *cell): tuple(c[cell] for c in part) for k, part in enumerate(parts) for cell in part[0]}


def _constant(piece: Polynomial, k: int) -> bool:
    """Whether a polynomial does not depend on its argument k."""
    if not isinstance(piece, tuple):
        return True
    return all(_constant(c, k - 1) for c in piece) if k else not any(map(any, map(coefficients, piece[1:])))


@lru_cache(maxsize=256)
def _of_order(cells: Cells, order: Index) -> Pieces:
    return {cell: derivative(piece, order) for cell, piece in cells.pieces.items()}


@lru_cache(maxsize=256)
def _whole(cells: Cells, order: Index) -> tuple[Mapping[Index, tuple[Any, Any]], Set[Index], Pieces]:
    """The range of a derivative on each cell between breakpoints, and on those where it is level, which are named;
    and the polynomials, in numbers of FLINT."""
    widths = [[rational(b - a) for a, b in zip(axis.starts, axis.x, strict=False)] for axis in cells.axes]
    inner = [range(1, len(axis.x)) for axis in cells.axes]
    pieces = {cell: rational(piece) for cell, piece in cells.of_order(order).items()}
    level = {cell for cell, piece in pieces.items() if all(_constant(piece, k) for k in range(len(order)))}
    whole = {cell: extremes(pieces[cell], [(_NOTHING, _NOTHING)] * len(order)) for cell in level}
    for cell in set(product(*inner)) - level:
        sides = [(_NOTHING, width[k]) for width, k in zip(widths, cell, strict=True)]
        whole[cell] = extremes(pieces[cell], sides)
    return whole, level, pieces
