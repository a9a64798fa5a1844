"""The linear error core of an estimator, without saturations and with saturations inside.

The linear error core of an estimator: x' = M x + B y + nonlinear terms, x the fields in a column.

M and B are the derivatives of `Ode.linear`, which is linear in the fields and the measurement. The estimation error
obeys the same M where the nonlinear terms of plant and model are equal, so the eigenvalues of M are the observer's
poles, and (M, B) is the filter of the measurement noise.

Estimators with saturations in their linear core, at the ranges of the estimated states.

    field' = lines(fields, y - o(u), saturate, c),   c = c(., u) of the chain

The linear error core is `lines` without saturation, c = 0. For a state inside its range the saturated estimate is at
least as near as the estimate.
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
    """The linear part x' = M x + B y of an estimator, x its stored variables and y the measurement: M (N, N) and B (N,
    p), SX of parameters and gains; `x`: the symbols of x, without frozen variables such as an adaptive gain."""

    x: Graph
    M: Graph
    B: Graph


def core(part: Ode, outputs: int, valid: Sequence[float] | None = None) -> Core | None:
    """Return M, B of the linear part x' = M x + B y of an estimator, x its stored variables, in terms of parameters and
    gains; None for an estimator without a linear part. `valid` (p): 1 for an output whose sample is used, else 0; by
    default every sample is used."""
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
    """Return M (N, N) of the linear part x' = M x + B y of an estimator, at the numbers `nominal` of its symbols."""
    linear = core(part, outputs)
    assert linear is not None
    return numbers(linear.M, nominal)


ONE: Mapping[Place, np.ndarray] = {Place("gain", "theta"): np.ones(1)}


def core_at_one(part: Ode) -> tuple[np.ndarray, np.ndarray]:
    """Return M (N, N), B (N, 1) of the linear part x' = M x + B y of an estimator of one output, at theta = 1."""
    linear = core(part, 1)
    assert linear is not None
    return numbers(linear.M, ONE), numbers(linear.B, ONE)


def numbers(graph: Graph, nominal: Mapping[Place, np.ndarray]) -> np.ndarray:
    """Return the numerical value of an SX graph of parameters and gains; `nominal`: their numbers by place."""
    symbols = ca.symvar(ca.SX(graph))
    values = [nominal[place].reshape(-1)[index] for place, index, _ in map(address, symbols)]
    (evaluated,) = ca.Function("numbers", symbols, [ca.densify(ca.SX(graph))]).call(values)  # of no symbols as well
    return np.array(evaluated)


def of_form(form: Form) -> dict[Place, np.ndarray]:
    """Return the nominal values of the form's parameters by place, and 0 for each stored value of a rate or output that
    may be infinite."""
    values = {Place("plant", field.name): np.array(field.initial) for field in parameter_fields(form.system.parameters)}
    return values | {Place("state", f"last_{name}"): np.zeros(1) for name in form.fallback}


def nominal(observer: Observer) -> dict[Place, np.ndarray]:
    """Return the nominal values of parameters, of gains, and of the values derived from both, by place."""
    values = of_form(observer.form)
    values |= {Place("gain", field.name): np.array(field.initial) for field in observer.gains}
    for part in observer.parts:
        for block in part.tune if isinstance(part, Ode) else ():
            assert isinstance(block, Block)
            values |= {place: numbers(value, values) for place, value in block.writes.items()}
    return values


Saturate = Callable[[Graph, int], Graph]  # clamps an SX scalar to the range of w_i
Model = Callable[[Graph], Graph]  # maps w (n) to c (n)
Lines = Callable[[Mapping[str, Graph], Graph, Graph, Saturate, Model], Mapping[str, Graph]]


@dataclass(frozen=True, eq=False)
class Saturating(Ode):
    """An estimator whose linear part contains saturations. `whole` returns the right-hand side by field name, with
    fewer operations than the sum of `linear` and `residual`."""

    whole: Callable[[Mapping[str, Graph], Graph, Graph, Graph], Mapping[str, Graph]] | None = None

    def rhs(self, values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        """Return the whole right-hand side, by field name."""
        assert self.whole is not None
        return dict(self.whole(values, u, y, valid))


def saturating(chain: Integrators, fields: tuple[Field, ...], lines: Lines) -> Saturating:
    """Return the estimator whose fields (stored variables) obey x' = lines(x, y - o(u), valid, saturate, c):
    saturate(value, i) clamps a value to the range of w_i, and c(w) (n) are the nonlinear terms of the chain w_i' =
    w_(i+1) + c_i(w, u)."""

    def linear(values: Mapping[str, Graph], y: Graph, valid: Graph) -> Mapping[str, Graph]:
        return lines(values, y, valid, lambda value, _: value, lambda _: ca.SX.zeros(chain.n))

    def whole(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> Mapping[str, Graph]:
        return lines(values, y - chain.offset(u), valid, chain.saturated, lambda w: chain.nonlinear(w, u))

    def remainder(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        core, total = linear(values, y - chain.offset(u), valid), whole(values, u, y, valid)
        return {name: total[name] - core[name] for name in core}

    return Saturating(fields, remainder, linear, chain.offset, whole=whole)


def vertices(chain: Integrators, fields: tuple[Field, ...], lines: Lines) -> Iterator[np.ndarray]:
    """Yield the matrices M (N, N) of the error e' = M e at theta = 1, c = 0, one for each combination of the
    saturations, each of which passes either all or nothing of its argument's error. While the plant's states are in
    their ranges, the true error matrix is a convex combination of these."""
    for shares in product((1.0, 0.0), repeat=chain.n - 1):

        def linear(
            values: Mapping[str, Graph], y: Graph, valid: Graph, shares: tuple[float, ...] = (1.0, *shares)
        ) -> Mapping[str, Graph]:
            return lines(values, y, valid, lambda value, i: shares[i] * value, lambda _: ca.SX.zeros(chain.n))

        yield core_at_one(Ode(fields, lambda *_: {}, linear))[0]


def saturation_columns(cores: Sequence[np.ndarray]) -> tuple[tuple[int, np.ndarray], ...]:
    """Return, for each saturation, the index of the field whose error it passes, and the column (N) that is added to M
    if it passes that error. `cores`: the `vertices`, of which the last one has every saturation pass nothing."""
    shut, columns = cores[-1], []
    for k in reversed(range(len(cores).bit_length() - 1)):
        passed = cores[-1 - 2**k] - shut
        (field,) = np.flatnonzero(passed.any(axis=0))
        columns.append((int(field), passed[:, field]))
    return tuple(columns)


def demand_ranges(observer: str, form: Form, wanted: Iterable[int]) -> None:
    """Raise `BadGain` if a state with an index in `wanted` has no range; the observer saturates these estimates."""
    for i in wanted:
        if not form.states[i].bounded:
            state = form.to_form[i]
            raise BadGain(f"{observer} saturates the estimate of {state}", "which has no range; declare low and high")
