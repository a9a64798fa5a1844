"""The memory of a step in the layout of the C structs: numpy aligns records as a C compiler of this machine does.

A record of `kept_type` is all memory of a step, so that one address is enough: the state and the parameters, the input
and the measurement of a sample, the number of its period (`at`), the time (`t`), the estimate and the traces.
"""

from collections.abc import Iterable

import numpy as np

from hgogen.emit.interface import parameters
from hgogen.emit.saved import mark
from hgogen.emit.syntax import DTYPE, Real
from hgogen.program import Field, Group, Place, lines_of
from hgogen.step import Step
from hgogen.stepping.sections import AT
from hgogen.stepping.times import T


def state_type(step: Step, real: Real = "double") -> np.dtype:
    """Return the numpy dtype with the layout of the C struct NAME_state, numbers in the precision `real`."""
    return np.dtype(_members(step.layout.stored, real) + _arrays(step.layout.groups, real), align=True)


def params_type(step: Step, real: Real = "double") -> np.dtype:
    """Return the numpy dtype with the layout of the C struct NAME_params, numbers in the precision `real`."""
    kinds: list[tuple[str, np.dtype]] = [(step.layout.mark.name, np.dtype(np.uint32))] if step.layout.mark else []
    kinds += [(kind, np.dtype(_members(fields, real), align=True)) for kind, fields in parameters(step)]
    return np.dtype(kinds or [("none", np.dtype(np.uint8))], align=True)


def kept_type(step: Step, real: Real = "double") -> np.dtype:
    """Return the numpy dtype of the C struct NAME_kept (`targets.record`): state, parameters, reports, signals,
    estimate and traces."""
    signals = {"input": step.given, "output": step.samples, "estimate": step.states}
    members = [("state", state_type(step, real)), ("params", params_type(step, real))]
    members += [("at", np.dtype(np.uint32))] if step.code.timed else []
    members += [("t", np.dtype(DTYPE[real]))] if step.code.time else []
    members += [(each.name, np.dtype(_members(each.fields, real), align=True)) for each in step.code.reports]
    scalars = {kind: [signal.name for signal in each] for kind, each in signals.items()}
    scalars |= {"traces": list(step.traces)}
    for kind, names in scalars.items():
        members += [(kind, np.dtype([(name, DTYPE[real]) for name in names], align=True))] if names else []
    return np.dtype(members, align=True)


def places(step: Step, record: np.ndarray) -> dict[Place, np.ndarray]:
    """Return a numpy view of each place (struct and field) of a step's memory, within a record (1) of `kept_type`."""
    views = _stored(step, record["state"])
    for kind, fields in parameters(step):
        views |= {Place(kind, field.name): _flat(record["params"][kind], field) for field in fields}
    for kind, signals in (("input", step.given), ("output", step.samples), ("estimate", step.states)):
        views |= {Place(kind, signal.name): record[kind][signal.name] for signal in signals}
    for report in step.code.reports:
        views |= {Place(report.struct, field.name): _flat(record[report.name], field) for field in report.fields}
    views |= {T: record["t"]} if step.code.time else {}
    return views | ({AT: record["at"]} if step.code.timed else {})


def state_places(step: Step, state: np.ndarray) -> dict[Place, np.ndarray]:
    """Return a numpy view of each place of a step's state in a record (1) of `state_type`: (size), (count, size) for a
    field of a group of `count` members, (count, count, size) for one of a group in a group."""
    views = {Place("state", field.name): _flat(state, field) for field in step.layout.state}
    for line in lines_of(step.layout.groups):
        view = state[line[0].name][0]
        for group in line[1:]:
            view = view[group.name]
        for field in line[-1].fields:
            array = view[field.name]
            views[Place(line[-1].name, field.name)] = array[..., None] if field.size == 1 else array
    return views


def initial_record(step: Step, real: Real = "double") -> np.ndarray:
    """Return a record (1) of `kept_type` with the state before the first call and nominal parameters, on which `tune`
    has not run."""
    record = np.zeros(1, kept_type(step, real))
    record["state"] = np.frombuffer(fresh(step, real), state_type(step, real))
    views = places(step, record)
    for kind, fields in (("plant", step.layout.plant), ("gain", step.layout.gains)):
        for field in fields:
            views[Place(kind, field.name)][:] = field.initial
    if step.layout.mark:
        record["params"][step.layout.mark.name] = mark(step, real)
    return record


def fresh(step: Step, real: Real = "double") -> bytes:
    """Return the bytes of a step's C struct NAME_state before the first call."""
    state = np.zeros(1, state_type(step, real))
    layout = step.layout
    members = [("state", layout.stored), *((group.name, group.fields) for *_, group in lines_of(layout.groups))]
    views = _stored(step, state)
    for struct, fields in members:
        for field in fields:
            views[Place(struct, field.name)][:] = field.initial
    if layout.mark:
        state[layout.mark.name] = mark(step, real)
    return state.tobytes()


def _stored(step: Step, state: np.ndarray) -> dict[Place, np.ndarray]:
    marked = {Place("state", step.layout.mark.name): _flat(state, step.layout.mark)} if step.layout.mark else {}
    return marked | state_places(step, state)


def _flat(record: np.ndarray, field: Field) -> np.ndarray:
    array: np.ndarray = record[field.name]
    return array if field.size == 1 else array[0]


def _arrays(groups: Iterable[Group], real: Real) -> list[tuple[object, ...]]:
    return [
        (g.name, np.dtype(_members(g.fields, real) + _arrays(g.groups, real), align=True), (g.count,)) for g in groups
    ]


def _members(fields: Iterable[Field], real: Real) -> list[tuple[object, ...]]:
    kinds = {"real": DTYPE[real], "index": np.uint32}
    return [(f.name, kinds[f.kind]) if f.size == 1 else (f.name, kinds[f.kind], (f.size,)) for f in fields]
