"""Parameters of a plant from measured records, with what the records tell of them.

A sensor may lag, y' = (h(x, u) - y)/tau, with tau an unknown of the fit. Less than half a sample of it cannot be told
from none, and of more than a quarter of a record too little is seen.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import casadi as ca
import numpy as np

from hgogen.logs.problem import Information, Predicting, Problem, Shooting, paced
from hgogen.logs.records import BadLog, Log, demanded
from hgogen.logs.result import FINE, SAME, Estimate, Fit, Place, Structure, above, parted, structure
from hgogen.logs.solution import Progress, Searches, Solution, Solver, digests
from hgogen.reading.given import asks_a_plant, count, signals_named, switches
from hgogen.run.consistency import CORNER, WRONG, alike, corner, deviation, whiteness
from hgogen.signal import Signal, resting
from hgogen.system import System, valued

BETWEEN, BY = ("hold", "line"), ("simulation", "prediction")
EQUAL = 1e-6  # of a cost, as in `above`: less is rounding, and the first start, that of the nominal values, counts
AGAIN = 4  # passes of a robust fit, each with the corner of the last one's residuals
LEAST, FIRST, MOST = 0.5, 2.0, 0.25  # of tau: of a sample; of a sample; of a record
SEGMENTS = 60  # of a record, about
WIDE = 100.0  # times its nominal value, to which a parameter without a range may go, and the same part of it
GROWN = 3.0  # of log growth in a segment, at most
PART = 0.05  # of a direction: less of a parameter in it is none
UNTOLD = 1.0  # of a unit: a direction with a larger standard error is not told by the records
ROUNDED = 1e-10  # of the largest eigenvalue of the information: less is rounding
AT = 1e-6  # of a unit, from the end of a range
Array = np.ndarray


class CannotFit(BadLog):
    """Records from which the parameters cannot be fitted, or parameters that cannot be."""


@dataclass(frozen=True, eq=False)
class Task:
    """What is fitted to what: `plant` with the lags of its sensors, of `given` without; `chosen`: its parameters that
    are fitted beside the `lags`; `by`: one of `BY`; `corner`: of the loss of each output, None for squares."""

    given: System
    plant: System
    chosen: tuple[Signal, ...]
    lags: tuple[Signal, ...]
    records: tuple[Log, ...]
    offset: tuple[Signal, ...]
    between: str
    by: str
    corner: Array | None = None

    @property
    def free(self) -> tuple[Signal, ...]:
        """The parameters that are fitted."""
        return (*self.chosen, *self.lags)

    @cached_property
    def spread(self) -> Array:
        """Of the samples of each output, about their mean."""
        return np.asarray(np.nanstd(np.concatenate([record.y for record in self.records]), axis=0))

    def corners(self, unknowns: Array) -> Array:
        """The corner of the loss of each output, from its residuals there."""
        return np.array([corner(e) for e in self.problem.residuals(unknowns)])

    @cached_property
    def problem(self) -> Problem:
        """With as many Runge-Kutta steps a sample as the fastest mode asks for. Raises: `CannotFit`."""
        period = max(record.dt for record in self.records)
        steps, growing = paced(self.plant, period)
        samples = max(len(record.y) for record in self.records)
        scale = np.where(self.spread > 0, self.spread, 1.0)
        if self.by == "simulation":
            return self.shooting(scale, samples, steps, growing * period)
        parts = (self.plant, self.free, self.records, scale, samples, steps, self.between, self.offset)
        unit = np.array([_unit(x) for x in self.plant.states])
        return Predicting(*parts, unit=unit, corner=math.inf if self.corner is None else CORNER)

    def shooting(self, scale: Array, samples: int, steps: int, growing: float) -> Problem:
        """In segments in which errors, `growing` in a sample, do so by no more than exp(GROWN)."""
        length = math.ceil(samples / SEGMENTS)
        length = max(1, min(length, int(GROWN / growing))) if growing else length
        parts = (self.plant, self.free, self.records, scale, length, steps, self.between, self.offset)
        return Shooting(*parts, corner=self.corner)

    @cached_property
    def solver(self) -> Solver:
        """Unknowns within their ranges, in units of these."""
        segments = sum(self.problem.segments)
        ends = [*map(_bounds, self.free), *[(-math.inf, math.inf)] * len(self.offset)]
        ends += [x.interval for x in self.plant.states] * segments
        unit = [*map(_unit, self.free), *(self.problem.scale[self.plant.outputs.index(y)] for y in self.offset)]
        unit += [_unit(x) for x in self.plant.states] * segments
        ends += [(low, high) for _, low, high in self.problem.levels]
        unit += [1.0] * len(self.problem.levels)
        low, high = np.array(ends, dtype=float).T
        return Solver(self.problem, low, high, np.array(unit))

    @property
    def nominal(self) -> Array:
        """The unknowns with the parameters at their nominal values."""
        values = [float(self.plant.nominal[p]) for p in self.free]
        levels = [start for start, _, _ in self.problem.levels]
        return np.array([*values, *[0.0] * len(self.offset), *self._nodes, *levels])

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
        for record, segments in zip(self.records, self.problem.segments, strict=True):
            at = np.arange(segments) * self.problem.length
            rows = [np.full(segments, resting(x)) for x in self.plant.states]
            for j, seen in enumerate(zip(self.given.output, self.plant.output, strict=True)):
                there = np.flatnonzero(np.isfinite(record.y[:, j]))
                for h in set(seen) & set(self.plant.states):
                    rows[self.plant.states.index(h)] = np.interp(at, there, record.y[there, j])
            nodes += np.array(rows).T.ravel().tolist()
        return nodes

    def result(self, best: Solution, ended: Sequence[Solution]) -> Fit:
        """The fit with what the records tell of it."""
        known = self.problem.information(best.unknowns, self.solver.unit)
        count, inner = len(self.free), len(self.chosen)
        follow = [alike(e) for e in known.tell]
        deviations, untold, joint = self._deviations(known, max(follow), best.unknowns)
        estimates = tuple(self._estimate(i, best.unknowns[i], deviations[i]) for i in range(count + len(self.offset)))
        *_, nodes = self.problem.parts(ca.DM(best.unknowns))
        names = list(map(str, self.given.states))
        first = (dict(zip(names, at[: len(names), 0].full().ravel().tolist(), strict=True)) for at in nodes)
        still = replace(self, plant=self.given, chosen=(), lags=(), offset=(), corner=None)
        before = still.problem.information(still.solver.solve(still.nominal).unknowns, still.solver.unit)
        return Fit(
            self.by,
            valued(self.given, {e.name: e.value for e in estimates[:inner]}),
            estimates[:inner],
            tuple(replace(e, name=y) for e, y in zip(estimates[inner:count], self._lagging, strict=True)),
            estimates[count:],
            tuple(first),
            tuple(record.y - e for record, e in zip(self.records, known.residuals, strict=True)),
            self._by_output(map(_rms, known.outputs)),
            self._by_output(self.spread.tolist()),
            self._by_output(map(_rms, before.outputs)),
            self._by_output(follow),
            untold,
            joint,
            self._confined(best.unknowns),
            tuple(ended),
            self._by_output(float(np.mean(np.abs(e) > WRONG * deviation(e))) for e in known.outputs),
            self._by_output(map(whiteness, known.tell)),
            tuple(self._rivals(best, ended, deviations)),
            self.problem.noise(best.unknowns),
        )

    def _deviations(
        self, known: Information, together: float, unknowns: Array
    ) -> tuple[Array, tuple[dict[str, float], ...], Structure | None]:
        """The standard errors of parameters and offsets, in their units, and the directions that are not told, in units
        of ranges; of a parameter without a range, in units of the value that is larger, the nominal or the fitted. What
        lies at an end of its range is held there, without a standard error. Then what no record tells, where these do
        not tell all."""
        every_name = [*map(str, self.free), *(f"offset of {y}" for y in self.offset)]
        inner = np.array([not self._end(i, value) for i, value in enumerate(unknowns[: len(every_name)])])
        names = [name for name, within in zip(every_name, inner, strict=True) if within]
        before = self.solver.unit[: len(inner)][inner]
        ranged = np.array([*(p.bounded for p in self.free), *[True] * len(self.offset)])[inner]
        unit = np.where(ranged, before, np.maximum(before, np.abs(unknowns[: len(inner)][inner])))
        every = np.concatenate(known.tell)
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
        if sure.all():
            return deviations, (), None
        free = [p for p, within in zip(self.free, inner, strict=False) if within]
        offset = [y for y, within in zip(self.offset, inner[len(self.free) :], strict=True) if within]
        joint = structure(self.plant, free, offset)
        hidden = np.array([joint is not None and name in (*joint.hidden, *joint.doubtful) for name in names])
        return deviations, tuple(_parts(names, v) for v in parted(V[:, ~sure], hidden).T), joint

    def _rivals(self, best: Solution, ended: Sequence[Solution], deviations: Array) -> Iterator[dict[str, float]]:
        """The parameters, lags and offsets of starts that cost as much as the best and lie elsewhere, by more than a
        standard error."""
        names = [
            *map(str, self.chosen),
            *(f"lag of {y}" for y in self._lagging),
            *(f"offset of {y}" for y in self.offset),
        ]
        away = np.maximum(deviations, FINE * self.solver.unit[: len(names)])
        for one in ended:
            values = one.unknowns[: len(names)]
            same = one.settled and above(self.by, one.cost, best.cost) <= SAME
            if same and (np.abs(values - best.unknowns[: len(names)]) > away).any():
                yield dict(zip(names, values.tolist(), strict=True))

    @property
    def _lagging(self) -> list[str]:
        """The outputs that lag, by name."""
        pairs = zip(self.plant.outputs, self.given.output, self.plant.output, strict=True)
        return [y.name for y, h, behind in pairs if h != behind]

    def _confined(self, unknowns: Array) -> tuple[str, ...]:
        room = np.minimum(unknowns - self.solver.low, self.solver.high - unknowns) / self.solver.unit
        count = sum(self.problem.segments) * self.problem.n
        nodes = room[self.problem.constants :][:count].reshape(-1, self.problem.n)
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

    def _by_output(self, values: Iterable[Any]) -> dict[str, Any]:
        return dict(zip(map(str, self.plant.outputs), values, strict=True))


@asks_a_plant
@switches
def fit(
    plant: System,
    *records: Log,
    free: Iterable[str | Signal] | None = None,
    offset: Iterable[str | Signal] = (),
    lag: Iterable[str | Signal] = (),
    between: Literal["hold", "line"] = "hold",
    by: Literal["simulation", "prediction"] = "simulation",
    starts: int = 3,
    seed: int = 0,
    robust: bool = False,
    each: Callable[[Progress], None] = lambda progress: None,
    resume: Progress | None = None,
) -> Fit:
    """The parameters with which the plant follows the records best.

    `records`: inputs u (N, m), outputs y (N, p), NaN where nothing was measured, and their period; `free`: the
    parameters that are fitted, by default those with a range, which bounds them; another stays within a hundredth and a
    hundred times its value. `offset`: the outputs to which an unknown constant is added; `lag`: those whose sensor
    follows by an unknown first-order lag; `between`: how inputs go on between samples; `by`: the error that is least,
    that of a "simulation", by multiple shooting, or, of a plant that noise moves or that is unstable, that of the
    "prediction" of a Kalman filter, whose noise is fitted along; `starts`: the first from the nominal values, the
    others random within the ranges, by `seed`; `robust`: a sample far off, as one of a sensor that failed, counts by
    its distance, not by its square; `each(progress)` is called after every iteration; `resume`: the progress of a fit
    of the same that was stopped, which goes on from there.

    Raises: `Misfit` for no plant; `CannotFit`; `CannotGoOn`; `BadGain` for counts and names that are none; `BadShape`,
    `BadNames` for records of another shape.
    """
    if not records or not all(isinstance(record, Log) for record in records):
        raise CannotFit("records", "are missing; give logs, such as hg.Log(u, y, dt)")
    for name, value, ways in (("between", between, BETWEEN), ("by", by, BY)):
        if value not in ways:
            raise CannotFit(f"{name}={value!r}", f"is none of {', '.join(ways)}")
    starts, seed = count("starts", starts, 1, 1000), count("seed", seed, 0, 2**53)
    chosen, logs = _free(plant, free), tuple(demanded(plant, record, k) for k, record in enumerate(records, 1))
    period, duration = max(record.dt for record in logs), min(len(record.y) * record.dt for record in logs)
    slow, lags = lagged(plant, _named("lag", lag, plant.outputs), period, duration)
    task = Task(plant, slow, chosen, tuple(lags), logs, _named("offset", offset, plant.outputs), between, by)
    options = {"free": task.free, "offset": task.offset, "between": between, "by": by, "starts": starts, "seed": seed}
    searches = Searches(digests(plant, logs, {**options, "robust": robust}), each, resume)
    return _best(task, searches, starts, np.random.default_rng(seed), AGAIN if robust else 0)


def lagged(plant: System, outputs: Sequence[Signal], period: float, duration: float) -> tuple[System, list[Signal]]:
    """The plant with a state for each of these outputs, and the lags tau as parameters, in the order of the outputs.

    `period`, `duration`: of a sample and of the shortest record, in the plant's time.
    """
    low, high = LEAST * period, max(MOST * duration, 2 * FIRST * period)
    flow, output, states, lags = list(plant.flow), list(plant.output), list(plant.states), list[Signal]()
    for y in outputs:
        behind = Signal(f"{y.name}_behind", y.unit, f"{y.name} as its sensor shows it")
        tau = Signal(f"lag_of_{y.name}", plant.time, f"lag of the sensor of {y.name}", FIRST * period, low, high)
        row = plant.outputs.index(y)
        flow.append((output[row] - behind) / tau)
        output[row] = behind
        states.append(behind)
        lags.append(tau)
    parameters = (*plant.parameters, *lags)
    slow = replace(plant, states=tuple(states), parameters=parameters, flow=tuple(flow), output=tuple(output))
    return slow, lags


def _best(task: Task, searches: Searches, starts: int, draw: np.random.Generator, passes: int) -> Fit:
    """Of the best of the starts; of a robust fit after more passes from there, since the residuals of least squares are
    those of outliers too. Raises: `CannotFit`."""
    ended: tuple[Solution, ...] = ()
    for begin in [task.nominal, *(task.drawn(draw) for _ in range(starts - 1))]:
        ended = searches.solved(task.solver, begin, ended)
    best = best_of(task.by, ended)
    if best is None:
        raise CannotFit(f"plant {task.given.name!r}", "has no finite residuals from any start; narrow the ranges")
    for _ in range(passes):
        task = replace(task, corner=task.corners(best.unknowns))
        ended = searches.solved(task.solver, best.unknowns, ended)
        best = ended[-1]
    return task.result(best, (best,) if passes else ended)


def best_of(by: str, ended: Sequence[Solution]) -> Solution | None:
    """That of the least cost among those that settled, else among the others; of equal ones the first. None where no
    cost is finite."""
    finite = [one for one in ended if np.isfinite(one.cost)]
    settled = [one for one in finite if one.settled] or finite
    least = min((one.cost for one in settled), default=0.0)
    return next((one for one in settled if above(by, one.cost, least) <= EQUAL), None)


def _free(plant: System, free: Iterable[str | Signal] | None) -> tuple[Signal, ...]:
    what = f"plant {plant.name!r}"
    if plant.origin is not None:
        raise CannotFit(what, "is recast; fit the plant that it was recast from")
    chosen = plant.tunable if free is None else _named("parameter", free, plant.parameters)
    if not plant.parameters:
        raise CannotFit(what, "has no parameter; declare what is unknown as one, with low= and high=")
    if not chosen:
        listed = ", ".join(map(str, plant.parameters))
        reason = f"has no parameter with a range; name those that are unknown, --free a,b or free=, among {listed}"
        raise CannotFit(what, reason)
    for p in chosen:
        if not p.bounded and not p.nominal:
            raise CannotFit(f"parameter {p.name!r}", "is 0 and has no range; declare low= and high=")
        if p.bounded and p.low == p.high:
            raise CannotFit(f"parameter {p.name!r}", "has a range of one point; widen it, or leave it out")
    return chosen


def _named(what: str, names: Iterable[str | Signal], signals: Sequence[Signal]) -> tuple[Signal, ...]:
    return signals_named(what, names, signals, lambda name, fix: CannotFit(f"{what} {name!r}", f"is unknown; {fix}"))


def _parts(names: Sequence[str], direction: Array) -> dict[str, float]:
    """The parts of a direction, the largest positive."""
    signed = direction * np.sign(direction[np.argmax(np.abs(direction))])
    return {name: float(part) for name, part in zip(names, signed, strict=True) if abs(part) > PART}


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
