"""The worst that a trial shows of an error, beside the bound that is proved of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hgogen.certificates.error_bound import ErrorBound
from hgogen.signal import Signal
from hgogen.trial import Trajectory


@dataclass(frozen=True)
class Seen:
    """Of a state: the `bound` of its error, and the `worst` from `after` (the model's unit of time) on after each event
    of a trial, None where it ends before."""

    state: str
    unit: str
    bound: float
    after: float
    worst: float | None


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
