"""Coordinates z = a signed permutation of the plant's states x, and the split x' = A(u) x + b(x, u)."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain, count
from typing import Any, TypeAlias

import sympy as sp

from hgogen.check import Check
from hgogen.form import Form
from hgogen.signal import Signal
from hgogen.system import System

# A, b and the output of a form.
Parts: TypeAlias = tuple[sp.ImmutableDenseMatrix, tuple[sp.Expr, ...], tuple[sp.Expr, ...]]


@dataclass(frozen=True)
class Coordinates:
    """z_i = sign_i x_order(i).

    `states`: z_1..z_n with ranges, units and meanings from the plant's states; `to_form`: z in terms of x;
    `from_form`: x, in the plant's order, in terms of z.
    """

    system: System
    order: tuple[Signal, ...]
    signs: tuple[int, ...]
    states: tuple[Signal, ...]

    @property
    def to_form(self) -> tuple[sp.Expr, ...]:
        """z as expressions of the plant's states."""
        return tuple(sign * x for sign, x in zip(self.signs, self.order, strict=True))

    @property
    def from_form(self) -> tuple[sp.Expr, ...]:
        """The plant's states as expressions of z."""
        replace = self.replacement
        return tuple(replace[x] for x in self.system.states)

    @property
    def replacement(self) -> dict[sp.Expr, sp.Expr]:
        """Plant state to its expression in z."""
        return {x: sign * z for x, sign, z in zip(self.order, self.signs, self.states, strict=True)}

    def carry(self, expression: sp.Expr) -> sp.Expr:
        """An expression of the plant's states, written in z."""
        return expression.xreplace(self.replacement)

    def back(self, expression: sp.Expr) -> sp.Expr:
        """An expression of z, written in the plant's states."""
        return expression.xreplace(dict(zip(self.states, self.to_form, strict=True)))

    @property
    def flow(self) -> tuple[sp.Expr, ...]:
        """z' in terms of z."""
        rows = dict(zip(self.system.states, self.system.flow, strict=True))
        return tuple(sign * self.carry(rows[x]) for sign, x in zip(self.signs, self.order, strict=True))

    @property
    def output(self) -> tuple[sp.Expr, ...]:
        """y in terms of z."""
        return tuple(self.carry(expression) for expression in self.system.output)


def coordinates(
    system: System, order: Sequence[Signal] | None = None, signs: Sequence[int] | None = None
) -> Coordinates:
    """z: the plant's states in `order` (default: the plant's), each times its sign, 1 or -1 (default 1)."""
    order = tuple(order or system.states)
    signs = tuple(signs or (1,) * len(order))
    taken = {signal.name for signal in (*system.signals, *system.declared.states)}
    stems = chain(("z", "zeta", "xi"), (f"z{k}_" for k in count(1)))
    stem = next(stem for stem in stems if taken.isdisjoint(f"{stem}{i}" for i in range(1, len(order) + 1)))
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
    """The plant in z, with the checks of its own coordinates before the form's.

    Args: `parts`: A, b and the output; by default A is what `split` finds. `more`: further fields of the form.
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


def linear_terms(expression: sp.Expr, states: Sequence[sp.Symbol]) -> tuple[sp.Expr, sp.Expr]:
    """The sum of the terms that are linear in a state with a coefficient free of states, and the rest."""
    linear: list[sp.Expr] = []
    rest: list[sp.Expr] = []
    for term in sp.Add.make_args(sp.expand_mul(expression)):
        _, factor = term.as_independent(*states, as_Add=False)
        (linear if factor in states else rest).append(term)
    return sp.Add(*linear), sp.Add(*rest)


def split(flow: Iterable[sp.Expr], states: Sequence[Signal]) -> tuple[sp.ImmutableDenseMatrix, tuple[sp.Expr, ...]]:
    """A and b of flow = A x + b; A holds the coefficients, free of states, of the terms linear in a state."""
    rows, n = tuple(flow), len(states)
    terms = [linear_terms(row, states) for row in rows]
    A = sp.ImmutableDenseMatrix(n, n, lambda i, j: terms[i][0].coeff(states[j]))
    return A, tuple(rest if linear != 0 else row for row, (linear, rest) in zip(rows, terms, strict=True))


def _signal(name: str, x: Signal, sign: int) -> Signal:
    # "+ 0.0" turns the -0.0 of a mirrored zero into 0.0, which prints better.
    low, high = (x.low, x.high) if sign > 0 else (x.high, x.low)
    nominal, low, high = (None if value is None else sign * value + 0.0 for value in (x.nominal, low, high))
    meaning = x.meaning if sign > 0 else f"minus {x.meaning or x.name}"
    return Signal(name, x.unit, meaning, nominal, low, high)
