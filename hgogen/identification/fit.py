"""Parameters of a plant from measured records, with what the records tell of them."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Literal

import casadi as ca
import numpy as np

from hgogen.errors import nearest
from hgogen.identification.information import Information, alike, information, residuals
from hgogen.identification.lag import lagged
from hgogen.identification.motion import paced
from hgogen.identification.records import BadLog, Log, demanded
from hgogen.identification.result import Estimate, Fit, Place
from hgogen.identification.robust import WRONG, corner, deviation, influence
from hgogen.identification.shooting import Shooting
from hgogen.identification.solution import Solution, Solver
from hgogen.signal import Signal, resting
from hgogen.structure.valued import valued
from hgogen.system import System

Array = np.ndarray
BETWEEN = ("hold", "line")
SEGMENTS = 60  # of a record, about
WIDE = 100.0  # times its nominal value, to which a parameter without a range may go, and the same part of it
GROWN = 3.0  # of log growth in a segment, at most
PART = 0.05  # of a direction: less of a parameter in it is none
UNTOLD = 1.0  # of a unit: a direction with a larger standard error is not told by the records
ROUNDED = 1e-10  # of the largest eigenvalue of the information: less is rounding
AGAIN = 4  # passes of a robust fit, each with the corner of the last one's residuals
AT = 1e-6  # of a unit, from the end of a range


class CannotFit(BadLog):
    """Records from which the parameters cannot be fitted, or parameters that cannot be."""


def fit(
    plant: System,
    *records: Log,
    free: Iterable[str | Signal] | None = None,
    offset: Iterable[str | Signal] = (),
    lag: Iterable[str | Signal] = (),
    between: Literal["hold", "line"] = "hold",
    starts: int = 3,
    seed: int = 0,
    robust: bool = False,
    each: Callable[[int, int], None] = lambda start, iteration: None,
) -> Fit:
    """The parameters with which the plant follows the records best, by multiple shooting.

    `records`: inputs u (N, m), outputs y (N, p), NaN where nothing was measured, and their period; `free`: the
    parameters that are fitted, by default those with a range, which bounds them; another stays within a hundredth and a
    hundred times its value. `offset`: the outputs to which an unknown constant is added; `lag`: those whose sensor
    follows by an unknown first-order lag; `between`: how inputs go on between samples; `starts`: the first from the
    nominal values, the others random within the ranges; `robust`: a sample far off, as one of a sensor that failed,
    counts by its distance, not by its square; `each(start, iteration)` is called after every iteration.

    Raises: `CannotFit`; `BadShape`, `BadNames` for records of another shape.
    """
    if not records or not all(isinstance(record, Log) for record in records):
        raise CannotFit("records", "are missing; give logs, such as hg.Log(u, y, dt)")
    if between not in BETWEEN:
        raise CannotFit(f"between={between!r}", f"is none of {', '.join(BETWEEN)}")
    if starts < 1:
        raise CannotFit(f"starts={starts}", "must be at least 1, the one from the nominal values")
    chosen, logs = _free(plant, free), tuple(demanded(plant, record, k) for k, record in enumerate(records, 1))
    period, duration = max(record.dt for record in logs), min(len(record.y) * record.dt for record in logs)
    slow, lags = lagged(plant, _named("lag", lag, plant.outputs), period, duration)
    offsets = _named("offset", offset, plant.outputs)
    task = _Task(plant, slow, chosen, tuple(lags), logs, offsets, between)
    draw = np.random.default_rng(seed)
    begins = [task.nominal, *(task.drawn(draw) for _ in range(starts - 1))]
    ended = tuple(task.solver.solve(begin, partial(each, k)) for k, begin in enumerate(begins))
    finite = [one for one in ended if np.isfinite(one.cost)]
    if not finite:
        raise CannotFit(f"plant {plant.name!r}", "has no finite residuals from any start; narrow the ranges")
    best = min(finite, key=lambda one: (not one.settled, one.cost))
    for _ in range(AGAIN if robust else 0):  # the residuals of least squares are those of outliers too
        task = replace(task, corner=task.corners(best.unknowns))
        best = task.solver.solve(best.unknowns, partial(each, starts - 1))
    return task.result(best, (best,) if robust else ended)


@dataclass(frozen=True, eq=False)
class _Task:
    """What is fitted to what: `plant` with the lags of its sensors, of `given` without; `chosen`: its parameters that
    are fitted beside the `lags`."""

    given: System
    plant: System
    chosen: tuple[Signal, ...]
    lags: tuple[Signal, ...]
    records: tuple[Log, ...]
    offset: tuple[Signal, ...]
    between: str
    corner: Array | None = None

    @property
    def free(self) -> tuple[Signal, ...]:
        """The parameters that are fitted."""
        return (*self.chosen, *self.lags)

    def corners(self, unknowns: Array) -> Array:
        """The corner of the loss of each output, from its residuals there."""
        return np.array([corner(e) for e in residuals(self.problem, unknowns)])

    def _influences(self, outputs: Sequence[Array]) -> list[Array]:
        """What the residuals of each output tell, in units of its scale."""
        scaled = [e / scale for e, scale in zip(outputs, self.problem.scale, strict=True)]
        if self.corner is None:
            return scaled
        return [influence(e, c) for e, c in zip(scaled, self.corner, strict=True)]

    @cached_property
    def problem(self) -> Shooting:
        """With as many Runge-Kutta steps a sample as the fastest mode asks for, and segments in which errors grow by no
        more than exp(GROWN). Raises: `CannotFit`."""
        period = max(record.dt for record in self.records)
        steps, growing = paced(self.plant, period)
        samples = max(len(record.y) for record in self.records)
        length = math.ceil(samples / SEGMENTS)
        length = max(1, min(length, int(GROWN / (growing * period)))) if growing else length
        spread = np.nanstd(np.concatenate([record.y for record in self.records]), axis=0)
        scale = np.where(spread > 0, spread, 1.0)
        return Shooting(self.plant, self.free, self.records, scale, length, steps, self.between, self.offset)

    @cached_property
    def solver(self) -> Solver:
        """Unknowns within their ranges, in units of these."""
        segments = sum(self.problem.segments)
        ends = [*map(_bounds, self.free), *[(-math.inf, math.inf)] * len(self.offset)]
        ends += [x.interval for x in self.plant.states] * segments
        unit = [*map(_unit, self.free), *(self.problem.scale[self.plant.outputs.index(y)] for y in self.offset)]
        unit += [_unit(x) for x in self.plant.states] * segments
        low, high = np.array(ends, dtype=float).T
        return Solver(self.problem, low, high, np.array(unit), self.corner)

    @property
    def nominal(self) -> Array:
        """The unknowns with the parameters at their nominal values."""
        values = [float(self.plant.nominal[p]) for p in self.free]
        return np.array([*values, *[0.0] * len(self.offset), *self._nodes])

    def drawn(self, draw: np.random.Generator) -> Array:
        """The unknowns with random parameters: within a range, else between half and twice the nominal value."""
        start = self.nominal
        for i, p in enumerate(self.free):
            start[i] = draw.uniform(*p.interval) if p.bounded else start[i] * 2 ** draw.uniform(-1, 1)
        return start

    @property
    def _nodes(self) -> list[float]:
        """The states where segments begin: what an output shows of them, the others at rest."""
        nodes: list[float] = []
        for record, count in zip(self.records, self.problem.segments, strict=True):
            at = np.arange(count) * self.problem.length
            rows = [np.full(count, resting(x)) for x in self.plant.states]
            for j, seen in enumerate(zip(self.given.output, self.plant.output, strict=True)):
                there = np.flatnonzero(np.isfinite(record.y[:, j]))
                for h in set(seen) & set(self.plant.states):
                    rows[self.plant.states.index(h)] = np.interp(at, there, record.y[there, j])
            nodes += np.array(rows).T.ravel().tolist()
        return nodes

    def result(self, best: Solution, ended: Sequence[Solution]) -> Fit:
        """The fit with what the records tell of it."""
        known = information(self.problem, best.unknowns, self.solver.unit)
        count, inner = len(self.free), len(self.chosen)
        follow = [alike(e) for e in self._influences(known.outputs)]
        deviations, untold = self._deviations(known, max(follow), best.unknowns)
        estimates = tuple(self._estimate(i, best.unknowns[i], deviations[i]) for i in range(count + len(self.offset)))
        *_, nodes = self.problem.parts(ca.DM(best.unknowns))
        names = list(map(str, self.given.states))
        first = (dict(zip(names, at[: len(names), 0].full().ravel().tolist(), strict=True)) for at in nodes)
        still = replace(self, plant=self.given, chosen=(), lags=(), offset=(), corner=None)
        before = information(still.problem, still.solver.solve(still.nominal).unknowns, still.solver.unit)
        return Fit(
            valued(self.given, {e.name: e.value for e in estimates[:inner]}),
            estimates[:inner],
            tuple(replace(e, name=y) for e, y in zip(estimates[inner:count], self._lagging, strict=True)),
            estimates[count:],
            tuple(first),
            tuple(record.y - e for record, e in zip(self.records, known.residuals, strict=True)),
            self._by_output(map(_rms, known.outputs)),
            self._by_output(np.nanstd(np.concatenate([record.y for record in self.records]), axis=0).tolist()),
            self._by_output(map(_rms, before.outputs)),
            self._by_output(follow),
            untold,
            self._confined(best.unknowns),
            tuple(ended),
            self._by_output(float(np.mean(np.abs(e) > WRONG * deviation(e))) for e in known.outputs),
        )

    def _deviations(
        self, known: Information, together: float, unknowns: Array
    ) -> tuple[Array, tuple[dict[str, float], ...]]:
        """The standard errors of parameters and offsets, in their units, and the directions that are not told, in units
        of ranges; of a parameter without a range, in units of the value that is larger, the nominal or the fitted. What
        lies at an end of its range is held there, without a standard error."""
        every_name = [*map(str, self.free), *(f"offset of {y}" for y in self.offset)]
        inner = np.array([not self._end(i, value) for i, value in enumerate(unknowns[: len(every_name)])])
        names = [name for name, within in zip(every_name, inner, strict=True) if within]
        before = self.solver.unit[: len(inner)][inner]
        ranged = np.array([*(p.bounded for p in self.free), *[True] * len(self.offset)])[inner]
        unit = np.where(ranged, before, np.maximum(before, np.abs(unknowns[: len(inner)][inner])))
        every = np.concatenate(self._influences(known.outputs))
        fitted = len(names) + self.problem.n * len(self.records)  # numbers that took a residual each
        left = len(every) - fitted
        noise = max(float(every @ every) / left * together, np.finfo(float).tiny) if left > 0 else math.inf
        weights, V = np.linalg.eigh(known.M[np.ix_(inner, inner)] * np.outer(unit / before, unit / before) / noise)
        weights = np.where(weights > ROUNDED * weights.max(initial=0.0), weights, np.finfo(float).tiny)
        errors = 1 / np.sqrt(weights)
        sure = errors <= UNTOLD
        spread = np.sqrt(V[:, sure] ** 2 @ errors[sure] ** 2) * unit
        deviations = np.full(len(inner), math.inf)
        deviations[inner] = np.where((np.abs(V[:, ~sure]) > PART).any(axis=1), math.inf, spread)
        parts = (V[:, k] * np.sign(V[np.argmax(np.abs(V[:, k])), k]) for k in np.flatnonzero(~sure))
        return deviations, tuple(
            {name: float(part) for name, part in zip(names, direction, strict=True) if abs(part) > PART}
            for direction in parts
        )

    @property
    def _lagging(self) -> list[str]:
        """The outputs that lag, by name."""
        pairs = zip(self.plant.outputs, self.given.output, self.plant.output, strict=True)
        return [y.name for y, h, behind in pairs if h != behind]

    def _confined(self, unknowns: Array) -> tuple[str, ...]:
        room = np.minimum(unknowns - self.solver.low, self.solver.high - unknowns) / self.solver.unit
        nodes = room[len(self.free) + len(self.offset) :].reshape(-1, self.problem.n)
        return tuple(x.name for x, least in zip(self.plant.states, nodes.min(axis=0), strict=True) if least <= AT)

    def _estimate(self, i: int, value: float, deviation: float) -> Estimate:
        at = self._end(i, value)
        if i >= len(self.free):
            y = self.offset[i - len(self.free)]
            return Estimate(y.name, float(value), 0.0, float(deviation), y.unit, at)
        p = self.free[i]
        within = float(np.clip(value, *_bounds(p)))
        return Estimate(p.name, within, float(p.nominal or 0.0), float(deviation), p.unit, at)

    def _end(self, i: int, value: float) -> Place:
        low, high, width = self.solver.low[i], self.solver.high[i], AT * self.solver.unit[i]
        return "low" if value <= low + width else "high" if value >= high - width else ""

    def _by_output(self, values: Iterable[float]) -> dict[str, float]:
        return dict(zip(map(str, self.plant.outputs), values, strict=True))


def _rms(e: Array) -> float:
    return float(np.sqrt(np.mean(e**2)))


def _bounds(p: Signal) -> tuple[float, float]:
    if p.bounded:
        return p.interval
    ends = (float(p.nominal or 0.0) / WIDE, float(p.nominal or 0.0) * WIDE)
    return min(ends), max(ends)


def _unit(s: Signal) -> float:
    """The size of a signal: the width of its range, else its nominal value, else 1."""
    low, high = s.interval
    return high - low if s.bounded else abs(s.nominal or 0.0) or 1.0


def _free(plant: System, free: Iterable[str | Signal] | None) -> tuple[Signal, ...]:
    """The parameters that are fitted. Raises: `CannotFit`."""
    if plant.origin is not None:
        raise CannotFit(f"plant {plant.name!r}", "is recast; fit the plant that it was recast from")
    chosen = _named("parameter", free, plant.parameters) if free is not None else ()
    chosen = chosen if free is not None else tuple(p for p in plant.parameters if p.bounded)
    if not chosen:
        listed = ", ".join(map(str, plant.parameters)) or "none"
        reason = f"has no parameter with a range; name those that are unknown, --free a,b or free=, among {listed}"
        raise CannotFit(f"plant {plant.name!r}", reason)
    for p in chosen:
        if not p.bounded and not p.nominal:
            raise CannotFit(f"parameter {p.name!r}", "is 0 and has no range; declare low= and high=")
        if p.bounded and p.low == p.high:
            raise CannotFit(f"parameter {p.name!r}", "has a range of one point; widen it, or leave it out")
    return chosen


def _named(what: str, names: Iterable[str | Signal], signals: Sequence[Signal]) -> tuple[Signal, ...]:
    """The signals of these names, in their own order. Raises: `CannotFit`."""
    wanted = {str(name) for name in ((names,) if isinstance(names, str | Signal) else names)}
    known = [s.name for s in signals]
    for name in sorted(wanted.difference(known)):
        listed = f"there are {', '.join(known)}" if known else "there is none"
        raise CannotFit(f"{what} {name[:60]!r}", f"is unknown; {nearest(name, known, listed)}")
    return tuple(s for s in signals if s.name in wanted)
