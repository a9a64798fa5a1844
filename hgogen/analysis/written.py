"""What a plant reads as it is written, which its rows may no longer have where it is recast."""

import sympy as sp

from hgogen.intervals.lost import put_apart
from hgogen.system import System


def written(plant: System) -> tuple[sp.Expr, ...]:
    """The rows of the plant, and each part of those of the plant that it was recast from, in its own states.

    x1 - x2 over 2 x1 - 2 x2 has no value at x1 = x2; with x1 = w + x2 SymPy makes 1/2 of it.
    """
    rows = (*plant.flow, *plant.output)
    if plant.origin is None:
        return rows
    before = plant.origin.plant
    back = dict(zip(before.states, plant.origin.backward, strict=True))
    return (*rows, *put_apart(written(before), lambda part: part.xreplace(back)))
