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

Other keys: invariants (a list of expressions that the flow keeps at 0), discrete (true: the flow is the state at the
next sample), meaning and reference (text), known (known
answers, a free table), and the tables that files of `hgogen.modelfiles` read: `observer` and `tuning` (tuning.py),
`trial` (recipe.py), `dissipation` (storage.py). Expressions are those of `reading.expression`.

Each dictionary in a file of a library is one model. It is either a table as above with a key "bound_queries", where a
parameter with a range is unknown and one without has a known value, or

    {"name", "states", "inputs", "outputs", "known_params", "unknown_params": [name, ..], "f", "h": [expression, ..],
     "x_box", "u_box", "param_ranges": {name: [low, high], ..}, "bound_queries": [expression, ..]}

In the second kind every listed name is a symbol, also pi and E. Ends are numbers or texts without names, such as
"pi/3"; "oo" and "-oo" are infinite.
"""

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import sympy as sp

from hgogen.errors import BadArgument, HgogenError, nearest
from hgogen.reading.declared import cells_of, with_disturbance
from hgogen.reading.expression import BadExpression, Fold, parse
from hgogen.reading.expression import read as read_expression
from hgogen.reading.files import BYTES, READERS, Unread, content_of, quoted
from hgogen.rigor.box import EVERYTHING, Box, End, box
from hgogen.rigor.lookup import Cells
from hgogen.rigor.series import ends as of_ball
from hgogen.rigor.series import values
from hgogen.rigor.tape import tape
from hgogen.signal import Signal, t
from hgogen.system import System

TEXT, NUMBER, EXPRESSION, TABLE, RANGES = "text", "a number", "an expression", "a table", "pairs of numbers"
NUMBERS, ROWS, EXPRESSIONS = "a list of numbers", "a list of lists of numbers", "a list of expressions"
SWITCH = "true or false"
_SIGNAL = {"unit": TEXT, "meaning": TEXT, "value": NUMBER, "low": NUMBER, "high": NUMBER}
_TURN = {"period": EXPRESSION}  # "2*pi" or 360
KINDS: dict[str, tuple[dict[str, str], str | None]] = {  # keys of each kind of signal, and the required one
    "states": ({**_SIGNAL, **_TURN, "rates": RANGES, "flow": EXPRESSION}, "flow"),
    "inputs": ({**_SIGNAL, **_TURN, "rates": RANGES}, None),
    "parameters": (_SIGNAL, "value"),
    "outputs": ({**_SIGNAL, **_TURN, "equation": EXPRESSION}, "equation"),
}
DISTURBANCE = {**_SIGNAL, "rates": RANGES, "on": TEXT, "order": NUMBER}
POINTS = {"x": NUMBERS, "y": NUMBERS, "z": ROWS, "kind": TEXT}
_COORDINATES = ("x", "y", "z")
TOP = {
    **dict.fromkeys(("name", "meaning", "reference", "time"), TEXT),
    **dict.fromkeys(KINDS, TABLE),
    "invariants": EXPRESSIONS,
    "discrete": SWITCH,
    **dict.fromkeys(("disturbances", "tables", "known", "observer", "tuning", "trial", "dissipation", "bounds"), TABLE),
}
_OF_PLANT = ("name", "time", "discrete", "disturbances", "tables", "invariants", *KINDS)
OTHER_KEYS = tuple(key for key in TOP if key not in _OF_PLANT)  # the keys that do not declare the plant
Result = TypeVar("Result")
_LARGEST = 1e300  # beyond it a number of a file is a slip
_EXAMPLES = {
    TEXT: '"..."',
    NUMBER: f"1.5, finite, below {_LARGEST:g} and without quotes",
    EXPRESSION: '"x2 - sin(x1)"',
    TABLE: "[...] with keys",
    RANGES: "[[-1, 1], [-2, 2]]",
    NUMBERS: "[0, 0.5, 1]",
    ROWS: "[[0, 1], [2, 3]]",
    EXPRESSIONS: '["x1**2 + x2**2 - 1"]',
    SWITCH: "true, without quotes",
}


@dataclass(eq=False)
class BadModelFile(HgogenError):
    """The error that a model file is faulty; `key` is the path of tables to the fault, empty for the file as a
    whole."""

    file: str
    key: str
    reason: str

    def __str__(self) -> str:
        return f"{self.file}{f', {self.key}' if self.key else ''}: {self.reason}"


class NoText(BadArgument):
    """The error that plain text cannot represent a system."""

    text = "system {what!r} cannot be written as plain text: {reason}"


@dataclass(frozen=True)
class PlainModel:
    """The content of a plain-text model.

    `known`, `observer`, `tuning`, `trial`, `dissipation` and `bounds` are its tables as written, empty if missing;
    `folds`: the expressions that SymPy simplified so that a condition for a real value was lost, such as x/x.
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
    """Return the model in a .toml or .json file. Raises: `BadModelFile` with file, key and fix."""
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
    """Return the model in a dictionary, as the TOML and JSON parsers return it; `file`: its name in errors. Raises:
    `BadModelFile`."""
    demand_keys(file, "", table, TOP, "name")
    groups = {kind: table.get(kind, {}) for kind in KINDS}
    signals: dict[str, list[Signal]] = {}
    for kind, group in groups.items():
        signals[kind] = [_signal(file, kind, name, entry, *KINDS[kind]) for name, entry in group.items()]
    symbols = {signal.name: signal for kind in KINDS for signal in signals[kind]}
    now = symbols.get(t.name, t)  # the time, unless a signal has its name
    tables = {name: _points(file, name, entry) for name, entry in table.get("tables", {}).items()}
    for name in tables.keys() & symbols.keys():
        raise BadModelFile(file, f"tables.{name}", f"a signal is called {name!r} as well; rename one of the two")

    def expressions(kind: str, key: str) -> list[Fold]:
        return [
            with_file_errors(
                file, f"{kind}.{name}.{key}", read_expression, str(entry[key]), symbols | {t.name: now}, tables
            )
            for name, entry in groups[kind].items()
        ]

    rows = {"flow": expressions("states", "flow"), "output": expressions("outputs", "equation")}
    rows["invariants"] = [
        with_file_errors(file, "invariants", read_expression, str(text), symbols, tables)
        for text in table.get("invariants", ())
    ]
    readings = {what: [one.reading for one in group] for what, group in rows.items()}
    about = {"time": table.get("time", "s"), "discrete": table.get("discrete", False)}
    plant = with_file_errors(file, "", System, table["name"], **readings, **signals, **about)
    for name, entry in table.get("disturbances", {}).items():
        signal = _signal(file, "disturbances", name, entry, DISTURBANCE, "on")
        on, order = entry["on"], entry.get("order", 1)
        plant = with_file_errors(file, f"disturbances.{name}", with_disturbance, plant, on, order, signal=signal)
    others = {key: table.get(key, "" if TOP[key] == TEXT else {}) for key in OTHER_KEYS}
    return PlainModel(file, plant, **others, folds=tuple(one for group in rows.values() for one in group if one.lost))


def demand_keys(file: str, where: str, table: Any, keys: Mapping[str, str], needed: str | None = None) -> None:
    """Check the keys of a `table` of a model file: raise `BadModelFile` unless every key is in `keys`, its value of the
    kind that this maps it to, and the key `needed` exists. `where`: the path of the table, for errors."""
    if not isinstance(table, Mapping):
        raise BadModelFile(file, where, f"is {_described(table)}, not a table; write its keys, {', '.join(keys)}")
    for key, value in table.items():
        path = f"{where}.{key}" if where else key
        if key not in keys:
            known = nearest(key, keys, f"the keys are {', '.join(keys)}")
            raise BadModelFile(file, path, f"there is no key {key[:60]!r} here; {known}")
        if not _FITS[keys[key]](value):
            raise BadModelFile(file, path, f"is {_described(value)}; write {keys[key]}, such as {_EXAMPLES[keys[key]]}")
    if needed is not None and needed not in table:
        example = _EXAMPLES[keys[needed]].partition(",")[0]
        raise BadModelFile(file, where, f"the key {needed!r} is missing; add {needed} = {example}")


def _number(value: Any) -> bool:
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
    EXPRESSIONS: lambda value: isinstance(value, list) and all(map(_FITS[EXPRESSION], value)),
    SWITCH: lambda value: isinstance(value, bool),
}


def _described(value: Any) -> str:
    if isinstance(value, dict | list):
        return "a table" if isinstance(value, dict) else "a list"
    if isinstance(value, str):
        return f"{str(value)[:40]!r}, text"
    huge = isinstance(value, int) and value.bit_length() > 1000  # Python does not print thousands of digits
    return "a huge number" if huge else repr(value)[:40]


def _signal(file: str, kind: str, name: str, entry: Any, keys: Mapping[str, str], needed: str | None) -> Signal:
    where = f"{kind}.{name}"
    demand_keys(file, where, entry, keys, needed)
    declared = {key: entry[key] for key in ("unit", "meaning", "low", "high", "rates") if key in entry}
    if "period" in entry:
        declared["period"] = with_file_errors(
            file, f"{where}.period", read_expression, str(entry["period"]), {}
        ).reading
    return with_file_errors(file, where, Signal, name, nominal=entry.get("value"), **declared)


def _points(file: str, name: str, entry: Mapping[str, Any]) -> Cells:
    where = f"tables.{name}"
    for key in ("x", "y"):
        demand_keys(file, where, entry, POINTS, key)
    *axes, values = (entry[key] for key in _COORDINATES if key in entry)
    return with_file_errors(file, where, cells_of, axes, values, entry.get("kind", "linear"), name)


def with_file_errors(file: str, where: str, function: Callable[..., Result], *args: Any, **kwargs: Any) -> Result:
    """Return function(*args, **kwargs), with an error in it replaced by a `BadModelFile` that names the `file` and, by
    `where`, the key."""
    try:
        return function(*args, **kwargs)
    except HgogenError as error:
        raise BadModelFile(file, where, str(error)) from None


# --- model to text ------------------------------------------------------------------------------------------


def to_text(plant: System, others: Mapping[str, Any] = MappingProxyType({})) -> str:
    """Return the plant as TOML, which `read` reads as an equal system; a float is written as its shortest decimal.
    `others`: the other top-level entries of the file by key, as `from_table` accepts them. Raises: `NoText` for a plant
    in new coordinates (`recast`), and for an expression outside the grammar."""
    if plant.origin is not None:
        raise NoText(plant.name, f"it is recast; write the plant it comes from, {plant.origin.plant.name!r}")
    symbols = {signal.name: signal for signal in plant.signals}
    symbols |= {t.name: t} if plant.times else {}
    bare = dict.fromkeys(plant.times, t)
    flow, output = ([row.xreplace(bare) for row in rows] for rows in (plant.flow, plant.output))
    equations = {
        "states": (plant.states, "flow", [_expression(plant, symbols, e) for e in flow]),
        "inputs": (plant.supplied, "", [""] * len(plant.supplied)),
        "parameters": (plant.parameters, "", [""] * len(plant.parameters)),
        "outputs": (plant.outputs, "equation", [_expression(plant, symbols, e) for e in output]),
    }
    lines = [f"name = {_quoted(plant.name)}"] + [f"time = {_quoted(plant.time)}"] * (plant.time != "s")
    lines += [f"{_key(key)} = {inline(value)}" for key, value in others.items()]
    invariants = [_expression(plant, symbols, row) for row in plant.invariants]
    lines += [f"invariants = {inline(invariants)}"] * bool(invariants) + ["discrete = true"] * plant.discrete
    lines += [line for cells in plant.tables for line in _table(plant, cells)]
    for kind, (signals, key, texts) in equations.items():
        for signal, text in zip(signals, texts, strict=True):
            entries: dict[str, Any] = {
                "unit": signal.unit or None,
                "meaning": signal.meaning or None,
                "value": signal.nominal,
            }
            entries |= {"low": signal.low, "high": signal.high, "rates": [list(pair) for pair in signal.rates] or None}
            entries |= {"period": signal.period} | ({key: text} if key else {})
            lines += ["", f"[{kind}.{signal.name}]"]
            lines += [f"{name} = {inline(value)}" for name, value in entries.items() if value is not None]
    return "\n".join(lines) + "\n"


def inline(value: Any) -> str:
    """Return a value in the syntax of TOML, in one line."""
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
    """Return a text as a basic string of TOML, which has JSON's escapes and also escapes DEL."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


# ---------------------------------------------------------------- entry


FORMAT = (
    '{"name": "osc", "states": ["x1", "x2"], "f": ["x2", "-a*x1 + u"], "outputs": ["y"], "h": ["x1"], "inputs": ["u"], '
    '"known_params": ["a"], "unknown_params": [], "x_box": {"x1": [-1, 1]}, "u_box": {"u": [-1, 1]}, '
    '"param_ranges": {"a": [1, 2]}, "bound_queries": ["x1**2"]}'
)
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z", re.ASCII)
_LISTS = ("states", "inputs", "known_params", "unknown_params", "outputs")
_BOXES = {"x_box": ("states",), "u_box": ("inputs",), "param_ranges": ("known_params", "unknown_params")}
_INFINITE = {"oo": math.inf, "inf": math.inf, "+oo": math.inf, "-oo": -math.inf, "-inf": -math.inf}
_BITS = 160


class BadEntry(BadArgument):
    """The error that a model in the file of a library of models cannot be read."""

    text = "model {what!r}: {reason}"


@dataclass(frozen=True)
class Entry:
    """A model in a library of models: x' = flow (n), y = output (p), expressions of the symbols in `states`, `inputs`,
    `known` and `unknown` (parameters).

    `outer`, `inner`: the closed box of the declared ranges, rounded outward and inward where an end is irrational;
    `inner` is None if it is empty. `queries`: expressions whose ranges are requested.
    """

    name: str
    states: tuple[sp.Symbol, ...]
    inputs: tuple[sp.Symbol, ...]
    known: tuple[sp.Symbol, ...]
    unknown: tuple[sp.Symbol, ...]
    outputs: tuple[str, ...]
    flow: tuple[sp.Expr, ...]
    output: tuple[sp.Expr, ...]
    outer: Box
    inner: Box | None
    queries: tuple[str, ...]

    @property
    def boxed(self) -> bool:
        """Whether any range is declared."""
        return bool(self.outer)

    @property
    def symbols(self) -> dict[str, sp.Symbol]:
        """Every declared symbol by name."""
        return {s.name: s for s in (*self.states, *self.inputs, *self.known, *self.unknown)}

    def declared(self, expression: sp.Expr) -> bool:
        """Return whether every symbol of the expression has a range."""
        return bool(expression.free_symbols <= self.outer.keys())


def entry(model: Any) -> Entry:
    """Return the model in a dictionary, an entry in the file of a library of models. Raises: `BadEntry`;
    `BadModelFile` for a fault in a plain-text model; `BadExpression` for a text that is no expression of the listed
    names."""
    if not isinstance(model, Mapping):
        raise BadEntry(quoted(model).strip("'"), f"is no object; write it as {FORMAT}")
    name = str(model.get("name", "without a name"))
    if isinstance(model.get("states"), Mapping):
        return _of_table(name, model)
    lists = {key: _names(name, key, model.get(key)) for key in _LISTS}
    lists["outputs"] = lists["outputs"] or tuple(f"y{k + 1}" for k in range(len(_texts(name, "h", model.get("h")))))
    listed = [s for key in _LISTS[:4] for s in lists[key]]
    twice = sorted({s for s in listed if listed.count(s) > 1})
    if twice:
        raise BadEntry(name, f"the name {twice[0]!r} is listed twice; rename one of the two")
    symbols = {s: sp.Symbol(s, real=True) for s in listed}
    rows = {}
    for key, per in (("f", "states"), ("h", "outputs")):
        texts = _texts(name, key, model.get(key))
        if len(texts) != len(lists[per]):
            have = f"has {len(lists[per])} {per} and {len(texts)} expressions in {key}"
            raise BadEntry(name, f"{have}; give one for each")
        if not texts:
            raise BadEntry(name, f"has no {per}; give at least one, and its expression in {key}")
        rows[key] = tuple(parse(text, symbols) for text in texts)
    outer, inner = _boxes(name, model, lists, symbols)
    states, inputs, known, unknown = (tuple(symbols[s] for s in lists[key]) for key in _LISTS[:4])
    queries = _texts(name, "bound_queries", model.get("bound_queries"))
    return Entry(name, states, inputs, known, unknown, lists["outputs"], rows["f"], rows["h"], outer, inner, queries)


def _of_table(name: str, model: Mapping[str, Any]) -> Entry:
    queries = _texts(name, "bound_queries", model.get("bound_queries"))
    plant = from_table({key: value for key, value in model.items() if key != "bound_queries"}, f"model {name!r}").plant
    if plant.discrete:
        raise BadEntry(name, "is discrete in time, and a library is of differential equations; check its model alone")
    ends = {s: pair for s, pair in box(plant.signals, plant.nominal).items() if pair != EVERYTHING}
    known, unknown = (tuple(p for p in plant.parameters if p.bounded is loose) for loose in (False, True))
    names = tuple(y.name for y in plant.outputs)
    return Entry(
        plant.name, plant.states, plant.inputs, known, unknown, names, plant.flow, plant.output, ends, ends, queries
    )


def _list(name: str, key: str, value: Any) -> Sequence[Any]:
    if value is None:
        return ()
    if not isinstance(value, Sequence) or isinstance(value, str | bytes):
        raise BadEntry(name, f"{key} is {quoted(value)}; write a list")
    return value


def _names(name: str, key: str, value: Any) -> tuple[str, ...]:
    for one in _list(name, key, value):
        if not isinstance(one, str) or not _NAME.match(one):
            raise BadEntry(name, f"{key} holds {quoted(one)}, which is no name: a letter, then letters, digits, _")
    return tuple(value or ())


def _texts(name: str, key: str, value: Any) -> tuple[str, ...]:
    texts = []
    for one in _list(name, key, value):
        if isinstance(one, bool) or not isinstance(one, str | int | float) or one != one:
            raise BadEntry(name, f"{key} holds {quoted(one)}; write each expression as text")
        texts.append(str(one))
    return tuple(texts)


def _boxes(
    name: str, model: Mapping[str, Any], lists: Mapping[str, Sequence[str]], symbols: Mapping[str, sp.Symbol]
) -> tuple[Box, Box | None]:
    outer, inner, empty = {}, {}, False
    for key, groups in _BOXES.items():
        ranges = model.get(key) or {}
        if not isinstance(ranges, Mapping):
            raise BadEntry(name, f'{key} is {quoted(ranges)}; write an object of ranges, such as {{"x": [0, 1]}}')
        allowed = [s for group in groups for s in lists[group]]
        for symbol, ends in ranges.items():
            if symbol not in allowed:
                raise BadEntry(name, f"{key} names {symbol!r}, which is none of its {' and '.join(groups)}")
            pair = _list(name, f"{key} of {symbol}", ends)
            if len(pair) != 2:
                raise BadEntry(name, f"{key} of {symbol} is {quoted(ends)}; write [low, high]")
            (low, low_in), (high_in, high) = (_end(name, f"{key} of {symbol}", end) for end in pair)
            if not low <= high or low == math.inf or high == -math.inf:
                raise BadEntry(name, f"{key} of {symbol}, {quoted(ends)}, holds no number; give low <= high")
            outer[symbols[symbol]] = (low, high)
            inner[symbols[symbol]] = (low_in, high_in)
            empty = empty or low_in > high_in
    return outer, None if empty else inner


def _end(name: str, what: str, value: Any) -> tuple[End, End]:
    """Return the nearest binary numbers below and above `value`, the end of a range; equal for a rational."""
    if isinstance(value, str):
        if value.strip() in _INFINITE:
            return (_INFINITE[value.strip()],) * 2
        exact = parse(value, {})
        if exact.is_Rational:
            return (Fraction(exact),) * 2
        ball = values(tape((exact,), ()), (), _BITS)[0]
        if not ball.is_finite():
            raise BadEntry(name, f"{what} holds {value!r}, which is no finite real number")
        return of_ball(ball)
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value:
        raise BadEntry(name, f'{what} holds {quoted(value)}, which is no number; write 0.5 or "pi/3"')
    if isinstance(value, float) and math.isinf(value):
        return value, value
    return (Fraction(repr(value)),) * 2
