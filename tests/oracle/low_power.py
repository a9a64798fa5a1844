"""Astolfi, Marconi, IEEE TAC 60 (2015), and Astolfi, Marconi, Praly, Teel, Automatica 98 (2018), in plain numpy.

x_i' = x_(i+1) + c_i(x, u), x_n' = c_n(x, u), y = x_1; c takes its argument clamped by the caller.
"""

from collections.abc import Callable

import numpy as np

Array = np.ndarray
Nonlinear = Callable[[Array, Array], Array]


def low_power(k: Array, theta: float, c: Nonlinear) -> Callable[[Array, Array, Array, Array], Array]:
    """The rate of xi = ((p_1, q_1), .., (p_(n-1), q_(n-1))), flattened: the paper's block form."""
    m = len(k)

    def rate(state: Array, y: Array, valid: Array, u: Array) -> Array:
        xi = state.reshape(m, 2)
        terms = c(np.array([xi[0, 0], *xi[:, 1]]), u)
        slope = np.empty((m, 2))
        for i in range(m):
            e = valid[0] * (y[0] - xi[0, 0]) if i == 0 else xi[i - 1, 1] - xi[i, 0]
            above = xi[i + 1, 1] if i + 1 < m else 0.0
            slope[i] = xi[i, 1] + terms[i] + theta * k[i, 0] * e, above + terms[i + 1] + theta**2 * k[i, 1] * e
        return slope.reshape(-1)

    return rate


def peaking_free(
    k: Array, last: float, theta: float, c: Nonlinear, low: Array, high: Array
) -> Callable[[Array, Array, Array, Array], Array]:
    """The rate of (xhat_1, .., xhat_n, eta_1, .., eta_(n-1)); `low`, `high` (n): the saturation of eta_i is at those of
    x_(i+1)."""
    n = len(k) + 1

    def rate(state: Array, y: Array, valid: Array, u: Array) -> Array:
        xhat, eta = state[:n], state[n:]
        sat = np.clip(eta, low[1:], high[1:])
        terms = c(xhat, u)
        dx, deta = np.empty(n), np.empty(n - 1)
        for i in range(n - 1):
            e = valid[0] * (y[0] - xhat[0]) if i == 0 else sat[i - 1] - xhat[i]
            above = sat[i + 1] if i + 1 < n - 1 else 0.0
            dx[i] = eta[i] + terms[i] + theta * k[i, 0] * e
            deta[i] = above + terms[i + 1] + theta**2 * k[i, 1] * e
        dx[-1] = terms[-1] + theta * last * (sat[-1] - xhat[-1])
        return np.concatenate([dx, deta])

    return rate
