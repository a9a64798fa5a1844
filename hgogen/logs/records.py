"""Measured records as arrays, and what is demanded of them."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from hgogen.errors import BadArgument
from hgogen.reading.measured import PYTHON, WINDOWS, difference, read
from hgogen.run.samples import held_last, table
from hgogen.signal import Signal, derived, resting
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
    held = held_last(u)
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
