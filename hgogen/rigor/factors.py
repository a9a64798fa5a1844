"""Polynomials over a field as products, exactly: powers of irreducible ones, and which are 0 on a part of the domain.

    prod P^e = number * prod (irreducible, monic)^e

A root's generator is a polynomial of its own: (p q)^(1/2) is p^(1/2) q^(1/2) only where p and q are not negative, and
(p^2)^(1/2) is |p|. Only for the zero set it is what it is a root of to a fraction. Of a square root g that replaces a
symbol, P(g) and P(-g) make one polynomial, which has no root.

|x| - x is not 0, and is 0 where x >= 0: (|x| - x) (|x| + x) = 0, so a division by either, which elimination needs,
loses the value on a part. It cannot be where the generators are analytic and even roots choose no sign: where no

    prod value_i = c h^2,   a product of some of their values, c a number, so that their square roots make |h|,

has an h that may change its sign (Kummer theory, S. Lang, Algebra, chapter VI.8).

A polynomial of degree d in T = tan(m/2), times cos(m/2)^d, is a form in cos(m/2), sin(m/2): it sees m = pi, too, where
T is infinite. A form of even degree is a polynomial in cos m, sin m:

    sin(m/2)^k cos(m/2)^(d - k) = (sin m/2)^(k mod 2) ((1 - cos m)/2)^(k div 2) ((1 + cos m)/2)^((d - k) div 2)
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import flint
import sympy as sp

from hgogen.rigor.elimination import Product
from hgogen.rigor.field import Field, Root, field, number, reduced, ring_of, written
from hgogen.rigor.interpolation import Table
from hgogen.rigor.kinks import Direction, Norm
from hgogen.rigor.points import exact
from hgogen.rigor.rewrite import TooLarge, Writer
from hgogen.rigor.tape import NoTape

# --- where a polynomial may vanish on a part of the domain

ROUGH = (
    *(sp.Abs, sp.Min, sp.Max, sp.sign, sp.Piecewise, sp.floor, sp.ceiling, sp.Heaviside, Norm, Direction, Table),
    *(sp.nan, sp.zoo, sp.oo),
)
_ONE_BRANCH = (sp.log, sp.exp, sp.tan, sp.Abs)


def branches(field: Field) -> bool:
    """Whether it may: for a function with kinks or jumps, two inverse functions, a root of a root, |h| of some h."""
    kernels = [m for m, g in zip(field.meaning, field.generators, strict=True) if g.is_Dummy]
    # a root, a logarithm, an exponential or an angle has no branches between which to choose
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
    """For each product of values that is a square h^2, from a basis of such products, the factors of h with odd
    exponents."""
    exponents = []  # of each value: irreducible monic polynomials and their exponents, by their text
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
        taken = [one for i, one in enumerate(exponents) if int(basis[i, j])]
        halves = {name: sum(one[name][1] for one in taken if name in one) // 2 for name in factors}
        squares.append([factors[name] for name, half in halves.items() if half % 2])
    return squares


# --- powers


@dataclass(frozen=True)
class Power:
    """A monic polynomial to an exponent that is not 0."""

    polynomial: Any
    exponent: Fraction


_Parts = list[tuple[Any, Fraction]]


def powers(field: Field, product: Product) -> tuple[sp.Expr, list[Power]]:
    """The number and the powers, all whole: the product's value wherever the roots are real. Raises: `TooLarge`."""
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
    """Powers with the same zeros and poles, though not the same value, in which each root is replaced by what it is a
    root of."""
    pairs = [(one.polynomial, one.exponent) for one in parts]
    for root in reversed(field.roots):
        generator = field.ring.gens()[root.index]
        _, ends = _ends(root, sum((e for p, e in pairs if p == generator), Fraction(0)) / root.degree)
        pairs = _merged([*((p, e) for p, e in pairs if p != generator), *ends])
        if root.rational and root.degree == 2:
            pairs = _joined(pairs, root.index)
    return [Power(p, e) for p, e in pairs]


def _fewest(root: Root, generator: Any, parts: _Parts) -> tuple[sp.Expr, _Parts]:
    """The number and the factors of g^k = g^(k - t q) value^t for the t that leaves the fewest factors; g is no factor
    where q divides k.
    """
    k = sum((e for p, e in parts if p == generator), Fraction(0))
    if not k:
        return sp.S.One, parts
    rest, down = [(p, e) for p, e in parts if p != generator], k // root.degree
    candidates = []
    for t in dict.fromkeys([down] if k % root.degree == 0 else [0, down, down + 1]):
        factor, ends = _ends(root, Fraction(t))
        candidates.append((factor, _merged([*rest, (generator, k - t * root.degree), *ends])))
    return min(candidates, key=lambda one: (len(one[1]), sum(abs(e) for _, e in one[1])))


def _ends(root: Root, share: Fraction) -> tuple[sp.Expr, _Parts]:
    """What the root is a root of, to an exponent: the number, of whole exponents alone, and irreducible factors."""
    if not share:
        return sp.S.One, []
    factor, ends = _monic([(root.value[0], share), (root.value[1], -share)])
    return factor, _irreducible(ends)


def _monic(parts: _Parts) -> tuple[sp.Expr, _Parts]:
    """The product of leading coefficients, each to its exponent, and the polynomials without them."""
    leading = sp.Mul(*(number(p.leading_coefficient()) ** sp.Rational(e) for p, e in parts))
    return leading, [(p / p.leading_coefficient(), e) for p, e in parts]


def _irreducible(parts: _Parts) -> _Parts:
    """The factors of monic polynomials, monic themselves, so that no number is lost."""
    return _merged((p / p.leading_coefficient(), e * k) for polynomial, e in parts for p, k in polynomial.factor()[1])


def _joined(parts: _Parts, index: int) -> _Parts:
    """The powers with P(g) and P(-g) joined to one factor where both have the same exponent: with g^2 = x + 1,
    (g - 1) (g + 1) is x."""
    left = {str(p): (p, e) for p, e in parts}
    joined = []
    for p, e in parts:
        if left.pop(str(p), None) is None:
            continue
        generators = list(p.context().gens())
        generators[index] = -generators[index]
        turned = p.compose(*generators)
        other = turned / turned.leading_coefficient()
        if left.get(str(other), (None, None))[1] == e:
            del left[str(other)]
            p = p * other
        joined.append((p, e))
    return joined


def _merged(parts: Iterable[tuple[Any, Fraction]]) -> _Parts:
    """The powers with the exponents of equal polynomials added, without constants and polynomials to the power 0."""
    merged: dict[str, tuple[Any, Fraction]] = {}
    for polynomial, exponent in parts:
        key = str(polynomial)
        merged[key] = polynomial, merged.get(key, (None, Fraction(0)))[1] + exponent
    return [one for one in merged.values() if one[1] and not one[0].is_constant()]


# --- expressions

_OPERATIONS, _MOST_TERMS = 300, 200


@dataclass(frozen=True)
class Factor:
    """base^exponent; `definite`: the base is positive, or negative, for all real values of its symbols at which its
    parts are real."""

    base: sp.Expr
    exponent: int
    definite: bool


@dataclass(frozen=True)
class Factors:
    """number * prod factors: equal to the expression wherever that is defined."""

    number: sp.Expr
    factors: tuple[Factor, ...]


def factors(expression: sp.Expr) -> Factors | None:
    """The factors of an expression without angles and kinks; None where it has them, or is too large, or is 0. It is
    known that exp(2 x) + 1 is never 0, nor is cosh(x)^2 - sinh(x)^2 = 1."""
    if expression.count_ops() > _OPERATIONS:
        return None
    writer, e = Writer(), exact(expression)
    try:
        writer.measure(e)
        made, ((top, bottom),) = field(writer, [writer.write(e)])
        if made.angles or branches(made) or top.is_zero():
            return None
        whole = [(top, 1), (bottom, -1)]
        if all(one_sign(made, p) for p, _ in whole):  # exp(2000 x) + 1 has factors that are not
            return Factors(sp.S.One, tuple(Factor(made.expression(p), k, True) for p, k in whole))
        number, parts = powers(made, whole)
    except (TooLarge, NoTape, ZeroDivisionError):
        return None
    if sum(len(one.polynomial) for one in parts) > _MOST_TERMS or any(one.exponent.denominator != 1 for one in parts):
        return None
    irreducible = (Factor(made.expression(p.polynomial), int(p.exponent), one_sign(made, p.polynomial)) for p in parts)
    return Factors(number, tuple(irreducible))


def one_sign(field: Field, polynomial: Any) -> bool:
    """Terms of one sign, in squares and what is never negative, one of them never 0."""
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
    """The degree of a polynomial in each angle's generator."""
    highest = polynomial.degrees()
    return {g: int(highest[g]) for g in field.angles}


def even_degrees(degree: Mapping[int, int]) -> bool:
    """Whether every degree is even."""
    return not any(k % 2 for k in degree.values())


def factored_form(
    field: Field, polynomial: Any, degree: Mapping[int, int]
) -> tuple[sp.Rational, list[tuple[sp.Expr, int]]]:
    """The form of the given even degrees as a number and powers of factors, without numbers before them.

    Raises: `TooLarge`.
    """
    if not any(degree.values()):
        return _primitive(sp.S.One, [(field.expression(polynomial), 1)])
    count = len(field.generators)
    ring = ring_of([*field.generators, *(sp.Dummy() for _ in range(2 * len(field.angles)))])
    cosines = dict(zip(field.angles, ring.gens()[count::2], strict=True))
    sines = dict(zip(field.angles, ring.gens()[count + 1 :: 2], strict=True))
    layers: dict[tuple[int, ...], dict[tuple[int, ...], Any]] = {}
    for powers, coefficient in polynomial.terms():
        rest = tuple(0 if g in field.angles else int(k) for g, k in enumerate(powers[:count]))
        key = tuple(int(powers[g]) for g in field.angles)
        layers.setdefault(key, {})[(*rest, *(0,) * (2 * len(field.angles)))] = coefficient
    total, one = ring.constant(0), ring.constant(1)
    for key, terms in layers.items():
        layer = ring.from_dict(terms)
        for g, k in zip(field.angles, key, strict=True):
            c, s, left = cosines[g], sines[g], degree[g] - k
            layer = layer * ((s / 2) ** (k % 2) * ((one - c) / 2) ** (k // 2) * ((one + c) / 2) ** (left // 2))
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
