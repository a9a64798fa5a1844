"""The zero set of the observability determinant with the inputs at 0, by exact algebra: for a library of models."""

from collections.abc import Sequence

import sympy as sp

from hgogen.algebra.elimination import Row, codistribution_product, tower
from hgogen.algebra.factors import ROUGH, branches, powers, split_roots
from hgogen.algebra.rank import NowhereDefined, believe_zeros, matrix_rows, modulus, new_rows, plant_of, somewhere
from hgogen.algebra.rewrite import TooLarge
from hgogen.algebra.series import Arithmetic, Point, first_gradients
from hgogen.algebra.tape import NoTape
from hgogen.analysis.determinant import alive, zero_set

LIMIT = 300_000  # products of terms of the elimination


def singular_set(
    flow: Sequence[sp.Expr],
    output: Sequence[sp.Expr],
    states: Sequence[sp.Symbol],
    inputs: Sequence[sp.Symbol] = (),
    limit: int = LIMIT,
) -> tuple[sp.Expr, ...] | str | None:
    """Factors whose zero sets together are that of det d(h, L_f h, .., L_f^(n-1) h)/dx with the inputs at 0.

    "none": it has no zero; "all": it is 0 everywhere, at random numbers as generic ranks are. With several outputs the
    rows are taken until they have rank n; whether all outputs come before the next derivative, or all derivatives
    before the next output, must make no difference. Parameters are symbols, and a factor of them is one.

    None: no answer, because it does make one, for a function with kinks, roots that depend on each other, or beyond
    `limit` products of terms.
    """
    off = dict.fromkeys(inputs, sp.S.Zero)
    drift, h = ([sp.sympify(e).subs(off) for e in rows] for rows in (flow, output))
    if any(e.has(*ROUGH) for e in (*drift, *h)):
        return None
    try:
        choices = _choices(drift, h, states)
        full = all(len(rows) == len(states) for rows in choices)
        if not full and all(p.exp.is_Integer for e in (*drift, *h) for p in e.atoms(sp.Pow)):
            return "all"
        plant = tower(drift, h, states)
        if branches(plant.field):
            return None
        if not full:
            return "all"
        zero_sets = set()
        for rows in {frozenset(rows): rows for rows in choices}.values():  # of those in another order one
            factors = codistribution_product(plant, rows, limit)
            if not alive(plant.field, factors):
                return None
            zero_sets.add(zero_set(plant.field, split_roots(plant.field, powers(plant.field, factors)[1])))
    except (TooLarge, NoTape, NowhereDefined, ZeroDivisionError):
        return None
    one = zero_sets.pop()
    return None if zero_sets else "none" if one == () else one


def _choices(flow: Sequence[sp.Expr], output: Sequence[sp.Expr], states: Sequence[sp.Symbol]) -> list[tuple[Row, ...]]:
    """The first independent rows, by order of derivative and by output, at a random point."""
    plant, _ = plant_of(flow, output, states, ())
    n = len(states)
    by_order = [(j, k) for k in range(n) for j in range(len(output))]

    def chosen(numbers: Arithmetic, point: Point) -> list[tuple[Row, ...]]:
        every = [matrix_rows(matrix) for matrix in first_gradients(plant, numbers, point, n)]
        prime = modulus(numbers)
        choices = []
        for order in (by_order, sorted(by_order)):
            new = new_rows([every[k][j] for j, k in order], prime)
            choices.append(tuple(order[i] for i in new))
        if any(len(rows) < n for rows in choices):
            believe_zeros(prime)
        return choices

    return somewhere(plant, chosen)
