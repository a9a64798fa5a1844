"""The high gain on the uniform form in plain numpy (Hammouri, Farza 2003), F on a line beyond the ranges [-1, 1]."""

from collections.abc import Callable, Sequence

import numpy as np

Array = np.ndarray


def uniform_injection(
    K: Array,
    theta: float,
    F: Callable[[Array, float], Array],
    slopes: Callable[[Array], Sequence[float]],
    beyond: Sequence[float],
) -> Callable[[Array, float, float], Array]:
    """z' = F(z, u) + Lambda^-1 diag(theta, .., theta^n) K (y - z_1), Lambda = diag(1, F_1', F_1' F_2', ..); the slopes
    F_k' at the clamped z, and those `beyond` the ranges, in z_(k+1)."""

    def rate(z: Array, u: float, y: float) -> Array:
        held = np.clip(z, -1, 1)
        line = np.append(np.array(beyond) * (z - held)[1:], 0)
        weights = np.concatenate([[1.0], np.cumprod(slopes(held))])
        return F(held, u) + line + theta ** np.arange(1, len(K) + 1) * K / weights * (y - z[0])

    return rate
