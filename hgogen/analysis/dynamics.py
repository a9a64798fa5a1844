"""A form's equations as CasADi graphs: z' = A(u) z + b(sat(z), u), y = h(z, u), with their Jacobians.

sat clamps the argument of b to the declared box of the states. The linear part is never clamped. The Jacobian is the
model's at the clamped point, A(u) + b*(sat(z), u), without the slope of a clamp. Where b is read at x = Psi(z), b* is
db/dx (dPhi/dx)^-1. A filter that corrects by the Jacobian reads y by its tangent outside of the box, h(sat(z)) +
h*(sat(z)) (z - sat(z)): with a clamped h its corrections would be too long, and with two states in an output they would
grow without end. Whether a table's slopes are 0 beyond its breakpoints is decided on that box, as in proofs
(`rigor.bounds`). Parameters with a range become places `plant.NAME`, the others are folded.

A row of the form without a finite value has a fallback where the user has accepted that.

A row is the rate of a state, z_i' = A_i z + b_i, or an output y_j = h_j. It is valid where its value at sat(z) is in
its range: a rate in the declared rates of its state, an output within its declared range and once its width beyond;
without these, where it is finite and at most 1e15. Its derivatives are valid where each of them is finite and at most
1e15, too.

    rate       At each stage of a method where it is invalid, b_i is its last value that was valid at the begin of a
               call. Its derivatives are 0 there.
    output     Its sample is not used where it is invalid. At a stage where it is invalid, it has its last valid value.
               Its derivatives are 0 there.

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
from hgogen.graph import Graph, binary, is_outside, to_casadi, turned, wrapped
from hgogen.program import INF, column, sym
from hgogen.rigor.bounds import contains_zero, enclose
from hgogen.rigor.box import EVERYTHING, box
from hgogen.rigor.lookup import hessian, jacobian
from hgogen.rigor.singular import as_computed, resolved, with_limited_slopes
from hgogen.signal import Signal, resting

Range = tuple[float, float]


@dataclass(frozen=True)
class Fallback:
    """The equations of a form, rates z_i' or outputs y_j, that are replaced by their last valid value where they have
    no finite value. `largest`: the largest magnitude that is valid for an equation without a declared range."""

    form: Form
    largest: float

    @cached_property
    def rates(self) -> dict[int, Signal]:
        """The signal that names the last valid value of each rate z_i' with a fallback, by index i."""
        states = {s.name: s for s in self.form.system.states}
        names = [name if name in states else z.name for name, z in zip(self.form.names, self.form.states, strict=True)]
        mixed = not set(names) <= states.keys() and not states.keys().isdisjoint(self.form.fallback)
        rows = {i: states.get(name, z) for i, (name, z) in enumerate(zip(names, self.form.states, strict=True))}
        return {i: s for i, s in rows.items() if mixed or s.name in self.form.fallback}

    @cached_property
    def outputs(self) -> dict[int, Signal]:
        """The output signal of each y_j with a fallback, by index j."""
        return {j: y for j, y in enumerate(self.form.system.outputs) if y.name in self.form.fallback}

    def rate(self, i: int, b: Graph, whole: Graph) -> Graph:
        """Return b_i, or its last valid value where the rate `whole` = A_i sat(z) + b_i is invalid, as an SX."""
        return ca.if_else(self.rate_valid(i, whole), b, last_value(self.rates[i])) if i in self.rates else b

    def valid_gains(self, A: Graph) -> Graph:
        """Return A, sparse (n, n), with 0 in place of the invalid chain gains a_i of rates with a fallback."""
        gains = ca.SX(A)
        for i, k in _links(self.form):
            if i in self.rates and self.form.A[i, k].free_symbols:
                gains[i, k] = ca.if_else(within(A[i, k], (-self.largest, self.largest)), A[i, k], 0)
        return gains

    def output(self, j: int, h: Graph, whole: Graph) -> Graph:
        """Return h_j, or its last valid value where `whole` = h_j(sat(z)) is no number in its range."""
        return ca.if_else(self.output_valid(j, whole), h, last_value(self.outputs[j])) if j in self.outputs else h

    def rate_valid(self, i: int, whole: Graph) -> Graph:
        """Return the SX test whether the value `whole` of the rate z_i' is a number in its range."""
        signal = self.rates[i]
        return within(self.form.signs[i] * whole, signal.rates[0] if signal.rates else (-self.largest, self.largest))

    def output_valid(self, j: int, whole: Graph) -> Graph:
        """Return the SX test whether the value `whole` of the output y_j is a number in its range, extended by its
        width at each end."""
        low, high = self.outputs[j].limits
        ends = (-self.largest, self.largest) if low == -INF else widened(low, high, 1)
        return within(whole, ends)

    def slopes_valid(self, row: Graph) -> Graph:
        """Return the SX test whether each derivative in `row` (1, n) of a Jacobian is a number of valid size."""
        return reduce(ca.logic_and, (within(slope, (-self.largest, self.largest)) for slope in ca.horzsplit(row)))


def within(value: Graph, ends: Range) -> Graph:
    """Return the SX test whether `value` is a number in the range `ends`."""
    return ca.logic_and(value >= ends[0], value <= ends[1])


def last_value(signal: Signal) -> Graph:
    """Return the SX symbol of the memory that holds the last valid value of the equation named by `signal`."""
    return sym("state", f"last_{signal.name}")


def with_fallback(form: Form, accepted: Iterable[str]) -> Form:
    """Return the form in which each equation whose refuted check `singular.NAME` is `accepted` is replaced by its last
    valid value where it has no finite value.

    Coefficients of A in such an equation that may have no finite value are moved into its b_i. The gains a_i of a chain
    stay in A, because the form has checks about them, and are 0 where they are invalid (`Fallback.valid_gains`).
    """
    accepted = {id for id in accepted if isinstance(id, str)}
    rows = dict.fromkeys((*form.system.states, *form.system.outputs, *form.states))
    names = tuple(s.name for s in rows if ClaimId(MAKER, s.name) in accepted)
    if not names:
        return form
    result = replace(form, fallback=names)
    A, b, links = form.A.as_mutable(), list(form.b), _links(form)
    in_z = replace(form.system, states=form.states, flow=form.flow, output=form.output, origin=None, invariants=())
    for i in Fallback(result, 1.0).rates:
        for k in range(form.n):
            if (i, k) not in links and A[i, k] != 0 and gaps([A[i, k]], in_z):
                b[i] = sp.Add(b[i], A[i, k] * form.states[k])
                A[i, k] = 0
    return replace(result, A=sp.ImmutableDenseMatrix(A), b=tuple(b))


def _links(form: Form) -> set[tuple[int, int]]:
    if form.kind in ("original", "state_affine"):
        return set()
    chains = zip(form.heads, form.blocks, strict=True)
    return {(i, i + 1) for head, size in chains for i in range(head, head + size - 1)}


# ---------------------------------------------------------------- graphs


HUGE = 1e15  # a value beyond it is absurd in any unit; its square still is a float


def clamp(value: Graph, low: float, high: float) -> Graph:
    """Return the SX min(max(value, low), high), without the operation for an infinite bound."""
    value = value if low == -INF else binary(ca.OP_FMAX, value, low)
    return value if high == INF else binary(ca.OP_FMIN, value, high)


def into_range(value: Graph, ends: Range, period: float | None) -> Graph:
    """Return the SX `value` clamped to the range `ends`; an angle with a `period` is first shifted by whole turns into
    the range. The clamp acts on an angle only if it is off by more turns than are counted exactly."""
    return clamp(value if period is None else turned(value, ends[0], period), *ends)


def at_nearest_turn(signal: Signal, value: Graph, other: Graph) -> Graph:
    """Return the SX `value` of a signal; of an angle, shifted by whole turns so that it is nearest to `other`."""
    return value if signal.period is None else other + wrapped(value - other, signal.period)


def inside(value: Graph, ends: Sequence[tuple[float, float]]) -> Graph:
    """Return the SX test whether each element of the column `value` is a number in its range (low, high) of `ends`."""
    tests = (
        binary(ca.OP_AND, binary(ca.OP_LE, low, value[i]), binary(ca.OP_LE, value[i], high))
        for i, (low, high) in enumerate(ends)
    )
    return reduce(partial(binary, ca.OP_AND), tests)


def widened(low: float, high: float, share: float) -> tuple[float, float]:
    """Return the range (low, high), extended by `share` of its width at each end."""
    more = share * (high - low) if high - low < INF else 0.0
    return low - more, high + more


def choose(test: Graph, yes: Graph, no: Graph) -> Graph:
    """Return the SX matrix that is `yes` where the SX `test` is 1, else `no`; an entry equal in both has no
    conditional."""
    result = ca.densify(yes)
    for k in range(result.numel()):
        if not ca.is_equal(result[k], no[k]):
            result[k] = ca.if_else(test, result[k], no[k])
    return result


def regular_at(matrix: Graph, test: Graph) -> Graph:
    """Return the SX matrix that is `matrix` where the SX `test` is 1, else an invertible constant, so that solving with
    it never divides by 0.

    The pivots of the constant are 1, its other entries 0, except for a matrix that is triangular in some order.
    """
    blocks, rows, columns, *_ = matrix.sparsity().btf()
    pivots = set(zip(rows, columns, strict=True))
    regular = ca.SX(matrix)
    for i, j in zip(*matrix.sparsity().get_triplet(), strict=True):
        pivot = (i, j) in pivots
        varies = not matrix[i, j].is_constant() if pivot else blocks < len(rows)
        if varies:
            regular[i, j] = ca.if_else(test, matrix[i, j], float(pivot))
    return regular


@dataclass(frozen=True)
class Dynamics:
    """The equations z' = A(u) z + b(sat(z), u), y = h(z, u) of a `form` as CasADi graphs, functions of z, an SX column
    (n), and u (m). `tangent`: whether outputs are continued linearly, by their tangent, where z is outside of its
    ranges."""

    form: Form
    tangent: bool = False  # whether outputs are continued by their tangents outside of the box

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
        """The range (low, high) of each state to which it is clamped, infinite for a periodic one."""
        return tuple(z.limits for z in self.form.states)

    def saturated(self, z: Graph) -> Graph:
        """Return sat(z), the state z clamped to the declared ranges."""
        return self._clamped(z, self.box)

    def _clamped(self, values: Graph, ends: Sequence[tuple[float, float]]) -> Graph:
        return column(clamp(values[i], *end) for i, end in enumerate(ends)) if self.form.clamped else values

    def flow(self, z: Graph, u: Graph) -> Graph:
        """Return the rate z' = A z + b (n), with the argument of b clamped to the declared ranges, or the value of b
        limited."""
        linear, nonlinear = self._graphs(self._argument(z), u)
        return linear @ z + self._limited(nonlinear)

    def linear(self, u: Graph) -> Graph:
        """Return A(u), sparse (n, n), of a form whose A depends on no state."""
        return self._graphs(self._z, u)[0]

    def nonlinear(self, z: Graph, u: Graph) -> Graph:
        """Return the nonlinear part b (n), with its argument clamped to the declared ranges, or its value limited."""
        return self._limited(self._graphs(self._argument(z), u)[1])

    def _argument(self, z: Graph) -> Graph:
        """Return the argument of b: z clamped to the box, or z itself if only the values of b are limited."""
        return z if self.form.free else self.saturated(z)

    def _limited(self, b: Graph) -> Graph:
        ends = self.form.limits
        return column(clamp(b[i], *end) for i, end in enumerate(ends)) if ends else b

    def affine(self, z: Graph, u: Graph) -> tuple[Graph, Graph]:
        """Return A (n, n), sparse, and b (n), both at sat(z)."""
        return self._graphs(self.saturated(z), u)

    def jacobian(self, z: Graph, u: Graph) -> Graph:
        """Return the Jacobian d(A z + b)/dz (n, n) at (sat(z), u); A(u) alone in the row of an invalid rate."""
        whole = self._jacobian(z, u)
        if not self.fallback.rates:
            return whole
        A, valid = ca.densify(self.fallback.valid_gains(self._without_fallback(z, u)[0])), self.rate_slopes_valid(z, u)
        rows = (choose(valid[i], whole[i, :], A[i, :]) if i in valid else whole[i, :] for i in range(self.n))
        return ca.vertcat(*rows)

    def input_jacobian(self, z: Graph, u: Graph) -> Graph:
        """Return the Jacobian d(A z + b)/du (n, m) at (sat(z), u), with a row of 0 for an invalid rate."""
        linear, nonlinear = self._without_fallback(self._z, self._u, slopes=True)
        slopes = jacobian(linear @ self._z + nonlinear, self._u)
        at = ca.substitute([slopes], [self._z, self._u], [self.saturated(z), u])[0]
        return self._zero_invalid(at, self.rate_slopes_valid(z, u))

    def rate_slopes_valid(self, z: Graph, u: Graph) -> dict[int, Graph]:
        """Return, by index i, the SX test whether the rate z_i' with a fallback and its derivatives are valid at
        (sat(z), u)."""
        fallback = self.fallback
        if not fallback.rates:
            return {}
        jacobian, values = self._jacobian(z, u), self._whole(self.saturated(z), u)
        return {
            i: ca.logic_and(fallback.rate_valid(i, values[i]), fallback.slopes_valid(jacobian[i, :]))
            for i in fallback.rates
        }

    def _jacobian(self, z: Graph, u: Graph) -> Graph:
        if self.form.behind is not None:
            # db/dx (dPhi/dx)^-1 at x = Psi(sat(z)) in the plant's ranges: there dPhi/dx is regular, as phase has
            # proved, while dPsi/dz may have poles in the box of z
            states, x = self.form.system.states, sym("form", "x", self.n)
            parts = (self.form.behind, self.form.to_form)
            rows = (column(self._convert(e, x, self._u, states, slopes=True)) for e in parts)
            slope, map_ = (jacobian(row, x) for row in rows)
            pulled = ca.sparsify(ca.solve(map_.T, slope.T).T)
            at = self._behind(self.saturated(z), u)
            return self.linear(u) + ca.substitute([pulled], [x, self._u], [at, u])[0]
        linear, nonlinear = self._without_fallback(self._z, self._u, slopes=True)
        slope = jacobian(nonlinear, self._z)
        if self.form.A.free_symbols & set(self.form.states):  # A(u, z_1): its own slope counts
            slope += jacobian(linear @ self._z, self._z) - linear
        return ca.substitute([linear + slope], [self._z, self._u], [self.saturated(z), u])[0]

    def output(self, z: Graph, u: Graph) -> Graph:
        """Return the outputs C(u) z + h(z, u) (p), with the argument of h clamped to the declared ranges, or h
        continued by its tangent."""
        values = self._saturating(self.form.output, z, u)
        if self.tangent and self.form.clamped:
            slopes = self._slopes([linear_terms(h, self.form.states)[1] for h in self.form.output], z, u)
            values += self._zero_invalid(slopes, self.output_slopes_valid(z, u)) @ (z - self.saturated(z))
        if not self.fallback.outputs:
            return values
        whole = self._saturating(self.form.output, self.saturated(z), u)
        return column(self.fallback.output(j, values[j], whole[j]) for j in range(self.outputs))

    def error(self, y: Graph, predicted: Graph) -> Graph:
        """Return the output error y - predicted (p); of a periodic output, the shortest angle between both."""
        return column(self.output_error(j, y[j], predicted[j]) for j in range(self.outputs))

    def output_error(self, j: int, y: Graph, predicted: Graph) -> Graph:
        """Return the output error y - predicted of output j, an SX scalar; of a periodic output, the shortest angle
        between both."""
        return wrapped(y - predicted, self.form.system.outputs[j].period)

    @staticmethod
    def _zero_invalid(slopes: Graph, valid: Mapping[int, Graph]) -> Graph:
        none = ca.SX.zeros(1, slopes.shape[1])
        rows = (choose(valid[j], slopes[j, :], none) if j in valid else slopes[j, :] for j in range(slopes.shape[0]))
        return ca.vertcat(*rows) if valid else slopes

    def output_slopes_valid(self, z: Graph, u: Graph) -> dict[int, Graph]:
        """Return, by index j, the SX test whether the output y_j with a fallback and its derivatives are valid at
        sat(z)."""
        if not self.fallback.outputs:
            return {}
        fallback, slopes = self.fallback, self._slopes(self.form.output, z, u)
        whole = self._saturating(self.form.output, self.saturated(z), u)
        return {
            j: ca.logic_and(fallback.output_valid(j, whole[j]), fallback.slopes_valid(slopes[j, :]))
            for j in fallback.outputs
        }

    def output_jacobian(self, z: Graph, u: Graph) -> Graph:
        """Return the Jacobian dh/dz (p, n) of the output, with a row of 0 for an invalid output."""
        return self._zero_invalid(self._slopes(self.form.output, z, u), self.output_slopes_valid(z, u))

    def rates_valid(self, z: Graph, u: Graph) -> dict[int, tuple[Graph, Graph]]:
        """Return, by index i of the rates z_i' with a fallback, the pair of b_i and the SX test whether A_i z + b_i is
        valid at (sat(z), u)."""
        if not self.fallback.rates:
            return {}
        b, whole = self._without_fallback(self._argument(z), u)[1], self._whole(self.saturated(z), u)
        return {i: (b[i], self.fallback.rate_valid(i, whole[i])) for i in self.fallback.rates}

    def outputs_valid(self, z: Graph, u: Graph) -> dict[int, tuple[Graph, Graph]]:
        """Return, by index j of the outputs with a fallback, the pair of h_j and the SX test whether it is valid at
        (sat(z), u)."""
        if not self.fallback.outputs:
            return {}
        values, whole = (self._saturating(self.form.output, at, u) for at in (z, self.saturated(z)))
        return {j: (values[j], self.fallback.output_valid(j, whole[j])) for j in self.fallback.outputs}

    def _whole(self, z: Graph, u: Graph) -> Graph:
        linear, nonlinear = self._without_fallback(z, u)
        return linear @ z + nonlinear

    @cached_property
    def fallback(self) -> Fallback:
        """The equations of the form that are replaced by their last valid value where they have no finite value."""
        return Fallback(self.form, HUGE)

    def _slopes(self, rows: Sequence[sp.Expr], z: Graph, u: Graph) -> Graph:
        """Return the Jacobian (k, n) of the expressions `rows` (k) by z at (sat(z), u)."""
        slopes = jacobian(column(self._convert(rows, self._z, self._u, slopes=True)), self._z)
        return ca.substitute([slopes], [self._z, self._u], [self.saturated(z), u])[0]

    def output_curvature(self, z: Graph, u: Graph) -> tuple[Graph, ...]:
        """Return the second derivatives d2h_j/dz2 (n, n) of each output at (sat(z), u)."""
        rows = column(self._convert(self.form.output, self._z, self._u, slopes=True))
        hessians = tuple(hessian(rows[j], self._z) for j in range(self.outputs))
        valid = self.output_slopes_valid(z, u)
        curved = ca.substitute(list(hessians), [self._z, self._u], [self.saturated(z), u])
        return tuple(ca.if_else(valid[j], each, 0) if j in valid else each for j, each in enumerate(curved))

    @property
    def invariants(self) -> tuple[sp.Expr, ...]:
        """The plant's invariants as expressions of z."""
        back = dict(zip(self.form.system.states, self.form.from_form, strict=True))
        return tuple(c.xreplace(back) for c in self.form.system.invariants)

    def values(self, expressions: Sequence[sp.Expr], z: Graph, u: Graph) -> list[Graph]:
        """Return expressions of the form's signals as graphs, evaluated at z itself, without clamping."""
        return self._convert(expressions, z, u, boxed=False)

    def estimate(self, z: Graph, u: Graph) -> Graph:
        """Return the estimate (n) of the plant's states x, as first declared, from z (n) and u (m).

        The inverse map x = Psi(z) is proved on the declared ranges only. Beyond an end of a range after which Psi is no
        longer monotone it is evaluated at this end: the square of a root below 0 is no level.
        """
        system = self.form.system
        if transformed(self.form):
            states, _ = self.recovered(z, u)
            return column(self._convert([e for _, e in system.reported], states, u, system.states))
        linear, nonlinear = zip(*(linear_terms(e, self.form.states) for _, e in self.form.estimates), strict=True)
        clamped = self._clamped(z, [reach(nonlinear, s, self.form.states) for s in self.form.states])
        return column(self._convert(linear, z, u)) + column(self._convert(nonlinear, clamped, u))

    def estimate_jacobian(self, z: Graph, u: Graph) -> Graph:
        """Return the Jacobian dx/dz (n, n) of the plant's states x, as first declared, at sat(z)."""
        free = ca.SX.sym("z", self.n)
        return ca.sparsify(ca.substitute(ca.jacobian(self.estimate(free, u), free), free, self.saturated(z)))

    def recovered(self, z: Graph, u: Graph) -> tuple[Graph, Graph]:
        """Return the states x = Psi(z, u) of the form's system, each clamped to its range, and the SX test whether all
        of them are finite numbers.

        A state whose Psi is no number has its resting value. Denominators of Psi keep their sign (`maps.sided`).
        """
        return self._ranged(self._unranged(z, u))

    def beyond(self, z: Graph, u: Graph, margin: float = 0.0) -> list[Graph]:
        """Return, for each bounded state recovered as x_i = Psi_i(z, u), the SX test whether it is outside of its range
        by more than `margin` of the width."""
        raw = self._unranged(z, u)
        return [is_outside(raw[i], *widened(*s.limits, margin)) for i, s in self._recovered_states]

    def behind_ranges(self, z: Graph, u: Graph) -> list[tuple[Graph, Graph, tuple[float, float]]]:
        """Return, for each bounded state recovered as x_i = Psi_i(z, u): its value before the clamp, its gradient (1,
        n) by z at sat(z), and its range."""
        raw, slopes = self._unranged(z, u), self._slopes(self._inverse.rows, z, u)
        return [(raw[i], slopes[i, :], s.limits) for i, s in self._recovered_states]

    @property
    def _recovered_states(self) -> list[tuple[int, Signal]]:
        states = enumerate(zip(self.form.system.states, self.form.from_form, strict=True))
        return [(i, s) for i, (s, e) in states if s.bounded and not (e.is_Symbol or (-e).is_Symbol)]

    @property
    def recoverable(self) -> bool:
        """Whether x = Psi(z), the inverse map, is proved to be a number on the whole box of z."""
        return all(self._inverse.finite)

    @cached_property
    def _inverse(self) -> Sided:
        return sided(self.form)

    def _unranged(self, z: Graph, u: Graph) -> Graph:
        return self._saturating(self._inverse.rows, z, u)

    def _ranged(self, raw: Graph) -> tuple[Graph, Graph]:
        """Return the plant's states x from their values `raw` (n), each clamped to
        its range, or at its default if it is NaN; and whether all are numbers."""
        if not self.form.clamped:
            return raw, ca.SX(1)
        states = self.form.system.states
        tests = {i: ca.fabs(raw[i]) <= HUGE for i, finite in enumerate(self._inverse.finite) if not finite}
        values = (ca.if_else(tests[i], raw[i], resting(s)) if i in tests else raw[i] for i, s in enumerate(states))
        usable = reduce(ca.logic_and, tests.values()) if tests else ca.SX(1)
        return self._clamped(column(values), [s.limits for s in states]), usable

    def pulled(self, vector: Graph, z: Graph, u: Graph, least: float | None) -> Graph:
        """Return the product (dPhi/dx)^-1 vector (n), where z = Phi(x) is the form's map to chain coordinates; 0 where
        |det dPhi/dx| <= `least` at sat(z); `least` is None where the determinant is proved to have no zero."""
        n, place = self.n, self.saturated(z)
        map_ = ca.sparsify(ca.reshape(column(self._convert(list(self._map.T), place, u)), n, n))
        if least is None:
            return ca.solve(map_, vector)
        regular = ca.fabs(self.determinant(place, u)) > least
        solved = ca.solve(regular_at(map_, regular), vector)
        return column(ca.if_else(regular, solved[i], 0) for i in range(n))

    def determinant(self, z: Graph, u: Graph) -> Graph:
        """Return det dPhi/dx at sat(z), where z = Phi(x) is the form's map to chain coordinates."""
        return self._convert([determinant(self._map.tolist()).value], z, u)[0]

    @cached_property
    def _z(self) -> Graph:
        return sym("form", "z", self.n)

    @cached_property
    def _u(self) -> Graph:
        return sym("form", "u", len(self.form.system.inputs))

    def _graphs(self, z: Graph, u: Graph) -> tuple[Graph, Graph]:
        """Return A (n, n), b (n) at z, already clamped; an
        undefined rate has its last defined b_i, and gains 0."""
        linear, nonlinear = self._without_fallback(z, u)
        if not self.fallback.rates:
            return linear, nonlinear
        whole = linear @ z + nonlinear
        rates = column(self.fallback.rate(i, nonlinear[i], whole[i]) for i in range(self.n))
        return self.fallback.valid_gains(linear), rates

    def _without_fallback(self, z: Graph, u: Graph, slopes: bool = False) -> tuple[Graph, Graph]:
        entries, linear = self.form.A.todok(), ca.SX(self.n, self.n)
        for place, value in zip(entries, self._convert(entries.values(), z, u, slopes=slopes), strict=True):
            linear[place] = value
        linear = ca.sparsify(linear)
        if self.form.behind is not None:
            states = self._behind(z, u)
            return linear, column(self._convert(self.form.behind, states, u, self.form.system.states))
        return linear, column(self._convert(self.form.b, z, u, boxed=not self.form.free, slopes=slopes))

    def _behind(self, z: Graph, u: Graph) -> Graph:
        """Return the plant's states x = Psi(z), for z already clamped, each clamped to its range."""
        return self._ranged(column(self._convert(self._inverse.rows, z, u)))[0]

    @property
    def _map(self) -> sp.ImmutableDenseMatrix:
        """The Jacobian dPhi/dx (n, n) of the map z = Phi(x) to chain coordinates."""
        assert self.form.jacobian is not None
        return self.form.jacobian

    def _saturating(self, expressions: Sequence[sp.Expr], z: Graph, u: Graph) -> Graph:
        """Return the expressions, with their terms linear in
        a state evaluated at z and all others at sat(z)."""
        linear, nonlinear = zip(*(linear_terms(e, self.form.states) for e in expressions), strict=True)
        return column(self._convert(linear, z, u)) + column(self._convert(nonlinear, self.saturated(z), u))

    def _convert(
        self,
        expressions: Any,
        z: Graph,
        u: Graph,
        states: Sequence[sp.Symbol] | None = None,
        boxed: bool = True,
        slopes: bool = False,
    ) -> list[Graph]:
        system = self.form.system
        symbols = {s: z[i] for i, s in enumerate(states or self.form.states)}
        symbols |= {s: u[i] for i, s in enumerate(system.inputs)}
        symbols |= {p: sym("plant", p.name) for p in system.tunable}
        rows: Iterable[sp.Expr] = map(sp.sympify, expressions)
        around = system.box_with(states or self.form.states)
        around |= {s: EVERYTHING for s in around if getattr(s, "period", None) is not None}
        if slopes:
            rows = [with_limited_slopes(e, around) for e in rows]
        if self.form.clamped and boxed:
            rows = (as_computed(resolved(e), around) for e in rows)
        constants = tuple(system.constants.items())
        return to_casadi([_with_values(e, constants) for e in rows], symbols)


@lru_cache(maxsize=512)  # the same rows occur at each stage of a step
def _with_values(expression: sp.Expr, constants: tuple[tuple[sp.Symbol, Any], ...]) -> sp.Expr:
    return expression.subs(dict(constants))


def linear_terms(expression: sp.Expr, states: Sequence[sp.Symbol]) -> tuple[sp.Expr, sp.Expr]:
    """Return the sum of the terms of an expression that are a state times a factor free of states, and the sum of all
    other terms."""
    linear: list[sp.Expr] = []
    others: list[sp.Expr] = []
    for term in sp.Add.make_args(sp.expand_mul(expression)):
        _, factor = term.as_independent(*states, as_Add=False)
        (linear if factor in states else others).append(term)
    return sp.Add(*linear), sp.Add(*others)


def reach(rows: Iterable[sp.Expr], state: Signal, states: Iterable[Signal]) -> tuple[float, float]:
    """Return the interval of `state` on which the expressions `rows` may be evaluated without a clamp: its range, with
    an infinite end where every row that depends on this state is monotone beyond the end."""
    slopes = [sp.diff(row, state) for row in rows if state in row.free_symbols]
    around, (low, high) = box(states), state.interval

    def turns(beyond: tuple[float, float]) -> bool:
        return any(contains_zero(enclose(slope, {**around, state: beyond})) for slope in slopes)

    return (low if turns((-INF, low)) else -INF), (high if turns((high, INF)) else INF)


def transformed(form: Form) -> bool:
    """Return whether the form's coordinates differ from the system's states by more than order and signs."""
    return not all(x.is_Symbol or (-x).is_Symbol for x in form.from_form)
