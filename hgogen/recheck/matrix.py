"""Matrices of fractions, and their signs by elimination: exact."""

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from functools import reduce
from math import lcm
from operator import add, mul

from .box import NotShown

Matrix = list[list[Fraction]]
_ZERO = Fraction(0)  # as most entries are


def demand_enough(name: str, sizes: Iterable[Fraction], least: Iterable[Fraction]) -> None:
    """That the sizes of something are at least these. Raises: `NotShown`."""
    if any(size < few for size, few in zip(sizes, least, strict=True)):
        raise NotShown(f"a size of {name} is less than what it follows from")


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
    """M^-1 by elimination. Raises: `NotShown` of a singular one."""
    size = len(M)
    rows = [[*row, *one] for row, one in zip(M, unit(size), strict=True)]
    for k in range(size):
        pivot = next((i for i in range(k, size) if rows[i][k]), None)
        if pivot is None:
            raise NotShown("a matrix is singular")
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
    """That these symmetric matrices are positive definite. Raises: `NotShown`."""
    _demand(matrices, True)


def demand_nonnegative(matrices: Mapping[str, Matrix]) -> None:
    """That these symmetric matrices have no negative eigenvalue. Raises: `NotShown`."""
    _demand(matrices, False)


def _demand(matrices: Mapping[str, Matrix], strictly: bool) -> None:
    for name, M in matrices.items():
        if transposed(M) != M:
            raise NotShown(f"its {name} is not symmetric")
        if not _nonnegative(M, strictly):
            raise NotShown(f"its {name} is not positive {'' if strictly else 'semi'}definite")


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
