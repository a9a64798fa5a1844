"""Bounds on a box, verified again: a walk over the certificate's bisection, each leaf by mpmath's intervals.

A leaf is shown by the natural interval extension, on the faces towards which the expression is monotone, or by the
mean value form f(x) in f(c) + sum_i [df/dx_i] (x_i - c_i). Where that is too weak the leaf is bisected further, up to a
limit of boxes. The pieces of a bisection cover their box by construction.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction

from mpmath import libmp

from .arithmetic import Dual, NotExact, Undefined, dual, evaluate, fractions, seeded
from .interval import Interval, between, intervals, point
from .text import Expression

MORE = 2000  # boxes beyond the certificate's own leaves

End = Fraction | float
Box = Mapping[str, tuple[End, End]]
Slopes = Mapping[int, Interval]

_duals = dual(intervals)


class NotShown(Exception):
    """A statement that the arithmetic does not confirm; the text says which and where."""


@dataclass(frozen=True)
class Try:
    """What one box says: shown or not, the slopes by which to choose where to cut, if there are any, and the face on
    which it fails if anywhere."""

    shown: bool
    slopes: Slopes | None = None
    face: Box | None = None


def leaves(tree: str, box: Box) -> list[Box]:
    """The boxes at the leaves of a bisection, written in prefix order: a name cuts its side, a dot is a leaf. Raises:
    `NotShown` for a text that is no bisection of this box."""
    boxes: list[Box] = []
    left = [box]
    for token in tree.split():
        if not left:
            raise NotShown("its bisection goes on after its last leaf")
        here = left.pop()
        if token == ".":
            boxes.append(here)
        elif token in here and here[token][0] < here[token][1]:
            left += reversed(halves(here, token))
        else:
            raise NotShown(f"its bisection cuts {token!r}, which is no side of the box")
    if left:
        raise NotShown("its bisection leaves a gap")
    return boxes


def halves(box: Box, name: str) -> tuple[Box, Box]:
    """The box cut in two: a side at its midpoint, an unbounded one at 0, or beyond 0 at twice its end and one."""
    low, high = box[name]
    cut = _middle(low, high)
    return {**box, name: (low, cut)}, {**box, name: (cut, high)}


def _middle(low: End, high: End) -> Fraction:
    if high == math.inf:
        return Fraction(0) if low < 0 else 2 * Fraction(low) + 1
    if low == -math.inf:
        return Fraction(0) if high > 0 else 2 * Fraction(high) - 1
    return (Fraction(low) + Fraction(high)) / 2


def covered(box: Box, tree: str, attempt: Callable[[Box], Try], more: int = MORE) -> int:
    """How many boxes it took to show a statement on the whole box, at most `more` beyond the leaves of the bisection.
    Raises: `NotShown` with the box that was not shown."""
    left = leaves(tree, box)
    limit = len(left) + more
    tried = 0
    while left:
        here = left.pop()
        tried += 1
        answer = attempt(here)
        if answer.shown:
            continue
        middle = centre_of(answer.face or here)
        if not attempt(middle).shown:  # no bisection would help
            raise NotShown(f"it does not hold at {_text(middle)}")
        name = _widest(here, box, answer.slopes)
        if name is None or tried >= limit:
            raise NotShown(f"it does not follow on {_text(here)} ({tried} boxes)")
        left += halves(here, name)
    return tried


def centre_of(box: Box) -> Box:
    """The box's middle, as a box."""
    return {name: (low, low) if low == high else (_middle(low, high),) * 2 for name, (low, high) in box.items()}


def _widest(here: Box, whole: Box, slopes: Slopes | None) -> str | None:
    """The side to cut: where the expression varies most, else the widest for its range."""
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
        f"{name} = {_short(low)}" if low == high else f"{name} in [{_short(low)}, {_short(high)}]"
        for name, (low, high) in box.items()
    )
    return ", ".join(named) or "its only point"


def _short(end: End) -> str:
    try:
        return f"{float(end):.6g}"
    except OverflowError:
        return "beyond 1e308"


# --- one expression


def sides(box: Box) -> dict[str, Interval]:
    """The box as intervals."""
    return {name: between(low, high) for name, (low, high) in box.items()}


def points(at: Mapping[str, Fraction]) -> dict[str, Interval]:
    """Numbers as intervals."""
    return {name: point(value) for name, value in at.items()}


def ranged(expression: Expression, low: End, high: End) -> Callable[[Box], Try]:
    """The statement that the expression is real and low <= value <= high; an infinite bound says nothing."""

    def attempt(box: Box) -> Try:
        try:
            natural = evaluate(expression, sides(box), intervals)
        except Undefined:
            return Try(False)
        fails = [(end, sign) for end, sign in ((low, 1), (high, -1)) if not _meets(natural, end, sign)]
        if not fails or unbounded(box):
            return Try(not fails)
        try:
            slopes = dict(evaluate(expression, moving(box), _duals).slopes)
        except Undefined:
            return Try(False)
        for end, sign in fails:
            face = face_on(box, slopes, sign)
            if not _bounded(expression, face, slopes, end, sign):
                return Try(False, slopes, face)
        return Try(True, slopes)

    return attempt


def _meets(value: Interval, limit: End, sign: int) -> bool:
    """Whether value >= limit, for sign 1, or value <= limit, for -1."""
    return value.at_least(limit) if sign > 0 else value.at_most(limit)


def moving(box: Box) -> dict[str, Dual]:
    """The box as intervals with slopes in those of its names that are no points, by their places."""
    return seeded(sides(box), (name if low < high else "" for name, (low, high) in box.items()), intervals)


def unbounded(box: Box) -> bool:
    """Whether a side of it has no end."""
    return any(math.inf in (abs(low), abs(high)) for low, high in box.values())


def _bounded(expression: Expression, face: Box, slopes: Slopes, limit: End, sign: int) -> bool:
    """Whether value >= limit on the face where it is least (sign 1), or value <= limit where it is greatest (-1)."""
    if all(low == high for low, high in face.values()):
        return _at(expression, {name: Fraction(low) for name, (low, _) in face.items()}, limit, sign)
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
    """The face where a monotone expression is least (sign 1) or greatest (sign -1)."""
    face = dict(box)
    for k, (name, (low, high)) in enumerate(box.items()):
        slope = slopes.get(k, point(Fraction(0)))
        rising, falling = slope.at_least(Fraction(0)), slope.at_most(Fraction(0))
        if rising or falling:
            end = low if rising == (sign > 0) or (rising and falling) else high
            face[name] = (end, end)
    return face


def _centre(side: tuple[End, End], slope: Interval | None, sign: int) -> Fraction:
    """Where the mean value form is best for this bound (Baumann 1988); any point of the side is right."""
    low, high = Fraction(side[0]), Fraction(side[1])
    if low == high or slope is None:
        return low
    least, most = (_float(end) for end in slope.ends)
    share = most / (most - least) if math.isfinite(most - least) and most > least else 0.5
    share = share if sign > 0 else 1 - share
    if not 0 <= share <= 1:
        share = 0.5
    return low + (high - low) * Fraction(1 - share)


def _at(expression: Expression, at: Mapping[str, Fraction], limit: End, sign: int) -> bool:
    """The bound at one point, in exact fractions where the value is one."""
    value = _value_at(expression, at)
    if value is None or isinstance(value, Interval):
        return value is not None and _meets(value, limit, sign)
    return value >= limit if sign > 0 else value <= limit


def _value_at(expression: Expression, at: Mapping[str, Fraction]) -> Fraction | Interval | None:
    """The value at a point, exact where it is a fraction; None where there is none."""
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
    """What the expression is at a point: "zero", "negative", "positive", or "" where it is not decided."""
    value = _value_at(expression, at)
    if isinstance(value, Fraction):
        return "zero" if not value else "positive" if value > 0 else "negative"
    return {1: "positive", -1: "negative"}.get(value.sign if value else 0, "")
