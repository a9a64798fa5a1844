"""Records as steps read them: a sample that a sensor cannot give is as good as missing, to filter and judge alike."""

import numpy as np

from hgogen import forms
from hgogen.identification.records import Log, demanded
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
    return demanded(plant, Log(there.u, y, there.dt), number)
