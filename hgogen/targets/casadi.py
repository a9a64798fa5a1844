"""CasADi functions, for those who build on: the continuous observer, its estimate, and the step, with named entries.

    derivative   (state, u, y, p) -> rate               state' of the observer's differential equations
    estimate     (state, u, p) -> x                     the plant's state from that state
    step         (state, u, y, p) -> next, x, status    one call: the memory after it, the estimate, the status;
                                                        then each report of the step, such as age
    begin        t -> state                             of functions of t: all that a call remembers, before one at t

The first two have one state, `continuous`, the step has another, `memory`: all that a call remembers. Each vector names
its elements. A covariance is the S or P that an explicit method integrates, and P where the method keeps factors. `p`
is limited to its ranges in every call, as `tune` does it; the status says so. A status of more than 32 bits is two
numbers, the lower 32 bits first.

A sample that is not a number is missing, in the derivative as in the step. The other guards, restarts, and what an
observer does at samples alone (the predictors of an innovation, a gain that is switched) are no differential equation
and in the step alone: in the derivative such entries are held, and `held` names them. A bank has no derivative.

The step has the values of `step.run`, up to the rounding of CasADi's own sin, exp and the like, and with `bundled` its
bits: then those are computed as in the C (of a zero, the sign may differ).
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from hgogen.emit.elementary import elementary
from hgogen.emit.node import CALLS, operations
from hgogen.emit.syntax import Real
from hgogen.errors import BadArgument
from hgogen.graph import Graph
from hgogen.program import Block
from hgogen.reading.given import among, demand_switch
from hgogen.rigor.lookup import Lookup, walked
from hgogen.step import Step, demand_step
from hgogen.stepping.discretise import NoEquation
from hgogen.stepping.graphs import Flow, Graphs, Vector
from hgogen.stepping.guards import EXACT
from hgogen.target import Files


class NotInCasadi(BadArgument):
    """The error for a precision or another argument that the target casadi does not support."""


@dataclass(frozen=True, repr=False)
class Functions(Files):
    """A step as CasADi functions. As files, each function is serialised (`casadi.Function.deserialize` reads it in
    Python, C++ and MATLAB), and NAME_entries.json names the elements of its arguments and results.

    `step` a `casadi.Function` of one call; `memory`, `u`, `y`, `p`, `x` its vectors; `bits` the names of its status
    bits; `reports`: the vectors of its further results, by name; `flow`: the differential equations, or why there are
    none; `begin`: the memory before a first call at t, None for a plant without functions of t.
    """

    step: ca.Function
    memory: Vector
    u: Vector
    y: Vector
    p: Vector
    x: Vector
    bits: tuple[str, ...]
    flow: Flow | NoEquation
    reports: Mapping[str, Vector]
    begin: ca.Function | None

    @property
    def derivative(self) -> ca.Function:
        """The `casadi.Function` of dz/dt, the right-hand sides of the observer's differential equations. Raises:
        `NoEquation`."""
        return self._flow.derivative

    @property
    def estimate(self) -> ca.Function:
        """The `casadi.Function` that computes the plant's estimated states x from the observer's state z. Raises:
        `NoEquation`."""
        return self._flow.estimate

    @property
    def continuous(self) -> Vector:
        """The vector of the observer's state z in its differential equations. Raises: `NoEquation`."""
        return self._flow.state

    @property
    def held(self) -> tuple[str, ...]:
        """The names of the elements of z (such as an adaptive theta) whose derivative is 0 because they change at
        samples only. Raises: `NoEquation`."""
        return self._flow.constant

    def flags(self, status: Any) -> tuple[str, ...]:
        """Return the names of the bits that are set in `status`: one number or, of more than 32 bits, two."""
        whole = sum(int(word) << EXACT * k for k, word in enumerate(np.ravel(np.asarray(status))))
        return tuple(bit for k, bit in enumerate(self.bits) if whole >> k & 1)

    @property
    def _flow(self) -> Flow:
        if isinstance(self.flow, NoEquation):
            raise self.flow
        return self.flow

    def __repr__(self) -> str:
        return f"<CasADi functions {', '.join(name for name in self if not name.endswith('.json'))}>"


def casadi(step: Step, *, real: Real = "double", bundled: bool = False) -> Functions:
    """Return the functions of a step.

    Args: `real` is "double", in which CasADi computes; `bundled`: sin, exp and the like by the functions of the C, for
    the same bits.

    Raises: `NoStep`; `NotInCasadi` for float.
    """
    demand_step(step, "casadi")
    demand_switch("casadi, bundled=", bundled)
    if not among(real, ("double",)):
        raise NotInCasadi(f"real = {real!r}", 'is not what CasADi computes in: take "double", or the target c99')
    known = elementary("double") if bundled else {}
    graphs = Graphs(step, lambda block: _block(block, known))
    call, flow, begin = graphs.step(), _flow(graphs), graphs.begin()
    u, y, p = graphs.inputs
    vectors = {"memory": graphs.memory, "u": u, "y": y, "p": p, "x": graphs.estimates}
    continuous = {"continuous": flow.state} if isinstance(flow, Flow) else {}
    functions = [call, *([flow.derivative, flow.estimate] if isinstance(flow, Flow) else [])]
    functions += [begin] if begin else []
    texts = [(f"{function.name()}.casadi", function.serialize()) for function in functions]
    keys = ("name", "initial", "unit", "meaning")
    listed: dict[str, list[dict[str, Any]]] = {
        name: [{key: getattr(each, key) for key in keys} for each in vector.entries]
        for name, vector in (vectors | graphs.reports | continuous).items()
    }
    raised = step.layout.raised
    listed["status"] = [{"name": bit.name, "meaning": bit.meaning, "action": step.action_of(bit)} for bit in raised]
    texts.append((f"{step.name}_entries.json", json.dumps(listed, indent=1) + "\n"))
    bits = tuple(bit.name for bit in raised)
    return Functions(tuple(texts), step=call, bits=bits, flow=flow, reports=graphs.reports, begin=begin, **vectors)


def _flow(graphs: Graphs) -> Flow | NoEquation:
    try:
        return graphs.flow()
    except NoEquation as error:
        return error


# --- the function of a block

_CHOSEN: Mapping[int, Callable[[Graph, Graph], Graph]] = {
    ca.OP_FMIN: lambda a, b: ca.if_else(a <= b, a, b),
    ca.OP_FMAX: lambda a, b: ca.if_else(a >= b, a, b),
}


def _block(block: Block, known: Mapping[str, Callable[..., Graph]]) -> ca.Function:
    """Return the CasADi function of a block of a step's program, operation by operation, so that the bits are those of
    C; `known`: functions that replace operations, by name. A clamp is a choice whose derivative at the end of the range
    is that of the value: CasADi's fmin and fmax have half of that derivative there, and a gain often begins at the end
    of its range."""
    inputs = block.graph.sx_in()
    return ca.Function("block", inputs, _walked(block.graph, inputs, known)[: len(block.writes)])


def _walked(function: ca.Function, inputs: Sequence[Graph], known: Mapping[str, Callable[..., Graph]]) -> list[Graph]:
    """Return the outputs of a CasADi function at `inputs`, built operation by operation; calls of other functions
    remain calls, so that the order of operations does not change. `known`: functions that replace operations, by
    name."""

    def apply(op: int, lookup: Lookup | None, *values: Graph) -> Graph:
        function = lookup or _CHOSEN.get(op) or known.get(CALLS.get(op, ""))
        return function(*values) if function else (ca.SX.unary if len(values) == 1 else ca.SX.binary)(op, *values)

    def call(routine: ca.Function, values: Sequence[Graph]) -> list[Graph]:
        symbols = routine.sx_in()
        inner = ca.Function(routine.name(), symbols, _walked(routine, symbols, known), {"never_inline": True})
        results: list[Graph] = inner.call(list(values))
        return results

    return walked(function, inputs, apply, call, operations(function) if known else ())
