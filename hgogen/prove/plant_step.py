"""The plant over one step, on its declared ranges: its speed, the effect of disturbances, its Taylor series.

    disturbance   |d_i(t)| <= dbar_i of any course in x' = F + d: |delta| <= integral over h of exp(s |dF/dx|) dbar

F = A x + b in the form's states. Between two samples u moves as the program assumes: linearly, at most at its rates, or
it is constant. While the plant keeps clear of the ends of its ranges by h sup|F_i|, neither it nor the flow without
disturbances leaves them within a step. `method_error` bounds the local error of a method.

The inputs of the error of a step, and their largest sizes (`Sizes`):

samples     an error of an output's samples at both ends of a call, independent of each other, with the line between
stages      an error of the injection at a stage deviation   the deviation of the plant from a step of the method in a
row of its form, over h; the sample at the end of
            the call contains it
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
from hgogen.analysis.ranges import fixed, signals
from hgogen.analysis.scaling import heads
from hgogen.check import Verdict
from hgogen.form import Form
from hgogen.prove.inclusion import Inclusion
from hgogen.prove.inequality import Inequality, Inputs
from hgogen.prove.quadratic import identity, rational
from hgogen.prove.questions import InputBound
from hgogen.rigor.bounds import bound
from hgogen.rigor.box import Box, box, exact
from hgogen.rigor.definite import number
from hgogen.rigor.search import Ranges
from hgogen.rigor.series import Balls, Plant, Undecided, between, evaluate, magnitude
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
    """A step of length `h` of a form whose inputs move between samples at up to `rates` (m), None if unknown."""

    form: Form
    h: Fraction
    rates: tuple[Fraction | None, ...]

    @cached_property
    def flow(self) -> tuple[sp.Expr, ...]:
        """The flow F (n) in z, inputs and parameters, with parameters without a range at their values."""
        return self._fixed(self.form.A * sp.Matrix(self.form.states) + sp.Matrix(self.form.b))

    @property
    def nonlinear_part(self) -> tuple[sp.Expr, ...]:
        """The b (n) of the form in the same symbols."""
        return self._fixed(self.form.b)

    def _fixed(self, rows: Iterable[sp.Expr]) -> tuple[sp.Expr, ...]:
        return tuple(exact(sp.sympify(row).xreplace(fixed(self.form))) for row in rows)

    @cached_property
    def speeds(self) -> tuple[Fraction, ...]:
        """The suprema sup|F_i| (n). Raises: `Unbounded`."""
        return tuple(self.largest(row) for row in self.flow)

    @cached_property
    def stated_speeds(self) -> tuple[Fraction, ...]:
        """The speeds as a certificate has them, a little larger where they are no numbers of the plant's."""
        return tuple(map(loose, self.flow, self.speeds))

    @property
    def margins(self) -> tuple[Fraction, ...]:
        """The distance by which the plant keeps clear of the ends of the ranges (n). Raises: `Unbounded`."""
        return tuple(self.h * speed for speed in self.speeds)

    def output_rate(self, output: int) -> Fraction:
        """Return sup|y'| of an output. Raises: `Unbounded`."""
        rate = self.rate(output)
        return loose(rate, self.largest(rate))

    def output_rate_deviation(self, output: int, most: Sequence[Fraction]) -> Fraction:
        """Return the largest change of y' if the rates of the states change by at most `most` (n). Raises:
        `Unbounded`."""
        y = self.form.output[output]
        by = zip(self.form.states, most, strict=True)
        return sum((self.largest(sp.diff(y, z)) * size for z, size in by if size), Fraction(0))

    def rate(self, output: int) -> sp.Expr:
        """Return y' of an output that reads no input. Raises: `Unbounded`."""
        form, y = self.form, self.form.output[output]
        self.demand_no_input(y)
        return sum((sp.diff(y, z) * row for z, row in zip(form.states, self.flow, strict=True)), sp.S(0))

    def demand_no_input(self, y: sp.Expr) -> None:
        """Demand that an output reads no input. Raises: `Unbounded`."""
        if y.free_symbols & {*self.form.system.inputs}:
            raise Unbounded(because("the output {y} reads an input", y=y))

    def along(self, expression: sp.Expr) -> sp.Expr:
        """Return the time derivative of an expression of states and inputs."""
        inputs = self.form.system.inputs
        by = zip((*self.form.states, *inputs), (*self.flow, *map(_rate_of, inputs)), strict=True)
        return sum((sp.diff(expression, x) * rate for x, rate in by), sp.S(0))

    def change(self, most: Sequence[Fraction]) -> Rows:
        """Return sup|dT_i/dx_j| (n, n) of the form's coordinates T in the plant's states x as first declared, 0 where
        `most` (n) is. Raises: `Unbounded`."""
        system, form, plant = self.form.system, self.form, self.form.system.declared
        where = system.box_with(plant.states)
        rows = [sp.sympify(row).xreplace(self._recast) for row in form.to_form]
        T, nothing = sp.Matrix(rows).jacobian(sp.Matrix(plant.states)), Fraction(0)
        return tuple(
            tuple(loose(T[i, j], _largest(T[i, j], where)) if size else nothing for j, size in enumerate(most))
            for i in range(form.n)
        )

    @property
    def _recast(self) -> dict[sp.Symbol, sp.Expr]:
        """The states of the form's system in those of the plant as first declared; empty where they are the same."""
        origin = self.form.system.origin
        return dict(zip(self.form.system.states, origin.forward, strict=True)) if origin else {}

    def by_parameters(self, most: Sequence[Fraction]) -> Rows:
        """Return sup|dF_i/dp| (n, q) of the plant's parameters p, which differ from the program's by at most `most`
        (q), 0 where `most` is. Raises: `Unbounded`."""
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
            tuple(loose(row, steepness_in(row, p, where)) if p in wrong else nothing for p in parameters)
            for row in rows
        )

    @cached_property
    def steepness(self) -> Rows:
        """The suprema sup|dF_i/dz_j| (n, n). Raises: `Unbounded`."""
        return tuple(tuple(self.steepest(row, z) for z in self.form.states) for row in self.flow)

    def steep(self, rows: Iterable[sp.Expr]) -> Rows:
        """Return the Lipschitz constants of rows in the states and the inputs (.., n + m). Raises: `Unbounded`."""
        names = (*self.form.states, *self.form.system.inputs)
        return tuple(tuple(self.steepest(row, x) for x in names) for row in rows)

    def steepest(self, row: sp.Expr, x: sp.Symbol) -> Fraction:
        """Return sup|drow/dx|, at a kink from each side. Raises: `Unbounded` for a row that jumps."""
        if not row.has(*JUMPS, *KINKS):
            slope = sp.diff(row, x)
            with suppress(Unbounded):
                return loose(slope, self.largest(slope))
        return loose(row, steepness_in(row, x, self.form.box))

    def disturbed(self, most: Sequence[Fraction]) -> tuple[Fraction, ...]:
        """Return |delta|/h (n) for disturbances in F of any course, of at most these sizes (n). Raises: `Unbounded`."""
        n = self.form.n
        M = [[*(x * self.h for x in row), size] for row, size in zip(self.steepness, most, strict=True)]
        whole = flint.arb_mat([[flint.arb(number(x)) for x in row] for row in [*M, [Fraction(0)] * (n + 1)]]).exp()
        return tuple(magnitude(whole[i, n]) * SUMMED for i in range(n))

    def series(self, order: int, cell: Ranges) -> list[list[Any]]:
        """Return the Taylor coefficients of the flow at any point of a cell."""
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
        """Return F of series, below t^order."""
        balls = Balls(0)
        values = [balls.series(row, order) for row in (*states, *inputs, *([p] for p in constant))]
        rows = evaluate(self._tape, balls, values, order, 1)
        return [balls.coefficients(value, order) for value, _ in rows]

    @cached_property
    def _tape(self) -> Plant:
        return Plant(tape(self.flow, signals(self.form)), 0, 0, 0)

    @cached_property
    def read(self) -> Ranges:
        """The ranges of the symbols that the flow reads, without constants. Raises: `Unbounded`."""
        names = sp.Matrix(self.flow).free_symbols
        return {x: (low, high) for x, (low, high) in self._ranges.items() if x in names and low < high}

    @cached_property
    def _ranges(self) -> Ranges:
        """The ranges of states, inputs and parameters. Raises: `Unbounded`."""
        form, system = self.form, self.form.system
        for signal in (*form.states, *system.inputs):
            if not signal.bounded:
                raise Unbounded(because("{signal} has no range", signal=signal))
        ends = form.box
        return {x: (Fraction(low), Fraction(high)) for x, (low, high) in ends.items()}

    def balls(self, cell: Ranges) -> tuple[list[Any], list[tuple[Any, Any]], list[Any]]:
        """Return the balls of states, of inputs with their rates, and of parameters; those in `cell` have its
        ranges."""
        form, system, ends = self.form, self.form.system, {**self._ranges, **cell}
        each = (form.states, system.inputs, system.parameters)
        states, inputs, parameters = ([between(*ends[x]) for x in group] for group in each)
        rates = [between(-most, most) for most in self.input_rates]
        return states, list(zip(inputs, rates, strict=True)), parameters

    @property
    def input_rates(self) -> tuple[Fraction, ...]:
        """The rates of the inputs, 0 for an input that the flow does not read. Raises: `Unbounded`."""
        read, input_rates = sp.Matrix(self.flow).free_symbols, list[Fraction]()
        for u, rate in zip(self.form.system.inputs, self.rates, strict=True):
            if rate is None and u in read:
                pattern = 'how fast {u} moves between samples is not known: give rates={{"{u}": ..}}, or hold it there'
                raise Unbounded(because(pattern, u=u.name))
            input_rates.append(rate if rate and u in read else _ZERO)
        return tuple(input_rates)

    def largest(self, expression: sp.Expr) -> Fraction:
        """Return the largest |expression| on the ranges; it may hold rates of inputs. Raises: `Unbounded`."""
        rates = {_rate_of(u): (-most, most) for u, most in zip(self.form.system.inputs, self.input_rates, strict=True)}
        return _largest(expression, {**box(signals(self.form)), **rates})


class Unbounded(ArithmeticError):
    """A quantity without a proved bound on the ranges; `args[0]` is the reason."""


def times(rows: Rows, sizes: Sequence[Fraction]) -> tuple[Fraction, ...]:
    """Return the product of rows with a column."""
    return tuple(sum((x * size for x, size in zip(row, sizes, strict=True)), Fraction(0)) for row in rows)


def _rate_of(u: sp.Symbol) -> sp.Symbol:
    """Return the symbol of the rate of an input, a name that no signal has."""
    return sp.Symbol(f"{u}'", real=True)


def loose(expression: sp.Expr, most: Fraction) -> Fraction:
    """Return the supremum of an expression, a little larger, so that a weaker arithmetic also proves it."""
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
    """Return the largest slope in p of an expression that does not jump. Raises: `Unbounded`."""
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
    """Return the first states of chains by the outputs that measure them; None where a slope is no number."""
    known, slopes = dict(fixed(form)), dict[int, tuple[int, Any]]()
    for j, head in heads(form).items():
        row = exact(sp.sympify(form.output[j]).xreplace(known))
        slopes[j] = head, sp.cancel(sp.diff(row, form.states[head]))
    if not all(slope.is_Rational for _, slope in slopes.values()):
        return None
    return {j: (head, Fraction(slope.p, slope.q)) for j, (head, slope) in slopes.items()}


@dataclass(frozen=True)
class Sizes:
    """The sizes of the inputs: `samples` (p), `stages` (p, s), `deviation` (n) in units of the form's states, `fields`
    (N) in units of e; empty for none."""

    samples: tuple[Fraction, ...] = ()
    stages: tuple[tuple[Fraction, ...], ...] = ()
    deviation: tuple[Fraction, ...] = ()
    fields: tuple[Fraction, ...] = ()

    @property
    def largest(self) -> Fraction:
        """The largest size, whatever its unit."""
        stages = (x for row in self.stages for x in row)
        return max((*self.samples, *stages, *self.deviation, *self.fields), default=_ZERO)

    def over(self, size: Fraction) -> "Sizes":
        """Return the sizes in units of a size > 0."""
        rows = tuple(tuple(x / size for x in row) for row in self.stages)
        samples, deviation, fields = (
            tuple(x / size for x in each) for each in (self.samples, self.deviation, self.fields)
        )
        return Sizes(samples, rows, deviation, fields)

    def inputs(self, step: Inequality, error: Inclusion, scales: Sequence[Fraction], heads: Heads) -> Inputs:
        """Return the inputs of a step that are not 0; `scales` (N) as `Inclusion.scales` gives them."""
        each = list[Inputs]()
        for output, size in enumerate(self.samples):
            each += [end * size for end in step.ends(output) if size]
        for output, row in enumerate(self.stages):
            each += [step.stages[i][output] * size for i, size in enumerate(row) if size]
        for state, size in enumerate(self.deviation):
            fields = zip(scales, error.layout.index, error.layout.fed, strict=True)
            effect = step.additive_input(rational([-scale * (fed and i == state) for scale, i, fed in fields]))
            for output, (head, slope) in heads.items():
                effect += step.ends(output)[1] * (step.h * slope * (head == state))
            each += [effect * size] if size else []
        one = identity(len(scales))
        each += [step.additive_input(one[k]) * size for k, size in enumerate(self.fields) if size]
        return Inputs.of(each)


@dataclass(frozen=True)
class ErrorInput:
    """The `sizes` of inputs, and the facts from which they follow, as a certificate has them."""

    sizes: Sizes
    follows: Evidence


@dataclass(frozen=True)
class Share:
    """The effect `what` of inputs of these `sizes`, by the `proofs` for their sizes over `unit`, by field. `follows`:
    the declared numbers and suprema from which the sizes follow; empty where these are not written."""

    what: str
    sizes: Sizes
    unit: Fraction
    proofs: Mapping[int, InputBound]
    follows: Evidence = field(default_factory=dict)

    def bound(self, field: int) -> Fraction:
        """Return the largest error of a field under these inputs."""
        return self.unit * self.proofs[field].bound

    @property
    def written(self) -> Evidence:
        """The share as a certificate has it."""
        bounds = [{"field": k + 1, **one.written, "bound": self.bound(k)} for k, one in self.proofs.items()]
        sizes = {"samples": self.sizes.samples, "stages": self.sizes.stages, "fields": self.sizes.fields}
        known = {"inputs": self.what, "follows": self.follows, **sizes, "beside": self.sizes.deviation}
        return {**known, "unit": self.unit, "bounds": bounds}
