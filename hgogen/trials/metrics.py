"""What a trial measures: time to settle after each event, steady errors, how theta behaved, whether a clamp
was active.

The events of a trial are its start (the initial state is wrong) and its jumps. An event lasts until the
next one. A trial without a band of its own is settled when every error stays within `SHARE` of its state's range, the
declared one, else that of the truth along the trial.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hgogen.step import Step
from hgogen.trial import Settled, Trajectory, Trial

SHARE = 0.05  # of a state's range
TRIGGERED = 1.5  # theta above this: the adaptation has been triggered
CALM = 1.05  # theta under this: Kalman mode again
LATE = 5  # the last fifth of the time between two events is late
LATCHED = 0.5  # theta above 1.5 in more than this share of the late time: it does not come back
WARM_UP = 0.05  # the first part of a trial, in which the estimate may be anywhere


@dataclass(frozen=True)
class Response:
    """What followed the event at `time` (s), None where it did not happen or does not apply.

    `settled`: time to settle (s); `peak`: the largest theta; `calm`: time until theta is under 1.05 for
    good (s); `triggers`: how often theta rose through 1.5; `loud`: share of the last fifth of the time before
    the next event with theta above 1.5.
    """

    time: float
    settled: float | None
    peak: float | None
    calm: float | None
    triggers: int | None
    loud: float | None


@dataclass(frozen=True)
class Metrics:
    """One trajectory in numbers.

    `responses`: one for each event; `rms`: steady error by state; `clamped`: samples after the first 5% of
    the trial with the estimate outside its declared or its outer box.
    """

    seed: int
    engine: str
    responses: tuple[Response, ...]
    rms: Mapping[str, float]
    clamped: int


def metrics(step: Step, trajectory: Trajectory) -> Metrics:
    """The trajectory in numbers; `step` is the one that made it."""
    trial, t = trajectory.trial, trajectory.truth.t
    ends = (*trial.events[1:], math.inf)
    responses = []
    for begin, end in zip(trial.events, ends, strict=True):
        span = (t >= begin - 1e-9) & (t < end - 1e-9)
        responses.append(_response(step, trajectory, begin, span))
    steady = trajectory.error[t >= trial.steady_from - 1e-9]
    rms = np.sqrt(np.mean(steady**2, axis=0))
    if step.clock.guarded:
        bits = sum(1 << k for k, bit in enumerate(step.layout.bits) if bit.name in ("OUTSIDE_BOX", "STATE_LIMITED"))
        outside = trajectory.status & trajectory.status.dtype.type(bits) != 0
    else:  # the status says nothing
        low, high = np.array([s.interval for s in step.states]).T
        outside = ~((trajectory.x >= low) & (trajectory.x <= high)).all(axis=1)
    late = t > WARM_UP * trial.duration
    return Metrics(
        seed=trajectory.seed,
        engine=trajectory.engine,
        responses=tuple(responses),
        rms={s.name: float(value) for s, value in zip(step.states, rms, strict=True)},
        clamped=int(np.count_nonzero(outside[late])),
    )


def criterion(trial: Trial, unit: str = "s") -> str:
    """What settled means, in words; `unit`: that of the plant's time."""
    if trial.settled is None:
        return f"every error within {100 * SHARE:g}% of its state's range until the next event"
    return f"|error of {trial.settled.state}| <= {trial.settled.band:g} for {trial.settled.hold:g} {unit}"


def ranges(step: Step, trajectory: Trajectory) -> np.ndarray:
    """The width (n) of each state's range."""
    seen = np.ptp(trajectory.truth.x, axis=0)
    widths = [s.interval[1] - s.interval[0] if s.bounded else seen[i] or 1.0 for i, s in enumerate(step.states)]
    return np.array(widths, dtype=float)


def _response(step: Step, trajectory: Trajectory, begin: float, span: np.ndarray) -> Response:
    """What followed an event, in the span that begins there, a mask (N,)."""
    error, wanted = trajectory.error[span], trajectory.trial.settled
    if wanted:
        settled = settling(error[:, [s.name for s in step.states].index(wanted.state)], wanted, step.dt)
    else:
        share = (np.abs(error) / ranges(step, trajectory)).max(axis=1)
        settled = _past(~(share <= SHARE), step.dt)
    if "theta" not in trajectory.traces:
        return Response(begin, settled, None, None, None, None)
    theta = trajectory.traces["theta"][span]
    late = theta[-max(1, len(theta) // LATE) :]
    return Response(
        time=begin,
        settled=settled,
        peak=float(theta.max()),
        calm=_past(theta >= CALM, step.dt),
        triggers=len(crossings(theta)),
        loud=float(np.mean(late > TRIGGERED)),
    )


def _past(holds: np.ndarray, dt: float) -> float | None:
    """Time (s) from the first sample until what holds, a mask (k,), does so no more; None where it does at the end."""
    samples = np.flatnonzero(holds)
    first = int(samples[-1]) + 1 if len(samples) else 0
    return first * dt if first < len(holds) else None


def settling(error: np.ndarray, settled: Settled, dt: float) -> float | None:
    """Time (s) from the first sample until |error| (k,) stays in the band for `hold`; None where it never
    does."""
    samples = round(settled.hold / dt) + 1
    inside = np.concatenate([[0], np.cumsum(np.abs(error) <= settled.band)])
    held = np.flatnonzero(inside[samples:] - inside[:-samples] == samples)
    return float(held[0] * dt) if len(held) else None


def crossings(theta: np.ndarray) -> np.ndarray:
    """The samples at which theta has just risen through 1.5."""
    above = theta > TRIGGERED
    return np.flatnonzero(above[1:] & ~above[:-1]) + 1


@dataclass(frozen=True)
class Summary:
    """Several seeds of one trial; of a quantity that some seed lacks, the worst is None (it never happened).

    `settled`, `worst`: median and largest time to settle after each event; `peak`: (smallest, largest) peak
    of theta; `calm`: median; `triggered`: share of seeds in which theta rose through 1.5; `loud`: mean;
    `latched`: seeds in which theta did not come back after some event; `alarm_ratio`: see `commands.alarm`;
    `rms`: median by state; `criterion`: what settled means.
    """

    trial: str
    criterion: str
    seeds: int
    engine: str
    times: tuple[float, ...]
    settled: tuple[float | None, ...]
    worst: tuple[float | None, ...]
    peak: tuple[tuple[float, float] | None, ...]
    calm: tuple[float | None, ...]
    triggered: tuple[float | None, ...]
    loud: tuple[float | None, ...]
    latched: int
    alarm_ratio: float | None
    rms: Mapping[str, float]
    clamped: int


def summary(trial: Trial, each: Sequence[Metrics], alarm_ratio: float | None = None, unit: str = "s") -> Summary:
    """The metrics of all seeds (at least one) in one; `unit`: that of the plant's time."""
    events = list(zip(*(m.responses for m in each), strict=True))
    settled = [[r.settled for r in event] for event in events]
    peaks = [_present(r.peak for r in event) for event in events]
    triggers = [_present(r.triggers for r in event) for event in events]
    louds = [_present(r.loud for r in event) for event in events]
    return Summary(
        trial=trial.name,
        criterion=criterion(trial, unit),
        seeds=len(each),
        engine=each[0].engine,
        times=tuple(event[0].time for event in events),
        settled=tuple(map(median, settled)),
        worst=tuple(None if None in times else max(_present(times)) for times in settled),
        peak=tuple((min(p), max(p)) if p else None for p in peaks),
        calm=tuple(median(r.calm for r in event) for event in events),
        triggered=tuple(float(np.mean([n > 0 for n in count])) if count else None for count in triggers),
        loud=tuple(float(np.mean(shares)) if shares else None for shares in louds),
        latched=sum(any((r.loud or 0) > LATCHED for r in m.responses) for m in each),
        alarm_ratio=alarm_ratio,
        rms={name: float(np.median([m.rms[name] for m in each])) for name in each[0].rms},
        clamped=sum(m.clamped for m in each),
    )


def _present(values: Iterable[Any]) -> list[Any]:
    return [value for value in values if value is not None]


def median(values: Iterable[float | None]) -> float | None:
    """The middle of times, where None counts as infinitely late."""
    middle = float(np.median([math.inf if value is None else value for value in values]))
    return middle if math.isfinite(middle) else None
