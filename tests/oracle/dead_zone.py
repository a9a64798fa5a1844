"""The dead-zone observer of Astolfi, Alessandri, Zaccarian 2021 on the pendulum, in plain numpy."""

import numpy as np

from oracle import sampled
from oracle.swing import corrected

Array = np.ndarray


def run(u: Array, y: Array, dt: float, K: tuple[float, float], theta: float, decay: float, r: float) -> Array:
    """States (N, 3): estimate (2), sigma, from 0."""

    def rate(x: Array, y: Array, valid: Array, u: Array) -> Array:
        e, most = valid[0] * (y[0] - x[0]), np.sqrt(max(x[2], 0))
        injected = np.sign(e) * max(abs(e) - most, 0)
        return np.append(corrected(x[:2], u[0], theta, K, injected), theta * (r * e * e - decay * x[2]))

    return sampled.run(rate, np.zeros(3), y, dt, u)
