"""Records as steps read them: a sample that a sensor cannot give is as good as missing, to filter and judge alike."""

import numpy as np

from hgogen import forms
from hgogen.identification.records import LEAST, BadLog, Log, demanded
from hgogen.stepping.guards import readings
from hgogen.structure.dynamics import HUGE
from hgogen.system import System


def readable(plant: System, record: Log, number: int) -> Log:
    """A record without the samples that a step rejects: those more than the width of its range beyond an output's
    range, as `plausible` of the guards says. Raises: `BadLog`, `BadShape`."""
    ranges = np.array(readings(forms.original(plant)))
    width = np.diff(ranges, axis=1).T
    low, high = np.maximum(ranges[:, 0] - width, -HUGE), np.minimum(ranges[:, 1] + width, HUGE)
    there = demanded(plant, record, number)
    y = np.where((there.y >= low) & (there.y <= high), there.y, np.nan)
    for signal, ends, read, column in zip(plant.outputs, ranges, y.T, there.y.T, strict=True):
        if np.isfinite(read).sum() < LEAST:
            values, name = column[np.isfinite(column)], signal.name
            lost, (least, most) = len(values) - int(np.isfinite(read).sum()), np.quantile(values, (0.05, 0.95))
            raise BadLog(
                f"record {number}",
                f"has {len(values)} samples of {name}, of which {lost} would be rejected: they lie about "
                f"{least:.4g}..{most:.4g}, and the model reads {ends[0]:g}..{ends[1]:g}; check column, unit and sign, "
                f"or widen the range of {name}",
            )
    return Log(there.u, y, there.dt)
