"""The pendulum in chains of integrators: q' = w, w' = -19.6 sin q - w/10 + u, in plain numpy."""

import numpy as np


def c(w: np.ndarray, u: float) -> np.ndarray:
    """What is nonlinear, at the estimate clamped to |q| <= 4, |w| <= 20."""
    q, rate = np.clip(w[0], -4, 4), np.clip(w[1], -20, 20)
    return np.array([0.0, -19.6 * np.sin(q) - 0.1 * rate + u])


def corrected(w: np.ndarray, u: float, level: float, K: tuple[float, float], injected: float) -> np.ndarray:
    """w' of a high-gain observer of the gain `level` that injects `injected`."""
    return np.array([w[1] + level * K[0] * injected, level**2 * K[1] * injected]) + c(w, u)
