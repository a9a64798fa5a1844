"""The determinant of quotients without a division: by minors of the first k rows, each from those of k - 1.

M_k(S) = sum_(j in S) +- a_kj M_(k-1)(S without j)        S: k columns
"""

from collections.abc import Sequence
from itertools import combinations
from typing import Any

from hgogen.algebra.elimination import Work
from hgogen.algebra.field import Field
from hgogen.algebra.quotient import Quotient, add, multiply
from hgogen.algebra.relations import reduced


def expanded(field: Field, rows: Sequence[Sequence[Quotient]], work: Work) -> Quotient:
    """The determinant of n x n quotients, reduced by the roots' relations.

    Raises: `TooLarge`.
    """
    one = field.ring.constant(1)
    minors: dict[tuple[int, ...], Quotient] = {(): (one, one)}
    for k, row in enumerate(rows):
        minors = {
            columns: _minor(field, row, columns, minors, work) for columns in combinations(range(len(rows)), k + 1)
        }
    return minors[tuple(range(len(rows)))]


def _minor(
    field: Field,
    row: Sequence[Quotient],
    columns: tuple[int, ...],
    minors: dict[tuple[int, ...], Quotient],
    work: Work,
) -> Quotient:
    total: Quotient = field.ring.constant(0), field.ring.constant(1)
    for place, j in enumerate(columns):
        other = minors[columns[:place] + columns[place + 1 :]]
        work.spend(1 + sum(len(a) * len(b) for a, b in zip(row[j], other, strict=True)))
        term = multiply(row[j], other)
        total = add(total, term if (place + len(columns)) % 2 else (-term[0], term[1]))
    top, bottom = total
    for root in reversed(field.relations):
        (top,), power = reduced([top], root.index, root.degree, root.value)
        bottom = bottom * root.value[1] ** power
    one: Any = field.ring.constant(1)
    return multiply((top, one), (one, bottom))
