"""The triangular (observability canonical) form for one output.

    z' = A(u) z + b(z, u),   y = C(u) z,
    A = superdiagonal a_2(u)..a_n(u),   C = (a_1(u), 0..0),   0 < a_m <= a_i(u) <= a_M,
    b_i of z_1..z_i and u only, Lipschitz.

z is the plant's state in another order, some with the other sign. The order follows the dependencies: the
output brings in one state, that state's derivative the next, and so on. A known offset c(u), as in
y = a_1(u) z_1 + c(u), stays in the output; it changes no innovation.

N. Boizot, E. Busvelle, J.-P. Gauthier, "An adaptive high-gain observer for nonlinear systems", Automatica 46
(2010), form (3).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import sympy as sp

from hgogen.check import Check, Verdict
from hgogen.coordinates import Coordinates, coordinates, split
from hgogen.defined import defined
from hgogen.dependence import free_of, states_in
from hgogen.errors import HgogenError
from hgogen.form import Form
from hgogen.linearity import bent, chord, differs, is_linear, matters, rough
from hgogen.lipschitz import lipschitz
from hgogen.points import exact
from hgogen.positive import positive, sign
from hgogen.signal import Signal
from hgogen.system import System

_INFINITE = (sp.nan, sp.zoo, sp.oo, -sp.oo, sp.AccumBounds)


@dataclass(eq=False)
class OneOutput(HgogenError):
    """The triangular form is for one output."""

    system: str
    outputs: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"system {self.system!r} has {len(self.outputs)} outputs, {', '.join(self.outputs)}, and the "
            "triangular form takes one; keep one of them, or use forms.original (block forms are for several)"
        )


@dataclass(frozen=True)
class _Link:
    """A row, y or the derivative of the state before: gain * state + rest, the rest of the states before."""

    state: Signal
    gain: sp.Expr
    rest: sp.Expr


def triangular(plant: System) -> Form:
    """The plant in triangular form, by permutation and sign.

    The form is the plant whatever the verdicts: where the structure is not shown, b keeps what A does not hold. A
    plant whose structure is refuted comes back in its own order with that one check; observers refuse it.

    Checks: `triangular.structure`; `triangular.a_1`..`triangular.a_n` (0 < a_m <= a_i <= a_M on the box of
    inputs and parameters); `triangular.offset` (c is defined there) where there is one; `triangular.lipschitz`.

    Raises: `OneOutput`.
    """
    if len(plant.outputs) != 1:
        raise OneOutput(plant.name, tuple(y.name for y in plant.outputs))
    found = _follow(plant)
    if isinstance(found, str):
        return _refuted(plant, found)
    links, doubts = found
    z = coordinates(plant, [link.state for link in links], _signs(links, plant))
    before = (1, *z.signs)
    a = [s * link.gain * t for s, link, t in zip(before, links, z.signs, strict=False)]
    A = sp.zeros(len(a), len(a))
    for i, gain in enumerate(a[1:]):
        A[i, i + 1] = gain
    offset, *rest = (s * z.carry(link.rest) for s, link in zip(before, links, strict=False))
    b = (*rest, z.flow[-1])
    checks = (
        _structure(Verdict.UNKNOWN, doubts[0])
        if doubts
        else _structure(Verdict.PROVED, " -> ".join(s.name for s in (*plant.outputs, *z.order))),
        *(positive(f"triangular.a_{i}", f"a_{i}", gain, plant) for i, gain in enumerate(a, 1)),
        *_offset(links[0].rest, plant),
        lipschitz("triangular.lipschitz", map(z.back, b), plant),
    )
    return _form(z, sp.ImmutableDenseMatrix(A), b, (a[0] * z.states[0] + offset,), checks)


def _follow(plant: System) -> tuple[list[_Link], list[str]] | str:
    """From the output to a state, from its derivative to the next, until all are met, and the doubts; or why not."""
    flow = dict(zip(plant.states, plant.flow, strict=True))
    name, row = plant.outputs[0].name, plant.output[0]
    links: list[_Link] = []
    doubts: list[str] = []
    left = list(plant.states)
    while left:
        new = states_in(row, left)
        if not new:
            return f"{name} brings in no new state, so the output never shows {_list(left)}"
        if len(new) > 1:
            shown = [x for x in new if matters(row, x, plant)]
            if len(shown) > 1:
                return f"{name} brings in {_list(new)} together, and each row may bring in one new state"
            new = (*shown, *(x for x in new if x not in shown))
        left.remove(new[0])
        link, doubt = _link(row, new[0], plant, left)
        if doubt and bent(row, new[0], plant):
            return f"{name} brings in {doubt}"
        links.append(link)
        doubts += [f"{name} brings in {doubt}"] if doubt else []
        name, row = f"{new[0]}'", flow[new[0]]
    return links, doubts


def _link(row: sp.Expr, state: Signal, plant: System, left: list[Signal]) -> tuple[_Link, str]:
    """The row as a link, and why it is not shown to be one; then the rest is whatever is left of the row as it is."""
    others, slope = states_in(row, left), row.diff(state)
    varies = states_in(slope, plant.states)
    if others or varies:
        gain = chord(row, state, plant)
        doubt = (
            f"{state} with a slope that varies with {_list(varies)}, {slope}; it may vary with inputs and "
            "parameters only"
        )
        if others:
            doubt = f"{state}, and {_list(others)} with it as far as is known"
        return _Link(state, gain, row - gain * state), doubt
    gain = free_of(slope, plant.states)
    clean = free_of(row, left)
    jagged = rough(row, state, plant)
    if jagged:
        clean = sp.simplify(clean)
    whole = exact(clean)
    pure = free_of(whole.diff(state), plant.states)
    offset = _rest(whole, state, pure)
    shown = not rough(clean, state, plant) and is_linear(whole, state, pure, offset)
    if shown and (clean == row or not differs(row, pure * state + offset, plant)):
        return _Link(state, gain, _rest(clean, state, gain)), ""
    why = f", for {jagged[0]}" if jagged else ""
    return _Link(state, gain, row - gain * state), f"{state} in a way that is not shown to be linear{why}"


def _rest(row: sp.Expr, state: Signal, gain: sp.Expr) -> sp.Expr:
    """row - gain * state, which is free of the state: its value at 0, or where that is 0/0 at 1, 2, 3;
    whether it is free of the state is for `is_linear` to say."""
    values = (row.subs(state, value) - gain * value for value in range(4))
    return next((rest for rest in values if not rest.has(*_INFINITE)), row - gain * state)


def _signs(links: list[_Link], plant: System) -> list[int]:
    """The sign of each z_i that makes a_i positive; an a_i without one sign stays as it is."""
    signs = [1]
    for link in links:
        signs.append(signs[-1] * (sign(link.gain, plant) or 1))
    return signs[1:]


def _offset(c: sp.Expr, plant: System) -> tuple[Check, ...]:
    known = c != 0 and c.free_symbols.isdisjoint(plant.states)
    return (defined("triangular.offset", "c", c, plant),) if known else ()


def _refuted(plant: System, reason: str) -> Form:
    z = coordinates(plant)
    return _form(z, *split(z.flow, z.states), z.output, (_structure(Verdict.REFUTED, reason),))


def _structure(verdict: Verdict, reason: str) -> Check:
    fix = "Measure another output, or use forms.original, which takes any plant."
    claim = "each row brings in one new state, linearly"
    return Check("triangular.structure", claim, verdict, reason, fix="" if verdict is Verdict.PROVED else fix)


def _form(
    z: Coordinates,
    A: sp.ImmutableDenseMatrix,
    b: tuple[sp.Expr, ...],
    output: tuple[sp.Expr, ...],
    checks: tuple[Check, ...],
) -> Form:
    return Form(
        system=z.system,
        kind="triangular",
        states=z.states,
        to_form=z.to_form,
        from_form=z.from_form,
        A=A,
        b=b,
        output=output,
        checks=(*z.system.checks, *checks),
        reference="Boizot, Busvelle, Gauthier, Automatica 46 (2010), form (3)",
    )


def _list(signals: Iterable[Signal]) -> str:
    return ", ".join(s.name for s in signals)
