"""Rows that are affine in some states, exactly, and the states that an output shows alone."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import sympy as sp

from hgogen.analysis.chain import Rows, of_plant
from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.hypotheses import apart
from hgogen.check import ClaimId, Verdict
from hgogen.graph import Graph
from hgogen.rigor.field import free_of
from hgogen.rigor.tape import bent, slope
from hgogen.sentence import NONE, Reason, because
from hgogen.signal import Signal
from hgogen.system import System


@dataclass(frozen=True)
class Affine:
    """A row as sum_k slopes[k] x_k + rest over the states asked, slopes and rest free of them; `answer`: whether that
    is proved, refuted (False) or neither, and `why`."""

    slopes: tuple[sp.Expr, ...]
    rest: sp.Expr
    answer: bool | None = True
    why: Reason = NONE


@dataclass(frozen=True)
class Measurement:
    """Output number `output` is gain * (state number `state`) + offset, the gain bounded away from zero; neither reads
    a state."""

    state: int
    output: int
    gain: sp.Expr
    offset: sp.Expr


def affine(name: str, row: sp.Expr, states: Sequence[Signal], rows: Rows) -> Affine:
    """The row of that name as an affine function of the states. A slope that varies with one of them refutes it, and so
    does what is left after the slopes; proved is that nothing is left."""
    none, slopes, rest, may = (sp.S.Zero,) * len(states), [], bent(row), list[sp.Symbol]()
    for x in states:
        sure, maybe = rows.reads(row, (x,))
        gain = free_of(slope(row, x), states, rows.box) if sure or maybe else sp.S.Zero
        varies, may_vary = rows.reads(gain, states)
        if varies:
            pattern = "{name} has the slope {gain} in {state}, which varies with {states}"
            return Affine(none, row, False, because(pattern, name=name, gain=gain, state=x, states=varies))
        may += may_vary
        slopes.append(gain)
        rest -= gain * x
    rest = free_of(sp.expand(rest), states, rows.box)
    sure, maybe = rows.reads(rest, states)
    if sure:
        return Affine(none, row, False, because("{name} is not affine in {states}", name=name, states=sure))
    doubtful = list(dict.fromkeys((*may, *maybe)))
    if doubtful:
        why = because("{name} is not shown to be affine in {states}", name=name, states=doubtful)
        return Affine(tuple(slopes), rest, None, why)
    return Affine(tuple(slopes), rest)


_GAIN = ClaimId("state_affine", "gain")  # of which the verdict alone is read


def measurements(plant: System) -> tuple[Measurement, ...]:
    """The states that an output shows alone, each by the first such output, as far as is proved."""
    rows, by_state = of_plant(plant), dict[int, Measurement]()
    for j, (name, row) in enumerate(zip(rows.names, rows.output, strict=True)):
        line = affine(name, row, plant.states, rows)
        seen = [(k, gain) for k, gain in enumerate(line.slopes) if gain != 0]
        if line.answer and len(seen) == 1 and apart(_GAIN, "c", seen[0][1], plant).verdict is Verdict.PROVED:
            by_state.setdefault(seen[0][0], Measurement(seen[0][0], j, seen[0][1], line.rest))
    return tuple(by_state.values())


def known(dynamics: Dynamics) -> Callable[[Graph, Graph, Graph, Graph], Graph]:
    """A function of the SX columns z (n), u (m), y (p), valid (p) that returns z with the measured states in the place
    of their estimates, for a form in the plant's own coordinates."""
    measured = measurements(dynamics.form.system)

    def replaced(z: Graph, u: Graph, y: Graph, valid: Graph) -> Graph:
        values = [z[i] for i in range(dynamics.n)]
        offset = dynamics.output(ca.SX.zeros(dynamics.n), u)
        slope = dynamics.output_jacobian(z, u)
        for one in measured:
            shown = (y[one.output] - offset[one.output]) / slope[one.output, one.state]
            values[one.state] = ca.if_else(valid[one.output], shown, values[one.state])
        return ca.vertcat(*values)

    return replaced
