"""What stands in the place of guards in a step without: signals as they come, every sample used, and a status of 0."""

from collections.abc import Sequence
from dataclasses import replace

from hgogen.observer import Observer
from hgogen.part import Clock
from hgogen.program import Block, Loop, Place, Program, Repeat, Statement, When, column, sym


def inputs(observer: Observer) -> Block:
    """The input now."""
    values = column(sym("input", signal.name) for signal in observer.form.system.inputs)
    return Block("the input", {Place("work", "u"): values})


def outputs(observer: Observer, clock: Clock) -> Block:
    """All samples at once for a part that integrates with the measurement: y now, y at the last call."""
    now = column(sym("output", signal.name) for signal in observer.form.system.outputs)
    return Block("the samples", {Place("work", "y"): now, Place("work", "y_last"): sym("state", "y", clock.outputs)})


def sample(observer: Observer, clock: Clock, j: int) -> Block:
    """The sample of output j and its innovation."""
    signal = observer.form.system.outputs[j]
    raw = sym("output", signal.name)
    error = raw - observer.dynamics.output(observer.z, clock.u_now)[j]
    values = {"measurement": raw, "e": error}
    return Block(f"the sample of {signal}", {Place("work", name): value for name, value in values.items()})


def silent(program: Sequence[Statement]) -> Program:
    """The program without what it says in the status, and without statements that do nothing else."""
    return tuple(statement for each in program for statement in _silent(each))


def _silent(statement: Statement) -> Program:
    if isinstance(statement, Block):
        writes = {place: value for place, value in statement.writes.items() if place.struct != "status"}
        if len(writes) == len(statement.writes):
            return (statement,)
        return (replace(statement, writes=writes),) * bool(writes)
    if isinstance(statement, When):
        body, otherwise = silent(statement.body), silent(statement.otherwise)
        return (replace(statement, body=body, otherwise=otherwise),) * bool(body or otherwise)
    if isinstance(statement, Loop | Repeat):
        return (replace(statement, body=body),) if (body := silent(statement.body)) else ()
    return (statement,)
