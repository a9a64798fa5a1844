"""The statements of a block with loops in them: where values are alike, one loop computes them.

Values are alike if they are computed by the same operations, from elements whose numbers change by equal steps. A
value that two statements need, and an argument of a routine, is an element of an array that a loop fills. A long sum,
or a long conjunction, is accumulated in a loop. Elements of an array that are written alike are written in a loop. Each
value is computed by the same operations as without loops, and so has the same bits.
"""

from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from math import isfinite
from typing import TypeVar

import casadi as ca

from hgogen.emit.code import NOTHING, Uses
from hgogen.emit.node import ARRAY, AT, CLAMP, ELEMENT, FILL, FOLD, TABLE, Node, boolean, opposite, ordered

MAX_OPERATIONS = 400  # of a value that is compared with others
LEAVES = (ca.OP_CONST, ca.OP_INPUT, ELEMENT, ARRAY, FOLD)
T = TypeVar("T")


@dataclass(frozen=True)
class Shape:
    """The structure of an expression without its array indices and constants. Two expressions with equal `key` can be
    computed by one loop; `elements`: the array indices that the expression reads; `constants`: its numbers."""

    key: Hashable
    elements: tuple[int, ...] = ()
    constants: tuple[float, ...] = ()


@dataclass(frozen=True)
class Shapes:
    """A computation of the `Shape` of expressions. Nodes in `units` (identities) count as variables within other
    expressions, as one and the same variable if `nameless`; `indexed`: whether a loop can index argument i."""

    units: set[int]
    indexed: Callable[[int], bool]
    nameless: bool = False

    def shape(self, node: Node, *, opened: bool = True, before: tuple[int, ...] = ()) -> Shape:
        """Return the `Shape` of the expression `node`. `opened`: whether a node in `units` is described by its
        operations, not as a variable; `before`: array indices placed before those of the expression."""
        reading = _Reading(self, list(before))
        return Shape(reading.key(node, opened), tuple(reading.elements), tuple(reading.constants))


@dataclass(frozen=True)
class _Reading:
    """A walk through an expression that collects the array indices and constants that it reads."""

    shapes: Shapes
    elements: list[int]
    constants: list[float] = field(default_factory=list)
    numbers: dict[int, int] = field(default_factory=dict)

    def key(self, node: Node, opened: bool = False) -> Hashable:
        if node.op == ca.OP_CONST and isfinite(node.constant):
            self.constants.append(node.constant)
            return node.op
        if node.op == ELEMENT:
            self.elements.append(node.element[1])
            return node.op, id(node.args[0]), node.element[0]
        if node.op == ca.OP_INPUT and self.shapes.indexed(node.source[0]):
            self.elements.append(node.source[1])
            return node.op, node.source[0]
        if node.op in LEAVES or (id(node) in self.shapes.units and not opened):
            return None if self.shapes.nameless else id(node)
        if id(node) in self.numbers:
            return "again", self.numbers[id(node)]
        self.numbers[id(node)] = len(self.numbers)
        if len(self.numbers) > MAX_OPERATIONS:
            return object()  # equal to no other key
        return node.op, node.lookup, *map(self.key, node.args)


def runs(rows: Sequence[tuple[Shape, T]], least: int) -> list[list[T]]:
    """Return groups of at least `least` expressions that one loop can compute: equal `Shape.key`, array indices that
    grow by equal steps. First come groups with equal constants, then with any."""
    used, result = set[int](), list[list[T]]()
    for constant in (True, False):
        groups: dict[Hashable, list[tuple[Shape, T]]] = {}
        for row in (each for each in rows if id(each) not in used):
            key = row[0].key, tuple(map(repr, row[0].constants)) if constant else ()
            groups.setdefault(key, []).append(row)
        for group in groups.values():
            result += _progressions(sorted(group, key=lambda row: row[0].elements), used, least)
    return result


def _progressions(rows: list[tuple[Shape, T]], used: set[int], least: int) -> list[list[T]]:
    result, start = list[list[T]](), 0
    while start + least <= len(rows):
        end = start + length([shape.elements for shape, _ in rows[start:]])
        if end - start >= least:
            used.update(id(row) for row in rows[start:end])
            result.append([thing for _, thing in rows[start:end]])
        start = end if end - start >= least else max(start + 1, end - 1)
    return result


def length(rows: Sequence[tuple[int, ...]]) -> int:
    """Return how many rows of array indices, counted from the first, differ from row to row by one constant step that
    is not all 0."""
    if len(rows) < 2 or not any(step := _step(*rows[:2])):
        return min(len(rows), 1)
    k = 2
    while k < len(rows) and _step(rows[k - 1], rows[k]) == step:
        k += 1
    return k


def _step(a: tuple[int, ...], b: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(y - x for x, y in zip(a, b, strict=True))


def owners(nodes: Sequence[Node], used: Iterable[Sequence[Node]], units: set[int]) -> dict[int, int]:
    """Return the owner of each node, both by identity: the only node or statement that uses the node, or the node
    itself if it is in `units`, has several users, or is a call of a routine.

    Args: `nodes` every value after its operands; `used` the values that each statement uses.
    """
    above: dict[int, set[int]] = {}
    for number, roots in enumerate(used):
        for root in roots:
            above.setdefault(id(root), set()).add(-1 - number)
    owner = dict[int, int]()
    for node in reversed(nodes):
        users = above.pop(id(node), set())
        alone = id(node) in units or len(users) != 1 or bool(node.routine)
        owner[id(node)] = id(node) if alone else users.pop()
        for child in node.args:
            above.setdefault(id(child), set()).add(owner[id(node)])
    return owner


FOLDED = (ca.OP_ADD, ca.OP_AND, ca.OP_OR)
Source = tuple[int, int]


@dataclass(frozen=True)
class Target:
    """The place to which an output of a block is written. `write` returns the statement for the text of a value;
    `flag`: whether the value is a truth value.

    `raised`, for a bit of the status: returns the lines that set the bit where a truth value holds; `write` then
    returns the statement that always sets it.

    `array`, `element`, for an element of an array: the array and the element's number; `each` returns the statement for
    the texts of a number and of a value. `source`: the input element at the same place, so that writing it back
    unchanged can be omitted. `uses`: the names that the statement uses besides the value.
    """

    write: Callable[[str], str]
    flag: bool = False
    raised: Callable[[str], Sequence[str]] | None = None
    array: Hashable = None
    element: int = 0
    each: Callable[[str, str], str] | None = None
    source: Source | None = None
    uses: Uses = NOTHING


@dataclass(frozen=True)
class Statement:
    """A value and the targets to which it is written. Several targets are written in a loop; then `node` is the value
    in one pass."""

    node: Node
    targets: tuple[Target, ...]


Pair = tuple[Node, Target]


def rolled(
    pairs: Sequence[Pair], indexed: Callable[[int], bool], hoist: Collection[int], least: int
) -> list[Statement]:
    """Return the statements of a block from its pairs (node, target): one loop for all values that differ in array
    indices only, and one statement for each other pair.

    Args: `indexed` whether a loop can index an argument; `hoist` arguments that the block also writes; `least` the
    smallest number of passes for which a loop is written.
    """
    nodes = ordered(node for node, _ in pairs)
    if _most_of_a_kind(nodes, pairs) < least:
        return [Statement(node, (target,)) for node, target in pairs]
    return list(_safe(_Rolling(pairs, nodes, indexed, least).statements(), hoist))


def _most_of_a_kind(nodes: Sequence[Node], pairs: Sequence[Pair]) -> int:
    """Return an upper bound on the passes of any loop: one more than the number of
    operations of one kind in the nodes (terms of a sum), or the elements of an array."""
    operations = Counter(node.op for node in nodes if node.op not in LEAVES)
    elements = Counter(target.array for _, target in pairs if target.each)
    return max(1 + max(operations.values(), default=0), max(elements.values(), default=0))


@dataclass(frozen=True)
class _Rolling:
    """A search for loops among the values of a block; `nodes`: every value after the values
    that it is computed from; `least`: the smallest number of passes of a loop."""

    pairs: Sequence[Pair]
    nodes: list[Node]
    indexed: Callable[[int], bool]
    least: int

    def statements(self) -> list[Statement]:
        users = Counter(id(node) for node in (*(n for n, _ in self.pairs), *(a for n in self.nodes for a in n.args)))
        passed = {id(argument) for node in self.nodes if node.routine for argument in node.args}
        chains = self._chains(passed, users)
        terms = {id(term) for _, terms in chains for term in terms if users[id(term)] == 1}
        owner = owners(self.nodes, [[node] for node, _ in self.pairs], passed | terms)
        shapes = Shapes({node for node, root in owner.items() if node == root}, self.indexed)
        unify = _Unify()
        for alike in self._by_height(shapes.units - terms):
            for run in runs([(shapes.shape(node), node) for node in alike], self.least):
                unify.filled(run)
        for top, parts in chains:
            if top.op in FOLDED:
                _folded(top, parts, [shapes.shape(term, opened=id(term) in terms) for term in parts], unify, self.least)
        return self._written(shapes, unify)

    def _by_height(self, chosen: set[int]) -> Iterator[list[Node]]:
        height, levels = dict[int, int](), dict[int, list[Node]]()
        for node in self.nodes:
            level = height[id(node)] = 1 + max((height[id(child)] for child in node.args), default=0)
            if id(node) in chosen and node.op not in LEAVES and not node.routine and not boolean(node):
                levels.setdefault(level, []).append(node)
        return (levels[level] for level in sorted(levels))

    def _chains(self, passed: set[int], users: Counter[int]) -> list[tuple[Node, list[Node]]]:
        owner = owners(self.nodes, [[node] for node, _ in self.pairs], passed)
        shapes = Shapes({node for node, root in owner.items() if node == root}, self.indexed, nameless=True)
        statements = [(-1 - k, node, target.array) for k, (node, target) in enumerate(self.pairs)]
        statements += [(id(node), node, "") for node in self.nodes if id(node) in shapes.units]
        keys = {number: (shapes.shape(node).key, array) for number, node, array in statements}
        alike = Counter(keys.values())
        inner, chains = set[int](), list[tuple[Node, list[Node]]]()
        for node in reversed(self.nodes):
            key = keys.get(owner[id(node)])
            row = key is not None and alike[key] >= self.least
            if node.op in FOLDED and id(node) not in inner and not row:
                spine, terms = _spine(node, lambda child: users[id(child)] == 1 and id(child) not in passed)
                inner |= spine
                chains += [(node, terms)] if len(terms) >= self.least else []
        return chains[::-1]

    def _written(self, shapes: Shapes, unify: "_Unify") -> list[Statement]:
        numbers = dict[Hashable, list[tuple[Shape, int]]]()
        for k, (node, target) in enumerate(self.pairs):
            if target.each:
                shape = shapes.shape(node, opened=False, before=(target.element,))
                numbers.setdefault(target.array, []).append((shape, k))
        first = {run[0]: run for rows in numbers.values() for run in runs(rows, self.least)}
        first = {min(run): run for run in first.values()}
        inside = {k for run in first.values() for k in run}
        statements = list[Statement]()
        for k, (node, target) in enumerate(self.pairs):
            if k in first:
                members = [self.pairs[number] for number in first[k]]
                node, targets = unify([node for node, _ in members]), tuple(target for _, target in members)
                statements.append(Statement(node, targets))
            elif k not in inside:
                statements.append(Statement(node, (target,)))
        return statements


def _spine(top: Node, inner: Callable[[Node], bool]) -> tuple[set[int], list[Node]]:
    """Return of a sum ((t_1 + t_2) + t_3) + .. the identities of the nested sums, and the terms t_i in order."""
    spine, terms, node = {id(top)}, list[Node](), top
    while True:
        positions = [k for k, child in enumerate(node.args) if child.op == top.op and inner(child)]
        if not positions:
            return spine, [*node.args, *reversed(terms)]
        terms.append(node.args[1 - positions[0]])
        node = node.args[positions[0]]
        spine.add(id(node))


class _Unify:
    """A merger of expressions that differ in array indices and
    constants into one: the value in a pass of a loop."""

    def __init__(self) -> None:
        self.tables = dict[tuple[str, ...], Node]()

    def __call__(self, nodes: Sequence[Node]) -> Node:
        return self._one(tuple(nodes), {})

    def filled(self, nodes: Sequence[Node]) -> None:
        fill = Node(FILL, (self(nodes),), count=len(nodes))
        for k, node in enumerate(nodes):
            _become(node, Node(ELEMENT, (fill,), element=(0, k)))

    def _one(self, nodes: tuple[Node, ...], done: dict[tuple[int, ...], Node]) -> Node:
        first, second = nodes[:2] if len(nodes) > 1 else nodes * 2
        if all(node is first for node in nodes):
            return first
        key = tuple(map(id, nodes))
        if key not in done:
            done[key] = self._moving(nodes, first, second, done)
        return done[key]

    def _moving(self, nodes: tuple[Node, ...], first: Node, second: Node, done: dict[tuple[int, ...], Node]) -> Node:
        if first.op == ca.OP_CONST:
            return self._number(nodes)
        if first.op == ca.OP_INPUT:
            step = second.source[1] - first.source[1]
            return Node(AT, source=first.source, step=step, inside=True)
        if first.op == ELEMENT:
            step = second.element[1] - first.element[1]
            return Node(AT, first.args, element=first.element, step=step, inside=True)
        args = tuple(self._one(column, done) for column in zip(*(node.args for node in nodes), strict=True))
        if first.op == CLAMP and all(opposite(*node.args[1:]) for node in nodes):
            value, _, high = args
            args = (value, Node(ca.OP_NEG, (high,), inside=True), high) if high.inside else args
        return Node(first.op, args, lookup=first.lookup, inside=True)

    def _number(self, nodes: Sequence[Node]) -> Node:
        numbers = tuple(repr(node.constant) for node in nodes)
        if len(set(numbers)) == 1:
            return nodes[0]
        table = self.tables.setdefault(numbers, Node(TABLE, table=tuple(node.constant for node in nodes)))
        return Node(AT, (table,), step=1, inside=True)


def _folded(top: Node, terms: Sequence[Node], shapes: Sequence[Shape], unify: _Unify, least: int) -> None:
    if all(_alike(shapes[k:]) < least for k in range(len(shapes))):
        return
    total, k = None, 0
    while k < len(terms):
        if (count := _alike(shapes[k:])) < least:
            total = terms[k] if total is None else Node(top.op, (total, terms[k]))
            k += 1
            continue
        if total is None:
            logic = top.op != ca.OP_ADD
            total = Node(ca.OP_CONST, constant=float(top.op == ca.OP_AND)) if logic else terms[k]
            k, count = (k, count) if logic else (k + 1, count - 1)
        total = Node(FOLD, (total, unify(terms[k : k + count])), fold=top.op, count=count)
        k += count
    assert total is not None
    _become(top, total)


def _alike(shapes: Sequence[Shape]) -> int:
    elements = list[tuple[int, ...]]()
    for shape in shapes:
        if shape.key != shapes[0].key:
            break
        elements.append(shape.elements)
    return length(elements)


def _become(node: Node, other: Node) -> None:
    for each in fields(Node):
        setattr(node, each.name, getattr(other, each.name))


def _safe(statements: Sequence[Statement], hoist: Collection[int]) -> Iterator[Statement]:
    """Yield the statements; a loop that would read an array element after writing it reads copies instead."""
    written = set[Source]()
    for each in statements:
        if len(each.targets) > 1 and not _reads_before(each, written, hoist):
            fill = Node(FILL, (each.node,), count=len(each.targets))
            yield replace(each, node=Node(AT, (fill,), step=1, inside=True))
        else:
            yield each
        written |= {target.source for target in each.targets if target.source}


def _reads_before(statement: Statement, written: set[Source], hoist: Collection[int]) -> bool:
    through = [node for node in _inside(statement.node) if node.op == AT and not node.args and node.source[0] in hoist]
    written = set(written)
    for k, target in enumerate(statement.targets):
        if any((node.source[0], node.source[1] + k * node.step) in written for node in through):
            return False
        written |= {target.source} if target.source else set()
    return True


def _inside(root: Node) -> Iterator[Node]:
    stack, visited = [root], set[int]()
    while stack:
        node = stack.pop()
        if node.inside and id(node) not in visited:
            visited.add(id(node))
            yield node
            stack += node.args


def outside(roots: Sequence[Node]) -> list[Node]:
    """Return the nodes that must be computed before a loop over the expressions `roots`."""
    result = [root for root in roots if not root.inside]
    return result + [child for root in roots for node in _inside(root) for child in node.args if not child.inside]
