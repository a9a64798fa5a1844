"""A continuous observer from sample to sample in plain numpy, by classical Runge-Kutta.

The measurement is on the line between two valid samples; a sample after a missing one counts for its whole step, and
one that is missing takes the injection away.
"""

from collections.abc import Callable

import numpy as np

Array = np.ndarray
Rate = Callable[[Array, Array, Array, Array], Array]  # of state, y (p), valid (p), u (m)
Map = Callable[[Array, Array, Array, Array], Array]  # of state, y (p), valid (p), u (m), after each sample


def run(rate: Rate, start: Array, y: Array, dt: float, u: Array | None = None, after: Map | None = None) -> Array:
    """States (N, ..) at the samples of y (N, p), NaN where one is missing; inputs u (N, m) on lines. `after` maps the
    state at each sample but the first."""
    state, states = np.array(start, dtype=float), [np.array(start, dtype=float)]
    u = np.zeros((len(y), 0)) if u is None else u
    for k in range(1, len(y)):
        valid = np.isfinite(y[k]).astype(float)
        now = np.where(valid > 0, y[k], 0.0)
        last = np.where((valid > 0) & np.isfinite(y[k - 1]), y[k - 1], now)

        def slope(
            state: Array, c: float, k: int = k, now: Array = now, last: Array = last, valid: Array = valid
        ) -> Array:
            return rate(state, last + c * (now - last), valid, u[k - 1] + c * (u[k] - u[k - 1]))

        k1 = slope(state, 0.0)
        k2 = slope(state + dt / 2 * k1, 0.5)
        k3 = slope(state + dt / 2 * k2, 0.5)
        k4 = slope(state + dt * k3, 1.0)
        state = state + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        state = state if after is None else after(state, now, valid, u[k])
        states.append(state)
    return np.array(states)
