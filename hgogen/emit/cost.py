"""The cost of a call of a step: its operations, and the bytes of its memory.

A call of a function (sine, root, table, ..) is counted apart from the operations of `discretisation.kernel_graphs`.
"""

from collections import Counter
from dataclasses import dataclass
from typing import Annotated

import casadi as ca

from hgogen.discretisation.kernel_graphs import FUNCTION, executed_operations
from hgogen.emit.layout import params_type, state_type
from hgogen.emit.node import CALLS
from hgogen.emit.syntax import Real
from hgogen.program import Program
from hgogen.step import Step

_CHEAP = (ca.OP_FABS, ca.OP_FMIN, ca.OP_FMAX, ca.OP_FLOOR, ca.OP_SIGN)  # calls in C, one instruction on a processor
_FUNCTIONS = frozenset(CALLS) - {*_CHEAP} | {ca.OP_CALL, FUNCTION}


@dataclass(frozen=True)
class Cost:
    """The cost of one call of a step: the numbers of arithmetic operations and of function calls (sine, root ..), and
    the bytes of the state and of the parameters in C."""

    operations: Annotated[int, "operations of one call"]
    functions: Annotated[int, "functions (sine, exponential, root, ..) of one call"]
    state: Annotated[int, "bytes of the state in C"]
    params: Annotated[int, "bytes of the parameters in C"]


def cost(step: Step, real: Real = "float") -> Cost:
    """Return the cost of one call of a step in the precision `real`: operations, function calls, bytes of memory."""
    return Cost(*counted(step.code.program), state_type(step, real).itemsize, params_type(step, real).itemsize)


def counted(program: Program) -> tuple[int, int]:
    """Return the number of arithmetic operations and the number of function calls (sine, root ..) of a program."""
    times: Counter[int] = executed_operations(program)
    functions = sum(count for op, count in times.items() if op in _FUNCTIONS)
    return times.total() - functions, functions
