"""Calling a step from Python: one sample by the program in Python, a whole record in one call of the compiled C."""

import ctypes
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, Literal

import numpy as np

from hgogen import methods, targets
from hgogen.emit import layout, native
from hgogen.errors import HgogenError
from hgogen.method import Method
from hgogen.observer import Observer
from hgogen.program import dangling
from hgogen.signal import Signal
from hgogen.step import BadStep, CannotUpdate, Step, plan
from hgogen.stepping.machine import Machine
from hgogen.stepping.sensors import AT, ROUND
from hgogen.time_unit import plural

Engine = Literal["c", "python"]


@dataclass(eq=False)
class BadShape(HgogenError):
    """An input or output array of the wrong shape or kind."""

    what: str
    reason: str

    def __str__(self) -> str:
        return f"{self.what} {self.reason}"


def _position(name: str, names: tuple[str, ...]) -> int:
    if name not in names:
        raise BadShape(f"{name!r}", f"names no state; the states are {', '.join(names)}")
    return names.index(name)


@dataclass(frozen=True)
class Sample:
    """What one call returns: the estimate `x` (n) of the states `names`, the status, its bits' names, and traces."""

    x: np.ndarray
    names: tuple[str, ...]
    status: int
    flags: tuple[str, ...]
    traces: Mapping[str, float]

    def __getitem__(self, name: str) -> float:
        return float(self.x[_position(name, self.names)])

    def __str__(self) -> str:
        values = [f"{name} = {value:.6g}" for name, value in zip(self.names, self.x, strict=True)]
        values += [f"{name} = {value:.6g}" for name, value in self.traces.items()]
        return f"{', '.join(values)} ({', '.join(self.flags) or 'ok'})"


@dataclass(frozen=True)
class Run:
    """What a record gives: times `t` (N), estimates `x` (N, n), `traces` (N) by name, `status` (N), and the engine."""

    t: np.ndarray
    x: np.ndarray
    names: tuple[str, ...]
    traces: Mapping[str, np.ndarray]
    status: np.ndarray
    engine: Engine | Literal["cvodes"]

    def __getitem__(self, name: str) -> np.ndarray:
        return np.asarray(self.x[:, _position(name, self.names)])


@dataclass(frozen=True, eq=False, repr=False)
class CallableStep(Step):
    """A step with a memory: see `Step` for its program."""

    _clock: list[int] = field(default_factory=lambda: [0])

    def __call__(self, u: Any = (), y: Any = ()) -> Sample:
        """One sample: `u` (m) the input now, `y` (p) the measurement now (NaN: missing), scalars where there is one.

        Raises: `BadShape`.
        """
        machine = self._machine
        _give(machine, "input", self.inputs, _vector("u", u, self.inputs))
        _give(machine, "output", self.outputs, _vector("y", y, self.outputs))
        status = machine.call()
        self._clock[0] += 1
        return self._sample(status)

    def predict(self, u: Any = ()) -> Sample:
        """Only advance the estimate to now; then `update` with the sensors that have a sample, and `adapt`.

        Raises: `BadShape`; `CannotUpdate` for an observer that integrates with the measurement.
        """
        self._demand_sections()
        _give(self._machine, "input", self.inputs, _vector("u", u, self.inputs))
        status = self._machine.section("predict")
        self._clock[0] += 1
        return self._sample(status)

    def update(self, at: int | None = None, /, **y: float) -> Sample:
        """Correct with the named outputs.

        `at`: the number of the period in which the samples were taken, counted from 0 at the first call after a reset;
        None: now. A step made with `periods` takes it, and does not use a sample of another period.

        Raises: `BadShape`, `CannotUpdate`.
        """
        self._demand_sections()
        status, names = 0, [s.name for s in self.outputs]
        for name, value in y.items():
            if name not in names:
                raise BadShape(f"update({name}=)", f"names no output; the outputs are {', '.join(names)}")
            self._machine.memory[f"output.{name}"][0] = float(value)
            status |= self._machine.section(f"update_{name}{'' if at is None else self._told(at)}")
        return self._sample(status)

    def _told(self, at: int) -> str:
        """The ending of a section that is told the number of the period."""
        if not self.timed:
            raise BadShape(f"update({at!r}, ..)", "is told a time; this step counts none: sample(.., periods={})")
        if isinstance(at, bool) or not isinstance(at, int | np.integer) or at < 0:
            raise BadShape(f"update({at!r}, ..)", "must be told the number of a period, a whole number from 0")
        self._machine.memory[AT][0] = int(at) % ROUND
        return "_at"

    def adapt(self) -> Sample:
        """Adapt the gain, once after the updates of a sample; nothing to do for a constant one."""
        self._demand_sections()
        has = any(section.name == "adapt" for section in self.sections)
        return self._sample(self._machine.section("adapt") if has else 0)

    def run(self, u: Any = (), y: Any = (), engine: Engine | None = None) -> Run:
        """A whole record from the present state on: `u` (N) or (N, m), `y` (N) or (N, p), NaN for a missing sample.

        `engine`: "c" the compiled step in one call, "python" the program block by block; by default C where there is a
        compiler, else Python with a `NoCompilerWarning`.

        Raises: `BadShape`; `NoCompiler` for "c" without a compiler.
        """
        y = _table("y", y, self.outputs, None)
        u = _table("u", u, self.inputs, len(y))
        if engine not in (None, "c", "python"):
            raise BadShape(f"engine = {engine!r}", 'must be "c", "python" or None')
        if engine is None:
            engine = "c" if native.compiler() else "python"
            if engine == "python":
                warnings.warn(str(native.NoCompilerWarning.__doc__), native.NoCompilerWarning, stacklevel=2)
        first = self._clock[0]
        x, traces, status = self._run_c(u, y) if engine == "c" else self._run_python(u, y)
        self._clock[0] += len(y)
        names = self.observer.traces
        return Run(
            t=(first + np.arange(len(y))) * self.dt,
            x=x,
            names=tuple(s.name for s in self.states),
            traces={name: traces[:, j] for j, name in enumerate(names)},
            status=status,
            engine=engine,
        )

    def reset(self) -> None:
        """As before the first call; tuned parameters stay."""
        self._machine.reset()
        self._clock[0] = 0

    def tune(self, **values: Any) -> int:
        """Set gains or tunable plant parameters by name, limit them to their ranges; returns the status.

        Raises: `BadShape` for an unknown name or a wrong length.
        """
        kinds = [("plant", f) for f in self.plant] + [("gain", f) for f in self.gains]
        places = {f.name: (f"{kind}.{f.name}", f.size) for kind, f in kinds}
        for name, value in values.items():
            if name not in places:
                raise BadShape(f"tune({name}=)", f"names nothing tunable; that is {', '.join(places)}")
            place, size = places[name]
            self._machine.memory[place][:] = _numbers(name, value, size)
        return self._machine.tune()

    def save(self) -> bytes:
        """The state as the bytes of the C struct (double)."""
        return layout.pack_state(self, self._machine.memory).tobytes()

    def restore(self, saved: bytes) -> None:
        """The state that `save` gave. Raises: `BadShape` where the bytes are not those of this step."""
        kind = layout.state_type(self)
        if len(saved) != kind.itemsize:
            raise BadShape(
                f"a saved state of {len(saved)} bytes",
                f"is not of this step, whose state has {kind.itemsize}",
            )
        layout.unpack_state(self, np.frombuffer(saved, kind), self._machine.memory)

    def flags(self, status: int) -> tuple[str, ...]:
        """The names of the bits that a status holds."""
        return tuple(bit.name for k, bit in enumerate(self.bits) if int(status) >> k & 1)

    @cached_property
    def _machine(self) -> Machine:
        return Machine(self)

    @cached_property
    def _library(self) -> ctypes.CDLL:
        loaded = native.library({**targets.c99(self, real="double", check=False), **targets.record(self)})
        for kind in ("state", "params"):
            size = getattr(loaded, f"{self.name}_{kind}_size")
            size.restype = ctypes.c_size_t
            mine = getattr(layout, f"{kind}_type")(self).itemsize
            if size() != mine:
                raise BadShape(f"the C struct {kind}", f"has {size()} bytes, Python's {mine}; use engine='python'")
        return loaded

    def _demand_sections(self) -> None:
        if not self.apart:
            raise CannotUpdate(self.observer.name, self.rule)

    def _sample(self, status: int) -> Sample:
        machine = self._machine
        machine.estimate()
        x = np.array([machine.memory[f"estimate.{s.name}"][0] for s in self.states])
        traces = {name: float(machine.memory[f"state.{name}"][0]) for name in self.observer.traces}
        return Sample(x, tuple(s.name for s in self.states), status, self.flags(status), traces)

    def _run_c(self, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        machine = self._machine
        state, params = layout.pack_state(self, machine.memory), layout.pack_params(self, machine.memory)
        x = np.zeros((len(y), len(self.states)))
        traces = np.zeros((len(y), len(self.observer.traces)))
        status = np.zeros(len(y), np.uint32)
        arrays = (u, y, x, traces, status)
        pointers = [ctypes.c_void_p(a.ctypes.data) for a in (state, params)]
        call = getattr(self._library, f"{self.name}_record")
        call(*pointers, ctypes.c_size_t(len(y)), *(ctypes.c_void_p(a.ctypes.data) for a in arrays))
        layout.unpack_state(self, state, machine.memory)
        return x, traces, status

    def _run_python(self, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        machine = self._machine
        inputs = [machine.memory[f"input.{s.name}"] for s in self.inputs]
        outputs = [machine.memory[f"output.{s.name}"] for s in self.outputs]
        results = [machine.memory[f"estimate.{s.name}"] for s in self.states]
        scalars = [machine.memory[f"state.{name}"] for name in self.observer.traces]
        x, traces = np.zeros((len(y), len(results))), np.zeros((len(y), len(scalars)))
        status = np.zeros(len(y), np.uint32)
        for k in range(len(y)):
            for place, value in zip((*inputs, *outputs), (*u[k], *y[k]), strict=True):
                place[0] = value
            status[k] = machine.call()
            x[k] = [place[0] for place in results]
            traces[k] = [place[0] for place in scalars]
        return x, traces, status


def sample(
    observer: Observer,
    method: Method = methods.continuous_discrete,
    dt: float | None = None,
    *,
    between: str = "line",
    periods: Mapping[str, float] | None = None,
) -> CallableStep:
    """The observer at the sampling period `dt` by `method` (default: `methods.continuous_discrete`).

    Times are in the unit of the model's `time`.

    `between`: what u does between samples, "line" (from the last value to this one) or "hold" (the value given is the
    one applied since the last call). `periods`: for sensors of different rates, the time between two samples of an
    output, by name, a whole multiple of dt, by default dt: its noise R is taken for that time. Such a step counts its
    periods and does not use a sample that `update` tells to be of another one, or gets a second time.

    Raises: `BadStep`; `StepTooLong`, with a dt to take, where errors at a point of the box or the covariance equation
    cannot be stable; `BadWindow`; `BadRate` for periods that do not fit, `CannotUpdate` where the observer integrates
    with the measurement.
    """
    if not isinstance(observer, Observer):
        raise BadStep(f"{type(observer).__name__} given to sample", "is no observer; make one by hg.observers")
    if not hasattr(method, "riccati"):
        raise BadStep(f"method = {method!r}", "is no method; take one of hg.methods, and the time as dt=")
    if dt is None:
        raise BadStep("dt", f"is missing; give the sampling period in {plural(observer.form.system.time)}, as dt=")
    planned = plan(observer, method, dt, between, periods)
    for section in planned.sections:
        if dangling(section.program):
            missing = ", ".join(sorted(dangling(section.program)))
            raise BadStep(f"section {section.name}", f"reads {missing}, which it never writes")
    return CallableStep(**{f.name: getattr(planned, f.name) for f in fields(planned)})


def _give(machine: Machine, kind: str, signals: Iterable[Any], values: np.ndarray) -> None:
    for signal, value in zip(signals, values, strict=True):
        machine.memory[f"{kind}.{signal.name}"][0] = value


def _vector(name: str, value: Any, signals: Sequence[Signal]) -> np.ndarray:
    _demand_given(name, value, signals)
    return _numbers(name, value, len(signals), _listed(signals))


def _numbers(name: str, value: Any, size: int, listed: str = "") -> np.ndarray:
    try:
        array = np.asarray(value, dtype=float).reshape(-1)
    except (TypeError, ValueError):
        raise BadShape(f"{name} = {value!r}", "is not an array of numbers") from None
    if array.shape != (size,):
        raise BadShape(f"{name} of shape {np.shape(value)}", f"must have {size} element{'s' * (size != 1)}{listed}")
    return array


def _table(name: str, value: Any, signals: Sequence[Signal], rows: int | None) -> np.ndarray:
    width = len(signals)
    if rows != 0:
        _demand_given(name, value, signals)
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise BadShape(name, "is not an array of numbers") from None
    if array.ndim == 1 and width == 1:
        array = array[:, None]
    if width == 0 and array.size == 0:
        array = np.zeros((rows or 0, 0))
    if array.ndim != 2 or array.shape[1] != width or (rows is not None and len(array) != rows):
        wanted = f"({'N' if rows is None else rows}, {width})" + (
            f" or ({'N' if rows is None else rows},)" if width == 1 else ""
        )
        raise BadShape(f"{name} of shape {np.shape(value)}", f"must have shape {wanted}{_listed(signals)}")
    return np.ascontiguousarray(array)


def _demand_given(name: str, value: Any, signals: Sequence[Signal]) -> None:
    """Raise `BadShape` for the empty tuple that stands for nothing, where there are signals."""
    if isinstance(value, tuple) and not value and signals:
        raise BadShape(name, f"is missing; give {name}=, the values of {', '.join(s.name for s in signals)}")


def _listed(signals: Sequence[Signal]) -> str:
    """The order of several signals, which may be more than the plant's: a form can take an input's derivatives too."""
    return f": {', '.join(s.name for s in signals)}" if len(signals) > 1 else ""
