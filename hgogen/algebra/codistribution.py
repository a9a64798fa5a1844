"""The determinant of the observability matrix as a product, by elimination between the Lie derivatives.

    w_0 = dh,   w_(k+1) = c_k (L_f w_k  modulo the rows before),   L_f w = f . dw/dx + w df/dx

What is subtracted from w_k is a combination of rows before it, whose Lie derivatives are combinations of rows before
w_(k+1): so every w_k may be reduced by elimination and scaled at once, and

    det d(h, L_f h, ..)/dx = +- prod pivots / prod scales,   a scale of w_k counted for w_k and all its successors.

Source: the observability codistribution, R. Hermann, A. Krener, IEEE TAC 22 (1977); fraction-free elimination.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

from hgogen.algebra.elimination import Elimination, Product, Work, cleared
from hgogen.algebra.quotient import add, multiply
from hgogen.algebra.tower import Tower

Row = tuple[int, int]  # (output, order of the derivative), both from 0


@dataclass(frozen=True)
class _Flow:
    """`common` times the flow and its Jacobian, which are then polynomials; `rates` by generator."""

    common: Any
    rates: Mapping[int, Any]
    jacobian: Sequence[Sequence[Any]]
    work: Work

    def along(self, row: list[Any]) -> list[Any]:
        """`common` times the Lie derivative L_f of a row."""
        lie_derivative = []
        for i, entry in enumerate(row):
            total = entry.context().constant(0)
            for g, degree in enumerate(entry.degrees()):
                if degree and g in self.rates:
                    total += self.work.times(entry.derivative(g), self.rates[g])
            for j, other in enumerate(row):
                if not other.is_zero() and not self.jacobian[j][i].is_zero():
                    total += self.work.times(other, self.jacobian[j][i])
            lie_derivative.append(total)
        return lie_derivative


def product(tower: Tower, rows: Sequence[Row], limit: int) -> Product:
    """Polynomials whose product, each to its power, is the determinant of the rows up to a constant factor.

    `rows`: in an order in which the reduction is sound: one output after the other, or by order of derivative.
    Raises: `TooLarge` beyond `limit` products of terms; `ZeroDivisionError` where the determinant is 0.
    """
    work = Work([limit])
    jacobian = [tower.gradient(f) for f in tower.flow]
    rates = {
        g: reduce(add, (multiply(slope, tower.flow[i]) for (h, i), slope in tower.slopes.items() if h == g))
        for g in sorted({g for g, _ in tower.slopes})
    }
    common, (moving, *slopes) = cleared([list(rates.values()), *jacobian])
    flow = _Flow(common, dict(zip(rates, moving, strict=True)), slopes, work)
    elimination = Elimination(tower.field, work)
    last = {j: max(k for output, k in rows if output == j) for j, _ in rows}
    factors: Product = []
    chain: dict[int, list[Any]] = {}
    for j, k in rows:
        if k:
            raw, scale = flow.along(chain[j]), flow.common
        else:
            scale, (raw,) = cleared([tower.gradient(tower.output[j])])
        chain[j], more = elimination.added(raw)
        factors += [(e, -power * (last[j] - k + 1)) for e, power in ((scale, 1), *more)]
        factors.append((elimination.pivot, 1))
    return factors
