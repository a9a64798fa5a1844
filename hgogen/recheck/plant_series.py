"""Taylor coefficients in time of a plant's flow, and of a step of a method in its length, on a box.

    x' = F(x, u), u' constant;   X_i = x + s sum_j a_ij k_j,   k_i = F(X_i, u + c_i s u'),   Phi_s = x + s sum_i b_i k_i

in intervals that hold those of every point of the box, and of every length s from 0 to h. At a stage an input may have
left the box, but not its range.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

from .arithmetic import evaluate
from .box import Box, sides
from .inequality import Tableau
from .interval import Interval, between, intersection, point
from .taylor import Taylor, taylor
from .text import Expression

Series = Sequence[Interval]
_ONE = Fraction(1)


@dataclass(frozen=True)
class PlantSeries:
    """The series of the rows F by the names of the states (n); `rates`: at most how fast an input moves, by its name,
    within its range in `whole`; a name of the box that is neither is constant."""

    rows: Sequence[Expression]
    states: Sequence[str]
    rates: Mapping[str, Fraction]
    box: Box
    whole: Box

    def flow(self, order: int) -> list[list[Interval]]:
        """Those of the flow (n) below s^order. Raises: `Undefined`."""
        ranges, inputs = sides(self.box), self._inputs(_ONE, Fraction(0))
        x = [[ranges[name]] for name in self.states]
        for k in range(order - 1):
            over = point(Fraction(1, k + 1))
            for series, rate in zip(x, self._rates(x, inputs, k + 1), strict=True):
                series.append(rate.coefficients[k] * over)
        return x

    def step(self, tableau: Tableau, h: Fraction, order: int) -> list[list[Taylor]]:
        """Those of the stages (s, n), and last of the step, below s^order. Raises: `Undefined`."""
        arithmetic, ranges, slopes, stages = taylor(order), sides(self.box), list[list[Taylor]](), list[list[Taylor]]()
        start = [_series([ranges[name]], order) for name in self.states]
        length = _series([between(0, h), point(_ONE)], order)
        for weights, at in zip((*tableau.rows, tableau.weights), (*tableau.nodes, _ONE), strict=True):
            here = list(start)
            for weight, slope in zip(weights, slopes, strict=True):
                if weight:
                    moves = length * arithmetic.number(weight)
                    here = [x + moves * one for x, one in zip(here, slope, strict=True)]
            stages.append(here)
            if len(slopes) < len(tableau.weights):
                slopes.append(self._rates([x.coefficients for x in here], self._inputs(at, h), order))
        return stages

    def _inputs(self, at: Fraction, h: Fraction) -> dict[str, Series]:
        """The inputs and their rates at that share of any length up to h, the rates for a step of it."""
        ranges, known = sides(self.box), dict[str, Series]()
        for name, rate in self.rates.items():
            moves = point(at) * between(-rate, rate)
            here = ranges[name] + moves * between(0, h)
            known[name] = [intersection(here, between(*self.whole[name])), moves]
        return known

    def _rates(self, states: Sequence[Series], inputs: Mapping[str, Series], order: int) -> list[Taylor]:
        """F below s^order of the series of the states and of the inputs."""
        values = {name: _series([side], order) for name, side in sides(self.box).items()}
        moving = {**dict(zip(self.states, states, strict=True)), **inputs}
        values |= {name: _series(x, order) for name, x in moving.items()}
        return [evaluate(row, values, taylor(order)) for row in self.rows]


def _series(coefficients: Series, order: int) -> Taylor:
    """The series that begins so, below s^order."""
    none = taylor(order).number(Fraction(0)).coefficients[1:]
    return Taylor((*coefficients, *none)[:order])
