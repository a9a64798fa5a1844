"""The switched-gain observer of Ahrens, Khalil 2009 on the pendulum, in plain numpy."""

import numpy as np

from oracle import sampled
from oracle.swing import corrected

Array = np.ndarray


def run(
    u: Array, y: Array, dt: float, K: tuple[float, float], gains: tuple[float, float], d: float, count: int
) -> Array:
    """States (N, 4): estimate (2), gain in force, samples in a row with |e| <= d; the gain is low from `count` on."""

    def rate(x: Array, y: Array, valid: Array, u: Array) -> Array:
        return np.append(corrected(x[:2], u[0], x[2], K, valid[0] * (y[0] - x[0])), [0, 0])

    def after(x: Array, y: Array, valid: Array, u: Array) -> Array:
        quiet = x[3]
        if valid[0]:
            quiet = min(quiet + 1, count) if abs(y[0] - x[0]) <= d else 0
        return np.array([x[0], x[1], gains[1] if quiet >= count else gains[0], quiet])

    return sampled.run(rate, np.array([0, 0, gains[0], 0]), y, dt, u, after)
