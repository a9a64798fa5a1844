"""How x' = A x moves over a piece of time, and what y = C x shows of it there, from the Taylor series of A and C.

    Phi' = A Phi,   W = integral Phi' C' C Phi,   in balls of whole numbers over 2^192: the middle, and how far off it

Phi and Phi' C' C Phi are series to an order N. The coefficient N + 1, taken anywhere in the piece, bounds what they
leave (Lagrange): its entries are at most those of the series of norms, the largest sums of a row or column, of A and C
on the whole piece, from |Phi| <= exp(length |A|).
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from typing import TypeVar

from .box import NotShown
from .interval import Interval, intervals, point

ORDER = 9  # N
_BITS = 192
_ONE = 1 << _BITS
Value = TypeVar("Value")


@dataclass(frozen=True)
class Balls:
    """A matrix: its middle, and by how much each entry may be off it, over 2^192."""

    mid: list[list[int]]
    off: list[list[int]]

    def __add__(self, other: "Balls") -> "Balls":
        return Balls(_sum(self.mid, other.mid), _sum(self.off, other.off))

    def __matmul__(self, other: "Balls") -> "Balls":
        columns = list(zip(zip(*other.mid, strict=True), zip(*other.off, strict=True), strict=True))
        pairs = [[_dot(m, r, *column) for column in columns] for m, r in zip(self.mid, self.off, strict=True)]
        return Balls([[m for m, _ in row] for row in pairs], [[r for _, r in row] for row in pairs])

    @property
    def turned(self) -> "Balls":
        """The transposed."""
        return Balls(*([list(column) for column in zip(*rows, strict=True)] for rows in (self.mid, self.off)))

    def times(self, share: Fraction) -> "Balls":
        """The matrix times a number above 0."""
        p, q = share.numerator, share.denominator
        return Balls(_each(self.mid, lambda x: x * p // q), _each(self.off, lambda x: x * p // q + 2))

    @property
    def norm(self) -> int:
        """The largest sum of sizes of a row, or of a column, from above."""
        sizes = [[abs(m) + r for m, r in zip(*rows, strict=True)] for rows in zip(self.mid, self.off, strict=True)]
        return max(map(sum, chain(sizes, zip(*sizes, strict=True))))

    @property
    def fractions(self) -> tuple[list[list[Fraction]], Fraction]:
        """The symmetric middle, and the largest sum by which a row may be off it."""
        n = range(len(self.mid))
        even = [[Fraction(self.mid[i][j] + self.mid[j][i], 2 * _ONE) for j in n] for i in n]
        return even, max(Fraction(sum(self.off[i][j] + self.off[j][i] for j in n), 2 * _ONE) for i in n)


def _sum(a: list[list[int]], b: list[list[int]]) -> list[list[int]]:
    return [[x + y for x, y in zip(*rows, strict=True)] for rows in zip(a, b, strict=True)]


def _each(rows: Iterable[Iterable[Value]], what: Callable[[Value], int]) -> list[list[int]]:
    return [[what(value) for value in row] for row in rows]


def _dot(m: Sequence[int], r: Sequence[int], n: Sequence[int], s: Sequence[int]) -> tuple[int, int]:
    middle = sum(map(int.__mul__, m, n))
    away = sum(abs(a) * d + b * (abs(c) + d) for a, b, c, d in zip(m, r, n, s, strict=True))
    return middle >> _BITS, (away >> _BITS) + 2


def balls(rows: Sequence[Sequence[Interval]]) -> Balls:
    """A matrix of intervals. Raises: `NotShown` for one that is not finite."""
    ends = [[_whole(x) for x in row] for row in rows]
    mid = _each(ends, lambda pair: (pair[0] + pair[1]) >> 1)
    return Balls(mid, _each(ends, lambda pair: ((pair[1] - pair[0]) >> 1) + 1))


def _whole(x: Interval) -> tuple[int, int]:
    if not x.finite:
        raise NotShown("A or C is not finite along the course")
    low, high = (Fraction(end) for end in x.exactly)
    return low.numerator * _ONE // low.denominator, -(-high.numerator * _ONE // high.denominator)


@dataclass(frozen=True)
class Shown:
    """Of a time: the transition over it, and what is shown in it."""

    Phi: Balls
    W: Balls

    def then(self, after: "Shown") -> "Shown":
        """Of this time and the one after it together."""
        return Shown(after.Phi @ self.Phi, self.W + self.Phi.turned @ after.W @ self.Phi)


Series = Sequence[Balls]


def piece(A: Series, C: Series, around: tuple[Series, Series], length: Fraction) -> Shown:
    """Of a piece, from the coefficients below N + 1 of A and C at its begin, and those below N + 2 `around`, on all of
    it."""
    n, p = len(A[0].mid), len(C[0].mid)
    unit = [[_ONE * (i == j) for j in range(n)] for i in range(n)]
    Phi = [Balls(unit, [[0] * n for _ in range(n)])]
    for k in range(ORDER):
        Phi.append(_coefficient(A, Phi, k).times(Fraction(1, k + 1)))
    V = [_coefficient(C, Phi, k) for k in range(ORDER + 1)]
    rates = [_coefficient([v.turned for v in V], V, k) for k in range(ORDER + 1)]
    rest, lost = _rest(around, p, length)
    end, shown = _off(n, rest) + Phi[0], _off(n, lost)
    for k in range(1, ORDER + 1):
        end += Phi[k].times(length**k)
    for k in range(ORDER + 1):
        shown += rates[k].times(length ** (k + 1) / (k + 1))
    return Shown(end, shown)


def _rest(around: tuple[Series, Series], p: int, length: Fraction) -> tuple[int, int]:
    a, c = ([one.norm for one in series] for series in around)
    grown = intervals.function("exp", (point(Fraction(a[0], _ONE) * length),))
    phi = [_whole(grown)[1]]
    for k in range(ORDER + 1):
        phi.append(-(-_above(a, phi, k) // (k + 1)))
    v = [_above(c, phi, k) for k in range(ORDER + 2)]
    h, N = length, ORDER + 1
    return _up(phi[N], h**N), _up(p * _above(v, v, N), h ** (N + 1) / (N + 1))


def _up(value: int, share: Fraction) -> int:
    return -(-value * share.numerator // share.denominator)


def _above(a: Sequence[int], b: Sequence[int], k: int) -> int:
    """The coefficient k of a b, from above."""
    return (sum(a[i] * b[k - i] for i in range(k + 1)) >> _BITS) + 1


def _coefficient(a: Series, b: Series, k: int) -> Balls:
    """The coefficient k of a b: those of a beside each other times those of b below each other, in one product."""
    first, last = a[: k + 1], b[k::-1]
    wide = ([list(chain(*rows)) for rows in zip(*each, strict=True)] for each in _parts(first))
    return Balls(*wide) @ Balls(*([*chain(*each)] for each in _parts(last)))


def _parts(series: Series) -> Iterator[tuple[list[list[int]], ...]]:
    return zip(*((one.mid, one.off) for one in series), strict=True)


def _off(n: int, size: int) -> Balls:
    return Balls([[0] * n for _ in range(n)], [[size] * n for _ in range(n)])
