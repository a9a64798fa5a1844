"""A step's memory as the bytes of the C structs: numpy's aligned records have the layout of a C compiler here."""

from collections.abc import Iterable, Mapping

import numpy as np

from hgogen.cprint import Real
from hgogen.program import Field
from hgogen.step import Step

_NUMBER = {"float": np.float32, "double": np.float64}


def state_type(step: Step, real: Real = "double") -> np.dtype:
    """The struct NAME_state."""
    groups = [(g.name, _record(g.fields, real), (g.count,)) for g in step.groups]
    return np.dtype(_members(step.state, real) + groups, align=True)


def params_type(step: Step, real: Real = "double") -> np.dtype:
    """The struct NAME_params."""
    kinds = (("plant", step.plant), ("gain", step.gains), ("derived", step.derived))
    return np.dtype([(kind, _record(fields, real)) for kind, fields in kinds if fields], align=True)


def pack_state(step: Step, memory: Mapping[str, np.ndarray]) -> np.ndarray:
    """The state in a machine's memory as one record, padding zero."""
    record = np.zeros(1, state_type(step))
    for field in step.state:
        _store(record, field, memory[f"state.{field.name}"])
    for group in step.groups:
        for field in group.fields:
            values = memory[f"{group.name}.{field.name}"]
            record[group.name][field.name][0] = values[:, 0] if _single(field) else values
    return record


def unpack_state(step: Step, record: np.ndarray, memory: Mapping[str, np.ndarray]) -> None:
    """The inverse of `pack_state`, into the machine's memory."""
    for field in step.state:
        memory[f"state.{field.name}"][:] = record[field.name][0]
    for group in step.groups:
        for field in group.fields:
            values = record[group.name][field.name][0]
            memory[f"{group.name}.{field.name}"][:] = values[:, None] if _single(field) else values


def pack_params(step: Step, memory: Mapping[str, np.ndarray]) -> np.ndarray:
    """The parameters in a machine's memory as one record."""
    record = np.zeros(1, params_type(step))
    for kind, fields in (("plant", step.plant), ("gain", step.gains), ("derived", step.derived)):
        for field in fields:
            _store(record[kind], field, memory[f"{kind}.{field.name}"])
    return record


def _single(field: Field) -> bool:
    return field.size == 1


def _store(record: np.ndarray, field: Field, values: np.ndarray) -> None:
    record[field.name][0] = values[0] if _single(field) else values


def _members(fields: Iterable[Field], real: Real) -> list[tuple[object, ...]]:
    kinds = {"real": _NUMBER[real], "index": np.uint32}
    return [(f.name, kinds[f.kind]) if _single(f) else (f.name, kinds[f.kind], (f.size,)) for f in fields]


def _record(fields: Iterable[Field], real: Real) -> np.dtype:
    return np.dtype(_members(fields, real), align=True)
