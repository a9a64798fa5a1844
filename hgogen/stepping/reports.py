"""Reports: functions of a step by which a caller reads how sure the estimate is, each only where `sample` names it.

    age   calls of predict since the last used sample of each output: 0 where this call used one, `OLDEST` for as many
          or more, and before the first

An age counts the calls up to the period of the sample's measurement, also of a late sample. A restart of the estimate
changes no age; a reset does.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import casadi as ca

from hgogen.observer import Observer
from hgogen.program import Block, Field, Place, Program, Report, When, scalar, sym
from hgogen.reading.given import BadGain, names
from hgogen.signal import Signal

OLDEST = (1 << 16) - 1  # the largest number of the smallest `unsigned` of C
REPORTS = ("age",)


def demand_reports(report: Any) -> tuple[str, ...]:
    """Return the names of reports in the order of `REPORTS`. Raises: `BadGain` for another name."""
    wanted = names("report", report)
    for name in wanted:
        if name not in REPORTS:
            raise BadGain(f"report {name!r}", f"is none; the reports are {', '.join(REPORTS)}")
    return tuple(name for name in REPORTS if name in wanted)


def reports(observer: Observer, wanted: Iterable[str]) -> tuple[Report, ...]:
    """Return the reports of these names."""
    makers = {"age": _ages}
    return tuple(makers[name](observer) for name in wanted)


# --- age


def age_fields(outputs: Iterable[Signal]) -> tuple[Field, ...]:
    """Return the state's fields that count the calls of predict since the last used sample of each output."""
    meaning = f"calls of predict since the last used sample of {{}}, {OLDEST} for more"
    return tuple(scalar(_age(y), OLDEST, kind="index", high=OLDEST, meaning=meaning.format(y)) for y in outputs)


def aged(outputs: Iterable[Signal]) -> Block:
    """Return the block of a predict that makes every sample older."""
    ages = {Place("state", _age(y)): sym("state", _age(y)) for y in outputs}
    older = {place: ca.if_else(age >= OLDEST, OLDEST, age + 1) for place, age in ages.items()}
    return Block("samples grow older", older)


def renewed(output: Signal) -> Block:
    """Return the block of an update that has used a sample of the output."""
    return Block(f"the newest sample of {output}", {Place("state", _age(output)): ca.SX(0)})


def renewed_where(outputs: Sequence[Signal], sampled: ca.SX) -> Program:
    """Return the statements of a predict that uses samples of the outputs: those that are there, by `sampled` (p)."""
    flags = [Place("work", f"sampled_{y}") for y in outputs]
    there = Block("which samples are there?", {flag: sampled[j] for j, flag in enumerate(flags)})
    return (there, *(When(flag, (renewed(y),)) for flag, y in zip(flags, outputs, strict=True)))


def _age(output: Signal) -> str:
    return f"age_{output}"


def _ages(observer: Observer) -> Report:
    outputs = observer.form.system.outputs
    meaning = f"calls of predict since the last used sample of each output, 0 for one of this call, {OLDEST} for more"
    return Report(
        "age",
        "ages",
        meaning,
        tuple(scalar(y.name, 0, kind="index", meaning=f"of {y}") for y in outputs),
        (Block("ages", {Place("ages", y.name): sym("state", _age(y)) for y in outputs}),),
        tuple(map(_age, outputs)),
        (
            f"A restart of the estimate changes no age; `reset` makes all ages {OLDEST}.",
            "Of a late sample, the calls since the period of its measurement count.",
        ),
    )
