"""The state-affine form up to output injection, for any number of outputs: the plant in its own coordinates.

    z' = A(u, y) z + b(u, y),   y = C(u) z + d(u)

A state is measured where an output depends on it alone, y_j = c(u) z_k + d(u) with c bounded away from zero; A and b
may vary with inputs and measured states in any way. z is the plant's state in its own order. A z holds the terms linear
in an unmeasured state, and those linear in a measured state with a coefficient free of states; b holds the other terms.

The form says nothing about observability, which depends on the input (see `estimators.persistence`), except for states
on which no output ever depends. H. Hammouri, J. de Leon Morales, "Observer synthesis for state-affine systems", 29th
IEEE CDC (1990); G. Besancon, G. Bornard, H. Hammouri, "Observer synthesis for a class of nonlinear control systems",
European Journal of Control 2 (1996).
"""

from collections.abc import Sequence

import sympy as sp

from hgogen.analysis.chain import Affine, affine, cut_off_check, measurements, of_plant
from hgogen.analysis.coordinates import coordinates, form_in, split
from hgogen.analysis.evidence import ByForm
from hgogen.analysis.hypotheses import lipschitz
from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Form, SurveySettings
from hgogen.rigor.tape import without_norms
from hgogen.sentence import because
from hgogen.signal import Signal
from hgogen.system import System

_REFERENCE = "Hammouri, de Leon Morales, CDC 1990"
_CLAIM = "x' = A(u, y) x + b(u, y), y = C(u) x + d(u), in the plant's states"
_TOGETHER = "Make what an output shows a state of its own, by hgogen.recast."
_FIX = "Measure the states that enter nonlinearly."


@SurveySettings(5, candidate=False)
def state_affine(plant: System) -> Form:
    """Return the plant in state-affine form up to output injection, z' = A(u, y) z + b(u, y), y = C(u) z + d(u), in its
    own coordinates.

    Checks: `state_affine.structure`; `state_affine.lipschitz`, of A(u, y) x + b(u, y), so that A is bounded;
    `state_affine.connected`, refuted, where no output depends on some states for any input. A plant without the
    structure has only that check; observers refuse it.
    """
    rows = of_plant(plant)
    output = [affine(name, row, plant.states, rows) for name, row in zip(rows.names, rows.output, strict=True)]
    measured = [plant.states[one.state] for one in measurements(plant)]
    hidden = [x for x in plant.states if x not in measured]
    flow = [affine(f"{x}'", rows.rate(x), hidden, rows) for x in plant.states]
    structure = _structure(output, flow, measured)
    z = coordinates(plant)
    if structure.verdict is Verdict.REFUTED:
        return form_in(z, "state_affine", (structure,), _REFERENCE)
    A, b = sp.zeros(len(flow), len(flow)), []
    remainders = []  # each rate without its terms in unmeasured states, as the user wrote it where these cancel
    for x, row in zip(plant.states, flow, strict=True):
        terms = (without_norms(gain) * state for gain, state in zip(row.slopes, hidden, strict=True))
        written = sp.expand(rows.rate(x) - sp.Add(*terms))
        remainders.append(without_norms(row.offset) if written.has(*hidden) else written)
    linear, nonlinear = split(remainders, plant.states)
    for i, row in enumerate(flow):
        for x, gain in zip(hidden, row.slopes, strict=True):
            A[i, plant.states.index(x)] = z.carry(without_norms(gain))
        b.append(z.carry(nonlinear[i]))
    A += linear
    steep = lipschitz("state_affine", plant.flow, plant, "A x + b")
    parts = sp.ImmutableDenseMatrix(A), tuple(b), z.output
    connected = cut_off_check("state_affine", plant)
    return form_in(z, "state_affine", (structure, steep, *connected), _REFERENCE, parts=parts)


def _structure(output: Sequence[Affine], flow: Sequence[Affine], measured: Sequence[Signal]) -> Check:
    """Return the check that y = C(u) z + d(u) and z' = A(u, y) z + b(u, y). An output
    that is not affine refutes it, and so does such a rate if each output depends
    on one state; else A, b may depend on measured combinations of states."""
    id = ClaimId("state_affine", "structure")
    single = all(row.answer and sum(gain != 0 for gain in row.slopes) <= 1 for row in output)
    dependent = sum(any(gain != 0 for gain in row.slopes) for row in output)
    wrong = next((row for wanted in (False, None) for row in (*output, *flow) if row.answer is wanted), None)
    if wrong is None:
        alone = because("by exact algebra; the outputs show {states}", states=measured)
        reason = alone if measured else because("by exact algebra; the outputs show no state alone")
        return Check(id, _CLAIM, Verdict.PROVED, reason, proofs=(ByForm(),))
    if wrong.answer is False and (wrong in output or (single and dependent == len(measured))):
        return Check(id, _CLAIM, Verdict.REFUTED, wrong.why, fix=_FIX)
    return Check(id, _CLAIM, Verdict.UNKNOWN, wrong.why, fix=_TOGETHER if wrong.answer is False else _FIX)
