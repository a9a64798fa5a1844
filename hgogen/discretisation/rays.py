"""How far along the rays of some eigenvalues a stability polynomial R stays within the unit circle.

A step of length h multiplies a mode of the eigenvalue lambda by R(h lambda). With z = x d, d = lambda/|lambda|, the
first x > 0 at which |R(x d)| passes 1 is a root of the real polynomial |R(x d)|^2 - 1.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

AXIS = 1e-9  # for eig's rounding: |Re z| below which a unit z is imaginary, |z|/max below which it is 0


def spectral_limit(spectrum: NDArray[np.complex128], polynomial: Sequence[float]) -> float:
    """The largest dt with |R(h lambda)| <= 1 for all 0 < h <= dt and each lambda; inf for none."""
    upper = map(complex, spectrum[spectrum.imag >= 0.0])  # the others are conjugates
    return min((_passed(each / abs(each), tuple(polynomial)) / abs(each) for each in upper), default=np.inf)


@lru_cache(maxsize=1024)  # all real eigenvalues, and those of points with the same slopes, lie on the same rays
def _passed(direction: complex, polynomial: tuple[float, ...]) -> float:
    """The first x at which |R(x direction)| passes 1: a root of the real polynomial |R|^2 - 1 of x; inf for none."""
    terms = np.array([c * direction**k for k, c in enumerate(polynomial)])
    excess = np.convolve(terms.real, terms.real) + np.convolve(terms.imag, terms.imag)
    excess[0] -= 1.0
    excess[np.abs(excess) < AXIS] = 0.0  # on the imaginary axis the low powers cancel and leave rounding
    roots = np.roots(excess[::-1])
    edges = np.sort(roots.real[(np.abs(roots.imag) < 1e-6 * np.abs(roots)) & (roots.real > 0.0)])
    edges = np.concatenate(([0.0], edges, [2.0 * edges.max(initial=1.0)]))
    grows = np.polyval(excess[::-1], (edges[1:] + edges[:-1]) / 2.0) > 0.0
    return float(edges[np.argmax(grows)]) if grows.any() else np.inf
