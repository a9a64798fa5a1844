"""The determinant of the observability matrix as a product, by elimination between the Lie derivatives.

    w_0 = dh,   w_(k+1) = c_k (L_f w_k  modulo the rows before),   L_f w = f . dw/dx + w df/dx

What is subtracted from w_k is a combination of rows before it, whose Lie derivatives are combinations of rows before
w_(k+1): so every w_k may be reduced by elimination and scaled at once, and

    det d(h, L_f h, ..)/dx = +- prod pivots / prod scales,   a scale of w_k counted for w_k and all its successors.

Source: the observability codistribution, R. Hermann, A. Krener, IEEE TAC 22 (1977); fraction-free elimination.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import Any

from hgogen.algebra import reduced
from hgogen.quotient import Quotient, add, multiply
from hgogen.rewrite import TooLarge
from hgogen.tower import Tower

Row = tuple[int, int]  # (output, order of the derivative), both from 0
Product = list[tuple[Any, int]]  # polynomials and their powers


@dataclass(frozen=True)
class _Work:
    """Products of terms that may still be formed."""

    left: list[int]

    def times(self, a: Any, b: Any) -> Any:
        self.spend(len(a) * len(b))
        return a * b

    def spend(self, terms: int) -> None:
        self.left[0] -= terms
        if self.left[0] < 0:
            raise TooLarge("the observability matrix")


@dataclass(frozen=True)
class _Elimination:
    """`common` times the flow and its Jacobian are polynomials; `pivots`: (column, reduced row), as they come."""

    tower: Tower
    common: Any
    rates: Mapping[int, Any]
    jacobian: Sequence[Sequence[Any]]
    work: _Work
    pivots: list[tuple[int, list[Any]]] = field(default_factory=list)

    def along(self, row: list[Any]) -> list[Any]:
        """`common` times L_f of a row."""
        found = []
        for i, entry in enumerate(row):
            total = self.tower.ring.constant(0)
            for g, degree in enumerate(entry.degrees()):
                if degree and g in self.rates:
                    total += self.work.times(entry.derivative(g), self.rates[g])
            for j, other in enumerate(row):
                if not other.is_zero() and not self.jacobian[j][i].is_zero():
                    total += self.work.times(other, self.jacobian[j][i])
            found.append(total)
        return found

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
        for root in reversed(self.tower.roots):
            row, power = reduced(row, root.index, root.degree, root.value)
            scales.append((root.value[1], power))
        entries = sorted((entry for entry in row if not entry.is_zero()), key=len)
        if not entries:
            return row
        self.work.spend(sum(map(len, entries)))
        shared = reduce(lambda a, b: a if a.is_constant() else a.gcd(b), entries)
        scales.append((shared, -1))
        return [entry / shared for entry in row]


def product(tower: Tower, rows: Sequence[Row], limit: int) -> Product:
    """Polynomials whose product, each to its power, is the determinant of the rows, a number apart.

    `rows`: in an order in which the reduction is sound: one output after the other, or by order of derivative.
    Raises: `TooLarge` beyond `limit` products of terms; `ZeroDivisionError` where it is 0.
    """
    work = _eliminated(tower, limit)
    last = {j: max(k for output, k in rows if output == j) for j, _ in rows}
    found: Product = []
    chain: dict[int, list[Any]] = {}
    for j, k in rows:
        scales: Product
        if k:
            raw, scales = work.along(chain[j]), [(work.common, 1)]
        else:
            common, (raw,) = _cleared(tower, [tower.gradient(tower.output[j])])
            scales = [(common, 1)]
        chain[j], more = work.added(raw)
        found += [(e, -power * (last[j] - k + 1)) for e, power in (*scales, *more)]
        column, row = work.pivots[-1]
        found.append((row[column], 1))
    return found


def _eliminated(tower: Tower, limit: int) -> _Elimination:
    jacobian = [tower.gradient(f) for f in tower.flow]
    rates = {
        g: reduce(add, (multiply(slope, tower.flow[i]) for (h, i), slope in tower.slopes.items() if h == g))
        for g in sorted({g for g, _ in tower.slopes})
    }
    common, (moving, *slopes) = _cleared(tower, [list(rates.values()), *jacobian])
    return _Elimination(tower, common, dict(zip(rates, moving, strict=True)), slopes, _Work([limit]))


def _cleared(tower: Tower, rows: Sequence[Sequence[Quotient]]) -> tuple[Any, list[list[Any]]]:
    """The least common denominator, and the rows times it."""
    common = tower.ring.constant(1)
    for row in rows:
        for _, bottom in row:
            common = common * (bottom / common.gcd(bottom))
            if len(common) > 1000:
                raise TooLarge("the common denominator")
    return common, [[top * (common / bottom) for top, bottom in row] for row in rows]
