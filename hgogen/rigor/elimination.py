"""Determinants of matrices over a field, without fractions or as products, and that of the observability matrix.

Rows of polynomials are each reduced by the rows before without fractions; the determinant is a product:

    w_k = c_k (given row k  -  a combination of the rows before)   =>   det = +- prod pivots / prod c_k

Of the Lie derivatives w_0 = dh, w_(k+1) = c_k (L_f w_k modulo the rows before), L_f w = f . dw/dx + w df/dx, what is
subtracted from w_k is a combination of rows before it, whose Lie derivatives are combinations of rows before w_(k+1).
So every w_k may be reduced by elimination and scaled at once, and

    det d(h, L_f h, ..)/dx = +- prod pivots / prod scales,   a scale of w_k counted for w_k and all its successors.

They are taken over a field that is closed under its derivatives: quotients of polynomials in symbols and kernels,

    x' = f(x, k),  y = h(x, k),  dk_j/dx_i = s_ji(x, k)         k: exp(m), tan(m/2), roots, logarithms, ..

Source: the observability codistribution, R. Hermann, A. Krener, IEEE TAC 22 (1977); fraction-free elimination.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from dataclasses import field as attribute
from functools import reduce
from itertools import combinations
from typing import Any

import sympy as sp

from hgogen.rigor.field import Field, Quotient, add, field, multiply, partial, reduced
from hgogen.rigor.points import exact
from hgogen.rigor.rewrite import Exp, Half, TooLarge, Writer

Product = list[tuple[Any, int]]  # polynomials and their powers
_COMMON = 1000  # terms of a common denominator


@dataclass(frozen=True)
class Work:
    """Products of terms that may still be formed."""

    left: list[int]

    def times(self, a: Any, b: Any) -> Any:
        """a b. Raises: `TooLarge`."""
        self.spend(len(a) * len(b))
        return a * b

    def spend(self, terms: int) -> None:
        """Count products of terms. Raises: `TooLarge`."""
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
    """The least common denominator, and the rows times it. Raises: `TooLarge`."""
    common = rows[0][0][1].context().constant(1)
    for row in rows:
        for _, bottom in row:
            common = common * (bottom / common.gcd(bottom))
            if len(common) > _COMMON:
                raise TooLarge("the common denominator")
    return common, [[top * (common / bottom) for top, bottom in row] for row in rows]


# --- minors


def expanded(field: Field, rows: Sequence[Sequence[Quotient]], work: Work) -> Quotient:
    """The determinant of n x n quotients without a division, reduced by the roots' relations: by minors of the first k
    rows, each from those of k - 1,

        M_k(S) = sum_(j in S) +- a_kj M_(k-1)(S without j)        S: k columns

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
    field: Field, row: Sequence[Quotient], columns: tuple[int, ...], minors: dict[tuple[int, ...], Quotient], work: Work
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


# --- a plant over a field

_KERNELS = 24  # kernels whose derivatives bring in others, without end or nearly


@dataclass(frozen=True)
class Tower:
    """`flow` (n) and `output` (p) in the `field`; `slopes[g, i]`: dg/dx_i of generator g where it is not 0."""

    states: tuple[sp.Symbol, ...]
    field: Field
    flow: tuple[Quotient, ...]
    output: tuple[Quotient, ...]
    slopes: Mapping[tuple[int, int], Quotient]

    def gradient(self, value: Quotient) -> list[Quotient]:
        """The partial derivatives of a value with respect to the states. Raises: `TooLarge`."""
        ring = self.field.ring
        partials = [(ring.constant(0), ring.constant(1))] * len(self.states)
        for (g, i), slope in self.slopes.items():
            part = partial(value, g)
            if not part[0].is_zero():
                partials[i] = add(partials[i], multiply(part, slope))
        return partials


def tower(flow: Sequence[sp.Expr], output: Sequence[sp.Expr], states: Sequence[sp.Symbol]) -> Tower:
    """The field of a plant and of its derivatives.

    Raises: `TooLarge`; `ZeroDivisionError` for a division by what is identically 0; `NoTape` for an unknown function.
    """
    writer = Writer()
    rows = [exact(sp.sympify(e)) for e in (*flow, *output)]
    for row in rows:
        writer.measure(row)
    values = [writer.write(row) for row in rows]
    slopes = dict(_slopes(writer, states))
    made, as_quotients = field(writer, (*values, *slopes.values(), *states))
    place = {g: k for k, g in enumerate(made.generators)}
    n, m = len(states), len(rows)
    own = {(place[x], i): (made.ring.constant(1), made.ring.constant(1)) for i, x in enumerate(states)}
    steep = {(place[g], i): q for (g, i), q in zip(slopes, as_quotients[m:], strict=False)}
    return Tower(tuple(states), made, tuple(as_quotients[:n]), tuple(as_quotients[n:m]), own | steep)


def _slopes(writer: Writer, states: Sequence[sp.Symbol]) -> Iterator[tuple[tuple[sp.Symbol, int], sp.Expr]]:
    done = 0
    while done < len(writer.kernels):
        if done >= _KERNELS:
            raise TooLarge(f"a model of more than {_KERNELS} functions")
        key, dummy = list(writer.kernels.items())[done]
        done += 1
        for i, x in enumerate(states):
            if x in key.free_symbols:
                yield (dummy, i), _slope(writer, key, dummy, x)


def _slope(writer: Writer, key: sp.Expr, kernel: sp.Dummy, x: sp.Symbol) -> sp.Expr:
    if isinstance(key, Exp):
        return kernel * writer.write(key.args[0].diff(x)) * key.args[1]
    if isinstance(key, Half):
        return (1 + kernel**2) * writer.write(key.args[0].diff(x)) * key.args[1] / 2
    return writer.write(key.diff(x))


# --- the codistribution

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


def codistribution_product(tower: Tower, rows: Sequence[Row], limit: int) -> Product:
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
