"""Oracle: the Kalman-like observer with forgetting, sampled, in plain numpy, P in full.

    z' = A(u, v) z + b(u, v),  v the measured states: y on the line between two samples, z's own where one is missing
    P  <- exp(rho h) Phi P Phi',  Phi = I + hA + (hA)^2/2 at mid-step;  z by classical Runge-Kutta
    P  <- where a P_ii exceeds its cap: s P s, s_i = min(1, cap_i/P_ii), diag(min(P_ii, cap_i/4)) if silent for 1/rho
    z  <- z + K (y_i - z_i),  K = P C_i'/(R_i/h + C_i P C_i'),  P <- P - K C_i P,  one output after the other

H. Hammouri, J. de Leon Morales, CDC 1990: S' = -rho S - A'S - S A + C'R^-1 C, P = S^-1. The outputs show the first
states. Written apart from the package; imports nothing of it.
"""

from collections.abc import Callable

import numpy as np

Array = np.ndarray


def run(
    A: Callable[[float, Array], Array],
    b: Callable[[float, Array], Array],
    rho: float,
    R: Array,
    z: Array,
    P: Array,
    h: float,
    u: Array,
    y: Array,
    cap: Array | float = np.inf,
) -> Array:
    """Estimates (N, n) over u (N,), y (N, p), NaN where a sample is missing; A, b of u and the measured states."""
    outputs, found, silent = len(R), [], 0.0
    for k in range(len(y)):
        valid = np.isfinite(y[k])
        if k:
            before = np.where(np.isfinite(y[k - 1]), y[k - 1], y[k])

            def f(z: Array, c: float, k: int = k, before: Array = before, valid: Array = valid) -> Array:
                now = u[k - 1] + c * (u[k] - u[k - 1])
                v = np.where(valid, before + c * (y[k] - before), z[:outputs])
                return A(now, v) @ z + b(now, v)

            k1 = f(z, 0.0)
            k2 = f(z + h / 2 * k1, 0.5)
            centre = z + h / 2 * k2
            k3 = f(centre, 0.5)
            hA = h * A((u[k - 1] + u[k]) / 2, np.where(valid, (before + y[k]) / 2, centre[:outputs]))
            z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(z + h * k3, 1.0))
            Phi = np.eye(len(z)) + hA + hA @ hA / 2
            P = np.exp(rho * h) * Phi @ P @ Phi.T
            silent = 0 if valid.any() else silent + rho * h
            if (np.diag(P) > cap).any():
                scale = np.minimum(1, cap / np.diag(P))
                anew = np.diag(np.minimum(np.diag(P), np.asarray(cap) / 4))
                P = scale[:, None] * P * scale if silent < 1 else anew
        for i in np.flatnonzero(valid):
            K = P[:, i] / (R[i] / h + P[i, i])
            z = z + K * (y[k, i] - z[i])
            P = P - np.outer(K, P[i])
        found.append(z)
    return np.array(found)
