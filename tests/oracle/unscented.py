"""Oracle: the scaled unscented Kalman filter as its textbooks print it, with weights and a full P, in plain numpy.

    lambda = alpha^2 (n + kappa) - n,  points chi_0 = z, chi_i = z +- column i of the Cholesky factor of (n + lambda) P
    W_0m = lambda/(n + lambda),  W_0c = W_0m + 1 - alpha^2 + beta,  W_i = 1/(2 (n + lambda))

Each point moves by classical Runge-Kutta, u on the line between two samples; h Q is added; each output corrects by
itself, with points drawn again. Of angles a mean is chi_0 + sum of W_i wrap(chi_i - chi_0). Julier, ACC 2002; Wan, van
der Merwe, 2000. Imports nothing of the package.
"""

from collections.abc import Callable

import numpy as np

Array = np.ndarray


def runge_kutta(f: Callable[[Array, float], Array], z: Array, u: tuple[float, float], h: float) -> Array:
    """One step of z' = f(z, u)."""
    middle = (u[0] + u[1]) / 2
    k1 = f(z, u[0])
    k2 = f(z + h / 2 * k1, middle)
    k3 = f(z + h / 2 * k2, middle)
    return z + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(z + h * k3, u[1]))


def points(z: Array, P: Array, scale: float) -> Array:
    """The sigma points (2n + 1, n)."""
    root = np.linalg.cholesky(scale * P)
    return np.array([z, *(z + root.T), *(z - root.T)])


def short_way(difference: Array, periods: Array) -> Array:
    """Differences of angles in [-period/2, period/2); a period of inf is that of a plain number."""
    turns = np.where(np.isinf(periods), 0.0, np.floor(difference / periods + 0.5))
    return difference - turns * np.where(np.isinf(periods), 0.0, periods)


def run(
    f: Callable[[Array, float], Array],
    h_of: Callable[[Array], Array],
    Q: Array,
    R: Array,
    z: Array,
    P: Array,
    dt: float,
    u: Array,
    y: Array,
    alpha: float,
    beta: float,
    kappa: float,
    turns: tuple[Array, Array] | None = None,
) -> Array:
    """Estimates (N, n) over u (N,), y (N, p), NaN where a sample is missing; `turns`: periods of states and outputs."""
    of_states, of_outputs = turns or (np.full(len(z), np.inf), np.full(y.shape[1], np.inf))
    n = len(z)
    scale = alpha**2 * (n + kappa)
    mean = np.full(2 * n + 1, 1 / (2 * scale))
    mean[0] = (scale - n) / scale
    spread = mean.copy()
    spread[0] += 1 - alpha**2 + beta
    estimates = []
    for k in range(len(y)):
        if k:
            moved = np.array([runge_kutta(f, chi, (u[k - 1], u[k]), dt) for chi in points(z, P, scale)])
            z = moved[0] + mean @ short_way(moved - moved[0], of_states)
            off = short_way(moved - z, of_states)
            P = (spread[:, None] * off).T @ off + dt * Q
        for j in np.flatnonzero(np.isfinite(y[k])):
            drawn = points(z, P, scale)
            read = np.array([h_of(chi)[j] for chi in drawn])
            centre = read[0] + mean @ short_way(read - read[0], of_outputs[j])
            off = short_way(read - centre, of_outputs[j])
            variance = spread @ off**2 + R[j] / dt
            K = (spread * off) @ (drawn - z) / variance
            z = z + K * short_way(y[k, j] - centre, of_outputs[j])
            P = P - variance * np.outer(K, K)
        estimates.append(z)
    return np.array(estimates)
