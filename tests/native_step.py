"""A step's C, compiled as float or double and called on states that numpy can read and write."""

import ctypes
from dataclasses import dataclass

import numpy as np

from hgogen import layout, native, targets
from hgogen.cprint import Real
from hgogen.step import Step

NUMBER = {"float": np.float32, "double": np.float64}


@dataclass(frozen=True, eq=False)
class Record:
    """After each sample: estimates x (N, n), traces (N, number of traces), status (N)."""

    x: np.ndarray
    traces: np.ndarray
    status: np.ndarray


class NativeStep:
    """The compiled step; `state` is its struct, a numpy record (1,) in the build's precision."""

    def __init__(self, step: Step, real: Real) -> None:
        self.step, self.number = step, NUMBER[real]
        self._library = native.library({**targets.c99(step, real=real, check=False), **targets.record(step, real=real)})
        self.state = np.zeros(1, layout.state_type(step, real))
        self._params = np.zeros(1, layout.params_type(step, real))
        for kind, array in (("state", self.state), ("params", self._params)):
            size = self._function(f"{kind}_size")
            size.restype = ctypes.c_size_t
            assert size() == array.itemsize
        self._pointers = [ctypes.c_void_p(array.ctypes.data) for array in (self.state, self._params)]
        self._function("init")(*self._pointers)

    def run(self, u: np.ndarray, y: np.ndarray) -> Record:
        """The step over samples u (N,), y (N,) of a plant with one input and one output, from `state` on."""
        count, step = len(y), self.step
        u, y = (np.ascontiguousarray(values, self.number) for values in (u, y))
        x = np.zeros((count, len(step.states)), self.number)
        traces = np.zeros((count, len(step.observer.traces)), self.number)
        status = np.zeros(count, np.uint32)
        arrays = [ctypes.c_void_p(array.ctypes.data) for array in (u, y, x, traces, status)]
        self._function("record")(*self._pointers, ctypes.c_size_t(count), *arrays)
        return Record(x, traces, status)

    def reset(self) -> None:
        """The state as before the first call."""
        self._function("reset")(self._pointers[0])

    def _function(self, name: str) -> ctypes._CFuncPtr:
        return getattr(self._library, f"{self.step.name}_{name}")
