"""What a call of a step costs: its operations, and the bytes of its memory.

Every section runs, a `When` takes its longer branch, a loop all its members. An operation is one of the program's
instructions: an addition, a product, a comparison, a choice; a function (sine, root, table, ..) is one beside
them.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from hgogen.algebra.lookup import called, instructions
from hgogen.discretisation.kernels import KERNELS
from hgogen.emit.layout import params_type, state_type
from hgogen.emit.operations import CALLS
from hgogen.emit.syntax import Real
from hgogen.program import Block, Call, Kernel, Loop, Statement, When
from hgogen.step import Step

_FREE = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_PARAMETER, ca.OP_ASSIGN)
_CHEAP = (ca.OP_FABS, ca.OP_FMIN, ca.OP_FMAX, ca.OP_FLOOR, ca.OP_SIGN)  # calls in C, one instruction on a processor
_FUNCTIONS = frozenset(CALLS) - {*_CHEAP} | {ca.OP_CALL}


@dataclass(frozen=True)
class Cost:
    """Of one call: `operations`, `functions`; bytes of the structs `state` and `params` in C."""

    operations: int
    functions: int
    state: int
    params: int


def cost(step: Step, real: Real = "float") -> Cost:
    """The cost of a call of the step in the working precision `real`."""
    operations, functions = _program(step.program)
    return Cost(operations, functions, state_type(step, real).itemsize, params_type(step, real).itemsize)


Pair = tuple[int, int]  # operations, functions


def _program(program: Sequence[Statement]) -> Pair:
    pairs = [_statement(statement) for statement in program]
    return sum(pair[0] for pair in pairs), sum(pair[1] for pair in pairs)


def _statement(statement: Statement) -> Pair:
    if isinstance(statement, Block):
        return _block(statement.graph)
    if isinstance(statement, Loop):
        operations, functions = _program(statement.body)
        return statement.count * operations, statement.count * functions
    if isinstance(statement, When):
        return max(_program(statement.body), _program(statement.otherwise))
    if isinstance(statement, Call):
        return _program(statement.section.program)
    return _kernel(statement) if isinstance(statement, Kernel) else (0, 0)


def _block(graph: ca.Function) -> Pair:
    """Of a graph, and of the routines that it calls."""
    times = Counter(graph.instruction_id(k) for k in range(graph.n_instructions()))
    calls = [called(each) for each in instructions(graph) if each.is_call()]
    inner = [_block(function) for function in calls if isinstance(function, ca.Function)]
    functions = sum(count for op, count in times.items() if op in _FUNCTIONS) - len(inner)
    operations = sum(count for op, count in times.items() if op not in _FREE) - functions - len(inner)
    return operations + sum(pair[0] for pair in inner), functions + sum(pair[1] for pair in inner)


def _kernel(kernel: Kernel) -> Pair:
    """By running it on numbers that count what is done to them."""
    done: Counter[str] = Counter()

    def counted(*shape: int) -> np.ndarray:
        return np.array([_Counted(done) for _ in range(math.prod(shape))], dtype=object).reshape(shape)

    columns = [counted(kernel.size, kernel.size)] if kernel.columns else []
    KERNELS[kernel.name](*columns, *(counted(size) for _, size in kernel.arguments), *kernel.counts)
    return done["operation"], done["function"]


class _Counted:
    """A number without a value, which is larger than any other, so that what is conditional is counted."""

    def __init__(self, done: Counter[str]) -> None:
        self.done = done

    def _operation(self, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return NotImplemented  # numpy then asks element by element
        self.done["operation"] += 1
        return self

    def __gt__(self, _: Any) -> bool:
        self.done["operation"] += 1
        return True

    def __le__(self, _: Any) -> bool:
        self.done["operation"] += 1
        return False

    def sqrt(self) -> "_Counted":
        """numpy's square root of an object."""
        self.done["function"] += 1
        return self

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __rtruediv__ = _operation
