"""How the plant moves beside a step of an observer's method, on its ranges.

    x(t + h) = Phi_h(x) + delta,   Phi_h: a step of the method on x' = F(x, u) = A x + b, without injection

Where the plant keeps clear of the ends of its ranges by h sup|F_i|, the stages X_i, and the flow from x, do not leave
them, and no clamp acts. Then

    line          l_i = (1 - c_i) y_k + c_i C Phi_h(x) - C X_i;
                  |l_i| <= h^2 sum_j |c_i b_j - a_ij| sum_k |a_jk| sup|y''|
                  and h^3 sup|l_(i,3)|, its Taylor coefficient, where that of h^2 is 0: sum_j (c_i b_j - a_ij) c_j = 0
    remainder     |x(t + h) - Phi_h(x)| <= h^(p+1) (sup|x_(p+1)| + sup|Phi_(p+1)|), of a method of order p: Taylor
                  coefficients in time of the flow at any point, of the step at any length up to h, in Arb's balls
    disturbance   |d_i(t)| <= dbar_i of any course in x' = F + d: |delta| <= integral over h of exp(s |dF/dx|) dbar

u moves between two samples as the program takes it to: on the line, at most at its rates, or it is held.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import flint
import sympy as sp

from hgogen.algebra.balls import Balls, Undecided, between, magnitude
from hgogen.algebra.definite import number
from hgogen.algebra.points import exact
from hgogen.algebra.series import Plant, evaluate
from hgogen.algebra.tape import NoTape, tape
from hgogen.check import Verdict
from hgogen.discretisation.runge_kutta import Tableau
from hgogen.form import Form
from hgogen.intervals.bounds import bound
from hgogen.intervals.box import Box, box
from hgogen.intervals.slope import lipschitz_bound
from hgogen.sentence import because
from hgogen.structure.polytope import fixed, signals

_THIRD = 3  # order of the Taylor coefficient of a line
_SHORT = 10_000  # the largest denominator of a tableau's coefficients
_LOOSE = Fraction(1001, 1000)  # of a supremum: what is taken for it
_SUMMED = 1 + Fraction(1, 10**9)  # of a number, which another arithmetic ends elsewhere
_NONE = Fraction(0)
Rows = tuple[tuple[Fraction, ...], ...]
_UNKNOWN = Undecided, ZeroDivisionError, ValueError, NoTape  # of a series, the third where FLINT divides by a ball of 0


@dataclass(frozen=True)
class PlantStep:
    """A step of length `h` of a method on a form whose inputs move between samples at up to `rates` (m), None where
    that is not known."""

    form: Form
    tableau: Tableau
    h: Fraction
    rates: tuple[Fraction | None, ...]

    @cached_property
    def flow(self) -> tuple[sp.Expr, ...]:
        """F (n), of z, inputs and parameters, those without a range at their values."""
        rows = self.form.A * sp.Matrix(self.form.states) + sp.Matrix(self.form.b)
        return tuple(exact(sp.sympify(row).xreplace(fixed(self.form))) for row in rows)

    @cached_property
    def speeds(self) -> tuple[Fraction, ...]:
        """sup|F_i| (n). Raises: `Unbounded`."""
        return tuple(self._largest(row) for row in self.flow)

    @property
    def margins(self) -> tuple[Fraction, ...]:
        """By how much the plant keeps clear of the ends of the ranges (n). Raises: `Unbounded`."""
        return tuple(self.h * speed for speed in self.speeds)

    def line(self, output: int) -> tuple[Fraction, ...]:
        """By how much the line between two samples of an output is beside what the plant shows at each stage (s).

        Raises: `Unbounded`.
        """
        a, _, _ = self._coefficients
        bend = sum((x * most for x, most in zip(self._bent[output], (*self._fast, *self._moving), strict=True)), _NONE)
        away = [sum(map(abs, row), _NONE) for row in a]  # of a stage from the start, over h sup|F|
        shares = [sum((abs(w) * far for w, far in zip(row, away, strict=True)), _NONE) for row in self._bends]
        sizes = [self.h**2 * share * bend for share in shares]
        for i, third in zip(self._cubic, self._lines[output], strict=True):
            sizes[i] = min(sizes[i], self.h**_THIRD * third)
        return tuple(sizes)

    @cached_property
    def _bent(self) -> Rows:
        """How steep y' of each output is in the states and inputs (p, n + m)."""
        rates, names = [*map(self._shown, range(len(self.form.output)))], (*self.form.states, *self.form.system.inputs)
        slopes = ([sp.diff(rate, x) for x in names] for rate in rates)
        return tuple(tuple(_loose(each, self._largest(each)) for each in row) for row in slopes)

    @cached_property
    def _fast(self) -> tuple[Fraction, ...]:
        """sup|F_i| (n)."""
        return tuple(map(_loose, self.flow, self.speeds))

    @cached_property
    def _bends(self) -> Rows:
        """c_i b_j - a_ij (s, s)."""
        a, b, c = self._coefficients
        return tuple(tuple(at * w - x for w, x in zip(b, row, strict=True)) for at, row in zip(c, a, strict=True))

    @cached_property
    def _cubic(self) -> list[int]:
        """The stages at which a line begins with its third Taylor coefficient, as the second is 0."""
        a, _, c = self._coefficients
        if [sum(row) for row in a] != c:
            return []
        each = enumerate(self._bends)
        return [i for i, row in each if any(row) and not sum(w * at for w, at in zip(row, c, strict=True))]

    @cached_property
    def _lines(self) -> Rows:
        """The third Taylor coefficients of the lines of each output at these stages (p, ..)."""
        (_, _, c), (_, stages, end), rows = self._coefficients, self._series, list[tuple[Fraction, ...]]()
        for y in self.form.output:
            slopes = [self._largest(sp.diff(y, z)) for z in self.form.states]
            row = list[Fraction]()
            for i in self._cubic:
                at = flint.arb(number(c[i]))
                off = (magnitude(last[_THIRD] * at - one[_THIRD]) for last, one in zip(end, stages[i], strict=True))
                row.append(sum((x * most for x, most in zip(slopes, off, strict=True)), _NONE) * _SUMMED)
            rows.append(tuple(row))
        return tuple(rows)

    def shown(self, output: int) -> Fraction:
        """sup|y'| of an output. Raises: `Unbounded`."""
        rate = self._shown(output)
        return _loose(rate, self._largest(rate))

    def beside(self, output: int, most: Sequence[Fraction]) -> Fraction:
        """By how much more y' may be where the rates are beside F by at most these sizes (n). Raises: `Unbounded`."""
        y = self.form.output[output]
        by = zip(self.form.states, most, strict=True)
        return sum((self._largest(sp.diff(y, z)) * size for z, size in by if size), Fraction(0))

    def _shown(self, output: int) -> sp.Expr:
        """y', but for what the inputs in it do."""
        form, y = self.form, self.form.output[output]
        if y.free_symbols & {*form.system.inputs}:
            raise Unbounded(because("the output {y} reads an input", y=y))
        return sum((sp.diff(y, z) * row for z, row in zip(form.states, self.flow, strict=True)), sp.S(0))

    def change(self, most: Sequence[Fraction]) -> Rows:
        """sup|dT_i/dx_j| (n, n) of the form's coordinates T in the plant's states x as first declared, 0 where `most`
        (n) is.

        Raises: `Unbounded`.
        """
        system, form, plant = self.form.system, self.form, self.form.system.declared
        where = box((*plant.states, *system.inputs, *system.parameters), system.nominal)
        rows = [sp.sympify(row).xreplace(self._recast) for row in form.to_form]
        T, nothing = sp.Matrix(rows).jacobian(sp.Matrix(plant.states)), Fraction(0)
        return tuple(
            tuple(_loose(T[i, j], _largest(T[i, j], where)) if size else nothing for j, size in enumerate(most))
            for i in range(form.n)
        )

    @property
    def _recast(self) -> dict[sp.Symbol, sp.Expr]:
        """The states of the form's system in those of the plant as first declared; empty where they are the same."""
        origin = self.form.system.origin
        return dict(zip(self.form.system.states, origin.forward, strict=True)) if origin else {}

    def by_parameters(self, most: Sequence[Fraction]) -> Rows:
        """sup|dF_i/dp| (n, q) of parameters p of the plant that are beside the program's by at most these sizes (q), 0
        where `most` is.

        Raises: `Unbounded`.
        """
        form, system = self.form, self.form.system
        wrong = {p: size for p, size in zip(system.parameters, most, strict=True) if size}
        read = sp.Matrix([*form.to_form, *form.output, *self._recast.values()]).free_symbols & wrong.keys()
        if read:
            raise Unbounded(because("the coordinates or outputs read {read}", read=sorted(map(str, read))))
        where = box(signals(form), system.nominal)
        for p, (low, high) in box(tuple(wrong), system.nominal).items():
            where[p] = Fraction(low) - wrong[p], Fraction(high) + wrong[p]
        rows = form.A * sp.Matrix(form.states) + sp.Matrix(form.b)
        parameters, nothing = system.parameters, Fraction(0)
        return tuple(
            tuple(_loose(row, steepness_in(row, p, where)) if p in wrong else nothing for p in parameters)
            for row in rows
        )

    @cached_property
    def steepness(self) -> Rows:
        """sup|dF_i/dz_j| (n, n). Raises: `Unbounded`."""
        J = sp.Matrix(self.flow).jacobian(sp.Matrix(self.form.states))
        each = range(self.form.n)
        return tuple(tuple(_loose(J[i, j], self._largest(J[i, j])) for j in each) for i in each)

    def disturbed(self, most: Sequence[Fraction]) -> tuple[Fraction, ...]:
        """|delta|/h (n) of disturbances of at most these sizes (n) in the rows of F, of any course.

        Raises: `Unbounded`.
        """
        n = self.form.n
        M = [[*(x * self.h for x in row), size] for row, size in zip(self.steepness, most, strict=True)]
        whole = flint.arb_mat([[flint.arb(number(x)) for x in row] for row in [*M, [Fraction(0)] * (n + 1)]]).exp()
        return tuple(magnitude(whole[i, n]) * _SUMMED for i in range(n))

    def remainder(self) -> tuple[Fraction, ...]:
        """|x(t + h) - Phi_h(x)|/h (n) without disturbances. Raises: `Unbounded`."""
        return tuple(self.h**self.tableau.order * (x + y) for x, y in zip(*self._left, strict=True))

    @property
    def follows(self) -> dict[str, Any]:
        """Of what `line` and `remainder` follow, as a certificate has it; of tables nothing. Raises: `Unbounded`."""
        if any(step.op == "table" for step in self._tape.tape.instructions):
            return {}
        flow, step = self._left
        known = {"rates": self._moving, "speeds": self._fast, "slopes": self._bent, "lines": self._lines}
        return {**known, "flow": flow, "step": step}

    @cached_property
    def _left(self) -> tuple[tuple[Fraction, ...], tuple[Fraction, ...]]:
        """Of the flow and of the step (n), the Taylor coefficients after the last that they share."""
        last, (flow, _, step) = self.tableau.order + 1, self._series
        one, other = ([magnitude(x[last]) * _SUMMED for x in each] for each in (flow, step))
        return tuple(one), tuple(other)

    @cached_property
    def _series(self) -> tuple[list[list[Any]], list[list[list[Any]]], list[list[Any]]]:
        """Those of the flow, of the stages (s) and of the step. Raises: `Unbounded`."""
        try:
            return self._flow_series(self.tableau.order + 2), *self._step_series
        except _UNKNOWN as error:
            raise Unbounded(
                because("the method's remainder has no bound on the ranges: {flow}", flow=self.flow)
            ) from error

    def _flow_series(self, order: int) -> list[list[Any]]:
        """Taylor coefficients of the flow at any point of the ranges."""
        states, inputs = [[ball] for ball in self._balls[0]], [list(pair) for pair in self._balls[1]]
        for k in range(order - 1):
            rows = self._rates(states, inputs, k + 1)
            for row, rate in zip(states, rows, strict=True):
                row.append(rate[k] / (k + 1))
        return states

    @property
    def _step_series(self) -> tuple[list[list[list[Any]]], list[list[Any]]]:
        """Those of the stages (s) and of the step in its length, at any length up to h: as many as are read."""
        (a, b, c), (states, inputs, _) = self._coefficients, self._balls
        order = max(_THIRD + 1, self.tableau.order + 2)
        length = flint.arb_series([between(Fraction(0), self.h), flint.arb(1)], prec=order)
        slopes, stages = list[list[Any]](), list[list[list[Any]]]()

        def moved(weights: Sequence[Fraction]) -> list[Any]:
            totals = [flint.arb_series([x], prec=order) for x in states]
            for weight, slope in zip(weights, slopes, strict=False):
                totals = [
                    total + length * one * flint.arb(number(weight)) for total, one in zip(totals, slope, strict=True)
                ]
            return totals

        for row, at in zip(a, c, strict=True):
            here = [[u, rate * flint.arb(number(at))] for u, rate in inputs]
            stages.append([_padded(x.coeffs(), order) for x in moved(row)])
            rates = self._rates(stages[-1], here, order)
            slopes.append([flint.arb_series(rate, prec=order) for rate in rates])
        return stages, [_padded(x.coeffs(), order) for x in moved(b)]

    def _rates(self, states: list[list[Any]], inputs: list[list[Any]], order: int) -> list[list[Any]]:
        """F of series, below t^order."""
        balls = Balls(0)
        values = [balls.series(row, order) for row in (*states, *inputs, *([p] for p in self._balls[2]))]
        rows = evaluate(self._tape, balls, values, order, 1)
        return [balls.coefficients(value, order) for value, _ in rows]

    @cached_property
    def _tape(self) -> Plant:
        return Plant(tape(self.flow, signals(self.form)), 0, 0, 0)

    @cached_property
    def _balls(self) -> tuple[list[Any], list[tuple[Any, Any]], list[Any]]:
        """Of the states, of the inputs and their rates, and of the parameters."""
        form, system = self.form, self.form.system
        for signal in (*form.states, *system.inputs):
            if not signal.bounded:
                raise Unbounded(because("{signal} has no range", signal=signal))
        ends = box(signals(form), system.nominal)
        each = (form.states, system.inputs, system.parameters)
        states, inputs, parameters = ([between(*(Fraction(end) for end in ends[x])) for x in group] for group in each)
        rates = [between(-most, most) for most in self._moving]
        return states, list(zip(inputs, rates, strict=True)), parameters

    @property
    def _coefficients(self) -> tuple[list[list[Fraction]], list[Fraction], list[Fraction]]:
        """a, its rows as long as b, b and c as the tableau means them."""

        def exactly(values: Sequence[float]) -> list[Fraction]:
            return [Fraction(value).limit_denominator(_SHORT) for value in values]

        rows = [(*row, *[0.0] * (len(self.tableau.b) - len(row))) for row in self.tableau.a]
        return [exactly(row) for row in rows], exactly(self.tableau.b), exactly(self.tableau.c)

    @property
    def _moving(self) -> tuple[Fraction, ...]:
        """The rates of the inputs, 0 of one that the flow does not read. Raises: `Unbounded`."""
        read, moving = sp.Matrix(self.flow).free_symbols, list[Fraction]()
        for u, rate in zip(self.form.system.inputs, self.rates, strict=True):
            if rate is None and u in read:
                pattern = 'how fast {u} moves between samples is not known: give rates={{"{u}": ..}}, or hold it there'
                raise Unbounded(because(pattern, u=u.name))
            moving.append(rate if rate and u in read else _NONE)
        return tuple(moving)

    def _largest(self, expression: sp.Expr) -> Fraction:
        """The largest |expression| on the ranges. Raises: `Unbounded`."""
        return _largest(expression, box(signals(self.form)))


class Unbounded(ArithmeticError):
    """What has no bound on the ranges, `args[0]` is the reason."""


def times(rows: Rows, sizes: Sequence[Fraction]) -> tuple[Fraction, ...]:
    """The product of rows with a column."""
    return tuple(sum((x * size for x, size in zip(row, sizes, strict=True)), Fraction(0)) for row in rows)


def _loose(expression: sp.Expr, most: Fraction) -> Fraction:
    """What an expression is at most, a little larger, so that a weaker arithmetic reaches it."""
    return most if expression.is_Symbol else most * (_SUMMED if expression.is_number else _LOOSE)


def _largest(expression: sp.Expr, where: Box) -> Fraction:
    try:
        known = bound(sp.sympify(expression), where, relative=0.005)
    except NoTape as error:
        raise Unbounded(error.reason) from error
    if not (known.defined and known.finite):
        raise Unbounded(because("{expression} has no finite range on the box", expression=expression))
    return max(abs(Fraction(known.low)), abs(Fraction(known.high)))


def steepness_in(expression: sp.Expr, p: sp.Symbol, where: Box) -> Fraction:
    """The largest slope in p of an expression that does not jump. Raises: `Unbounded`."""
    try:
        known = lipschitz_bound((expression,), (p,), where, relative=0.005)
    except NoTape as error:
        raise Unbounded(error.reason) from error
    if known.verdict is not Verdict.PROVED:
        jumps = "{expression} may jump with {p}, or be steep without bound"
        raise Unbounded(because(jumps, expression=expression, p=p))
    return Fraction(known.high)


def _padded(values: list[Any], order: int) -> list[Any]:
    return [*values, *[flint.arb(0)] * (order - len(values))]
