"""Bounds on a box: each leaf of the certificate's bisection is verified by mpmath's intervals.

A leaf is verified by the natural interval extension, on the faces towards which the expression is monotone, or by the
mean value form f(x) in f(c) + sum_i [df/dx_i] (x_i - c_i). If that is too weak the leaf is bisected further, up to a
limit of boxes. The pieces of a bisection cover their box by construction.

Bounds of a Jacobian's spectral norm on a box, and a check that an expression is smooth there, work likewise. A Jacobian
is enclosed entry by entry, by forward derivatives in mpmath's intervals; if that is too weak, by the mean value form of
each entry, with second derivatives.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from itertools import chain, combinations
from operator import mul
from typing import Any

from mpmath import libmp

from .arithmetic import Dual, NotExact, Undefined, Unproved, dual, evaluate, fractions, jacobian, seeded, total
from .interval import Interval, between, intersection, intervals, point
from .matrix import Matrix
from .tables import is_table, jumps, table_of
from .text import KINKS, Expression

MORE = 2000  # boxes beyond the certificate's own leaves

End = Fraction | float
Box = Mapping[str, tuple[End, End]]
Slopes = Mapping[int, Interval]

_duals = dual(intervals)


@dataclass(frozen=True)
class Attempt:
    """The result of an attempt to prove a statement on one box: whether it `holds`; the `slopes` of its expression by
    index of a name, if known, by which the side to cut is chosen; and the `face` of the box on which it fails if it
    fails anywhere."""

    holds: bool
    slopes: Slopes | None = None
    face: Box | None = None


def leaves(tree: str, box: Box) -> list[Box]:
    """Return the boxes into which a bisection `tree` divides a box. The tree is a text in prefix order: a name cuts
    that side in its middle, a dot is a leaf. Raises: `Unproved` for a text that is no bisection of this box."""
    boxes: list[Box] = []
    pending = [box]
    for token in tree.split():
        if not pending:
            raise Unproved("its bisection goes on after its last leaf")
        here = pending.pop()
        if token == ".":
            boxes.append(here)
        elif token in here and here[token][0] < here[token][1]:
            pending += reversed(halves(here, token))
        else:
            raise Unproved(f"its bisection cuts {token!r}, which is no side of the box")
    if pending:
        raise Unproved("its bisection leaves a gap")
    return boxes


def halves(box: Box, name: str) -> tuple[Box, Box]:
    """Return the two halves of a box along the side `name`: cut in the middle, an unbounded side at 0 or, where 0 is
    outside, at twice its end plus 1, away from 0."""
    low, high = box[name]
    cut = _middle(low, high)
    return {**box, name: (low, cut)}, {**box, name: (cut, high)}


def _middle(low: End, high: End) -> Fraction:
    if high == math.inf:
        return Fraction(0) if low < 0 else 2 * Fraction(low) + 1
    if low == -math.inf:
        return Fraction(0) if high > 0 else 2 * Fraction(high) - 1
    return (Fraction(low) + Fraction(high)) / 2


def covered(box: Box, tree: str, attempt: Callable[[Box], Attempt], more: int = MORE) -> int:
    """Return the number of boxes with which a statement is proved on the whole box: `attempt` tries to prove it on each
    leaf of the bisection `tree`, and where it fails on halves, at most `more` in all. Raises: `Unproved` with a box on
    which it is not proved."""
    pending = leaves(tree, box)
    limit = len(pending) + more
    tried = 0
    while pending:
        here = pending.pop()
        tried += 1
        answer = attempt(here)
        if answer.holds:
            continue
        middle = centre_of(answer.face or here)
        if not attempt(middle).holds:  # no bisection would help
            raise Unproved(f"it does not hold at {_text(middle)}")
        name = _widest(here, box, answer.slopes)
        if name is None or tried >= limit:
            raise Unproved(f"it does not follow on {_text(here)} ({tried} boxes)")
        pending += halves(here, name)
    return tried


def centre_of(box: Box) -> Box:
    """Return the centre of a box, as a box whose sides are points."""
    return {name: (low, low) if low == high else (_middle(low, high),) * 2 for name, (low, high) in box.items()}


def _widest(here: Box, whole: Box, slopes: Slopes | None) -> str | None:
    sizes = {}
    for index, (name, (low, high)) in enumerate(here.items()):
        if low == high:
            continue
        first, last = whole[name]
        width = _width(low, high)
        share = width / _width(first, last) if math.isfinite(_width(first, last)) else width
        steep = max(abs(_float(end)) for end in slopes[index].ends) if slopes and index in slopes else 0.0
        size = steep * width if slopes else share
        sizes[name] = size + 1e-6 * share if math.isfinite(size) else share
    return max(sizes, key=lambda name: sizes[name]) if sizes else None


def _width(low: End, high: End) -> float:
    try:
        return float(high - low)
    except OverflowError:
        return math.inf


def _float(end: object) -> float:
    try:
        return float(libmp.to_float(end))
    except OverflowError:
        return math.inf


def _text(box: Box) -> str:
    named = (
        f"{name} = {_printed_end(low)}" if low == high else f"{name} in [{_printed_end(low)}, {_printed_end(high)}]"
        for name, (low, high) in box.items()
    )
    return ", ".join(named) or "its only point"


def _printed_end(end: End) -> str:
    try:
        return f"{float(end):.6g}"
    except OverflowError:
        return "beyond 1e308"


# --- one expression


def narrowed(box: Box, names: Iterable[str]) -> Box:
    """Return the box of these names only, in alphabetical order."""
    return {name: box[name] for name in sorted(names)}


def shortened(text: str) -> str:
    """Return a text cut to 60 characters, for a sentence."""
    return text if len(text) <= 60 else f"{text[:57]}..."


def sides(box: Box) -> dict[str, Interval]:
    """Return the sides of a box as intervals, by name."""
    return {name: between(low, high) for name, (low, high) in box.items()}


def points(at: Mapping[str, Fraction]) -> dict[str, Interval]:
    """Return numbers by name as intervals."""
    return {name: point(value) for name, value in at.items()}


def ranged(expression: Expression, low: End, high: End) -> Callable[[Box], Attempt]:
    """Return a function that attempts to prove low <= expression <= high on a box; a bound may be infinite."""

    def attempt(box: Box) -> Attempt:
        try:
            natural = evaluate(expression, sides(box), intervals)
        except Undefined:
            return Attempt(False)
        fails = [(end, sign) for end, sign in ((low, 1), (high, -1)) if not _meets(natural, end, sign)]
        if not fails or unbounded(box):
            return Attempt(not fails)
        try:
            slopes = dict(evaluate(expression, seeded_sides(box), _duals).slopes)
        except Undefined:
            return Attempt(False)
        for end, sign in fails:
            face = face_on(box, slopes, sign)
            if not _bounded(expression, face, slopes, end, sign):
                return Attempt(False, slopes, face)
        return Attempt(True, slopes)

    return attempt


def _meets(value: Interval, limit: End, sign: int) -> bool:
    return value.at_least(limit) if sign > 0 else value.at_most(limit)


def seeded_sides(box: Box) -> dict[str, Dual]:
    """Return the sides of a box as dual numbers by name, with the slope 1 at their own index; a side that is a point
    has no slope."""
    return seeded(sides(box), (name if low < high else "" for name, (low, high) in box.items()), intervals)


def unbounded(box: Box) -> bool:
    """Return whether a side of the box has an infinite end."""
    return any(math.inf in (abs(low), abs(high)) for low, high in box.values())


def _bounded(expression: Expression, face: Box, slopes: Slopes, limit: End, sign: int) -> bool:
    """Return whether the expression is proved >= limit (sign 1) or <= limit (sign -1) on a face of the box, by interval
    arithmetic or by the mean value form with the partial derivatives `slopes`."""
    if all(low == high for low, high in face.values()):
        value = _value_at(expression, {name: Fraction(low) for name, (low, _) in face.items()})
        if value is None or isinstance(value, Interval):
            return value is not None and _meets(value, limit, sign)
        return value >= limit if sign > 0 else value <= limit
    try:
        if _meets(evaluate(expression, sides(face), intervals), limit, sign):
            return True
        centre = {name: _centre(face[name], slopes.get(k), sign) for k, name in enumerate(face)}
        total = evaluate(expression, points(centre), intervals)
    except Undefined:
        return False
    for k, name in enumerate(face):
        if k in slopes:
            total = total + slopes[k] * (between(*face[name]) - point(centre[name]))
    return _meets(total, limit, sign)


def face_on(box: Box, slopes: Slopes, sign: int) -> dict[str, tuple[End, End]]:
    """Return the face of a box on which an expression with these partial derivatives is smallest (sign 1) or largest
    (sign -1); sides along which it is not monotone stay whole."""
    face = dict(box)
    for k, (name, (low, high)) in enumerate(box.items()):
        slope = slopes.get(k, point(Fraction(0)))
        rising, falling = slope.at_least(Fraction(0)), slope.at_most(Fraction(0))
        if rising or falling:
            end = low if rising == (sign > 0) or (rising and falling) else high
            face[name] = (end, end)
    return face


def _centre(side: tuple[End, End], slope: Interval | None, sign: int) -> Fraction:
    """Return the centre on a side with which the mean value form gives the best lower bound (sign 1) or upper bound
    (sign -1) (Baumann 1988); the bound is valid for any point of the side."""
    low, high = Fraction(side[0]), Fraction(side[1])
    if low == high or slope is None:
        return low
    least, most = (_float(end) for end in slope.ends)
    share = most / (most - least) if math.isfinite(most - least) and most > least else 0.5
    share = share if sign > 0 else 1 - share
    if not 0 <= share <= 1:
        share = 0.5
    return low + (high - low) * Fraction(1 - share)


def _value_at(expression: Expression, at: Mapping[str, Fraction]) -> Fraction | Interval | None:
    value: Fraction | Interval
    try:
        try:
            value = evaluate(expression, at, fractions)
        except NotExact:
            value = evaluate(expression, points(at), intervals)
    except (Undefined, ZeroDivisionError):
        return None
    return value


def witnessed(expression: Expression, at: Mapping[str, Fraction]) -> str:
    """Return the sign of an expression at a point: "zero", "negative", "positive", or "" if undecided."""
    value = _value_at(expression, at)
    if isinstance(value, Fraction):
        return "zero" if not value else "positive" if value > 0 else "negative"
    return {1: "positive", -1: "negative"}.get(value.sign if value else 0, "")


Rows = tuple[Expression, ...]
Side = tuple[End, End]
Norm = Callable[[list[list[Interval]], Fraction], bool]  # whether a matrix, however it lies in intervals, is within


def regular(expressions: Sequence[Expression], names: Sequence[str]) -> Callable[[Box], Attempt]:
    """Return a function that attempts to prove on a box that the expressions and their partial derivatives in `names`
    are finite."""

    def values(box: Box) -> Iterable[Interval]:
        there = sides(box)
        slopes = jacobian(expressions, there, names, intervals)
        return *(evaluate(row, there, intervals) for row in expressions), *chain(*slopes)

    return all_finite(values)


def all_finite(values: Callable[[Box], Iterable[Interval]]) -> Callable[[Box], Attempt]:
    """Return a function that attempts to prove on a box that all `values`, functions of the box, are finite."""

    def attempt(box: Box) -> Attempt:
        try:
            return Attempt(all(x.finite for x in values(box)))
        except Undefined:
            return Attempt(False)

    return attempt


def demand_differentiable(texts: Iterable[Expression], at: Mapping[str, Fraction]) -> None:
    """Demand that the expressions have no kink at a point: there no modulus, sign, minimum, maximum or table switches,
    so that the formulas of the slopes are valid. Raises: `Unproved`."""
    values = points(at)
    for text in texts:
        for op, args, _ in text.instructions:
            if op not in KINKS and not is_table(op):
                continue
            operands = [evaluate(replace(text, result=arg), values, intervals) for arg in args]
            differences = [x - y for x, y in combinations(operands, 2)] if len(operands) > 1 else operands
            if is_table(op):  # whose argument may be one of its points
                each = zip(operands, table_of(op)[0].axes, strict=True)
                differences = [x - point(place) for x, places in each for place in places]
            if any(x.sign == 0 for x in differences):
                raise Unproved(f"{shortened(text.text)} may have no slope at its witness")


def demand_continuous(texts: Iterable[Expression], names: Iterable[str], box: Box) -> None:
    """Demand that no table, or derivative of a table, in the expressions jumps within the box along the `names`. Slopes
    on the leaves of a bisection are one-sided at the cuts and do not detect a jump there. Raises: `Unproved`."""
    along, ranges = frozenset(names), sides(box)
    for text in texts:
        varies: list[bool] = []
        for op, args, value in text.instructions:
            varies.append(value in along if op == "symbol" else any(varies[arg] for arg in args))
            if not (varies[-1] and jumps(op)):
                continue
            table, order = table_of(op)
            place = [evaluate(replace(text, result=arg), ranges, intervals).exactly for arg in args]
            orders = tuple(m + varies[arg] for m, arg in zip(order, args, strict=True))
            if table.range(orders, place) is None:
                raise Unproved(f"{shortened(text.text)} is not shown to be continuous")


def norm_at_most(
    rows: Sequence[Expression],
    names: Sequence[str],
    bound: Fraction,
    scale: Sequence[Expression] = (),
    norm: Norm | None = None,
) -> Callable[[Box], Attempt]:
    """Return a function that attempts to prove |S J S^-1| <= bound on a box, J the Jacobian of `rows` in `names`, S =
    diag(`scale`), by default 1; `norm`: the test of the bound, by default in the spectral norm."""
    within = norm or spectral

    def entries(box: Box) -> list[list[Interval]]:
        return _scaled(rows, names, box, scale)

    def varying(box: Box) -> list[list[Dual]]:
        return _second(rows, names, box, scale)

    return by_mean_value(entries, varying, lambda J: within(J, bound))


def by_mean_value(
    entries: Callable[[Box], list[list[Interval]]],
    varying: Callable[[Box], list[list[Dual]]],
    holds: Callable[[list[list[Interval]]], bool],
) -> Callable[[Box], Attempt]:
    """Return a function that attempts to prove on a box that a matrix has a property, tested by `holds` on matrices of
    intervals: on its `entries`, then on their mean value forms. `varying`: the entries as dual numbers."""

    def attempt(box: Box) -> Attempt:
        try:
            J = entries(box)
            if holds(J):
                return Attempt(True)
            centre, dJ = centre_of(box), varying(box)
            middle, away = entries(centre), offsets(centre, box)
        except Undefined:
            return Attempt(False)
        refined = [
            [intersection(x, mean_value(at, dx.slopes, away)) for x, at, dx in zip(*three, strict=True)]
            for three in zip(J, middle, dJ, strict=True)
        ]
        return Attempt(holds(refined), weights([*chain(*dJ)]))

    return attempt


def demand_jacobian(
    rows: Sequence[Expression], names: Sequence[str], most: Matrix, sizes: Sequence[Fraction], box: Box
) -> int:
    """Demand |d rows_i/d names_j| <= `most`_ij on a box for every j with `sizes`_j other than 0; return the number of
    boxes. Raises: `Unproved`."""
    wanted = [j for j, size in enumerate(sizes) if size]
    ends = {(i, j): (-bounds[j], bounds[j]) for i, bounds in enumerate(most) for j in wanted}
    where = narrowed(box, {name for row in rows for name in row.names})
    demand_continuous(rows, [names[j] for j in wanted], where)
    return covered(where, ".", in_ranges(rows, names, ends))


def in_ranges(
    rows: Sequence[Expression],
    names: Sequence[str],
    ends: Mapping[tuple[int, int], tuple[End, End]],
    scale: Sequence[Expression] = (),
) -> Callable[[Box], Attempt]:
    """Return a function that attempts to prove on a box that entry (i, j) of S J S^-1 lies in `ends`[i, j], J the
    Jacobian of `rows` in `names`, S = diag(`scale`), by default 1."""

    def values(box: Box) -> list[Interval]:
        J = _scaled(rows, names, box, scale)
        return [J[i][j] for i, j in ends]

    def varying(box: Box) -> list[Dual]:
        J = _second(rows, names, box, scale)
        return [J[i][j] for i, j in ends]

    return on_faces([*ends.values()], values, varying)


def on_faces(
    ends: Sequence[Side], values: Callable[[Box], list[Interval]], varying: Callable[[Box], list[Dual]]
) -> Callable[[Box], Attempt]:
    """Return a function that attempts to prove on a box that values lie in the ranges `ends`: by the `values` as
    intervals, by their mean value forms, or by the values on the face towards which they are monotone. `varying`: the
    values as dual numbers.

    Where a derivative may jump in a variable, the slope in it is unbounded, and only the interval values prove
    something.
    """

    def beyond(x: Interval, k: int) -> list[int]:
        low, high = ends[k]
        return [way for way, meets in ((1, x.at_least(low)), (-1, x.at_most(high))) if not meets]

    def holds(face: Box, k: int, way: int, slopes: Slopes) -> bool:
        centre = centre_of(face)
        if way not in beyond(mean_value(values(centre)[k], slopes, offsets(centre, face)), k):
            return True
        return way not in beyond(values(face)[k], k)

    def attempt(box: Box) -> Attempt:
        try:
            fails = [(k, way) for k, x in enumerate(values(box)) for way in beyond(x, k)]
            slopes = [x.slopes for x in varying(box)] if fails else []
            for k, way in fails:
                face = face_on(box, slopes[k], way)
                if not holds(face, k, way, slopes[k]):
                    return Attempt(False, slopes[k], face)
        except Undefined:
            return Attempt(False)
        return Attempt(True)

    return attempt


def _scaled(
    rows: Sequence[Expression], names: Sequence[str], box: Box, scale: Sequence[Expression]
) -> list[list[Interval]]:
    """Return S J S^-1 as intervals on a box, J the Jacobian of `rows` in `names`, S = diag(`scale`), by default 1."""
    return _similar(tuple(rows), tuple(names), tuple(box.items()), tuple(scale), False)


def _second(
    rows: Sequence[Expression], names: Sequence[str], box: Box, scale: Sequence[Expression]
) -> list[list[Dual]]:
    """Return S J S^-1 as dual numbers on a box, J the Jacobian of `rows` in `names`, S = diag(`scale`): entries with
    their derivatives."""
    if unbounded(box):
        raise Undefined("an unbounded side")
    return _similar(tuple(rows), tuple(names), tuple(box.items()), tuple(scale), True)


@lru_cache(maxsize=1 << 10)  # statements on the entries of a Jacobian and on its norm share boxes
def _similar(
    rows: Rows, names: tuple[str, ...], ends: tuple[tuple[str, Side], ...], scale: Rows, varying: bool
) -> list[list[Any]]:
    """Return S J S^-1, J the Jacobian of `rows` in `names`, S = diag(`scale`), as intervals, or as dual numbers if
    `varying`. The diagonal is that of J, which a multiplication by S_i/S_i in intervals would widen."""
    box, arithmetic = dict(ends), _duals if varying else intervals
    values: Mapping[str, Any] = seeded_sides(box) if varying else sides(box)
    J, S = jacobian(rows, values, names, arithmetic), [evaluate(factor, values, arithmetic) for factor in scale]
    return [[x if i == j else S[i] * x / S[j] for j, x in enumerate(row)] for i, row in enumerate(J)] if S else J


def offsets(centre: Box, box: Box) -> Slopes:
    """Return the intervals x_k - c_k of a box with the centre c, by the index k of a name."""
    return {k: side - point(Fraction(centre[name][0])) for k, (name, side) in enumerate(sides(box).items())}


def mean_value(centre: Interval, slopes: Slopes, away: Slopes) -> Interval:
    """Return the mean value form f(c) + sum_k slopes_k away_k; `centre`: f(c), `away`: the intervals x_k - c_k."""
    for k, slope in slopes.items():
        centre = centre + slope * away[k]
    return centre


def weights(entries: Sequence[Dual]) -> Slopes:
    """Return the sum over all entries of |partial derivative in x_k|, by the index k of a name."""
    variation: dict[int, Interval] = {}
    for entry in entries:
        for k, slope in entry.slopes.items():
            size = intervals.function("Abs", (slope,))
            variation[k] = variation[k] + size if k in variation else size
    return variation


def frobenius(J: list[list[Interval]], bound: Fraction) -> bool:
    """Return whether the Frobenius norm of every matrix within the intervals J is at most the bound."""
    return _sum(map(_squared, zip(*J, strict=True))).at_most(bound**2)


def spectral(J: list[list[Interval]], bound: Fraction) -> bool:
    """Return whether the spectral norm of every matrix within the intervals J is proved to be at most the bound, by the
    Frobenius norm or by the pivots of bound^2 I - J'J in intervals."""
    columns = list(zip(*J, strict=True))
    squares = [_squared(column) for column in columns]
    if _sum(squares).at_most(bound**2):
        return True
    n, most = len(columns), point(bound**2)
    M = [[most - square] * n for square in squares]
    for i, j in combinations(range(n), 2):
        M[i][j] = M[j][i] = -total(map(mul, columns[i], columns[j]))
    return positive(M)


def _squared(column: Iterable[Interval]) -> Interval:
    return _sum(intervals.power(x, 2) for x in column)


def _sum(terms: Iterable[Interval]) -> Interval:
    return total((point(Fraction(0)), *terms))


def positive(M: list[list[Interval]]) -> bool:
    """Return whether every symmetric matrix within the intervals M is proved positive definite."""
    return definite(M) > 0


def definite(M: list[list[Interval]]) -> int:
    """Return 1 if every symmetric matrix within the intervals M is proved positive definite, -1 if none is, 0 if
    undecided, by the signs of the pivots."""
    M = [list(row) for row in M]
    n = len(M)
    for k in range(n):
        if M[k][k].sign <= 0:
            return M[k][k].sign
        for i in range(k + 1, n):
            factor = M[k][i] / M[k][k]
            for j in range(i, n):
                M[i][j] = M[i][j] - factor * M[k][j]
    return 1
