"""Measured logs as arrays, their validation, and the cross-validated error of a step's predictions or estimates,
segment by segment.

    E_s = mean over j of the mean over segment s of (e_j/c_j)^2

with the errors e_j of predictions of the outputs, h samples ahead, or of hidden states whose truth was measured, and

    c_j^2 = mean over all logs of (y_j(k+h) - y_j(k))^2,   or of (x_j(k) - mean of x_j)^2

so that copying the last value, or the mean, has E = 1. A signal that is constant in a log does not count there, nor
does a segment without comparable samples. Cross-validation: a gain is chosen on all segments but one and judged on that
one; its error is the root of the mean over the segments.
"""

import math
import warnings
from collections.abc import Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, TypeVar

import numpy as np

from hgogen import forms
from hgogen.analysis.dynamics import HUGE
from hgogen.call import CallableStep
from hgogen.errors import BadArgument
from hgogen.part import SUBSTEPS
from hgogen.reading.cells import BadRecord, DateOrder, DecimalSign
from hgogen.reading.measured import PYTHON, WINDOWS, Record, Report, difference, read
from hgogen.run.backends import quickest_engine
from hgogen.run.gates import RejectsMany
from hgogen.run.prediction import forecasts
from hgogen.run.samples import Run, last_values, table
from hgogen.signal import Signal, derived, differences, in_turn, resting, supplied, times, with_times
from hgogen.stepping.guards import plausible_range, readings
from hgogen.system import System

LEAST = 10  # least number of samples of an output
UNEVEN, ROUNDING = 100, 1e-9  # ratio of the longest to the shortest dt of a step, at most; of a time


class BadLog(BadArgument):
    """The error for a log from which nothing can be learned about a plant."""


@dataclass(frozen=True, eq=False)
class Log:
    """A measured log: u (N, m), finite, and y (N, p), NaN for missing samples, with the period dt; `start`: the time t
    of the first sample, for a plant with functions of t; `times` (N): the times of the samples of an irregular log,
    whose `dt` is a typical step."""

    u: np.ndarray
    y: np.ndarray
    dt: float
    start: float = 0.0
    times: np.ndarray | None = None

    @property
    def elapsed(self) -> np.ndarray:
        """The time (N) since the previous sample, 0 at the first."""
        return np.concatenate([[0.0], self.ahead[:-1]])

    def given(self, step: CallableStep) -> np.ndarray | None:
        """Return the argument `dt` of `step.run`: the elapsed times for a step with varying dt, None for a step with a
        constant period."""
        return self.elapsed if step.clock.varying else None

    @property
    def ahead(self) -> np.ndarray:
        """The time (N) from each sample to the next, dt after the last."""
        return np.full(len(self.y), self.dt) if self.times is None else np.diff(self.times, append=self.end)

    @property
    def end(self) -> float:
        """The end time of the log: dt after the last sample."""
        return self.start + len(self.y) * self.dt if self.times is None else float(self.times[-1] + self.dt)

    @property
    def duration(self) -> float:
        """The length of the log in time, from the first sample to dt after the last."""
        return float(self.ahead.sum())

    def since(self, first: int) -> "Log":
        """Return the log from the sample `first` on."""
        at = self.start + first * self.dt if self.times is None else self.start + self.times[first] - self.times[0]
        times = None if self.times is None else self.times[first:]
        return replace(self, u=self.u[first:], y=self.y[first:], start=float(at), times=times)

    def of(self, inputs: Sequence[Signal]) -> "Log":
        """Return the log with a column for each of the `inputs` that a form reads: the plant's inputs, which the log
        holds, then their derivatives (by differences) and times."""
        of_caller, sources = supplied(inputs), derived(inputs)
        columns = {u.name: u.unwrapped(column) for u, column in zip(of_caller, self.u.T, strict=False)}
        names = (sources[u.name] for u in of_caller[len(columns) :])
        elapsed = self.dt if self.times is None else self.elapsed
        rates = [difference(columns[name], order, elapsed) for name, order in names]
        begins = [self.start] * len(times(inputs))
        passed = self.dt * np.arange(len(self.y)) if self.times is None else self.times - self.times[0]
        return replace(self, u=with_times(inputs, np.column_stack([self.u, *rates]), begins, passed))


def step_limits(logs: Iterable[Log]) -> tuple[float, float] | None:
    """Return the shortest and the longest dt of a step for irregular logs, with at most `SUBSTEPS` sub-steps between
    two samples; None if all logs have a constant period."""
    logs = list(logs)
    if all(log.times is None for log in logs):
        return None
    spacings = np.concatenate([log.ahead[:-1] for log in logs])
    longest = max(float(np.median(spacings)), (1 + ROUNDING) * float(spacings.max()) / SUBSTEPS)
    return min(max(float(spacings.min()), longest / UNEVEN), longest / 2), longest


def validated_log(plant: System, record: Log, number: int) -> Log:
    """Return the log after validation, as tables of numbers; a missing input repeats the last value, and periodic
    signals lie within their period. `number`: that of the log in messages. Raises: `BadLog`, `BadShape`."""
    y = table("y", record.y, plant.outputs, None)
    u = in_turn(plant.supplied, table("u", record.u, plant.supplied, len(y)), Signal.reduced)
    name = f"record {number}"
    if isinstance(record.dt, str) or not 0 < record.dt < math.inf:
        raise BadLog(name, f"has the period {record.dt!s:.60}; give a positive time")
    y = in_turn(plant.outputs, np.where(np.isfinite(y), y, np.nan), Signal.reduced)
    for signal, column in zip(plant.outputs, y.T, strict=True):
        if np.isfinite(column).sum() < LEAST:
            raise BadLog(name, f"has fewer than {LEAST} samples of {signal.name}; give a longer one")
    filled = last_values(u)
    if not math.isfinite(record.start):
        raise BadLog(name, f"has the start {record.start!s:.60}; give a finite time")
    if record.times is not None:
        at = np.asarray(record.times, dtype=float)
        if at.shape != (len(y),) or not np.isfinite(at).all() or np.any(np.diff(at) <= 0):
            raise BadLog(name, f"has times of shape {at.shape}; give {len(y)} that ascend, one for each sample")
        record = replace(record, times=at)
        if plant.discrete:
            reason = f"has samples at times of its own, and {plant.name} is discrete in time; give one of one period"
            raise BadLog(name, reason)
    return replace(record, u=np.where(np.isfinite(filled), filled, list(map(resting, plant.supplied))), y=y)


def reading_of(state: Signal, y: Signal, values: Any) -> Any:
    """Return the values of a state that its output `y` measures. Of a periodic output, that turn is meant which is
    nearest to the middle of the state's range; the values of a periodic state lie within its period."""
    return state.turned(y.nearest(values, middle_of(state)))


def middle_of(signal: Signal) -> float:
    """Return the middle of a signal's declared range, 0 without a range."""
    return sum(signal.interval) / 2 if signal.bounded else 0.0


def range_warnings(plant: System, record: Log, faulty: Collection[str] | None = None) -> Iterator[str]:
    """Yield a sentence for each output that measures a state outside of its declared range, with the plausible cause;
    `faulty`: the signals with a fault, None if no observer judged the log."""
    for y, h, column in zip(plant.outputs, plant.output, record.y.T, strict=True):
        state = next((x for x in plant.states if x == h and x.bounded), None)
        if state is None:
            continue
        low, high = state.limits
        outside = reading_of(state, y, column)
        outside = outside[(outside < low) | (outside > high)]
        if len(outside):
            farthest = outside[np.argmax(np.maximum(low - outside, outside - high))]
            cause = "widen it, if the unit and the sign are right"
            if faulty is not None:
                ends = wider(low, high, float(outside.min()), float(outside.max()))
                fits = f"no fault of it is found, so that the range is too small: {ends} of {state.name}"
                cause = f"the faults of {', '.join(faulty)} come first; then widen it" if faulty else fits
            yield (
                f"{y.name} leaves the declared range of {state.name}, {low:g}..{high:g}, in {len(outside)} of "
                f"{len(column)} samples, as far as {farthest:.4g}: {cause}"
            )


def wider(low: float, high: float, least: float, largest: float) -> str:
    """Return the text, as in a model file, of the changed ends of a range `low`..`high` that contains the values
    `least` to `largest`, with a margin of a tenth of its width; an end does not cross 0."""
    spare, unit, ends = 0.1 * (high - low), 10.0 ** (math.floor(math.log10(high - low)) - 1), []
    if least < low:
        first = math.floor((least - spare) / unit) * unit
        ends.append(f"low = {0 if least >= 0 > first else first:.6g}")
    if largest > high:
        last = math.ceil((largest + spare) / unit) * unit
        ends.append(f"high = {0 if largest <= 0 < last else last:.6g}")
    return ", ".join(ends)


class BadSignal(BadArgument):
    """The error for a name that is no signal of the plant."""


def record(
    source: Any,
    plant: System,
    *,
    dt: float | None = None,
    time: str | None = None,
    period: float | None = None,
    columns: Mapping[str, str] | None = None,
    shift: Mapping[str, int] | None = None,
    between: Literal["line", "hold", "forward"] = "line",
    decimal: DecimalSign | None = None,
    dates: DateOrder | None = None,
) -> Log:
    """Return the log in a file (text, Parquet, MAT, Excel, ULog or MDF) or a DataFrame, resampled with the period `dt`,
    by default with its own period; an irregular log has by default the times of its rows.

    `time`: the column of times, or an expression, or `period`, the time between rows; `columns`: the column of each
    signal, or an expression of columns as for --map, by default the column of its name; `shift`: samples by which a
    signal is delayed. An input that is logged faster than dt, or irregularly, is averaged: over half a step to both
    sides ("line"), or over the step before ("hold", as the observer's step uses it) or after ("forward", as `hg.fit`
    does). `decimal`: "." or ",", and `dates`: "dmy", "mdy" or "ymd", where the cells of a text do not tell.

    Raises: `BadRecord`; `NotInstalled` for a file whose library is missing.
    """
    signals = {s.name: s for s in (*plant.supplied, *plant.outputs)}
    columns, shift = columns or {}, shift or {}
    if unknown := [name for name in (*columns, *shift) if name not in signals]:
        raise BadSignal(unknown[0], f"is no signal; the signals are {', '.join(signals)}")
    inputs = {s.name: WINDOWS[between] for s in plant.supplied}
    wanted = {name: columns.get(name, name) for name in signals}
    words: dict[str, Any] = {"time": time, "period": period, "unit": plant.time, "signals": signals, "caller": PYTHON}
    words |= {"own_times": "irregular", "decimal": decimal, "dates": dates}
    got = read(source, wanted, dt=dt, inputs=inputs, **words).shifted(shift, plant.supplied)
    demand_regular(plant, got.report)
    return log_of(got, plant)


def log_of(record: Record, plant: System | None = None, rows: int | None = None) -> Log:
    """Return the log of a plant from a file's contents `record`, only its first `rows` if set; without a plant a log
    without signals."""
    inputs, outputs = (plant.supplied, plant.outputs) if plant else ((), ())
    u, y, t = (each[:rows] for each in (record.of(inputs), record.of(outputs), record.t))
    return Log(u, y, record.report.dt, float(record.t[0]), t if record.report.spacing else None)


def demand_regular(plant: System, report: Report) -> None:
    """Raise `BadRecord` for a discrete plant and a log with rows that are not `dt` apart, since a map advances by one
    period. Rows that are missing in the grid are missing samples."""
    if not plant.discrete:
        return
    if report.spacing:
        rows = f"rows {report.spacing[0]:g} to {report.spacing[1]:g} {report.unit} apart"
        raise BadRecord(report.path, f"has {rows}, and {plant.name} is discrete in time; resample it, by --dt (dt=)")
    uneven = report.shift > JITTER * report.dt or report.surplus or abs(report.period - report.dt) > JITTER * report.dt
    if uneven:
        rows = f"rows every {report.period:g} {report.unit}, up to {report.shift:.3g} off the grid of {report.dt:g}"
        fix = "resample it, or write the plant as differential equations"
        raise BadRecord(report.path, f"has {rows}, and {plant.name} is discrete in time; {fix}")


SMALLEST, FINEST, WHOLE = 1e-9, 4, 0.02  # gaps over the range that are rounding; parts of a gap; share of a quantum


def quantum_of(values: np.ndarray) -> float:
    """Return the quantum of a sensor or of a file's digits: the largest q such that all differences of the `values` (N)
    are whole multiples of q; 0 if there is none."""
    present = values[np.isfinite(values)]
    levels = np.unique(present)
    gaps = np.diff(levels)
    gaps = gaps[gaps > SMALLEST * np.ptp(levels)] if len(gaps) else gaps
    if len(gaps) < (2 if len(levels) < len(present) / 2 else LEAST):  # with few gaps any numbers are multiples
        return 0.0
    for parts in range(1, FINEST + 1):
        q = float(gaps.min()) / parts
        counts = gaps / q
        off = np.abs(counts - np.rint(counts))
        if np.all(off < WHOLE):
            return float(np.sum(gaps) / np.rint(counts).sum())
    return 0.0


JITTER = 0.05  # of the period: a row farther off the grid is of another time
Array = np.ndarray
Key = TypeVar("Key", bound=Hashable)
AS_WELL = 1.05  # factor between errors that count as equal
ALIKE = 2e-3  # relative difference of E by rounding: a thousandth of an error
BEGIN = 0.05  # share of a log at its beginning, in which an estimate may converge


@dataclass(frozen=True)
class PredictionCriterion:
    """A criterion by which gains are judged: the errors of predictions `samples` samples ahead, relative to those of
    copying the last value. An error is NaN without a sample to compare, infinite if the estimate diverged; `outputs`:
    the signals of y."""

    samples: int
    outputs: tuple[Signal, ...] = ()

    def rival(self, records: Sequence[Log]) -> list[Array]:
        """Return for each log the squared errors (N, p) of copying, (y_j(k+h) - y_j(k))^2; y_j(k) is the last value up
        to sample k."""
        h, rival_squares = self.samples, []
        for record in records:
            squares = np.full(record.y.shape, np.nan)
            later = record.y[h:]
            squares[h:] = differences(self.outputs, later, last_values(record.y)[: len(later)]) ** 2
            rival_squares.append(squares)
        return rival_squares

    def errors(self, k: int, step: CallableStep, run: Run, record: Log) -> Array:
        """Return the errors e_j(k+h|k) (N, p) of predictions h samples ahead from the run of a step along a log, at
        samples that the step used; `k`: the number of the log."""
        one = next(forecasts(step, run, record.u, record.y, (self.samples,)))
        return np.where(one.compared, np.where(np.isfinite(one.model), one.model, np.inf), np.nan)


@dataclass(frozen=True, eq=False)
class HiddenStateCriterion:
    """A criterion by which gains are judged: the estimation errors of hidden states, relative to the states' deviations
    from their mean; `truth`: for each log the courses (N) by state, NaN for missing samples; `states`: their
    signals."""

    truth: tuple[Mapping[str, Array], ...]
    states: tuple[Signal, ...]

    def rival(self, records: Sequence[Log]) -> list[Array]:
        """Return for each log the squared deviations (N, q) from the mean, (x_j - mean of x_j)^2."""
        tables = [np.column_stack(list(each.values())) for each in self.truth]
        means = np.array([x.mean(column) for x, column in zip(self.states, np.concatenate(tables).T, strict=True)])
        return [differences(self.states, table, np.broadcast_to(means, table.shape)) ** 2 for table in tables]

    def errors(self, k: int, step: CallableStep, run: Run, record: Log) -> Array:
        """Return the estimation errors (N, q) of a run along log number k."""
        return np.column_stack([run.off(state, true) for state, true in self.truth[k].items()])


@dataclass(frozen=True)
class Judge:
    """A judge of steps by the logs `records`: the criterion `yardstick` (prediction errors, or errors of hidden
    states), and the number of `segments` in a log of mean length."""

    records: Sequence[Log]
    yardstick: PredictionCriterion | HiddenStateCriterion
    segments: int

    def errors(self, step: CallableStep) -> Array:
        """Return for each comparable segment s of all logs the relative mean square error of a step, infinite if the
        estimate diverged:

            E_s = mean over j of the mean over segment s of (e_j/c_j)^2

        Predictions more than one sample ahead are averaged with those of a second run, which begins in the middle of
        the log with a wrong initial state. Otherwise a model that is never corrected, begun in the right state, would
        be the best.
        """
        errors = []
        with np.errstate(all="ignore"), warnings.catch_warnings(action="ignore", category=RejectsMany):
            for k, (scale, parts) in enumerate(zip(self._scales, self._parts, strict=True)):
                squares, N = self._squares(k, step, 0), len(self.records[k].y)
                middle, settled = N // 2, N // 2 + round(BEGIN * N)
                if isinstance(self.yardstick, PredictionCriterion) and 1 < self.yardstick.samples < N - settled:
                    squares[settled:] += self._squares(k, step, middle)[settled - middle :]
                    squares[settled:] /= 2
                if np.isinf(squares).any():
                    errors.append(np.full(len(parts), np.inf))
                    continue
                means = [[_mean(column) for column in (squares / scale)[part].T] for part in parts]
                each = np.array([_mean(np.array(columns)) for columns in means])
                errors.append(np.where(np.isnan(each), np.inf, each))
        return np.concatenate(errors)

    def _squares(self, k: int, step: CallableStep, first: int) -> Array:
        """Return the squared errors (N, q) of a step that begins at the sample `first` of log number k; all infinite if
        the estimate diverged."""
        record = self.records[k].of(step.inputs).since(first)
        engine = quickest_engine(step, sum(len(each.y) for each in self.records))
        step.reset(record.start)
        run = step.run(u=record.u, y=record.y, engine=engine, dt=record.given(step))
        squares = self.yardstick.errors(k, step, run, record) ** 2
        return squares if np.isfinite(run.x).all() else np.full(squares.shape, np.inf)

    @property
    def most(self) -> int:
        """The largest number of segments in a log of mean length such that no segment is empty."""
        lengths = list(map(len, self._rival_squares))
        return min(math.floor((n - round(BEGIN * n)) * sum(lengths) / (len(lengths) * n)) for n in lengths)

    @property
    def count(self) -> int:
        """The number of segments of all logs that have samples to compare."""
        return sum(map(len, self._parts))

    @cached_property
    def _rival_squares(self) -> list[Array]:
        return self.yardstick.rival(self.records)

    @cached_property
    def _scales(self) -> list[Array]:
        """The mean squares c_j^2 (q), one row for each data log, of the
        errors without a model (copying the last value, or the mean); NaN
        for a signal that is constant in the log or never compared."""
        whole = np.array([_mean(column) for column in np.concatenate(self._rival_squares).T])
        moving = [np.array([_mean(column) > 0 for column in squares.T]) for squares in self._rival_squares]
        return [np.where(moving_signals, whole, np.nan) for moving_signals in moving]

    @cached_property
    def _parts(self) -> list[list[Array]]:
        """The numbers of the samples in each segment that has samples to compare, by
        data log. A log has segments in proportion to its length, at least one."""
        every, mean = [], sum(map(len, self._rival_squares)) / len(self._rival_squares)
        for squares, scale in zip(self._rival_squares, self._scales, strict=True):
            there = np.isfinite(squares / scale).any(axis=1)
            count = max(1, round(self.segments * len(squares) / mean))
            parts = np.array_split(np.arange(round(BEGIN * len(squares)), len(squares)), count)
            every.append([part for part in parts if there[part].any()])
        return every


def _mean(values: Array) -> float:
    there = values[np.isfinite(values)]
    return float(there.mean()) if len(there) else np.nan


def chosen(errors: Mapping[Key, Array]) -> tuple[Key, Array]:
    """Return the key of the candidate whose mean error is least, and the cross-validated error of each segment: that of
    the candidate that is best on all other segments; `errors`: squared errors by segment for each candidate."""
    keys, table = list(errors), np.array(list(errors.values()))
    segments = range(table.shape[1])
    judged = [table[int(np.argmin(np.delete(table, s, axis=1).sum(axis=1))), s] for s in segments]
    return keys[int(np.argmin(table.sum(axis=1)))], np.array(judged)


def as_good(errors: Array, best: Array) -> bool:
    """Return whether the squared `errors` by segment exceed the `best` by at most one standard error (the rule of
    Breiman, Friedman, Olshen, Stone, Classification and Regression Trees, 1984), and their root by at most 5 %. The
    standard error is that of the paired differences or that of the best, whichever is less, so that a candidate with
    scattered errors is not preferred. Differences by rounding are ignored."""
    difference = errors - best
    scatter = min(difference.std(ddof=1), best.std(ddof=1)) / np.sqrt(len(difference))
    limit = min(scatter, (AS_WELL**2 - 1) * best.mean())
    return bool(difference.mean() <= max(limit, ALIKE * best.mean()))


def clearly_worse(errors: Array, best: Array) -> bool:
    """Return whether a candidate is clearly worse: the RMS of its `errors` (squared, by segment) exceeds that of the
    `best` by more than 5 %, and the mean by more than one standard error of the paired differences."""
    difference = errors - best
    scatter = difference.std(ddof=1) / np.sqrt(len(difference))
    return bool(errors.mean() > AS_WELL**2 * best.mean() and not difference.mean() <= scatter)


def readable(plant: System, record: Log, number: int) -> Log:
    """Return log number `number` without the samples that a step rejects, those outside of an output's plausible range.
    Raises: `BadLog`, `BadShape`."""
    ranges = readings(forms.original(plant))
    pairs = [plausible_range(y, ends) for y, ends in zip(plant.outputs, ranges, strict=True)]
    low, high = np.clip(np.array(pairs).T, -HUGE, HUGE)
    there = validated_log(plant, record, number)
    y = np.where((there.y >= low) & (there.y <= high), there.y, np.nan)
    for signal, ends, admitted, column in zip(plant.outputs, ranges, y.T, there.y.T, strict=True):
        if np.isfinite(admitted).sum() < LEAST:
            values, name = column[np.isfinite(column)], signal.name
            lost, (least, most) = len(values) - int(np.isfinite(admitted).sum()), np.quantile(values, (0.05, 0.95))
            raise BadLog(
                f"record {number}",
                f"has {len(values)} samples of {name}, of which {lost} would be rejected: they lie about "
                f"{least:.4g}..{most:.4g}, and the model reads {ends[0]:g}..{ends[1]:g}; check column, unit and sign, "
                f"or widen the range of {name}",
            )
    return replace(there, y=y)
