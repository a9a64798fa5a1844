"""A JSON file of parameters or tunings from the user, of limited size and nesting.

A file that a command wrote holds the equations of its plant. A plant with other equations accepts its numbers with a
warning, since a model changes during its development.
"""

import json
import warnings
from collections.abc import Mapping
from pathlib import Path
from sys import float_info
from types import FunctionType
from typing import Any

import sympy as sp

from hgogen.errors import BadArgument
from hgogen.form import Form
from hgogen.observer import Observer
from hgogen.reading.files import Unread, content_of
from hgogen.signal import Signal
from hgogen.step import Step
from hgogen.system import System, exchanged, valued

LARGEST = 10_000_000  # bytes
_BUILT_TYPES = (System, Form, Observer, Step)


class BadFile(BadArgument):
    """The error for an invalid file of parameters or tunings."""


class OtherPlant(UserWarning):
    """The warning about a file that was written for a plant with other equations."""


def equations(plant: System) -> list[str]:
    """Return the equations of the declared plant as such files store them, without the values of parameters."""
    return list(plant.declared.equations)


def demand_plant(path: Path, table: dict[str, Any], plant: System) -> None:
    """Warn with `OtherPlant` if the equations stored in the file are not those of the plant; `table`: the file's
    content."""
    plant_equations, file_equations = equations(plant), table.get("equations")
    if not isinstance(file_equations, list) or file_equations == plant_equations:
        return
    lost = next((f"{row}" for row in file_equations if row not in plant_equations), "fewer equations")
    warnings.warn(
        f"{path} was made for another plant, with {lost:.200}; make it again for this one", OtherPlant, stacklevel=2
    )


def table_of(path: Path, writer: str) -> dict[str, Any]:
    """Return the JSON object in a file; `writer`: the command that writes such files, for the error message. Raises:
    `BadFile`."""
    try:
        table = json.loads(content_of(path, LARGEST))
    except Unread as error:
        raise BadFile(str(path), error.reason) from None
    except (ValueError, RecursionError) as error:
        raise BadFile(str(path), f"is no JSON ({error}); give a file that `{writer}` wrote") from None
    return table if isinstance(table, dict) else {}


def read_tunings(path: Path, plant: System) -> tuple[Mapping[str, Any], str]:
    """Return the tunings by name in a JSON file as `hgogen tune` writes it, and the name of the recommended one, "" if
    there is none. Raises: `BadFile`."""
    content = table_of(path, "hgogen tune")
    tables, take = content.get("tuning"), content.get("take", "")
    if not isinstance(tables, dict) or not all(isinstance(table, dict) for table in tables.values()):
        raise BadFile(str(path), 'has no table "tuning" of tables; write {"tuning": {"riccati": {"Q": .., "R": ..}}}')
    if take not in ("", *tables):
        raise BadFile(str(path), f"takes {take!r:.60}, which is none of its tunings: {', '.join(tables)}")
    demand_plant(path, content, plant)
    return tables, take


class BadParameters(BadFile):
    """The error for an invalid file of parameters, or a model that cannot accept other values."""


def read_values(path: Path, plant: System) -> dict[str, float]:
    """Return the values of a plant's parameters by name from a JSON file as `hgogen fit` writes it. Raises:
    `BadFile`."""
    content = table_of(path, "hgogen fit")
    values = content.get("parameters")
    if not isinstance(values, dict):
        raise BadParameters(str(path), 'has no table "parameters"; write {"parameters": {"NAME": value}}')
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= float_info.max:
            raise BadParameters(str(path), f"gives {name[:60]!r} the value {value!r:.60}; give a finite number")
    demand_plant(path, content, plant)
    return {name: float(value) for name, value in values.items()}


def put(names: Mapping[str, Any], plant: System, values: Mapping[str, float]) -> dict[str, Any]:
    """Return the entries of a model file (`names`) that change if its plant's parameters have the new `values`: the
    plant, its parameters, and tables and expressions that contain them. Functions are unchanged, since they are called
    with the new values. Raises: `BadParameters` for an object that was built from the plant when the file was read;
    `BadValue`."""
    new_parameters, new_plant = exchanged(plant, values), valued(plant, values)
    changed = {
        name: _put(name, value, plant, new_plant, new_parameters)
        for name, value in names.items()
        if not name.startswith("__")
    }
    return {name: value for name, value in changed.items() if value is not names[name]}


def _put(name: str, value: Any, plant: System, new_plant: System, new_parameters: Mapping[Signal, Signal]) -> Any:
    if value is plant:
        return new_plant
    if isinstance(value, _BUILT_TYPES):
        reason = "is made of the plant where the file is read, with the values in it; make it in a function"
        raise BadParameters(name, reason)
    if isinstance(value, sp.Basic):
        return value.xreplace(dict(new_parameters)) if value.free_symbols & new_parameters.keys() else value
    if isinstance(value, FunctionType) or not isinstance(value, dict | list | tuple):
        return value
    parts = value.values() if isinstance(value, dict) else value
    changed = [_put(name, part, plant, new_plant, new_parameters) for part in parts]
    if all(one is other for one, other in zip(changed, parts, strict=True)):
        return value
    return dict(zip(value, changed, strict=True)) if isinstance(value, dict) else type(value)(changed)
