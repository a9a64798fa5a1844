"""What a plant does beside a step of an explicit Runge-Kutta method, on its ranges.

    x(t + h) = Phi_h(x) + delta,   Phi_h: a step of the method on x' = F(x, u) = A x + b, without injection

Where the plant keeps clear of the ends of its ranges by h sup|F_i|, the stages X_i, and the flow from x, do not leave
them, and no clamp acts. Then

    line          l_i = (1 - c_i) y_k + c_i C Phi_h(x) - C X_i;
                  |l_i| <= h^2 sum_j |c_i b_j - a_ij| sum_k |a_jk| sup|y''|
                  and h^3 sup|l_(i,3)|, its Taylor coefficient, where that of h^2 is 0: sum_j (c_i b_j - a_ij) c_j = 0
    remainder     |x(t + h) - Phi_h(x)| <= h^(p+1) (sup|x_(p+1)| + sup|Phi_(p+1)|), of a method of order p: Taylor
                  coefficients in time of the flow at any point, of the step at any length up to h, in Arb's balls
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import flint
import sympy as sp

from hgogen.algebra.balls import between, magnitude
from hgogen.algebra.definite import number
from hgogen.discretisation.runge_kutta import Tableau
from hgogen.guarantees.entering import Entering, Sizes
from hgogen.guarantees.plant_step import SUMMED, UNKNOWN, PlantStep, Rows, Unbounded, loose
from hgogen.sentence import because
from hgogen.structure.spare import heads

_THIRD = 3  # order of the Taylor coefficient of a line
_SHORT = 10_000  # the largest denominator of a tableau's coefficients
_NONE = Fraction(0)


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
        return Entering(Sizes(stages=stages, beside=self.remainder()), self._follows)

    def line(self, output: int) -> tuple[Fraction, ...]:
        """By how much the line between two samples of an output is beside what the plant shows at each stage (s).

        Raises: `Unbounded`.
        """
        (a, _, _), moving = self._coefficients, (*self.plant.stated_speeds, *self.plant.moving)
        bend = sum((x * most for x, most in zip(self._bent[output], moving, strict=True)), _NONE)
        away = [sum(map(abs, row), _NONE) for row in a]  # of a stage from the start, over h sup|F|
        shares = [sum((abs(w) * far for w, far in zip(row, away, strict=True)), _NONE) for row in self._bends]
        sizes = [self.plant.h**2 * share * bend for share in shares]
        for i, third in zip(self._cubic, self._lines[output], strict=True):
            sizes[i] = min(sizes[i], self.plant.h**_THIRD * third)
        return tuple(sizes)

    def remainder(self) -> tuple[Fraction, ...]:
        """|x(t + h) - Phi_h(x)|/h (n) without disturbances. Raises: `Unbounded`."""
        return tuple(self.plant.h**self.tableau.order * (x + y) for x, y in zip(*self._left, strict=True))

    @property
    def _follows(self) -> dict[str, Any]:
        flow, step = self._left
        known = {
            "rates": self.plant.moving,
            "speeds": self.plant.stated_speeds,
            "slopes": self._bent,
            "lines": self._lines,
        }
        return {**known, "flow": flow, "step": step}

    @cached_property
    def _bent(self) -> Rows:
        """How steep y' of each output is in the states and inputs (p, n + m)."""
        form, plant = self.plant.form, self.plant
        rates = [plant.rate(output) if output in self._used else sp.S(0) for output in range(len(form.output))]
        names = (*form.states, *form.system.inputs)
        slopes = ([sp.diff(rate, x) for x in names] for rate in rates)
        return tuple(tuple(loose(each, plant.largest(each)) for each in row) for row in slopes)

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
        """The third Taylor coefficients of the lines of each output at these stages (p, ..)."""
        (_, _, c), (_, stages, end), rows = self._coefficients, self._series, list[tuple[Fraction, ...]]()
        for output, y in enumerate(self.plant.form.output):
            shown = y if output in self._used else sp.S(0)
            slopes = [self.plant.largest(sp.diff(shown, z)) for z in self.plant.form.states]
            row = list[Fraction]()
            for i in self._cubic:
                at = flint.arb(number(c[i]))
                off = (magnitude(last[_THIRD] * at - one[_THIRD]) for last, one in zip(end, stages[i], strict=True))
                row.append(sum((x * most for x, most in zip(slopes, off, strict=True)), _NONE) * SUMMED)
            rows.append(tuple(row))
        return tuple(rows)

    @cached_property
    def _left(self) -> tuple[tuple[Fraction, ...], tuple[Fraction, ...]]:
        """Of the flow and of the step (n), the Taylor coefficients after the last that they share."""
        last, (flow, _, step) = self.tableau.order + 1, self._series
        one, other = ([magnitude(x[last]) * SUMMED for x in each] for each in (flow, step))
        return tuple(one), tuple(other)

    @cached_property
    def _series(self) -> tuple[list[list[Any]], list[list[list[Any]]], list[list[Any]]]:
        """Those of the flow, of the stages (s) and of the step. Raises: `Unbounded`."""
        try:
            return self.plant.series(self.tableau.order + 2), *self._step_series
        except UNKNOWN as error:
            raise Unbounded(
                because("the method's remainder has no bound on the ranges: {flow}", flow=self.plant.flow)
            ) from error

    @property
    def _step_series(self) -> tuple[list[list[list[Any]]], list[list[Any]]]:
        """Those of the stages (s) and of the step in its length, at any length up to h: as many as are read."""
        (a, b, c), (states, inputs, _) = self._coefficients, self.plant.balls
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
            rates = self.plant.rates_of(stages[-1], here, order)
            slopes.append([flint.arb_series(rate, prec=order) for rate in rates])
        return stages, [_padded(x.coeffs(), order) for x in moved(b)]

    @property
    def _coefficients(self) -> tuple[list[list[Fraction]], list[Fraction], list[Fraction]]:
        """a, its rows as long as b, b and c as the tableau means them."""

        def exactly(values: Sequence[float]) -> list[Fraction]:
            return [Fraction(value).limit_denominator(_SHORT) for value in values]

        rows = [(*row, *[0.0] * (len(self.tableau.b) - len(row))) for row in self.tableau.a]
        return [exactly(row) for row in rows], exactly(self.tableau.b), exactly(self.tableau.c)


def _padded(values: list[Any], order: int) -> list[Any]:
    return [*values, *[flint.arb(0)] * (order - len(values))]
