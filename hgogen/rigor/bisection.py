"""Boxes that are cut in two, the tree of these cuts, and points of a box.

A box of floats is cut where a search is in doubt. A box with exact ends is cut in few cells: the cell that weighs most
across the side whose halves weigh least, until none weighs more than 1, or much more than the centre of one does: there
no cut would help.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Generic, Self, TypeVar

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from hgogen.rigor.outward import Array, Flags

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
