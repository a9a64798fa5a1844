"""Boxes that are cut in two, the tree of these cuts, and points of a box.

A box of floats is cut where a search is in doubt. A box with exact ends is cut in few cells: the cell that weighs most
across the side whose halves weigh least, until none weighs more than 1, or much more than the centre of one does: there
no cut would help.

Branch and bound on a tape: rigorous ranges on a box of floats, and how good they are.

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
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from typing import Generic, Self, TypeVar

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from hgogen.rigor.box import STRANGE, Box, exact, sides
from hgogen.rigor.enclosure import Enclosure, enclose
from hgogen.rigor.outward import Array, Flags, Pair, add, meet, negate, scale, where_known
from hgogen.rigor.tape import NoTape, Tape, tape

Indices = NDArray[np.int64]


def middle(low: Array, high: Array) -> Array:
    """The point at which a side is cut: its midpoint; for an unbounded one 0, or beyond 0 twice its end and one."""
    centre = low / 2.0 + high / 2.0
    if np.isfinite(centre).all():
        return np.clip(centre, low, high)
    both = np.isinf(low) & np.isinf(high)
    right, left = np.isinf(high) & ~both, np.isinf(low) & ~both
    centre = np.where(right, np.where(low < 0, 0.0, 2.0 * low + 1.0), centre)
    centre = np.where(left, np.where(high > 0, 0.0, 2.0 * high - 1.0), centre)
    return np.clip(np.where(both, 0.0, centre), low, high)


def spread(m: int, count: int) -> Array:
    """Points (m x count) of the unit cube, evenly spread: multiples of the square roots of primes, modulo 1."""
    primes = [p for p in range(2, 20 * (m + 2)) if all(p % q for q in range(2, math.isqrt(p) + 1))][:m]
    steps = np.sqrt(np.array(primes, dtype=float))[:, None]
    points: Array = np.mod(steps * np.arange(1, count + 1) + 0.5, 1.0)
    return points


def placed(low: Array, high: Array, t: Array) -> Array:
    """Points of the unit cube on the box; an unbounded side is reached by a rational map."""
    low, high = low[:, None], high[:, None]
    t = np.clip(t, 1e-6, 1.0 - 1e-6)
    ends = np.isinf(low), np.isinf(high)
    finite = np.where(ends[0], 0.0, low), np.where(ends[1], 0.0, high)
    x = finite[0] * (1.0 - t) + finite[1] * t
    x = np.where(ends[1] & ~ends[0], finite[0] + t / (1.0 - t), x)
    x = np.where(ends[0] & ~ends[1], finite[1] - t / (1.0 - t), x)
    x = np.where(ends[0] & ends[1], (t - 0.5) / (t * (1.0 - t)), x)
    return np.clip(x, low, high)


def corners(low: Array, high: Array) -> Array:
    """Middle, then up to 64 corners; zero or a large number for an infinite end."""
    m = len(low)
    ends = (
        np.where(np.isinf(low), np.minimum(high, 0.0) - 1e3, low),
        np.where(np.isinf(high), np.maximum(low, 0.0) + 1e3, high),
    )
    codes = np.arange(min(2**m, 64))
    bits = (codes[None, :] >> np.arange(m)[:, None]) & 1
    corners = np.where(bits == 1, ends[1][:, None], ends[0][:, None])
    return np.concatenate((middle(low, high)[:, None], corners), axis=1)


Tree = tuple[object, ...] | str


@dataclass(frozen=True)
class Columns:
    """What is known on n boxes: arrays whose last axis counts them."""

    def only(self, rows: Indices | Flags | slice) -> Self:
        """That of the given rows alone."""
        return type(self)(**{name: getattr(self, name)[..., rows] for name in self.__dataclass_fields__})

    def with_more(self, other: Self) -> Self:
        """That of both."""
        names = self.__dataclass_fields__
        return type(self)(**{n: np.concatenate((getattr(self, n), getattr(other, n)), axis=-1) for n in names})


@dataclass(frozen=True)
class Leaves(Columns):
    """n boxes (m x n ends); `node`: the place of each in the tree; `cut`: the variable to bisect, or -1."""

    low: Array
    high: Array
    node: Indices
    cut: Indices


_Leaves = TypeVar("_Leaves", bound=Leaves)
_Inner = TypeVar("_Inner")


@dataclass(frozen=True)
class Cover(Generic[_Leaves, _Inner]):
    """A bisection so far: the leaves of its tree, of whose nodes the `splits` were cut, and where; and what is attained
    at points of the box (`inner`)."""

    leaves: _Leaves
    inner: _Inner
    splits: list[tuple[int, int]]

    @property
    def boxes(self) -> int:
        """How many were tried."""
        return 1 + 2 * len(self.splits)

    @property
    def tree(self) -> Tree:
        """Nested ("split", variable, left, right) and "leaf"; node 0 is the root, split j makes 2j+1 and 2j+2."""
        made: dict[int, Tree] = {}
        for j in range(len(self.splits) - 1, -1, -1):
            node, variable = self.splits[j]
            made[node] = ("split", variable, made.pop(2 * j + 1, "leaf"), made.pop(2 * j + 2, "leaf"))
        return made.get(0, "leaf")


def best_cuts(score: Array, possible: Flags) -> Indices:
    """The variable of the largest score (m x k) in each box among those that can be cut, -1 where none can be."""
    best = np.argmax(np.where(possible, score, -1.0), axis=0)
    return np.where(possible.any(axis=0), best, -1).astype(np.int64)


Look = Callable[[Array, Array, Indices, _Inner], tuple[_Leaves, _Inner]]


def bisected(
    cover: Cover[_Leaves, _Inner],
    doubtful: Callable[[Cover[_Leaves, _Inner]], Indices],
    look: Look[_Inner, _Leaves],
    limit: int,
) -> tuple[Cover[_Leaves, _Inner], Cover[_Leaves, _Inner]]:
    """Cut leaves until none is `doubtful`, which gives the rows of a batch, the worst first, or `limit` boxes were
    tried; and the cover from which a bisection with a higher limit goes on. `look`: what is known on boxes (m x k)."""
    while True:
        rows, room = doubtful(cover), (limit - cover.boxes) // 2
        if len(rows) == 0 or room < 1:
            return cover, cover
        if room < len(rows):  # a higher limit makes the whole batch: it goes on from before
            return _cut(cover, rows[:room], look), cover
        cover = _cut(cover, rows, look)


def _cut(cover: Cover[_Leaves, _Inner], rows: Indices, look: Look[_Inner, _Leaves]) -> Cover[_Leaves, _Inner]:
    """With these leaves cut in two; both children of one are neighbours."""
    parents, columns = cover.leaves.only(rows), np.arange(len(rows))
    centre = middle(parents.low, parents.high)[parents.cut, columns]
    low, high = np.repeat(parents.low, 2, axis=1), np.repeat(parents.high, 2, axis=1)
    high[parents.cut, 2 * columns] = centre
    low[parents.cut, 2 * columns + 1] = centre
    children, inner = look(low, high, cover.boxes + np.arange(2 * len(rows), dtype=np.int64), cover.inner)
    left = np.ones(len(cover.leaves.node), dtype=bool)
    left[rows] = False
    splits = [*cover.splits, *zip(parents.node.tolist(), parents.cut.tolist(), strict=True)]
    return Cover(cover.leaves.only(left).with_more(children), inner, splits)


# --- cells of an exact box

T = TypeVar("T")
Ranges = Mapping[sp.Symbol, tuple[Fraction, Fraction]]
Place = tuple[int, ...]  # of a cell: which half of each cut, from the first on
MOST = 32  # cells
_BESIDE_CENTRE = 1.25  # of the weight of a centre: what a cell may weigh


@dataclass(frozen=True)
class _Cell(Generic[T]):
    """What is known on a box, None of nothing, and how much that weighs."""

    box: Ranges
    known: T | None
    weight: float


@dataclass(frozen=True)
class Subdivision(Generic[T]):
    """What is known on each of the cells, and the `tree` of their cuts in prefix order: the name of the side that is
    cut in its middle, a dot for a cell."""

    cells: tuple[T, ...]
    tree: str


def subdivided(
    box: Ranges, known_on: Callable[[Ranges], T | None], weight: Callable[[T], float]
) -> Subdivision[T] | None:
    """The box in at most `MOST` cells; None where nothing is known of one of them, or of the centre of one."""

    def cell(here: Ranges) -> _Cell[T]:
        known = known_on(here)
        return _Cell(here, known, math.inf if known is None else weight(known))

    leaves: dict[Place, _Cell[T]] = {(): cell(box)}
    cuts, attained = dict[Place, str](), 1.0
    while len(leaves) < MOST:
        place = max(leaves, key=lambda each: leaves[each].weight)
        worst = leaves[place]
        if worst.weight > attained:
            centre = {x: ((low + high) / 2,) * 2 for x, (low, high) in worst.box.items()}
            attained = max(attained, _BESIDE_CENTRE * cell(centre).weight)
        if worst.weight <= attained:
            break
        del leaves[place]
        cuts[place], halves = _best_cut(worst.box, box, cell)
        leaves |= {(*place, k): half for k, half in enumerate(halves)}
    known = [one.known for one in leaves.values() if one.known is not None]
    return Subdivision(tuple(known), " ".join(_tokens(cuts))) if len(known) == len(leaves) else None


def _best_cut(here: Ranges, whole: Ranges, cell: Callable[[Ranges], _Cell[T]]) -> tuple[str, list[_Cell[T]]]:
    """The name of the best side to cut, and its halves; of those that are as good the widest for its range."""
    cuts = dict[str, tuple[tuple[float, ...], list[_Cell[T]]]]()
    for x, (low, high) in here.items():
        middle = (low + high) / 2
        halves = [cell({**here, x: side}) for side in ((low, middle), (middle, high))]
        weights = sorted((one.weight for one in halves), reverse=True)
        cuts[str(x)] = (*weights, -float((high - low) / (whole[x][1] - whole[x][0]))), halves
    name = min(cuts, key=lambda each: cuts[each][0])
    return name, cuts[name][1]


def _tokens(cuts: Mapping[Place, str]) -> Iterator[str]:
    left: list[Place] = [()]
    while left:
        place = left.pop()
        yield cuts.get(place, ".")
        left += [(*place, 1), (*place, 0)] if place in cuts else []


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
        last, cover = bisected(begun, doubtful, partial(_boxes, problem), limit)
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
    return best_cuts(score, possible)


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
