"""The command `compare`: several observers of one model over its trials, on the same noise."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import typer

from hgogen import observers as every
from hgogen.call import CallableStep
from hgogen.certificates.error_bound import ErrorBound
from hgogen.commands import drawings, log_tables, stated_bounds, tables, trial_runs
from hgogen.commands.campaigning import campaigns
from hgogen.commands.command import (
    NO_RUNS,
    Bar,
    Json,
    ModelArgument,
    OneTrial,
    Out,
    ReaderOption,
    Runs,
    Seeds,
    command,
    engine_here,
    folder_of,
    one_or_all,
    rendered,
    show,
)
from hgogen.commands.headed import file_list
from hgogen.commands.process import note
from hgogen.errors import HgogenError
from hgogen.guarantees.lmi import NoSolver
from hgogen.model import MissingPart, Model, load
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.system import System
from hgogen.trial import Trial
from hgogen.trials.comparison import Measured, measured
from hgogen.trials.incidents import guard_notes as guards
from hgogen.trials.incidents import leaving_notes, left
from hgogen.trials.metrics import criterion

Names = Annotated[
    str | None,
    typer.Option("--observers", "--observer", metavar="A,B,..", help="Tunings of the model, or observers."),
]


@command()
def compare_(
    model: ModelArgument,
    observers: Names = None,
    setting: Setting = AS_WRITTEN,
    seeds: Seeds = None,
    trial: OneTrial = None,
    reader: ReaderOption = None,
    asked: Runs = NO_RUNS,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Try several observers of a model on its trials, each on the same noise, at the same sampling period, the shortest
    of theirs, and from the same estimate of the plant's state, the trial's `estimate`, else the nominal values; print
    convergence, steady error, peaking and cost side by side, and draw the errors. One that is refused is named with the
    reason, and the others are compared.

    Settled: the median of the seeds. Steady: over the trial's own steady part, else its last tenth, the median of the
    seeds. Peaking: how far the error rises above what it is at the start or at a jump, of all seeds, over the state's
    range. Functions: sine, exponential, root and such, of one call. Of a model that says how large noise and the like
    are at most, beside it what is proved of each error, or why nothing is.

    JSON keys: model, dt, engine, trials (trial, seeds, criterion: what settled means, times of the events, estimate and
    start: the states that all observers and that the plant begin with, left: as in `simulate`, observers: a list of
    name, observer, method, settled after each event, rms and peak by state, clamped, acted as in `simulate`,
    operations, functions, state and params in bytes of the C in float, proved: the bounds by state, worst: by state the
    largest error of all seeds from when on these hold, null where the trial ends before, unproved: what is not known of
    them, and why), refused (why, by observer), files; of a campaign, with --vary or --runs, model, dt, engine,
    campaigns (as in `simulate`), refused.
    """
    loaded = load(model).set(setting)
    folder = folder_of(out, loaded)
    names = _names(loaded, observers)
    chosen, engine = one_or_all(trial_runs.trials(loaded), trial), engine_here(reader)
    if not asked:
        folder.demand(*(f"{one.name}_errors.svg" for one in chosen))
    steps, refused = _started(loaded, names, chosen)
    names = _admitted(names, refused)
    first = steps[chosen[0].name]
    unit, dt = loaded.plant.time, min(step.dt for step in first.values())
    longer = [name for name, step in first.items() if step.dt > dt]
    if longer:
        note(f"all sampled at dt = {dt:g} {unit}, the shortest; {', '.join(longer)} would be sampled more slowly")
        again, slow = _started(loaded, longer, chosen, dt)
        refused |= slow
        names = _admitted(names, slow)
        steps = {trial: {name: (each | again[trial])[name] for name in names} for trial, each in steps.items()}
    reasons = {name: str(error) for name, error in refused.items()}
    without = log_tables.without(reasons, "refused, and not compared")
    if asked:
        rows, tables_ = campaigns(lambda one: steps[one.name], chosen, engine, asked, seeds)
        campaign = {"model": loaded.path, "dt": dt, "engine": engine, "campaigns": rows, "refused": reasons}
        show(as_json, campaign, *tables_, *without)
        return
    counts = {one.name: one.seeds if seeds is None else tuple(range(seeds)) for one in chosen}
    known = _known(loaded, steps, chosen)
    tried: list[tuple[Trial, list[Measured]]] = []
    with Bar("trials", len(names) * sum(map(len, counts.values()))) as bar:
        for one in chosen:
            asked_of = engine, counts[one.name], bar.tick
            each = [(*pair, known[one.name][pair[0]]) for pair in steps[one.name].items()]
            tried.append((one, [measured(name, step, one, *asked_of, bound) for name, step, bound in each]))
            if one.first_state(loaded.plant) == {name: float(value) for name, value in one.start.items()}:
                note(
                    f"trial {one.name}: every observer starts on the truth, so that its first time to settle says "
                    "nothing; give the trial an estimate"
                )
            # all observers share the truth
            note(*leaving_notes(one.name, left(loaded.plant, tried[-1][1][0].first), unit))
            for row in tried[-1][1]:
                note(*guards(one.name, row.name, row.acted, bool(one.jumps), unit))
    paths = folder.write(rendered({f"{one.name}_errors": drawings.errors(each, unit) for one, each in tried}))
    shown = [
        tables.compared(
            f"trial {one.name}, seeds {len(counts[one.name])}, settled: {criterion(one, unit)}",
            each,
            unit,
            *(one.first_state(loaded.plant), one.start),
        )
        for one, each in tried
    ]
    report = {
        "model": loaded.path,
        "dt": dt,
        "engine": engine,
        "trials": [_row(loaded.plant, one, len(counts[one.name]), each) for one, each in tried],
        "refused": reasons,
        "files": [str(path) for path in paths],
    }
    show(as_json, report, *shown, *without, file_list(paths))


def _started(
    model: Model, names: list[str], trials: Sequence[Trial], dt: float | None = None
) -> tuple[dict[str, dict[str, CallableStep]], dict[str, HgogenError]]:
    """Of each trial the steps of tunings, all from its first estimate; and why the others are refused."""
    steps: dict[str, dict[str, CallableStep]] = {one.name: {} for one in trials}
    refused: dict[str, HgogenError] = {}
    for name in names:
        try:
            made = {one.name: model.step(name, dt, one.first_estimate) for one in trials}
        except HgogenError as error:
            refused[name] = error
        else:
            for trial, step in made.items():
                steps[trial][name] = step
    return steps, refused


def _known(
    model: Model, steps: Mapping[str, Mapping[str, CallableStep]], trials: Sequence[Trial]
) -> dict[str, dict[str, ErrorBound | None]]:
    """Of each trial what is proved of the errors of its steps, once for all trials that begin alike; None where the
    model does not ask."""
    known: dict[str, dict[str, ErrorBound | None]] = {one.name: {} for one in trials}
    for name, step in steps[trials[0].name].items():
        begun: list[tuple[Mapping[str, float], ErrorBound | None]] = []
        for one in trials:
            start = one.first_estimate(step.observer.form)
            same = [earlier for other, earlier in begun if other == start]
            try:
                bound = same[0] if same else stated_bounds.bound_of(steps[one.name][name], model)
            except NoSolver as missing:
                note(str(missing))
                bound = None
            known[one.name][name] = bound
            begun.append((start, bound))
    return known


def _admitted(names: list[str], refused: Mapping[str, HgogenError]) -> list[str]:
    """The names without those that are refused. Raises: `HgogenError` of the first, where all are."""
    admitted = [name for name in names if name not in refused]
    if not admitted:
        first, *others = refused
        note(*(f"{name} is refused as well: {refused[name]}" for name in others))
        raise refused[first]
    return admitted


def _row(plant: System, trial: Trial, seeds: int, each: list[Measured]) -> dict[str, Any]:
    row = {"trial": trial.name, "seeds": seeds, "criterion": criterion(trial, plant.time), "times": list(trial.events)}
    row |= {"estimate": trial.first_state(plant), "start": dict(trial.start)}
    return {**row, "left": left(plant, each[0].first), "observers": each}


def _names(model: Model, asked: str | None) -> list[str]:
    """The tunings asked for, each once. Raises: `MissingPart`."""
    if asked is None and not model.tuning.tables:
        fix = model.fixes["tuning"].format(observer="high_gain", arguments="its gains")
        raise MissingPart(model.path, f"it has no tuning, whose observers are compared; add {fix}")
    names = list(model.tuning.tables) if asked is None else [name.strip() for name in asked.split(",")]
    if not all(names) or not names:
        raise MissingPart(model.path, "there is no observer to compare; give --observers A,B of its tuning")
    for name in names:
        if name not in model.tuning.tables and name not in every.__all__:
            model.tuned(name)  # says what it may have been
    return list(dict.fromkeys(names))
