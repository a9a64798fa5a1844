"""A model's trials over their seeds, campaigns of many runs on each trial, and the tables of both."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Group, RenderableType
from rich.text import Text

from hgogen.call import CallableStep
from hgogen.certificates.error_bound import ErrorBound
from hgogen.commands.command import Runs
from hgogen.commands.output import Bar, headed, note
from hgogen.estimators.noise import sample_deviations
from hgogen.model import Model
from hgogen.run.campaign import (
    BadCampaign,
    Campaign,
    Outcome,
    Spread,
    Tally,
    campaign,
    results_head,
    results_line,
    stored_outcomes,
)
from hgogen.run.comparison import Agreement, BoundedError, agreement
from hgogen.run.metrics import (
    ITSELF,
    Interventions,
    Leaving,
    Metrics,
    Summary,
    alarm_complaints,
    alarm_ratio,
    criterion,
    interventions,
    leaving_notes,
    leaving_signals,
    metrics,
    summary,
)
from hgogen.run.metrics import guard_notes as guards
from hgogen.run.samples import Engine
from hgogen.sentence import up
from hgogen.target import lines_of
from hgogen.trial import OrnsteinUhlenbeck, Trajectory, Trial, demand_trial, proposed_trial, try_out

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Tick = Callable[[], None]


def trials_or_proposed(model: Model) -> tuple[Trial, ...]:
    """Return the model's trials or, if it has none, one proposed from its ranges, with a note. Raises: `NoTrial`,
    `MissingPart`."""
    if model.has("trial"):
        return model.trials()
    trial = proposed_trial(model.plant)
    at = ", ".join(f"{state} = {value:g}" for state, value in trial.start.items())
    span = f"over {trial.duration:.3g} {model.plant.time} from {at}"
    note(f"{model.path} has no trial; it is tried on one that stays in its ranges, {span}")
    return (trial,)


def with_declared_noise(model: Model, trials: Sequence[Trial], steps: Iterable[CallableStep]) -> tuple[Trial, ...]:
    """Return a model's own trials unchanged, a proposed trial with the noise of a sample (standard deviations) that the
    first of the `steps` with R declares."""
    if model.has("trial"):
        return tuple(trials)
    declared = next(filter(None, map(sample_deviations, steps)), {})
    names = [y.name for y in model.plant.declared.outputs if y.name in declared]
    noise = {name: OrnsteinUhlenbeck(declared[name]) for name in names}
    return tuple(replace(one, noise=noise) for one in trials)


def trials_of(model: Model, step: CallableStep) -> tuple[Trial, ...]:
    """Return a model's trials (a proposed one with the noise that the step declares), on each of which the step can
    run. Raises: `NoTrial`, `MissingPart`, `BadTrial`."""
    known = with_declared_noise(model, trials_or_proposed(model), [step])
    for trial in known:
        demand_trial(step.observer.form.system.declared, trial, step.dt)
    return known


@dataclass(frozen=True, eq=False)
class Tried:
    """The results of a trial over its seeds; `first`: the trajectory of the first seed."""

    trial: Trial
    first: Trajectory
    each: Annotated[tuple[Metrics, ...], "the metrics of every seed"]
    leaving: Annotated[tuple[Leaving, ...], "the plant's own states and inputs that leave their declared ranges"]
    acted: Annotated[Interventions, "when guards acted on the estimate"]


@dataclass(frozen=True, eq=False)
class TrialRow:
    """The results of a trial as printed in JSON."""

    json_keys = "*summary left=tried.leaving acted=tried.acted"

    summary: Summary
    tried: Tried


def tried(step: CallableStep, trial: Trial, engine: Engine, seeds: Sequence[int], tick: Tick) -> Tried:
    """Return the metrics of a step on a trial for each of the seeds; `tick` is called after each seed."""
    first: Trajectory | None = None
    each: list[Metrics] = []
    acted = Interventions(runs=0)
    for trajectory in try_out(step, trial, engine, seeds):
        first = first or trajectory
        each.append(metrics(step, trajectory))
        acted += interventions(step, trajectory.status, trajectory.truth.t)
        tick()
    assert first is not None  # a trial without seeds was refused
    return Tried(trial, first, tuple(each), leaving_signals(step.observer.form.system, first), acted)


def summaries(step: CallableStep, done: Sequence[Tried], engine: Engine, say: Callable[[str], None]) -> list[Summary]:
    """Return the metrics of each trial over its seeds as one `Summary`, with the alarm ratio of an adaptive theta;
    `say` is called with each warning."""
    ratios = [(one, alarm_ratio(step, one.trial, engine, [m.seed for m in one.each])) for one in done]
    summed = [summary(one.trial, one.each, ratio, step.time) for one, ratio in ratios]
    guarded = (guards(one.trial.name, step.observer.name, one.acted, bool(one.trial.jumps), step.time) for one in done)
    for sentence in (*departures(done, step.time), *chain.from_iterable(guarded), *alarm_complaints(summed)):
        say(sentence)
    return summed


def departures(done: Iterable[Tried], unit: str) -> Iterator[str]:
    """Yield a sentence for each trial in which the plant leaves its declared ranges; `unit`: the unit of time."""
    return chain.from_iterable(leaving_notes(one.trial.name, one.leaving, unit) for one in done)


def agreements(c: Iterable[Tried], python: Iterable[Tried], dt: float) -> tuple[Agreement, ...]:
    """Return the difference between C and Python on the first seed of each trial; `dt`: the sampling period."""
    pairs = zip(c, python, strict=True)
    return tuple(agreement((a.first, a.each[0]), (b.first, b.each[0]), dt) for a, b in pairs)


def trial_figures(step: CallableStep, done: Iterable[Tried], known: ErrorBound | None = None) -> dict[str, "Figure"]:
    """Return the figures of each trial, by file name without suffix: the states, theta if it adapts, and, if proved
    bounds are `known`, the errors."""
    from hgogen.run import figures as figure

    drawn = {}
    for one in done:
        drawn[f"{one.trial.name}_states"] = figure.states(step, one.first)
        if known and known.bounds:
            of = {step.observer.name: one.first.error}
            drawn[f"{one.trial.name}_errors"] = figure.errors(
                step.states, one.first.truth.t, of, one.trial.events, step.time, known.bounds
            )
        if step.observer.traces:
            drawn[f"{one.trial.name}_theta"] = figure.adaptation(step, one.first.truth.t, one.first.traces)
    return drawn


def trials_table(each: Iterable[Summary], unit: str) -> RenderableType:
    """Return the table of the responses to each event of each trial, over the seeds; `unit`: the unit of time."""
    parts: list[RenderableType] = []
    for one in each:
        names = [f"event at ({unit})", f"settled after ({unit})", f"worst ({unit})"]
        if any(peak is not None for peak in one.peak):
            names += ["peak theta", f"theta < 1.05 after ({unit})", "triggered", "still > 1.5"]
        title = f"trial {one.trial}: {one.seeds} seed{'s' * (one.seeds != 1)}, in {LANGUAGES[one.engine]}; "
        table = headed(f"{title}settled: {one.criterion}", *names, numbers=len(names))
        for k, time in enumerate(one.times):
            peak = one.peak[k]
            row = (
                f"{time:g}",
                time_cell(one.settled[k]),
                time_cell(one.worst[k]),
                "" if peak is None else _range(*peak),
                "" if peak is None else time_cell(one.theta_settled[k]),
                *("" if share is None else f"{100 * share:.0f}%" for share in (one.triggered[k], one.loud[k])),
            )
            table.add_row(*row[: len(names)])
        rms = ", ".join(f"{name} {value:.3g}" for name, value in one.rms.items())
        clamped = f"{one.clamped} samples" if one.clamped else "no sample"
        parts += [table, Text(f"steady RMS: {rms}; outside the box after the first 5%: {clamped}")]
        if one.alarm_ratio is not None:
            parts.append(Text(f"alarm ratio: {one.alarm_ratio:.2f}; above {ITSELF:g} noise alone can keep theta high"))
        parts.append("")
    return Group(*parts)


def bounds_table(each: Sequence[BoundedError]) -> RenderableType:
    """Return a table of the largest error of each state and its proved bound."""
    title = f"errors of the first seed, from {each[0].after:g} after each event on, beside what is proved of them"
    table = headed(title, "state", "worst seen", "proved", numbers=2)
    for one in each:
        worst = "-" if one.worst is None else f"{one.worst:.3g} {one.unit}"
        table.add_row(one.state, worst, f"{up(one.bound, 3)} {one.unit}")
    return table


LANGUAGES = {"c": "C", "python": "Python"}


def time_cell(value: float | None) -> str:
    """Return a time as text with two decimals, a short time with more; "never" for None."""
    if value is None:
        return "never"
    return f"{value:g}" if abs(value) < 0.01 else f"{value:.2f}"


def _range(low: float, high: float) -> str:
    return f"{low:.2f}" if f"{low:.2f}" == f"{high:.2f}" else f"{low:.2f} .. {high:.2f}"


def agreement_table(each: Iterable[Agreement], unit: str) -> RenderableType:
    """Return the table of differences between C and Python on each trial; `unit`: the unit of the model's time."""
    table = headed(
        "C against Python, double precision, relative to each state's peak",
        *(
            "trial",
            "seed",
            f"until ({unit})",
            "difference until then",
            "afterwards",
            f"settled after ({unit}), both",
            "agreed",
        ),
        numbers=5,
    )
    for one in each:
        pairs = [(time_cell(first), time_cell(second)) for first, second in one.settled]
        settled = ", ".join(first if first == second else f"{first}/{second}" for first, second in pairs)
        agreed = Text("yes", style="green") if one.agreed else Text("no", style="red")
        difference = f"{one.before:.1e}", f"{one.after:.1e}"
        table.add_row(one.trial, str(one.seed), f"{one.until:g}", *difference, settled, agreed)
    return Group(table, "")


RUNS = 1000  # runs of a campaign by default
NAMED = 5  # invalid lines that are listed


@dataclass(frozen=True, eq=False)
class CampaignRow:
    """The results of many runs of one observer on a trial; `name`: the tuning's name."""

    json_keys = (
        "trial=campaign.trial.name observer=name engine=campaign.engine criterion runs failed "
        "varied=campaign.draws.varied quantiles run?"
    )

    name: Annotated[str, "name of the tuning"]
    campaign: Campaign
    tally: Tally
    repeat: int | None

    @property
    def criterion(self) -> str:
        """When a run counts as settled."""
        return criterion(self.campaign.trial, self.campaign.step.time)

    @property
    def runs(self) -> int:
        """Number of runs."""
        return len(self.campaign.draws)

    @property
    def failed(self) -> int:
        """Number of runs whose plant could not be simulated."""
        return self.tally.failed

    @property
    def quantiles(self) -> list[Spread]:
        """The quantiles of each quantity over the runs."""
        return self.tally.spreads()

    @property
    def run(self) -> Outcome | None:
        """The run that --repeat names."""
        return None if self.repeat is None else self.tally.last

    def notes(self) -> Iterator[str]:
        """Yield a sentence on the runs that failed, if any did."""
        if self.tally.failure:
            share = f"{self.tally.failed} of {len(self.tally)} runs without a truth"
            first = f"of run {self.tally.failure.run} {self.tally.failure.failed}"
            yield f"{self.name}, trial {self.campaign.trial.name}: {share}; {first}"

    def tables(self) -> Iterator[RenderableType]:
        """Yield a row for each quantity, or the numbers of one run."""
        every, run = self.repeat is None, self.run
        which = f"{len(self.tally)} runs" if every else f"run {self.repeat}"
        columns = ("5 %", "50 %", "95 %", "worst", "of run") if every else ("",)
        title = f"{self.name}, trial {self.campaign.trial.name}, {which}"
        table = headed(title, "", *columns, numbers=len(columns))
        for spread in self.quantiles:
            values = (spread.low, spread.middle, spread.high, spread.worst)
            numbers = ["never" if value is None else f"{value:.3g}" for value in values]
            table.add_row(Text(spread.name), *([*numbers, str(spread.run)] if every else numbers[:1]))
        yield table
        drawn = [f"{each.name} in {each.low:g} .. {each.high:g}" for each in self.campaign.draws.varied]
        yield Text(f"settled: {self.criterion}; varied: {', '.join(drawn) or 'noise seeds alone'}")
        if run is None:
            yield Text("the same options and --repeat K run number K alone, and say what was drawn for it\n")
            return
        varied = "".join(f", {key} = {value:.6g}" for key, value in run.varied.items())
        yield Text(f"run {self.repeat}: noise of seed {self.repeat}{varied}\n")


def campaigns(
    steps: Callable[[Trial], Mapping[str, CallableStep]],
    trials: Iterable[Trial],
    engine: Engine,
    options: Runs,
    seeds: int | None,
) -> tuple[CampaignRow, ...]:
    """Return the results of a campaign for each trial and each step; `steps`: returns the steps for a trial, by name.

    Raises: `BadParameter` for options that exclude each other; as `run.campaign` does.
    """
    if seeds is not None:
        raise typer.BadParameter("run k of a campaign has the noise of seed k; give --runs", param_hint="--seeds")
    each = [
        (
            name,
            campaign(
                step, trial, RUNS if options.runs is None else options.runs, options.vary, options.draw or 0, engine
            ),
        )
        for trial in trials
        for name, step in steps(trial).items()
    ]
    if options.repeat is not None and options.repeat >= min(len(one.draws) for _, one in each):
        raise typer.BadParameter(f"the runs are numbered from 0 to {len(each[0][1].draws) - 1}", param_hint="--repeat")
    with Bar("runs", sum(len(one.draws) if options.repeat is None else 1 for _, one in each)) as bar:
        rows = tuple(CampaignRow(name, one, _tallied(name, one, options, bar), options.repeat) for name, one in each)
    note(*(sentence for row in rows for sentence in row.notes()))
    if all(row.tally.failed == len(row.tally) for row in rows):
        raise BadCampaign("vary", "leaves no run whose plant can be integrated; vary less, or shorten the trial")
    return rows


def _tallied(name: str, one: Campaign, options: Runs, bar: Bar) -> Tally:
    tally, first = Tally(len(one.draws), one.step.time), options.repeat or 0
    wanted = range(first, len(one.draws) if options.repeat is None else first + 1)
    with _results(name, one, options.results) as (known, add):
        for outcome in known:
            if outcome.run in wanted:
                tally.add(outcome)
        bar.tick(done=len(tally))
        missing = [number for number in wanted if number not in tally]
        for outcome in one.run(missing, options.jobs if len(missing) > 1 else 1, options.scheduler) if missing else ():
            tally.add(outcome)
            add(results_line(outcome))
            bar.tick()
    return tally


@contextmanager
def _results(
    name: str, one: Campaign, folder: Path | None
) -> Iterator[tuple[Iterable[Outcome], Callable[[str], None]]]:
    if folder is None:
        yield (), lambda line: None
        return
    file = f"{one.trial.name}_{name}.jsonl"
    with lines_of(file, folder) as (lines, add):
        first = next(lines, None)
        if first is None:
            add(results_head(one))
        yield _valid(one, lines if first is None else chain([first], lines), str(folder / file)), add


def _valid(one: Campaign, lines: Iterable[str], file: str) -> Iterator[Outcome]:
    dropped = list[int]()
    for number, outcome in enumerate(stored_outcomes(one, lines, file), 2):
        if outcome is None:
            dropped.append(number)
        else:
            yield outcome
    if dropped:
        listed = ", ".join(map(str, dropped[:NAMED])) + (", .." if len(dropped) > NAMED else "")
        note(f"{file}: {len(dropped)} lines ({listed}) hold no outcome of this campaign: left out, their runs repeated")
