"""Whether an expression is 0 somewhere on a closed box: the one answer that forms and singular sets stand on.

Proved by outward-rounded intervals and bisection, by rational ends where floats are too coarse, or factor by factor
after exact algebra; refuted by a point, or between two points of opposite sign. A slope's values at a kink are a set,
and a set that jumps over 0 has not one sign: an upper semicontinuous map with convex values takes connected boxes to
connected sets (J.-P. Aubin, A. Cellina, "Differential inclusions", 1984, chapter 1).
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from fractions import Fraction
from functools import lru_cache

import sympy as sp

from hgogen.algebra.factors import Factors, factors
from hgogen.algebra.kinks import jump
from hgogen.check import Verdict
from hgogen.intervals.bounds import (
    LIMIT,
    NOWHERE,
    Problem,
    Range,
    attained,
    counted,
    place,
    problem_of,
    range_of,
    steep,
)
from hgogen.intervals.box import Box, End, Point
from hgogen.intervals.digits import down
from hgogen.intervals.glance import Interval, beyond, fractions, multiplied, raised, rational
from hgogen.intervals.outward import number
from hgogen.intervals.search import Outcome, one_sign, regular
from hgogen.intervals.zeros import crossing, special_point
from hgogen.sentence import Reason, because

_GLANCE = 60  # boxes before a zero is looked for


class Cause(Enum):
    """Why an expression has not one sign, at the witness."""

    ZERO = "vanishes"
    UNDEFINED = "is not a finite real number"
    CROSSING = "changes sign"  # next to the witness
    JUMP = "jumps from one sign to the other"  # at a kink, where it is a set
    PART = "vanishes with a factor, or is not finite there"


@dataclass(frozen=True)
class Sign:
    """Whether an expression has one sign on a box.

    PROVED: `sign` is 1 or -1 and 0 < `margin` <= |value| there, finite. REFUTED: `witness` is a point where it is zero
    or undefined, next to a zero between two points of opposite sign, or at a kink where it jumps between them, as
    `cause` says. UNKNOWN: `reason` says how many boxes were tried. `never`: proved to be 0 nowhere on the box, although
    it may come as close to 0 as you like where the box is unbounded, or be undefined. `exact`: the rational ends that
    prove it without bisection.
    """

    verdict: Verdict
    sign: int
    margin: End
    witness: Mapping[sp.Symbol, Fraction] = field(hash=False)
    reason: Reason
    range: Range
    cause: Cause | None = None
    never: bool = False
    exact: Interval | None = field(default=None, hash=False)

    def __str__(self) -> str:
        if self.verdict is Verdict.PROVED:
            margin = f"at least {down(self.margin, 9)}" if self.sign > 0 else f"at most -{down(self.margin, 9)}"
            return f"{self.verdict}: {margin}, by {self.reason}"
        return f"{self.verdict}: {self.reason}{place(self.witness)}"


def nonzero(expression: sp.Expr, box: Box, *, boxes: int = LIMIT, refute: bool = True) -> Sign:
    """Whether the expression is finite and has one sign on the whole box; without `refute`, which may take long, proved
    or unknown.

    Raises: `EmptyBox`; `NoTape` for a function without a rule.
    """
    return _nonzero(expression, tuple(box.items()), boxes, refute)


@lru_cache(maxsize=512)  # several forms, and several hypotheses of one, ask for the sign of the same gain
def _nonzero(
    expression: sp.Expr, ends: tuple[tuple[sp.Symbol, tuple[End, End]], ...], boxes: int, refute: bool
) -> Sign:
    problem = problem_of(expression, dict(ends))
    if problem is None:
        return Sign(Verdict.REFUTED, 0, 0.0, {}, NOWHERE.note, NOWHERE, Cause.UNDEFINED)
    never, cover = False, None
    for limit in dict.fromkeys((min(boxes, _GLANCE), boxes)):
        outcome = problem.search(one_sign, limit, cover)
        cover = outcome.cover
        if outcome.defined and (outcome.low > 0 or outcome.high < 0):
            return _proved(problem, outcome)
        refuted = _refutation(problem, outcome, limit) if refute else None
        if refuted:
            cause, reason, witness = refuted
            return Sign(Verdict.REFUTED, 0, 0.0, witness, reason, range_of(problem, outcome, 0.0), cause)
        if limit <= _GLANCE and not outcome.inner.least < 0 < outcome.inner.most:
            never, low, high = _by_algebra(problem.expression, problem.sides.box)
            if outcome.defined and (low > 0 or high < 0):
                return _enclosed(problem, outcome, low, high)
        if outcome.boxes + 2 <= limit:  # more boxes would change nothing
            break
    undecided = "{boxes} does not decide it" if outcome.boxes == 1 else "{boxes} do not decide it"
    reason = because(undecided, boxes=counted(outcome.boxes))
    if end := beyond(problem.expression, problem.sides):
        pattern = "{why}; the ranges end on {point} of the table {table}, whose slope beyond is taken there: move one"
        reason = because(pattern, why=reason, point=float(end[0]), table=end[1])
    return Sign(Verdict.UNKNOWN, 0, 0.0, {}, reason, range_of(problem, outcome, 0.0), never=never)


def _proved(problem: Problem, outcome: Outcome) -> Sign:
    sign, margin = (1, outcome.low) if outcome.low > 0 else (-1, -outcome.high)
    reason, extent = counted(outcome.boxes), range_of(problem, outcome, 0.0)
    return Sign(Verdict.PROVED, sign, margin, {}, reason, extent, never=True)


def _enclosed(problem: Problem, outcome: Outcome, low: End, high: End) -> Sign:
    """The proof of one sign by the exact range on the box as a whole."""
    outer = replace(range_of(problem, outcome, 0.0), low=number(low)[0], high=number(high)[1], tree="leaf")
    sign, reason = 1 if low > 0 else -1, because("exact algebra and rational ends")
    return Sign(Verdict.PROVED, sign, max(low, -high), {}, reason, outer, never=True, exact=(low, high))


def _by_algebra(expression: sp.Expr, box: Box) -> tuple[bool, End, End]:
    """Whether an expression is 0 nowhere on the box where it is defined, by its factors; and its range, whose ends are
    rational."""
    low, high = rational(expression, box)
    factored = factors(expression)
    if factored is None or (low > 0 or high < 0):
        return low > 0 or high < 0, low, high
    never, product = _product(factored, expression, box)
    return never, max(low, product[0]), min(high, product[1])


def _product(factored: Factors, expression: sp.Expr, box: Box) -> tuple[bool, Interval]:
    """Whether no factor is 0, and the product of the factors' ranges; a factor that is proved to have one sign by
    bisection has the range of that proof."""
    never, total = True, rational(factored.number, {})
    for one in factored.factors:
        low, high = rational(one.base, box)
        known = one.definite or low > 0 or high < 0
        again = len(factored.factors) == 1 and one.exponent == 1 and one.base.count_ops() >= expression.count_ops()
        other = not again and one.base not in (expression, -expression)  # no more than another way to write it
        if low <= 0 <= high and one.base.free_symbols and other:
            sign = nonzero(one.base, box, boxes=_GLANCE, refute=False)
            known = known or sign.never
            if sign.verdict is Verdict.PROVED:
                seen = sign.exact or fractions((sign.range.low, sign.range.high))
                low, high = max(low, seen[0]), min(high, seen[1])
        never = never and (known or one.exponent < 0)
        total = multiplied(total, raised((low, high), one.exponent))
    return never, total


def _refutation(problem: Problem, outcome: Outcome, boxes: int) -> tuple[Cause, Reason, Point] | None:
    """The cause why an expression has not one sign, the same in words, and a point; None where none is known."""
    extremes = [
        problem.sides.point(at.tolist()) for at in (outcome.inner.at_least, outcome.inner.at_most) if at is not None
    ]
    special = special_point(problem.expression, problem.program, problem.sides, hints=extremes)
    if special:
        what, point = special
        cause = Cause.ZERO if what == "= 0" else Cause.UNDEFINED
        return cause, because(cause.value), point
    crossed = _crossed(problem, outcome, boxes)
    if crossed:
        sides = jump(problem.expression, {s: sp.Rational(value) for s, value in crossed.items()})
        if sides is None:
            return Cause.CROSSING, because(Cause.CROSSING.value), crossed
        jumps = because("jumps from {one} to {other}, not of one sign", one=sides[0], other=sides[1])
        return Cause.JUMP, jumps, crossed
    for part, pattern in _parts(problem.expression):
        inner = nonzero(part, problem.sides.box, boxes=boxes)
        if inner.verdict is Verdict.REFUTED and inner.cause is not Cause.JUMP:
            rest = {s: Fraction(_any(ends)) for s, ends in problem.sides.box.items()}
            return Cause.PART, because(pattern, part=part), rest | dict(inner.witness)
    return None


def _crossed(problem: Problem, outcome: Outcome, boxes: int) -> Point | None:
    """The zero between two values of opposite sign of a continuous expression."""
    least, most = (
        attained(problem, outcome.inner.least, outcome.inner.at_least),
        attained(problem, outcome.inner.most, outcome.inner.at_most),
    )
    if least is None or most is None or not least.value < 0 < most.value:
        return None
    if not outcome.continuous:
        a, b = least.point, most.point
        between = {s: (min(a[s], b[s]), max(a[s], b[s])) for s in problem.sides.symbols}
        part = problem_of(problem.expression, between)
        if part is None or not part.search(regular, boxes).continuous:
            return None
    return crossing(problem.expression, problem.program, problem.sides, dict(least.point), dict(most.point))


def _parts(expression: sp.Expr) -> Iterator[tuple[sp.Expr, str]]:
    """Factors, at whose zeros the expression is zero or undefined, and what it divides by, each with the pattern of a
    reason."""
    powers = [] if expression.has(sp.Piecewise) else sorted(expression.atoms(sp.Pow), key=str)
    for node in powers:  # a Piecewise may not take the branch that is not finite
        if node.exp.is_Rational and node.exp < 0 and node.base != expression and not node.base.is_number:
            yield node.base, "is not finite: it divides by {part}, which vanishes"
    for factor in _irreducible(expression):
        if factor != expression and factor.free_symbols and not factor.is_Symbol:
            yield factor, "vanishes with its factor {part}, or is not finite there"


def _irreducible(expression: sp.Expr) -> list[sp.Expr]:
    """Its factors, as far as they are known: by exact algebra alone where SymPy would factor a high power of exp."""
    if any(steep(e) for e in expression.atoms(sp.exp)):
        product = factors(expression)
        return [one.base for one in product.factors if one.exponent > 0 and not one.definite] if product else []
    try:
        return [factor for factor, _ in sp.factor_list(sp.together(expression))[1]]
    except (sp.PolynomialError, NotImplementedError):
        return []


def _any(ends: tuple[End, End]) -> End:
    low, high = ends
    return low if abs(low) != math.inf else high if abs(high) != math.inf else Fraction(0)
