"""What is alike in a block: values computed by the same operations, of elements whose numbers go on by equal steps."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import TypeVar

import casadi as ca

from hgogen.emit.node import ARRAY, ELEMENT, FOLD, Node

MOST = 400  # operations of one that is compared with others
LEAVES = (ca.OP_CONST, ca.OP_INPUT, ELEMENT, ARRAY, FOLD)
T = TypeVar("T")


@dataclass(frozen=True)
class Shape:
    """How a value is computed: `key` is the same for those alike, and so are the lengths of `elements`, the numbers of
    the elements that it reads, and of `constants`."""

    key: Hashable
    elements: tuple[int, ...] = ()
    constants: tuple[float, ...] = ()


@dataclass(frozen=True)
class Shapes:
    """Makes shapes, in which a value of `whole` is one to read, any other for another one unless it is `nameless`;
    `indexed`: whether a loop can go through an argument."""

    whole: set[int]
    indexed: Callable[[int], bool]
    nameless: bool = False

    def of(self, node: Node, *, opened: bool = True, before: tuple[int, ...] = ()) -> Shape:
        """The shape of a value; `opened`: where it is a whole, how that is computed; `before`:
        numbers that come before those of its elements."""
        reading = _Reading(self, list(before))
        return Shape(reading.key(node, opened), tuple(reading.elements), tuple(reading.constants))


@dataclass(frozen=True)
class _Reading:
    """One walk through a value."""

    shapes: Shapes
    elements: list[int]
    constants: list[float] = field(default_factory=list)
    seen: dict[int, int] = field(default_factory=dict)

    def key(self, node: Node, opened: bool = False) -> Hashable:
        """What is the same in values alike; the rest is noted."""
        if node.op == ca.OP_CONST and isfinite(node.constant):
            self.constants.append(node.constant)
            return node.op
        if node.op == ELEMENT:
            self.elements.append(node.element[1])
            return node.op, id(node.args[0]), node.element[0]
        if node.op == ca.OP_INPUT and self.shapes.indexed(node.source[0]):
            self.elements.append(node.source[1])
            return node.op, node.source[0]
        if node.op in LEAVES or (id(node) in self.shapes.whole and not opened):
            return None if self.shapes.nameless else id(node)
        if id(node) in self.seen:
            return "again", self.seen[id(node)]
        self.seen[id(node)] = len(self.seen)
        if len(self.seen) > MOST:
            return object()  # which is alike to no other
        return node.op, node.lookup, *map(self.key, node.args)


def runs(rows: Sequence[tuple[Shape, T]], least: int) -> list[list[T]]:
    """Those things alike that go on by equal steps, in their order, at least so many: first with equal constants, then
    with any."""
    taken, result = set[int](), list[list[T]]()
    for constant in (True, False):
        groups: dict[Hashable, list[tuple[Shape, T]]] = {}
        for row in (each for each in rows if id(each) not in taken):
            key = row[0].key, tuple(map(repr, row[0].constants)) if constant else ()
            groups.setdefault(key, []).append(row)
        for group in groups.values():
            result += _progressions(sorted(group, key=lambda row: row[0].elements), taken, least)
    return result


def _progressions(rows: list[tuple[Shape, T]], taken: set[int], least: int) -> list[list[T]]:
    """Things whose elements go on by equal steps, at least so many; their rows are then taken."""
    result, start = list[list[T]](), 0
    while start + least <= len(rows):
        end = start + length([shape.elements for shape, _ in rows[start:]])
        if end - start >= least:
            taken.update(id(row) for row in rows[start:end])
            result.append([thing for _, thing in rows[start:end]])
        start = end if end - start >= least else max(start + 1, end - 1)
    return result


def length(rows: Sequence[tuple[int, ...]]) -> int:
    """How many rows, from the first, go on by equal steps that are not all 0."""
    if len(rows) < 2 or not any(step := _step(*rows[:2])):
        return min(len(rows), 1)
    k = 2
    while k < len(rows) and _step(rows[k - 1], rows[k]) == step:
        k += 1
    return k


def _step(a: tuple[int, ...], b: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(y - x for x, y in zip(a, b, strict=True))


def owners(nodes: Sequence[Node], used: Iterable[Sequence[Node]], wholes: set[int]) -> dict[int, int]:
    """For each value the one whole that it is computed for, or itself: where it is one of `wholes`, or is computed for
    two. `nodes`: every value after those that it takes; `used`: what each statement uses, which counts as a whole."""
    above: dict[int, set[int]] = {}
    for number, roots in enumerate(used):
        for root in roots:
            above.setdefault(id(root), set()).add(-1 - number)
    owner = dict[int, int]()
    for node in reversed(nodes):
        users = above.pop(id(node), set())
        own = id(node) in wholes or len(users) != 1 or bool(node.routine)
        owner[id(node)] = id(node) if own else users.pop()
        for child in node.args:
            above.setdefault(id(child), set()).add(owner[id(node)])
    return owner
