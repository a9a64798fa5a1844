"""The hypothesis on b: Lipschitz in the state on the declared box, uniformly in inputs and parameters.

The bound L_b = sup |db/dx| comes from outward-rounded intervals (`slope`). A state without a range is unbounded
here, because an observer does not clamp it.

An observer evaluates b with its argument clamped to the box of z, of which z = Phi(x) takes the plant's box to a part.
What is shown on that image says nothing of the rest of the box of z, through which the estimate may pass. A clamp of
each component is Lipschitz, so b is after it if it is on the box (`clamped`).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from fractions import Fraction

import sympy as sp

from hgogen.analysis.evidence import Slopes
from hgogen.analysis.written import asked, if_valued
from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Form
from hgogen.rigor.bounds import Proof, counted, ends
from hgogen.rigor.box import box, witness
from hgogen.rigor.singular import minimal, one_sided, reasons, singular
from hgogen.rigor.slope import JUMPS, lipschitz_bound
from hgogen.rigor.tape import NoTape, bent
from hgogen.sentence import Reason, Up, because, joined
from hgogen.signal import Signal
from hgogen.system import System

BOXES = 500  # of a clamped b, whose bound need not be the least
_NARROW = "Narrow the ranges so that it stays away from there."
_SINGULAR = "{what} may jump or be singular"
_TAKEN = because("b is taken at Psi(z), clamped to the plant's ranges")


def lipschitz(maker: str, b: Iterable[sp.Expr], system: System, name: str = "b") -> Check:
    """The check `MAKER.lipschitz`, that b is Lipschitz in the states.

    `b`: in the plant's states, inputs and parameters; `name`: what the report calls it. This check answers for the
    plant as it is written as well.

    The verdicts are
    proved: with L_b, and every part of the plant is finite and real on the box;
    refuted: with a point towards which a slope tends to infinity;
    where: for some inputs or parameters alone it, or the plant as written, may be singular; closed parts of the box
    without them have a bound;
    unknown: a range is missing, there may be a jump or a singular state, near which no bound is known, the boxes tried
    give no bound, or a part of the plant may have no value.
    """
    id, claim = ClaimId(maker, "lipschitz"), f"{name} is Lipschitz in the state on the box"

    def answer(verdict: Verdict, reason: Reason, fix: str = "") -> Check:
        return Check(id, claim, verdict, reason, fix=fix)

    around, entries = system.box, tuple(b)
    rows = tuple(one_sided(row, around) for row in entries)
    try:
        steepest = lipschitz_bound(rows, system.states, around)
    except NoTape as missing:
        return answer(Verdict.UNKNOWN, because(_SINGULAR, what=missing.what), "Write it with functions that are known.")
    if steepest.verdict is Verdict.PROVED:
        bound = Slopes(Proof(entries, None, ends(0.0, steepest.high)[1], steepest.variables, steepest.tree))
        on = because(
            "L_b <= {L_b}, by outward-rounded intervals on {boxes}",
            L_b=Up(steepest.high),
            boxes=counted(steepest.boxes),
        )
        reason = on if steepest.high else because("it does not depend on the state")
        return if_valued(replace(answer(Verdict.PROVED, reason), proofs=(bound,)), system)
    if steepest.verdict is Verdict.REFUTED:
        return replace(answer(Verdict.REFUTED, steepest.reason, _NARROW), witness=witness(steepest.witness))
    jumps = sorted({node for row in rows for node in bent(row).atoms(*JUMPS) if node.has(*system.states)}, key=str)
    if jumps:
        doubt = because("{part} may jump", part=jumps[0])
        return answer(Verdict.UNKNOWN, doubt, "Write saturations with sympy.Min and sympy.Max.")
    slopes = [row.diff(x) for row in rows for x in system.states if x in row.free_symbols]
    poles = singular([*rows, *slopes], around)
    read = {s for row in rows for s in row.free_symbols & {*system.states, *system.inputs}}
    loose = sorted(s.name for s in read if not s.bounded)
    if loose:
        doubt = because("no bound without a range for {names}", names=loose)
        return answer(Verdict.UNKNOWN, doubt, f"Declare low= and high= for {', '.join(loose)}.")
    if not poles:
        return answer(Verdict.UNKNOWN, steepest.reason)
    conditions = minimal((*poles.values(), *asked(system)))
    if any(part.has(*system.states) for part in (*poles, *(each.of for each in conditions))):
        places = [condition.failure for condition in conditions]
        doubt = because("no uniform bound is shown; it may be singular {places: or }", places=places)
        return answer(Verdict.UNKNOWN, doubt, _NARROW)
    parts = "holds on every closed part of the box where {conditions: and }"
    return answer(Verdict.WHERE, because(parts, conditions=reasons(conditions)), _NARROW)


def clamped(observer: str, form: Form, *, boxes: int = BOXES) -> tuple[Check, ...]:
    """The check `OBSERVER.lipschitz` of a form in other coordinates than the plant's states, in some order and with
    signs. For those states the form's own check is of the same box, and no check is made; nor is one where b is 0.
    """
    if not any(form.b) or all(any(z in (x, -x) for x in form.system.states) for z in form.to_form):
        return ()
    claim = "b is Lipschitz in z on the whole box of z, to which its argument is clamped"
    check = Check(ClaimId(observer, "lipschitz"), claim, Verdict.UNKNOWN, because("it is not clamped"))
    if form.free:
        return (check,)
    if form.behind is None:
        proof = _steepest(form.b, form.states, form, boxes)
        if isinstance(proof, Reason):
            return (replace(check, reason=proof),)
        assert proof.high is not None
        reason = because("L_b <= {L_b}, by outward-rounded intervals", L_b=Up(proof.high))
        return (replace(check, verdict=Verdict.PROVED, reason=reason, proofs=(Slopes(proof),)),)
    # unknown, not refuted: beyond the image of the plant's box b is not the plant's
    if isinstance(_steepest(form.from_form, form.states, form, boxes), Reason):
        poles = "{taken}, of which no slope is proved: Psi may have poles in the box of z"
        return (replace(check, reason=because(poles, taken=_TAKEN)),)
    why = _steepest(form.behind, form.system.states, form, boxes)
    if isinstance(why, Reason):
        return (replace(check, reason=joined(_TAKEN, why)),)
    reason = because("{taken}, both of bounded slope, by outward-rounded intervals", taken=_TAKEN)
    return (replace(check, verdict=Verdict.PROVED, reason=reason),)


def _steepest(rows: Sequence[sp.Expr], states: Sequence[Signal], form: Form, boxes: int) -> Proof | Reason:
    """The proof of the steepest slope of the rows on the box of the states, or the reason why none is proved."""
    around = box((*states, *form.system.inputs, *form.system.parameters), form.system.nominal)
    try:
        steepest = lipschitz_bound(rows, states, around, boxes=boxes)
    except NoTape as missing:
        return because(_SINGULAR, what=missing.what)
    if steepest.verdict is not Verdict.PROVED or not math.isfinite(steepest.high):
        return steepest.reason
    return Proof(tuple(rows), None, Fraction(steepest.high), steepest.variables, steepest.tree)
