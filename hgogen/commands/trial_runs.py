"""A model's trials over their seeds, and what commands say of them."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Annotated

from hgogen.call import CallableStep
from hgogen.commands.process import note
from hgogen.model import Model
from hgogen.run.comparison import Agreement, agreement
from hgogen.run.metrics import (
    Interventions,
    Left,
    Metrics,
    Summary,
    alarm_complaints,
    alarm_ratio,
    interventions,
    leaving_notes,
    left,
    metrics,
    summary,
)
from hgogen.run.metrics import guard_notes as guards
from hgogen.run.samples import Engine
from hgogen.trial import Trajectory, Trial, demand_trial, proposed_trial, try_out

Tick = Callable[[], None]


def trials(model: Model) -> tuple[Trial, ...]:
    """The model's own, else one that is made of its ranges, and said. Raises: `NoTrial`, `MissingPart`."""
    if model.has("trial"):
        return model.trials()
    trial = proposed_trial(model.plant)
    at = ", ".join(f"{state} = {value:g}" for state, value in trial.start.items())
    span = f"over {trial.duration:.3g} {model.plant.time} from {at}"
    note(f"{model.path} has no trial; it is tried on one that stays in its ranges, {span}")
    return (trial,)


def trials_of(model: Model, step: CallableStep) -> tuple[Trial, ...]:
    """The trials of a model, each of which its step can be tried on. Raises: `NoTrial`, `MissingPart`, `BadTrial`."""
    known = trials(model)
    for trial in known:
        demand_trial(step.observer.form.system.declared, trial, step.dt)
    return known


@dataclass(frozen=True, eq=False)
class Tried:
    """A trial over its seeds; `first`: the first seed's trajectory."""

    trial: Trial
    first: Trajectory
    each: Annotated[tuple[Metrics, ...], "the metrics of every seed"]
    left: Annotated[tuple[Left, ...], "the plant's own states and inputs that leave their declared ranges"]
    acted: Annotated[Interventions, "when guards acted on the estimate"]


@dataclass(frozen=True, eq=False)
class TrialRow:
    """A trial as JSON has it."""

    json_keys = "*summary left=tried.left acted=tried.acted"

    summary: Summary
    tried: Tried


def trial_rows(summaries: Iterable[Summary], done: Iterable[Tried]) -> tuple[TrialRow, ...]:
    """The trials as JSON has them."""
    return tuple(map(TrialRow, summaries, done))


def tried(step: CallableStep, trial: Trial, engine: Engine, seeds: Sequence[int], tick: Tick) -> Tried:
    """The step over a trial; `tick` is called after each seed."""
    first: Trajectory | None = None
    each: list[Metrics] = []
    acted = Interventions(runs=0)
    for trajectory in try_out(step, trial, engine, seeds):
        first = first or trajectory
        each.append(metrics(step, trajectory))
        acted += interventions(step, trajectory.status, trajectory.truth.t)
        tick()
    assert first is not None  # a trial without seeds has been refused
    return Tried(trial, first, tuple(each), left(step.observer.form.system, first), acted)


def summaries(step: CallableStep, done: Sequence[Tried], engine: Engine, say: Callable[[str], None]) -> list[Summary]:
    """All seeds of each trial in one, with the trial's alarm ratio; `say` is called with what is wrong."""
    ratios = [(one, alarm_ratio(step, one.trial, engine, [m.seed for m in one.each])) for one in done]
    summed = [summary(one.trial, one.each, ratio, step.time) for one, ratio in ratios]
    guarded = (guards(one.trial.name, step.observer.name, one.acted, bool(one.trial.jumps), step.time) for one in done)
    for sentence in (*departures(done, step.time), *chain.from_iterable(guarded), *alarm_complaints(summed)):
        say(sentence)
    return summed


def departures(done: Iterable[Tried], unit: str) -> Iterator[str]:
    """A sentence for each trial whose plant leaves its ranges."""
    return chain.from_iterable(leaving_notes(one.trial.name, one.left, unit) for one in done)


def agreements(c: Iterable[Tried], python: Iterable[Tried], dt: float) -> tuple[Agreement, ...]:
    """C against Python, on the first seed of each trial."""
    pairs = zip(c, python, strict=True)
    return tuple(agreement((a.first, a.each[0]), (b.first, b.each[0]), dt) for a, b in pairs)
