"""Rigorous answers on a closed box: the range of an expression, whether it vanishes, how steep a vector field is.

What is proved comes from outward-rounded intervals and bisection (`intervals.search`), what is refuted from a point;
limits count boxes. Numbers are exact: a float is its shortest decimal.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

import sympy as sp

from hgogen.algebra.points import exact
from hgogen.algebra.tape import Tape, tape
from hgogen.algebra.variants import variants
from hgogen.check import Verdict
from hgogen.intervals.box import Box, End, Point, Sides, box, sides
from hgogen.intervals.digits import down, up
from hgogen.intervals.outward import Array
from hgogen.intervals.search import Found, Goal, Tree, one_sign, regular, search, tight
from hgogen.intervals.slope import lipschitz_bound
from hgogen.intervals.zeros import crossing, special_point

__all__ = ["LIMIT", "Attained", "Box", "End", "Range", "Sign", "bound", "box", "lipschitz_bound", "nonzero"]

LIMIT = 20_000
_FIRST = 500  # boxes before a pole is looked for
_GLANCE = 60  # and before a zero


@dataclass(frozen=True)
class Attained:
    """A point of the box and a bound of the value there: at most `value` for the least, at least for the most."""

    value: float
    point: Mapping[sp.Symbol, Fraction] = field(hash=False)


@dataclass(frozen=True)
class Range:
    """The range of an expression on a box.

    low <= value <= high wherever it and its parts are finite and real; -inf and inf where nothing is proved. `defined`:
    proved finite and real on the whole closed box. `least`, `most`: points where a value as small, as large is
    attained. `boxes`: how many were tried; `note`: why it is not tighter, or "". `variables`: what the tree's indices
    count; `tree`: the bisection, ("split", index, left, right) and "leaf", sides cut as `floats.middle` says.
    """

    low: float
    high: float
    defined: bool
    least: Attained | None
    most: Attained | None
    boxes: int
    note: str
    variables: tuple[sp.Symbol, ...]
    tree: Tree = field(repr=False)

    @property
    def finite(self) -> bool:
        """Whether both ends are finite."""
        return math.isfinite(self.low) and math.isfinite(self.high)

    def __str__(self) -> str:
        said = [f"from {down(self.low, 9)} to {up(self.high, 9)}, by {_boxes(self.boxes)}"]
        ends = (("least", "at most", up, self.least), ("most", "at least", down, self.most))
        said += [
            f"the {end} is {side} {rounded(one.value, 9)}{_at(one.point)}"
            for end, side, rounded, one in ends
            if one is not None
        ]
        return "; ".join([*said, *filter(None, [self.note])])

    def as_dict(self) -> dict[str, Any]:
        """For JSON, which has no infinity: None for an end that is not bounded."""
        low, high = (end if math.isfinite(end) else None for end in (self.low, self.high))
        return {"low": low, "high": high, "defined": self.defined, "boxes": self.boxes, "note": self.note}


@dataclass(frozen=True)
class Sign:
    """Whether an expression has one sign on a box.

    PROVED: `sign` is 1 or -1 and 0 < `margin` <= |value| there, finite. REFUTED: `witness` is a point where it is zero
    or undefined, or next to a zero between two points of opposite sign. UNKNOWN: `reason` says how many boxes were
    tried.
    """

    verdict: Verdict
    sign: int
    margin: float
    witness: Mapping[sp.Symbol, Fraction] = field(hash=False)
    reason: str
    range: Range

    def __str__(self) -> str:
        if self.verdict is Verdict.PROVED:
            told = f"at least {down(self.margin, 9)}" if self.sign > 0 else f"at most -{down(self.margin, 9)}"
            return f"{self.verdict}: {told}, by {self.reason}"
        return f"{self.verdict}: {self.reason}{_at(self.witness)}"


def bound(expression: sp.Expr, box: Box, *, boxes: int = LIMIT, relative: float = 0.02) -> Range:
    """The range of the expression on the box, outward; wider than the true one by at most `relative` of its width,
    or `note` says why.

    Raises: `EmptyBox`; `NoTape` for a function without a rule.
    """
    problem = _problem(expression, box)
    if problem is None:
        return _NOWHERE
    found = problem.search(tight(relative), min(boxes, _FIRST))
    if found.finished:
        return _range(problem, found, relative)
    if not found.defined:
        special = special_point(problem.expression, problem.program, problem.sides, ("undefined",))
        if special:  # more boxes would not help
            return replace(
                _range(problem, found, relative), note=f"it is not a finite real number at {_text(special[1])}"
            )
    return _range(problem, problem.search(tight(relative), boxes), relative)


def nonzero(expression: sp.Expr, box: Box, *, boxes: int = LIMIT, refute: bool = True) -> Sign:
    """Whether the expression is finite and has one sign on the whole box; without `refute`, which may take long, proved
    or unknown.

    Raises: `EmptyBox`; `NoTape` for a function without a rule.
    """
    problem = _problem(expression, box)
    if problem is None:
        return Sign(Verdict.REFUTED, 0, 0.0, {}, "it is not a finite real number", _NOWHERE)
    for limit in dict.fromkeys((min(boxes, _GLANCE), boxes)):
        found = problem.search(one_sign, limit)
        if found.defined and (found.low > 0 or found.high < 0):
            return _proved(problem, found)
        refuted = _refutation(problem, found, limit) if refute else None
        if refuted:
            reason, witness = refuted
            return Sign(Verdict.REFUTED, 0, 0.0, witness, reason, _range(problem, found, 0.0))
        if found.boxes + 2 <= limit:  # more boxes would change nothing
            break
    reason = f"{_boxes(found.boxes)} {'does' if found.boxes == 1 else 'do'} not decide it"
    return Sign(Verdict.UNKNOWN, 0, 0.0, {}, reason, _range(problem, found, 0.0))


_NOWHERE = Range(-math.inf, math.inf, False, None, None, 0, "it is not a finite real number", (), "leaf")


@dataclass(frozen=True)
class _Problem:
    """An expression with exact numbers, its points put in, and its forms as a tape."""

    expression: sp.Expr
    sides: Sides
    program: Tape

    def search(self, goal: Goal, boxes: int) -> Found:
        return search(self.program, self.sides.outer, self.sides.inner, goal, boxes)


def _problem(expression: sp.Expr, box: Box) -> _Problem | None:
    """None for an expression that is nowhere a finite real number."""
    fixed, around = sides(exact(sp.sympify(expression)), box)
    if fixed.has(sp.nan, sp.zoo, sp.oo, -sp.oo, sp.I, sp.AccumBounds):
        return None
    return _Problem(fixed, around, tape(variants(fixed), around.symbols))


def _range(problem: _Problem, found: Found, relative: float) -> Range:
    return Range(
        low=found.low,
        high=found.high,
        defined=found.defined,
        least=_attained(problem, found.inner.least, found.inner.at_least),
        most=_attained(problem, found.inner.most, found.inner.at_most),
        boxes=found.boxes,
        note=_note(found, relative),
        variables=problem.sides.symbols,
        tree=found.tree,
    )


def _attained(problem: _Problem, value: float, at: Array | None) -> Attained | None:
    if not problem.sides.symbols and math.isfinite(value):
        return Attained(value, {})
    return None if at is None else Attained(value, problem.sides.point(at.tolist()))


def _note(found: Found, relative: float) -> str:
    if not found.defined:
        return f"it was not shown to be finite and real everywhere, with {_boxes(found.boxes)}"
    if found.finished:
        return ""
    return f"it is not within {relative:.0%} of values that are attained, with {_boxes(found.boxes)}"


def _proved(problem: _Problem, found: Found) -> Sign:
    positive = found.low > 0
    margin = found.low if positive else -found.high
    reason = _boxes(found.boxes)
    return Sign(Verdict.PROVED, 1 if positive else -1, margin, {}, reason, _range(problem, found, 0.0))


def _refutation(problem: _Problem, found: Found, boxes: int) -> tuple[str, Point] | None:
    """Why it has not one sign, and where."""
    near = [problem.sides.point(at.tolist()) for at in (found.inner.at_least, found.inner.at_most) if at is not None]
    special = special_point(problem.expression, problem.program, problem.sides, near=near)
    if special:
        what, point = special
        return ("vanishes" if what == "= 0" else "is not a finite real number"), point
    crossed = _crossed(problem, found, boxes)
    if crossed:
        return "changes sign", crossed
    for part, reason in _parts(problem.expression):
        inner = nonzero(part, _as_box(problem.sides), boxes=boxes)
        if inner.verdict is Verdict.REFUTED:
            rest = {s: Fraction(_any(ends)) for s, ends in zip(problem.sides.symbols, problem.sides.ends, strict=True)}
            return reason.format(part), rest | dict(inner.witness)
    return None


def _crossed(problem: _Problem, found: Found, boxes: int) -> Point | None:
    """The zero between two values of opposite sign of a continuous expression."""
    least, most = (
        _attained(problem, found.inner.least, found.inner.at_least),
        _attained(problem, found.inner.most, found.inner.at_most),
    )
    if least is None or most is None or not least.value < 0 < most.value:
        return None
    if not found.continuous:
        between = {s: _ordered(least.point[s], most.point[s]) for s in problem.sides.symbols}
        part = _problem(problem.expression, between)
        if part is None or not part.search(regular, boxes).continuous:
            return None
    return crossing(problem.expression, problem.program, problem.sides, dict(least.point), dict(most.point))


def _ordered(a: Fraction, b: Fraction) -> tuple[Fraction, Fraction]:
    return (a, b) if a <= b else (b, a)


def _parts(expression: sp.Expr) -> Iterator[tuple[sp.Expr, str]]:
    """Factors, at whose zeros the expression is zero or undefined, and what it divides by."""
    powers = [] if expression.has(sp.Piecewise) else sorted(expression.atoms(sp.Pow), key=str)
    for node in powers:  # a Piecewise may not take the branch that is not finite
        if node.exp.is_Rational and node.exp < 0 and node.base != expression and not node.base.is_number:
            yield node.base, "is not finite: it divides by {}, which vanishes"
    try:
        _, factors = sp.factor_list(sp.together(expression))
    except (sp.PolynomialError, NotImplementedError):
        return
    for factor, _ in factors:
        if factor != expression and factor.free_symbols and not factor.is_Symbol:
            yield factor, "vanishes with its factor {}, or is not finite there"


def _boxes(count: int) -> str:
    return f"{count} box{'' if count == 1 else 'es'}"


def _text(point: Mapping[sp.Symbol, Fraction]) -> str:
    return ", ".join(f"{s} = {value}" for s, value in point.items())


def _at(point: Mapping[sp.Symbol, Fraction]) -> str:
    """Where, in few digits."""
    return ", at " + ", ".join(f"{s} = {float(value):g}" for s, value in point.items()) if point else ""


def _as_box(sides: Sides) -> dict[sp.Symbol, tuple[End, End]]:
    return dict(zip(sides.symbols, sides.ends, strict=True))


def _any(ends: tuple[End, End]) -> End:
    low, high = ends
    return low if abs(low) != math.inf else high if abs(high) != math.inf else Fraction(0)
