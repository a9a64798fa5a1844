"""What a step is given in a trial without its jumps: the record on which its cost is counted."""

from dataclasses import replace

import numpy as np

from hgogen.call import CallableStep
from hgogen.calling.late import at_their_times
from hgogen.trial import Trial, noisy, sampled, simulate


def rows_given(step: CallableStep, trial: Trial, count: int = 300) -> np.ndarray:
    """The first samples (count, m + p): inputs, then the columns of the step's `samples`, of the trial's first seed. A
    trial that is shorter gives fewer.

    Raises: `BadTrial`.
    """
    calm = replace(trial, jumps=(), steady=None, settled=None, duration=min(trial.duration, count * step.dt))
    system = step.observer.form.system
    truth = simulate(system.declared, calm, step.dt)
    (y,) = noisy(system.declared, truth, calm, calm.seeds[:1])
    rows: np.ndarray = np.hstack([sampled(system, calm, truth.t), step.arriving(at_their_times(step, y))])
    return rows[:count]
