"""The routines of a step as functions of its emitted code: their names, and what each is passed.

What a routine reads of the parameters it reads through the struct of parameters, where every call means that place; in
a bank, whose members have parameters of their own, it is passed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca

from hgogen.discretisation.runge_kutta import Argument, Routine
from hgogen.emit.interface import reached
from hgogen.emit.node import Node, columns, ordered, read
from hgogen.program import Block, blocks
from hgogen.rigor.lookup import calls
from hgogen.step import Step

REGISTERS = 8  # that take numbers in a call on x86-64; a Cortex-M4F has 16


@dataclass(frozen=True)
class Passed:
    """An argument as calls pass it: number `number` of the routine's, these elements of it one by one, or the array."""

    number: int
    argument: Argument
    elements: tuple[int, ...]
    by_value: bool

    @property
    def names(self) -> list[str]:
        """The parameters that carry it."""
        return [self.argument.local(k) for k in self.elements] if self.by_value else [self.argument.label]


@dataclass(frozen=True, eq=False)
class Subprogram:
    """A routine, its name in emitted code without the prefix, and what of its arguments is passed."""

    routine: Routine
    name: str
    passed: tuple[Passed, ...]

    @property
    def reads_parameters(self) -> bool:
        """Whether it is given the struct of parameters."""
        return len(self.passed) < len(self.routine.arguments)

    def columns(self, call: Node) -> Iterator[tuple[Passed, list[Node]]]:
        """The arguments of a call, element by element."""
        every = list(columns(call))
        return ((each, [every[each.number][1][k] for k in each.elements]) for each in self.passed)


@lru_cache(maxsize=8)  # which each printer of a step asks for
def subprograms(step: Step) -> dict[str, Subprogram]:
    """The routines that a step calls, by their keys, in the order of the first calls."""
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
    """The form in which these arguments of a routine are passed: few numbers by value, else columns as arrays."""
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
    """Every call of a routine, with the block that it stands in."""
    programs = (*(section.program for section in step.code.called), step.code.estimate, step.code.tuning)
    for block in (each for program in programs for each in blocks(program)):
        if calls(block.graph):
            nodes = ordered(node for output in read(block.graph) for node in output)
            yield from ((block, node) for node in nodes if node.routine)


def _lies(block: Block, argument: Argument, column: list[Node]) -> bool:
    """Whether a call gives for an argument the parameter that the routine was written with."""
    if argument.place is None or reached([argument.place]) != {"p"}:
        return False
    sources = [node.source for node in column if node.op == ca.OP_INPUT]
    return len(sources) == argument.size and all(
        block.reads[k] == (argument.place, argument.size) and element == i for i, (k, element) in enumerate(sources)
    )
