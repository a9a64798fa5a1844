"""A gain for a row that is not shown to be linear in a state: a difference quotient in the middle of the box."""

from collections.abc import Iterator
from itertools import islice

import sympy as sp

from hgogen.algebra.points import exact, points
from hgogen.signal import Signal
from hgogen.system import System

_VALUES = 12  # of the state


def chord(row: sp.Expr, state: Signal, plant: System) -> sp.Expr:
    """(row(b) - row(a))/(b - a) for the first values a, b of the state at which it is finite, the other states in the
    middle of their ranges; or 0.
    """
    middle = next(points(plant.states))
    rates = (slope.xreplace(dict(middle)) for slope in _slopes(exact(row), state))
    return next(
        (slope for slope in rates if not slope.has(sp.nan, sp.zoo, sp.oo, -sp.oo, sp.AccumBounds, sp.I)), sp.S.Zero
    )


def _slopes(row: sp.Expr, state: Signal) -> Iterator[sp.Expr]:
    values = list(dict.fromkeys(point[state] for point in islice(points((state,)), _VALUES)))
    for i, a in enumerate(values[:2]):
        for b in values[i + 1 :]:
            try:
                yield (row.xreplace({state: b}) - row.xreplace({state: a})) / (b - a)
            except (ValueError, TypeError):  # a comparison of numbers that SymPy cannot make
                continue
