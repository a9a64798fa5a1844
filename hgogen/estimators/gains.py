"""Gains from poles: the coefficients p_1..p_n of (s - s_1)...(s - s_n) = s^n + p_1 s^(n-1) + ... + p_n.

A filter in the output injection asks more than a negative real part of the poles mu of A - L C: with

    M = [[A, diag L], [-beta C'C, -alpha I + beta A']],   p_M(s) = beta^n p_(A - L C)(s (s + alpha)/beta),

M is Hurwitz if and only if each mu lies inside a parabola, S = {alpha^2 Re mu + beta (Im mu)^2 < 0}. Source: Astolfi,
Jungers, Zaccarian, "Output injection filtering redesign in high-gain observers", ECC 2018, (9)-(11), Lemma 1; that
mu outside S make M unstable is Routh's test of s^2 + alpha s - beta mu.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from hgogen.errors import HgogenError
from hgogen.sentence import up


@dataclass(eq=False)
class BadPoles(HgogenError):
    """Poles that no real observer can have, or that do not decay."""

    poles: tuple[complex, ...]
    reason: str

    def __str__(self) -> str:
        return f"poles {', '.join(f'{p:g}' for p in self.poles) or 'given'}: {self.reason}"


@dataclass(eq=False)
class OutsideParabola(HgogenError):
    """Poles of A - L C at which a filtered output injection does not decay: `poles` are those outside S, `eigenvalue`
    the worst that M has of them, `ratio` is alpha^2/beta, and any ratio above `least` admits them."""

    poles: tuple[complex, ...]
    eigenvalue: complex
    ratio: Fraction
    least: Fraction

    def __str__(self) -> str:
        return (
            f"poles {', '.join(f'{p:g}' for p in self.poles)}: outside the parabola alpha^2 Re + beta Im^2 < 0, so "
            f"that the filtered error core has the eigenvalue {self.eigenvalue:.6g}; alpha^2/beta = "
            f"{float(self.ratio):.6g} must be above {up(self.least, 6)} to admit them: raise alpha, lower beta, "
            "or give them smaller imaginary parts"
        )


def numbers(poles: Sequence[complex]) -> tuple[complex, ...]:
    """Poles as complex numbers. Raises: `BadPoles` for anything else."""
    try:
        return tuple(complex(pole) for pole in poles)
    except (TypeError, ValueError, OverflowError):
        raise BadPoles((), f"{poles!r} is no sequence of numbers; write, say, (-1, -2)") from None


def coefficients(poles: Sequence[complex], n: int) -> np.ndarray:
    """p_1..p_n (n) of n poles in the open left half plane, complex ones in conjugate pairs.

    Raises: `BadPoles`.
    """
    values = numbers(poles)
    if len(values) != n:
        raise BadPoles(values, f"there are {len(values)}, the form has {n} states; give one for each")
    if not all(np.isfinite(values)):
        raise BadPoles(values, "are not all finite numbers")
    unstable = [pole for pole in values if pole.real >= 0]
    if unstable:
        raise BadPoles(values, f"{unstable[0]:g} is not in the open left half plane; give it a negative real part")
    polynomial = np.poly(values)
    if not np.isfinite(polynomial).all():
        raise BadPoles(values, "their polynomial is beyond a double's range; give smaller ones, and a larger theta")
    if np.abs(np.imag(polynomial)).max() > 1e-12 * np.abs(polynomial).max():
        raise BadPoles(values, "complex poles must come in conjugate pairs")
    return np.array(np.real(polynomial)[1:])


def least_ratio(pole: complex) -> Fraction:
    """(Im mu)^2/(-Re mu) of a mu in the open left half plane: it lies in S where alpha^2/beta is above it. Exact."""
    return Fraction(pole.imag) ** 2 / -Fraction(pole.real)


def demand_parabola(poles: Iterable[complex], alpha: float, beta: float) -> None:
    """That poles in the open left half plane lie in S, in exact arithmetic; alpha, beta > 0.

    Raises: `OutsideParabola`.
    """
    ratio = Fraction(alpha) ** 2 / Fraction(beta)
    outside = {complex(pole): least_ratio(complex(pole)) for pole in poles}
    outside = {pole: least for pole, least in outside.items() if least >= ratio}
    if outside:
        worst = max(filtered_spectrum(outside, alpha, beta), key=lambda value: value.real)
        raise OutsideParabola(tuple(outside), complex(worst), ratio, max(outside.values()))


def filtered_spectrum(poles: Iterable[complex], alpha: float, beta: float) -> np.ndarray:
    """The eigenvalues (2 n) of M whose A - L C has the n `poles`, by Lemma 1: both roots s of s (s + alpha) = beta mu,
    symmetric about -alpha/2."""
    root = np.sqrt(alpha * alpha / 4 + beta * np.array([complex(pole) for pole in poles]))
    return np.concatenate([-alpha / 2 + root, -alpha / 2 - root])


def filtered_core(L: np.ndarray, alpha: float, beta: float) -> np.ndarray:
    """M (2 n, 2 n) of the gains L (n)."""
    n = len(L)
    shift = np.diag(np.ones(n - 1), 1)
    below = np.zeros((n, n))
    below[0, 0] = -beta
    return np.block([[shift, np.diag(L)], [below, beta * shift.T - alpha * np.eye(n)]])


def parabola_advice(L: np.ndarray, alpha: float, beta: float) -> str:
    """What to change about gains L (n) whose M is not Hurwitz."""
    poles = np.roots([1.0, *L]).astype(complex)
    unstable = poles[poles.real >= 0]
    if unstable.size:
        return f"A - L C itself has the pole {complex(unstable[0]):.6g}; take gains whose poles decay"
    least = float(max(map(least_ratio, map(complex, poles))))
    return f"alpha^2/beta = {alpha**2 / beta:.6g} must be above about {least:.4g}; raise alpha or lower beta"
