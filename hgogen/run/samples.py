"""Inputs and results of a step that is called from Python: conversion of arguments, one sample, a log.

Samples may arrive late. In the order of measurement a row has the samples measured at its time, y (N, p). In the order
of arrival a row has the arguments of a call: the sample of each output that arrives, and the ages of outputs that may
be late (N, p + ages).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple, Protocol, cast

import numpy as np

from hgogen.errors import BadArgument
from hgogen.program import lines_of
from hgogen.reading.given import count, in_order, names_of, unmasked
from hgogen.registry import Displayed, display, library
from hgogen.run.gates import GateShare
from hgogen.signal import Signal, plural
from hgogen.step import Step
from hgogen.stepping.delays import AT, MEMORY

Engine = Literal["c", "python"]
Take = Callable[[Any], None]


class BadShape(BadArgument):
    """The error for an input or output array of the wrong shape or kind."""


def _position(name: str, names: tuple[str, ...]) -> int:
    if name not in names:
        raise BadShape(f"{name!r}", f"names no state; the states are {', '.join(names)}")
    return names.index(name)


class Legend(NamedTuple):
    """The names of a step's states, status bits and traces; `kind`: the type of its numbers, "d" for double, "f" for
    float."""

    names: tuple[str, ...]
    bits: tuple[str, ...]
    traces: tuple[str, ...]
    kind: Literal["d", "f"] = "d"

    def flags(self, status: int) -> tuple[str, ...]:
        """The names of the bits that are set in a status. Raises: `BadGain` for an invalid status."""
        word = count("status", status, 0, 2**64 - 1)
        return tuple(name for k, name in enumerate(self.bits) if word >> k & 1)


class Sample:
    """The result of a call of a step: the estimate `x` (n) of the states `names`, the status with the names of its
    bits, and the traces.

    It stores the bytes of a call, and converts them to arrays and names on access.
    """

    __slots__ = ("_legend", "_numbers", "_status", "_x")

    def __init__(self, legend: Legend, numbers: bytes, status: int) -> None:
        """Store the result of a call of a step; `numbers`: the estimate, then the traces, as bytes."""
        self._legend = legend
        self._numbers = numbers
        self._status = status
        self._x: np.ndarray | None = None

    @property
    def x(self) -> np.ndarray:
        """The estimate x (n) after the call."""
        if self._x is None:
            self._x = np.frombuffer(self._numbers, self._legend.kind, len(self.names)).astype(float)
        return self._x

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the estimated states."""
        return self._legend.names

    @property
    def status(self) -> int:
        """The status, a bit mask, 0 for ok."""
        return self._status

    @property
    def flags(self) -> tuple[str, ...]:
        """The names of the bits that are set in the status."""
        return self._legend.flags(self._status)

    @property
    def traces(self) -> dict[str, float]:
        """The traces (further numbers of the observer, such as theta) by name."""
        values = memoryview(self._numbers).cast(self._legend.kind)[len(self.names) :].tolist()
        return dict(zip(self._legend.traces, values, strict=True))

    def __getitem__(self, name: str) -> float:
        return float(self.x[_position(name, self.names)])

    def __repr__(self) -> str:
        return f"<sample: {self}>"

    def __str__(self) -> str:
        values = [f"{name} = {value:.6g}" for name, value in zip(self.names, self.x, strict=True)]
        values += [f"{name} = {value:.6g}" for name, value in self.traces.items()]
        return f"{', '.join(values)} ({', '.join(self.flags) or 'ok'})"


class Replayed(Protocol):
    """The interface of a second pass over the samples of a run, which computes the innovations."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """The names of the outputs."""
        ...

    @property
    def innovations(self) -> Any:
        """The innovations of the whole run, an object with `e`, `variances`, `joint` and `covariance`."""
        ...

    @property
    def step(self) -> Step:
        """The step that ran."""
        ...

    @property
    def y(self) -> np.ndarray:
        """The samples of the whole run, in the order of arrival."""
        ...

    def gates(self, status: np.ndarray) -> tuple[GateShare, ...]:
        """Return the share of the samples beyond each gate in calls with this status (N)."""
        ...


@dataclass(frozen=True)
class Run(Displayed):
    """The results of a step over a log: times `t` (N), estimates `x` (N, n), `traces` (N) by name, `status` (N), and
    the engine: "c", "python" or another.

    `replay` computes `innovations`, `variances`, `joint` and `covariance` on access; this run has the samples from
    number `first` on of the replayed run. `times`: the times at the first sample from which the plant's functions of
    time are computed.
    """

    t: np.ndarray
    x: np.ndarray
    names: tuple[str, ...]
    traces: Mapping[str, np.ndarray]
    status: np.ndarray
    engine: Annotated[Engine | Literal["cvodes"], "who ran the step: c, python or cvodes"]
    replay: Replayed | None = field(default=None, repr=False, compare=False)
    first: int = 0
    states: tuple[Signal, ...] = field(default=(), repr=False, compare=False)
    times: tuple[float, ...] = field(default=(), repr=False, compare=False)

    @property
    def outputs(self) -> tuple[str, ...]:
        """The names of the outputs that have innovations; none for a run without a step."""
        return () if self.replay is None else self.replay.outputs

    @property
    def innovations(self) -> np.ndarray | None:
        """The innovations y - yhat (N, p) of all outputs at the prediction, before any corrects, NaN for an unused
        sample; None without a step."""
        return None if self.replay is None else self.replay.innovations.e[self.first :]

    @property
    def variances(self) -> np.ndarray | None:
        """The variances (N, p) of the innovations by the observer, on the diagonal of `joint`; None without a
        covariance."""
        return self._replayed("variances")

    @property
    def joint(self) -> np.ndarray | None:
        """The covariance S (N, p, p) of the innovations of all outputs at the prediction; None without one, and for
        late samples."""
        return self._replayed("joint")

    @property
    def covariance(self) -> np.ndarray | None:
        """The covariance (N, n, n) of the estimates, in the order of `names`, after each sample; None without one."""
        return self._replayed("covariance")

    @property
    def gates(self) -> tuple[GateShare, ...]:
        """The share of the samples beyond each innovation gate, with the expected share; none without gates."""
        return () if self.replay is None else self.replay.gates(self.status)

    def __str__(self) -> str:
        lines = [self.head]
        if len(self.t):
            ends = zip(self.names, self.x[0], self.x.min(axis=0), self.x.max(axis=0), self.x[-1], strict=True)
            lines += [
                f"{name}: first {a:.4g}, least {low:.4g}, largest {high:.4g}, last {b:.4g}"
                for name, a, low, high, b in ends
            ]
        return "\n".join(lines)

    @property
    def head(self) -> str:
        """The number of samples, the engine and the raised status bits, in a line."""
        raised = ", ".join(f"{name} in {count}" for name, count in self.raised.items())
        return f"{len(self.t)} samples, computed by {self.engine}; status bits: {raised or 'none'}"

    @property
    def raised(self) -> dict[str, int]:
        """The number of samples with each status bit, of the bits that were raised; none for a run without a step."""
        layout = None if self.replay is None else self.replay.step.layout
        bits = layout.bits if layout else ()
        counts = {
            bit.name: int(np.count_nonzero(self.status >> np.uint64(k) & np.uint64(1))) for k, bit in enumerate(bits)
        }
        return {name: count for name, count in counts.items() if count}

    def plot(self, truth: Mapping[str, Any] = MappingProxyType({})) -> Sequence[Any]:
        """Return the matplotlib axes of a figure with a panel for each state: the estimate with 2 sigma where the
        observer has a covariance, its measurement, and the `truth` (N) by state.

        Raises: `BadShape` for a run without a step, or a truth that is no column of a state."""
        if self.replay is None:
            raise BadShape("a run without a step", "has no samples to draw; draw its x over t")
        courses = {name: np.asarray(values, dtype=float) for name, values in truth.items()}
        for name, values in courses.items():
            _position(name, self.names)
            if values.shape != self.t.shape:
                raise BadShape(f"truth of {name} of shape {values.shape}", f"must have shape {self.t.shape}")
        axes: Sequence[Any] = display("run_plot")(
            self, by_measurement_time(self.replay.step, self.replay.y)[self.first :], courses
        )
        return axes

    def frame(self) -> Any:
        """A pandas DataFrame by the time t, a row for each sample: estimates, traces and status; the innovations of an
        output y as e_y, their variances, if any, as s_y. Raises: `NotInstalled`."""
        pandas = library("pandas", "run.frame()")
        columns = {name: self.x[:, i] for i, name in enumerate(self.names)} | dict(self.traces)
        columns |= {"status": self.status}
        for j, output in enumerate(self.outputs):
            for letter, values in (("e", self.innovations), ("s", self.variances)):
                if values is not None:
                    columns[f"{letter}_{output}"] = values[:, j]
        return pandas.DataFrame(columns, index=pandas.Index(self.t, name="t"))

    def _replayed(self, name: str) -> np.ndarray | None:
        values = None if self.replay is None else getattr(self.replay.innovations, name)
        return None if values is None else values[self.first :]

    def __getitem__(self, name: str) -> np.ndarray:
        return np.asarray(self.x[:, _position(name, self.names)])

    def off(self, name: str, reference: Any) -> np.ndarray:
        """Return the difference (N) of a state's estimate and a reference (N); for a periodic state within half a
        period."""
        signal = next((each for each in self.states if each.name == name), None)
        reference = np.asarray(reference, dtype=float)
        return np.asarray(self[name] - reference if signal is None else signal.difference(self[name], reference))

    def since(self, first: int) -> "Run":
        """Return the run from sample number `first` on."""
        traces = {name: values[first:] for name, values in self.traces.items()}
        t, x, status = self.t[first:], self.x[first:], self.status[first:]
        passed = float(t[0] - self.t[0]) if len(t) else 0.0
        times = tuple(time + passed for time in self.times)
        first = self.first + min(first, len(self.t))
        return replace(self, t=t, x=x, traces=traces, status=status, first=first, times=times)


# --- conversion of arguments


def sample_writer(name: str, signals: Sequence[Signal], array: np.ndarray, at: int) -> Take:
    """Return a function that writes one sample of the `signals` into `array`, from index `at` on; `name`: the argument
    in error messages.

    The function accepts floats, a mapping by the signals' names, and whatever numpy converts. It raises `BadShape` or
    `BadNames`, and then writes nothing.
    """
    size, values = len(signals), cast(Any, array.data)  # setting an item of it takes a third of the time

    def convert(value: Any) -> None:
        demand_given(name, value, signals)
        array[at : at + size] = numbers(name, in_order(name, value, names_of(signals)), size, signal_order(signals))

    def none(value: Any) -> None:
        if type(value) is not tuple or value:
            convert(value)

    def one(value: Any) -> None:
        if isinstance(value, float):
            values[at] = value
        else:
            convert(value)

    def several(value: Any) -> None:
        if type(value) in (tuple, list) and len(value) == size and all(isinstance(each, float) for each in value):
            for place, each in enumerate(value, at):
                values[place] = each
        else:
            convert(value)

    return {0: none, 1: one}.get(size, several)


def numbers(name: str, value: Any, size: int, order: str = "") -> np.ndarray:
    """Return the value of an argument as an array (size), NaN for masked entries; `name`, `order`: the argument and the
    order of its elements, for the message. Raises: `BadShape`."""
    array = reals(name, value, with_value=True).reshape(-1)
    if array.shape != (size,):
        raise BadShape(f"{name} of shape {np.shape(value)}", f"must have {size} element{'s' * (size != 1)}{order}")
    return array


def table(name: str, value: Any, signals: Sequence[Signal], rows: int | None) -> np.ndarray:
    """Return a log of `signals` as an array (N, number of signals), from an array or from columns (N) by the names of
    signals; NaN where an entry is masked. `name`: the argument in messages; `rows`: the demanded N, None for any.

    Raises: `BadShape`, `BadNames`.
    """
    width = len(signals)
    if rows != 0:
        demand_given(name, value, signals)
    if hasattr(value, "columns") and hasattr(value, "to_numpy"):
        value = _frame_columns(name, value, signals)
    if isinstance(value, Mapping):
        columns = in_order(name, value, names_of(signals))
        lengths = dict(zip(names_of(signals), map(np.size, columns), strict=True))
        if len(set(lengths.values())) > 1:
            listing = ", ".join(f"{signal} {length}" for signal, length in lengths.items())
            raise BadShape(f"{name} with columns of different lengths ({listing})", "must have one length for all")
        arrays = [numbers(f"{name} of {s}", c, n) for c, (s, n) in zip(columns, lengths.items(), strict=True)]
        value = np.stack(arrays, 1) if arrays else []
    array = reals(name, value)
    if array.ndim == 1 and width == 1:
        array = array[:, None]
    if width == 0 and array.size == 0:
        array = np.zeros((rows or 0, 0))
    if array.ndim != 2 or array.shape[1] != width or (rows is not None and len(array) != rows):
        length = "N" if rows is None else rows
        wanted = f"({length}, {width})" + f" or ({length},)" * (width == 1)
        raise BadShape(f"{name} of shape {np.shape(value)}", f"must have shape {wanted}{signal_order(signals)}")
    return np.ascontiguousarray(array)


def with_elapsed(step: Step, u: np.ndarray, dt: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the inputs u (.., N, m), and the elapsed time (.., N) of each sample, in which negative and NaN values
    count as 0. For a step with varying dt, u has the given times `dt` (a number, (N) or (.., N)) as its last column.

    Raises: `BadShape`.
    """
    if not step.clock.varying:
        if dt is not None:
            raise BadShape("dt", f"is for a step in which it varies; this one has dt = {step.dt:g}")
        return u, np.zeros(u.shape[:-1])
    if dt is None:
        way = f"give the time since the row before in {plural(step.time)}, as dt="
        raise BadShape("dt", f"is missing; {way}, or for a log at one period take a step with a number as dt (--dt)")
    elapsed = reals("dt", dt)
    if elapsed.ndim > 2 or (elapsed.ndim and elapsed.shape[-1] != u.shape[-2]):
        raise BadShape(f"dt of shape {elapsed.shape}", f"must be a number, or have {u.shape[-2]} for each log")
    lead = np.broadcast_shapes(elapsed.shape[:-1], u.shape[:-2])
    elapsed = np.broadcast_to(elapsed, (*lead, u.shape[-2]))
    wide = np.concatenate([np.broadcast_to(u, (*lead, *u.shape[-2:])), elapsed[..., None]], axis=-1)
    return np.ascontiguousarray(wide), np.where(elapsed > 0, elapsed, 0.0)


def reals(name: str, value: Any, *, with_value: bool = False) -> np.ndarray:
    """Return values as an array of doubles, NaN for masked entries. `name`: the argument in messages; `with_value`:
    whether the message has the value. Raises: `BadShape` for text, dates and complex numbers, whose imaginary parts
    would be lost."""
    try:
        array = np.asarray(unmasked(value))
        objects = array.flat if array.dtype.kind == "O" else ()
        if array.dtype.kind not in "biufO" or any(isinstance(one, str | bytes) for one in objects):
            raise TypeError
        return array.astype(float, copy=False)
    except OverflowError:
        raise BadShape(name, "has a number beyond the range of a double") from None
    except (TypeError, ValueError):
        raise BadShape(f"{name} = {value!r}" if with_value else name, "is not an array of numbers") from None


def _frame_columns(name: str, frame: Any, signals: Sequence[Signal]) -> dict[str, np.ndarray]:
    absent = [signal.name for signal in signals if signal.name not in frame.columns]
    if absent:
        there = ", ".join(map(str, frame.columns))
        raise BadShape(f"{name}, a DataFrame", f"has no column {', '.join(absent)}; its columns are {there}")
    return {signal.name: frame[signal.name].to_numpy(dtype=float) for signal in signals}


def last_values(values: np.ndarray) -> np.ndarray:
    """Return the columns (N, c) with each missing number replaced by the last one; NaN before the first."""
    rows = np.where(np.isfinite(values), np.arange(len(values))[:, None], 0)
    return np.take_along_axis(values, np.maximum.accumulate(rows, axis=0), axis=0)


def demand_given(name: str, value: Any, signals: Sequence[Signal]) -> None:
    """Raise `BadShape` if the argument `name` is missing (the empty tuple, its default) although there are signals."""
    if isinstance(value, tuple) and not value and signals:
        raise BadShape(name, f"is missing; give {name}=, the values of {', '.join(s.name for s in signals)}")


def signal_order(signals: Sequence[Signal]) -> str:
    """Return the end of an error message that lists several signals in order, with the derivatives of inputs that a
    form needs."""
    return f": {', '.join(s.name for s in signals)}" if len(signals) > 1 else ""


Array = np.ndarray


def arriving(step: Step, y: Array) -> Array:
    """Return the samples y (N, p), given at the rows of their measurement, at the rows in which they arrive with the
    step's longest delays, followed by a column of ages for each late output; unchanged for a step without delays."""
    if not step.ages:
        return y
    columns = [y[:, j] for j in range(len(step.outputs))]
    for output, age in zip(step.late, step.ages, strict=True):
        j, most = step.outputs.index(output), int(age.interval[1])
        columns[j] = np.concatenate([np.full(min(most, len(y)), np.nan), y[: max(0, len(y) - most), j]])
        columns.append(np.full(len(y), float(most)))
    return np.column_stack(columns)


def at_sampling_times(step: Step, y: Array) -> Array:
    """Return the samples y (N, p) with NaN in the rows in which a slower sensor has no sample."""
    every = step.clock.every or (1,) * len(step.outputs)
    return np.where(np.arange(len(y))[:, None] % every == 0, y, np.nan)


def by_measurement_time(step: Step, samples: Array) -> Array:
    """Return samples (N, p) at the rows of their measurement, from `samples` (N, p + ages) at the rows of their
    arrival: the first of several for one row, NaN if none arrived in time."""
    y = samples[:, : len(step.outputs)].copy()
    for column, (output, age) in enumerate(zip(step.late, step.ages, strict=True), len(step.outputs)):
        j, ages = step.outputs.index(output), samples[:, column]
        by_row = np.full(len(y), np.nan)
        there = np.isfinite(y[:, j]) & (ages >= 0) & (ages <= age.interval[1]) & (ages == np.floor(ages))
        for row in np.flatnonzero(there):
            then = row - int(ages[row])
            if then >= 0 and np.isnan(by_row[then]):
                by_row[then] = y[row, j]
        y[:, j] = by_row
    return y


def at_measurement_time(step: Step, records: Array, j: int) -> Array:
    """Return the records (N) of a step's memory, set back to the period in which the sample of output `j` was measured,
    after its prediction; unchanged for a step without delays."""
    if not step.ages:
        return records
    state, output, rows = records["state"], step.outputs[j], np.arange(len(records))
    ages = {late: records["output"][age.name] for late, age in zip(step.late, step.ages, strict=True)}
    ring = state[MEMORY]
    age = np.nan_to_num(ages.get(output, np.zeros(len(records))), nan=0.0, posinf=0.0, neginf=0.0)
    then = (state[AT.name].astype(int) - np.clip(age, 0, ring.shape[1] - 1).astype(int)) % ring.shape[1]
    back = records.copy()
    plain = step.plain.layout.groups if step.plain else ()
    groups = {f"{MEMORY}_{line[0].name}": line[0].name for line in lines_of(plain)}
    for name in ring.dtype.names or ():
        back["state"][groups.get(name, name)] = ring[name][rows, then]
    return back
