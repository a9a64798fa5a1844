"""Branch and bound: bisection of boxes of floats, with rigorous ranges of expressions on them.

A search evaluates boxes, and bisects those that are farthest from its goal. On each box the range of an expression is
the intersection of several enclosures: the natural interval extension of every output of the tape (equivalent forms of
one expression: as written, factored, ..); the same on the faces at which a monotone expression is extreme; and the mean
value form

    f(x) in f(c) + sum_i [df/dx_i] (x_i - c_i),

with one centre c for the lower and one for the upper bound (E. Baumann, "Optimal centered forms", BIT 28, 1988).
Enclosed values at points of the box bound the range from inside. The search counts boxes and uses no random numbers.

A box with exact ends is divided into few cells (`subdivided`): the cell of the largest weight is cut across the side
whose halves have the least weight, until no weight is above 1, or much above that of a cell's centre, where cuts would
not help.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from functools import partial, reduce
from typing import Generic, TypeVar

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from hgogen.rigor.box import STRANGE, Box, Sides, exact, sides
from hgogen.rigor.enclosure import Enclosure, enclose
from hgogen.rigor.outward import Array, Flags, Pair, add, meet, negate, scale, where_known
from hgogen.rigor.tape import NoTape, Tape, tape

# --- points of a box

Indices = NDArray[np.int64]


def middle(low: Array, high: Array) -> Array:
    """Return the points (m x k) at which boxes are bisected: the middles; for an unbounded side 0, or where 0 is
    outside twice the end plus 1, away from 0."""
    centre = low / 2.0 + high / 2.0
    if np.isfinite(centre).all():
        return np.clip(centre, low, high)
    both = np.isinf(low) & np.isinf(high)
    above, below = np.isinf(high) & ~both, np.isinf(low) & ~both
    centre = np.where(above, np.where(low < 0, 0.0, 2.0 * low + 1.0), centre)
    centre = np.where(below, np.where(high > 0, 0.0, 2.0 * high - 1.0), centre)
    return np.clip(np.where(both, 0.0, centre), low, high)


def spread(m: int, count: int) -> Array:
    """Return `count` evenly spread points (m x count) of the unit cube: multiples of the square roots of primes, modulo
    1."""
    primes = [p for p in range(2, 20 * (m + 2)) if all(p % q for q in range(2, math.isqrt(p) + 1))][:m]
    steps = np.sqrt(np.array(primes, dtype=float))[:, None]
    points: Array = np.mod(steps * np.arange(1, count + 1) + 0.5, 1.0)
    return points


def placed(low: Array, high: Array, t: Array) -> Array:
    """Return points t (m x count) of the unit cube mapped to the box low <= x <= high (m); an unbounded side by a
    rational map."""
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
    """Return the middle of a box, then up to 64 of its corners (m x count); an infinite end is replaced by a large
    number."""
    m = len(low)
    ends = (
        np.where(np.isinf(low), np.minimum(high, 0.0) - 1e3, low),
        np.where(np.isinf(high), np.maximum(low, 0.0) + 1e3, high),
    )
    codes = np.arange(min(2**m, 64))
    bits = (codes[None, :] >> np.arange(m)[:, None]) & 1
    corners = np.where(bits == 1, ends[1][:, None], ends[0][:, None])
    return np.concatenate((middle(low, high)[:, None], corners), axis=1)


# --- the search

Tree = tuple[object, ...] | str


@dataclass(frozen=True)
class LeafBounds:
    """Proved bounds bottom <= value <= top of an expression on n boxes low <= x <= high (m x n), and flags whether it
    is `defined` and `continuous` on them; `node`: the index of each box in the tree of the bisection; `cut`: the
    variable to bisect next, or -1."""

    low: Array
    high: Array
    node: Indices
    cut: Indices
    bottom: Array
    top: Array
    defined: Flags
    continuous: Flags

    def only(self, rows: Indices | Flags) -> "LeafBounds":
        """Return the bounds and flags of some boxes, by their indices or flags."""
        return LeafBounds(*(getattr(self, each.name)[..., rows] for each in fields(self)))

    def with_more(self, other: "LeafBounds") -> "LeafBounds":
        """Return the bounds and flags of these boxes, then of the boxes of `other`."""
        pairs = ((getattr(self, each.name), getattr(other, each.name)) for each in fields(self))
        return LeafBounds(*(np.concatenate(pair, axis=-1) for pair in pairs))


@dataclass(frozen=True)
class AttainedValues:
    """The smallest and the largest value that was evaluated on a box: a value at the point `at_least` (m) is at most
    `least`, a value at `at_most` at least `most`; inf and -inf before a point was evaluated."""

    least: float = math.inf
    most: float = -math.inf
    at_least: Array | None = None
    at_most: Array | None = None


@dataclass(frozen=True)
class Bisection:
    """A bisection of a box: the bounds on its `leaves`, the attained values `inner`, and the `splits` (node, variable)
    in order; `finished`: whether the goal is reached; `before`: the state from which a search with more boxes
    continues."""

    leaves: LeafBounds
    inner: AttainedValues
    splits: list[tuple[int, int]]
    finished: bool = False
    before: "Bisection | None" = None

    @property
    def boxes(self) -> int:
        """Return the number of boxes on which the expression was evaluated."""
        return 1 + 2 * len(self.splits)

    @property
    def tree(self) -> Tree:
        """Return the tree of the bisection, nested ("split", variable, left, right) and "leaf". Node 0 is the root;
        nodes 2j+1 and 2j+2 are the halves of split j."""
        subtrees: dict[int, Tree] = {}
        for j in range(len(self.splits) - 1, -1, -1):
            node, variable = self.splits[j]
            subtrees[node] = ("split", variable, subtrees.pop(2 * j + 1, "leaf"), subtrees.pop(2 * j + 2, "leaf"))
        return subtrees.get(0, "leaf")

    @property
    def low(self) -> float:
        """Return a proved lower bound of the expression on the whole box."""
        return float(self.leaves.bottom.min())

    @property
    def high(self) -> float:
        """Return a proved upper bound of the expression on the whole box."""
        return float(self.leaves.top.max())

    @property
    def defined(self) -> bool:
        """Return whether the expression is proved finite and real on the whole box."""
        return bool(self.leaves.defined.all())

    @property
    def continuous(self) -> bool:
        """Return whether the expression is proved defined and continuous on the whole box."""
        return bool(self.leaves.continuous.all() and self.leaves.defined.all())


# The distance of each leaf from the goal: 0 where it is reached, larger for worse leaves.
Goal = Callable[[LeafBounds, AttainedValues], Array]
# The facts on boxes (m x k ends) with given indices in the tree, and bounds from inside.
BoundBoxes = Callable[[Array, Array, Indices, AttainedValues], tuple[LeafBounds, AttainedValues]]
ROOT: Indices = np.zeros(1, dtype=np.int64)  # the index of the whole box


def bisected(cover: Bisection, bounds_on: BoundBoxes, goal: Goal, limit: int, batch: int) -> Bisection:
    """Return the bisection after more cuts: the worst leaves, up to `batch` at a time, until `goal(leaves, inner)`, the
    priority of each leaf, is 0 for all of them, or the `limit` of boxes is reached. `bounds_on`: the function that
    returns the bounds on new boxes."""
    while True:
        todo = np.where(cover.leaves.cut < 0, 0.0, goal(cover.leaves, cover.inner))
        rows = np.nonzero(todo > 0.0)[0]
        rows = rows[np.argsort(-todo[rows], kind="stable")][:batch]
        room = (limit - cover.boxes) // 2
        last = _cut(cover, rows[:room], bounds_on) if len(rows) and room > 0 else cover
        if len(rows) == 0 or room < len(rows):  # a higher limit cuts the whole batch: it continues from before
            return replace(last, finished=not (goal(last.leaves, last.inner) > 0.0).any(), before=cover)
        cover = last


def _cut(cover: Bisection, rows: Indices, bounds_on: BoundBoxes) -> Bisection:
    parents, columns = cover.leaves.only(rows), np.arange(len(rows))
    centre = middle(parents.low, parents.high)[parents.cut, columns]
    low, high = np.repeat(parents.low, 2, axis=1), np.repeat(parents.high, 2, axis=1)
    high[parents.cut, 2 * columns] = centre
    low[parents.cut, 2 * columns + 1] = centre
    children, inner = bounds_on(low, high, cover.boxes + np.arange(2 * len(rows), dtype=np.int64), cover.inner)
    uncut = np.ones(len(cover.leaves.node), dtype=bool)
    uncut[rows] = False
    splits = [*cover.splits, *zip(parents.node.tolist(), parents.cut.tolist(), strict=True)]
    return Bisection(cover.leaves.only(uncut).with_more(children), inner, splits)


def best_cuts(low: Array, high: Array, weight: Array, known: Flags, share: Array, possible: Flags) -> Indices:
    """Return the variable to bisect in each of k boxes: that with the largest `weight` (m x k), or the largest `share`
    of the root's side if the weights are not `known` and finite; -1 if none of the `possible` sides can be cut."""
    finite = known & np.isfinite(weight).all(axis=0)
    score = np.where(finite, weight + 1e-3 * weight.max(axis=0) * share, share)
    centre = middle(low, high)
    possible = possible & (centre > low) & (centre < high)
    best = np.argmax(np.where(possible, score, -1.0), axis=0)
    return np.where(possible.any(axis=0), best, -1).astype(np.int64)


# --- ranges

_BATCH = 256  # boxes a round
_GLANCE = 60  # most boxes of a proof that a part is defined
_FINE = 2.0**-44  # least width of a side that is cut, as a share of the root's
_FAR = 2.0**40  # an unbounded side that begins beyond it is not cut
_ROUNDS, _AROUND = 8, 48  # rounds of the search for extreme points, and points around each
_SPREAD = 160  # first points of that search


def tight(relative: float) -> Goal:
    """Return the goal of a search for a range: bounds that exceed attained values by at most the share `relative` of
    the range's width."""

    def excess(leaves: LeafBounds, inner: AttainedValues) -> Array:
        width = inner.most - inner.least if math.isfinite(inner.least) and math.isfinite(inner.most) else 0.0
        tolerance = relative / 2.0 * max(width, 0.0)
        tolerance = max(tolerance, 1e-13 * max(abs(v) for v in (inner.least, inner.most, 0.0) if math.isfinite(v)))
        over = np.maximum(inner.least - tolerance - leaves.bottom, leaves.top - tolerance - inner.most)
        over = np.where(leaves.defined, np.maximum(over, 0.0), np.inf)
        return np.where(np.isnan(over), np.inf, over)

    return excess


def one_sign(leaves: LeafBounds, inner: AttainedValues) -> Array:
    """Return the goal of a search for a sign: the priority of each leaf until the expression is proved defined and of
    one sign; 0 for all once an attained value refutes this."""
    if inner.least <= 0.0 <= inner.most:
        return np.zeros(leaves.bottom.shape)
    undecided = (leaves.bottom <= 0.0) & (leaves.top >= 0.0)
    worst = np.minimum(np.abs(leaves.bottom), np.abs(leaves.top))
    return np.where(~leaves.defined, np.inf, np.where(undecided, np.where(worst > 0, worst, 5e-324), 0.0))


def everywhere(leaves: LeafBounds, inner: AttainedValues) -> Array:
    """Return the goal of a proof that the expression is defined: inf for each leaf where this is not yet proved, else
    0."""
    return np.where(leaves.defined, 0.0, np.inf)


def is_defined(e: sp.Expr, box: Box) -> bool:
    """Return whether e is proved to be a finite real number on the whole box."""
    fixed, around = sides(exact(e), box)
    if fixed.has(*STRANGE):
        return False
    try:
        program = tape([fixed], around.symbols)
    except NoTape:
        return False
    return search(program, around, everywhere, _GLANCE).defined


def regular(leaves: LeafBounds, inner: AttainedValues) -> Array:
    """Return the goal of a proof that the expression is defined and continuous: inf for each leaf where this is not yet
    proved, else 0."""
    return np.where(leaves.defined & leaves.continuous, 0.0, np.inf)


def search(program: Tape, around: Sides, goal: Goal, limit: int, begun: Bisection | None = None) -> Bisection:
    """Return a bisection of the box `around` with bounds of an expression, whose equal forms are the outputs of the
    tape `program`, until the goal is reached or there are `limit` boxes. `begun`: a bisection with a lower limit to
    continue."""
    bounds_on = partial(_ranges, program, around)
    with np.errstate(all="ignore"):
        if begun is None:
            # goals about definedness need no values
            inner = AttainedValues() if goal in (everywhere, regular) else _explore(program, around)
            low, high = around.outer
            begun = Bisection(*bounds_on(low[:, None], high[:, None], ROOT, inner), [])
        return bisected(begun, bounds_on, goal, limit, _BATCH)


def _points(around: Sides, x: Array) -> Pair:
    first, last = (end[:, None] for end in around.inner)
    bottom, top = (end[:, None] for end in around.outer)
    low, high = np.where(x < first, bottom, x), np.where(x < first, first, x)
    return np.where(x > last, last, low), np.where(x > last, top, high)


# --- one batch of boxes


def _ranges(
    program: Tape, around: Sides, low: Array, high: Array, node: Indices, inner: AttainedValues
) -> tuple[LeafBounds, AttainedValues]:
    k = low.shape[1]
    parts = enclose(program, low, high, slopes=True)
    first = parts[0]
    value = _common(parts)
    sound = first.defined & first.continuous
    slope = _slopes(parts, sound)
    sound = sound & np.isfinite(slope[0]).all(axis=0) & np.isfinite(slope[1]).all(axis=0)
    centres, faces = _centres(low, high, slope, sound), _faces(low, high, slope, sound)
    points = np.concatenate(centres, axis=1)
    ends = zip(_points(around, points), *faces, strict=True)
    # one walk of the tape costs little more for twice the boxes
    (bottom, top), defined = _values(program, *(np.concatenate(end, axis=1) for end in ends))
    inner = _better(inner, points, ((bottom[: 2 * k], top[: 2 * k]), defined[: 2 * k]))
    for side, centre in enumerate(centres):
        rows = slice(side * k, (side + 1) * k)
        form = _mean_value((bottom[rows], top[rows]), (low, high), centre, slope)
        value = _meet(value, where_known(sound & defined[rows], form))
    if faces:
        least, most = slice(2 * k, 3 * k), slice(3 * k, None)
        value = _meet(
            value, (np.where(defined[least], bottom[least], -np.inf), np.where(defined[most], top[most], np.inf))
        )
    cut = _cuts(around.outer, low, high, slope, sound)
    return LeafBounds(low, high, node, cut, *value, first.defined, first.continuous), inner


Values = tuple[Pair, Flags]  # ranges on boxes, and where the values are defined


def _values(program: Tape, low: Array, high: Array) -> Values:
    parts = enclose(program, low, high)
    return _common(parts), parts[0].defined


def _common(parts: list[Enclosure]) -> Pair:
    return reduce(_meet, (part.value for part in parts))


def _meet(a: Pair, b: Pair) -> Pair:
    low, high = meet(a, b)
    empty = ~(low <= high)
    return np.where(empty, a[0], low), np.where(empty, a[1], high)


def _slopes(parts: list[Enclosure], sound: Flags) -> Pair:
    low, high = (np.full_like(end, s) for end, s in zip(parts[0].slope, (-np.inf, np.inf), strict=True))
    for part in parts:
        known = sound & part.defined & part.continuous & ~np.isnan(part.slope[0]) & ~np.isnan(part.slope[1])
        low, high = _meet((low, high), where_known(known, part.slope))
    return low, high


def _centres(low: Array, high: Array, slope: Pair, sound: Flags) -> Pair:
    """Return the centres (m x k) of the mean value form on k boxes, for the lower and for the upper bound, by Baumann's
    formula; the midpoint where no derivative is known."""
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
    rising = sound & (slope[0] >= 0)
    falling = sound & (slope[1] <= 0) & ~rising  # a slope of 0 counts once
    if len(low) == 1 or not (rising | falling).any():
        return []
    bottom = np.where(falling, high, low), np.where(rising, low, high)
    top = np.where(rising, high, low), np.where(falling, low, high)
    return [bottom, top]


def _cuts(root: Pair, low: Array, high: Array, slope: Pair, sound: Flags) -> Indices:
    """Return the variable to bisect in each box: that with the largest |derivative| times width, or the relatively
    widest side if no derivative is known; -1 if no side can be cut."""
    m, k = low.shape
    if m == 0:
        return np.full(k, -1, dtype=np.int64)
    width, whole = high - low, (root[1] - root[0])[:, None]
    share = np.where(np.isinf(whole), np.where(np.isinf(width), 1.0, width / (1.0 + width)), width / whole)
    size = np.maximum(np.abs(slope[0]), np.abs(slope[1])) * width
    within_reach = (np.minimum(np.abs(low), np.abs(high)) < _FAR) | (np.isinf(low) & np.isinf(high))
    return best_cuts(low, high, size, sound, share, np.where(np.isinf(width), within_reach, share > _FINE))


# --- attained values


def _better(inner: AttainedValues, x: Array, at: Values) -> AttainedValues:
    value, known = at
    least = np.where(known & np.isfinite(value[1]), value[1], np.inf)
    most = np.where(known & np.isfinite(value[0]), value[0], -np.inf)
    i, j = int(np.argmin(least)), int(np.argmax(most))
    if least[i] < inner.least:
        inner = replace(inner, least=float(least[i]), at_least=x[:, i])
    if most[j] > inner.most:
        inner = replace(inner, most=float(most[j]), at_most=x[:, j])
    return inner


def _explore(program: Tape, around: Sides) -> AttainedValues:
    low, high = around.outer
    m = len(low)
    if m == 0:
        return AttainedValues()
    x = np.concatenate((corners(low, high), placed(low, high, spread(m, _SPREAD))), axis=1)
    inner = _better(AttainedValues(), x, _values(program, *_points(around, x)))
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
        inner = _better(inner, x, _values(program, *_points(around, x)))
    return inner


# --- cells of an exact box

T = TypeVar("T")
Ranges = Mapping[sp.Symbol, tuple[Fraction, Fraction]]
Place = tuple[int, ...]  # the address of a cell: the half of each cut, from the first on
MOST = 32  # largest number of cells
_OVER_CENTRE = 1.25  # factor on the weight of a centre up to which a cell is not cut


@dataclass(frozen=True)
class _Cell(Generic[T]):
    """A box with exact ends, the result on it (None if there is none), and its weight: the cell of the largest weight
    is cut next."""

    box: Ranges
    known: T | None
    weight: float


@dataclass(frozen=True)
class Subdivision(Generic[T]):
    """A box divided into cells: the results on the `cells`, and the `tree` of cuts as text in prefix order: the name of
    a side that is cut in its middle, or a dot for a cell."""

    cells: tuple[T, ...]
    tree: str


def subdivided(
    box: Ranges, known_on: Callable[[Ranges], T | None], weight: Callable[[T], float]
) -> Subdivision[T] | None:
    """Return the box divided into at most `MOST` cells by cutting the cell of the largest `weight(result)` again and
    again; the results are `known_on(cell)`. None if there is no result on a cell or its centre."""

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
            attained = max(attained, _OVER_CENTRE * cell(centre).weight)
        if worst.weight <= attained:
            break
        del leaves[place]
        cuts[place], halves = _best_cut(worst.box, box, cell)
        leaves |= {(*place, k): half for k, half in enumerate(halves)}
    known = [one.known for one in leaves.values() if one.known is not None]
    tokens, waiting = list[str](), [Place()]
    while waiting:
        place = waiting.pop()
        tokens.append(cuts.get(place, "."))
        waiting += [(*place, 1), (*place, 0)] if place in cuts else []
    return Subdivision(tuple(known), " ".join(tokens)) if len(known) == len(leaves) else None


def _best_cut(here: Ranges, whole: Ranges, cell: Callable[[Ranges], _Cell[T]]) -> tuple[str, list[_Cell[T]]]:
    cuts = dict[str, tuple[tuple[float, ...], list[_Cell[T]]]]()
    for x, (low, high) in here.items():
        middle = (low + high) / 2
        halves = [cell({**here, x: side}) for side in ((low, middle), (middle, high))]
        weights = sorted((one.weight for one in halves), reverse=True)
        cuts[str(x)] = (*weights, -float((high - low) / (whole[x][1] - whole[x][0]))), halves
    name = min(cuts, key=lambda each: cuts[each][0])
    return name, cuts[name][1]
