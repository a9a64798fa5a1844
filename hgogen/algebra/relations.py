"""Whether an expression is zero by exact algebra: its numerator, reduced by the relations of its generators."""

from typing import Any

import sympy as sp

from hgogen.algebra.quotient import Quotient, power, quotients, ring_of, times
from hgogen.algebra.rewrite import TooLarge, rational
from hgogen.algebra.tape import NoTape


def vanishes(expression: sp.Expr) -> bool | None:
    """True: zero wherever it is defined. False: a rational function of symbols that is zero nowhere on a dense
    open set, and defined there. None: not decided. The numbers are exact.

    Source: normal forms of rational functions over a tower of radicals; B. F. Caviness, R. J. Fateman,
    "Simplification of radical expressions", SYMSAC 1976.
    """
    try:
        form = rational(expression)
        parts = (form.value, *(relation.value for relation in form.relations))
        (top, _), *values = quotients(parts, form.generators, ring_of(form.generators))
        for relation, value in reversed(list(zip(form.relations, values, strict=True))):
            (top,), _ = reduced([top], form.generators.index(relation.generator), relation.degree, value)
    except (TooLarge, ZeroDivisionError, NoTape):
        return None
    if top.is_zero():
        return True
    return False if set(form.generators) <= expression.free_symbols else None


def reduced(row: list[Any], index: int, degree: int, value: Quotient) -> tuple[list[Any], int]:
    """The polynomials with generator^degree replaced by a quotient, times a power of its denominator, and that power.

    Raises: `TooLarge`.
    """
    ring = row[0].context()
    most = max((int(powers[index]) // degree for top in row for powers in top.monoms()), default=0)
    if not most:
        return row, 0
    weights = [times(power(value[0], t), power(value[1], most - t)) for t in range(most + 1)]
    replaced = []
    for top in row:
        layers: dict[int, dict[tuple[int, ...], Any]] = {}
        for powers, coefficient in top.to_dict().items():
            t, left = divmod(int(powers[index]), degree)
            rest = tuple(left if i == index else int(k) for i, k in enumerate(powers))
            layers.setdefault(t, {})[rest] = coefficient
        replaced.append(
            sum((times(ring.from_dict(terms), weights[t]) for t, terms in layers.items()), ring.constant(0))
        )
    return replaced, most
