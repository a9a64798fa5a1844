"""A table on intervals: the exact ranges of the cells that they meet, rounded outward.

Of a box that ends on a breakpoint the cell within counts, of an argument that is one number, a breakpoint, both cells.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hgogen.algebra.cells import Cells
from hgogen.intervals.outward import Pair, number

Flags = NDArray[np.bool_]


def apply(cells: Cells, order: int, a: Pair) -> tuple[Pair, Flags, Flags]:
    """The range of a derivative of a table on a, with both its limits where it jumps; whether it is bounded there, and
    whether it is continuous."""
    rows = [_on(cells, order, low, high) for low, high in zip(a[0].tolist(), a[1].tolist(), strict=True)]
    low, high, bounded, continuous = zip(*rows, strict=True)
    return (np.array(low), np.array(high)), np.array(bounded), np.array(continuous)


@lru_cache(maxsize=1 << 16)  # boxes of a bisection share ends, and a slope asks for the cells again
def _on(cells: Cells, order: int, low: float, high: float) -> tuple[float, float, bool, bool]:
    range = cells.range(low, high, order)
    if range is None:
        return -np.inf, np.inf, False, False
    least, most = (end if isinstance(end, float) else number(end)[way] for way, end in enumerate(range))
    return least, most, True, cells.least_smooth(*cells.met(low, high)) > order
