"""Many runs of a step at once: what `trial.tried` gives of each, byte for byte, by `CallableStep.run_many`."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hgogen.call import CallableStep
from hgogen.trial import Trajectory, Trial, Truth, records

WORTH = 5_000_000  # samples of a step from which on it takes less time than to compile what takes them together
HELD = 1 << 20  # numbers of measurements of runs that differ by more than their seeds


@dataclass(frozen=True, eq=False)
class Ahead:
    """A run before it is taken: its trial, seed and truth, the inputs u (N, m), and what is measured, y (N, p)."""

    trial: Trial
    seed: int
    truth: Truth
    u: np.ndarray
    y: np.ndarray


def ahead(step: CallableStep, trial: Trial, truth: Truth, seeds: Sequence[int]) -> Iterator[list[Ahead]]:
    """The runs of seeds, as many as are made at once."""
    for some, u, measured in records(step, trial, truth, seeds):
        yield [Ahead(trial, seed, truth, u, y) for seed, y in zip(some, measured, strict=True)]


def together(step: CallableStep, start: bytes, runs: Sequence[Ahead]) -> Iterator[Trajectory]:
    """The compiled step over runs with the same inputs, from the memory `start`."""
    step.restore(start)
    y = np.stack([step.arriving(one.y) for one in runs])
    many = step.run_many(runs[0].u, y, jobs=1, traces=True, engine="c")
    for k, one in enumerate(runs):
        x, status = (np.ascontiguousarray(array[k]) for array in (many.x, many.status))
        traces = {name: np.ascontiguousarray(values[k]) for name, values in many.traces.items()}
        yield Trajectory(one.trial, one.seed, one.truth, one.y, x, traces, status, "c")
