"""That derivatives in time of what a plant moves are at most as large as is said of them, on its ranges.

    x' = F(x, u), u' constant:   the k-th derivative of r(x(t), u(t)) of a row r

by Taylor series of values with slopes in the point, and in the rates of inputs, from which they begin. In intervals
what a derivative is on a box, by itself, or on the face towards which it grows by its value at the centre and slopes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from math import factorial

from .arithmetic import Dual, dual, evaluate
from .box import Box, End, covered, sides
from .context import narrowed
from .interval import Interval, point
from .plant_motion import PlantMotion
from .slope import on_faces
from .taylor import Taylor, taylor
from .text import Expression

_ONE = Fraction(1)
_NONE = taylor(2).number(_ONE).coefficients[1]  # the 0 by which series cost nothing
Series = Mapping[str, Dual]  # by names
Ends = tuple[tuple[str, tuple[End, End]], ...]  # those of a box


@dataclass(frozen=True)
class Derivative:
    """Of a row, the derivative of an order, and what it is at most."""

    row: Expression
    order: int
    most: Fraction


def demand_derivatives(motion: PlantMotion, each: Sequence[Derivative]) -> int:
    """That derivatives of rows of the plant are at most what is said; with how many boxes. Raises: `NotShown`."""
    context, moves = motion.context, tuple((one.row, one.order) for one in each)
    whole, rates = context.form.box, dict(zip(context.file.inputs, motion.rates, strict=True))
    moving = {u: _rate_of(u) for u, rate in rates.items() if rate}
    box = {**narrowed(whole, motion.read), **{moving[u]: (-rates[u], rates[u]) for u in moving}}
    plant = tuple(context.rates), tuple(context.z), tuple(whole.items()), tuple(moving.items())

    def on(here: Box) -> list[Dual]:
        return _derivatives(*plant, moves, tuple(here.items()))

    def values(here: Box) -> list[Interval]:
        return [each.value for each in on(here)]

    return covered(box, ".", on_faces([(-one.most, one.most) for one in each], values, on))


@lru_cache(maxsize=1 << 10)  # other bounds of them are shown, or are not, of the same boxes
def _derivatives(
    rates: tuple[Expression, ...],
    states: tuple[str, ...],
    whole: Ends,
    moving: tuple[tuple[str, str], ...],
    moves: tuple[tuple[Expression, int], ...],
    here: Ends,
) -> list[Dual]:
    """What derivatives of rows, of an order each, are in intervals on a box, with their slopes. Raises: `Undefined`."""
    orders = dict(sorted(moves, key=lambda one: one[1]))
    series = _along(rates, states, _started(dict(here), dict(whole), dict(moving)), max(orders.values()))
    rows = {row: evaluate(row, _begin(series, order + 1), dual(taylor(order + 1))) for row, order in orders.items()}
    return [_derivative(rows[row], order) for row, order in moves]


def _derivative(series: Dual, order: int) -> Dual:
    """Of a series, with its slopes."""
    share = point(Fraction(factorial(order)))
    slopes = {name: share * slope.coefficients[order] for name, slope in series.slopes.items()}
    return Dual(share * series.value.coefficients[order], slopes)


def _rate_of(u: str) -> str:
    """What stands for the rate of an input, a name that no expression has."""
    return f"{u}'"


def _started(here: Box, whole: Box, moving: Mapping[str, str]) -> Series:
    """What is known of all names at first, with slopes in those that a box leaves room, `moving` the names of inputs'
    rates."""
    places = {name: k for k, (name, (low, high)) in enumerate(here.items()) if low < high}
    ranges = sides({**whole, **here})

    def series(*names: str) -> Dual:
        each = range(len(names))
        units = {
            places[name]: Taylor(tuple(point(_ONE) if k == j else _NONE for k in each))
            for j, name in enumerate(names)
            if name in places
        }
        return Dual(Taylor(tuple(ranges[name] for name in names)), units)

    return {name: series(name, *([moving[name]] if name in moving else [])) for name in whole}


def _along(rows: Sequence[Expression], states: Sequence[str], started: Series, order: int) -> Series:
    """The series below t^(order + 1). Raises: `Undefined`."""
    series = dict(started)
    for k in range(order):
        here = _begin(series, k + 1)
        slopes = [evaluate(row, here, dual(taylor(k + 1))) for row in rows]
        series |= {name: _longer(here[name], slope) for name, slope in zip(states, slopes, strict=True)}
    return series


def _begin(series: Series, count: int) -> dict[str, Dual]:
    """The same of as many coefficients."""

    def cut(x: Taylor) -> Taylor:
        return Taylor((*x.coefficients, *[_NONE] * count)[:count])

    return {name: Dual(cut(x.value), {k: cut(slope) for k, slope in x.slopes.items()}) for name, x in series.items()}


def _longer(x: Dual, rate: Dual) -> Dual:
    """By one coefficient, from the rate."""
    count = len(x.value.coefficients)
    share, none = point(Fraction(1, count)), Taylor((_NONE,) * count)

    def longer(x: Taylor, rate: Taylor) -> Taylor:
        return Taylor((*x.coefficients, share * rate.coefficients[-1]))

    keys = x.slopes.keys() | rate.slopes.keys()
    slopes = {k: longer(x.slopes.get(k, none), rate.slopes.get(k, none)) for k in sorted(keys)}
    return Dual(longer(x.value, rate.value), slopes)
