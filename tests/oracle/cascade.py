"""Khalil, Automatica 80 (2017), in plain numpy, in the paper's z; x_i' = x_(i+1) + c_i(x, u), y = x_1."""

from collections.abc import Callable

import numpy as np

Array = np.ndarray
Nonlinear = Callable[[Array, Array], Array]


def estimate(z: Array, alpha: Array, mu: float, c: Nonlinear, low: Array, high: Array, u: Array) -> Array:
    """xhat (n) of z (n); c_(i-1) is subtracted from what estimates x_(i-1)'."""
    n = len(z)
    xhat = np.zeros(n)
    xhat[0] = z[0]
    for i in range(1, n):
        rate = z[1] / mu if i == 1 else alpha[i] / mu * (z[i] + xhat[i - 1])
        xhat[i] = np.clip(rate - c(xhat, u)[i - 1], low[i], high[i])
    return xhat


def cascade(
    alpha: Array, mu: float, c: Nonlinear, low: Array, high: Array
) -> Callable[[Array, Array, Array, Array], Array]:
    """The rate of z."""

    def rate(z: Array, y: Array, valid: Array, u: Array) -> Array:
        xhat, e = estimate(z, alpha, mu, c, low, high, u), valid[0] * (y[0] - z[0])
        slope = np.empty(len(z))
        slope[:2] = (z[1] + alpha[0] * e) / mu, alpha[1] * e / mu
        for i in range(2, len(z)):
            slope[i] = -alpha[i] * (z[i] + xhat[i - 1]) / mu
        return slope

    return rate


def start(w: Array, alpha: Array, mu: float, c: Nonlinear, u: Array) -> Array:
    """z (n) whose estimate is w (n)."""
    rates = w[1:] + c(w, u)[:-1]
    return np.array([w[0], mu * rates[0], *(mu * rates[i - 1] / alpha[i] - w[i - 1] for i in range(2, len(w)))])
