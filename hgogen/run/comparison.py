"""Observers of one model side by side: the same truth, noise and sampling period, and the same first estimate.

    convergence    time to settle after the start and after each jump, the median of the seeds (`metrics.criterion`)
    steady error   its root mean square over the trial's steady part, the median of the seeds
    peaking        the largest rise of the error of each state after an event, over its range, of all seeds: max |e(t)|
                   until the next event less the |e| at the event itself, which is the start's or the jump's doing
    cost           operations of one call, bytes of the state
    proved         the bound of each state's error, where a model says how large noise and the like are at most, and the
                   worst that all seeds show of it from when on it holds (`seen`)

The range of a state: `metrics.ranges`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from hgogen.call import CallableStep
from hgogen.certificates.error_bound import ErrorBound
from hgogen.emit.cost import Cost, cost
from hgogen.run.incidents import Interventions, interventions
from hgogen.run.metrics import median, metrics, ranges
from hgogen.run.samples import Engine
from hgogen.sentence import Encoded
from hgogen.signal import Signal
from hgogen.trial import Trajectory, Trial, try_out


@dataclass(frozen=True, eq=False)
class Measured(Encoded):
    """What an observer does on a trial; `first`: the trajectory of the first seed."""

    json_keys = "name observer method settled rms peak clamped acted proved worst unproved *cost"

    name: Annotated[str, "name of its tuning"]
    observer: Annotated[str, "name of the observer"]
    method: Annotated[str, "method of its step"]
    states: tuple[Signal, ...]
    settled: Annotated[tuple[float | None, ...], "median time to settle after each event; null: never"]
    rms: Annotated[Mapping[str, float], "steady error by state, the median of the seeds"]
    peak: Annotated[Mapping[str, float], "largest rise of the error after an event, over the state's range"]
    clamped: Annotated[int, "samples outside the box after the first 5%"]
    cost: Cost
    first: Trajectory
    acted: Annotated[Interventions, "when guards acted on the estimate, over all seeds"]
    proved: Annotated[Mapping[str, float], "the bound by state that has one"] = field(default_factory=dict)
    worst: Annotated[
        Mapping[str, float | None],
        "by state, the largest error of all seeds from when on the bound holds; null where the trial ends before",
    ] = field(default_factory=dict)
    unproved: Annotated[str, "what is not known of the bounds, and why"] = ""


def measured(
    name: str,
    step: CallableStep,
    trial: Trial,
    engine: Engine,
    seeds: Sequence[int],
    tick: Callable[[], None],
    known: ErrorBound | None = None,
) -> Measured:
    """The step of tuning `name` over the trial's seeds; `tick` is called after each. `known`: what is proved of it."""
    each = []
    for trajectory in try_out(step, trial, engine, seeds):
        each.append(trajectory)
        tick()
    per_seed = [metrics(step, one) for one in each]
    names, events = [s.name for s in step.states], zip(*(one.responses for one in per_seed), strict=True)
    peak = np.max([rises(one) for one in each], axis=0) / ranges(step, each[0])
    return Measured(
        name=name,
        observer=step.observer.name,
        method=step.code.rule,
        states=step.states,
        settled=tuple(median(response.settled for response in event) for event in events),
        rms={state: float(np.median([m.rms[state] for m in per_seed])) for state in names},
        peak=dict(zip(names, map(float, peak), strict=True)),
        clamped=sum(m.clamped for m in per_seed),
        cost=cost(step),
        first=each[0],
        acted=sum((interventions(step, one.status, one.truth.t) for one in each), Interventions(runs=0)),
        proved=known.bounds if known else {},
        worst=largest(step.states, each, known) if known else {},
        unproved=str(known.missing) if known else "",
    )


def rises(trajectory: Trajectory) -> np.ndarray:
    """How far the |error| of each state (n) rises above what it is at an event, the largest over the events."""
    error, t = np.abs(trajectory.error), trajectory.truth.t
    begins = [k for k in np.searchsorted(t, np.array(trajectory.trial.events) - 1e-9) if k < len(t)]
    largest: np.ndarray = (np.maximum.reduceat(error, begins) - error[begins]).max(axis=0)
    return largest


@dataclass(frozen=True)
class Seen:
    """The error of a state in a trial beside its bound."""

    state: Annotated[str, "the state"]
    unit: Annotated[str, "its unit"]
    bound: Annotated[float, "what is proved of its error"]
    after: Annotated[float, "how long after an event the bound holds"]
    worst: Annotated[float | None, "largest error from then on; null where the trial ends before"]


def seen(states: Sequence[Signal], trajectory: Trajectory, known: ErrorBound) -> tuple[Seen, ...]:
    """Of each state that has a bound; none where it is not known from when on they hold."""
    if known.settles is None:
        return ()
    t, events = trajectory.truth.t, np.asarray(trajectory.trial.events)
    last = events[np.searchsorted(events, t, side="right") - 1]
    holds = t - last >= known.settles
    rows = []
    for k, state in enumerate(states):
        if state.name in known.bounds:
            worst = float(np.abs(trajectory.error[holds, k]).max()) if holds.any() else None
            rows.append(Seen(state.name, state.unit, known.bounds[state.name], known.settles, worst))
    return tuple(rows)


def largest(states: Sequence[Signal], each: Sequence[Trajectory], known: ErrorBound) -> Mapping[str, float | None]:
    """The worst of all trajectories by the name of each state that has a bound; None where none of them tells."""
    rows = [one for trajectory in each for one in seen(states, trajectory, known) if one.worst is not None]
    return {name: max((one.worst or 0.0 for one in rows if one.state == name), default=None) for name in known.bounds}
