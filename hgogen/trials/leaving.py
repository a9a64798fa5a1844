"""Whether a trial's own plant leaves the ranges that it declares, for which no observer is made."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from hgogen.system import System
from hgogen.trial import Trajectory

_ROUNDING = 1e-9  # of a range, by which a truth that runs along its end may be beyond it


@dataclass(frozen=True)
class Left:
    """A state or an input of the plant that leaves [low, high]: first at `time`, where it is `value`; `farthest`: its
    value farthest from the range."""

    signal: str
    low: float
    high: float
    time: float
    value: float
    farthest: float

    def sentence(self, unit: str) -> str:
        """A sentence such as "q leaves its range -4..4 at t = 1.2 s, where it is 4.01, and gets as far as 9"."""
        return (
            f"{self.signal} leaves its range {self.low:g}..{self.high:g} at t = {self.time:.6g} {unit}, where it is "
            f"{self.value:.6g}, and gets as far as {self.farthest:.6g}"
        )


def left(system: System, trajectory: Trajectory) -> tuple[Left, ...]:
    """The states and inputs of the plant as first declared that leave their ranges along the truth."""
    plant, truth = system.declared, trajectory.truth
    signals, values = (*plant.states, *plant.inputs), np.hstack([truth.x, truth.u])
    leaving = []
    for signal, along in zip(signals, values.T, strict=True):
        low, high = signal.interval
        beyond = np.maximum(low - along, along - high)
        first = int(np.argmax(beyond > _ROUNDING * (high - low)))
        if signal.bounded and beyond[first] > _ROUNDING * (high - low):
            numbers = (truth.t[first], along[first], along[np.argmax(beyond)])
            leaving.append(Left(signal.name, low, high, *map(float, numbers)))
    return tuple(leaving)


def notes(trial: str, each: Iterable[Left], unit: str) -> Iterator[str]:
    """A sentence for a trial in which something leaves its range."""
    sentences = "; ".join(one.sentence(unit) for one in each)
    if sentences:
        yield (
            f"trial {trial}, the plant itself: {sentences}. The proofs hold on the ranges alone, at whose edge an "
            "observer evaluates the model: declare wider ones, or change the trial"
        )
