"""A plant with other values of its parameters."""

from collections.abc import Mapping
from dataclasses import replace

from hgogen.errors import BadArgument, nearest
from hgogen.signal import Signal
from hgogen.system import System


class BadValue(BadArgument):
    """A value that a parameter cannot have."""


def valued(plant: System, values: Mapping[str, float]) -> System:
    """The plant with other nominal values of parameters, by name.

    Raises: `BadValue` for a name that is no parameter, a value outside of its range, and a plant that is recast.
    """
    new = exchanged(plant, values)
    flow, output = (tuple(row.xreplace(new) for row in rows) for rows in (plant.flow, plant.output))
    return replace(plant, parameters=tuple(new.get(p, p) for p in plant.parameters), flow=flow, output=output)


def exchanged(plant: System, values: Mapping[str, float]) -> dict[Signal, Signal]:
    """Each parameter of these names to the one with its new value. Raises: `BadValue`."""
    if plant.origin is not None:
        raise BadValue(f"plant {plant.name!r}", "is recast; give the values to the plant that it was recast from")
    known = {p.name: p for p in plant.parameters}
    for name in values:
        if name not in known:
            listed = f"its parameters are {', '.join(known)}" if known else "it has no parameters"
            raise BadValue(f"{name[:60]!r}", f"is no parameter of {plant.name!r}; {nearest(name, known, listed)}")
    new = {}
    for name, value in values.items():
        p = known[name]
        low, high = p.interval
        if not low <= value <= high:
            raise BadValue(f"{p.name} = {value:g}", f"lies outside of its range [{low:g}, {high:g}]; widen that")
        new[p] = Signal(p.name, p.unit, p.meaning, value, p.low, p.high, p.rates)
    return new
