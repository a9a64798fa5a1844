"""Rows of polynomials over a field, each reduced by the rows before it without fractions; the determinant as a product.

w_k = c_k (given row k  -  a combination of the rows before)   =>   det = +- prod pivots / prod c_k
"""

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field as attribute
from functools import reduce
from typing import Any

from hgogen.algebra.field import Field
from hgogen.algebra.quotient import Quotient
from hgogen.algebra.relations import reduced
from hgogen.algebra.rewrite import TooLarge

Product = list[tuple[Any, int]]  # polynomials and their powers
_COMMON = 1000  # terms of a common denominator


@dataclass(frozen=True)
class Work:
    """Products of terms that may still be formed."""

    left: list[int]

    def times(self, a: Any, b: Any) -> Any:
        """a b.

        Raises: `TooLarge`.
        """
        self.spend(len(a) * len(b))
        return a * b

    def spend(self, terms: int) -> None:
        """Count products of terms.

        Raises: `TooLarge`.
        """
        self.left[0] -= terms
        if self.left[0] < 0:
            raise TooLarge("the matrix")


@dataclass(frozen=True)
class Elimination:
    """`pivots`: (column, reduced row), as they come."""

    field: Field
    work: Work
    pivots: list[tuple[int, list[Any]]] = attribute(default_factory=list)

    @property
    def odd(self) -> bool:
        """Whether the pivots' columns are an odd permutation."""
        columns = [column for column, _ in self.pivots]
        return sum(a > b for i, a in enumerate(columns) for b in columns[i + 1 :]) % 2 == 1

    @property
    def pivot(self) -> Any:
        """The pivot of the last row."""
        column, row = self.pivots[-1]
        return row[column]

    def added(self, row: list[Any]) -> tuple[list[Any], Product]:
        """The row without what the rows before make up, now one of them, and by what it was multiplied.

        Raises: `TooLarge`; `ZeroDivisionError` for a row that is a combination.
        """
        scales: Product = []
        row = self._plain(row, scales)
        for column, before in self.pivots:
            if not row[column].is_zero():
                self.work.spend(len(row[column]) * len(before[column]))
                shared = row[column].gcd(before[column])
                own, other = before[column] / shared, row[column] / shared
                row = [self.work.times(own, a) - self.work.times(other, b) for a, b in zip(row, before, strict=True)]
                scales.append((own, 1))
                row = self._plain(row, scales)
        present = [i for i, entry in enumerate(row) if not entry.is_zero()]
        if not present:
            raise ZeroDivisionError
        self.pivots.append((min(present, key=lambda i: len(row[i])), row))
        return row, scales

    def _plain(self, row: list[Any], scales: Product) -> list[Any]:
        """The row reduced by the roots' relations, without the common factor of its entries."""
        for root in reversed(self.field.relations):
            row, power = reduced(row, root.index, root.degree, root.value)
            scales.append((root.value[1], power))
        entries = sorted((entry for entry in row if not entry.is_zero()), key=len)
        if not entries:
            return row
        self.work.spend(sum(map(len, entries)))
        shared = reduce(lambda a, b: a if a.is_constant() else a.gcd(b), entries)
        scales.append((shared, -1))
        return [entry / shared for entry in row]


def cleared(rows: Sequence[Sequence[Quotient]]) -> tuple[Any, list[list[Any]]]:
    """The least common denominator, and the rows times it.

    Raises: `TooLarge`.
    """
    common = rows[0][0][1].context().constant(1)
    for row in rows:
        for _, bottom in row:
            common = common * (bottom / common.gcd(bottom))
            if len(common) > _COMMON:
                raise TooLarge("the common denominator")
    return common, [[top * (common / bottom) for top, bottom in row] for row in rows]
