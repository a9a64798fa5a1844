"""The hypothesis on b: Lipschitz in z on the declared box, uniformly in inputs and parameters.

A box is convex, so b is Lipschitz there if it is continuous and its Jacobian is bounded (mean value theorem).
The bound comes from exact interval arithmetic; that Abs, Min and Max have no derivative on a null set does no
harm. A state without a range is unbounded here, because an observer does not clamp it.
"""

from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction

import sympy as sp

from hgogen.check import Check, Verdict
from hgogen.interval import Box, Interval, contains_zero, enclose, finite
from hgogen.interval import box as box_of
from hgogen.signal import Signal
from hgogen.system import System

# A jump hides from the derivative, so these are never taken as continuous.
_JUMPS = (sp.Piecewise, sp.sign, sp.floor, sp.ceiling, sp.frac, sp.Mod, sp.Heaviside)
_ONE = Fraction(1)

# Functions with singular points: (index of the argument, whether its range is clear of them, what must hold).
_SINGULAR: dict[type, tuple[int, Callable[[Interval], bool], str]] = {
    sp.log: (0, lambda t: t[0] > 0, "{} > 0"),
    sp.tan: (0, lambda t: -Fraction(3, 2) <= t[0] and t[1] <= Fraction(3, 2), "cos({}) != 0"),
    sp.asin: (0, lambda t: t[0] > -_ONE and t[1] < _ONE, "-1 < {} < 1"),
    sp.acos: (0, lambda t: t[0] > -_ONE and t[1] < _ONE, "-1 < {} < 1"),
    sp.atanh: (0, lambda t: t[0] > -_ONE and t[1] < _ONE, "-1 < {} < 1"),
    sp.acosh: (0, lambda t: t[0] > _ONE, "{} > 1"),
    sp.atan2: (1, lambda t: t[0] > 0, "{} > 0"),
}


def lipschitz(id: str, b: Sequence[sp.Expr], states: Sequence[Signal], system: System) -> Check:
    """The check that b (n expressions of `states`, inputs and parameters) is Lipschitz in the states.

    proved: every entry of its Jacobian has a finite range. where: it may have singular points on the box, and
    is Lipschitz on every compact part without them. unknown: a range is missing, or there may be a jump, or
    exact interval arithmetic finds no bound.
    """

    def answer(verdict: Verdict, reason: str, fix: str = "") -> Check:
        return Check(id, "b is Lipschitz in z on the box", verdict, reason, fix=fix)

    fixed = {p: value for p, value in system.nominal.items() if not p.bounded}
    rows = [row.xreplace(fixed) for row in b]
    box = box_of((*states, *system.inputs, *system.parameters))
    jumps = sorted({str(node) for row in rows for node in row.atoms(*_JUMPS) if node.has(*states)})
    if jumps:
        return answer(
            Verdict.UNKNOWN, f"{jumps[0]} may jump", "Write saturations with sympy.Min and sympy.Max."
        )
    slopes = [row.diff(z) for row in rows for z in states if z in row.free_symbols]
    unbounded = [slope for slope in slopes if not finite(enclose(slope, box))]
    singular = _singular([*rows, *slopes], box)
    missing = {s.name for doubt in (*unbounded, *singular) for s in doubt.free_symbols if not s.bounded}
    if missing:
        names = ", ".join(sorted(missing))
        return answer(
            Verdict.UNKNOWN, f"no bound without a range for {names}", f"Declare low= and high= for {names}."
        )
    tamed = {node: sp.Dummy() for node in singular}
    rest = {**box, **dict.fromkeys(tamed.values(), (_ONE, _ONE))}
    for slope in unbounded:
        if not finite(enclose(slope.xreplace(tamed), rest)):
            return answer(Verdict.UNKNOWN, f"exact intervals give the slope {slope} no bound")
    if singular:
        holds = " and ".join(sorted({_condition(node, box) for node in singular}))
        return answer(Verdict.WHERE, f"holds where {holds}", "Narrow the ranges so that it holds everywhere.")
    return answer(Verdict.PROVED, "every partial derivative is bounded there, by exact intervals")


def _singular(expressions: Iterable[sp.Expr], box: Box) -> list[sp.Expr]:
    """Nodes whose argument may reach, on the box, a point where they are not smooth."""
    nodes = {node for expression in expressions for node in expression.atoms(sp.Pow, *_SINGULAR)}
    return sorted((node for node in nodes if _condition(node, box)), key=str)


def _condition(node: sp.Expr, box: Box) -> str:
    """What must hold for `node` to be smooth; empty if exact intervals show that it does on the whole box."""
    if type(node) in _SINGULAR:
        index, clear, text = _SINGULAR[type(node)]
        return "" if clear(enclose(node.args[index], box)) else text.format(node.args[index])
    base = enclose(node.base, box)
    if node.exp.is_Integer:
        return f"{node.base} != 0" if node.exp < 0 and contains_zero(base) else ""
    if base[0] > 0 or (node.exp.is_Rational and node.exp > 0 and base[0] >= 0):
        return ""
    return f"{node.base} > 0"
