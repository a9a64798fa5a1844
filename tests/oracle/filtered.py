"""Astolfi, Jungers, Zaccarian, ECC 2018, in plain numpy: plant (22), the observers (7) and (18), and M of (10)."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

Array = np.ndarray
LOW, HIGH = np.array([-3.0, -4, -6, -12]), np.array([3.0, 4, 6, 12])  # the box to which phi's argument is saturated


def phi(x: Array) -> float:
    """The last line of (22)."""
    return float(-x[3] - 5.2 * x[2] - 2.7 * x[1] + 4.5 * (x[0] ** 2 - 1))


def plant(x: Array) -> Array:
    """(22)."""
    return np.array([x[1], x[2], x[3], phi(x)])


def matrix(L: Array, alpha: float, beta: float) -> Array:
    """M of (10)."""
    n = len(L)
    A, C = np.eye(n, k=1), np.eye(1, n)
    return np.block([[A, np.diag(L)], [-beta * C.T @ C, -alpha * np.eye(n) + beta * A.T]])


def filtered(L: Array, alpha: float, beta: float, k: float) -> Callable[[Array, float], Array]:
    """(7) for plant (22), of (x, eta) and y."""

    def rate(state: Array, y: float) -> Array:
        x, eta = np.split(state, 2)
        moved = np.array([*x[1:], phi(np.clip(x, LOW, HIGH))]) + L * eta
        source = np.array([y - x[0], *eta[:-1]])
        return np.concatenate([moved, -k * alpha * eta + k**2 * beta * source])

    return rate


def injected(N: Array, F: Array, G: Array, H: Array, k: float) -> Callable[[Array, float], Array]:
    """(18) for plant (22)."""
    D = np.diag(k ** np.arange(1.0, 5))

    def rate(state: Array, y: float) -> Array:
        x, eta = state[:4], state[4:]
        moved = np.array([*x[1:], phi(np.clip(x, LOW, HIGH))]) + D @ N @ H @ eta
        return np.concatenate([moved, k * F @ eta + k * G * (y - x[0])])

    return rate


def run(rate: Callable[[Array, float], Array], start: Array, y: Array, dt: float) -> Array:
    """Classical Runge-Kutta with y on the line between samples: states (N, ..) at the samples."""
    state, states = np.array(start), [np.array(start)]
    for before, now in pairwise(y):
        middle = (before + now) / 2
        k1 = rate(state, before)
        k2 = rate(state + dt / 2 * k1, middle)
        k3 = rate(state + dt / 2 * k2, middle)
        state = state + dt / 6 * (k1 + 2 * k2 + 2 * k3 + rate(state + dt * k3, now))
        states.append(state)
    return np.array(states)
