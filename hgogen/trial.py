"""A trial: the plant's truth, noise on the measurements, jumps, a wrong initial state, and the response of an observer.

    x' = flow(x, u(t); p),  y = output(x, u(t); p) + n,  x jumps at given times
    n_{k+1} = rho n_k + sigma sqrt(1 - rho^2) g_k,  rho = exp(-dt/tau),  n_0 = sigma g_0;  or a tone, a sin(omega t)

The truth is integrated by CVODES (absolute and relative tolerance 1e-13 a step), from jump to jump; many truths of one
plant by `Extrapolation` where that is as accurate. The noise is the exact discretisation of a stationary
Ornstein-Uhlenbeck process, g from numpy's default_rng(seed); tau = 0 is white noise.

The truth of a discrete plant is the iteration of its map, by the inputs at the samples. A jump takes effect at the
first sample that is not before it.

A plant without a trial has a proposed one:

    x(0) = m + c s S,   u_k(t) = m + c S sin(2 pi t/T_k + k pi/2),   xhat(0) = m,   duration 10 D
    T_k = D sqrt(k + 1),  longer where the declared range of a derivative of u_k asks for it,   k = 0, 1, ..

m: the middle and S: half of a range; D: the longest time in which a state crosses its range at its fastest; s: a sign
for each state; c = 1/2, 1/4 or 1/10. No two inputs have the same signal, so that their differences act too. The
proposal is the motion that stays longest in all ranges of the states, the first of equals; where it leaves them, the
trial ends before.
"""

import ctypes
import math
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import astuple, dataclass, field, replace
from functools import cached_property
from itertools import cycle, islice, pairwise
from numbers import Integral, Real
from typing import Annotated, Any, NamedTuple

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.analysis.linearised import NoLinearisation, pace
from hgogen.analysis.manifold import attracted_flow, projected_points
from hgogen.call import CallableStep
from hgogen.errors import BadArgument, HgogenError
from hgogen.form import Form
from hgogen.graph import CVODES, Graph, to_casadi
from hgogen.modelfiles.setting import SEEDS
from hgogen.reading import files
from hgogen.reading.expression import parse
from hgogen.reading.given import names_of, requires_any_plant, scalar
from hgogen.rigor.singular import TINY, with_limited_slopes
from hgogen.run import native
from hgogen.run.samples import Engine, at_sampling_times, with_elapsed
from hgogen.signal import Signal, derived, differences, in_turn, plural, resting, times
from hgogen.signal import t as t
from hgogen.system import System

MEMORY = 1 << 30  # bytes of one seed's truth, measurements and estimates
_TOGETHER = 1 << 20  # numbers of measurements that are computed at once
_FURTHER = 4  # numbers of a sample besides states, inputs and outputs: its time, status and traces
FEW = 16  # columns, up to which lists are faster than rows of an array; the numbers are the same


@dataclass(eq=False)
class BadTrial(HgogenError):
    """The error for a trial that does not fit its plant, or that cannot be integrated."""

    trial: str
    reason: str

    def __str__(self) -> str:
        return f"trial {files.quoted(self.trial)}: {self.reason}"


@dataclass(frozen=True)
class OrnsteinUhlenbeck:
    """Noise of standard deviation `sigma` (the output's unit) and correlation time `tau`, 0 for white."""

    sigma: float
    tau: float = 0.0

    def at(self, times: np.ndarray, rngs: Sequence[np.random.Generator]) -> np.ndarray:
        """Return the noise (N, k) at evenly spaced `times` (N), a column for each of the k generators."""
        normal = np.column_stack([rng.standard_normal(len(times)) for rng in rngs])
        rho = math.exp(-(times[1] - times[0]) / self.tau) if self.tau > 0 else 0.0
        scaled = self.sigma * normal
        scaled[1:] *= math.sqrt(1.0 - rho * rho)
        if scaled.shape[1] < FEW:
            return np.column_stack([_recursion(column.tolist(), rho) for column in scaled.T])
        return np.asarray(_recursion(scaled, rho))


@dataclass(frozen=True)
class Sine:
    """A tone of `amplitude` (the output's unit) and frequency `omega` (rad per time), equal for every seed."""

    amplitude: float
    omega: float

    def at(self, times: np.ndarray, rngs: Sequence[np.random.Generator]) -> np.ndarray:
        """Return the tone (N, k) at `times` (N), a column for each of the k generators."""
        return np.tile(self.amplitude * np.sin(self.omega * times)[:, None], len(rngs))


@dataclass(frozen=True)
class Jump:
    """A jump of the state `state` to `value` at `time`."""

    time: float
    state: str
    value: float


@dataclass(frozen=True)
class Settled:
    """The criterion of settling: |error of `state`| stays at most `band` from some time on, for at least the time
    `hold`."""

    state: str
    band: float
    hold: float


@dataclass(frozen=True)
class Trial:
    """A scenario, repeated over noise seeds; its times are in the unit of time of the plant's System.

    `duration`; `start`: the plant's state by name; `inputs`: an expression of `hgogen.trial.t`, or a number, for each
    input by name (not for one that is the derivative of another); `noise` by output name, or its standard deviation;
    `jumps`: one or several; `steady`: the time from which errors count as steady, by default the start of the last
    tenth; `seeds`: of the noise, or how many; `estimate`: the plant's state by name from which every observer starts,
    by default its own start, and in a comparison the nominal values.

    Raises: `BadTrial` for a field of another kind.
    """

    name: Annotated[str, "name of the trial"]
    duration: float
    start: Annotated[Mapping[str, float], "the plant's state at the start"]
    inputs: Mapping[str, Any] = field(default_factory=dict)
    noise: Mapping[str, OrnsteinUhlenbeck | Sine] = field(default_factory=dict)
    jumps: tuple[Jump, ...] = ()
    settled: Settled | None = None
    steady: float | None = None
    seeds: tuple[int, ...] = tuple(range(12))
    estimate: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for key, value in vars(self).copy().items():
            object.__setattr__(self, key, read_field(self.name, key, value))

    def first_estimate(self, form: Form) -> dict[str, float]:
        """Return the `initial` of a form's observers for the state `estimate` at time 0. Raises: `BadTrial`."""
        plant = form.system.declared
        _names(self, "inputs", input_expressions(form.system, self), {s.name for s in form.system.inputs}, needed=True)
        _names(self, "estimate", self.estimate, {s.name for s in plant.states})
        first = zip(form.system.inputs, inputs_at(form.system, self, np.zeros(1))[0], strict=True)
        read = set().union(*(sp.sympify(e).free_symbols for e in form.to_form))
        return dict(self.estimate) | {u.name: float(value) for u, value in first if u in read}

    def first_state(self, plant: System) -> dict[str, float]:
        """Return `estimate` completed to every state of the plant."""
        return {s.name: float(self.estimate.get(s.name, resting(s))) for s in plant.states}

    @property
    def events(self) -> tuple[float, ...]:
        """0 and the times of the jumps, in order, each once."""
        return tuple(sorted({0.0, *(float(jump.time) for jump in self.jumps)}))

    @property
    def steady_from(self) -> float:
        """The time from which errors count as steady: `steady`, or the start of the trial's last tenth."""
        return 0.9 * self.duration if self.steady is None else self.steady


@dataclass(frozen=True, eq=False)
class Truth:
    """The simulated plant at the samples, without noise: t (N,), x (N, n), u (N, m), y (N, p); at a jump the values
    after it. `states`: the signals of x; the values of a periodic one are wrapped to its turn; `opposites`: the sets of
    states of which both signs together are equivalent, as q and -q of a quaternion."""

    t: np.ndarray
    x: np.ndarray
    u: np.ndarray
    y: np.ndarray
    states: tuple[Signal, ...] = ()
    opposites: tuple[tuple[int, ...], ...] = ()

    def error(self, estimate: np.ndarray) -> np.ndarray:
        """Return estimate - x (N, n); angles are compared the short way round, and states of which both signs together
        are equivalent with the nearer sign."""
        estimate = estimate.copy() if self.opposites else estimate
        for v in map(list, self.opposites):
            estimate[:, v] *= np.where((estimate[:, v] * self.x[:, v]).sum(axis=1) < 0, -1, 1)[:, None]
        return differences(self.states, estimate, self.x)

    @property
    def at_once(self) -> int:
        """The number of seeds whose measurements are computed at once."""
        return max(1, _TOGETHER // self.y.size)


class Feed(NamedTuple):
    """The inputs of one run of a step: trial, seed and truth, the inputs u (N, m), and the measurements y (N, p)."""

    trial: Trial
    seed: int
    truth: Truth
    u: np.ndarray
    y: np.ndarray


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A seed of a trial: the truth, the measurements y (N, p), and the response of the step.

    `x` (N, n) estimate; `traces` by name (N,); `status` (N,); `engine`: the engine that ran the step.
    """

    trial: Trial
    seed: int
    truth: Truth
    y: np.ndarray
    x: np.ndarray
    traces: Mapping[str, np.ndarray]
    status: np.ndarray
    engine: str

    @property
    def error(self) -> np.ndarray:
        """The estimate minus the truth (N, n)."""
        return self.truth.error(self.x)


def simulate(plant: System, trial: Trial, dt: float, times: np.ndarray | None = None) -> Truth:
    """Return the plant's truth at 0, dt, .. up to the trial's duration, or at `times`, parameters at their nominal
    values. Raises: `BadTrial` for names or numbers that do not fit, or a plant that cannot be integrated that far."""
    return Plant(plant, trial, dt, times=times).truth(trial.start)


def sample_times(step: CallableStep, trial: Trial) -> np.ndarray | None:
    """Return the times (N) of a trial's samples for a step whose dt varies, drawn evenly between its limits, the same
    ones each time; None for one at multiples of dt."""
    if not step.clock.varying:
        return None
    draw = np.random.default_rng(0).uniform(step.shortest, step.dt, math.ceil(trial.duration / step.shortest))
    times = np.concatenate([[0.0], np.cumsum(draw)])
    return times[times <= trial.duration]


def elapsed(step: CallableStep, truth: Truth) -> np.ndarray | None:
    """Return the argument `dt` of a run on the samples of a truth: the times (N) between them where dt varies."""
    return np.diff(truth.t, prepend=0.0) if step.clock.varying else None


def motion(step: CallableStep, trial: Trial, free: Sequence[Signal] = ()) -> ca.Function:
    """Return the plant along a trial as a function (x, t, p) -> (x', y, u): its rate, or its next state if it is
    discrete, the outputs without noise and the inputs of the step; p: values of the parameters `free`, the others are
    nominal. Raises: `BadTrial`."""
    system = step.observer.form.system
    plant, signals = Plant(system.declared, trial, step.dt, free), input_expressions(system, trial)
    x, time, p = (plant.graph[name] for name in "xtp")
    u = to_casadi([sp.sympify(signals[s.name]) for s in system.inputs], {t: time})
    return ca.Function("truth", [x, time, p], [plant.graph["ode"], plant.measure(x, time, p), ca.vertcat(*u)])


class Plant:
    """A plant along a trial, prepared once for several truths.

    `free`: parameters whose values differ from truth to truth; the others are nominal; `many`: whether there are enough
    truths to compile their integration; `times`: those of the samples, by default multiples of dt.

    Raises: `BadTrial` for names or numbers that do not fit.
    """

    def __init__(
        self,
        plant: System,
        trial: Trial,
        dt: float,
        free: Sequence[Signal] = (),
        many: bool = False,
        times: np.ndarray | None = None,
    ) -> None:
        self._plant = plant
        self._trial = trial = replace(trial, inputs=input_expressions(plant, trial))
        demand_trial(plant, trial, dt)
        self.times = np.arange(round(trial.duration / dt) + 1) * dt if times is None else times
        time, x, p = ca.SX.sym("t"), ca.SX.sym("x", len(plant.states)), ca.SX.sym("p", len(free))
        u = to_casadi([sp.sympify(trial.inputs[s.name]) for s in plant.inputs], {t: time})
        symbols = dict(zip(plant.states, ca.vertsplit(x), strict=True)) if plant.states else {}
        symbols |= dict(zip(plant.inputs, u, strict=True)) | {p: float(v) for p, v in plant.nominal.items()}
        symbols |= dict(zip(free, ca.vertsplit(p), strict=True)) if free else {}
        flow = (
            with_limited_slopes(row, plant.box, TINY) for row in plant.flow
        )  # its slopes have to be finite, at powers of 0 too
        ode = attracted_flow(ca.vertcat(*to_casadi(flow, symbols)), plant.constraints, plant.states, symbols, 1 / dt)
        self.graph: Mapping[str, Graph] = {"x": x, "t": time, "p": p, "ode": ode}
        self._map: Any = ca.Function("map", [x, time, p], [ca.densify(self.graph["ode"])])
        self.measure: Any = ca.Function("measure", [x, time, p], [ca.vertcat(*to_casadi(plant.output, symbols))])
        self._segments = list(_segments(trial, self.times))
        self._integrators: dict[float, ca.Function] = {}
        moving = [one for one in self._segments if many and one.stops and not plant.discrete]
        self._marches = {one.begin: Extrapolation(self.graph, [one.begin, *one.stops]) for one in moving}

    def truth(self, start: Mapping[str, float], parameters: Sequence[float] = ()) -> Truth:
        """Return the truth from a state by name, with values of the free parameters. Raises: `BadTrial`."""
        x, times = self.states(start, parameters), self.times[None, :]
        values = np.tile(np.array(parameters, dtype=float)[:, None], times.shape)
        y = np.array(self.measure.map(times.size)(x.T, times, values)).T
        plant = self._plant
        x, y = in_turn(plant.states, x), in_turn(plant.outputs, y)
        return Truth(self.times, x, self.u, y, plant.states, plant.opposites)

    @cached_property
    def u(self) -> np.ndarray:
        """The inputs (N, m) at the samples."""
        return inputs_at(self._plant, self._trial, self.times)

    def states(self, start: Mapping[str, float], parameters: Sequence[float] = ()) -> np.ndarray:
        """Return the states of the truth (N, n); a jump takes effect at its exact time. Raises: `BadTrial`."""
        p = np.array(parameters, dtype=float)
        index = {s.name: i for i, s in enumerate(self._plant.states)}
        now = np.array([start[s.name] for s in self._plant.states], dtype=float)
        if self._plant.discrete:
            return self._iterated(now, p)
        states = np.empty((len(self.times), len(now)))
        for segment in self._segments:
            for jump in self._trial.jumps:
                if jump.time == segment.begin:
                    now[index[jump.state]] = jump.value
            states[segment.here] = now
            if segment.stops:
                reached = self._marches[segment.begin](now, p) if self._marches else None
                if reached is None:
                    reached = self._by_cvodes(segment, now, p)
                states[segment.inside], now = reached[: len(segment.inside)], reached[-1].copy()
        return states

    def _iterated(self, now: np.ndarray, p: np.ndarray) -> np.ndarray:
        index = {s.name: i for i, s in enumerate(self._plant.states)}
        due = np.searchsorted(self.times, [(1 - 1e-9) * jump.time for jump in self._trial.jumps])
        states, begins = np.empty((len(self.times), len(now))), sorted({0, *due[due < len(self.times)].tolist()})
        for begin, end in pairwise((*begins, len(self.times))):
            for k, jump in zip(due, self._trial.jumps, strict=True):
                if k == begin:
                    now[index[jump.state]] = jump.value
            times = self.times[None, begin:end]
            after = np.array(self._map.mapaccum(end - begin)(now, times, np.tile(p[:, None], times.shape))).T
            states[begin], states[begin + 1 : end], now = now, after[:-1], after[-1].copy()
        if not np.isfinite(states).all():
            at = self.times[~np.isfinite(states).all(axis=1)][0]
            reason = f"the plant's map has no finite value before t = {at:g}; check flow, start and inputs"
            raise BadTrial(self._trial.name, reason)
        return states

    def _by_cvodes(self, segment: "_Segment", now: np.ndarray, p: np.ndarray) -> np.ndarray:
        begin, stops, options = segment.begin, segment.stops, {**CVODES, "abstol": 1e-13, "reltol": 1e-13}
        try:
            with deferred_interrupt():
                if begin not in self._integrators:
                    self._integrators[begin] = ca.integrator("truth", "cvodes", self.graph, begin, stops, options)
                reached = np.array(self._integrators[begin](x0=now, p=p)["xf"]).T
        except RuntimeError:
            reached = np.full((len(stops), len(now)), np.nan)
        if not np.isfinite(reached).all():
            raise BadTrial(
                self._trial.name,
                f"the plant cannot be integrated from t = {begin:g} to t = {stops[-1]:g}; it may escape in finite "
                "time or leave the domain of a function: check flow, start and inputs, or shorten the trial",
            )
        return reached


@dataclass(frozen=True, eq=False)
class _Segment:
    """The time from an event at `begin` to the next event: the samples `here` at the first event (a mask), the samples
    `inside` (their indices), and the times at which the integration stops, including the next event."""

    begin: float
    here: np.ndarray
    inside: np.ndarray
    stops: list[float]


def _segments(trial: Trial, times: np.ndarray) -> Iterator[_Segment]:
    grain = 1e-9 * times[1]  # a jump this near to a sample is at the sample
    for begin, end in pairwise((*trial.events, math.inf)):
        inside = np.flatnonzero((times > begin + grain) & (times < end - grain))
        stops = [*times[inside], *([end] if end <= times[-1] + grain else [])]
        yield _Segment(begin, np.abs(times - begin) <= grain, inside, stops)


def inputs_at(plant: System, trial: Trial, moments: np.ndarray) -> np.ndarray:
    """Return the plant's inputs (N, m) at the times `moments`."""
    time, inputs = ca.SX.sym("t"), input_expressions(plant, trial)
    u = to_casadi([sp.sympify(inputs[s.name]) for s in plant.inputs], {t: time})
    each = ca.Function("inputs", [time], [ca.densify(ca.SX(ca.vertcat(*u)))])
    values = np.array(each.map(len(moments))(moments[None, :])).T.reshape(len(moments), -1)
    for j, w in enumerate(plant.times, len(plant.supplied)):
        values[:, j] %= float(w.turn)
    return values


def input_expressions(plant: System, trial: Trial) -> dict[str, Any]:
    """Return the expression in t of every input of the plant by name: as the trial declares it, a derivative of another
    input, or the time itself."""
    rates = {
        name: sp.diff(sp.sympify(trial.inputs[source]), t, order)
        for name, (source, order) in derived(plant.inputs).items()
        if source in trial.inputs
    }
    return rates | dict(trial.inputs) | {w.name: t for w in times(plant.inputs)}


def noisy(plant: System, truth: Truth, trial: Trial, seeds: Sequence[int]) -> np.ndarray:
    """Return the measurements y (k, N, p), the truth plus the noise of k seeds, one generator for all outputs."""
    rngs, y = [np.random.default_rng(seed) for seed in seeds], np.repeat(truth.y[None], len(seeds), axis=0)
    for j, output in enumerate(plant.outputs):
        if output.name in trial.noise:
            y[:, :, j] = output.turned(y[:, :, j] + trial.noise[output.name].at(truth.t, rngs).T)
    return y


def try_out(
    step: CallableStep, trial: Trial, engine: Engine | None = None, seeds: Sequence[int] | None = None
) -> Iterator[Trajectory]:
    """Return the response of the step in the trial, one trajectory for each seed, from the trial's `estimate`, else
    from the step's reset state. The step remains as after the last sample. A slower sensor has its first sample at 0.

    `engine`: as in `Step.run`, "c", "python" or None for C where there is a compiler.

    Raises: `BadTrial`; `BadGain` for an estimate that the observer cannot start from.
    """
    truth = simulate(step.observer.form.system.declared, trial, step.dt, sample_times(step, trial))
    runs = feeds(step, trial, truth, trial.seeds if seeds is None else seeds)
    yield from run_feeds(step, runs, first_memory(step, trial), engine)


def first_memory(step: CallableStep, trial: Trial) -> bytes:
    """Return the memory of a step, as `save` does, at a trial's start: with the trial's first estimate if it has one,
    else the step's own. Raises: `BadGain` for an estimate that the observer cannot start from."""
    step.reset(0.0)
    return step.started(trial.first_estimate).save() if trial.estimate else step.save()


def run_feeds(step: CallableStep, runs: Iterable[Feed], start: bytes, engine: Engine | None) -> Iterator[Trajectory]:
    """Yield the response of the step to each run of a trial, restarted each time from the memory `start`, bytes from
    `save`."""
    for one in runs:
        step.restore(start)
        run = step.run(u=one.u, y=step.arriving(one.y), engine=engine, dt=elapsed(step, one.truth))
        yield Trajectory(one.trial, one.seed, one.truth, one.y, run.x, run.traces, run.status, run.engine)


def feeds(step: CallableStep, trial: Trial, truth: Truth, seeds: Sequence[int]) -> Iterator[Feed]:
    """Yield the inputs and the noisy measurements of each seed, for the `truth` of the plant; the noise of many seeds
    is computed in one call."""
    system = step.observer.form.system
    u = truth.u if system.inputs == system.declared.inputs else inputs_at(system, trial, truth.t)
    for first in range(0, len(seeds), truth.at_once):
        some = seeds[first : first + truth.at_once]
        for seed, y in zip(some, noisy(system.declared, truth, trial, some), strict=True):
            yield Feed(trial, seed, truth, u[:, : len(step.inputs)], at_sampling_times(step, y))


def demand_trial(plant: System, trial: Trial, dt: float) -> None:
    """Raise `BadTrial` unless every name in the trial is one of the plant, every required name has a value, and every
    number is valid."""
    states = {s.name for s in plant.states}
    _names(trial, "start", trial.start, states, needed=True)
    _names(trial, "inputs", trial.inputs.keys() - {*names_of(plant.times)}, {*names_of(plant.supplied)}, needed=True)
    _names(trial, "estimate", trial.estimate, states)
    _names(trial, "noise", trial.noise, {s.name for s in plant.outputs})
    _names(trial, "jumps", [jump.state for jump in trial.jumps], states)
    _names(trial, "settled", [trial.settled.state] if trial.settled else [], states)
    width = 2 * len(plant.states) + len(plant.inputs) + 2 * len(plant.outputs) + _FURTHER
    for reason in (*_faults(trial, dt, plant.time, width), *_outside(plant, trial)):
        raise BadTrial(trial.name, reason)


def _faults(trial: Trial, dt: float, unit: str, width: int) -> Iterator[str]:
    if not dt <= trial.duration < math.inf:
        yield f"duration = {trial.duration!r} must be a time in {plural(unit)}, at least dt = {dt:g}"
    elif (rows := trial.duration / dt) * width > MEMORY / 8:
        longest = 0.9 * MEMORY / 8 / width * dt
        yield (
            f"duration = {trial.duration:g} {unit} is {rows:.3g} samples of dt = {dt:g} {unit}, which take "
            f"{8 * rows * width / 2**30:.3g} GiB of memory; take a duration of at most {longest:.2g} {unit}, or a "
            "longer dt"
        )
    if not 0 <= trial.steady_from <= trial.duration:
        yield f"steady = {trial.steady_from:g} must lie within 0..{trial.duration:g} {unit}"
    if not trial.seeds:
        yield "it has no seeds; give at least one, seeds=(0,)"
    for name, value in trial.start.items():
        if not math.isfinite(value):
            yield f"start {name} = {value} is not finite; give a finite number"
    for jump in trial.jumps:
        if not (0 < jump.time <= trial.duration and math.isfinite(jump.value)):
            yield f"{jump} must lie within 0..{trial.duration:g} {unit} and have a finite value"
    if trial.settled and not (0 < trial.settled.band < math.inf and 0 < trial.settled.hold < math.inf):
        yield f"{trial.settled} must have a band and a hold ({unit}) above 0, and finite"
    for name, noise in trial.noise.items():
        if not all(0 <= number < math.inf for number in astuple(noise)):
            yield f"{noise} of {name} must have finite numbers, not negative"
    for name, value in trial.inputs.items():
        if strangers := sp.sympify(value).free_symbols - {t}:
            yield f"input {name} uses {min(map(str, strangers))}; write it as an expression of hgogen.trial.t"


def _outside(plant: System, trial: Trial) -> Iterator[str]:
    states = {s.name: s for s in plant.states}
    for jump in trial.jumps:
        low, high = states[jump.state].limits
        if not low <= jump.value <= high:
            yield f"{jump} leaves the range {low}..{high} of {jump.state}; declare a wider one, or jump less far"
    point = np.array([[trial.start[name] for name in states]], dtype=float)
    projected = projected_points(plant.invariants, plant.states, plant.nominal, point)
    if not (len(projected) and np.allclose(projected, point, rtol=1e-6, atol=1e-9)):
        listed = ", ".join(f"{name} = {value:.6g}" for name, value in zip(states, projected.ravel(), strict=False))
        yield f"start is not on the plant's invariants; take {listed or 'a point on them'}"


def _names(trial: Trial, what: str, names: Any, known: set[str], needed: bool = False) -> None:
    listed = ", ".join(sorted(known)) or "none"
    for name in names:
        if name not in known:
            raise BadTrial(trial.name, f"{what} names {name!r}, which the plant does not have; it has {listed}")
    for name in sorted(known):
        if needed and name not in names:
            raise BadTrial(trial.name, f"{what} says nothing of {name!r}; give it a value")


def rows_given(step: CallableStep, trial: Trial, count: int = 300) -> np.ndarray:
    """Return the first samples (count, m + p) of the trial's first seed, as a call of the step reads them: the inputs
    `Step.given`, then the measurements `Step.samples`. A shorter trial gives fewer. Raises: `BadTrial`."""
    nominal = replace(trial, jumps=(), steady=None, settled=None, duration=min(trial.duration, count * step.dt))
    system = step.observer.form.system
    truth = simulate(system.declared, nominal, step.dt, sample_times(step, nominal))
    (y,) = noisy(system.declared, truth, nominal, nominal.seeds[:1])
    u, _ = with_elapsed(step, inputs_at(system, nominal, truth.t), elapsed(step, truth))
    rows: np.ndarray = np.hstack([u, step.arriving(at_sampling_times(step, y))])
    return rows[:count]


def _recursion(values: Any, rho: float) -> Any:
    """Return the solution v (N) or (N, k) of v_k = values_k + rho v_(k-1), v_0 = values_0, written over `values`."""
    for k in range(1, len(values)):
        values[k] += rho * values[k - 1]
    return values


# --- conversion of fields -------------------------------------------------------------------------------------


def read_field(trial: Any, key: str, value: Any) -> Any:
    """Return the value of a trial's field `key`; a number of seeds, a single jump or a standard deviation is converted
    to the type of the field. Raises: `BadTrial`."""
    if key not in _FIELDS:
        return value
    reader, wanted = _FIELDS[key]
    try:
        return reader(value)
    except HgogenError as error:
        raise BadTrial(str(trial), f"{key}: {error}") from None
    except (TypeError, ValueError, OverflowError):
        raise BadTrial(str(trial), f"{key} = {files.quoted(value)} must be {wanted}") from None


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


def _number(value: Any) -> Any:
    if isinstance(value, bool | str):
        raise TypeError
    float(value)
    return value


def _each(reader: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda entries: {_text(name): reader(value) for name, value in dict(entries).items()}


def _noise(value: Any) -> Any:
    noise = OrnsteinUhlenbeck(_number(value)) if isinstance(value, Real) else value
    return _instance(noise, OrnsteinUhlenbeck | Sine)


def _instance(entry: Any, kind: Any) -> Any:
    if not isinstance(entry, kind):
        raise TypeError
    for key, value in vars(entry).items():
        (_text if key == "state" else _number)(value)
    return entry


def _seeds(seeds: Any) -> tuple[int, ...]:
    if isinstance(seeds, Integral) and not isinstance(seeds, bool):
        if int(seeds) > SEEDS:
            raise ValueError
        seeds = range(int(seeds))
    seeds = tuple(seeds)
    if not all(isinstance(seed, Integral) and not isinstance(seed, bool) and int(seed) >= 0 for seed in seeds):
        raise ValueError
    return tuple(map(int, seeds))


def _unless_none(reader: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda value: None if value is None else reader(value)


_STATE = "a number for each state by name, such as {'x1': 1.0}"
_FIELDS: dict[str, tuple[Callable[[Any], Any], str]] = {
    "name": (lambda name: files.demand_file_name(_text(name)), "text"),
    "duration": (_number, "a number"),
    "start": (_each(_number), _STATE),
    "estimate": (_each(_number), _STATE),
    "inputs": (
        _each(lambda value: parse(value, {"t": t}) if isinstance(value, str) else scalar(value, "an input")),
        "an expression of hgogen.trial.t, or a number, for each input by name",
    ),
    "noise": (_each(_noise), "a standard deviation, an OrnsteinUhlenbeck or a Sine for each output by name"),
    "jumps": (
        lambda jumps: tuple(_instance(one, Jump) for one in ((jumps,) if isinstance(jumps, Jump) else jumps)),
        "a Jump(time, state, value), or several in a tuple",
    ),
    "settled": (_unless_none(lambda value: _instance(value, Settled)), "a Settled(state, band, hold), or None"),
    "steady": (_unless_none(_number), "a number, or None"),
    "seeds": (_seeds, f"a count from 1 to {SEEDS}, or whole numbers from 0 in a tuple, such as (0, 1)"),
}


Array = np.ndarray
ORDERED = (2, 4, 6, 8)  # n_i
LOCAL = 1e-12  # of the peak of a state, an error of T_43
_LOOP = """
void march(long long count, long long n, double* x, double* e, const double* t, const double* h, const double* p,
           long long* iw, double* w) {
  const double* arg[%d];
  double* res[%d];
  for (long long k = 0; k < count; k++) {
    arg[0] = x + k*n, arg[1] = t + k, arg[2] = h + k, arg[3] = p;
    res[0] = x + (k + 1)*n, res[1] = e + k*n;
    march_step(arg, res, iw, w, 0);
  }
}
"""


class Extrapolation:
    """The motion of x' = f(x, t; p) from `times[0]` to the others, by extrapolation with given steps, compiled.

        z_1 = x + h/n f(x),   z_(j+1) = z_(j-1) + 2 h/n f(z_j),   T_i1 = z_n,   n = n_i of 2, 4, 6, 8
        T_(i,k+1) = T_ik + (T_ik - T_(i-1,k))/((n_i/n_(i-k))^2 - 1),   x+ = T_44,   e = T_44 - T_43

    x+ is of order 8, e the error of T_43, of order 6. A motion is valid where e stays below `LOCAL` of the peak of each
    state: its error is then below that of CVODES. An input may jump at a given time, where a step ends.
    Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (1993), II.9: Gragg's rule, extrapolated.

    `ode`: graphs of the state "x", the time "t", parameters "p" and the rate "ode", as for CasADi's integrators.
    """

    def __init__(self, ode: Mapping[str, Graph], times: Sequence[float]) -> None:
        self.graph, self._t, self._h = ode, np.asarray(times, dtype=float)[:-1], np.diff(times)

    def __call__(self, start: Array, p: Array) -> Array | None:
        """Return the states (k, n) at `times[1:]` from `start` (n) at `times[0]` with the parameters p; None where the
        error is too large, and without a compiler."""
        if not native.compiler():
            return None
        count, n = len(self._t), len(start)
        states, errors = np.empty((count + 1, n)), np.empty((count, n))
        states[0] = start
        integers, numbers = np.empty(self._step.sz_iw(), dtype=np.int64), np.empty(self._step.sz_w())
        arrays = (states, errors, self._t, self._h, np.asarray(p, dtype=float), integers, numbers)
        self._march(count, n, *(each.ctypes.data for each in arrays))
        with np.errstate(all="ignore"):
            good = errors.max(axis=0) <= LOCAL * np.abs(states).max(axis=0)
        return states[1:] if good.all() else None

    @cached_property
    def _step(self) -> Any:
        """The CasADi function (x, t, h, p) -> (x+, |e|) of one extrapolated integration step."""
        t, h = ca.SX.sym("t"), ca.SX.sym("h")
        x, p = self.graph["x"], self.graph["p"]
        rate = ca.Function("rate", [x, self.graph["t"], p], [ca.densify(self.graph["ode"])])
        first, rows = rate(x, t, p), [[x]]
        for i, n in enumerate(ORDERED):
            before, now = x, x + h / n * first
            for j in range(1, n):
                before, now = now, before + 2 * h / n * rate(now, t + j * h / n, p)
            row = [now]
            for k in range(1, i + 1):
                row.append(row[-1] + (row[-1] - rows[-1][k - 1]) / ((n / ORDERED[i - k]) ** 2 - 1))
            rows.append(row)
        return ca.Function("march_step", [x, t, h, p], [rows[-1][-1], ca.fabs(rows[-1][-1] - rows[-1][-2])])

    @cached_property
    def _march(self) -> Any:
        generator = ca.CodeGenerator("step.c")
        generator.add(self._step)
        loop = _LOOP % (self._step.sz_arg(), self._step.sz_res())
        march = native.library({"step.c": generator.dump() + loop}, ("-O2",)).march
        march.argtypes = (*[ctypes.c_longlong] * 2, *[ctypes.c_void_p] * 7)
        march.restype = None
        return march


@contextmanager
def deferred_interrupt() -> Iterator[list[Any]]:
    """Yield a list that collects Ctrl-C during the `with` block; the interrupt is raised at its end. CasADi would take
    the exception of a signal handler for a failure of the model."""
    deferred_interrupt: list[Any] = []
    before = signal.getsignal(signal.SIGINT)
    if not callable(before) or threading.current_thread() is not threading.main_thread():  # it is ignored, or not ours
        yield deferred_interrupt
        return
    signal.signal(signal.SIGINT, lambda *signalled: deferred_interrupt.append(signalled))
    try:
        yield deferred_interrupt
    finally:
        signal.signal(signal.SIGINT, before)
    if deferred_interrupt:
        before(*deferred_interrupt[-1])


CROSSINGS = 10.0  # times D
SAMPLES = 2000  # of a motion
SHARES = (0.5, 0.25, 0.1)  # c
SIGNS = ((1,), (1, -1), (-1,))
PARTS = tuple(0.5**k for k in range(7, -1, -1))  # of the duration
BEFORE = 0.9  # of the time to leave
LEAST = 0.1  # of D: a shorter motion is no trial


class NoTrial(BadArgument):
    """The error for a plant whose ranges are insufficient for a proposed trial."""


@requires_any_plant
def proposed_trial(plant: System) -> Trial:
    """Return a trial without noise for a plant that declares none: of several motions, the one that stays in the ranges
    longest. For a plant in other coordinates it is a trial of the plant as declared.

    Raises: `NoTrial` where the plant is discrete, a state or an input has no range, no state moves, or every motion
    leaves the ranges from the start.
    """
    first = plant.declared
    if plant.discrete:
        raise NoTrial(f"plant {plant.name!r}", "is discrete in time, so that it has no time scale; declare a trial")
    if unknown := [s.name for s in (*first.states, *first.inputs) if not s.bounded]:
        raise NoTrial(f"plant {plant.name!r}", f"has no range of {', '.join(unknown)}, and no trial; declare either")
    try:
        longest = pace(first).longest
    except NoLinearisation as error:
        raise NoTrial(f"plant {plant.name!r}", str(error)) from None
    if not longest:
        raise NoTrial(f"plant {plant.name!r}", "does not move within its ranges; declare a trial")
    motions = list(_motions(first, longest))
    durations = [_stay(first, one) for one in motions]
    best = int(np.argmax(durations))
    if durations[best] < LEAST * longest:
        raise NoTrial(
            f"plant {plant.name!r}",
            f"leaves its ranges within {durations[best]:.2g} {first.time} on every motion that was tried; declare a "
            "trial in which it is held there",
        )
    motion = motions[best]
    return motion if durations[best] >= motion.duration else replace(motion, duration=BEFORE * durations[best])


def _motions(plant: System, longest: float) -> Iterator[Trial]:
    names = [x.name for x in plant.states]

    def state(values: list[float]) -> dict[str, float]:
        points = projected_points(plant.invariants, plant.states, plant.nominal, np.array([values]))
        return dict(zip(names, points[0].tolist(), strict=True)) if len(points) else {}

    middle = state([_middle(x) for x in plant.states])
    for share in SHARES:
        for signs in SIGNS:
            signed = zip(plant.states, islice(cycle(signs), len(plant.states)), strict=True)
            start = state([_middle(x) + share * sign * _half(x) for x, sign in signed])
            inputs = {u.name: _tone(k, u, share * _half(u), longest) for k, u in enumerate(plant.supplied)}
            yield Trial("proposed", CROSSINGS * longest, start, inputs, estimate=middle, seeds=(0,))


def _tone(k: int, u: Signal, amplitude: float, longest: float) -> sp.Expr:
    """Return u_k = m + c S sin(2 pi t/T_k + k pi/2), T_k so long that the amplitude (2 pi/T_k)^j c S of each derivative
    j is in its range, where that has 0 inside; c S = `amplitude`."""
    limits = ((order, min(-low, high)) for order, (low, high) in enumerate(u.rates, 1))
    slowest = (2 * math.pi * (amplitude / limit) ** (1 / order) for order, limit in limits if limit > 0)
    period = max(longest * math.sqrt(k + 1), *slowest, 0.0)
    return _middle(u) + amplitude * sp.sin(2 * sp.pi * t / period + k * sp.pi / 2)


def _stay(plant: System, trial: Trial) -> float:
    low, high = np.array([s.limits for s in plant.states]).T
    stayed = 0.0
    for part in PARTS:
        duration = part * trial.duration
        try:
            x = Plant(plant, replace(trial, duration=duration), duration / SAMPLES).states(trial.start)
        except BadTrial:
            return stayed
        outside = np.flatnonzero(((x < low) | (x > high)).any(axis=1))
        if len(outside):
            return float(outside[0] * duration / SAMPLES)
        stayed = duration
    return stayed


def _middle(signal: Signal) -> float:
    return math.fsum(signal.interval) / 2


def _half(signal: Signal) -> float:
    return (signal.interval[1] - signal.interval[0]) / 2
