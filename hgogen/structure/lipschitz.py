"""The hypothesis on b: Lipschitz in the state on the declared box, uniformly in inputs and parameters.

The bound L_b = sup |db/dx| comes from outward-rounded intervals (`slope`). A state without a range is unbounded
here, because an observer does not clamp it.
"""

from collections.abc import Iterable
from dataclasses import replace

import sympy as sp

from hgogen.algebra.kinks import bent
from hgogen.algebra.tape import NoTape
from hgogen.analysis.written import asked, if_valued
from hgogen.check import Check, ClaimId, Verdict
from hgogen.evidence.enclosing import Slopes
from hgogen.intervals.bounds import Proof, counted, ends
from hgogen.intervals.bounds import box as box_of
from hgogen.intervals.digits import Up
from hgogen.intervals.one_sided import one_sided
from hgogen.intervals.singular import minimal, reasons, singular
from hgogen.intervals.slope import JUMPS, KINKS, Lipschitz, lipschitz_bound
from hgogen.sentence import Reason, because
from hgogen.system import System

__all__ = ["JUMPS", "KINKS", "lipschitz"]

_NARROW = "Narrow the ranges so that it stays away from there."


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

    box, entries = box_of(system.signals, system.nominal), tuple(b)
    rows = tuple(one_sided(row, box) for row in entries)
    try:
        steepest = lipschitz_bound(rows, system.states, box)
    except NoTape as missing:
        doubt = because("{what} may jump or be singular", what=missing.what)
        return answer(Verdict.UNKNOWN, doubt, "Write it with functions that are known.")
    if steepest.verdict is Verdict.PROVED:
        bound = Slopes(Proof(entries, None, ends(0.0, steepest.high)[1], steepest.variables, steepest.tree))
        return if_valued(replace(answer(Verdict.PROVED, _bound(steepest)), proofs=(bound,)), system)
    if steepest.verdict is Verdict.REFUTED:
        witness = {s.name: float(value) for s, value in steepest.witness.items()}
        return replace(answer(Verdict.REFUTED, steepest.reason, _NARROW), witness=witness)
    jumps = sorted({node for row in rows for node in bent(row).atoms(*JUMPS) if node.has(*system.states)}, key=str)
    if jumps:
        doubt = because("{part} may jump", part=jumps[0])
        return answer(Verdict.UNKNOWN, doubt, "Write saturations with sympy.Min and sympy.Max.")
    slopes = [row.diff(x) for row in rows for x in system.states if x in row.free_symbols]
    poles = singular([*rows, *slopes], box)
    names = sorted(
        {s.name for row in rows for s in row.free_symbols & {*system.states, *system.inputs} if not s.bounded}
    )
    if names:
        doubt = because("no bound without a range for {names}", names=names)
        return answer(Verdict.UNKNOWN, doubt, f"Declare low= and high= for {', '.join(names)}.")
    if poles:
        conditions = minimal((*poles.values(), *asked(system)))
        if any(part.has(*system.states) for part in (*poles, *(each.of for each in conditions))):
            places = [condition.failure for condition in conditions]
            doubt = because("no uniform bound is shown; it may be singular {places: or }", places=places)
            return answer(Verdict.UNKNOWN, doubt, _NARROW)
        parts = "holds on every closed part of the box where {conditions: and }"
        return answer(Verdict.WHERE, because(parts, conditions=reasons(conditions)), _NARROW)
    return answer(Verdict.UNKNOWN, steepest.reason)


def _bound(steepest: Lipschitz) -> Reason:
    if steepest.high == 0:
        return because("it does not depend on the state")
    pattern = "L_b <= {L_b}, by outward-rounded intervals on {boxes}"
    return because(pattern, L_b=Up(steepest.high), boxes=counted(steepest.boxes))
