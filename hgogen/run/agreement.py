"""Two runs of a step over the same record: the compiled C and Python's reading of the program, float and double.

C and Python evaluate the same operations in double precision. Until theta first rises they can differ by rounding
only; while theta is high the gain multiplies what little differs, so from there on the times to settle are
compared. Of a run in float, as small firmware makes it, and one in double,

    difference = max over samples of |x_float - x_double|, over the width of the state's range, else over its peak

where samples at which one of them is no number do not count.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from hgogen.errors import HgogenError
from hgogen.run.metrics import Metrics, crossings
from hgogen.run.samples import Run
from hgogen.sentence import Encoded
from hgogen.signal import Signal
from hgogen.trial import Trajectory

ROUNDING = 1e-11  # of the trajectory's peak: some 1e3 operations a step, each 1e-16, forgotten within 1e2 steps
COARSE = 1e-3  # of a state's range: more than rounding does where nothing amplifies it


@dataclass(frozen=True)
class Agreement(Encoded):
    """How two readers of a step differ, relative to each state's peak.

    Times to settle may differ by one sample, because an error that just touches the band may lie on either side of it.
    """

    json_keys = "trial seed until before after settled dt agreed"

    trial: Annotated[str, "name of the trial"]
    seed: Annotated[int, "seed of its noise"]
    until: Annotated[float, "time of the first rise of theta through 1.5, else the end (s)"]
    before: Annotated[float, "largest difference until then"]
    after: Annotated[float, "largest difference from then on"]
    settled: Annotated[tuple[tuple[float | None, float | None], ...], "times to settle after each event: C, Python (s)"]
    dt: Annotated[float, "sampling period (s)"]

    @property
    def agreed(self) -> bool:
        """Whether C and Python say the same."""
        c, python = np.array(self.settled, dtype=float).reshape(-1, 2).T  # NaN where never
        return self.before <= ROUNDING and np.allclose(c, python, rtol=0, atol=1.5 * self.dt, equal_nan=True)


def agreement(c: tuple[Trajectory, Metrics], python: tuple[Trajectory, Metrics], dt: float) -> Agreement:
    """Two trajectories of one trial and seed, with their metrics."""
    (mine, measured), (other, expected) = c, python
    peak = np.maximum(np.abs(other.x).max(axis=0), np.finfo(float).tiny)
    difference = (np.abs(mine.x - other.x) / peak).max(axis=1)
    rises = crossings(other.traces["theta"]) if "theta" in other.traces else np.array([], int)
    first = int(rises[0]) if len(rises) else len(difference)
    return Agreement(
        trial=mine.trial.name,
        seed=mine.seed,
        until=float(other.truth.t[min(first, len(difference) - 1)]),
        before=float(difference[:first].max(initial=0.0)),
        after=float(difference[first:].max(initial=0.0)),
        settled=tuple((a.settled, b.settled) for a, b in zip(measured.responses, expected.responses, strict=True)),
        dt=dt,
    )


@dataclass(eq=False)
class Disagree(HgogenError):
    """C and Python do not say the same."""

    status: ClassVar[int] = 1
    failed: tuple[Agreement, ...]

    def __str__(self) -> str:
        worst = max(self.failed, key=lambda one: one.before)
        return (
            f"C and Python disagree in trial {worst.trial!r}, seed {worst.seed}: {worst.before:.1e} of the peak until "
            f"t = {worst.until:g}, times to settle {worst.settled}; check the compiler's flags (no -ffast-math)"
        )


@dataclass(frozen=True)
class Difference:
    """How far a state is from a run in double."""

    state: Annotated[str, "the state"]
    unit: Annotated[str, "its unit"]
    largest: Annotated[float, "largest difference"]
    t: Annotated[float, "time of the largest difference"]
    share: Annotated[float, "the difference over the scale"]
    scale: Annotated[float, "width of the state's range, or its peak"]
    of: Annotated[str, "range or peak: what the scale is"]
    status: Annotated[int, "samples whose status differs, in the whole run"]


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
