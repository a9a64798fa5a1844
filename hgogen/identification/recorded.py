"""A log as a record of a plant: a file's path or a DataFrame, its columns as signals, on a grid."""

from collections.abc import Mapping
from typing import Any, Literal

from hgogen.errors import BadArgument
from hgogen.identification.records import Log
from hgogen.reading.averaged import WINDOWS
from hgogen.reading.measured import PYTHON, read
from hgogen.system import System


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
    signals = (*plant.inputs, *plant.outputs)
    named = dict(columns or {})
    unknown = [name for name in (*named, *(shift or {})) if name not in [s.name for s in signals]]
    if unknown:
        raise BadSignal(unknown[0], f"is no signal; the signals are {', '.join(s.name for s in signals)}")
    inputs = {s.name: WINDOWS[between] for s in plant.inputs}
    wanted: dict[str, str] = {str(s.name): named.get(s.name, str(s.name)) for s in signals}
    units = {s.name: s.unit for s in signals}
    words: dict[str, Any] = {"time": time, "period": period, "unit": plant.time, "units": units, "caller": PYTHON}
    got = read(source, wanted, dt=dt, inputs=inputs, **words)
    got = got.shifted(shift or {})
    return Log(got.of(plant.inputs), got.of(plant.outputs), got.report.dt)
