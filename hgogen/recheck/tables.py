"""Tables of a certificate: functions given by points, constant beyond their ends, with exact ranges.

    Linear(x, m, x_0, y_0, x_1, y_1, ..), Monotone(x, m, x_0, y_0, ..): the derivative of order m at x, 0 for the value
    Bilinear(x, y, p, q, n, x_1, .., x_n, y_1, .., y_m, z_11, z_12, .., z_nm): that of order p in x and q in y

Between two points Linear is a line, and Bilinear one along each axis. A value or slope is a weighted sum of the values
at the points, with products of weights along the axes; a range is the range of such sums.

Between two points Monotone is the cubic with slopes d_k at its ends. Inside, the slope is 0 if the chords D on both
sides differ in sign, else 1/d_k is the mean of 1/D weighted by w = h + 2 g, with the width h of its own chord and g of
the other. At an end it is the slope of the parabola through the three nearest points: 0 if it opposes its chord, and 3
D at most if the next chord has the other sign (Fritsch and Carlson 1980, Fritsch and Butland 1984). A derivative that
jumps is the set between its limits; on a box that ends there, the limit from within.
"""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

MOST = 10_000  # points
HIGHEST = 8  # order of a derivative
End = Fraction | float
Side = tuple[End, End]
Order = tuple[int, ...]  # one for each argument
Piece = tuple[Fraction, ...]  # coefficients about the left end, the constant first
Weights = tuple[tuple[int, Fraction], ...]  # of values by their index; without any the sum is zero
_ZERO, _ONE = Fraction(0), Fraction(1)
_NEVER = 5  # more than any order that jumps


def _pieces_on(places: Sequence[Fraction], low: End, high: End) -> tuple[int, int]:
    first, last = bisect_left(places, low), bisect_right(places, low)
    return (last, bisect_left(places, high)) if low < high else (first, last)


@dataclass(frozen=True)
class Grid:
    """A piecewise linear table, constant beyond its breakpoints `axes`; `values`: one for each breakpoint of the first
    axis, with two axes a row over the second."""

    axes: tuple[tuple[Fraction, ...], ...]
    values: tuple[Any, ...]
    degree = 1  # along an axis

    @cached_property
    def jumps(self) -> tuple[Order, ...]:
        """The lowest order of a derivative that jumps at each breakpoint of each axis: 1 if the slopes on both sides
        differ."""
        turned = (self.values, tuple(zip(*self.values, strict=True)) if len(self.axes) > 1 else ())
        return tuple(
            tuple(
                1 if a != b else _NEVER for a, b in pairwise(_mixed(_rise(axis, k), rows) for k in range(len(axis) + 1))
            )
            for axis, rows in zip(self.axes, turned, strict=False)
        )

    def range(self, order: Order, box: Sequence[Side]) -> tuple[Fraction, Fraction] | None:
        """Return the least and the largest value on a box of the derivative with an `order` by each argument; None if
        it is unbounded."""
        if any(_beyond(*each) for each in zip(self.axes, self.jumps, order, box, strict=True)):
            return None
        weights = [list(_weights(*each)) for each in zip(self.axes, order, box, strict=True)]
        sums = list(_sums(weights, self.values))
        return min(sums), max(sums)


def _beyond(places: Sequence[Fraction], jumps: Order, order: int, side: Side) -> bool:
    first, last = _pieces_on(places, *side)
    return any(jump < order for jump in jumps[first:last])


def _weights(places: Sequence[Fraction], order: int, side: Side) -> Iterator[Weights]:
    low, high = side
    first, last = _pieces_on(places, low, high)
    if order == 0:
        yield from (_between_places(places, t) for t in dict.fromkeys((low, *places[first:last], high)))
    else:
        yield from (_rise(places, k) if order == 1 else () for k in range(first, last + 1))


def _between_places(places: Sequence[Fraction], t: End) -> Weights:
    """Return the weights by which the values y_k at the breakpoints `places` make the value of a linear table at t, as
    pairs (k, weight); beyond its ends the table is constant."""
    if not places[0] < t < places[-1]:
        return ((0 if t <= places[0] else len(places) - 1, _ONE),)
    k = bisect_right(places, t)
    part = (Fraction(t) - places[k - 1]) / (places[k] - places[k - 1])
    return ((k - 1, 1 - part), (k, part))


def _rise(places: Sequence[Fraction], k: int) -> Weights:
    """Return the weights by which the values y_k at the breakpoints `places` make the slope of piece k, as pairs (k,
    weight); none beyond the table, where the slope is 0."""
    if not 0 < k < len(places):
        return ()
    width = places[k] - places[k - 1]
    return ((k - 1, -1 / width), (k, 1 / width))


def _sums(weights: Sequence[Sequence[Weights]], values: Any) -> Iterator[Fraction]:
    if not weights:
        yield values
        return
    for each in weights[0]:
        yield from _sums(weights[1:], _mixed(each, values))


def _mixed(weights: Weights, values: Sequence[Any]) -> Any:
    if not isinstance(values[0], tuple):
        return sum((weight * values[k] for k, weight in weights), _ZERO)
    rows = [tuple(weight * number for number in values[k]) for k, weight in weights]
    return tuple(map(sum, zip(*rows, strict=True))) if rows else (_ZERO,) * len(values[0])


@dataclass(frozen=True)
class Curve:
    """A table of monotone cubics through `points` (x, y), constant beyond them."""

    points: tuple[tuple[Fraction, Fraction], ...]
    degree = 3

    @cached_property
    def axes(self) -> tuple[tuple[Fraction, ...]]:
        """The breakpoints of the only axis."""
        return (tuple(x for x, _ in self.points),)

    @cached_property
    def orders(self) -> tuple[tuple[Piece, ...], ...]:
        """The polynomial pieces of the table and of its derivatives up to the fourth, which is zero; the first and the
        last piece lie beyond the points."""
        every = [((self.points[0][1],), *_cubics(self.points), (self.points[-1][1],))]
        for _ in range(4):
            every.append(tuple(_rate(piece) for piece in every[-1]))
        return tuple(every)

    @cached_property
    def jumps(self) -> tuple[Order]:
        """The lowest order of a derivative that jumps at each breakpoint."""
        lowest = []
        for k, width in enumerate((_ZERO, *(b - a for a, b in pairwise(self.axes[0])))):
            differ = (m for m, each in enumerate(self.orders[:4]) if _at(each[k], width) != _at(each[k + 1], _ZERO))
            lowest.append(next(differ, _NEVER))
        return (tuple(lowest),)

    def range(self, order: Order, box: Sequence[Side]) -> tuple[Fraction, Fraction] | None:
        """Return bounds of the derivative of an `order` on a box, exact unless a cubic has an extremum inside; None if
        it is unbounded."""
        ((low, high),), m = box, min(order[0], 4)
        if _beyond(self.axes[0], self.jumps[0], m, (low, high)):
            return None
        first, last = _pieces_on(self.axes[0], low, high)
        ranges = [self._on(m, k, low, high) for k in range(first, last + 1)]
        return min(least for least, _ in ranges), max(most for _, most in ranges)

    def _on(self, order: int, k: int, low: End, high: End) -> tuple[Fraction, Fraction]:
        piece = self.orders[order][k]
        if not any(piece[1:]):
            return piece[0], piece[0]
        start, end = self.axes[0][k - 1], self.axes[0][k]  # a piece that is not constant is between two points
        return _range(piece, Fraction(max(low, start)) - start, Fraction(min(high, end)) - start)


def _rate(piece: Piece) -> Piece:
    return tuple(k * c for k, c in enumerate(piece) if k) or (_ZERO,)


def _at(piece: Piece, t: Fraction) -> Fraction:
    return sum((c * t**k for k, c in enumerate(piece)), _ZERO)


def _range(piece: Piece, a: Fraction, b: Fraction) -> tuple[Fraction, Fraction]:
    """Return the range of a polynomial on [a, b]; for a cubic with an extremum inside the bounds by its Bezier control
    points."""
    values = [_at(piece, a), _at(piece, b)]
    if len(piece) == 3 and piece[2]:
        turn = -piece[1] / (2 * piece[2])
        values += [_at(piece, turn)] if a < turn < b else []
    if len(piece) == 4:
        least, most = _range(_rate(piece), a, b)
        third, rate = (b - a) / 3, _rate(piece)
        values += [values[0] + third * _at(rate, a), values[1] - third * _at(rate, b)] if least < 0 < most else []
    return min(values), max(values)


def _cubics(points: Sequence[tuple[Fraction, Fraction]]) -> list[Piece]:
    widths = [b - a for (a, _), (b, _) in pairwise(points)]
    chords = [(d - c) / (b - a) for (a, c), (b, d) in pairwise(points)]
    slopes = 2 * chords
    if len(chords) > 1:
        inside = map(_between, widths, widths[1:], chords, chords[1:])
        slopes = [_last(widths[1], widths[0], chords[1], chords[0]), *inside, _last(*widths[-2:], *chords[-2:])]
    pieces: list[Piece] = []
    for k, (h, D) in enumerate(zip(widths, chords, strict=True)):
        p, q = slopes[k] - D, slopes[k + 1] - D  # y + D t + t (t - h) (p (t - h) + q t)/h^2
        pieces.append((points[k][1], slopes[k], -(2 * p + q) / h, (p + q) / h**2))
    return pieces


def _between(g: Fraction, h: Fraction, C: Fraction, D: Fraction) -> Fraction:
    if C * D <= 0:
        return _ZERO
    v, w = g + 2 * h, h + 2 * g
    return (v + w) / (v / C + w / D)


def _last(g: Fraction, h: Fraction, C: Fraction, D: Fraction) -> Fraction:
    """Return the slope of a monotone cubic at the end of its last interval. This has the width h and the chord slope D,
    the interval before it the width g and the chord slope C."""
    slope = D + h * (D - C) / (g + h)
    if slope * D <= 0:
        return _ZERO
    return 3 * D if C * D <= 0 and abs(slope) > abs(3 * D) else slope


# --- as the name of a function


def _points(numbers: Sequence[Fraction]) -> tuple[tuple[Fraction, Fraction], ...]:
    if len(numbers) % 2 or not 4 <= len(numbers) <= 2 * MOST:
        raise ValueError(f"a table has x and y of 2 to {MOST} points")
    return tuple(zip(numbers[::2], numbers[1::2], strict=True))


def _line(numbers: Sequence[Fraction]) -> Grid:
    x, y = zip(*_points(numbers), strict=True)
    return Grid((x,), y)


def _map(numbers: Sequence[Fraction]) -> Grid:
    """Return the table in the numbers n, then n breakpoints x, the breakpoints y, and the values row by row. Raises:
    `ValueError` with the fault."""
    n = int(numbers[0]) if numbers and numbers[0].denominator == 1 and 2 <= numbers[0] < len(numbers) else 0
    m, excess = divmod(len(numbers) - 1 - n, n + 1)
    if not n or excess or m < 2 or n * m > MOST:
        raise ValueError(f"a map has n, n of x, m of y and n m values; n and m are 2 or more, and n m at most {MOST}")
    x, y, z = numbers[1 : n + 1], numbers[n + 1 : n + m + 1], numbers[n + m + 1 :]
    return Grid((tuple(x), tuple(y)), tuple(tuple(z[k * m : (k + 1) * m]) for k in range(n)))


KINDS: Mapping[str, tuple[int, Callable[[Sequence[Fraction]], Grid | Curve]]] = {  # with the count of arguments
    "Linear": (1, _line),
    "Monotone": (1, lambda numbers: Curve(_points(numbers))),
    "Bilinear": (2, _map),
}


def name_of(kind: str, numbers: Sequence[Fraction]) -> str:
    """Return the name by which a derivative of a table is called in expressions: its kind with its orders and numbers.
    Raises: `ValueError`."""
    count, table = KINDS[kind]
    if len(numbers) < count or any(m.denominator != 1 or not 0 <= m <= HIGHEST for m in numbers[:count]):
        raise ValueError(f"the order of a derivative is a whole number from 0 to {HIGHEST}")
    if any(a >= b for axis in table(numbers[count:]).axes for a, b in pairwise(axis)):
        raise ValueError("the x of a table do not increase")
    return " ".join((kind, *map(str, numbers)))


def is_table(name: str) -> bool:
    """Return whether a function's name is that of a table."""
    return " " in name


@lru_cache(maxsize=256)
def table_of(name: str) -> tuple[Grid | Curve, Order]:
    """Return the table that is encoded in a function's name, and the order of the derivative by each argument."""
    kind, *numbers = name.split()
    count, table = KINDS[kind]
    return table(tuple(map(Fraction, numbers[count:]))), tuple(map(int, numbers[:count]))


def next_of(name: str, k: int) -> str:
    """Return the name of the table's derivative by argument k, from 0."""
    kind, *orders = name.split(" ", k + 2)
    return " ".join((kind, *orders[:k], str(int(orders[k]) + 1), *orders[k + 1 :]))


def jumps(name: str, more: int = 0) -> bool:
    """Return whether the table's derivative with this name jumps somewhere, or a derivative of it of up to `more`
    higher orders."""
    if not is_table(name):
        return False
    table, order = table_of(name)
    return any(min(along) <= m + more for along, m in zip(table.jumps, order, strict=True))


def in_one_piece(name: str, box: Sequence[Side]) -> bool:
    """Return whether a box lies inside one polynomial piece of the table along each axis, breakpoints excluded."""
    axes = table_of(name)[0].axes
    return all(bisect_left(axis, low) == bisect_right(axis, high) for axis, (low, high) in zip(axes, box, strict=True))


def value_at(name: str, at: Sequence[Fraction]) -> Fraction | None:
    """Return the value of the table's derivative with this name at the numbers `at`; None at a jump."""
    ends = range_on(name, [(x, x) for x in at])
    return ends[0] if ends and ends[0] == ends[1] else None


def range_on(name: str, box: Sequence[Side]) -> tuple[Fraction, Fraction] | None:
    """Return the range of the table's derivative with this name on a box, which may be infinite; None if it is
    unbounded."""
    table, order = table_of(name)
    return None if any(math.isnan(end) for side in box for end in side) else table.range(order, box)
