"""The hypothesis that a known function of inputs and parameters is a finite real number on the whole box."""

import sympy as sp

from hgogen.algebra.points import exact, kind, points, settled, witness
from hgogen.algebra.tape import NoTape, tape
from hgogen.check import Check, ClaimId, Verdict
from hgogen.intervals.bounds import Box, bound, box
from hgogen.intervals.singular import minimal, singular
from hgogen.system import System

_BOXES = 2000
_LOOSE = 1e6  # of a range that is asked only whether it is there
_SLOPED_BEYOND = (sp.log, sp.atanh, sp.tan)  # their derivatives may have a real value where they have none


def defined(id: ClaimId, name: str, c: sp.Expr, system: System) -> Check:
    """The check that c is defined on the box; `name` is what the report calls it.

    It is proved by outward-rounded intervals and bisection, refuted by a point, and unknown otherwise.
    """
    claim = f"{name} = {c} is a finite real number on the box"
    c = exact(settled(c, {p: value for p, value in system.nominal.items() if not p.bounded}))
    signals = tuple(s for s in system.signals if s in c.free_symbols)
    around = box(signals, system.nominal)
    try:
        extent = bound(c, around, boxes=_BOXES)
    except NoTape as missing:
        return Check(id, claim, Verdict.UNKNOWN, str(missing))
    if extent.defined:
        return Check(id, claim, Verdict.PROVED, "outward-rounded intervals find no singular point")
    loose = ", ".join(s.name for s in signals if not s.bounded)
    if loose:
        fix = f"Declare low= and high= for {loose}."
        return Check(id, claim, Verdict.UNKNOWN, f"no range is declared for {loose}", fix=fix)
    fix = f"Narrow the ranges so that {name} is defined everywhere."
    for point in points(signals):
        if kind(c, point) == "undefined":
            return Check(id, claim, Verdict.REFUTED, f"{name} is not a finite real number", witness(point), fix)
    poles = singular([c], around)
    reason = f"holds where {' and '.join(map(str, minimal(poles.values())))}" if poles else extent.note
    return Check(id, claim, Verdict.UNKNOWN, reason, fix=fix)


def beyond(row: sp.Expr, state: sp.Symbol, around: Box) -> str:
    """A part of the state in the row that is not shown to have a value, though the row's slope in the state may be
    finite: a logarithm or atanh that may be real nowhere, a tangent or a quotient whose poles cancel in the slope (of
    atan(tan(x)) it is 1), a function without a rule; "" without."""
    nodes = (node for node in row.atoms(sp.Pow, sp.Function) if node.has(state) and _sloped_beyond(node))
    return next((str(node) for node in sorted(nodes, key=str) if not _defined(node, around)), "")


def _sloped_beyond(node: sp.Expr) -> bool:
    if isinstance(node, sp.Pow):
        return bool(node.exp.is_negative)
    return isinstance(node, _SLOPED_BEYOND) or not _ruled(node)


def _ruled(node: sp.Expr) -> bool:
    try:
        return bool(tape([node], node.free_symbols).outputs)
    except NoTape:
        return False


def _defined(node: sp.Expr, around: Box) -> bool:
    try:
        return bound(node, around, boxes=_BOXES, relative=_LOOSE).defined
    except NoTape:
        return False
