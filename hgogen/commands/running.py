"""The commands `run` and `noise`: a measured record, and what a quiet one says of noise."""

from pathlib import Path
from typing import Annotated

import typer

from hgogen.call import CallableStep
from hgogen.commands import jobs, log_tables, tables
from hgogen.commands.command import (
    Json,
    ModelArgument,
    Out,
    Tuned,
    command,
    engine_here,
    folder_of,
    json_text,
    rendered,
    show,
)
from hgogen.commands.logs import horizons
from hgogen.model import load
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.reading.filename import fault
from hgogen.reading.measured import Record, mapping, read
from hgogen.signal import Signal
from hgogen.trials import noise
from hgogen.trials.prediction import predictions

Data = Annotated[Path, typer.Option("--data", help="The log, a CSV file with a header.")]
Time = Annotated[str | None, typer.Option("--time", help="The column of times, in the unit of the model's time.")]
Period = Annotated[
    float | None,
    typer.Option("--period", help="The time between rows, in the unit of the model's time, where no column has times."),
]
Map = Annotated[
    list[str] | None, typer.Option("--map", metavar="SIGNAL=COLUMN", help="Which column is a signal; repeat it.")
]


@command()
def run_(
    model: ModelArgument,
    data: Data,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
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
    loop, model, copying, count: samples compared, rejected: samples that the observer rejected, which are not), files.
    """
    ahead = horizons(horizon, "--horizon")
    loaded = load(model).set(setting)
    folder, name = folder_of(out, loaded, observer), "record" if fault(data.stem) else data.stem
    folder.demand(f"{name}_report.json")
    step = loaded.step(observer)
    record = _record(step, data, time, period, map_, (*step.inputs, *step.outputs))
    u, y = record.of(step.inputs), record.of(step.outputs)
    engine = engine_here()
    done = step.run(u=u, y=y, engine=engine)
    errors = predictions(step, done, u, y, ahead)
    status = jobs.flagged(step, done.status)
    files: dict[str, str | bytes] = {f"{name}_estimates.csv": jobs.estimates(step, record, done)}
    files |= rendered(jobs.record_figures(step, name, record, done))
    paths = folder.demand(*files, f"{name}_report.json")
    report = {
        "model": loaded.path,
        "engine": engine,
        "record": record.report.as_dict(),
        "status": status,
        "predictions": [one.as_dict() for one in errors],
        "files": list(map(str, paths)),
    }
    folder.write({**files, f"{name}_report.json": json_text(report) + "\n"})
    shown = (
        log_tables.report(record.report),
        tables.status(step.bits, status, len(y)),
        log_tables.predictions(errors, step.dt, step.time),
        tables.files(paths),
    )
    show(as_json, report, *shown)


def _record(
    step: CallableStep,
    data: Path,
    time: str | None,
    period: float | None,
    pairs: list[str] | None,
    signals: tuple[Signal, ...],
) -> Record:
    columns = mapping(str(data), pairs or (), step.inputs, step.outputs)
    wanted = {s.name: columns[s.name] for s in signals}
    return read(data, wanted, dt=step.dt, time=time, period=period, unit=step.time)


@command()
def noise_(
    model: ModelArgument,
    data: Data,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    time: Time = None,
    period: Period = None,
    map_: Map = None,
    begin: Annotated[
        float | None, typer.Option("--from", help="Where the quiet part begins, in the model's time.")
    ] = None,
    end: Annotated[float | None, typer.Option("--to", help="Where the quiet part ends, in the model's time.")] = None,
    d: Annotated[
        float | None, typer.Option("--window", help="Window d, in the model's time; by default the model's.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Suggest sigma, tau and the thresholds gamma_0, gamma_1 from a quiet record, in which the plant rests.

    JSON keys: model, record (as in `run`), noise (a list of: output, samples, sigma, tau, d, spread,
    gamma_0, gamma_1, R, notes).
    """
    loaded = load(model).set(setting)
    step = loaded.step(observer)
    d = d if d is not None else jobs.window(loaded, "--window", observer)
    record = _record(step, data, time, period, map_, step.outputs)
    quiet = noise.quiet(record.t, begin, end, step.time)
    suggestions = [noise.suggest(s.name, record.of([s])[quiet, 0], step.dt, d, step.time) for s in step.outputs]
    value = {"model": loaded.path, "record": record.report.as_dict(), "noise": [one.as_dict() for one in suggestions]}
    show(
        as_json,
        value,
        log_tables.report(record.report),
        *(log_tables.suggestion(one, step.time) for one in suggestions),
    )
