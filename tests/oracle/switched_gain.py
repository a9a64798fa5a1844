"""The switched-gain observer of Ahrens, Khalil 2009 on the pendulum, in plain numpy."""

import numpy as np

from oracle import swing


def run(
    u: np.ndarray, y: np.ndarray, dt: float, K: tuple[float, float], gains: tuple[float, float], d: float, count: int
) -> np.ndarray:
    """States (N, 4): estimate (2), gain in force, samples in a row with |e| <= d; the gain is low from `count` on."""

    def rate(x: np.ndarray, u: float, y: float, valid: float) -> np.ndarray:
        e, level = valid * (y - x[0]), x[2]
        return np.array([x[1] + level * K[0] * e, level**2 * K[1] * e, 0, 0]) + np.pad(swing.pendulum(x[:2], u), (0, 2))

    def after(x: np.ndarray, u: float, y: float) -> np.ndarray:
        quiet = x[3]
        if np.isfinite(y):
            quiet = min(quiet + 1, count) if abs(y - x[0]) <= d else 0
        return np.array([x[0], x[1], gains[1] if quiet >= count else gains[0], quiet])

    return swing.run(rate, np.array([0, 0, gains[0], 0]), u, y, dt, after)
