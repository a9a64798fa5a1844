"""The shares of samples beyond innovation gates in a run, and the expected ones.

    expected = 1 - probability    where the model, Q and R are right and the sensor has no outliers

A gate does not distinguish an outlier from a good sample of a filter whose covariance is too small. Such a filter
rejects good samples, and its error grows. The mean of the normalised innovations squared (NIS), without the gate and
without outliers, is near 1 if Q and R are right. Source: Bar-Shalom, Li, Kirubarajan (2001), 5.4.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from hgogen.errors import ReportedWarning
from hgogen.estimators.gate import GatedGroup
from hgogen.estimators.riccati_part import Riccati, SampledFilter
from hgogen.reading.given import names_of
from hgogen.step import Step

MUCH = 0.1  # of the samples: more outliers than most sensors have
FEWEST = 10  # samples beyond a gate that make a share
UNUSED = ("MISSING", "REJECTED", "LATE", "EARLY", "REPEATED", "UNDATED")  # bits of a sample that is not used


class RejectsMany(ReportedWarning):
    """The warning about a gate that rejects far more samples than its probability says."""


@dataclass(frozen=True)
class GateShare:
    """The numbers of samples within and beyond one innovation gate in a run."""

    outputs: Annotated[tuple[str, ...], "the outputs that pass together"]
    count: Annotated[int, "number of calls with a sample of them"]
    beyond: Annotated[int, "number of these beyond the gate: rejected, or used with a larger R"]
    reacquired: Annotated[int, "number accepted after too many in a row beyond the gate"]
    expected: Annotated[float, "share beyond the gate where model, Q and R are right and there are no outliers"]

    @property
    def share(self) -> float:
        """The share of the samples beyond the gate."""
        return self.beyond / self.count if self.count else 0.0

    @property
    def excessive(self) -> bool:
        """Whether the share beyond the gate is far above the expected one: above twice the expected share plus a
        tenth."""
        return self.beyond >= FEWEST and self.share > 2 * self.expected + MUCH

    def __add__(self, other: "GateShare") -> "GateShare":
        beyond, reacquired = self.beyond + other.beyond, self.reacquired + other.reacquired
        return replace(self, count=self.count + other.count, beyond=beyond, reacquired=reacquired)

    def __str__(self) -> str:
        outputs, share = ", ".join(self.outputs), f"{100 * self.share:.3g} % of {self.count} samples"
        opened = f", and {self.reacquired} were accepted after too many in a row" if self.reacquired else ""
        return f"{share} of {outputs} are beyond the gate, {100 * self.expected:.3g} % are expected{opened}"

    @property
    def sentence(self) -> str:
        """The sentence on an excessive share, with the recommended action."""
        return (
            f"{self}: check the NIS first, by hg.consistency of a run without the gate over a part without outliers; "
            "above 1, raise Q and R or correct the model, else check the sensor"
        )


def gated(step: Step) -> tuple[GatedGroup, ...]:
    """Return the groups of outputs of a step that have a gate."""
    parts = (part.plain if isinstance(part, SampledFilter) else part for part in step.observer.parts)
    return tuple(group for part in parts if isinstance(part, Riccati) for group in part.gates)


def gate_shares(step: Step, status: np.ndarray) -> tuple[GateShare, ...]:
    """Return the share of the samples beyond each gate of a step, from the status (N) of its calls."""
    groups = gated(step)
    if not groups:
        return ()
    names = [group.name for group in groups]
    beyond, reacquired = (raised(step, status, bits, names) for bits in (("GATED", "INFLATED"), ("REACQUIRED",)))
    unused = raised(step, status, UNUSED, names_of(step.outputs))
    return tuple(
        GateShare(
            group.names,
            count=len(status) - int(unused[:, group.outputs].all(axis=1).sum()),
            beyond=int(beyond[:, k].sum()),
            reacquired=int(reacquired[:, k].sum()),
            expected=group.expected,
        )
        for k, group in enumerate(groups)
    )


def raised(step: Step, status: np.ndarray, bits: Sequence[str], names: Sequence[str]) -> np.ndarray:
    """Return the mask (N, k) of the calls whose `status` (N) has a bit such as MISSING_y: one of the `bits` (MISSING
    ..) of each of the k `names` (y ..)."""
    known = [bit.place.name for bit in step.layout.bits]
    wanted = [[f"{bit}_{name}" for bit in bits] for name in names]
    masks = [sum(1 << k for k, bit in enumerate(known) if bit in each) for each in wanted]
    return np.asarray(status[:, None] & np.array(masks, step.layout.word) != 0)
