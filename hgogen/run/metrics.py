"""Metrics of a trial: time to settle after each event, steady errors, adaptation of theta, actions of guards.

The events of a trial are its start (the initial state is wrong) and its jumps. An event lasts until the next one. A
trial without a declared band is settled when every error stays within `SHARE` of its state's declared range, else of
the range of the truth along the trial.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated, Any

import numpy as np

from hgogen.call import CallableStep
from hgogen.emit import layout
from hgogen.emit.saved import sealed
from hgogen.run.gates import GateShare, gate_shares
from hgogen.run.samples import Engine, Run
from hgogen.signal import resting
from hgogen.step import Step
from hgogen.system import System
from hgogen.trial import Settled, Trajectory, Trial, noisy, simulate

SHARE = 0.05  # of a state's range
TRIGGERED = 1.5  # theta above which the adaptation counts as triggered
KALMAN = 1.05  # theta below which the observer counts as an extended Kalman filter again
LATE = 5  # the last fifth of the time between two events is late
LATCHED = 0.5  # share of the late time with theta above 1.5, from which theta counts as not recovering
WARM_UP = 0.05  # first share of a trial, in which the estimate may be outside its ranges
ALARM_SEEDS = 3  # most seeds of an alarm ratio, a mean over many windows that varies little
ITSELF = 1.0  # the alarm ratio above which the alarm can feed itself


@dataclass(frozen=True)
class Response:
    """The response to an event of a trial (start, jump): settling times, and the course of theta; None for an event
    that never happened or a quantity that does not apply."""

    time: Annotated[float, "time of the event (s)"]
    settled: Annotated[float | None, "time to settle (s); null: never"]
    peak: Annotated[float | None, "largest theta"]
    theta_settled: Annotated[float | None, "time until theta is under 1.05 for good (s)"]
    triggers: Annotated[int | None, "how often theta rose through 1.5"]
    loud: Annotated[float | None, "share of the last fifth of the time before the next event with theta above 1.5"]


@dataclass(frozen=True)
class Metrics:
    """The metrics of one trajectory (one seed): the response to each event, and the steady errors by state."""

    seed: Annotated[int, "seed of the noise"]
    engine: Annotated[str, "who ran the step: c or python"]
    responses: Annotated[tuple[Response, ...], "what followed each event"]
    rms: Annotated[Mapping[str, float], "steady error by state"]
    clamped: Annotated[int, "samples after the first 5% with the estimate outside its ranges or its outer box"]


def metrics(step: Step, trajectory: Trajectory) -> Metrics:
    """Return the metrics of a trajectory of `step`: times to settle after each event, RMS errors."""
    trial, t = trajectory.trial, trajectory.truth.t
    pairs = pairwise((*trial.events, math.inf))
    spans = [(begin, (t >= begin - 1e-9) & (t < end - 1e-9)) for begin, end in pairs]
    steady = trajectory.error[t >= trial.steady_from - 1e-9]
    rms = np.sqrt(np.mean(steady**2, axis=0))
    if step.clock.guarded:
        bits = sum(1 << k for k, bit in enumerate(step.layout.bits) if bit.name in ("OUTSIDE_BOX", "STATE_LIMITED"))
        outside = trajectory.status & trajectory.status.dtype.type(bits) != 0
    else:  # the status has no bits of guards
        low, high = np.array([s.limits for s in step.states]).T
        outside = ~((trajectory.x >= low) & (trajectory.x <= high)).all(axis=1)
    late = t > WARM_UP * trial.duration
    return Metrics(
        seed=trajectory.seed,
        engine=trajectory.engine,
        responses=tuple(_response(step, trajectory, begin, span) for begin, span in spans),
        rms={s.name: float(value) for s, value in zip(step.states, rms, strict=True)},
        clamped=int(np.count_nonzero(outside[late])),
    )


def criterion(trial: Trial, unit: str = "s") -> str:
    """Return in words when a trial counts as settled, such as the error band; `unit`: the unit of time."""
    if trial.settled is None:
        return f"every error within {100 * SHARE:g}% of its state's range until the next event"
    return f"|error of {trial.settled.state}| <= {trial.settled.band:g} for {trial.settled.hold:g} {unit}"


def ranges(step: Step, trajectory: Trajectory) -> np.ndarray:
    """Return the width (n) of each state's declared range; without a declared range, the width of its course along the
    trajectory."""
    spans = np.ptp(trajectory.truth.x, axis=0)
    widths = [s.interval[1] - s.interval[0] if s.bounded else spans[i] or 1.0 for i, s in enumerate(step.states)]
    return np.array(widths, dtype=float)


def _response(step: Step, trajectory: Trajectory, begin: float, span: np.ndarray) -> Response:
    error, wanted, times = trajectory.error[span], trajectory.trial.settled, trajectory.truth.t
    dt = float(np.diff(times).mean()) if step.clock.varying else step.dt
    if wanted:
        settled = settling(error[:, [s.name for s in step.states].index(wanted.state)], wanted, dt)
    else:
        share = (np.abs(error) / ranges(step, trajectory)).max(axis=1)
        settled = _past(~(share <= SHARE), dt)
    if "theta" not in trajectory.traces:
        return Response(begin, settled, None, None, None, None)
    theta = trajectory.traces["theta"][span]
    late = theta[-max(1, len(theta) // LATE) :]
    return Response(
        time=begin,
        settled=settled,
        peak=float(theta.max()),
        theta_settled=_past(theta >= KALMAN, dt),
        triggers=len(crossings(theta)),
        loud=float(np.mean(late > TRIGGERED)),
    )


def _past(holds: np.ndarray, dt: float) -> float | None:
    samples = np.flatnonzero(holds)
    first = int(samples[-1]) + 1 if len(samples) else 0
    return first * dt if first < len(holds) else None


def settling(error: np.ndarray, settled: Settled, dt: float) -> float | None:
    """Return the time (s) from the first sample until |error| (k,) remains in the band of `settled` for its time
    `hold`; None for never."""
    samples = round(settled.hold / dt) + 1
    inside = np.concatenate([[0], np.cumsum(np.abs(error) <= settled.band)])
    begins = np.flatnonzero(inside[samples:] - inside[:-samples] == samples)
    return float(begins[0] * dt) if len(begins) else None


def crossings(theta: np.ndarray) -> np.ndarray:
    """Return the numbers of the samples at which theta (N,) rises through 1.5."""
    above = theta > TRIGGERED
    return np.flatnonzero(above[1:] & ~above[:-1]) + 1


@dataclass(frozen=True)
class Summary:
    """The metrics of several seeds of one trial: medians and worst values; the worst is None if the event never
    happened in some seed."""

    trial: Annotated[str, "name of the trial"]
    criterion: Annotated[str, "what settled means"]
    seeds: Annotated[int, "number of seeds"]
    engine: Annotated[str, "who ran the step: c or python"]
    times: Annotated[tuple[float, ...], "times of the events"]
    settled: Annotated[tuple[float | None, ...], "median time to settle after each event; null: never"]
    worst: Annotated[tuple[float | None, ...], "largest time to settle after each event; null: never in some seed"]
    peak: Annotated[tuple[tuple[float, float] | None, ...], "smallest and largest peak of theta"]
    theta_settled: Annotated[tuple[float | None, ...], "median time until theta is under 1.05 for good"]
    triggered: Annotated[tuple[float | None, ...], "share of seeds in which theta rose through 1.5"]
    loud: Annotated[tuple[float | None, ...], "mean share of the last fifth before the next event with theta above 1.5"]
    latched: Annotated[int, "seeds in which theta did not come back after some event"]
    alarm_ratio: Annotated[float | None, "innovation at the largest theta over its threshold"]
    rms: Annotated[Mapping[str, float], "median steady error by state"]
    clamped: Annotated[int, "samples after the first 5% outside the declared or the outer box"]


def summary(trial: Trial, each: Sequence[Metrics], alarm_ratio: float | None = None, unit: str = "s") -> Summary:
    """Return the metrics of one trial over its seeds, at least one, as a `Summary`; `alarm_ratio`: as the function of
    this name returns it; `unit`: the unit of the plant's time."""
    events = list(zip(*(m.responses for m in each), strict=True))
    settled: list[list[Any]] = [[r.settled for r in event] for event in events]
    peaks, triggers, louds = (
        [[value for r in event if (value := getattr(r, name)) is not None] for event in events]
        for name in ("peak", "triggers", "loud")
    )
    return Summary(
        trial=trial.name,
        criterion=criterion(trial, unit),
        seeds=len(each),
        engine=each[0].engine,
        times=tuple(event[0].time for event in events),
        settled=tuple(map(median, settled)),
        worst=tuple(None if None in times else max(times) for times in settled),
        peak=tuple((min(p), max(p)) if p else None for p in peaks),
        theta_settled=tuple(median(r.theta_settled for r in event) for event in events),
        triggered=tuple(float(np.mean([n > 0 for n in count])) if count else None for count in triggers),
        loud=tuple(float(np.mean(shares)) if shares else None for shares in louds),
        latched=sum(any((r.loud or 0) > LATCHED for r in m.responses) for m in each),
        alarm_ratio=alarm_ratio,
        rms={name: float(np.median([m.rms[name] for m in each])) for name in each[0].rms},
        clamped=sum(m.clamped for m in each),
    )


def median(values: Iterable[float | None]) -> float | None:
    """Return the median of times, where None counts as infinitely late."""
    middle = float(np.median([math.inf if value is None else value for value in values]))
    return middle if math.isfinite(middle) else None


def alarm_ratio(step: CallableStep, trial: Trial, engine: Engine, seeds: Sequence[int]) -> float | None:
    """Return the alarm ratio of an adaptive theta, which says whether an alarm can sustain itself:

        ratio = (mean of I_d with theta fixed at 2 theta_1, without a fault) / gamma_0

    At 2 theta_1 the estimate is noisy, and so is the prediction in the innovation. If noise alone keeps I_d above
    gamma_0, an alarm never ends. Up to a ratio of 1 theta recovers, from about 5 on it does not; between, the noise
    decides. (For a logistic mu, the centre replaces gamma_0.)

    The result is the median over at most three of the seeds, from the second half of the trial without its jumps; None
    for a theta without innovation. The state of the step does not change. Raises: `BadTrial`.
    """
    nominal = {gain.name: gain.initial for gain in step.layout.gains}
    threshold = nominal.get("gamma_0", nominal.get("centre"))
    if threshold is None:
        return None
    plant, nominal_trial = step.observer.form.system, replace(trial, jumps=(), steady=None)
    truth = simulate(plant, nominal_trial, step.dt)
    pinned = replace(step)  # has another memory
    pinned.tune(rate=0)  # theta never decays
    start = _at_the_peak(pinned, nominal_trial)
    means = []
    for seed in seeds[:ALARM_SEEDS]:
        pinned.restore(start)
        y = pinned.arriving(noisy(plant, truth, nominal_trial, [seed])[0])
        innovation = pinned.run(truth.u, y, engine).traces["innovation"]
        means.append(np.mean(innovation[len(innovation) // 2 :]))
    return float(np.median(means)) / float(threshold[0])


def alarm_complaints(each: Iterable[Summary]) -> Iterator[str]:
    """Yield a sentence for every trial in which an adaptive theta does not return to 1 after an alarm."""
    for one in each:
        if one.latched and one.alarm_ratio is not None:
            fed = one.alarm_ratio > ITSELF
            advice = "; lower theta_1 or Q, or raise gamma_0" if fed else ", so it needs more time between the events"
            yield (
                f"trial {one.trial!r}: theta does not come back in {one.latched} of {one.seeds} seeds: "
                f"alarm ratio {one.alarm_ratio:.2g}{advice}"
            )


def _at_the_peak(step: CallableStep, trial: Trial) -> bytes:
    """Return the step's memory at the start of a trial, but with
    the true state as the estimate and theta at its peak."""
    form = step.observer.form
    values: dict[Any, Any] = {s: trial.start[s.name] for s in form.system.states} | form.system.nominal
    values |= {u: resting(u) for u in form.system.inputs}
    state = np.frombuffer(layout.fresh(step, step.real), layout.state_type(step, step.real)).copy()
    state["z"] = z = [float(expression.subs(values)) for expression in form.to_form]
    state["theta"] = max(field.high[0] for field in step.layout.state if field.name == "theta")
    if any(group.name == "predictor" for group in step.layout.groups):
        state["predictor"]["z"] = z
    return sealed(step, step.real, state.tobytes())


_LISTED = 3  # most times in a sentence
_ROUNDING = 1e-9  # of a range, by which a truth at its end may be outside
Array = np.ndarray


@dataclass(frozen=True)
class Interventions:
    """The times at which guards changed an estimate (restarts, projections onto the ranges), and the samples beyond
    innovation gates, in `runs` runs."""

    restarts: Annotated[tuple[float, ...], "times of restarts from the sample"] = ()
    projections: Annotated[tuple[float, ...], "times of projections onto the ranges"] = ()
    runs: Annotated[int, "number of runs"] = 1
    gates: Annotated[tuple[GateShare, ...], "the samples beyond innovation gates"] = ()

    def __bool__(self) -> bool:
        return bool(self.restarts or self.projections)

    def __add__(self, other: "Interventions") -> "Interventions":
        restarts, projections = self.restarts + other.restarts, self.projections + other.projections
        pairs = zip(self.gates, other.gates, strict=True) if self.gates else ()
        gates = tuple(one + another for one, another in pairs) or other.gates
        return Interventions(restarts, projections, self.runs + other.runs, gates)

    @property
    def excessive(self) -> tuple[str, ...]:
        """A sentence for each gate with far more samples beyond it than its probability says."""
        return tuple(share.sentence for share in self.gates if share.excessive)

    def sentence(self, unit: str) -> str:
        """Return a clause such as "2 restarts from the sample (t = 1.2, 3 s), 1 projection onto the ranges (t = .4
        s)"."""
        named = (("restart", "from the sample", self.restarts), ("projection", "onto the ranges", self.projections))
        parts = []
        for action, where, times in named:
            if times:
                listed = ", ".join(f"{t:.4g}" for t in sorted(times)[:_LISTED]) + ", .." * (len(times) > _LISTED)
                parts.append(f"{len(times)} {action}{'s' * (len(times) != 1)} {where} (t = {listed} {unit})")
        return ", ".join(parts) + f" in {self.runs} runs" * (self.runs > 1)


def interventions(step: Step, status: np.ndarray, t: np.ndarray) -> Interventions:
    """Return the restarts and projections of an estimate that the status (N,) reports at the times t (N,), and the
    samples beyond gates."""
    names = {bit.name: k for k, bit in enumerate(step.layout.bits)}

    def raised(name: str) -> tuple[float, ...]:
        return tuple(t[((status >> names[name]) & 1) != 0].tolist()) if name in names else ()

    restarts, projections = raised("RESTARTED_FROM_SAMPLE"), raised("PROJECTED_ONTO_RANGES")
    return Interventions(restarts, projections, gates=gate_shares(step, status))


def guard_notes(trial: str, observer: str, each: Interventions, disturbed: bool, unit: str) -> Iterator[str]:
    """Yield a sentence for a trial with restarts or projections of the estimate (a warning unless the trial is
    `disturbed`), and one for each gate that rejects too many samples. `trial`, `observer`: names; `unit`: the unit of
    time."""
    yield from (f"trial {trial}, {observer}: {sentence}" for sentence in each.excessive)
    if each and disturbed:
        yield f"trial {trial}, {observer}: {each.sentence(unit)}"
    elif each:
        yield (
            f"warning: nothing disturbs trial {trial}, yet {observer} has {each.sentence(unit)}; widen the ranges, or "
            "check model and gains"
        )


@dataclass(frozen=True)
class Leaving:
    """A state or an input of the plant that leaves its declared range along a trial."""

    signal: Annotated[str, "the state or input"]
    low: Annotated[float, "lower end of its range"]
    high: Annotated[float, "upper end of its range"]
    time: Annotated[float, "when it leaves first"]
    value: Annotated[float, "its value there"]
    farthest: Annotated[float, "its value farthest from the range"]

    def sentence(self, unit: str) -> str:
        """Return a sentence such as "q leaves its range -4..4 at t = 1.2 s, where it is 4.01, and gets as far as 9"."""
        return (
            f"{self.signal} leaves its range {self.low:g}..{self.high:g} at t = {self.time:.6g} {unit}, where it is "
            f"{self.value:.6g}, and gets as far as {self.farthest:.6g}"
        )


def leaving_signals(system: System, trajectory: Trajectory) -> tuple[Leaving, ...]:
    """Return the states and inputs of the declared plant that leave their ranges along the true trajectory."""
    plant, truth = system.declared, trajectory.truth
    signals, values = (*plant.states, *plant.inputs), np.hstack([truth.x, truth.u])
    leaving = []
    for signal, along in zip(signals, values.T, strict=True):
        low, high = signal.limits
        beyond = np.maximum(low - along, along - high)
        first = int(np.argmax(beyond > _ROUNDING * (high - low)))
        if signal.bounded and beyond[first] > _ROUNDING * (high - low):
            numbers = (truth.t[first], along[first], along[np.argmax(beyond)])
            leaving.append(Leaving(signal.name, low, high, *map(float, numbers)))
    return tuple(leaving)


def leaving_notes(trial: str, each: Iterable[Leaving], unit: str) -> Iterator[str]:
    """Yield a sentence for a trial in which signals leave their ranges; `trial`: its name."""
    sentences = "; ".join(one.sentence(unit) for one in each)
    if sentences:
        yield (
            f"trial {trial}, the plant itself: {sentences}. The proofs hold on the ranges alone, at whose edge an "
            "observer evaluates the model: declare wider ones, or change the trial"
        )


def before_loss(run: Run) -> int:
    """Return the number of samples before the first estimate that is infinite or NaN."""
    finite = np.isfinite(run.x).all(axis=1)
    return len(finite) if finite.all() else int(np.argmin(finite))


def loss(step: Step, run: Run, t: Array, u: Array, y: Array) -> Iterator[str]:
    """Yield a sentence if a run lost its estimate (infinite or NaN): the time, the cause and the remedy; over inputs u
    (N, m) and samples y (N, p) at times t (N,)."""
    first = before_loss(run)
    if first == len(t):
        return
    signals = np.array([s.name for s in (*step.inputs, *step.outputs)])
    absent = ~np.isfinite(np.hstack([u, y]))[: first + 1]
    rows = np.flatnonzero(absent.any(axis=1))
    since = f"from {t[first]:.6g} {step.time} on the estimate is no number, and no error counts"
    if step.clock.guarded or not len(rows):
        fix = "lower" if step.clock.guarded else "run it with --guards all, or lower"
        yield f"{since}: it grew beyond every number; {fix} the gains, or take a shorter --dt"
        return
    names = signals[absent[rows[-1]]]
    absent_at = f"{', '.join(names)} {'has' if len(names) == 1 else 'have'} no number at {t[rows[-1]]:.6g} {step.time}"
    fix = "run it with --guards all, or fill in what the log lacks"
    yield f"{absent_at}, which a step without guards cannot leave out: {since}; {fix}"
