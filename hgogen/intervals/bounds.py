"""The range of an expression on a closed box, rigorous.

What is proved comes from outward-rounded intervals and bisection (`intervals.search`), what is refuted from a point;
limits count boxes. Numbers are exact: a float is its shortest decimal.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from typing import Annotated, Any

import sympy as sp

from hgogen.algebra.interpolation import Stepped
from hgogen.algebra.points import STRANGE, exact, largest_exponent, put
from hgogen.algebra.tape import Tape, tape
from hgogen.intervals.bisection import Cover, Tree
from hgogen.intervals.box import Box, End, Sides, box, sides
from hgogen.intervals.digits import down, up
from hgogen.intervals.glance import taken
from hgogen.intervals.outward import Array
from hgogen.intervals.search import Goal, Inner, Known, Outcome, search, tight
from hgogen.intervals.slope import lipschitz_bound
from hgogen.intervals.zeros import special_point
from hgogen.sentence import NONE, Encoded, Reason, because, equations

# --- forms of one expression


_LARGE = 400  # operations beyond which rewriting would cost more than bisection
_REWRITTEN = 12  # exponents beyond which it would grow out of hand


def steep(e: sp.exp) -> bool:
    """Whether SymPy would take it as a high power: exp(-8750/T) as exp(1/T)^-8750."""
    return any(abs(int(term.as_coeff_Mul(rational=True)[0].p)) > _REWRITTEN for term in sp.Add.make_args(e.args[0]))


def variants(expression: sp.Expr) -> tuple[sp.Expr, ...]:
    """The expression as it is, then its factors and its Horner forms where it is rational in its symbols.

    They come from exact algebra over the rationals: each is equal to the first where the first is defined, and may have
    lost a removable pole.
    """
    symbols = sorted(expression.free_symbols, key=str)
    if not symbols or expression.count_ops() > _LARGE or largest_exponent(expression) > _REWRITTEN:
        return (expression,)
    if expression.has(sp.Piecewise, sp.floor, sp.ceiling):
        return (expression,)
    forms = [expression]
    try:
        stands = {e: sp.Dummy() for e in sorted(expression.atoms(sp.exp), key=str) if steep(e)}
        forms.append(sp.factor(expression.xreplace(stands)).xreplace({d: e for e, d in stands.items()}))
        if expression.is_polynomial(*symbols):
            whole = sp.expand(expression)
            forms += [whole, *(sp.horner(whole, wrt=wrt) for wrt in (symbols, symbols[::-1]))]
    except (sp.PolynomialError, NotImplementedError):
        pass
    return tuple(dict.fromkeys(form for form in forms if not form.has(*STRANGE)))


# --- proofs


_SLACK = Fraction(1, 2**40)  # of the size, so that another arithmetic, or other roundings of a cut, reach the bounds


@dataclass(frozen=True)
class Proof:
    """A fact on a closed box, on which the `expressions` are defined.

    Of a range: low <= value <= high, of the one expression; of a slope: the spectral norm of the expressions' Jacobian
    in the states is at most `high`, and `low` is None. Both are exact; `variables`, `tree`: the bisection, ("split",
    index, left, right) and "leaf", sides cut in the middle.
    """

    expressions: tuple[sp.Expr, ...]
    low: Fraction | None
    high: Fraction | None
    variables: tuple[sp.Symbol, ...]
    tree: Any = field(hash=False, repr=False)


def ends(low: Fraction | float, high: Fraction | float) -> tuple[Fraction | None, Fraction | None]:
    """Bounds a little outside of these. Each keeps its sign, if it has one, and is None where it is infinite."""
    return _moved(low, -1), _moved(high, 1)


def _moved(value: Fraction | float, way: int) -> Fraction | None:
    if abs(value) == float("inf"):
        return None
    return Fraction(value) + way * abs(Fraction(value)) * _SLACK


# --- ranges


__all__ = ["LIMIT", "Attained", "Box", "End", "Range", "bound", "box", "lipschitz_bound"]

LIMIT = 20_000
_FIRST = 500  # boxes before a pole is looked for


@dataclass(frozen=True)
class Attained:
    """A point of the box and a bound of the value there: at most `value` for the least, at least for the most."""

    value: float
    point: Mapping[sp.Symbol, Fraction] = field(hash=False)


@dataclass(frozen=True)
class Range(Encoded):
    """The range of an expression on a box.

    low <= value <= high wherever it and its parts are finite and real; -inf and inf where nothing is proved. `least`,
    `most`: points where a value as small, as large is attained. `variables`: what the tree's indices count; `tree`: the
    bisection, ("split", index, left, right) and "leaf", sides cut as `floats.middle` says.
    """

    json_keys = ("low", "high", "defined", "boxes", "note")

    low: Annotated[float, "lower bound; null where there is none"]
    high: Annotated[float, "upper bound; null where there is none"]
    defined: Annotated[bool, "whether it is proved finite and real on the whole closed box"]
    least: Attained | None
    most: Attained | None
    boxes: Annotated[int, "number of boxes that were tried"]
    note: Annotated[Reason, "why the range is not tighter, or empty"]
    variables: tuple[sp.Symbol, ...]
    tree: Tree = field(repr=False)

    @property
    def finite(self) -> bool:
        """Whether both ends are finite."""
        return math.isfinite(self.low) and math.isfinite(self.high)

    def __str__(self) -> str:
        parts = [f"from {down(self.low, 9)} to {up(self.high, 9)}, by {counted(self.boxes)}"]
        ends = (("least", "at most", up, self.least), ("most", "at least", down, self.most))
        parts += [
            f"the {end} is {side} {rounded(one.value, 9)}{place(one.point)}"
            for end, side, rounded, one in ends
            if one is not None
        ]
        return "; ".join([*parts, *map(str, filter(None, [self.note]))])


def bound(expression: sp.Expr, box: Box, *, boxes: int = LIMIT, relative: float = 0.02) -> Range:
    """The range of the expression on the box, rounded outward; it is wider than the true one by at most `relative` of
    its width, or `note` says why not.

    Raises: `EmptyBox`; `NoTape` for a function without a rule.
    """
    return _bound(sp.sympify(expression), tuple((x, tuple(ends)) for x, ends in box.items()), boxes, relative)


@lru_cache(maxsize=512)  # an observer and its hypotheses ask for the same ranges, as of the a_i
def _bound(expression: sp.Expr, ends: tuple[Any, ...], boxes: int, relative: float) -> Range:
    problem = problem_of(expression, dict(ends))
    if problem is None:
        return NOWHERE
    first = min(boxes, _FIRST)
    outcome = problem.search(tight(relative), first)
    if outcome.finished:
        return range_of(problem, outcome, relative)
    if not outcome.defined:
        special = special_point(problem.expression, problem.program, problem.sides, ("undefined",))
        if special:  # more boxes would not help
            note = because("it is not a finite real number at {point}", point=equations(special[1]))
            return replace(range_of(problem, outcome, relative), note=note)
    if first < boxes:
        outcome = problem.search(tight(relative), boxes, outcome.cover)
    return range_of(problem, outcome, relative)


NOWHERE = Range(-math.inf, math.inf, False, None, None, 0, because("it is not a finite real number"), (), "leaf")


@dataclass(frozen=True)
class Problem:
    """An expression with exact numbers, its points put in, and its forms as a tape."""

    expression: sp.Expr
    sides: Sides
    program: Tape

    def search(self, goal: Goal, boxes: int, begun: Cover[Known, Inner] | None = None) -> Outcome:
        """The outcome of a bisection of its box for a goal, or of one that was begun for it."""
        return search(self.program, self.sides.outer, self.sides.inner, goal, boxes, begun)


def problem_of(expression: sp.Expr, box: Box) -> Problem | None:
    """The problem of an expression on a box; None where the expression is nowhere a finite real number."""
    fixed, around = sides(exact(sp.sympify(expression)), box)
    if fixed.has(*STRANGE):
        return None
    fixed = taken(fixed, around)
    return Problem(fixed, around, tape(variants(fixed), around.symbols))


def range_of(problem: Problem, outcome: Outcome, relative: float) -> Range:
    """The outcome of a search as a range; `relative`: how tight the search was asked to be."""
    return Range(
        low=outcome.low,
        high=outcome.high,
        defined=outcome.defined,
        least=attained(problem, outcome.inner.least, outcome.inner.at_least),
        most=attained(problem, outcome.inner.most, outcome.inner.at_most),
        boxes=outcome.boxes,
        note=_note(outcome, relative),
        variables=problem.sides.symbols,
        tree=outcome.tree,
    )


def attained(problem: Problem, value: float, at: Array | None) -> Attained | None:
    """A bound of the value at a point that a search looked at; None without one, or where a table's derivative jumps
    there: what lies on its other side need not be of the box."""
    if not problem.sides.symbols and math.isfinite(value):
        return Attained(value, {})
    if at is None:
        return None
    point = problem.sides.point(at.tolist())
    if problem.expression.has(Stepped):
        there = put(problem.expression, {s: sp.Rational(x) for s, x in point.items()})
        if there is None or there.has(Stepped):
            return None
    return Attained(value, point)


def _note(outcome: Outcome, relative: float) -> Reason:
    boxes = counted(outcome.boxes)
    if not outcome.defined:
        return because("it was not shown to be finite and real everywhere, with {boxes}", boxes=boxes)
    if outcome.finished:
        return NONE
    far = "it is not within {relative:.0%} of values that are attained, with {boxes}"
    return because(far, relative=relative, boxes=boxes)


def counted(count: int) -> Reason:
    """A number of boxes, in words."""
    return because("{count} box" if count == 1 else "{count} boxes", count=count)


def place(point: Mapping[sp.Symbol, Fraction]) -> str:
    """The place as the end of a sentence, in few digits."""
    return ", at " + ", ".join(f"{s} = {float(value):g}" for s, value in point.items()) if point else ""
