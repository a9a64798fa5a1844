"""Whether a polynomial in a field's generators that is not 0 identically may be 0 on a part of the domain.

|x| - x is not 0, and is 0 where x >= 0: (|x| - x) (|x| + x) = 0, so a division by either, which elimination needs,
loses the value on a part. It cannot be where the generators are analytic and even roots choose no sign: where no

    prod value_i = c h^2,   a product of some of their values, c a number, so that their square roots make |h|,

has an h that may change its sign.   Source: Kummer theory, S. Lang, Algebra, chapter VI.8
"""

from collections.abc import Sequence
from typing import Any

import flint
import sympy as sp

from hgogen.algebra.field import Field, Root
from hgogen.algebra.kinks import Direction, Norm
from hgogen.algebra.tabulated import Table

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
        ends = [(root.value[0], 1), (root.value[1], -1)]
        monic = [(p / p.leading_coefficient(), sign * int(k)) for end, sign in ends for p, k in end.factor()[1]]
        exponents.append({str(p): (p, k) for p, k in monic})
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
