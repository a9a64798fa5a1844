"""A signal of a log: one of its columns by name, or an expression of columns.

    T1 + 273.15      2*pi/60*rpm      -[Current(A)]

by the grammar of text models. In brackets stands the name of a column that is no identifier. A column whose name is the
whole text comes first, in the unit of its signal where its name holds another, as "T1 [degC]" or "Current(A)": it is
converted by y -> factor y + offset. The units are pint's, an optional library; an expression says itself what it does.

Texts of the command line give a signal its column, SIGNAL=COLUMN, or a shift, SIGNAL=SAMPLES.
"""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.graph import NoGraph, to_casadi
from hgogen.reading.expression import BadExpression, parse
from hgogen.reading.log import BadRecord, Column, Table
from hgogen.reading.optional import NotInstalled, library
from hgogen.signal import Signal

FAR = 1e9  # where a conversion is asked for besides 0: its offset then costs no digits of the factor
_BRACKETS = re.compile(r"\[((?:[^\[\]]|\[[^\[\]]*\])*)\]")  # with a pair of brackets in it, as of a unit
_SIGNS = re.compile(r"[-+*/()\[\]]")
_UNIT = re.compile(r"[\[(]([^\[\]()]+)[\])]\s*$")
_POWER = re.compile(r"(?<=[A-Za-z°µ])\^?(-?\d)")
_WORDS = {"²": "**2", "³": "**3", "·": "*", "°C": "degC", "°F": "degF", "°": "degree", "%": "percent", "Ω": "ohm"}
_GRAVITY = {"g": "standard_gravity", "G": "standard_gravity", "mg": "millistandard_gravity"}  # of an acceleration
_ANGLES = {"radian", "degree", "revolution", "turn"}


def column(log: Table, text: str) -> Column:
    """The numbers of a column, or of an expression: no number where one that it reads has none. Raises: `BadRecord`."""
    if text in log.header or not _SIGNS.search(text):
        return log.column(text)
    bracketed = _BRACKETS.findall(text)
    numbers = iter(range(len(bracketed)))
    plain = _BRACKETS.sub(lambda _: f" {_placeholder(log, next(numbers))} ", text)
    names = {_placeholder(log, k): name for k, name in enumerate(bracketed)}
    names |= {name: name for name in log.header if name.isidentifier()}
    symbols = {written: sp.Symbol(written, real=True) for written in names}
    try:
        expression = parse(plain, symbols)
        words = set(re.findall(r"[^\W\d]\w*", plain))
        read = {written: log.column(names[written]) for written in names if written in words}
        inputs = {symbols[written]: ca.SX.sym(written) for written in read}
        graph = ca.Function("column", list(inputs.values()), to_casadi([expression], inputs))
    except (BadExpression, NoGraph) as error:
        listed = ", ".join(name if name.isidentifier() else f"[{name}]" for name in log.header if name)
        raise BadRecord(log.path, f"the expression {text!r}: {error}; its columns are {listed}") from None
    if not read:
        reason = f"the expression {text!r} reads no column; name one, in brackets if it is no identifier"
        raise BadRecord(log.path, reason)
    with np.errstate(all="ignore"):
        values = np.array(graph(*(one.values[None, :] for one in read.values()))).ravel()
    known = np.all([np.isfinite(one.values) for one in read.values()], axis=0) & np.isfinite(values)
    blank = np.any([one.blank for one in read.values()], axis=0)
    examples = (one.example for one in read.values() if one.example)
    return Column(text, np.where(known, values, np.nan), blank & ~known, next(examples, ""))


def operand(log: Table, text: str) -> str:
    """What stands for a column, or an expression of columns, within an expression."""
    if text in log.header:
        return text if text.isidentifier() else f"[{text}]"
    return f"({text})"


def _placeholder(log: Table, k: int) -> str:
    """An identifier that no column has."""
    name = f"column_{k}"
    while name in log.header:
        name += "_"
    return name


# --- units --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Conversion:
    """value -> factor value + offset, from a column's unit to a signal's; `note`: what to say of it."""

    factor: float
    offset: float
    note: str

    def operand(self, column: str) -> str:
        """The converted column in an expression of columns."""
        shift = f" {'+' if self.offset > 0 else '-'} {abs(self.offset):.12g}" if self.offset else ""
        return f"({self.factor:.12g}*{column}{shift})"


class Inconvertible(ValueError):
    """Two units of different kinds."""


def named_unit(column: str) -> str:
    """The unit at the end of a column's name, in brackets; "" for none."""
    match = _UNIT.search(column)
    return match[1].strip() if match and re.search(r"[^\W\d]|[%°]", match[1]) else ""


def converted(log: Table, column: Column, name: str, text: str, unit: str) -> tuple[Table, Column, str]:
    """A column in the unit of its signal, what stands for it in an expression, and the log with a note on it. Raises:
    `BadRecord` where the units do not convert."""
    plain = operand(log, text)
    try:
        change = conversion(name, text, unit)
    except Inconvertible as error:
        fix = f"rename it, or take its numbers as they are, by an expression such as 1*{plain}"
        raise BadRecord(log.path, f"the column {text!r} {error}; {fix}") from None
    if isinstance(change, str):
        return (replace(log, notes=(*log.notes, change)) if change else log), column, plain
    log = replace(log, notes=(*log.notes, change.note))
    return log, replace(column, values=change.factor * column.values + change.offset), change.operand(plain)


def conversion(name: str, column: str, unit: str) -> Conversion | str:
    """The conversion of a column to the unit of the signal `name`; a note, which may be empty, where there is nothing
    to convert or nobody to do it. Raises: `Inconvertible`, of units of different kinds."""
    source = named_unit(column)
    if not source or not unit or _normal(source) == _normal(unit):
        return ""
    try:
        registry = _registry()
    except NotInstalled as error:
        return f"{name}: the unit in {column!r} is not compared with the model's, {unit}, since {error}"
    pair = [_parsed(registry, text) for text in (source, unit)]
    if None in pair:
        return ""
    first, second = pair
    if source in _GRAVITY and second.dimensionality == registry.Unit(_GRAVITY[source]).dimensionality:
        first = registry.Unit(_GRAVITY[source])
    if first.dimensionality != second.dimensionality or _turns(first, second):
        raise Inconvertible(f"is in {source}, which does not convert to {unit}, the unit of {name}")
    try:
        zero, far = (float(registry.Quantity(value, first).to(second).magnitude) for value in (0.0, FAR))
    except Exception:  # pint's own, of offsets in products
        return f"{name}: {source} is not converted to {unit}, which is no matter of a factor and an offset"
    factor, offset = (far - zero) / FAR, zero
    if math.isclose(factor, 1.0, rel_tol=1e-12) and not offset:
        return ""
    return Conversion(factor, offset, f"{name}: converted from {source} to {unit}")


@cache
def _registry() -> Any:
    return library("pint", "a unit in a column's name", "units").UnitRegistry()


def _normal(text: str) -> str:
    for sign, written in _WORDS.items():
        text = text.replace(sign, written)
    return _POWER.sub(r"**\1", text).replace(" ", "*")


def _parsed(registry: Any, text: str) -> Any:
    """The unit of a text; None where pint knows none, as of a remark in brackets."""
    try:
        return registry.Unit(_normal(text))
    except Exception:  # pint's own, of several kinds
        return None


def _turns(first: Any, second: Any) -> bool:
    """Whether one counts cycles and the other angles, whose factor 2 pi pint leaves out."""
    cycles, angles = (
        [bool(names & set(map(str, unit._units))) for unit in (first, second)] for names in ({"hertz"}, _ANGLES)
    )
    return (cycles[0] and angles[1]) or (cycles[1] and angles[0])


def signal_named(key: str, inputs: Sequence[Signal], outputs: Sequence[Signal]) -> str | None:
    """The signal that a text names: plain "u" and "y" are the only input and the only output."""
    names = [s.name for s in (*inputs, *outputs)]
    short = {"u": inputs, "y": outputs}
    if key not in names and len(short.get(key, ())) == 1:
        return str(short[key][0].name)
    return key if key in names else None


def shifts_of(path: str, texts: Iterable[str], inputs: Sequence[Signal], outputs: Sequence[Signal]) -> dict[str, int]:
    """Samples by signal, from texts "SIGNAL=SAMPLES", each of which may hold several, with commas between them. Raises:
    `BadRecord`."""
    shifts: dict[str, int] = {}
    for text in (part for each in texts for part in each.split(",")):
        key, _, number = (part.strip() for part in text.partition("="))
        name = signal_named(key, inputs, outputs)
        if name is None:
            listed = ", ".join(s.name for s in (*inputs, *outputs))
            raise BadRecord(path, f"--shift {text!r} names no signal; the signals are {listed}")
        if name in shifts:
            raise BadRecord(path, f"--shift gives {name} twice; leave one of them out")
        try:
            shifts[name] = int(number)
        except ValueError:
            reason = f"--shift {text!r} must read SIGNAL=SAMPLES, a whole number, such as u=1 for one sample later"
            raise BadRecord(path, reason) from None
    return shifts


def mapping(
    path: str, assignments: Iterable[str], inputs: Sequence[Signal], outputs: Sequence[Signal]
) -> dict[str, str]:
    """The column name of each signal, from texts "SIGNAL=COLUMN"; a signal that none names has a column of its own
    name.

    Plain "u" and "y" name the only input and the only output.

    Raises: `BadRecord`.
    """
    names = [s.name for s in (*inputs, *outputs)]
    columns = {name: name for name in names}
    seen: dict[str, str] = {}
    for text in assignments:
        key, equals, column = text.partition("=")
        key = signal_named(key.strip(), inputs, outputs) or key.strip()
        if not equals or not column.strip():
            raise BadRecord(path, f"--map {text!r} must read SIGNAL=COLUMN; the signals are {', '.join(names)}")
        if key not in names:
            raise BadRecord(path, f"--map {text!r} names no signal; the signals are {', '.join(names)}")
        if key in seen:
            raise BadRecord(path, f"--map {seen[key]!r} and --map {text!r} map {key} twice; leave one of them out")
        seen[key] = text
        columns[key] = column.strip()
    return columns
