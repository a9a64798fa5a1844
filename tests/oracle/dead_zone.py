"""The dead-zone observer of Astolfi, Alessandri, Zaccarian 2021 on the pendulum, in plain numpy."""

import numpy as np

from oracle import swing


def run(
    u: np.ndarray, y: np.ndarray, dt: float, K: tuple[float, float], theta: float, decay: float, r: float
) -> np.ndarray:
    """States (N, 3): estimate (2), sigma, from 0."""

    def rate(x: np.ndarray, u: float, y: float, valid: float) -> np.ndarray:
        e = valid * (y - x[0])
        taken = np.sign(e) * max(abs(e) - np.sqrt(max(x[2], 0)), 0)
        linear = np.array([x[1] + theta * K[0] * taken, theta**2 * K[1] * taken, theta * (r * e * e - decay * x[2])])
        return linear + np.pad(swing.pendulum(x[:2], u), (0, 1))

    return swing.run(rate, np.zeros(3), u, y, dt)
