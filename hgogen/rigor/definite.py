"""Signs of eigenvalues in exact arithmetic: of symmetric rational matrices, and whether a matrix is Hurwitz.

All eigenvalues of a symmetric M are real, and det(x I + M) = sum_k e_k x^(n-k) with e_k the elementary symmetric
functions of them. So M >= 0 if and only if every e_k >= 0, and M > 0 if and only if every e_k > 0 (FLINT's
characteristic polynomial; Horn, Johnson, "Matrix Analysis", 7.1 and 7.2). A matrix of doubles, which are rationals, is
Hurwitz by Routh's array of its characteristic polynomial (E. J. Routh 1877; Gantmacher, "The Theory of Matrices", XV).
For a symmetric matrix of balls a sign is known where it is that of every matrix within the balls.

NumPy's linear algebra runs on one thread (`one_thread`): for tens of rows the threads of BLAS wait longer than they
compute, and their sums depend on the number of threads.
"""

from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from itertools import combinations
from math import isqrt
from typing import Any

import numpy as np
from flint import arb, arb_mat, fmpq, fmpq_mat, fmpz_mat
from threadpoolctl import ThreadpoolController

from hgogen.errors import HgogenError

Matrix = tuple[tuple[Fraction, ...], ...]

_CLOSE = Fraction(1, 2**40)  # first radius of the enclosure of a float eigenvalue, as a share of the largest entry


def exact(M: Iterable[Iterable[Fraction]]) -> Any:
    """Return a matrix of fractions as a FLINT matrix of rationals."""
    return fmpq_mat([[number(value) for value in row] for row in M])


def rationals(M: np.ndarray) -> Matrix:
    """Return a matrix of floats as a matrix of the equal fractions."""
    return tuple(tuple(map(Fraction, row)) for row in M.tolist())


def root(value: Fraction, bits: int = 24) -> Fraction:
    """Return a short rational r with sqrt(value) <= r <= (1 + 2^-bits) sqrt(value), up to rounding of the factor."""
    if not value:
        return value
    shift = 2 * max(0, bits - (value.numerator.bit_length() - value.denominator.bit_length()) // 2)
    whole = -(-(value.numerator << shift) // value.denominator)
    return Fraction(isqrt(whole - 1) + 1, 1 << (shift // 2))


def number(value: Any) -> Any:
    """Return a fraction, float or whole number as the equal FLINT rational."""
    if isinstance(value, fmpq):
        return value
    return fmpq(*value.as_integer_ratio()) if isinstance(value, float) else fmpq(value.numerator, value.denominator)


def fraction(value: Any) -> Fraction:
    """Return a FLINT rational as a fraction."""
    return Fraction(int(value.p), int(value.q))


def floats(M: Any) -> np.ndarray:
    """Return a FLINT matrix of rationals as an array of floats."""
    return np.array([[float(fraction(M[i, j])) for j in range(M.ncols())] for i in range(M.nrows())])


def unit(n: int) -> Any:
    """Return the unit matrix (n, n) of FLINT."""
    return fmpq_mat([[fmpq(int(i == j)) for j in range(n)] for i in range(n)])


def positive(M: Any) -> bool:
    """Return whether a symmetric FLINT matrix is positive definite; both answers are proved. It tries a congruence R M
    R' that is nearly the unit matrix, then the leading minors, the pivots of a fraction-free elimination without row
    exchanges."""
    whole, _ = M.numer_denom()
    if _near_unit(whole):
        return True
    order, _, _, pivots = whole.fflu()
    return bool(order.is_one()) and all(pivots[k, k] > 0 for k in range(pivots.nrows()))


def _near_unit(M: Any) -> bool:
    """Return whether R M R' is diagonally dominant, and so R M R' and M are positive definite (Gershgorin). R
    approximates the inverse of a Cholesky factor of M; the entries of M may be error balls, the answer then holds for
    every M within them."""
    rows = [[arb(value).mid() for value in row] for row in M.tolist()]
    try:
        diagonal = [row[k].man_exp() for k, row in enumerate(rows)]
        units = [int(mantissa.bit_length() + exponent) // 2 for mantissa, exponent in diagonal]
        over = [arb(2) ** -j for j in units]
        scaled = [[float(x * i * j) for x, j in zip(row, over, strict=True)] for row, i in zip(rows, over, strict=True)]
        inverse = np.linalg.inv(np.linalg.cholesky(scaled)).tolist()
        R = fmpz_mat([[int(x * 2**40) << max(units) - j for x, j in zip(row, units, strict=True)] for row in inverse])
    except (ValueError, OverflowError):  # not finite, without a factor, or beyond a float
        return False
    congruent = (R * M * R.transpose()).tolist()
    return all(2 * row[k] > sum(map(abs, row)) for k, row in enumerate(congruent))


def definite(M: np.ndarray) -> bool:
    """Return whether a symmetric matrix M is positive definite. For FLINT rationals both answers are proved; for FLINT
    balls True proves it for every matrix within them. It tries a congruence to nearly the unit matrix, which does not
    widen wide balls, then the signs of the pivots, which need no floats for narrow balls."""
    if not any(isinstance(value, arb) for value in M.flat):
        return positive(fmpq_mat(M.tolist()))
    if _near_unit(arb_mat(M.tolist())):
        return True
    remaining = M.copy()
    for k in range(len(M)):
        if not remaining[k, k] > 0:
            return False
        after = slice(k + 1, None)
        outer = np.outer(remaining[after, k], remaining[k, after])
        remaining[after, after] = remaining[after, after] - outer / remaining[k, k]
    return True


def nonnegative(M: Any) -> bool:
    """Return whether a symmetric FLINT matrix is positive semidefinite; both answers are proved."""
    elementary = (-M).charpoly().coeffs()[-2::-1]  # of det(x I + M) = (-1)^n det(-x I - M), after the first
    return all(value >= 0 for value in elementary)


def smallest(M: Any) -> tuple[Fraction, Fraction]:
    """Return proved bounds low <= lambda < high of the smallest eigenvalue lambda of a symmetric FLINT matrix; low > 0
    where the matrix is positive definite.

    low is the eigenvalue in floats, rounded to nine digits, if this is a proved lower bound: 2 for an eigenvalue 2.
    Else both bounds start at 2^-40 of the largest entry from the float, and move outward until they are proved.
    """
    values = floats(M)
    eigenvalue, slack = float(np.linalg.eigvalsh(values).min()), _CLOSE * Fraction(float(np.abs(values).max()) or 1.0)
    one, middle, low = unit(M.nrows()), Fraction(eigenvalue), Fraction(f"{eigenvalue:.9g}")
    high, below, above = middle + slack, slack, slack
    while not nonnegative(M - one * number(low)):
        low, below = middle - below, 4 * below
    while nonnegative(M - one * number(high)):
        above *= 4
        high = middle + above
    if low <= 0 and positive(M):
        low = high / 2
        while not nonnegative(M - one * number(low)):
            low /= 16
    return low, high


def largest(M: Any) -> tuple[Fraction, Fraction]:
    """Return proved bounds low < lambda <= high of the largest eigenvalue lambda of a symmetric FLINT matrix."""
    low, high = smallest(-M)
    return -high, -low


# --- symmetric up to rounding

_ROUNDING = Fraction(1, 10**12)


def symmetric(M: Sequence[Sequence[Fraction]]) -> tuple[tuple[Fraction, ...], ...] | None:
    """Return (M + M')/2 in exact fractions for a matrix M (n, n) that is symmetric up to solver rounding, else None:
    |M_ij - M_ji| <= 1e-12 max(|M_ij|, |M_ji|, sqrt|M_ii M_jj|) for all i, j. Both sides scale alike with the units of
    the coordinates, so that small entries count, too."""
    n = range(len(M))
    for i, j in combinations(n, 2):
        size = max(M[i][j] ** 2, M[j][i] ** 2, abs(M[i][i] * M[j][j]))
        if (M[i][j] - M[j][i]) ** 2 > _ROUNDING**2 * size:
            return None
    return tuple(tuple((M[i][j] + M[j][i]) / 2 for j in n) for i in n)


def unsymmetric(name: str) -> str:
    """Return the message that the matrix `name` must be symmetric, with the symmetric matrix to give instead."""
    return f"must be symmetric, to 1e-12 of its numbers; give ({name} + {name}')/2"


# --- Hurwitz


@dataclass(eq=False)
class NotHurwitz(HgogenError):
    """The error that the linear part of an observer's error dynamics is not Hurwitz with its `gains`; `fix`: what to
    change."""

    gains: str
    eigenvalues: tuple[complex, ...]
    fix: str

    def __str__(self) -> str:
        listed = ", ".join(f"{v.real:.6g}" + (f" +- {v.imag:.6g}i" if v.imag else "") for v in self.eigenvalues)
        return f"{self.gains}: the linear error core has the eigenvalues {listed}, which do not decay; {self.fix}"


def hurwitz(matrix: np.ndarray) -> bool:
    """Return whether all eigenvalues of a matrix (n, n) of floats or fractions have negative real parts, decided
    exactly."""
    rows = [[value if isinstance(value, Fraction) else Fraction(float(value)) for value in row] for row in matrix]
    polynomial = exact(rows).charpoly().coeffs()[::-1]
    above, below = polynomial[0::2], polynomial[1::2]
    while below:
        if not below[0] > 0:
            return False
        ratio = above[0] / below[0]
        after = [a - ratio * b for a, b in zip(above[1:], [*below[1:], fmpq(0)], strict=False)]
        above, below = below, after
    return True


def demand_hurwitz(gains: str, matrix: np.ndarray, fix: str) -> None:
    """Raise `NotHurwitz` unless the matrix (n, n) is Hurwitz; `gains`: the name of the gains in the message; `fix`:
    what to change."""
    if hurwitz(matrix):
        return
    eigenvalues = np.linalg.eigvals(np.asarray(matrix, dtype=float)).astype(complex)
    spectrum = sorted(eigenvalues, key=lambda value: -value.real)
    bad = [value for value in spectrum if value.real >= 0 and value.imag >= 0] or spectrum[:1]
    raise NotHurwitz(gains, tuple(map(complex, bad)), fix)


def one_thread() -> AbstractContextManager[Any]:
    """Return a context in which NumPy's linear algebra runs on one thread."""
    limit: AbstractContextManager[Any] = _threads().limit(limits=1, user_api="blas")
    return limit


_threads = cache(ThreadpoolController)  # one for the process: the search for its libraries takes ten milliseconds
