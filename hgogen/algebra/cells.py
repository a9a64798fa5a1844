"""A table as a piecewise polynomial, with exact numbers: its cells, their ranges, and where derivatives jump.

    f(t) = c_k0 + c_k1 (t - s_k) + c_k2 (t - s_k)^2 + c_k3 (t - s_k)^3     for x_(k-1) <= t <= x_k,   k = 0 .. n

The breakpoints are x_0 < .. < x_(n-1); cell 0 lies below the first and cell n above the last, where f is constant: a
table is held at its ends. s_k is the breakpoint below cell k, x_0 for the first. Of a table whose argument keeps within
its points, the first and the last polynomial may go on beyond instead.

    linear     c_k1 = D_k = (y_k - y_(k-1))/(x_k - x_(k-1))
    monotone   cubics through the points with slopes d_k, which rise and fall with the points and have no other turns

The slopes d_k are Fritsch and Butland's, as in PCHIP: 0 where D_k D_(k+1) <= 0, and inside the weighted harmonic mean

    3 (h_k + h_(k+1))/d = (2 h_(k+1) + h_k)/D_k + (h_(k+1) + 2 h_k)/D_(k+1),    h_k = x_k - x_(k-1)

At the ends it is the slope of the parabola through three points, 0 where its sign is not D's, and 3 D at most where the
next D has another sign. Held beyond, f has a kink at an end with another slope than 0. Sources: F. N. Fritsch and R. E.
Carlson, "Monotone piecewise cubic interpolation", SIAM J. Numer. Anal. 17 (1980), for what slopes are monotone; F. N.
Fritsch and J. Butland, "A method for constructing local monotone piecewise cubic interpolants", SIAM J. Sci. Stat.
Comput. 5 (1984), for these.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from math import comb, inf

Polynomial = tuple[Fraction, ...]  # of t - s, the constant first
Numbers = tuple[Fraction, ...]
Number = Fraction | float  # of which a float is infinite, or exactly what it is
ZERO = Fraction(0)
NEVER = 1000  # more than any order


@dataclass(frozen=True)
class Cells:
    """A table by its name, its kind, "linear" or "monotone", and its points, whose `x` increase; `held` at its ends."""

    name: str
    kind: str
    x: Numbers
    y: Numbers
    held: bool = True

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        return hash((self.name, self.kind, self.x, self.y, self.held))

    @property
    def points(self) -> tuple[str, Numbers, Numbers]:
        """What tells one table from another."""
        return self.kind, self.x, self.y

    @cached_property
    def starts(self) -> Numbers:
        """The breakpoint below each cell."""
        return (self.x[0], *self.x)

    @cached_property
    def pieces(self) -> tuple[Polynomial, ...]:
        """The polynomial of each cell."""
        inner = _linear(self.x, self.y) if self.kind == "linear" else _monotone(self.x, self.y)
        if self.held:
            return ((self.y[0],), *inner, (self.y[-1],))
        return (inner[0], *inner, taylor(inner[-1], self.x[-1] - self.x[-2]))

    @cached_property
    def derivatives(self) -> tuple[tuple[Polynomial, ...], ...]:
        """The polynomials of each derivative, of which the last is 0."""
        orders = [self.pieces]
        while any(any(piece) for piece in orders[-1]):
            orders.append(tuple(map(derivative, orders[-1])))
        return tuple(orders)

    def of_order(self, order: int) -> tuple[Polynomial, ...]:
        """The polynomials of a derivative of any order."""
        return self.derivatives[min(order, len(self.derivatives) - 1)]

    @cached_property
    def smooth(self) -> tuple[int, ...]:
        """For each breakpoint the first derivative that jumps there, 1 for a kink, `NEVER` where none does."""
        return tuple(self._first_jump(j) for j in range(len(self.x)))

    def _first_jump(self, j: int) -> int:
        width = self.starts[j + 1] - self.starts[j]
        for order, pieces in enumerate(self.derivatives):
            if value(pieces[j], width) != value(pieces[j + 1], ZERO):
                return order
        return NEVER

    @property
    def smoothness(self) -> int:
        """How many derivatives are continuous everywhere."""
        return min(self.smooth) - 1

    def met(self, low: Number, high: Number) -> tuple[int, int]:
        """The first and the last cell that have more than an end in common with [low, high]; of a breakpoint alone, the
        cells on both its sides."""
        if low == high:
            return bisect_left(self.x, low), bisect_right(self.x, low)
        return bisect_right(self.x, low), bisect_left(self.x, high)

    def least_smooth(self, first: int, last: int) -> int:
        """The first derivative that jumps at a breakpoint between two cells, `NEVER` where none does."""
        return min(self.smooth[first:last], default=NEVER)

    def at(self, place: Fraction, order: int = 0) -> Fraction | None:
        """The value of a derivative; None where it jumps."""
        first, last = self.met(place, place)
        if self.least_smooth(first, last) <= order:
            return None
        return value(self.of_order(order)[last], place - self.starts[last])

    def range(self, low: Number, high: Number, order: int = 0) -> tuple[Number, Number] | None:
        """Numbers between which a derivative lies on [low, high], with both its limits where it jumps; None where the
        one before jumps as well."""
        first, last = self.met(low, high)
        if self.least_smooth(first, last) < order:
            return None
        ends = [self._over(order, k, low, high) for k in {first, last}]
        if last - first > 1:
            ends.append(self._across(order, first + 1, last))
        return min(least for least, _ in ends), max(most for _, most in ends)

    def _over(self, order: int, k: int, low: Number, high: Number) -> tuple[Number, Number]:
        """The range of one cell on [low, high]."""
        piece, start = self.of_order(order)[k], self.starts[k]
        if not any(piece[1:]):
            return piece[0], piece[0]
        a, b = (max(low, start) if k else low), (min(high, self.x[k]) if k < len(self.x) else high)
        return (-inf, inf) if inf in (-a, b) else extremes(piece, Fraction(a) - start, Fraction(b) - start)

    def _across(self, order: int, first: int, last: int) -> tuple[Fraction, Fraction]:
        """The range of all of the cells from `first` to before `last`."""
        ranges = self._whole[min(order, len(self.derivatives) - 1)][first - 1 : last - 1]
        return min(least for least, _ in ranges), max(most for _, most in ranges)

    @cached_property
    def _whole(self) -> tuple[tuple[tuple[Fraction, Fraction], ...], ...]:
        """The range of each derivative on each cell between two points."""
        widths = [b - a for a, b in pairwise(self.x)]
        return tuple(
            tuple(extremes(piece, ZERO, width) for piece, width in zip(pieces[1:-1], widths, strict=True))
            for pieces in self.derivatives
        )


# --- polynomials


def derivative(piece: Polynomial) -> Polynomial:
    """The derivative of a polynomial."""
    return tuple(k * c for k, c in enumerate(piece))[1:] or (ZERO,)


def value(piece: Polynomial, d: Fraction) -> Fraction:
    """A polynomial's value."""
    total = ZERO
    for c in reversed(piece):
        total = total * d + c
    return total


def taylor(piece: Polynomial, a: Fraction) -> Polynomial:
    """The coefficients of the same polynomial about a, by Horner's scheme."""
    moved = list(piece)
    for i in range(len(piece) - 1):
        for j in range(len(piece) - 2, i - 1, -1):
            moved[j] += a * moved[j + 1]
    return tuple(moved)


def extremes(piece: Polynomial, a: Fraction, b: Fraction) -> tuple[Fraction, Fraction]:
    """The range of a polynomial on [a, b]: exact up to degree 2 and where its derivative keeps its sign, else that of
    its coefficients in the basis of Bernstein, whose hull holds it."""
    ends: tuple[Fraction, ...] = (value(piece, a), value(piece, b))
    slope = derivative(piece)
    if len(piece) > 3 and any(slope):
        low, high = extremes(slope, a, b)
        ends = ends if low >= 0 or high <= 0 else _bernstein(piece, a, b)
    elif len(piece) == 3 and piece[2] and a < (turn := -piece[1] / (2 * piece[2])) < b:
        ends = (*ends, value(piece, turn))
    return min(ends), max(ends)


def _bernstein(piece: Polynomial, a: Fraction, b: Fraction) -> tuple[Fraction, ...]:
    """The coefficients on [a, b] in the basis of Bernstein: beta_i = sum_j C(i, j)/C(n, j) p_j, p on [0, 1]."""
    n = len(piece) - 1
    scaled = [c * (b - a) ** j for j, c in enumerate(taylor(piece, a))]
    return tuple(sum((Fraction(comb(i, j), comb(n, j)) * scaled[j] for j in range(i + 1)), ZERO) for i in range(n + 1))


# --- kinds


def _linear(x: Numbers, y: Numbers) -> list[Polynomial]:
    return [(low, rise) for low, rise in zip(y, _rises(x, y), strict=False)]


def _rises(x: Numbers, y: Numbers) -> list[Fraction]:
    """The slopes of the chords."""
    return [(d - c) / (b - a) for a, b, c, d in zip(x, x[1:], y, y[1:], strict=False)]


def _monotone(x: Numbers, y: Numbers) -> list[Polynomial]:
    """The cubic of each cell by Hermite's formula."""
    h, D = [b - a for a, b in pairwise(x)], _rises(x, y)
    d = _slopes(h, D)
    return [
        (y[k], d[k], (3 * D[k] - 2 * d[k] - d[k + 1]) / h[k], (d[k] + d[k + 1] - 2 * D[k]) / h[k] ** 2)
        for k in range(len(h))
    ]


def _slopes(h: Sequence[Fraction], D: Sequence[Fraction]) -> list[Fraction]:
    if len(h) == 1:
        return [D[0], D[0]]
    inner = [_mean(h[k], h[k + 1], D[k], D[k + 1]) for k in range(len(h) - 1)]
    return [_end(h[0], h[1], D[0], D[1]), *inner, _end(h[-1], h[-2], D[-1], D[-2])]


def _mean(h: Fraction, g: Fraction, D: Fraction, E: Fraction) -> Fraction:
    if D * E <= 0:
        return ZERO
    return 3 * (h + g) / ((2 * g + h) / D + (g + 2 * h) / E)


def _end(h: Fraction, g: Fraction, D: Fraction, E: Fraction) -> Fraction:
    slope = ((2 * h + g) * D - h * E) / (h + g)
    if slope * D <= 0:
        return ZERO
    return 3 * D if D * E <= 0 and abs(slope) > 3 * abs(D) else slope
