"""The field of a set of expressions: quotients of polynomials in symbols and kernels, with what each kernel means.

The kernels are those of `rewrite`: exp(m), tan(m/2), roots, logarithms, .. sin and cos are rational in T = tan(m/2), so
that the ring has unique factorisation, which it has not with sin and cos and their relation. For the same reason a root
of c s + r, with a number c and an r without the symbol s, takes the place of s:

    g^q = c s + r   =>   s = (g^q - r)/c
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sympy as sp

from hgogen.algebra.quotient import Quotient, quotients, ring_of
from hgogen.algebra.rewrite import Exp, Half, Relation, Writer


@dataclass(frozen=True)
class Root:
    """Generator number `index` to the power `degree` is `value`; `rational`: where it replaces a symbol."""

    index: int
    degree: int
    value: Quotient
    rational: bool


@dataclass(frozen=True)
class Field:
    """`generators` of the `ring`: symbols, then kernels; `meaning`: the function of the symbols that each stands for.

    `angles`: the angle m of each generator that is tan(m/2); `exponents`: what each generator that is an exponential
    is exp of; `roots`: those with a relation, and those that replace a symbol.
    """

    generators: tuple[sp.Symbol, ...]
    meaning: tuple[sp.Expr, ...]
    ring: Any
    roots: tuple[Root, ...]
    angles: Mapping[int, sp.Expr]
    exponents: Mapping[int, sp.Expr]

    @property
    def relations(self) -> tuple[Root, ...]:
        """The roots that replace no symbol, inner ones first."""
        return tuple(root for root in self.roots if not root.rational)

    def expression(self, polynomial: Any) -> sp.Expr:
        """A polynomial in the symbols and functions that the generators stand for."""
        value, highest = written(polynomial, self.meaning), polynomial.degrees()
        return sp.expand(value) if any(highest[root.index] for root in self.roots) else value

    def kernels(self, polynomial: Any) -> bool:
        """Whether the polynomial reads a kernel."""
        return any(d and g.is_Dummy for d, g in zip(polynomial.degrees(), self.generators, strict=False))


def written(polynomial: Any, values: Sequence[sp.Expr]) -> sp.Expr:
    """The polynomial with a value for each generator."""
    terms = (
        sp.Mul(number(c), *(v ** int(k) for v, k in zip(values, powers, strict=False) if k))
        for powers, c in polynomial.terms()
    )
    return sp.Add(*terms)


def number(coefficient: Any) -> sp.Rational:
    """A coefficient of a polynomial."""
    return sp.Rational(int(coefficient.p), int(coefficient.q))


def field(writer: Writer, expressions: Sequence[sp.Expr]) -> tuple[Field, list[Quotient]]:
    """The field of what a writer has written, and the expressions in it.

    Raises: `TooLarge`; `ZeroDivisionError` for a division by what is identically 0; `NoTape` for an unknown function.
    """
    right = [relation.value for relation in writer.relations]
    symbols = {s for e in (*expressions, *right) for s in e.free_symbols if not s.is_Dummy}
    keys = {dummy: key for key, dummy in writer.kernels.items()}
    generators = (*sorted(symbols, key=str), *keys)
    place = {g: k for k, g in enumerate(generators)}
    ring = ring_of(generators)
    replaced, rational = _replaced(writer.relations)
    as_quotients = quotients([*(e.xreplace(replaced) for e in expressions), *right], generators, ring)
    inner = quotients([e.xreplace(replaced) for e in right], generators, ring)
    roots = (
        Root(place[r.generator], r.degree, plain if r.generator in rational else value, r.generator in rational)
        for r, plain, value in zip(writer.relations, as_quotients[len(expressions) :], inner, strict=True)
    )
    made = Field(
        generators=generators,
        meaning=tuple(_meaning(keys[g]) if g in keys else g for g in generators),
        ring=ring,
        roots=tuple(roots),
        angles={place[g]: key.args[0] * key.args[1] for g, key in keys.items() if isinstance(key, Half)},
        exponents={place[g]: key.args[0] * key.args[1] for g, key in keys.items() if isinstance(key, Exp)},
    )
    return made, as_quotients[: len(expressions)]


def _replaced(relations: Sequence[Relation]) -> tuple[dict[sp.Symbol, sp.Expr], set[sp.Symbol]]:
    """Each symbol that a root replaces, with its value; and the generators of those roots."""
    replacements: dict[sp.Symbol, sp.Expr] = {}
    roots: set[sp.Symbol] = set()
    for relation in relations:
        value = sp.expand(relation.value.xreplace(replacements))
        symbols = sorted((s for s in value.free_symbols if not s.is_Dummy), key=str)
        s = next((s for s in symbols if value.diff(s).is_Rational), None)
        if s is not None:
            new = {s: sp.expand(s + (relation.generator**relation.degree - value) / value.diff(s))}
            replacements = {old: sp.expand(e.xreplace(new)) for old, e in replacements.items()} | new
            roots.add(relation.generator)
    return replacements, roots


def _meaning(key: sp.Expr) -> sp.Expr:
    if isinstance(key, Exp):
        return sp.exp(key.args[0] * key.args[1])
    if isinstance(key, Half):
        return sp.tan(key.args[0] * key.args[1] / 2)
    return key
