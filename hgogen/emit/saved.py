"""A saved state: a digest of the program that it is of, its bytes, and a checksum of both.

    LAYOUT    8 bytes     the digest
    state     any         the memory of the state as it lies there
    checksum  4 bytes     CRC-32 (IEEE 802.3) of all bytes before it, the lowest byte first

The digest is of what must be the same for a state to mean the same: the model with the values and ranges of its
signals and its tables, the form, the observer with its arguments, the parameters as they are generated, the method, dt,
the precision, and the fields of the memory in their order. The name that a caller gives the code is none of it, nor is
where an estimate begins.
"""

import hashlib
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import lru_cache
from inspect import signature
from typing import Any

import numpy as np

from hgogen.emit.syntax import DTYPE, Real
from hgogen.errors import BadArgument
from hgogen.observer import STARTS, Observer
from hgogen.program import Field, Group
from hgogen.reading.given import names_of
from hgogen.registry import version
from hgogen.step import Step
from hgogen.stepping.guards import mark_number
from hgogen.system import System

DIGEST, CHECKSUM = 8, 4  # bytes
ADDED = DIGEST + CHECKSUM  # bytes of a saved state beside those of the state
POLYNOMIAL = 0xEDB88320
_IN_EQUATIONS = ("poles", "gains", "Q", "R")  # arguments that may be given in several ways


class NotSaved(BadArgument):
    """Bytes that are no saved state of a step."""


@lru_cache(maxsize=8)  # what is made of a step asks several times
def layout(step: Step, real: Real, language: str = "c") -> bytes:
    """Return the digest (8) of a step in a precision; `language`: whose memory it is, C's or another's."""
    observer, form = step.observer, step.observer.form
    system = form.system.declared
    lines = [version(), language, real, system.name, form.kind, observer.name, step.code.rule]
    clock = step.clock
    lines += [f"dt {clock.dt!r}, {clock.periods}, {clock.between}, {clock.guards}, {clock.prefer}"]
    lines += [str(observer.delays)]
    lines += [*_plant(system), *(_plant(form.system) if form.system is not system else ())]
    guards = f"{form.clamped} {form.limits} {form.free} {form.fallback}"
    lines += [*map(str, form.to_form), guards, *_observer(observer)]
    for parameters in (step.layout.plant, step.layout.gains):
        lines += (f"{field.name} {[DTYPE[real](value) for value in field.initial]}" for field in parameters)
    lines += [*_listed(step.layout.derived, ()), *_listed(step.layout.state, step.layout.groups)]
    return hashlib.sha256("\n".join(lines).encode()).digest()[:DIGEST]


def mark(step: Step, real: Real) -> int:
    """Return the number that marks memory of a step in a precision."""
    return mark_number(layout(step, real))


def sealed(step: Step, real: Real, state: bytes) -> bytes:
    """Return a state's bytes as what is saved of it."""
    body = layout(step, real) + state
    return body + struct.pack("<I", zlib.crc32(body))


def opened(step: Step, real: Real, saved: bytes, size: int) -> bytes:
    """Return the bytes (size) of the state that was saved.

    Raises: `NotSaved` for what is damaged, or of another program.
    """
    what = f"a saved state of {len(saved)} bytes"
    if len(saved) != size + ADDED:
        raise NotSaved(what, f"is not of this step, of which {size + ADDED} are saved; give what save() gave")
    body, state = saved[:-CHECKSUM], saved[DIGEST:-CHECKSUM]
    if struct.pack("<I", zlib.crc32(body)) != saved[-CHECKSUM:]:
        raise NotSaved(what, "is damaged: its checksum differs; save again")
    marked = not step.layout.mark or state[:4] == struct.pack("=I", mark(step, real))
    if saved[:DIGEST] != layout(step, real) or not marked:
        raise NotSaved(what, "is of another model, observer, gains, dt or precision; restore it where it was saved")
    return state


def _plant(system: System) -> Iterator[str]:
    """Yield a plant in words: its parameters' values, the ranges of its signals, its equations and its tables."""
    yield from (f"{parameter.name} {parameter.nominal}" for parameter in system.parameters)
    yield from (f"{signal.name} {signal.low} {signal.high} {signal.rates}" for signal in system.signals)
    yield from (f"' {row}" for row in system.flow)
    yield from (f"= {row}" for row in system.output)
    yield from (f"{table.name} {table.points}" for table in system.tables)


def _observer(observer: Observer) -> Iterator[str]:
    """Yield an observer and its members in words: the equations with their numbers, and the arguments beside them."""
    yield from observer.equations
    if observer.made is None:
        return
    bound = signature(observer.made.func).bind(*observer.made.args, **observer.made.keywords)
    bound.apply_defaults()
    (_, base), *others = bound.arguments.items()
    form = observer.form
    orders = (form.names, names_of(form.system.states), names_of(form.system.outputs))
    left = (*STARTS, *_IN_EQUATIONS, "accept")
    yield from (f"{name} {_text(value, orders)}" for name, value in others if name not in left)
    yield from _observer(base) if isinstance(base, Observer) else ()


def _text(value: Any, orders: Sequence[Sequence[str]]) -> str:
    """Return the text of an argument, which is the same for equal numbers of any type in any sequence, or by the names
    of one of the orders."""
    match value:
        case Mapping():
            for names in orders:
                if value.keys() == {*names}:
                    return _text([value[name] for name in names], orders)
            return f"{{{', '.join(sorted(f'{name}: {_text(each, orders)}' for name, each in value.items()))}}}"
        case np.ndarray():
            return _text(value.tolist(), orders)
        case list() | tuple():
            return f"[{', '.join(_text(each, orders) for each in value)}]"
        case int() | float() | complex() | np.number():
            return repr(complex(value))
    if is_dataclass(value) and not isinstance(value, type):
        each = (f"{field.name}={_text(getattr(value, field.name), orders)}" for field in fields(value))
        return f"{type(value).__name__}({', '.join(each)})"
    return str(getattr(value, "__qualname__", value))


def _listed(fields: Iterable[Field], groups: Iterable[Group]) -> Iterator[str]:
    """Yield the layout of memory in words."""
    yield from (f"{field.kind} {field.name}[{field.size}]: {', '.join(field.labels)}" for field in fields)
    for group in groups:
        yield f"{group.name}[{group.count}]"
        yield from _listed(group.fields, group.groups)
