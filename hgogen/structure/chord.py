"""The links of a chain as a form takes them: with signs of the states that make the gains positive, and a difference
quotient in the middle of the box as the gain of a row that is not shown to be linear in a state.
"""

from collections.abc import Iterable
from dataclasses import replace
from itertools import islice

import sympy as sp

from hgogen.algebra.points import STRANGE, exact, points
from hgogen.structure.chain import Link, Shape
from hgogen.structure.positive import sign
from hgogen.system import System

_VALUES = 12  # of the state


def settled(link: Link, shape: Shape, plant: System, measured: sp.Symbol | None = None) -> Link:
    """The link; where it is not shown to have the shape, a chord for the gain, and what that leaves of the row for the
    rest."""
    if link.answer(shape, measured)[0]:
        return link
    gain = _chord(link.row, link.state, plant)
    return replace(link, gain=gain, rest=link.row - gain * link.state)


def _chord(row: sp.Expr, state: sp.Symbol, plant: System) -> sp.Expr:
    """(row(b) - row(a))/(b - a) for the first values a, b of the state at which it is finite, the other states in the
    middle of their ranges; or 0."""
    middle, row = dict(next(points(plant.states))), exact(row)
    values = list(dict.fromkeys(point[state] for point in islice(points((state,)), _VALUES)))
    for i, a in enumerate(values[:2]):
        for b in values[i + 1 :]:
            try:
                slope = (row.xreplace({state: b}) - row.xreplace({state: a})) / (b - a)
            except (ValueError, TypeError):  # a comparison of numbers that SymPy cannot make
                continue
            slope = slope.xreplace(middle)
            if not slope.has(*STRANGE):
                return slope
    return sp.S.Zero


def signs_of(links: Iterable[Link], plant: System) -> list[int]:
    """The sign of each z_i that makes a_i positive; an a_i without one sign stays as it is."""
    signs = [1]
    for link in links:
        signs.append(signs[-1] * (sign(link.gain, plant) or 1))
    return signs[1:]
