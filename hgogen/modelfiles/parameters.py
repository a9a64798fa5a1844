"""Values of a model's parameters from a file, in the place of those that the model says: {"parameters": {"k": 0.1}}."""

from collections.abc import Mapping
from pathlib import Path
from sys import float_info
from types import FunctionType
from typing import Any

import sympy as sp

from hgogen.form import Form
from hgogen.modelfiles.json_file import BadFile, demand_plant, table_of
from hgogen.observer import Observer
from hgogen.signal import Signal
from hgogen.step import Step
from hgogen.structure.valued import exchanged, valued
from hgogen.system import System

_MADE = (System, Form, Observer, Step)


class BadParameters(BadFile):
    """A file of parameters that cannot be taken."""


def read(path: Path, plant: System) -> dict[str, float]:
    """The values of a plant's parameters by name of a JSON file, such as `hgogen fit` writes.

    Raises: `BadFile`.
    """
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
    """What a model file holds by name, with other values of the plant's parameters, where it differs: the plant, its
    parameters, and tables and expressions that read them. What functions make is made of these when they are called.

    Raises: `BadParameters` for what was made of the plant when the file was read; `BadValue`.
    """
    new, moved = exchanged(plant, values), valued(plant, values)
    made = {name: _put(name, value, plant, moved, new) for name, value in names.items() if not name.startswith("__")}
    return {name: value for name, value in made.items() if value is not names[name]}


def _put(name: str, value: Any, plant: System, moved: System, new: Mapping[Signal, Signal]) -> Any:
    if value is plant:
        return moved
    if isinstance(value, _MADE):
        reason = "is made of the plant where the file is read, with the values in it; make it in a function"
        raise BadParameters(name, reason)
    if isinstance(value, sp.Basic):
        return value.xreplace(dict(new)) if value.free_symbols & new.keys() else value
    if isinstance(value, FunctionType) or not isinstance(value, dict | list | tuple):
        return value
    parts = value.values() if isinstance(value, dict) else value
    changed = [_put(name, part, plant, moved, new) for part in parts]
    if all(one is other for one, other in zip(changed, parts, strict=True)):
        return value
    return dict(zip(value, changed, strict=True)) if isinstance(value, dict) else type(value)(changed)
