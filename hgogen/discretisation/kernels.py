"""Matrix operations as loops, for states too many to unroll: Python's reading.

Each kernel is written once here and once as loops (`emit.matrix_loops`), which every language prints, in the same order
of operations, so both give the same bits.

On P = L D L', the columns of L in the members of a group: `columns[k, i]` is row i of column k, of which i > k counts,
the diagonal being 1.

    expand         unit diagonal and zeros above it, so that a column can be multiplied by Phi
    triangularise  L, D of M diag(D) M' for a matrix M with `band` >= 1 diagonals above the main one, by rotations of
                   two columns without square roots (Gentleman 1973), which leave M diag(D) M' as it is
    add            L, D of L D L' + diag(w), by n rank-one updates (Gill, Golub, Murray, Saunders 1974, method C1)
    correct        L, D after a scalar measurement with row c, whose elements from `read` on are 0, and variance r, and
                   its gain (Bierman)
    cap            rows of L scaled where a variance exceeds its cap, a congruence
    renew          L, D with the information diag(c)^2 added, by a measurement of each state (Bierman)

On a matrix X (n, n) by rows, in one array:

    balance        X <- S^-1 X S, S diagonal of powers of two, so that row i and column i are of about the same size
                   (Parlett, Reinsch 1969); a high gain enters X by its powers, which S takes out
    exponential    phi_0 = exp X, phi_1 = (phi_0 - 1)/X, phi_2 = (phi_1 - 1)/X by scaling and squaring
    resolvent      (1 - X)^-1 by Gauss-Jordan with row pivots
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

Array = np.ndarray
SWEEPS = 12  # of balancing; it has settled long before, and need not have
HALVINGS = 64  # at most, of a norm or in a scale: 2^64 is beyond what a gain of a float can be
DEGREE = 13  # of the series of phi_2: (1/2)^14/16! is below the rounding of a double


def expand(columns: Array) -> None:
    """Unit diagonal, zeros above."""
    n = len(columns)
    for k in range(n):
        columns[k, k] = 1
        columns[k, :k] = 0


def triangularise(columns: Array, d: Array, band: int) -> None:
    """M = columns' and d in; L (strict lower) and D out."""
    n = len(d)
    for i in range(n):
        pivot = columns[i, i]
        for k in range(i + 1, min(i + 1 + band, n)):
            other = columns[k, i]
            a, b = d[i] * pivot, d[k] * other
            total = a * pivot + b * other
            f, g = a / total, b / total
            d[k] = d[i] * (d[k] / total)
            d[i] = total
            x, y = columns[i, i + 1 :].copy(), columns[k, i + 1 :].copy()
            columns[i, i + 1 :] = f * x + g * y
            columns[k, i + 1 :] = pivot * y - other * x
            pivot, columns[k, i] = d.dtype.type(1), 0
        d[i] = d[i] * pivot * pivot
        columns[i, i] = 1


def add(columns: Array, d: Array, w: Array) -> None:
    """Add diag(w), w >= 0."""
    n = len(d)
    for k in range(n):
        vector, weight = np.zeros(n, d.dtype), w[k]
        vector[k] = 1
        for j in range(k, n):
            pivot, before, rest, below = vector[j], d[j], vector[j + 1 :], columns[j, j + 1 :]
            grown = before + weight * pivot * pivot
            factor = weight * pivot / grown
            weight = weight * before / grown
            d[j] = grown
            rest -= pivot * below
            below += factor * rest


def correct(columns: Array, d: Array, c: Array, r: Array, gain: Array, read: int) -> None:
    """Measurement of row c and variance r; the gain goes to `gain`."""
    alpha = r[0]
    gain[:] = 0
    for j in reversed(range(read)):
        f = c[j]
        for i in range(j + 1, read):
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
    """Scale row i by cap_i/P_ii where P_ii > cap_i; whether one did, or is not a number, or a D is negative. A D that
    then is none of a covariance below its cap, as no step makes it, is the cap."""
    n, variance = len(d), variances(columns, d)
    scale = np.where(variance > caps, caps / variance, np.ones(n, d.dtype))
    if (variance <= caps).all() and (d >= 0).all():
        return False
    for k in range(n):
        columns[k, k + 1 :] = columns[k, k + 1 :] * scale[k + 1 :] / scale[k]
    scaled = d * scale * scale
    d[:] = np.where((scaled >= 0) & (scaled <= caps), scaled, caps)
    return True


def renew(columns: Array, d: Array, caps: Array, c: Array) -> bool:
    """Measure each state to the variance 1/c_i^2; whether the P_ii/cap_i then do not add up to 1/2 or less."""
    return not share(columns, d, caps, c) <= 0.5


def share(columns: Array, d: Array, caps: Array, c: Array) -> Any:
    """Measure each state to the variance 1/c_i^2; what the P_ii/cap_i then add up to."""
    n = len(d)
    for i in range(n):
        alpha, gain = d.dtype.type(1), np.zeros(n, d.dtype)
        for j in reversed(range(i + 1)):
            f = c[i] if j == i else columns[j, i] * c[i]
            v, before = d[j] * f, alpha
            alpha = before + v * f
            d[j] = d[j] * before / alpha
            old = columns[j, j + 1 :].copy()
            columns[j, j + 1 :] = old - f * gain[j + 1 :] / before
            gain[j + 1 :] = gain[j + 1 :] + old * v
            gain[j] = v
    total = d.dtype.type(0)
    for variance, limit in zip(variances(columns, d), caps, strict=True):
        total = total + variance / limit
    return total


def variances(columns: Array, d: Array) -> Array:
    """P_ii, summed from the diagonal's own, then from the first column on."""
    variance = d.copy()
    for k in range(len(d)):
        variance[k + 1 :] = variance[k + 1 :] + columns[k, k + 1 :] * columns[k, k + 1 :] * d[k]
    return variance


def balance(x: Array, scale: Array) -> None:
    """x in and out; the diagonal of S."""
    n = len(scale)
    X, two = x.reshape(n, n), x.dtype.type(2)
    scale[:] = 1
    for _ in range(SWEEPS):
        for i in range(n):
            column, row, f = _sum(X[:, i], i), _sum(X[i], i), x.dtype.type(1)
            if not (column > 0 and row > 0):
                continue
            for _ in range(HALVINGS):
                if column >= row / two:
                    break
                f, column, row = f * two, column * two, row / two
            for _ in range(HALVINGS):
                if column < row * two:
                    break
                f, column, row = f / two, column / two, row * two
            X[i] = X[i] / f
            X[:, i] = X[:, i] * f
            scale[i] = scale[i] * f


def _sum(values: Array, but: int) -> Any:
    """The sum of |values| but one, from the first to the last."""
    total = values.dtype.type(0)
    for j in range(len(values)):
        if j != but:
            total = total + abs(values[j])
    return total


def exponential(x: Array, phi_0: Array, phi_1: Array, phi_2: Array) -> None:
    """phi_2 by its series for X/2^k of norm at most 1/2, to the 14th power; then k doublings of X."""
    n = math.isqrt(len(x))
    X, one, doublings = x.reshape(n, n).copy(), np.eye(n, dtype=x.dtype), 0
    norm = max(_sum(X[i], n) for i in range(n))
    for _ in range(HALVINGS):
        if not norm > 0.5:
            break
        norm, X, doublings = norm / 2, X / 2, doublings + 1
    a2 = one
    for j in range(DEGREE, 0, -1):
        a2 = one + _product(X, a2) / (j + 2)
    a2 = a2 / 2
    a1 = one + _product(X, a2)
    a0 = one + _product(X, a1)
    for _ in range(doublings):
        a2 = (_product(a0, a2) + a1 + a2) / 4
        a1 = (_product(a0, a1) + a1) / 2
        a0 = _product(a0, a0)
    phi_0[:], phi_1[:], phi_2[:] = a0.ravel(), a1.ravel(), a2.ravel()


def _product(a: Array, b: Array) -> Array:
    """a b, summed from the first to the last."""
    total = np.zeros_like(b)
    for k in range(len(a)):
        total = total + a[:, k, None] * b[None, k]
    return total


def resolvent(x: Array, inverse: Array) -> None:
    """(1 - X)^-1; x is left in pieces."""
    n = math.isqrt(len(x))
    A, R = x.reshape(n, n), inverse.reshape(n, n)
    one = np.eye(n, dtype=x.dtype)
    A[:], R[:] = one - A, one
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[best, k]):
                best = i
        A[[k, best]], R[[k, best]] = A[[best, k]], R[[best, k]]
        pivot = A[k, k]
        A[k], R[k] = A[k] / pivot, R[k] / pivot
        for i in range(n):
            factor = A[i, k]
            if i != k:
                A[i], R[i] = A[i] - factor * A[k], R[i] - factor * R[k]


KERNELS: Mapping[str, Callable[..., Any]] = {
    "expand": expand,
    "triangularise": triangularise,
    "add": add,
    "correct": correct,
    "cap": cap,
    "renew": renew,
    "balance": balance,
    "exponential": exponential,
    "resolvent": resolvent,
}
