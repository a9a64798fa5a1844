"""Whether a matrix is Hurwitz, in exact arithmetic: Routh's array of its characteristic polynomial.

A double is a rational; the characteristic polynomial and the array of a matrix of doubles are computed in rationals
(FLINT), so the answer is a proof. Source: E. J. Routh 1877; Gantmacher, "The Theory of Matrices", XV.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from flint import fmpq

from hgogen.algebra.definite import exact
from hgogen.errors import HgogenError


@dataclass(eq=False)
class NotHurwitz(HgogenError):
    """Gains whose linear error core has eigenvalues that do not decay."""

    gains: str
    eigenvalues: tuple[complex, ...]
    fix: str

    def __str__(self) -> str:
        listed = ", ".join(f"{v.real:.6g}" + (f" +- {v.imag:.6g}i" if v.imag else "") for v in self.eigenvalues)
        return f"{self.gains}: the linear error core has the eigenvalues {listed}, which do not decay; {self.fix}"


def hurwitz(matrix: np.ndarray) -> bool:
    """Whether every eigenvalue of a matrix (n, n), floats or fractions, has a negative real part: a proof."""
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
    """Raises: `NotHurwitz` for a matrix (n, n) that is not; `fix` says what to change."""
    if hurwitz(matrix):
        return
    eigenvalues = np.linalg.eigvals(np.asarray(matrix, dtype=float)).astype(complex)
    spectrum = sorted(eigenvalues, key=lambda value: -value.real)
    bad = [value for value in spectrum if value.real >= 0 and value.imag >= 0] or spectrum[:1]
    raise NotHurwitz(gains, tuple(map(complex, bad)), fix)
