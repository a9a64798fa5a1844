"""The hypothesis that a known function of inputs and parameters is a finite real number on the whole box."""

from dataclasses import dataclass

import sympy as sp

from hgogen.algebra.points import exact, kind, points, settled, witness
from hgogen.algebra.tape import NoTape
from hgogen.check import Check, ClaimId, Verdict
from hgogen.evidence.enclosing import enclosure, sides
from hgogen.evidence.grounds import Evidence
from hgogen.form import Form
from hgogen.intervals.bounds import bound, box
from hgogen.intervals.singular import minimal, reasons, singular
from hgogen.sentence import Sentence, because
from hgogen.system import System

_BOXES = 2000


@dataclass(frozen=True)
class Offset:
    """The known part of an output, that of chain `chain`, which has a value."""

    chain: int

    def evidence(self, form: Form) -> Evidence | None:
        """Its range."""
        z = form.states[form.heads[self.chain - 1]]
        c = exact(sp.sympify(form.output[self.chain - 1])).subs(z, 0)
        return enclosure(form, c, bound(c, sides(form, c.free_symbols)))


def defined(id: ClaimId, name: str, c: sp.Expr, system: System) -> Check:
    """The check that c is defined on the box; `name` is what the report calls it.

    It is proved by outward-rounded intervals and bisection, refuted by a point, and unknown otherwise.
    """
    claim = Sentence.of("{name} = {c} is a finite real number on the box", name=name, c=c)
    c = exact(settled(c, {p: value for p, value in system.nominal.items() if not p.bounded}))
    signals = tuple(s for s in system.signals if s in c.free_symbols)
    around = box(signals, system.nominal)
    try:
        extent = bound(c, around, boxes=_BOXES)
    except NoTape as missing:
        return Check(id, claim, Verdict.UNKNOWN, missing.reason)
    if extent.defined:
        reason = because("outward-rounded intervals find no singular point")
        return Check(id, claim, Verdict.PROVED, reason, proofs=(Offset(*id.at or (1,)),))
    loose = [s.name for s in signals if not s.bounded]
    if loose:
        fix = f"Declare low= and high= for {', '.join(loose)}."
        return Check(id, claim, Verdict.UNKNOWN, because("no range is declared for {names}", names=loose), fix=fix)
    fix = f"Narrow the ranges so that {name} is defined everywhere."
    for point in points(signals):
        if kind(c, point) == "undefined":
            reason = because("{name} is not a finite real number", name=name)
            return Check(id, claim, Verdict.REFUTED, reason, witness(point), fix)
    poles = singular([c], around)
    holds = because("holds where {conditions: and }", conditions=reasons(minimal(poles.values())))
    reason = holds if poles else extent.note
    return Check(id, claim, Verdict.UNKNOWN, reason, fix=fix)
