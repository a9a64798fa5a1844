"""A box in cells, cut where what is known of them says least.

The cell that weighs most is cut across the side whose halves weigh least, until none weighs more than 1, or much more
than the centre of one does: there no cut would help.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Generic, TypeVar

import sympy as sp

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
        cuts[place], halves = _cut(worst.box, box, cell)
        leaves |= {(*place, k): half for k, half in enumerate(halves)}
    known = [one.known for one in leaves.values() if one.known is not None]
    return Subdivision(tuple(known), " ".join(_tokens(cuts))) if len(known) == len(leaves) else None


def _cut(here: Ranges, whole: Ranges, cell: Callable[[Ranges], _Cell[T]]) -> tuple[str, list[_Cell[T]]]:
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
