"""A step on many records at once: in lanes (`targets.lanes`) by threads, or where they cannot be had one by one.

Both give the same bits. What a record starts from and its parameters are a scalar record of `emit.layout`, whose
numbers in their order are those of the memory in lanes.
"""

import ctypes
import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import product
from typing import Literal

import numpy as np

from hgogen import targets
from hgogen.emit import layout
from hgogen.emit.lanewriter import NoLanes
from hgogen.emit.saved import mark, sealed
from hgogen.emit.syntax import DTYPE, Real
from hgogen.reading.given import BadGain, count, switches
from hgogen.run import native
from hgogen.run.asked import Asked
from hgogen.run.readers import Kept
from hgogen.run.samples import Engine
from hgogen.step import Step
from hgogen.stepping.ready import UNINITIALISED

MOST_THREADS = 1000
CHUNK = 64  # records whose signals a thread holds at a time
ALIGNED, LANES = 64, 16  # bytes of the widest register, and how many numbers it holds
Array = np.ndarray
Memories = Callable[[int], bytes]  # of the number of a record: what it starts from
Each = Callable[[int, int], object]  # is told how many records are done, and of how many


@dataclass(frozen=True)
class Batch:
    """What many records give: estimates `x` (B, N, n) of the states `names`, `status` (B, N), `traces` (B, N) by name
    where they were asked for; `engine`: "lanes" where they ran in lanes, else what took them one by one; `memory`
    (B, bytes) of the states at their ends, which `seal` makes what is saved; `tuned` (B): what `tune` says of each
    one's parameters, 0 for ok."""

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
        """The state that each record leaves, as `save` gives it: the `starts` of what comes after."""
        return tuple(map(self.seal, map(bytes, self.memory)))


@dataclass(frozen=True, eq=False)
class Many:
    """What many records can be run by, of a step in the precision `real`."""

    step: Step
    real: Real

    @switches
    def run(
        self, asked: Asked, memory: Memories, engine: Engine, jobs: int | None, *, traces: bool, each: Each | None
    ) -> Batch:
        """The records, each from its memory. Raises: `BadShape`, `BadNames`; `BadGain` for jobs that are no number, and
        what is not to be called; `Misfit`."""
        if not (each is None or callable(each)):
            raise BadGain(f"each = {each!r}", "must be a function of how many records are done, and of how many")
        u, y, number = asked.u, asked.y, asked.count
        results = _Results.of(self.step, y.shape[-2], number, traces, self.real)
        lanes = self.lanes if engine == "c" else None
        threads = (os.cpu_count() or 1) if jobs is None else count("jobs", jobs, 1, MOST_THREADS)
        alone = self._alone(u, y, memory, results, engine)
        for done in _threaded(lanes, u, y, memory, results, threads) if lanes else alone:
            if each:
                each(done, number)
        x, status, shown = results.x[..., :number], results.status[:, :number], results.traces[..., :number]
        names = self.step.observer.traces if traces else ()
        return Batch(
            x.transpose(2, 0, 1).astype(float, copy=False),
            tuple(signal.name for signal in self.step.states),
            status.T,
            {name: shown[:, j].T.astype(float, copy=False) for j, name in enumerate(names)},
            "lanes" if lanes else engine,
            results.states,
            np.array([asked.limited.get(k, 0) for k in range(number)], self.step.layout.word),
            partial(sealed, self.step, self.real),
        )

    def _alone(self, u: Array, y: Array, memory: Memories, results: "_Results", engine: Engine) -> Iterator[int]:
        own = self.own
        own.entries(engine)
        for k in range(results.records):
            own.whole[:] = memory(k)
            x, traces, status = own.run(engine, *(array[k] if array.ndim == 3 else array for array in (u, y)))
            results.x[:, :, k], results.status[:, k] = x, status
            results.states[k] = np.frombuffer(own.state, np.uint8)
            if results.traced:
                results.traces[:, :, k] = traces
            yield k + 1

    @cached_property
    def own(self) -> Kept:
        """A memory that is no caller's."""
        return Kept(self.step, self.real)

    @cached_property
    def lanes(self) -> "_Lanes | None":
        """The step in lanes; None where it has none, or the compiler does not know them."""
        try:
            files = targets.lanes(self.step, real=self.real)
            return _Lanes(self.step, self.real, native.library(files, ("-O2", *native.own())))
        except (NoLanes, native.CompilerFailed):
            return None


@dataclass(frozen=True, eq=False)
class _Results:
    """What comes out, with the records beside each other: x (N, n, B), traces (N, number, B), status (N, B), and room
    for lanes without a record; and the states (B, bytes) at their ends."""

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
        traces: Array = np.empty((samples, len(step.observer.traces) * traced, width), kind)
        status, states = np.empty((samples, width), step.layout.word), np.empty((records, size), np.uint8)
        return cls(records, traced, x, traces, status, states)


@dataclass(frozen=True, eq=False)
class _Lanes:
    """The compiled step in lanes."""

    step: Step
    real: Real
    library: ctypes.CDLL

    def run(self, u: Array, y: Array, records: Array, results: _Results, first: int) -> int:
        """The records from number `first` on, as many as there are; returns how many."""
        u, y = (_beside(array, first, len(records), DTYPE[self.real]) for array in (u, y))
        begun = self._begun(records, len(results.x))
        memory, call = self._memory(records), getattr(self.library, f"{self.step.name}_lanes_run")
        widths = [*(array.shape[2] if array.ndim == 3 else 0 for array in (u, y)), results.status.shape[1]]
        width = (ctypes.c_size_t * 3)(*widths)
        for block, lanes in enumerate(memory):
            at = block * self.width
            signals = (array[..., at:] if array.ndim == 3 else array for array in (u, y))
            shown = (array[..., first + at :] for array in (results.x, results.traces, results.status))
            x, traces, status = map(_address, shown)
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
        """The numbers of the records (B, bytes) whose first call, where there is a sample, begins anew, for they lack
        the mark, the first of a state; now they have it."""
        fresh = np.frombuffer(layout.fresh(self.step, self.real), np.uint8)
        if not (self.step.layout.mark and samples):
            return np.array([], int)
        missing = records.view(np.uint32)[:, 0] != mark(self.step, self.real)
        records[missing, : len(fresh)] = fresh
        return np.flatnonzero(missing)

    @cached_property
    def width(self) -> int:
        """The number of lanes."""
        return self._size("width")

    def _size(self, name: str) -> int:
        size = getattr(self.library, f"{self.step.name}_lanes_{name}")
        size.restype = ctypes.c_size_t
        return int(size())

    @cached_property
    def _numbers(self) -> list[tuple[Array, Array, np.dtype, np.dtype]]:
        """Of each type of numbers their places in the memory and in a record, counted in such numbers, and their types
        there."""
        record, real = layout.kept_type(self.step, self.real), np.dtype(DTYPE[self.real])
        every = [place for part in ("state", "params") for place in _numbers(*_field(record, part))]

        def of(kind: np.dtype, lanes: np.dtype) -> tuple[Array, Array, np.dtype, np.dtype]:
            there = [k for k, (_, each) in enumerate(every) if each == kind]
            here = [every[k][0] // kind.itemsize for k in there]
            return np.array(there, int), np.array(here, int), lanes, kind

        return [of(real, real), of(np.dtype(np.uint32), np.dtype(f"u{real.itemsize}"))]

    def _memory(self, records: Array) -> Array:
        """The memory (blocks, bytes) of records (B, bytes); lanes without a record do what the last does."""
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


def _field(kind: np.dtype, name: str) -> tuple[np.dtype, int]:
    assert kind.fields
    inner, offset, *_ = kind.fields[name]
    return inner, offset


def _numbers(kind: np.dtype, start: int) -> Iterator[tuple[int, np.dtype]]:
    """Where each number of a type lies, from `start` on."""
    if kind.subdtype:
        base, shape = kind.subdtype
        for k, _ in enumerate(product(*map(range, shape))):
            yield from _numbers(base, start + k * base.itemsize)
    elif kind.names:
        for name in kind.names:
            inner, offset = _field(kind, name)
            yield from _numbers(inner, start + offset)
    else:
        yield start, kind


def _beside(array: Array, first: int, records: int, kind: type) -> Array:
    """Signals (B, N, m) from record `first` on as (N, m, at least `records`), with room for whole registers; those that
    all records have as they are."""
    with np.errstate(over="ignore"):  # what is beyond a float is infinite, and no sample
        if array.ndim == 2:
            return np.ascontiguousarray(array, dtype=kind)
        room = np.zeros((*array.shape[1:], CHUNK), kind)
        room[:, :, :records] = array[first : first + records].transpose(1, 2, 0)
    return room


def _address(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def _threaded(lanes: _Lanes, u: Array, y: Array, memory: Memories, results: _Results, jobs: int) -> Iterator[int]:
    """Chunk by chunk; how many records are done. No more chunks wait than there are threads."""
    done, waiting = 0, deque[Future[int]]()
    with ThreadPoolExecutor(jobs) as pool:
        for first in range(0, results.records, CHUNK):
            last = min(first + CHUNK, results.records)
            records = np.stack([np.frombuffer(memory(k), np.uint8) for k in range(first, last)])
            waiting.append(pool.submit(lanes.run, u, y, records, results, first))
            if len(waiting) > 2 * jobs:
                done += waiting.popleft().result()
                yield done
        while waiting:
            done += waiting.popleft().result()
            yield done
