"""The graphs of a block: CasADi's operations, their instructions as nodes, and the routines that they call.

Sines and cosines of bounded angles are operations of their own: what a graph clamps is bounded, and so are sums and
products of it.

    |x| <= 100:           no test of whether x can be turned, and three pieces of pi are enough
    |x| <= 4.7 < 3 pi/2:  one turn by pi at the most, which a comparison finds

A bound is an interval of the result where that is a number, and says whether it always is one: min(a, b) is
`a < b ? a : b` in emitted code, which is b where a is no number. Rounding may exceed a bound by 2^-24 of its size for
each operation, for which 3 pi/2 leaves room.

A routine is a function of the emitted code. It reads parameters through the struct of parameters where every call means
the same place; in a bank, whose members have parameters of their own, they are passed as arguments.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, lru_cache
from itertools import chain, islice
from math import inf
from typing import NamedTuple

import casadi as ca

from hgogen.discretisation.runge_kutta import Argument, Routine
from hgogen.emit import elementary
from hgogen.emit.elementary import BOUNDED, SMALL
from hgogen.emit.interface import reached
from hgogen.emit.syntax import AND, EQUAL, OR, ORDER, PRODUCT, SUM
from hgogen.program import Block, blocks
from hgogen.rigor.lookup import Lookup, calls, folded
from hgogen.step import Step

SMALL_SIN, SMALL_COS, BOUNDED_SIN, BOUNDED_COS = -8, -9, -10, -11  # operations that CasADi does not have
_ANGLES = {
    ca.OP_SIN: ((SMALL, SMALL_SIN), (BOUNDED, BOUNDED_SIN)),
    ca.OP_COS: ((SMALL, SMALL_COS), (BOUNDED, BOUNDED_COS)),
}
_LARGE = 1e30  # a larger number may be infinite in single precision


class Bound(NamedTuple):
    """An interval low <= v <= high that contains the values of an expression; `number`: whether the value is never NaN
    (it may be infinite)."""

    low: float
    high: float
    number: bool

    @property
    def size(self) -> float:
        """The largest |v| in the interval."""
        return max(abs(self.low), abs(self.high))


_ANY = Bound(-inf, inf, False)
_WAVE = Bound(-1.0, 1.0, False)


def operations(function: ca.Function) -> list[int]:
    """Return the operation code of each instruction of an SX function: CasADi's, or one of this file for sine and
    cosine of a bounded angle."""
    codes = [function.instruction_id(k) for k in range(function.n_instructions())]
    if _ANGLES.keys().isdisjoint(codes):
        return codes
    bounds, result = dict[int, Bound](), list[int]()
    for k, op in enumerate(codes):
        known = op in _BOUNDS or op in _ANGLES
        operands = [bounds[place] for place in function.instruction_input(k)] if known else []
        result.append(next((code for limit, code in _ANGLES.get(op, ()) if operands[0].size <= limit), op))
        value = function.instruction_constant(k) if op == ca.OP_CONST else inf
        if abs(value) < inf:
            bound = Bound(value, value, True)
        elif op in _BOUNDS:
            bound = _BOUNDS[op](*operands)
        else:
            bound = _WAVE if op in _ANGLES else _ANY
        if op != ca.OP_OUTPUT:  # its output is no place of work
            bounds |= dict.fromkeys(function.instruction_output(k), bound)
    return result


def _number(a: Bound, b: Bound) -> bool:
    """Return whether a sum, difference or product of values in
    `a` and `b` is never NaN: no operand may be infinite."""
    return a.number and b.number and max(a.size, b.size) < _LARGE


def _product(a: Bound, b: Bound) -> Bound:
    if max(a.size, b.size) == inf:
        return _ANY
    ends = [x * y for x in a[:2] for y in b[:2]]
    return Bound(min(ends), max(ends), _number(a, b))


def _smaller(a: Bound, b: Bound) -> Bound:
    return Bound(min(a.low, b.low), min(a.high, b.high) if a.number else b.high, b.number)


def _larger(a: Bound, b: Bound) -> Bound:
    return Bound(max(a.low, b.low) if a.number else b.low, max(a.high, b.high), b.number)


_BOUNDS: Mapping[int, Callable[..., Bound]] = {
    ca.OP_ADD: lambda a, b: Bound(a.low + b.low, a.high + b.high, _number(a, b)),
    ca.OP_SUB: lambda a, b: Bound(a.low - b.high, a.high - b.low, _number(a, b)),
    ca.OP_MUL: _product,
    ca.OP_DIV: lambda a, b: _ANY if b.low <= 0 <= b.high else _product(a, Bound(1 / b.high, 1 / b.low, b.number)),
    ca.OP_NEG: lambda a: Bound(-a.high, -a.low, a.number),
    ca.OP_TWICE: lambda a: Bound(2 * a.low, 2 * a.high, a.number),
    ca.OP_SQ: lambda a: _product(a, a),
    ca.OP_FMIN: _smaller,
    ca.OP_FMAX: _larger,
}


INFIX: dict[int, tuple[str, float]] = {
    ca.OP_ADD: (" + ", SUM),
    ca.OP_SUB: (" - ", SUM),
    ca.OP_MUL: ("*", PRODUCT),
    ca.OP_DIV: ("/", PRODUCT),
    ca.OP_LT: (" < ", ORDER),
    ca.OP_LE: (" <= ", ORDER),
    ca.OP_EQ: (" == ", EQUAL),
    ca.OP_NE: (" != ", EQUAL),
}
LOGIC: dict[int, float] = {ca.OP_AND: AND, ca.OP_OR: OR}  # the signs depend on the language
CALLS: dict[int, str] = {
    ca.OP_FABS: "abs",
    ca.OP_FMIN: "min",
    ca.OP_FMAX: "max",
    ca.OP_FLOOR: "floor",
    ca.OP_SIGN: "sign",
    ca.OP_SQRT: "sqrt",
    ca.OP_EXP: "exp",
    ca.OP_LOG: "log",
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    BOUNDED_SIN: "bounded_sin",
    BOUNDED_COS: "bounded_cos",
    SMALL_SIN: "small_sin",
    SMALL_COS: "small_cos",
    ca.OP_TAN: "tan",
    ca.OP_ASIN: "asin",
    ca.OP_ACOS: "acos",
    ca.OP_ATAN: "atan",
    ca.OP_ATAN2: "atan2",
    ca.OP_SINH: "sinh",
    ca.OP_COSH: "cosh",
    ca.OP_TANH: "tanh",
    ca.OP_ASINH: "asinh",
    ca.OP_ACOSH: "acosh",
    ca.OP_ATANH: "atanh",
    ca.OP_POW: "pow",
    ca.OP_CONSTPOW: "pow",
    ca.OP_EXPM1: "expm1",
    ca.OP_LOG1P: "log1p",
    ca.OP_HYPOT: "hypot",
}


@dataclass(eq=False, slots=True)
class Node:
    """A value in an expression graph: the operation `op` (a CasADi code, or one of this file) applied to the nodes
    `args`."""

    op: int
    args: tuple["Node", ...] = ()
    constant: float = 0.0
    source: tuple[int, int] = (0, 0)  # of an input: argument, element
    uses: int = 0
    name: str = ""
    lookup: Lookup | None = None  # of a call
    routine: Routine | None = None  # of a call
    element: tuple[int, int] = (0, 0)  # of a result of a routine: its number, element
    labels: dict[int, str] = field(default_factory=dict)  # of a call of a routine: the names of its results
    passed: tuple[tuple["Node", ...], ...] = ()  # of a call of a routine: the values of each argument
    count: int = 0  # the passes of the loop that computes it
    step: int = 0  # of `source` or `element` from one pass of a loop to the next
    inside: bool = False  # whether it differs between the passes of a loop
    fold: int = 0  # the operation by which a loop accumulates it
    table: tuple[float, ...] = ()


_PAIRED = {ca.OP_OR: ca.OP_LT, ca.OP_AND: ca.OP_LE}
_BOOLEAN = {ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR}
CLAMP, WITHIN, CHOOSE, KEEP = -1, -2, -3, -4
_CHOICES = (CHOOSE, ca.OP_IF_ELSE_ZERO)
ELEMENT = -5  # of a result of a routine, or of an array
NEAREST = -6  # the whole number nearest to one
ARRAY = -7  # a whole argument, which a call passes as an array
POWER_OF_TWO = -12
FILL = -21  # an array that a loop fills; the argument is an element
FOLD = -22  # the result of a loop that accumulates; the arguments are the first value and a term
AT = -23  # the element in a pass of a loop, of an input, or of the array that is the argument
TABLE = -24  # an array of numbers
_PRIMITIVES = {elementary.NEAREST: NEAREST, elementary.POWER_OF_TWO: POWER_OF_TWO}
INSIDE, OUTSIDE = -13, -14  # of an interval
_TESTS = (WITHIN, INSIDE, OUTSIDE)
PATTERNS: dict[int, str] = {CLAMP: "clamp", WITHIN: "within", KEEP: "keep"}  # names of small functions
PATTERNS |= {INSIDE: "inside", OUTSIDE: "outside"}
PATTERNS |= {op: name for name, op in _PRIMITIVES.items()}


def read(function: ca.Function, intervals: bool = False) -> list[list[Node]]:
    """Return the expression graph of an SX function: for each output the list of its elements as nodes. `intervals`:
    whether a test low <= v <= high is one node."""
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
    for node in (each for each in nodes if each.op == ca.OP_IF_ELSE_ZERO):
        test, value = node.args
        if test.op == WITHIN and value.op == CLAMP and test.args[0] is value.args[0]:
            node.op, node.args = KEEP, (*value.args, Node(ca.OP_CONST), test.args[1])
    if any(node.op in _CHOICES for node in nodes):
        _decide(outputs)
    return outputs


def _decide(outputs: list[list[Node]]) -> None:
    """Replace each choice in a branch of another choice by the one of its branches that is taken there, where the outer
    test decides it. A node with several uses stays as it is, since one of these may be outside the branch."""
    known: dict[Node, dict[Node, bool]] = {node: {} for node in chain(*outputs)}  # the decided tests of each used node
    for node in reversed(ordered(known)):
        if node not in known:
            continue
        around = [known[node]] * len(node.args)
        if node.op in _CHOICES:
            around[1:] = [around[0] | _implied(node.args[0], branch == 1) for branch in range(1, len(node.args))]
        node.args = tuple(map(_reduced, node.args, around))
        for arg, tests in zip(node.args, around, strict=True):
            known[arg] = {} if arg in known else tests


def _reduced(node: Node, tests: Mapping[Node, bool]) -> Node:
    """Return the innermost part of a node that equals the node where `tests` have these values."""
    while part := _equal_part(node, tests):
        node = part
    return node


def _equal_part(node: Node, tests: Mapping[Node, bool]) -> Node | None:
    """Return the part of a node that equals the node where `tests` have these values, or None: the branch of a choice
    that is taken, or the undecided operand of `and`, `or`."""
    if node.op in _CHOICES and (value := _decided(node.args[0], tests)) is not None:
        return (*node.args, Node(ca.OP_CONST))[1 if value else 2]
    if node.op in LOGIC:
        values = (_decided(arg, tests) for arg in node.args)
        args = (
            arg if value is None else Node(ca.OP_CONST, constant=float(value))
            for arg, value in zip(node.args, values, strict=True)
        )
        return _neutral(node.op, tuple(args))
    return None


def _decided(test: Node, tests: Mapping[Node, bool]) -> bool | None:
    """Return the value of a test where those of `tests` are known, None where it does not follow."""
    if test.op == ca.OP_NOT:
        opposite = _decided(test.args[0], tests)
        return None if opposite is None else not opposite
    return tests.get(test)


def _implied(test: Node, value: bool) -> dict[Node, bool]:
    """Return the values of tests that follow from that of `test`: of its opposite, and of each test in an `and` that
    holds or in an `or` that does not."""
    if test.op == ca.OP_NOT:
        return _implied(test.args[0], not value)
    parts = test.args if test.op == (ca.OP_AND if value else ca.OP_OR) else ()
    return {test: value} | {each: decided for part in parts for each, decided in _implied(part, value).items()}


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
    """Yield for each argument of a call of a routine the `Argument` and the nodes of its elements."""
    assert call.routine
    elements = iter(call.args)
    return ((argument, list(islice(elements, argument.size))) for argument in call.routine.arguments)


def ordered(roots: Iterable[Node]) -> list[Node]:
    """Return every node of the graphs with these `roots` once, each after its operands."""
    done: dict[Node, None] = {}
    stack = list(roots)[::-1]
    while stack:
        missing = [child for child in stack[-1].args if child not in done]
        if missing:
            stack += missing[::-1]
        else:
            done[stack.pop()] = None
    return list(done)


def _node(op: int, args: tuple[Node, ...], intervals: bool) -> Node:
    if (same := _neutral(op, args)) is not None:
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


def _neutral(op: int, args: tuple[Node, ...]) -> Node | None:
    """Return the one of `args` that equals the result of `op`, or None: for `and`, `or` of a truth value with itself or
    with a neutral constant."""
    if op in (ca.OP_AND, ca.OP_OR):
        for one, other in (args, args[::-1]):
            idle = other.op == ca.OP_CONST and bool(other.constant) == (op == ca.OP_AND)
            if boolean(one) and (other is one or idle):
                return one
    return None


def _by_size(op: int, args: tuple[Node, ...], intervals: bool) -> Node | None:
    """Return a simpler node for a comparison with constants, or None: v < -b
    or b < v becomes b < |v|, and -b <= v and v <= b becomes |v| <= b;
    with two other constants it becomes a test of the interval."""
    (a, b), (c, d) = (arg.args for arg in args)
    v, low, high, w = (a, b, c, d) if op == ca.OP_OR else (b, a, d, c)
    if v is not w or {low.op, high.op} - {ca.OP_CONST, AT, ca.OP_NEG}:
        return None
    if not opposite(low, high):
        constant = intervals and low.op == high.op == ca.OP_CONST
        return Node(INSIDE if op == ca.OP_AND else OUTSIDE, (v, low, high)) if constant else None
    return Node(WITHIN, (v, high)) if op == ca.OP_AND else Node(ca.OP_LT, (high, Node(ca.OP_FABS, (v,))))


def opposite(low: Node, high: Node) -> bool:
    """Return whether two nodes are constants -b and b with b > 0, or tables of such constants."""
    if high.op == AT and low.op == ca.OP_NEG:
        return low.args[0] is high and high.args[0].op == TABLE and min(high.args[0].table) > 0
    return low.op == high.op == ca.OP_CONST and -low.constant == high.constant > 0


def negative(node: Node) -> bool:
    """Return whether a node is a negative constant, or a product with a negative constant first: then v + node is
    printed as v - .."""
    if node.op == ca.OP_MUL and not node.name:
        return negative(node.args[0])
    return node.op == ca.OP_CONST and node.constant < 0


def negated(node: Node) -> Node:
    """Return the node of -v, v a negative constant or a product with a negative constant first."""
    if node.op == ca.OP_CONST:
        return Node(ca.OP_CONST, constant=-node.constant)
    return Node(node.op, (negated(node.args[0]), node.args[1]))


def boolean(node: Node) -> bool:
    """Return whether the value of a node is a truth value."""
    return node.op in _BOOLEAN or node.op in _TESTS or (node.op == FOLD and node.fold in _BOOLEAN)


REGISTERS = 8  # for numbers passed in a call on x86-64; a Cortex-M4F has 16


@dataclass(frozen=True)
class Passed:
    """An argument of an emitted routine as calls pass it: its `number` in the routine's argument list and the passed
    `elements`, by value or as an array."""

    number: int
    argument: Argument
    elements: tuple[int, ...]
    by_value: bool

    @property
    def names(self) -> list[str]:
        """The names of the C parameters through which the argument is passed."""
        return [self.argument.local(k) for k in self.elements] if self.by_value else [self.argument.label]


@dataclass(frozen=True, eq=False)
class Subprogram:
    """A routine that a step calls: its name in C without the prefix, and the arguments that every call passes."""

    routine: Routine
    name: str
    passed: tuple[Passed, ...]

    @property
    def reads_parameters(self) -> bool:
        """Whether the routine reads the struct of parameters."""
        return len(self.passed) < len(self.routine.arguments)

    def columns(self, call: Node) -> Iterator[tuple[Passed, list[Node]]]:
        """Yield, for each passed argument of a call of this routine, the argument and the nodes of its elements."""
        arguments = list(columns(call))
        return ((each, [arguments[each.number][1][k] for k in each.elements]) for each in self.passed)


@lru_cache(maxsize=8)  # every printer of a step calls it
def subprograms(step: Step) -> dict[str, Subprogram]:
    """Return the routines that a step calls by their keys, in the order of their first calls."""
    routines: dict[str, Routine] = {}
    moving: dict[str, set[Argument]] = {}
    for block, call in _calls(step):
        assert call.routine
        routine = routines.setdefault(call.routine.key, call.routine)
        others = (argument for argument, column in columns(call) if not _lies(block, argument, column))
        moving.setdefault(routine.key, set()).update(others)
    return {
        key: Subprogram(routine, name, _passed(routine, moving[key]))
        for (key, routine), name in zip(routines.items(), _distinct(routines), strict=True)
    }


def _passed(routine: Routine, moving: set[Argument]) -> tuple[Passed, ...]:
    read = [(k, argument, routine.elements(k)) for k, argument in enumerate(routine.arguments) if argument in moving]
    few = sum(len(elements) for _, _, elements in read) <= REGISTERS
    return tuple(
        Passed(k, argument, elements if few else tuple(range(argument.size)), few or argument.size == 1)
        for k, argument, elements in read
    )


def _distinct(routines: dict[str, Routine]) -> list[str]:
    names = [routine.name for routine in routines.values()]
    before = [names[:k].count(name) for k, name in enumerate(names)]
    return [f"{name}_{count + 1}" if count else name for name, count in zip(names, before, strict=True)]


def _calls(step: Step) -> Iterator[tuple[Block, Node]]:
    reports = (report.program for report in step.code.reports)
    programs = (*(section.program for section in step.code.called), step.code.estimate, *reports, step.code.tuning)
    for block in (each for program in programs for each in blocks(program)):
        if calls(block.graph):
            nodes = ordered(node for output in read(block.graph) for node in output)
            yield from ((block, node) for node in nodes if node.routine)


def _lies(block: Block, argument: Argument, column: list[Node]) -> bool:
    if argument.place is None or reached([argument.place]) != {"p"}:
        return False
    sources = [node.source for node in column if node.op == ca.OP_INPUT]
    return len(sources) == argument.size and all(
        block.reads[k] == (argument.place, argument.size) and element == i for i, (k, element) in enumerate(sources)
    )
