"""Explicit Runge-Kutta methods as data: k_i = f(z + h sum_j a_ij k_j, c_i), z+ = z + h sum_i b_i k_i.

A routine is a part of a graph that emitted code keeps as a function of its own: the plant's flow, which each stage
calls, its Jacobian, or the right-hand side of a whole observer. In a graph it is a call of a CasADi function that is
never inlined. Values of the step's memory that it reads, such as parameters, are further arguments; the names of their
symbols give the places in memory.

`open_loop` is the model of a form without correction over one sample: classical Runge-Kutta, parameters at their
nominal values, its nonlinear part evaluated in the declared ranges, as in an observer. No state is clamped where the
model has no value.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache, reduce
from operator import add
from typing import Any

import casadi as ca
import numpy as np

from hgogen.analysis.dynamics import Dynamics
from hgogen.form import Form
from hgogen.graph import Graph, to_casadi
from hgogen.part import clock_of
from hgogen.program import Place, address, column, sym
from hgogen.system import System

RATE = "rate"  # the name of the last routine
MEANINGS = {
    "flow": "the plant's equation x' = f(x, u), in the coordinates of the estimate, but for rows that are constant",
    "jacobian": "the entries of the flow's Jacobian that are not constant, by columns",
    RATE: "the right-hand side of the observer's differential equation",
}
Values = Mapping[str, Graph]


@dataclass(frozen=True)
class Argument:
    """A column vector that a routine reads, by name and size; `place`: its place in the step's memory, if it is read
    there."""

    name: str
    size: int
    place: Place | None = None

    @property
    def label(self) -> str:
        """Return the column's name in emitted code: that of its place in the step's memory, if it has one."""
        return self.place.name if self.place else self.name

    def local(self, element: int) -> str:
        """Return the name of an element in emitted code: z1, or the name of the column where it has one element."""
        return self.label if self.size == 1 else f"{self.label}{element + 1}"


@dataclass(frozen=True, eq=False)
class Routine:
    """A routine: a CasADi `function` that emitted code keeps as a function of its own, such as the plant's flow."""

    function: ca.Function

    @property
    def name(self) -> str:
        """Return the name in emitted code, without the prefix: a key of `MEANINGS`."""
        return str(self.function.name())

    @cached_property
    def key(self) -> str:
        """Return a text, equal for two routines with equal results for equal arguments: the serialised function."""
        return str(self.function.serialize())

    @cached_property
    def arguments(self) -> tuple[Argument, ...]:
        """Return the column vectors that are the routine's arguments, in order."""
        arguments = []
        for name, symbols in zip(self.function.name_in(), self.function.sx_in(), strict=True):
            place = address(symbols[0])[0] if _is_place(symbols[0]) else None
            arguments.append(Argument(name, symbols.numel(), place))
        return tuple(arguments)

    def elements(self, argument: int) -> tuple[int, ...]:
        """Return the indices of those elements of argument number `argument` that the routine reads."""
        steps = range(self.function.n_instructions())
        reads = (self.function.instruction_input(k) for k in steps if self.function.instruction_id(k) == ca.OP_INPUT)
        return tuple(sorted({element for number, element in reads if number == argument}))

    @cached_property
    def results(self) -> tuple[tuple[str, int], ...]:
        """Return the names and sizes of the routine's results; the size of a matrix is its number of nonzeros."""
        return tuple((name, self.function.nnz_out(k)) for k, name in enumerate(self.function.name_out()))

    def entries(self, result: int) -> list[str]:
        """Return the names of the elements of result number `result`: F_21 of a matrix, by columns; dz3 of a column
        with fewer nonzeros than rows; "" for an element whose index is its row."""
        pattern, name = self.function.sparsity_out(result), self.function.name_out(result)
        if pattern.is_column():
            return ["" if row == k else f"{name}{row + 1}" for k, row in enumerate(pattern.row())]
        between = "_" if max(pattern.shape) > 9 else ""
        return [f"{name}_{i + 1}{between}{j + 1}" for i, j in zip(*pattern.get_triplet(), strict=True)]


def _is_place(symbol: Graph) -> bool:
    return ":" in symbol.name()


def routine(
    name: str, sizes: Mapping[str, int], body: Callable[[Values], Values]
) -> Callable[[Values], dict[str, Graph]]:
    """Return a function from columns, whose sizes are `sizes` by name, to the values of `body` by name. It calls the
    routine `name`, which the emitted code keeps as one function.

    The routine has only arguments that `body` reads, and only results and elements that are not constant numbers.
    """
    arguments = {key: column(ca.SX.sym(f"{key}_{k}") for k in range(size)) for key, size in sizes.items()}
    results = {key: _Result(value) for key, value in body(arguments).items()}
    moving = {key: result for key, result in results.items() if not result.value.is_constant()}
    if not moving:
        return lambda _: {key: result.value for key, result in results.items()}
    values = ca.cse([result.computed for result in moving.values()])
    symbols = ca.symvar(ca.veccat(*values))
    names = {symbol.name() for symbol in symbols}
    read = [key for key, each in arguments.items() if any(symbol.name() in names for symbol in ca.vertsplit(each))]
    places = sorted({(place, size) for place, _, size in map(address, filter(_is_place, symbols))})
    columns = [*(arguments[key] for key in read), *(sym(*place, size) for place, size in places)]
    labels = [*read, *(f"place{k}" for k in range(len(places)))]
    function = ca.Function(name, columns, values, labels, [*moving], {"never_inline": True})

    def call(at: Values) -> dict[str, Graph]:
        computed = function.call([*(ca.SX(at[key]) for key in read), *columns[len(read) :]])
        filled = {key: moving[key].filled(new) for key, new in zip(moving, computed, strict=True)}
        return {key: filled.get(key, result.value) for key, result in results.items()}

    return call


@dataclass(frozen=True)
class _Result:
    """A result of a routine, of which the routine computes the elements that are not constant."""

    value: Graph

    @cached_property
    def _computed(self) -> list[int]:
        return [k for k, each in enumerate(self.value.nonzeros()) if not each.is_constant()]

    @property
    def computed(self) -> Graph:
        rows, columns = self.value.sparsity().get_triplet()
        places = ([each[k] for k in self._computed] for each in (rows, columns))
        elements = self.value.nonzeros()
        return ca.SX(ca.Sparsity.triplet(*self.value.shape, *places), column(elements[k] for k in self._computed))

    def filled(self, computed: Graph) -> Graph:
        elements = self.value.nonzeros()
        for k, each in zip(self._computed, computed.nonzeros(), strict=True):
            elements[k] = each
        return ca.SX(self.value.sparsity(), column(elements))


@dataclass(frozen=True)
class Tableau:
    """The Butcher tableau of k_i = f(z + h sum_j a_ij k_j, c_i), z+ = z + h sum_i b_i k_i; `a`: below the
    diagonal; `order` is 0 for the map of a discrete plant."""

    name: str
    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    c: tuple[float, ...]
    order: int

    @property
    def map(self) -> bool:
        """Whether a step is z+ = f(z, 0), of a discrete plant."""
        return not self.order

    @property
    def equations(self) -> tuple[str, ...]:
        """Return the method's equations in lines, one for each stage k_i, and one for z+."""
        stages = (f"k_{i} = f(z{' + ' * any(row)}{_slopes(row)})" for i, row in enumerate(self.a, 1))
        return (*stages, f"z+ = z + {_slopes(self.b)}")

    @property
    def rows(self) -> tuple[str, ...]:
        """Return the tableau c | a over b in lines, as textbooks print it; none of a map."""
        if self.map:
            return ()
        entries = [[str(Fraction(a).limit_denominator(10_000)) for a in row] for row in (*self.a, self.b)]
        nodes = [*(str(Fraction(c).limit_denominator(10_000)) for c in self.c), ""]
        width, indent = (max(map(len, each)) for each in ([a for row in entries for a in row], nodes))
        lines = [
            f"{c:>{indent}} | {' '.join(f'{a:>{width}}' for a in row)}" for c, row in zip(nodes, entries, strict=True)
        ]
        return (*lines[:-1], "-" * len(lines[-1]), lines[-1])

    @property
    def chained(self) -> bool:
        """Return whether there are more than two stages, and each reads the slope of the stage before it alone, so that
        a step need remember only the sum of the other slopes."""
        return len(self.a) > 2 and not any(any(row[:-1]) for row in self.a)

    @property
    def polynomial(self) -> tuple[float, ...]:
        """Return the coefficients of the stability polynomial R(z) = 1 + sum_k z^(k+1) b' A^k 1, constant first."""
        weights, coefficients = [1.0] * len(self.b), [1.0]
        for _ in self.b:
            coefficients.append(sum(b * w for b, w in zip(self.b, weights, strict=True)))
            weights = [sum(a * w for a, w in zip(row, weights, strict=False)) for row in self.a]
        return tuple(coefficients)


def _slopes(weights: Iterable[float]) -> str:
    """Return the text of h sum_i w_i k_i for the weights w_i; "" if every weight is 0."""
    exact = {f"k_{j}": Fraction(weight).limit_denominator(10_000) for j, weight in enumerate(weights, 1) if weight}
    if not exact:
        return ""
    if len(exact) == 1:
        ((name, weight),) = exact.items()
        return f"h {name}" if weight == 1 else f"{weight} h {name}"
    return f"h ({' + '.join(name if weight == 1 else f'{weight} {name}' for name, weight in exact.items())})"


EULER = Tableau("Euler", ((),), (1.0,), (0.0,), 1)
HEUN = Tableau("Heun", ((), (1.0,)), (0.5, 0.5), (0.0, 1.0), 2)
RK4 = Tableau(
    "classical Runge-Kutta",
    ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
    (1 / 6, 1 / 3, 1 / 3, 1 / 6),
    (0.0, 0.5, 0.5, 1.0),
    4,
)


MAP = Tableau("the map z+ = f(z, u)", ((),), (1.0,), (0.0,), 0)


def plant_tableau(plant: System) -> Tableau:
    """Return the tableau that integrates a plant over a step: classical Runge-Kutta, or the map of a discrete plant."""
    return MAP if plant.discrete else RK4


def repeated(tableau: Tableau, times: int) -> Tableau:
    """Return the tableau of one long step that equals `times` equal steps of the method."""
    share = [b / times for b in tableau.b]
    rows = [
        (*share * k, *(a / times for a in row), *[0.0] * (len(share) - len(row)))
        for k in range(times)
        for row in tableau.a
    ]
    return Tableau(
        f"{tableau.name}, {times} steps",
        tuple(row[:i] for i, row in enumerate(rows)),
        tuple(share * times),
        tuple((k + c) / times for k in range(times) for c in tableau.c),
        tableau.order,
    )


@dataclass(frozen=True)
class Stages:
    """The graphs of a Runge-Kutta step: the new values by name, and the argument and the slope of each stage."""

    result: dict[str, Graph]
    arguments: tuple[dict[str, Graph], ...]
    slopes: tuple[dict[str, Graph], ...]

    @property
    def names(self) -> dict[str, Graph]:
        """Return the slopes by their names in emitted code (`k1_z`, ..)."""
        return {f"k{i}_{key}": k[key] for i, k in enumerate(self.slopes, 1) for key in k}


def advance(tableau: Tableau, rate: Callable[[Values, float], Values], start: Values, h: float | Graph) -> Stages:
    """Return a Runge-Kutta step of length h from the values `start`, by name; `rate(values, c)` is the derivative of
    the values at the fraction c of the step."""
    if tableau.map:
        return Stages(dict(rate(start, 0.0)), (dict(start),), ())
    arguments: list[dict[str, Graph]] = []
    slopes: list[dict[str, Graph]] = []
    for row, c in zip(tableau.a, tableau.c, strict=True):
        stage = dict(start)
        for a, slope in zip(row, slopes, strict=False):
            if a:
                stage = {key: value + h * a * slope[key] for key, value in stage.items()}
        arguments.append(stage)
        slopes.append(dict(rate(stage, c)))
    result, ratios = {}, _ratios(tableau.b)
    for key, value in start.items():  # z + h b_1 (k_1 + b_2/b_1 k_2 + ..): whole ratios cost no multiplication
        each = zip(ratios, slopes, strict=True)
        total = reduce(add, (slope[key] if ratio == 1 else ratio * slope[key] for ratio, slope in each))
        result[key] = value + h * tableau.b[0] * total
    return Stages(result, tuple(arguments), tuple(slopes))


@dataclass(frozen=True)
class Rounds:
    """The stages of a `chained` tableau as iterations of one loop: k = f(at, c), sum <- sum + share k, at <- z + ahead
    k, then z+ = z + last sum, with c, share and ahead of each iteration."""

    fractions: tuple[float, ...]
    shares: tuple[float, ...]
    ahead: tuple[float, ...]
    last: float


def rounds(tableau: Tableau, h: float) -> Rounds:
    """Return the coefficients of a `chained` tableau for a loop over its stages, for a step of length h."""
    ahead = (*(h * row[-1] for row in tableau.a[1:]), 0.0)
    return Rounds(tuple(tableau.c), tuple(_ratios(tableau.b)), ahead, h * tableau.b[0])


def _ratios(b: tuple[float, ...]) -> list[float]:
    return [round(weight / b[0], 12) for weight in b]


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """The model without correction, as CasADi functions with dense results: `move` (z, u now, u next) -> z at the next
    sample, with the time until then as a last argument if it varies; `read` (z, u) -> y; `entry` (x, u) -> z of the
    plant's state x as first declared."""

    move: Any
    read: Any
    entry: Any


@lru_cache(maxsize=8)  # the same model predicts one log after another
def open_loop(form: Form, dt: float | None, between: str, steps: int = 1) -> OpenLoop:
    """Return the model of a form, without correction, over a sample of `dt`, or of a varying length if `dt` is None, by
    `steps` Runge-Kutta steps, or one map of a discrete plant; `between`: how inputs vary, "line" or "hold"."""
    dynamics, states = Dynamics(replace(form, fallback=())), [signal for signal, _ in form.estimates]
    z, x = ca.SX.sym("z", form.n), ca.SX.sym("x", len(states))
    now, then = (ca.SX.sym(name, len(form.system.inputs)) for name in ("now", "then"))

    tableau, clock = plant_tableau(form.system), clock_of(form.system, dt or 1.0, between)
    varies = [ca.SX.sym("dt")] if dt is None else []
    h = varies[0] if dt is None else dt

    def rate(values: Any, c: float) -> dict[str, Graph]:
        return {"z": dynamics.flow(values["z"], clock.between_samples(c, now, then, h))}

    tableau = repeated(tableau, steps) if steps > 1 else tableau
    after = advance(tableau, rate, {"z": z}, h).result["z"]
    plant = dict(zip((*states, *form.system.inputs), (*ca.vertsplit(x), *ca.vertsplit(now)), strict=True))
    plant |= {p: ca.SX(float(value)) for p, value in form.system.nominal.items()}
    return OpenLoop(
        ca.Function("move", [z, now, then, *varies], [ca.densify(_nominal(form, after))]),
        ca.Function("read", [z, then], [ca.densify(_nominal(form, dynamics.output(z, then)))]),
        ca.Function("entry", [x, now], [ca.densify(column(to_casadi(form.entry, plant)))]),
    )


def evaluated(function: Any, *tables: np.ndarray) -> np.ndarray:
    """Return the values (N, k) of a CasADi `function` at N samples; `tables`: for each argument an array with a row for
    each sample. CasADi accesses the memory of these arrays: it would convert them number by number."""
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
    tunable = form.system.tunable
    if not tunable:
        return graph
    values = [ca.SX(float(p.nominal or 0.0)) for p in tunable]
    return ca.substitute([graph], [sym("plant", p.name) for p in tunable], values)[0]
