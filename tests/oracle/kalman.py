"""The Kalman filter of a linear plant as textbooks have it: dense matrices, all samples of a call at once.

    x <- Phi x,  P <- Phi P Phi' + Q          between two calls
    e = y - C x,  S = C P C' + R              of the samples that are there
    x <- x + P C' S^-1 e,  P <- P - P C' S^-1 C P

Source: Anderson, Moore, "Optimal Filtering" (1979), chapter 3.
"""

from collections.abc import Iterator

import numpy as np

Array = np.ndarray


def transition(A: Array, h: float) -> tuple[Array, Array]:
    """The matrices (n, n) of z after a classical Runge-Kutta step of z' = A z, and of P, by two terms."""
    n, X = len(A), h * A
    short = np.eye(n) + X + X @ X / 2
    return short + X @ X @ X / 6 + X @ X @ X @ X / 24, short


def kalman(
    Phi: Array, C: Array, Q: Array, R: Array, x: Array, P: Array, y: Array, short: Array | None = None
) -> Iterator[tuple[Array, Array, Array, Array]]:
    """Yield for each row of samples y (N, p), NaN where one is missing: the estimate x (n) and its covariance P (n, n)
    after it, all innovations e (p) at the prediction, NaN where there is no sample, and their covariance S (p, p).

    `Phi` of the estimate, and of the covariance unless that has another, `short`; `Q` of one step; `R` of a sample.
    """
    short = Phi if short is None else short
    for k, row in enumerate(y):
        if k:
            x, P = Phi @ x, short @ P @ short.T + Q
        e, S = row - C @ x, C @ P @ C.T + R
        there = np.isfinite(row)
        H, gain = C[there], np.zeros((len(x), there.sum()))
        if there.any():
            gain = np.linalg.solve(S[np.ix_(there, there)], H @ P).T
        x, P = x + gain @ e[there], P - gain @ H @ P
        yield x, (P + P.T) / 2, e, S
