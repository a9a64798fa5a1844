"""One model of a library file: names, expressions and boxes as SymPy, each fault met with a sentence.

    {"name", "states", "inputs", "outputs", "known_params", "unknown_params": [name, ..], "f", "h": [expression, ..],
     "x_box", "u_box", "param_ranges": {name: [low, high], ..}, "bound_queries": [expression, ..]}

or a plain-text model as `hgogen.reading.text_model` reads it, with "bound_queries" beside its tables. There a parameter
with a range is unknown, one without is known and has its value.

An expression means what SymPy makes of it: x/x is 1. Every listed name is a symbol, whatever it means elsewhere. Ends
are numbers or texts without names, such as "pi/3"; "oo" and "-oo" are infinite.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import sympy as sp

from hgogen.errors import BadArgument
from hgogen.reading.expression import parse
from hgogen.reading.filename import shown
from hgogen.reading.text_model import from_table
from hgogen.rigor.box import EVERYTHING, Box, End, box
from hgogen.rigor.series import ends as of_ball
from hgogen.rigor.series import values
from hgogen.rigor.tape import tape

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
    """A model of a library that cannot be read."""

    text = "model {what!r}: {reason}"


@dataclass(frozen=True)
class Entry:
    """A model: x' = flow (n), y = output (p), in the symbols of `states`, `inputs`, `known` and `unknown` parameters.

    `outer`, `inner`: the closed boxes, rounded outward and inward where an end is irrational; `inner` is None where
    nothing is left inside. `boxed`: whether any box is declared. `queries`: texts whose ranges are asked.
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
        """Whether every symbol of the expression has a range."""
        return bool(expression.free_symbols <= self.outer.keys())


def entry(model: Any) -> Entry:
    """Read one model, a dictionary as in the file. Raises: `BadEntry`; `BadModelFile` for a fault in a plain-text
    model; `BadExpression` for a text that is no expression of the listed names."""
    if not isinstance(model, Mapping):
        raise BadEntry(shown(model).strip("'"), f"is no object; write it as {FORMAT}")
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
        raise BadEntry(name, f"{key} is {shown(value)}; write a list")
    return value


def _names(name: str, key: str, value: Any) -> tuple[str, ...]:
    for one in _list(name, key, value):
        if not isinstance(one, str) or not _NAME.match(one):
            raise BadEntry(name, f"{key} holds {shown(one)}, which is no name: a letter, then letters, digits, _")
    return tuple(value or ())


def _texts(name: str, key: str, value: Any) -> tuple[str, ...]:
    texts = []
    for one in _list(name, key, value):
        if isinstance(one, bool) or not isinstance(one, str | int | float) or one != one:
            raise BadEntry(name, f"{key} holds {shown(one)}; write each expression as text")
        texts.append(str(one))
    return tuple(texts)


def _boxes(
    name: str, model: Mapping[str, Any], lists: Mapping[str, Sequence[str]], symbols: Mapping[str, sp.Symbol]
) -> tuple[Box, Box | None]:
    outer, inner, empty = {}, {}, False
    for key, groups in _BOXES.items():
        ranges = model.get(key) or {}
        if not isinstance(ranges, Mapping):
            raise BadEntry(name, f'{key} is {shown(ranges)}; write an object of ranges, such as {{"x": [0, 1]}}')
        allowed = [s for group in groups for s in lists[group]]
        for symbol, ends in ranges.items():
            if symbol not in allowed:
                raise BadEntry(name, f"{key} names {symbol!r}, which is none of its {' and '.join(groups)}")
            pair = _list(name, f"{key} of {symbol}", ends)
            if len(pair) != 2:
                raise BadEntry(name, f"{key} of {symbol} is {shown(ends)}; write [low, high]")
            (low, low_in), (high_in, high) = (_end(name, f"{key} of {symbol}", end) for end in pair)
            if not low <= high or low == math.inf or high == -math.inf:
                raise BadEntry(name, f"{key} of {symbol}, {shown(ends)}, holds no number; give low <= high")
            outer[symbols[symbol]] = (low, high)
            inner[symbols[symbol]] = (low_in, high_in)
            empty = empty or low_in > high_in
    return outer, None if empty else inner


def _end(name: str, what: str, value: Any) -> tuple[End, End]:
    """The numbers below and above, as near as `_BITS` bits make them; equal where the end is rational."""
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
        raise BadEntry(name, f'{what} holds {shown(value)}, which is no number; write 0.5 or "pi/3"')
    if isinstance(value, float) and math.isinf(value):
        return value, value
    return (Fraction(repr(value)),) * 2
