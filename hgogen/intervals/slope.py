"""How steep a vector field is on a box: L_b = sup |db/dx| of the spectral norm, or why there is none.

A box is convex, so a continuous b whose Jacobian is bounded is Lipschitz (mean value theorem); kinks (Abs, Min, Max)
do no harm, jumps in the state do. Not Lipschitz is shown by a point of the box towards which an entry of the Jacobian
tends to infinity.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache
from itertools import islice

import sympy as sp

from hgogen.algebra.interpolation import Kinked, Stepped, Table
from hgogen.algebra.kinks import Norm, bent
from hgogen.algebra.points import STRANGE, exact, kind, put
from hgogen.algebra.tape import tape
from hgogen.check import Verdict
from hgogen.intervals.bisection import Tree
from hgogen.intervals.bounds import special_point
from hgogen.intervals.box import Box, End, Point, Sides, sides
from hgogen.intervals.glance import taken
from hgogen.intervals.search import everywhere, search
from hgogen.intervals.spectral import Field, Steep, steepest
from hgogen.sentence import NONE, Reason, because, equations

# What jumps hides from the symbolic derivative, and what bends is better read by slopes.
JUMPS = (sp.Piecewise, sp.sign, sp.floor, sp.ceiling, sp.frac, sp.Mod, sp.Heaviside, sp.atan2, Stepped)
KINKS = (sp.Abs, sp.Min, sp.Max, Norm, Kinked)
_TURNING = (sp.Heaviside, sp.Abs, sp.Min, sp.Max, Norm)

Ends = tuple[tuple[sp.Symbol, tuple[End, End]], ...]

LIMIT = 4000
_FIRST = 500  # boxes before a singular point is looked for
_WORK = 400_000  # boxes times rows times symbols squared, so that large systems take seconds, too
_RELATIVE = 0.02
_OPERATIONS = 150  # of a slope whose limit is asked for
_DISTANCES = (10, 30, 60)  # binary digits of the distances at which the growth is seen


@dataclass(frozen=True)
class Lipschitz:
    """Whether b is Lipschitz in some symbols on a box.

    PROVED: |db/dx| <= `high` on the box, and >= `low` at a point of it, at a table's breakpoint as programs take it.
    REFUTED: `witness` is a point towards which `slope`, an entry of the Jacobian, tends to infinity. UNKNOWN: `reason`
    says how many boxes were tried. `variables`, `tree`: the bisection, as in `bounds.Range`.
    """

    verdict: Verdict
    low: float
    high: float
    reason: Reason
    boxes: int
    variables: tuple[sp.Symbol, ...]
    witness: Mapping[sp.Symbol, Fraction] = field(default_factory=dict, hash=False)
    tree: Tree = field(default="leaf", repr=False)


def lipschitz_bound(
    b: Iterable[sp.Expr], states: Sequence[sp.Symbol], box: Box, *, boxes: int = LIMIT, relative: float = _RELATIVE
) -> Lipschitz:
    """The supremum over the box of the spectral norm of db/dx, rounded outward; it is at most `relative` too large, or
    `reason` says why not.

    Raises: `EmptyBox`; `NoTape` for a function without a rule.
    """
    return _lipschitz_bound(tuple(map(sp.sympify, b)), tuple(states), tuple(box.items()), boxes, relative)


@lru_cache(maxsize=256)  # several forms, and their observers, ask for the slopes of the same rows
def _lipschitz_bound(
    b: tuple[sp.Expr, ...], states: tuple[sp.Symbol, ...], ends: Ends, boxes: int, relative: float
) -> Lipschitz:
    whole, around = sides(sp.Tuple(*map(exact, b)), dict(ends))
    rows = [taken(row, around) for row in whole if not (row.is_number and row.is_real)]
    read = [x for x in states if x in around.symbols]
    if not rows:
        return Lipschitz(Verdict.PROVED, 0.0, 0.0, because("it is constant"), 0, around.symbols)
    if any(row.has(*STRANGE) for row in rows):
        reason = because("it is not a finite real number")
        return Lipschitz(Verdict.UNKNOWN, 0.0, math.inf, reason, 0, around.symbols)
    if not read:
        return _constant(rows, around, boxes)
    vector = _field([bent(row) for row in rows], read, around)
    boxes = min(boxes, _WORK // (len(rows) * len(around.symbols) ** 2) + 1)
    first = min(boxes, _FIRST)
    outcome = steepest(vector, around.outer, relative, first)
    steep = None if outcome.bounded else _endless(rows, read, around)
    if not (outcome.finished or steep) and first < boxes:
        outcome = steepest(vector, around.outer, relative, boxes, outcome.cover)
    if outcome.bounded:
        loose = because("{boxes} boxes bring it no closer to the slopes that are attained", boxes=outcome.boxes)
        return _answer(Verdict.PROVED, outcome, NONE if outcome.finished else loose, around)
    if steep:
        slope, point = steep
        reason = because("the slope {slope} has no bound towards {point}", slope=slope, point=equations(point))
        return Lipschitz(Verdict.REFUTED, outcome.low, math.inf, reason, outcome.boxes, around.symbols, point)
    return _answer(Verdict.UNKNOWN, outcome, because("{boxes} boxes give no bound", boxes=outcome.boxes), around)


def _answer(verdict: Verdict, outcome: Steep, reason: Reason, around: Sides) -> Lipschitz:
    return Lipschitz(verdict, outcome.low, outcome.high, reason, outcome.boxes, around.symbols, tree=outcome.tree)


def _constant(rows: list[sp.Expr], around: Sides, boxes: int) -> Lipschitz:
    """The answer for rows that do not depend on the state, which are Lipschitz where they are defined."""
    outcomes = [search(tape([row], around.symbols), around.outer, around.inner, everywhere, boxes) for row in rows]
    tried = sum(one.boxes for one in outcomes)
    if all(one.defined for one in outcomes):
        reason = because("it does not depend on the state")
        return Lipschitz(Verdict.PROVED, 0.0, 0.0, reason, tried, around.symbols)
    reason = because("{boxes} boxes do not show that it is defined", boxes=tried)
    return Lipschitz(Verdict.UNKNOWN, 0.0, math.inf, reason, tried, around.symbols)


def _field(rows: list[sp.Expr], states: list[sp.Symbol], around: Sides) -> Field:
    """With the entries of the Jacobian that vary, where the rows are smooth; constant ones the rows' tape gives as
    well."""
    smooth = not any(row.has(*JUMPS, *KINKS) for row in rows)
    places = [(i, j) for i, row in enumerate(rows) for j, x in enumerate(states) if smooth and x in row.free_symbols]
    slopes = {(i, j): rows[i].diff(states[j]) for i, j in places}
    entries = {place: slope for place, slope in slopes.items() if slope.free_symbols}
    at = tuple(around.symbols.index(x) for x in states)
    return Field(tape(rows, around.symbols), at, tape(entries.values(), around.symbols), tuple(entries))


# --- not Lipschitz


def _endless(rows: list[sp.Expr], states: list[sp.Symbol], around: Sides) -> tuple[sp.Expr, Point] | None:
    """A slope, and a point towards which it tends to infinity along a line in the box."""
    real = {s: sp.Dummy(s.name, real=True) for s in around.symbols}
    plain = {dummy: s for s, dummy in real.items()}
    around = Sides(tuple(real.values()), around.ends)
    states = [real[x] for x in states]
    for row in (row.xreplace(real) for row in rows):
        if row.has(*JUMPS, Table):
            continue
        for point in _suspects(row, around):
            for x in states:
                slope = row.diff(x)
                if slope == 0 or slope.has(sp.re, sp.im) or slope.count_ops() >= _OPERATIONS:
                    continue  # re and im stand in the slope of |e| where e is not real everywhere: limits cost much
                if _grows(slope, point, around):
                    return slope.xreplace(plain), {plain[s]: value for s, value in point.items()}
    return None


def _suspects(row: sp.Expr, around: Sides) -> Iterator[Point]:
    """Points where a root, a power, a logarithm or an inverse function of the row is singular."""
    for argument in dict.fromkeys(_singular_arguments(row)):
        symbols = [s for s in around.symbols if s in argument.free_symbols]
        own = around.only(symbols)
        if not symbols:
            continue
        special = special_point(argument, tape([argument], own.symbols), own, ("= 0",))
        if special:
            yield around.centre() | special[1]


def _singular_arguments(row: sp.Expr) -> Iterator[sp.Expr]:
    for node in sorted(row.atoms(sp.Pow, sp.log, sp.asin, sp.acos, sp.atanh, sp.acosh), key=str):
        if isinstance(node, sp.Pow):
            if not (node.exp.is_Integer and node.exp > 0):
                yield node.base
        elif isinstance(node, sp.log):
            yield node.args[0]
        else:
            yield node.args[0] - 1
            yield node.args[0] + 1
    for node in sorted(row.atoms(sp.tan), key=str):
        yield sp.cos(node.args[0])


def _grows(slope: sp.Expr, point: Point, around: Sides) -> bool:
    """Whether |slope| tends to infinity towards the point along a line in the box: by its limit, and as seen."""
    t = sp.Dummy("t", positive=True)
    exponents = {s for node in slope.atoms(sp.Pow) for s in node.exp.free_symbols}
    for target in islice(around.spread(), 6):  # exponents stay: a power to a fraction of many digits costs much
        moved = {s: Fraction(0) if s in exponents else target[s] - value for s, value in point.items()}
        along = put(slope, {s: sp.Rational(value) + t * sp.Rational(moved[s]) for s, value in point.items()})
        along = along and along.replace(lambda node: isinstance(node, _TURNING), lambda node: _branch(node, t))
        if not along or not along.has(t) or along.has(sp.Heaviside):
            continue
        sizes = [_size(along, {t: sp.Rational(1, 2**digits)}) for digits in _DISTANCES]
        if None in sizes or not sizes[0] < sizes[1] < sizes[2]:  # type: ignore[operator]
            continue
        try:
            limit = sp.limit(along, t, 0, "+")
        except (NotImplementedError, ValueError, TypeError, RecursionError, sp.PoleError):
            return False  # nor would other lines show it, and each try may cost much
        if limit in (sp.oo, -sp.oo):
            return True
    return False


def _branch(node: sp.Expr, t: sp.Symbol) -> sp.Expr:
    """Heaviside, |..|, Min or Max as what it is for small t > 0, where its arguments at 0 tell."""
    if isinstance(node, (sp.Min, sp.Max)):
        way = 1 if isinstance(node, sp.Max) else -1
        ahead = (a for a in node.args if all((way * (a - b)).subs(t, 0).is_positive for b in node.args if b != a))
        return next(ahead, node)
    (argument, *_) = node.args
    start = argument.subs(t, 0)
    above, below = (argument, -argument) if isinstance(node, sp.Abs) else (sp.S.One, sp.S.Zero)
    return above if start.is_positive else below if start.is_negative else node


def _size(expression: sp.Expr, at: Mapping[sp.Symbol, sp.Rational]) -> sp.Expr | None:
    if kind(expression, at) not in ("> 0", "< 0"):
        return None
    return abs(expression.xreplace(dict(at)).evalf(20))
