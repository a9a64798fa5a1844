"""The hypothesis that a slope is bounded away from zero on the closed box of states, inputs and parameters."""

import sympy as sp

from hgogen.algebra.tape import NoTape
from hgogen.check import Check, ClaimId, Verdict
from hgogen.intervals.bounds import box
from hgogen.intervals.digits import down
from hgogen.intervals.sign import nonzero
from hgogen.system import System


def apart(id: ClaimId, name: str, slope: sp.Expr, plant: System) -> Check:
    """The check that 0 < m <= |slope| on the box, a parameter without a range at its value.

    proved: by outward-rounded intervals and bisection, with the margin m. refuted: with a point where it is zero or
    undefined, or between two of its signs. unknown: with the number of boxes tried, or the missing ranges.
    """
    claim = f"0 < m <= |{name}| = |{slope}| on the box"
    around = box(plant.signals, plant.nominal)
    try:
        sign = nonzero(slope, around)
    except NoTape as error:
        return Check(id, claim, Verdict.UNKNOWN, str(error))
    if sign.verdict is Verdict.PROVED:
        reason = f"it is {'at least ' if sign.sign > 0 else 'at most -'}{down(sign.margin)}"
        return Check(id, claim, sign.verdict, reason, subject=slope)
    if sign.verdict is Verdict.REFUTED:
        witness = {s.name: float(value) for s, value in sign.witness.items()}
        fix = f"Narrow the ranges so that {name} keeps one sign."
        return Check(id, claim, sign.verdict, f"{name} {sign.reason}", witness, fix)
    loose = ", ".join(s.name for s in plant.signals if s in slope.free_symbols and around[s][0] == -around[s][1])
    fix = f"Declare low= and high= for {loose}." if loose else ""
    return Check(id, claim, Verdict.UNKNOWN, sign.reason, fix=fix)
