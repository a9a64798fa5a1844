"""An extended Kalman filter in plain numpy whose inputs are noisy: P <- Phi P Phi' + h Q + (h f_u) S (h f_u)'."""

from collections.abc import Callable

import numpy as np

Array = np.ndarray
Function = Callable[[Array, Array], Array]


def run(
    functions: tuple[Function, Function, Function],  # f(z, u), df/dz and df/du
    C: Array,
    noises: tuple[Array, Array, Array],  # Q as a density, the variances of one sample of each input and output
    start: tuple[Array, Array],
    dt: float,
    u: Array,
    y: Array,
) -> tuple[Array, Array]:
    """Return the estimates (N, n) and their covariances (N, n, n), with inputs on a line between samples."""
    (f, F, G), (Q, S, r), (z, P), one = functions, noises, start, np.eye(len(start[0]))
    rows, covariances = [], []
    for k, sample in enumerate(y):
        if k:
            middle = (u[k - 1] + u[k]) / 2
            k1 = f(z, u[k - 1])
            k2 = f(z + dt / 2 * k1, middle)
            at = z + dt / 2 * k2
            k3 = f(at, middle)
            k4 = f(z + dt * k3, u[k])
            A, B = dt * F(at, middle), dt * G(at, middle)
            Phi = one + A + A @ A / 2
            z, P = z + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4), Phi @ P @ Phi.T + dt * Q + B @ np.diag(S) @ B.T
        for j, c in enumerate(C):
            if np.isfinite(sample[j]):
                K = P @ c / (c @ P @ c + r[j])
                z, P = z + K * (sample[j] - c @ z), P - np.outer(K, c @ P)
        rows.append(z)
        covariances.append(P)
    return np.array(rows), np.array(covariances)
