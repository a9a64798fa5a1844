"""The standard high-gain observer in plain numpy (Gauthier, Hammouri, Othman 1992; Astolfi et al. 2018, (3))."""

from collections.abc import Callable, Sequence

import numpy as np

Array = np.ndarray


def high_gain(
    K: Sequence[Array],
    theta: float,
    A: Callable[[Array], Array],
    C: Callable[[Array], Array],
    b: Callable[[Array, Array], Array],
) -> Callable[[Array, Array, Array, Array], Array]:
    """z' = A(u) z + b(z, u) + sum_i diag(theta, .., theta^n_i) K_i (y_i - C_i(u) z), K_i on the rows of chain i."""
    sizes = [len(k) for k in K]

    def rate(z: Array, y: Array, valid: Array, u: Array) -> Array:
        e = valid * (y - C(u) @ z)
        pushed = [theta ** np.arange(1, size + 1) * k * e[i] for i, (k, size) in enumerate(zip(K, sizes, strict=True))]
        return A(u) @ z + b(z, u) + np.concatenate(pushed)

    return rate
