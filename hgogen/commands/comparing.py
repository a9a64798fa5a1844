"""The command `compare`: several observers of one model over its trials, on the same noise."""

from typing import Annotated, Any

import typer

from hgogen.call import CallableStep
from hgogen.commands import jobs, tables
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
from hgogen.model import MissingPart, Model, load
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.system import System
from hgogen.trial import Trial
from hgogen.trials.comparison import Measured, measured
from hgogen.trials.leaving import Left, left, notes
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
    convergence, steady error, peaking and cost side by side, and draw the errors.

    Settled: the median of the seeds. Steady: over the trial's own steady part, else its last tenth, the median of the
    seeds. Peaking: how far the error rises above what it is at the start or at a jump, of all seeds, over the state's
    range. Functions: sine, exponential, root and such, of one call.

    JSON keys: model, dt, engine, trials (trial, seeds, criterion: what settled means, times of the events, estimate and
    start: the states that all observers and that the plant begin with, left: as in `simulate`,
    observers: a list of name, observer, method,
    settled after each event, rms and peak by state, clamped, operations, functions, state and params in bytes of the C
    in float), files; of a campaign, with --vary or --runs, model, dt, engine, campaigns (as in `simulate`).
    """
    loaded = load(model).set(setting)
    folder = folder_of(out, loaded)
    names = _names(loaded, observers)
    chosen, engine = one_or_all(jobs.trials(loaded), trial), engine_here(reader)
    if not asked:
        folder.demand(*(f"{one.name}_errors.svg" for one in chosen))
    steps = {one.name: _started(loaded, names, one) for one in chosen}
    first = steps[chosen[0].name]
    unit, dt = loaded.plant.time, min(step.dt for step in first.values())
    longer = [name for name, step in first.items() if step.dt > dt]
    if longer:
        note(f"all sampled at dt = {dt:g} {unit}, the shortest; {', '.join(longer)} would be sampled more slowly")
        for one in chosen:
            steps[one.name] |= _started(loaded, longer, one, dt)
    if asked:
        rows, tables_ = campaigns(lambda one: steps[one.name], chosen, engine, asked, seeds)
        show(as_json, {"model": loaded.path, "dt": dt, "engine": engine, "campaigns": rows}, *tables_)
        return
    counts = {one.name: one.seeds if seeds is None else tuple(range(seeds)) for one in chosen}
    tried: list[tuple[Trial, list[Measured]]] = []
    with Bar("trials", len(names) * sum(map(len, counts.values()))) as bar:
        for one in chosen:
            each = steps[one.name].items()
            tried.append((one, [measured(name, step, one, engine, counts[one.name], bar.tick) for name, step in each]))
            _note_no_error(loaded.plant, one)
            note(*notes(one.name, _left(loaded.plant, tried[-1][1]), unit))
    paths = folder.write(rendered({f"{one.name}_errors": jobs.errors(each, unit) for one, each in tried}))
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
        "files": [str(path) for path in paths],
    }
    show(as_json, report, *shown, file_list(paths))


def _started(model: Model, names: list[str], trial: Trial, dt: float | None = None) -> dict[str, CallableStep]:
    """The steps of tunings, all from the first estimate of a trial."""
    return {name: model.step(name, dt, trial.first_estimate) for name in names}


def _note_no_error(plant: System, trial: Trial) -> None:
    """Say so where there is no error to settle at the start."""
    if trial.first_state(plant) == {name: float(value) for name, value in trial.start.items()}:
        note(
            f"trial {trial.name}: every observer starts on the truth, so that its first time to settle says nothing; "
            "give the trial an estimate"
        )


def _left(plant: System, each: list[Measured]) -> tuple[Left, ...]:
    """Where the plant leaves its ranges, whose truth all observers share."""
    return left(plant, each[0].first)


def _row(plant: System, trial: Trial, seeds: int, each: list[Measured]) -> dict[str, Any]:
    row = {"trial": trial.name, "seeds": seeds, "criterion": criterion(trial, plant.time), "times": list(trial.events)}
    row |= {"estimate": trial.first_state(plant), "start": dict(trial.start)}
    row |= {"left": [one.as_dict() for one in _left(plant, each)]}
    return {**row, "observers": [one.as_dict() for one in each]}


def _names(model: Model, asked: str | None) -> list[str]:
    """The tunings asked for, each once. Raises: `MissingPart`."""
    if asked is None and not model.tuning.tables:
        fix = model.fixes["tuning"].format(observer="high_gain", arguments="its gains")
        raise MissingPart(model.path, "tuning", f"it has no tuning, whose observers are compared; add {fix}")
    names = list(model.tuning.tables) if asked is None else [name.strip() for name in asked.split(",")]
    if not all(names) or not names:
        raise MissingPart(model.path, "tuning", "there is no observer to compare; give --observers A,B of its tuning")
    return list(dict.fromkeys(names))
