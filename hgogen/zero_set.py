"""The zero set of a product of polynomials over a tower, as readable factors: without what never vanishes.

    prod P^e = prod (irreducible)^e,   kept where e > 0; a root's g^(1/q) counts for g

A factor in T = tan(m/2), of degree d, times cos(m/2)^d is a form in cos(m/2), sin(m/2): it sees m = pi, too, where T
is infinite. Forms of even degree are polynomials in cos m, sin m; odd ones are multiplied together first.
"""

import random
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import inf
from typing import Any

import sympy as sp

from hgogen.bounds import nonzero
from hgogen.check import Verdict
from hgogen.codistribution import Product
from hgogen.identity import is_zero
from hgogen.pointwise import values
from hgogen.rewrite import TooLarge
from hgogen.tape import tape
from hgogen.tower import Tower

_TERMS = 1500  # of all factors: more cannot be read
_FEW = 3  # symbols, and boxes, of a factor that bounds are asked whether it ever vanishes
_BOXES = 40
_SAMPLES, _GRID = 24, 9


@dataclass(frozen=True)
class _Power:
    polynomial: Any
    exponent: Fraction


def zero_set(tower: Tower, product: Product) -> tuple[sp.Expr, ...] | None:
    """Factors whose zero sets together are that of the product where it is defined; empty where it has no zero.

    None: it may be 0 identically by relations between functions that the tower has not, or x**a with a symbol a is a
    factor, whose zeros depend on a.

    Raises: `TooLarge`.
    """
    if not all(_alive(tower, polynomial) for polynomial, _ in product):
        return None
    powers = _irreducible(tower, product)
    positive = [one for one in powers if one.exponent > 0]
    if sum(len(one.polynomial) for one in positive) > _TERMS:
        raise TooLarge("the determinant")
    if any(_symbolic(tower, one.polynomial) for one in positive):
        return None
    kept = [one.polynomial for one in positive if not _definite(tower, one.polynomial)]
    even, odd = _by_parity(tower, kept, _at_infinity(tower, powers))
    found = [factor for e in (*even, *odd) for factor in e]
    return tuple(sorted({_signed(e) for e in found if not _never(e)}, key=sp.default_sort_key))


def _alive(tower: Tower, polynomial: Any) -> bool:
    """Whether it is not 0 identically, for certain: without kernels a polynomial is its own proof."""
    return not tower.kernels(polynomial) or is_zero(tower.expression(polynomial)) is False


# ---------------------------------------------------------------- factors and their powers


def _irreducible(tower: Tower, product: Product) -> list[_Power]:
    whole = _merged((polynomial / polynomial.leading_coefficient(), Fraction(e)) for polynomial, e in product)
    parts = _merged((p, e * k) for polynomial, e in whole for p, k in polynomial.factor()[1])
    for root in reversed(tower.roots):
        generator = tower.ring.gens()[root.index]
        share = sum((e for p, e in parts if p == generator), Fraction(0)) / root.degree
        ends = ((root.value[0], share), (root.value[1], -share)) if share else ()
        more = [(p, e * k) for end, e in ends for p, k in end.factor()[1]]
        parts = _merged([*((p, e) for p, e in parts if p != generator), *more])
    return [_Power(p, e) for p, e in parts]


def _merged(powers: Iterable[tuple[Any, Fraction]]) -> list[tuple[Any, Fraction]]:
    """Equal polynomials once, those to the power 0 not at all."""
    found: dict[str, tuple[Any, Fraction]] = {}
    for polynomial, exponent in powers:
        key = str(polynomial)
        found[key] = polynomial, found.get(key, (None, Fraction(0)))[1] + exponent
    return [one for one in found.values() if one[1] and not one[0].is_constant()]


def _symbolic(tower: Tower, polynomial: Any) -> bool:
    """x**a, which may have a zero at x = 0 or not."""
    return len(polynomial) == 1 and any(
        degree and tower.exponents[g].has(sp.log)
        for g, degree in enumerate(polynomial.degrees())
        if g in tower.exponents
    )


def _definite(tower: Tower, polynomial: Any) -> bool:
    """Terms of one sign, in squares and what is never negative, one of them never 0."""
    terms = list(polynomial.terms())
    if len({c > 0 for _, c in terms}) > 1:
        return False
    roots = {root.index for root in tower.roots if root.degree % 2 == 0}
    names = [(g.is_positive or k in tower.exponents, k in roots) for k, g in enumerate(tower.generators)]
    free = [[name for name, d in zip(names, powers, strict=False) if d] for powers, _ in terms]
    odd = [[name for name, d in zip(names, powers, strict=False) if d % 2] for powers, _ in terms]
    return all(any(name) for term in odd for name in term) and any(all(p for p, _ in term) for term in free)


# ---------------------------------------------------------------- angles


def _at_infinity(tower: Tower, powers: list[_Power]) -> list[int]:
    """The angles' generators at whose infinity, cos(m/2) = 0, the product is 0."""
    return [g for g in tower.angles if sum(one.exponent * int(one.polynomial.degrees()[g]) for one in powers) < 0]


def _by_parity(tower: Tower, kept: list[Any], infinite: list[int]) -> tuple[list[list[sp.Expr]], list[list[sp.Expr]]]:
    """The factors of even degree in each angle's generator, each written out, and the product of the others."""
    degrees = [{g: int(p.degrees()[g]) for g in tower.angles} for p in kept]
    even = [(p, d) for p, d in zip(kept, degrees, strict=True) if not any(k % 2 for k in d.values())]
    odd = [(p, d) for p, d in zip(kept, degrees, strict=True) if any(k % 2 for k in d.values())]
    written = [_written(tower, p, d) for p, d in even]
    if not odd and not infinite:
        return written, []
    total = tower.ring.constant(1)
    for p, _ in odd:
        if len(total) * len(p) > _TERMS:
            raise TooLarge("the determinant")
        total = total * p
    degree = {g: sum(d[g] for _, d in odd) + (g in infinite) for g in tower.angles}
    if any(k % 2 for k in degree.values()):
        total, degree = total * total, {g: 2 * k for g, k in degree.items()}
    return written, [_written(tower, total, degree)]


def _written(tower: Tower, polynomial: Any, degree: Mapping[int, int]) -> list[sp.Expr]:
    """The form of even degree in each angle's cos(m/2), sin(m/2), factored as a polynomial in cos m, sin m."""
    if not any(degree.values()):
        return [tower.expression(polynomial)]
    total = []
    for powers, coefficient in polynomial.terms():
        rest = [0 if g in tower.angles else int(k) for g, k in enumerate(powers)]
        plain = sp.Mul(*(v**k for v, k in zip(tower.meaning, rest, strict=False) if k))
        number = sp.Rational(int(coefficient.p), int(coefficient.q))
        turns = (_turn(tower.angles[g], int(powers[g]), d) for g, d in degree.items())
        total.append(number * plain * sp.Mul(*turns))
    value = _plainer(sp.expand(sp.Add(*total)), tower)
    return [factor for factor, _ in sp.factor_list(value)[1]]


def _turn(angle: sp.Expr, k: int, degree: int) -> sp.Expr:
    """sin(m/2)^k cos(m/2)^(degree - k) in cos m and sin m."""
    c, s = sp.cos(angle), sp.sin(angle)
    up, down = divmod(k, 2), divmod(degree - k, 2)
    return (s / 2) ** up[1] * ((1 - c) / 2) ** up[0] * ((1 + c) / 2) ** down[0]


def _plainer(value: sp.Expr, tower: Tower) -> sp.Expr:
    """With cos^2 as 1 - sin^2 where that is shorter."""
    for angle in tower.angles.values():
        c, s = sp.Dummy(), sp.Dummy()
        inside = sp.Poly(value.xreplace({sp.cos(angle): c, sp.sin(angle): s}), c)
        other = sum((e * (1 - s**2) ** (k // 2) * c ** (k % 2) for (k,), e in inside.terms()), sp.S.Zero)
        back = sp.expand(other).xreplace({c: sp.cos(angle), s: sp.sin(angle)})
        value = min(value, back, key=lambda e: len(sp.Add.make_args(e)))
    return value


# ---------------------------------------------------------------- what never vanishes


def _never(e: sp.Expr) -> bool:
    """Whether the factor is proved to be 0 for no real values of its symbols."""
    if not e.free_symbols or e.is_zero is False:
        return e.is_zero is False
    if len(e.free_symbols) > _FEW or _changes_sign(e):
        return False
    return nonzero(e, dict.fromkeys(e.free_symbols, (-inf, inf)), boxes=_BOXES).verdict is Verdict.PROVED


def _changes_sign(e: sp.Expr) -> bool:
    """Whether sample points show both signs, or 0, or nothing: then bounds are not asked."""
    symbols = sorted(e.free_symbols, key=str)
    program, draw = tape((e,), symbols), random.Random(1)
    points = [[Fraction(draw.randint(-_GRID, _GRID), draw.randint(1, _GRID)) for _ in symbols] for _ in range(_SAMPLES)]
    found = [values(program, point)[0] for point in points]
    return not any(all(test(ball) for ball in found if ball.is_finite()) for test in (_above, _below))


def _above(ball: Any) -> bool:
    return bool(ball > 0)


def _below(ball: Any) -> bool:
    return bool(ball < 0)


def _signed(e: sp.Expr) -> sp.Expr:
    return -e if e.could_extract_minus_sign() else e
