"""Determinants of matrices of expressions, and maps that are one to one by the signs of their minors.

Determinants are exact. Their zero set is that of a product of polynomials over a field, written as readable factors
without those that never vanish. The generically independent rows of a matrix are found here too.

A map can be proved to be one to one on a box without an inverse, by the signs of minors:

    F: box -> R^n differentiable, all principal minors of its Jacobian above 0 at every point:  F is one to one there

The box is a product of closed intervals, of any length. Such a Jacobian reverses the sign of no vector but 0. The
theorem asks for each point by itself, so that bisection proves it. The determinant alone is not enough: that of exp(x)
(cos y, sin y) is exp(2 x), and the map is periodic in y. F is one to one where L F is, L a constant invertible matrix:
an order and signs of the rows of F, or about the inverse of its Jacobian at the middle.

D. Gale, H. Nikaido, "The Jacobian matrix and global univalence of mappings", Math. Annalen 159 (1965), theorem 4.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain, combinations, islice, permutations
from math import inf, prod
from random import Random
from typing import Any, TypeVar

import flint
import numpy as np
import sympy as sp
from sympy.functions.elementary.hyperbolic import HyperbolicFunction

from hgogen.check import Verdict
from hgogen.rigor.bounds import nonzero
from hgogen.rigor.box import Box, exact, points
from hgogen.rigor.factors import (
    Elimination,
    Power,
    Product,
    WorkLimit,
    branches,
    cleared,
    degrees,
    even_degrees,
    expanded,
    factored_form,
    one_sign,
    powers,
    split_roots,
)
from hgogen.rigor.field import Field, Quotient, TooLarge, Writer, field, is_zero
from hgogen.rigor.rank import ZERO_BITS, TooImprecise, independent_rows
from hgogen.rigor.series import values
from hgogen.rigor.tape import NoTape, tape
from hgogen.signal import Signal

_Row = TypeVar("_Row")
LIMIT = 300_000  # products of terms
_TERMS = 4000
_POINTS, _TRIES = 2, 24
_READABLE = 1500  # terms of all factors: more cannot be read
_BOXES, _BITS = 40, 256  # boxes to decide whether a factor ever vanishes; bits of samples
_LONG = 300  # operations of a factor, beyond which boxes of all numbers cost seconds and decide nothing
_SAMPLES, _GRID = 24, 9  # points, and the largest numerator and denominator of their coordinates


@dataclass(frozen=True)
class Determinant:
    """A determinant of expressions, with its zeros.

    `value`: a quotient of products, equal to the determinant where its roots are real. `factors`: expressions whose
    zero sets together are the zero set of the value; empty where it has no zero, None where this is not known.
    """

    value: sp.Expr
    factors: tuple[sp.Expr, ...] | None


def determinant(rows: Sequence[Sequence[sp.Expr]], limit: int = LIMIT) -> Determinant:
    """Return the determinant of an n x n matrix of expressions. Raises: `TooLarge` beyond `limit` products of terms, or
    where a pivot may be 0 by a relation that is not known."""
    writer = Writer()
    entries = [exact(sp.sympify(e)) for row in rows for e in row]
    for e in entries:
        writer.measure(e)
    domain, as_quotients = field(writer, [writer.write(e) for e in entries])
    matrix = [as_quotients[k * len(rows) : (k + 1) * len(rows)] for k in range(len(rows))]
    try:
        product = _product(domain, matrix, limit)
    except ZeroDivisionError:
        return Determinant(sp.S.Zero, (sp.S.Zero,))
    if not surely_nonzero(domain, product):
        raise TooLarge("what the functions of a matrix have to do with each other")
    number, parts = powers(domain, product)
    if sum(len(one.polynomial) for one in parts) > _TERMS:
        raise TooLarge("the determinant")
    return Determinant(number * _value(domain, parts), zero_set(domain, split_roots(domain, parts)))


def readable_determinant(rows: Sequence[Sequence[sp.Expr]], det: Determinant) -> Determinant:
    """Return the determinant `det` of the `rows` rewritten for a reader: its value and factors with the hyperbolic
    functions of the rows in place of exponentials. It is `det` itself for rows without such functions, or where it is
    shorter."""
    nodes = sorted(set().union(*(e.atoms(HyperbolicFunction) for row in rows for e in row)), key=str)
    names = {node: sp.Symbol(str(node), positive=isinstance(node, sp.cosh) or None, real=True) for node in nodes}
    try:
        other = determinant([[e.xreplace(names) for e in row] for row in rows]) if names else det
    except TooLarge:
        return det
    if other is det or other.factors is None or other.value.count_ops() > det.value.count_ops():
        return det
    back = {symbol: node for node, symbol in names.items()}
    slopes = {
        e: symbol for node, symbol in names.items() if isinstance(node, sp.tanh) for e in (symbol - 1, symbol + 1)
    }
    factors = tuple(e.xreplace(back) for e in other.factors if e not in slopes)  # |tanh| < 1
    value, every = other.value, other.value.as_powers_dict()
    for T in set(slopes.values()):  # (T - 1)^k (T + 1)^k is written as (1 - T^2)^k, as the slope of tanh is
        k = every.get(T - 1)
        if k and k == every.get(T + 1):
            value = value / ((T - 1) * (T + 1)) ** k * (-1) ** k * (1 - T**2) ** k
    return Determinant(value.xreplace(back), factors)


def _product(domain: Field, matrix: Sequence[Sequence[Quotient]], limit: int) -> Product:
    """Return the determinant of a matrix over the field `domain` as a product of powers
    of polynomials, by elimination. A division may leave a pole that the determinant
    does not have; the determinant is then expanded without divisions."""
    doubtful = branches(domain)
    if doubtful or domain.relations:
        try:
            top, bottom = expanded(domain, matrix, WorkLimit([limit]))
        except TooLarge:
            if doubtful:
                raise
        else:
            if top.is_zero():
                raise ZeroDivisionError
            return [(top, 1), (bottom, -1)]
    elimination = Elimination(domain, WorkLimit([limit]))
    product: Product = []
    for entries in matrix:
        common, (row,) = cleared([entries])
        _, scales = elimination.added(row)
        product += [(e, -power) for e, power in ((common, 1), *scales)]
        product.append((elimination.pivot, 1))
    return [*product, (domain.ring.constant(-1 if elimination.odd else 1), 1)]


def _value(field: Field, parts: Sequence[Power]) -> sp.Expr:
    """Return the product of powers P^e of polynomials, `parts`, as an expression. With C = cos(m/2), a
    polynomial P of degree d in tan(m/2) is a homogeneous form of degree d over C^d. Forms of even
    degree are written one by one; the others are multiplied, with the remaining power of C."""
    every = [(p.polynomial, p.exponent, degrees(field, p.polynomial)) for p in parts]
    forms = [(p, d, e) for p, e, d in every if even_degrees(d)]
    cosines = {g: -sum(int(e) * d[g] for _, e, d in every) for g in field.angles}
    ends = []
    for sign in (1, -1):
        odd = [p ** int(e * sign) for p, e, d in every if not even_degrees(d) and e * sign > 0]
        whole = prod(odd, start=field.ring.constant(1))
        ends.append((whole, {g: k + max(sign * cosines[g], 0) for g, k in degrees(field, whole).items()}, sign))
    shared = {g: ends[0][1][g] % 2 for g in field.angles}  # both are odd, or none is
    forms += [(p, {g: k + shared[g] for g, k in d.items()}, Fraction(sign)) for p, d, sign in ends]
    written = [(*factored_form(field, p, d), sp.Rational(e)) for p, d, e in forms]
    return sp.Mul(*(n**e for n, _, e in written), *(b ** (k * e) for _, bases, e in written for b, k in bases))


# ---------------------------------------------------------------- which rows


def independent(rows: Mapping[_Row, Sequence[sp.Expr]], n: int) -> tuple[_Row, ...]:
    """Return the keys of the first n rows, each of n expressions, that are linearly independent at general points, in
    order; fewer than n keys where the rank is lower.

    The rows are eliminated with balls at two random points: unless these lie on a set without volume, a row that is
    dependent there is dependent everywhere.
    """
    symbols = sorted(set().union(*(e.free_symbols for row in rows.values() for e in row)), key=str)
    program = tape([exact(e) for row in rows.values() for e in row], symbols)
    best: tuple[_Row, ...] = ()
    points = 0
    draw = Random(1)
    for _ in range(_TRIES):
        point = [Fraction(draw.randint(200, 1800), 997) for _ in symbols]
        for bits in (256, ZERO_BITS):
            balls = values(program, point, bits)
            if all(ball.is_finite() for ball in balls):
                points += bits == ZERO_BITS
                chosen: list[int] = []
                with flint.ctx.workprec(bits), suppress(TooImprecise):
                    chosen = independent_rows([balls[k * n : (k + 1) * n] for k in range(len(rows))], 0)
                best = max(best, tuple(list(rows)[k] for k in chosen[:n]), key=len)
            if len(best) == n:
                return best
        if points == _POINTS:
            break
    return best


# ---------------------------------------------------------------- zero sets


def surely_nonzero(field: Field, product: Product) -> bool:
    """Return whether it is certain that no polynomial of the product is identically 0. A polynomial in symbols alone is
    not identically 0; a polynomial that contains functions is evaluated at a random point, where its ball excludes 0,
    or tested by `is_zero`."""
    undecided = [p for p, _ in product if field.kernels(p)]
    symbols = sorted({s for e in field.meaning for s in e.free_symbols}, key=str)
    program = tape(field.meaning, symbols)
    draw = Random(1)
    for _ in range(_SAMPLES):
        point = [Fraction(draw.randint(1, _GRID), draw.randint(1, _GRID)) for _ in symbols]
        if undecided:
            balls = values(program, point, _BITS)
            undecided = [p for p in undecided if not _not_zero(p, balls)]
    return all(is_zero(field.expression(p)) is False for p in undecided)


def _not_zero(polynomial: Any, balls: Sequence[Any]) -> bool:
    total = flint.arb(0)
    for exponents, c in polynomial.terms():
        total += prod((ball**k for ball, k in zip(balls, exponents, strict=False) if k), start=flint.arb(c))
    return bool(total.is_finite() and not total.contains(0))


def zero_set(field: Field, parts: Sequence[Power]) -> tuple[sp.Expr, ...] | None:
    """Return factors whose zero sets together are the zero set of a product of powers of polynomials, `parts`, where
    this product is defined; () where it has no zero.

    The result is None where the zeros are not decided: a factor x**a with a symbol a, or a zero and a pole that may
    cancel by a relation between functions. Raises: `TooLarge`.
    """
    zeros = [one.polynomial for one in parts if one.exponent > 0 and not one_sign(field, one.polynomial)]
    poles = [one.polynomial for one in parts if one.exponent < 0 and not one_sign(field, one.polynomial)]
    if sum(map(len, zeros)) > _READABLE:
        raise TooLarge("the determinant")
    logs = [g for g, m in field.exponents.items() if m.has(sp.log)]  # x**a may or may not have a zero at x = 0
    if any(len(p) == 1 and any(p.degrees()[g] for g in logs) for p in zeros):
        return None
    if zeros and poles:
        # kernels that others may depend on: roots with a relation, and functions where there are two
        places = {root.index for root in field.roots} | field.angles.keys() | field.exponents.keys()
        functions = {k for k, g in enumerate(field.generators) if g.is_Dummy} - places
        doubtful = {root.index for root in field.relations} | (functions if len(functions) > 1 else set())
        if any(p.degrees()[g] for p in (*zeros, *poles) for g in doubtful):
            return None
    factors = [factor for p, degree in _forms(field, zeros, parts) for factor, _ in factored_form(field, p, degree)[1]]
    vanishing = set()  # without factors that are proved to have no zero; a long one is not tested
    for e in factors:
        everywhere = dict.fromkeys(e.free_symbols, (-inf, inf))
        if e.count_ops() > _LONG or not nonzero(e, everywhere, boxes=_BOXES, refute=False).never:
            vanishing.add(_signed(e))
    return tuple(sorted(vanishing, key=sp.default_sort_key))


def _forms(field: Field, zeros: Sequence[Any], parts: Sequence[Power]) -> list[tuple[Any, dict[int, int]]]:
    """Return polynomials with an even degree in tan(m/2) of each angle m: those
    of `zeros` that have one, and the product of the others, times cos(m/2) if
    the product of `parts` is 0 at m = pi, squared if its degree is odd."""
    infinite = [g for g in field.angles if sum(p.exponent * degrees(field, p.polynomial)[g] for p in parts) < 0]
    forms = [(p, degrees(field, p)) for p in zeros if even_degrees(degrees(field, p))]
    odd = [p for p in zeros if not even_degrees(degrees(field, p))]
    if not odd and not infinite:
        return forms
    total = field.ring.constant(1)
    for p in odd:
        if len(total) * len(p) > _READABLE:
            raise TooLarge("the determinant")
        total = total * p
    degree = {g: k + (g in infinite) for g, k in degrees(field, total).items()}
    if not even_degrees(degree):
        total, degree = total * total, {g: 2 * k for g, k in degree.items()}
    return [*forms, (total, degree)]


def _signed(e: sp.Expr) -> sp.Expr:
    if isinstance(e, sp.Pow) and e.exp.is_Rational and e.exp.is_positive:
        return _signed(e.base)
    return -e if e.could_extract_minus_sign() else e


# ---------------------------------------------------------------- univalent


STATES = 5  # 31 minors, and 120 orders of rows
_TRIED = 3  # orders of rows for which a proof is tried
_SMALL = 1e-9  # of the largest minor at a sample point: a smaller one counts as 0
_DENOMINATOR = 64  # the largest one of a row's weights

Weights = tuple[tuple[Fraction, ...], ...]


def subsets(n: int) -> Iterator[tuple[int, ...]]:
    """Yield the nonempty subsets of {0, .., n - 1} as tuples, in the order of their sizes."""
    return chain.from_iterable(combinations(range(n), size) for size in range(1, n + 1))


def univalent(jacobian: sp.Matrix, read: Sequence[Signal], box: Box, boxes: int) -> Weights | None:
    """Return a constant matrix L (n, n) by which a map is proved to be one to one on a box: all principal minors of L
    J, J the map's `jacobian` (n, n), are above 0 on the box (Gale, Nikaido 1965); None where none is proved. `read`:
    the signals that J depends on; `boxes`: the most boxes of a bisection."""
    n = jacobian.rows
    if n > STATES:
        return None
    sampled = _samples(jacobian, read)
    candidates = chain(islice(_orders(sampled), _TRIED), _combined(sampled)) if len(sampled) else ()
    return next((L for L in candidates if _proved(weighted(L, jacobian), box, boxes)), None)


def weighted(L: Weights, jacobian: sp.Matrix) -> sp.Matrix:
    """Return the product L J of a constant matrix `L` and a `jacobian` J."""
    return sp.Matrix([[sp.Rational(x) for x in row] for row in L]) * jacobian


def minor(matrix: sp.Matrix, places: Sequence[int]) -> sp.Expr:
    """Return the principal minor of a matrix on the rows and columns with the indices `places`. Raises: `TooLarge`."""
    rows = matrix.extract(list(places), list(places)).tolist()
    return readable_determinant(rows, determinant(rows)).value


def _samples(jacobian: sp.Matrix, read: Sequence[Signal]) -> np.ndarray:
    """Return the values (k, n, n) of a Jacobian at sample points
    of the box where it is finite, the middle first."""
    n = jacobian.rows
    try:
        program = tape(list(jacobian), read)
    except NoTape:
        return np.zeros((0, n, n))
    balls = (values(program, [point[s] for s in read]) for point in points(read))
    matrices = np.array([[float(x.mid()) for x in row] for row in balls]).reshape(-1, n, n)
    return np.asarray(matrices[np.isfinite(matrices).all(axis=(1, 2))])


def _orders(sampled: np.ndarray) -> Iterator[Weights]:
    """Yield signed permutations L (n, n) for which L J has positive principal minors at all samples J (k, n, n)."""
    n = sampled.shape[-1]
    for order in permutations(range(n)):
        signs = np.sign([sampled[0, k, i] for i, k in enumerate(order)])
        L = np.zeros((n, n))
        L[range(n), order] = signs
        if signs.all() and _positive(L @ sampled):
            yield _rational(L)


def _combined(sampled: np.ndarray) -> Iterator[Weights]:
    """Yield a rounded inverse L of the first sample J if L J has positive principal minors at all J (k, n, n)."""
    n = sampled.shape[-1]
    if np.linalg.matrix_rank(sampled[0]) == n:
        inverse = np.linalg.inv(sampled[0])
        rows = _rational(inverse / np.abs(inverse).max(axis=1, keepdims=True))
        L = np.array(rows, dtype=float)
        if np.linalg.matrix_rank(L) == n and _positive(L @ sampled):
            yield rows


def _positive(matrices: np.ndarray) -> bool:
    n = matrices.shape[-1]
    every = (np.linalg.det(matrices[np.ix_(range(len(matrices)), s, s)]) for s in map(list, subsets(n)))
    return all(bool((minor > _SMALL * np.abs(minor).max()).all()) for minor in every)


def _rational(L: np.ndarray) -> Weights:
    return tuple(tuple(Fraction(x).limit_denominator(_DENOMINATOR) for x in row) for row in L.tolist())


def _proved(matrix: sp.Matrix, box: Box, boxes: int) -> bool:
    for places in subsets(matrix.rows):
        try:
            value = minor(matrix, places)
        except TooLarge:
            return False
        where = {s: box[s] for s in sorted(value.free_symbols, key=str)}
        sign = nonzero(value, where, boxes=boxes, refute=False)
        if sign.verdict is not Verdict.PROVED or sign.sign < 0:
            return False
    return True
