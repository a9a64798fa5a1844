"""An SX function as Python text: the operations of the emitted C, one a line, in the same order and precision.

Python's floats and numpy's float32 round each operation as C does (IEEE 754, no contraction), comparisons and choices
are those of the C, and the elementary functions are the graphs that the C prints. So the text computes the bits of the
C, and does not depend on this machine's mathematical library.
"""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache
from math import ldexp
from typing import Any

import casadi as ca
import numpy as np

from hgogen.discretisation.notation import bound
from hgogen.emit import helpers
from hgogen.emit.code import indented
from hgogen.emit.elementary import ALL_WHOLE, ROUNDS, elementary
from hgogen.emit.node import (
    CALLS,
    CHOOSE,
    CLAMP,
    ELEMENT,
    KEEP,
    NEAREST,
    POWER_OF_TWO,
    WITHIN,
    Node,
    boolean,
    columns,
    ordered,
    read,
)
from hgogen.emit.printer import Operand
from hgogen.emit.syntax import DTYPE, NotPrintable, Number, Real, demand_apart
from hgogen.rigor.lookup import Lookup

_SIMPLE: dict[int, str] = {
    ca.OP_ADD: "{} + {}",
    ca.OP_SUB: "{} - {}",
    ca.OP_MUL: "{} * {}",
    ca.OP_NEG: "-{}",
    ca.OP_FABS: "-{0} if {0} < 0 else {0}",
    ca.OP_FMIN: "{0} if {0} < {1} else {1}",
    ca.OP_FMAX: "{0} if {0} > {1} else {1}",
    ca.OP_SIGN: "(one if {0} > 0 else zero) - (one if {0} < 0 else zero)",
    ca.OP_FLOOR: "floor({})",
    ca.OP_LT: "{} < {}",
    ca.OP_LE: "{} <= {}",
    ca.OP_EQ: "{} == {}",
    ca.OP_NE: "{} != {}",
    WITHIN: "-{1} <= {0} <= {1}",
    NEAREST: "({} + rounds) - rounds",
    POWER_OF_TWO: "power_of_two({})",
}
_DIVIDED = "{0} / {1} if {1} else divided({0}, {1})"  # Python raises an error for a division by 0, C does not
_LOGIC: dict[int, str] = {ca.OP_NOT: "not {}", ca.OP_AND: "{} and {}", ca.OP_OR: "{} or {}"}
_COUNTED: dict[int, str] = {op: f"({_SIMPLE[op]}) & 0xFFFFFFFF" for op in (ca.OP_ADD, ca.OP_SUB, ca.OP_MUL)}
_COUNTED |= {op: _SIMPLE[op] for op in (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE)}


@dataclass
class Writer:
    """A writer of CasADi graphs as lines of Python in which every operation is rounded to the precision `real`;
    `names`: the objects to which names in the lines refer."""

    real: Real
    names: dict[str, Any] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)
    count: int = 0
    routines: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Add the helper functions (clamp, sign ..) and constants to `names`."""
        number = float if self.real == "double" else DTYPE[self.real]
        self.names |= {"inf": number("inf"), "nan": number("nan"), "zero": number(0), "one": number(1)}
        self.names |= {"rounds": number(ROUNDS[self.real])}
        small = {each.__name__: each for each in (helpers.within, helpers.whole, helpers.floor)}
        self.names |= bound(small, {"ALL_WHOLE": number(ALL_WHOLE[self.real])}, number) | {"divided": _divided}
        self.names |= {"power_of_two": lambda k: number(ldexp(1.0, int(k)))}

    def write(self, function: ca.Function, inputs: Callable[[int, int], Operand], kind: Number) -> list[list[Node]]:
        """Add the lines that compute a CasADi function, and return its outputs as nodes whose `name` is a Python name
        or literal. `inputs`: gives the operand for (argument, element); `kind`: the type of the numbers."""
        outputs = read(function)
        for node in ordered(node for output in outputs for node in output):
            if node.op == ca.OP_CONST:
                node.name = self._constant(node.constant, kind)
            elif node.op == ca.OP_INPUT:
                operand = inputs(*node.source)
                node.name = operand.text if operand.local else self.fresh(operand.text)
            else:
                node.name = self.fresh(self._text(node, kind))
        return outputs

    def number(self, node: Node, kind: Number) -> str:
        """Return the Python text of a node as a number of the type `kind`."""
        if not boolean(node):
            return node.name
        return f"(1 if {node.name} else 0)" if kind == "unsigned" else f"(one if {node.name} else zero)"

    def fresh(self, text: str) -> str:
        """Return the name of a new local variable, after adding a line that assigns the expression `text` to it."""
        self.count += 1
        self.lines.append(f"t{self.count} = {text}")
        return f"t{self.count}"

    def _text(self, node: Node, kind: Number) -> str:
        op, values = node.op, [self.number(arg, kind) for arg in node.args]
        if op in _LOGIC:
            return _LOGIC[op].format(*(arg.name for arg in node.args))
        if op in (CHOOSE, ca.OP_IF_ELSE_ZERO):
            _, yes, no = values if op == CHOOSE else (*values, self._constant(0.0, kind))
            return f"{yes} if {node.args[0].name} else {no}"
        simple = _COUNTED if kind == "unsigned" else _SIMPLE
        if op in simple:
            return simple[op].format(*values)
        if kind == "unsigned":
            raise NotPrintable(op)
        if op == ca.OP_DIV:
            return _DIVIDED.format(*values)
        if op in (CLAMP, KEEP):
            return self._clamped(*values)
        if node.lookup:
            return self._called(node.lookup.graph.name(), _table(node.lookup, self.real), values)
        if node.routine:
            return self._call(node, kind)
        if op == ELEMENT:
            return "{}[{}][{}]".format(node.args[0].name, *node.element)
        if op not in CALLS:
            raise NotPrintable(op)
        return self._called(CALLS[op], _function(CALLS[op], self.real), values)

    def _called(self, name: str, function: Callable[..., Any], values: Sequence[str]) -> str:
        self.names[name] = function
        return f"{name}({', '.join(values)})"

    def _clamped(self, value: str, low: str, high: str, otherwise: str = "", limit: str = "") -> str:
        raised = self.fresh(_SIMPLE[ca.OP_FMAX].format(value, low))
        clamped = _SIMPLE[ca.OP_FMIN].format(raised, high)
        return f"({clamped}) if {_SIMPLE[WITHIN].format(value, limit)} else {otherwise}" if otherwise else clamped

    def _call(self, node: Node, kind: Number) -> str:
        assert node.routine
        number = self.routines.setdefault(node.routine.key, len(self.routines))
        name = f"r{number}"
        if name not in self.names:
            self.names[name] = evaluated(node.routine.function, self.real)
        texts = (", ".join(self.number(each, kind) for each in column) for _, column in columns(node))
        return f"{name}(({', '.join(f'({text},)' for text in texts)},))"

    def _constant(self, value: float, kind: Number) -> str:
        if kind == "unsigned":
            return str(int(value))
        if self.real == "double":
            return repr(float(value))
        name = f"c{float(value).hex()}".translate(_PLAIN)
        self.names[name] = DTYPE[self.real](value)
        return name


_PLAIN = str.maketrans({"-": "m", "+": "p", ".": "_"})


def _divided(a: Any, b: Any) -> Any:
    """Return the quotient a / b, for b = 0 or -0 as IEEE 754 defines it."""
    with np.errstate(all="ignore"):
        quotient = np.divide(a, b)
    return float(quotient) if isinstance(a, float | int) else quotient


def defined(text: Sequence[str], names: dict[str, Any], name: str, title: str) -> Any:
    """Return the object called `name` that the lines of Python in `text` define; `names`: the global names of these
    lines; `title`: the file name in tracebacks."""
    exec(compile("\n".join(text), f"<{title}>", "exec"), names)
    return names[name]


@cache
def _function(name: str, real: Real) -> Callable[..., Any]:
    graph, writer = elementary(real)[name], Writer(real)
    (result,) = (node for (node,) in writer.write(graph, lambda argument, _: Operand(f"x{argument}"), real))
    arguments = ", ".join(f"x{k}" for k in range(graph.n_in()))
    lines = [*writer.lines, f"return {writer.number(result, real)}"]
    return defined([f"def {name}({arguments}):", *indented(lines)], writer.names, name, name)  # type: ignore[no-any-return]


@lru_cache(maxsize=1024)
def _table(lookup: Lookup, real: Real) -> Callable[..., Any]:
    demand_apart(lookup, real)
    number = float if real == "double" else DTYPE[real]
    names: dict[str, Any] = {name: [number(each) for each in numbers] for name, numbers in lookup.arrays.items()}
    lines = [line.format(**vars(axis)) for axis in lookup.axes for line in _SEARCH]
    lines += [*lookup.flattened, f"return {lookup.formula('zero')}"]
    arguments = ", ".join(axis.name for axis in lookup.axes)
    names |= {"zero": number(0), "bisect_right": bisect_right}
    return defined([f"def table({arguments}):", *indented(lines)], names, "table", lookup.name)  # type: ignore[no-any-return]


_SEARCH = (
    "{cell} = bisect_right({array}, {name}, lo=1) - 1 if {name} == {name} else 0",
    "{distance} = {name} - {array}[{cell}]",
)


@lru_cache(maxsize=4096)
def evaluated(function: ca.Function, real: Real) -> Callable[[Sequence[Any]], list[list[Any]]]:
    """Return an SX function as a Python function from lists of numbers to lists of numbers, with every operation
    rounded to `real`."""
    writer = Writer(real)

    def operand(argument: int, element: int) -> Operand:
        return Operand(f"operands[{argument}][{element}]", local=False)

    outputs = writer.write(function, operand, real)
    texts = (", ".join(writer.number(node, real) for node in output) for output in outputs)
    lines = [*writer.lines, f"return [{', '.join(f'[{text}]' for text in texts)}]"]
    return defined(["def run(operands):", *indented(lines)], writer.names, "run", function.name())  # type: ignore[no-any-return]
