"""Points of a box where an expression vanishes or is not a finite real number, shown exactly.

Candidates are corners, middles, small rationals, the rational roots of polynomials; enclosures sort out those that may
be zeros, exact arithmetic decides.
"""

import math
from collections.abc import Iterable, Iterator
from fractions import Fraction
from itertools import islice, product

import numpy as np
import sympy as sp

from hgogen.algebra.kinks import jump
from hgogen.algebra.points import STEEP, kind, largest_exponent, put
from hgogen.algebra.tape import Tape
from hgogen.intervals.box import End, Point, Sides
from hgogen.intervals.enclosure import enclose
from hgogen.intervals.outward import Array, Pair, number

_CANDIDATES, _EXACT = 800, 16  # points looked at by enclosures, by exact arithmetic
_DENOMINATORS = 12
_STEPS = 1100  # of a bisection: from the largest float down to the smallest


def special_point(
    expression: sp.Expr,
    program: Tape,
    sides: Sides,
    kinds: tuple[str, ...] = ("= 0", "undefined"),
    hints: Iterable[Point] = (),
) -> tuple[str, Point] | None:
    """("= 0" or "undefined", the point) for the first candidate that is one of the kinds; points of few digits next to
    the `hints` are candidates, too."""
    if largest_exponent(expression) > STEEP:
        return None
    candidates = [*_simple(hints, sides), *islice(_candidates(expression, sides), _CANDIDATES)]
    if not candidates:
        return None
    low, high = _around(candidates, sides)
    first = enclose(program, low, high)[0]
    doubtful = ~first.defined
    if "= 0" in kinds:
        doubtful = doubtful | ((first.value[0] <= 0) & (first.value[1] >= 0))
    for index in np.nonzero(doubtful)[0][:_EXACT]:
        point = candidates[int(index)]
        what = kind(expression, _rational(point))
        if what in kinds:
            return what, point
    return None


def crossing(expression: sp.Expr, program: Tape, sides: Sides, below: Point, above: Point) -> Point:
    """A zero, a kink at which the sign jumps, or a point next to one, on the line from a point where the expression is
    negative to one where it is positive; the expression is continuous there."""
    for _ in range(_STEPS):
        centre = {s: Fraction(number((below[s] + above[s]) / 2)[0]) for s in sides.symbols}
        if centre in (below, above) or not sides.contains(centre):
            break
        value = enclose(program, *_around([centre], sides))[0].value
        if value[0][0] > 0:
            above = centre
        elif value[1][0] < 0:
            below = centre
        else:
            break
    if largest_exponent(expression) > STEEP:
        return below
    simplest = {s: ((below[s] + above[s]) / 2).limit_denominator(10_000) for s in below}
    for point in (simplest, centre):
        if sides.contains(point) and (
            kind(expression, _rational(point)) == "= 0" or jump(expression, _rational(point)) is not None
        ):
            return point
    return below


def _simple(hints: Iterable[Point], sides: Sides) -> Iterator[Point]:
    for point in hints:
        for largest in (1, 2, 6, 12, 100, 1000):
            simple = {s: value.limit_denominator(largest) for s, value in point.items()}
            if sides.contains(simple):
                yield simple


def _rational(point: Point) -> dict[sp.Symbol, sp.Rational]:
    return {s: sp.Rational(value) for s, value in point.items()}


def _around(points: list[Point], sides: Sides) -> Pair:
    """Floats around exact points, m x k each."""
    ends = [[number(point[s]) for point in points] for s in sides.symbols]
    table: Array = np.array(ends, dtype=float).reshape(len(sides.symbols), len(points), 2)
    return table[:, :, 0], table[:, :, 1]


def _candidates(expression: sp.Expr, sides: Sides) -> Iterator[Point]:
    values = [_values(ends) for ends in sides.ends]
    if len(values) == 1:
        yield from _points(sides, [[*_roots(expression, sides), *values[0], *_fractions(sides.ends[0])]])
        return
    few = values if len(values) < 5 else [side[:3] for side in values]
    yield from _solved(expression, sides, values)
    yield from _points(sides, few)


def _points(sides: Sides, values: list[list[Fraction]]) -> Iterator[Point]:
    for coordinates in product(*values):
        yield dict(zip(sides.symbols, coordinates, strict=True))


def _values(ends: tuple[End, End]) -> list[Fraction]:
    """Ends, zero, middle and ones, of a side."""
    low, high = ends
    finite = [Fraction(end) for end in ends if abs(end) != math.inf]
    middle = sum(finite, Fraction(0)) / 2 if len(finite) == 2 else Fraction(0)
    wanted = (*finite, Fraction(0), middle, Fraction(1), Fraction(-1))
    return list(dict.fromkeys(value for value in wanted if low <= value <= high)) or [Fraction(1)]


def _fractions(ends: tuple[End, End]) -> Iterator[Fraction]:
    """Small fractions of a side."""
    low, high = (max(-20, min(20, end)) for end in ends)
    for q in range(1, _DENOMINATORS + 1):
        for p in range(math.ceil(low * q), math.floor(high * q) + 1):
            if ends[0] <= Fraction(p, q) <= ends[1]:
                yield Fraction(p, q)


def _roots(expression: sp.Expr, sides: Sides) -> Iterable[Fraction]:
    """The rational roots of a polynomial in one symbol."""
    (symbol,), ((low, high),) = sides.symbols, sides.ends
    if not expression.is_polynomial(symbol):
        return []
    try:
        roots = sp.Poly(expression, symbol).ground_roots()
    except sp.PolynomialError:
        return []
    exact = sorted(Fraction(root) for root in roots if root.is_Rational)  # x - pi has the root pi
    return [root for root in exact if low <= root <= high]


def _solved(expression: sp.Expr, sides: Sides, values: list[list[Fraction]]) -> Iterator[Point]:
    """Zeros of an expression that is linear in a symbol, the others at simple values."""
    for k, symbol in enumerate(sides.symbols):
        slope = expression.diff(symbol)
        if slope == 0 or slope.has(symbol):
            continue
        rest = put(expression, {symbol: sp.S.Zero})
        if rest is None:
            continue
        others = [side if i != k else [Fraction(0)] for i, side in enumerate(values)]
        for point in islice(_points(sides, others), 8):
            at = _rational(point)
            steep, start = put(slope, at), put(rest, at)
            if not (steep and start is not None and steep.is_Rational and start.is_Rational):
                continue
            root = -start / steep
            solution = point | {symbol: Fraction(root)}
            if sides.contains(solution):
                yield solution
