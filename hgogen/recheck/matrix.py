"""Exact matrices of fractions, with definiteness by elimination.

The weights of the matrix exponential of a core X, with an error bound, and the integral of a driven core.

    exp X = 1 + X phi_1,   phi_1 = 1 + X phi_2,   phi_2 = 1/2 + X/3! + X^2/4! + ..

phi_2 is computed by its series for X/2^k of a norm of at most 1/2, in intervals; then by k doublings of X,

    phi_2(2 X) = (phi_0 phi_2 + phi_1 + phi_2)/4,   phi_1(2 X) = (phi_0 phi_1 + phi_1)/2,   phi_0(2 X) = phi_0^2

The integral of s (h - s)/2 |exp(s L) V| over s from 0 to h, entry by entry: on a piece from a to b = a + w each entry
of F = exp(s L) V differs from its chord by at most (s - a)(b - s)/2 sup|L^2 F|, |L^2 F(s)| <= exp(w |L|) |L^2 F(a)|;
with p = s (h - s)/2, which is concave, and m the middle of the piece

    integral of p |F| <= w/6 (p(a) + 2 p(m)) |F(a)| + w/6 (p(b) + 2 p(m)) |F(b)| + w^3/12 p(m) sup|L^2 F|
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise
from math import factorial, lcm
from operator import mul
from typing import Any

from .arithmetic import Unproved, total
from .interval import between, point

_ZERO = Fraction(0)


class Matrix:
    """A matrix whose entries are numbers of one kind; `width`: the number of columns, also of a matrix without rows."""

    def __init__(self, rows: Iterable[Iterable[Any]], width: int | None = None) -> None:
        self.rows = [list(row) for row in rows]
        self.width = len(self.rows[0]) if width is None and self.rows else width or 0

    def __iter__(self) -> Iterator[list[Any]]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, row: int) -> list[Any]:
        return self.rows[row]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Matrix | list) and self.rows == [*other]

    def __hash__(self) -> int:
        return hash(tuple(map(tuple, self.rows)))

    def __add__(self, other: "Matrix") -> "Matrix":
        rows = zip(self.rows, other.rows, strict=True)  # skip zeros, which most entries are
        return Matrix([[x + y if x and y else x or y for x, y in zip(*row, strict=True)] for row in rows], self.width)

    def __sub__(self, other: "Matrix") -> "Matrix":
        return self + -1 * other

    def __rmul__(self, factor: Fraction | int) -> "Matrix":
        return self.mapped(lambda x: factor * x if x else x)

    def __matmul__(self, other: "Matrix") -> "Matrix":
        """Return the matrix product. Rows and columns of fractions are put over one denominator, so that each entry is
        reduced once only."""
        if self.width != len(other):
            raise ValueError("matrices that do not fit")
        rows, columns = self.rows, other.T.rows
        if isinstance(next((x for row in (*rows, *columns) for x in row), _ZERO), Fraction):
            whole, others = map(_whole, rows), list(map(_whole, columns))
            products = [[(sum(map(mul, a, b)), p * q) for b, q in others] for a, p in whole]
            return Matrix([[Fraction(*x) if x[0] else _ZERO for x in row] for row in products], other.width)
        return Matrix([[total(map(mul, row, column)) for column in columns] for row in rows], other.width)

    def __abs__(self) -> "Matrix":
        return self.mapped(abs)

    @property
    def T(self) -> "Matrix":
        """The transpose."""
        return Matrix([[row[j] for row in self.rows] for j in range(self.width)], len(self.rows))

    def mapped(self, function: Callable[[Any], Any]) -> "Matrix":
        """Return the matrix with a function applied to each entry."""
        return Matrix([[function(x) for x in row] for row in self.rows], self.width)

    def weighed(self, weights: Iterable[Any]) -> "Matrix":
        """Return diag(weights) M, whose row i is weights_i times row i of M."""
        pairs = zip(weights, self.rows, strict=True)
        return Matrix([[weight * x for x in row] for weight, row in pairs], self.width)

    def applied(self, x: Sequence[Fraction]) -> list[Fraction]:
        """Return the product M x with a vector."""
        return [dot(row, x) for row in self.rows]


def _whole(values: Sequence[Fraction]) -> tuple[list[int], int]:
    common = lcm(*(value.denominator for value in values))
    return [value.numerator * (common // value.denominator) for value in values], common


def dot(a: Iterable[Fraction], b: Iterable[Fraction]) -> Fraction:
    """Return the inner product sum_k a_k b_k."""
    return sum((x * y for x, y in zip(a, b, strict=True)), _ZERO)


def unit(n: int) -> Matrix:
    """Return the unit matrix (n, n)."""
    return Matrix([unit_row(k, n) for k in range(n)])


def unit_row(k: int, count: int) -> list[Fraction]:
    """Return row k of the unit matrix (count, count)."""
    return [Fraction(int(k == at)) for at in range(count)]


def zeros(rows: int, columns: int) -> Matrix:
    """Return a matrix of zeros."""
    return Matrix([[_ZERO] * columns for _ in range(rows)], columns)


def column_matrix(values: Iterable[Fraction]) -> Matrix:
    """Return a matrix with one column."""
    return Matrix([[value] for value in values], 1)


def outer(column: Iterable[Fraction], row: Sequence[Fraction]) -> Matrix:
    """Return the outer product column row', a matrix of rank one."""
    return Matrix([[x * y for y in row] for x in column], len(row))


def row_sum_norm(M: Matrix) -> Fraction:
    """Return the norm max_i sum_j |m_ij| of a matrix."""
    return max((sum(map(abs, row), _ZERO) for row in M), default=_ZERO)


def inverse(M: Matrix) -> Matrix:
    """Return the inverse of a matrix, by elimination. Raises: `Unproved` for a singular matrix."""
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
    return Matrix([row[size:] for row in rows])


def lyapunov(P: Matrix, N: Matrix) -> Matrix:
    """Return N'P + P N for a symmetric P."""
    PN = P @ N
    return PN + PN.T


def similar(t: Sequence[Fraction], N: Matrix) -> Matrix:
    """Return T N T^-1 for T = diag(t)."""
    return Matrix([[t[i] * value / t[j] for j, value in enumerate(row)] for i, row in enumerate(N)])


def companion(K: Sequence[Fraction]) -> Matrix:
    """Return A - K C (n, n) for the chain of integrators w_i' = w_(i+1), y = w_1 and the gain K (n)."""
    return Matrix([[Fraction(int(j == i + 1)) - (k if j == 0 else 0) for j in range(len(K))] for i, k in enumerate(K)])


def demand_positive(matrices: Mapping[str, Matrix], strictly: bool = True) -> None:
    """Demand that symmetric matrices, given by their names for the error, are positive definite, or semidefinite if not
    `strictly`. Raises: `Unproved`."""
    for name, M in matrices.items():
        if M.T != M:
            raise Unproved(f"its {name} is not symmetric")
        if not _is_positive(M, strictly):
            raise Unproved(f"its {name} is not positive {'' if strictly else 'semi'}definite")


def demand_nonnegative(matrices: Mapping[str, Matrix]) -> None:
    """Demand that symmetric matrices, given by their names for the error, are positive semidefinite. Raises:
    `Unproved`."""
    demand_positive(matrices, strictly=False)


def _is_positive(M: Matrix, strictly: bool) -> bool:
    """Return whether a symmetric matrix is positive definite (`strictly`) or semidefinite, by the pivots of exact
    elimination; for a zero pivot its whole row must be 0."""
    rows = [list(row) for row in M]
    for k, row in enumerate(rows):
        if row[k] < 0 or (row[k] == 0 and (strictly or any(row[k:]))):
            return False
        if row[k] == 0:
            continue
        for i in range(k + 1, len(rows)):
            factor = rows[i][k] / row[k]
            rows[i] = [x - factor * y for x, y in zip(rows[i], row, strict=True)]
    return True


def decaying(N: Matrix, P: Matrix) -> Matrix:
    """Return -I - N'P - P N: if this and P are positive definite, N is Hurwitz."""
    return -1 * unit(len(N)) - lyapunov(P, N)


def demand_at_least(name: str, sizes: Iterable[Fraction], least: Iterable[Fraction]) -> None:
    """Demand sizes_i >= least_i for all i; `name`: the subject of the sizes in the error. Raises: `Unproved`."""
    if any(size < few for size, few in zip(sizes, least, strict=True)):
        raise Unproved(f"a size of {name} is less than what it follows from")


# --- the matrix exponential

_TERMS = 24  # of the series
_DOUBLINGS = 40


@lru_cache(maxsize=8)  # the inequalities of one claim share it
def weight(X: Matrix) -> tuple[Matrix, Fraction]:
    """Return an approximation (n, n) of phi_2(X) = 1/2 + X/3! + X^2/4! + .., and a bound of the error of its entries.
    Raises: `Unproved`."""
    norm, k, n = row_sum_norm(X), 0, len(X)
    while norm > Fraction(1, 2):
        norm, k = norm / 2, k + 1
    if k > _DOUBLINGS:
        raise Unproved("its core is too fast for its dt")
    small, one = X.mapped(lambda x: point(x / 2**k)), unit(n).mapped(point)
    tail = 2 * norm**_TERMS / factorial(_TERMS + 2)  # the omitted terms are together below twice the first
    phi_2, power = Matrix([[between(-tail, tail)] * n for _ in range(n)]), one
    for j in range(_TERMS):
        phi_2 = phi_2 + _over(factorial(j + 2), power)
        power = small @ power
    phi_1 = one + small @ phi_2
    phi_0 = one + small @ phi_1
    for _ in range(k):
        phi_2 = _over(4, phi_0 @ phi_2 + phi_1 + phi_2)
        phi_1 = _over(2, phi_0 @ phi_1 + phi_1)
        phi_0 = phi_0 @ phi_0
    if not all(x.finite for row in phi_2 for x in row):
        raise Unproved("its core has no exponential that intervals bound")
    low, high = phi_2.mapped(lambda x: Fraction(x.exactly[0])), phi_2.mapped(lambda x: Fraction(x.exactly[1]))
    return Fraction(1, 2) * (low + high), max(map(max, Fraction(1, 2) * (high - low)))


def _over(divisor: int, a: Matrix) -> Matrix:
    share = point(Fraction(1, divisor))
    return a.mapped(lambda x: share * x)


_FEW, _MANY = 16, 128  # pieces of an integral
_FINE = 16  # pieces for h |L| = 1
_ROUNDS = 8  # of balancing
_SLOW = Fraction(1, 2)  # largest norm of w L in a piece


def core_integral(L: Matrix, h: Fraction, V: Matrix) -> Matrix:
    """Return an entrywise upper bound (N, k) of the integral over s from 0 to h of s (h - s)/2 |exp(s L) V|, for L (N,
    N), V (N, k). Raises: `Unproved` for an L that is too fast.

    L is first balanced by powers of 2, which makes sums of rows and columns similar and reduces the norm.
    """
    d, each = [Fraction(1)] * len(L), range(len(L))
    for i in _ROUNDS * [*each]:
        row = sum((abs(L[i][j]) * d[i] / d[j] for j in each if j != i), _ZERO)
        column = sum((abs(L[j][i]) * d[j] / d[i] for j in each if j != i), _ZERO)
        if row and column:
            ratio = column / row
            d[i] *= Fraction(2) ** ((ratio.numerator.bit_length() - ratio.denominator.bit_length()) // 2)
    return _integral(similar(d, L), h, V.weighed(d)).weighed(1 / x for x in d)


def _integral(L: Matrix, h: Fraction, V: Matrix) -> Matrix:
    turns = h * row_sum_norm(L)
    count = min(_MANY, max(_FEW, math.ceil(_FINE * turns)))
    if turns > count * _SLOW:
        raise Unproved("its core is too fast for its dt")
    places = [h * Fraction(k, count) for k in range(count + 1)]
    w, values, total = h / count, [_driven(L, s, V) for s in places], zeros(len(V), V.width)
    LL, wL, q = L @ L, w * abs(L), w * row_sum_norm(L)
    for (a, (F, off)), (b, (after, off_after)) in pairwise(zip(places, values, strict=True)):
        middle, first, last = ((h - s) * s / 2 for s in ((a + b) / 2, a, b))
        second = abs(LL @ F) + abs(LL) @ off
        # exp(w |L|) from above: beyond 1 + w |L| it is at most q^2 of the largest of a column, as q <= 1/2
        most = Matrix([[q**2 * max(column) for column in second.T]] * len(V))
        total += w / 6 * (first + 2 * middle) * (abs(F) + off) + w / 6 * (last + 2 * middle) * (abs(after) + off_after)
        total += w**3 / 12 * middle * (second + wL @ second + most)
    return total


def _driven(L: Matrix, s: Fraction, V: Matrix) -> tuple[Matrix, Matrix]:
    """Return exp(s L) V = V + X V + X^2 phi_2(X) V with X = s L, and a bound of the error of its entries."""
    X = s * L
    phi_2, width = weight(X)
    any_of_it = Matrix([[width] * len(L) for _ in L])
    return V + X @ V + X @ X @ (phi_2 @ V), abs(X @ X) @ (any_of_it @ abs(V))
