"""The state-affine form up to output injection, for any number of outputs: the plant in its own coordinates.

    z' = A(u, y) z + b(u, y),   y = C(u) z + d(u)

A state is measured where an output shows it alone, y_j = c(u) z_k + d(u) with c bounded away from zero; A and b may
vary with inputs and measured states in any way. z is the plant's state in its own order; A z holds the terms linear in
a state that is not measured, and those linear in a measured one with a coefficient free of states; b the rest.

The form says nothing of observability, which depends on the input (see `estimators.persistence`), but for states that
no output ever shows. H. Hammouri, J. de Leon Morales, "Observer synthesis for state-affine systems", 29th IEEE CDC
(1990); G. Besancon, G. Bornard, H. Hammouri, "Observer synthesis for a class of nonlinear control systems", European
Journal of Control 2 (1996).
"""

from collections.abc import Sequence

import sympy as sp

from hgogen.analysis.chain import Affine, affine, cut_off, measurements, of_plant
from hgogen.analysis.coordinates import coordinates, form_in, split
from hgogen.analysis.evidence import ByForm
from hgogen.analysis.hypotheses import lipschitz
from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Asking, Form
from hgogen.rigor.tape import unbent
from hgogen.sentence import because
from hgogen.signal import Signal
from hgogen.system import System

_REFERENCE = "Hammouri, de Leon Morales, CDC 1990"
_CLAIM = "x' = A(u, y) x + b(u, y), y = C(u) x + d(u), in the plant's states"
_TOGETHER = "Make what an output shows a state of its own, by hgogen.recast."
_FIX = "Measure the states that enter nonlinearly."


@Asking(5, candidate=False)
def state_affine(plant: System) -> Form:
    """The plant in state-affine form, in its own coordinates.

    Checks: `state_affine.structure`; `state_affine.lipschitz`, of A(u, y) x + b(u, y), so that A is bounded;
    `state_affine.connected`, refuted, where states are hidden from the outputs for every input. A plant without the
    structure comes back with that one check; observers refuse it.
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
    beside = []  # the terms in hidden states; as it is written, where these cancel in it
    for x, row in zip(plant.states, flow, strict=True):
        terms = (unbent(gain) * state for gain, state in zip(row.slopes, hidden, strict=True))
        written = sp.expand(rows.rate(x) - sp.Add(*terms))
        beside.append(unbent(row.offset) if written.has(*hidden) else written)
    linear, rest = split(beside, plant.states)
    for i, row in enumerate(flow):
        for x, gain in zip(hidden, row.slopes, strict=True):
            A[i, plant.states.index(x)] = z.carry(unbent(gain))
        b.append(z.carry(rest[i]))
    A += linear
    steep = lipschitz("state_affine", plant.flow, plant, "A x + b")
    parts = sp.ImmutableDenseMatrix(A), tuple(b), z.output
    unseen = cut_off("state_affine", plant)
    return form_in(z, "state_affine", (structure, steep, *unseen), _REFERENCE, parts=parts)


def _structure(output: Sequence[Affine], flow: Sequence[Affine], measured: Sequence[Signal]) -> Check:
    """Refuted by an output that is not affine, or by a rate, where the outputs show single states: else a rate may yet
    be a function of what they show together."""
    id = ClaimId("state_affine", "structure")
    single = all(row.answer and sum(gain != 0 for gain in row.slopes) <= 1 for row in output)
    shown = sum(any(gain != 0 for gain in row.slopes) for row in output)
    wrong = next((row for wanted in (False, None) for row in (*output, *flow) if row.answer is wanted), None)
    if wrong is None:
        alone = because("by exact algebra; the outputs show {states}", states=measured)
        reason = alone if measured else because("by exact algebra; the outputs show no state alone")
        return Check(id, _CLAIM, Verdict.PROVED, reason, proofs=(ByForm(),))
    if wrong.answer is False and (wrong in output or (single and shown == len(measured))):
        return Check(id, _CLAIM, Verdict.REFUTED, wrong.why, fix=_FIX)
    return Check(id, _CLAIM, Verdict.UNKNOWN, wrong.why, fix=_TOGETHER if wrong.answer is False else _FIX)
