"""Matrix operations on P = L D L' as loops, for states too many to unroll: Python's reading.

The columns of L lie in the members of a group: `columns[k, i]` is row i of column k, of which i > k counts, the
diagonal being 1. Each kernel is written once here and once in C (`ckernels`), in the same order of operations, so both
give the same bits.

    expand         unit diagonal and zeros above it, so that a column can be multiplied by Phi
    triangularise  L, D of M diag(D) M' for a full matrix M, by weighted Gram-Schmidt on its rows (Thornton)
    add            L, D of L D L' + diag(w), by n rank-one updates (Gill, Golub, Murray, Saunders 1974, method C1)
    correct        L, D after a scalar measurement with row c and variance r, and its gain (Bierman)
    cap            rows of L scaled where a variance exceeds its cap, a congruence
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

Array = np.ndarray


def expand(columns: Array) -> None:
    """Unit diagonal, zeros above."""
    n = len(columns)
    for k in range(n):
        columns[k, k] = 1
        columns[k, :k] = 0


def triangularise(columns: Array, d: Array) -> None:
    """M = columns' (full) and d in; L (strict lower) and D out."""
    n = len(d)
    rows, weights = columns.T.copy(), d.copy()
    columns[:] = np.eye(n)
    for j in range(n):
        weighted = weights * rows[j]
        sums = np.zeros(n - j, rows.dtype)
        for k in range(n):
            sums = sums + rows[j:, k] * weighted[k]
        d[j] = sums[0]
        factors = sums[1:] / d[j]
        columns[j, j + 1 :] = factors
        rows[j + 1 :] -= factors[:, None] * rows[j]


def add(columns: Array, d: Array, w: Array) -> None:
    """Add diag(w), w >= 0."""
    n = len(d)
    for k in range(n):
        vector, weight = np.zeros(n, d.dtype), w[k]
        vector[k] = 1
        for j in range(k, n):
            pivot = vector[j]
            grown = d[j] + weight * pivot * pivot
            factor = weight * pivot / grown
            weight = weight * d[j] / grown
            d[j] = grown
            vector[j + 1 :] = vector[j + 1 :] - pivot * columns[j, j + 1 :]
            columns[j, j + 1 :] = columns[j, j + 1 :] + factor * vector[j + 1 :]


def correct(columns: Array, d: Array, c: Array, r: Array, gain: Array) -> None:
    """Measurement of row c and variance r; the gain goes to `gain`."""
    n, alpha = len(d), r[0]
    gain[:] = 0
    for j in reversed(range(n)):
        f = c[j]
        for i in range(j + 1, n):
            f = f + columns[j, i] * c[i]
        v, before = d[j] * f, alpha
        alpha = before + v * f
        d[j] = d[j] * before / alpha
        old = columns[j, j + 1 :].copy()
        columns[j, j + 1 :] = old - f * gain[j + 1 :] / before
        gain[j + 1 :] = gain[j + 1 :] + old * v
        gain[j] = v
    gain[:] = gain / alpha


def cap(columns: Array, d: Array, caps: Array) -> bool:
    """Scale row i by cap_i/P_ii where P_ii > cap_i; whether one did."""
    n = len(d)
    variance = d.copy()
    for k in range(n):
        variance[k + 1 :] = variance[k + 1 :] + columns[k, k + 1 :] * columns[k, k + 1 :] * d[k]
    scale = np.where(variance > caps, caps / variance, np.ones(n, d.dtype))
    if not (variance > caps).any():
        return False
    for k in range(n):
        columns[k, k + 1 :] = columns[k, k + 1 :] * scale[k + 1 :] / scale[k]
    d[:] = d * scale * scale
    return True


KERNELS: Mapping[str, Callable[..., Any]] = {
    "expand": expand,
    "triangularise": triangularise,
    "add": add,
    "correct": correct,
    "cap": cap,
}
