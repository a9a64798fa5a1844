"""The matrix exponential's weights of a core X, to a width that is known, and the integral of what a core drives.

    exp X = 1 + X phi_1,   phi_1 = 1 + X phi_2,   phi_2 = 1/2 + X/3! + X^2/4! + ..

phi_2 by its series for X/2^k of a norm of at most 1/2, in intervals; then k doublings of X,

    phi_2(2 X) = (phi_0 phi_2 + phi_1 + phi_2)/4,   phi_1(2 X) = (phi_0 phi_1 + phi_1)/2,   phi_0(2 X) = phi_0^2

The integral of s (h - s)/2 |exp(s L) V| over s from 0 to h, entry by entry: on a piece from a to b = a + w each entry
of F = exp(s L) V is beside its line by (s - a)(b - s)/2 sup|L^2 F| at most, |L^2 F(s)| <= exp(w |L|) |L^2 F(a)|; with
p = s (h - s)/2, which is concave, and m the middle of the piece

    integral of p |F| <= w/6 (p(a) + 2 p(m)) |F(a)| + w/6 (p(b) + 2 p(m)) |F(b)| + w^3/12 p(m) sup|L^2 F|
"""

import math
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise
from math import factorial
from operator import mul

from .arithmetic import total
from .box import NotShown
from .interval import Interval, between, point
from .matrix import Matrix, plus, scaled, similar, sizes, times, zeros

_TERMS = 24  # of the series
_DOUBLINGS = 40
Intervals = list[list[Interval]]


def weight(X: Matrix) -> tuple[Matrix, Fraction]:
    """A matrix, and by how much none of its elements is beside that of phi_2(X). Raises: `NotShown`."""
    return _weight(tuple(map(tuple, X)))


@lru_cache(maxsize=8)  # the inequalities of one claim share it
def _weight(X: tuple[tuple[Fraction, ...], ...]) -> tuple[Matrix, Fraction]:
    norm, k, n = max(sum(map(abs, row), Fraction(0)) for row in X), 0, len(X)
    while norm > Fraction(1, 2):
        norm, k = norm / 2, k + 1
    if k > _DOUBLINGS:
        raise NotShown("its core is too fast for its dt")
    small = [[point(x / 2**k) for x in row] for row in X]
    one = [[point(Fraction(i == j)) for j in range(n)] for i in range(n)]
    left = 2 * norm**_TERMS / factorial(_TERMS + 2)  # the terms that are left out are together below twice the first
    phi_2 = [[between(-left, left)] * n for _ in range(n)]
    power = one
    for j in range(_TERMS):
        phi_2 = _sum(phi_2, _over(factorial(j + 2), power))
        power = _product(small, power)
    phi_1 = _sum(one, _product(small, phi_2))
    phi_0 = _sum(one, _product(small, phi_1))
    for _ in range(k):
        phi_2 = _over(4, _sum(_product(phi_0, phi_2), phi_1, phi_2))
        phi_1 = _over(2, _sum(_product(phi_0, phi_1), phi_1))
        phi_0 = _product(phi_0, phi_0)
    if not all(x.finite for row in phi_2 for x in row):
        raise NotShown("its core has no exponential that intervals bound")
    ends = [[tuple(Fraction(end) for end in each.exactly) for each in row] for row in phi_2]
    middles = [[(low + high) / 2 for low, high in row] for row in ends]
    return middles, max((high - low) / 2 for row in ends for low, high in row)


def _product(a: Intervals, b: Intervals) -> Intervals:
    columns = list(zip(*b, strict=True))
    return [[total(map(mul, row, each)) for each in columns] for row in a]


def _sum(*terms: Intervals) -> Intervals:
    return [[total(each) for each in zip(*rows, strict=True)] for rows in zip(*terms, strict=True)]


def _over(divisor: int, a: Intervals) -> Intervals:
    share = point(Fraction(1, divisor))
    return [[share * x for x in row] for row in a]


# --- what a core drives

_FEW, _MANY = 16, 128  # pieces
_FINE = 16  # of them, where the core turns by 1
_ROUNDS = 8  # of a balance
_SLOW = Fraction(1, 2)  # by how much it may turn in a piece


def core_integral(L: Matrix, h: Fraction, V: Matrix) -> Matrix:
    """Of a core L (N, N) and what it drives (N, k). Raises: `NotShown` of a core that is too fast."""
    d = _balance(L)
    whole = _integral(similar(d, L), h, [[own * x for x in row] for own, row in zip(d, V, strict=True)])
    return [[x / own for x in row] for own, row in zip(d, whole, strict=True)]


def _balance(L: Matrix) -> list[Fraction]:
    """Powers of 2 by which the rows and the columns of d L d^-1 have sums that are near each other: that is slower."""
    d, each = [Fraction(1)] * len(L), range(len(L))
    for i in _ROUNDS * [*each]:
        row = sum((abs(L[i][j]) * d[i] / d[j] for j in each if j != i), Fraction(0))
        column = sum((abs(L[j][i]) * d[j] / d[i] for j in each if j != i), Fraction(0))
        if row and column:
            ratio = column / row
            d[i] *= Fraction(2) ** ((ratio.numerator.bit_length() - ratio.denominator.bit_length()) // 2)
    return d


def _integral(L: Matrix, h: Fraction, V: Matrix) -> Matrix:
    turns = h * max(sum(map(abs, row), Fraction(0)) for row in L)
    count = min(_MANY, max(_FEW, math.ceil(_FINE * turns)))
    if turns > count * _SLOW:
        raise NotShown("its core is too fast for its dt")
    places = [h * Fraction(k, count) for k in range(count + 1)]
    w, values, total = h / count, [_driven(L, s, V) for s in places], zeros(len(V), len(V[0]))
    LL = times(L, L)
    for (a, (F, off)), (b, (after, beside)) in pairwise(zip(places, values, strict=True)):
        middle, first, last = ((h - s) * s / 2 for s in ((a + b) / 2, a, b))
        bent = plus(sizes(times(LL, F)), times(sizes(LL), off))
        total = plus(
            total,
            scaled(w / 6 * (first + 2 * middle), plus(sizes(F), off)),
            scaled(w / 6 * (last + 2 * middle), plus(sizes(after), beside)),
            scaled(w**3 / 12 * middle, _grown(L, w, bent)),
        )
    return total


def _driven(L: Matrix, s: Fraction, V: Matrix) -> tuple[Matrix, Matrix]:
    """exp(s L) V = V + X V + X^2 phi_2 V, X = s L, and by how much none of its elements is beside that."""
    X = scaled(s, L)
    phi_2, width = weight(X)
    XX, XV = times(X, X), times(X, V)
    any_of_it = [[width] * len(L) for _ in L]
    return plus(V, XV, times(XX, times(phi_2, V))), times(sizes(XX), times(any_of_it, sizes(V)))


def _grown(L: Matrix, w: Fraction, V: Matrix) -> Matrix:
    """exp(w |L|) V from above, of V >= 0: what is beyond 1 + w |L| is at most q^2 of the largest of a column, as the
    sums of the rows of w |L| are at most q <= 1/2."""
    q = w * max(sum(map(abs, row), Fraction(0)) for row in L)
    most = [[q**2 * max(column) for column in zip(*V, strict=True)]] * len(V)
    return plus(V, times(scaled(w, sizes(L)), V), most)
