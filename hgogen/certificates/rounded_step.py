"""How far one call of a step's program is from exact arithmetic, on a set of states, samples and inputs.

The statements are those that the method makes of the observer, which every language prints, in their order; what guards
do beside is left out. What a step remembers, samples and inputs are numbers of the working precision, the same in both;
gains, parameters, constants and what `tune` computes of them are rounded.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import islice
from typing import Any

import casadi as ca

from hgogen.algebra.lookup import Lookup, called, instructions
from hgogen.intervals.computed import Computed, Real, Rounding, Unsure, exactly
from hgogen.part import Clock, Ode
from hgogen.program import Block, Place, Program, Repeat, Statement
from hgogen.step import Step

Memory = dict[Place, list[Computed]]


def rounding_errors(step: Step, real: Real, held: Sequence[Any], y: Sequence[Any], u: Sequence[Any]) -> list[Any]:
    """By element of the observer's fields (N), how far a call leaves it from what exact arithmetic makes of the same:
    of fields in the balls `held` (N), samples in `y` (p), now and at the last call, and inputs in `u` (m).

    Raises: `Unsure`.
    """
    (part,) = step.observer.parts
    if not isinstance(part, Ode) or step.periods != (step.dt,) * len(y) or step.observer.delays:
        raise Unsure("an observer that is more than one differential equation, or samples that are not of every call")
    rounding, fields = Rounding(real), part.fields
    clock = Clock(step.dt, step.between, len(u), len(y), (), step.guards == "all", step.prefer)
    pieces = step.method.ode(part, clock)
    rest = iter(map(exactly, held))
    memory: Memory = {Place("state", field.name): list(islice(rest, field.size)) for field in fields}
    memory |= {Place("work", name): list(map(exactly, y)) for name in ("y", "y_last")}
    memory |= {Place(struct, "u"): list(map(exactly, u)) for struct in ("state", "work")}
    memory[Place("work", "valid")] = [exactly(1)] * len(y)
    for struct, numbers in (("plant", step.plant), ("gain", step.gains)):
        memory |= {Place(struct, each.name): list(map(rounding.constant, each.initial)) for each in numbers}
    _run(rounding, (*pieces.tune, *pieces.predict), memory)
    return [each.error for field in fields for each in memory[Place("state", field.name)]]


def _run(rounding: Rounding, program: Program, memory: Memory) -> None:
    """Raises: `Unsure`."""
    for statement in _plain(program):
        if not isinstance(statement, Block):
            raise Unsure("a loop or a matrix operation")
        arguments = [memory[place] for place, _ in statement.reads]
        memory |= zip(statement.writes, _outputs(rounding, statement.graph, arguments), strict=False)


def _plain(program: Iterable[Statement]) -> Iterable[Statement]:
    """The statements one after the other."""
    for statement in program:
        yield from _plain(statement.unrolled) if isinstance(statement, Repeat) else (statement,)


def _outputs(rounding: Rounding, graph: Any, arguments: Sequence[Sequence[Computed]]) -> list[list[Computed]]:
    """The outputs of an SX function. Raises: `Unsure`."""
    slots: dict[int, Computed] = {}
    outputs = [[exactly(0)] * graph.nnz_out(i) for i in range(graph.n_out())]
    for op, take, give, more in _instructions(graph):
        if op == ca.OP_INPUT:
            slots[give[0]] = arguments[take[0]][take[1]]
        elif op == ca.OP_OUTPUT:
            outputs[give[0]][give[1]] = slots[take[0]]
        elif op == ca.OP_CONST:
            slots[give[0]] = rounding.constant(more)
        elif op == ca.OP_CALL:
            results = _called(rounding, more, [slots[i] for i in take])
            slots |= zip(give, results, strict=True)
        else:
            slots[give[0]] = rounding.apply(op, [slots[i] for i in take])
    return outputs


def _called(rounding: Rounding, function: Any, values: Sequence[Computed]) -> list[Computed]:
    """Raises: `Unsure`."""
    if isinstance(function, Lookup):
        raise Unsure("a table")
    rest = iter(values)
    columns = [list(islice(rest, function.nnz_in(k))) for k in range(function.n_in())]
    return [value for column in _outputs(rounding, function, columns) for value in column]


@lru_cache(maxsize=256)
def _instructions(graph: Any) -> list[tuple[int, list[int], list[int], Any]]:
    """(operation, what it takes, what it gives, its constant or what it calls) of each instruction."""
    rows, texts = [], instructions(graph)
    more: Mapping[int, Callable[[int], Any]] = {
        ca.OP_CONST: lambda k: float(graph.instruction_constant(k)),
        ca.OP_CALL: lambda k: called(texts[k]),
    }
    for k in range(graph.n_instructions()):
        op = graph.instruction_id(k)
        extra = more[op](k) if op in more else None
        rows.append((op, list(graph.instruction_input(k)), list(graph.instruction_output(k)), extra))
    return rows
