"""A reader that computes the bits of the emitted C: instruction by instruction, in its precision, with its functions.

Python's floats and numpy's float32 round each operation as C does (IEEE 754, no contraction), and the elementary
functions are the graphs that the C prints, so the result does not depend on this machine's mathematical library.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from hgogen.emit.cprint import CALLS, Real
from hgogen.emit.elementary import elementary
from hgogen.program import Block
from hgogen.step import Step
from hgogen.stepping.machine import Bound, Machine

DTYPE: Mapping[str, Any] = {"float": np.float32, "double": np.float64}


def _choose(test: Any, value: Any) -> Any:
    return value if test else type(value)(0)


_OPERATIONS: dict[int, Callable[..., Any]] = {
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a / b,
    ca.OP_NEG: lambda a: -a,
    ca.OP_SQ: lambda a: a * a,
    ca.OP_TWICE: lambda a: type(a)(2) * a,
    ca.OP_INV: lambda a: type(a)(1) / a,
    ca.OP_FABS: abs,
    ca.OP_FMIN: lambda a, b: a if a < b else b,
    ca.OP_FMAX: lambda a, b: a if a > b else b,
    ca.OP_SIGN: lambda a: type(a)(int(a > 0) - int(a < 0)),
    ca.OP_FLOOR: np.floor,
    ca.OP_LT: lambda a, b: type(a)(a < b),
    ca.OP_LE: lambda a, b: type(a)(a <= b),
    ca.OP_EQ: lambda a, b: type(a)(a == b),
    ca.OP_NE: lambda a, b: type(a)(a != b),
    ca.OP_NOT: lambda a: type(a)(not a),
    ca.OP_AND: lambda a, b: type(a)(bool(a) and bool(b)),
    ca.OP_OR: lambda a, b: type(a)(bool(a) or bool(b)),
    ca.OP_IF_ELSE_ZERO: _choose,
}


def evaluate(function: Any, arguments: list[Any], real: Real) -> list[list[Any]]:
    """The outputs of an SX function at argument arrays, every operation rounded to `real`."""
    number, slots = DTYPE[real], {}
    outputs = [[number(0)] * function.numel_out(i) for i in range(function.n_out())]
    for op, take, give, constant in _instructions(function):
        if op == ca.OP_INPUT:
            slots[give[0]] = arguments[take[0]][take[1]]
        elif op == ca.OP_OUTPUT:
            outputs[give[0]][give[1]] = slots[take[0]]
        elif op == ca.OP_CONST:
            slots[give[0]] = number(constant)
        elif op in _OPERATIONS:
            slots[give[0]] = number(_OPERATIONS[op](*(slots[i] for i in take)))
        else:
            graph = elementary(real)[CALLS[op]]
            slots[give[0]] = evaluate(graph, [[slots[i]] for i in take], real)[0][0]
    return outputs


@lru_cache(maxsize=4096)
def _listing(function: Any) -> tuple[tuple[int, tuple[int, ...], tuple[int, ...], float], ...]:
    rows = []
    for k in range(function.n_instructions()):
        op = function.instruction_id(k)
        constant = function.instruction_constant(k) if op == ca.OP_CONST else 0.0
        rows.append((op, tuple(function.instruction_input(k)), tuple(function.instruction_output(k)), constant))
    return tuple(rows)


def _instructions(function: Any) -> tuple[tuple[int, tuple[int, ...], tuple[int, ...], float], ...]:
    return _listing(function)


def machine(step: Step, real: Real) -> Machine:
    """A machine that computes what the emitted C computes, bit for bit (slow: about 2 us an operation)."""

    def bind(block: Block, arguments: list[np.ndarray]) -> Bound:
        results = [np.zeros(block.graph.numel_out(i), DTYPE[real]) for i in range(len(block.writes))]

        def run() -> None:
            with np.errstate(all="ignore"):
                values = evaluate(block.graph, arguments, real)
            for array, numbers in zip(results, values, strict=False):
                array[:] = numbers

        return run, results

    return Machine(step, bind, DTYPE[real])
