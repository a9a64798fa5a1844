"""What counts as a symmetric matrix: solvers leave M and M' a rounding apart, and mean (M + M')/2.

    |M_ij - M_ji| <= 1e-12 max(|M_ij|, |M_ji|, sqrt|M_ii M_jj|)

for every i, j is rounding. The right side turns with the units of the coordinates as the entries do, so that no small
one is lost beside a large one.
"""

from collections.abc import Sequence
from fractions import Fraction
from itertools import combinations

_ROUNDING = Fraction(1, 10**12)


def symmetric(M: Sequence[Sequence[Fraction]]) -> tuple[tuple[Fraction, ...], ...] | None:
    """(M + M')/2 in exact fractions, where M (n, n) is symmetric but for rounding; else None."""
    n = range(len(M))
    for i, j in combinations(n, 2):
        largest = max(M[i][j] ** 2, M[j][i] ** 2, abs(M[i][i] * M[j][j]))
        if (M[i][j] - M[j][i]) ** 2 > _ROUNDING**2 * largest:
            return None
    return tuple(tuple((M[i][j] + M[j][i]) / 2 for j in n) for i in n)


def unsymmetric(name: str) -> str:
    """Why a matrix of that name is refused, and what to give."""
    return f"must be symmetric, to 1e-12 of its numbers; give ({name} + {name}')/2"
