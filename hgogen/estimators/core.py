"""The linear error core of an estimator, without saturations and with saturations inside.

The linear error core of an estimator: x' = M x + B y + what is nonlinear, x its fields in a column.

It is a derivative of `Ode.linear`, which is linear in the fields and the measurement. The error of the estimate obeys
the same M where the model's nonlinear terms agree, so the eigenvalues of M are the observer's poles, and (M, B) is what
measurement noise goes through.

Estimators with saturations inside their linear core, at the ranges of the states they estimate.

    field' = lines(fields, y - o(u), saturate, c),   c = c(., u) of the chain

The linear error core is `lines` without saturation, c = 0. While a saturation acts, a state inside its range keeps the
saturated estimate at least as near as the estimate itself.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import casadi as ca
import numpy as np

from hgogen.estimators.integrators import Integrators
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.observer import Observer, parameter_fields
from hgogen.part import Ode
from hgogen.program import Block, Field, Place, address, sym
from hgogen.reading.given import BadGain


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


ONE: Mapping[Place, np.ndarray] = {Place("gain", "theta"): np.ones(1)}


def core_at_one(part: Ode) -> tuple[np.ndarray, np.ndarray]:
    """M (N, N) and B (N, 1) of a part of one output that has a core, at theta = 1."""
    linear = core(part, 1)
    assert linear is not None
    return numbers(linear.M, ONE), numbers(linear.B, ONE)


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
    return values | {Place("state", f"last_{name}"): np.zeros(1) for name in form.fallback}


def nominal(observer: Observer) -> dict[Place, np.ndarray]:
    """The numbers of the places of the form, of gains and what is derived of them, all as declared."""
    values = of_form(observer.form)
    values |= {Place("gain", field.name): np.array(field.initial) for field in observer.gains}
    for part in observer.parts:
        for block in part.tune if isinstance(part, Ode) else ():
            assert isinstance(block, Block)
            values |= {place: numbers(value, values) for place, value in block.writes.items()}
    return values


Saturate = Callable[[Graph, int], Graph]  # an SX scalar to the range of w_i
Model = Callable[[Graph], Graph]  # c (n) of w (n)
Lines = Callable[[Mapping[str, Graph], Graph, Graph, Saturate, Model], Mapping[str, Graph]]


@dataclass(frozen=True, eq=False)
class Saturating(Ode):
    """An estimator with saturations in its linear core: `whole`, by field name, is its right-hand side in one piece,
    of fewer operations than linear + rest."""

    whole: Callable[[Mapping[str, Graph], Graph, Graph, Graph], Mapping[str, Graph]] | None = None

    def rhs(self, values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        """The whole right-hand side."""
        assert self.whole is not None
        return dict(self.whole(values, u, y, valid))


def saturating(chain: Integrators, fields: tuple[Field, ...], lines: Lines) -> Saturating:
    """The estimator field' = lines(values, y - o(u), valid, saturate, c): saturate(value, i) is clamped to the range of
    w_i, c(w) are the chain's nonlinear terms (n)."""

    def linear(values: Mapping[str, Graph], y: Graph, valid: Graph) -> Mapping[str, Graph]:
        return lines(values, y, valid, lambda value, _: value, lambda _: ca.SX.zeros(chain.n))

    def whole(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> Mapping[str, Graph]:
        return lines(values, y - chain.offset(u), valid, chain.saturated, lambda w: chain.nonlinear(w, u))

    def rest(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        core, all_ = linear(values, y - chain.offset(u), valid), whole(values, u, y, valid)
        return {name: all_[name] - core[name] for name in core}

    return Saturating(fields, rest, linear, chain.offset, whole=whole)


def vertices(chain: Integrators, fields: tuple[Field, ...], lines: Lines) -> Iterator[np.ndarray]:
    """The linear error core (N, N) at theta = 1 with every saturation passing all, or nothing, of the estimate's error:
    what a saturated estimate of a state inside its range obeys is between them."""
    for shares in product((1.0, 0.0), repeat=chain.n - 1):

        def linear(
            values: Mapping[str, Graph], y: Graph, valid: Graph, shares: tuple[float, ...] = (1.0, *shares)
        ) -> Mapping[str, Graph]:
            return lines(values, y, valid, lambda value, i: shares[i] * value, lambda _: ca.SX.zeros(chain.n))

        yield core_at_one(Ode(fields, lambda *_: {}, linear))[0]


def gates(cores: Sequence[np.ndarray]) -> tuple[tuple[int, np.ndarray], ...]:
    """The shares that saturations pass on, of all `vertices`: the field whose error is passed, and the column (N) that
    this adds to the core of the last of them, where nothing is passed."""
    shut, columns = cores[-1], []
    for k in reversed(range(len(cores).bit_length() - 1)):
        passed = cores[-1 - 2**k] - shut
        (of,) = np.flatnonzero(passed.any(axis=0))
        columns.append((int(of), passed[:, of]))
    return tuple(columns)


def demand_ranges(observer: str, form: Form, wanted: Iterable[int]) -> None:
    """Raises: `BadGain` where one of the states `wanted` has no range to saturate its estimate to."""
    for i in wanted:
        if not form.states[i].bounded:
            what = form.to_form[i]
            raise BadGain(f"{observer} saturates the estimate of {what}", "which has no range; declare low and high")
