"""What a plant does beside a step of an explicit Runge-Kutta method, on its ranges.

    x(t + h) = Phi_h(x) + delta,   Phi_h: a step of the method on x' = F(x, u) = A x + b, without injection

Where the plant keeps clear of the ends of its ranges by h sup|F_i|, the stages X_i, and the flow from x, do not leave
them, and no clamp acts. Then

    line          l_i = (1 - c_i) y_k + c_i C Phi_h(x) - C X_i;
                  |l_i| <= h^2 sum_j |c_i b_j - a_ij| sum_k |a_jk| sup|y''|
                  and h^3 sup|l_(i,3)|, its Taylor coefficient, where that of h^2 is 0: sum_j (c_i b_j - a_ij) c_j = 0
    remainder     |x(t + h) - Phi_h(x)| <= h^(q+1) (sup|x_(q+1)| + sup|Phi_(q+1)|) for each q from 1 to p, of a method
                  of order p: Taylor coefficients in time of the flow at any point, of the step at any length up to h,
                  in Arb's balls on cells of the ranges; where that is more, or there is none, as of a flow that is
                  Lipschitz (`lipschitz_step`). Of a row it is the least
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, partial
from typing import Any

import flint
import sympy as sp

from hgogen.analysis.spare import heads
from hgogen.discretisation.runge_kutta import Tableau
from hgogen.prove import lipschitz_step
from hgogen.prove.entering import Entering, Sizes
from hgogen.prove.plant_step import SUMMED, UNKNOWN, PlantStep, Rows, Unbounded, times
from hgogen.rigor.balls import between, magnitude
from hgogen.rigor.bisection import Ranges, Subdivision, subdivided
from hgogen.rigor.definite import number
from hgogen.sentence import because

_SECOND, _THIRD = 2, 3  # order of the Taylor coefficient of a line
_SHORT = 10_000  # the largest denominator of a tableau's coefficients
_NONE = Fraction(0)
_LITTLE = Fraction(1, 1000)  # of how fast the plant moves: what is left is not looked into further
_NO_REMAINDER = "the method's remainder has no bound on the ranges: {flow}"


@dataclass(frozen=True)
class BesideStages:
    """The plant's step beside that of a tableau."""

    plant: PlantStep
    tableau: Tableau

    @property
    def entering(self) -> Entering:
        """What enters the error of it, and of what that follows. Raises: `Unbounded`."""
        outputs, still = range(len(self.plant.form.output)), (Fraction(0),) * len(self.tableau.b)
        stages = tuple(self.line(output) if output in self._used else still for output in outputs)
        sizes, cells, rows = Sizes(stages=stages, beside=self.remainder()), self._cells, self._rows
        orders = [row.order for row in rows]
        follows = {
            "rates": self.plant.moving,
            "speeds": self.plant.stated_speeds,
            "slopes": self._bent,
            "lines": self._lines,
            "orders": orders,
            "flow": [row.flow for row in rows],
            "step": [row.step for row in rows],
            "steepness": [] if all(orders) else self._steepness,
            "tree": cells.tree if cells else ".",
        }
        return Entering(sizes, follows)

    def line(self, output: int) -> tuple[Fraction, ...]:
        """By how much the line between two samples of an output is beside what the plant shows at each stage (s).
        Raises: `Unbounded`."""
        (a, _, _), moving = self._coefficients, (*self.plant.stated_speeds, *self.plant.moving)
        bend = sum((x * most for x, most in zip(self._bent[output], moving, strict=True)), _NONE)
        away = [sum(map(abs, row), _NONE) for row in a]  # of a stage from the start, over h sup|F|
        shares = [sum((abs(w) * far for w, far in zip(row, away, strict=True)), _NONE) for row in self._bends]
        sizes = [self.plant.h**2 * share * bend for share in shares]
        for i, third in zip(self._cubic, self._lines[output], strict=False):
            sizes[i] = min(sizes[i], self.plant.h**_THIRD * third)
        return tuple(sizes)

    def remainder(self) -> tuple[Fraction, ...]:
        """|x(t + h) - Phi_h(x)|/h (n) without disturbances. Raises: `Unbounded`."""
        return tuple(row.size for row in self._rows)

    @cached_property
    def _rows(self) -> tuple["Row", ...]:
        """What is left in each row of the form, by the order that says least of it (n). Raises: `Unbounded`."""
        known, plant = self._known, self.plant
        rows = [known.rows(plant.h)] if known else []
        if not known or known.weight(plant.h, self._little) > 1:
            linear, moving = [*map(_linear, plant.flow)], (*plant.stated_speeds, *plant.moving)
            sizes = lipschitz_step.left(plant.h, *self._coefficients, self._steepness, moving, linear)
            if sizes is None:
                raise Unbounded(because(_NO_REMAINDER, flow=plant.flow))
            rows += [tuple(Row(0, _NONE, _NONE, size) for size in sizes)]
        return tuple(min(each, key=lambda row: row.size) for each in zip(*rows, strict=True))

    @cached_property
    def _steepness(self) -> Rows:
        return self.plant.steep(self.plant.flow)

    @cached_property
    def _bent(self) -> Rows:
        """How steep y' of each output is in the states and inputs (p, n + m)."""
        plant, outputs = self.plant, range(len(self.plant.form.output))
        return plant.steep(plant.rate(output) if output in self._used else sp.S(0) for output in outputs)

    @property
    def _used(self) -> Mapping[int, int]:
        """The outputs that are injected."""
        return heads(self.plant.form)

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
        """The third Taylor coefficients of the lines of each output at these stages (p, ..); without those where the
        plant has no series."""
        known, rows = self._known, list[tuple[Fraction, ...]]()
        for output, y in enumerate(self.plant.form.output):
            shown = y if output in self._used else sp.S(0)
            slopes = [self.plant.largest(sp.diff(shown, z)) for z in self.plant.form.states]
            rows.append(tuple(off * SUMMED for off in times(known.lines, slopes)) if known else ())
        return tuple(rows)

    @cached_property
    def _known(self) -> "Coefficients | None":
        """The largest of all cells, None where one has no series."""
        return Coefficients.largest(self._cells.cells) if self._cells else None

    @cached_property
    def _cells(self) -> "Subdivision[Coefficients] | None":
        """The ranges in cells, cut until what is left is little beside how fast it moves. Raises: `Unbounded`."""
        weight = partial(Coefficients.weight, h=self.plant.h, little=self._little)
        return subdivided(self.plant.read, self._on, weight)

    @cached_property
    def _little(self) -> tuple[Fraction, ...]:
        return tuple(_LITTLE * speed for speed in self.plant.stated_speeds)

    def _on(self, cell: Ranges) -> "Coefficients | None":
        """Those on a cell."""
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
        """Those of the stages (s) and of the step in its length, at any length up to h: as many as are read."""
        (a, b, c), (states, inputs, constant) = self._coefficients, self.plant.balls(cell)
        order = max(_THIRD + 1, self.tableau.order + 2)
        length = flint.arb_series([between(Fraction(0), self.plant.h), flint.arb(1)], prec=order)
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
            rates = self.plant.rates_of(stages[-1], here, constant, order)
            slopes.append([flint.arb_series(rate, prec=order) for rate in rates])
        return stages, [_padded(x.coeffs(), order) for x in moved(b)]

    @property
    def _coefficients(self) -> tuple[list[list[Fraction]], list[Fraction], list[Fraction]]:
        """a, its rows as long as b, b and c as the tableau means them."""

        def exactly(values: Sequence[float]) -> list[Fraction]:
            return [Fraction(value).limit_denominator(_SHORT) for value in values]

        rows = [(*row, *[0.0] * (len(self.tableau.b) - len(row))) for row in self.tableau.a]
        return [exactly(row) for row in rows], exactly(self.tableau.b), exactly(self.tableau.c)


@dataclass(frozen=True)
class Row:
    """What is left in a row over h, by an `order`: of coefficients of the `flow` and of the `step`, none of 0."""

    order: int
    flow: Fraction
    step: Fraction
    size: Fraction


@dataclass(frozen=True)
class Coefficients:
    """Sizes of Taylor coefficients, from the second on those of the `flow` and of the `step` (.., n), and the third
    ones of the `lines` by which stages are beside them (.., n)."""

    flow: Rows
    step: Rows
    lines: Rows

    @classmethod
    def largest(cls, each: Sequence["Coefficients"]) -> "Coefficients":
        """The largest of several."""
        kinds = zip(*((one.flow, one.step, one.lines) for one in each), strict=True)
        grouped = (zip(*kind, strict=True) for kind in kinds)
        return cls(*(tuple(tuple(map(max, zip(*rows, strict=True))) for rows in kind) for kind in grouped))

    def rows(self, h: Fraction) -> tuple[Row, ...]:
        """What they leave in each row, by the best of their orders (n)."""
        each = enumerate(zip(self.flow, self.step, strict=True), 1)
        orders = [[Row(q, x, y, h**q * (x + y)) for x, y in zip(*pair, strict=True)] for q, pair in each]
        return tuple(min(row, key=lambda one: one.size) for row in zip(*orders, strict=True))

    def weight(self, h: Fraction, little: Sequence[Fraction]) -> float:
        """How many times more than little that is (n), of all rows the most."""
        pairs = zip(self.rows(h), little, strict=True)
        return max((float(row.size / most) if most else math.inf for row, most in pairs if row.size), default=0.0)


def _linear(row: sp.Expr) -> bool:
    """Whether a row is a sum of names, each times a number."""
    return all(term.is_number or term.as_coeff_Mul()[1].is_Symbol for term in sp.Add.make_args(row))


def _padded(values: list[Any], order: int) -> list[Any]:
    return [*values, *[flint.arb(0)] * (order - len(values))]
