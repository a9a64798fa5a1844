"""The hypothesis that a slope is bounded away from zero on the closed box of states, inputs and parameters."""

from dataclasses import replace

import sympy as sp

from hgogen.algebra.tape import NoTape
from hgogen.check import Check, ClaimId, Verdict
from hgogen.intervals.bounds import box
from hgogen.intervals.box import EVERYTHING
from hgogen.intervals.digits import Down
from hgogen.intervals.sign import nonzero
from hgogen.sentence import Sentence, because
from hgogen.structure.chain import Link
from hgogen.system import System


def apart(id: ClaimId, name: str, slope: sp.Expr, plant: System) -> Check:
    """The check that 0 < m <= |slope| on the box, a parameter without a range at its value.

    proved: by outward-rounded intervals and bisection, with the margin m. refuted: with a point where it is zero or
    undefined, or between two of its signs. unknown: with the number of boxes tried, or the missing ranges.
    """
    claim = Sentence.of("0 < m <= |{name}| = |{slope}| on the box", name=name, slope=slope)
    around = box(plant.signals, plant.nominal)
    try:
        sign = nonzero(slope, around)
    except NoTape as error:
        return Check(id, claim, Verdict.UNKNOWN, error.reason)
    if sign.verdict is Verdict.PROVED:
        pattern = "it is at least {margin}" if sign.sign > 0 else "it is at most -{margin}"
        reason = because(pattern, margin=Down(sign.margin))
        return Check(id, claim, sign.verdict, reason, subject=slope)
    if sign.verdict is Verdict.REFUTED:
        witness = {s.name: float(value) for s, value in sign.witness.items()}
        fix = f"Narrow the ranges so that {name} keeps one sign."
        reason = because("{name} {reason}", name=name, reason=sign.reason)
        return Check(id, claim, sign.verdict, reason, witness, fix)
    loose = ", ".join(s.name for s in plant.signals if s in slope.free_symbols and around[s] == EVERYTHING)
    fix = f"Declare low= and high= for {loose}." if loose else ""
    return Check(id, claim, Verdict.UNKNOWN, sign.reason, fix=fix)


def without_jumps(check: Check, link: Link) -> Check:
    """The check of the slope of a link: unknown in place of proved where the row may jump with its state, since it is
    not one-to-one for its slope alone."""
    if check.verdict is not Verdict.PROVED or link.jumps is None:
        return check
    pattern = "{row} may jump with {state}, at a step of {part}, where it has no slope"
    reason = because(pattern, row=link.name, state=link.state, part=link.jumps)
    fix = f"Narrow the range of {link.state} to one branch, or smooth the step."
    return replace(check, verdict=Verdict.UNKNOWN, reason=reason, fix=fix, subject=None, proofs=())
