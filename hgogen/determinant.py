"""Determinants of matrices of expressions, exactly, and the factors of their zero sets; which rows are independent."""

import random
from collections.abc import Mapping, Sequence
from typing import TypeVar

import mpmath
import sympy as sp
from sympy.polys.matrices import DomainMatrix

from hgogen.points import exact

_Row = TypeVar("_Row")
# Rows are judged at random points with this many digits; a pivot below half of them, relative to its row, counts as 0.
_DIGITS = 60
_TRIGONOMETRIC = (sp.sin, sp.cos, sp.sinh, sp.cosh)


def determinant(rows: Sequence[Sequence[sp.Expr]]) -> sp.Expr:
    """The determinant (n x n), a quotient of polynomials in the symbols and functions that occur, factored."""
    matrix = sp.Matrix([[exact(e) for e in row] for row in rows])
    domain_matrix = DomainMatrix.from_Matrix(matrix).to_field()
    value = domain_matrix.domain.to_sympy(domain_matrix.det())
    if len({type(f) for f in value.atoms(*_TRIGONOMETRIC)}) > 1:  # sin^2 + cos^2 is no identity of polynomials
        value = min(sp.trigsimp(value), value, key=sp.count_ops)
    return sp.factor(value)


def factors(value: sp.Expr) -> tuple[sp.Expr, ...]:
    """The factors of a quotient's numerator that may be 0, each once; empty where it has no zero.

    Numbers and powers of e are left out, and what SymPy knows not to be 0 for the symbols' assumptions.
    """
    numerator, _ = sp.fraction(sp.together(value))
    _, found = sp.factor_list(numerator)
    bases = (_base(factor) for factor, _ in found)
    kept = (-f if f.could_extract_minus_sign() else f for f in bases if not f.is_number and f.is_zero is not False)
    return tuple(sorted(set(kept), key=sp.default_sort_key))


def _base(factor: sp.Expr) -> sp.Expr:
    """b of b**r with a rational r > 0; a real power of e as the number 1."""
    if isinstance(factor, sp.exp):
        return sp.S.One
    if isinstance(factor, sp.Pow) and factor.exp.is_Rational and factor.exp.is_positive:
        return factor.base
    return factor


def independent(rows: Mapping[_Row, Sequence[sp.Expr]], n: int) -> tuple[_Row, ...]:
    """The keys of the first n rows (n entries each) that are generically independent, in order; or fewer.

    By elimination at two random points: a row that is dependent there may be independent elsewhere on a set without
    volume only.
    """
    symbols = sorted(set().union(*(e.free_symbols for row in rows.values() for e in row)), key=str)
    matrix = [[exact(e) for e in row] for row in rows.values()]
    function = sp.lambdify(symbols, matrix, "mpmath", cse=True)
    draw = random.Random(1)
    best: tuple[_Row, ...] = ()
    with mpmath.workdps(_DIGITS):
        for _ in range(2):
            point = [mpmath.mpf(draw.randint(200, 1800)) / 997 for _ in symbols]
            found = _pivots(list(rows), function(*point), n)
            best = max(best, found, key=len)
    return best


def _pivots(names: Sequence[_Row], rows: Sequence[Sequence[mpmath.mpf]], n: int) -> tuple[_Row, ...]:
    """By Gauss: each row is reduced by those taken before it, and taken if something is left of it."""
    small = mpmath.mpf(10) ** (-_DIGITS // 2)
    taken: list[tuple[int, list[mpmath.mpf]]] = []
    chosen: list[_Row] = []
    for name, given in zip(names, rows, strict=True):
        row = [mpmath.mpmathify(entry) for entry in given]
        size = max(map(abs, row))
        for column, pivot in taken:
            share = row[column] / pivot[column]
            row = [a - share * b for a, b in zip(row, pivot, strict=True)]
        column = max(range(n), key=lambda k: abs(row[k]))
        if abs(row[column]) > small * size:
            taken.append((column, row))
            chosen.append(name)
        if len(chosen) == n:
            break
    return tuple(chosen)
