"""The model of a form without correction, one sample on: classical Runge-Kutta, parameters at their nominal values.

Its nonlinear part is evaluated in the declared box, as in an observer. Nothing is held where it has no value.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from hgogen.analysis.dynamics import Dynamics
from hgogen.discretisation.runge_kutta import RK4, advance, repeated
from hgogen.form import Form
from hgogen.graph import Graph, to_casadi
from hgogen.part import on_line
from hgogen.program import column, sym


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """CasADi functions: `move` (z, u now, u then) -> z one sample on, `read` (z, u) -> y, `enter` (x, u) -> z, of the
    plant's state as it was first declared; what they give is dense."""

    move: Any
    read: Any
    enter: Any


@lru_cache(maxsize=8)  # one record after another is predicted by the same model
def open_loop(form: Form, dt: float, between: str, steps: int = 1) -> OpenLoop:
    """The model over a sample of `dt`, in so many Runge-Kutta steps; `between`: how inputs go on, "line" or "hold"."""
    dynamics, states = Dynamics(replace(form, held=())), [signal for signal, _ in form.estimates]
    z, x = ca.SX.sym("z", form.n), ca.SX.sym("x", len(states))
    now, then = (ca.SX.sym(name, len(form.system.inputs)) for name in ("now", "then"))

    def rate(values: Any, c: float) -> dict[str, Graph]:
        return {"z": dynamics.flow(values["z"], then if between == "hold" else on_line(c, now, then))}

    moved = advance(repeated(RK4, steps) if steps > 1 else RK4, rate, {"z": z}, dt).result["z"]
    plant = dict(zip((*states, *form.system.inputs), (*ca.vertsplit(x), *ca.vertsplit(now)), strict=True))
    plant |= {p: ca.SX(float(value)) for p, value in form.system.nominal.items()}
    return OpenLoop(
        ca.Function("move", [z, now, then], [ca.densify(_nominal(form, moved))]),
        ca.Function("read", [z, then], [ca.densify(_nominal(form, dynamics.output(z, then)))]),
        ca.Function("enter", [x, now], [ca.densify(column(to_casadi(form.entry, plant)))]),
    )


def evaluated(function: Any, *tables: np.ndarray) -> np.ndarray:
    """Return the values (N, k) of a CasADi function of matrices with N columns, a column for each sample, at tables
    with a row for each. It reads and writes their memory, since CasADi converts an array number by number."""
    arrays = [np.ascontiguousarray(each, dtype=float) for each in tables]
    columns, samples = function.size_out(0)
    result = np.empty((samples, columns))
    buffer, evaluate = function.buffer()
    for k, each in enumerate(arrays):
        if each.size:
            buffer.set_arg(k, each.data)
    buffer.set_res(0, result.data)
    evaluate()
    return result


def _nominal(form: Form, graph: Graph) -> Graph:
    """The graph with tunable parameters at their nominal values."""
    tunable = form.system.tunable
    if not tunable:
        return graph
    values = [ca.SX(float(p.nominal or 0.0)) for p in tunable]
    return ca.substitute([graph], [sym("plant", p.name) for p in tunable], values)[0]
