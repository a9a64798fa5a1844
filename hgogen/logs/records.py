"""Measured records as arrays, what is demanded of them, and how well a step predicts them, or estimates a truth in
them, segment by segment.

    E_s = mean over j of the mean over segment s of (e_j/c_j)^2

with the errors e_j of predictions of the outputs, h samples ahead, or of hidden states whose truth was measured, and

    c_j^2 = mean over all records of (y_j(k+h) - y_j(k))^2,   or of (x_j(k) - mean of x_j)^2

so that copying the last value has 1, or the mean. What stands still in a record has no c_j and does not count there,
nor does a segment in which nothing can be compared. A gain is chosen on the segments but one, and judged by that one;
what is said of it is the root of the mean of these judgements (cross-validation).
"""

import math
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, TypeVar

import numpy as np

from hgogen import forms
from hgogen.analysis.dynamics import HUGE
from hgogen.call import CallableStep
from hgogen.errors import BadArgument
from hgogen.reading.measured import PYTHON, WINDOWS, difference, read
from hgogen.run.prediction import forecasts
from hgogen.run.samples import Engine, Run, last_values, table
from hgogen.signal import Signal, derived, resting
from hgogen.stepping.guards import readings
from hgogen.system import System

LEAST = 10  # samples of an output


class BadLog(BadArgument):
    """Records from which nothing can be learned of a plant."""


@dataclass(frozen=True, eq=False)
class Log:
    """A record: u (N, m), finite, and y (N, p), NaN where nothing was measured, a period dt apart."""

    u: np.ndarray
    y: np.ndarray
    dt: float

    def of(self, inputs: Sequence[Signal]) -> "Log":
        """The record with a column for each of the inputs that a form reads: those of the plant, which it holds, and
        behind them derivatives of these, as differences."""
        count, sources = self.u.shape[1], derived(inputs)
        columns = dict(zip((u.name for u in inputs), self.u.T, strict=False))
        rates = [difference(columns[name], order, self.dt) for name, order in (sources[u.name] for u in inputs[count:])]
        return replace(self, u=np.column_stack([self.u, *rates]))


def demanded(plant: System, record: Log, number: int) -> Log:
    """The record as tables of numbers, a missing input as the last one there was. Raises: `BadLog`, `BadShape`."""
    y = table("y", record.y, plant.outputs, None)
    u = table("u", record.u, plant.inputs, len(y))
    name = f"record {number}"
    if isinstance(record.dt, str) or not 0 < record.dt < math.inf:
        raise BadLog(name, f"has the period {record.dt!s:.60}; give a positive time")
    y = np.where(np.isfinite(y), y, np.nan)
    for signal, column in zip(plant.outputs, y.T, strict=True):
        if np.isfinite(column).sum() < LEAST:
            raise BadLog(name, f"has fewer than {LEAST} samples of {signal.name}; give a longer one")
    held = last_values(u)
    return Log(np.where(np.isfinite(held), held, [resting(s) for s in plant.inputs]), y, float(record.dt))


def beyond(plant: System, record: Log) -> Iterator[str]:
    """A sentence for each output that shows a state outside of its declared range."""
    for y, h, column in zip(plant.outputs, plant.output, record.y.T, strict=True):
        state = next((x for x in plant.states if x == h and x.bounded), None)
        if state is None:
            continue
        low, high = state.interval
        outside = column[(column < low) | (column > high)]
        if len(outside):
            farthest = outside[np.argmax(np.maximum(low - outside, outside - high))]
            yield (
                f"{y.name} leaves the declared range of {state.name}, {low:g}..{high:g}, in {len(outside)} of "
                f"{len(column)} samples, as far as {farthest:.4g}: widen it, if the unit and the sign are right"
            )


class BadSignal(BadArgument):
    """A name that is no signal of the plant."""


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
) -> Log:
    """The record of a CSV, Parquet or MAT file, or of a DataFrame, on the grid of `dt`, by default of its own period.

    `time`: the column of times, or `period`, the time between rows; `columns`: what of the log is a signal, a column or
    an expression of columns as for --map, by default the column of its name; `shift`: samples by signal by which it is
    taken later. An input of a log that is faster than dt, or irregular, is averaged: over half a step to both sides, or
    over the step before ("hold", as the step takes it) or after ("forward", as `hg.fit` does).

    Raises: `BadRecord`; `NotInstalled` for a file whose library is not there.
    """
    units = {s.name: s.unit for s in (*plant.inputs, *plant.outputs)}
    columns, shift = columns or {}, shift or {}
    if unknown := [name for name in (*columns, *shift) if name not in units]:
        raise BadSignal(unknown[0], f"is no signal; the signals are {', '.join(units)}")
    inputs = {s.name: WINDOWS[between] for s in plant.inputs}
    wanted = {name: columns.get(name, name) for name in units}
    words: dict[str, Any] = {"time": time, "period": period, "unit": plant.time, "units": units, "caller": PYTHON}
    got = read(source, wanted, dt=dt, inputs=inputs, **words).shifted(shift)
    return Log(got.of(plant.inputs), got.of(plant.outputs), got.report.dt)


Array = np.ndarray
Key = TypeVar("Key", bound=Hashable)
ALIKE = 2e-3  # of E: a thousandth of an error, as two filters that differ by rounding have
BEGIN = 0.05  # of a record, in which an estimate may find its way


@dataclass(frozen=True)
class Ahead:
    """Predictions of the outputs so many `samples` ahead, beside copying the last value. Errors are NaN where there is
    nothing to compare, infinite where an estimate is lost."""

    samples: int

    def rival(self, records: Sequence[Log]) -> list[Array]:
        """Return, of each record, the squared errors (N, p) of what does without a model: (y_j(k+h) - y_j(k))^2 at
        each sample that has a last value."""
        h, moves = self.samples, []
        for record in records:
            squares = np.full(record.y.shape, np.nan)
            squares[h:] = (record.y[h:] - last_values(record.y)[: len(record.y[h:])]) ** 2
            moves.append(squares)
        return moves

    def errors(self, k: int, step: CallableStep, run: Run, record: Log) -> Array:
        """The errors (N, p) of a run of a step along record number k: e_j(k+h|k) where the step used a sample."""
        one = next(forecasts(step, run, record.u, record.y, (self.samples,)))
        return np.where(one.compared, np.where(np.isfinite(one.model), one.model, np.inf), np.nan)


@dataclass(frozen=True, eq=False)
class Hidden:
    """Estimates of hidden states beside their mean; `truth` (N) of each record by state, NaN where it was not
    measured."""

    truth: tuple[Mapping[str, Array], ...]

    def rival(self, records: Sequence[Log]) -> list[Array]:
        """(x_j - mean of x_j)^2."""
        tables = [np.column_stack(list(each.values())) for each in self.truth]
        means = np.array([_mean(column) for column in np.concatenate(tables).T])
        return [(table - means) ** 2 for table in tables]

    def errors(self, k: int, step: CallableStep, run: Run, record: Log) -> Array:
        """Return the errors of the estimate."""
        return np.column_stack([run[state] - true for state, true in self.truth[k].items()])


@dataclass(frozen=True)
class Judge:
    """The data by which steps are judged: `records`, a `yardstick`, so many `segments` a record of mean length, run by
    `engine`."""

    records: Sequence[Log]
    yardstick: Ahead | Hidden
    segments: int
    engine: Engine

    def errors(self, step: CallableStep) -> Array:
        """E_s (segments of all records in which something can be compared), infinite where the estimate is lost."""
        errors = []
        with np.errstate(all="ignore"):
            for k, (scale, parts) in enumerate(zip(self._scales, self._parts, strict=True)):
                record = self.records[k].of(step.inputs)
                step.reset()
                run = step.run(u=record.u, y=record.y, engine=self.engine)
                squares = self.yardstick.errors(k, step, run, record) ** 2
                if not np.isfinite(run.x).all() or np.isinf(squares).any():
                    errors.append(np.full(len(parts), np.inf))
                    continue
                means = [[_mean(column) for column in (squares / scale)[part].T] for part in parts]
                each = np.array([_mean(np.array(columns)) for columns in means])
                errors.append(np.where(np.isnan(each), np.inf, each))
        return np.concatenate(errors)

    @property
    def most(self) -> int:
        """The number of segments that a record of mean length may have, so that none is without a sample."""
        lengths = list(map(len, self._moves))
        return min(math.floor((n - round(BEGIN * n)) * sum(lengths) / (len(lengths) * n)) for n in lengths)

    @property
    def count(self) -> int:
        """The number of segments that have an error."""
        return sum(map(len, self._parts))

    @cached_property
    def _moves(self) -> list[Array]:
        return self.yardstick.rival(self.records)

    @cached_property
    def _scales(self) -> list[Array]:
        """c_j^2 (q) of all records, for each record NaN of what stands still there or is never compared."""
        whole = np.array([_mean(column) for column in np.concatenate(self._moves).T])
        moving = [np.array([_mean(column) > 0 for column in squares.T]) for squares in self._moves]
        return [np.where(moves, whole, np.nan) for moves in moving]

    @cached_property
    def _parts(self) -> list[list[Array]]:
        """The squares of each log's segments, of those in which something can be compared; a log has as many as its
        length is of the mean one's, and one at least."""
        every, mean = [], sum(map(len, self._moves)) / len(self._moves)
        for squares, scale in zip(self._moves, self._scales, strict=True):
            there = np.isfinite(squares / scale).any(axis=1)
            count = max(1, round(self.segments * len(squares) / mean))
            parts = np.array_split(np.arange(round(BEGIN * len(squares)), len(squares)), count)
            every.append([part for part in parts if there[part].any()])
        return every


def _mean(values: Array) -> float:
    """Return the mean of what is finite, NaN where nothing is."""
    there = values[np.isfinite(values)]
    return float(there.mean()) if len(there) else np.nan


def chosen(errors: Mapping[Key, Array]) -> tuple[Key, Array]:
    """Return, of candidates, the one with the least errors over all segments; and of each segment the error there of
    the one that is chosen on the others."""
    keys, table = list(errors), np.array(list(errors.values()))
    segments = range(table.shape[1])
    judged = [table[int(np.argmin(np.delete(table, s, axis=1).sum(axis=1))), s] for s in segments]
    return keys[int(np.argmin(table.sum(axis=1)))], np.array(judged)


def as_good(errors: Array, best: Array) -> bool:
    """Return whether errors by segment are above the best by no more than one standard error (the rule of Breiman,
    Friedman, Olshen, Stone, Classification and Regression Trees, 1984), that of their difference or that of the
    best, whichever is less: errors that scatter widely are no reason to prefer them. Errors that differ by rounding
    are as good."""
    difference = errors - best
    scatter = min(difference.std(ddof=1), best.std(ddof=1)) / np.sqrt(len(difference))
    return bool(difference.mean() <= max(scatter, ALIKE * best.mean()))


def readable(plant: System, record: Log, number: int) -> Log:
    """A record without the samples that a step rejects: those more than the width of its range beyond an output's
    range, as `plausible` of the guards says. Raises: `BadLog`, `BadShape`."""
    ranges = np.array(readings(forms.original(plant)))
    width = np.diff(ranges, axis=1).T
    low, high = np.maximum(ranges[:, 0] - width, -HUGE), np.minimum(ranges[:, 1] + width, HUGE)
    there = demanded(plant, record, number)
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
    return Log(there.u, y, there.dt)
