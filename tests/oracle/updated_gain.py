"""The updated-gain observer of Andrieu, Praly, Astolfi 2009 on the pendulum, in plain numpy."""

import numpy as np

from oracle import sampled
from oracle.swing import corrected

Array = np.ndarray


def slope(w: Array, L: float) -> float:
    """|diag(L, L^2)^-1 dc/dw diag(L, L^2)|_F at the estimate clamped to its ranges."""
    J = np.array([[0, 0], [-19.6 * np.cos(np.clip(w[0], -4, 4)), -0.1]])
    D = np.diag([L, L**2])
    return float(np.linalg.norm(np.linalg.inv(D) @ J @ D))


def run(u: Array, y: Array, dt: float, K: tuple[float, float], p: tuple[float, float, float], start: float) -> Array:
    """States (N, 3): estimate (2), gain L, which moves by its law with Gamma held over a sample, in ten Runge-Kutta
    steps."""

    def rate(x: Array, y: Array, valid: Array, u: Array) -> Array:
        return np.append(corrected(x[:2], u[0], x[2], K, valid[0] * (y[0] - x[0])), 0)

    def after(x: Array, y: Array, valid: Array, u: Array) -> Array:
        L, gamma, h = x[2], slope(x[:2], x[2]), dt / 10

        def law(L: float) -> float:
            return L * (p[0] * (p[1] - L) + p[2] * gamma)

        for _ in range(10):
            k1 = law(L)
            k2 = law(L + h / 2 * k1)
            k3 = law(L + h / 2 * k2)
            L = L + h / 6 * (k1 + 2 * k2 + 2 * k3 + law(L + h * k3))
        return np.array([x[0], x[1], L])

    return sampled.run(rate, np.array([0, 0, start]), y, dt, u, after)
