"""A plant over a field that is closed under its derivatives: quotients of polynomials in symbols and kernels.

x' = f(x, k),  y = h(x, k),  dk_j/dx_i = s_ji(x, k)         k: exp(m), tan(m/2), roots, logarithms, ..
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from hgogen.algebra.field import Field, field
from hgogen.algebra.points import exact
from hgogen.algebra.quotient import Quotient, add, multiply, partial
from hgogen.algebra.rewrite import Exp, Half, TooLarge, Writer

_KERNELS = 24  # kernels whose derivatives bring in others, without end or nearly


@dataclass(frozen=True)
class Tower:
    """`flow` (n) and `output` (p) in the `field`; `slopes[g, i]`: dg/dx_i of generator g where it is not 0."""

    states: tuple[sp.Symbol, ...]
    field: Field
    flow: tuple[Quotient, ...]
    output: tuple[Quotient, ...]
    slopes: Mapping[tuple[int, int], Quotient]

    def gradient(self, value: Quotient) -> list[Quotient]:
        """The partial derivatives of a value with respect to the states.

        Raises: `TooLarge`.
        """
        ring = self.field.ring
        partials = [(ring.constant(0), ring.constant(1))] * len(self.states)
        for (g, i), slope in self.slopes.items():
            part = partial(value, g)
            if not part[0].is_zero():
                partials[i] = add(partials[i], multiply(part, slope))
        return partials


def tower(flow: Sequence[sp.Expr], output: Sequence[sp.Expr], states: Sequence[sp.Symbol]) -> Tower:
    """The field of a plant and of its derivatives.

    Raises: `TooLarge`; `ZeroDivisionError` for a division by what is identically 0; `NoTape` for an unknown function.
    """
    writer = Writer()
    rows = [exact(sp.sympify(e)) for e in (*flow, *output)]
    for row in rows:
        writer.measure(row)
    values = [writer.write(row) for row in rows]
    slopes = dict(_slopes(writer, states))
    made, as_quotients = field(writer, (*values, *slopes.values(), *states))
    place = {g: k for k, g in enumerate(made.generators)}
    n, m = len(states), len(rows)
    own = {(place[x], i): (made.ring.constant(1), made.ring.constant(1)) for i, x in enumerate(states)}
    steep = {(place[g], i): q for (g, i), q in zip(slopes, as_quotients[m:], strict=False)}
    return Tower(tuple(states), made, tuple(as_quotients[:n]), tuple(as_quotients[n:m]), own | steep)


def _slopes(writer: Writer, states: Sequence[sp.Symbol]) -> Iterator[tuple[tuple[sp.Symbol, int], sp.Expr]]:
    """The slopes dk/dx_i of every kernel, also of the kernels that the derivatives bring in."""
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
        return kernel * writer.write(key.args[0].diff(x)) * key.args[1]
    if isinstance(key, Half):
        return (1 + kernel**2) * writer.write(key.args[0].diff(x)) * key.args[1] / 2
    return writer.write(key.diff(x))
