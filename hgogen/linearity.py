"""Whether a row is gain * state + rest: gain of inputs and parameters, rest free of that state.

A slope free of states does not show it: a jump has no slope. A row shows it where nothing in it jumps, bends or is
singular in the state on the box, and the remainder is 0 by exact algebra. Chords refute it: the row's difference
quotients in the state, which must be equal for all values of it and of the other states.
"""

from collections.abc import Iterator
from itertools import islice

import sympy as sp

from hgogen.interval import box as box_of
from hgogen.lipschitz import JUMPS, KINKS
from hgogen.points import exact, kind, points
from hgogen.signal import Signal
from hgogen.singular import singular
from hgogen.system import System

_VALUES = 12  # of the state, for chords
_POINTS = 40  # of the other signals


def rough(row: sp.Expr, state: Signal, plant: System) -> list[sp.Expr]:
    """Parts of the row that may jump, bend or be singular in the state on the box."""
    row = row.xreplace(_fixed(plant))
    parts = {*row.atoms(*JUMPS, *KINKS, sp.AccumBounds), *singular([row], box_of(plant.signals))}
    return sorted((part for part in parts if part.has(state)), key=str)


def is_linear(row: sp.Expr, state: Signal, gain: sp.Expr, rest: sp.Expr) -> bool:
    """Whether row = gain * state + rest by exact algebra; the row is smooth in the state."""
    if rest.has(state, sp.AccumBounds, sp.nan, sp.zoo):
        return False
    gap = row - gain * state - rest
    return bool(sp.expand(gap) == 0 or sp.simplify(gap) == 0)


def matters(row: sp.Expr, state: Signal, plant: System) -> bool:
    """Whether the row differs at two sample points of the box that differ in the state only."""
    return any(_not_zero(chord, plant) for chord in _chords(row, state, plant))


def bent(row: sp.Expr, state: Signal, plant: System) -> bool:
    """Whether two chords differ between sample points of the box of the same inputs and parameters."""
    middle = next(points(plant.states))
    chords = list(_chords(row, state, plant))
    firsts = (chord.xreplace(dict(middle)) for chord in chords)
    first = next((chord for chord in firsts if _finite(chord)), None)
    return first is not None and any(_not_zero(chord - first, plant) for chord in chords)


def differs(one: sp.Expr, other: sp.Expr, plant: System) -> bool:
    """Whether the two have different values at a sample point of the box."""
    return _not_zero(exact((one - other).xreplace(_fixed(plant))), plant)


def chord(row: sp.Expr, state: Signal, plant: System) -> sp.Expr:
    """A gain for a row that is not shown to be linear: a chord in the middle of the other states' ranges, or 0."""
    middle = next(points(plant.states))
    firsts = (chord.xreplace(dict(middle)) for chord in _chords(row, state, plant, {}))
    return next((chord for chord in firsts if _finite(chord)), sp.S.Zero)


def _chords(
    row: sp.Expr, state: Signal, plant: System, fixed: dict[Signal, sp.Rational] | None = None
) -> Iterator[sp.Expr]:
    """Difference quotients in the state between sample values of it."""
    row = exact(row.xreplace(_fixed(plant) if fixed is None else fixed))
    values = list(dict.fromkeys(point[state] for point in islice(points((state,)), _VALUES)))
    for i, a in enumerate(values):
        for b in values[i + 1 :] if i < 2 else ():  # two of them with all others
            try:
                yield (row.xreplace({state: b}) - row.xreplace({state: a})) / (b - a)
            except (ValueError, TypeError):  # a comparison of numbers that SymPy cannot make
                continue


def _fixed(plant: System) -> dict[Signal, sp.Rational]:
    return {p: value for p, value in plant.nominal.items() if not p.bounded}


def _finite(expression: sp.Expr) -> bool:
    return not expression.has(sp.nan, sp.zoo, sp.oo, -sp.oo, sp.AccumBounds, sp.I)


def _not_zero(expression: sp.Expr, plant: System) -> bool:
    if expression == 0 or not _finite(expression):
        return False
    read = tuple(s for s in plant.signals if s in expression.free_symbols)
    return any(kind(expression, point) in ("> 0", "< 0") for point in islice(points(read), _POINTS))
