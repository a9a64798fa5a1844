"""The command line: from a model file to an observer in C and in Python.

Exit status 0: done; 1: a hypothesis refuted that nobody accepted, C and Python (or C and its recorded vectors)
disagree, or a certificate is not verified; 2: wrong usage or bad input. Results go to the standard output, as tables
or, with --json, as JSON alone; everything else goes to the standard error stream.
"""

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

import hgogen as hg
from hgogen.call import CallableStep, Engine
from hgogen.commands import jobs, noise, tables
from hgogen.commands.agreement import Disagree
from hgogen.commands.checking import OptionalFile, check
from hgogen.commands.command import (
    Bar,
    Json,
    ModelArgument,
    OneTrial,
    Out,
    ReaderOption,
    Seeds,
    Tuned,
    app,
    command,
    engine_here,
    note,
    one_or_all,
    save_figures,
    show,
)
from hgogen.commands.comparing import compare
from hgogen.commands.prediction import predictions
from hgogen.commands.responding import response
from hgogen.emit import native
from hgogen.emit.cnames import renamed, says
from hgogen.model import Model, listed, load, summary
from hgogen.reading.record import Record, mapping, read
from hgogen.registry import summaries
from hgogen.signal import Signal
from hgogen.step import Step
from hgogen.targets.c99 import c99
from hgogen.trial import Trial


class Precision(StrEnum):
    """Working precision of the C."""

    FLOAT = "float"
    DOUBLE = "double"


Real = Annotated[Precision, typer.Option("--real", help="Working precision of the C.")]
Data = Annotated[Path, typer.Option("--data", help="The log, a CSV file with a header.")]
Time = Annotated[str | None, typer.Option("--time", help="The column of times, in the unit of the model's time.")]
Period = Annotated[float | None, typer.Option("--period", help="Seconds between rows, where no column has times.")]
Map = Annotated[
    list[str] | None, typer.Option("--map", metavar="SIGNAL=COLUMN", help="Which column is a signal; repeat it.")
]


def main() -> None:
    """The entry point of the command `hgogen`."""
    app()


def _tried(step: CallableStep, trials: tuple[Trial, ...], engine: Engine, count: int | None) -> list[jobs.Tried]:
    seeds = {trial.name: trial.seeds if count is None else tuple(range(count)) for trial in trials}
    language = {"c": "C", "python": "Python"}[engine]
    with Bar(f"trials in {language}", sum(map(len, seeds.values()))) as bar:
        return [jobs.tried(step, trial, engine, seeds[trial.name], bar.tick) for trial in trials]


def _folder(model: Model, observer: str | None) -> str:
    """The name of the folder of results: that of the model, and of the tuning where one is asked for."""
    return f"{model.name}_{observer}" if observer else model.name


def _made_by(name: str, observer: str | None, real: Precision) -> str:
    """The command that makes the same C, for its banner."""
    words = ["hgogen generate", name, *(["--observer", observer] if observer else [])]
    return " ".join([*words, *(["--real double"] if real is Precision.DOUBLE else [])])


@command()
def build(
    model: ModelArgument,
    observer: Tuned = None,
    out: Out = None,
    real: Real = Precision.FLOAT,
    seeds: Seeds = None,
    as_json: Json = False,
) -> None:
    """Check a model, generate and compile its C, try it in C and in Python, compare them, draw the figures.

    Everything lies in the folder --out, with report.json, which is what --json prints. Without a C compiler
    the trials run in Python, one seed each, and the C is written but not tried.

    JSON keys: model, plant, form, coordinates, flow, outputs, checks, refuted, theorem, notes (as in `check`), c_names
    (by signal, where C has another name), compiler, self_check (what it printed), trials (trial, criterion, seeds,
    engine, times, settled, worst, peak, calm, triggered, loud, latched, alarm_ratio, rms, clamped), comparison (trial,
    seed, until, before, after, settled, dt, agreed), files.
    """
    loaded = load(model)
    folder = out or Path("build") / _folder(loaded, observer)
    step, trials = loaded.step(observer), loaded.trials()
    claims = jobs.checked(loaded, name=observer)
    if not as_json:
        tables.console().print(tables.checks(claims.head, claims.checks, claims.accepted))
    for sentence in claims.notes:
        note(sentence)
    files = c99(step, real=real.value, command=_made_by(loaded.name, observer, real))
    _note_names(step)
    paths = hg.write(files, folder)
    engine = engine_here()
    self_check = native.run_check(files).strip() if engine == "c" else None
    done = _tried(step, trials, engine, seeds if engine == "c" else 1)
    again = _tried(step, trials, "python", 1) if engine == "c" else []
    comparison = jobs.agreements(done, again, step.dt) if again else ()
    paths += save_figures(jobs.figures(step, done), folder)
    summaries = jobs.summaries(step, done, engine, note)
    report = {
        "model": loaded.path,
        **claims.as_dict(),
        "c_names": renamed(step),
        "compiler": native.compiler(),
        "self_check": self_check,
        "trials": [one.as_dict() for one in summaries],
        "comparison": [one.as_dict() for one in comparison],
        "files": [str(path) for path in (*paths, folder / "report.json")],
    }
    paths += hg.write({"report.json": json.dumps(report, indent=2, allow_nan=False) + "\n"}, folder)
    shown = [tables.trials(summaries, step.time)]
    if again:
        shown += [tables.agreements(comparison, step.time), f"self-check of the {real.value} C: {self_check}\n"]
    show(as_json, report, *shown, tables.files(paths))
    if not all(one.agreed for one in comparison):
        raise Disagree(tuple(one for one in comparison if not one.agreed))


def _note_names(step: Step) -> None:
    """Say which signals have another name in C."""
    if said := says(step):
        note(f"in C {said}")


command(cls=OptionalFile)(check)
command()(compare)
command()(response)


@command("recheck")
def recheck_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A certificate that hgogen check wrote.")],
    as_json: Json = False,
) -> None:
    """Verify a certificate again, by other code and another arithmetic than those that wrote it.

    Exit status: 0 every claim that is said to be proved or refuted is verified, 1 one of them is not or there is none,
    2 the file is no certificate. The model's digest is that in the banner of its C; the file's digest is no signature.

    JSON keys: plant, form, observer (null without one), model (SHA-256 of these three), verified, claims (id, verdict,
    found: "verified", "open" where nothing is asserted, or "fails", sentence, boxes: how many intervals it took).
    """
    from hgogen.recheck import recheck

    found = recheck.recheck(recheck.load(file))
    show(as_json, found.as_dict(), tables.rechecked(found))
    found.demand()


@command()
def generate(
    models: Annotated[list[str], typer.Argument(metavar="MODEL...", help="Model files, or names in models/.")],
    observer: Tuned = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder that holds one folder a model.")] = Path("generated"),
    real: Real = Precision.FLOAT,
    as_json: Json = False,
) -> None:
    """Write the C of models, and the figures of their trials as that C draws them.

    JSON keys: models (a list of: model, c_names, by signal where C has another name, files).
    """
    written = []
    for given in models:
        loaded = load(given)
        for sentence in loaded.notes:
            note(sentence)
        step = loaded.step(observer)
        files = c99(step, real=real.value, command=_made_by(loaded.name, observer, real))
        _note_names(step)
        drawn = {}
        if loaded.has("trial"):
            drawn = jobs.figures(step, _tried(step, loaded.trials(), "c", 1))
        else:
            note(f"{loaded.path} defines no trial(), so there are no figures of it")
        folder = out / _folder(loaded, observer)
        paths = hg.write(files, folder) + save_figures(drawn, folder)
        written.append({"model": loaded.path, "c_names": renamed(step), "files": [str(path) for path in paths]})
    show(as_json, {"models": written}, *(tables.files(one["files"]) for one in written))


@command()
def simulate(
    model: ModelArgument,
    observer: Tuned = None,
    seeds: Seeds = None,
    reader: ReaderOption = None,
    trial: OneTrial = None,
    as_json: Json = False,
) -> None:
    """Try a model's observer on its trials and print the metrics.

    JSON keys: model, trials (trial, criterion: what settled means, seeds, engine, times of the events, settled and
    worst time to settle after each, peak of theta as [smallest, largest], calm: time until theta < 1.05, triggered:
    share of seeds, loud: share of the last fifth before the next event with theta > 1.5, latched: seeds in which theta
    does not come back, alarm_ratio: innovation at the largest theta over its threshold, rms by state, clamped: samples
    outside the box after the first 5%, each: the same by seed).
    """
    loaded = load(model)
    step, trials = loaded.step(observer), loaded.trials()
    chosen, engine = one_or_all(trials, trial), reader.value if reader else engine_here()
    done = _tried(step, chosen, engine, seeds)
    summaries = jobs.summaries(step, done, engine, note)
    pairs = zip(summaries, done, strict=True)
    listed_ = [{**told.as_dict(), "each": [seed.as_dict() for seed in one.each]} for told, one in pairs]
    show(as_json, {"model": loaded.path, "trials": listed_}, tables.trials(summaries, step.time))


@command()
def run(
    model: ModelArgument,
    data: Data,
    observer: Tuned = None,
    time: Time = None,
    period: Period = None,
    map_: Map = None,
    out: Out = None,
    horizon: Annotated[str, typer.Option(help="Samples ahead of the prediction errors, such as 1,5,25.")] = "1,5,25",
    as_json: Json = False,
) -> None:
    """Run a model's observer over a measured record: estimates as CSV, figures, and what was wrong with the
    record.

    JSON keys: model, engine, record (path, rows, samples, dt, period, columns, missing, not_numbers,
    covered, absent, malformed, untimed, out_of_order, duplicates, surplus, gaps, longest_gap, filled, shift,
    unit of time, notes), status (samples by status bit), predictions (output, ahead: samples or null for open
    loop, model, copying, count), files.
    """
    ahead = _horizons(horizon)
    loaded = load(model)
    step = loaded.step(observer)
    record = _record(step, data, time, period, map_, (*step.inputs, *step.outputs))
    u, y = record.of(step.inputs), record.of(step.outputs)
    engine = engine_here()
    done = step.run(u=u, y=y, engine=engine)
    errors = predictions(step, done.x, u, y, ahead)
    status = jobs.flagged(step, done.status)
    folder, name = out or Path("build") / _folder(loaded, observer), data.stem
    paths = hg.write({f"{name}_estimates.csv": jobs.estimates(step, record, done)}, folder)
    paths += save_figures(jobs.record_figures(step, name, record, done), folder)
    report = {
        "model": loaded.path,
        "engine": engine,
        "record": record.report.as_dict(),
        "status": status,
        "predictions": [one.as_dict() for one in errors],
        "files": [str(path) for path in (*paths, folder / f"{name}_report.json")],
    }
    paths += hg.write({f"{name}_report.json": json.dumps(report, indent=2, allow_nan=False) + "\n"}, folder)
    shown = (
        tables.report(record.report),
        tables.status(step.bits, status, len(y)),
        tables.predictions(errors, step.dt, step.time),
        tables.files(paths),
    )
    show(as_json, report, *shown)


def _horizons(text: str) -> tuple[int, ...]:
    try:
        ahead = tuple(int(part) for part in text.split(","))
    except ValueError:
        ahead = (0,)
    if min(ahead) < 1:
        raise typer.BadParameter(f"{text!r} must be positive whole numbers, such as 1,5,25", param_hint="--horizon")
    return ahead


def _record(
    step: CallableStep,
    data: Path,
    time: str | None,
    period: float | None,
    given: list[str] | None,
    signals: tuple[Signal, ...],
) -> Record:
    columns = mapping(str(data), given or (), step.inputs, step.outputs)
    wanted = {s.name: columns[s.name] for s in signals}
    return read(data, wanted, dt=step.dt, time=time, period=period, unit=step.time)


@command("noise")
def noise_(
    model: ModelArgument,
    data: Data,
    time: Time = None,
    period: Period = None,
    map_: Map = None,
    begin: Annotated[float | None, typer.Option("--from", help="Where the quiet part begins (s).")] = None,
    end: Annotated[float | None, typer.Option("--to", help="Where the quiet part ends (s).")] = None,
    d: Annotated[float | None, typer.Option("--window", help="Window d (s); by default the model's.")] = None,
    as_json: Json = False,
) -> None:
    """Suggest sigma, tau and the thresholds gamma_0, gamma_1 from a quiet record, in which the plant rests.

    JSON keys: model, record (as in `run`), noise (a list of: output, samples, sigma, tau, d, spread,
    gamma_0, gamma_1, R, notes).
    """
    loaded = load(model)
    step = loaded.step()
    d = d if d is not None else jobs.window(loaded, "--window")
    record = _record(step, data, time, period, map_, step.outputs)
    quiet = noise.quiet(record.t, begin, end)
    found = [noise.suggest(s.name, record.of([s])[quiet, 0], step.dt, d) for s in step.outputs]
    value = {"model": loaded.path, "record": record.report.as_dict(), "noise": [one.as_dict() for one in found]}
    show(as_json, value, tables.report(record.report), *(tables.suggestion(one, step.time) for one in found))


@command()
def window(
    model: ModelArgument,
    lengths: Annotated[str, typer.Option("--d", help="Windows d (s), such as 0.5,1,2.")] = "",
    trial: Annotated[str | None, typer.Option(help="The trial of this name; by default the first.")] = None,
    as_json: Json = False,
) -> None:
    """Tell how well windows d of the innovation show the state along a trial: the observability Gramian of each.

    By default half of the model's window d, itself, twice and four times it, as far as the trial is long.

    JSON keys: model, trial, windows (d, least, median and most of the Gramian's smallest eigenvalue, weakest: the state
    with the largest share of the direction that shows least, share).
    """
    loaded = load(model)
    chosen = next((one for one in loaded.trials() if trial in (None, one.name)), None)
    if chosen is None:
        raise typer.BadParameter(f"{trial!r} is none of the model's trials", param_hint="--trial")
    given = _lengths(lengths) if lengths else _about(jobs.window(loaded, "--d"), chosen.duration)
    found = hg.gramian(loaded.plant, chosen, given)
    value = {"model": loaded.path, "trial": chosen.name, "windows": [one.as_dict() for one in found]}
    show(as_json, value, tables.windows(chosen.name, found, loaded.plant.time))


def _about(d: float, duration: float) -> tuple[float, ...]:
    return tuple(d * k for k in (0.5, 1.0, 2.0, 4.0) if d * k <= duration)


def _lengths(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{text!r} must be times, such as 0.5,1,2", param_hint="--d") from None


@command("list")
def list_(as_json: Json = False) -> None:
    """List the models found in models/, and the forms, observers, methods and targets there are.

    JSON keys: models (paths), forms, observers, methods, targets (names), summaries (of each: what it is in one line).
    """
    kinds = ("forms", "observers", "methods", "targets")
    cases = {kind: summaries(f"hgogen.{kind}", getattr(hg, kind).__all__) for kind in kinds}
    told = {"models": {path: summary(path) for path in listed()}, **cases}
    show(as_json, {**{kind: list(found) for kind, found in told.items()}, "summaries": told}, tables.listed(told))


if __name__ == "__main__":
    main()
