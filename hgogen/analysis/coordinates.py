"""Coordinates z = a signed permutation of the plant's states x, and the split x' = A(u) x + b(x, u).

A plant whose states form chains, as the triangular forms need it, with the checks of its hypotheses.

    z_(i,j)' = a_(i,j+1) z_(i,j+1) + b_(i,j),   z_(i,n_i)' = b_(i,n_i),   y_i = a_(i,1) z_(i,1) + c_i

z is the plant's state chain by chain, with the signs that make the a_(i,j) positive. Where a row is not proved to be
linear in its new state, its a_(i,j) is a difference quotient in the middle of the box.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, count, islice
from typing import Any, TypeAlias

import sympy as sp

from hgogen.analysis.chain import Chains, Link, Shape
from hgogen.analysis.dynamics import linear_terms
from hgogen.analysis.hypotheses import finite_offset, lipschitz, positive, sign
from hgogen.check import Check, ClaimId
from hgogen.form import Form
from hgogen.rigor.box import STRANGE, exact, points
from hgogen.signal import Signal
from hgogen.system import System

# A, b and the output of a form.
Parts: TypeAlias = tuple[sp.ImmutableDenseMatrix, tuple[sp.Expr, ...], tuple[sp.Expr, ...]]


@dataclass(frozen=True)
class Coordinates:
    """The coordinates z_i = sign_i x_order(i), a signed permutation of the plant's states x.

    `states`: z_1..z_n with ranges, units and meanings from the plant's states; `to_form`: z in terms of x; `from_form`:
    x, in the plant's order, in terms of z.
    """

    system: System
    order: tuple[Signal, ...]
    signs: tuple[int, ...]
    states: tuple[Signal, ...]

    @property
    def to_form(self) -> tuple[sp.Expr, ...]:
        """The coordinates z as expressions of the plant's states."""
        return tuple(sign * x for sign, x in zip(self.signs, self.order, strict=True))

    @property
    def from_form(self) -> tuple[sp.Expr, ...]:
        """The plant's states as expressions of z."""
        replace = self.replacement
        return tuple(replace[x] for x in self.system.states)

    @property
    def replacement(self) -> dict[sp.Expr, sp.Expr]:
        """The expression in z of each plant state, by its symbol."""
        return {x: sign * z for x, sign, z in zip(self.order, self.signs, self.states, strict=True)}

    def carry(self, expression: sp.Expr) -> sp.Expr:
        """Return an expression of the plant's states rewritten in z."""
        return expression.xreplace(self.replacement)

    def back(self, expression: sp.Expr) -> sp.Expr:
        """Return an expression of z rewritten in the plant's states."""
        return expression.xreplace(dict(zip(self.states, self.to_form, strict=True)))

    @property
    def flow(self) -> tuple[sp.Expr, ...]:
        """The rates z' in terms of z."""
        rows = dict(zip(self.system.states, self.system.flow, strict=True))
        return tuple(sign * self.carry(rows[x]) for sign, x in zip(self.signs, self.order, strict=True))

    @property
    def output(self) -> tuple[sp.Expr, ...]:
        """The outputs y in terms of z."""
        return tuple(self.carry(expression) for expression in self.system.output)


def coordinates(
    system: System, order: Sequence[Signal] | None = None, signs: Sequence[int] | None = None
) -> Coordinates:
    """Return the coordinates z of a plant: its states in `order` (default: as declared), each times 1 or -1 from
    `signs` (default 1)."""
    order = tuple(order or system.states)
    signs = tuple(signs or (1,) * len(order))
    used_names = {signal.name for signal in (*system.signals, *system.declared.states)}
    stems = chain(("z", "zeta", "xi"), (f"z{k}_" for k in count(1)))
    stem = next(stem for stem in stems if used_names.isdisjoint(f"{stem}{i}" for i in range(1, len(order) + 1)))
    states = tuple(_signal(f"{stem}{i}", x, sign) for i, (x, sign) in enumerate(zip(order, signs, strict=True), 1))
    return Coordinates(system, order, signs, states)


def form_in(
    z: Coordinates,
    kind: str,
    checks: Iterable[Check],
    reference: str,
    *,
    parts: Parts | None = None,
    **more: Any,
) -> Form:
    """Return the form of a plant in the coordinates z.

    Args: `kind`, `reference`: the name and the paper of the form; `checks`: those of the form, which follow the
    plant's; `parts`: (A, b, output) of z' = A z + b, by default those of `split`; `more`: further fields of `Form`.
    """
    A, b, output = parts or (*split(z.flow, z.states), z.output)
    return Form(
        system=z.system,
        kind=kind,
        states=z.states,
        to_form=z.to_form,
        from_form=z.from_form,
        A=A,
        b=b,
        output=output,
        checks=(*z.system.checks, *checks),
        reference=reference,
        **more,
    )


def split(flow: Iterable[sp.Expr], states: Sequence[Signal]) -> tuple[sp.ImmutableDenseMatrix, tuple[sp.Expr, ...]]:
    """Return the splitting flow = A x + b of rates: A (n, n) has the coefficients, free of states, of the terms linear
    in one state; b (n) has all other terms."""
    rows, n = tuple(flow), len(states)
    terms = [linear_terms(row, states) for row in rows]
    A = sp.ImmutableDenseMatrix(n, n, lambda i, j: terms[i][0].coeff(states[j]))
    return A, tuple(nonlinear if linear != 0 else row for row, (linear, nonlinear) in zip(rows, terms, strict=True))


def _signal(name: str, x: Signal, sign: int) -> Signal:
    # "+ 0.0" turns the -0.0 of a mirrored zero into 0.0, which prints better.
    low, high = (x.low, x.high) if sign > 0 else (x.high, x.low)
    nominal, low, high = (None if value is None else sign * value + 0.0 for value in (x.nominal, low, high))
    meaning = x.meaning if sign > 0 else f"minus {x.meaning or x.name}"
    return Signal(name, x.unit, meaning, nominal, low, high, period=x.period)


# ---------------------------------------------------------------- triangle


_VALUES = 12  # of the state, for the chord


def triangle(structure: Check, reference: str, plant: System, chains: Chains, shape: Shape, **more: Any) -> Form:
    """Return the form of the plant whose states z are ordered by `chains`: z_i' = a_(i+1) z_(i+1) + b_i, y = a_1 z_1 +
    c, each a_i of the `shape` (CONSTANT: free of states, MEASURED: may vary with z_1, UNIFORM: any).

    Its checks after `structure`: `a_i` of one chain, `a_i_j` of several (0 < a_m <= a <= a_M on the box); `offset`,
    `offset_i` (c_i is finite on the box); `lipschitz`, of b and of each a z whose a varies with a state. `more`:
    further fields of `Form`.
    """
    maker, several = structure.id.maker, "blocks" in more
    every = [[_with_chord_gain(link, shape, plant, links[0].state) for link in links] for links in chains.links]
    signs = [signs_of(links, plant) for links in every]
    z = coordinates(plant, chains.order, [t for each in signs for t in each])
    A, b, output, head = sp.zeros(len(z.states), len(z.states)), [*z.flow], [*z.output], 0
    gains, offsets = list[Check](), list[Check]()
    for i, links in enumerate(every):
        for j, (link, s, t) in enumerate(zip(links, (1, *signs[i]), signs[i], strict=False)):
            a, offset = s * link.gain * t, s * z.carry(link.offset)
            at = (i + 1, j + 1) if several else (j + 1,)
            name = "a_({},{})" if several else "a_{}"
            gains.append(positive(ClaimId(maker, "a", *at), name.format(*at), a, plant))
            if j:
                A[head + j - 1, head + j], b[head + j - 1] = z.carry(a), offset
            else:
                output[i] = z.carry(a) * z.states[head] + offset
        c = links[0].offset if links else sp.S.Zero
        if c != 0 and c.free_symbols.isdisjoint(plant.states):
            id = ClaimId(maker, "offset", i + 1) if several else ClaimId(maker, "offset")
            offsets.append(finite_offset(id, f"c_{i + 1}" if several else "c", c, plant))
        head += len(links)
    parts = sp.ImmutableDenseMatrix(A), tuple(b), tuple(output)
    form = form_in(z, maker, (structure, *gains, *offsets), reference, parts=parts, **more)
    name = "b" if form.nonlinear == form.b else "b, with the a_i(z_1) z_i,"
    steep = lipschitz(maker, map(z.back, form.nonlinear), plant, name)
    return replace(form, checks=(*form.checks, steep))


def _with_chord_gain(link: Link, shape: Shape, plant: System, measured: sp.Symbol | None = None) -> Link:
    """Return the link row = gain * state + offset; where the row is not proved to have the `shape`, with a difference
    quotient as the gain and an offset that contains the remainder. `measured`: the state z_1, which the gain may vary
    with."""
    if link.answer(shape, measured)[0]:
        return link
    gain = _chord(link.row, link.state, plant)
    return replace(link, gain=gain, offset=link.row - gain * link.state)


def _chord(row: sp.Expr, state: sp.Symbol, plant: System) -> sp.Expr:
    """Return a finite difference quotient (row(b) - row(a))/(b - a) between two values a, b of
    `state`, the other states in the middle of their ranges; 0 if no quotient is finite."""
    middle, row = dict(next(points(plant.states))), exact(row)
    values = list(dict.fromkeys(point[state] for point in islice(points((state,)), _VALUES)))
    for i, a in enumerate(values[:2]):
        for b in values[i + 1 :]:
            try:
                slope = (row.xreplace({state: b}) - row.xreplace({state: a})) / (b - a)
            except (ValueError, TypeError):  # a comparison of numbers that SymPy cannot make
                continue
            slope = slope.xreplace(middle)
            if not slope.has(*STRANGE):
                return slope
    return sp.S.Zero


def signs_of(links: Iterable[Link], plant: System) -> list[int]:
    """Return the sign, 1 or -1, of each z_i of a chain with which the gains a_i of its links are positive; 1 for an a_i
    of both signs."""
    signs = [1]
    for link in links:
        signs.append(signs[-1] * (sign(link.gain, plant) or 1))
    return signs[1:]
