"""That the sizes of what a method leaves follow from the plant, on its ranges.

    x(t + h) = Phi_h(x) + delta,   Phi_h: a step of a method of order p on x' = F(x, u), u' constant

    beside      |delta|/h <= h^q (sup|x_(q+1)| + sup|Phi_(q+1)|), of an order q from 1 to p for each row: Taylor
                coefficients of the flow at any point, of the step at any length up to h; of the order 0 what there is
                where F is Lipschitz
    stages      |(1 - c_i) y + c_i C Phi_h(x) - C X_i| <= h^2 sum_j |c_i b_j - a_ij| sum_k |a_jk| sup|y''|, and
                h^3 sup|c_i C Phi_3 - C X_(i,3)| where sum_j (c_i b_j - a_ij) c_j = 0

where the plant keeps clear of the ends of its ranges by h sup|F|. y'' is at most how steep y' is in states and inputs,
times how fast they move. Suprema are at most what the certificate says of them, shown by bisection: of coefficients on
the cells of its tree.

Beside a plant whose flow is Lipschitz, kinks and all, |dF_i/dx_j|, |dF_i/du_k| <= L, |x'| <= V, |u'| <= r, so that
|d/dt F_i(x(t), u(t))| <= W_i = (L (V, r))_i, a sum of values at c_l, of weights w_l that add to c, is beside the
integral from 0 to c by at most W times that of the size of min(s, c) - sum of the w_l with c_l <= s; with c = 1 and
weights that add the c_l to 1/2, and where F_i has a second derivative of at most w, by w (1/24 + sum |w_l| (c_l -
1/2)^2/2), which a linear row has: w = (L (W, 0))_i. A stage is beside the plant at its time by that, in h, and by what
the stages before it are, times L.
"""

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain, pairwise
from typing import Any

from .arithmetic import Undefined
from .box import Box, NotShown, Try, covered
from .context import Context, narrowed
from .file import column, entries, matrix, part
from .inequality import ONE, Tableau
from .interval import Interval, point
from .matrix import Matrix, demand_enough, dot
from .plant_motion import PlantMotion, PlantSeries, demand_keys, motion_of
from .slope import no_steeper
from .text import Expression

_KEYS = ("rates", "speeds", "slopes", "lines", "orders", "flow", "step", "steepness", "tree")
_THIRD = 3  # the coefficient of a line
_MORE = 100  # boxes on which coefficients are taken, beyond the cells of a tree
_BENT = 2  # the degree of what is not linear
_HALF, _ZERO, _TWELFTH = Fraction(1, 2), Fraction(0), Fraction(1, 12)


@dataclass(frozen=True)
class Remainder:
    """What a method leaves of a plant that moves so: bounds of the `slopes` of y' in states and inputs (p, n + m), of
    the third coefficients of the `lines` that have no second one (p, ..) or of none; and of each row of the form (n)
    the order and the bounds of the coefficients of the `flow` and of the `step` after it, on the cells of a `tree`, and
    where one is 0 how steep the rows are in states and inputs, `steepness` (n, n + m)."""

    context: Context
    tableau: Tableau
    motion: PlantMotion
    slopes: Matrix
    lines: Matrix
    orders: list[int]
    flow: list[Fraction]
    step: list[Fraction]
    steepness: Matrix
    tree: str

    @property
    def beside(self) -> list[Fraction]:
        """Of each row (n), over h. Raises: `NotShown`."""
        h, each = self.motion.h, zip(self.orders, self.flow, self.step, strict=True)
        left = [h**order * (x + y) for order, x, y in each]
        if not self.steepness:
            return left
        constant = {name for name, (low, high) in self.context.form.box.items() if low == high}
        linear = [_degree(row, constant) <= 1 for row in self.context.rates]
        lipschitz = left_by_lipschitz(self.tableau, h, self.steepness, self._moving, linear)
        return [x if order else y for order, x, y in zip(self.orders, left, lipschitz, strict=True)]

    @property
    def _moving(self) -> tuple[Fraction, ...]:
        return (*self.motion.speeds, *self.motion.rates)

    @property
    def stages(self) -> Matrix:
        """Of the line between the samples of each output, at each stage (p, s)."""
        return [self._line(*each) for each in zip(self.slopes, self.lines, strict=True)]

    def _line(self, slopes: list[Fraction], thirds: list[Fraction]) -> list[Fraction]:
        h = self.motion.h
        bend = dot(slopes, self._moving)
        away = [sum(map(abs, row), _ZERO) for row in self.tableau.rows]
        shares = [dot(map(abs, row), away) for row in self.tableau.bends]
        sizes = [h**2 * bend * share for share in shares]
        for i, third in zip(self.tableau.cubic, thirds, strict=False):
            sizes[i] = min(sizes[i], h**_THIRD * third)
        return sizes

    def demand(self) -> int:
        """That the bounds are those of the plant; with how many boxes. Raises: `NotShown`."""
        context, box, boxes = self.context, self.context.form.box, self.motion.demand()
        names = (*context.z, *context.file.inputs)
        for j, (head, slope) in self.motion.shown.items():
            bounds = [[x / abs(slope) for x in self.slopes[j]]]
            boxes += no_steeper((context.rates[head],), names, bounds, [Fraction(1)] * len(names), box)
        if self.steepness:
            boxes += no_steeper(context.rates, names, self.steepness, [Fraction(1)] * len(names), box)
        if not (any(self.orders) or any(self.lines)):
            return boxes
        return boxes + covered(narrowed(box, self.motion.read), self.tree, self._within, _MORE)

    def _within(self, box: Box) -> Try:
        context, orders, whole = self.context, self.orders, self.context.form.box
        rates = dict(zip(context.file.inputs, self.motion.rates, strict=True))
        plant = PlantSeries(context.rates, context.z, rates, {**whole, **box}, whole)
        try:
            flow = plant.flow(max(orders) + 2)
            if not _all_within(_after(flow, orders, self.flow)):
                return Try(False)
            steps = plant.step(self.tableau, self.motion.h, max(max(orders) + 2, _THIRD + 1))
        except Undefined:
            return Try(False)
        step = [x.coefficients for x in steps[-1]]
        pairs = _after(step, orders, self.step)
        for j, (head, slope) in self.motion.shown.items():
            for i, third in zip(self.tableau.cubic, self.lines[j], strict=False):
                line = point(self.tableau.nodes[i]) * step[head][_THIRD] - steps[i][head].coefficients[_THIRD]
                pairs.append((line, third / abs(slope)))
        return Try(_all_within(pairs))


def _after(
    series: Sequence[Sequence[Interval]], orders: Sequence[int], bounds: Sequence[Fraction]
) -> list[tuple[Interval, Fraction]]:
    """The coefficients after the orders of rows, but of 0, and their bounds."""
    each = zip(series, orders, bounds, strict=True)
    return [(x[order + 1], most) for x, order, most in each if order]


def _degree(row: Expression, constant: Container[str]) -> int:
    """0 of what is constant, 1 of what adds names and products of them with what is; else more."""
    degrees = list[int]()
    for op, args, value in row.instructions:
        own = [degrees[arg] for arg in args]
        if op == "symbol":
            degrees.append(int(value not in constant))
        elif op in ("add", "sub", "neg"):
            degrees.append(max(own))
        elif op == "mul" or (op == "div" and not own[1]):
            degrees.append(sum(own))
        else:
            degrees.append(_BENT if any(own) else 0)
    return degrees[row.result]


def _all_within(pairs: Iterable[tuple[Interval, Fraction]]) -> bool:
    return all(x.at_least(-most) and x.at_most(most) for x, most in pairs)


def demand_remainder(
    context: Context, tableau: Tableau, h: Fraction, share: Mapping[str, Any]
) -> tuple[PlantMotion, int]:
    """How the plant moves, from which the sizes of the share follow, with how many boxes. Raises: `NotShown`."""
    follows, p, n, m = part(share, "follows", dict), len(context.form.output), len(context.z), len(context.file.inputs)
    demand_keys(follows, _KEYS)
    motion = motion_of(context, h, follows)
    slopes = matrix(follows, "slopes", p, n + m)
    orders = _orders(follows, n, tableau)
    steepness = [] if all(orders) else matrix(follows, "steepness", n, n + m)
    if all(orders) and part(follows, "steepness", list):
        raise NotShown("none of its rows follows from their steepness")
    rows = column(follows, "flow", n), column(follows, "step", n)
    tree = part(follows, "tree", str)
    left = Remainder(context, tableau, motion, slopes, _lines(follows, p, tableau), orders, *rows, steepness, tree)
    stages, beside = matrix(share, "stages", p, len(tableau.nodes)), column(share, "beside", n)
    demand_enough("the method", (*beside, *chain(*stages)), (*left.beside, *chain(*left.stages)))
    return motion, left.demand()


def _orders(follows: Mapping[str, Any], n: int, tableau: Tableau) -> list[int]:
    """Of each row (n), from 0 to that of the method. Raises: `NotShown`."""
    orders = column(follows, "orders", n)
    if any(q.denominator > 1 or not 0 <= q <= tableau.order for q in orders):
        raise NotShown(f"one of its orders is none of 0 to {tableau.order}")
    return [*map(int, orders)]


def _lines(follows: Mapping[str, Any], p: int, tableau: Tableau) -> Matrix:
    """The bounds of the third coefficients of each output (p, ..), or none of any. Raises: `NotShown`."""
    count = len(tableau.cubic) if any(entries(follows, "lines", p)) else 0
    return matrix(follows, "lines", p, count)


# --- where the flow is Lipschitz


def left_by_lipschitz(
    tableau: Tableau, h: Fraction, steepness: Matrix, moving: Sequence[Fraction], linear: Sequence[bool]
) -> list[Fraction]:
    """Of each row (n), over h: of `steepness` (n, n + m) where states and inputs are `moving` so fast (n + m), and some
    rows are `linear`. Raises: `NotShown`."""
    if any(x < 0 for row in steepness for x in row):
        raise NotShown("one of its steepness is negative")
    n, nodes, off = len(steepness), tableau.nodes, list[list[Fraction]]()
    W = _driven(steepness, moving)
    for row, c in zip((*tableau.rows, tableau.weights), (*nodes, ONE), strict=True):
        beside = [h * h * _kernel(row, nodes, c) * x for x in W]
        for w, before in zip(row, off, strict=False):
            beside = [x + h * abs(w) * y for x, y in zip(beside, _driven(steepness, before), strict=True)]
        off.append(beside)
    if dot(tableau.weights, nodes) != _HALF:  # not exact for lines
        return [x / h for x in off[-1]]
    bends = _driven(steepness, W)
    moment = sum((abs(w) * (c - _HALF) ** 2 for w, c in zip(tableau.weights, nodes, strict=True)), _TWELFTH) / 2
    kernel, left = _kernel(tableau.weights, nodes, ONE), list[Fraction]()
    for i in range(n):
        less = max(h * kernel * W[i] - h * h * moment * bends[i], _ZERO) if linear[i] else _ZERO
        left.append(off[-1][i] / h - less)
    return left


def _driven(rows: Matrix, by: Sequence[Fraction]) -> list[Fraction]:
    """Of rows, whose last entries may be of what does not move."""
    return [sum((x * y for x, y in zip(row, by, strict=False)), _ZERO) for row in rows]


def _kernel(weights: Sequence[Fraction], nodes: Sequence[Fraction], c: Fraction) -> Fraction:
    """The integral from 0 to 1. Raises: `NotShown` of weights that do not add to c."""
    if sum(weights, _ZERO) != c:
        raise NotShown("its stages are not exact for what is constant")
    jumps = dict.fromkeys(sorted({_ZERO, c, ONE, *nodes}), _ZERO)
    for w, at in zip(weights, nodes, strict=False):
        jumps[at] += w
    value, total = _ZERO, _ZERO
    for here, there in pairwise(jumps):
        value -= jumps[here]
        after = value + (there - here if there <= c else _ZERO)
        total += _size(value, after) * (there - here)
        value = after
    return total


def _size(a: Fraction, b: Fraction) -> Fraction:
    """The mean size of what goes from a to b on a line."""
    if a * b >= 0:
        return abs(a + b) / 2
    return (a * a + b * b) / (2 * abs(b - a))
