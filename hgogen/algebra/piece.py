"""Polynomials of several arguments as coefficients of coefficients, and their ranges on boxes.

    p(d, e) = p_0(e) + d p_1(e) + d^2 p_2(e) + ..,    p_i(e) = p_i0 + e p_i1 + ..

The outer tuple is that of the first argument, the constant first; what is no tuple is a constant.
"""

from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from itertools import product
from math import comb, perm
from typing import Any

from flint import fmpq

Polynomial = Any  # a tuple of such, or a coefficient: a number, or whatever is multiplied with numbers
Side = tuple[Fraction, Fraction]
ZERO = Fraction(0)


def value(piece: Polynomial, at: Sequence[Any], number: Callable[[Any], Any] = lambda c: c) -> Any:
    """A polynomial's value by Horner's scheme; `number` is what a coefficient counts as."""
    if not isinstance(piece, tuple):
        return number(piece)
    first, *rest = at
    *others, total = (value(c, rest, number) for c in piece)
    for c in reversed(others):
        total = total * first + c
    return total


def rational(piece: Any) -> Any:
    """The same numbers as those of FLINT, which are multiplied and compared far faster."""
    if isinstance(piece, tuple):
        return tuple(map(rational, piece))
    return piece if isinstance(piece, fmpq) else fmpq(*piece.as_integer_ratio())


def derivative(piece: Polynomial, order: Sequence[int]) -> Polynomial:
    """The derivative, of an order in each argument."""
    if not order:
        return piece
    first, *rest = order
    return tuple(_times(perm(k, first), derivative(c, rest)) for k, c in enumerate(piece))[first:] or _zero(len(order))


def _zero(count: int) -> Polynomial:
    return (_zero(count - 1),) if count else ZERO


def _times(k: int, piece: Polynomial) -> Polynomial:
    return tuple(_times(k, c) for c in piece) if isinstance(piece, tuple) else k * piece


def taylor(piece: tuple[Any, ...], a: Fraction) -> tuple[Any, ...]:
    """The coefficients of the same polynomial of the first argument about a, by Horner's scheme."""
    moved = list(piece)
    for i in range(len(piece) - 1):
        for j in range(len(piece) - 2, i - 1, -1):
            moved[j] = moved[j] + a * moved[j + 1]
    return tuple(moved)


def coefficients(piece: Polynomial) -> Iterator[Any]:
    """All of a polynomial's coefficients."""
    if not isinstance(piece, tuple):
        yield piece
        return
    for c in piece:
        yield from coefficients(c)


def columns(pieces: Sequence[Polynomial]) -> Polynomial:
    """Many polynomials as one, whose coefficients are lists, an entry for each of them."""
    if not any(isinstance(piece, tuple) for piece in pieces):
        return list(pieces)
    parts = [piece if isinstance(piece, tuple) else (piece,) for piece in pieces]
    count = max(map(len, parts))
    return tuple(columns([part[i] if i < len(part) else ZERO for part in parts]) for i in range(count))


def extremes(piece: Polynomial, box: Sequence[Side]) -> Side:
    """The range of a polynomial on a box, of degree 1 at most in every argument but the first: it is attained at the
    ends of those. In the first exact up to degree 2 and where the derivative keeps its sign, else that of the
    coefficients in the basis of Bernstein, whose hull holds it."""
    first, *rest = box
    corners = product(*(dict.fromkeys(side) for side in rest))
    ends = [_along(tuple(value(c, corner) for c in piece), *first) for corner in corners]
    return min(low for low, _ in ends), max(high for _, high in ends)


def _along(piece: tuple[Fraction, ...], a: Fraction, b: Fraction) -> Side:
    ends: tuple[Fraction, ...] = (value(piece, (a,)), value(piece, (b,)))
    slope = derivative(piece, (1,))
    if len(piece) > 3 and any(slope):
        low, high = _along(slope, a, b)
        ends = ends if low >= 0 or high <= 0 else _bernstein(piece, a, b)
    elif len(piece) == 3 and piece[2] and a < (turn := -piece[1] / (2 * piece[2])) < b:
        ends = (*ends, value(piece, (turn,)))
    return min(ends), max(ends)


def _bernstein(piece: tuple[Fraction, ...], a: Fraction, b: Fraction) -> tuple[Fraction, ...]:
    """The coefficients on [a, b] in the basis of Bernstein: beta_i = sum_j C(i, j)/C(n, j) p_j, p on [0, 1]."""
    n = len(piece) - 1
    scaled = [c * (b - a) ** j / comb(n, j) for j, c in enumerate(taylor(piece, a))]
    return tuple(sum(comb(i, j) * scaled[j] for j in range(i + 1)) for i in range(n + 1))
