"""Faults of the times of a log's rows, found in the column of times as it is written and in those of other clocks.

Of the steps d_k = t_k - t_(k-1) between rows, with their median over positive ones d:

    wraps     t falls back by the same number W of times, or to 0, between rows that rise: a counter of finite range
    coarse    most steps are 0: several rows have one stamp; `stale` where a few are
    milli     d is about a power of 1000 times the period of the step, or 20 times the longest dt that the step is
              advised to take and more; or the name of the column ends or begins with ms, us, ns
    gaps      a step of many d
    jitter    steps scatter about d
    period    a column that runs like a clock at another pace than --period
    clock     a column that runs with the times and scatters where they are even, or is always earlier, by a delay that
              scatters: it holds the true times, or those of the measurement where t is stamped on arrival
"""

import math
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hgogen.logs.finding import Finding, stretches_of
from hgogen.reading.log import Table, operand
from hgogen.reading.measured import Record
from hgogen.signal import plural

Array = np.ndarray
LEAST = 40  # rows of a clock
_EVEN, _JITTER, _SAME = 0.01, 0.05, 0.02  # scatter of steps that are even, or not; relative difference of paces
_SCATTERED = 0.15  # of a period: a jitter that is worth a step of varying length
_STALE = 0.02  # share of repeated stamps
_PAUSES = 8.0  # periods: a gap that is named
_FALLS = 0.05  # share of rows at which a counter falls back
_PREFIXES = {"m": ("milli", 1e3), "u": ("micro", 1e6), "n": ("nano", 1e9)}
_NAMED = re.compile(r"(?i)(?:^|[_ .([])([mun])s(?:ec)?[)\]]?$|^([mun])s(?:ec)?[_ .]")  # of a unit of time
_TOO_LONG = 100.0  # times the longest dt that is advised
_NAMES = re.compile(r"(?i)time|tempo|zeit|stamp|clock|date|sec|^t$|^t[_ \[(]|(?:^|_)[mun]s$|_t$")


@dataclass(frozen=True, eq=False)
class Clock:
    """A column of times of a log: `values` at the `rows` of its file, the `name` of the column ("" for times by a
    constant period), and its text in an expression (`operand`)."""

    record: Record
    table: Table
    rows: Array
    values: Array
    name: str
    operand: str
    varying: bool
    longest: float = math.inf

    @cached_property
    def there(self) -> Array:
        """The indices of the rows that have a time."""
        return np.flatnonzero(np.isfinite(self.values))

    @cached_property
    def steps(self) -> Array:
        """The differences of successive times, over the rows that have a time."""
        return np.diff(self.values[self.there])

    @cached_property
    def middle(self) -> float:
        """The median of the positive steps; 0 if there are none."""
        rising = self.steps[self.steps > 0]
        return float(np.median(rising)) if len(rising) else 0.0

    @cached_property
    def pace(self) -> float:
        """The mean time between rows, without falls and long pauses."""
        usual = self.steps[(self.steps >= 0) & (self.steps <= 3 * max(self.middle, 1e-300))]
        return float(f"{usual.mean():.5g}") if len(usual) else 0.0

    def finding(self, fault: str, rows: Array, strength: float, text: str, fix: str, name: str = "") -> Finding:
        """Return a finding about the times of some `rows` (indices of `there`)."""
        places = stretches_of(self.rows[self.there[rows]])
        return Finding(name or self.name, fault, places, len(rows), float(strength), text, fix)

    def at(self, row: int) -> str:
        """Return words for the row at the end of step number `row`, such as "at row 7 (3.5 s)"."""
        k = int(self.there[row + 1])
        return f"at row {self.rows[k]} ({self.values[k]:.6g} {self.record.report.unit})"


def wraps(clock: Clock) -> Iterator[Finding]:
    """Yield the finding that the times are a counter that wraps around, or a clock that restarts."""
    falls = np.flatnonzero(clock.steps < -2 * clock.middle)
    if not 0 < len(falls) <= _FALLS * len(clock.steps):
        return
    before, after = clock.values[clock.there[falls]], clock.values[clock.there[falls + 1]]
    widths = before - after + clock.pace
    same = len(falls) > 1 and np.ptp(widths) <= 2 * clock.middle
    if same or np.all(np.abs(after) < 2 * clock.middle):
        text = (
            f"{clock.name} falls back by {widths[0]:.6g} {clock.at(int(falls[0]))}, {len(falls)} times in all: a "
            "counter that wraps, or a clock that starts again; rows are sorted by it, and mixed"
        )
        fix = f"rows in their order, --period {clock.pace:g} in place of --time"
        yield clock.finding("wraps", falls + 1, 1 / _FALLS, text, fix)


def repeated(clock: Clock) -> Iterator[Finding]:
    """Yield the finding that several rows have the same time stamp."""
    steps = np.where(clock.steps < 0, clock.middle, clock.steps)
    zero = steps == 0
    if not zero.mean() > _STALE or clock.middle <= 0:
        return
    first = np.flatnonzero(np.concatenate([[True], ~zero]))
    counts = np.diff(np.append(first, len(zero) + 1))
    usual = int(np.median(counts[1:-1])) if len(counts) > 2 else int(counts.max())
    whole = slice(first[1], first[-1]) if len(first) > 2 else slice(0, len(zero))
    period = float(f"{steps[whole].mean():.5g}")
    values = np.asarray(clock.record.cells)[clock.there]
    differ = np.any((values[1:] != values[:-1]) & np.isfinite(values[1:]), axis=1)
    rows = np.flatnonzero(zero & differ)
    where, strength = f"first {clock.at(int(np.argmax(zero)))}", zero.mean() / _STALE
    if not len(rows):
        text = f"{int(zero.sum())} rows repeat the row before, with its time, {where}"
        yield clock.finding("repeated", np.flatnonzero(zero) + 1, strength, text, "they are left out: nothing to do")
    else:
        kind = "coarse" if usual > 1 else "stale"
        clocked = f"{usual} rows have one stamp: a coarse clock" if usual > 1 else "stamps repeat the one before"
        text = f"of {clock.name} {clocked}, in {int(zero.sum())} rows, {where}; only one row of a stamp is used"
        fix = f"times by the number of the row, --period {period:g} in place of --time"
        yield clock.finding(kind, rows + 1, strength, text, fix)


def unit(clock: Clock) -> Iterator[Finding]:
    """Yield the finding that the times have another unit than the step's dt."""
    report = clock.record.report
    factor = report.period / report.dt
    for prefix, power in _PREFIXES.values():
        if 0.5 < factor / power < 2:
            text = f"a row every {report.period:g}, and the step's dt is {report.dt:g} {report.unit}"
            fix = f'times in {prefix}{plural(report.unit)}? --time "{clock.operand}/{power:g}"'
            if not clock.name:
                fix = f"--period {report.period / power:g}"
            yield clock.finding(
                prefix, np.arange(len(clock.there)), factor, f"{clock.name or 'the period'}: {text}", fix
            )


def unit_of_seconds(clock: Clock) -> Iterator[Finding]:
    """Yield the finding that times are read as seconds although they seem to be ms, us or ns: their column's name says
    so, or a step in seconds is far too long for the model and a step in the shorter unit is not."""
    report, table = clock.record.report, clock.table
    if report.unit != "s" or table.header.count(clock.name) != 1 or [*unit(clock)]:
        return
    column = table.column(clock.name)
    there, named = clock.rows[clock.there], _NAMED.search(clock.name)
    if column.unit or not np.array_equal(column.values[there], clock.values[clock.there]):  # converted
        return
    name, length = f"the column {clock.name!r}", f"a row every {report.period:g} s"
    if named is not None:
        prefix, power = _PREFIXES[(named[1] or named[2]).lower()]
        text = f"times look like {prefix}seconds by the name of {name}, and are taken as seconds, {length}"
    else:
        prefix, power = _PREFIXES["m" if report.period <= 1e3 * clock.longest else "u"]
        if not _TOO_LONG * clock.longest < report.period <= power * clock.longest:
            return
        text = f"times look like {prefix}seconds: {name} has {length}, and the model admits {clock.longest:.3g} s"
    fix = f'--time "{clock.operand}/{power:g}", or --time "1*{clock.operand}" if they are seconds'
    yield clock.finding(prefix, np.arange(len(there)), max(2.0, report.period / clock.longest), text, fix)


def gaps(clock: Clock) -> Iterator[Finding]:
    """Yield the finding that rows are missing."""
    long = np.flatnonzero(clock.steps > _PAUSES * clock.middle)
    if not 0 < len(long) < _FALLS * len(clock.steps):
        return
    first, worst = int(long[0]), float(clock.steps[long].max())
    text = f"{clock.name} has gaps of up to {worst:.4g} {clock.record.report.unit}, {len(long)} in all, first before "
    text += clock.at(first).removeprefix("at ")
    fix = (
        "missing samples, which the model bridges; --from and --to take one side; if the clock jumped and no row is "
        f"lost, --period {clock.pace:g}"
    )
    yield clock.finding("gap", long + 1, worst / (_PAUSES * clock.middle), text, fix)


def jitter(clock: Clock) -> Iterator[Finding]:
    """Yield the finding that the rows are unevenly spaced."""
    scatter, positive = scatter_of(clock.values), clock.steps[clock.steps > 0]
    if not math.inf > scatter > _SCATTERED or clock.varying or (clock.steps <= 0).mean() > _STALE:
        return
    counts, edges = np.histogram(positive[positive <= 3 * clock.middle], bins=30)
    mode = float(edges[int(np.argmax(counts))] + (edges[1] - edges[0]) / 2)
    mostly = f", mostly {mode:.3g}" if counts.max() > len(positive) / 2 else ""
    low, high = np.quantile(positive, (0.01, 0.99))
    text = (
        f"rows are {low:.3g} to {high:.3g} {clock.record.report.unit} apart{mostly}: the steps of {clock.name} scatter "
        f"by {100 * scatter:.3g} % of their median"
    )
    limits = f"dt = [{0.9 * low:.2g}, {1.1 * high:.2g}] in the table of the observer"
    fix = f"with a varying dt the step takes rows at their own times: {limits}"
    yield clock.finding("jitter", np.arange(len(clock.there)), scatter / _SCATTERED, text, fix)


def other_clocks(clock: Clock) -> Iterator[Finding]:
    """Yield the findings about columns that are no signals and increase steadily, as clocks do."""
    columns, table = clock.record.report.columns.values(), clock.table
    even = scatter_of(clock.values) <= _EVEN
    for name in dict.fromkeys(table.header):
        if not name or name in (clock.name, *columns) or table.header.count(name) > 1:
            continue
        stamps = table.column(name).values[clock.rows]
        if not clock.name:
            yield from _contradicted(clock, name, stamps)
            continue
        there = np.isfinite(stamps) & np.isfinite(clock.values)
        if there.sum() < LEAST or not np.all(np.diff(stamps[there]) > 0) or not np.ptp(clock.values[there]) > 0:
            continue
        pace, scatter = np.ptp(stamps[there]) / np.ptp(clock.values[there]), scatter_of(stamps)
        power = 10.0 ** round(math.log10(pace))
        if abs(pace / power - 1) > _SAME:
            continue
        late = clock.values[there] - stamps[there] / power
        delay, spread = float(late.min()), float(np.std(late))
        measured = power == 1 and 0 <= delay < 100 * clock.middle and spread > _JITTER * clock.middle
        fix = f"--time {shlex.quote(name if power == 1 else f'{operand(table, name)}/{power:g}')}"
        if measured:
            text = f"the column {name!r} is earlier than {clock.name} in every row, by {delay:.3g} to {late.max():.3g}"
            text += f" {clock.record.report.unit}: it holds the times of measurement, {clock.name} those of arrival"
            yield clock.finding("clock", np.flatnonzero(there), spread / (_JITTER * clock.middle), text, fix, name)
        elif even and scatter > _JITTER:
            text = (
                f"the column {name!r} runs like a clock, too, and its steps scatter by {100 * scatter:.2g} % of a "
                f"period, where those of {clock.name!r} are even: it may hold the true times"
            )
            yield clock.finding("clock", np.flatnonzero(there), scatter / _JITTER, text, fix, name)


def _contradicted(clock: Clock, name: str, stamps: Array) -> Iterator[Finding]:
    """Yield the findings of a column of `stamps` that contradicts a constant period."""
    steps, period = np.diff(stamps[np.isfinite(stamps)]), clock.record.report.period
    middle = float(np.median(steps)) if len(steps) else 0.0
    if not middle > 0 or np.mean(abs(steps / middle - 1) <= 0.5) < 0.9:
        return
    rows, time = np.flatnonzero(np.isfinite(stamps)), f"--time {shlex.quote(name)}"
    ratio = middle / period
    power = 10.0 ** (3 * round(math.log10(ratio) / 3))
    if len(steps) >= LEAST and _NAMES.search(name) and abs(ratio / power - 1) > _SAME:
        true = float(f"{np.mean(steps) / power:.5g}")
        text = f"the column {name!r} runs like a clock, {middle:.4g} a row, which contradicts --period {period:g}"
        fix = f"--period {true:g}" if power != 1 else f"{time} in place of --period, or --period {true:g}"
        yield clock.finding("period", rows, abs(ratio / power - 1) / _SAME, text, fix, name)


def scatter_of(times: Array) -> float:
    """Return the standard deviation of the time steps over their median, without pauses."""
    steps = np.diff(times[np.isfinite(times)])
    middle = float(np.median(steps)) if len(steps) else 0.0
    usual = steps[np.abs(steps) <= 3 * middle]
    return float(np.std(usual)) / middle if middle > 0 else math.inf


FAULTS = (wraps, repeated, unit, unit_of_seconds, other_clocks, gaps, jitter)  # causes before their effects


def is_of_unit(finding: Finding) -> bool:
    """Return whether a finding says that the times have another unit."""
    return finding.fault in {prefix for prefix, _ in _PREFIXES.values()}


def time_findings(record: Record, varying: bool = False, longest: float = math.inf) -> list[Finding]:
    """Return the faults of the times of a log's rows; `varying`: whether the step accepts a varying dt; `longest`: the
    longest dt that is advised for the step."""
    if record.stamps is None or record.table is None or record.rows is None:
        return []
    clock = Clock(record, record.table, record.rows, record.stamps, *record.clock, varying, longest)
    faults = FAULTS if clock.name else (unit, other_clocks)
    if len(clock.there) < LEAST or clock.middle <= 0:
        return []
    return [one for fault in faults for one in fault(clock)]
