"""The compiled C against Python's reading of the same program, over the same record.

Both evaluate the same operations in double precision. Until theta first rises they can differ by rounding
only; while theta is high the gain multiplies what little differs, so from there on the times to settle are
compared.
"""

from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np

from hgogen.errors import HgogenError
from hgogen.trial import Trajectory
from hgogen.trials.metrics import Metrics, crossings

ROUNDING = 1e-11  # of the trajectory's peak: some 1e3 operations a step, each 1e-16, forgotten within 1e2 steps


@dataclass(frozen=True)
class Agreement:
    """How two readers of a step differ, relative to each state's peak.

    `until` (s): the first rise of theta through 1.5, or the end; `before`, `after`: the largest difference
    until then and from then on; `settled`: times to settle after each event, (C, Python); `dt` (s): they
    may differ by one sample, because an error that just touches the band may lie on either side of it.
    """

    trial: str
    seed: int
    until: float
    before: float
    after: float
    settled: tuple[tuple[float | None, float | None], ...]
    dt: float

    @property
    def agreed(self) -> bool:
        """Whether C and Python say the same."""
        c, python = np.array(self.settled, dtype=float).reshape(-1, 2).T  # NaN where never
        return self.before <= ROUNDING and np.allclose(c, python, rtol=0, atol=1.5 * self.dt, equal_nan=True)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self) | {"agreed": self.agreed}


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
