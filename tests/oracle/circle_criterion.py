"""The observer of Arcak and Kokotovic (Automatica 37, 2001), (5), in plain numpy, with powers of theta."""

from collections.abc import Callable, Sequence

import numpy as np

Array = np.ndarray


def circle_criterion(
    K: Sequence[Array], N: Sequence[Array], theta: float, A: Array, C: Array, b: Callable[[Array, Array], Array]
) -> Callable[[Array, Array, Array, Array], Array]:
    """z' = A z + b(z + sum_i diag(1, theta, ..) N_i e_i, u) + sum_i diag(theta, .., theta^n_i) K_i e_i, e = y - C z,
    K_i and N_i on the rows of chain i; b takes its argument clamped by the caller."""

    def rate(z: Array, y: Array, valid: Array, u: Array) -> Array:
        e = valid * (y - C @ z)
        pushed = [theta ** np.arange(1, len(k) + 1) * k * e[i] for i, k in enumerate(K)]
        beside = [theta ** np.arange(len(n)) * n * e[i] for i, n in enumerate(N)]
        return A @ z + b(z + np.concatenate(beside), u) + np.concatenate(pushed)

    return rate
