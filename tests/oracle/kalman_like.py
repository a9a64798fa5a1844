"""Oracle: the Kalman-like observer with forgetting, sampled, in plain numpy, P in full.

    z' = A(u, v) z + b(u, v),  v the measured states: y on the line between two samples, z's own where one is missing
    P  <- exp(rho h) Phi P Phi' + h Q_0,  Phi = I + hA + (hA)^2/2 at mid-step;  z by classical Runge-Kutta
    P  <- P - P (P + diag(cap)/(1 - exp(-rho h)))^-1 P, which is P^-1 <- P^-1 + (1 - exp(-rho h)) S_0, S_0 = 1/cap,
    Q_0 = 1e-14 rho diag(cap)
    z  <- z + K (y_i - z_i),  K = P C_i'/(R_i/h + C_i P C_i'),  P <- P - K C_i P,  one output after the other

H. Hammouri, J. de Leon Morales, CDC 1990: S' = -rho (S - S_0) - A'S - S A + C'R^-1 C - S Q_0 S, P = S^-1, there with
S_0 = Q_0 = 0.
The outputs show the first states. Written apart from the package; imports nothing of it.
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
    cap: Array,
) -> Array:
    """Estimates (N, n) over u (N,), y (N, p), NaN where a sample is missing; A, b of u and the measured states."""
    outputs, estimates = len(R), []
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
            P = np.exp(rho * h) * Phi @ P @ Phi.T + 1e-14 * rho * h * np.diag(cap)
            P = P - P @ np.linalg.solve(P + np.diag(cap / (1 - np.exp(-rho * h))), P)
        for i in np.flatnonzero(valid):
            K = P[:, i] / (R[i] / h + P[i, i])
            z = z + K * (y[k, i] - z[i])
            P = P - np.outer(K, P[i])
        estimates.append(z)
    return np.array(estimates)
