"""Bounds of the speed of a plant on its ranges, from which sizes of a method's local error follow.

    x' = F(x, u), u' constant;   X_i = x + s sum_j a_ij k_j,   k_i = F(X_i, u + c_i s u'),   Phi_s = x + s sum_i b_i k_i

Taylor coefficients in time of the plant's flow, and of a step of a method in its length, are intervals that enclose
those of every point of a box, and of every length s from 0 to h. At a stage an input may have left the box, but not its
range. The k-th derivative of r(x(t), u(t)) of a row r is bounded by series with slopes in the point and in the rates of
inputs: by its interval on a box, or by its mean value form on the face towards which it increases.

The sizes of the inputs to an error follow from the user's declarations, on the plant's ranges.

    noise         the error of a sample itself
    rounded       half of the quantisation steps of samples
    late          tau (|y'| + |dy/dz| m): the error of the time at which a sample was taken
    disturbance   integral of exp(s h J) m over s from 0 to 1, |dF/dz| <= J:   m = |dT/dx| d for d in the plant's rows
    parameters    the same for m = |dF/dp| q, parameters that differ from the program's by q

z' = F, z = T(x); the certificate states a bound of each |.|, which is proved by bisection. `local_error` treats the
local error of a method, `program` the rounding errors of a program.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from math import factorial
from typing import Any

from .arithmetic import Dual, Unproved, dual, evaluate
from .box import Box, End, covered, demand_jacobian, narrowed, on_faces, ranged, seeded_sides, sides
from .context import Context, demand_only, printed
from .file import column, matrix, part
from .inequality import Tableau
from .interval import Interval, Taylor, between, intersection, padded_series, point, taylor
from .matrix import Matrix, demand_at_least, row_sum_norm
from .text import Expression

_ONE = Fraction(1)


@dataclass(frozen=True)
class PlantMotion:
    """Bounds of the motion of the plant z' = F(z, u) in steps of length `h`: `speeds` (n) of |F| on the plant's ranges,
    `rates` (m) of |u'|."""

    context: Context
    h: Fraction
    rates: list[Fraction]
    speeds: list[Fraction]

    def demand(self) -> int:
        """Demand that the `speeds` bound |F|, that the `rates` are not negative, and that no measured output depends on
        an input; return the number of boxes. Raises: `Unproved`."""
        context = self.context
        for j in self.observed:
            demand_only(context.form.output[j].names & set(context.file.inputs), (), "an output")
        for u, rate in zip(context.file.inputs, self.rates, strict=True):
            if rate < 0 or (rate and u not in self.read):
                raise Unproved("one of its rates is negative, or of an input that the plant does not read")
        return demand_speeds(context, self.speeds)

    @cached_property
    def read(self) -> frozenset[str]:
        """The names of states, inputs and parameters on which F depends."""
        return frozenset(name for row in self.context.rates for name in row.names)

    @cached_property
    def observed(self) -> dict[int, tuple[int, Fraction]]:
        """For each output j that measures a state, the state's index and dy_j/dz. Raises: `Unproved`."""
        observed = dict[int, tuple[int, Fraction]]()
        for j, z in ((j, z) for j, z in enumerate(self.context.observed) if z):
            observed[j] = self.context.z.index(z), self.context.output_slope(j)
        return observed

    @property
    def phrase(self) -> str:
        """The words of a finding for the method's local error, with the assumed rates of inputs."""
        each = zip(self.context.file.inputs, self.rates, strict=True)
        moving = [f"{u} moves at up to {printed(rate, -1)}" for u, rate in each if u in self.read]
        return f"what the method leaves{' as ' if moving else ''}{', '.join(moving)}"

    @property
    def clear(self) -> str:
        """The words of a finding for h sup|F|, the distance that each state must have from the ends of its range."""
        each = zip(self.context.z, self.speeds, strict=True)
        return ", ".join(f"{printed(self.h * speed, 1)} in {z}" for z, speed in each)


def demand_speeds(context: Context, speeds: Sequence[Fraction]) -> int:
    """Demand |F_i| <= speeds_i for all rows of the plant z' = F(z, u) (n); return the number of boxes. Raises:
    `Unproved`."""
    rows = zip(context.rates, speeds, strict=True)
    return sum(covered(narrowed(context.form.box, row.names), ".", ranged(row, -most, most)) for row, most in rows)


def motion_of(context: Context, h: Fraction, follows: Mapping[str, Any]) -> PlantMotion:
    """Return the plant's motion in steps of length h, with the `rates` and `speeds` of the evidence `follows`. Raises:
    `Unproved`."""
    rates, speeds = column(follows, "rates", len(context.file.inputs)), column(follows, "speeds", len(context.z))
    return PlantMotion(context, h, rates, speeds)


def demand_keys(follows: Mapping[str, Any], keys: tuple[str, ...], name: str = "the method") -> None:
    """Demand that the evidence `follows` has exactly these keys; `name`: the kind of inputs that it is about, in the
    error. Raises: `Unproved`."""
    if set(follows) != {*keys}:
        raise Unproved(f"the sizes of {name} do not follow from {', '.join(keys) or 'nothing'}")


# --- series in time

Series = Mapping[str, Dual]  # by names, of Taylor series with slopes


def _flow(rows: Sequence[Expression], states: Sequence[str], started: Series, order: int) -> Series:
    """Return the Taylor series in time below t^order of the solution of states' = `rows`; `started`: the first
    coefficients of the states and the series of inputs and parameters."""
    series = dict(started)
    for k in range(1, order):
        here = _begun(series, k)
        rates = [evaluate(row, here, dual(taylor(k))) for row in rows]
        series |= {name: _longer(here[name], rate) for name, rate in zip(states, rates, strict=True)}
    return series


def _begun(series: Series, count: int) -> Series:
    cut = {
        name: {k: padded_series(slope.coefficients, count) for k, slope in x.slopes.items()}
        for name, x in series.items()
    }
    return {name: Dual(padded_series(x.value.coefficients, count), cut[name]) for name, x in series.items()}


def _longer(x: Dual, rate: Dual) -> Dual:
    count = len(x.value.coefficients)
    share, none = point(Fraction(1, count)), padded_series((), count)

    def longer(x: Taylor, rate: Taylor) -> Taylor:
        return Taylor((*x.coefficients, share * rate.coefficients[-1]))

    keys = sorted(x.slopes.keys() | rate.slopes.keys())
    slopes = {k: longer(x.slopes.get(k, none), rate.slopes.get(k, none)) for k in keys}
    return Dual(longer(x.value, rate.value), slopes)


@dataclass(frozen=True)
class PlantSeries:
    """Taylor series of the plant x' = F(x, u) from all points of a `box` at once, in intervals: `rows` F (n), `states`
    x (n). `rates`: bounds of |u'| by the name of an input, which stays in its range in `whole`; other names are
    constant."""

    rows: Sequence[Expression]
    states: Sequence[str]
    rates: Mapping[str, Fraction]
    box: Box
    whole: Box

    def flow(self, order: int) -> list[list[Interval]]:
        """Return the Taylor coefficients of each state (n) in time, below t^order. Raises: `Undefined`."""
        started = {name: [side] for name, side in sides(self.box).items()} | self._inputs(_ONE, Fraction(0))
        series = _flow(
            self.rows, self.states, {name: Dual(padded_series(x, len(x)), {}) for name, x in started.items()}, order
        )
        return [[*series[name].value.coefficients] for name in self.states]

    def step(self, tableau: Tableau, h: Fraction, order: int) -> list[list[Taylor]]:
        """Return Taylor series of a Runge-Kutta step in its length s <= h, below s^order: of the states (n) at each
        stage (s rows), and last of x+. Raises: `Undefined`."""
        arithmetic, ranges, slopes, stages = taylor(order), sides(self.box), list[list[Taylor]](), list[list[Taylor]]()
        constant = {name: padded_series([side], order) for name, side in ranges.items()}
        start = [constant[name] for name in self.states]
        length = padded_series([between(0, h), point(_ONE)], order)
        for weights, at in zip((*tableau.rows, tableau.weights), (*tableau.nodes, _ONE), strict=True):
            here = list(start)
            for weight, slope in zip(weights, slopes, strict=True):
                if weight:
                    orders_of = length * arithmetic.number(weight)
                    here = [x + orders_of * one for x, one in zip(here, slope, strict=True)]
            stages.append(here)
            if len(slopes) < len(tableau.weights):
                inputs = {name: padded_series(x, order) for name, x in self._inputs(at, h).items()}
                values = {**constant, **dict(zip(self.states, here, strict=True)), **inputs}
                slopes.append([evaluate(row, values, arithmetic) for row in self.rows])
        return stages

    def _inputs(self, at: Fraction, h: Fraction) -> dict[str, list[Interval]]:
        """Return the Taylor coefficients (u, `at` u') of each input u in s, at the time `at` s of a step of length s <=
        h."""
        ranges, known = sides(self.box), dict[str, list[Interval]]()
        for name, rate in self.rates.items():
            orders_of = point(at) * between(-rate, rate)
            here = ranges[name] + orders_of * between(0, h)
            known[name] = [intersection(here, between(*self.whole[name])), orders_of]
        return known


# --- derivatives in time

Ends = tuple[tuple[str, tuple[End, End]], ...]  # ends of a box


@dataclass(frozen=True)
class Derivative:
    """The statement |d^k r/dt^k| <= `most` along the plant's motion, for a `row` r in states and inputs, k =
    `order`."""

    row: Expression
    order: int
    most: Fraction


def demand_derivatives(motion: PlantMotion, each: Sequence[Derivative]) -> int:
    """Demand the stated bounds of time derivatives on the plant's ranges; return the number of boxes. Raises:
    `Unproved`."""
    context, orders_of = motion.context, tuple((one.row, one.order) for one in each)
    whole, rates = context.form.box, dict(zip(context.file.inputs, motion.rates, strict=True))
    steered = {u: f"{u}'" for u, rate in rates.items() if rate}  # the name of its rate, which no expression reads
    box = {**narrowed(whole, motion.read), **{steered[u]: (-rates[u], rates[u]) for u in steered}}
    plant = tuple(context.rates), tuple(context.z), tuple(whole.items()), tuple(steered.items())

    def on(here: Box) -> list[Dual]:
        return _derivatives(*plant, orders_of, tuple(here.items()))

    def values(here: Box) -> list[Interval]:
        return [each.value for each in on(here)]

    return covered(box, ".", on_faces([(-one.most, one.most) for one in each], values, on))


@lru_cache(maxsize=1 << 10)  # several bounds are tried on the same boxes
def _derivatives(
    rates: tuple[Expression, ...],
    states: tuple[str, ...],
    whole: Ends,
    steered: tuple[tuple[str, str], ...],
    orders_of: tuple[tuple[Expression, int], ...],
    here: Ends,
) -> list[Dual]:
    orders = dict(sorted(orders_of, key=lambda one: one[1]))
    every = {**{name: Dual(x, {}) for name, x in sides(dict(whole)).items()}, **seeded_sides(dict(here))}
    rate = dict(steered)
    started = {name: _started(every[name], *([every[rate[name]]] if name in rate else [])) for name, _ in whole}
    series = _flow(rates, states, started, max(orders.values()) + 1)
    rows = {row: evaluate(row, _begun(series, order + 1), dual(taylor(order + 1))) for row, order in orders.items()}
    shares = [(rows[row], order, point(Fraction(factorial(order)))) for row, order in orders_of]
    return [
        Dual(
            share * series.value.coefficients[order],
            {name: share * slope.coefficients[order] for name, slope in series.slopes.items()},
        )
        for series, order, share in shares
    ]


def _started(*coefficients: Dual) -> Dual:
    (none,) = padded_series((), 1).coefficients
    keys = dict.fromkeys(k for x in coefficients for k in x.slopes)
    slopes = {k: Taylor(tuple(x.slopes.get(k, none) for x in coefficients)) for k in keys}
    return Dual(Taylor(tuple(x.value for x in coefficients)), slopes)


_TERMS = 60  # of the exponential's series
_FAST = 20  # largest norm of h J
Shares = Mapping[str, Mapping[str, Any]]


def demand_declared_sizes(context: Context, h: Fraction, shares: Shares) -> int:
    """Demand that the sizes stated in the shares (evidence by kind: noise, rounded or late samples, disturbances,
    wrong parameters) are at least what follows from the user's declarations; return the number of boxes. Raises:
    `Unproved`."""
    n, p, boxes = len(context.z), len(context.form.output), 0
    drift, others = [Fraction(0)] * n, dict[str, tuple[Mapping[str, Any], list[Fraction]]]()
    for name, share in shares.items():
        follows = part(share, "follows", dict)
        keys = _KEYS.get(name, ())
        demand_keys(follows, keys, name)
        if name in _ROWS:
            rows, sizes, observed = _ROWS[name](context, follows)
            each = rows.applied(sizes)
            J = matrix(follows, "steepness", n, n)
            boxes += observed + demand_jacobian(context.rates, context.z, J, [Fraction(1)] * n, context.form.box)
            demand_at_least(name, column(share, "beside", n), _accumulated(h, J, each))
            drift = [x + y for x, y in zip(drift, each, strict=True)]
        elif keys:
            others[name] = follows, _signless(follows, "sizes", p)
    for name, (follows, sizes) in others.items():
        if name == "late":
            sizes, observed = _late(context, follows, sizes, drift)
            boxes += observed
        least = [size / 2 for size in sizes] if name == "rounded" else sizes
        demand_at_least(name, column(shares[name], "samples", p), least)
    return boxes


def _signless(follows: Mapping[str, Any], key: str, count: int) -> list[Fraction]:
    numbers = column(follows, key, count)
    if min(numbers, default=Fraction(0)) < 0:
        raise Unproved(f"one of its {key} is negative")
    return numbers


def _late(
    context: Context, follows: Mapping[str, Any], sizes: Sequence[Fraction], drift: Sequence[Fraction]
) -> tuple[list[Fraction], int]:
    """Return tau (|y'| + |dy/dz| m) for each output (p), a bound of the error of a sample whose time is wrong by up to
    tau = `sizes`, with a disturbance of z' of up to m = `drift` (n); and the number of boxes. Raises: `Unproved`."""
    speeds, least, boxes = _signless(follows, "speeds", len(sizes)), list[Fraction](), 0
    for j, (tau, speed) in enumerate(zip(sizes, speeds, strict=True)):
        if not tau:
            least.append(tau)
            continue
        context.demand_observed(j)
        slope = context.output_slope(j)
        demand_only(context.form.output[j].names & set(context.file.inputs), (), "a late output")
        i = context.z.index(context.observed[j])
        most, row = speed / abs(slope), context.rates[i]
        boxes += covered(narrowed(context.form.box, row.names), ".", ranged(row, -most, most))
        least.append(tau * (speed + abs(slope) * drift[i]))
    return least, boxes


def _by_disturbance(context: Context, follows: Mapping[str, Any]) -> tuple[Matrix, list[Fraction], int]:
    names, T = context.plant.states, context.form.to_form
    sizes = _signless(follows, "sizes", len(names))
    rows = matrix(follows, "rows", len(T), len(names))
    return rows, sizes, demand_jacobian(T, names, rows, sizes, context.plant.box)


def _by_parameters(context: Context, follows: Mapping[str, Any]) -> tuple[Matrix, list[Fraction], int]:
    form, names = context.form, context.file.parameters
    sizes = _signless(follows, "sizes", len(names))
    wrong = {name: size for name, size in zip(names, sizes, strict=True) if size}
    for text in (*form.to_form, *form.from_form, *form.output):
        demand_only(text.names & set(wrong), (), "a coordinate or an output")
    rows = matrix(follows, "rows", len(context.z), len(names))
    box = {**form.box, **{name: (form.box[name][0] - size, form.box[name][1] + size) for name, size in wrong.items()}}
    return rows, sizes, demand_jacobian(context.rates, names, rows, sizes, box)


def _accumulated(h: Fraction, J: Matrix, drift: Sequence[Fraction]) -> list[Fraction]:
    """Return upper bounds (n) of sum_k (h J)^k m/(k + 1)!, the mean effect over a step h of a disturbance m = `drift`
    (n) of z' = F with |dF/dz| <= J (n, n). Raises: `Unproved`."""
    if any(x < 0 for row in J for x in row):
        raise Unproved("one of its steepness is negative")
    norm = h * row_sum_norm(J)
    if norm > _FAST:
        raise Unproved("the plant is too fast for its dt")
    term, total = list(drift), list(drift)
    for k in range(2, _TERMS + 2):
        exact = [h * x / k for x in J.applied(term)]
        term = [Fraction(-(-x.numerator * 2**_BITS // x.denominator), 2**_BITS) for x in exact]  # or a little above
        total = [x + y for x, y in zip(total, term, strict=True)]
    tail = max(term, default=Fraction(0))  # each omitted term is at most half of the one before
    return [x + tail if x > at_first else x for x, at_first in zip(total, drift, strict=True)]


_BITS = 400
_KEYS: Mapping[str, tuple[str, ...]] = {
    "noise": ("sizes",),
    "rounded": ("sizes",),
    "late": ("sizes", "speeds"),
    "disturbance": ("sizes", "rows", "steepness"),
    "parameters": ("sizes", "rows", "steepness"),
}
_ROWS: Mapping[str, Callable[..., tuple[Matrix, list[Fraction], int]]] = {
    "disturbance": _by_disturbance,
    "parameters": _by_parameters,
}
