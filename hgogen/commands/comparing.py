"""The command `compare`: several observers of one model over its trials, on the same noise."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Group, RenderableType
from rich.text import Text

from hgogen import observers as every
from hgogen.call import CallableStep
from hgogen.certificates.error_bound import ErrorBound
from hgogen.commands.claims import bound_of
from hgogen.commands.command import (
    NO_RUNS,
    ModelArgument,
    ModelReport,
    OneTrial,
    Out,
    ReaderOption,
    Runs,
    Seeds,
    command,
    engine_here,
    explained,
    one_or_all,
)
from hgogen.commands.output import Bar, Written, filled, folder_of, headed, note, refusals_table, rendered
from hgogen.commands.trial_runs import CampaignRow, campaigns, time_cell, trials_or_proposed, with_declared_noise
from hgogen.errors import HgogenError
from hgogen.model import MissingPart, Model, load
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.prove.semidefinite import NoSolver
from hgogen.run.comparison import Measured, measured
from hgogen.run.metrics import Leaving, criterion, leaving_notes, leaving_signals
from hgogen.run.metrics import guard_notes as guards
from hgogen.run.samples import Engine
from hgogen.sentence import up
from hgogen.system import System
from hgogen.trial import Trial

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Names = Annotated[
    str | None,
    typer.Option(
        "--observers",
        "--observer",
        metavar="A,B,..",
        help="Tunings of the model, or observers.",
        callback=explained,
    ),
]


@dataclass(frozen=True, eq=False)
class ComparedTrial:
    """The results of several observers on one trial of a plant."""

    json_keys = "trial=trial.name seeds criterion times=trial.events estimate start=trial.start left=leaving observers"

    plant: System
    trial: Trial
    seeds: Annotated[int, "number of noise seeds"]
    observers: Annotated[tuple[Measured, ...], "what each observer does"]

    @property
    def criterion(self) -> str:
        """When a trial counts as settled."""
        return criterion(self.trial, self.plant.time)

    @property
    def estimate(self) -> dict[str, float]:
        """The estimate of the plant's state with which every observer starts."""
        return self.trial.first_state(self.plant)

    @property
    def leaving(self) -> tuple[Leaving, ...]:
        """The plant's own states and inputs that leave their declared ranges."""
        return leaving_signals(self.plant, self.observers[0].first)  # all observers share the truth

    def notes(self) -> Iterator[str]:
        """Yield sentences on the reliability of the trial, and on when guards acted."""
        unit = self.plant.time
        if self.estimate == {name: float(value) for name, value in self.trial.start.items()}:
            yield (
                f"trial {self.trial.name}: every observer starts on the truth, so that its first time to settle says "
                "nothing; give the trial an estimate"
            )
        yield from leaving_notes(self.trial.name, self.leaving, unit)
        for row in self.observers:
            yield from guards(self.trial.name, row.name, row.acted, bool(self.trial.jumps), unit)


@dataclass(frozen=True, eq=False)
class Comparison(ModelReport):
    """The results of several observers of one model, on the same noise."""

    json_keys = "model dt engine trials refused files"

    dt: Annotated[float, "sampling period of all observers"]
    engine: Annotated[Engine, "who runs the steps: c or python"]
    unit: str
    trials: Annotated[tuple[ComparedTrial, ...], "the observers on each trial"]
    refused: Annotated[dict[str, str], "why observers are refused, by name"]
    files: Written

    def tables(self) -> Iterator[Any]:
        """Yield tables with a row for each observer."""
        for one in self.trials:
            title = f"trial {one.trial.name}, seeds {one.seeds}, settled: {one.criterion}"
            yield comparison_tables(title, one.observers, self.unit, one.estimate, one.trial.start)
        yield from refusals_table(self.refused, "refused, and not compared")


@dataclass(frozen=True, eq=False)
class ComparedCampaigns(ModelReport):
    """The campaigns of several observers, with --vary or --runs."""

    dt: Annotated[float, "sampling period of all observers"]
    engine: Annotated[Engine, "who runs the steps: c or python"]
    campaigns: Annotated[tuple[CampaignRow, ...], "the campaign of each observer on each trial"]
    refused: Annotated[dict[str, str], "why observers are refused, by name"]

    def tables(self) -> Iterator[Any]:
        """Yield a table for each campaign."""
        for row in self.campaigns:
            yield from row.tables()
        yield from refusals_table(self.refused, "refused, and not compared")


@command(Comparison, ComparedCampaigns)
def compare_(
    model: ModelArgument,
    observers: Names = None,
    setting: Setting = AS_WRITTEN,
    seeds: Seeds = None,
    trial: OneTrial = None,
    reader: ReaderOption = None,
    campaign_options: Runs = NO_RUNS,
    out: Out = None,
) -> Comparison | ComparedCampaigns:
    """Try several observers of a model on its trials and print convergence, steady error, peaking and cost in one
    table; draw the errors. All observers have the same noise, the same sampling period (the shortest of their own), and
    the same initial estimate of the plant's state: the trial's `estimate`, else the nominal values. A refused observer
    is named with the reason, and the others are compared.

    Settled: the median of the seeds. Steady: over the trial's own steady part, else its last tenth, the median of the
    seeds. Peaking: the largest rise of the error above its value at the start or at a jump, over all seeds, relative to
    the state's range. Functions: calls of sine, exponential, root and the like in one call of the step. For a model
    that declares bounds on noise and disturbances, the table also has the proved bound of each error, or the reason why
    there is none.
    """
    loaded = load(model).set(setting)
    folder = folder_of(out, loaded)
    names = _names(loaded, observers)
    chosen, engine = one_or_all(trials_or_proposed(loaded), trial), engine_here(reader)
    if not campaign_options:
        folder.demand(*(f"{one.name}_errors.svg" for one in chosen))
    steps, dt, refused = _alike(loaded, names, chosen)
    chosen = with_declared_noise(loaded, chosen, steps[chosen[0].name].values())
    if campaign_options:
        rows = campaigns(lambda one: steps[one.name], chosen, engine, campaign_options, seeds)
        return ComparedCampaigns(loaded.path, dt, engine, rows, refused)
    tried = _tried(loaded, steps, chosen, engine, seeds)
    unit = loaded.plant.time
    drawn = {f"{one.trial.name}_errors": error_figure(one.observers, unit) for one in tried}
    return Comparison(loaded.path, dt, engine, unit, tried, refused, tuple(folder.write(rendered(drawn))))


def _alike(
    model: Model, names: list[str], trials: Sequence[Trial]
) -> tuple[dict[str, dict[str, CallableStep]], float, dict[str, str]]:
    """Return the steps by trial and tuning, all at the shortest of their sampling periods; that period; and by name the
    reasons why other tunings are refused."""
    steps, refused = _started(model, names, trials)
    names = _admitted(names, refused)
    first = steps[trials[0].name]
    unit, dt = model.plant.time, min(step.dt for step in first.values())
    longer = [name for name, step in first.items() if step.dt > dt]
    if longer:
        note(f"all sampled at dt = {dt:g} {unit}, the shortest; {', '.join(longer)} would be sampled more slowly")
        again, slow = _started(model, longer, trials, dt)
        refused |= slow
        names = _admitted(names, slow)
        steps = {trial: {name: (each | again[trial])[name] for name in names} for trial, each in steps.items()}
    return steps, dt, {name: str(error) for name, error in refused.items()}


def _tried(
    model: Model,
    steps: Mapping[str, Mapping[str, CallableStep]],
    trials: Sequence[Trial],
    engine: Engine,
    seeds: int | None,
) -> tuple[ComparedTrial, ...]:
    counts = {one.name: one.seeds if seeds is None else tuple(range(seeds)) for one in trials}
    known = _known(model, steps, trials)
    tried = []
    with Bar("trials", sum(len(steps[name]) * len(each) for name, each in counts.items())) as bar:
        for one in trials:
            each = tuple(
                measured(name, step, one, engine, counts[one.name], bar.tick, known[one.name][name])
                for name, step in steps[one.name].items()
            )
            tried.append(ComparedTrial(model.plant, one, len(counts[one.name]), each))
            note(*tried[-1].notes())
    return tuple(tried)


def _started(
    model: Model, names: list[str], trials: Sequence[Trial], dt: float | None = None
) -> tuple[dict[str, dict[str, CallableStep]], dict[str, HgogenError]]:
    steps: dict[str, dict[str, CallableStep]] = {one.name: {} for one in trials}
    refused: dict[str, HgogenError] = {}
    for name in names:
        try:
            steps_by_trial = {one.name: model.step(name, dt, one.first_estimate) for one in trials}
        except HgogenError as error:
            refused[name] = error
        else:
            for trial, step in steps_by_trial.items():
                steps[trial][name] = step
    return steps, refused


def _known(
    model: Model, steps: Mapping[str, Mapping[str, CallableStep]], trials: Sequence[Trial]
) -> dict[str, dict[str, ErrorBound | None]]:
    """Return the proved error bound of each step, by trial and tuning. Trials
    with equal initial estimates share one proof, which takes long."""
    known: dict[str, dict[str, ErrorBound | None]] = {one.name: {} for one in trials}
    for name, step in steps[trials[0].name].items():
        begun: list[tuple[Mapping[str, float], ErrorBound | None]] = []
        for one in trials:
            start = one.first_estimate(step.observer.form)
            same = [earlier for other, earlier in begun if other == start]
            try:
                bound = same[0] if same else bound_of(steps[one.name][name], model)
            except NoSolver as missing:
                note(str(missing))
                bound = None
            known[one.name][name] = bound
            begun.append((start, bound))
    return known


def _admitted(names: list[str], refused: Mapping[str, HgogenError]) -> list[str]:
    admitted = [name for name in names if name not in refused]
    if not admitted:
        first, *others = refused
        note(*(f"{name} is refused as well: {refused[name]}" for name in others))
        raise refused[first]
    return admitted


def _names(model: Model, requested: str | None) -> list[str]:
    if requested is None and not model.tuning.tables:
        fix = model.fixes["tuning"].format(observer="high_gain", arguments="its gains")
        raise MissingPart(model.path, f"it has no tuning, whose observers are compared; add {fix}")
    names = list(model.tuning.tables) if requested is None else [name.strip() for name in requested.split(",")]
    if not all(names) or not names:
        raise MissingPart(model.path, "there is no observer to compare; give --observers A,B of its tuning")
    for name in names:
        if name not in model.tuning.tables and name not in every.__all__:
            model.tuned(name)  # raises an error that suggests names
    return list(dict.fromkeys(names))


def error_figure(each: Sequence[Measured], unit: str) -> "Figure":
    """Return the figure of the estimation errors of several observers on the first seed of a trial; `unit`: the unit of
    time."""
    from hgogen.run import figures as figure

    first = each[0].first
    of = {one.name: one.first.error for one in each}
    return figure.errors(each[0].states, first.truth.t, of, first.trial.events, unit)


def comparison_tables(
    title: str, each: Sequence[Measured], unit: str, estimate: Mapping[str, float], start: Mapping[str, float]
) -> RenderableType:
    """Return tables with a row for each observer. All observers began with the `estimate` of the plant's state (by
    name), while the true state was `start`."""
    states = list(each[0].rms)
    columns = (f"settled after each event ({unit})", "operations", "functions", "bytes of state")
    whole = headed(title, "observer", *columns, numbers=len(columns))
    for one in each:
        settled = ", ".join(map(time_cell, one.settled))
        whole.add_row(one.name, settled, *map(str, (one.cost.operations, one.cost.functions, one.cost.state)))
    rms = headed("steady error, root mean square", "observer", *states, numbers=len(states))
    peak = headed(
        "peaking: largest rise of the error after an event, over the state's range",
        "observer",
        *states,
        numbers=len(states),
    )
    for one in each:
        rms.add_row(one.name, *(f"{value:.3g}" for value in one.rms.values()))
        peak.add_row(one.name, *(f"{value:.2g}" for value in one.peak.values()))
    at = (", ".join(f"{name} = {value:g}" for name, value in values.items()) for values in (estimate, start))
    begun = "every observer starts at {}; the plant at {}".format(*at)
    notes = (begun, *_meanings(each, unit), *(f"{one.name}: {one.unproved}" for one in each if one.unproved))
    return Group(whole, "", rms, "", *_proved(each, states), peak, "", *map(Text, notes), "")


def _proved(each: Sequence[Measured], states: Sequence[str]) -> list[RenderableType]:
    if not any(one.proved or one.unproved for one in each):
        return []
    title = (
        "proved: a bound of the error once the initial error has decayed; then the largest error of all seeds "
        "after that"
    )
    table = headed(title, "observer", *states, numbers=len(states))
    for one in each:
        cells = []
        for bound, worst in ((one.proved.get(x), one.worst.get(x)) for x in states):
            largest = "-" if worst is None else f"{worst:.3g}"
            cells.append("-" if bound is None else f"{up(bound, 3)} ({largest})")
        table.add_row(one.name, *cells)
    return filled(table)


def _meanings(each: Sequence[Measured], unit: str) -> Iterable[str]:
    yield f"steady: from {each[0].first.trial.steady_from:g} {unit} on, the median of the seeds; peaking: of all seeds"
    yield "operations, functions (sine, exponential, root, ..): of one call; settled: the median of the seeds"
    methods: dict[str, list[str]] = {}
    for one in each:
        methods.setdefault(one.method, []).append(one.name)
    if len(methods) > 1:
        yield "; ".join(f"by {method}: {', '.join(names)}" for method, names in methods.items())
