"""Gains from poles: the coefficients p_1..p_n of (s - s_1)...(s - s_n) = s^n + p_1 s^(n-1) + ... + p_n."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hgogen.errors import HgogenError


@dataclass(eq=False)
class BadPoles(HgogenError):
    """Poles that no real observer can have, or that do not decay."""

    poles: tuple[complex, ...]
    reason: str

    def __str__(self) -> str:
        return f"poles {', '.join(f'{p:g}' for p in self.poles) or 'given'}: {self.reason}"


def coefficients(poles: Sequence[complex], n: int) -> np.ndarray:
    """p_1..p_n (n) of n poles in the open left half plane, complex ones in conjugate pairs.

    Raises: `BadPoles`.
    """
    try:
        values = tuple(complex(pole) for pole in poles)
    except (TypeError, ValueError):
        raise BadPoles((), f"{poles!r} is no sequence of numbers; write, say, (-1, -2)") from None
    if len(values) != n:
        raise BadPoles(values, f"there are {len(values)}, the form has {n} states; give one for each")
    if not all(np.isfinite(values)):
        raise BadPoles(values, "are not all finite numbers")
    unstable = [pole for pole in values if pole.real >= 0]
    if unstable:
        raise BadPoles(values, f"{unstable[0]:g} is not in the open left half plane; give it a negative real part")
    polynomial = np.poly(values)
    if np.abs(np.imag(polynomial)).max() > 1e-12 * np.abs(polynomial).max():
        raise BadPoles(values, "complex poles must come in conjugate pairs")
    return np.array(np.real(polynomial)[1:])
