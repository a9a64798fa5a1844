"""Columns whose names hold a unit, as "T1 [degC]" or "Current(A)", in the unit of the model's signal.

The units are pint's, an optional library. A column alone is converted, by y -> factor y + offset; an expression of
columns says itself what it does.
"""

import math
import re
from dataclasses import dataclass
from functools import cache
from typing import Any

from hgogen.reading.optional import NotInstalled, library

FAR = 1e9  # where a conversion is asked for besides 0: its offset then costs no digits of the factor
_UNIT = re.compile(r"[\[(]([^\[\]()]+)[\])]\s*$")
_POWER = re.compile(r"(?<=[A-Za-z°µ])\^?(-?\d)")
_SIGNS = {"²": "**2", "³": "**3", "·": "*", "°C": "degC", "°F": "degF", "°": "degree", "%": "percent", "Ω": "ohm"}
_GRAVITY = {"g": "standard_gravity", "G": "standard_gravity", "mg": "millistandard_gravity"}  # of an acceleration
_ANGLES = {"radian", "degree", "revolution", "turn"}


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


def conversion(name: str, column: str, unit: str) -> Conversion | str:
    """That of a column to the unit of the signal `name`; a note, which may be empty, where there is nothing to convert
    or nobody to do it. Raises: `Inconvertible`, of units of different kinds."""
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
    for sign, written in _SIGNS.items():
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
