"""One argument of a table: its breakpoints, and the cells below, between and above them."""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import inf
from typing import Any

from hgogen.algebra.interpolation import KINDS
from hgogen.algebra.piece import ZERO, taylor

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

    def met(self, low: Number, high: Number) -> tuple[int, int]:
        """The first and the last cell that have more than an end in common with [low, high]; of a breakpoint alone, the
        cells on both its sides."""
        if low == high:
            return bisect_left(self.x, low), bisect_right(self.x, low)
        return bisect_right(self.x, low), bisect_left(self.x, high)

    def taken(self, low: Number, high: Number) -> tuple[Ends, tuple[int, int]]:
        """Where a program may compute an argument that is in [low, high], and the first and the last cell that it
        takes, at a breakpoint the one above; beyond the ends of a table that is not held, what is at its ends."""
        if self.rounded is None:
            return (low, high), self.met(low, high)
        low, high = low - self.rounded[0], high + self.rounded[1]
        cells = bisect_right(self.x, low), bisect_right(self.x, high)
        return (low, high) if self.held else (max(low, self.x[0]), min(high, self.x[-1])), cells

    def part(self, k: int, low: Number, high: Number) -> Ends:
        """What of [low, high] lies in a cell, from its start on."""
        a, b = (max(low, self.starts[k]) if k else low), (min(high, self.x[k]) if k < len(self.x) else high)
        return _since(self.starts[k], a), _since(self.starts[k], b)

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


def _since(start: Fraction, end: Number) -> Number:
    return end if end in (-inf, inf) else Fraction(end) - start


def _first_jump(width: Fraction, below: tuple[Any, ...], above: tuple[Any, ...]) -> int:
    """By the coefficients of both about the breakpoint between them."""
    moved = taylor(below, width)
    for order in range(max(len(moved), len(above))):
        left, right = (piece[order] if order < len(piece) else ZERO for piece in (moved, above))
        if _differ(left, right):
            return order
    return NEVER


def _differ(a: Any, b: Any) -> bool:
    different = a != b
    return bool(different.any() if hasattr(different, "any") else different)
