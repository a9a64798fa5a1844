"""Branch and bound on a tape: rigorous ranges on a box of floats, and how good they are.

On each box the range is what several enclosures have in common: the natural interval extension of every output of
the tape (forms of one expression: as written, factored, ..); the same on the faces towards which the expression is
monotone; and the mean value form

    f(x) in f(c) + sum_i [df/dx_i] (x_i - c_i),

with one centre c for the lower and one for the upper bound (E. Baumann, "Optimal centered forms", BIT 28, 1988).
What is still too wide is bisected, the worst first. Values at points of the box, enclosed too, bound the range from
inside.
The search counts boxes and draws nothing at random.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import sympy as sp

from hgogen.rigor import bisection
from hgogen.rigor.bisection import Columns, Cover, Indices, Leaves, Tree, corners, middle, placed, spread
from hgogen.rigor.box import Box, sides
from hgogen.rigor.enclosure import Enclosure, enclose
from hgogen.rigor.outward import Array, Flags, Pair, add, meet, negate, scale, where_known
from hgogen.rigor.points import STRANGE, exact
from hgogen.rigor.tape import NoTape, Tape, tape

_BATCH = 256  # boxes a round
_GLANCE = 60  # boxes to show that a part is defined
_FINE = 2.0**-44  # of the root's width: no box is cut further
_FAR = 2.0**40  # an unbounded box that begins beyond it is not cut
_ROUNDS, _AROUND = 8, 48  # of the search for good points
_SPREAD = 160  # first points


@dataclass(frozen=True)
class Known(Leaves):
    """What is known on boxes: bottom <= value <= top, where it is `defined`, and `continuous`."""

    bottom: Array
    top: Array
    defined: Flags
    continuous: Flags


@dataclass(frozen=True)
class Inner:
    """Points (m) where a value at most `least`, or at least `most`, is attained; inf and -inf before one is known."""

    least: float
    most: float
    at_least: Array | None
    at_most: Array | None


@dataclass(frozen=True)
class Outcome:
    """The result of a search: the leaves, the inner values, how many boxes were tried, the bisection tree, and the
    cover from which a search with more boxes goes on."""

    leaves: Known
    inner: Inner
    boxes: int
    finished: bool
    tree: Tree
    cover: Cover[Known, Inner]

    @property
    def low(self) -> float:
        """A lower bound on the whole box."""
        return float(self.leaves.bottom.min())

    @property
    def high(self) -> float:
        """An upper bound on the whole box."""
        return float(self.leaves.top.max())

    @property
    def defined(self) -> bool:
        """Whether it is proved finite and real everywhere."""
        return bool(self.leaves.defined.all())

    @property
    def continuous(self) -> bool:
        """Whether it is proved continuous."""
        return bool(self.leaves.continuous.all() and self.leaves.defined.all())


# What is still to be done on each leaf: > 0, more for worse; 0 for nothing.
Goal = Callable[[Known, Inner], Array]


def tight(relative: float) -> Goal:
    """The goal that low and high are within `relative` of the range's width of values that are attained."""

    def excess(leaves: Known, inner: Inner) -> Array:
        width = inner.most - inner.least if math.isfinite(inner.least) and math.isfinite(inner.most) else 0.0
        tolerance = relative / 2.0 * max(width, 0.0)
        tolerance = max(tolerance, 1e-13 * max(abs(v) for v in (inner.least, inner.most, 0.0) if math.isfinite(v)))
        over = np.maximum(inner.least - tolerance - leaves.bottom, leaves.top - tolerance - inner.most)
        over = np.where(leaves.defined, np.maximum(over, 0.0), np.inf)
        return np.where(np.isnan(over), np.inf, over)

    return excess


def one_sign(leaves: Known, inner: Inner) -> Array:
    """The goal that the expression is defined and has one sign; the search ends once both signs are attained."""
    if inner.least <= 0.0 <= inner.most:
        return np.zeros(leaves.bottom.shape)
    doubt = (leaves.bottom <= 0.0) & (leaves.top >= 0.0)
    worst = np.minimum(np.abs(leaves.bottom), np.abs(leaves.top))
    return np.where(~leaves.defined, np.inf, np.where(doubt, np.where(worst > 0, worst, 5e-324), 0.0))


def everywhere(leaves: Known, inner: Inner) -> Array:
    """The goal that the expression is defined."""
    return np.where(leaves.defined, 0.0, np.inf)


def is_defined(e: sp.Expr, box: Box) -> bool:
    """Whether it is proved that e is a finite real number on the whole box."""
    fixed, around = sides(exact(e), box)
    if fixed.has(*STRANGE):
        return False
    try:
        program = tape([fixed], around.symbols)
    except NoTape:
        return False
    return search(program, around.outer, around.inner, everywhere, _GLANCE).defined


def regular(leaves: Known, inner: Inner) -> Array:
    """The goal that the expression is defined and continuous."""
    return np.where(leaves.defined & leaves.continuous, 0.0, np.inf)


def search(
    program: Tape, root: Pair, inside: Pair, goal: Goal, limit: int, begun: Cover[Known, Inner] | None = None
) -> Outcome:
    """Bisect `root` (m ends each) until nothing is left to do for the goal, or `limit` boxes were tried; what was
    `begun` for the same goal with a lower limit goes on.

    `inside`: the largest box of floats in the true box, whose ends lie at most one float inside the root's.
    """
    problem = _Problem(program, root, inside)

    def doubtful(cover: Cover[Known, Inner]) -> Indices:
        todo = np.where(cover.leaves.cut < 0, 0.0, goal(cover.leaves, cover.inner))
        rows = np.nonzero(todo > 0.0)[0]
        return rows[np.argsort(-todo[rows], kind="stable")][:_BATCH]

    with np.errstate(all="ignore"):
        if begun is None:
            inner = Inner(math.inf, -math.inf, None, None)
            if goal not in (everywhere, regular):  # these ask for no values
                inner = _explore(problem, inner)
            first = _boxes(problem, root[0][:, None], root[1][:, None], np.zeros(1, dtype=np.int64), inner)
            begun = Cover(*first, [])
        last, cover = bisection.bisected(begun, doubtful, partial(_boxes, problem), limit)
        finished = not (goal(last.leaves, last.inner) > 0.0).any()
        return Outcome(last.leaves, last.inner, last.boxes, finished, last.tree, cover)


@dataclass(frozen=True)
class _Problem:
    program: Tape
    root: Pair
    inside: Pair

    def points(self, x: Array) -> Pair:
        """Enclosures of points (m x k): an end that is no float by its two neighbours."""
        low, high = x, x
        first, last = (end[:, None] for end in self.inside)
        bottom, top = (end[:, None] for end in self.root)
        low, high = np.where(x < first, bottom, low), np.where(x < first, first, high)
        return np.where(x > last, last, low), np.where(x > last, top, high)


# --- one batch of boxes


def _boxes(problem: _Problem, low: Array, high: Array, node: Indices, inner: Inner) -> tuple[Known, Inner]:
    """Ranges on boxes (m x k), and the inner values with their centres'."""
    k = low.shape[1]
    parts = enclose(problem.program, low, high, slopes=True)
    first = parts[0]
    value = _common(parts)
    sound = first.defined & first.continuous
    slope = _slopes(parts, sound)
    sound = sound & np.isfinite(slope[0]).all(axis=0) & np.isfinite(slope[1]).all(axis=0)
    centres, faces = _centres(low, high, slope, sound), _faces(low, high, slope, sound)
    points = np.concatenate(centres, axis=1)
    ends = zip(problem.points(points), *faces, strict=True)
    at = _values(problem.program, *(np.concatenate(end, axis=1) for end in ends))
    inner = _better(inner, points, at.only(slice(2 * k)))
    for side, centre in enumerate(centres):
        here = at.only(slice(side * k, (side + 1) * k))
        form = _mean_value((here.value[0], here.value[1]), (low, high), centre, slope)
        value = _meet(value, where_known(sound & here.defined, form))
    if faces:
        least, most = at.only(slice(2 * k, 3 * k)), at.only(slice(3 * k, None))
        bottom, top = np.where(least.defined, least.value[0], -np.inf), np.where(most.defined, most.value[1], np.inf)
        value = _meet(value, (bottom, top))
    cut = _cuts(problem, low, high, slope, sound)
    return Known(low, high, node, cut, *value, first.defined, first.continuous), inner


@dataclass(frozen=True)
class _Values(Columns):
    """What all forms say of the value on boxes (2 x k ends), and where it is defined."""

    value: Array
    defined: Flags


def _values(program: Tape, low: Array, high: Array) -> _Values:
    """The values of one walk of the tape, which costs little more for twice the boxes."""
    parts = enclose(program, low, high)
    return _Values(np.array(_common(parts)), parts[0].defined)


def _common(parts: list[Enclosure]) -> Pair:
    """What all forms say of the value; the first alone where they have nothing in common (no value there)."""
    value = parts[0].value
    for part in parts[1:]:
        value = _meet(value, part.value)
    return value


def _meet(a: Pair, b: Pair) -> Pair:
    low, high = meet(a, b)
    empty = ~(low <= high)
    return np.where(empty, a[0], low), np.where(empty, a[1], high)


def _slopes(parts: list[Enclosure], sound: Flags) -> Pair:
    low, high = (np.full_like(end, s) for end, s in zip(_slope(parts[0]), (-np.inf, np.inf), strict=True))
    for part in parts:
        one = _slope(part)
        known = sound & part.defined & part.continuous & ~np.isnan(one[0]) & ~np.isnan(one[1])
        low, high = _meet((low, high), where_known(known, one))
    return low, high


def _slope(part: Enclosure) -> Pair:
    assert part.slope is not None
    return part.slope


def _centres(low: Array, high: Array, slope: Pair, sound: Flags) -> Pair:
    """Baumann's centres, for the lower and the upper bound; the midpoint where no slope is known."""
    centre = middle(low, high)
    least, most = slope
    width = most - least
    share = np.where(width > 0, most / width, 0.5)
    down = share * low - (least / np.where(width > 0, width, 1.0)) * high
    up = (most / np.where(width > 0, width, 1.0)) * high - np.where(width > 0, least / width, 0.5) * low
    down = np.where(least >= 0, low, np.where(most <= 0, high, down))
    up = np.where(least >= 0, high, np.where(most <= 0, low, up))
    usable = sound & np.isfinite(down) & np.isfinite(up)
    down, up = np.where(usable, down, centre), np.where(usable, up, centre)
    return np.clip(down, low, high), np.clip(up, low, high)


def _mean_value(here: Pair, box: Pair, centre: Array, slope: Pair) -> Pair:
    away = add(box, negate((centre, centre)))
    terms = scale(slope, away)
    total = here
    for i in range(len(centre)):
        total = add(total, (terms[0][i], terms[1][i]))
    return total


def _faces(low: Array, high: Array, slope: Pair, sound: Flags) -> list[Pair]:
    """The faces where the expression is least, and those where it is most, of what is not monotone the boxes; nothing
    where none is, or where the faces are the centres."""
    rising = sound & (slope[0] >= 0)
    falling = sound & (slope[1] <= 0) & ~rising  # not both, of a slope that is 0: one face is as good as the other
    if len(low) == 1 or not (rising | falling).any():
        return []
    bottom = np.where(falling, high, low), np.where(rising, low, high)
    top = np.where(rising, high, low), np.where(falling, low, high)
    return [bottom, top]


def _cuts(problem: _Problem, low: Array, high: Array, slope: Pair, sound: Flags) -> Indices:
    """The variable to bisect in each box: that with the largest |slope| times width, or the relatively widest where no
    slope is known; -1 where no side can be cut."""
    m, k = low.shape
    if m == 0:
        return np.full(k, -1, dtype=np.int64)
    width = high - low
    whole = (problem.root[1] - problem.root[0])[:, None]
    share = np.where(np.isinf(whole), np.where(np.isinf(width), 1.0, width / (1.0 + width)), width / whole)
    size = np.maximum(np.abs(slope[0]), np.abs(slope[1])) * width
    score = np.where(sound & np.isfinite(size).all(axis=0), size + 1e-3 * size.max(axis=0) * share, share)
    centre = middle(low, high)
    within_reach = (np.minimum(np.abs(low), np.abs(high)) < _FAR) | (np.isinf(low) & np.isinf(high))
    possible = (centre > low) & (centre < high) & np.where(np.isinf(width), within_reach, share > _FINE)
    return bisection.best_cuts(score, possible)


# --- values that are attained


def _better(inner: Inner, x: Array, at: _Values) -> Inner:
    """The inner values, with those at points x (m x k)."""
    value, known = at.value, at.defined
    least = np.where(known & np.isfinite(value[1]), value[1], np.inf)
    most = np.where(known & np.isfinite(value[0]), value[0], -np.inf)
    i, j = int(np.argmin(least)), int(np.argmax(most))
    if least[i] < inner.least:
        inner = replace(inner, least=float(least[i]), at_least=x[:, i])
    if most[j] > inner.most:
        inner = replace(inner, most=float(most[j]), at_most=x[:, j])
    return inner


def _explore(problem: _Problem, inner: Inner) -> Inner:
    """The values at the corners, at a spread of points, and then closer and closer around the best two points."""
    low, high = problem.root
    m = len(low)
    if m == 0:
        return inner
    start = np.concatenate((corners(low, high), placed(low, high, spread(m, _SPREAD))), axis=1)
    inner = _better(inner, start, _values(problem.program, *problem.points(start)))
    width = high - low
    for round in range(_ROUNDS if m > 1 else 0):
        clusters = []
        for at in (inner.at_least, inner.at_most):
            if at is not None:
                reach = np.where(np.isfinite(width), width, 1.0 + np.abs(at)) * 0.35 ** (round + 1)
                clusters.append(placed(np.maximum(low, at - reach), np.minimum(high, at + reach), spread(m, _AROUND)))
        if not clusters:
            break
        x = np.concatenate(clusters, axis=1)
        inner = _better(inner, x, _values(problem.program, *problem.points(x)))
    return inner
