"""Plain-text models: one dictionary, written in TOML or JSON, read without running any code.

    name = "van_der_pol"
    time = "h"                       # unit of time of all rates, periods and trials; by default "s"
    [states.x1]                      # the order of the tables is the order of the states
    unit = "V"                       # meaning = "...", low = -3, high = 3, all optional
    flow = "x2"                      # x1' = x2
    [inputs.u]                       # value: before the first sample; rates = [[-1, 1]]: ranges of u', u'', ...
    [parameters.mu]
    value = 1.0                      # with low and high it can be tuned at run time
    [outputs.y]
    equation = "x1"
    [disturbances.d]                 # an unknown input to a row, a state of its own: x2' = .. + d, d' = 0
    on = "x2"                        # order = 2: d' is a state too, in the range of rates = [[-1, 1]]
    low = -2
    high = 2
    [tables.ocv]                     # a function by points, which expressions call: ocv(x1)
    x = [0, 0.5, 1]
    y = [3, 3.7, 4.2]
    kind = "monotone"                # or "linear", the default
    [tables.friction]                # of two arguments, friction(x2, x1): z has a row for each of x
    x = [-1, 0, 1]
    y = [0, 50]
    z = [[-2, -1], [0, 0], [2, 1]]

Beside these: meaning and reference (text), known (known answers, a free table), and the tables that files of
`hgogen.modelfiles` read: `observer` and `tuning` (tuning.py), `trial` (recipe.py), `dissipation` (storage.py).
Expressions are those of `reading.expression`.
"""

import json
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import sympy as sp

from hgogen.errors import BadArgument, HgogenError, nearest
from hgogen.reading.content import BYTES, READERS, Unread, content_of
from hgogen.reading.disturbed import with_disturbance
from hgogen.reading.expression import BadExpression, parse
from hgogen.reading.expression import read as read_expression
from hgogen.reading.folding import Fold
from hgogen.reading.table import cells_of
from hgogen.rigor.lookup import Cells
from hgogen.signal import Signal
from hgogen.system import System

TEXT, NUMBER, EXPRESSION, TABLE, RANGES = "text", "a number", "an expression", "a table", "pairs of numbers"
NUMBERS, ROWS = "a list of numbers", "a list of lists of numbers"
_SIGNAL = {"unit": TEXT, "meaning": TEXT, "value": NUMBER, "low": NUMBER, "high": NUMBER}
_KINDS: dict[str, tuple[dict[str, str], str | None]] = {  # keys of each kind of signal, and the one that must be there
    "states": ({**_SIGNAL, "rates": RANGES, "flow": EXPRESSION}, "flow"),
    "inputs": ({**_SIGNAL, "rates": RANGES}, None),
    "parameters": (_SIGNAL, "value"),
    "outputs": ({**_SIGNAL, "equation": EXPRESSION}, "equation"),
}
_DISTURBANCE = {**_SIGNAL, "rates": RANGES, "on": TEXT, "order": NUMBER}
_POINTS = {"x": NUMBERS, "y": NUMBERS, "z": ROWS, "kind": TEXT}
_COORDINATES = ("x", "y", "z")
_TOP = {
    **dict.fromkeys(("name", "meaning", "reference", "time"), TEXT),
    **dict.fromkeys(_KINDS, TABLE),
    **dict.fromkeys(("disturbances", "tables", "known", "observer", "tuning", "trial", "dissipation", "bounds"), TABLE),
}
_OF_PLANT = ("name", "time", "disturbances", "tables", *_KINDS)
BESIDE = tuple(key for key in _TOP if key not in _OF_PLANT)  # what a file says beside its plant
Made = TypeVar("Made")
_LARGEST = 1e300  # beyond it a number of a file is a slip
_EXAMPLES = {
    TEXT: '"..."',
    NUMBER: f"1.5, finite, below {_LARGEST:g} and without quotes",
    EXPRESSION: '"x2 - sin(x1)"',
    TABLE: "[...] with keys",
    RANGES: "[[-1, 1], [-2, 2]]",
    NUMBERS: "[0, 0.5, 1]",
    ROWS: "[[0, 1], [2, 3]]",
}


@dataclass(eq=False)
class BadModelFile(HgogenError):
    """A model file with a table that is none; `key` is the path of tables to the fault, empty for the file as a
    whole."""

    file: str
    key: str
    reason: str

    def __str__(self) -> str:
        return f"{self.file}{f', {self.key}' if self.key else ''}: {self.reason}"


class NoText(BadArgument):
    """A system that no plain text can hold."""

    text = "system {what!r} cannot be written as plain text: {reason}"


@dataclass(frozen=True)
class PlainModel:
    """What a plain-text model holds.

    `known`, `observer`, `tuning`, `trial`, `dissipation` and `bounds` are its tables as they stand, empty if missing;
    `folds` are the expressions from which SymPy folded something away.
    """

    file: str
    plant: System
    meaning: str
    reference: str
    known: Mapping[str, Any]
    observer: Mapping[str, Any]
    tuning: Mapping[str, Any]
    trial: Mapping[str, Any]
    dissipation: Mapping[str, Any]
    bounds: Mapping[str, Any]
    folds: tuple[Fold, ...] = ()


# --- text to model ------------------------------------------------------------------------------------------


def read(path: Path) -> PlainModel:
    """The model of a .toml or .json file. Raises: `BadModelFile` with file, key and fix."""
    try:
        text = content_of(path, BYTES).decode("utf-8-sig")
        table = READERS[path.suffix](text)
    except Unread as error:
        raise BadModelFile(str(path), "", error.reason) from None
    except (ValueError, RecursionError) as error:
        kind = path.suffix[1:].upper()
        reason = "it is nested too deep" if isinstance(error, RecursionError) else str(error)
        raise BadModelFile(str(path), "", f"is no {kind} text ({reason}); correct it") from None
    return from_table(table, str(path))


def from_table(table: Any, file: str = "model") -> PlainModel:
    """The model of a dictionary, as TOML and JSON give it; `file` is what errors call it. Raises: `BadModelFile`."""
    demand_keys(file, "", table, _TOP, "name")
    groups = {kind: table.get(kind, {}) for kind in _KINDS}
    signals: dict[str, list[Signal]] = {}
    for kind, group in groups.items():
        signals[kind] = [_signal(file, kind, name, entry, *_KINDS[kind]) for name, entry in group.items()]
    symbols = {signal.name: signal for kind in _KINDS for signal in signals[kind]}
    tables = {name: _points(file, name, entry) for name, entry in table.get("tables", {}).items()}
    for name in tables.keys() & symbols.keys():
        raise BadModelFile(file, f"tables.{name}", f"a signal is called {name!r} as well; rename one of the two")

    def expressions(kind: str, key: str) -> list[Fold]:
        """The expressions under `key` in every table of a kind."""
        return [
            named(file, f"{kind}.{name}.{key}", read_expression, str(entry[key]), symbols, tables)
            for name, entry in groups[kind].items()
        ]

    flow, output = expressions("states", "flow"), expressions("outputs", "equation")
    readings = {"flow": [one.reading for one in flow], "output": [one.reading for one in output]}
    plant = named(file, "", System, table["name"], **readings, **signals, time=table.get("time", "s"))
    for name, entry in table.get("disturbances", {}).items():
        signal = _signal(file, "disturbances", name, entry, _DISTURBANCE, "on")
        on, order = entry["on"], entry.get("order", 1)
        plant = named(file, f"disturbances.{name}", with_disturbance, plant, on, order, signal=signal)
    beside = {key: table.get(key, "" if _TOP[key] == TEXT else {}) for key in BESIDE}
    return PlainModel(file, plant, **beside, folds=tuple(one for one in (*flow, *output) if one.lost))


def demand_keys(file: str, where: str, table: Any, keys: Mapping[str, str], needed: str | None = None) -> None:
    """Raise `BadModelFile` unless every key is known and of its kind, and the needed one is there."""
    if not isinstance(table, Mapping):
        raise BadModelFile(file, where, f"is {_shown(table)}, not a table; write its keys, {', '.join(keys)}")
    for key, value in table.items():
        path = f"{where}.{key}" if where else key
        if key not in keys:
            known = nearest(key, keys, f"the keys are {', '.join(keys)}")
            raise BadModelFile(file, path, f"there is no key {key[:60]!r} here; {known}")
        if not _FITS[keys[key]](value):
            raise BadModelFile(file, path, f"is {_shown(value)}; write {keys[key]}, such as {_EXAMPLES[keys[key]]}")
    if needed is not None and needed not in table:
        example = _EXAMPLES[keys[needed]].partition(",")[0]
        raise BadModelFile(file, where, f"the key {needed!r} is missing; add {needed} = {example}")


def _number(value: Any) -> bool:
    """A finite number; an integer too large for a float is none."""
    return type(value) in (int, float) and abs(value) < _LARGEST


def _numbers(value: Any) -> bool:
    return isinstance(value, list) and all(map(_number, value))


_FITS: dict[str, Callable[[Any], bool]] = {
    TEXT: lambda value: isinstance(value, str),
    NUMBER: _number,
    EXPRESSION: lambda value: isinstance(value, str) or _number(value),
    TABLE: lambda value: isinstance(value, dict),
    RANGES: lambda value: isinstance(value, list) and all(_numbers(pair) and len(pair) == 2 for pair in value),
    NUMBERS: _numbers,
    ROWS: lambda value: isinstance(value, list) and all(map(_numbers, value)),
}


def _shown(value: Any) -> str:
    if isinstance(value, dict | list):
        return "a table" if isinstance(value, dict) else "a list"
    if isinstance(value, str):
        return f"{str(value)[:40]!r}, text"
    huge = isinstance(value, int) and value.bit_length() > 1000  # of thousands of digits it cannot even be printed
    return "a huge number" if huge else repr(value)[:40]


def _signal(file: str, kind: str, name: str, entry: Any, keys: Mapping[str, str], needed: str | None) -> Signal:
    where = f"{kind}.{name}"
    demand_keys(file, where, entry, keys, needed)
    declared = {key: entry[key] for key in ("unit", "meaning", "low", "high", "rates") if key in entry}
    return named(file, where, Signal, name, nominal=entry.get("value"), **declared)


def _points(file: str, name: str, entry: Mapping[str, Any]) -> Cells:
    where = f"tables.{name}"
    for key in ("x", "y"):
        demand_keys(file, where, entry, _POINTS, key)
    *axes, values = (entry[key] for key in _COORDINATES if key in entry)
    return named(file, where, cells_of, axes, values, entry.get("kind", "linear"), name)


def named(file: str, where: str, function: Callable[..., Made], *args: Any, **kwargs: Any) -> Made:
    """What `function` returns; its refusal becomes a `BadModelFile` with file and key."""
    try:
        return function(*args, **kwargs)
    except HgogenError as error:
        raise BadModelFile(file, where, str(error)) from None


# --- model to text ------------------------------------------------------------------------------------------


def to_text(plant: System, beside: Mapping[str, Any] = MappingProxyType({})) -> str:
    """The plant as TOML, which `read` reads back as an equal system; a float is written as its shortest decimal.
    `beside`: what else stands in the file, by its key at the top, as `from_table` takes it. Raises: `NoText` for a
    recast plant, and for an expression outside the grammar."""
    if plant.origin is not None:
        raise NoText(plant.name, f"it is recast; write the plant it comes from, {plant.origin.plant.name!r}")
    symbols = {signal.name: signal for signal in plant.signals}
    equations = {
        "states": ("flow", [_expression(plant, symbols, e) for e in plant.flow]),
        "inputs": ("", [""] * len(plant.inputs)),
        "parameters": ("", [""] * len(plant.parameters)),
        "outputs": ("equation", [_expression(plant, symbols, e) for e in plant.output]),
    }
    lines = [f"name = {_quoted(plant.name)}"] + [f"time = {_quoted(plant.time)}"] * (plant.time != "s")
    lines += [f"{_key(key)} = {inline(value)}" for key, value in beside.items()]
    lines += [line for cells in plant.tables for line in _table(plant, cells)]
    for kind, (key, texts) in equations.items():
        for signal, text in zip(getattr(plant, kind), texts, strict=True):
            entries = {"unit": signal.unit or None, "meaning": signal.meaning or None, "value": signal.nominal}
            entries |= {"low": signal.low, "high": signal.high, "rates": [list(pair) for pair in signal.rates] or None}
            entries |= {key: text} if key else {}
            lines += ["", f"[{kind}.{signal.name}]"]
            lines += [f"{name} = {inline(value)}" for name, value in entries.items() if value is not None]
    return "\n".join(lines) + "\n"


def inline(value: Any) -> str:
    """A value of TOML in one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)} = {inline(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(inline, value))}]"
    return _quoted(value) if isinstance(value, str) else json.dumps(value)


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _quoted(name)


def _table(plant: System, cells: Cells) -> Iterable[str]:
    yield from ("", f"[tables.{cells.name}]")
    for key, numbers in zip(_COORDINATES, (*(axis.x for axis in cells.axes), cells.values), strict=False):
        try:
            yield f"{key} = {_decimals(numbers)}"
        except ValueError:
            reason = f"{key} of the table {cells.name} has a number that is no decimal; round it"
            raise NoText(plant.name, reason) from None
    yield f"kind = {_quoted(cells.kind)}"


def _decimals(numbers: Any) -> Any:
    """Exact numbers, or tuples of them, as floats whose shortest decimals they are. Raises: `ValueError`."""
    if isinstance(numbers, tuple):
        return list(map(_decimals, numbers))
    if Fraction(repr(float(numbers))) != numbers:
        raise ValueError
    return float(numbers)


def _expression(plant: System, symbols: Mapping[str, Signal], expression: sp.Expr) -> str:
    floats = expression.atoms(sp.Float)
    exact = expression.xreplace({number: sp.Rational(Fraction(repr(float(number)))) for number in floats})
    text = str(exact)
    try:
        same = parse(text, symbols, {cells.name: cells for cells in plant.tables}) == exact
    except BadExpression as error:
        raise NoText(plant.name, str(error)) from None
    if not same:
        raise NoText(plant.name, f"{text[:200]} reads back as another expression; rename the signal E or pi")
    return text


def _quoted(text: str) -> str:
    """A basic string of TOML, which has JSON's escapes, and escapes DEL too."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
