"""What of a row needs no clamp: its linear terms, and an end of a range beyond which it goes on in one direction."""

from collections.abc import Iterable, Sequence

import sympy as sp

from hgogen.intervals.box import box
from hgogen.intervals.glance import contains_zero, enclose
from hgogen.program import INF
from hgogen.signal import Signal


def split(expression: sp.Expr, states: Sequence[sp.Symbol]) -> tuple[sp.Expr, sp.Expr]:
    """The sum of the terms that are linear in a state with a coefficient free of states, and the rest."""
    linear: list[sp.Expr] = []
    rest: list[sp.Expr] = []
    for term in sp.Add.make_args(sp.expand_mul(expression)):
        _, factor = term.as_independent(*states, as_Add=False)
        (linear if factor in states else rest).append(term)
    return sp.Add(*linear), sp.Add(*rest)


def reach(rows: Iterable[sp.Expr], state: Signal, states: Iterable[Signal]) -> tuple[float, float]:
    """The state's range, without an end beyond which every row that reads the state goes on in one direction."""
    slopes = [sp.diff(row, state) for row in rows if state in row.free_symbols]
    around, (low, high) = box(states), state.interval

    def turns(beyond: tuple[float, float]) -> bool:
        return any(contains_zero(enclose(slope, {**around, state: beyond})) for slope in slopes)

    return (low if turns((-INF, low)) else -INF), (high if turns((high, INF)) else INF)
