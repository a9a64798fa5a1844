"""The linear error core of an estimator: x' = M x + B y + what is nonlinear, x its fields in a column.

By differentiation of `Ode.linear`, which is linear in the fields and the measurement. The error of the estimate obeys
the same M where the model's nonlinear terms agree, so the eigenvalues of M are the observer's poles, and (M, B) is what
measurement noise goes through.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.observer import Observer, parameter_fields
from hgogen.part import Ode
from hgogen.program import Block, Place, address, sym


@dataclass(frozen=True, eq=False)
class Core:
    """The core x' = M x + B y with M (N, N) and B (N, p) in SX; `x`: the symbols of the fields that are not frozen, in
    their order."""

    x: Graph
    M: Graph
    B: Graph


def core(part: Ode, outputs: int, valid: Sequence[float] | None = None) -> Core | None:
    """The core as graphs of parameters and gains, frozen fields at their values; None where there is none.

    `valid` (p): 1 for an output whose sample can be used, else 0; by default all of them.
    """
    if part.linear is None:
        return None
    moving = [field for field in part.fields if field.name not in part.frozen]
    values: dict[str, Graph] = {field.name: sym("state", field.name, field.size) for field in moving}
    x, y = ca.vertcat(*values.values()), sym("work", "y", outputs)
    values |= {name: ca.SX(ca.DM(numbers)) for name, numbers in part.frozen.items()}
    lines = part.linear(values, y, ca.SX(ca.DM(np.ones(outputs) if valid is None else valid)))
    rate = ca.vertcat(*(lines.get(field.name, ca.SX(field.size, 1)) for field in moving))
    return Core(x, ca.jacobian(rate, x), ca.jacobian(rate, y))


def core_numbers(part: Ode, outputs: int, nominal: Mapping[Place, np.ndarray]) -> np.ndarray:
    """M (N, N) of a part that has a core, evaluated at the numbers of the places that it reads."""
    linear = core(part, outputs)
    assert linear is not None
    return numbers(linear.M, nominal)


def measured_numbers(part: Ode, outputs: int, nominal: Mapping[Place, np.ndarray]) -> np.ndarray:
    """B (N, p) of a part that has a core, evaluated likewise."""
    linear = core(part, outputs)
    assert linear is not None
    return numbers(linear.B, nominal)


def numbers(graph: Graph, nominal: Mapping[Place, np.ndarray]) -> np.ndarray:
    """The value of an SX graph of places of parameters and gains at their numbers."""
    symbols = ca.symvar(ca.SX(graph))
    values = [nominal[place].reshape(-1)[index] for place, index, _ in map(address, symbols)]
    (evaluated,) = ca.Function("numbers", symbols, [ca.densify(ca.SX(graph))]).call(values)  # of no symbols as well
    return np.array(evaluated)


def of_form(form: Form) -> dict[Place, np.ndarray]:
    """The numbers of the places of parameters, as declared, and of rows that are held, as before there was a finite
    value."""
    values = {Place("plant", field.name): np.array(field.initial) for field in parameter_fields(form.system.parameters)}
    return values | {Place("state", f"last_{name}"): np.zeros(1) for name in form.held}


def nominal(observer: Observer) -> dict[Place, np.ndarray]:
    """The numbers of the places of the form, of gains and what is derived of them, all as declared."""
    values = of_form(observer.form)
    values |= {Place("gain", field.name): np.array(field.initial) for field in observer.gains}
    for part in observer.parts:
        for block in part.tune if isinstance(part, Ode) else ():
            assert isinstance(block, Block)
            values |= {place: numbers(value, values) for place, value in block.writes.items()}
    return values
