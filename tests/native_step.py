"""A step's C, compiled as float or double and called on states that numpy can read and write."""

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hgogen.emit import layout
from hgogen.emit.syntax import Real
from hgogen.program import Place
from hgogen.run.backends import StepMemory
from hgogen.step import Step

NUMBER = {"float": np.float32, "double": np.float64}


def pack_state(step: Step, memory: Mapping[Place, np.ndarray]) -> np.ndarray:
    """The state in a machine's memory as one record (1) of the C in double."""
    state = np.frombuffer(bytearray(layout.fresh(step)), layout.state_type(step))  # a copy would leave out padding
    for place, array in layout.state_places(step, state).items():
        array[:] = memory[place]
    return state


def unpack_state(step: Step, state: np.ndarray, memory: Mapping[Place, np.ndarray]) -> None:
    """A record (1) of the C, in any precision, into a machine's memory."""
    for place, array in layout.state_places(step, state).items():
        memory[place][:] = array


@dataclass(frozen=True, eq=False)
class Record:
    """After each sample: estimates x (N, n), traces (N, number of traces), status (N)."""

    x: np.ndarray
    traces: np.ndarray
    status: np.ndarray


class NativeStep:
    """The compiled step; `state` and `params` are its structs, numpy records (1,) in the build's precision."""

    def __init__(self, step: Step, real: Real) -> None:
        self.step, self.number = step, NUMBER[real]
        self._library = StepMemory(step, real)._library  # that which a call of it compiles
        self.state = np.zeros(1, layout.state_type(step, real))
        self.params = np.zeros(1, layout.params_type(step, real))
        for kind, array in (("state", self.state), ("params", self.params)):
            size = self._function(f"{kind}_size")
            size.restype = ctypes.c_size_t
            assert size() == array.itemsize
        self._pointers = [ctypes.c_void_p(array.ctypes.data) for array in (self.state, self.params)]
        self._function("init")(*self._pointers)

    def run(self, u: np.ndarray, y: np.ndarray) -> Record:
        """The step over samples u (N, m), y (N, p), or (N,) where there is one, from `state` on."""
        count, step = len(y), self.step
        u, y = (np.ascontiguousarray(values, self.number) for values in (u, y))
        x = np.zeros((count, len(step.states)), self.number)
        traces = np.zeros((count, len(step.traces)), self.number)
        status = np.zeros(count, step.layout.word)
        arrays = [ctypes.c_void_p(array.ctypes.data) for array in (u, y, x, traces, status)]
        self._function("record")(*self._pointers, ctypes.c_size_t(count), *arrays)
        return Record(x, traces, status)

    def reset(self) -> None:
        """The state as before the first call."""
        self._function("reset")(self._pointers[0])

    def tune(self) -> int:
        """Limit `params` and compute the derived ones; returns the status."""
        return int(self._function("tune")(self._pointers[1]))

    def step_by_step(self, u: np.ndarray, y: np.ndarray) -> Record:
        """As `run`, by a call of NAME_step and of NAME_estimate for each sample."""
        step = self.step
        kinds = {"input": step.given, "output": step.samples, "plant": step.states}
        records = {k: np.zeros(1, [(s.name, self.number) for s in group]) for k, group in kinds.items()}
        inputs, out, plant = (ctypes.c_void_p(array.ctypes.data) for array in records.values())
        rows = {kind: [] for kind in ("x", "traces", "status")}
        for row_u, row_y in zip(u, y, strict=True):
            records["input"][0], records["output"][0] = tuple(row_u), tuple(row_y)
            samples = (inputs, out) if step.given else (out,)
            rows["status"].append(self._function("step")(*self._pointers, *samples) & 0xFFFFFFFF)
            self._function("estimate")(*self._pointers, plant)
            rows["x"].append(tuple(records["plant"][0]))
            rows["traces"].append([self.state[name][0] for name in step.observer.traces])
        return Record(*(np.array(rows[kind]) for kind in ("x", "traces", "status")))

    def _function(self, name: str) -> ctypes._CFuncPtr:
        return getattr(self._library, f"{self.step.name}_{name}")
