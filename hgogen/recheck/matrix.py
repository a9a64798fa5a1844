"""Matrices of fractions, and their signs by elimination: exact.

The matrix exponential's weights of a core X, to a width that is known, and the integral of what a core drives.

    exp X = 1 + X phi_1,   phi_1 = 1 + X phi_2,   phi_2 = 1/2 + X/3! + X^2/4! + ..

phi_2 by its series for X/2^k of a norm of at most 1/2, in intervals; then k doublings of X,

    phi_2(2 X) = (phi_0 phi_2 + phi_1 + phi_2)/4,   phi_1(2 X) = (phi_0 phi_1 + phi_1)/2,   phi_0(2 X) = phi_0^2

The integral of s (h - s)/2 |exp(s L) V| over s from 0 to h, entry by entry: on a piece from a to b = a + w each entry
of F = exp(s L) V is beside its line by (s - a)(b - s)/2 sup|L^2 F| at most, |L^2 F(s)| <= exp(w |L|) |L^2 F(a)|; with
p = s (h - s)/2, which is concave, and m the middle of the piece

    integral of p |F| <= w/6 (p(a) + 2 p(m)) |F(a)| + w/6 (p(b) + 2 p(m)) |F(b)| + w^3/12 p(m) sup|L^2 F|
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from functools import lru_cache, reduce
from itertools import pairwise
from math import factorial, lcm
from operator import add, mul

from .arithmetic import Unproved, total
from .interval import Interval, between, point

Matrix = list[list[Fraction]]
_ZERO = Fraction(0)  # as most entries are


def demand_enough(name: str, sizes: Iterable[Fraction], least: Iterable[Fraction]) -> None:
    """That the sizes of something are at least these. Raises: `Unproved`."""
    if any(size < few for size, few in zip(sizes, least, strict=True)):
        raise Unproved(f"a size of {name} is less than what it follows from")


def dot(a: Iterable[Fraction], b: Iterable[Fraction]) -> Fraction:
    """The sum of products."""
    return sum((x * y for x, y in zip(a, b, strict=True)), _ZERO)


def unit(n: int) -> Matrix:
    """The unit matrix (n, n)."""
    return [[Fraction(int(i == j)) for j in range(n)] for i in range(n)]


def zeros(rows: int, columns: int) -> Matrix:
    """A matrix of zeros."""
    return [[Fraction(0)] * columns for _ in range(rows)]


def scaled(factor: Fraction, M: Matrix) -> Matrix:
    """factor M."""
    return [[factor * value if value else _ZERO for value in row] for row in M]


def plus(*terms: Matrix) -> Matrix:
    """The sum."""
    return [[_sum(values) for values in zip(*rows, strict=True)] for rows in zip(*terms, strict=True)]


def _sum(values: Sequence[Fraction]) -> Fraction:
    """What is 0, as most entries are, costs nothing."""
    there = [value for value in values if value]
    return reduce(add, there) if there else _ZERO


def minus(first: Matrix, *others: Matrix) -> Matrix:
    """The first less the others."""
    return plus(first, *(scaled(Fraction(-1), other) for other in others))


def sizes(M: Matrix) -> Matrix:
    """|m_ij|."""
    return [[abs(value) for value in row] for row in M]


def times(A: Matrix, B: Matrix) -> Matrix:
    """A B, each row and column of whole numbers over one denominator: each entry is brought to lowest terms once."""
    rows, columns = list(map(_whole, A)), list(map(_whole, transposed(B)))
    if len({len(values) for values, _ in (*rows, *columns)}) > 1 and columns:
        raise ValueError("matrices that do not fit")  # which `map` below would not see
    return [[Fraction(sum_, p * q) if (sum_ := sum(map(mul, a, b))) else _ZERO for b, q in columns] for a, p in rows]


def _whole(values: Sequence[Fraction]) -> tuple[list[int], int]:
    """Numbers times their least common denominator, and that."""
    common = lcm(*(value.denominator for value in values))
    return [value.numerator * (common // value.denominator) for value in values], common


def outer(column: list[Fraction], row: list[Fraction]) -> Matrix:
    """A column times a row."""
    return [[x * y for y in row] for x in column]


def transposed(M: Matrix) -> Matrix:
    """M'."""
    return [list(column) for column in zip(*M, strict=True)]


def inverse(M: Matrix) -> Matrix:
    """M^-1 by elimination. Raises: `Unproved` of a singular one."""
    size = len(M)
    rows = [[*row, *one] for row, one in zip(M, unit(size), strict=True)]
    for k in range(size):
        pivot = next((i for i in range(k, size) if rows[i][k]), None)
        if pivot is None:
            raise Unproved("a matrix is singular")
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [x / rows[k][k] for x in rows[k]]
        for i in range(size):
            if i != k:
                factor = rows[i][k]
                rows[i] = [x - factor * y for x, y in zip(rows[i], rows[k], strict=True)]
    return [row[size:] for row in rows]


def twice(P: Matrix, N: Matrix) -> Matrix:
    """N'P + P N of a symmetric P."""
    PN = times(P, N)
    return plus(PN, transposed(PN))


def similar(t: Sequence[Fraction], N: Matrix) -> Matrix:
    """T N T^-1, T the diagonal t."""
    return [[t[i] * value / t[j] for j, value in enumerate(row)] for i, row in enumerate(N)]


def companion(K: Sequence[Fraction]) -> Matrix:
    """A - K C (n, n) of a chain of integrators."""
    return [[Fraction(int(j == i + 1)) - (k if j == 0 else 0) for j in range(len(K))] for i, k in enumerate(K)]


def demand_positive(matrices: Mapping[str, Matrix]) -> None:
    """That these symmetric matrices are positive definite. Raises: `Unproved`."""
    _demand(matrices, True)


def demand_nonnegative(matrices: Mapping[str, Matrix]) -> None:
    """That these symmetric matrices have no negative eigenvalue. Raises: `Unproved`."""
    _demand(matrices, False)


def _demand(matrices: Mapping[str, Matrix], strictly: bool) -> None:
    for name, M in matrices.items():
        if transposed(M) != M:
            raise Unproved(f"its {name} is not symmetric")
        if not _nonnegative(M, strictly):
            raise Unproved(f"its {name} is not positive {'' if strictly else 'semi'}definite")


def _nonnegative(M: Matrix, strictly: bool) -> bool:
    """Whether a symmetric matrix has no negative eigenvalue, `strictly` none of zero, by the pivots of its elimination:
    a pivot of zero wants a row of zeros."""
    M = [list(row) for row in M]
    for k, row in enumerate(M):
        if row[k] < 0 or (row[k] == 0 and (strictly or any(row[k:]))):
            return False
        if row[k] == 0:
            continue
        for i in range(k + 1, len(M)):
            factor = M[i][k] / row[k]
            M[i] = [x - factor * y for x, y in zip(M[i], row, strict=True)]
    return True


def decaying(N: Matrix, P: Matrix) -> Matrix:
    """-I - N'P - P N, which is positive definite where P shows N to decay."""
    return minus(scaled(Fraction(-1), unit(len(N))), twice(P, N))


# ---

_TERMS = 24  # of the series
_DOUBLINGS = 40
Intervals = list[list[Interval]]


def weight(X: Matrix) -> tuple[Matrix, Fraction]:
    """A matrix, and by how much none of its elements is beside that of phi_2(X). Raises: `Unproved`."""
    return _weight(tuple(map(tuple, X)))


@lru_cache(maxsize=8)  # the inequalities of one claim share it
def _weight(X: tuple[tuple[Fraction, ...], ...]) -> tuple[Matrix, Fraction]:
    norm, k, n = max(sum(map(abs, row), Fraction(0)) for row in X), 0, len(X)
    while norm > Fraction(1, 2):
        norm, k = norm / 2, k + 1
    if k > _DOUBLINGS:
        raise Unproved("its core is too fast for its dt")
    small = [[point(x / 2**k) for x in row] for row in X]
    one = [[point(Fraction(i == j)) for j in range(n)] for i in range(n)]
    left = 2 * norm**_TERMS / factorial(_TERMS + 2)  # the terms that are left out are together below twice the first
    phi_2 = [[between(-left, left)] * n for _ in range(n)]
    power = one
    for j in range(_TERMS):
        phi_2 = _plus(phi_2, _over(factorial(j + 2), power))
        power = _product(small, power)
    phi_1 = _plus(one, _product(small, phi_2))
    phi_0 = _plus(one, _product(small, phi_1))
    for _ in range(k):
        phi_2 = _over(4, _plus(_product(phi_0, phi_2), phi_1, phi_2))
        phi_1 = _over(2, _plus(_product(phi_0, phi_1), phi_1))
        phi_0 = _product(phi_0, phi_0)
    if not all(x.finite for row in phi_2 for x in row):
        raise Unproved("its core has no exponential that intervals bound")
    ends = [[tuple(Fraction(end) for end in each.exactly) for each in row] for row in phi_2]
    middles = [[(low + high) / 2 for low, high in row] for row in ends]
    return middles, max((high - low) / 2 for row in ends for low, high in row)


def _product(a: Intervals, b: Intervals) -> Intervals:
    columns = list(zip(*b, strict=True))
    return [[total(map(mul, row, each)) for each in columns] for row in a]


def _plus(*terms: Intervals) -> Intervals:
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
    """Of a core L (N, N) and what it drives (N, k). Raises: `Unproved` of a core that is too fast."""
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
        raise Unproved("its core is too fast for its dt")
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
