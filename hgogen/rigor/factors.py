"""Determinants of matrices over a field as products of powers, and the determinant of the observability matrix.

Fraction-free elimination reduces each row of polynomials by the rows before it; the determinant is a product:

    w_k = c_k (given row k  -  a combination of the rows before)   =>   det = +- prod pivots / prod c_k

The rows of the observability matrix are Lie derivatives w_0 = dh, w_(k+1) = c_k (L_f w_k modulo the rows before), with
L_f w = f . dw/dx + w df/dx. Elimination subtracts from w_k a combination of rows before it, whose Lie derivatives are
combinations of rows before w_(k+1). So every w_k may be reduced and scaled before the next derivative, and

    det d(h, L_f h, ..)/dx = +- prod pivots / prod scales,   a scale of w_k counted for w_k and all its successors.

The field is closed under the derivatives. It consists of quotients of polynomials in symbols and kernels,

    x' = f(x, k),  y = h(x, k),  dk_j/dx_i = s_ji(x, k)         k: exp(m), tan(m/2), roots, logarithms, ..

Source: the observability codistribution, R. Hermann, A. Krener, IEEE TAC 22 (1977); fraction-free elimination.

A product of polynomials over the field has an exact factorisation into irreducible ones:

    prod P^e = number * prod (irreducible, monic)^e

The generator of a root is a factor of its own: (p q)^(1/2) is p^(1/2) q^(1/2) only where p and q are not negative, and
(p^2)^(1/2) is |p|. For zero sets alone the root is replaced by a fractional power of its radicand. For a square root g
that replaces a symbol, P(g) and P(-g) are joined to one polynomial without the root.

A function may vanish on a part of the domain: |x| - x is 0 where x >= 0. As (|x| - x) (|x| + x) = 0, a division by
either factor, which elimination needs, loses the value on that part. This is excluded where the generators are analytic
and even roots choose no sign. Even roots choose no sign where in every relation

    prod value_i = c h^2,   a product of radicands, c a number, so that the product of their square roots is |h|,

h cannot change its sign (Kummer theory, S. Lang, Algebra, chapter VI.8).

A polynomial of degree d in T = tan(m/2), times cos(m/2)^d, is a form in cos(m/2), sin(m/2). The form has a value at m =
pi, too, where T is infinite. A form of even degree is a polynomial in cos m, sin m:

    sin(m/2)^k cos(m/2)^(d - k) = (sin m/2)^(k mod 2) ((1 - cos m)/2)^(k div 2) ((1 + cos m)/2)^((d - k) div 2)
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from dataclasses import field as attribute
from fractions import Fraction
from functools import reduce
from itertools import combinations
from typing import Any

import flint
import sympy as sp

from hgogen.rigor.box import exact
from hgogen.rigor.field import (
    Exp,
    Field,
    Half,
    Quotient,
    Root,
    TooLarge,
    Writer,
    add,
    field,
    multiply,
    number,
    partial,
    reduced,
    ring_of,
    written,
)
from hgogen.rigor.lookup import Table
from hgogen.rigor.tape import Direction, Norm, NoTape

Product = list[tuple[Any, int]]  # polynomials and their powers
_COMMON = 1000  # terms of a common denominator


@dataclass(frozen=True)
class WorkLimit:
    """A limit on the work of exact algebra: `remaining` has the number of products of terms that may still be
    formed."""

    remaining: list[int]

    def times(self, a: Any, b: Any) -> Any:
        """Return the product a b of two polynomials and charge it to the limit. Raises: `TooLarge`."""
        self.spend(len(a) * len(b))
        return a * b

    def spend(self, terms: int) -> None:
        """Subtract a number of products of terms from the limit. Raises: `TooLarge` once it is exceeded."""
        self.remaining[0] -= terms
        if self.remaining[0] < 0:
            raise TooLarge("the matrix")


@dataclass(frozen=True)
class Elimination:
    """A fraction-free elimination of rows of polynomials in progress; `pivots`: the pairs (column of the pivot, reduced
    row) in the order of the rows; `work`: the limit on its size."""

    field: Field
    work: WorkLimit
    pivots: list[tuple[int, list[Any]]] = attribute(default_factory=list)

    @property
    def odd(self) -> bool:
        """Return whether the columns of the pivots, in the order of the rows, are an odd permutation."""
        columns = [column for column, _ in self.pivots]
        return sum(a > b for i, a in enumerate(columns) for b in columns[i + 1 :]) % 2 == 1

    @property
    def pivot(self) -> Any:
        """Return the pivot of the last row, a polynomial."""
        column, row = self.pivots[-1]
        return row[column]

    def added(self, row: list[Any]) -> tuple[list[Any], Product]:
        """Reduce a row of polynomials by the earlier rows, store it, and return the pair (reduced row, factors): the
        product of the factors, polynomials with their powers, is what the row was multiplied by.

        Raises: `TooLarge`; `ZeroDivisionError` for a linear combination of the earlier rows.
        """
        scales: Product = []
        row = self._plain(row, scales)
        for column, before in self.pivots:
            if not row[column].is_zero():
                self.work.spend(len(row[column]) * len(before[column]))
                shared = row[column].gcd(before[column])
                scale, other = before[column] / shared, row[column] / shared
                row = [self.work.times(scale, a) - self.work.times(other, b) for a, b in zip(row, before, strict=True)]
                scales.append((scale, 1))
                row = self._plain(row, scales)
        present = [i for i, entry in enumerate(row) if not entry.is_zero()]
        if not present:
            raise ZeroDivisionError
        self.pivots.append((min(present, key=lambda i: len(row[i])), row))
        return row, scales

    def _plain(self, row: list[Any], scales: Product) -> list[Any]:
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
    """Return the least common denominator d of all quotients in the rows, and d times the rows. Raises: `TooLarge`."""
    common = rows[0][0][1].context().constant(1)
    for row in rows:
        for _, bottom in row:
            common = common * (bottom / common.gcd(bottom))
            if len(common) > _COMMON:
                raise TooLarge("the common denominator")
    return common, [[top * (common / bottom) for top, bottom in row] for row in rows]


# --- minors


def expanded(field: Field, rows: Sequence[Sequence[Quotient]], work: WorkLimit) -> Quotient:
    """Return the determinant of a matrix (n, n) of quotients without a division, g^q = value applied for each root g of
    the field. The minors M_k of the first k rows follow from M_(k-1):

        M_k(S) = sum_(j in S) +- a_kj M_(k-1)(S without j)        S: k columns

    Raises: `TooLarge`.
    """
    zero, one = field.ring.constant(0), field.ring.constant(1)
    minors: dict[tuple[int, ...], Quotient] = {(): (one, one)}
    for k, row in enumerate(rows):
        smaller, minors = minors, {}
        for columns in combinations(range(len(rows)), k + 1):
            top, bottom = zero, one
            for place, j in enumerate(columns):
                other = smaller[columns[:place] + columns[place + 1 :]]
                work.spend(1 + sum(len(a) * len(b) for a, b in zip(row[j], other, strict=True)))
                term = multiply(row[j], other)
                top, bottom = add((top, bottom), term if (place + k) % 2 == 0 else (-term[0], term[1]))
            for root in reversed(field.relations):
                (top,), power = reduced([top], root.index, root.degree, root.value)
                bottom = bottom * root.value[1] ** power
            minors[columns] = multiply((top, one), (one, bottom))
    return minors[tuple(range(len(rows)))]


# --- a plant over a field

_KERNELS = 24  # most kernels: derivatives of some introduce new ones without end


@dataclass(frozen=True)
class Tower:
    """A plant x' = f(x), y = h(x) whose right-hand sides are quotients of polynomials in generators g (states, roots,
    exp ..): `flow` f (n), `output` h (p), and `slopes[g, i]` = dg/dx_i, by the index of g, where it is not 0."""

    states: tuple[sp.Symbol, ...]
    field: Field
    flow: tuple[Quotient, ...]
    output: tuple[Quotient, ...]
    slopes: Mapping[tuple[int, int], Quotient]

    def gradient(self, value: Quotient) -> list[Quotient]:
        """Return the partial derivatives (n) of a quotient by the states. Raises: `TooLarge`."""
        ring = self.field.ring
        partials = [(ring.constant(0), ring.constant(1))] * len(self.states)
        for (g, i), slope in self.slopes.items():
            part = partial(value, g)
            if not part[0].is_zero():
                partials[i] = add(partials[i], multiply(part, slope))
        return partials


def tower(flow: Sequence[sp.Expr], output: Sequence[sp.Expr], states: Sequence[sp.Symbol]) -> Tower:
    """Return the plant x' = `flow`, y = `output` as quotients of polynomials in a field with all functions in them and
    the derivatives of these.

    Raises: `TooLarge`; `ZeroDivisionError` for a division by 0; `NoTape` for an unknown function.
    """
    writer = Writer()
    rows = [exact(sp.sympify(e)) for e in (*flow, *output)]
    for row in rows:
        writer.measure(row)
    values = [writer.write(row) for row in rows]
    slopes = dict(_slopes(writer, states))
    algebra, as_quotients = field(writer, (*values, *slopes.values(), *states))
    place = {g: k for k, g in enumerate(algebra.generators)}
    n, m, one = len(states), len(rows), algebra.ring.constant(1)
    rates = {(place[x], i): (one, one) for i, x in enumerate(states)}
    rates |= {(place[g], i): q for (g, i), q in zip(slopes, as_quotients[m:], strict=False)}
    return Tower(tuple(states), algebra, tuple(as_quotients[:n]), tuple(as_quotients[n:m]), rates)


def _slopes(writer: Writer, states: Sequence[sp.Symbol]) -> Iterator[tuple[tuple[sp.Symbol, int], sp.Expr]]:
    done = 0
    while done < len(writer.kernels):
        if done >= _KERNELS:
            raise TooLarge(f"a model of more than {_KERNELS} functions")
        key, dummy = list(writer.kernels.items())[done]
        done += 1
        for i, x in enumerate(states):
            if x in key.free_symbols:
                if isinstance(key, (Exp, Half)):
                    inner = writer.write(key.args[0].diff(x)) * key.args[1]
                    yield (dummy, i), dummy * inner if isinstance(key, Exp) else (1 + dummy**2) * inner / 2
                else:
                    yield (dummy, i), writer.write(key.diff(x))


# --- the codistribution

Row = tuple[int, int]  # (output, order of the derivative), both from 0


def _lie_derivative(
    row: list[Any], rates: Mapping[int, Any], jacobian: Sequence[Sequence[Any]], work: WorkLimit
) -> list[Any]:
    """Return the Lie derivative L_f w = f . dw/dx + w df/dx of a row w of polynomials, for `rates`
    (time derivatives of the symbols) and the `jacobian` df/dx, both without denominators."""
    derivative = []
    for i, entry in enumerate(row):
        total = entry.context().constant(0)
        for g, degree in enumerate(entry.degrees()):
            if degree and g in rates:
                total += work.times(entry.derivative(g), rates[g])
        for j, other in enumerate(row):
            if not other.is_zero() and not jacobian[j][i].is_zero():
                total += work.times(other, jacobian[j][i])
        derivative.append(total)
    return derivative


def codistribution_product(tower: Tower, rows: Sequence[Row], limit: int) -> Product:
    """Return the determinant of some rows d(L_f^k h_j)/dx of the observability matrix, up to a constant factor, as a
    product of powers of polynomials.

    `rows`: pairs (output j, order k), one output after the other or by order of derivative, as the reduction needs.
    Raises: `TooLarge` beyond `limit` products of terms; `ZeroDivisionError` where the determinant is 0.
    """
    work = WorkLimit([limit])
    jacobian = [tower.gradient(f) for f in tower.flow]
    rates = {
        g: reduce(add, (multiply(slope, tower.flow[i]) for (h, i), slope in tower.slopes.items() if h == g))
        for g in sorted({g for g, _ in tower.slopes})
    }
    common, (tops, *slopes) = cleared([list(rates.values()), *jacobian])
    whole_rates = dict(zip(rates, tops, strict=True))
    elimination = Elimination(tower.field, work)
    last = {j: max(k for output, k in rows if output == j) for j, _ in rows}
    factors: Product = []
    chain: dict[int, list[Any]] = {}
    for j, k in rows:
        if k:
            raw, scale = _lie_derivative(chain[j], whole_rates, slopes, work), common
        else:
            scale, (raw,) = cleared([tower.gradient(tower.output[j])])
        chain[j], more = elimination.added(raw)
        factors += [(e, -power * (last[j] - k + 1)) for e, power in ((scale, 1), *more)]
        factors.append((elimination.pivot, 1))
    return factors


# --- where a polynomial may vanish on a part of the domain

ROUGH = (
    *(sp.Abs, sp.Min, sp.Max, sp.sign, sp.Piecewise, sp.floor, sp.ceiling, sp.Heaviside, Norm, Direction, Table),
    *(sp.nan, sp.zoo, sp.oo),
)
_ONE_BRANCH = (sp.log, sp.exp, sp.tan, sp.Abs)


def branches(field: Field) -> bool:
    """Return whether a polynomial over the field that is not 0 may vanish on a part of the domain, as |x| - x does.
    This is possible with kinks or jumps, two inverse functions, a root of a root, or roots whose product is the modulus
    |h| of an h that changes sign; a True is no proof."""
    kernels = [m for m, g in zip(field.meaning, field.generators, strict=True) if g.is_Dummy]
    # a root, a logarithm, an exponential or an angle chooses between no branches
    functions = [m for m in kernels if isinstance(m, sp.Function) and not isinstance(m, _ONE_BRANCH)]
    if len(functions) > 1 or any(m.has(*ROUGH) for m in field.meaning):
        return True
    roots = [root for root in field.relations if not all(end.is_constant() for end in root.value)]
    places = [root.index for root in roots]
    if any(end.degrees()[k] for root in roots for end in root.value for k in places):
        return True
    # a product of even roots, exponentials and positive symbols cannot change its sign
    nonnegative = {root.index for root in field.roots if root.degree % 2 == 0} | field.exponents.keys()
    nonnegative |= {k for k, g in enumerate(field.generators) if g.is_positive}
    letters = [p for k, p in enumerate(field.ring.gens()) if k in nonnegative]
    squares = _squared([root for root in roots if root.degree % 2 == 0])
    return any(p not in letters for h in squares for p in h)


def _squared(roots: Sequence[Root]) -> list[list[Any]]:
    """Return, for each product of radicands that is a square h^2, the irreducible factors of h with odd exponents."""
    exponents = []  # of each radicand: irreducible monic polynomials and their exponents, by their text
    for root in roots:
        ends = _irreducible([(root.value[0], Fraction(1)), (root.value[1], Fraction(-1))])
        exponents.append({str(p): (p, int(k)) for p, k in ends})
    factors = {name: p for one in exponents for name, (p, _) in one.items()}
    parities = [[one[name][1] % 2 if name in one else 0 for one in exponents] for name in factors]
    if not parities:
        return []
    basis, count = flint.nmod_mat(parities, 2).nullspace()
    squares = []
    for j in range(count):
        chosen = [one for i, one in enumerate(exponents) if int(basis[i, j])]
        halves = {name: sum(one[name][1] for one in chosen if name in one) // 2 for name in factors}
        squares.append([factors[name] for name, half in halves.items() if half % 2])
    return squares


# --- powers


@dataclass(frozen=True)
class Power:
    """A power P^exponent of a monic polynomial P, the exponent not 0."""

    polynomial: Any
    exponent: Fraction


_Parts = list[tuple[Any, Fraction]]


def powers(field: Field, product: Product) -> tuple[sp.Expr, list[Power]]:
    """Return a product of polynomials as a number and powers of irreducible monic polynomials; equal to it where roots
    are real. Raises: `TooLarge`."""
    for root in reversed(field.relations):  # so that equal functions are equal polynomials
        plain = [(*reduced([p], root.index, root.degree, root.value), e) for p, e in product]
        product = [*((p, e) for (p,), _, e in plain), (root.value[1], -sum(k * e for _, k, e in plain))]
    value, whole = _monic([(p, Fraction(e)) for p, e in product])
    parts = _irreducible(_merged(whole))
    for root in reversed(field.roots):
        factor, parts = _fewest(root, field.ring.gens()[root.index], parts)
        value *= factor
        if root.rational and root.degree == 2:
            parts = _joined(parts, root.index)
    return value, [Power(p, e) for p, e in parts]


def split_roots(field: Field, parts: Sequence[Power]) -> list[Power]:
    """Return the powers with each root replaced by its radicand, to a fractional power: their product has the same
    zeros and poles as that of `parts`."""
    pairs = [(one.polynomial, one.exponent) for one in parts]
    for root in reversed(field.roots):
        generator = field.ring.gens()[root.index]
        _, ends = _ends(root, sum((e for p, e in pairs if p == generator), Fraction(0)) / root.degree)
        pairs = _merged([*((p, e) for p, e in pairs if p != generator), *ends])
        if root.rational and root.degree == 2:
            pairs = _joined(pairs, root.index)
    return [Power(p, e) for p, e in pairs]


def _fewest(root: Root, generator: Any, parts: _Parts) -> tuple[sp.Expr, _Parts]:
    """Return a number and factors whose product equals that of `parts`, with g^k written as g^(k - t q) value^t for the
    `root` g^q = value; t is chosen so that the fewest factors remain."""
    k = sum((e for p, e in parts if p == generator), Fraction(0))
    if not k:
        return sp.S.One, parts
    others, down = [(p, e) for p, e in parts if p != generator], k // root.degree
    candidates = []
    for t in dict.fromkeys([down] if k % root.degree == 0 else [0, down, down + 1]):
        factor, ends = _ends(root, Fraction(t))
        candidates.append((factor, _merged([*others, (generator, k - t * root.degree), *ends])))
    return min(candidates, key=lambda one: (len(one[1]), sum(abs(e) for _, e in one[1])))


def _ends(root: Root, share: Fraction) -> tuple[sp.Expr, _Parts]:
    if not share:
        return sp.S.One, []
    factor, ends = _monic([(root.value[0], share), (root.value[1], -share)])
    return factor, _irreducible(ends)


def _monic(parts: _Parts) -> tuple[sp.Expr, _Parts]:
    leading = sp.Mul(*(number(p.leading_coefficient()) ** sp.Rational(e) for p, e in parts))
    return leading, [(p / p.leading_coefficient(), e) for p, e in parts]


def _irreducible(parts: _Parts) -> _Parts:
    return _merged((p / p.leading_coefficient(), e * k) for polynomial, e in parts for p, k in polynomial.factor()[1])


def _joined(parts: _Parts, index: int) -> _Parts:
    """Return the powers with P(g) and P(-g) multiplied where both have the same exponent, g the generator of that
    index, a square root: with g^2 = x + 1, (g - 1) (g + 1) is x."""
    pending = {str(p): (p, e) for p, e in parts}
    joined = []
    for p, e in parts:
        if pending.pop(str(p), None) is None:
            continue
        generators = list(p.context().gens())
        generators[index] = -generators[index]
        turned = p.compose(*generators)
        other = turned / turned.leading_coefficient()
        if pending.get(str(other), (None, None))[1] == e:
            del pending[str(other)]
            p = p * other
        joined.append((p, e))
    return joined


def _merged(parts: Iterable[tuple[Any, Fraction]]) -> _Parts:
    merged: dict[str, tuple[Any, Fraction]] = {}
    for polynomial, exponent in parts:
        key = str(polynomial)
        merged[key] = polynomial, merged.get(key, (None, Fraction(0)))[1] + exponent
    return [one for one in merged.values() if one[1] and not one[0].is_constant()]


# --- expressions

_OPERATIONS, _MOST_TERMS = 300, 200


@dataclass(frozen=True)
class Factor:
    """A factor base^exponent of an expression; `definite`: whether the base has one sign, and is not 0, wherever its
    subexpressions are real."""

    base: sp.Expr
    exponent: int
    definite: bool


@dataclass(frozen=True)
class Factors:
    """A factorisation number * prod base^exponent, equal to the factored expression wherever the latter is defined."""

    number: sp.Expr
    factors: tuple[Factor, ...]


def factors(expression: sp.Expr) -> Factors | None:
    """Return the factorisation of an expression, by which exp(2 x) + 1 and cosh(x)^2 - sinh(x)^2 = 1 have no zero; None
    for an expression with angles or kinks, one that is too large, and 0."""
    if expression.count_ops() > _OPERATIONS:
        return None
    writer, e = Writer(), exact(expression)
    try:
        writer.measure(e)
        over, ((top, bottom),) = field(writer, [writer.write(e)])
        if over.angles or branches(over) or top.is_zero():
            return None
        whole = [(top, 1), (bottom, -1)]
        if all(one_sign(over, p) for p, _ in whole):  # exp(2000 x) + 1 has factors without one sign
            return Factors(sp.S.One, tuple(Factor(over.expression(p), k, True) for p, k in whole))
        number, parts = powers(over, whole)
    except (TooLarge, NoTape, ZeroDivisionError):
        return None
    if sum(len(one.polynomial) for one in parts) > _MOST_TERMS or any(one.exponent.denominator != 1 for one in parts):
        return None
    irreducible = (Factor(over.expression(p.polynomial), int(p.exponent), one_sign(over, p.polynomial)) for p in parts)
    return Factors(number, tuple(irreducible))


def one_sign(field: Field, polynomial: Any) -> bool:
    """Return whether a polynomial is proved to have one sign and no zero, because all terms are products of squares and
    nonnegative generators with coefficients of one sign, and one term is never 0."""
    terms = list(polynomial.terms())
    if len({c > 0 for _, c in terms}) > 1:
        return False
    nonnegative = {root.index for root in field.roots if root.degree % 2 == 0}
    positive = {k for k, m in field.exponents.items() if not m.has(sp.log)}  # x**a is 0 at x = 0
    positive |= {k for k, g in enumerate(field.generators) if g.is_positive}
    read = [{k for k, d in enumerate(exponents) if d} for exponents, _ in terms]
    odd = {k for exponents, _ in terms for k, d in enumerate(exponents) if d % 2}
    return odd <= positive | nonnegative and any(one <= positive for one in read)


# --- angles

_ANGLE_TERMS = 3000


def degrees(field: Field, polynomial: Any) -> dict[int, int]:
    """Return the polynomial's degree in tan(m/2) for each angle m, by the index of this generator."""
    highest = polynomial.degrees()
    return {g: int(highest[g]) for g in field.angles}


def even_degrees(degree: Mapping[int, int]) -> bool:
    """Return whether the degree in tan(m/2) is even for every angle m."""
    return not any(k % 2 for k in degree.values())


def factored_form(
    field: Field, polynomial: Any, degree: Mapping[int, int]
) -> tuple[sp.Rational, list[tuple[sp.Expr, int]]]:
    """Return P cos(m_1/2)^d_1 cos(m_2/2)^d_2 .., for a polynomial P in the tan(m/2) of its angles m, as a number and
    powers of primitive factors in cos m and sin m. `degree`: the even number d by the index of tan(m/2). Raises:
    `TooLarge`."""
    if not any(degree.values()):
        return _primitive(sp.S.One, [(field.expression(polynomial), 1)])
    count = len(field.generators)
    ring = ring_of([*field.generators, *(sp.Dummy() for _ in range(2 * len(field.angles)))])
    cosines = dict(zip(field.angles, ring.gens()[count::2], strict=True))
    sines = dict(zip(field.angles, ring.gens()[count + 1 :: 2], strict=True))
    layers: dict[tuple[int, ...], dict[tuple[int, ...], Any]] = {}
    for powers, coefficient in polynomial.terms():
        others = tuple(0 if g in field.angles else int(k) for g, k in enumerate(powers[:count]))
        coefficients = layers.setdefault(tuple(int(powers[g]) for g in field.angles), {})
        coefficients[(*others, *(0,) * (2 * len(field.angles)))] = coefficient
    total, one = ring.constant(0), ring.constant(1)
    for key, terms in layers.items():
        layer = ring.from_dict(terms)
        for g, k in zip(field.angles, key, strict=True):
            halves = ((one - cosines[g]) / 2) ** (k // 2) * ((one + cosines[g]) / 2) ** ((degree[g] - k) // 2)
            layer = layer * ((sines[g] / 2) ** (k % 2) * halves)
        total = total + layer
        if len(total) > _ANGLE_TERMS:
            raise TooLarge("the form in sines and cosines")
    for g in field.angles:
        total = min(
            total, reduced([total], ring.gens().index(cosines[g]), 2, (one - sines[g] ** 2, one))[0][0], key=len
        )
    meaning = [*field.meaning, *(f(m) for m in field.angles.values() for f in (sp.cos, sp.sin))]
    content, parts = total.factor()
    return _primitive(number(content), [(written(p, meaning), int(k)) for p, k in parts])


def _primitive(content: sp.Rational, parts: list[tuple[sp.Expr, int]]) -> tuple[sp.Rational, list[tuple[sp.Expr, int]]]:
    split = [(*e.primitive(), k) for e, k in parts]
    return content * sp.Mul(*(c**k for c, _, k in split)), [(e, k) for _, e, k in split]
