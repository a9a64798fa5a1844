"""Observers of one model side by side: the same truth, the same noise, the same sampling period.

    convergence    time to settle after the start and after each jump, the median of the seeds: by the trial's own band,
                   else until every error stays within `SHARE` of its state's range
    steady error   its root mean square over the trial's steady part, the median of the seeds
    peaking        the largest error of each state over its range, of all seeds
    cost           operations of one call, bytes of the state

A state's range is the declared one, else that of the truth along the trial.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from hgogen.call import CallableStep, Engine
from hgogen.cost import Cost, cost
from hgogen.metrics import median, metrics
from hgogen.signal import Signal
from hgogen.trial import Trajectory, Trial, try_out

SHARE = 0.05


@dataclass(frozen=True, eq=False)
class Measured:
    """An observer on a trial; `name`: its tuning; `settled` (s) after each event, None: never; `rms`, `peak`: by state;
    `clamped`: samples outside the box after the first 5%; `first`: its trajectory of the first seed."""

    name: str
    observer: str
    method: str
    states: tuple[Signal, ...]
    settled: tuple[float | None, ...]
    rms: Mapping[str, float]
    peak: Mapping[str, float]
    clamped: int
    cost: Cost
    first: Trajectory

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        told = {key: value for key, value in vars(self).items() if key not in ("states", "first", "cost")}
        return {**told, "settled": list(self.settled), **asdict(self.cost)}


def criterion(trial: Trial) -> str:
    """What settled means, in words."""
    if trial.settled is None:
        return f"every error within {100 * SHARE:g}% of its state's range until the next event"
    return f"|error of {trial.settled.state}| <= {trial.settled.band:g} for {trial.settled.hold:g} s"


def measured(
    name: str, step: CallableStep, trial: Trial, engine: Engine, seeds: Sequence[int], tick: Callable[[], None]
) -> Measured:
    """The step of tuning `name` over the trial's seeds; `tick` is called after each."""
    each = []
    for trajectory in try_out(step, trial, engine, seeds):
        each.append(trajectory)
        tick()
    told = [metrics(step, one) for one in each]
    names, width = [s.name for s in step.states], _ranges(step, each[0])
    own = [[response.settled for response in one.responses] for one in told]
    settled = own if trial.settled else [_settled(one, width) for one in each]
    peak = np.max([np.abs(one.error).max(axis=0) for one in each], axis=0) / width
    return Measured(
        name=name,
        observer=step.observer.name,
        method=step.rule,
        states=step.states,
        settled=tuple(median(event) for event in zip(*settled, strict=True)),
        rms={state: float(np.median([m.rms[state] for m in told])) for state in names},
        peak=dict(zip(names, map(float, peak), strict=True)),
        clamped=sum(m.clamped for m in told),
        cost=cost(step),
        first=each[0],
    )


def _ranges(step: CallableStep, trajectory: Trajectory) -> np.ndarray:
    """The width (n) of each state's range."""
    seen = np.ptp(trajectory.truth.x, axis=0)
    widths = [s.interval[1] - s.interval[0] if s.bounded else seen[i] or 1.0 for i, s in enumerate(step.states)]
    return np.array(widths, dtype=float)


def _settled(trajectory: Trajectory, width: np.ndarray) -> list[float | None]:
    """Time (s) after each event until every error stays within `SHARE` of its range until the next one."""
    t, worst = trajectory.truth.t, (np.abs(trajectory.error) / width).max(axis=1)
    ends = (*trajectory.trial.events, np.inf)
    spans = [(t >= begin - 1e-9) & (t < end - 1e-9) for begin, end in pairwise(ends)]
    return [_last(worst[span], float(t[1])) for span in spans]


def _last(worst: np.ndarray, dt: float) -> float | None:
    """Time (s) of the sample after the last outside; None where that is the end."""
    outside = np.flatnonzero(~(worst <= SHARE))
    first = int(outside[-1]) + 1 if len(outside) else 0
    return first * dt if first < len(worst) else None
