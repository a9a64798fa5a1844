"""Boxes that are cut in two, and the tree of these cuts."""

import numpy as np
from numpy.typing import NDArray

from hgogen.intervals.floats import middle
from hgogen.intervals.outward import Array, Pair

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
