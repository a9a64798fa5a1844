"""A product of polynomials over a field as powers of irreducible ones.

    prod P^e = number * prod (irreducible, monic)^e;   a root's g^(k/q) counts for what it is a root of

and of a square root g that replaces a symbol, P(g) and P(-g) make one, which has no root.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import sympy as sp

from hgogen.algebra import reduced
from hgogen.elimination import Product
from hgogen.field import Field, number


@dataclass(frozen=True)
class Power:
    """A monic polynomial to an exponent that is not 0."""

    polynomial: Any
    exponent: Fraction


def powers(field: Field, product: Product) -> tuple[sp.Expr, list[Power]]:
    """The number and the powers.

    Raises: `TooLarge`.
    """
    for root in reversed(field.relations):  # so that equal functions are equal polynomials
        plain = [(*reduced([p], root.index, root.degree, root.value), e) for p, e in product]
        product = [*((p, e) for (p,), _, e in plain), (root.value[1], -sum(k * e for _, k, e in plain))]
    value = sp.Mul(*(number(p.leading_coefficient()) ** e for p, e in product))
    whole = _merged((p / p.leading_coefficient(), Fraction(e)) for p, e in product)
    parts = _merged((_monic(p), e * k) for polynomial, e in whole for p, k in polynomial.factor()[1])
    for root in reversed(field.roots):
        generator = field.ring.gens()[root.index]
        share = sum((e for p, e in parts if p == generator), Fraction(0)) / root.degree
        ends = ((root.value[0], share), (root.value[1], -share)) if share else ()
        value *= sp.Mul(*(number(end.leading_coefficient()) ** sp.Rational(e) for end, e in ends))
        more = [(_monic(p), e * k) for end, e in ends for p, k in end.factor()[1]]
        parts = _merged([*((p, e) for p, e in parts if p != generator), *more])
        if root.rational and root.degree == 2:
            parts = _joined(parts, root.index)
    return value, [Power(p, e) for p, e in parts]


def _joined(parts: list[tuple[Any, Fraction]], index: int) -> list[tuple[Any, Fraction]]:
    """P(g) P(-g) as one where both have the same exponent: with g^2 = x + 1, (g - 1) (g + 1) is x."""
    left = {str(p): (p, e) for p, e in parts}
    found = []
    for p, e in parts:
        if left.pop(str(p), None) is None:
            continue
        generators = list(p.context().gens())
        generators[index] = -generators[index]
        other = _monic(p.compose(*generators))
        if left.get(str(other), (None, None))[1] == e:
            del left[str(other)]
            p = p * other
        found.append((p, e))
    return found


def _monic(polynomial: Any) -> Any:
    return polynomial / polynomial.leading_coefficient()


def _merged(parts: Iterable[tuple[Any, Fraction]]) -> list[tuple[Any, Fraction]]:
    """Equal polynomials once, those to the power 0 not at all."""
    found: dict[str, tuple[Any, Fraction]] = {}
    for polynomial, exponent in parts:
        key = str(polynomial)
        found[key] = polynomial, found.get(key, (None, Fraction(0)))[1] + exponent
    return [one for one in found.values() if one[1] and not one[0].is_constant()]
