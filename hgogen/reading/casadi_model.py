"""A plant declared in CasADi: x' = flow, y = output, graphs of SX or MX symbols, each of which is a Signal."""

from collections.abc import Iterable
from typing import Any

import casadi as ca
import sympy as sp

from hgogen.errors import BadArgument
from hgogen.graph import Graph, to_sympy
from hgogen.signal import Signal
from hgogen.system import System

Pairs = Iterable[tuple[Graph, Signal | Iterable[Signal]]]


class BadGraph(BadArgument):
    """A CasADi model that does not fit together; the sentence names the part and the fix."""

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
    """The System of a CasADi model.

    Args: `states`, `inputs`, `parameters`: pairs (symbol, Signal), or (vector symbol, a Signal for each entry); the
    symbols all SX or all MX. `flow` (n) and `output` (p): graphs of them, or lists of scalar graphs.
    `time`: as of `hg.System`.

    A float in a graph becomes the rational of its shortest decimal.

    Raises: `BadGraph` for symbols that are none, are given twice or are missing, for MX that does not expand to SX,
    and for rounding; `hgogen.graph.NoSymbols` for an operation without an expression; `BadSystem`.
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
    """The declared pairs of a kind, each as its symbol and the Signal of each of its entries. Raises: `BadGraph`."""
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
    """A graph, or a list of scalar graphs, as one dense column. Raises: `BadGraph`."""
    try:
        graph = ca.vertcat(*rows) if isinstance(rows, tuple | list) else rows
    except NotImplementedError:
        graph = None
    if not isinstance(graph, ca.SX | ca.MX):
        raise BadGraph(system, f"{what} is of type {type(rows).__name__}; give a CasADi graph, or a list of them")
    if graph.shape[1] != 1:
        raise BadGraph(system, f"{what} has the shape {graph.shape}; make it a column")
    return ca.densify(graph)
