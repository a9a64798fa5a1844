"""The hypothesis on b: Lipschitz in the state on the declared box, uniformly in inputs and parameters.

A box is convex, so b is Lipschitz there if it is continuous and its Jacobian is bounded (mean value theorem).
The bound comes from exact interval arithmetic; that Abs, Min and Max have no derivative on a null set does no
harm. A state without a range is unbounded here, because an observer does not clamp it.
"""

from collections.abc import Iterable
from fractions import Fraction

import sympy as sp

from hgogen.check import Check, Verdict
from hgogen.interval import box as box_of
from hgogen.interval import enclose, finite
from hgogen.singular import singular
from hgogen.system import System

# A jump hides from the derivative, so these are never taken as continuous.
JUMPS = (sp.Piecewise, sp.sign, sp.floor, sp.ceiling, sp.frac, sp.Mod, sp.Heaviside)
KINKS = (sp.Abs, sp.Min, sp.Max)


def lipschitz(id: str, b: Iterable[sp.Expr], system: System, name: str = "b") -> Check:
    """The check that b is Lipschitz in the states; b is given in the plant's states, inputs and parameters,
    `name` is what the report calls it.

    proved: every entry of its Jacobian has a finite range. where: it may have singular points on the box, and
    is Lipschitz on every compact part without them. unknown: a range is missing, or there may be a jump, or
    exact interval arithmetic finds no bound.
    """

    def answer(verdict: Verdict, reason: str, fix: str = "") -> Check:
        return Check(id, f"{name} is Lipschitz in the state on the box", verdict, reason, fix=fix)

    fixed = {p: value for p, value in system.nominal.items() if not p.bounded}
    rows = [row.xreplace(fixed) for row in b]
    box = box_of(system.signals)
    jumps = sorted({str(node) for row in rows for node in row.atoms(*JUMPS) if node.has(*system.states)})
    if jumps:
        return answer(Verdict.UNKNOWN, f"{jumps[0]} may jump", "Write saturations with sympy.Min and sympy.Max.")
    slopes = [row.diff(x) for row in rows for x in system.states if x in row.free_symbols]
    unbounded = [slope for slope in slopes if not finite(enclose(slope, box))]
    poles = singular([*rows, *slopes], box)
    missing = {s.name for doubt in (*unbounded, *poles) for s in doubt.free_symbols if not s.bounded}
    if missing:
        names = ", ".join(sorted(missing))
        return answer(Verdict.UNKNOWN, f"no bound without a range for {names}", f"Declare low= and high= for {names}.")
    tamed = {node: sp.Dummy() for node in poles}
    one = Fraction(1)
    rest = {**box, **dict.fromkeys(tamed.values(), (one, one))}
    for slope in unbounded:
        if not finite(enclose(slope.xreplace(tamed), rest)):
            return answer(Verdict.UNKNOWN, f"exact intervals give the slope {slope} no bound")
    if poles:
        conditions = set(poles.values())
        conditions -= {positive.replace(" > 0", " != 0") for positive in conditions if " > 0" in positive}
        holds = " and ".join(sorted(conditions))
        return answer(Verdict.WHERE, f"holds where {holds}", "Narrow the ranges so that it holds everywhere.")
    return answer(Verdict.PROVED, "every partial derivative is bounded there, by exact intervals")
