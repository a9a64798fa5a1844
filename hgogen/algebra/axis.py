"""One argument of a table: its breakpoints, and the cells below, between and above them."""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import inf, nextafter
from typing import Any

from hgogen.algebra.interpolation import KINDS
from hgogen.algebra.piece import ZERO, rational, taylor

Number = Fraction | float  # of which a float is infinite, or exactly what it is
Ends = tuple[Number, Number]
NEVER = 1000  # more than any order


@dataclass(frozen=True)
class Axis:
    """Breakpoints x_0 < .. < x_(n-1): cell 0 lies below the first, cell n above the last. Beyond them a table is
    constant, `held`; where its argument keeps within them, the first and the last polynomial may go on instead.
    `rounded`: of cells that a program takes, how far below and above its exact value it may compute the argument."""

    x: tuple[Fraction, ...]
    held: bool = True
    rounded: Ends | None = None

    @cached_property
    def starts(self) -> tuple[Fraction, ...]:
        """The breakpoint below each cell, of the first cell the one above it."""
        return (self.x[0], *self.x)

    @cached_property
    def _floats(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The floats next below the breakpoints, and those next above, or the breakpoints themselves."""
        nearest = [(float(x), x) for x in self.x]
        below = tuple(f if f <= x else nextafter(f, -inf) for f, x in nearest)
        return below, tuple(f if f >= x else nextafter(f, inf) for f, x in nearest)

    def _before(self, end: Number) -> int:
        """How many breakpoints lie below a number; of a float as soon as the float next below them does."""
        return bisect_left(self._floats[0] if isinstance(end, float) else self.x, end)

    def _until(self, end: Number) -> int:
        """How many breakpoints do not lie above a number."""
        return bisect_right(self._floats[1] if isinstance(end, float) else self.x, end)

    def met(self, low: Number, high: Number) -> tuple[int, int]:
        """The first and the last cell that have more than an end in common with [low, high]; of a breakpoint alone, the
        cells on both its sides."""
        if low == high:
            return self._before(low), self._until(low)
        return self._until(low), self._before(high)

    def taken(self, low: Number, high: Number) -> tuple[Ends, tuple[int, int]]:
        """Where a program may compute an argument that is in [low, high], and the first and the last cell that it
        takes, at a breakpoint the one above; beyond the ends of a table that is not held, what is at its ends."""
        if self.rounded is None:
            return (low, high), self.met(low, high)
        low, high = low - self._rounded(low)[0], high + self._rounded(high)[1]
        cells = self._until(low), self._until(high)
        if self.held:
            return (low, high), cells
        return (low if cells[0] else self.x[0], high if cells[1] < len(self.x) else self.x[-1]), cells

    def _rounded(self, end: Number) -> Ends:
        """`rounded` in floats beside a float, which Python makes of it anyway, but slowly."""
        assert self.rounded is not None
        return self._float_rounded if isinstance(end, float) else self.rounded

    @cached_property
    def _float_rounded(self) -> Ends:
        assert self.rounded is not None
        below, above = self.rounded
        return float(below), float(above)

    def part(self, k: int, span: tuple[int, int], low: Number, high: Number) -> tuple[Any, Any]:
        """What of [low, high], which meets the cells of a span, lies in one of them, from its start on: numbers of
        FLINT, or infinite ones."""
        x, starts = self._rational
        a = low if k == span[0] else starts[k]
        b = high if k == span[1] else x[k]
        return _since(starts[k], a), _since(starts[k], b)

    @cached_property
    def _rational(self) -> tuple[list[Any], list[Any]]:
        """The breakpoints and the starts as numbers of FLINT, which are added and compared far faster."""
        return list(map(rational, self.x)), list(map(rational, self.starts))

    def pieces(self, kind: str, values: Any) -> list[tuple[Any, ...]]:
        """The polynomial of each cell, of the values at the breakpoints: numbers, or an array of them for each."""
        inner = KINDS[kind](self.x, values)
        if self.held:
            return [(values[0],), *inner, (values[-1],)]
        return [inner[0], *inner, taylor(inner[-1], self.x[-1] - self.x[-2])]

    def smooth(self, pieces: Sequence[tuple[Any, ...]]) -> tuple[int, ...]:
        """For each breakpoint the first derivative of such polynomials that jumps there, 1 for a kink, `NEVER` where
        none does."""
        widths = [b - a for a, b in zip(self.starts, self.x, strict=False)]
        return tuple(map(_first_jump, widths, pieces, pieces[1:]))


def _since(start: Any, end: Any) -> Any:
    return end if end in (-inf, inf) else rational(end) - start


def _first_jump(width: Fraction, below: tuple[Any, ...], above: tuple[Any, ...]) -> int:
    """By the coefficients of both about the breakpoint between them."""
    moved = taylor(below, width)
    for order in range(max(len(moved), len(above))):
        left, right = (piece[order] if order < len(piece) else ZERO for piece in (moved, above))
        different = left != right
        if different.any() if hasattr(different, "any") else different:
            return order
    return NEVER
