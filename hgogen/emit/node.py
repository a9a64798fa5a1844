"""A block's SX instructions as nodes, with the patterns recognised that have a text of their own."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache
from itertools import islice

import casadi as ca

from hgogen.discretisation.runge_kutta import Argument, Routine
from hgogen.emit import elementary
from hgogen.emit.operations import operations
from hgogen.rigor.lookup import Lookup, folded


@dataclass(eq=False, slots=True)
class Node:
    """A value of a graph."""

    op: int
    args: tuple["Node", ...] = ()
    constant: float = 0.0
    source: tuple[int, int] = (0, 0)  # of an input: argument, element
    uses: int = 0
    name: str = ""
    lookup: Lookup | None = None  # of a call
    routine: Routine | None = None  # of a call
    element: tuple[int, int] = (0, 0)  # of what a routine computes: result, element
    labels: dict[int, str] = field(default_factory=dict)  # of a call of a routine: the names of its results
    passed: tuple[tuple["Node", ...], ...] = ()  # of a call of a routine: what it passes for each argument
    count: int = 0  # of what a loop computes: how often it runs
    step: int = 0  # of an element that moves with a loop, which at first is that of `source` or `element`
    inside: bool = False  # whether it is another value each time that a loop around it runs
    fold: int = 0  # of what a loop sums up: the operation
    table: tuple[float, ...] = ()


_PAIRED = {ca.OP_OR: ca.OP_LT, ca.OP_AND: ca.OP_LE}
_BOOLEAN = {ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR}
CLAMP, WITHIN, CHOOSE, KEEP = -1, -2, -3, -4  # such patterns
ELEMENT = -5  # of what a routine computes
NEAREST = -6  # the whole number nearest to one
ARRAY = -7  # all of an argument, as a routine is passed it
POWER_OF_TWO = -12
FILL = -21  # an array whose elements a loop computes, each as the argument says
FOLD = -22  # what a loop makes of a first value and of one more each time, as the arguments say
AT = -23  # the element at which a loop is, of an input, or of the array that is the argument
TABLE = -24  # an array of numbers
_PRIMITIVES = {elementary.NEAREST: NEAREST, elementary.POWER_OF_TWO: POWER_OF_TWO}
INSIDE, OUTSIDE = -13, -14  # of an interval
_TESTS = (WITHIN, INSIDE, OUTSIDE)
PATTERNS: dict[int, str] = {CLAMP: "clamp", WITHIN: "within", KEEP: "keep"}  # functions of ours
PATTERNS |= {INSIDE: "inside", OUTSIDE: "outside"}
PATTERNS |= {op: name for name, op in _PRIMITIVES.items()}


def read(function: ca.Function, intervals: bool = False) -> list[list[Node]]:
    """The outputs of an SX function as nodes, one list for each output; `intervals`: tests of two ends are one node."""
    nodes: list[Node] = []

    @cache
    def given_as(argument: int, element: int) -> Node:
        return Node(ca.OP_INPUT, source=(argument, element))

    def apply(op: int, args: list[Node]) -> Node:
        nodes.append(_node(op, tuple(args), intervals))
        return nodes[-1]

    def constant(number: float) -> Node:
        return Node(ca.OP_CONST, constant=number)

    outputs = folded(function, given_as, constant, apply, _called, operations(function))
    for node in nodes:
        _settle(node)
    return outputs


def _called(function: Lookup | ca.Function, values: list[Node]) -> list[Node]:
    args = tuple(values)
    if isinstance(function, Lookup):
        return [Node(ca.OP_CALL, args, lookup=function)]
    if function.name() in _PRIMITIVES:
        return [Node(_PRIMITIVES[function.name()], args)]
    call = Node(ca.OP_CALL, args, routine=(routine := Routine(function)))
    places = [(k, i) for k, (_, size) in enumerate(routine.results) for i in range(size)]
    return [Node(ELEMENT, (call,), element=place) for place in places]


def columns(call: Node) -> Iterator[tuple[Argument, list[Node]]]:
    """The arguments of a call of a routine, element by element."""
    assert call.routine
    rest = iter(call.args)
    return ((argument, list(islice(rest, argument.size))) for argument in call.routine.arguments)


def ordered(roots: Iterable[Node]) -> list[Node]:
    """Every node once, after those that it takes."""
    done: dict[Node, None] = {}
    stack = list(roots)[::-1]
    while stack:
        missing = [child for child in stack[-1].args if child not in done]
        if missing:
            stack += missing[::-1]
        else:
            done[stack.pop()] = None
    return list(done)


def _settle(node: Node) -> None:
    """A clamp that is 0 where its argument is not finite: `keep` as well."""
    if node.op == ca.OP_IF_ELSE_ZERO:
        test, value = node.args
        if test.op == WITHIN and value.op == CLAMP and test.args[0] is value.args[0]:
            node.op, node.args = KEEP, (*value.args, Node(ca.OP_CONST), test.args[1])


def _node(op: int, args: tuple[Node, ...], intervals: bool) -> Node:
    """A value, with the patterns of a choice, a clamp and a finite test recognised."""
    if (same := _decided(op, args)) is not None:
        return same
    if op == ca.OP_ADD and args[0].op == args[1].op == ca.OP_IF_ELSE_ZERO:
        (test, yes), (opposite, no) = args[0].args, args[1].args
        if opposite.op == ca.OP_NOT and opposite.args[0] is test:
            if test.op == WITHIN and yes.op == CLAMP and test.args[0] is yes.args[0]:
                return Node(KEEP, (*yes.args, no, test.args[1]))
            return Node(CHOOSE, (test, yes, no))
    if op == ca.OP_LE and args[0].op == ca.OP_FABS:
        return Node(WITHIN, (args[0].args[0], args[1]))
    if op in _PAIRED and all(arg.op == _PAIRED[op] for arg in args):
        return _by_size(op, args, intervals) or Node(op, args)
    if op == ca.OP_FMIN and args[0].op == ca.OP_FMAX:
        return Node(CLAMP, (args[0].args[0], args[0].args[1], args[1]))
    if op == ca.OP_SQ:
        return Node(ca.OP_MUL, (args[0], args[0]))
    if op == ca.OP_TWICE:
        return Node(ca.OP_MUL, (Node(ca.OP_CONST, constant=2.0), args[0]))
    if op == ca.OP_INV:
        return Node(ca.OP_DIV, (Node(ca.OP_CONST, constant=1.0), args[0]))
    return Node(op, args)


def _decided(op: int, args: tuple[Node, ...]) -> Node | None:
    """The argument that a value is, bit for bit: a choice that was made before by the same test, a truth value with
    itself, or with one that decides nothing; None for other values."""
    if op == ca.OP_IF_ELSE_ZERO and args[1].op == op and args[1].args[0] is args[0]:
        return args[1]
    if op in (ca.OP_AND, ca.OP_OR):
        for one, other in (args, args[::-1]):
            idle = other.op == ca.OP_CONST and bool(other.constant) == (op == ca.OP_AND)
            if boolean(one) and (other is one or idle):
                return one
    return None


def _by_size(op: int, args: tuple[Node, ...], intervals: bool) -> Node | None:
    """v < -b or b < v as b < |v|, and -b <= v and v <= b as |v| <= b; of other numbers as a test of the interval, None
    of other comparisons."""
    (a, b), (c, d) = (arg.args for arg in args)
    v, low, high, w = (a, b, c, d) if op == ca.OP_OR else (b, a, d, c)
    if v is not w or {low.op, high.op} - {ca.OP_CONST, AT, ca.OP_NEG}:
        return None
    if not opposite(low, high):
        constant = intervals and low.op == high.op == ca.OP_CONST
        return Node(INSIDE if op == ca.OP_AND else OUTSIDE, (v, low, high)) if constant else None
    return Node(WITHIN, (v, high)) if op == ca.OP_AND else Node(ca.OP_LT, (high, Node(ca.OP_FABS, (v,))))


def opposite(low: Node, high: Node) -> bool:
    """Whether they are the numbers -b and b, b > 0, of a table too."""
    if high.op == AT and low.op == ca.OP_NEG:
        return low.args[0] is high and high.args[0].op == TABLE and min(high.args[0].table) > 0
    return low.op == high.op == ca.OP_CONST and -low.constant == high.constant > 0


def negative(node: Node) -> bool:
    """Whether it is, or is a product that starts with, a negative number: adding it prints as a subtraction."""
    if node.op == ca.OP_MUL and not node.name:
        return negative(node.args[0])
    return node.op == ca.OP_CONST and node.constant < 0


def negated(node: Node) -> Node:
    """A negative number, or a product that starts with one, without its sign."""
    if node.op == ca.OP_CONST:
        return Node(ca.OP_CONST, constant=-node.constant)
    return Node(node.op, (negated(node.args[0]), node.args[1]))


def boolean(node: Node) -> bool:
    """Whether the value is a truth value."""
    return node.op in _BOOLEAN or node.op in _TESTS or (node.op == FOLD and node.fold in _BOOLEAN)
