"""Records of samples that come late: from the order of time to that of arrival and back, and what a step remembered.

In the order of time a row holds the samples that were taken then, y (N, p). In that of arrival it holds what a call is
given: the sample of each output that came then, and the ages of those that may be late (N, p + ages).
"""

import numpy as np

from hgogen.program import lines_of
from hgogen.step import Step
from hgogen.stepping.delays import AT, MEMORY

Array = np.ndarray


def arriving(step: Step, y: Array) -> Array:
    """Samples y (N, p) in the order of time as they come where each is as late as it may be; of a step without delays
    as they are."""
    if not step.ages:
        return y
    came = [y[:, j] for j in range(len(step.outputs))]
    for output, age in zip(step.late, step.ages, strict=True):
        j, most = step.outputs.index(output), int(age.interval[1])
        came[j] = np.concatenate([np.full(min(most, len(y)), np.nan), y[: max(0, len(y) - most), j]])
        came.append(np.full(len(y), float(most)))
    return np.column_stack(came)


def at_their_times(step: Step, y: Array) -> Array:
    """y (N, p) with NaN between the samples of a slower sensor."""
    every = [round(period / step.dt) for period in step.clock.periods]
    return np.where(np.arange(len(y))[:, None] % every == 0, y, np.nan)


def in_time(step: Step, samples: Array) -> Array:
    """Samples (N, p + ages) in the order of arrival by the rows in which they were taken, (N, p), NaN where none came
    in time; of one row the first."""
    y = samples[:, : len(step.outputs)].copy()
    for column, (output, age) in enumerate(zip(step.late, step.ages, strict=True), len(step.outputs)):
        j, ages = step.outputs.index(output), samples[:, column]
        taken = np.full(len(y), np.nan)
        there = np.isfinite(y[:, j]) & (ages >= 0) & (ages <= age.interval[1]) & (ages == np.floor(ages))
        for row in np.flatnonzero(there):
            then = row - int(ages[row])
            if then >= 0 and np.isnan(taken[then]):
                taken[then] = y[row, j]
        y[:, j] = taken
    return y


def remembered(step: Step, records: Array, j: int) -> Array:
    """Records (N) with the memory of the period in which the sample of output j was taken that they hold, as its
    prediction left it; of a step without delays as they are."""
    if not step.ages:
        return records
    state, output, rows = records["state"], step.outputs[j], np.arange(len(records))
    ages = {late: records["output"][age.name] for late, age in zip(step.late, step.ages, strict=True)}
    ring = state[MEMORY]
    age = np.nan_to_num(ages.get(output, np.zeros(len(records))), nan=0.0, posinf=0.0, neginf=0.0)
    then = (state[AT.name].astype(int) - np.clip(age, 0, ring.shape[1] - 1).astype(int)) % ring.shape[1]
    back = records.copy()
    plain = step.plain.layout.groups if step.plain else ()
    groups = {f"{MEMORY}_{line[0].name}": line[0].name for line in lines_of(plain)}
    for name in ring.dtype.names or ():
        back["state"][groups.get(name, name)] = ring[name][rows, then]
    return back
