"""Tables of a certificate: functions by points, held at their ends, whose ranges are exact.

    Linear(x, m, x_0, y_0, x_1, y_1, ..), Monotone(x, m, x_0, y_0, ..): the derivative of order m at x, 0 for the value

Between two points Linear is a line. Monotone is the cubic with slopes d_k at its ends: inside 0 where the chords D on
both sides have not one sign, else 1/d_k the mean of 1/D weighted by w = h + 2 g of the widths h of its own chord and g
of the other; at an end the slope of the parabola through the three nearest points, 0 against its chord, 3 D at most
where the next chord turns round (Fritsch and Carlson 1980, Fritsch and Butland 1984). Where a derivative jumps it is
the set between its limits; on a box that ends there, the limit from within.
"""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import pairwise

KINDS = ("Linear", "Monotone")
MOST = 10_000  # points
HIGHEST = 8  # order of a derivative
End = Fraction | float
Piece = tuple[Fraction, ...]  # coefficients about the left end, the constant first
_ZERO = Fraction(0)


@dataclass(frozen=True)
class Table:
    """The points, and the `pieces` of each derivative, one more than points: before the first, between, beyond."""

    points: tuple[tuple[Fraction, Fraction], ...]
    kind: str

    @cached_property
    def places(self) -> tuple[Fraction, ...]:
        """The breakpoints."""
        return tuple(x for x, _ in self.points)

    @cached_property
    def orders(self) -> tuple[tuple[Piece, ...], ...]:
        """The pieces of the value and of its derivatives, of which the fourth is zero."""
        inner = _lines(self.points) if self.kind == "Linear" else _cubics(self.points)
        every = [((self.points[0][1],), *inner, (self.points[-1][1],))]
        for _ in range(4):
            every.append(tuple(_rate(piece) for piece in every[-1]))
        return tuple(every)

    @cached_property
    def jumps(self) -> tuple[int, ...]:
        """For each breakpoint the lowest order that jumps there, 5 where none does."""
        widths = (_ZERO, *(b - a for a, b in pairwise(self.places)))
        return tuple(
            next((m for m in range(4) if _at(self.orders[m][k], width) != _at(self.orders[m][k + 1], _ZERO)), 5)
            for k, width in enumerate(widths)
        )

    def pieces_on(self, low: End, high: End) -> tuple[int, int]:
        """The first and the last piece on [low, high], the breakpoints between them inside it; of one breakpoint the
        pieces on both sides."""
        first, last = bisect_left(self.places, low), bisect_right(self.places, low)
        return (last, bisect_left(self.places, high)) if low < high else (first, last)

    def range(self, order: int, low: End, high: End) -> tuple[Fraction, Fraction] | None:
        """The least and the largest value on [low, high], or bounds of them; None where it is not bounded."""
        (first, last), order = self.pieces_on(low, high), min(order, 4)
        if any(jump < order for jump in self.jumps[first:last]):
            return None
        ranges = [self._on(order, k, low, high) for k in range(first, last + 1)]
        return min(least for least, _ in ranges), max(most for _, most in ranges)

    def _on(self, order: int, k: int, low: End, high: End) -> tuple[Fraction, Fraction]:
        piece = self.orders[order][k]
        if not any(piece[1:]):
            return piece[0], piece[0]
        start, end = self.places[k - 1], self.places[k]  # a piece that is no constant lies between two points
        return _range(piece, Fraction(max(low, start)) - start, Fraction(min(high, end)) - start)


def _rate(piece: Piece) -> Piece:
    return tuple(k * c for k, c in enumerate(piece) if k) or (_ZERO,)


def _at(piece: Piece, t: Fraction) -> Fraction:
    return sum((c * t**k for k, c in enumerate(piece)), _ZERO)


def _range(piece: Piece, a: Fraction, b: Fraction) -> tuple[Fraction, Fraction]:
    """Of a cubic that turns within, the bounds that its control points give."""
    values = [_at(piece, a), _at(piece, b)]
    if len(piece) == 3 and piece[2]:
        turn = -piece[1] / (2 * piece[2])
        values += [_at(piece, turn)] if a < turn < b else []
    if len(piece) == 4:
        least, most = _range(_rate(piece), a, b)
        third, rate = (b - a) / 3, _rate(piece)
        values += [values[0] + third * _at(rate, a), values[1] - third * _at(rate, b)] if least < 0 < most else []
    return min(values), max(values)


def _lines(points: Sequence[tuple[Fraction, Fraction]]) -> list[Piece]:
    return [(c, (d - c) / (b - a)) for (a, c), (b, d) in pairwise(points)]


def _cubics(points: Sequence[tuple[Fraction, Fraction]]) -> list[Piece]:
    widths = [b - a for (a, _), (b, _) in pairwise(points)]
    chords = [rise for _, rise in _lines(points)]
    slopes = _ends(widths, chords)
    pieces: list[Piece] = []
    for k, (h, D) in enumerate(zip(widths, chords, strict=True)):
        p, q = slopes[k] - D, slopes[k + 1] - D  # y + D t + t (t - h) (p (t - h) + q t)/h^2
        pieces.append((points[k][1], slopes[k], -(2 * p + q) / h, (p + q) / h**2))
    return pieces


def _ends(h: Sequence[Fraction], D: Sequence[Fraction]) -> list[Fraction]:
    if len(D) == 1:
        return [D[0], D[0]]
    return [_last(h[1], h[0], D[1], D[0]), *map(_between, h, h[1:], D, D[1:]), _last(h[-2], h[-1], D[-2], D[-1])]


def _between(g: Fraction, h: Fraction, C: Fraction, D: Fraction) -> Fraction:
    if C * D <= 0:
        return _ZERO
    v, w = g + 2 * h, h + 2 * g
    return (v + w) / (v / C + w / D)


def _last(g: Fraction, h: Fraction, C: Fraction, D: Fraction) -> Fraction:
    """The slope at the end of the last chord D, of width h, after C of width g."""
    slope = D + h * (D - C) / (g + h)
    if slope * D <= 0:
        return _ZERO
    return 3 * D if C * D <= 0 and abs(slope) > abs(3 * D) else slope


# --- as the name of a function


def name_of(kind: str, order: Fraction, numbers: Sequence[Fraction]) -> str:
    """The name that stands for a table's derivative in an expression's program. Raises: `ValueError` with the fault."""
    if order.denominator != 1 or not 0 <= order <= HIGHEST:
        raise ValueError(f"the order of a derivative is a whole number from 0 to {HIGHEST}")
    if len(numbers) % 2 or not 4 <= len(numbers) <= 2 * MOST:
        raise ValueError(f"a table has x and y of 2 to {MOST} points")
    if any(a >= b for a, b in pairwise(numbers[::2])):
        raise ValueError("the x of a table do not increase")
    return " ".join((kind, *map(str, (order, *numbers))))


def is_table(name: str) -> bool:
    """Whether a function's name stands for a table."""
    return " " in name


@lru_cache(maxsize=256)
def table_of(name: str) -> tuple[Table, int]:
    """The table, and the order of its derivative."""
    kind, order, *numbers = name.split()
    exact = list(map(Fraction, numbers))
    return Table(tuple(zip(exact[::2], exact[1::2], strict=True)), kind), int(order)


def next_of(name: str) -> str:
    """The name of the derivative."""
    kind, order, rest = name.split(" ", 2)
    return f"{kind} {int(order) + 1} {rest}"


def jumps(name: str) -> bool:
    """Whether it is a table's derivative that jumps somewhere."""
    if not is_table(name):
        return False
    table, order = table_of(name)
    return min(table.jumps) <= order


def value_at(name: str, x: Fraction) -> Fraction | None:
    """The value at a number; None where it jumps."""
    table, order = table_of(name)
    ends = table.range(order, x, x)
    return ends[0] if ends and ends[0] == ends[1] else None


def range_on(name: str, low: End, high: End) -> tuple[Fraction, Fraction] | None:
    """The range on [low, high], whose ends may be infinite; None where it has none."""
    table, order = table_of(name)
    return None if math.isnan(low) or math.isnan(high) else table.range(order, low, high)
