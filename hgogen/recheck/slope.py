"""Bounds of a Jacobian's spectral norm on a box, verified again, and that an expression is smooth there.

A Jacobian on a box is enclosed entry by entry, by forward derivatives in mpmath's intervals; where that is too weak, by
the mean value form of each entry, with second derivatives.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from itertools import chain, combinations
from operator import mul
from typing import Any

from .arithmetic import Dual, Undefined, dual, evaluate, jacobian, total
from .box import Box, End, NotShown, Slopes, Try, centre_of, covered, face_on, moving, points, sides, unbounded
from .context import Context, cut, narrowed
from .interval import Interval, intersection, intervals, point
from .matrix import Matrix
from .tables import is_table, jumps, table_of
from .text import KINKS, Expression

_duals = dual(intervals)
Rows = tuple[Expression, ...]
Side = tuple[End, End]
Norm = Callable[[list[list[Interval]], Fraction], bool]  # whether a matrix, however it lies in intervals, is within


def regular(expressions: Sequence[Expression], names: Sequence[str]) -> Callable[[Box], Try]:
    """The statement that expressions and their derivatives in `names` are finite."""

    def attempt(box: Box) -> Try:
        try:
            there = sides(box)
            slopes = jacobian(expressions, there, names, intervals)
            values = (evaluate(row, there, intervals) for row in expressions)
            return Try(all(x.finite for x in (*values, *chain(*slopes))))
        except Undefined:
            return Try(False)

    return attempt


def at_kinks(slope: Expression, row: Expression, context: Context) -> Expression:
    """The slope of a row, its `sign` read as the slope of |e|, which at e = 0 is a set and not 0.

    A sign that the row itself has stays: x sign(u) has the slope sign(u), which is 0 at u = 0, at an edge too."""
    jumps = [context.value(replace(row, result=args[0])) for op, args, _ in row.instructions if op == "sign"]

    def stays(place: int) -> bool:
        argument = context.value(replace(slope, result=place))
        return any(context.algebra.is_zero(argument - jump) for jump in jumps)

    steps = (
        step._replace(op="side") if step.op == "sign" and not stays(step.args[0]) else step
        for step in slope.instructions
    )
    return replace(slope, instructions=tuple(steps))


def differentiable(texts: Iterable[Expression], at: Mapping[str, Fraction]) -> None:
    """Shows that no modulus, sign, minimum or maximum has its kink at a point, where the formula of a slope would say
    nothing. Raises: `NotShown`."""
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
                raise NotShown(f"{cut(text.text)} may have no slope at its witness")


def continuous(texts: Iterable[Expression], names: Iterable[str], box: Box) -> None:
    """Shows that no table's derivative in a text jumps along the names within a box. A slope does not see a jump where
    the certificate's bisection is cut, on whose leaves it is that from within. Raises: `NotShown`."""
    along, ranges = frozenset(names), sides(box)
    for text in texts:
        moves: list[bool] = []
        for op, args, value in text.instructions:
            moves.append(value in along if op == "symbol" else any(moves[arg] for arg in args))
            if not (moves[-1] and jumps(op)):
                continue
            table, order = table_of(op)
            place = [evaluate(replace(text, result=arg), ranges, intervals).exactly for arg in args]
            orders = tuple(m + moves[arg] for m, arg in zip(order, args, strict=True))
            if table.range(orders, place) is None:
                raise NotShown(f"{cut(text.text)} is not shown to be continuous")


def steep(
    rows: Sequence[Expression],
    names: Sequence[str],
    bound: Fraction,
    scale: Sequence[Expression] = (),
    norm: Norm | None = None,
) -> Callable[[Box], Try]:
    """The statement |J| <= bound in a norm, by default the spectral one, J the Jacobian of `rows` in `names`; of
    S J S^-1 for a diagonal S = `scale`."""
    within = norm or spectral

    def entries(box: Box) -> list[list[Interval]]:
        return _scaled(rows, names, box, scale)

    def varying(box: Box) -> list[list[Dual]]:
        return _second(rows, names, box, scale)

    return by_mean_value(entries, varying, lambda J: within(J, bound))


def by_mean_value(
    entries: Callable[[Box], list[list[Interval]]],
    varying: Callable[[Box], list[list[Dual]]],
    shown: Callable[[list[list[Interval]]], bool],
) -> Callable[[Box], Try]:
    """The statement that a matrix is such: by its entries, or by the mean value form of each, from its slopes."""

    def attempt(box: Box) -> Try:
        try:
            J = entries(box)
            if shown(J):
                return Try(True)
            centre, dJ = centre_of(box), varying(box)
            middle, away = entries(centre), ways(centre, box)
        except Undefined:
            return Try(False)
        refined = [
            [intersection(x, mean_value(at, dx.slopes, away)) for x, at, dx in zip(*three, strict=True)]
            for three in zip(J, middle, dJ, strict=True)
        ]
        return Try(shown(refined), weights([*chain(*dJ)]))

    return attempt


def no_steeper(
    rows: Sequence[Expression], names: Sequence[str], most: Matrix, sizes: Sequence[Fraction], box: Box
) -> int:
    """That no slope of the rows in a name whose size is not 0 is steeper than `most`; with how many boxes. Raises:
    `NotShown`."""
    wanted = [j for j, size in enumerate(sizes) if size]
    ends = {(i, j): (-bounds[j], bounds[j]) for i, bounds in enumerate(most) for j in wanted}
    where = narrowed(box, {name for row in rows for name in row.names})
    continuous(rows, [names[j] for j in wanted], where)
    return covered(where, ".", in_ranges(rows, names, ends))


def in_ranges(
    rows: Sequence[Expression],
    names: Sequence[str],
    ends: Mapping[tuple[int, int], tuple[End, End]],
    scale: Sequence[Expression] = (),
) -> Callable[[Box], Try]:
    """The statement that these entries of S J S^-1 are in their ranges."""

    def values(box: Box) -> list[Interval]:
        J = _scaled(rows, names, box, scale)
        return [J[i][j] for i, j in ends]

    def varying(box: Box) -> list[Dual]:
        J = _second(rows, names, box, scale)
        return [J[i][j] for i, j in ends]

    return on_faces([*ends.values()], values, varying)


def on_faces(
    ends: Sequence[Side], values: Callable[[Box], list[Interval]], varying: Callable[[Box], list[Dual]]
) -> Callable[[Box], Try]:
    """The statement that values are in ranges on a box: by themselves, or on the face towards which one is monotone, by
    its value at the centre and its slopes or by itself. A side that may jump has any slope in what moves it, so that it
    is the same at the centre, or on the face, wherever that shows anything."""

    def beyond(x: Interval, k: int) -> list[int]:
        low, high = ends[k]
        return [way for way, meets in ((1, x.at_least(low)), (-1, x.at_most(high))) if not meets]

    def shown(face: Box, k: int, way: int, slopes: Slopes) -> bool:
        centre = centre_of(face)
        if way not in beyond(mean_value(values(centre)[k], slopes, ways(centre, face)), k):
            return True
        return way not in beyond(values(face)[k], k)

    def attempt(box: Box) -> Try:
        try:
            fails = [(k, way) for k, x in enumerate(values(box)) for way in beyond(x, k)]
            slopes = [x.slopes for x in varying(box)] if fails else []
            for k, way in fails:
                face = face_on(box, slopes[k], way)
                if not shown(face, k, way, slopes[k]):
                    return Try(False, slopes[k], face)
        except Undefined:
            return Try(False)
        return Try(True)

    return attempt


def _scaled(
    rows: Sequence[Expression], names: Sequence[str], box: Box, scale: Sequence[Expression]
) -> list[list[Interval]]:
    """S J S^-1 on a box; J where there is no scale."""
    return _similar(tuple(rows), tuple(names), tuple(box.items()), tuple(scale), False)


def _second(
    rows: Sequence[Expression], names: Sequence[str], box: Box, scale: Sequence[Expression]
) -> list[list[Dual]]:
    """S J S^-1 with the slopes of its entries in all of the box's names, by their places. Raises: `Undefined`."""
    if unbounded(box):
        raise Undefined("an unbounded side")
    return _similar(tuple(rows), tuple(names), tuple(box.items()), tuple(scale), True)


@lru_cache(maxsize=1 << 10)  # of each entry of a Jacobian, and of its norm, something is shown of the same boxes
def _similar(
    rows: Rows, names: tuple[str, ...], ends: tuple[tuple[str, Side], ...], scale: Rows, varying: bool
) -> list[list[Any]]:
    """S J S^-1, whose diagonal is that of J, which S would make wider."""
    box, arithmetic = dict(ends), _duals if varying else intervals
    values: Mapping[str, Any] = moving(box) if varying else sides(box)
    J, S = jacobian(rows, values, names, arithmetic), [evaluate(factor, values, arithmetic) for factor in scale]
    return [[x if i == j else S[i] * x / S[j] for j, x in enumerate(row)] for i, row in enumerate(J)] if S else J


def ways(centre: Box, box: Box) -> Slopes:
    """From the centre to all of the box, by the places of names."""
    return {k: side - point(Fraction(centre[name][0])) for k, (name, side) in enumerate(sides(box).items())}


def mean_value(centre: Interval, slopes: Slopes, away: Slopes) -> Interval:
    """The value at a centre and slopes from it, `away` the ways from there."""
    for k, slope in slopes.items():
        centre = centre + slope * away[k]
    return centre


def weights(entries: Sequence[Dual]) -> Slopes:
    """The sum of the sizes of the entries' slopes in each name."""
    variation: dict[int, Interval] = {}
    for entry in entries:
        for k, slope in entry.slopes.items():
            size = intervals.function("Abs", (slope,))
            variation[k] = variation[k] + size if k in variation else size
    return variation


def frobenius(J: list[list[Interval]], bound: Fraction) -> bool:
    """The sum of squares is at most bound^2."""
    return _sum(map(_squared, zip(*J, strict=True))).at_most(bound**2)


def spectral(J: list[list[Interval]], bound: Fraction) -> bool:
    """|J| <= bound by Frobenius' norm, or bound^2 I - J'J > 0 by the pivots of its LDL' in intervals."""
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
    """Whether every symmetric matrix within M is positive definite."""
    return definite(M) > 0


def definite(M: list[list[Interval]]) -> int:
    """1 where every symmetric matrix within M is positive definite, -1 where none is, else 0: by signs of pivots."""
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
