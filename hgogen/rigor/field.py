"""The field of a set of expressions: quotients of polynomials in symbols and kernels, with what each kernel means.

The kernels are those of `rewrite`: exp(m), tan(m/2), roots, logarithms, .. sin and cos are rational in T = tan(m/2), so
that the ring has unique factorisation, which it has not with sin and cos and their relation. For the same reason a root
of c s + r, with a number c and an r without the symbol s, takes the place of s:

    g^q = c s + r   =>   s = (g^q - r)/c

Quotients are formed by a tape with FLINT's polynomials over the rationals; sizes are limited by counts of terms.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import comb
from typing import Any

import sympy as sp
from flint import Ordering, fmpq, fmpq_mpoly_ctx

from hgogen.rigor.rewrite import Exp, Half, Relation, TooLarge, Writer
from hgogen.rigor.tape import Instruction, NoTape, tape

# --- quotients

# Products of more terms than this are not formed.
_TERMS = 200_000
# Nor powers whose coefficients may have more digits than this together.
_DIGITS = 4_000_000
# Numerator and denominator, without a common factor.
Quotient = tuple[Any, Any]


def ring_of(generators: Sequence[sp.Symbol]) -> Any:
    """The ring of polynomials in the generators, in their order."""
    return fmpq_mpoly_ctx.get([f"g{i}" for i in range(len(generators))] or ["g"], Ordering.degrevlex)


def quotients(expressions: Iterable[sp.Expr], generators: Sequence[sp.Symbol], ring: Any) -> list[Quotient]:
    """Rational functions of the generators.

    Raises: `TooLarge`; `ZeroDivisionError` for a denominator that is zero; `NoTape` for what is no such function.
    """
    program = tape(expressions, generators)
    values: list[Quotient] = []
    for instruction in program.instructions:
        values.append(_apply(instruction, [values[i] for i in instruction.args], ring))
    return [values[i] for i in program.outputs]


def _apply(instruction: Instruction, args: list[Quotient], ring: Any) -> Quotient:
    op, value, one = instruction.op, instruction.value, ring.constant(1)
    if op == "symbol":
        return ring.gens()[value], one
    if op == "number":
        return ring.constant(fmpq(value.numerator, value.denominator)), one
    if op == "add":
        return add(*args)
    if op == "mul":
        return multiply(*args)
    if op == "power":
        (top, bottom), exponent = args[0], int(value or 0)
        if exponent < 0:
            if top.is_zero():
                raise ZeroDivisionError
            top, bottom = bottom, top
        return power(top, abs(exponent)), power(bottom, abs(exponent))
    raise NoTape(op, "a rational function")


def add(one: Quotient, other: Quotient) -> Quotient:
    """a/b + c/d. Raises: `TooLarge`."""
    (a, b), (c, d) = one, other
    if b == d:
        return _cancelled(a + c, b)
    shared = b.gcd(d)
    left, right = d / shared, b / shared
    return _cancelled(times(a, left) + times(c, right), times(b, left))


def multiply(one: Quotient, other: Quotient) -> Quotient:
    """a/b c/d. Raises: `TooLarge`."""
    (a, b), (c, d) = one, other
    (a, d), (c, b) = _cancelled(a, d), _cancelled(c, b)
    return times(a, c), times(b, d)


def partial(value: Quotient, generator: int) -> Quotient:
    """The derivative by one generator, the others held. Raises: `TooLarge`."""
    top, bottom = value
    if bottom.is_constant():
        return top.derivative(generator) / bottom, bottom.context().constant(1)
    up = times(top.derivative(generator), bottom) - times(top, bottom.derivative(generator))
    return _cancelled(up, times(bottom, bottom))


def times(a: Any, b: Any) -> Any:
    """The product of two polynomials. Raises: `TooLarge`."""
    if len(a) * len(b) > _TERMS:
        raise TooLarge("a product")
    return a * b


def power(base: Any, exponent: int) -> Any:
    """A whole power of a polynomial. Raises: `TooLarge`."""
    if len(base) > 1:  # of two terms or more; first a bound that costs nothing
        terms = comb(len(base) + exponent - 1, exponent) if exponent < _TERMS else _TERMS + 1
        if terms > _TERMS or terms * exponent > _DIGITS:
            raise TooLarge("a power")
    return base**exponent


def _cancelled(top: Any, bottom: Any) -> Quotient:
    if bottom.is_constant():
        return top, bottom
    shared = top.gcd(bottom)
    return top / shared, bottom / shared


# --- fields


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


# --- relations


def vanishes(expression: sp.Expr) -> bool | None:
    """True: zero wherever it is defined. False: a rational function of symbols that is zero nowhere on a dense
    open set, and defined there. None: not decided. The numbers are exact.

    Source: normal forms of rational functions over a tower of radicals; B. F. Caviness, R. J. Fateman,
    "Simplification of radical expressions", SYMSAC 1976.
    """
    writer = Writer()
    try:
        writer.measure(expression)
        parts = [writer.write(expression), *(relation.value for relation in writer.relations)]
        read = {s for part in parts for s in part.free_symbols} | {r.generator for r in writer.relations}
        every = (*sorted(expression.free_symbols, key=str), *writer.kernels.values())
        generators = [s for s in every if s in read]
        (top, _), *values = quotients(parts, generators, ring_of(generators))
        for relation, value in reversed(list(zip(writer.relations, values, strict=True))):
            (top,), _ = reduced([top], generators.index(relation.generator), relation.degree, value)
    except (TooLarge, ZeroDivisionError, NoTape):
        return None
    if top.is_zero():
        return True
    return False if read <= expression.free_symbols else None


def reduced(row: list[Any], index: int, degree: int, value: Quotient) -> tuple[list[Any], int]:
    """The polynomials with generator^degree replaced by a quotient, times a power of its denominator, and that power.

    Raises: `TooLarge`.
    """
    ring = row[0].context()
    most = max((int(powers[index]) // degree for top in row for powers in top.monoms()), default=0)
    if not most:
        return row, 0
    weights = [times(power(value[0], t), power(value[1], most - t)) for t in range(most + 1)]
    replaced = []
    for top in row:
        layers: dict[int, dict[tuple[int, ...], Any]] = {}
        for powers, coefficient in top.to_dict().items():
            t, left = divmod(int(powers[index]), degree)
            rest = tuple(left if i == index else int(k) for i, k in enumerate(powers))
            layers.setdefault(t, {})[rest] = coefficient
        replaced.append(
            sum((times(ring.from_dict(terms), weights[t]) for t, terms in layers.items()), ring.constant(0))
        )
    return replaced, most
