"""Norms |e| of vectors of intervals, and the directions e_i/|e|, which at e = 0 are sets."""

from collections.abc import Sequence
from functools import reduce

import numpy as np

from hgogen.intervals import outward
from hgogen.intervals.outward import Array, Pair, add, multiply, power, reciprocal


def size(parts: Sequence[Pair]) -> Pair:
    """|e|."""
    return outward.square_root(reduce(add, (power(a, 2) for a in parts)))


def direction(parts: Sequence[Pair], index: int, wide: bool) -> Pair:
    """The range of e_i/|e|; of a `wide` box without what it is at its faces alone: slopes there are limits from within.

    It rises with e_i, and falls with the size of the others where e_i > 0, rises with it where e_i < 0.
    """
    low, high = parts[index]
    zero = np.zeros(low.shape)
    rest = reduce(add, (power(a, 2) for i, a in enumerate(parts) if i != index), (zero, zero))
    alone = np.full(low.shape, len(parts) == 1)
    below, above = _share(np.stack((low, low, high, high)), np.stack((*rest, *rest)))
    least = np.where(low < 0, below[0], np.where(alone, 1.0, below[1]))
    most = np.where(high > 0, above[2], np.where(alone, -1.0, above[3]))
    free = (low <= 0) & (high >= 0) & (rest[0] <= 0)  # e may be 0
    least = np.where(free, np.where(low < 0, -1.0, np.where(alone, 1.0, 0.0)), least)
    most = np.where(free, np.where(high > 0, 1.0, np.where(alone, -1.0, 0.0)), most)
    within = wide & (low < high)
    return np.where(free & ~within, -1.0, least), np.where(free & ~within, 1.0, most)


def _share(e: Array, rest: Array) -> Pair:
    """e/sqrt(e^2 + rest), between -1 and 1; not for e = rest = 0."""
    whole = outward.square_root(add(power((e, e), 2), (rest, rest)))
    low, high = multiply((e, e), reciprocal(whole))
    far = np.isinf(e)
    return np.where(far, -1.0, np.maximum(low, -1.0)), np.where(far, 1.0, np.minimum(high, 1.0))
