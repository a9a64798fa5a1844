"""The plant in its own coordinates, for any number of outputs.

    z' = A(u) z + b(z, u),   y = h(z, u),

z is the plant's state in its own order, A holds the coefficients of terms linear in a state, b the other terms. The
form serves the plain extended Kalman filter and plants without a triangular form; no theorem promises convergence.

A high gain needs the structure of H. Hammouri, M. Farza, "Nonlinear observers for locally uniformly observable
systems", ESAIM: COCV 9 (2003). With the states x_1..x_n ordered by their distance from the output, whatever the order
of z, y = h(x_1, u) and x_i' is a function of x_1..x_{i+1} and u with a nonzero partial derivative in x_{i+1}. A high
gain overshoots in x_i like theta^(i-1).
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace

import sympy as sp

from hgogen.analysis.chain import Rows, affecting_states, connected, of_plant
from hgogen.analysis.coordinates import Coordinates, coordinates, form_in, split
from hgogen.analysis.hypotheses import lipschitz, with_chords
from hgogen.check import Check, ClaimId, Verdict
from hgogen.errors import HgogenError
from hgogen.form import Form, SurveySettings
from hgogen.reading.given import names as several
from hgogen.rigor.bounds import nonzero
from hgogen.rigor.factors import ROUGH
from hgogen.rigor.field import is_zero
from hgogen.rigor.tape import slope
from hgogen.sentence import NONE, Reason, because
from hgogen.signal import Signal
from hgogen.system import System


@dataclass(eq=False)
class BadOrder(HgogenError):
    """The error that the argument `order` does not list each state of the plant once; the field `order` is its text in
    the message."""

    system: str
    order: str
    states: str
    text = "system {system!r}: the order {order} must hold each of the states {states} once"


@SurveySettings(6, costly=True, discrete=True)  # its Lipschitz constant takes seconds, and no theorem covers it
def original(plant: System, order: Sequence[Signal | str] | None = None) -> Form:
    """Return the plant in its own coordinates, z' = A(u) z + b(z, u), y = h(z, u), its states in `order`, signals or
    their names; by default as declared. It is the only form of a discrete plant, z+ = A(u) z + b(z, u).

    Checks: `original.connected` (the outputs depend on every state on the box, directly or through other states); of
    differential equations `original.order` (the structure that a high gain needs: generic, or unknown),
    `original.lipschitz`.

    Raises: `BadOrder`; `BadGain` for an order that is no sequence of names.
    """
    rows = of_plant(plant)
    sure, every = affecting_states(rows, sure=True), affecting_states(rows)
    hidden = [x for x in plant.states if x not in every]
    doubtful = [x for x in every if x not in sure]
    along = (*every, *hidden)
    states = plant.states
    if order is not None:
        by_name = {x.name: x for x in plant.states}
        if isinstance(order, Mapping | Set):
            problem = f"is a {type(order).__name__}, which has no order; it"
            raise BadOrder(plant.name, problem, ", ".join(by_name))
        names = tuple(map(str, several("order", order)))
        if sorted(names) != sorted(by_name):
            raise BadOrder(plant.name, f"({', '.join(names)})", ", ".join(by_name))
        states = tuple(by_name[name] for name in names)
    z = coordinates(plant, states)
    A, b = split(z.flow, z.states)
    joined = connected("original", hidden, doubtful)
    if plant.constraints:
        joined = replace(joined, claim=f"{joined.claim}, or in an invariant with such states")
    checks = (joined, *(() if plant.discrete else _for_high_gain(z, A, b, along, rows)))
    levels = tuple(along.index(x) for x in z.order)
    return form_in(z, "original", checks, "the plant's own coordinates", parts=(A, b, z.output), levels=levels)


def _for_high_gain(
    z: Coordinates, A: sp.ImmutableDenseMatrix, b: Sequence[sp.Expr], along: Sequence[sp.Symbol], rows: Rows
) -> tuple[Check, Check]:
    flow = (sp.Add(*(a * s for a, s in zip(A.row(i), z.states, strict=True)), row) for i, row in enumerate(b))
    listed = ", ".join(map(str, along))
    claim = (
        f"in the order ({listed}) y depends on the first state only, and the derivative of each state on states "
        "up to the next one, with a slope in that"
    )
    generic = because("no slope is identically zero; zeros on the box are not excluded")
    obstacle = _misshapen(along, rows)
    entries = tuple(map(z.back, (*flow, *z.output)))
    verdict = Verdict.UNKNOWN if obstacle else Verdict.GENERIC
    return (
        Check(ClaimId("original", "order"), claim, verdict, obstacle or generic),
        with_chords(lipschitz("original", entries, z.system, "A x + b with the output"), entries, z.system),
    )


def _misshapen(along: Sequence[sp.Symbol], rows: Rows) -> Reason:
    """Return why x_i' = f_i(x_1..x_(i+1), u) is not proved for the states x in
    the order `along`, else `NONE`. Each f_i must have a partial derivative in
    x_(i+1) that is identically zero neither on the box nor on a branch."""
    if len(rows.output) > 1:
        return because("this structure is defined for one output")
    for i, row in enumerate((rows.output[0], *(rows.rate(x) for x in along[:-1]))):
        name = f"{along[i - 1]}'" if i else "y"
        sure, maybe = rows.reads(row, rows.states)
        if along[i] not in {*sure, *maybe}:
            return because("{row} does not depend on {state}", row=name, state=along[i])
        steep = slope(row, along[i])
        if along[i] not in sure or is_zero(steep, rows.box) is not False:
            return because("no slope of {row} in {state} is proved", row=name, state=along[i])
        if steep.has(*ROUGH) and nonzero(steep, rows.box).verdict is not Verdict.PROVED:
            return because("the slope of {row} in {state} may be 0 on a part of the box", row=name, state=along[i])
        later = [x.name for x in rows.states if x in along[i + 1 :] and x in {*sure, *maybe}]
        if later:
            return because("{row} depends on {names}, later in this order", row=name, names=later)
    return NONE
