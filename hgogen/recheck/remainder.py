"""That the sizes of what a method leaves follow from the plant, on its ranges.

    x(t + h) = Phi_h(x) + delta,   Phi_h: a step of a method of order p on x' = F(x, u), u' constant

    beside      |delta|/h <= h^p (sup|x_(p+1)| + sup|Phi_(p+1)|): Taylor coefficients of the flow at any point, of the
                step at any length up to h
    stages      |(1 - c_i) y + c_i C Phi_h(x) - C X_i| <= h^2 sum_j |c_i b_j - a_ij| sum_k |a_jk| sup|y''|, and
                h^3 sup|c_i C Phi_3 - C X_(i,3)| where sum_j (c_i b_j - a_ij) c_j = 0

where the plant keeps clear of the ends of its ranges by h sup|F|. y'' is at most how steep y' is in states and inputs,
times how fast they move. Suprema are at most what the certificate says of them, shown by bisection.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

from .arithmetic import Undefined
from .box import Box, NotShown, Try, covered, ranged
from .context import Context, narrowed, only, short
from .interval import point
from .matrix import Matrix, column, matrix
from .plant_series import PlantSeries
from .slope import no_steeper
from .stages import Tableau
from .tables import is_table

_KEYS = ("rates", "speeds", "slopes", "lines", "flow", "step")
_THIRD = 3  # the coefficient of a line
_MORE = 100  # boxes on which coefficients are taken
_ZERO = Fraction(0)


def derivable(context: Context) -> bool:
    """Whether the rows have series: of tables there are none."""
    return not any(is_table(step.op) for row in context.rates for step in row.instructions)


@dataclass(frozen=True)
class Remainder:
    """What a method leaves in a step of length `h`, of inputs that move at up to `rates` (m): bounds of sup|F| (n), of
    the `slopes` of y' in states and inputs (p, n + m), of the third coefficients of the `lines` that have no second one
    (p, ..), and of the last ones of the flow and of the step (n)."""

    context: Context
    tableau: Tableau
    h: Fraction
    rates: list[Fraction]
    speeds: list[Fraction]
    slopes: Matrix
    lines: Matrix
    flow: list[Fraction]
    step: list[Fraction]

    @property
    def beside(self) -> list[Fraction]:
        """Of each row (n), over h."""
        return [self.h**self.tableau.order * (x + y) for x, y in zip(self.flow, self.step, strict=True)]

    @property
    def stages(self) -> Matrix:
        """Of the line between the samples of each output, at each stage (p, s)."""
        return [self._line(*each) for each in zip(self.slopes, self.lines, strict=True)]

    def _line(self, slopes: list[Fraction], thirds: list[Fraction]) -> list[Fraction]:
        moving = (*self.speeds, *self.rates)
        bend = sum((x * most for x, most in zip(slopes, moving, strict=True)), _ZERO)
        away = [sum(map(abs, row), _ZERO) for row in self.tableau.rows]
        bends = self.tableau.bends
        sizes = [
            self.h**2 * bend * sum((abs(w) * far for w, far in zip(row, away, strict=True)), _ZERO) for row in bends
        ]
        for i, third in zip(self.tableau.cubic, thirds, strict=True):
            sizes[i] = min(sizes[i], self.h**_THIRD * third)
        return sizes

    def demand(self) -> int:
        """That the bounds are those of the plant; with how many boxes. Raises: `NotShown`."""
        context, box = self.context, self.context.form.box
        for j in self._shown:
            only(context.form.output[j].names & set(context.file.inputs), (), "an output")
        for u, rate in zip(context.file.inputs, self.rates, strict=True):
            if rate < 0 or (rate and u not in self.read):
                raise NotShown("one of its rates is negative, or of an input that the plant does not read")
        names, boxes = (*context.z, *context.file.inputs), 0
        for row, speed in zip(context.rates, self.speeds, strict=True):
            boxes += covered(narrowed(box, row.names), ".", ranged(row, -speed, speed))
        for j, (head, slope) in self._shown.items():
            bounds = [[x / slope for x in self.slopes[j]]]
            boxes += no_steeper((context.rates[head],), names, bounds, [Fraction(1)] * len(names), box)
        return boxes + covered(narrowed(box, self.read), ".", self._within, _MORE)

    def _within(self, box: Box) -> Try:
        """That coefficients are within their bounds on a box."""
        context, order, whole = self.context, self.tableau.order, self.context.form.box
        rates = dict(zip(context.file.inputs, self.rates, strict=True))
        plant = PlantSeries(context.rates, context.z, rates, {**whole, **box}, whole)
        try:
            flow, steps = plant.flow(order + 2), plant.step(self.tableau, self.h, max(order + 2, _THIRD + 1))
        except Undefined:
            return Try(False)
        step = [x.coefficients for x in steps[-1]]
        pairs = [(x[order + 1], most) for x, most in zip(flow, self.flow, strict=True)]
        pairs += [(x[order + 1], most) for x, most in zip(step, self.step, strict=True)]
        for j, (head, slope) in self._shown.items():
            for i, third in zip(self.tableau.cubic, self.lines[j], strict=True):
                line = point(self.tableau.nodes[i]) * step[head][_THIRD] - steps[i][head].coefficients[_THIRD]
                pairs.append((line, third / slope))
        return Try(all(x.at_least(-most) and x.at_most(most) for x, most in pairs))

    @cached_property
    def read(self) -> frozenset[str]:
        """The names that the rows read."""
        return frozenset(name for row in self.context.rates for name in row.names)

    @cached_property
    def _shown(self) -> dict[int, tuple[int, Fraction]]:
        """By output, the place of the state that it shows, and |dy/dz|; without those that show none, which are not
        injected. Raises: `NotShown`."""
        shown = dict[int, tuple[int, Fraction]]()
        for j, z in ((j, z) for j, z in enumerate(self.context.seen) if z):
            slope = self.context.first_gain(j).number
            if not slope:
                raise NotShown("the slope of an output is no number")
            shown[j] = self.context.z.index(z), abs(slope)
        return shown

    @property
    def said(self) -> str:
        """What it is, and how fast inputs move, in words."""
        each = zip(self.context.file.inputs, self.rates, strict=True)
        moving = [f"{u} moves at up to {short(rate, -1)}" for u, rate in each if u in self.read]
        return f"what the method leaves{' as ' if moving else ''}{', '.join(moving)}"

    @property
    def clear(self) -> str:
        """By how much the plant keeps clear of the ends of its ranges, in words."""
        each = zip(self.context.z, self.speeds, strict=True)
        return ", ".join(f"{short(self.h * speed, 1)} in {z}" for z, speed in each)


def demand_remainder(
    context: Context, tableau: Tableau, h: Fraction, share: Mapping[str, Any]
) -> tuple[Remainder, int]:
    """What the sizes of the share follow from, with how many boxes. Raises: `NotShown`."""
    follows, p, n, m = share["follows"], len(context.form.output), len(context.z), len(context.file.inputs)
    if set(follows) != {*_KEYS}:
        raise NotShown(f"the sizes of the method do not follow from {', '.join(_KEYS)}")
    rates, speeds = column(follows, "rates", m), column(follows, "speeds", n)
    slopes, lines = matrix(follows, "slopes", p, n + m), matrix(follows, "lines", p, len(tableau.cubic))
    flow, step = column(follows, "flow", n), column(follows, "step", n)
    left = Remainder(context, tableau, h, rates, speeds, slopes, lines, flow, step)
    boxes = left.demand()
    stages, beside = matrix(share, "stages", p, len(tableau.nodes)), column(share, "beside", n)
    pairs = [*zip(beside, left.beside, strict=True)]
    for sizes, least in zip(stages, left.stages, strict=True):
        pairs += zip(sizes, least, strict=True)
    if any(size < least for size, least in pairs):
        raise NotShown("a size of the method is less than what it follows from")
    return left, boxes
