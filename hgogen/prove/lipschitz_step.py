"""What a plant does beside a step of an explicit Runge-Kutta method, of a flow that is Lipschitz and no more.

With |dF_i/dx_j|, |dF_i/du_k| <= L, |x'| <= V, |u'| <= r: W = L (V, r) bounds the rates of F on the plant's way, where
F may have kinks. The kernel of Peano of a sum of values on [0, c], their weights w_l at c_l, is its integral from 0,

    K(s) = min(s, c) - sum of w_l over c_l <= s,   |integral from 0 to c h of F - h sum_l w_l F(c_l h)| <= h^2 W int|K|

so that with d_i, how far a stage is from the plant at its time, and d that of the result,

    d_i <= h^2 W int|K_i| + h sum_j |a_ij| L d_j,   |x(t + h) - Phi_h(x)| <= h^2 W int|K| + h sum_i |b_i| L d_i

A row of F that is linear has a second derivative there of at most L W, and of weights that are exact for lines the
first term is at most h^3 L W (1/24 + sum_i |b_i| (c_i - 1/2)^2/2).
"""

from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise

import numpy as np

_ZERO, _ONE, _HALF = Fraction(0), Fraction(1), Fraction(1, 2)
Column = Sequence[Fraction]
Rows = Sequence[Column]


def left(
    h: Fraction, a: Rows, b: Column, c: Column, steepness: Rows, moving: Column, linear: Sequence[bool]
) -> tuple[Fraction, ...] | None:
    """|x(t + h) - Phi_h(x)|/h (n) of a method a, b, c, of `steepness` L (n, n + m), of states and inputs that are
    `moving` so fast (n + m), of rows that are `linear` (n) or not; None of a method that is not exact for constants."""
    if sum(b) != 1 or any(sum(row) != at for row, at in zip(a, c, strict=True)):
        return None
    L = np.array(steepness, dtype=object)
    in_states, bent, away = L[:, : len(L)], L @ np.array(moving, dtype=object), list[np.ndarray]()
    for row, at in zip((*a, b), (*c, _ONE), strict=True):
        stages = (h * abs(w) * (in_states @ off) for w, off in zip(row, away, strict=False))
        away.append(sum(stages, h**2 * _kernel(at, row, c) * bent))
    over_h, less = away[-1] / h, 0 * bent
    if sum(w * at for w, at in zip(b, c, strict=True)) == _HALF:
        spread = Fraction(1, 24) + sum((abs(w) * (at - _HALF) ** 2 / 2 for w, at in zip(b, c, strict=True)), _ZERO)
        less = h * _kernel(_ONE, b, c) * bent - h**2 * spread * (in_states @ bent)
    return tuple(x - max(y, _ZERO) if line else x for x, y, line in zip(over_h, less, linear, strict=True))


def _kernel(end: Fraction, weights: Column, places: Column) -> Fraction:
    """The integral of |K| of values at these places, from 0 to 1."""
    cuts, total = sorted({_ZERO, end, _ONE, *places}), _ZERO
    for low, high in pairwise(cuts):
        taken = sum((w for w, at in zip(weights, places, strict=True) if at <= low), _ZERO)
        first, last = min(low, end) - taken, min(high, end) - taken
        sizes = abs(first) + abs(last)
        crossed = (first**2 + last**2) / (2 * sizes) if first * last < 0 else sizes / 2
        total += (high - low) * crossed
    return total
