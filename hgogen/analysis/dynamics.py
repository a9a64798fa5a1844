"""A form's equations as CasADi graphs: z' = A(u) z + b(sat(z), u), y = h(z, u), with their Jacobians.

sat clamps the argument of b to the declared box of the states; the linear part is never clamped; the Jacobian is the
model's, A(u) + b*(sat(z), u), at the clamped point: no clamp has a slope in it, neither that of z nor that of a state
x = Psi(z) at which b is read, where it is b* = db/dx (dPhi/dx)^-1. So a filter that corrects by the Jacobian takes y by
its tangent outside of the box, h(sat(z)) + h*(sat(z)) (z - sat(z)): of the clamped h its corrections would be too long,
and with two states in a reading grow without end. Whether a table's slopes are 0 beyond its points is
decided on that box, as proofs do (`rigor.bounds`). Parameters with a range become places `plant.NAME`, the others
are folded.

What a step does where a row of its form has no finite value, and its user has accepted that.

A row is the rate of a state, z_i' = A_i z + b_i, or an output y_j = h_j. It is taken where its value at sat(z) is in
its range: a rate in the declared rates of its state, an output within its declared range and once its width beyond;
without these, where it is finite and at most 1e15. Its derivatives are taken where each of them is, too.

    rate       b_i is the last one that was taken at the begin of a call: at each stage of a method at which it is not
               taken now. Its derivatives are 0 there.
    output     a sample is not used where the output is not taken; at a stage at which it is not, it is the last one
               that was. Its derivatives are 0 there.

The last values are fields of the state, `last_NAME`. No number is added to a denominator, nor to an argument.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial, reduce
from typing import Any

import casadi as ca
import sympy as sp

from hgogen.analysis.determinant import determinant
from hgogen.analysis.maps import Sided, sided
from hgogen.analysis.undefined import MAKER, gaps
from hgogen.check import ClaimId
from hgogen.form import Form
from hgogen.graph import Graph, binary, leaves, to_casadi
from hgogen.program import INF, column, sym
from hgogen.rigor.bounds import contains_zero, enclose
from hgogen.rigor.box import box
from hgogen.rigor.lookup import hessian, jacobian
from hgogen.rigor.singular import computed, resolved
from hgogen.signal import Signal, resting

Range = tuple[float, float]


@dataclass(frozen=True)
class Holding:
    """The held rows of a form; `largest`: what is beyond it is not taken, where no range says it."""

    form: Form
    largest: float

    @cached_property
    def rates(self) -> dict[int, Signal]:
        """The rows z_i' that are held, each with the signal of its name."""
        states = {s.name: s for s in self.form.system.states}
        names = [name if name in states else z.name for name, z in zip(self.form.names, self.form.states, strict=True)]
        mixed = not set(names) <= states.keys() and not states.keys().isdisjoint(self.form.held)
        rows = {i: states.get(name, z) for i, (name, z) in enumerate(zip(names, self.form.states, strict=True))}
        return {i: s for i, s in rows.items() if mixed or s.name in self.form.held}

    @cached_property
    def outputs(self) -> dict[int, Signal]:
        """The outputs y_j that are held."""
        return {j: y for j, y in enumerate(self.form.system.outputs) if y.name in self.form.held}

    def rate(self, i: int, b: Graph, whole: Graph) -> Graph:
        """b_i, or its last one where the `whole` rate A_i sat(z) + b_i is not taken."""
        return ca.if_else(self.takes_rate(i, whole), b, last(self.rates[i])) if i in self.rates else b

    def coasting(self, A: Graph) -> Graph:
        """A, sparse (n, n), whose gain of a chain in a row that is held is 0 where it is not taken."""
        coasts = ca.SX(A)
        for i, k in _links(self.form):
            if i in self.rates and self.form.A[i, k].free_symbols:
                coasts[i, k] = ca.if_else(within(A[i, k], (-self.largest, self.largest)), A[i, k], 0)
        return coasts

    def output(self, j: int, h: Graph, whole: Graph) -> Graph:
        """h_j, or its last one where h_j(sat(z)), the `whole`, is not taken."""
        return ca.if_else(self.takes_output(j, whole), h, last(self.outputs[j])) if j in self.outputs else h

    def takes_rate(self, i: int, whole: Graph) -> Graph:
        """Whether the rate i is taken."""
        signal = self.rates[i]
        return within(self.form.signs[i] * whole, signal.rates[0] if signal.rates else (-self.largest, self.largest))

    def takes_output(self, j: int, whole: Graph) -> Graph:
        """Whether the output j is taken."""
        low, high = self.outputs[j].interval
        width = high - low
        ends = (low - width, high + width) if self.outputs[j].bounded else (-self.largest, self.largest)
        return within(whole, ends)

    def takes_slopes(self, row: Graph) -> Graph:
        """Whether each derivative of a row (1, n) is taken."""
        return reduce(ca.logic_and, (within(slope, (-self.largest, self.largest)) for slope in ca.horzsplit(row)))


def within(value: Graph, ends: Range) -> Graph:
    """Whether a value is a number in its range; SX."""
    return ca.logic_and(value >= ends[0], value <= ends[1])


def last(signal: Signal) -> Graph:
    """The place of the last value of a row."""
    return sym("state", f"last_{signal.name}")


def holding(form: Form, accepted: Iterable[str]) -> Form:
    """Return the form, of which the rows whose checks `singular.NAME` are `accepted` are held.

    Coefficients of A in a held row that may have no finite value go into its b; the gains of a chain stay, of which the
    form has checks of their own, and are 0 there (`Holding.coasting`).
    """
    accepted = {id for id in accepted if isinstance(id, str)}
    rows = dict.fromkeys((*form.system.states, *form.system.outputs, *form.states))
    names = tuple(s.name for s in rows if ClaimId(MAKER, s.name) in accepted)
    if not names:
        return form
    held = replace(form, held=names)
    A, b, links = form.A.as_mutable(), list(form.b), _links(form)
    in_z = replace(form.system, states=form.states, flow=form.flow, output=form.output, origin=None)
    for i in Holding(held, 1.0).rates:
        for k in range(form.n):
            if (i, k) not in links and A[i, k] != 0 and gaps([A[i, k]], in_z):
                b[i] = sp.Add(b[i], A[i, k] * form.states[k])
                A[i, k] = 0
    return replace(held, A=sp.ImmutableDenseMatrix(A), b=tuple(b))


def _links(form: Form) -> set[tuple[int, int]]:
    """The entries of A with which a state of a chain enters the row before it; none of a form without chains."""
    if form.kind in ("original", "state_affine"):
        return set()
    chains = zip(form.heads, form.blocks, strict=True)
    return {(i, i + 1) for head, size in chains for i in range(head, head + size - 1)}


# ---------------------------------------------------------------- graphs


HUGE = 1e15  # a value beyond it is absurd in any unit; its square still is a float


def clamp(value: Graph, low: float, high: float) -> Graph:
    """SX min(max(value, low), high); as it is where there is no bound."""
    value = value if low == -INF else binary(ca.OP_FMAX, value, low)
    return value if high == INF else binary(ca.OP_FMIN, value, high)


def inside(value: Graph, ends: Sequence[tuple[float, float]]) -> Graph:
    """Whether every element of a column is a number in its range; SX."""
    tests = (
        binary(ca.OP_AND, binary(ca.OP_LE, low, value[i]), binary(ca.OP_LE, value[i], high))
        for i, (low, high) in enumerate(ends)
    )
    return reduce(partial(binary, ca.OP_AND), tests)


def widened(low: float, high: float, share: float) -> tuple[float, float]:
    """The range, longer by a share of its width at each end."""
    more = share * (high - low) if high - low < INF else 0.0
    return low - more, high + more


def either(test: Graph, yes: Graph, no: Graph) -> Graph:
    """The matrix `yes` where the test holds, elsewhere `no`; an entry that is the same in both does not ask."""
    chosen = ca.densify(yes)
    for k in range(chosen.numel()):
        if not ca.is_equal(chosen[k], no[k]):
            chosen[k] = ca.if_else(test, chosen[k], no[k])
    return chosen


def regular_at(matrix: Graph, test: Graph) -> Graph:
    """The matrix where the test holds, elsewhere one that has an inverse as well: nothing is divided by 0.

    Its pivots are 1 there, and what is off them 0 but for one that is triangular in an order.
    """
    blocks, rows, columns, *_ = matrix.sparsity().btf()
    pivots = set(zip(rows, columns, strict=True))
    regular = ca.SX(matrix)
    for i, j in zip(*matrix.sparsity().get_triplet(), strict=True):
        pivot = (i, j) in pivots
        moves = not matrix[i, j].is_constant() if pivot else blocks < len(rows)
        if moves:
            regular[i, j] = ca.if_else(test, matrix[i, j], float(pivot))
    return regular


@dataclass(frozen=True)
class Dynamics:
    """Graphs of `form`; z is an SX column (n), u an SX column (m)."""

    form: Form
    tangent: bool = False  # whether outputs go on by their tangents outside of the box

    @property
    def n(self) -> int:
        """Number of states."""
        return self.form.n

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return len(self.form.output)

    @cached_property
    def box(self) -> tuple[tuple[float, float], ...]:
        """The declared range of each state."""
        return tuple(z.interval for z in self.form.states)

    def saturated(self, z: Graph) -> Graph:
        """The state z clamped to the box."""
        return self._held(z, self.box)

    def _held(self, values: Graph, ends: Sequence[tuple[float, float]]) -> Graph:
        """The column, each element clamped to its range by a form that clamps."""
        return column(clamp(values[i], *end) for i, end in enumerate(ends)) if self.form.clamped else values

    def flow(self, z: Graph, u: Graph) -> Graph:
        """The rate z' (n), with the argument of b clamped, or its value limited."""
        linear, nonlinear = self._graphs(self._argument(z), u)
        return linear @ z + self._limited(nonlinear)

    def linear(self, u: Graph) -> Graph:
        """A(u), sparse (n, n), of a form whose A is free of states."""
        return self._graphs(self._z, u)[0]

    def nonlinear(self, z: Graph, u: Graph) -> Graph:
        """The nonlinear part b (n), with its argument clamped, or its value limited."""
        return self._limited(self._graphs(self._argument(z), u)[1])

    def _argument(self, z: Graph) -> Graph:
        """The argument of b: z clamped to the box, or as it is where values alone are limited."""
        return z if self.form.free else self.saturated(z)

    def _limited(self, b: Graph) -> Graph:
        """b (n), each row in its limits, where it has some."""
        ends = self.form.limits
        return column(clamp(b[i], *end) for i, end in enumerate(ends)) if ends else b

    def affine(self, z: Graph, u: Graph) -> tuple[Graph, Graph]:
        """A (n, n), sparse, and b (n), both at sat(z)."""
        return self._graphs(self.saturated(z), u)

    def jacobian(self, z: Graph, u: Graph) -> Graph:
        """The Jacobian d(A z + b)/dz (n, n) at (sat(z), u): A(u) + b* where A is free of states; A(u) in a row that is
        held there."""
        whole = self._jacobian(z, u)
        if not self.holding.rates:
            return whole
        A, taken = ca.densify(self.holding.coasting(self._unheld(z, u)[0])), self.slopes_taken(z, u)
        rows = (either(taken[i], whole[i, :], A[i, :]) if i in taken else whole[i, :] for i in range(self.n))
        return ca.vertcat(*rows)

    def slopes_taken(self, z: Graph, u: Graph) -> dict[int, Graph]:
        """Whether the value and the derivatives of each row that may be held are taken at (sat(z), u)."""
        holding = self.holding
        if not holding.rates:
            return {}
        jacobian, values = self._jacobian(z, u), self._whole(self.saturated(z), u)
        return {
            i: ca.logic_and(holding.takes_rate(i, values[i]), holding.takes_slopes(jacobian[i, :]))
            for i in holding.rates
        }

    def _jacobian(self, z: Graph, u: Graph) -> Graph:
        if self.form.behind is not None:
            # db/dx (dPhi/dx)^-1 at x = Psi(sat(z)) in the plant's ranges: there dPhi/dx is regular, as phase has
            # proved, while dPsi/dz may have poles in the box of z
            states, x = self.form.system.states, sym("form", "x", self.n)
            rows = (column(self._convert(e, x, self._u, states)) for e in (self.form.behind, self.form.to_form))
            slope, map_ = (jacobian(row, x) for row in rows)
            pulled = ca.sparsify(ca.solve(map_.T, slope.T).T)
            at = self._behind(self.saturated(z), u)
            return self.linear(u) + ca.substitute([pulled], [x, self._u], [at, u])[0]
        linear, rest = self._unheld(self._z, self._u)
        slope = jacobian(rest, self._z)
        if self.form.A.free_symbols & set(self.form.states):  # A(u, z_1): its own slope counts
            slope += jacobian(linear @ self._z, self._z) - linear
        return ca.substitute([linear + slope], [self._z, self._u], [self.saturated(z), u])[0]

    def output(self, z: Graph, u: Graph) -> Graph:
        """C(u) z + h(z, u) (p), with the argument of the nonlinear part h clamped, or by its tangent there."""
        values = self._saturating(self.form.output, z, u)
        if self.tangent and self.form.clamped:
            slopes = self._slopes([linear_terms(h, self.form.states)[1] for h in self.form.output], z, u)
            values += self._taken(slopes, self.readable(z, u)) @ (z - self.saturated(z))
        if not self.holding.outputs:
            return values
        whole = self._saturating(self.form.output, self.saturated(z), u)
        return column(self.holding.output(j, values[j], whole[j]) for j in range(self.outputs))

    @staticmethod
    def _taken(slopes: Graph, read: Mapping[int, Graph]) -> Graph:
        """The rows of slopes, 0 where one that may be held is not `read`."""
        none = ca.SX.zeros(1, slopes.shape[1])
        rows = (either(read[j], slopes[j, :], none) if j in read else slopes[j, :] for j in range(slopes.shape[0]))
        return ca.vertcat(*rows) if read else slopes

    def readable(self, z: Graph, u: Graph) -> dict[int, Graph]:
        """Whether each output that may be held is taken at sat(z), with its derivatives."""
        if not self.holding.outputs:
            return {}
        holding, slopes = self.holding, self._slopes(self.form.output, z, u)
        whole = self._saturating(self.form.output, self.saturated(z), u)
        return {
            j: ca.logic_and(holding.takes_output(j, whole[j]), holding.takes_slopes(slopes[j, :]))
            for j in holding.outputs
        }

    def output_jacobian(self, z: Graph, u: Graph) -> Graph:
        """The Jacobian dh/dz (p, n) of the output; 0 of one that is held there."""
        return self._taken(self._slopes(self.form.output, z, u), self.readable(z, u))

    def rates_taken(self, z: Graph, u: Graph) -> dict[int, tuple[Graph, Graph]]:
        """b_i of each row that may be held, and whether its rate is taken at (sat(z), u)."""
        if not self.holding.rates:
            return {}
        b, whole = self._unheld(self._argument(z), u)[1], self._whole(self.saturated(z), u)
        return {i: (b[i], self.holding.takes_rate(i, whole[i])) for i in self.holding.rates}

    def outputs_taken(self, z: Graph, u: Graph) -> dict[int, tuple[Graph, Graph]]:
        """The outputs that may be held, and whether each it is taken at (sat(z), u)."""
        if not self.holding.outputs:
            return {}
        values, whole = (self._saturating(self.form.output, at, u) for at in (z, self.saturated(z)))
        return {j: (values[j], self.holding.takes_output(j, whole[j])) for j in self.holding.outputs}

    def _whole(self, z: Graph, u: Graph) -> Graph:
        """A z + b (n), nothing of it held."""
        linear, rest = self._unheld(z, u)
        return linear @ z + rest

    @cached_property
    def holding(self) -> Holding:
        """The rows that are held where they have no finite value."""
        return Holding(self.form, HUGE)

    def _slopes(self, rows: Sequence[sp.Expr], z: Graph, u: Graph) -> Graph:
        """The Jacobian of rows by z at (sat(z), u)."""
        slopes = jacobian(column(self._convert(rows, self._z, self._u)), self._z)
        return ca.substitute([slopes], [self._z, self._u], [self.saturated(z), u])[0]

    def output_curvature(self, z: Graph, u: Graph) -> tuple[Graph, ...]:
        """The second derivatives d2h_j/dz2 (n, n) at (sat(z), u) of each output."""
        rows = column(self._convert(self.form.output, self._z, self._u))
        hessians = tuple(hessian(rows[j], self._z) for j in range(self.outputs))
        read = self.readable(z, u)
        curved = ca.substitute(list(hessians), [self._z, self._u], [self.saturated(z), u])
        return tuple(ca.if_else(read[j], each, 0) if j in read else each for j, each in enumerate(curved))

    def estimate(self, z: Graph, u: Graph) -> Graph:
        """The plant's states, as first declared, from z (n) and u (m).

        The map back is shown to be one on the box only: beyond an end where it turns round it is evaluated at that
        end, since the square of a root below 0 is no level.
        """
        system = self.form.system
        if moved(self.form):
            states, _ = self.recovered(z, u)
            return column(self._convert([e for _, e in system.reported], states, u, system.states))
        linear, rest = zip(*(linear_terms(e, self.form.states) for _, e in self.form.estimates), strict=True)
        clamped = self._held(z, [reach(rest, s, self.form.states) for s in self.form.states])
        return column(self._convert(linear, z, u)) + column(self._convert(rest, clamped, u))

    def recovered(self, z: Graph, u: Graph) -> tuple[Graph, Graph]:
        """The states of the form's system from z, each in its range, and whether the inverse is a number there.

        A state for which it is not takes its resting value. Denominators keep their sign (`maps.sided`).
        """
        return self._ranged(self._unranged(z, u))

    def beyond(self, z: Graph, u: Graph, margin: float = 0.0) -> list[Graph]:
        """Whether each state of the form's system that is more than a z with a sign leaves its range by more than
        `margin` of its width."""
        raw = self._unranged(z, u)
        return [leaves(raw[i], *widened(*s.interval, margin)) for i, s in self._more]

    def behind_ranges(self, z: Graph, u: Graph) -> list[tuple[Graph, Graph, tuple[float, float]]]:
        """The states of the form's system with a range that is more than a z with a sign, before it is clamped: its
        value, its gradient (1, n) at sat(z), and its range."""
        raw, slopes = self._unranged(z, u), self._slopes(self._inverse.rows, z, u)
        return [(raw[i], slopes[i, :], s.interval) for i, s in self._more]

    @property
    def _more(self) -> list[tuple[int, Signal]]:
        """The states of the form's system, by their numbers, that have a range and are more than a z with a sign."""
        states = enumerate(zip(self.form.system.states, self.form.from_form, strict=True))
        return [(i, s) for i, (s, e) in states if s.bounded and not (e.is_Symbol or (-e).is_Symbol)]

    @property
    def recoverable(self) -> bool:
        """Whether the inverse is proved to be a number on the whole box of z."""
        return all(self._inverse.finite)

    @cached_property
    def _inverse(self) -> Sided:
        return sided(self.form)

    def _unranged(self, z: Graph, u: Graph) -> Graph:
        return self._saturating(self._inverse.rows, z, u)

    def _ranged(self, raw: Graph) -> tuple[Graph, Graph]:
        """Values of the states of the form's system, each in its range or, where it is no number, at rest; by a form
        that does not clamp, the values."""
        if not self.form.clamped:
            return raw, ca.SX(1)
        states = self.form.system.states
        looked = {i: ca.fabs(raw[i]) <= HUGE for i, finite in enumerate(self._inverse.finite) if not finite}
        taken = (ca.if_else(looked[i], raw[i], resting(s)) if i in looked else raw[i] for i, s in enumerate(states))
        usable = reduce(ca.logic_and, looked.values()) if looked else ca.SX(1)
        return self._held(column(taken), [s.interval for s in states]), usable

    def pulled(self, vector: Graph, z: Graph, u: Graph, least: float | None) -> Graph:
        """The product (dPhi/dx)^-1 vector, or 0 where |det dPhi/dx| <= `least` at sat(z); with None for `least` the
        determinant is proved to have no zero."""
        n, place = self.n, self.saturated(z)
        map_ = ca.sparsify(ca.reshape(column(self._convert(list(self._map.T), place, u)), n, n))
        if least is None:
            return ca.solve(map_, vector)
        regular = ca.fabs(self.determinant(place, u)) > least
        solved = ca.solve(regular_at(map_, regular), vector)
        return column(ca.if_else(regular, solved[i], 0) for i in range(n))

    def determinant(self, z: Graph, u: Graph) -> Graph:
        """The determinant of dPhi/dx."""
        return self._convert([determinant(self._map.tolist()).value], z, u)[0]

    @cached_property
    def _z(self) -> Graph:
        return sym("form", "z", self.n)

    @cached_property
    def _u(self) -> Graph:
        return sym("form", "u", len(self.form.system.inputs))

    def _graphs(self, z: Graph, u: Graph) -> tuple[Graph, Graph]:
        """A and b at z, which its callers have clamped; of a row that is held there the last b_i, no infinite gain."""
        linear, rest = self._unheld(z, u)
        if not self.holding.rates:
            return linear, rest
        whole = linear @ z + rest
        return self.holding.coasting(linear), column(self.holding.rate(i, rest[i], whole[i]) for i in range(self.n))

    def _unheld(self, z: Graph, u: Graph) -> tuple[Graph, Graph]:
        """A and b at z."""
        entries, linear = self.form.A.todok(), ca.SX(self.n, self.n)
        for place, value in zip(entries, self._convert(entries.values(), z, u), strict=True):
            linear[place] = value
        linear = ca.sparsify(linear)
        if self.form.behind is not None:
            states = self._behind(z, u)
            return linear, column(self._convert(self.form.behind, states, u, self.form.system.states))
        return linear, column(self._convert(self.form.b, z, u, boxed=not self.form.free))

    def _behind(self, z: Graph, u: Graph) -> Graph:
        """Psi(z), each state in its range, at z, which its callers have clamped."""
        return self._ranged(column(self._convert(self._inverse.rows, z, u)))[0]

    @property
    def _map(self) -> sp.ImmutableDenseMatrix:
        """The Jacobian dPhi/dx of a form that carries it."""
        assert self.form.jacobian is not None
        return self.form.jacobian

    def _saturating(self, expressions: Sequence[sp.Expr], z: Graph, u: Graph) -> Graph:
        """Terms linear in a state at z, the others at sat(z)."""
        linear, rest = zip(*(linear_terms(e, self.form.states) for e in expressions), strict=True)
        return column(self._convert(linear, z, u)) + column(self._convert(rest, self.saturated(z), u))

    def _convert(
        self, expressions: Any, z: Graph, u: Graph, states: Sequence[sp.Symbol] | None = None, boxed: bool = True
    ) -> list[Graph]:
        """The expressions as graphs; `boxed`: of arguments that are clamped, by a form that clamps."""
        system = self.form.system
        symbols = {s: z[i] for i, s in enumerate(states or self.form.states)}
        symbols |= {s: u[i] for i, s in enumerate(system.inputs)}
        symbols |= {p: sym("plant", p.name) for p in system.tunable}
        rows: Iterable[sp.Expr] = map(sp.sympify, expressions)
        if self.form.clamped and boxed:
            around = system.box_with(states or self.form.states)
            rows = (computed(resolved(e), around) for e in rows)
        constants = tuple(system.constants.items())
        return to_casadi([_with_values(e, constants) for e in rows], symbols)


@lru_cache(maxsize=512)  # the same rows are asked for at each stage of a step
def _with_values(expression: sp.Expr, constants: tuple[tuple[sp.Symbol, Any], ...]) -> sp.Expr:
    return expression.subs(dict(constants))


def linear_terms(expression: sp.Expr, states: Sequence[sp.Symbol]) -> tuple[sp.Expr, sp.Expr]:
    """The sum of the terms that are linear in a state with a coefficient free of states, and the rest."""
    linear: list[sp.Expr] = []
    rest: list[sp.Expr] = []
    for term in sp.Add.make_args(sp.expand_mul(expression)):
        _, factor = term.as_independent(*states, as_Add=False)
        (linear if factor in states else rest).append(term)
    return sp.Add(*linear), sp.Add(*rest)


def reach(rows: Iterable[sp.Expr], state: Signal, states: Iterable[Signal]) -> tuple[float, float]:
    """The state's range, without an end beyond which every row that reads the state goes on in one direction."""
    slopes = [sp.diff(row, state) for row in rows if state in row.free_symbols]
    around, (low, high) = box(states), state.interval

    def turns(beyond: tuple[float, float]) -> bool:
        return any(contains_zero(enclose(slope, {**around, state: beyond})) for slope in slopes)

    return (low if turns((-INF, low)) else -INF), (high if turns((high, INF)) else INF)


def moved(form: Form) -> bool:
    """Whether the form's coordinates are more than the system's states in another order, with signs."""
    return not all(x.is_Symbol or (-x).is_Symbol for x in form.from_form)
