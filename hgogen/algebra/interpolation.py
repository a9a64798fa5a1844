"""The polynomials between the points of one axis, of numbers or of whatever is added and scaled.

    linear     c_k1 = D_k = (y_k - y_(k-1))/(x_k - x_(k-1))
    monotone   cubics through the points with slopes d_k, which rise and fall with the points and have no other turns

The slopes d_k are Fritsch and Butland's, as in PCHIP: 0 where D_k D_(k+1) <= 0, and inside the weighted harmonic mean

    3 (h_k + h_(k+1))/d = (2 h_(k+1) + h_k)/D_k + (h_(k+1) + 2 h_k)/D_(k+1),    h_k = x_k - x_(k-1)

At the ends it is the slope of the parabola through three points, 0 where its sign is not D's, and 3 D at most where the
next D has another sign. Sources: F. N. Fritsch and R. E. Carlson, "Monotone piecewise cubic interpolation", SIAM J.
Numer. Anal. 17 (1980), for what slopes are monotone; F. N. Fritsch and J. Butland, "A method for constructing local
monotone piecewise cubic interpolants", SIAM J. Sci. Stat. Comput. 5 (1984), for these.
"""

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any

from hgogen.algebra.piece import ZERO

Pieces = list[tuple[Any, ...]]  # a polynomial for each two points


def _rises(x: Sequence[Fraction], y: Sequence[Any]) -> list[Any]:
    """The slopes of the chords."""
    return [(d - c) / (b - a) for a, b, c, d in zip(x, x[1:], y, y[1:], strict=False)]


def _monotone(x: Sequence[Fraction], y: Sequence[Fraction]) -> Pieces:
    """The cubic of each cell by Hermite's formula."""
    h, D = [b - a for a, b in pairwise(x)], _rises(x, y)
    if len(h) == 1:
        d = [D[0], D[0]]
    else:
        inner = [_mean(h[k], h[k + 1], D[k], D[k + 1]) for k in range(len(h) - 1)]
        d = [_end(h[0], h[1], D[0], D[1]), *inner, _end(h[-1], h[-2], D[-1], D[-2])]
    return [
        (y[k], d[k], (3 * D[k] - 2 * d[k] - d[k + 1]) / h[k], (d[k] + d[k + 1] - 2 * D[k]) / h[k] ** 2)
        for k in range(len(h))
    ]


def _mean(h: Fraction, g: Fraction, D: Fraction, E: Fraction) -> Fraction:
    if D * E <= 0:
        return ZERO
    return 3 * (h + g) / ((2 * g + h) / D + (g + 2 * h) / E)


def _end(h: Fraction, g: Fraction, D: Fraction, E: Fraction) -> Fraction:
    slope = ((2 * h + g) * D - h * E) / (h + g)
    if slope * D <= 0:
        return ZERO
    return 3 * D if D * E <= 0 and abs(slope) > 3 * abs(D) else slope


KINDS: Mapping[str, Callable[..., Pieces]] = {
    "linear": lambda x, y: list(zip(y, _rises(x, y), strict=False)),
    "monotone": _monotone,
}
DEGREES = {"linear": 1, "monotone": 3}
SEVERAL = ("linear",)  # those that a table of several arguments may have
