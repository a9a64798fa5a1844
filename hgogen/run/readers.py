"""What a step that is called keeps between two samples, and its readers: the compiled C, and the program in Python.

All of it is one record in the layout of the C (`emit.layout`), on which both readers work where it lies. They compute
the same bits, so they may take turns at any sample.
"""

import ctypes
import operator
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from dataclasses import fields as fields_of
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np

from hgogen import targets
from hgogen.emit import layout, pystep
from hgogen.emit.pystep import Entry
from hgogen.emit.saved import opened
from hgogen.emit.syntax import DTYPE, Real
from hgogen.reading.given import among
from hgogen.run import native
from hgogen.run.samples import BadShape, Engine
from hgogen.step import Step


class Kept:
    """The memory of one step in the precision `real`, `places` of it by name, and what can be called on it.

    `signals`: u, then y, of a sample, as numbers of that precision; `shown`: the estimate, then the traces.
    """

    def __init__(self, step: Step, real: Real) -> None:
        self._step, self.real, self.record = step, real, layout.made(step, real)
        self.places = layout.places(step, self.record)
        self._readers: dict[Engine, Mapping[str, Entry]] = {}
        self.whole = self.record.view(np.uint8).data
        self.state = self.whole[: layout.state_type(step, real).itemsize]
        shown, signals = len(step.states) + len(step.observer.traces), len(step.inputs) + len(step.samples)
        self.signals, self.shown = np.split(self.record.view(DTYPE[real])[-signals - shown :], [signals])
        self._new = bytes(self.state)

    def reset(self) -> None:
        """The state as before the first call."""
        self.state[:] = self._new

    def saved(self, state: Any) -> bytes:
        """A state that was saved, as its bytes. Raises: `BadShape` for what is no bytes; `NotSaved` for what is
        damaged, or of another program."""
        if not isinstance(state, bytes | bytearray | memoryview):
            raise BadShape(f"a saved state that is a {type(state).__name__}", "is no bytes; give what save() gave")
        return opened(self._step, self.real, bytes(state), len(self.state))

    def ready(self, engine: Engine | None, own: Engine | None) -> Engine:
        """What takes a record, and has tuned what is in the memory: the engine that is asked for, else the step's own,
        else C where there is a compiler.

        Raises: `BadShape`; `NoCompiler`, `CompilerFailed`.
        """
        if not among(engine, (None, "c", "python")):
            raise BadShape(f"engine = {engine!r}", 'must be "c", "python" or None')
        engine = engine or own
        if engine is None and not native.compiler():
            warnings.warn(str(native.NoCompilerWarning.__doc__), native.NoCompilerWarning, stacklevel=3)
        engine = engine or native.engine()
        self.entries(engine)
        return engine

    def entries(self, engine: Engine) -> Mapping[str, Entry]:
        """The functions of a reader by name, which are made at the first time.

        Raises: `NoCompiler`, `CompilerFailed`.
        """
        if engine not in self._readers:
            entries = self._compiled() if engine == "c" else pystep.entries(self._step, self.record, self.real)
            entries["tune"]()
            self._readers[engine] = entries
        return self._readers[engine]

    def run(self, engine: Engine, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Estimates (N, n), traces (N, number of them) and statuses (N) of samples u (N, m), y (N, p)."""
        with np.errstate(over="ignore"):  # what is beyond a float is infinite, and no sample
            u, y = (array.astype(DTYPE[self.real], copy=False) for array in (u, y))
        n, traces = len(self._step.states), len(self._step.observer.traces)
        step, status = self.entries(engine)["step"], np.zeros(len(y), self._step.layout.word)
        if engine == "c":
            x, traced = np.zeros((len(y), n), u.dtype), np.zeros((len(y), traces), u.dtype)
            arrays = (self.record["state"], self.record["params"], u, y, x, traced, status)
            state, params, *signals = (ctypes.c_void_p(array.ctypes.data) for array in arrays)
            getattr(self._library, f"{self._step.name}_record")(state, params, ctypes.c_size_t(len(y)), *signals)
            return x.astype(float, copy=False), traced.astype(float, copy=False), status
        rows = np.zeros((len(y), n + traces))
        for k, row in enumerate(np.hstack([u, y])):
            self.signals[:] = row
            status[k] = step()
            rows[k] = self.shown
        return rows[:, :n], rows[:, n:], status

    @cached_property
    def _library(self) -> ctypes.CDLL:
        return _library(_Program(self._step, self.real), native.compiler())

    def _compiled(self) -> dict[str, Entry]:
        """The C function of each entry, of one address, which a thread finishes before another has its turn."""
        step, library = self._step, self._library
        size = getattr(library, f"{step.name}_kept_size")
        size.restype = ctypes.c_size_t
        if size() != self.record.itemsize:
            raise BadShape(f"the C struct {step.name}_kept", f"has {size()} bytes, Python's {self.record.itemsize}")
        names = ["step", "estimate", "tune"]
        names += [section.name for section in (*step.code.sections, *step.code.timed)] if step.code.apart else []
        kind = ctypes.PYFUNCTYPE(np.ctypeslib.as_ctypes_type(step.layout.word), ctypes.c_void_p)
        calls = {name: kind((f"{step.name}_kept_{name}", library)) for name in names}
        return {name: partial(call, self.record.ctypes.data) for name, call in calls.items()}


@dataclass(frozen=True, eq=False)
class _Program:
    """A step in a precision; equal are those that are made of the very same parts, as steps that were remembered."""

    step: Step
    real: Real

    @cached_property
    def _parts(self) -> list[object]:
        return [getattr(self.step, each.name) for each in fields_of(Step)]

    def __hash__(self) -> int:
        return hash((self.real, *map(id, self._parts)))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, _Program):
            return NotImplemented
        return self.real == other.real and all(map(operator.is_, self._parts, other._parts))

    @property
    def unread(self) -> Step:
        """The step as its C is called, which nobody reads: it says nothing of what is proved of the observer."""
        observer = replace(self.step.observer, claims=tuple)
        return Step(**{each.name: getattr(self.step, each.name) for each in fields_of(Step)} | {"observer": observer})


@lru_cache(maxsize=32)
def _library(program: _Program, _: str | None) -> ctypes.CDLL:
    """Its C, which is written once for a compiler."""
    step, real = program.unread, program.real
    return native.library({**targets.c99(step, real=real, check=False), **targets.record(step, real=real)})
