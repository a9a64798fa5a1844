"""A plant over a field that is closed under its derivatives: quotients of polynomials in symbols and kernels.

    x' = f(x, k),  y = h(x, k),  dk_j/dx_i = s_ji(x, k)         k: exp(m), tan(m/2), roots, logarithms, ..

The kernels are those of `rewrite`: sin and cos are rational in T = tan(m/2), so that the field has unique
factorisation, which it has not with sin and cos and their relation.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sympy as sp

from hgogen.points import exact
from hgogen.quotient import Quotient, add, multiply, partial, quotients, ring_of
from hgogen.rewrite import Exp, Half, TooLarge, Writer

_KERNELS = 24  # kernels whose derivatives bring in others, without end or nearly


@dataclass(frozen=True)
class Root:
    """Generator number `index` to the power `degree` is `value`."""

    index: int
    degree: int
    value: Quotient


@dataclass(frozen=True)
class Tower:
    """`generators` of the `ring`: symbols, then kernels; `meaning`: the function of the symbols that each stands for.

    `angles`: the angle m of each generator that is tan(m/2); `exponents`: what each generator that is an exponential
    is exp of; `slopes[g, i]`: dg/dx_i where it is not 0.
    """

    states: tuple[sp.Symbol, ...]
    generators: tuple[sp.Symbol, ...]
    meaning: tuple[sp.Expr, ...]
    ring: Any
    flow: tuple[Quotient, ...]
    output: tuple[Quotient, ...]
    slopes: Mapping[tuple[int, int], Quotient]
    roots: tuple[Root, ...]
    angles: Mapping[int, sp.Expr]
    exponents: Mapping[int, sp.Expr]

    def gradient(self, value: Quotient) -> list[Quotient]:
        """The derivatives by the states.

        Raises: `TooLarge`.
        """
        zero = self.ring.constant(0), self.ring.constant(1)
        found = [zero] * len(self.states)
        for (g, i), slope in self.slopes.items():
            part = partial(value, g)
            if not part[0].is_zero():
                found[i] = add(found[i], multiply(part, slope))
        return found

    def expression(self, polynomial: Any) -> sp.Expr:
        """A polynomial in the symbols and functions that the generators stand for."""
        return sp.Add(*(_monomial(powers, c, self.meaning) for powers, c in polynomial.terms()))

    def kernels(self, polynomial: Any) -> bool:
        """Whether the polynomial reads a kernel."""
        return any(d and g.is_Dummy for d, g in zip(polynomial.degrees(), self.generators, strict=False))


def _monomial(powers: Sequence[int], coefficient: Any, values: Sequence[sp.Expr]) -> sp.Expr:
    number = sp.Rational(int(coefficient.p), int(coefficient.q))
    return sp.Mul(number, *(value ** int(k) for value, k in zip(values, powers, strict=False) if k))


def tower(flow: Sequence[sp.Expr], output: Sequence[sp.Expr], states: Sequence[sp.Symbol]) -> Tower:
    """The field of a plant.

    Raises: `TooLarge`; `ZeroDivisionError` for a division by what is identically 0; `NoTape` for an unknown function.
    """
    writer = Writer()
    rows = [exact(sp.sympify(e)) for e in (*flow, *output)]
    for row in rows:
        writer.measure(row)
    values = [writer.write(row) for row in rows]
    slopes = dict(_slopes(writer, states))
    right = [relation.value for relation in writer.relations]
    symbols = {s for e in (*values, *slopes.values(), *right) for s in e.free_symbols if not s.is_Dummy} | {*states}
    kernels = {dummy: key for key, dummy in writer.kernels.items()}
    generators = (*sorted(symbols, key=str), *kernels)
    place = {s: k for k, s in enumerate(generators)}
    ring = ring_of(generators)
    found = quotients((*values, *slopes.values(), *right), generators, ring)
    n, m = len(states), len(rows)
    steep = {(place[g], i): q for (g, i), q in zip(slopes, found[m : m + len(slopes)], strict=True)}
    one = ring.constant(1), ring.constant(1)
    return Tower(
        states=tuple(states),
        generators=generators,
        meaning=tuple(_meaning(kernels[g]) if g in kernels else g for g in generators),
        ring=ring,
        flow=tuple(found[:n]),
        output=tuple(found[n:m]),
        slopes={(place[x], i): one for i, x in enumerate(states)} | steep,
        roots=tuple(
            Root(place[r.generator], r.degree, value)
            for r, value in zip(writer.relations, found[m + len(slopes) :], strict=True)
        ),
        angles={place[g]: key.args[0] / key.args[1] for g, key in kernels.items() if isinstance(key, Half)},
        exponents={place[g]: key.args[0] / key.args[1] for g, key in kernels.items() if isinstance(key, Exp)},
    )


def _slopes(writer: Writer, states: Sequence[sp.Symbol]) -> Iterator[tuple[tuple[sp.Symbol, int], sp.Expr]]:
    """dk/dx_i of every kernel, of those that the derivatives bring in, too."""
    done = 0
    while done < len(writer.kernels):
        if done >= _KERNELS:
            raise TooLarge(f"a model of more than {_KERNELS} functions")
        key, dummy = list(writer.kernels.items())[done]
        done += 1
        for i, x in enumerate(states):
            if x in key.free_symbols:
                yield (dummy, i), _slope(writer, key, dummy, x)


def _slope(writer: Writer, key: sp.Expr, kernel: sp.Dummy, x: sp.Symbol) -> sp.Expr:
    if isinstance(key, Exp):
        return kernel * writer.write(key.args[0].diff(x)) / key.args[1]
    if isinstance(key, Half):
        return (1 + kernel**2) * writer.write(key.args[0].diff(x)) / (2 * key.args[1])
    return writer.write(key.diff(x))


def _meaning(key: sp.Expr) -> sp.Expr:
    if isinstance(key, Exp):
        return sp.exp(key.args[0] / key.args[1])
    if isinstance(key, Half):
        return sp.tan(key.args[0] / (2 * key.args[1]))
    return key
