"""Sensors of different rates: what a step that counts its periods adds to its sections.

`state.now` counts the calls of `predict` modulo 65536, the first one is number 0. A sample of output y may come with
the number of the period in which it was taken, `update_y_at`: one of an earlier period is late, one of a period that
`predict` has not reached is early; neither is used, and the status says which. The difference is taken modulo 65536,
so the count may wrap round: up to 32768 periods back count as late, more as early. Before the first `predict` every
sample is early. A second sample of y in one period and a second `adapt` do nothing but say so. The noise R of an output
is taken for its own period, a whole multiple of dt.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import casadi as ca

from hgogen.errors import BadArgument
from hgogen.program import Block, Call, Field, Place, Program, Section, When, scalar, sym
from hgogen.signal import Signal, plural
from hgogen.system import System

ROUND = 1 << 16  # periods after which the count begins again: what the smallest `unsigned` of C holds
OLDEST = ROUND // 2  # periods back that still count as late
AT = Place("argument", "at")  # the place of the number of the period in which a sample was taken


class BadRate(BadArgument):
    """A sensor's period that cannot be used."""


def multiples(periods: Any, plant: System, dt: float) -> tuple[int, ...]:
    """The number of dt between two samples of each output; 1 for an output that `periods` (by name) does not name.

    Raises: `BadRate`.
    """
    names = [signal.name for signal in plant.outputs]
    if not isinstance(periods, Mapping):
        fix = f"must name outputs with their sampling periods in {plural(plant.time)}"
        raise BadRate(f"periods = {periods!r}", fix)
    for name in periods:
        if name not in names:
            raise BadRate(f"periods names {name!r},", f"which is no output; the outputs are {', '.join(names)}")
    counts = []
    for name in names:
        period = periods.get(name, dt)
        what = f"the period {name} = {period!r}"
        if isinstance(period, bool) or not isinstance(period, int | float) or not 0 < period < float("inf"):
            raise BadRate(what, f"must be a positive time in {plural(plant.time)}")
        count = max(1, round(period / dt))
        if abs(count * dt - period) > 1e-9 * period:
            raise BadRate(what, f"is no whole multiple of dt = {dt:g}; take {count * dt:.6g}, or another dt")
        counts.append(count)
    return tuple(counts)


def fields(outputs: tuple[Signal, ...], adapts: bool) -> tuple[Field, ...]:
    """What the step remembers of time; `adapts`: whether it has an `adapt`."""
    adapted = scalar("adapted", 0, kind="index", high=1, meaning="1 when adapt was called now")
    used = (scalar(_used(s), 0, kind="index", high=1, meaning=f"1 when a sample of {s} was used now") for s in outputs)
    return (
        scalar("now", 0, kind="index", high=ROUND - 1, meaning=f"number of this period, modulo {ROUND}"),
        *([adapted] if adapts else ()),
        *used,
    )


def _used(output: Signal) -> str:
    return f"used_{output}"


def tick(outputs: tuple[Signal, ...], adapts: bool) -> Block:
    """The next period, before the first call's flag is raised."""
    now = sym("state", "now")
    after = ca.if_else(now >= ROUND - 1, 0, now + 1)
    fresh = {Place("state", name): ca.SX(0) for name in (*["adapted"] * adapts, *map(_used, outputs))}
    later = ca.if_else(sym("state", "calls") >= 1, after, now)
    return Block("the next period", {Place("state", "now"): later, **fresh})


def once(output: Signal, correct: Program) -> Program:
    """An update by one output, once a period, none before the first; `correct` ends with what a valid sample does."""
    used, begun = sym("state", _used(output)), sym("state", "calls") >= 1
    test = {
        Place("work", "fresh"): ca.logic_and(used < 1, begun),
        Place("status", f"REPEATED_{output}"): used >= 1,
        Place("status", f"EARLY_{output}"): ca.logic_not(begun),
    }
    return (Block(f"one sample of {output} a period", test), When(Place("work", "fresh"), correct))


def order_fields(outputs: Iterable[Signal]) -> tuple[Field, ...]:
    """What a step remembers whose sections may be called one by one: whether a sample of an output is still to come
    since predict was called."""
    meaning = "1 from a sample of {} that was used until the next predict"
    return tuple(scalar(_used(s), 1, kind="index", high=1, meaning=meaning.format(s)) for s in outputs)


def awaited(outputs: Iterable[Signal]) -> tuple[Block, ...]:
    """After a predict samples may come."""
    fresh = {Place("state", _used(output)): ca.SX(0) for output in outputs}
    return (Block("samples may come", fresh),) if fresh else ()


def in_order(output: Signal, correct: Program) -> Program:
    """An update by one output, once after a predict; `correct` ends with what a valid sample does."""
    fresh = {Place("work", "fresh"): sym("state", _used(output)) < 1}
    raised = Block("there was no predict since the last", {Place("status", "OUT_OF_ORDER"): ca.SX(1)})
    return (Block(f"is a sample of {output} awaited?", fresh), When(Place("work", "fresh"), correct, (raised,)))


def use(output: Signal) -> Block:
    """What a valid sample leaves."""
    return Block(f"{output} is used", {Place("state", _used(output)): ca.SX(1)})


def adapt_once(program: Program) -> Program:
    """Adaptation, once a period."""
    done = sym("state", "adapted")
    test = {Place("work", "fresh"): done < 1, Place("status", "ADAPTED"): done >= 1}
    mark = Block("adapted", {Place("state", "adapted"): ca.SX(1)})
    return (Block("one adaptation a period", test), When(Place("work", "fresh"), (*program, mark)))


def timed(section: Section, output: Signal) -> Section:
    """The update section of an output for a sample that says when it was taken."""
    now, at = sym("state", "now"), sym(*AT)
    age = ca.if_else(now >= at, now - at, ROUND - 1 - at + now + 1)
    test = {
        Place("work", "timely"): age < 1,
        Place("status", f"LATE_{output}"): ca.logic_and(age >= 1, age <= OLDEST),
        Place("status", f"EARLY_{output}"): age > OLDEST,
    }
    program = (Block("is the sample of now?", test), When(Place("work", "timely"), (Call(section),)))
    return replace(section, name=f"{section.name}_at", meaning=f"{section.meaning} of period `at`", program=program)
