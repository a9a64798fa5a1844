"""The zero set of a product of polynomials over a field, as readable factors: without what never vanishes."""

from collections.abc import Sequence
from fractions import Fraction
from math import inf, prod
from random import Random
from typing import Any

import sympy as sp
from flint import arb

from hgogen.algebra.elimination import Product
from hgogen.algebra.factors import Power, degrees, even_degrees, factored_form, one_sign
from hgogen.algebra.field import Field
from hgogen.algebra.identity import is_zero
from hgogen.algebra.pointwise import values
from hgogen.algebra.rewrite import TooLarge
from hgogen.algebra.tape import tape
from hgogen.intervals.sign import nonzero

_TERMS = 1500  # of all factors: more cannot be read
_BOXES, _BITS = 40, 256  # of the question whether a factor ever vanishes; of samples
_LONG = 300  # operations of a factor, beyond which boxes of all numbers cost seconds and decide nothing
_SAMPLES, _GRID = 24, 9  # points, and of what fractions


def alive(field: Field, product: Product) -> bool:
    """Whether no polynomial of it is 0 identically, for certain: one without kernels is its own proof, others have a
    value whose ball excludes 0, or are left to `is_zero`.
    """
    left = [p for p, _ in product if field.kernels(p)]
    symbols = sorted({s for e in field.meaning for s in e.free_symbols}, key=str)
    program = tape(field.meaning, symbols)
    draw = Random(1)
    for _ in range(_SAMPLES):
        point = [Fraction(draw.randint(1, _GRID), draw.randint(1, _GRID)) for _ in symbols]
        if left:
            balls = values(program, point, _BITS)
            left = [p for p in left if not _not_zero(p, balls)]
    return all(is_zero(field.expression(p)) is False for p in left)


def _not_zero(polynomial: Any, balls: Sequence[Any]) -> bool:
    """Whether its value, where the generators have these, excludes 0."""
    total = arb(0)
    for exponents, c in polynomial.terms():
        total += prod((ball**k for ball, k in zip(balls, exponents, strict=False) if k), start=arb(c))
    return bool(total.is_finite() and not total.contains(0))


def zero_set(field: Field, parts: Sequence[Power]) -> tuple[sp.Expr, ...] | None:
    """Factors whose zero sets together are that of the product of the powers, where it is defined; none where the
    product has no zero.

    The answer is None where it depends on what the field does not decide: a factor x**a with a symbol a, or a zero and
    a pole that may cancel by a relation between functions.

    Raises: `TooLarge`.
    """
    zeros = [one.polynomial for one in parts if one.exponent > 0 and not one_sign(field, one.polynomial)]
    poles = [one.polynomial for one in parts if one.exponent < 0 and not one_sign(field, one.polynomial)]
    if sum(map(len, zeros)) > _TERMS:
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
    vanishing = set()  # without those that are proved to be 0 nowhere; of a long one it is not asked
    for e in factors:
        everywhere = dict.fromkeys(e.free_symbols, (-inf, inf))
        if e.count_ops() > _LONG or not nonzero(e, everywhere, boxes=_BOXES, refute=False).never:
            vanishing.add(_signed(e))
    return tuple(sorted(vanishing, key=sp.default_sort_key))


def _forms(field: Field, zeros: Sequence[Any], parts: Sequence[Power]) -> list[tuple[Any, dict[int, int]]]:
    """Polynomials with an even degree in each angle's generator: the `zeros` that have one, and the product of the
    others, times cos(m/2) where the whole product is 0 at m = pi, squared where its degree is odd.
    """
    infinite = [g for g in field.angles if sum(p.exponent * degrees(field, p.polynomial)[g] for p in parts) < 0]
    forms = [(p, degrees(field, p)) for p in zeros if even_degrees(degrees(field, p))]
    odd = [p for p in zeros if not even_degrees(degrees(field, p))]
    if not odd and not infinite:
        return forms
    total = field.ring.constant(1)
    for p in odd:
        if len(total) * len(p) > _TERMS:
            raise TooLarge("the determinant")
        total = total * p
    degree = {g: k + (g in infinite) for g, k in degrees(field, total).items()}
    if not even_degrees(degree):
        total, degree = total * total, {g: 2 * k for g, k in degree.items()}
    return [*forms, (total, degree)]


def _signed(e: sp.Expr) -> sp.Expr:
    """A factor in one sign; of a root, what it is a root of."""
    if isinstance(e, sp.Pow) and e.exp.is_Rational and e.exp.is_positive:
        return _signed(e.base)
    return -e if e.could_extract_minus_sign() else e
