"""Memory and engines of a step that is called from Python: compiled C, Python, and C for many logs at once.

The memory is one NumPy record in the layout of the C structs (`emit.layout`), on which both engines work in place. They
compute the same bits, so the engine may change at any sample.

Many logs run in SIMD lanes (`targets.lanes`) by threads, or one by one where the step has no lanes, with the same bits.
The initial state and the parameters of a log are a record of `emit.layout`; the memory in lanes has the same order.
"""

import ctypes
import operator
import os
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from dataclasses import fields as fields_of
from functools import cached_property, lru_cache, partial
from itertools import product
from typing import Any, Literal

import numpy as np

from hgogen import targets
from hgogen.emit import layout, pystep
from hgogen.emit.cost import cost
from hgogen.emit.lanewriter import NoLanes
from hgogen.emit.pystep import Entry
from hgogen.emit.saved import mark, opened, sealed
from hgogen.emit.syntax import DTYPE, Real
from hgogen.program import Field, Place
from hgogen.reading.given import BadGain, among, count, requires_switches, unmasked
from hgogen.run import native
from hgogen.run.samples import BadShape, Engine, reals, signal_order, table, with_elapsed
from hgogen.signal import Signal
from hgogen.step import Step
from hgogen.stepping.guards import UNINITIALISED

COMPILED = 6e6  # operations in Python that take about as long as to compile a step
FUNCTION = 40  # operations in Python that take as long as a sine


def quickest_engine(step: Step, samples: int) -> Engine:
    """Return the engine that is fastest for a log of this many samples: Python for a short log, else the compiled step
    if there is a compiler. Both compute the same bits."""
    each = cost(step)
    short = samples * (each.operations + FUNCTION * each.functions) < COMPILED
    return "python" if short else native.engine()


class StepMemory:
    """The memory of a step in the precision `real`, its `places` (arrays by struct and field), and the step's functions
    that work on it.

    `signals`: the inputs u, then the outputs y, of one sample in that precision; `outputs`: the estimate, then the
    traces.
    """

    def __init__(self, step: Step, real: Real) -> None:
        self.step, self.real, self.record = step, real, layout.initial_record(step, real)
        self.places = layout.places(step, self.record)
        self._readers: dict[Engine, Mapping[str, Entry]] = {}
        self.whole = self.record.view(np.uint8).data
        self.state = self.whole[: layout.state_type(step, real).itemsize]
        views, signals = len(step.states) + len(step.traces), len(step.given) + len(step.samples)
        self.signals, self.outputs = np.split(self.record.view(DTYPE[real])[-signals - views :], [signals])
        self._new = bytes(self.state)

    def reset(self) -> None:
        """Set the state to its value before the first call."""
        self.state[:] = self._new

    def saved(self, state: Any) -> bytes:
        """Return the bytes of the state in a saved state. Raises: `BadShape` for an argument that is no bytes;
        `NotSaved` for a damaged state, or one of another program."""
        if not isinstance(state, bytes | bytearray | memoryview):
            raise BadShape(f"a saved state that is a {type(state).__name__}", "is no bytes; give what save() gave")
        return opened(self.step, self.real, bytes(state), len(self.state))

    def ready(self, engine: Engine | None, default: Engine | None) -> Engine:
        """Return the engine for a log, after running `tune` on the memory: the requested `engine`, else the step's
        `default`, else C if there is a compiler, else Python.

        Raises: `BadShape`; `NoCompiler`, `CompilerFailed`.
        """
        if not among(engine, (None, "c", "python")):
            raise BadShape(f"engine = {engine!r}", 'must be "c", "python" or None')
        engine = engine or default
        if engine is None and not native.compiler():
            warnings.warn(str(native.NoCompilerWarning.__doc__), native.NoCompilerWarning, stacklevel=3)
        engine = engine or native.engine()
        self.entries(engine)
        return engine

    def entries(self, engine: Engine) -> Mapping[str, Entry]:
        """Return the functions of a step (step, estimate, tune ..) by name, in C or Python as `engine` says; they are
        built at the first call.

        Raises: `NoCompiler`, `CompilerFailed`.
        """
        if engine not in self._readers:
            entries = self._compiled() if engine == "c" else pystep.entries(self.step, self.record, self.real)
            entries["tune"]()
            self._readers[engine] = entries
        return self._readers[engine]

    def run(self, engine: Engine, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return estimates (N, n), traces (N, number of them) and statuses (N) of a step over samples u (N, m), y (N,
        p)."""
        with np.errstate(over="ignore"):  # a number beyond a float becomes infinite, a missing sample
            u, y = (array.astype(DTYPE[self.real], copy=False) for array in (u, y))
        n, traces = len(self.step.states), len(self.step.traces)
        step, status = self.entries(engine)["step"], np.zeros(len(y), self.step.layout.word)
        if engine == "c":
            x, traced = np.zeros((len(y), n), u.dtype), np.zeros((len(y), traces), u.dtype)
            arrays = (self.record["state"], self.record["params"], u, y, x, traced, status)
            state, params, *signals = (ctypes.c_void_p(array.ctypes.data) for array in arrays)
            getattr(self._library, f"{self.step.name}_record")(state, params, ctypes.c_size_t(len(y)), *signals)
            return x.astype(float, copy=False), traced.astype(float, copy=False), status
        rows = np.zeros((len(y), n + traces))
        for k, row in enumerate(np.hstack([u, y])):
            self.signals[:] = row
            status[k] = step()
            rows[k] = self.outputs
        return rows[:, :n], rows[:, n:], status

    @cached_property
    def _library(self) -> ctypes.CDLL:
        return _library_of(_Program(self.step, self.real), native.compiler())

    def _compiled(self) -> dict[str, Entry]:
        """Return the C functions of the step by name, bound to this memory. Calls of them hold Python's GIL."""
        step, library = self.step, self._library
        size = getattr(library, f"{step.name}_kept_size")
        size.restype = ctypes.c_size_t
        if size() != self.record.itemsize:
            raise BadShape(f"the C struct {step.name}_kept", f"has {size()} bytes, Python's {self.record.itemsize}")
        names = ["step", "estimate", "tune"]
        names += [section.name for section in (*step.code.sections, *step.code.timed)] if step.code.separable else []
        kind = ctypes.PYFUNCTYPE(np.ctypeslib.as_ctypes_type(step.layout.word), ctypes.c_void_p)
        calls = {name: kind((f"{step.name}_kept_{name}", library)) for name in names}
        return {name: partial(call, self.record.ctypes.data) for name, call in calls.items()}


@dataclass(frozen=True, eq=False)
class _Program:
    """A step in a precision as the key of a cache: two are equal if their parts are identical objects."""

    step: Step
    real: Real

    @cached_property
    def _parts(self) -> list[object]:
        return [getattr(self.step, each.name) for each in fields_of(Step)]

    def __hash__(self) -> int:
        return hash((self.real, *map(id, self._parts)))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, _Program) or self.real != other.real:
            return False
        return all(map(operator.is_, self._parts, other._parts))


@lru_cache(maxsize=32)
def _library_of(program: _Program, _: str | None) -> ctypes.CDLL:
    step, real = program.step, program.real
    unread = {"observer": replace(step.observer, claims=tuple)}
    step = Step(**{each.name: getattr(step, each.name) for each in fields_of(Step)} | unread)
    return native.library({**targets.c99(step, real=real, check=False), **targets.record(step, real=real)})


Array = np.ndarray
Starts = Mapping[str, Any] | Sequence[bytes]
Started = Callable[[Mapping[str, float]], bytes]  # from the plant's state by name to the step's initial state


@dataclass(frozen=True, eq=False)
class Records:
    """The data of `count` logs (B) for a step: inputs `u` (B, N, m), or (N, m) for all; measurements `y` (B, N, p), or
    (N, p) for all; `parameters` by place of memory, (B, size), or (size) for all; initial `states`, one for all or one
    for each log, none to continue from the step's present state."""

    u: Array
    y: Array
    count: int
    parameters: Mapping[Place, Array]
    states: Sequence[bytes]

    @classmethod
    def of(
        cls, memory: "StepMemory", u: Any, y: Any, parameters: Any, starts: Any, started: Started, dt: Any
    ) -> "Records":
        """Return the logs from a caller's arguments. `starts`: initial values of the plant's states by name, or saved
        states; `started` converts the former into a state of the step. Raises: `BadShape`, `BadNames`; `NotSaved`;
        errors of `started`."""
        step = memory.step
        y = _signals("y", y, step.samples, None)
        u, _ = with_elapsed(step, _signals("u", u, step.inputs, y.shape[-2]), dt)
        varied = _parameters(step, {} if parameters is None else parameters)
        starts = () if starts is None else starts
        named = isinstance(starts, Mapping)
        if not (named or isinstance(starts, Sequence)):
            wanted = "is no mapping from states to numbers, and no list of saved states, such as many.states"
            raise BadShape(f"starts = {starts!r}", wanted)
        columns = {name: _values(f"starts {name}", value, 1) for name, value in starts.items()} if named else {}
        lengths = {name: len(array) for name, array in (("u", u), ("y", y)) if array.ndim == 3}
        lengths |= {place.name: len(array) for place, array in varied.items() if array.ndim > 1}
        lengths |= {f"starts {name}": len(array) for name, array in columns.items() if array.ndim > 1}
        lengths |= {} if named or not len(starts) else {"starts": len(starts)}
        if len(set(lengths.values())) > 1:
            listing = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise BadShape(f"different numbers of records ({listing})", "must be one for all")
        number = next(iter(lengths.values()), 1)
        if not named:
            return cls(u, y, number, varied, list(map(memory.saved, starts)))
        rows = list(zip(*(np.broadcast_to(c.reshape(-1), number).tolist() for c in columns.values()), strict=True))
        states = {row: memory.saved(started(dict(zip(columns, row, strict=True)))) for row in dict.fromkeys(rows)}
        return cls(u, y, number, varied, [states[row] for row in rows])

    def prepare(self, k: int, memory: "StepMemory", base: bytes, engine: Engine) -> int:
        """Set `memory` to the initial memory of log number `k`: `base` (bytes) with that log's state and parameters.
        Return the status of `tune`, 0 without parameters."""
        memory.whole[:] = base
        if self.states:
            memory.state[:] = self.states[k % len(self.states)]
        for place, values in self.parameters.items():
            memory.places[place][:] = values[k] if values.ndim == 2 else values
        return memory.entries(engine)["tune"]() if self.parameters else 0


def tunable(step: Step) -> dict[str, tuple[Place, Field]]:
    """Return the place and the field of each tunable parameter by name."""
    kinds = [("plant", item) for item in step.layout.plant] + [("gain", item) for item in step.layout.gains]
    return {item.name: (Place(kind, item.name), item) for kind, item in kinds}


def _parameters(step: Step, parameters: Any) -> dict[Place, Array]:
    """Return the values of parameters, (B, size) for B logs or (size) for all, by place of memory."""
    known = tunable(step)
    if not isinstance(parameters, Mapping):
        wanted = f"is no mapping from some of {', '.join(known)} to numbers"
        raise BadShape(f"parameters = {parameters!r}", wanted)
    for name in parameters:
        if name not in known:
            raise BadShape(f"parameters {name!r}", f"names nothing tunable; that is {', '.join(known)}")
    return {known[name][0]: _values(name, value, known[name][1].size) for name, value in parameters.items()}


def _signals(name: str, value: Any, signals: Sequence[Signal], rows: int | None) -> Array:
    """Return signals (B, N, number) of B logs, or (N, number) for all,
    from any shape that one log may have; `rows`: the demanded N."""
    if not isinstance(value, np.ndarray | list | tuple) or np.ndim(value) != 3:
        return table(name, value, signals, rows)
    array, width = unmasked(value), len(signals)
    count, length, last = np.shape(array)
    if last != width or rows not in (None, length):
        wanted = f"must have shape (B, {'N' if rows is None else rows}, {width}), or that without B for all records"
        raise BadShape(f"{name} of shape {(count, length, last)}", f"{wanted}{signal_order(signals)}")
    return table(name, np.reshape(array, (count * length, width)), signals, None).reshape(count, length, width)


def _values(name: str, value: Any, size: int) -> Array:
    """Return numbers (B, size) for B logs, or (size) for all."""
    array = reals(name, value)
    array = array[..., None] if size == 1 else array
    if array.ndim not in (1, 2) or array.shape[-1] != size:
        wanted = "a number, or one for each record (B)" if size == 1 else f"({size}), or (B, {size})"
        raise BadShape(f"{name} of shape {np.shape(value)}", f"must be {wanted}")
    return array


MOST_THREADS = 1000
CHUNK = 64  # logs that a thread processes at a time
ALIGNED, LANES = 64, 16  # bytes of the widest register, and its size in numbers
Memories = Callable[[int], memoryview]  # from the number of a log to its initial memory
Each = Callable[[int, int], object]  # called with the number of finished logs and of all logs


@dataclass(frozen=True)
class Batch:
    """The results of B logs: estimates `x` (B, N, n) of the states `names`, `status` (B, N), requested `traces` (B, N)
    by name; `engine`: "lanes" (SIMD), or the engine that ran the logs one by one; `memory` (B, bytes): the final
    states, which `seal` turns into saved states; `tuned` (B): the status of `tune` for each log's parameters, 0 for
    ok."""

    x: Array
    names: tuple[str, ...]
    status: Array
    traces: Mapping[str, Array]
    engine: Literal["lanes", "c", "python"]
    memory: Array = field(repr=False)
    tuned: Array
    seal: Callable[[bytes], bytes] = field(repr=False)

    @property
    def states(self) -> tuple[bytes, ...]:
        """The final state of each log as a saved state, from which a next log can start (`starts`)."""
        return tuple(map(self.seal, map(bytes, self.memory)))


@dataclass(frozen=True, eq=False)
class Many:
    """A runner of a step over many logs in the precision `real`: in SIMD lanes (a log in each vector element), or one
    log after the other."""

    step: Step
    real: Real

    @requires_switches
    def run(
        self, records: Records, base: bytes, engine: Engine, jobs: int | None, *, traces: bool, each: Each | None
    ) -> Batch:
        """Return the results of all logs, each started from the memory `base` (bytes). `jobs`: threads; `each(done,
        count)` is called with the number of finished logs and of all. Raises: `BadGain` for jobs that are no number,
        and for `each` that cannot be called; `Misfit`."""
        if not (each is None or callable(each)):
            raise BadGain(f"each = {each!r}", "must be a function of how many records are done, and of how many")
        number, spare, word = records.count, self.spare, self.step.layout.word
        results, tuned = _Results.of(self.step, records.y.shape[-2], number, traces, self.real), np.zeros(number, word)
        lanes = self.lanes if engine == "c" else None
        threads = (os.cpu_count() or 1) if jobs is None else count("jobs", jobs, 1, MOST_THREADS)

        def memory(k: int) -> memoryview:
            tuned[k] = records.prepare(k, spare, base, engine)
            return spare.whole

        spare.entries(engine)
        alone = self._alone(records, memory, results, engine)
        for done in lanes.chunks(records.u, records.y, memory, results, threads) if lanes else alone:
            if each:
                each(done, number)
        x, status, views = results.x[..., :number], results.status[:, :number], results.traces[..., :number]
        names = self.step.traces if traces else ()
        return Batch(
            x.transpose(2, 0, 1).astype(float, copy=False),
            tuple(signal.name for signal in self.step.states),
            status.T,
            {name: views[:, j].T.astype(float, copy=False) for j, name in enumerate(names)},
            "lanes" if lanes else engine,
            results.states,
            tuned,
            partial(sealed, self.step, self.real),
        )

    def _alone(self, records: Records, memory: Memories, results: "_Results", engine: Engine) -> Iterator[int]:
        for k in range(results.records):
            memory(k)
            signals = (array[k] if array.ndim == 3 else array for array in (records.u, records.y))
            x, traces, status = self.spare.run(engine, *signals)
            results.x[:, :, k], results.status[:, k] = x, status
            results.states[k] = np.frombuffer(self.spare.state, np.uint8)
            if results.traced:
                results.traces[:, :, k] = traces
            yield k + 1

    @cached_property
    def spare(self) -> StepMemory:
        """A memory of the step for internal runs, separate from the caller's."""
        return StepMemory(self.step, self.real)

    @cached_property
    def lanes(self) -> "_Lanes | None":
        """The step compiled to SIMD code, with a log in each vector element; None where the step has no such code, or
        the compiler does not support vectors."""
        try:
            files = targets.lanes(self.step, real=self.real)
            return _Lanes(self.step, self.real, native.library(files, ("-O2", *native.machine_flags())))
        except (NoLanes, native.CompilerFailed):
            return None


@dataclass(frozen=True, eq=False)
class _Results:
    """The results of B logs with the logs along the last axis: x (N, n, B), traces (N, number, B),
    status (N, B), padded for vector elements without a log; and the final states (B, bytes)."""

    records: int
    traced: bool
    x: Array
    traces: Array
    status: Array
    states: Array

    @classmethod
    def of(cls, step: Step, samples: int, records: int, traced: bool, real: Real) -> "_Results":
        kind, size = DTYPE[real], layout.state_type(step, real).itemsize
        width = -(-records // LANES) * LANES
        x: Array = np.empty((samples, len(step.states), width), kind)
        traces: Array = np.empty((samples, len(step.traces) * traced, width), kind)
        status, states = np.empty((samples, width), step.layout.word), np.empty((records, size), np.uint8)
        return cls(records, traced, x, traces, status, states)


@dataclass(frozen=True, eq=False)
class _Lanes:
    """A step compiled to SIMD code: each vector element (lane) computes another log."""

    step: Step
    real: Real
    library: ctypes.CDLL

    def chunks(self, u: Array, y: Array, memory: Memories, results: _Results, jobs: int) -> Iterator[int]:
        done, waiting = 0, deque[Future[int]]()
        with ThreadPoolExecutor(jobs) as pool:
            for first in range(0, results.records, CHUNK):
                last = min(first + CHUNK, results.records)
                records = np.stack([np.frombuffer(bytes(memory(k)), np.uint8) for k in range(first, last)])
                waiting.append(pool.submit(self._run, u, y, records, results, first))
                if len(waiting) > 2 * jobs:
                    done += waiting.popleft().result()
                    yield done
            while waiting:
                done += waiting.popleft().result()
                yield done

    def _run(self, u: Array, y: Array, records: Array, results: _Results, first: int) -> int:
        u, y = (_side_by_side(array, first, len(records), DTYPE[self.real]) for array in (u, y))
        begun = self._begun(records, len(results.x))
        memory, call = self._memory(records), getattr(self.library, f"{self.step.name}_lanes_run")
        widths = [*(array.shape[2] if array.ndim == 3 else 0 for array in (u, y)), results.status.shape[1]]
        width = (ctypes.c_size_t * 3)(*widths)
        for block, lanes in enumerate(memory):
            at = block * self.width
            signals = (array[..., at:] if array.ndim == 3 else array for array in (u, y))
            views = (array[..., first + at :] for array in (results.x, results.traces, results.status))
            x, traces, status = map(_address, views)
            arrays = (*map(_address, signals), x, traces if results.traced else ctypes.c_void_p(), status)
            call(_address(lanes), ctypes.c_size_t(len(results.x)), width, *arrays)
        self._remembered(memory, records)
        places = [bit.place for bit in self.step.layout.bits]
        if UNINITIALISED.place in places:
            anew = 1 << places.index(UNINITIALISED.place)
            results.status[:1, first : first + len(records)][:, begun] |= anew
        results.states[first : first + len(records)] = records[:, : results.states.shape[1]]
        return len(records)

    def _begun(self, records: Array, samples: int) -> Array:
        """Initialise the records (B, bytes) of memory that are not marked
        as initialised, if there are samples; return their indices."""
        fresh = np.frombuffer(layout.fresh(self.step, self.real), np.uint8)
        if not (self.step.layout.mark and samples):
            return np.array([], int)
        missing = records.view(np.uint32)[:, 0] != mark(self.step, self.real)
        records[missing, : len(fresh)] = fresh
        return np.flatnonzero(missing)

    @cached_property
    def width(self) -> int:
        return self._size("width")

    def _size(self, name: str) -> int:
        size = getattr(self.library, f"{self.step.name}_lanes_{name}")
        size.restype = ctypes.c_size_t
        return int(size())

    @cached_property
    def _numbers(self) -> list[tuple[Array, Array, np.dtype, np.dtype]]:
        record, real = layout.kept_type(self.step, self.real), np.dtype(DTYPE[self.real])
        assert record.fields
        parts = [record.fields[part] for part in ("state", "params")]
        every = [place for kind, offset, *_ in parts for place in _numbers(kind, offset)]

        def of(kind: np.dtype, lanes: np.dtype) -> tuple[Array, Array, np.dtype, np.dtype]:
            there = [k for k, (_, each) in enumerate(every) if each == kind]
            here = [every[k][0] // kind.itemsize for k in there]
            return np.array(there, int), np.array(here, int), lanes, kind

        return [of(real, real), of(np.dtype(np.uint32), np.dtype(f"u{real.itemsize}"))]

    def _memory(self, records: Array) -> Array:
        """Return the memory for lanes (blocks, bytes) from records
        (B, bytes) of logs; lanes without a log repeat the last."""
        blocks, size = -(-len(records) // self.width), self._size("size")
        room = np.zeros(ALIGNED + blocks * size, np.uint8)
        start = -room.ctypes.data % ALIGNED
        memory: Array = room[start : start + blocks * size].reshape(blocks, size)
        records = records[np.minimum(np.arange(blocks * self.width), len(records) - 1)]
        for there, here, lanes, kind in self._numbers:
            numbers = records.view(kind)[:, here].reshape(blocks, self.width, -1)
            memory.view(lanes).reshape(blocks, -1, self.width)[:, there] = numbers.transpose(0, 2, 1)
        return memory

    def _remembered(self, memory: Array, records: Array) -> None:
        for there, here, lanes, kind in self._numbers:
            numbers = memory.view(lanes).reshape(len(memory), -1, self.width)[:, there].transpose(0, 2, 1)
            records.view(kind)[:, here] = numbers.reshape(-1, len(here))[: len(records)]


def _numbers(kind: np.dtype, start: int) -> Iterator[tuple[int, np.dtype]]:
    if kind.subdtype:
        base, shape = kind.subdtype
        for k, _ in enumerate(product(*map(range, shape))):
            yield from _numbers(base, start + k * base.itemsize)
    elif kind.names:
        for inner, offset, *_ in (kind.fields or {}).values():
            yield from _numbers(inner, start + offset)
    else:
        yield start, kind


def _side_by_side(array: Array, first: int, records: int, kind: type) -> Array:
    """Return signals (B, N, m), from log number `first` on, as (N, m, CHUNK), logs
    along the last axis; signals (N, m) common to all logs are unchanged."""
    with np.errstate(over="ignore"):  # a number beyond a float becomes infinite, a missing sample
        if array.ndim == 2:
            return np.ascontiguousarray(array, dtype=kind)
        room = np.zeros((*array.shape[1:], CHUNK), kind)
        room[:, :, :records] = array[first : first + records].transpose(1, 2, 0)
    return room


def _address(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
