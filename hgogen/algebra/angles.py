"""Polynomials in T = tan(m/2) written in cos m and sin m.

A polynomial of degree d in T, times cos(m/2)^d, is a form in cos(m/2), sin(m/2): it sees m = pi, too, where T is
infinite. A form of even degree is a polynomial in cos m, sin m:

    sin(m/2)^k cos(m/2)^(d - k) = (sin m/2)^(k mod 2) ((1 - cos m)/2)^(k div 2) ((1 + cos m)/2)^((d - k) div 2)
"""

from collections.abc import Mapping
from typing import Any

import sympy as sp

from hgogen.algebra.field import Field, number, written
from hgogen.algebra.quotient import ring_of
from hgogen.algebra.rewrite import TooLarge

_TERMS = 3000


def degrees(field: Field, polynomial: Any) -> dict[int, int]:
    """The degree of a polynomial in each angle's generator."""
    highest = polynomial.degrees()
    return {g: int(highest[g]) for g in field.angles}


def even(degree: Mapping[int, int]) -> bool:
    """Whether every degree is even."""
    return not any(k % 2 for k in degree.values())


def factored(field: Field, polynomial: Any, degree: Mapping[int, int]) -> tuple[sp.Rational, list[tuple[sp.Expr, int]]]:
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
        if len(total) > _TERMS:
            raise TooLarge("the form in sines and cosines")
    for g in field.angles:
        total = min(total, _less_cosine(total, ring.gens().index(cosines[g]), sines[g]), key=len)
    meaning = [*field.meaning, *(f(m) for m in field.angles.values() for f in (sp.cos, sp.sin))]
    content, parts = total.factor()
    return _primitive(number(content), [(written(p, meaning), int(k)) for p, k in parts])


def _primitive(content: sp.Rational, parts: list[tuple[sp.Expr, int]]) -> tuple[sp.Rational, list[tuple[sp.Expr, int]]]:
    split = [(*e.primitive(), k) for e, k in parts]
    return content * sp.Mul(*(c**k for c, _, k in split)), [(e, k) for _, e, k in split]


def _less_cosine(polynomial: Any, index: int, s: Any) -> Any:
    """The polynomial with cos^2 written as 1 - sin^2."""
    ring = polynomial.context()
    layers: dict[int, dict[tuple[int, ...], Any]] = {}
    for powers, coefficient in polynomial.terms():
        half, left = divmod(int(powers[index]), 2)
        rest = tuple(left if i == index else int(k) for i, k in enumerate(powers))
        layers.setdefault(half, {})[rest] = coefficient
    square = ring.constant(1) - s**2
    return sum((ring.from_dict(terms) * square**half for half, terms in layers.items()), ring.constant(0))
