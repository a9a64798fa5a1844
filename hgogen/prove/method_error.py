"""The local error of an integration method: bounds of the deviation of its step from the plant on the declared ranges.

1. Explicit Runge-Kutta methods, on a Lipschitz flow. With |dF_i/dx_j|, |dF_i/du_k| <= L, |x'| <= V, |u'| <= r, W = L
(V, r) bounds the rates of F along the plant's path, where F may have kinks. The Peano kernel of a sum of values on [0,
c], with weights w_l at c_l, is its integral from 0,

    K(s) = min(s, c) - sum of w_l over c_l <= s,   |integral from 0 to c h of F - h sum_l w_l F(c_l h)| <= h^2 W int|K|

so that d_i, the distance of a stage from the plant at its time, and that of the result have the bounds

    d_i <= h^2 W int|K_i| + h sum_j |a_ij| L d_j,   |x(t + h) - Phi_h(x)| <= h^2 W int|K| + h sum_i |b_i| L d_i

A linear row of F has a second derivative of at most L W. For weights that are exact for lines its first term is at most
h^3 L W (1/24 + sum_i |b_i| (c_i - 1/2)^2/2).

2. Explicit Runge-Kutta methods, on a flow with Taylor series.

    x(t + h) = Phi_h(x) + delta,   Phi_h: a step of the method on x' = F(x, u) = A x + b, without injection

While the plant keeps clear of the ends of its ranges by h sup|F_i|, the stages X_i and the flow from x do not leave
them, and no clamp acts. Then

    line          l_i = (1 - c_i) y_k + c_i C Phi_h(x) - C X_i;
                  |l_i| <= h^2 sum_j |c_i b_j - a_ij| sum_k |a_jk| sup|y''|
                  and h^3 sup|l_(i,3)|, its Taylor coefficient, where that of h^2 is 0: sum_j (c_i b_j - a_ij) c_j = 0
    remainder     |x(t + h) - Phi_h(x)| <= h^(q+1) (sup|x_(q+1)| + sup|Phi_(q+1)|) for each q from 1 to p, of a method
                  of order p: Taylor coefficients in time of the flow at any point, of the step at any length up to h,
                  in Arb's balls on cells of the ranges; or the bound of part 1 (`lipschitz_remainder`), also where
                  there is no series. Each row takes the least

3. Methods that realise the linear core of an observer. The plant in the coordinates of the errors, X_k = s_k z_i for a
field k that estimates z_i and 0 for a filter, obeys the observer's own equations, as it injects no output error. With
the core L of `realised_step`, y the plant's own output and beta_k = s_k b_i,

    X' = L X + w,   w = B y + beta
    a = X_0 + h phi_1 X'_0 + h phi_2 B (y_1 - y_0),   X+ = a + h phi_2 (beta(a) - beta_0)

the last a step of the program from X_0, with samples y_0 and y_1 of the plant at both ends: here the line between two
samples needs no term of its own. alpha is the error of a realisation whose nonlinear part is known at both ends,

    alpha = X_0 + h phi_1 X'_0 + h phi_2 (w_1 - w_0) - X(t + h),   so that
    a - X(t + h) = alpha - h phi_2 (beta_1 - beta_0),   X+ - X(t + h) = alpha + h phi_2 (beta(a) - beta_1)

Let v - line be the difference of a signal v from the line between its ends, |v - line| <= s (h - s)/2 sup|v''|, and
phi* the exponential's phi. With phi_1 = 1 + h L phi_2, which each realisation has, and h L X'_0 + w_1 - w_0 the
integral of (1 - (h - s) L) X''(s),

    by the matrix exponential   alpha = h (phi_2 - phi_2*) integral of (1 - (h - s) L) X''(s)
                                        - integral of exp((h - s) L) (w - line)(s)
    by the bilinear rule        alpha = -(1 - h L/2)^-1 integral of (X' - line)(s)

entry by entry. Where F has kinks, or derivatives without a bound, z'' and b' are bounded by the Lipschitz constants of
F and b times the rates of states and inputs; and |v - line| <= 2 s (h - s)/h sup|v'|, as if v'' were 4/h times that.
|beta_1 - beta_0| <= h sup|beta'|. |beta(a) - beta_1| is at most the slopes of the error times |a - X(t + h)|: clamping
a brings it nearer to a plant within its ranges. The integral with the exponential is a sum over pieces, in each of
which Arb's balls hold it.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import flint
import numpy as np
import sympy as sp
from flint import arb, arb_mat, ctx

from hgogen.analysis.evidence import Evidence
from hgogen.analysis.ranges import fixed_parameters
from hgogen.analysis.scaling import heads
from hgogen.discretisation.runge_kutta import Tableau
from hgogen.prove import inequality
from hgogen.prove.inclusion import Inclusion, Uncertain
from hgogen.prove.plant_step import (
    SUMMED,
    UNKNOWN,
    ErrorInput,
    PlantStep,
    Rows,
    Sizes,
    Unbounded,
    heads_of,
    times,
    with_slack,
)
from hgogen.prove.quadratic import BALLS, Array, floats, identity, rational
from hgogen.rigor.box import exact
from hgogen.rigor.definite import number
from hgogen.rigor.lookup import Table
from hgogen.rigor.search import Ranges, Subdivision, subdivided
from hgogen.rigor.series import between, magnitude
from hgogen.rigor.slope import JUMPS, KINKS
from hgogen.sentence import because

_ZERO, _ONE, _HALF = Fraction(0), Fraction(1), Fraction(1, 2)
Column = Sequence[Fraction]


def lipschitz_remainder(
    h: Fraction,
    a: Sequence[Column],
    b: Column,
    c: Column,
    steepness: Sequence[Column],
    moving: Column,
    linear: Sequence[bool],
) -> tuple[Fraction, ...] | None:
    """Return bounds (n) of the local error |x(t + h) - Phi_h(x)|/h of one step Phi_h of a Runge-Kutta method with
    coefficients `a`, `b`, `c`; None where these do not integrate constants exactly. `steepness` (n, n + m): Lipschitz
    constants of the flow in states and inputs; `moving` (n + m): the largest rates of these; `linear` (n): whether F_i
    is linear."""
    if sum(b) != 1 or any(sum(row) != at for row, at in zip(a, c, strict=True)):
        return None
    L = np.array(steepness, dtype=object)
    in_states, second_rates, away = L[:, : len(L)], L @ np.array(moving, dtype=object), list[np.ndarray]()
    for row, at in zip((*a, b), (*c, _ONE), strict=True):
        stages = (h * abs(w) * (in_states @ off) for w, off in zip(row, away, strict=False))
        away.append(sum(stages, h**2 * _kernel(at, row, c) * second_rates))
    over_h, less = away[-1] / h, 0 * second_rates
    if sum(w * at for w, at in zip(b, c, strict=True)) == _HALF:
        spread = Fraction(1, 24) + sum((abs(w) * (at - _HALF) ** 2 / 2 for w, at in zip(b, c, strict=True)), _ZERO)
        less = h * _kernel(_ONE, b, c) * second_rates - h**2 * spread * (in_states @ second_rates)
    return tuple(x - max(y, _ZERO) if line else x for x, y, line in zip(over_h, less, linear, strict=True))


def _kernel(end: Fraction, weights: Column, places: Column) -> Fraction:
    """Return the integral of |K(s)| from 0 to 1 of the Peano kernel
    K(s) = min(s, `end`) - sum of the `weights` at `places` <= s."""
    cuts, total = sorted({_ZERO, end, _ONE, *places}), _ZERO
    for low, high in pairwise(cuts):
        passed = sum((w for w, at in zip(weights, places, strict=True) if at <= low), _ZERO)
        first, last = min(low, end) - passed, min(high, end) - passed
        sizes = abs(first) + abs(last)
        crossed = (first**2 + last**2) / (2 * sizes) if first * last < 0 else sizes / 2
        total += (high - low) * crossed
    return total


_SECOND, _THIRD = 2, 3  # order of the Taylor coefficient of a line
_DENOMINATOR = 10_000  # the largest denominator of a tableau's coefficients
_LITTLE = Fraction(1, 1000)  # remainder over the plant's speed, below which cells are not cut
_NO_REMAINDER = "the method's remainder has no bound on the ranges: {flow}"


@dataclass(frozen=True)
class StageDeviation:
    """The deviation of the `plant` over one step from the step of an explicit Runge-Kutta method with this
    `tableau`."""

    plant: PlantStep
    tableau: Tableau

    @property
    def error_input(self) -> ErrorInput:
        """The sizes of the errors that the method causes at its stages and its end, and the numbers from which a
        certificate derives them. Raises: `Unbounded`."""
        outputs, still = range(len(self.plant.form.output)), (Fraction(0),) * len(self.tableau.b)
        stages = tuple(self.line(output) if output in self._used else still for output in outputs)
        sizes, cells, rows = Sizes(stages=stages, deviation=self.remainder()), self._cells, self._rows
        orders = [row.order for row in rows]
        follows = {
            "rates": self.plant.input_rates,
            "speeds": self.plant.stated_speeds,
            "slopes": self._output_steepness,
            "lines": self._lines,
            "orders": orders,
            "flow": [row.flow for row in rows],
            "step": [row.step for row in rows],
            "steepness": [] if all(orders) else self._steepness,
            "tree": cells.tree if cells else ".",
        }
        return ErrorInput(sizes, follows)

    def line(self, output: int) -> tuple[Fraction, ...]:
        """Return, for each stage (s), the largest difference between an output at this stage and the linear
        interpolation of its two samples; `output`: its index. Raises: `Unbounded`."""
        (a, _, _), moving = self._coefficients, (*self.plant.stated_speeds, *self.plant.input_rates)
        second_rate = sum((x * most for x, most in zip(self._output_steepness[output], moving, strict=True)), _ZERO)
        away = [sum(map(abs, row), _ZERO) for row in a]  # distance of a stage from the start, over h sup|F|
        shares = [sum((abs(w) * far for w, far in zip(row, away, strict=True)), _ZERO) for row in self._line_weights]
        sizes = [self.plant.h**2 * share * second_rate for share in shares]
        for i, third in zip(self._cubic, self._lines[output], strict=False):
            sizes[i] = min(sizes[i], self.plant.h**_THIRD * third)
        return tuple(sizes)

    def remainder(self) -> tuple[Fraction, ...]:
        """Return bounds (n) of the local error |x(t + h) - Phi_h(x)|/h, Phi_h a step of the method. Raises:
        `Unbounded`."""
        return tuple(row.size for row in self._rows)

    @cached_property
    def _rows(self) -> tuple["Row", ...]:
        """The least bound of |x(t + h) - Phi_h(x)|_i/h over the orders of Taylor's formula
        and the Lipschitz bound, for each state i (n), Phi_h the method's step."""
        known, plant = self._known, self.plant
        rows = [known.rows(plant.h)] if known else []
        if not known or known.weight(plant.h, self._negligible) > 1:
            moving = (*plant.stated_speeds, *plant.input_rates)
            terms = (sp.Add.make_args(row) for row in plant.flow)
            linear = [all(term.is_number or term.as_coeff_Mul()[1].is_Symbol for term in row) for row in terms]
            sizes = lipschitz_remainder(plant.h, *self._coefficients, self._steepness, moving, linear)
            if sizes is None:
                raise Unbounded(because(_NO_REMAINDER, flow=plant.flow))
            rows += [tuple(Row(0, _ZERO, _ZERO, size) for size in sizes)]
        return tuple(min(each, key=lambda row: row.size) for each in zip(*rows, strict=True))

    @cached_property
    def _steepness(self) -> Rows:
        return self.plant.steep(self.plant.flow)

    @cached_property
    def _output_steepness(self) -> Rows:
        """The Lipschitz constants (p, n + m) of each output's y' in the
        n states and m inputs, 0 for outputs that are not injected."""
        plant, outputs = self.plant, range(len(self.plant.form.output))
        return plant.steep(plant.rate(output) if output in self._used else sp.S(0) for output in outputs)

    @property
    def _used(self) -> Mapping[int, int]:
        return heads(self.plant.form)

    @cached_property
    def _line_weights(self) -> Rows:
        """The weights c_i b_j - a_ij (s, s) of h F(X_j) in the difference
        between the line through two samples and stage i."""
        a, b, c = self._coefficients
        return tuple(tuple(at * w - x for w, x in zip(b, row, strict=True)) for at, row in zip(c, a, strict=True))

    @cached_property
    def _cubic(self) -> list[int]:
        """The stages at which the line through two samples differs from the stage by O(h^3) only."""
        a, _, c = self._coefficients
        if [sum(row) for row in a] != c:
            return []
        each = enumerate(self._line_weights)
        return [i for i, row in each if any(row) and not sum(w * at for w, at in zip(row, c, strict=True))]

    @cached_property
    def _lines(self) -> Rows:
        """The factors of h^3 in the differences between each output's line through two samples and
        those stages (p, ..) where they are O(h^3); empty rows if the flow has no Taylor series."""
        known, rows = self._known, list[tuple[Fraction, ...]]()
        for output, y in enumerate(self.plant.form.output):
            expression = y if output in self._used else sp.S(0)
            slopes = [self.plant.largest(sp.diff(expression, z)) for z in self.plant.form.states]
            rows.append(tuple(off * SUMMED for off in times(known.lines, slopes)) if known else ())
        return tuple(rows)

    @cached_property
    def _known(self) -> "Coefficients | None":
        return Coefficients.largest(self._cells.cells) if self._cells else None

    @cached_property
    def _cells(self) -> "Subdivision[Coefficients] | None":
        weight = partial(Coefficients.weight, h=self.plant.h, little=self._negligible)
        return subdivided(self.plant.read, self._on_cell, weight)

    @cached_property
    def _negligible(self) -> tuple[Fraction, ...]:
        return tuple(_LITTLE * speed for speed in self.plant.stated_speeds)

    def _on_cell(self, cell: Ranges) -> "Coefficients | None":
        last, c = self.tableau.order + 2, self._coefficients[2]
        try:
            flow, (stages, end) = self.plant.series(last, cell), self._step_series(cell)
        except UNKNOWN:
            return None
        lines = [
            [x[_THIRD] * flint.arb(number(c[i])) - y[_THIRD] for x, y in zip(end, stages[i], strict=True)]
            for i in self._cubic
        ]
        each = [zip(*(row[_SECOND:last] for row in rows), strict=True) for rows in (flow, end)]
        kinds = (*each, lines)
        return Coefficients(*(tuple(tuple(magnitude(x) * SUMMED for x in row) for row in rows) for rows in kinds))

    def _step_series(self, cell: Ranges) -> tuple[list[list[list[Any]]], list[list[Any]]]:
        """Return the Taylor coefficients in the step length, up to h, from a
        point of `cell`, of all stages (s, n, ..) and of the result (n, ..)."""
        (a, b, c), (states, inputs, constant) = self._coefficients, self.plant.balls(cell)
        order = max(_THIRD + 1, self.tableau.order + 2)
        length = flint.arb_series([between(Fraction(0), self.plant.h), flint.arb(1)], prec=order)
        slopes, stages = list[list[Any]](), list[list[list[Any]]]()

        def states_after(weights: Sequence[Fraction]) -> list[Any]:
            totals = [flint.arb_series([x], prec=order) for x in states]
            for weight, slope in zip(weights, slopes, strict=False):
                totals = [
                    total + length * one * flint.arb(number(weight)) for total, one in zip(totals, slope, strict=True)
                ]
            return totals

        for row, at in zip(a, c, strict=True):
            here = [[u, rate * flint.arb(number(at))] for u, rate in inputs]
            stages.append([_padded(x.coeffs(), order) for x in states_after(row)])
            rates = self.plant.rates_of(stages[-1], here, constant, order)
            slopes.append([flint.arb_series(rate, prec=order) for rate in rates])
        return stages, [_padded(x.coeffs(), order) for x in states_after(b)]

    @property
    def _coefficients(self) -> tuple[list[list[Fraction]], list[Fraction], list[Fraction]]:
        """The exact coefficients a (s, s), b (s) and c (s) of the tableau, which holds them in floats."""

        def exactly(values: Sequence[float]) -> list[Fraction]:
            return [Fraction(value).limit_denominator(_DENOMINATOR) for value in values]

        rows = [(*row, *[0.0] * (len(self.tableau.b) - len(row))) for row in self.tableau.a]
        return [exactly(row) for row in rows], exactly(self.tableau.b), exactly(self.tableau.c)


@dataclass(frozen=True)
class Row:
    """A bound `size` of the local error |x(t + h) - Phi_h(x)|_i/h of one state. For an `order` q > 0 it is h^q (`flow`
    + `step`), the bounds of the Taylor coefficients of the plant's flow and of the method's step; for order 0 it is the
    bound by Lipschitz constants."""

    order: int
    flow: Fraction
    step: Fraction
    size: Fraction


@dataclass(frozen=True)
class Coefficients:
    """Bounds of Taylor coefficients in the step length on a part of the ranges: of the plant's `flow` and of the
    method's `step` (.., n), from the second coefficient on; and the third coefficients of `lines` (.., n), the
    differences between interpolated samples and stages."""

    flow: Rows
    step: Rows
    lines: Rows

    @classmethod
    def largest(cls, each: Sequence["Coefficients"]) -> "Coefficients":
        """Return, entry by entry, the largest coefficients of several cells."""
        kinds = zip(*((one.flow, one.step, one.lines) for one in each), strict=True)
        grouped = (zip(*kind, strict=True) for kind in kinds)
        return cls(*(tuple(tuple(map(max, zip(*rows, strict=True))) for rows in kind) for kind in grouped))

    def rows(self, h: Fraction) -> tuple[Row, ...]:
        """Return, for each state (n), the smallest bound of the local error over all orders, for a step of length h."""
        each = enumerate(zip(self.flow, self.step, strict=True), 1)
        orders = [[Row(q, x, y, h**q * (x + y)) for x, y in zip(*pair, strict=True)] for q, pair in each]
        return tuple(min(row, key=lambda one: one.size) for row in zip(*orders, strict=True))

    def weight(self, h: Fraction, little: Sequence[Fraction]) -> float:
        """Return the largest ratio, over the states, of the bound of the local error to `little` (n), the size that is
        negligible."""
        pairs = zip(self.rows(h), little, strict=True)
        return max((float(row.size / most) if most else math.inf for row, most in pairs if row.size), default=0.0)


def _padded(values: list[Any], order: int) -> list[Any]:
    return [*values, *[flint.arb(0)] * (order - len(values))]


_FEW, _MANY = 8, 64  # the least and the most pieces of a step
_FINE = 8  # pieces per unit of |L| h
_BARELY = 1 + Fraction(1, 10**6)  # factor on a size, so that a weaker arithmetic proves it
_SECOND_PER_FIRST = 4  # over h: factor from a bound of v' to a substitute for that of v''
_SMOOTH = 5  # number of Taylor coefficients of the plant, up to its third derivative


@dataclass(frozen=True, eq=False)
class CoreDeviation:
    """The deviation of the `plant` over one step from the step of a method that integrates the linear core of an
    observer's `error` at `theta`. `smooth`: whether the plant has the derivatives that its bounds use; if not,
    Lipschitz constants replace them."""

    plant: PlantStep
    error: Inclusion
    theta: Fraction
    smooth: bool = True

    def error_input(self, realisation: inequality.Realisation, local: "LocalError") -> ErrorInput:
        """Return the largest deviation of each component of e, after one step, from that of the plant's own state, and
        the numbers from which a certificate derives it. `realisation`: the function to phi_1 and phi_2; `local`: its
        local error. Raises: `Unbounded`."""
        self._demand_chain()
        try:
            return self._by_derivatives(realisation, local)
        except Unbounded:
            return replace(self, smooth=False)._by_derivatives(realisation, local)

    def _by_derivatives(self, realisation: inequality.Realisation, local: "LocalError") -> ErrorInput:
        with ctx.workprec(BALLS):
            weight, alpha = np.abs(realisation(self.L, self.plant.h)[1]) * self.h, local.alpha(self)
            ahead = alpha + weight @ np.abs(self.lifted) @ self.most(1, self.plant.nonlinear_part) * self.h
            e = self.obeyed
            slopes = np.abs(e.M - e.core) + np.abs(e.G) @ np.abs(e.H)  # bound of the slopes outside of the core
            total = alpha + weight @ slopes @ ahead
            if not all(arb(x).is_finite() for x in total):
                raise Unbounded(because("its core turns too fast for a step of {h}", h=float(self.plant.h)))
            sizes = Sizes(fields=tuple(magnitude(arb(x)) * _BARELY / self.plant.h for x in total))
        return ErrorInput(sizes, self._follows(local))

    def _follows(self, local: "LocalError") -> Evidence:
        flow, nonlinear = self.plant.flow, self.plant.nonlinear_part
        known = {"rates": self.plant.input_rates, "speeds": self.plant.stated_speeds}
        if not self.smooth:
            return {**known, "flow": [], "rest": [], "steepness": [self.plant.steep(flow), self.plant.steep(nonlinear)]}
        return {
            **known,
            "flow": self._derivatives(local.flow, flow),
            "rest": tuple(self._derivatives(order, nonlinear) for order in range(1, local.nonlinear + 1)),
            "steepness": [],
        }

    @cached_property
    def obeyed(self) -> Uncertain:
        """The error dynamics e' = M e + G diag(d) H e at theta."""
        return self.error.at(self.theta)

    @property
    def L(self) -> Array:
        """The linear core L (N, N) that the method realises."""
        return self.obeyed.core

    @property
    def h(self) -> Any:
        """The length of the step as FLINT's rational."""
        return number(self.plant.h)

    @cached_property
    def lifted(self) -> Array:
        """The matrix s (N, n) with e = s times the errors of the form's states, 0 for components of filters."""
        scales = self.error.scales(self.theta)
        assert scales is not None  # a plant's step is asked of numbers alone
        return self.error.lifted(scales)

    @cached_property
    def sample_input(self) -> Array:
        """The matrix B C (N, n) by which the plant's outputs C z enter e'."""
        columns, heads_by_output = 0 * self.lifted, heads_of(self.plant.form)
        assert heads_by_output is not None
        for output, (head, slope) in heads_by_output.items():
            columns[:, head] += self.obeyed.injected[:, output] * number(slope)
        return columns

    def most(self, order: int, rows: Sequence[sp.Expr]) -> Array:
        """Return sup (n) of the time derivatives, of the first or second `order`, of expressions `rows`; for a plant
        that is not smooth, 4/h times the first in place of the second. Raises: `Unbounded`."""
        if self.smooth:
            return rational(self._derivatives(order, rows))
        rates = times(self.plant.steep(rows), (*self.plant.stated_speeds, *self.plant.input_rates))
        return rational([(_SECOND_PER_FIRST / self.plant.h) ** (order - 1) * rate for rate in rates])

    def _derivatives(self, order: int, rows: Sequence[sp.Expr]) -> tuple[Fraction, ...]:
        self._demand_smooth()
        for _ in range(order):
            rows = [self.plant.along(row) for row in rows]
        return tuple(with_slack(row, self.plant.largest(row) * SUMMED) for row in rows)

    def _demand_chain(self) -> None:
        """Demand L s + B C = s A: then the plant obeys the observer's equations."""
        form, each = self.plant.form, range(self.plant.form.n)
        for output in heads(form):
            self.plant.demand_no_input(form.output[output])
        A = form.A.applyfunc(lambda a: exact(sp.sympify(a).xreplace(fixed_parameters(form))))
        chain = rational([[Fraction(int(A[i, j].p), int(A[i, j].q)) for j in each] for i in each])
        if (self.L @ self.lifted + self.sample_input != self.lifted @ chain).any():
            raise Unbounded(because("its core is not the plant's chain in exact numbers"))

    def _demand_smooth(self) -> None:
        if not any(row.has(*JUMPS, *KINKS, Table) for row in self.plant.flow):
            return
        try:
            self.plant.series(_SMOOTH, {})
        except UNKNOWN as error:
            pattern = "how far the plant bends in a step has no bound on the ranges: {flow}"
            raise Unbounded(because(pattern, flow=self.plant.flow)) from error


@dataclass(frozen=True)
class LocalError:
    """The local error of a method that integrates w' = L w + B y + beta exactly for y and beta linear in time. `alpha`:
    the function to its bounds (N); `flow`: the order of the time derivative of z' in these bounds; `nonlinear`: the
    highest order of time derivatives of b in them."""

    flow: int
    nonlinear: int
    alpha: Callable[[CoreDeviation], Array]


def by_bilinear_rule(step: CoreDeviation) -> Array:
    """Return the bound (N) of the bilinear rule's local error, |(1 - h L/2)^-1 s| h^3/12 sup|z'''|, s the matrix from
    errors of the form's states z to e. Raises: `Unbounded`."""
    resolvent, _ = inequality.by_bilinear_rule(step.L, step.plant.h)
    return np.asarray(np.abs(resolvent @ step.lifted) @ step.most(2, step.plant.flow) * (step.h**3 / 12))


def by_matrix_exponential(step: CoreDeviation) -> Array:
    """Return the bound (N) of the local error of the matrix exponential: the integral of exp((h - s) L) times the
    deviation of the source B y + beta from a line in time, plus the part by which the program's phi_2 may differ.
    Raises: `Unbounded`."""
    source, rates = np.hstack([step.sample_input, step.lifted]), step.most(1, step.plant.flow)
    driven = _integral(step.L, step.plant.h, source) @ np.concatenate([rates, step.most(2, step.plant.nonlinear_part)])
    any_of_it = 0 * step.L + number(inequality.WITHIN)
    turned = identity(len(step.L)) + np.abs(step.L) * (step.h / 2)
    return np.asarray(driven + any_of_it @ turned @ np.abs(step.lifted) @ rates * step.h**2)


BILINEAR = LocalError(2, 1, by_bilinear_rule)
EXPONENTIAL = LocalError(1, 2, by_matrix_exponential)


def _integral(L: Array, h: Fraction, source: Array) -> Array:
    """Return an upper bound (N, q) of the integral from 0 to h of s (h - s)/2 |exp(s L) source|, `source` (N, q)."""
    turns = float(np.abs(floats(L)).sum(axis=1).max()) * float(h)
    count, total = min(_MANY, max(_FEW, math.ceil(_FINE * turns))), 0 * source
    for low, high in pairwise(h * Fraction(k, count) for k in range(count + 1)):
        weight = h * (high**2 - low**2) / 4 - (high**3 - low**3) / 6
        sizes = [[x.abs_upper() for x in row] for row in _power(L, low, high) @ source]
        total = total + np.array(sizes, dtype=object).reshape(source.shape) * number(weight)
    return total


def _power(L: Array, low: Fraction, high: Fraction) -> Array:
    """Return balls (N, N) that enclose exp(s L) for every s in [low, high]."""
    half, each = (high - low) / 2, range(len(L))
    ends = (arb(number(low + half)), between(-half, half))
    middle, around = (arb_mat([[arb(x) * s for x in row] for row in L.tolist()]).exp() for s in ends)
    power = middle * around
    return np.array([[power[i, j] for j in each] for i in each], dtype=object)
