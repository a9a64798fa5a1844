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
from hgogen.dependence import free_of, states_in
from hgogen.errors import HgogenError
from hgogen.form import Form
from hgogen.lipschitz import lipschitz
from hgogen.positive import positive, sign
from hgogen.signal import Signal
from hgogen.system import System


@dataclass(frozen=True)
class OneOutput(HgogenError):
    """The triangular form is for one output."""

    system: str
    outputs: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"system {self.system!r} has {len(self.outputs)} outputs, {', '.join(self.outputs)}, and the "
            "triangular form takes one; keep one of them, or use forms.original (block forms are for several)"
        )


def triangular(plant: System) -> Form:
    """The plant in triangular form, by permutation and sign.

    A plant whose structure is refuted comes back in its own order with that one check; observers refuse it.

    Checks: `triangular.structure`; `triangular.a_1`..`triangular.a_n` (0 < a_m <= a_i <= a_M on the box of
    inputs and parameters); `triangular.lipschitz`.

    Raises: `OneOutput`.
    """
    if len(plant.outputs) != 1:
        raise OneOutput(plant.name, tuple(y.name for y in plant.outputs))
    chain = _follow(plant)
    if isinstance(chain, str):
        return _refuted(plant, chain)
    order, coefficients = zip(*chain, strict=True)
    z = coordinates(plant, order, _signs(coefficients, plant))
    a = [s * gain * t for s, gain, t in zip((1, *z.signs), coefficients, z.signs, strict=False)]
    A = sp.zeros(len(a), len(a))
    for i, gain in enumerate(a[1:]):
        A[i, i + 1] = gain
    linear = A * sp.Matrix(z.states)
    y = a[0] * z.states[0]
    output = y + _remainder(z.output[0], y, z.states)
    b = tuple(_remainder(row, linear[i], z.states[i + 1 :]) for i, row in enumerate(z.flow))
    checks = (
        _structure(Verdict.PROVED, " -> ".join(s.name for s in (*plant.outputs, *order))),
        *(positive(f"triangular.a_{i}", f"a_{i}", gain, plant) for i, gain in enumerate(a, 1)),
        lipschitz("triangular.lipschitz", map(z.back, b), plant),
    )
    return _form(z, sp.ImmutableDenseMatrix(A), b, (output,), checks)


def _follow(plant: System) -> list[tuple[Signal, sp.Expr]] | str:
    """States in order, each with its a_i, from the output to one, from that one to the next; or why not."""
    flow = dict(zip(plant.states, plant.flow, strict=True))
    name, row = plant.outputs[0].name, plant.output[0]
    chain: list[tuple[Signal, sp.Expr]] = []
    left = list(plant.states)
    while left:
        new = states_in(row, left)
        if not new:
            return f"{name} brings in no new state, so the output never shows {_list(left)}"
        if len(new) > 1:
            return f"{name} brings in {_list(new)} together, and each row may bring in one new state"
        slope = row.diff(new[0])
        varies = _list(states_in(slope, plant.states))
        if varies:
            return (
                f"{name} brings in {new[0]} with a slope that varies with {varies}, {slope}; it may vary "
                "with inputs and parameters only"
            )
        chain.append((new[0], free_of(slope, plant.states)))
        left.remove(new[0])
        name, row = f"{new[0]}'", flow[new[0]]
    return chain


def _signs(coefficients: Iterable[sp.Expr], plant: System) -> list[int]:
    """The sign of each z_i that makes a_i positive; an a_i without one sign stays as it is."""
    signs = [1]
    for gain in coefficients:
        signs.append(signs[-1] * (sign(gain, plant) or 1))
    return signs[1:]


def _remainder(row: sp.Expr, linear: sp.Expr, later: tuple[Signal, ...]) -> sp.Expr:
    """row - linear, which depends on no later state; setting the next one to 0 keeps the row as written."""
    if not later:
        return row
    rest = row.subs(later[0], 0)
    if rest.has(sp.nan, sp.zoo, sp.oo):
        rest = row - linear
    return free_of(rest, later)


def _refuted(plant: System, reason: str) -> Form:
    z = coordinates(plant)
    return _form(z, *split(z.flow, z.states), z.output, (_structure(Verdict.REFUTED, reason),))


def _structure(verdict: Verdict, reason: str) -> Check:
    fix = (
        ""
        if verdict is Verdict.PROVED
        else "Measure another output, or use forms.original, which takes any plant."
    )
    claim = "each row brings in one new state, linearly"
    return Check("triangular.structure", claim, verdict, reason, fix=fix)


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
        checks=checks,
        reference="Boizot, Busvelle, Gauthier, Automatica 46 (2010), form (3)",
    )


def _list(signals: Iterable[Signal]) -> str:
    return ", ".join(s.name for s in signals)
