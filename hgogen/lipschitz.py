"""The hypothesis on b: Lipschitz in z on the declared box, uniformly in inputs and parameters.

A box is convex, so b is Lipschitz there if it is continuous and its Jacobian is bounded (mean value theorem). The
bound comes from exact interval arithmetic; a derivative of Abs, Min or Max exists outside a null set, which is
enough. A state without a range is unbounded here, because an observer does not clamp it.
"""

from collections.abc import Iterable, Sequence

import sympy as sp

from hgogen.check import Check, Verdict
from hgogen.interval import Box, contains_zero, enclose, finite
from hgogen.interval import box as box_of
from hgogen.signal import Signal
from hgogen.system import System

# A jump hides from the derivative, so these are never taken as continuous.
_JUMPS = (sp.Piecewise, sp.sign, sp.floor, sp.ceiling, sp.Heaviside)


def lipschitz(id: str, b: Sequence[sp.Expr], states: Sequence[Signal], system: System) -> Check:
    """The check that b (n expressions of `states`, inputs and parameters) is Lipschitz in the states.

    proved: every entry of its Jacobian has a finite range. where: it has singular points on the box. unknown: a
    range is missing, or exact interval arithmetic finds no bound.
    """
    claim = "b is Lipschitz in z on the box"
    fixed = {p: value for p, value in system.nominal.items() if not p.bounded}
    rows = [row.xreplace(fixed) for row in b]
    box = box_of((*states, *system.inputs, *system.parameters))
    entries = [row.diff(z) for row in rows for z in states if z in row.free_symbols]
    jumps = sorted({str(node) for row in rows for node in row.atoms(*_JUMPS)})
    if jumps:
        return Check(id, claim, Verdict.UNKNOWN, f"{jumps[0]} may jump", fix="Write the model without jumps.")
    unbounded = [entry for entry in entries if not finite(enclose(entry, box))]
    missing = sorted(
        {s.name for e in (*unbounded, *_singular(rows, box)) for s in e.free_symbols if not s.bounded}
    )
    if missing:
        names = ", ".join(missing)
        fix = f"Declare low= and high= for {names}."
        return Check(
            id, claim, Verdict.UNKNOWN, f"the slope has no bound without a range for {names}", fix=fix
        )
    singular = sorted({_condition(node, box) for node in _singular([*rows, *entries], box)})
    if singular:
        fix = "Narrow the declared ranges so that the condition holds on all of the box."
        return Check(id, claim, Verdict.WHERE, "holds where " + " and ".join(singular), fix=fix)
    if unbounded:
        return Check(id, claim, Verdict.UNKNOWN, f"no bound was found for the slope {unbounded[0]}")
    return Check(id, claim, Verdict.PROVED, "every partial derivative is bounded there, by exact intervals")


def _singular(expressions: Iterable[sp.Expr], box: Box) -> list[sp.Expr]:
    """Powers and logarithms whose argument may reach a point on the box where they are not smooth."""
    nodes = {node for expression in expressions for node in expression.atoms(sp.Pow, sp.log)}
    return sorted((node for node in nodes if _condition(node, box)), key=str)


def _condition(node: sp.Expr, box: Box) -> str:
    """What must hold at `node`, empty if exact intervals show that it does."""
    if isinstance(node, sp.log):
        return "" if enclose(node.args[0], box)[0] > 0 else f"{node.args[0]} > 0"
    base = enclose(node.base, box)
    if node.exp.is_Integer:
        return f"{node.base} != 0" if node.exp < 0 and contains_zero(base) else ""
    if base[0] > 0 or (node.exp.is_Rational and node.exp > 0 and base[0] >= 0):
        return ""
    return f"{node.base} > 0"
