"""When the law of recovery acted on an estimate: restarts from the sample and projections onto the ranges."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hgogen.step import Step

_SHOWN = 3  # times that a sentence names


@dataclass(frozen=True)
class Interventions:
    """The times of all `restarts` from the sample and `projections` onto the ranges in so many `runs`."""

    restarts: tuple[float, ...] = ()
    projections: tuple[float, ...] = ()
    runs: int = 1

    def __bool__(self) -> bool:
        """Whether there is any."""
        return bool(self.restarts or self.projections)

    def __add__(self, other: "Interventions") -> "Interventions":
        """Those of both."""
        restarts, projections = self.restarts + other.restarts, self.projections + other.projections
        return Interventions(restarts, projections, self.runs + other.runs)

    def sentence(self, unit: str) -> str:
        """A clause such as "2 restarts from the sample (t = 1.2, 3 s), 1 projection onto the ranges (t = .4 s)"."""
        named = (("restart", "from the sample", self.restarts), ("projection", "onto the ranges", self.projections))
        parts = []
        for what, where, times in named:
            if times:
                shown = ", ".join(f"{t:.4g}" for t in sorted(times)[:_SHOWN]) + ", .." * (len(times) > _SHOWN)
                parts.append(f"{len(times)} {what}{'s' * (len(times) != 1)} {where} (t = {shown} {unit})")
        return ", ".join(parts) + f" in {self.runs} runs" * (self.runs > 1)


def interventions(step: Step, status: np.ndarray, t: np.ndarray) -> Interventions:
    """Those that a status (N,) tells of at the times t (N,)."""
    names = {bit.name: k for k, bit in enumerate(step.bits)}

    def raised(name: str) -> tuple[float, ...]:
        return tuple(t[((status >> names[name]) & 1) != 0].tolist()) if name in names else ()

    return Interventions(raised("RESTARTED_FROM_SAMPLE"), raised("PROJECTED_ONTO_RANGES"))


def notes(trial: str, observer: str, each: Interventions, disturbed: bool, unit: str) -> Iterator[str]:
    """A sentence for a trial in which there are some; a warning where nothing disturbs it."""
    if each and disturbed:
        yield f"trial {trial}, {observer}: {each.sentence(unit)}"
    elif each:
        yield (
            f"warning: nothing disturbs trial {trial}, yet {observer} has {each.sentence(unit)}; widen the ranges, or "
            "check model and gains"
        )
