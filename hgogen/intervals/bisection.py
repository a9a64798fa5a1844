"""Boxes of floats that are cut in two, the tree of these cuts, and points of a box."""

import math

import numpy as np
from numpy.typing import NDArray

from hgogen.intervals.outward import Array, Pair


def middle(low: Array, high: Array) -> Array:
    """The point at which a side is cut: its midpoint; for an unbounded one 0, or beyond 0 twice its end and one."""
    centre = low / 2.0 + high / 2.0
    if np.isfinite(centre).all():
        return np.clip(centre, low, high)
    both = np.isinf(low) & np.isinf(high)
    right, left = np.isinf(high) & ~both, np.isinf(low) & ~both
    centre = np.where(right, np.where(low < 0, 0.0, 2.0 * low + 1.0), centre)
    centre = np.where(left, np.where(high > 0, 0.0, 2.0 * high - 1.0), centre)
    return np.clip(np.where(both, 0.0, centre), low, high)


def spread(m: int, count: int) -> Array:
    """Points (m x count) of the unit cube, evenly spread: multiples of the square roots of primes, modulo 1."""
    primes = [p for p in range(2, 20 * (m + 2)) if all(p % q for q in range(2, math.isqrt(p) + 1))][:m]
    steps = np.sqrt(np.array(primes, dtype=float))[:, None]
    points: Array = np.mod(steps * np.arange(1, count + 1) + 0.5, 1.0)
    return points


def placed(low: Array, high: Array, t: Array) -> Array:
    """Points of the unit cube on the box; an unbounded side is reached by a rational map."""
    low, high = low[:, None], high[:, None]
    t = np.clip(t, 1e-6, 1.0 - 1e-6)
    ends = np.isinf(low), np.isinf(high)
    finite = np.where(ends[0], 0.0, low), np.where(ends[1], 0.0, high)
    x = finite[0] * (1.0 - t) + finite[1] * t
    x = np.where(ends[1] & ~ends[0], finite[0] + t / (1.0 - t), x)
    x = np.where(ends[0] & ~ends[1], finite[1] - t / (1.0 - t), x)
    x = np.where(ends[0] & ends[1], (t - 0.5) / (t * (1.0 - t)), x)
    return np.clip(x, low, high)


def corners(low: Array, high: Array) -> Array:
    """Middle, then up to 64 corners; zero or a large number for an infinite end."""
    m = len(low)
    ends = (
        np.where(np.isinf(low), np.minimum(high, 0.0) - 1e3, low),
        np.where(np.isinf(high), np.maximum(low, 0.0) + 1e3, high),
    )
    codes = np.arange(min(2**m, 64))
    bits = (codes[None, :] >> np.arange(m)[:, None]) & 1
    corners = np.where(bits == 1, ends[1][:, None], ends[0][:, None])
    return np.concatenate((middle(low, high)[:, None], corners), axis=1)


Tree = tuple[object, ...] | str


def halves(low: Array, high: Array, cut: NDArray[np.int64]) -> Pair:
    """The ends (m x 2k) of both children in turn of boxes (m x k), each cut in that variable."""
    columns = np.arange(low.shape[1])
    centre = middle(low, high)[cut, columns]
    low, high = np.repeat(low, 2, axis=1), np.repeat(high, 2, axis=1)
    high[cut, 2 * columns] = centre
    low[cut, 2 * columns + 1] = centre
    return low, high


def split_tree(splits: list[tuple[int, int]]) -> Tree:
    """Nested ("split", variable, left, right) and "leaf"; node 0 is the root, the j-th split makes 2j+1 and 2j+2."""
    made: dict[int, Tree] = {}
    for j in range(len(splits) - 1, -1, -1):
        node, variable = splits[j]
        made[node] = ("split", variable, made.pop(2 * j + 1, "leaf"), made.pop(2 * j + 2, "leaf"))
    return made.get(0, "leaf")
