"""The linear error of an observer behind a saturation or a dead zone, in scaled coordinates, at l = 1."""

from collections.abc import Callable

import numpy as np


def falls(poles: tuple[float, ...], decay: float, r: float, seed: int, inject: Callable[[float, float], float]) -> bool:
    """Whether |eps| + sqrt sigma falls below 1e-2 of what it was within 100 units of time; from a random eps(0) and
    sigma(0), by Runge-Kutta."""
    n, K, rng = len(poles), np.poly(poles)[1:], np.random.default_rng(seed)
    A = np.diag(np.ones(n - 1), 1)

    def rate(x: np.ndarray) -> np.ndarray:
        injected = inject(x[0], np.sqrt(max(x[n], 0)))
        return np.append(A @ x[:n] - K * injected, r * x[0] ** 2 - decay * x[n])

    start = x = np.append(rng.standard_normal(n), rng.choice([0, 0.01, 1, 100]))
    h = 0.5 / max(3.0, decay)
    for _ in range(round(100 / h)):
        k1 = rate(x)
        k2 = rate(x + h / 2 * k1)
        k3 = rate(x + h / 2 * k2)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3))

    def size(x: np.ndarray) -> float:
        return float(np.linalg.norm(x[:n]) + np.sqrt(max(x[n], 0)))

    return size(x) < 1e-2 * size(start)
