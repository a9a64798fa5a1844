"""How far a run in float, as small firmware makes it, is from the same run in double.

difference = max over samples of |x_float - x_double|, over the width of the state's range, else over its peak

Samples at which one of them is no number do not count.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hgogen.calling.samples import Run
from hgogen.signal import Signal

COARSE = 1e-3  # of a state's range: more than rounding does where nothing amplifies it


@dataclass(frozen=True)
class Difference:
    """Of one state: the `largest` difference, at the time `t`, and its `share` of the `scale`, which is `of` its
    "range" or "peak"; `status`: samples whose status differs, in the whole run."""

    state: str
    unit: str
    largest: float
    t: float
    share: float
    scale: float
    of: str
    status: int


def differences(states: Sequence[Signal], single: Run, double: Run) -> tuple[Difference, ...]:
    """Of each state of two runs over the same samples, in float and in double."""
    status = int(np.count_nonzero(single.status != double.status))
    each = []
    for signal in states:
        gap, size = np.abs(single[signal.name] - double[signal.name]), np.abs(double[signal.name])
        gap, peak = np.where(np.isfinite(gap), gap, 0.0), float(size[np.isfinite(size)].max(initial=0.0))
        width = signal.interval[1] - signal.interval[0]
        scale, of = (width, "range") if signal.bounded else (peak, "peak")
        at = int(np.argmax(gap))
        share = float(gap[at]) / scale if scale else float(gap[at] > 0)
        each.append(Difference(signal.name, signal.unit, float(gap[at]), float(single.t[at]), share, scale, of, status))
    return tuple(each)


def coarse(each: Sequence[Difference], unit: str) -> Iterator[str]:
    """A sentence for each state that float moves by more than rounding does, and one for statuses that differ."""
    for one in each:
        if one.share > COARSE:
            yield (
                f"in float, {one.state} is {one.share:.2g} of its {one.of} from double at {one.t:.4g} {unit}: scale "
                "the states to numbers of one size, lower the gains, or take double"
            )
    if each and each[0].status:
        yield f"in float, samples whose status is another than in double: {each[0].status}"
