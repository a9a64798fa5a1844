"""The commands `run` and `noise`: a measured record, and what a quiet one says of noise."""

import csv
import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

import numpy as np
import typer

from hgogen.call import CallableStep
from hgogen.calling.samples import Engine, Run
from hgogen.commands import drawings, log_tables, tables
from hgogen.commands.command import (
    Bar,
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
from hgogen.commands.headed import file_list
from hgogen.commands.logs import Shift, Truth, horizons, numbers_by_name, too_far, truth_name, truth_of, truth_options
from hgogen.identification.records import Log, beyond
from hgogen.model import MissingPart, Model, load
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.reading.averaged import WINDOWS
from hgogen.reading.differences import derived
from hgogen.reading.filename import fault
from hgogen.reading.mapped import mapping, shifts_of
from hgogen.reading.measured import COMMAND, Record, read
from hgogen.signal import Signal
from hgogen.trials import noise
from hgogen.trials.agreement import Difference, coarse, differences
from hgogen.trials.consistency import consistency, no_better
from hgogen.trials.incidents import before_loss, interventions, loss
from hgogen.trials.prediction import predictions, rejected, rms
from hgogen.trials.rejected import MostlyRejected, better, clamped, rejections

Data = Annotated[Path, typer.Option("--data", help="The log, a CSV file with a header, a Parquet or a MAT file.")]
Time = Annotated[str | None, typer.Option("--time", help="The column of times, in the unit of the model's time.")]
Period = Annotated[
    float | None,
    typer.Option("--period", help="The time between rows, in the unit of the model's time, where no column has times."),
]
Map = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="SIGNAL=COLUMN",
        help="Which column is a signal, or what of columns, such as y='T1 + 273.15' or i='-[I (A)]'; repeat it.",
    ),
]


ROUNDING = 1e-12  # of a time over a period
PIECE = 10_000  # rows of CSV text at once, whose cells take some ten times as much memory as their text
_NAN = re.compile("nan")
STAGES = 5  # of `run` until the figures, besides a sample ahead of each prediction


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
    truth: Truth = None,
    shift: Shift = None,
    initial: Annotated[
        str | None,
        typer.Option(
            metavar="x=1,v=0", help="The plant's state at the first row; by default the observer's own start."
        ),
    ] = None,
    burn_in: Annotated[
        float, typer.Option(min=0.0, help="The time at the beginning that no error counts, in the model's time.")
    ] = 0.0,
    as_json: Json = False,
) -> None:
    """Run a model's observer over a measured record: estimates as CSV, figures, and what was wrong with the
    record.

    The estimate starts from --initial, by default with what the first samples show of the states, the others where the
    observer does.

    JSON keys: model, engine, record (path, rows, samples, dt, period, columns, missing, not_numbers, covered, absent,
    malformed, untimed, out_of_order, duplicates, surplus, gaps, longest_gap, filled, shift, unit of time, notes),
    status (samples by status bit), acted (as in `simulate`), initial (states that the first samples or --initial give),
    predictions (output, ahead: samples or null for open loop, model, copying, count: samples compared, rejected:
    samples that the observer rejected, which are not), hidden (RMS error of the estimate by state, where --truth gives
    it), innovations (by output: count, rms; nis, the mean of e^2/s, with the ends of its 95 % band, outside, the share
    beyond 2 sigma, null without a covariance; whiteness: test, statistic, limit, lags, white), nees (states, count,
    alike: how many errors tell as much as one, nees, band; null without truth or covariance), rejected (outputs most of
    whose samples the observer rejects, for which the exit status is 1: output, count, share, values: the middle nine in
    ten, range, map: what makes it fit, mends), better (another shift or sign of one signal with which predictions err
    clearly less, or null: signal, shift in samples, sign, error over that of copying, present), real, from_double (with
    --real float, by state: the largest difference from the same run in double, its time t, its share of scale, the
    width of the range or the peak; status: samples whose status differs), notes, files.
    """
    ahead = horizons(horizon, "--horizon")
    with Bar("reading the log", STAGES + max(ahead)) as bar:
        loaded = _timed(load(model).set(setting), data, time, period)
        folder, name = folder_of(out, loaded, observer), "record" if fault(data.stem) else data.stem
        folder.demand(f"{name}_report.json")
        step = loaded.step(observer)
        true = truth_of(loaded.plant, truth or ())
        record = _record(step, data, time, period, map_, (*step.inputs, *step.samples), true)
        shifts = shifts_of(str(data), shift or (), step.inputs, step.outputs)
        record = record.shifted(
            shifts | {age.name: shifts.get(y.name, 0) for y, age in zip(step.late, step.ages, strict=True)}
        )
        bar.tick("running the observer")
        u, samples = record.of(step.inputs), record.of(step.samples)
        y = step.in_time(samples)
        engine = engine_here()
        step, begins = _begun(step, y, initial)
        done = step.run(u=u, y=samples, engine=engine)
        counted = _counted(step, burn_in, len(y))
        bar.tick("predictions")
        judge, judged = _judged(step, done, u, y, engine)
        there = np.where(np.arange(len(y))[:, None] < before_loss(done), y, np.nan)
        errors = predictions(judge, judged.since(counted), u[counted:], there[counted:], ahead, bar.tick)
        measured = {state: record.values[:, record.names.index(name)] for state, (name, _) in true.items()}
        hidden = {state: _rms((done[state] - values)[counted:]) for state, values in measured.items()}
        bar.tick("innovations")
        sure = consistency(done.since(counted), {state: values[counted:] for state, values in measured.items()})
        wrong = rejections(judge, judged, u, y, record.operands, engine)
        single = _from_double(step, done, u, samples, engine)
        bar.tick("other shifts and signs")
        other = None if wrong else better(judge, u, y, counted, engine)
        notes = [
            *loss(step, done, record.t, u, y),
            *clamped(step, u, record.operands),
            *beyond(loaded.plant, Log(u, np.where(rejected(judge, judged, y), np.nan, y), step.dt)),
            *no_better(errors),
            *sure.sentences(),
            *coarse(single, step.time),
        ]
    acted = interventions(step, done.status, record.t)
    if acted:
        notes.append(f"the law of recovery acted: {acted.sentence(step.time)}")
    notes += too_far(ahead, [one.ahead for one in errors])
    if other:
        notes.append(other.sentence(shifts.get(other.signal, 0), record.operands[other.signal]))
    status = _flagged(step, done.status)
    files: dict[str, str | bytes] = {f"{name}_estimates.csv": _estimates(step, record, done)}
    files |= {f"{name}_innovations.csv": _innovations(step, record, done)}
    files |= rendered(drawings.record_figures(step, name, _drawn(step, record, y), done, measured))
    paths = folder.demand(*files, f"{name}_report.json")
    report = {
        "model": loaded.path,
        "engine": engine,
        "record": record.report,
        "status": status,
        "acted": acted,
        "initial": begins,
        "predictions": errors,
        "hidden": hidden,
        "innovations": sure.outputs,
        "nees": sure.states,
        "real": step.real,
        "better": other,
        "rejected": wrong,
        "from_double": single,
        "notes": notes,
        "files": list(map(str, paths)),
    }
    folder.write({**files, f"{name}_report.json": json_text(report) + "\n"})
    shown = (
        log_tables.report(record.report, begins),
        tables.status(step, status, len(y)),
        log_tables.predictions(errors, step.dt, step.time),
        *log_tables.hidden(hidden, step.states),
        *log_tables.from_double(single, step.time),
        log_tables.consistent(sure, notes),
        file_list(paths),
    )
    show(as_json, report, *shown)
    if wrong:
        raise MostlyRejected(wrong)


def _judged(step: CallableStep, done: Run, u: np.ndarray, y: np.ndarray, engine: Engine) -> tuple[CallableStep, Run]:
    """The step and its run by which the record is judged in the order of time: of a step for late samples that without
    delays, with the estimates of the run."""
    if not step.ages:
        return step, done
    return step.undelayed, replace(done, status=step.undelayed.run(u=u, y=y, engine=engine).status)


def _drawn(step: CallableStep, record: Record, y: np.ndarray) -> Record:
    """The record with its samples y (N, p) in the order of time, beside the estimates of which figures show them."""
    values = record.values.copy()
    values[:, [record.names.index(signal.name) for signal in step.outputs]] = y
    return replace(record, values=values)


def _from_double(
    step: CallableStep, done: Run, u: np.ndarray, samples: np.ndarray, engine: Engine
) -> tuple[Difference, ...]:
    """How far a run in float is from the same in double; nothing of one in double."""
    if step.real == "double":
        return ()
    return differences(step.states, done, step.made_again(real="double").run(u=u, y=samples, engine=engine))


def _begun(step: CallableStep, y: np.ndarray, initial: str | None) -> tuple[CallableStep, dict[str, float]]:
    """The step that starts there, and what it takes from the text or, by default, from the first samples of the
    states that are outputs, within their ranges."""
    if initial is not None:
        values = numbers_by_name([initial], "--initial")
        return step.started(values), values
    plant, shown = step.observer.form.system.declared, {}
    for output, column in zip(plant.output, y.T, strict=True):
        there = np.flatnonzero(np.isfinite(column))
        if output in plant.states and len(there):
            state = plant.states[plant.states.index(output)]
            shown[state.name] = float(np.clip(column[there[0]], *state.interval))
    return (step.started({**step.observer.initial, **shown}), shown) if shown else (step, {})


def _counted(step: CallableStep, burn_in: float, samples: int) -> int:
    """The first sample whose errors count. Raises: `typer.BadParameter`."""
    first = burn_in / step.dt * (1 - ROUNDING)
    if not first <= samples - 2:  # not a number neither
        reason = f"{burn_in:g} {step.time} leaves nothing of a record of {samples * step.dt:g} {step.time}"
        raise typer.BadParameter(reason, param_hint="--burn-in")
    return math.ceil(first)


def _rms(errors: np.ndarray) -> float | None:
    """None where nothing was measured."""
    there = errors[np.isfinite(errors)]
    return rms(there) if len(there) else None


def _timed(model: Model, data: Path, time: str | None, period: float | None) -> Model:
    """The model, of one that says no period that of the record, to which starting gains are made."""
    if model.has("step") or model.setting.dt is not None:
        return model
    clock = read(data, {}, dt=None, time=time, period=period, unit=model.plant.time)
    return model.sampled(clock.report.dt)


def _record(
    step: CallableStep,
    data: Path,
    time: str | None,
    period: float | None,
    pairs: list[str] | None,
    signals: tuple[Signal, ...],
    true: Mapping[str, tuple[str, str]] = MappingProxyType({}),
) -> Record:
    columns = mapping(str(data), pairs or (), step.inputs, step.samples)
    wanted = {**{s.name: columns[s.name] for s in signals}, **dict(true.values())}
    inputs = {s.name: WINDOWS[step.clock.between] for s in step.inputs}
    units = {s.name: s.unit for s in signals} | {truth_name(x.name): x.unit for x in step.states}
    return read(
        data,
        wanted,
        dt=step.dt,
        time=time,
        period=period,
        unit=step.time,
        caller=replace(COMMAND, others=truth_options(true)),
        inputs=inputs,
        units=units,
        rates=derived(step.inputs),
    )


def _estimates(step: CallableStep, record: Record, run: Run) -> str:
    """The estimates as CSV text: time, what was measured, the estimated states, traces, status; empty where
    missing."""
    measured = [f"{s.name}_measured" if s.name in run.names else s.name for s in step.outputs]
    numbers = np.column_stack([record.t, record.of(step.outputs), run.x, *run.traces.values()])
    return _csv(["t", *measured, *run.names, *run.traces, "status"], numbers, run.status)


def _innovations(step: CallableStep, record: Record, run: Run) -> str:
    """Innovations of the outputs and their variances as CSV text, and the lower triangle of the estimate's covariance
    by columns, P_i_j of states i and j; without variances of an observer that holds none."""
    assert run.innovations is not None  # of a step
    header, columns = ["t", *(f"e_{s.name}" for s in step.outputs)], [record.t, run.innovations]
    if run.variances is not None and run.covariance is not None:
        pairs = [(i, j) for j in range(len(run.names)) for i in range(j, len(run.names))]
        header += [f"s_{s.name}" for s in step.outputs] + [f"P_{run.names[i]}_{run.names[j]}" for i, j in pairs]
        columns += [run.variances, *(run.covariance[:, i, j] for i, j in pairs)]
    return _csv(header, np.column_stack(columns))


def _csv(header: Sequence[str], numbers: np.ndarray, status: np.ndarray | None = None) -> str:
    """Rows of numbers as CSV text, empty for NaN; a status behind each."""
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerow(header)
    cells = ",".join(["%.10g"] * numbers.shape[1])
    pattern = f"{cells},%d\n" if status is not None else f"{cells}\n"
    missing = np.isnan(numbers).any(axis=1)
    columns = [*numbers.T, *([] if status is None else [status])]
    for first in range(0, len(numbers), PIECE):
        rows = zip(*(column[first : first + PIECE].tolist() for column in columns), strict=True)
        text = "".join([pattern % row for row in rows])
        stream.write(_NAN.sub("", text) if missing[first : first + PIECE].any() else text)
    return stream.getvalue()


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
    loaded = _timed(load(model).set(setting), data, time, period)
    step = loaded.step(observer)
    d = d if d is not None else innovation_window(loaded, "--window", observer)
    record = _record(step, data, time, period, map_, step.outputs)
    quiet = noise.quiet(record.t, begin, end, step.time)
    suggestions = [noise.suggest(s.name, record.of([s])[quiet, 0], step.dt, d, step.time) for s in step.outputs]
    value = {"model": loaded.path, "record": record.report, "noise": suggestions}
    show(
        as_json,
        value,
        log_tables.report(record.report),
        *(log_tables.suggestion(one, step.time) for one in suggestions),
    )


def _flagged(step: CallableStep, status: np.ndarray) -> dict[str, int]:
    """In how many samples each status bit was raised; only those that were."""
    one, bits = step.layout.word.type(1), step.layout.bits
    counts = {bit.name: int(np.count_nonzero(status & (one << k))) for k, bit in enumerate(bits)}
    return {name: count for name, count in counts.items() if count}


def innovation_window(model: Model, option: str, observer: str | None = None) -> float:
    """The innovation's window d (s) in a tuning of a model, by default the first that has one; `option` is the
    command's that gives another.

    Raises: `MissingPart` if no adaptive theta is there, or no tuning of that name.
    """
    tuning = model.tuning if observer is None else model.tuned(observer)
    for name in tuning.tables if observer is None else (observer,):
        innovation = getattr(tuning.gains(name).get("theta"), "innovation", None)
        if innovation is not None:
            return float(innovation.d)
    reason = f"its tuning has no adaptive theta, whose window would be the default; give one by {option}"
    raise MissingPart(model.path, reason)
