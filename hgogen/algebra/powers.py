"""A product of polynomials over a field as powers of irreducible ones, with whole exponents, or fractions of them.

    prod P^e = number * prod (irreducible, monic)^e

A root's generator is a polynomial of its own: (p q)^(1/2) is p^(1/2) q^(1/2) only where p and q are not negative, and
(p^2)^(1/2) is |p|. Only for the zero set it is what it is a root of to a fraction. Of a square root g that replaces a
symbol, P(g) and P(-g) make one polynomial, which has no root.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import sympy as sp

from hgogen.algebra.elimination import Product
from hgogen.algebra.field import Field, Root, number
from hgogen.algebra.relations import reduced


@dataclass(frozen=True)
class Power:
    """A monic polynomial to an exponent that is not 0."""

    polynomial: Any
    exponent: Fraction


_Parts = list[tuple[Any, Fraction]]


def powers(field: Field, product: Product) -> tuple[sp.Expr, list[Power]]:
    """The number and the powers, all whole: the product's value wherever the roots are real.

    Raises: `TooLarge`.
    """
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


def split(field: Field, parts: Sequence[Power]) -> list[Power]:
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
