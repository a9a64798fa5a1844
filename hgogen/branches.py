"""Whether a polynomial in a field's generators that is not 0 identically may be 0 on a part of the domain.

|x| - x is not 0, and is 0 where x >= 0: (|x| - x) (|x| + x) = 0, so a division by either, which elimination needs,
loses the value on a part. It cannot be where the generators are analytic and the roots independent: where no product

    prod value_i^(k_i)     not all k_i divisible by p,  p a prime that divides the degrees

is a p-th power of a rational function, a number apart.   Source: Kummer theory, S. Lang, Algebra, chapter VI.8
"""

from typing import Any

import flint
import sympy as sp

from hgogen.field import Field, Root

ROUGH = (sp.Abs, sp.Min, sp.Max, sp.sign, sp.Piecewise, sp.floor, sp.ceiling, sp.Heaviside, sp.nan, sp.zoo, sp.oo)


def branches(field: Field) -> bool:
    """Whether it may; a function with kinks or jumps, two inverse functions, or roots not shown to be independent."""
    functions = [m for m, g in zip(field.meaning, field.generators, strict=True) if g.is_Dummy and _other(m)]
    if len(functions) > 1 or any(m.has(*ROUGH) for m in field.meaning):
        return True
    roots = [root for root in field.relations if not _number(root)]
    places = [root.index for root in roots]
    if any(end.degrees()[k] for root in roots for end in root.value for k in places):
        return True  # a root of a root
    primes = {int(p) for root in roots for p, _ in flint.fmpz(root.degree).factor()}
    return any(_dependent([root for root in roots if root.degree % p == 0], p) for p in sorted(primes))


def _other(meaning: sp.Expr) -> bool:
    """Neither a root nor a logarithm, exponential or angle, which have no branches between which to choose."""
    return isinstance(meaning, sp.Function) and not isinstance(meaning, (sp.log, sp.exp, sp.tan, sp.Abs))


def _number(root: Root) -> bool:
    return all(end.is_constant() for end in root.value)


def _dependent(roots: list[Root], prime: int) -> bool:
    """Whether the exponents of irreducible factors have rank below the number of roots, modulo the prime."""
    found = [_exponents(root) for root in roots]
    names = sorted(set().union(*found))
    matrix = flint.nmod_mat(
        len(found), len(names), [one.get(name, 0) % prime for one in found for name in names], prime
    )
    return bool(matrix.rank() < len(found))


def _exponents(root: Root) -> dict[str, int]:
    ends: list[tuple[Any, int]] = [(root.value[0], 1), (root.value[1], -1)]
    return {str(p / p.leading_coefficient()): sign * int(k) for end, sign in ends for p, k in end.factor()[1]}
