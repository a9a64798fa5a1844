"""A step's memory as the bytes of the C structs: numpy's aligned records have the layout of a C compiler here."""

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from hgogen.emit.cprint import Real
from hgogen.program import Field, Group, lines_of
from hgogen.step import Step

_NUMBER = {"float": np.float32, "double": np.float64}


def state_type(step: Step, real: Real = "double") -> np.dtype:
    """The struct NAME_state."""
    return np.dtype(_members(step.state, real) + _arrays(step.groups, real), align=True)


def params_type(step: Step, real: Real = "double") -> np.dtype:
    """The struct NAME_params."""
    kinds = (("plant", step.plant), ("gain", step.gains), ("derived", step.derived))
    return np.dtype([(kind, _record(fields, real)) for kind, fields in kinds if fields], align=True)


def pack_state(step: Step, memory: Mapping[str, np.ndarray]) -> np.ndarray:
    """The state in a machine's memory as one record, padding zero."""
    record = np.zeros(1, state_type(step))
    for field in step.state:
        _store(record, field, memory[f"state.{field.name}"])
    for place, view, field in _views(step, record):
        view[:] = memory[place][..., 0] if _single(field) else memory[place]
    return record


def unpack_state(step: Step, record: np.ndarray, memory: Mapping[str, np.ndarray]) -> None:
    """The inverse of `pack_state`, into the machine's memory."""
    for field in step.state:
        memory[f"state.{field.name}"][:] = record[field.name][0]
    for place, view, field in _views(step, record):
        memory[place][:] = view[..., None] if _single(field) else view


def pack_params(step: Step, memory: Mapping[str, np.ndarray]) -> np.ndarray:
    """The parameters in a machine's memory as one record."""
    record = np.zeros(1, params_type(step))
    for kind, fields in (("plant", step.plant), ("gain", step.gains), ("derived", step.derived)):
        for field in fields:
            _store(record[kind], field, memory[f"{kind}.{field.name}"])
    return record


def _views(step: Step, record: np.ndarray) -> Iterator[tuple[str, np.ndarray, Field]]:
    """(place, where it lies in the record, field) of each field of a group."""
    for line in lines_of(step.groups):
        view = record[0]
        for group in line:
            view = view[group.name]
        for field in line[-1].fields:
            yield f"{line[-1].name}.{field.name}", view[field.name], field


def _arrays(groups: Iterable[Group], real: Real) -> list[tuple[object, ...]]:
    return [
        (g.name, np.dtype(_members(g.fields, real) + _arrays(g.groups, real), align=True), (g.count,)) for g in groups
    ]


def _single(field: Field) -> bool:
    return field.size == 1


def _store(record: np.ndarray, field: Field, values: np.ndarray) -> None:
    record[field.name][0] = values[0] if _single(field) else values


def _members(fields: Iterable[Field], real: Real) -> list[tuple[object, ...]]:
    kinds = {"real": _NUMBER[real], "index": np.uint32}
    return [(f.name, kinds[f.kind]) if _single(f) else (f.name, kinds[f.kind], (f.size,)) for f in fields]


def _record(fields: Iterable[Field], real: Real) -> np.dtype:
    return np.dtype(_members(fields, real), align=True)
