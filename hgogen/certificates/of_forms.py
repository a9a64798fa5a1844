"""The evidence of a claim about a form: what `hgogen recheck` needs to verify it again, by what is claimed.

What was found when a check was proved is used again: its bounds and its bisection, carried to the form's coordinates.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from typing import Any

import sympy as sp
from sympy.printing.str import StrPrinter

from hgogen.algebra.kinks import slope
from hgogen.algebra.points import exact
from hgogen.analysis.determinant import determinant
from hgogen.analysis.lie import derivatives, rates
from hgogen.check import Check, Claims, Verdict
from hgogen.form import Form
from hgogen.intervals.bounds import Range, bound, box
from hgogen.intervals.digits import up
from hgogen.intervals.proof import Proof
from hgogen.intervals.sign import Cause, nonzero

Evidence = dict[str, Any]
Sides = Mapping[sp.Symbol, tuple[Fraction | float, Fraction | float]]
_DIGITS = 12
LOOSE = 2.0**-10  # what a Lipschitz bound is wider here than the proof's, so that a weaker arithmetic reaches it


def evidence(form: Form, check: Check) -> Evidence | None:
    """The evidence for a proved or refuted check; None where nothing here shows it."""
    makers = (make for claims, verdict, make in _MAKERS if check.id in claims and check.verdict is verdict)
    return next((make(form, check) for make in makers), None)


def text(form: Form, expression: sp.Expr) -> str:
    """An expression in the certificate's grammar."""
    names = {s.name for s in (*form.system.signals, *form.states)}
    if form.system.origin is not None:
        names |= {s.name for s in form.system.origin.plant.signals}
    return written(expression, names)


def written(expression: sp.Expr, names: set[str]) -> str:
    """An expression of these names in the certificate's grammar."""
    return str(_Printer(names).doprint(exact(sp.sympify(expression))))


def end(value: Fraction | float) -> str | None:
    """An end of a range: exact, None for an infinite one."""
    return None if abs(value) == math.inf else str(Fraction(value))


def outward(value: float | Fraction, way: int) -> Fraction:
    """A number of 12 significant digits at or above the value (`way` 1), or at or below it (-1)."""
    if not value:
        return Fraction(0)
    step: Fraction = Fraction(10) ** (Decimal(up(abs(Fraction(value)))).adjusted() + 1 - _DIGITS)
    steps = Fraction(value) / step
    return step * (math.ceil(steps) if way > 0 else math.floor(steps))


class _Printer(StrPrinter):  # type: ignore[misc]
    """SymPy's text in the certificate's grammar: rationals for floats, exp(1) for e."""

    def __init__(self, names: set[str]) -> None:
        super().__init__()
        self.names = names

    def _print_Exp1(self, expression: sp.Expr) -> str:
        return "exp(1)"

    def _print_Pi(self, expression: sp.Expr) -> str:
        return "4*atan(1)" if "pi" in self.names else "pi"


# --- boxes and bisections


def _box(form: Form, names: Iterable[sp.Symbol]) -> Sides:
    system = form.system
    every = box((*form.states, *system.inputs, *system.parameters), system.nominal)
    return {s: every[s] for s in sorted(names, key=str)}


def _sides(where: Sides) -> dict[str, list[str | None]]:
    return {s.name: [end(low), end(high)] for s, (low, high) in where.items()}


def _mirrored(form: Form) -> dict[sp.Symbol, tuple[str, bool]]:
    """Each state of the plant as the name of the form's state that it is, and whether its sign is changed."""
    names = {}
    for x, image in zip(form.system.states, form.from_form, strict=True):
        if image in form.states or -image in form.states:
            names[x] = (str(abs(image.as_coeff_Mul()[0]) * image.as_coeff_Mul()[1]), image not in form.states)
    return names


def tree(bisection: Range | Proof, form: Form | None = None) -> str:
    """The text of a bisection in prefix order, in the form's coordinates, or in the plant's without a form."""
    images = _mirrored(form) if form else {}
    names = [images.get(s, (s.name, False)) for s in bisection.variables]
    tokens: list[str] = []
    left: list[Any] = [bisection.tree]
    while left:
        node = left.pop()
        if isinstance(node, str):
            tokens.append(".")
            continue
        _, index, first, second = node
        name, mirrored = names[int(index)]
        tokens.append(name)
        left += [first, second] if mirrored else [second, first]
    return " ".join(tokens)


def enclosure(form: Form, expression: sp.Expr, bounds: Range | Proof, where: Sides | None = None) -> Evidence | None:
    """The evidence of low <= expression <= high on the form's box, or on the box `where` of the plant; None where the
    bounds are not finite."""
    low, high = bounds.low, bounds.high
    if isinstance(bounds, Range) and not bounds.defined:
        return None
    if low is None or high is None or not (math.isfinite(low) and math.isfinite(high)):
        return None
    number = Fraction(str(expression)) if expression.is_Rational else None
    return {
        "expression": text(form, expression),
        "box": _sides(_box(form, expression.free_symbols) if where is None else where),
        "low": str(outward(low, -1) if number is None else number),
        "high": str(outward(high, 1) if number is None else number),
        "tree": tree(bounds, form if where is None else None),
    }


# --- the makers


def _gain(form: Form, check: Check) -> Evidence | None:
    """0 < a_m <= a_i <= a_M."""
    return enclosure(form, _coefficient(form, check.id.at), check.proofs[0]) if check.proofs else None


def _coefficient(form: Form, at: tuple[int, ...]) -> sp.Expr:
    """a_i of the one chain, or a_(i,j) of chain i."""
    chain, index = at if len(at) == 2 else (1, *at)
    return exact(sp.sympify(form.gains[chain - 1][index - 1]))


def _no_gain(form: Form, check: Check) -> Evidence | None:
    """A point where a_i is zero, negative or undefined, exactly."""
    a = _coefficient(form, check.id.at)
    where = _box(form, a.free_symbols)
    sign = nonzero(a, where)
    least = sign.range.least
    if sign.cause in (Cause.ZERO, Cause.UNDEFINED, Cause.PART):  # else it is next to the zero only
        point = sign.witness
    elif least is not None and least.value < 0:
        point = least.point
    else:
        return None
    at = {s.name: str(point[s]) for s in where if s in point}
    return {"expression": text(form, a), "witness": at}


def _offset(form: Form, check: Check) -> Evidence | None:
    (chain,) = check.id.at or (1,)
    z = form.states[form.heads[chain - 1]]
    c = exact(sp.sympify(form.output[chain - 1])).subs(z, 0)
    return enclosure(form, c, bound(c, _box(form, c.free_symbols)))


def _slope(form: Form, check: Check) -> Evidence | None:
    """dh/dz_1 or dF_(i-1)/dz_i away from zero, on the box of states, inputs and parameters."""
    slope = _rate_slope(form, *check.id.at)
    where = _box(form, slope.free_symbols)
    bounds = bound(slope, where)
    return enclosure(form, slope, bounds if bounds.low > 0 or bounds.high < 0 else nonzero(slope, where).range)


def _rate_slope(form: Form, index: int) -> sp.Expr:
    rate = form.output[0] if index == 1 else form.flow[index - 2]
    return exact(slope(sp.sympify(rate), form.states[index - 1]))


def _no_slope(form: Form, check: Check) -> Evidence | None:
    """A point where the slope is zero, or two where it has opposite signs."""
    slope = _rate_slope(form, *check.id.at)
    where = _box(form, slope.free_symbols)
    sign = nonzero(slope, where)
    least, most = sign.range.least, sign.range.most
    points: dict[str, Mapping[Any, Any]] = {}
    if least is not None and most is not None and least.value < 0 < most.value:
        points = {"witness": least.point, "other": most.point}
    elif sign.cause is Cause.ZERO:
        points = {"witness": sign.witness}
    witnesses = {key: {s.name: str(point[s]) for s in where if s in point} for key, point in points.items()}
    return {"expression": text(form, slope), **witnesses} if witnesses else None


def _lipschitz(form: Form, check: Check) -> Evidence | None:
    """The evidence for the rows whose slope was proved, in the form's coordinates, whatever part of it they are."""
    back = dict(zip(form.system.states, form.from_form, strict=True))
    proofs = (steep(form, (row.xreplace(back) for row in proof.expressions), proof, LOOSE) for proof in check.proofs)
    return next(proofs, None)


def steep(form: Form, rows: Iterable[sp.Expr], proof: Proof, wider: float = 1e-9) -> Evidence | None:
    """A bound of the rows' Jacobian in the spectral norm, which an order and signs of the states do not change."""
    if proof.high is None:
        return None
    names = set().union(*(exact(sp.sympify(row)).free_symbols for row in rows))
    bound = outward(float(proof.high) * (1 + wider), 1)
    return {"box": _sides(_box(form, names)), "bound": str(bound), "tree": tree(proof, form)}


def _chain(form: Form, check: Check) -> Evidence | None:
    """Phi = (y, y', ..), in the plant's states, its inputs and their derivatives."""
    Phi = _phases(form)
    return None if Phi is None else {"chain": [text(form, entry) for entry in Phi]}


def _phases(form: Form) -> tuple[sp.Expr, ...] | None:
    system = form.system
    if system.origin is not None:
        return None
    derived = {u.derivative(k).name for u in system.inputs for k in range(1, form.n + 1)}
    plant = replace(system, inputs=tuple(u for u in system.inputs if u.name not in derived))
    return derivatives(exact(system.output[0]), rates(plant, form.n), form.n)


def _rank(form: Form, check: Check) -> Evidence | None:
    """det dPhi/dx away from zero."""
    Phi, system = _phases(form), form.system
    if Phi is None:
        return None
    det = exact(determinant([[entry.diff(x) for x in system.states] for entry in Phi]).value)
    known = [u.derivative(k) for u in system.inputs for k in range(form.n)]
    every = box((*known, *system.signals), system.nominal)
    where = {s: every[s] for s in sorted(det.free_symbols, key=str)}
    return enclosure(form, det, nonzero(det, where).range, where)


def _nothing(form: Form, check: Check) -> Evidence:
    """For claims that are verified from the form itself."""
    return {}


Maker = Callable[[Form, Check], Evidence | None]
_MAKERS: tuple[tuple[Claims, Verdict, Maker], ...] = (
    (Claims(fact="structure"), Verdict.PROVED, _nothing),
    (Claims("recast"), Verdict.PROVED, _nothing),
    (Claims(fact="a"), Verdict.PROVED, _gain),
    (Claims(fact="a"), Verdict.REFUTED, _no_gain),
    (Claims(fact="offset"), Verdict.PROVED, _offset),
    (Claims(fact="slope"), Verdict.PROVED, _slope),
    (Claims(fact="slope"), Verdict.REFUTED, _no_slope),
    (Claims(fact="lipschitz"), Verdict.PROVED, _lipschitz),
    (Claims("phase", "chain"), Verdict.PROVED, _chain),
    (Claims("phase", "rank"), Verdict.PROVED, _rank),
)
