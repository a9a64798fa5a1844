"""By how much a step of a tableau is beside a plant whose flow is Lipschitz, kinks and all.

    |dF_i/dx_j|, |dF_i/du_k| <= L,   |x'| <= V, |u'| <= r:   |d/dt F_i(x(t), u(t))| <= W_i = (L (V, r))_i

A sum of values at c_l, of weights w_l that add to c, is beside the integral from 0 to c by at most W times that of the
size of min(s, c) - sum of the w_l with c_l <= s; with c = 1 and weights that add the c_l to 1/2, and where F_i has a
second derivative of at most w, by w (1/24 + sum |w_l| (c_l - 1/2)^2/2), which a linear row has: w = (L (W, 0))_i. A
stage is beside the plant at its time by that, in h, and by what the stages before it are, times L.
"""

from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise

from .box import NotShown
from .inequality import ONE, Tableau
from .matrix import Matrix

_HALF, _ZERO = Fraction(1, 2), Fraction(0)
_TWELFTH = Fraction(1, 12)


def left_by_lipschitz(
    tableau: Tableau, h: Fraction, steepness: Matrix, moving: Sequence[Fraction], linear: Sequence[bool]
) -> list[Fraction]:
    """Of each row (n), over h: of `steepness` (n, n + m) where states and inputs are `moving` so fast (n + m), and some
    rows are `linear`. Raises: `NotShown`."""
    if any(x < 0 for row in steepness for x in row):
        raise NotShown("one of its steepness is negative")
    n, nodes, off = len(steepness), tableau.nodes, list[list[Fraction]]()
    W = _driven(steepness, moving)
    for row, c in zip((*tableau.rows, tableau.weights), (*nodes, ONE), strict=True):
        beside = [h * h * _kernel(row, nodes, c) * x for x in W]
        for w, before in zip(row, off, strict=False):
            beside = [x + h * abs(w) * y for x, y in zip(beside, _driven(steepness, before), strict=True)]
        off.append(beside)
    if not _of_lines(tableau):
        return [x / h for x in off[-1]]
    bends = _driven(steepness, W)
    moment = sum((abs(w) * (c - _HALF) ** 2 for w, c in zip(tableau.weights, nodes, strict=True)), _TWELFTH) / 2
    kernel, left = _kernel(tableau.weights, nodes, ONE), list[Fraction]()
    for i in range(n):
        less = max(h * kernel * W[i] - h * h * moment * bends[i], _ZERO) if linear[i] else _ZERO
        left.append(off[-1][i] / h - less)
    return left


def _of_lines(tableau: Tableau) -> bool:
    """Whether its weights are exact for lines."""
    return sum((w * c for w, c in zip(tableau.weights, tableau.nodes, strict=True)), _ZERO) == _HALF


def _driven(rows: Matrix, by: Sequence[Fraction]) -> list[Fraction]:
    """Of rows, whose last entries may be of what does not move."""
    return [sum((x * y for x, y in zip(row, by, strict=False)), _ZERO) for row in rows]


def _kernel(weights: Sequence[Fraction], nodes: Sequence[Fraction], c: Fraction) -> Fraction:
    """The integral from 0 to 1. Raises: `NotShown` of weights that do not add to c."""
    if sum(weights, _ZERO) != c:
        raise NotShown("its stages are not exact for what is constant")
    jumps = dict.fromkeys(sorted({_ZERO, c, ONE, *nodes}), _ZERO)
    for w, at in zip(weights, nodes, strict=False):
        jumps[at] += w
    value, total = _ZERO, _ZERO
    for here, there in pairwise(jumps):
        value -= jumps[here]
        after = value + (there - here if there <= c else _ZERO)
        total += _size(value, after) * (there - here)
        value = after
    return total


def _size(a: Fraction, b: Fraction) -> Fraction:
    """The mean size of what goes from a to b on a line."""
    if a * b >= 0:
        return abs(a + b) / 2
    return (a * a + b * b) / (2 * abs(b - a))
