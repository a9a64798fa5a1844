"""Measured logs resampled to the step's grid of times: u and y at t_0 + k dt, NaN where nothing was measured.

The report counts the cells and rows that were missing, not a number, duplicated, out of order or in a gap, and says how
each was treated. A row goes to the nearest grid point; of several at one point each column keeps the number nearest in
time (of equals the first). An input of a log that is faster than the step, or irregular, is averaged instead, over the
time that a sample represents:

    u_k = 1/(b - a) integral over [a, b] of the log, each row's value held until the next,   a, b = t_k + window dt

so that the integral is preserved: charge, volume or heat. The window follows from the step's interpolation of u between
samples. Linear interpolation has half a step on both sides, since its integral is dt (u_0/2 + u_1 + .. + u_N/2); a
value that was applied since the last sample has the step before it.

A log is irregular if more than a tenth of the times between its rows are a quarter of their median off every multiple
of it. Where a caller asks for that, such a log keeps the times of its rows, and nothing is averaged.

Derivatives of inputs, which a form needs and few logs hold, are differences from sample to sample,

    u'(k) = (u(k) - u(k - 1))/dt,   u''(k) = (u'(k) - u'(k - 1))/dt,   ..

which firmware can compute, and which equal the slope of the line that ends at the sample. The first difference also
replaces those before it."""

import math
import re
import shlex
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Annotated, Any, Literal

import numpy as np

from hgogen.reading.cells import (
    EVERY_ROW,
    BadRecord,
    Column,
    DateOrder,
    DecimalSign,
    Rows,
    Undecided,
    has_dates,
    stamps_of,
)
from hgogen.reading.given import names_of, unmasked
from hgogen.reading.jumps import other_angle
from hgogen.reading.log import Table, column_named, column_of, converted, log_of, of_signals, operand, words_of
from hgogen.signal import Signal, finer_units, plural, seconds

Window = tuple[float, float]
WINDOWS: dict[str, Window] = {"line": (-0.5, 0.5), "hold": (-1.0, 0.0), "forward": (0.0, 1.0)}
FASTER = 0.75  # of the step: a log with a shorter period is averaged
WITHOUT_PERIOD = "without a period, and moved to a grid"
UNEVEN, SHARE = 0.25, 0.1  # of the period, of the rows: more of them so far off it make a log irregular
HOLD_PERIODS = 10.0  # typical periods for which a row's value stays valid: a longer pause is a gap
_BEAT = 0.01  # of a period, from a whole multiple: beyond it rows and samples drift apart
_AMBIGUOUS = 0.4  # of a period, from a whole multiple: beyond it the number of periods of a step is ambiguous
LONGEST = 10_000_000  # samples on the grid; with more the times are hardly seconds
_SPARSE, _LONG = 500, 1_000_000  # nor if rows are so many samples apart on a grid of so many samples
_CLOCK = 40  # first cells of a column of times
_INSIDE = 0.51  # of a turn, from its middle: a sample farther off is given in another turn
_PLAIN = Signal("plain")  # a column of no signal is a course of plain numbers
_SINCE_1970 = {1e-3: "milliseconds", 1e-6: "microseconds", 1e-9: "nanoseconds", 1.0: "seconds"}
_EPOCH, _MINUTE, _DAY = (9.4e8, 4.1e9), 60.0, 86_400.0  # s: from 1999 to 2099; rows are a minute apart at most
_RUN = 10  # periods back in time, and half of the rows between two such: a logger that was started again
_ROW, _SAMPLES = re.compile(r"row\s*[:=]?\s*(\d+)"), re.compile(r"(\d+)\.\.(\d+)")
_ALIKE = 1e-9  # relative difference of equal values
_HOLD_NOTE = "every row held until the next, so that the integral is kept"


@dataclass(frozen=True)
class Caller:
    """The names of options that error messages suggest, on the command line or in Python. `column`: a pattern with
    {name} for a signal's column; `others`: the option in its place for particular signals; `times`: that for the column
    of times; `period`: that for the time between rows."""

    column: str
    times: str
    period: str
    others: Mapping[str, str] = field(default_factory=dict)

    def fix(self, name: str) -> str:
        """Return the option by which the user gives the column of the signal `name`."""
        return self.others.get(name) or self.column.format(name=name)


COMMAND = Caller("--map {name}=COLUMN", "--time COLUMN or --period TIME", "--period TIME")
PYTHON = Caller("columns={{{name!r}: COLUMN}}", "time=COLUMN or period=TIME", "period=TIME")


@dataclass(frozen=True)
class Report:
    """A report on the contents of a log and on how they were treated.

    The count `absent` is missing + not_numbers - covered + filled, except for an input that is averaged.
    """

    path: Annotated[str, "path of the file"]
    rows: Annotated[int, "rows of the file"]
    samples: Annotated[int, "samples on the grid of dt"]
    dt: Annotated[float, "period of the grid"]
    period: Annotated[float, "typical time between rows"]
    columns: Annotated[Mapping[str, str], "column by signal"]
    missing: Annotated[Mapping[str, int], "empty cells by signal, in rows with a usable time"]
    not_numbers: Annotated[Mapping[str, int], "cells without a finite number by signal, in such rows"]
    covered: Annotated[
        Mapping[str, int], "such cells by signal beside another row's at a grid point, which cost no sample"
    ]
    absent: Annotated[Mapping[str, int], "samples without a number by signal"]
    malformed: Annotated[int, "rows with another number of cells than the header, left out"]
    untimed: Annotated[int, "rows without a usable time, left out"]
    out_of_order: Annotated[int, "rows earlier than one before them, sorted"]
    duplicates: Annotated[int, "rows that repeat a time, merged"]
    surplus: Annotated[int, "rows of other times at a grid point that has one, merged"]
    gaps: Annotated[int, "pauses longer than 1.5 periods"]
    longest_gap: Annotated[float, "the longest pause"]
    filled: Annotated[int, "grid points without a row, given as missing samples"]
    shift: Annotated[float, "farthest that a row was moved"]
    unit: Annotated[str, "unit of all times"]
    notes: Annotated[tuple[str, ...], "what else was decided on reading, or looks doubtful"]
    spacing: Annotated[
        tuple[float, float] | None, "shortest and longest time between samples at the rows' own times; null on a grid"
    ] = None

    def sentences(self) -> tuple[str, ...]:
        """Return sentences on the contents of the log and their treatment, without counts of 0."""
        period, dt = (f"{time:g} {self.unit}" for time in (self.period, self.dt))
        lines = [f"{self.rows} rows, one every {period}, became {self.samples} samples of {dt}"]
        if self.spacing:
            shortest, longest = (f"{time:g}" for time in self.spacing)
            lines = [f"{self.rows} rows, {shortest} to {longest} {self.unit} apart, are samples at their own times"]
        for name, column in self.columns.items():
            lines += (f"{name} ({column}): {text}" for text in self._missing_samples(name))
        counted = (
            (self.malformed, "rows whose number of cells is not that of the header: {}, left out"),
            (self.untimed, "rows without a usable time: {}, left out"),
            (self.out_of_order, "rows earlier than one before them: {}, sorted by time"),
            (self.duplicates, "rows that repeat a time: {}, merged; each column keeps its first number"),
            (self.surplus, "rows at a grid point that has one: {}, merged; the number nearest in time is kept"),
            (self.gaps, f"gaps longer than 1.5 periods: {{}}, the longest {self.longest_gap:g} {self.unit}"),
            (self.filled, "grid points without a row: {}, given as missing samples"),
        )
        lines += [text.format(count) for count, text in counted if count]
        if self.shift > 1e-6 * self.dt:
            lines.append(f"rows were moved to the nearest grid point, by {self.shift:.3g} {self.unit} at most")
        return (*lines, *self.notes)

    def _missing_samples(self, name: str) -> list[str]:
        """Return texts on the missing samples of a signal, one if they have one cause; none if that is missing rows."""
        empty, invalid, covered = self.missing[name], self.not_numbers[name], self.covered[name]
        cells = ((empty, "empty"), (invalid, "no finite number"))
        lines = [f"cells that are {what}: {count}, taken as missing samples" for count, what in cells if count]
        absent, counts = self.absent[name], [count for count in (empty, invalid, self.filled) if count]
        sums = [f"of these, at a grid point that another row fills: {covered}"] * bool(covered)
        sums += [f"samples without a number, in all: {absent}"] * bool(absent and counts != [absent])
        parts = [[*lines, *sums]] if len(lines) == 1 else [*([one] for one in lines), sums]
        return ["; ".join(part) for part in parts if part]


@dataclass(frozen=True, eq=False)
class Record:
    """Measured signals on a grid of times.

    `t` (N,): the times, from the first row's on; `values` (N, c): the signals `names`, NaN where missing or masked;
    `report`: on the reading; `operands`: the operand of each signal's column in an expression of --map; `rates`: the
    names that are difference quotients of other signals, with source and order; `stamps` (rows,): the times as they are
    written; `clock`: the name of their column and its operand, empty for times by a period; `cells` (rows, c): the
    signals as they are written; `table`: the file; `rows`: the indices of the selected rows of the file.
    """

    t: np.ndarray
    names: tuple[str, ...]
    values: np.ndarray
    report: Annotated[Report, "what was found in the log"]
    operands: Mapping[str, str] = field(default_factory=dict)
    rates: Mapping[str, tuple[str, int]] = field(default_factory=dict)
    stamps: np.ndarray | None = None
    clock: tuple[str, str] = ("", "")
    cells: np.ndarray | None = None
    table: Table | None = None
    rows: np.ndarray | None = None

    def __post_init__(self) -> None:
        """Replace masked values by NaN, because a selection of columns would lose the mask."""
        object.__setattr__(self, "values", unmasked(self.values))

    def of(self, signals: Sequence[Signal]) -> np.ndarray:
        """Return the columns (N, k) of some signals, in the order of `signals`."""
        return np.ascontiguousarray(self.values[:, [self.names.index(s.name) for s in signals]])

    def with_rates(
        self, rates: Mapping[str, tuple[str, int]], signals: Mapping[str, Signal] = MappingProxyType({})
    ) -> "Record":
        """Return the record with derivatives of signals as further columns, by difference quotients. `rates`: by name,
        the source signal and the order; `signals`: by name; those with a period are unwrapped before."""
        courses = dict(zip(self.names, self.values.T, strict=True))
        dt = self.elapsed if self.report.spacing else self.report.dt
        courses |= {name: signals[name].unwrapped(values) for name, values in courses.items() if name in signals}
        columns = [difference(courses[of], order, dt) for of, order in rates.values()]
        return replace(
            self,
            names=(*self.names, *rates),
            values=np.column_stack([self.values, *columns]),
            report=replace(self.report, notes=(*self.report.notes, *difference_notes(rates))),
            operands={**self.operands, **{name: name for name in rates}},
            rates=rates,
        )

    @property
    def elapsed(self) -> np.ndarray:
        """The time (N,) since the previous sample, 0 for the first."""
        return np.diff(self.t, prepend=self.t[0])

    def shifted(self, shifts: Mapping[str, int], inputs: Iterable[Signal] = ()) -> "Record":
        """Return the record with signals, and their difference quotients, delayed by numbers of samples, or advanced by
        negative ones; samples without a value at the ends are missing. At the rows' own times only `inputs` can be
        shifted, by rows. Raises: `BadRecord` if no sample of a signal remains, and for another signal at such times."""
        shifts = {name: shifts[of] for name, (of, _) in self.rates.items() if of in shifts} | dict(shifts)
        values, notes, by_rows = self.values.copy(), [], names_of(inputs)
        for name, by in shifts.items():
            if by and self.report.spacing and name not in by_rows:
                reason = f"a shift of {name} counts samples of one period, and these are at the times of their rows"
                raise BadRecord(self.report.path, f"{reason}; resample it, by --dt (dt=)")
            if abs(by) >= len(values):
                reason = f"a shift of {name} by {by} leaves nothing of its {len(values)} samples; give a smaller one"
                raise BadRecord(self.report.path, reason)
            column = self.names.index(name)
            values[:, column] = shifted(values[:, column], by)
            if by:
                way = "later" if by > 0 else "earlier"
                what = "rows" if self.report.spacing else "samples"
                notes.append(f"{name} is taken {way} than it was logged, by {what}: {abs(by)}")
        return replace(self, values=values, report=replace(self.report, notes=(*self.report.notes, *notes)))

    def without(self, texts: Iterable[str], inputs: Sequence[Signal], outputs: Sequence[Signal]) -> "Record":
        """Return the record with some samples declared missing by `texts` of the option --missing: those of one value,
        y=-999; those that repeat the previous one, y=repeats; or those with numbers in a range, y=150..199, both
        included. Raises: `BadRecord`."""
        values, notes, path = self.values.copy(), [], self.report.path
        for option, name, what in of_signals(path, "--missing", texts, inputs, outputs):
            column = values[:, self.names.index(name)]
            lost = _lost(column, what)
            if lost is None:
                reason = "must read SIGNAL=VALUE, SIGNAL=repeats or SIGNAL=FIRST..LAST, such as y=-999 or y=150..199"
                raise BadRecord(path, f"{option} {reason}")
            if not np.isfinite(column[~lost]).any():
                raise BadRecord(path, f"{option} leaves no sample of {name}; give another value, or fewer samples")
            notes.append(f"{name}: samples taken as missing by {what}: {int((lost & np.isfinite(column)).sum())}")
            column[lost] = np.nan
        return replace(self, values=values, report=replace(self.report, notes=(*self.report.notes, *notes)))


def _lost(column: np.ndarray, what: str) -> np.ndarray | None:
    """Return the mask (N,) of the samples of a column that a text of --missing declares missing; None for an invalid
    text."""
    if match := _SAMPLES.fullmatch(what):
        first, last = map(int, match.groups())
        return (np.arange(len(column)) >= first) & (np.arange(len(column)) <= last)
    if what == "repeats":
        return np.append(False, column[1:] == column[:-1])
    try:
        return np.asarray(np.isclose(column, float(what), rtol=_ALIKE, atol=0.0))
    except ValueError:
        return None


def shifted(values: np.ndarray, by: int) -> np.ndarray:
    """Return a column (N,) delayed by `by` samples, or advanced if negative; NaN where this leaves no sample."""
    whole = np.full(len(values), np.nan)
    count = len(values) - abs(by)
    if count > 0:
        whole[max(by, 0) : max(by, 0) + count] = values[max(-by, 0) : max(-by, 0) + count]
    return whole


def read(
    path: Any,
    columns: Mapping[str, str],
    *,
    dt: float | None,
    time: str | None = None,
    period: float | None = None,
    unit: str = "s",
    caller: Caller = COMMAND,
    inputs: Mapping[str, Window] = MappingProxyType({}),
    signals: Mapping[str, Signal] = MappingProxyType({}),
    rates: Mapping[str, tuple[str, int]] = MappingProxyType({}),
    rows: Rows = EVERY_ROW,
    decimal: DecimalSign | None = None,
    dates: DateOrder | None = None,
    own_times: Literal["irregular", "always"] | None = None,
) -> Record:
    """Return the log at `path`, a file or a DataFrame, sampled with the period `dt`, by default the log's own; or at
    the times of its rows, if `own_times` is "always", or if it is "irregular", the log has no period and `dt` is None.

    Args: `columns`: the column name of each signal, or an expression of columns (reading/log.py); `time`: the column of
    times, or an expression; or `period`: the time between rows; `unit`: that of all times, which is the model's;
    `caller`: whose options error messages suggest; `inputs`: the signals that are averaged over a window if the log is
    faster than `dt` or irregular; others are sampled; `signals`: by name; a column with another unit in its name is
    converted to the signal's, and values of a periodic signal are wrapped into its turn; `rates`: the names that are
    derivatives of other signals, with source and order, computed as difference quotients if the log has no such column;
    `rows`: the selection of rows; `decimal`, `dates`: the decimal sign and the order of day, month and year, None where
    the cells decide.

    Raises: `BadRecord`.
    """
    columns = {name: column_named(text) for name, text in columns.items()}
    time = None if time is None else column_named(time)
    log = log_of(path, (*columns.values(), *([time] if time else ())), decimal, dates)
    columns, time = {name: log.called(text) for name, text in columns.items()}, time and log.called(time)
    _demand_times(log, time, period, unit, caller)
    differences = {name: of for name, of in rates.items() if columns.get(name) == name and name not in log.header}
    columns = {name: column for name, column in columns.items() if name not in differences}
    log, series, operands = _series(log, columns, signals, caller)
    if time is not None:
        log, times = _times(log, time, unit, caller)
    else:
        times = np.arange(log.rows) * float(period or 0.0)
        log = replace(log, notes=(*log.notes, *_clocks(log, columns.values())))
    log, selected = _selected(log, rows, times, time, unit)
    series, times = {name: column.select_rows(selected) for name, column in series.items()}, times[selected]
    _demand_one_run(log.path, times, selected)
    of_columns = (note for one in series.values() for note in one.notes)
    log = replace(log, notes=tuple(dict.fromkeys((*log.notes, *of_columns))))
    record = _gridded(log, series, _grid(log.path, times, dt, unit, own_times), unit, inputs, signals)
    _demand_numbers(record.report, series, signals.keys() - inputs.keys() - caller.others.keys(), caller)
    cells = np.column_stack([one.values for one in series.values()]) if series else np.empty((log.rows, 0))
    clock = ("", "") if time is None else (time, operand(log, time))
    record = replace(record, operands=operands, stamps=times, clock=clock, cells=cells, table=log, rows=selected)
    return record.with_rates(differences, signals)


def _demand_times(log: Table, time: str | None, period: float | None, unit: str, caller: Caller) -> None:
    if (time is None) == (period is None):
        fix = f"give either {caller.times}, so that the rows have times; the columns are {_listed(log)}"
        raise BadRecord(log.path, fix)
    if period is not None and not 0 < period < math.inf:
        raise BadRecord(log.path, f"the period {period:g} must be a positive number of {plural(unit)}")


def _demand_numbers(report: Report, series: Mapping[str, Column], outputs: Container[str], caller: Caller) -> None:
    for name in [name for name, absent in report.absent.items() if absent == report.samples]:
        example = f", but cells such as {series[name].example!r}" if series[name].example else ""
        what = f"the column {series[name].name!r} holds no number for {name}{example}"
        without = f", or take {name} out of the model to run without it" if name in outputs else ""
        raise BadRecord(report.path, f"{what}; say {caller.fix(name)}{without}")


def _listed(log: Table) -> str:
    return ", ".join(filter(None, log.header))


def _series(
    log: Table, columns: Mapping[str, str], signals: Mapping[str, Signal], caller: Caller
) -> tuple[Table, dict[str, Column], dict[str, str]]:
    """Return the log with notes; by name of the signal its column, in its unit and turn; and by name its operand."""
    for name in [name for name, column in columns.items() if name == column and name not in log.header]:
        raise BadRecord(log.path, f"has no column {name!r}; say {caller.fix(name)}, one of {_listed(log)}")
    series = {name: column_of(log, text) for name, text in columns.items()}
    operands = {name: operand(log, text) for name, text in columns.items()}
    for name, text in columns.items():
        unit_of = signals[name].unit if name in signals else ""
        log, series[name], operands[name] = converted(log, series[name], name, text, unit_of)
    for name, signal in [(name, signal) for name, signal in signals.items() if signal.period and name in series]:
        series[name], turned = _in_turn(series[name], name, signal, operands[name], caller)
        log = replace(log, notes=(*log.notes, *turned))
    return log, series, operands


def _in_turn(column: Column, name: str, signal: Signal, written: str, caller: Caller) -> tuple[Column, tuple[str, ...]]:
    """Return the column of a periodic signal with its values wrapped into its turn, and notes; values that a step would
    reject are not changed. `written`: the column as an operand."""
    reduced = signal.reduced(column.values)
    values = np.where(np.isnan(reduced), column.values, reduced)
    low, high = signal.interval
    beyond = int(np.count_nonzero(np.abs(column.values - (low + high) / 2) > _INSIDE * (high - low)))
    notes = [f"{name}: values outside of its turn, {low:g}..{high:g}, taken in it: {beyond}"] * (beyond > 0)
    if (unit := other_angle(signal, column.values)) is not None:
        fix = caller.fix(name).replace("COLUMN", f"'{'pi/180' if unit == 'degrees' else '180/pi'}*{written}'")
        notes.append(f"{name} jumps by a turn in {unit}, and its period is {signal.period:g}; if it is, say {fix}")
    return replace(column, values=values), tuple(notes)


def _times(log: Table, text: str, unit: str, caller: Caller) -> tuple[Table, np.ndarray]:
    """Return the log with notes, and the times (rows,) in `unit`, from a column or an expression of columns, NaN for a
    missing one. Dates and times of day become times since the first one, if the model's unit of time is known."""
    dated = any(has_dates(log.cells(name)[:_CLOCK]) for name in log.header if name in words_of(text))
    column = column_of(log, text, lambda name: _clock(log, name, unit, not dated))
    log, column, _ = converted(log, column, "time", text, unit)
    if np.isfinite(column.values).sum() <= len(column.values) / 2:
        example = f", such as {column.example!r}" if column.example else ""
        raise BadRecord(
            log.path,
            f"the time column {column.name!r} holds {column.not_numbers} cells that are no numbers{example} and "
            f"{column.empty} empty ones; it must hold {plural(unit)}, dates or times of day, or say {caller.period}",
        )
    return replace(log, notes=(*log.notes, *column.notes)), column.values


def _demand_days(log: Table, name: str, overnight: np.ndarray) -> None:
    """Raise `BadRecord` if a column of dates has other days than the times of day in another column, which are the
    times (rows,) `overnight`, in s."""
    for other in log.header:
        cells = log.cells(other)
        if log.header.count(other) > 1 or not has_dates(cells[:_CLOCK]) or any(":" in cell for cell in cells[:_CLOCK]):
            continue
        with suppress(Undecided):
            in_days = stamps_of(cells, log.dates).seconds + stamps_of(log.cells(name), overnight=False).seconds
            off = (in_days - overnight)[np.isfinite(in_days - overnight)]
            if len(off) and np.ptp(off) > 1:
                sums = " + ".join(each if each.isidentifier() else f"[{each}]" for each in (other, name))
                raise BadRecord(
                    log.path, f"{other!r} has other days than those that pass in {name!r}; say --time '{sums}'"
                )


def _demand_one_run(path: str, times: np.ndarray, rows: np.ndarray) -> None:
    """Raise `BadRecord` if the times of the selected `rows` start again, as those of a logger that was restarted."""
    timed = np.flatnonzero(np.isfinite(times))
    steps = np.diff(times[timed], append=np.inf)
    back = np.flatnonzero(steps < -_RUN * np.median(np.abs(steps)))
    if len(back) and np.diff([0, *back + 1, len(timed)]).min() >= 2 * _RUN:
        row = rows[timed[back[0] + 1]] + 1
        fix = f"take one of its runs, --to row:{row - 1} or --from row:{row}, or if it is a counter that wraps, "
        fix += f"the rows in their order, --period {np.median(np.abs(steps)):.5g}"
        raise BadRecord(path, f"its times begin anew in row {row}, as where a logger is started again; {fix}")


def _clock(log: Table, name: str, unit: str, overnight: bool = True) -> Column:
    """Return a column as times in `unit`: dates, times of day, times since 1970 as computers count them, or plain
    numbers."""
    column, known = log.column(name), seconds(unit)
    there = np.isfinite(column.values)
    if not known or column.unit:
        return column
    if 2 * there.sum() <= log.rows:
        try:
            stamps = stamps_of(log.cells(name), log.dates, overnight)
        except Undecided as error:
            raise BadRecord(log.path, f"the time column {name!r} holds {error}") from None
        notes = tuple(f"time: {note}" for note in stamps.notes)
        timed = np.isfinite(stamps.seconds)
        if timed.sum() > there.sum():
            if overnight and not stamps.dated:
                _demand_days(log, name, stamps.seconds)
            return replace(column, values=stamps.seconds / known, blank=column.blank & ~timed, notes=notes)
    for factor, what in _SINCE_1970.items():
        stamps_since = column.values[there] * factor
        if (
            factor != known
            and len(stamps_since) > 1
            and np.all((stamps_since > _EPOCH[0]) & (stamps_since < _EPOCH[1]))
            and np.median(np.abs(np.diff(stamps_since))) <= _MINUTE
        ):
            note = f"time: {name!r} counts {what} since 1970: taken from its first time on, in {plural(unit)}"
            since = (column.values - column.values[there][0]) * factor / known
            return replace(column, values=since, notes=(*column.notes, note))
    return column


def _selected(log: Table, rows: Rows, times: np.ndarray, time: str | None, unit: str) -> tuple[Table, np.ndarray]:
    """Return the log with a note, and the numbers of the rows that are selected."""
    if rows == EVERY_ROW:
        return log, np.arange(len(times))
    number = np.arange(1, len(times) + 1)
    inside = np.ones(len(times), bool)
    for option, text, within in (("--from", rows.begin, np.greater_equal), ("--to", rows.end, np.less_equal)):
        if text is None:
            continue
        if match := _ROW.fullmatch(text):
            inside &= within(number, int(match[1]))
        else:
            inside &= within(times, _bound(log, option, text, time, unit))
    selected = np.flatnonzero(inside)[:: rows.every]
    if len(selected) < 2:
        known = times[np.isfinite(times)]
        runs = f"times run from {known.min():g} to {known.max():g} {unit} and its rows from 1 to {len(times)}"
        raise BadRecord(log.path, f"--from, --to and --every leave {len(selected)} of its rows; its {runs}")
    every = f", each of {rows.every} in turn" if rows.every > 1 else ""
    note = f"rows {number[selected[0]]} to {number[selected[-1]]} of {len(times)} are taken{every}"
    return replace(log, notes=(*log.notes, note)), selected


def _bound(log: Table, option: str, text: str, time: str | None, unit: str) -> float:
    """Return the time in a text of --from or --to: a number, or a date or a time of day as in the column of times."""
    try:
        return float(text)
    except ValueError:
        pass
    known = seconds(unit)
    if known and time in log.header:
        stamps = stamps_of([*log.cells(str(time)), text], log.dates, overnight=False)
        at = float(stamps.seconds[-1])
        at += _DAY * (not stamps.dated and at < 0)
        if np.isfinite(stamps.seconds).sum() > 1 and math.isfinite(at):
            return at / known
    fix = f"a time in {plural(unit)}, a time as its column has it, or a row, such as row:100"
    raise BadRecord(log.path, f"{option} {text!r} must be {fix}")


def _clocks(log: Table, mapped: Iterable[str]) -> Iterator[str]:
    """Yield a note for each unmapped column that is a clock with pauses, whose
    gaps a constant --period would close. A column is a clock if at least
    nine in ten of its steps are within 0.5 and 1.5 times their median."""
    for name in dict.fromkeys(log.header):
        if not name or name in mapped or log.header.count(name) > 1:
            continue
        column = log.column(name)
        times = column.values
        with suppress(Undecided):
            times = times if np.isfinite(times).any() else stamps_of(log.cells(name), log.dates).seconds
        steps = np.diff(times[np.isfinite(times)])
        middle = float(np.median(steps)) if len(steps) else 0.0
        if not middle > 0 or np.mean(abs(steps / middle - 1) <= 0.5) < 0.9:
            continue
        if pauses := steps[steps > 1.5 * middle].tolist():
            yield (
                f"the column {name!r} runs like a clock, {middle:.4g} a row, but for pauses: {len(pauses)}, of up to "
                f"{max(pauses):.4g}: --period lays the rows one after the other and closes these gaps. Say --time "
                f"{shlex.quote(name)} to have missing samples there"
            )


def _pace(subject: str, period: float, dt: float, unit: str) -> tuple[str, ...]:
    factor = period / dt
    finding = f"{subject} {factor:.4g} times the step's dt, {dt:g} {unit}: "
    if 0.5 - 1e-9 <= factor <= 2 + 1e-9:
        whole = max(factor, 1 / factor)
        if abs(whole - round(whole)) < _BEAT:
            return ()
        return (f"{finding}rows and samples do not match; with --dt {period:.5g} (dt=) each sample has its row",)
    finer = (name for name, ratio in finer_units(unit).items() if ratio / 2 < factor < 2 * ratio)
    if name := next(finer, ""):
        question = f"are its times {name}? They are read as {plural(unit)}"
    elif factor > 1:
        question = f"between rows the step predicts by the model alone; are the times {plural(unit)}, and is dt right?"
    else:
        question = f"only the row nearest to each sample is used; are the times {plural(unit)}, and is dt right?"
    return (finding + question,)


def _typical(times: np.ndarray) -> float:
    """Return the period of ascending times, 0 for a single one. It has the fewest digits for which the end of the grid
    stays within the rounding of the times or, if they jitter, within `_BEAT` of a period: 0.01 and not
    0.00999999999999979."""
    steps = np.diff(times)
    if not len(steps):
        return 0.0
    period = _slope(times, steps, float(np.median(steps)))
    off = 2 * float(np.spacing(np.abs(times).max()))
    if np.abs(steps / period - np.rint(steps / period)).max() * period > off:
        off = max(off, _BEAT * period)
    shorter = (float(f"{period:.{digits}g}") for digits in range(1, 18))
    return next(each for each in shorter if abs(each - period) * len(steps) <= off or each == period)


def irregular(steps: np.ndarray) -> bool:
    """Return whether a log has no period, from the `steps` (N,) between its rows: too many are no multiples of their
    median."""
    periods = steps / np.median(steps)
    return bool(np.mean(np.abs(periods - np.rint(periods)) > UNEVEN) > SHARE)


def _slope(times: np.ndarray, steps: np.ndarray, middle: float) -> float:
    """Return the least-squares slope of times over row numbers. A step that is no clear
    multiple of the period starts a new piece with its own offset. If too many steps
    are unclear, return their median `middle`, which is sensitive to jitter."""
    if irregular(steps):
        return middle
    counts = np.rint(steps / middle)
    off = np.abs(steps / middle - counts)
    piece = np.concatenate([[0], np.cumsum((off > _AMBIGUOUS) | (counts > HOLD_PERIODS))])
    number = np.concatenate([[0.0], np.cumsum(counts)])
    number, since = (each - (np.bincount(piece, each) / np.bincount(piece))[piece] for each in (number, times))
    return float(number @ since / (number @ number)) if np.any(number) else middle


@dataclass(frozen=True, eq=False)
class _Grid:
    """The sampling of a log whose rows have the times `stamps` (rows,): at multiples of `dt`, or at the times of the
    rows if `own`.

    `ordered`: the indices of the rows with a time, sorted by time; `times`: their times; `distinct`: the times without
    repetitions, typically `period` apart; `point`: for each of the ordered rows the index of its sample; `away`: the
    time between row and sample.
    """

    stamps: np.ndarray
    ordered: np.ndarray
    times: np.ndarray
    distinct: np.ndarray
    period: float
    dt: float
    own: bool
    point: np.ndarray
    away: np.ndarray

    @property
    def steps(self) -> np.ndarray:
        """The differences of successive distinct times."""
        return np.diff(self.distinct)

    @property
    def samples(self) -> int:
        """The number of samples."""
        return int(self.point[-1]) + 1

    @property
    def t(self) -> np.ndarray:
        """The times (samples,)."""
        return self.distinct if self.own else self.times[0] + np.arange(self.samples) * self.dt

    def first_numbers(self, columns: Iterable[np.ndarray]) -> np.ndarray:
        """Return, for each sample and column, the number of the row nearest in time (samples, columns), the first of
        equally near ones; NaN where no row has a number."""
        nearest = np.lexsort((self.away, self.point))
        columns, point = [one[self.ordered][nearest] for one in columns], self.point[nearest]
        values = np.full((self.samples, len(columns)), np.nan)
        for c, numbers in enumerate(columns):
            there = np.flatnonzero(np.isfinite(numbers))
            places, first = np.unique(point[there], return_index=True)
            values[places, c] = numbers[there[first]]
        return values


def _grid(
    path: str, stamps: np.ndarray, step: float | None, unit: str, own_times: Literal["irregular", "always"] | None
) -> _Grid:
    timed = np.flatnonzero(np.isfinite(stamps))
    ordered = timed[np.argsort(stamps[timed], kind="stable")]
    times = stamps[ordered]
    distinct = times[np.diff(times, prepend=-np.inf) > 0]
    period = _typical(distinct) or step or 0.0
    dt = step or period
    if not dt or (own_times == "always" and len(distinct) < 2):
        raise BadRecord(path, f"its rows with a time, {len(timed)}, have one time; give a log of at least 2")
    own = own_times == "always" or (own_times == "irregular" and step is None and irregular(np.diff(distinct)))
    if own:
        point, away = np.searchsorted(distinct, times), np.zeros(len(times))
    else:
        _demand_samples(path, times, len(distinct), dt, unit)
        point = np.floor((times - times[0]) / dt + 0.5).astype(int)
        away = np.abs(times - times[0] - point * dt)
    return _Grid(stamps, ordered, times, distinct, period, dt, own, point, away)


def _gridded(
    log: Table,
    series: Mapping[str, Column],
    grid: _Grid,
    unit: str,
    inputs: Mapping[str, Window],
    signals: Mapping[str, Signal],
) -> Record:
    values, dt = grid.first_numbers(one.values for one in series.values()), grid.dt
    averaging = not grid.own and needs_averaging(grid.steps, grid.period, dt)
    means = [name for name in series if averaging and name in inputs]
    for name in means:
        signal = signals.get(name, _PLAIN)
        course = signal.unwrapped(series[name].values[grid.ordered])
        hold = max(HOLD_PERIODS * grid.period, dt)
        mean = window_means(grid.times, course, float(grid.times[0]), grid.samples, dt, inputs[name], hold)
        values[:, list(series).index(name)] = signal.turned(mean)
    notes = [*log.notes, *_grid_notes(grid, unit)]
    notes += [f"{', '.join(means)}: averaged over each step, {_HOLD_NOTE}"] * bool(means)
    return Record(grid.t, tuple(series), values, _report(log, series, grid, values, unit, tuple(notes)))


def _grid_notes(grid: _Grid, unit: str) -> Iterator[str]:
    if grid.own:
        return
    if not (len(grid.steps) and irregular(grid.steps)):
        yield from _pace(f"the record's period, {grid.period:g} {unit}, is", grid.period, grid.dt, unit)
        return
    if not 0.5 <= grid.period / grid.dt <= 2:
        yield from _pace(f"its rows are {grid.period:g} {unit} apart at the median,", grid.period, grid.dt, unit)
    low, high = f"{float(grid.steps.min()):g}", f"{float(grid.steps.max()):g}"
    yield (
        f"its rows are {low} to {high} {unit} apart, {WITHOUT_PERIOD}: an observer with dt = [{low}, {high}] takes "
        "them at their own times, and so do fit and tune without --dt (dt=)"
    )


def _report(
    log: Table, series: Mapping[str, Column], grid: _Grid, values: np.ndarray, unit: str, notes: tuple[str, ...]
) -> Report:
    timed, steps = np.sort(grid.ordered), grid.steps
    pauses = steps[steps > (HOLD_PERIODS if grid.own else 1.5) * grid.period]
    used, samples, stamps = 1 + int(np.count_nonzero(np.diff(grid.point))), grid.samples, grid.stamps
    cells = {name: column.select_rows(timed) for name, column in series.items()}
    absent = dict(zip(series, np.isnan(values).sum(axis=0).tolist(), strict=True))
    lost = {name: column.empty + column.not_numbers for name, column in cells.items()}
    return Report(
        path=log.path,
        rows=len(stamps) + log.malformed,
        samples=samples,
        dt=grid.dt,
        period=grid.period,
        columns={name: column.name for name, column in series.items()},
        missing={name: column.empty for name, column in cells.items()},
        not_numbers={name: column.not_numbers for name, column in cells.items()},
        covered={name: min(lost[name], max(0, lost[name] + samples - used - absent[name])) for name in series},
        absent=absent,
        malformed=log.malformed,
        untimed=len(stamps) - len(timed),
        out_of_order=int(np.count_nonzero(stamps[timed][1:] < np.maximum.accumulate(stamps[timed])[:-1])),
        duplicates=len(timed) - len(grid.distinct),
        surplus=len(grid.distinct) - used,
        gaps=len(pauses),
        longest_gap=float(pauses.max()) if len(pauses) else 0.0,
        filled=samples - used,
        shift=float(grid.away.max()),
        unit=unit,
        notes=notes,
        spacing=(float(steps.min()), float(steps.max())) if grid.own else None,
    )


def _demand_samples(path: str, times: np.ndarray, rows: int, dt: float, unit: str) -> None:
    span = float(times[-1] - times[0])
    if span / dt > (LONGEST if span / dt < _SPARSE * rows else _LONG):
        many = f"its times span {span:g} {unit}, {span / dt:.3g} samples of {dt:g} {unit} for {rows} rows"
        other = "Where they are in another unit, name it in the header, as t [ms], or convert them, as t/1000 does"
        raise BadRecord(path, f"{many}; are they {plural(unit)}, and is dt right? {other}")
    if np.floor(span / dt + 0.5) < 1:
        one = f"its rows with a time, {len(times)}, make 1 sample of {dt:g} {unit}"
        raise BadRecord(path, f"{one}; give a log of at least 2")


def needs_averaging(steps: np.ndarray, period: float, dt: float) -> bool:
    """Return whether inputs have to be averaged over samples, because the `steps` (N,) between rows, typically
    `period`, are shorter than `dt` or irregular."""
    uneven = np.abs(steps / period - 1) > UNEVEN if period else np.zeros(0, bool)
    return bool(period < FASTER * dt or (len(uneven) and uneven.mean() > SHARE))


def window_means(
    times: np.ndarray, values: np.ndarray, first: float, samples: int, dt: float, window: Window, hold: float
) -> np.ndarray:
    """Return the means (samples,) of a column over a window around each sample time first + k dt, each number held
    until the next. `times`, `values` (N,): the column, times ascending; `window`: the ends of the window over dt. If
    the last number before a window is older than `hold` (time), the mean begins at the first number inside; NaN if
    there is none."""
    there = np.isfinite(values)
    times, index = np.unique(times[there], return_index=True)
    if not len(times):
        return np.full(samples, np.nan)
    values = values[there][index]
    grid = first + np.arange(samples) * dt
    end = max(float(grid[-1]), float(times[-1]))
    knots = np.append(times, end + dt)
    integral = np.concatenate([[0.0], np.cumsum(values * np.diff(knots))])
    low, high = (np.clip(grid + edge * dt, first, end) for edge in window)
    at = np.searchsorted(times, low + 1e-9 * dt, "right") - 1
    stale = np.where(at < 0, True, low - times[np.maximum(at, 0)] > hold)
    low = np.where(stale, np.append(times, np.inf)[at + 1], low)  # the window begins at the next number
    at = np.where(stale, np.minimum(at + 1, len(times) - 1), at)
    length = high - low
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (np.interp(high, knots, integral) - np.interp(low, knots, integral)) / length
    mean = np.where(length > 1e-9 * dt, mean, values[at])
    return np.asarray(np.where(~stale | (length > 1e-9 * dt), mean, np.nan))


def difference_notes(rates: Mapping[str, tuple[str, int]]) -> tuple[str, ...]:
    """Return sentences on derivatives that are computed because the log does not contain them. `rates`: by name, the
    source signal and the order."""
    return tuple(
        f"{name} is taken as differences of {source} from sample to sample: no column gives it"
        for name, (source, _) in rates.items()
    )


def difference(values: np.ndarray, order: int, dt: float | np.ndarray) -> np.ndarray:
    """Return the difference quotient (N,), of the given order, of a column (N,); `dt`: the time between samples, or the
    time (N,) since the previous one. NaN if one of its samples is missing."""
    if len(values) <= order:
        return np.full(len(values), np.nan)
    rates, elapsed = values, np.broadcast_to(dt, len(values))
    for k in range(1, order + 1):
        rates = np.diff(rates) / elapsed[k:]
    return np.concatenate([np.repeat(rates[:1], order), rates])
