"""Filters of a discrete plant x+ = f(x, u), y = h(x) + v in plain numpy, by equations that other libraries document.

EKF:  x <- f(x, u), P <- F P F' + Q;  K = P H'(H P H' + R)^-1, x <- x + K (y - h), P <- (1 - K H) P (1 - K H)' + K R K'.
UKF:  sigma points x +- columns of sqrt((n + lambda) P), lambda = alpha^2 (n + kappa) - n, with the weights of Merwe
      (lambda/(n + lambda), the same + 1 - alpha^2 + beta, 1/(2 (n + lambda))) or of Julier (alpha = 1, beta = 0 in the
      first weight of the covariance), drawn from x, P for the prediction and anew for each update.

A sample that is missing is masked, as in pykalman. Outputs of one sample are taken one after the other, each linearised
(or drawn) after the one before.
"""

from collections.abc import Callable, Iterator

import numpy as np

Array = np.ndarray
Map = Callable[[Array, Array], Array]


def moved(u: Array, first: str, between: str) -> Iterator[tuple[int, Array | None]]:
    """The number of each call and the input of its prediction, None where it does not predict."""
    for k in range(len(u)):
        at_rest = np.zeros(u.shape[1])
        now = u[k] if between == "hold" else u[k - 1] if k else at_rest
        yield k, now if k or first == "predict" else None


def ekf(
    f: Map,
    F: Map,
    h: Callable[[Array], Array],
    H: Callable[[Array], Array],
    Q: Array,
    r: Array,
    x: Array,
    P: Array,
    u: Array,
    y: Array,
    first: str = "update",
    between: str = "line",
) -> tuple[Array, Array]:
    """The estimates (N, n) and covariances (N, n, n) after the samples y (N, p) of variances r (p), NaN if missing."""
    states, covariances = [], []
    for k, now in moved(u, first, between):
        if now is not None:
            slope = F(x, now)
            x, P = f(x, now), slope @ P @ slope.T + Q
        for j in np.flatnonzero(np.isfinite(y[k])):
            row = H(x)[j]
            K = P @ row / (row @ P @ row + r[j])
            x, keep = x + K * (y[k, j] - h(x)[j]), np.eye(len(x)) - np.outer(K, row)
            P = keep @ P @ keep.T + r[j] * np.outer(K, K)
        states.append(x)
        covariances.append(P)
    return np.array(states), np.array(covariances)


def points(x: Array, P: Array, alpha: float, beta: float, kappa: float) -> tuple[Array, Array, Array]:
    """Merwe's scaled sigma points (2n + 1, n), their weights of the mean and of the covariance."""
    n = len(x)
    spread = alpha**2 * (n + kappa)
    steps = np.linalg.cholesky(spread * P).T
    every = np.vstack([x, x + steps, x - steps])
    mean = np.full(2 * n + 1, 1 / (2 * spread))
    mean[0] = 1 - n / spread
    covariance = mean.copy()
    covariance[0] += 1 - alpha**2 + beta
    return every, mean, covariance


def ukf(
    f: Map,
    h: Callable[[Array], Array],
    Q: Array,
    r: Array,
    x: Array,
    P: Array,
    u: Array,
    y: Array,
    alpha: float,
    beta: float,
    kappa: float,
) -> tuple[Array, Array]:
    """The estimates (N, n) and covariances (N, n, n) of the unscented filter."""
    states, covariances = [], []
    for k, now in moved(u, "update", "line"):
        if now is not None:
            every, w, c = points(x, P, alpha, beta, kappa)
            after = np.array([f(point, now) for point in every])
            x = w @ after
            P = (c[:, None] * (after - x)).T @ (after - x) + Q
        for j in np.flatnonzero(np.isfinite(y[k])):
            every, w, c = points(x, P, alpha, beta, kappa)
            read = np.array([h(point)[j] for point in every])
            mean = w @ read
            s = c @ (read - mean) ** 2 + r[j]
            K = (c[:, None] * (every - x)).T @ (read - mean) / s
            x, P = x + K * (y[k, j] - mean), P - s * np.outer(K, K)
        states.append(x)
        covariances.append(P)
    return np.array(states), np.array(covariances)
