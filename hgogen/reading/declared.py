"""Models from other sources than SymPy expressions: CasADi graphs, tables, unknown inputs.

`from_casadi`: x' = flow, y = output, graphs of SX or MX symbols, each of which is a Signal. `table`: a function of one
or two arguments, given by points. `with_disturbance`: an unknown input to one row of a plant, modelled by additional
states:

    x_i' = f_i(x, u) + d,    d' = d_dot,    d_dot' = d_ddot,    ..,    the last of `order` of them has the rate 0

An observer of the new plant also estimates d. The rate 0 of the last state models an input of which nothing else is
known: proofs hold while d follows this model, a jump of d is a new initial error, and a filter models its variation by
Q.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from numbers import Rational
from typing import Any

import casadi as ca
import sympy as sp

from hgogen.errors import BadArgument, nearest
from hgogen.graph import Graph, to_sympy
from hgogen.reading.given import among, requires_plant
from hgogen.rigor.functions import NAMES
from hgogen.rigor.lookup import KINDS, SEVERAL, Axis, Cells, applied
from hgogen.signal import Signal, check_name
from hgogen.system import BadSystem, System

Pairs = Iterable[tuple[Graph, Signal | Iterable[Signal]]]


class BadGraph(BadArgument):
    """The error that a CasADi model is inconsistent; the message names the part and the fix."""

    text = "CasADi model {what!r}: {reason}"


def from_casadi(
    name: str,
    *,
    states: Pairs,
    outputs: Iterable[Signal],
    flow: Graph | Iterable[Graph],
    output: Graph | Iterable[Graph],
    inputs: Pairs = (),
    parameters: Pairs = (),
    time: str = "s",
) -> System:
    """Return the System of a model whose equations are CasADi graphs.

    Args: `states`, `inputs`, `parameters`: pairs (symbol, Signal), or (vector symbol, a Signal for each entry); the
    symbols all SX or all MX. `flow` (n) and `output` (p): graphs of these symbols, or lists of scalar graphs. `time`:
    as of `hg.System`.

    A float in a graph becomes the rational number of its shortest decimal.

    Raises: `BadGraph` for a symbol that is no CasADi symbol, occurs twice or is undeclared, for MX that does not expand
    to SX, and for rounding; `hgogen.graph.NoSymbols` for an operation without an expression; `BadSystem`.
    """
    groups = {"states": states, "inputs": inputs, "parameters": parameters}
    declared = {kind: _pairs(name, kind, pairs) for kind, pairs in groups.items()}
    symbols = [symbol for pairs in declared.values() for symbol, _ in pairs]
    signals = [entries for pairs in declared.values() for _, entries in pairs]
    graphs = [_graph(name, what, rows) for what, rows in (("flow", flow), ("output", output))]
    known = {entry.name() for symbol in symbols for entry in ca.symvar(symbol)}
    for what, graph in zip(("flow", "output"), graphs, strict=True):
        for free in ca.symvar(graph):
            if not any(type(free) is type(s) and ca.depends_on(free, s) for s in symbols):
                hint = "which is another symbol of that name" if free.name() in known else "which is not declared"
                raise BadGraph(name, f"{what} uses {free.name()}, {hint}; pair that symbol with a Signal")
    try:
        function = ca.Function("model", symbols, graphs)
        function = function.expand() if function.is_a("MXFunction") else function
    except (RuntimeError, NotImplementedError) as error:
        last = str(error).strip().splitlines()[-1]
        raise BadGraph(name, f"does not become one SX function ({last}); declare it in SX, each symbol once") from None
    expressions = to_sympy(function, signals)
    rows = (*expressions[0], *expressions[1])
    if steps := sorted(str(node) for row in rows for node in row.atoms(sp.floor, sp.ceiling, sp.Mod)):
        raise BadGraph(name, f"uses {steps[0]}, which has no slope; hold a rounded value as an input or a parameter")
    by_kind: dict[str, Any] = {kind: [s for _, entries in pairs for s in entries] for kind, pairs in declared.items()}
    return System(name, **by_kind, outputs=outputs, flow=expressions[0], output=expressions[1], time=time)


def _pairs(system: str, kind: str, pairs: Any) -> list[tuple[Graph, tuple[Signal, ...]]]:
    if not isinstance(pairs, Iterable):
        raise BadGraph(system, f"{kind} is {str(pairs)[:60]}; give a list of pairs (symbol, Signal)")
    fix = f"{kind} is a list of pairs (symbol, Signal)"
    declared: list[tuple[Graph, tuple[Signal, ...]]] = []
    for pair in pairs:
        if not isinstance(pair, tuple | list) or len(pair) != 2:
            raise BadGraph(system, f"{kind} holds {str(pair)[:60]}, no pair; {fix}")
        symbol, signals = pair
        if isinstance(signals, Signal):
            signals = (signals,)
        entries = tuple(signals) if isinstance(signals, tuple | list) else ()
        if not isinstance(symbol, ca.SX | ca.MX) or not symbol.is_valid_input():
            raise BadGraph(system, f"{kind} holds {str(symbol)[:60]}, no CasADi symbol; {fix}")
        if len(entries) != symbol.numel() or not all(isinstance(entry, Signal) for entry in entries):
            raise BadGraph(system, f"{symbol} in {kind} has {symbol.numel()} entries; give a Signal for each, {fix}")
        declared.append((symbol, entries))
    return declared


def _graph(system: str, what: str, rows: Graph | Iterable[Graph]) -> Graph:
    try:
        graph = ca.vertcat(*rows) if isinstance(rows, tuple | list) else rows
    except NotImplementedError:
        graph = None
    if not isinstance(graph, ca.SX | ca.MX):
        raise BadGraph(system, f"{what} is of type {type(rows).__name__}; give a CasADi graph, or a list of them")
    if graph.shape[1] != 1:
        raise BadGraph(system, f"{what} has the shape {graph.shape}; make it a column")
    return ca.densify(graph)


# ---------------------------------------------------------------- table


Numbers = tuple[Fraction, ...]
_WHAT = ("xs", "ys")  # names of the axes
MOST = 2000  # points, so that a certificate holds their text, 100 000 characters, with all digits of double precision


class BadTable(BadArgument):
    """The error that a table is invalid; the message names the table and the fix."""

    text = "table {what!r}: {reason}"


def table(x: Any, xs: Iterable[Any], ys: Iterable[Any], *, kind: str = "linear", name: str = "table") -> sp.Expr:
    """Return the value at `x`, an expression of a model, of the function given by the points (xs, ys); it is constant
    before the first and after the last point.

    `kind`: "linear", which interpolates linearly, is Lipschitz and has kinks at the points; or "monotone", cubic pieces
    that rise and fall with the points and have no other extrema (Fritsch and Carlson's conditions, Fritsch and
    Butland's slopes, as in PCHIP), continuously differentiable between the ends. `name`: the table's name in reports
    and in the emitted code.

    A function of two expressions is a map, hg.table((x, y), (xs, ys), zs): bilinear between the lines of the grid and
    constant beyond its ends, Lipschitz with kinks at the lines. `zs` (len(xs), len(ys)) has a row for each of xs, as in
    SciPy's RegularGridInterpolator.

    Raises: `BadTable` for fewer than two points, lists of different lengths, entries that are not finite numbers, `xs`
    that do not increase, an `x` that is no real expression, a map that is not linear, more than two expressions;
    `BadName`.
    """
    arguments: list[Any] = [x]
    axes: list[Any] = [xs]
    if isinstance(x, tuple | list) and len(x) > 1:
        if len(x) > 2:
            fix = "write it as a sum or product of such, or as a formula"
            raise BadTable(name, f"is taken at {len(x)} expressions, and a table is a function of one or two; {fix}")
        if not isinstance(xs, tuple | list) or len(xs) != 2 or not all(isinstance(each, Iterable) for each in xs):
            problem = f"is taken at 2 expressions and its axes are {xs!r:.60}"
            raise BadTable(name, f"{problem}; give two lists of numbers, (xs, ys)")
        arguments, axes = list(x), list(xs)
    cells = cells_of(axes, ys, kind, name)
    return applied(cells, [_argument(name, each) for each in arguments])


def _argument(name: str, x: Any) -> sp.Expr:
    try:
        argument = sp.sympify(x, strict=True)
    except (sp.SympifyError, TypeError):
        raise BadTable(name, f"is taken at {x!r}; give an expression of the model's signals, such as a state") from None
    if not isinstance(argument, sp.Expr) or argument.is_Matrix or argument.is_real is False:
        raise BadTable(name, f"is taken at {argument}, no real expression; give one of the model's signals")
    return argument


def cells_of(axes: Sequence[Any], values: Any, kind: str, name: str) -> Cells:
    """Return the table with these breakpoints and values. `axes`: one list of breakpoints, or two for a map; `values`:
    at the breakpoints; `kind`, `name` and errors as of `table`."""
    check_name(name)
    if name in NAMES:
        raise BadTable(name, "has the name of a function; choose another")
    if not among(kind, KINDS):
        raise BadTable(name, f'kind = {kind!r} is none of its kinds; write "linear" or "monotone"')
    if len(axes) > 1 and kind not in SEVERAL:
        raise BadTable(name, f'is of two expressions and kind = {kind!r}; a map is linear in each: write "linear"')
    x = [_numbers(name, what, each) for what, each in zip(_WHAT, axes, strict=False)]
    numbers = _curve(name, x[0], values) if len(x) == 1 else _map(name, x, values)
    for what, each in zip(_WHAT, x, strict=False):
        if len(x) > 1 and len(set(each)) < 2:
            constant = ", ".join(f"{float(number):g}" for number in each[:3]) or "empty"
            fix = "give 2 numbers or more, or leave this axis out: a table of the other expression alone"
            raise BadTable(name, f"{what} is a constant, {constant}; {fix}")
        for k, (a, b) in enumerate(pairwise(each), 1):
            if not a < b:
                pair = f"{what} {k} and {k + 1}, {float(a):g} and {float(b):g}"
                raise BadTable(name, f"{pair}, do not increase; sort them")
    cells = Cells(name, kind, tuple(map(Axis, x)), numbers)
    if not _fits(cells):
        raise BadTable(name, "is too steep, or too large, for double precision; choose other units")
    return cells


def _curve(name: str, x: Numbers, values: Any) -> Numbers:
    y = _numbers(name, "ys", values)
    if len(x) != len(y):
        raise BadTable(name, f"has {len(x)} xs and {len(y)} ys; give a y for each x")
    if not 2 <= len(x) <= MOST:
        raise BadTable(name, f"has {len(x)} point{'s' * (len(x) != 1)}; give 2 to {MOST}")
    return y


def _map(name: str, axes: Sequence[Numbers], values: Any) -> tuple[Numbers, ...]:
    _demand_list(name, "zs", values, "a row of numbers for each of xs")
    rows = tuple(_numbers(name, f"row {k} of zs", row, ", number") for k, row in enumerate(values, 1))
    count, width = map(len, axes)
    if len(rows) != count or any(len(row) != width for row in rows):
        turned = len(rows) == width and all(len(row) == count for row in rows)
        fix = "transpose zs" if turned else f"give {count} rows, one for each of xs, of {width} numbers"
        lengths = " or ".join(map(str, sorted({len(row) for row in rows}))) or "no"
        shape = f"{len(rows)} row{'s' * (len(rows) != 1)} of {lengths} numbers"
        raise BadTable(name, f"has {count} xs, {width} ys, and in zs {shape}; {fix}")
    if count * width > MOST:
        raise BadTable(name, f"has {count} x {width} points; give {MOST} at most")
    return rows


def _fits(cells: Cells) -> bool:
    try:
        finite = all(math.isfinite(float(c)) for order in cells.orders for c in cells.of_order(order).flat)
        return finite and all(float(a) < float(b) for axis in cells.axes for a, b in pairwise(axis.x))
    except OverflowError:
        return False


def _numbers(name: str, what: str, values: Any, each: str = "") -> Numbers:
    _demand_list(name, what, values, "a list of numbers")
    return tuple(_number(name, f"{what}{each} {k}", value) for k, value in enumerate(values, 1))


def _demand_list(name: str, what: str, values: Any, fix: str) -> None:
    if isinstance(values, str | Mapping | set | sp.Basic) or not isinstance(values, Iterable):
        raise BadTable(name, f"{what} is {values!r:.60}; give {fix}")


def _number(name: str, what: str, value: Any) -> Fraction:
    """Return the exact number; of a float, the number of its shortest decimal: 1/10 for 0.1."""
    if isinstance(value, sp.Rational):
        return Fraction(int(value.p), int(value.q))
    if isinstance(value, Rational) and not isinstance(value, bool):
        return Fraction(value)
    try:
        number = math.nan if isinstance(value, bool | str) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise BadTable(name, f"{what} is {value!r:.60}, no finite number; give one")
    return Fraction(repr(number))


# ---------------------------------------------------------------- disturbed


@requires_plant
def with_disturbance(
    plant: System, on: str | sp.Symbol, order: int = 1, *, signal: Signal | None = None, name: str | None = None
) -> System:
    """Return the plant with an unknown input d that is added to the rate of one state, and is itself a further state,
    d' = 0.

    Args: `on`: the state whose rate contains d, or its name; `order`: the number of states of the disturbance: d, and
    from 2 on its derivatives, named NAME_dot, NAME_ddot, ..; `signal`: d, whose range is that of its estimate, and
    whose `rates` are the ranges of the derivatives, one for each from order 2 on; `name`: that of the new plant, by
    default the plant's own.

    `hg.observability`, `hg.survey` and the checks of a form report whether d is observable. Raises: `BadSystem` for an
    unknown state, a missing range, a plant in new coordinates (`recast`) or a name in use.
    """
    if plant.origin is not None:
        fix = "give the disturbance to the plant that it was recast from, and recast that"
        raise BadSystem(plant.name, f"is recast, and its rows are not those of what is reported; {fix}")
    row = plant.states.index(_state(plant, on))
    unknown = _chain(plant, plant.states[row], order, signal)
    flow = [f + unknown[0] if i == row else f for i, f in enumerate(plant.flow)]
    new = plant.name if name is None else name
    return replace(plant, name=new, states=(*plant.states, *unknown), flow=(*flow, *unknown[1:], sp.S.Zero))


def _state(plant: System, on: str | sp.Symbol) -> Signal:
    name, known = str(on), {x.name: x for x in plant.states}
    if name in known and on in (name, known[name]):
        return known[name]
    what, fix = "no state of it", nearest(name, known, f"its states are {', '.join(known)}")
    if name in known:
        what, fix = "a symbol of that name, and not the state", "give the state, or its name"
    elif name in {u.name for u in plant.inputs}:
        what = "an input, which has no row"
    raise BadSystem(plant.name, f"on = {name[:60]!r} is {what}; {fix}")


def _chain(plant: System, state: Signal, order: int, signal: Signal | None) -> tuple[Signal, ...]:
    if isinstance(order, bool) or not isinstance(order, int) or order < 1:
        raise BadSystem(plant.name, f"order = {order!r} must be a whole number, at least 1, which is for d' = 0")
    if not isinstance(signal, Signal):
        unit = f', "({state.unit})/{plant.time}"' if state.unit else ""
        example = f'hg.Signal("d_{state}"{unit}, low=-1, high=1)'
        raise BadSystem(plant.name, f"the disturbance on {state} needs a range; give it by signal={example}")
    if not signal.bounded:
        fix = "give low= and high=, on which every proof and the estimate's clamps rest"
        raise BadSystem(plant.name, f"the disturbance {signal} has no range; {fix}")
    if len(signal.rates) != order - 1:
        fix = "give a pair for each derivative that is a state, order - 1 of them" if order > 1 else "leave them out"
        have = f"{len(signal.rates)} rates, and order = {order}"
        raise BadSystem(plant.name, f"the disturbance {signal} has {have}; {fix}")
    turn = signal.period
    chain = [Signal(signal.name, signal.unit, signal.meaning, signal.nominal, signal.low, signal.high, period=turn)]
    for k in range(1, order):
        rate = signal.derivative(k, plant.time)
        what = "derivative" if k == 1 else f"derivative of order {k}"  # estimated, unlike that of an input
        chain.append(Signal(rate.name, rate.unit, f"{what} of {signal.name}", low=rate.low, high=rate.high))
    return tuple(chain)
