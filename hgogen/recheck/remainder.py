"""That the sizes of what a method leaves follow from the plant, on its ranges.

    x(t + h) = Phi_h(x) + delta,   Phi_h: a step of a method of order p on x' = F(x, u), u' constant

    beside      |delta|/h <= h^p (sup|x_(p+1)| + sup|Phi_(p+1)|): Taylor coefficients of the flow at any point, of the
                step at any length up to h
    stages      |(1 - c_i) y + c_i C Phi_h(x) - C X_i| <= h^2 sum_j |c_i b_j - a_ij| sum_k |a_jk| sup|y''|, and
                h^3 sup|c_i C Phi_3 - C X_(i,3)| where sum_j (c_i b_j - a_ij) c_j = 0

where the plant keeps clear of the ends of its ranges by h sup|F|. y'' is at most how steep y' is in states and inputs,
times how fast they move. Suprema are at most what the certificate says of them, shown by bisection.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from .arithmetic import Undefined
from .box import Box, NotShown, Try, covered
from .context import Context, narrowed
from .file import part
from .interval import Interval, point
from .matrix import Matrix, column, matrix
from .plant_motion import PlantMotion, demand_keys, motion_of
from .plant_series import PlantSeries
from .slope import no_steeper
from .stages import Tableau

_KEYS = ("rates", "speeds", "slopes", "lines", "flow", "step")
_THIRD = 3  # the coefficient of a line
_MORE = 100  # boxes on which coefficients are taken
_ZERO = Fraction(0)


@dataclass(frozen=True)
class Remainder:
    """What a method leaves of a plant that moves so: bounds of the `slopes` of y' in states and inputs (p, n + m), of
    the third coefficients of the `lines` that have no second one (p, ..), and of the last ones of the flow and of the
    step (n)."""

    context: Context
    tableau: Tableau
    motion: PlantMotion
    slopes: Matrix
    lines: Matrix
    flow: list[Fraction]
    step: list[Fraction]

    @property
    def beside(self) -> list[Fraction]:
        """Of each row (n), over h."""
        return [self.motion.h**self.tableau.order * (x + y) for x, y in zip(self.flow, self.step, strict=True)]

    @property
    def stages(self) -> Matrix:
        """Of the line between the samples of each output, at each stage (p, s)."""
        return [self._line(*each) for each in zip(self.slopes, self.lines, strict=True)]

    def _line(self, slopes: list[Fraction], thirds: list[Fraction]) -> list[Fraction]:
        h, moving = self.motion.h, (*self.motion.speeds, *self.motion.rates)
        bend = sum((x * most for x, most in zip(slopes, moving, strict=True)), _ZERO)
        away = [sum(map(abs, row), _ZERO) for row in self.tableau.rows]
        shares = [sum((abs(w) * far for w, far in zip(row, away, strict=True)), _ZERO) for row in self.tableau.bends]
        sizes = [h**2 * bend * share for share in shares]
        for i, third in zip(self.tableau.cubic, thirds, strict=True):
            sizes[i] = min(sizes[i], h**_THIRD * third)
        return sizes

    def demand(self) -> int:
        """That the bounds are those of the plant; with how many boxes. Raises: `NotShown`."""
        context, box, boxes = self.context, self.context.form.box, self.motion.demand()
        names = (*context.z, *context.file.inputs)
        for j, (head, slope) in self.motion.shown.items():
            bounds = [[x / abs(slope) for x in self.slopes[j]]]
            boxes += no_steeper((context.rates[head],), names, bounds, [Fraction(1)] * len(names), box)
        return boxes + covered(narrowed(box, self.motion.read), ".", self._within, _MORE)

    def _within(self, box: Box) -> Try:
        """That coefficients are within their bounds on a box."""
        context, order, whole = self.context, self.tableau.order, self.context.form.box
        rates = dict(zip(context.file.inputs, self.motion.rates, strict=True))
        plant = PlantSeries(context.rates, context.z, rates, {**whole, **box}, whole)
        try:
            flow = [x[order + 1] for x in plant.flow(order + 2)]
            if not _all_within(zip(flow, self.flow, strict=True)):
                return Try(False)
            steps = plant.step(self.tableau, self.motion.h, max(order + 2, _THIRD + 1))
        except Undefined:
            return Try(False)
        step = [x.coefficients for x in steps[-1]]
        pairs = [(x[order + 1], most) for x, most in zip(step, self.step, strict=True)]
        for j, (head, slope) in self.motion.shown.items():
            for i, third in zip(self.tableau.cubic, self.lines[j], strict=True):
                line = point(self.tableau.nodes[i]) * step[head][_THIRD] - steps[i][head].coefficients[_THIRD]
                pairs.append((line, third / abs(slope)))
        return Try(_all_within(pairs))


def _all_within(pairs: Iterable[tuple[Interval, Fraction]]) -> bool:
    return all(x.at_least(-most) and x.at_most(most) for x, most in pairs)


def demand_remainder(
    context: Context, tableau: Tableau, h: Fraction, share: Mapping[str, Any]
) -> tuple[PlantMotion, int]:
    """How the plant moves, from which the sizes of the share follow, with how many boxes. Raises: `NotShown`."""
    follows, p, n, m = part(share, "follows", dict), len(context.form.output), len(context.z), len(context.file.inputs)
    demand_keys(follows, _KEYS)
    motion = motion_of(context, h, follows)
    slopes, lines = matrix(follows, "slopes", p, n + m), matrix(follows, "lines", p, len(tableau.cubic))
    left = Remainder(context, tableau, motion, slopes, lines, column(follows, "flow", n), column(follows, "step", n))
    stages, beside = matrix(share, "stages", p, len(tableau.nodes)), column(share, "beside", n)
    pairs = [*zip(beside, left.beside, strict=True)]
    for sizes, least in zip(stages, left.stages, strict=True):
        pairs += zip(sizes, least, strict=True)
    if any(size < least for size, least in pairs):
        raise NotShown("a size of the method is less than what it follows from")
    return motion, left.demand()
