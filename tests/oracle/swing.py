"""Observers of the pendulum by classical Runge-Kutta over a record, with a map after each step; plain numpy.

Input and measurement are on the line between samples. A sample that is missing (NaN) injects nothing; after it the next
one counts for the whole of its period.
"""

from collections.abc import Callable

import numpy as np

Rate = Callable[[np.ndarray, float, float, float], np.ndarray]
Map = Callable[[np.ndarray, float, float], np.ndarray]


def run(rate: Rate, start: np.ndarray, u: np.ndarray, y: np.ndarray, dt: float, after: Map | None = None) -> np.ndarray:
    """States (N, n) at the samples: x' = rate(x, u, y, valid) from `start`; after each step x <- after(x, u, y)."""
    x, found = np.array(start, dtype=float), [np.array(start, dtype=float)]
    for k in range(1, len(y)):
        valid = float(np.isfinite(y[k]))
        now = y[k] if valid else 0.0
        last = y[k - 1] if valid and np.isfinite(y[k - 1]) else now
        middle, half = (u[k - 1] + u[k]) / 2, (last + now) / 2
        k1 = rate(x, u[k - 1], last, valid)
        k2 = rate(x + dt / 2 * k1, middle, half, valid)
        k3 = rate(x + dt / 2 * k2, middle, half, valid)
        k4 = rate(x + dt * k3, u[k], now, valid)
        x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        x = x if after is None else after(x, u[k], y[k])
        found.append(x)
    return np.array(found)


def pendulum(w: np.ndarray, u: float) -> np.ndarray:
    """c(w, u) of q' = w, w' = -19.6 sin q - w/10 + u, at the estimate clamped to |q| <= 4, |w| <= 20."""
    q, rate = np.clip(w[0], -4, 4), np.clip(w[1], -20, 20)
    return np.array([0.0, -19.6 * np.sin(q) - 0.1 * rate + u])
