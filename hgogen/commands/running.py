"""The commands `run`, `inspect`, `noise` and `window`: an observer on a measured log, the faults of a log, the noise of
a resting plant's log, and the observability of windows.
"""

import csv
import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.console import Group, RenderableType
from rich.text import Text

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.commands.command import (
    NO_COLUMNS,
    Columns,
    ModelArgument,
    ModelReport,
    Out,
    Shift,
    Truth,
    Tuned,
    command,
    engine_here,
    horizons,
    numbers_by_name,
    numbers_in,
    one_or_all,
)
from hgogen.commands.data import (
    Begin,
    fault_lines,
    faulty_signals,
    judging_observer,
    log_findings,
    log_summary,
    too_far,
    truth_name,
    truth_of,
    truth_options,
)
from hgogen.commands.output import Bar, Folder, Written, cell, filled, folder_of, headed, note, rendered
from hgogen.commands.trial_runs import trials_or_proposed
from hgogen.errors import HgogenError
from hgogen.estimators.noise import deviation_lines
from hgogen.logs.changes import Better
from hgogen.logs.finding import Finding
from hgogen.logs.findings import judged
from hgogen.logs.initial import first_states
from hgogen.logs.records import Log, demand_regular, log_of, range_warnings, reading_of, step_limits
from hgogen.model import MissingPart, Model, load
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.reading.cells import BadRecord
from hgogen.reading.files import file_name_fault
from hgogen.reading.log import mapping, quotient, shifts_of
from hgogen.reading.measured import COMMAND, WINDOWS, Record, read
from hgogen.run.comparison import Difference, differences, precision_warnings
from hgogen.run.consistency import Consistency, Suggestion, consistency, prediction_warnings, suggest
from hgogen.run.gates import GateShare
from hgogen.run.gramian import Gramian
from hgogen.run.metrics import Interventions, before_loss, interventions, loss
from hgogen.run.prediction import (
    MostlyRejected,
    Prediction,
    Rejection,
    predictions,
    rejected,
    rejections,
    rms,
)
from hgogen.run.samples import Run
from hgogen.signal import Signal, derived, finer_units, plural
from hgogen.step import Step, StepTooLong

Data = Annotated[Path, typer.Option("--data", help="The log: a text with a header, Parquet, MAT, Excel, ULog or MDF.")]
ROUNDING = 1e-12  # relative rounding of a time over a period
PIECE = 10_000  # rows of CSV text at once; cells take about ten times the memory of their text
_NAN = re.compile("nan")
_CLEAR = 0.3  # of the longest dt: a unit that comes nearer to it is in doubt
STAGES = 5  # stages of `run` before the figures, besides one for each sample ahead


@dataclass(frozen=True, eq=False)
class RecordRun(ModelReport):
    """A run over a measured log, with findings about the observer and the log."""

    json_keys = (
        "model engine=run.engine record=record.report status acted initial begins predictions hidden "
        "innovations=sure.outputs nees=sure.states real=step.real findings better rejected from_double notes files"
    )

    step: CallableStep
    record: Record
    run: Run
    counted: int  # the first sample whose errors count
    truth: Mapping[str, np.ndarray]  # the measured course of each state of --truth
    begins: Annotated[dict[str, Begin], "states that the first samples or --initial give, and why"]
    predictions: Annotated[tuple[Prediction, ...], "RMS errors of predictions, by output and samples ahead"]
    findings: Annotated[tuple[Finding, ...], "faults of the log"]
    better: Annotated[
        Better | None, "another shift, sign or unit of a signal with which predictions are clearly better"
    ]
    rejected: Annotated[tuple[Rejection, ...], "outputs most of whose samples the observer rejects; exit status 1"]
    from_double: Annotated[tuple[Difference, ...], "with --real float, how far each state is from the run in double"]
    doubts: tuple[tuple[str, ...], tuple[str, ...]]  # doubts about the samples; about horizons and shifts
    files: Written = ()

    @property
    def acted(self) -> Interventions:
        """The times at which guards changed the estimate."""
        return interventions(self.step, self.run.status, self.record.t)

    @property
    def initial(self) -> dict[str, float]:
        """Initial estimates of states, from the first samples or --initial."""
        return {name: one.value for name, one in self.begins.items()}

    @property
    def hidden(self) -> dict[str, float | None]:
        """RMS error of the estimate by state whose truth --truth gives."""
        errors = {state: self.run.off(state, true)[self.counted :] for state, true in self.truth.items()}
        measured = {state: each[np.isfinite(each)] for state, each in errors.items()}
        return {state: rms(each) if len(each) else None for state, each in measured.items()}

    @cached_property
    def sure(self) -> Consistency:
        """The consistency of innovations and errors with the covariance of the observer."""
        true = {state: values[self.counted :] for state, values in self.truth.items()}
        return consistency(self.run.since(self.counted), true)

    @property
    def notes(self) -> tuple[str, ...]:
        """The faults of the log, and sentences on the reliability of the run."""
        return (*map(str, self.findings), *self.remarks)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on the reliability of the run."""
        acted = (f"the fault recovery acted: {self.acted.sentence(self.step.time)}",) if self.acted else ()
        differing = precision_warnings(self.from_double, self.step.time)
        known, more = self.doubts
        explained = bool(self.findings)  # by a cause with its fix, in whose place symptoms would name another
        doubtful = *(() if explained else prediction_warnings(self.predictions)), *self.sure.sentences(explained)
        return (*known, *doubtful, *differing, *acted, *self.acted.excessive, *more)

    @property
    def status(self) -> dict[str, int]:
        """The number of samples with each status bit, without the bits that were never raised."""
        return self.run.raised

    def written(self, name: str) -> dict[str, str | bytes]:
        """Return by file name the estimates and innovations as CSV, and the figures; `name`: the log's name."""
        texts = {"estimates": _estimates(self.step, self.record, self.run)}
        texts |= {"innovations": _innovations(self.step, self.record, self.run)}
        drawn = rendered(self._figures(name))
        return {**{f"{name}_{what}.csv": text for what, text in texts.items()}, **drawn}

    def _figures(self, name: str) -> dict[str, Any]:
        from hgogen.run import figures

        step, record, run = self.step, self.record, self.run
        y = step.in_time(record.of(step.samples))
        drawn = {
            f"{name}_states": figures.record_states(step, record.t, run, y, self.truth),
            f"{name}_innovations": figures.record_innovations(step, record.t, run),
        }
        adapts = step.observer.traces
        return drawn | ({f"{name}_theta": figures.adaptation(step, record.t, run.traces)} if adapts else {})

    def tables(self) -> Iterator[Any]:
        """Yield the log, the status, predictions and innovations."""
        step = self.step
        yield log_summary(
            self.record.report, self.begins, self.findings, [x.name for x, _ in step.observer.form.estimates]
        )
        yield from fault_lines(self.findings)
        yield Text(f"run by the {repr(step).strip('<>')}")
        yield from deviation_lines(step)
        yield status_table(step, self.status, len(self.record.t))
        yield from gates_table(self.acted.gates)
        yield predictions_table(self.predictions, self.record.report.dt, step.time)
        units = {x.name: Text(x.unit) for x in step.states}
        title = "RMS error of the estimate, by the truth"
        rows = ((name, cell(error) or "nothing measured", units[name]) for name, error in self.hidden.items())
        yield from filled(headed(title, "state", "error", "unit", rows=rows))
        title = "in float, as the firmware computes: the largest difference from double"
        columns = ("state", "difference", "unit", f"at ({step.time})", "share", "of its")
        rows_ = (
            (one.state, f"{one.largest:.3g}", Text(one.unit), f"{one.t:.4g}", f"{one.share:.2g}", one.of)
            for one in self.from_double
        )
        yield from filled(headed(title, *columns, rows=rows_))
        yield consistency_table(self.sure, self.remarks)

    def demand(self) -> None:
        """Raise `MostlyRejected` if the observer rejects most samples of an output."""
        if self.rejected:
            raise MostlyRejected(self.rejected)


@command(RecordRun)
def run_(
    model: ModelArgument,
    data: Data,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    columns: Columns = NO_COLUMNS,
    out: Out = None,
    horizon: Annotated[str, typer.Option(help="Samples ahead of the prediction errors, such as 1,5,25.")] = "1,5,25",
    truth: Truth = None,
    shift: Shift = None,
    initial: Annotated[
        str | None,
        typer.Option(
            metavar="x=1,v=0", help="The plant's state at the first row; by default estimated from the first samples."
        ),
    ] = None,
    burn_in: Annotated[
        float,
        typer.Option(
            min=0.0, help="Time at the beginning that is left out of the errors, in the model's unit of time."
        ),
    ] = 0.0,
) -> RecordRun:
    """Run a model's observer over a measured log: write the estimates as CSV and figures, and print faults of the log.

    The estimate starts at --initial. By default it starts at the states that follow from the first samples; all other
    states start at the observer's initial values.
    """
    ahead = horizons(horizon, "--horizon")
    with Bar("reading the log", STAGES + max(ahead)) as bar:
        loaded, folder, name = _destination(model, data, observer, setting, columns, out, "report")
        true = truth_of(loaded.plant, truth or ())
        opened = _opened(loaded, observer, data, columns, shift or (), true)
        bar.tick("running the observer")
        report = _over_record(opened, _estimated(opened, initial), true, burn_in, ahead, bar)
    return folder.save(report, f"{name}_report.json", report.written(name))


class _Opened(NamedTuple):
    """A log resampled with the period of a step, after the shifts of --shift."""

    model: Model
    step: CallableStep
    record: Record
    shifts: Mapping[str, int]

    @property
    def elapsed(self) -> np.ndarray | None:
        """The time (N) since the previous sample, for a step with varying dt; None for another step."""
        return self.record.elapsed if self.step.clock.varying else None


class _Estimated(NamedTuple):
    """The run of a step over a log u (N, m), y (N, p), with the initial estimates `begins`; `judge`, `judged`: the step
    and the run by which the log is judged."""

    step: CallableStep
    begins: dict[str, Begin]
    u: np.ndarray
    y: np.ndarray
    samples: np.ndarray
    run: Run
    judge: CallableStep
    judged: Run


def _destination(
    model: str, data: Path, observer: str | None, setting: Setting, columns: Columns, out: Path | None, ending: str
) -> tuple[Model, Folder, str]:
    """Return the model, the folder of its results, and the name of the log; `ending`: the end of the report's file
    name."""
    loaded = _timed(load(model).set(setting), data, columns)
    folder, name = folder_of(out, loaded, observer), "record" if file_name_fault(data.stem) else data.stem
    folder.demand(f"{name}_{ending}.json")
    return loaded, folder, name


def _opened(
    model: Model,
    observer: str | None,
    data: Path,
    columns: Columns,
    shift: Sequence[str],
    true: Mapping[str, tuple[str, str]] = MappingProxyType({}),
) -> _Opened:
    step = _step(model, observer, data, columns)
    record = _record(step, data, columns, (*step.inputs, *step.samples), true)
    shifts = shifts_of(str(data), shift, step.inputs, step.outputs)
    ages = {age.name: shifts.get(y.name, 0) for y, age in zip(step.late, step.ages, strict=True)}
    record = record.shifted(shifts | ages, step.inputs).without(columns.missing or (), step.inputs, step.outputs)
    return _Opened(model, step, record, shifts)


def _estimated(opened: _Opened, initial: str | None = None) -> _Estimated:
    u, samples = opened.record.of(opened.step.inputs), opened.record.of(opened.step.samples)
    y, engine = opened.step.in_time(samples), engine_here()
    step, begins = _begun(opened, u, y, initial)
    step.reset(float(opened.record.t[0]))
    done = step.run(u=u, y=samples, engine=engine, dt=opened.elapsed)
    return _Estimated(step, begins, u, y, samples, done, *judged(step, done, u, y, engine))


def _over_record(
    opened: _Opened,
    estimated: _Estimated,
    true: Mapping[str, tuple[str, str]],
    burn_in: float,
    ahead: Sequence[int],
    bar: Bar,
) -> RecordRun:
    model, record, engine = opened.model, opened.record, engine_here()
    step, begins, u, y, samples, done, judge, run = estimated
    counted = _counted(step, burn_in, record.t)
    bar.tick("predictions")
    there = np.where(np.arange(len(y))[:, None] < before_loss(done), y, np.nan)
    errors = predictions(judge, run.since(counted), u[counted:], there[counted:], ahead, bar.tick)
    bar.tick("innovations")
    wrong = rejections(judge, run, u, y, record.operands, engine, opened.elapsed)
    double = None
    if step.real != "double":
        double = step.rebuilt(real="double").run(u=u, y=samples, engine=engine, dt=opened.elapsed)
    single = () if double is None else differences(step.states, done, double)
    bar.tick("faults of the log")
    faults, other = log_findings(judge, record, run, u, y, opened.shifts, counted)
    used = Log(u, np.where(rejected(judge, run, y), np.nan, y), step.dt)
    doubts = (*loss(step, done, record.t, u, y), *range_warnings(model.plant, used, faulty_signals(faults)))
    more = too_far(ahead, [one.ahead for one in errors])
    truth = {state: record.values[:, record.names.index(name)] for state, (name, _) in true.items()}
    messages = doubts, tuple(more)
    return RecordRun(
        model.path, step, record, done, counted, truth, begins, errors, tuple(faults), other, wrong, single, messages
    )


def _begun(
    opened: _Opened, u: np.ndarray, samples: np.ndarray, initial: str | None
) -> tuple[CallableStep, dict[str, Begin]]:
    step = opened.step
    if initial is not None:
        values = numbers_by_name([initial], "--initial")
        return step.started(values), {name: Begin(value, "--initial") for name, value in values.items()}
    plant, measured = step.observer.form.system.declared, {}
    for y, output, column in zip(plant.outputs, plant.output, samples.T, strict=True):
        there = np.flatnonzero(np.isfinite(column))
        if output in plant.states and len(there):
            state = plant.states[plant.states.index(output)]
            measured[state.name] = float(np.clip(reading_of(state, y, column[there[0]]), *state.interval))
    parts = {"its first sample": measured}
    for why, steady in (("steady state of the first samples", True), ("what the first samples imply", False)):
        known = {name: value for part in parts.values() for name, value in part.items()}
        parts[why] = first_states(step, u, samples, opened.elapsed, known, steady)
    begins = {name: Begin(value, why) for why, part in parts.items() for name, value in part.items()}
    values = {name: one.value for name, one in begins.items()}
    return (step.started({**step.observer.initial, **values}), begins) if begins else (step, {})


def _counted(step: CallableStep, burn_in: float, t: np.ndarray) -> int:
    if not burn_in * (1 - ROUNDING) <= t[-2] - t[0]:  # NaN is refused too
        reason = f"{burn_in:g} {step.time} leaves nothing of a log of {t[-1] - t[0]:g} {step.time}"
        raise typer.BadParameter(reason, param_hint="--burn-in")
    return int(np.searchsorted(t - t[0], burn_in * (1 - ROUNDING)))


def _timed(model: Model, data: Path, columns: Columns) -> Model:
    if model.has("step") or model.setting.dt is not None:
        return model
    return model.sampled(_period(model, data, columns))


def _period(model: Model, data: Path, columns: Columns) -> float | tuple[float, float]:
    """Return the period of a log, of an irregular one the shortest and the longest dt of a step for it."""
    parts = (text.partition("=") for text in columns.map_ or ())
    mapped = {name.strip(): column.strip() for name, _, column in parts if column.strip()}
    log = log_of(read(data, mapped, dt=None, own_times="irregular", unit=model.plant.time, **columns.reading()))
    return step_limits([log]) or log.dt


def _step(model: Model, observer: str | None, data: Path, columns: Columns) -> CallableStep:
    """Return the step of a model, or of its tuning `observer`. Raises: `BadRecord` if its dt is the log's period and
    too long for the plant, but a thousandth or a millionth of that period is not (times in ms or us)."""
    if observer is not None and observer not in model.tuning.with_textbook_name(observer).tables:
        note(f"{observer} has no tuning in the model, and runs with starting gains")
    try:
        return model.step(observer)
    except HgogenError as error:
        refused = error if isinstance(error, StepTooLong) else error.__cause__
        if not isinstance(refused, StepTooLong) or model.setting.dt != _period(model, data, columns):
            raise
        parts = {name: part for name, part in finer_units(refused.unit).items() if refused.dt / part <= refused.limit}
        if not parts:
            raise
        names = [name for name, part in parts.items() if refused.dt / part > _CLEAR * refused.limit][:1]
        names += [name for name in parts if name not in names][:1]
        options = [
            f"--time '{quotient(columns.time, parts[name])}'"
            if columns.time
            else f"--period {refused.dt / parts[name]:g}"
            for name in names
        ]
        time = plural(refused.unit)
        question = (
            f"has a row every {refused.dt:g} {time}: are the times {' or '.join(names)}? Say {' or '.join(options)}"
        )
        as_it_is = f"dt = {refused.dt:g} is too long for {refused.rule}: refused above {refused.limit:.3g}"
        raise BadRecord(str(data), f"{question}. As {time}, {as_it_is}") from None


def _record(
    step: CallableStep,
    data: Path,
    columns: Columns,
    signals: tuple[Signal, ...],
    true: Mapping[str, tuple[str, str]] = MappingProxyType({}),
) -> Record:
    named = mapping(str(data), columns.map_ or (), step.inputs, step.samples)
    wanted = {**{s.name: named[s.name] for s in signals}, **dict(true.values())}
    inputs = {s.name: WINDOWS[step.clock.between] for s in step.inputs}
    known = {s.name: s for s in signals} | {truth_name(x.name): x for x in step.states}
    record = read(
        data,
        wanted,
        dt=None if step.clock.varying else step.dt,
        own_times="always" if step.clock.varying else None,
        unit=step.time,
        caller=replace(COMMAND, others=truth_options(true)),
        inputs=inputs,
        signals=known,
        rates=derived(step.inputs),
        **columns.reading(),
    )
    demand_regular(step.observer.form.system, record.report)
    return columns.begun(record)


def _estimates(step: CallableStep, record: Record, run: Run) -> str:
    measured = [f"{s.name}_measured" if s.name in run.names else s.name for s in step.outputs]
    numbers = np.column_stack([record.t, record.of(step.outputs), run.x, *run.traces.values()])
    return _csv(["t", *measured, *run.names, *run.traces, "status"], numbers, run.status)


def _innovations(step: CallableStep, record: Record, run: Run) -> str:
    """Return the CSV text of the innovations and their variances, and of the
    lower triangle of the estimate's covariance by columns, P_i_j of states
    i and j. An observer without a covariance has innovations alone."""
    assert run.innovations is not None  # a step has innovations
    header, columns = ["t", *(f"e_{s.name}" for s in step.outputs)], [record.t, run.innovations]
    if run.variances is not None and run.covariance is not None:
        pairs = [(i, j) for j in range(len(run.names)) for i in range(j, len(run.names))]
        header += [f"s_{s.name}" for s in step.outputs] + [f"P_{run.names[i]}_{run.names[j]}" for i, j in pairs]
        columns += [run.variances, *(run.covariance[:, i, j] for i, j in pairs)]
    return _csv(header, np.column_stack(columns))


def _csv(header: Sequence[str], numbers: np.ndarray, status: np.ndarray | None = None) -> str:
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


@dataclass(frozen=True, eq=False)
class InspectReport(ModelReport):
    """The faults of a log, before gains are learned from it."""

    json_keys = "model record=record.report findings better notes files"

    step: CallableStep
    record: Record
    findings: Annotated[tuple[Finding, ...], "faults of the log"]
    better: Annotated[
        Better | None, "another shift, sign or unit of a signal with which predictions are clearly better"
    ]
    notes: Annotated[tuple[str, ...], "what else looks doubtful"]
    files: Written = ()

    def tables(self) -> Iterator[Any]:
        """Yield the log, and a line for each fault."""
        yield log_summary(self.record.report, findings=self.findings)
        yield from fault_lines(self.findings)
        yield from map(Text, self.notes)
        if not self.findings:
            noted = ", but see the notes on the file above" if self.record.report.notes else ""
            yield f"no fault found in the signals and in the innovations of the model's observer{noted}"

    def written(self, name: str) -> dict[str, str | bytes]:
        """Return by file name the figure of the signals with their faults marked; `name`: the log's name."""
        from hgogen.run import figures

        signals = (*self.step.inputs, *self.step.outputs)
        faults = [(name, one.rows) for one in self.findings for name in one.signal.split(", ")]
        rows = {s.name: [each for name, stretches in faults if name == s.name for each in stretches] for s in signals}
        drawn = figures.log_faults(signals, self.record.t, self.record.of(signals), rows, self.step.time)
        return {**rendered({f"{name}_signals": drawn})}


@command(InspectReport)
def inspect_(
    model: ModelArgument,
    data: Data,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    columns: Columns = NO_COLUMNS,
    out: Out = None,
    shift: Shift = None,
) -> InspectReport:
    """Look for faults in a measured log before gains are learned from it: sensors, the file, delays, signs and units.

    Each line names a fault, its samples, and a remedy. The faults follow from the signals themselves and from the
    innovations of an observer: that of --observer, that of the model, or riccati with starting gains. A figure shows
    the signals with the faults marked.
    """
    with Bar("reading the log", 4) as bar:
        loaded, folder, name = _destination(model, data, observer, setting, columns, out, "faults")
        opened = _opened(loaded, observer or judging_observer(loaded), data, columns, shift or ())
        bar.tick("running the observer")
        step, _, u, y, _, done, judge, run = _estimated(opened)
        bar.tick("other shifts, signs and units")
        faults, other = log_findings(judge, opened.record, run, u, y, opened.shifts)
        notes = tuple(share.sentence for share in done.gates if share.excessive)
        notes += (*range_warnings(loaded.plant, Log(u, y, step.dt), faulty_signals(faults)),)
        if opened.elapsed is not None:
            middle = float(np.median(opened.elapsed[1:]))
            notes += (
                f"the rows are not evenly spaced, so that no delay is searched; add --dt {middle:.3g} to search delays",
            )
        report = InspectReport(loaded.path, step, opened.record, tuple(faults), other, notes)
        bar.tick("the figure")
    return folder.save(report, f"{name}_faults.json", report.written(name))


@dataclass(frozen=True, eq=False)
class NoiseReport(ModelReport):
    """The sensor noise in a part of a log without excitation."""

    json_keys = "model record=record.report noise"

    record: Record
    noise: Annotated[tuple[Suggestion, ...], "what the record suggests for each output"]
    unit: str

    def tables(self) -> Iterator[Any]:
        """Yield the log and the suggested values."""
        yield log_summary(self.record.report)
        for one in self.noise:
            rows = (
                ("sigma", f"{one.sigma:.4g}", "standard deviation about a straight line"),
                ("tau", f"{one.tau:.4g} {self.unit}", "correlation time" if one.tau else "white noise"),
                ("d", f"{one.d:g} {self.unit}", "window of the innovation"),
                ("gamma_0", f"{one.gamma_0:.4g}", f"sigma^2 d (1 + 6.5 x {one.spread:.3g}): theta may rise above it"),
                ("gamma_1", f"{one.gamma_1:.4g}", "2 gamma_0: theta rises fully above it"),
                ("R", f"{one.R:.4g}", "spectral density of the noise; a larger R smooths more"),
            )
            title = f"noise of {one.output}, from {one.samples} samples"
            table = headed(title, "value", "", "meaning", rows=rows)
            yield Group(table, *(Text(f"doubt: {note}", style="yellow") for note in one.notes), "")


@command(NoiseReport)
def noise_(
    model: ModelArgument,
    data: Data,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    columns: Columns = NO_COLUMNS,
    window: Annotated[float | None, typer.Option(help="Window d, in the model's time; by default the model's.")] = None,
) -> NoiseReport:
    """Suggest sigma, tau and the thresholds gamma_0, gamma_1 from a log without motion, or from the part of a log
    between --from and --to."""
    loaded = _timed(load(model).set(setting), data, columns)
    step = _step(loaded, observer, data, columns)
    d = innovation_window(loaded, "--window", observer) if window is None else window
    record = _record(step, data, columns, step.outputs)
    courses = ((s, s.unwrapped(record.of([s])[:, 0])) for s in step.outputs)
    suggestions = (suggest(s.name, course, step.dt, d, step.time) for s, course in courses)
    return NoiseReport(loaded.path, record, tuple(suggestions), step.time)


def innovation_window(model: Model, option: str, observer: str | None = None) -> float:
    """Return the window d (s) of the innovation in a model's tuning, by default the first that has one; `option`: the
    command-line option that sets another.

    Raises: `MissingPart` if there is no adaptive theta, or no tuning of that name.
    """
    tuning = model.tuning if observer is None else model.tuned(observer)
    for name in tuning.tables if observer is None else (observer,):
        innovation = getattr(tuning.gains(name).get("theta"), "innovation", None)
        if innovation is not None:
            return float(innovation.d)
    reason = f"its tuning has no adaptive theta, whose window would be the default; give one by {option}"
    raise MissingPart(model.path, reason)


@dataclass(frozen=True, eq=False)
class Windows(ModelReport):
    """The observability Gramians of windows along a trial."""

    json_keys = "model trial windows"

    trial: Annotated[str, "name of the trial"]
    windows: Annotated[tuple[Gramian, ...], "the observability Gramian of each window"]
    unit: str

    def tables(self) -> Iterator[Any]:
        """Yield a row for each window."""
        yield window_table(self.trial, self.windows, self.unit)


@command(Windows)
def window_(
    model: ModelArgument,
    lengths: Annotated[str, typer.Option("--d", help="Windows d, in the model's time, such as 0.5,1,2.")] = "",
    observer: Tuned = None,
    trial: Annotated[str | None, typer.Option(help="The trial of this name; by default the first.")] = None,
) -> Windows:
    """Compute the observability Gramian of windows of length d along a trial: how well the innovation over a window
    determines the state.

    By default d is half, once, twice and four times the window of the model or of one of its tunings, up to the length
    of the trial.
    """
    loaded = load(model)
    chosen, *_ = one_or_all(trials_or_proposed(loaded), trial)
    if lengths:
        windows = numbers_in(lengths, "times, such as 0.5,1,2", "--d")
    else:
        d = innovation_window(loaded, "--d", observer)
        windows = tuple(d * k for k in (0.5, 1.0, 2.0, 4.0) if d * k <= chosen.duration)
    gramians = hg.gramian(loaded.plant, chosen, windows)
    return Windows(loaded.path, chosen.name, gramians, loaded.plant.time)


def predictions_table(each: Sequence[Prediction], dt: float, unit: str) -> RenderableType:
    """Return the table of the RMS errors of predictions; `dt`: the sampling period, `unit`: the unit of time."""
    table = headed(
        "RMS prediction error of the measured outputs",
        *("output", "samples ahead", f"time ahead ({unit})", "from the estimate", "copying the last value"),
        numbers=4,
    )
    for one in each:
        ahead = ("all, open loop", "") if one.ahead is None else (str(one.ahead), f"{one.ahead * dt:g}")
        table.add_row(one.output, *ahead, f"{one.model:.4g}", "" if one.copying is None else f"{one.copying:.4g}")
    lost = {one.output: one.rejected for one in each if one.rejected}
    lines = [f"{name}: {count} that the observer rejected, not compared" for name, count in lost.items()]
    return Group(table, *map(Text, lines), "")


def consistency_table(whole: Consistency, notes: Iterable[str]) -> RenderableType:
    """Return the table of a run's innovations: their size relative to their variance, and whiteness; `notes` are
    printed below."""
    known = any(one.nis is not None for one in whole.outputs)
    says = "NIS is 1 if they are as large as the observer assumes; " if known else ""
    sure = ("NIS", "by the median", "its 95 % band", "beyond 2 sigma") if known else ()
    title = f"innovations: {says}Ljung-Box tests whiteness"
    table = headed(title, "output", "samples", "RMS", *sure, "Ljung-Box", "limit", numbers=4 + len(sure))
    for one in whole.outputs:
        share = "" if one.outside is None else f"{100 * one.outside:.3g} %"
        size = (cell(one.nis), cell(one.median), _band(one.band), share) if known else ()
        test = one.whiteness
        white = ("", "") if test is None else (f"{test.statistic:.4g}", f"{test.limit:.4g}")
        table.add_row(one.output, f"{one.count}", cell(one.rms), *size, *white)
    lines = [
        f"NIS of {', '.join(one.outputs)} together: {one.nis:.4g}, its 95 % band {_band(one.band)}, from {one.freedom} "
        "samples"
        for one in [whole.joint]
        if one is not None
    ]
    lines += [
        f"NEES of {', '.join(one.states)}: {one.nees:.4g}, its 95 % band {_band(one.band)}, from {one.count} "
        f"correlated samples, {one.alike:.3g} of which count as one independent sample"
        for one in [whole.states]
        if one is not None
    ]
    return Group(table, *map(Text, (*lines, *notes)), "")


def _band(ends: tuple[float, float] | None) -> str:
    return "" if ends is None else f"{ends[0]:.4g} .. {ends[1]:.4g}"


def status_table(step: Step, counts: Mapping[str, int], samples: int) -> RenderableType:
    """Return a table of how often each status bit was raised in `samples` samples, and what to do."""
    if not step.layout.bits:
        return Text("status: none, of a step without guards\n")
    raised = [bit for bit in step.layout.bits if counts.get(bit.name)]
    if not raised:
        return Text(f"status: 0 (ok) in all {samples} samples\n")
    rows = ((str(counts[bit.name]), bit.name, Text(bit.meaning), Text(step.action_of(bit))) for bit in raised)
    table = headed(f"status over {samples} samples", "samples", "bit", "meaning", "what to do", rows=rows)
    return Group(table, "")


def gates_table(shares: Iterable[GateShare]) -> Iterable[RenderableType]:
    """Return a table of the samples beyond each innovation gate, none without gates."""
    columns = ("outputs", "samples", "beyond", "share", "expected", "accepted after too many")
    rows = (
        (", ".join(s.outputs), str(s.count), str(s.beyond), f"{s.share:.3%}", f"{s.expected:.3%}", str(s.reacquired))
        for s in shares
    )
    return filled(headed("samples beyond innovation gates", *columns, rows=rows))


def window_table(trial: str, gramians: Iterable[Gramian], unit: str) -> RenderableType:
    """Return the table of the observability Gramians of windows along a trial; `unit`: the unit of time."""
    names = (f"d ({unit})", "smallest eigenvalue", "median", "weakest direction", "its share")
    table = headed(f"the observability Gramian of windows d along trial {trial}: its observability Gramian", *names)
    for one in gramians:
        (low, high), (name, share) = one.range, one.weakest
        table.add_row(f"{one.d:g}", f"{low:.2g} .. {high:.2g}", f"{one.median:.2g}", name, f"{share:.0%}")
    advice = (
        "The innovation of a small initial error, per its squared length, is at least the smallest eigenvalue, to "
        "first order: take a window at which an error that matters stands out of sigma^2 d, the innovation of the "
        "noise."
    )
    return Group(table, Text(advice), "")
