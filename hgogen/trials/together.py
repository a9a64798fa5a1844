"""A trial over many seeds at once: what `trial.tried` gives, byte for byte, by `CallableStep.run_many`."""

from collections.abc import Iterator, Sequence

import numpy as np

from hgogen.call import CallableStep
from hgogen.trial import Trajectory, Trial, Truth, records

WORTH = 5_000_000  # samples of a step from which on it takes less time than to compile what takes them together


def tried_together(
    step: CallableStep, trial: Trial, truth: Truth, start: bytes, seeds: Sequence[int]
) -> Iterator[Trajectory]:
    """The compiled step over a truth of its plant, from the memory `start`, one trajectory for each seed."""
    step.restore(start)
    for some, u, measured in records(step, trial, truth, seeds):
        every = list(measured)
        many = step.run_many(u, np.stack([step.arriving(y) for y in every]), jobs=1, traces=True, engine="c")
        for k, (seed, y) in enumerate(zip(some, every, strict=True)):
            x, status = (np.ascontiguousarray(array[k]) for array in (many.x, many.status))
            traces = {name: np.ascontiguousarray(values[k]) for name, values in many.traces.items()}
            yield Trajectory(trial, seed, truth, y, x, traces, status, "c")
