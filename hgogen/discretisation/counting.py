"""Programs counted in operations: how many a period carries out, and how many the text of one holds.

Both are what a choice between two programs is made by, and `emit.cost` reports the first. An operation is one of the
program's instructions: an addition, a product, a comparison, a choice, a function.
"""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from hgogen.discretisation.kernels import KERNELS
from hgogen.program import Block, Call, Copy, Kernel, Loop, Reader, Statement, When, blocks, walk
from hgogen.rigor.lookup import called, instructions

_FREE = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_PARAMETER, ca.OP_ASSIGN)
OPERATION, FUNCTION = -1, -2  # of a kernel: an instruction, a root
KERNEL = 20  # operations that the text of a kernel is as long as


def carried_out(program: Sequence[Statement]) -> Counter[int]:
    """How often each instruction is carried out in a period, by CasADi's number of it: every section runs, a `When`
    takes its longer branch, a loop all its members."""
    return _Counting().program(program)


def written(program: Sequence[Statement]) -> int:
    """How many operations the text of a program holds, where each statement is written out."""
    kernels = sum(isinstance(statement, Kernel) for statement in walk(program))
    return sum(instructions_of(block.graph).total() for block in blocks(program)) + KERNEL * kernels


class _Counting(Reader[Counter[int]]):
    """How often each instruction is carried out."""

    def joined(self, parts: Iterable[Counter[int]]) -> Counter[int]:
        return sum(parts, Counter())

    def _block(self, block: Block) -> Counter[int]:
        return instructions_of(block.graph)

    def _loop(self, loop: Loop) -> Counter[int]:
        return Counter({op: loop.count * times for op, times in self.program(loop.body).items()})

    def _when(self, when: When) -> Counter[int]:
        return max(self.program(when.body), self.program(when.otherwise), key=Counter.total)

    def _call(self, call: Call) -> Counter[int]:
        return self.program(call.section.program)

    def _copy(self, _: Copy) -> Counter[int]:
        return Counter()

    def _kernel(self, kernel: Kernel) -> Counter[int]:
        """By running it on numbers that count what is done to them.

        An `add` counts as one update after the other, of 7 + 4 (s - 1) operations where s rows are left; two at a time,
        as they are carried out, share a few of these.
        """
        done: Counter[int] = Counter()
        if kernel.name == "add":
            return Counter({OPERATION: sum(s * (2 * s + 5) for s in range(1, kernel.size + 1))})

        def counted(*shape: int) -> np.ndarray:
            return np.array([_Counted(done) for _ in range(math.prod(shape))], dtype=object).reshape(shape)

        columns = [counted(kernel.size, kernel.size)] if kernel.columns else []
        KERNELS[kernel.name](*columns, *(counted(size) for _, size in kernel.arguments), *kernel.counts)
        return done


@lru_cache(maxsize=256)  # a routine is called at each stage, and a program is asked twice
def instructions_of(graph: ca.Function) -> Counter[int]:
    """The instructions of a graph, and of the routines that it calls, but for what costs nothing."""
    times = Counter(graph.instruction_id(k) for k in range(graph.n_instructions()))
    calls = (each for each in instructions(graph) if each.is_call())
    routines = [each for each in map(called, calls) if isinstance(each, ca.Function)]
    times[ca.OP_CALL] -= len(routines)
    times = Counter({op: count for op, count in times.items() if op not in _FREE and count})
    return sum(map(instructions_of, routines), times)


class _Counted:
    """A number without a value, which is larger than any other, so that what is conditional is counted."""

    def __init__(self, done: Counter[int]) -> None:
        self.done = done

    def _operation(self, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return NotImplemented  # numpy then asks element by element
        self.done[OPERATION] += 1
        return self

    def __gt__(self, _: Any) -> bool:
        self.done[OPERATION] += 1
        return True

    def __ge__(self, _: Any) -> bool:
        self.done[OPERATION] += 1
        return True

    def __le__(self, _: Any) -> bool:
        self.done[OPERATION] += 1
        return False

    def sqrt(self) -> "_Counted":
        """numpy's square root of an object."""
        self.done[FUNCTION] += 1
        return self

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __rtruediv__ = _operation
