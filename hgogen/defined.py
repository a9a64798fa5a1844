"""The hypothesis that a known function of inputs and parameters is a finite real number on the whole box."""

import sympy as sp

from hgogen.check import Check, Verdict
from hgogen.interval import box as box_of
from hgogen.points import exact, kind, points, witness
from hgogen.singular import singular
from hgogen.system import System


def defined(id: str, name: str, c: sp.Expr, system: System) -> Check:
    """The check that c is defined on the box; `name` is what the report calls it.

    proved: exact intervals find no singular point. refuted: with a point. unknown: neither, or a range is missing.
    """
    claim = f"{name} = {c} is a finite real number on the box"
    c = exact(c.xreplace({p: value for p, value in system.nominal.items() if not p.bounded}))
    signals = tuple(s for s in system.signals if s in c.free_symbols)
    poles = singular([c], box_of(signals))
    if not poles and not c.has(sp.nan, sp.zoo, sp.oo, -sp.oo):
        return Check(id, claim, Verdict.PROVED, "exact intervals find no singular point")
    loose = ", ".join(s.name for s in signals if not s.bounded)
    if loose:
        fix = f"Declare low= and high= for {loose}."
        return Check(id, claim, Verdict.UNKNOWN, f"no range is declared for {loose}", fix=fix)
    fix = f"Narrow the ranges so that {name} is defined everywhere."
    for point in points(signals):
        if kind(c, point) == "undefined":
            return Check(id, claim, Verdict.REFUTED, f"{name} is not a finite real number", witness(point), fix)
    return Check(id, claim, Verdict.UNKNOWN, f"holds where {' and '.join(sorted(set(poles.values())))}", fix=fix)
