"""Alessandri 2020, (18) with Hessian 2 Pi, in plain numpy; one classical Runge-Kutta step, y on the line.

    xhat' = f + Pi^-1 h_x'R (y - h)
    Pi'   = -Pi f_x - f_x'Pi - Pi Q^-1 Pi + h_x'R h_x - s sum_j [R (y - h)]_j d2h_j

s = 1 without a rate, else rate/max(rate, |the eigenvalues of Pi^-1 (..)|_2).
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Model:
    """f (n), h (p) of x with their derivatives: (n, n), (p, n), (p, n, n)."""

    f: Callable[[Array], Array]
    f_x: Callable[[Array], Array]
    h: Callable[[Array], Array]
    h_x: Callable[[Array], Array]
    h_xx: Callable[[Array], Array]


@dataclass(frozen=True)
class Estimator:
    """The weights Q, R; `rate`: None for the term as it is, 0 for none."""

    model: Model
    Q: Array
    R: Array
    rate: float | None = 0.0

    def slope(self, x: Array, Pi: Array, y: Array) -> tuple[Array, Array]:
        """xhat', Pi'."""
        m = self.model
        F, C, weighted = m.f_x(x), m.h_x(x), self.R @ (y - m.h(x))
        D = np.einsum("j,jkl->kl", weighted, m.h_xx(x))
        if self.rate is not None:
            size = np.linalg.norm(np.linalg.eigvals(np.linalg.solve(Pi, D)))
            D = D * (self.rate / max(self.rate, size) if self.rate else 0.0)
        rate = -Pi @ F - F.T @ Pi - Pi @ np.linalg.inv(self.Q) @ Pi + C.T @ self.R @ C - D
        return m.f(x) + np.linalg.solve(Pi, C.T @ weighted), rate

    def run(self, x: Array, Pi: Array, y: Array, dt: float) -> tuple[Array, Array]:
        """x (N, n), Pi (N, n, n) at the samples y (N, p); the first takes no time."""
        xs, Pis = [x], [Pi]
        for last, now in pairwise(y):
            x, Pi = self._step(x, Pi, last, now, dt)
            xs.append(x)
            Pis.append(Pi)
        return np.array(xs), np.array(Pis)

    def _step(self, x: Array, Pi: Array, last: Array, now: Array, dt: float) -> tuple[Array, Array]:
        middle = (last + now) / 2
        a, A = self.slope(x, Pi, last)
        b, B = self.slope(x + dt / 2 * a, Pi + dt / 2 * A, middle)
        c, C = self.slope(x + dt / 2 * b, Pi + dt / 2 * B, middle)
        d, D = self.slope(x + dt * c, Pi + dt * C, now)
        return x + dt / 6 * (a + 2 * b + 2 * c + d), Pi + dt / 6 * (A + 2 * B + 2 * C + D)
