"""The plant over one step, on its declared ranges: its speed, the effect of disturbances, its Taylor series.

    disturbance   |d_i(t)| <= dbar_i of any course in x' = F + d: |delta| <= integral over h of exp(s |dF/dx|) dbar

F = A x + b in the form's states. Between two samples u moves as the program assumes: linearly, at most at its rates, or
it is constant. While the plant keeps clear of the ends of its ranges by h sup|F_i|, neither it nor the flow without
disturbances leaves them within a step. `method_error` bounds the local error of a method.

The inputs of the error of a step, and their largest sizes (`Sizes`):

    samples     an error of an output's samples at both ends of a call, independent of each other, with the line between
    stages      an error of the injection at a stage
    deviation   the deviation of the plant from a step of the method in a row of its form, over h; the sample at the end
                of the call contains it
    fields      a deviation of a field of the estimator itself, over h
"""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any

import flint
import sympy as sp

from hgogen.analysis.evidence import Evidence
from hgogen.analysis.ranges import fixed_parameters, signals
from hgogen.analysis.scaling import heads
from hgogen.check import Verdict
from hgogen.form import Form
from hgogen.prove.inclusion import Inclusion
from hgogen.prove.inequality import Inequality, Inputs
from hgogen.prove.quadratic import identity
from hgogen.prove.questions import InputBound
from hgogen.rigor.bounds import bound
from hgogen.rigor.box import Box, box, exact
from hgogen.rigor.definite import number
from hgogen.rigor.search import Ranges
from hgogen.rigor.series import BallSeries, Plant, Undecided, between, evaluate, magnitude
from hgogen.rigor.slope import JUMPS, KINKS, lipschitz_bound
from hgogen.rigor.tape import NoTape, tape
from hgogen.sentence import because

_LOOSE = Fraction(1001, 1000)  # factor on a supremum, so that a weaker arithmetic proves it
_ZERO = Fraction(0)
SUMMED = 1 + Fraction(1, 10**9)  # factor on a number that another arithmetic rounds differently
Rows = tuple[tuple[Fraction, ...], ...]
# of a series; ValueError where FLINT divides by a ball around 0
UNKNOWN = Undecided, ZeroDivisionError, ValueError, NoTape


@dataclass(frozen=True)
class PlantStep:
    """The plant z' = F(z, u) of a `form` over one step of length `h`, with bounds of its change on the declared ranges.
    `rates` (m): the largest speeds of the inputs u between samples, None where unknown."""

    form: Form
    h: Fraction
    rates: tuple[Fraction | None, ...]

    @cached_property
    def flow(self) -> tuple[sp.Expr, ...]:
        """The right-hand side F = A z + b (n) of z' = F, expressions of states, inputs and parameters; parameters
        without a range have their values."""
        return self._fixed(self.form.A * sp.Matrix(self.form.states) + sp.Matrix(self.form.b))

    @property
    def nonlinear_part(self) -> tuple[sp.Expr, ...]:
        """The b (n) of z' = A z + b; parameters without a range have their values."""
        return self._fixed(self.form.b)

    def _fixed(self, rows: Iterable[sp.Expr]) -> tuple[sp.Expr, ...]:
        return tuple(exact(sp.sympify(row).xreplace(fixed_parameters(self.form))) for row in rows)

    @cached_property
    def speeds(self) -> tuple[Fraction, ...]:
        """The suprema sup|F_i| (n) on the declared ranges. Raises: `Unbounded`."""
        return tuple(self.largest(row) for row in self.flow)

    @cached_property
    def stated_speeds(self) -> tuple[Fraction, ...]:
        """The bounds of sup|F_i| (n) that a certificate states: up to 0.1 % above `speeds`, so that less accurate
        arithmetic proves them too."""
        return tuple(map(with_slack, self.flow, self.speeds))

    @property
    def margins(self) -> tuple[Fraction, ...]:
        """The distances h sup|F_i| (n) that the plant must keep from the ends of its ranges. Raises: `Unbounded`."""
        return tuple(self.h * speed for speed in self.speeds)

    def output_rate(self, output: int) -> Fraction:
        """Return sup|y'| of an output, by its index from 0, on the declared ranges. Raises: `Unbounded`."""
        rate = self.rate(output)
        return with_slack(rate, self.largest(rate))

    def output_rate_deviation(self, output: int, most: Sequence[Fraction]) -> Fraction:
        """Return sum_i sup|dy/dz_i| most_i, a bound of the change of an output's derivative y' where each rate z_i'
        changes by at most `most` (n). Raises: `Unbounded`."""
        y = self.form.output[output]
        by = zip(self.form.states, most, strict=True)
        return sum((self.largest(sp.diff(y, z)) * size for z, size in by if size), Fraction(0))

    def rate(self, output: int) -> sp.Expr:
        """Return y' = sum_i dy/dz_i F_i, an expression, of an output (index from 0) that contains no input. Raises:
        `Unbounded`."""
        form, y = self.form, self.form.output[output]
        self.demand_no_input(y)
        return sum((sp.diff(y, z) * row for z, row in zip(form.states, self.flow, strict=True)), sp.S(0))

    def demand_no_input(self, y: sp.Expr) -> None:
        """Demand that an output's expression y contains no input. Raises: `Unbounded`."""
        if y.free_symbols & {*self.form.system.inputs}:
            raise Unbounded(because("the output {y} reads an input", y=y))

    def along(self, expression: sp.Expr) -> sp.Expr:
        """Return the time derivative of an expression of states and inputs along z' = F; u' of an input is a symbol
        "u'"."""
        inputs = self.form.system.inputs
        by = zip((*self.form.states, *inputs), (*self.flow, *map(_rate_of, inputs)), strict=True)
        return sum((sp.diff(expression, x) * rate for x, rate in by), sp.S(0))

    def change(self, most: Sequence[Fraction]) -> Rows:
        """Return the suprema sup|dT_i/dx_j| (n, n) of the coordinates z = T(x) of the form, x the states of the plant
        as first declared; 0 in columns j where `most` (n), the sizes of disturbances of x_j', is 0. Raises:
        `Unbounded`."""
        system, form, plant = self.form.system, self.form, self.form.system.declared
        where = system.box_with(plant.states)
        rows = [sp.sympify(row).xreplace(self._recast) for row in form.to_form]
        T, nothing = sp.Matrix(rows).jacobian(sp.Matrix(plant.states)), Fraction(0)
        return tuple(
            tuple(with_slack(T[i, j], _largest(T[i, j], where)) if size else nothing for j, size in enumerate(most))
            for i in range(form.n)
        )

    @property
    def _recast(self) -> dict[sp.Symbol, sp.Expr]:
        origin = self.form.system.origin
        return dict(zip(self.form.system.states, origin.forward, strict=True)) if origin else {}

    def by_parameters(self, most: Sequence[Fraction]) -> Rows:
        """Return the suprema sup|dF_i/dp_j| (n, q) in the parameters p, where the plant's parameters differ from the
        program's by at most `most` (q); 0 in columns where `most` is 0. Raises: `Unbounded`."""
        form, system = self.form, self.form.system
        wrong = {p: size for p, size in zip(system.parameters, most, strict=True) if size}
        read = sp.Matrix([*form.to_form, *form.output, *self._recast.values()]).free_symbols & wrong.keys()
        if read:
            raise Unbounded(because("the coordinates or outputs read {read}", read=sorted(map(str, read))))
        where = form.box
        for p, (low, high) in box(tuple(wrong), system.nominal).items():
            where[p] = Fraction(low) - wrong[p], Fraction(high) + wrong[p]
        rows = form.A * sp.Matrix(form.states) + sp.Matrix(form.b)
        parameters, nothing = system.parameters, Fraction(0)
        return tuple(
            tuple(with_slack(row, steepness_in(row, p, where)) if p in wrong else nothing for p in parameters)
            for row in rows
        )

    @cached_property
    def steepness(self) -> Rows:
        """The suprema sup|dF_i/dz_j| (n, n) of the Jacobian of the flow on the declared ranges. Raises: `Unbounded`."""
        return tuple(tuple(self.steepest(row, z) for z in self.form.states) for row in self.flow)

    def steep(self, rows: Iterable[sp.Expr]) -> Rows:
        """Return Lipschitz constants (k, n + m) of k expressions in the n states and m inputs. Raises: `Unbounded`."""
        names = (*self.form.states, *self.form.system.inputs)
        return tuple(tuple(self.steepest(row, x) for x in names) for row in rows)

    def steepest(self, row: sp.Expr, x: sp.Symbol) -> Fraction:
        """Return the supremum sup|d row/dx| of an expression `row` in one state or input x; at a kink both one-sided
        derivatives count. Raises: `Unbounded` for an expression that jumps."""
        if not row.has(*JUMPS, *KINKS):
            slope = sp.diff(row, x)
            with suppress(Unbounded):
                return with_slack(slope, self.largest(slope))
        return with_slack(row, steepness_in(row, x, self.form.box))

    def disturbed(self, most: Sequence[Fraction]) -> tuple[Fraction, ...]:
        """Return bounds (n) of |delta|/h, delta the difference over one step between x' = F + d and x' = F, for
        disturbances |d_i| <= `most` (n) of any course: h |delta| <= integral of exp(s sup|dF/dx|) most. Raises:
        `Unbounded`."""
        n = self.form.n
        M = [[*(x * self.h for x in row), size] for row, size in zip(self.steepness, most, strict=True)]
        whole = flint.arb_mat([[flint.arb(number(x)) for x in row] for row in [*M, [Fraction(0)] * (n + 1)]]).exp()
        return tuple(magnitude(whole[i, n]) * SUMMED for i in range(n))

    def series(self, order: int, cell: Ranges) -> list[list[Any]]:
        """Return the Taylor coefficients in time (n, order) of each state, as balls that enclose those of every
        solution of z' = F from a point of `cell`, a part of the ranges."""
        first, input_rates, constant = self.balls(cell)
        states, inputs = [[ball] for ball in first], [list(pair) for pair in input_rates]
        for k in range(order - 1):
            rows = self.rates_of(states, inputs, constant, k + 1)
            for row, rate in zip(states, rows, strict=True):
                row.append(rate[k] / (k + 1))
        return states

    def rates_of(
        self, states: list[list[Any]], inputs: list[list[Any]], constant: list[Any], order: int
    ) -> list[list[Any]]:
        """Return the Taylor coefficients (n, order) of F along given Taylor coefficients of `states` and `inputs` (each
        a list of balls), with `constant` parameters."""
        balls = BallSeries(0)
        values = [balls.series(row, order) for row in (*states, *inputs, *([p] for p in constant))]
        rows = evaluate(self._tape, balls, values, order, 1)
        return [balls.coefficients(value, order) for value, _ in rows]

    @cached_property
    def _tape(self) -> Plant:
        return Plant(tape(self.flow, signals(self.form)), 0, 0, 0)

    @cached_property
    def read(self) -> Ranges:
        """The ranges, by symbol, of the states, inputs and parameters that F depends on, without constants. Raises:
        `Unbounded`."""
        names = sp.Matrix(self.flow).free_symbols
        return {x: (low, high) for x, (low, high) in self._ranges.items() if x in names and low < high}

    @cached_property
    def _ranges(self) -> Ranges:
        form, system = self.form, self.form.system
        for signal in (*form.states, *system.inputs):
            if not signal.bounded:
                raise Unbounded(because("{signal} has no range", signal=signal))
        ends = form.box
        return {x: (Fraction(low), Fraction(high)) for x, (low, high) in ends.items()}

    def balls(self, cell: Ranges) -> tuple[list[Any], list[tuple[Any, Any]], list[Any]]:
        """Return Arb's balls that hold the ranges: of the states, of the inputs in pairs with their rates, and of the
        parameters. A symbol in `cell` has the range given there."""
        form, system, ends = self.form, self.form.system, {**self._ranges, **cell}
        each = (form.states, system.inputs, system.parameters)
        states, inputs, parameters = ([between(*ends[x]) for x in group] for group in each)
        rates = [between(-most, most) for most in self.input_rates]
        return states, list(zip(inputs, rates, strict=True)), parameters

    @property
    def input_rates(self) -> tuple[Fraction, ...]:
        """The largest |u'| (m) of the inputs, 0 for one that F does not contain. Raises: `Unbounded` where one is not
        known."""
        read, input_rates = sp.Matrix(self.flow).free_symbols, list[Fraction]()
        for u, rate in zip(self.form.system.inputs, self.rates, strict=True):
            if rate is None and u in read:
                pattern = 'how fast {u} moves between samples is not known: give rates={{"{u}": ..}}, or hold it there'
                raise Unbounded(because(pattern, u=u.name))
            input_rates.append(rate if rate and u in read else _ZERO)
        return tuple(input_rates)

    def largest(self, expression: sp.Expr) -> Fraction:
        """Return sup|expression| on the ranges of states, inputs, parameters and rates of inputs. Raises:
        `Unbounded`."""
        rates = {_rate_of(u): (-most, most) for u, most in zip(self.form.system.inputs, self.input_rates, strict=True)}
        return _largest(expression, {**box(signals(self.form)), **rates})


class Unbounded(ArithmeticError):
    """The error that a quantity has no proved bound on the declared ranges; `args[0]` is the reason."""


def times(rows: Rows, sizes: Sequence[Fraction]) -> tuple[Fraction, ...]:
    """Return the matrix-vector product of the matrix `rows` (k, n) with the column `sizes` (n)."""
    return tuple(sum((x * size for x, size in zip(row, sizes, strict=True)), Fraction(0)) for row in rows)


def _rate_of(u: sp.Symbol) -> sp.Symbol:
    return sp.Symbol(f"{u}'", real=True)


def with_slack(expression: sp.Expr, most: Fraction) -> Fraction:
    """Return a number slightly above `most`, a supremum of the expression, so that less accurate arithmetic proves it
    as well: by 0.1 %, by 1e-9 for a number, unchanged for a symbol, whose range is exact."""
    return most if expression.is_Symbol else most * (SUMMED if expression.is_number else _LOOSE)


def _largest(expression: sp.Expr, where: Box) -> Fraction:
    try:
        known = bound(sp.sympify(expression), where, relative=0.005)
    except NoTape as error:
        raise Unbounded(error.reason) from error
    if not (known.defined and known.finite):
        raise Unbounded(because("{expression} has no finite range on the box", expression=expression))
    return max(abs(Fraction(known.low)), abs(Fraction(known.high)))


def steepness_in(expression: sp.Expr, p: sp.Symbol, where: Box) -> Fraction:
    """Return the supremum of |d expression/dp| on the box `where`, for an expression that does not jump. Raises:
    `Unbounded`."""
    try:
        known = lipschitz_bound((expression,), (p,), where, relative=0.005)
    except NoTape as error:
        raise Unbounded(error.reason) from error
    if known.verdict is not Verdict.PROVED:
        jumps = "{expression} may jump with {p}, or be steep without bound"
        raise Unbounded(because(jumps, expression=expression, p=p))
    return Fraction(known.high)


# inputs whose sizes a user declares
ERROR_INPUTS = ("noise", "rounded", "late", "disturbance", "parameters", "rates")


Heads = Mapping[int, tuple[int, Fraction]]  # by an output's place: the place of the state that it measures, and dy/dz


def heads_of(form: Form) -> Heads | None:
    """Return, by the index of each measured output, the pair (index of the first state z_i of its chain, dy/dz_i); None
    where a derivative dy/dz_i contains parameters."""
    known, slopes = dict(fixed_parameters(form)), dict[int, tuple[int, Any]]()
    for j, head in heads(form).items():
        row = exact(sp.sympify(form.output[j]).xreplace(known))
        slopes[j] = head, sp.cancel(sp.diff(row, form.states[head]))
    if not all(slope.is_Rational for _, slope in slopes.values()):
        return None
    return {j: (head, Fraction(slope.p, slope.q)) for j, (head, slope) in slopes.items()}


@dataclass(frozen=True)
class Sizes:
    """The largest sizes of the inputs of an error e over one step; () for an input that does not exist. `samples` (p):
    errors of the samples at both ends; `stages` (p, s): errors of an output at each stage; `deviation` (n): the
    deviation of the plant from a step of the method, over h, in units of the form's states; `fields` (N): errors of the
    program's memory, over h, in units of e."""

    samples: tuple[Fraction, ...] = ()
    stages: tuple[tuple[Fraction, ...], ...] = ()
    deviation: tuple[Fraction, ...] = ()
    fields: tuple[Fraction, ...] = ()

    @property
    def largest(self) -> Fraction:
        """The largest of all these numbers, whatever their units."""
        stages = (x for row in self.stages for x in row)
        return max((*self.samples, *stages, *self.deviation, *self.fields), default=_ZERO)

    def over(self, size: Fraction) -> "Sizes":
        """Return the sizes divided by the number `size` > 0."""
        rows = tuple(tuple(x / size for x in row) for row in self.stages)
        samples, deviation, fields = (
            tuple(x / size for x in each) for each in (self.samples, self.deviation, self.fields)
        )
        return Sizes(samples, rows, deviation, fields)

    def inputs(self, step: Inequality, error: Inclusion, scales: Sequence[Fraction], heads: Heads) -> Inputs:
        """Return the effect of all inputs of nonzero size on a `step`, each scaled by its size. `scales` (N): the
        factors of `Inclusion.scales`; `heads`: the result of `heads_of`."""
        each, lifted = list[Inputs](), error.lifted(scales)
        for output, size in enumerate(self.samples):
            each += [end * size for end in step.ends(output) if size]
        for output, row in enumerate(self.stages):
            each += [step.stages[i][output] * size for i, size in enumerate(row) if size]
        for state, size in enumerate(self.deviation):
            effect = step.additive_input(-lifted[:, state])
            for output, (head, slope) in heads.items():
                effect += step.ends(output)[1] * (step.h * slope * (head == state))
            each += [effect * size] if size else []
        one = identity(len(scales))
        each += [step.additive_input(one[k]) * size for k, size in enumerate(self.fields) if size]
        return Inputs.of(each)


@dataclass(frozen=True)
class ErrorInput:
    """The `sizes` of one cause of errors, such as noise; `follows`: the numbers from which a certificate derives these
    sizes."""

    sizes: Sizes
    follows: Evidence


@dataclass(frozen=True)
class Share:
    """The share of one cause, called `what`, in an error bound, for inputs of the `sizes`. `proofs`: by index of a
    component of e, the proved bound for inputs of the sizes over `unit`; `follows`: the declared numbers and suprema
    from which a certificate derives the sizes, {} where it does not."""

    what: str
    sizes: Sizes
    unit: Fraction
    proofs: Mapping[int, InputBound]
    follows: Evidence = field(default_factory=dict)

    def bound(self, field: int) -> Fraction:
        """Return the largest error, under these inputs, of the state to which component `field` of e belongs."""
        return self.unit * self.proofs[field].bound

    def evidence(self, form: Form) -> Evidence:
        """Return the share with its sizes and proofs, under the keys of a certificate."""
        bounds = [{"field": k + 1, "proof": one, "bound": self.bound(k)} for k, one in self.proofs.items()]
        sizes = {"samples": self.sizes.samples, "stages": self.sizes.stages, "fields": self.sizes.fields}
        known = {"inputs": self.what, "follows": self.follows, **sizes, "beside": self.sizes.deviation}
        return {**known, "unit": self.unit, "bounds": bounds}
