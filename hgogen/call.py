"""Calls of a step from Python, sample by sample or over a whole log, by the compiled C or without a compiler."""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from hgogen import methods
from hgogen.analysis.linearised import corrects_nothing
from hgogen.emit.pystep import Entry
from hgogen.emit.saved import sealed
from hgogen.emit.syntax import Real
from hgogen.form import Form
from hgogen.method import Method
from hgogen.observer import Initial, Observer
from hgogen.part import First, Guards, Prefer
from hgogen.program import Place, dangling
from hgogen.reading.given import in_order
from hgogen.reading.jumps import Course, JumpsByTurn, jumps_by_turns, unwrapped_outputs
from hgogen.registry import Displayed, display
from hgogen.rigor.definite import one_thread
from hgogen.run import native
from hgogen.run.backends import Batch, Each, Many, Records, Starts, StepMemory, tunable
from hgogen.run.gates import RejectsMany, gate_shares
from hgogen.run.samples import (
    BadShape,
    Engine,
    Legend,
    Run,
    Sample,
    Take,
    arriving,
    by_measurement_time,
    numbers,
    sample_writer,
    table,
    with_elapsed,
)
from hgogen.run.uncertainty import Replay
from hgogen.signal import Time, plural
from hgogen.step import BadStep, CannotUpdate, GrowingAngle, StartsUncorrected, Step, StepMayFail, demand_choice, plan
from hgogen.stepping.delays import with_late_samples
from hgogen.stepping.discretise import demand_motion
from hgogen.stepping.sections import AT, ROUND
from hgogen.stepping.substeps import ELAPSED
from hgogen.stepping.times import COUNT, REMAINDER, count_at, next_times
from hgogen.system import System


@dataclass(frozen=True, eq=False, repr=False)
class CallableStep(Step, Displayed):
    """A discretised observer that Python can call, sample by sample or over a log, with its memory between calls: the
    estimate and all other stored values. A `Step` is its program alone.

    `engine`: "c" for the compiled step or "python" for its program as Python; None: C where there is a compiler. Both
    compute equal bits, and share the memory. `real`: their precision, "float" or "double".
    """

    engine: Engine | None = None
    real: Annotated[Real, "working precision: float or double"] = "double"
    _kept: StepMemory = field(init=False)
    _clock: list[Any] = field(init=False)
    _legend: Legend = field(init=False)
    _take_u: Take = field(init=False)
    _take_y: Take = field(init=False)
    _take: Mapping[str, Take] = field(init=False)
    _output_bytes: Callable[[], bytes] = field(init=False)
    _courses: tuple[Course, ...] = field(init=False)

    def __post_init__(self) -> None:
        memory, u, first = StepMemory(self, self.real), len(self.inputs), len(self.given)
        signals = (*self.given, *self.samples)

        def to(name: str, first: int, last: int) -> Take:
            return sample_writer(name, signals[first:last], memory.signals, first)

        states, bits = (tuple(each.name for each in named) for named in (self.states, self.layout.bits))
        vars(self).update(
            _kept=memory,
            _clock=[0, 0.0, 0.0],
            _legend=Legend(states, bits, self.traces, "d" if self.real == "double" else "f"),
            _take_u=to("u", 0, u),
            _take_y=to("y", first, len(signals)),
            _take={signal.name: to(signal.name, j, j + 1) for j, signal in enumerate(signals)},
            _output_bytes=memory.outputs.data.tobytes,
            _courses=unwrapped_outputs(self.observer.form.system),
        )

    def __call__(self, u: Any = (), y: Any = (), dt: float | None = None) -> Sample:
        """Return the estimate after a sample: `u` (m) the input now, `y` (p) the measurement now (NaN or masked:
        missing), scalars where there is one, or a mapping by the signals' names. For a step with late samples y has the
        order of `samples`: the newest sample of each output, then the ages of those that may be late. `dt`: the time
        since the last call, for a step in which it varies. The first call compiles the C, unless it was compiled
        before.

        Raises: `BadShape`, `BadNames`; `CompilerFailed`; `NoCompiler` for the engine "c" without a compiler.
        """
        self._take_u(u)
        self._take_y(y)
        if dt is not None or self.clock.varying:
            self._take_dt(dt)
        status = self._entries["step"]()
        self._clock[0] += 1
        return Sample(self._legend, self._output_bytes(), status)

    def predict(self, u: Any = (), dt: float | None = None) -> Sample:
        """Advance the estimate to now without a correction, and return it; then call `update` with the sensors that
        have a sample, and `adapt`. `dt`: as in a call. Raises: `BadShape`; `CannotUpdate` for an observer that
        integrates with the measurement."""
        self._demand_sections()
        self._take_u(u)
        if dt is not None or self.clock.varying:
            self._take_dt(dt)
        status = self._entries["predict"]()
        self._clock[0] += 1
        return Sample(self._legend, self._output_bytes(), status)

    def update(self, at: int | None = None, /, **y: float) -> Sample:
        """Correct the estimate with samples of the named outputs, and return it. A step for late samples also accepts
        `y_age`, the age in periods of the sample y, by default 0, and corrects when `adapt` is called.

        `at`: the number of the sampling period in which the samples were measured, counted from 0 at the first call
        after a reset; None: the current period. A step made with `periods` needs it, and does not use a sample of
        another period.

        Raises: `BadShape`, `CannotUpdate`.
        """
        self._demand_sections()
        samples = {age.name: 0.0 for age in self.ages} | y
        known = [signal.name for signal in self.samples]
        for name, value in samples.items():
            if name not in known:
                raise BadShape(f"update({name}=)", f"names no output; the outputs are {', '.join(known)}")
            self._take[name](value)
        for output, age in zip(self.late, self.ages, strict=True):
            if age.name in y and output.name not in y:
                raise BadShape(
                    f"update({age.name}=)",
                    f"is the age of a sample of {output.name} that is missing; give {output.name} too",
                )
        ending = "" if at is None else "_at"
        if at is not None:
            self._take_at(at)
        status = self._entries["estimate"]() if not y else 0
        joint = [self._entries[name] for name in ("innovate", "gate") if y and name in self._entries]
        for name in set(known) - samples.keys() if joint else ():
            self._take[name](np.nan)
        for section in joint:
            status |= section()
        for name in (signal.name for signal in self.outputs if signal.name in y):
            status |= self._entries[f"update_{name}{ending}"]()
        return Sample(self._legend, self._output_bytes(), status)

    def _take_at(self, at: int) -> None:
        if not self.code.timed:
            raise BadShape(
                f"update({at!r}, ..)",
                "is given a time, but this step has no `periods`: make it by sample(.., periods={})",
            )
        if isinstance(at, bool) or not isinstance(at, int | np.integer) or at < 0:
            raise BadShape(f"update({at!r}, ..)", "needs the number of a period, a whole number from 0")
        self._kept.places[AT][0] = int(at) % ROUND

    def adapt(self) -> Sample:
        """Advance the law of an adaptive gain by one sample, once after the updates of this sample, and return the
        estimate."""
        self._demand_sections()
        status = self._entries["adapt" if "adapt" in self._entries else "estimate"]()
        return Sample(self._legend, self._output_bytes(), status)

    def run(self, u: Any = (), y: Any = (), engine: Engine | None = None, *, dt: Any = None) -> Run:
        """Return the estimates of a whole log from the present state on: `u` (N) or (N, m), `y` (N) or (N, p), or a
        column (N) for each by name; NaN, or a masked entry, for a missing sample. For a step with late samples y has
        the columns of `samples`, (N, p + ages), and a row has the samples that arrived then; `arriving` makes such rows
        from samples in the order of time. `dt`: for a step in which it varies, the time since the row before, a number
        or an array (N), of which the first is not used in a first call; of times t it is numpy.diff(t, prepend=t[0]).

        `engine`: "c" the compiled step in one call, "python" sample by sample; by default the step's own, else C where
        there is a compiler, else Python with a `NoCompilerWarning`. An output without a period whose samples jump by a
        whole turn has a `JumpsByTurn` warning, and a gate that rejects far more samples than its probability says a
        `RejectsMany` warning.

        Raises: `BadShape`, `BadNames`; `CompilerFailed`; `NoCompiler` for "c" without a compiler.
        """
        y = table("y", y, self.samples, None)
        u, spent = with_elapsed(self, table("u", u, self.inputs, len(y)), dt)
        for jump in jumps_by_turns(self._courses, y, self.dt, self.time):
            warnings.warn(jump, JumpsByTurn, stacklevel=2)
        engine = self._kept.ready(engine, self.engine)
        memory, begins = bytes(self._kept.whole), self._next_times(spent)
        x, traces, status = self._kept.run(engine, u, y)
        for share in gate_shares(self, status):
            if share.excessive:
                warnings.warn(share.sentence, RejectsMany, stacklevel=2)
        times = self._times(spent)
        return Run(
            t=times,
            x=x,
            names=tuple(s.name for s in self.states),
            traces={name: traces[:, j] for j, name in enumerate(self.traces)},
            status=status,
            engine=engine,
            replay=Replay(self, memory, u.copy(), y.copy(), status, engine, self.real),
            states=self.states,
            times=begins,
        )

    def plot_response(self, omega: Any = None) -> Sequence[Any]:
        """Return the matplotlib axes of a figure with a panel for each state: the amplitude of its error over that of
        sinusoidal noise of each output, in continuous time and by this step, over the frequencies `omega` (K, rad per
        unit of time), by default around the poles of the error.

        Raises: `NoResponse` for an observer without a linear error core; `BadFrequency`, `BadGain`."""
        axes: Sequence[Any] = display("response_plot")(self, omega)
        return axes

    def run_many(
        self,
        u: Any = (),
        y: Any = (),
        *,
        parameters: Mapping[str, Any] | None = None,
        starts: Starts | None = None,
        jobs: int | None = None,
        each: Each | None = None,
        traces: bool = False,
        engine: Engine | None = None,
        dt: Any = None,
    ) -> Batch:
        """Return the estimates of many logs, each from the present state, which does not change: the bits of `run`,
        several times as fast.

        `u` (B, N, m) and `y` (B, N, p), or as for `run` where all logs have the same; `dt` as for `run`, or (B, N).
        `parameters`, by their names in
        `tune`, are numbers, or one for each log (B). `starts`: the plant's state by name, as for `started`, with
        numbers or one for each log (B), or B states from `save`. A parameter beyond its range is limited to it, as
        `tuned` of the result says. `jobs`: threads, None for one for each core; `each(done, B)` is called as logs are
        done; `traces`: whether to return them; `engine` as in `run`. In C, a compiler with vector types runs as many
        logs at once as a register of this machine holds numbers. Besides inputs and results a thread stores the signals
        of 64 logs.

        Raises: as `run`; `BadShape` for lengths that differ, `BadNames`, `BadGain` for a start.
        """
        engine = self._kept.ready(engine, self.engine)
        records = Records.of(self._kept, u, y, parameters, starts, lambda start: self.started(start).save(), dt)
        return self._many.run(records, bytes(self._kept.whole), engine, jobs, traces=traces, each=each)

    def reset(self, time: float | None = None) -> None:
        """Set the estimate and all other memory to their values before the first call; tuned parameters stay. `time`:
        the time t at the first call, for a plant with functions of t; by default the `time` of the previous reset,
        initially 0.

        Raises: `BadShape` for a time that is no finite number.
        """
        begin = self._clock[2] if time is None else numbers("time", time, 1).item()
        if not math.isfinite(begin):
            raise BadShape(f"time = {begin}", "must be a finite number")
        self._kept.reset()
        self._clock[:] = [0, 0.0, begin]
        if times := self._plant_times:
            counts, remainders = zip(*count_at(times, self.clock, begin), strict=True)
            self._kept.places[COUNT][:] = counts
            if self.clock.varying:
                self._kept.places[REMAINDER][:] = remainders

    def tune(self, **values: Any) -> int:
        """Set gains or tunable plant parameters by name, limit them to their ranges, and return the status. A gain of
        coordinates or outputs accepts a mapping by their names, too.

        Raises: `BadShape` for an unknown name or a wrong length, `BadNames`; then none of them is set.
        """
        wanted, known = {}, tunable(self)
        for name, value in values.items():
            if name not in known:
                raise BadShape(f"tune({name}=)", f"names nothing tunable; that is {', '.join(known)}")
            place, field = known[name]
            wanted[place] = numbers(name, in_order(name, value, field.labels) if field.labels else value, field.size)
        tune = self._entries["tune"]
        for place, array in wanted.items():
            self._kept.places[place][:] = array
        return tune()

    @property
    def tuned(self) -> dict[str, tuple[float, ...]]:
        """The present values of the gains and of the tunable parameters of the plant, by name."""
        known = tunable(self).items()
        return {name: tuple(map(float, self._kept.places[place].ravel())) for name, (place, _) in known}

    def save(self) -> bytes:
        """Return the memory between calls as bytes, as NAME_save in C: a digest of the program, the C struct, a
        checksum."""
        return sealed(self, self.real, bytes(self._kept.state))

    def restore(self, saved: bytes) -> None:
        """Set the memory to `saved`, bytes from `save`; the times of `run` begin at 0 again, as after `reset`.

        Raises: `BadShape` for a value that is no bytes; `NotSaved`, without a change of the memory, for damaged bytes,
        or those of another program.
        """
        self._kept.state[:] = self._kept.saved(saved)
        self._clock[:2] = [0, 0.0]

    def started(self, initial: Initial) -> "CallableStep":
        """Return a step of an equal observer that starts from `initial`: the plant's state by name, or a function of
        the observer's form that returns it. Raises: `BadGain`."""
        return self._alike(_quietly(self.observer.started(initial), self.method, self.limits, self._options))

    def rebuilt(
        self,
        form: Callable[[System], Form] | None = None,
        method: Method | None = None,
        dt: float | tuple[float, float] | None = None,
        real: Real | None = None,
        guards: Guards | None = None,
        prefer: Prefer | None = None,
        report: str | Sequence[str] | None = None,
        between: str | None = None,
    ) -> "CallableStep":
        """Return a step of the same observer with another `form` of its plant, method, period dt, precision `real`,
        guards, preference `prefer`, `report` or course of inputs `between` samples; an option that is None keeps its
        value. Raises: as `sample` and the observer do."""
        observer = self.observer.on(form) if form else self.observer
        requested = {"real": real, "guards": guards, "prefer": prefer, "report": report, "between": between}
        options = self._options | {key: value for key, value in requested.items() if value is not None}
        options |= {} if dt is None or isinstance(dt, tuple) else {"substeps": None}
        return self._alike(sample(observer, method or self.method, self.limits if dt is None else dt, **options))

    def arriving(self, y: Any) -> np.ndarray:
        """Return the samples for `run` from samples y (N) or (N, p), or a column for each output by name, in the order
        of time, each as late as it may come; without delays as they are. Raises: `BadShape`, `BadNames`."""
        return arriving(self, table("y", y, self.outputs, None))

    def in_time(self, y: Any) -> np.ndarray:
        """Return samples as for `run` in the order of time (N, p): each sample in the row of its time, NaN where none
        came in time. Raises: `BadShape`, `BadNames`."""
        return by_measurement_time(self, table("y", y, self.samples, None))

    @cached_property
    def undelayed(self) -> "CallableStep":
        """Return a step of an equal observer for samples without delay; the step itself if no output has a delay."""
        plain = replace(self.observer, delays=())
        return self._alike(_quietly(plain, self.method, self.limits, self._options)) if self.ages else self

    def flags(self, status: int) -> tuple[str, ...]:
        """Return the names of the bits that are set in `status`, the word that a call returns."""
        return self._legend.flags(status)

    def __copy__(self) -> "CallableStep":
        """Return a step of the same program with a copy of the memory."""
        return replace(self)._resumed(*self._memory)

    def __deepcopy__(self, memo: Any) -> "CallableStep":
        return copy(self)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the data that rebuild the program, and the memory, since a pickle holds no graphs. Raises: `BadGain`
        for an observer that is not from `hg.observers`."""
        return _unpickled, (self.observer, self.method, self.limits, self._options, self._memory)

    @property
    def _options(self) -> dict[str, Any]:
        clock = self.clock
        rated = self.code.timed or any(period != self.dt for period in self.periods)
        periods = dict(zip((s.name for s in self.outputs), self.periods, strict=True)) if rated else None
        requested = {name: getattr(clock, name) for name in ("between", "guards", "prefer", "first", "report")}
        requested |= {"substeps": clock.varying.substeps} if clock.varying else {}
        return requested | {"engine": self.engine, "real": self.real, "periods": periods}

    @property
    def limits(self) -> float | tuple[float, float]:
        """The argument `dt` of `sample`: the sampling period, or the pair of the shortest and the longest time between
        calls."""
        return (self.clock.varying.shortest, self.dt) if self.clock.varying else self.dt

    @property
    def _plant_times(self) -> tuple[Time, ...]:
        return self.observer.form.system.times

    def _next_times(self, elapsed: np.ndarray) -> tuple[float, ...]:
        """Return the time (modulo its period) of each periodic function of time in the plant, at the first call of a
        run; `elapsed` (N): the time before each call."""
        if not self._plant_times:
            return ()
        places, varies = self._kept.places, self.clock.varying
        count = places[COUNT] + places[REMAINDER] if varies else places[COUNT]
        ahead = float(elapsed[:1].sum()) if varies else self.dt
        return next_times(self._plant_times, self.clock, count, ahead * bool(places[Place("state", "calls")][0]))

    def _alike(self, other: "CallableStep") -> "CallableStep":
        """Return the step `other`, reset to the start time of this step."""
        other.reset(self._clock[2])
        return other

    @property
    def _memory(self) -> tuple[bytes, list[Any]]:
        return bytes(self._kept.whole), list(self._clock)

    def _resumed(self, memory: bytes, clock: list[Any]) -> "CallableStep":
        self._kept.whole[:] = memory
        self._clock[:] = clock
        return self

    def _take_dt(self, dt: Any) -> None:
        """Write the time since the last call to the memory, as the last input of the step. Raises: `BadShape`."""
        if not self.clock.varying:
            raise BadShape(f"dt = {dt!r}", f"is for a step in which it varies; this one has dt = {self.dt:g}")
        if dt is None:
            raise BadShape("dt", f"is missing; give the time since the last call in {plural(self.time)}, as dt=")
        self._take[ELAPSED](dt)
        passed = self._kept.places[Place("input", ELAPSED)].item() if self._clock[0] else 0.0
        self._clock[1] += passed if passed > 0 else 0.0

    def _times(self, elapsed: np.ndarray) -> np.ndarray:
        """Return the times (N) of the samples of a run, and advance the stored time; `elapsed` (N): the time before
        each sample."""
        count, time, _ = self._clock
        if self.clock.varying:
            times = time + np.cumsum(np.where(np.arange(len(elapsed)) + count > 0, elapsed, 0.0))
            self._clock[1] = float(times[-1]) if len(times) else time
        else:
            times = (count + np.arange(len(elapsed))) * self.dt
        self._clock[0] += len(elapsed)
        return np.asarray(times)

    @cached_property
    def _many(self) -> Many:
        return Many(self, self.real)

    @cached_property
    def _entries(self) -> Mapping[str, Entry]:
        return self._kept.entries(self.engine or native.engine())

    def _demand_sections(self) -> None:
        if not self.code.separable:
            raise CannotUpdate(self.observer.name, self.code.rule)


def sample(
    observer: Observer,
    method: Method = methods.continuous_discrete,
    dt: float | tuple[float, float] | None = None,
    *,
    substeps: int | None = None,
    between: str = "line",
    periods: Mapping[str, float] | None = None,
    guards: Guards = "all",
    prefer: Prefer = "speed",
    first: First = "update",
    engine: Engine | None = None,
    real: Real = "double",
    report: str | Sequence[str] = (),
) -> CallableStep:
    """Return the step of the observer at the sampling period `dt` by `method` (default: `methods.continuous_discrete`).

    Times are in the unit of the model's `time`.

    `dt`: a number, or the pair of the shortest and the longest time between two calls. With a pair each call is given
    the time since the last call, and predicts over that time. Over 0 it only corrects. A time above the longest is
    divided into up to `substeps` equal steps (8 by default); beyond these the status bit DT_LIMITED is set and the
    estimate lags. A negative time, or none, is refused by the bit DT_REFUSED. A time below the shortest is used without
    a change.

    `between`: the course of u between samples, "line" (from the last value to this one) or "hold" (the value of this
    call was applied since the last call). `periods`: for sensors of different rates, the time between two samples of an
    output, by name, a whole multiple of dt, by default dt; the noise R of an output is for that time. Such a step
    counts its periods and does not use a sample that `update` assigns to another period, or a second sample of one
    period. `guards`: "none" leaves out everything but the observer's own mathematics: no clamp, no test of a sample, no
    status, no restart. A sample that is not a number then destroys the estimate, and the observer has no claims.
    `prefer`: "flash" for a short program with loops, by default "speed".

    For a discrete plant x+ = f(x, u), dt is the time from one sample to the next, for reports and time axes alone. The
    input of a call moves the plant to the next sample; with `between` "hold" it has moved the plant to this sample.
    `first`: "update", the first call corrects the initial state by its sample; or "predict", it predicts before it
    corrects, with the input at its resting value, or with "hold" by its own input.

    `engine`: "c" or "python", which give the same bits; by default C where there is a compiler. The C is compiled at
    the first sample, and stored in the user's cache. `real`: the precision, "float" as on small firmware, or "double".
    `report`: functions of the emitted code that report on the estimate, whose numbers are among the traces in Python
    (`stepping.reports`): "sigma", the standard deviation of each state; "age", the number of calls since the last used
    sample of each output; "innovation", the innovations of all outputs before any sample is used, with their
    covariance.

    Raises: `BadStep`; `StepTooLong`, with a dt to take, where errors at a point of the box or the covariance equation
    cannot be stable; `StepTooShort` where rounding freezes a state in this precision, or a count does not fit;
    `BadWindow`; `BadRate` for periods that do not fit, `CannotUpdate` where the observer integrates with the
    measurement.
    """
    if not isinstance(observer, Observer):
        raise BadStep(f"{type(observer).__name__} given to sample", "is no observer; make one by hg.observers")
    if not hasattr(method, "riccati"):
        raise BadStep(f"method = {method!r}", "is no method; take one of hg.methods, and the time as dt=")
    if dt is None:
        raise BadStep("dt", f"is missing; give the sampling period in {plural(observer.form.system.time)}, as dt=")
    demand_choice("engine", engine, ("c", "python", None))
    demand_choice("real", real, ("float", "double"))
    demand_choice("guards", guards, ("all", "none"))
    demand_choice("prefer", prefer, ("speed", "flash"))
    with one_thread():
        planned = with_late_samples(
            plan(observer, method, dt, between, periods, guards, prefer, first, report, substeps)
        )
    demand_motion(observer.form, planned.shortest, real)
    _warn_of_angles_and_start(planned)
    for section in planned.code.called:
        if missing := ", ".join(map(str, sorted(dangling(section.program)))):
            raise BadStep(f"section {section.name}", f"reads {missing}, which it never writes")
    return CallableStep(**{f.name: getattr(planned, f.name) for f in fields(planned)}, engine=engine, real=real)


def _warn_of_angles_and_start(planned: Step) -> None:
    form = planned.observer.form
    for x, turn in form.system.growing.items():
        why = "has no range, and its equations repeat after a turn: its value grows with the turns and loses digits"
        declare = f"declare period={turn} of it, and of outputs that are this angle"
        warnings.warn(f"{x} {why}; {declare}", GrowingAngle, stacklevel=3)
    start = next((item.initial for item in planned.layout.state if item.name == "z"), None)
    if start and form.kind == "original" and corrects_nothing(form.system, start):
        at = ", ".join(f"{x.name} = {value:g}" for x, value in zip(form.system.states, start, strict=True))
        why = "where the plant rests and no output has a slope, so that no sample corrects it"
        text = f"the estimate starts at {at}, {why}; start elsewhere, by initial="
        warnings.warn(text, StartsUncorrected, stacklevel=3)


def _quietly(observer: Observer, method: Method, dt: Any, options: Mapping[str, Any]) -> CallableStep:
    with warnings.catch_warnings():
        for known in (StepMayFail, GrowingAngle, StartsUncorrected):
            warnings.simplefilter("ignore", known)
        return sample(observer, method, dt, **options)


def _unpickled(
    observer: Observer, method: Method, dt: Any, options: Mapping[str, Any], memory: tuple[bytes, list[Any]]
) -> CallableStep:
    return _quietly(observer, method, dt, options)._resumed(*memory)
