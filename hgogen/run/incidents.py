"""What happens to an estimate along a run: guards act on it, the plant leaves its declared ranges, it is lost."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hgogen.run.samples import Run
from hgogen.step import Step
from hgogen.system import System
from hgogen.trial import Trajectory

_SHOWN = 3  # times that a sentence names
_ROUNDING = 1e-9  # of a range, by which a truth that runs along its end may be beyond it
Array = np.ndarray


@dataclass(frozen=True)
class Interventions:
    """When the law of recovery acted."""

    restarts: Annotated[tuple[float, ...], "times of restarts from the sample"] = ()
    projections: Annotated[tuple[float, ...], "times of projections onto the ranges"] = ()
    runs: Annotated[int, "number of runs"] = 1

    def __bool__(self) -> bool:
        return bool(self.restarts or self.projections)

    def __add__(self, other: "Interventions") -> "Interventions":
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
    names = {bit.name: k for k, bit in enumerate(step.layout.bits)}

    def raised(name: str) -> tuple[float, ...]:
        return tuple(t[((status >> names[name]) & 1) != 0].tolist()) if name in names else ()

    return Interventions(raised("RESTARTED_FROM_SAMPLE"), raised("PROJECTED_ONTO_RANGES"))


def guard_notes(trial: str, observer: str, each: Interventions, disturbed: bool, unit: str) -> Iterator[str]:
    """A sentence for a trial in which there are some; a warning where nothing disturbs it."""
    if each and disturbed:
        yield f"trial {trial}, {observer}: {each.sentence(unit)}"
    elif each:
        yield (
            f"warning: nothing disturbs trial {trial}, yet {observer} has {each.sentence(unit)}; widen the ranges, or "
            "check model and gains"
        )


@dataclass(frozen=True)
class Left:
    """A state or an input of the plant that leaves its range."""

    signal: Annotated[str, "the state or input"]
    low: Annotated[float, "lower end of its range"]
    high: Annotated[float, "upper end of its range"]
    time: Annotated[float, "when it leaves first"]
    value: Annotated[float, "its value there"]
    farthest: Annotated[float, "its value farthest from the range"]

    def sentence(self, unit: str) -> str:
        """A sentence such as "q leaves its range -4..4 at t = 1.2 s, where it is 4.01, and gets as far as 9"."""
        return (
            f"{self.signal} leaves its range {self.low:g}..{self.high:g} at t = {self.time:.6g} {unit}, where it is "
            f"{self.value:.6g}, and gets as far as {self.farthest:.6g}"
        )


def left(system: System, trajectory: Trajectory) -> tuple[Left, ...]:
    """The states and inputs of the plant as first declared that leave their ranges along the truth."""
    plant, truth = system.declared, trajectory.truth
    signals, values = (*plant.states, *plant.inputs), np.hstack([truth.x, truth.u])
    leaving = []
    for signal, along in zip(signals, values.T, strict=True):
        low, high = signal.interval
        beyond = np.maximum(low - along, along - high)
        first = int(np.argmax(beyond > _ROUNDING * (high - low)))
        if signal.bounded and beyond[first] > _ROUNDING * (high - low):
            numbers = (truth.t[first], along[first], along[np.argmax(beyond)])
            leaving.append(Left(signal.name, low, high, *map(float, numbers)))
    return tuple(leaving)


def leaving_notes(trial: str, each: Iterable[Left], unit: str) -> Iterator[str]:
    """A sentence for a trial in which something leaves its range."""
    sentences = "; ".join(one.sentence(unit) for one in each)
    if sentences:
        yield (
            f"trial {trial}, the plant itself: {sentences}. The proofs hold on the ranges alone, at whose edge an "
            "observer evaluates the model: declare wider ones, or change the trial"
        )


def before_loss(run: Run) -> int:
    """How many samples there are before the first whose estimate is no number."""
    finite = np.isfinite(run.x).all(axis=1)
    return len(finite) if finite.all() else int(np.argmin(finite))


def loss(step: Step, run: Run, t: Array, u: Array, y: Array) -> Iterator[str]:
    """A sentence on the loss of an estimate over inputs u (N, m) and samples y (N, p) at times t (N,), if it is lost:
    since when, by what, and what to do."""
    first = before_loss(run)
    if first == len(t):
        return
    signals = np.array([s.name for s in (*step.inputs, *step.outputs)])
    absent = ~np.isfinite(np.hstack([u, y]))[: first + 1]
    rows = np.flatnonzero(absent.any(axis=1))
    since = f"from {t[first]:.6g} {step.time} on the estimate is no number, and no error counts"
    if step.clock.guarded or not len(rows):
        fix = "lower" if step.clock.guarded else "run it with --guards all, or lower"
        yield f"{since}: it grew beyond every number; {fix} the gains, or take a shorter --dt"
        return
    names = signals[absent[rows[-1]]]
    absent_at = f"{', '.join(names)} {'has' if len(names) == 1 else 'have'} no number at {t[rows[-1]]:.6g} {step.time}"
    fix = "run it with --guards all, or fill in what the log lacks"
    yield f"{absent_at}, which a step without guards cannot leave out: {since}; {fix}"
