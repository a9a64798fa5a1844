"""Whether b is Lipschitz where an observer evaluates it: with its argument clamped to the box of z.

z = Phi(x) takes the plant's box to a part of the box of z. What is shown on that image says nothing of the rest of the
box of z, through which the estimate may pass. A clamp of each component is Lipschitz, so b is after it if it is on the
box.
"""

import math
from collections.abc import Sequence
from fractions import Fraction

import sympy as sp

from hgogen.algebra.tape import NoTape
from hgogen.check import Check, ClaimId, Verdict
from hgogen.evidence.enclosing import Slopes
from hgogen.form import Form
from hgogen.intervals.bounds import Proof
from hgogen.intervals.box import box
from hgogen.intervals.digits import Up
from hgogen.intervals.slope import lipschitz_bound
from hgogen.sentence import Reason, because, joined
from hgogen.signal import Signal

BOXES = 500  # the bound need not be the least
_TAKEN = because("b is taken at Psi(z), clamped to the plant's ranges")


def clamped(observer: str, form: Form, *, boxes: int = BOXES) -> tuple[Check, ...]:
    """The check `OBSERVER.lipschitz` of a form in other coordinates than the plant's states, in some order and with
    signs. For those states the form's own check is of the same box, and no check is made; nor is one where b is 0.
    """
    if not any(form.b) or all(any(z in (x, -x) for x in form.system.states) for z in form.to_form):
        return ()
    claim = "b is Lipschitz in z on the whole box of z, to which its argument is clamped"
    if form.free:
        return (Check(ClaimId(observer, "lipschitz"), claim, Verdict.UNKNOWN, because("it is not clamped")),)
    verdict, reason, *proofs = _bounded_slope(form, boxes)
    return (Check(ClaimId(observer, "lipschitz"), claim, verdict, reason, proofs=tuple(map(Slopes, proofs))),)


def _bounded_slope(form: Form, boxes: int) -> tuple[Verdict, Reason] | tuple[Verdict, Reason, Proof]:
    """The verdict, the reason and the proof. The verdict is PROVED or UNKNOWN: beyond the image of the plant's box b is
    not the plant's, and nothing there refutes."""
    if form.behind is None:
        proof = _steepest(form.b, form.states, form, boxes)
        if isinstance(proof, Reason):
            return Verdict.UNKNOWN, proof
        assert proof.high is not None
        return Verdict.PROVED, because("L_b <= {L_b}, by outward-rounded intervals", L_b=Up(proof.high)), proof
    if isinstance(_steepest(form.from_form, form.states, form, boxes), Reason):
        poles = "{taken}, of which no slope is proved: Psi may have poles in the box of z"
        return Verdict.UNKNOWN, because(poles, taken=_TAKEN)
    why = _steepest(form.behind, form.system.states, form, boxes)
    if isinstance(why, Reason):
        return Verdict.UNKNOWN, joined(_TAKEN, why)
    return Verdict.PROVED, because("{taken}, both of bounded slope, by outward-rounded intervals", taken=_TAKEN)


def _steepest(rows: Sequence[sp.Expr], states: Sequence[Signal], form: Form, boxes: int) -> Proof | Reason:
    """The proof of the steepest slope of the rows on the box of the states, or the reason why none is proved."""
    around = box((*states, *form.system.inputs, *form.system.parameters), form.system.nominal)
    try:
        steepest = lipschitz_bound(rows, states, around, boxes=boxes)
    except NoTape as missing:
        return because("{what} may jump or be singular", what=missing.what)
    if steepest.verdict is not Verdict.PROVED or not math.isfinite(steepest.high):
        return steepest.reason
    return Proof(tuple(rows), None, Fraction(steepest.high), steepest.variables, steepest.tree)
