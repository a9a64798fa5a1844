"""A table on intervals: the exact ranges of the cells that they meet, rounded outward.

Of a box that ends on a breakpoint the cell within counts, of an argument that is one number, a breakpoint, both cells.
Of a table that a program takes (`taken`) that is the cell above, of such a box as well.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hgogen.algebra.axis import Ends
from hgogen.algebra.cells import Cells, Index
from hgogen.intervals.outward import Pair, number

Flags = NDArray[np.bool_]


def apply(cells: Cells, order: Index, place: Sequence[Pair]) -> tuple[Pair, Flags, Flags]:
    """The range of a derivative of a table where its arguments are in these intervals, with all its limits where it
    jumps; whether it is bounded there, and along which axes, a row for each, it is continuous."""
    sides = [zip(low.tolist(), high.tolist(), strict=True) for low, high in place]
    rows = [_on(cells, order, box) for box in zip(*sides, strict=True)]
    low, high, bounded, continuous = zip(*rows, strict=True)
    return (np.array(low), np.array(high)), np.array(bounded), np.array(continuous).T


@lru_cache(maxsize=1 << 16)  # boxes of a bisection share ends, and a slope asks for the cells again
def _on(cells: Cells, order: Index, box: tuple[Ends, ...]) -> tuple[float, float, bool, tuple[bool, ...]]:
    range, continuous = cells.limits(box, order)
    if range is None:
        return -np.inf, np.inf, False, (False,) * len(order)
    least, most = (end if isinstance(end, float) else number(end)[way] for way, end in enumerate(range))
    return least, most, True, continuous
