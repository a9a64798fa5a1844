"""The command `fit`: parameters of a model from measured logs."""

import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from time import monotonic
from types import MappingProxyType
from typing import Annotated, Any, Literal

import numpy as np
import typer
from rich.console import Group, RenderableType
from rich.text import Text

from hgogen.call import CallableStep
from hgogen.commands.command import (
    NO_COLUMNS,
    Columns,
    Data,
    HeldOut,
    ModelArgument,
    ModelReport,
    Out,
    Shift,
    Tuned,
    begun_work,
    command,
    early,
    names_in,
)
from hgogen.commands.data import JUDGE, Logs, demand_in_time, judging_observer, logs_of
from hgogen.commands.output import (
    Bar,
    Folder,
    Written,
    cell,
    folder_of,
    headed,
    interruptible,
    json_text,
    note,
    rendered,
)
from hgogen.errors import HgogenError
from hgogen.logs.fit import AGAIN, FINE, Fit, fit
from hgogen.logs.problem import ITERATIONS, Progress, progress_of
from hgogen.logs.records import Log, step_limits
from hgogen.model import Model, load
from hgogen.modelfiles.json_file import equations, table_of
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.reading.measured import WINDOWS
from hgogen.reading.text_model import OTHER_KEYS, read, to_text
from hgogen.run.backends import quickest_engine
from hgogen.run.consistency import WORSE, integrated_autocorrelation_time
from hgogen.run.prediction import predictions

BEGUN = "fit_begun.json"  # the progress of an unfinished fit
EVERY = 1.0  # seconds at least between two writes of that file
LESS = 0.5  # residuals with a lag over those without that propose it
OUTLYING, STEADY, SIZE = 5e-3, 6.0, 0.3  # share of outliers; of a mean: standard errors, and deviations
FAR = 4.0  # standard errors by which a parameter moves only if the rows held out are unlike the others
UNLIKE = ": they are unlike the others, or the model is too simple; judge the fit on another log, by --held-out FILE"
_AHEAD = (1, 5, 25)  # samples ahead, of the validation errors
_FEEDBACK = (
    "with a feedback controller this proves nothing, since later inputs respond to noise that no prediction knows: "
    "judge "
    "by hgogen tune, one sample ahead"
)


class By(StrEnum):
    """The error that a fit minimises: that of simulation, or of prediction."""

    SIMULATION = "simulation"
    PREDICTION = "prediction"


@dataclass(frozen=True)
class PredictionErrors:
    """RMS errors of predictions of an output on the validation rows."""

    record: Annotated[str, "path of the record"]
    output: Annotated[str, "the output"]
    ahead: Annotated[int | None, "samples ahead; null for open loop"]
    fitted: Annotated[float, "error of the fitted plant"]
    unfitted: Annotated[float, "error of the plant as it was, with the same gains"]
    copying: Annotated[float | None, "error of copying the last value"]


@dataclass(frozen=True)
class ParameterChange:
    """A fitted parameter, estimated without and with the validation rows."""

    judged: Annotated[float, "without the rows held out: its errors are in `predictions`"]
    final: Annotated[float, "from all rows"]


@dataclass(frozen=True, eq=False)
class FitReport(ModelReport):
    """The fitted parameters, and their prediction errors on the validation rows."""

    json_keys = (
        "model equations records=logs.reports findings=logs.findings *result changes predictions unjudged proposals "
        "notes files"
    )

    equations: Annotated[list[str], "the plant's equations"]
    result: Fit
    judged: Fit
    logs: Logs
    by: By
    predictions: Annotated[list[PredictionErrors], "errors in the rows held out"]
    unjudged: Annotated[str, "why there are none, or empty"]
    proposals: Annotated[tuple[str, ...], "options that the residuals ask for"]
    files: Written = ()

    @property
    def changes(self) -> dict[str, ParameterChange]:
        """Parameters, estimated without and with the validation rows; empty without validation rows."""
        before = self.judged.values if self.judged is not self.result else {}
        return {one.name: ParameterChange(before[one.name], one.value) for one in self.result.parameters if before}

    @property
    def verdicts(self) -> tuple[str, ...]:
        """The verdicts on the validation rows, and the advice about offsets."""
        judgements = (*_verdicts(self.predictions, self.by), *self._distance())
        return (*judgements, *_without_offset(self.result), *self.proposals)

    def _distance(self) -> Iterator[str]:
        """Yield a sentence on how far the parameters moved when all rows were used, or on why they could not be fitted
        to all rows."""
        if self.logs.parted and self.judged is self.result:
            yield "the parameters were fitted without the rows held out, since the search on all rows did not settle"
        deviations = {name: sigma for name, sigma in self.judged.deviation.items() if 0 < sigma < math.inf}
        errors = {
            name: abs(one.final - one.judged) / deviations.get(name, math.inf) for name, one in self.changes.items()
        }
        if not errors:
            return
        name = max(errors, key=lambda each: errors[each])
        far = f"{name} changes most, from {self.changes[name].judged:.5g} to {self.changes[name].final:.5g}"
        yield (
            f"the errors in the rows held out belong to parameters fitted without these rows; the file has parameters "
            f"fitted to all rows; {far}, by {errors[name]:.2g} of its standard errors"
            f"{UNLIKE if errors[name] > FAR else ''}"
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on the reliability of the result."""
        return (*self.logs.notes(), *self.result.notes(), *self.verdicts)

    def figures(self) -> dict[str, Any]:
        """Return the figure of each log by name."""
        from hgogen.run import figures  # which takes a while to import

        outputs, plant = self.result.plant.outputs, self.logs.plant
        return {
            f"fitted_{k}": figures.fitted(plant, record.t[: len(y)], record.of(outputs)[: len(y)], y)
            for k, (record, y) in enumerate(zip(self.logs.records, self.result.fitted, strict=False), 1)
        }

    def tables(self) -> Iterator[Any]:
        """Yield the fit and its predictions."""
        yield fit_tables(self.result, self.logs.notes(), self.changes)
        if not self.predictions:
            yield Text(f"nothing judges the fit; {self.unjudged}\n")
            return
        title = "RMS prediction error in the rows held out, from an observer's estimate, without fitting to these rows"
        table = headed(title, "output", "samples ahead", "fitted", "before", "copying the last value", numbers=5)
        several = len({one.record for one in self.predictions}) > 1
        for one in self.predictions:
            name = f"{one.output} in {one.record}" if several else one.output
            ahead = "all, open loop" if one.ahead is None else str(one.ahead)
            table.add_row(name, ahead, *map(cell, (one.fitted, one.unfitted, one.copying)))
        yield Group(table, *map(Text, self.verdicts), "")


@command(FitReport)
def fit_(
    model: ModelArgument,
    data: Data,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    columns: Columns = NO_COLUMNS,
    shift: Shift = None,
    free: Annotated[
        str | None, typer.Option("--free", help="The parameters to fit, such as a,b; by default those with a range.")
    ] = None,
    offset: Annotated[
        str | None, typer.Option("--offset", help="The outputs to which an unknown constant is added, such as y.")
    ] = None,
    lag: Annotated[
        str | None, typer.Option("--lag", help="The outputs whose sensor has an unknown first-order lag.")
    ] = None,
    by: Annotated[
        By,
        typer.Option(help="The error to minimise; take prediction for an unstable plant or one with process noise."),
    ] = By.SIMULATION,
    between: Annotated[
        Literal["hold", "line"], typer.Option(help="Inputs between samples: held constant, or interpolated linearly.")
    ] = "hold",
    held_out: HeldOut = None,
    starts: Annotated[
        int, typer.Option(min=1, max=1000, help="Number of starts of the search; the first is at the nominal values.")
    ] = 3,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random starts.")] = 0,
    robust: Annotated[
        bool, typer.Option("--robust", help="Large residuals count by their size, not by their square.")
    ] = False,
    jobs: Annotated[int, typer.Option("--jobs", metavar="N", min=1, help="Number of processes for the starts.")] = 1,
    write: Annotated[
        Path | None, typer.Option("--write", metavar="FILE.toml", help="Write a new text model with the fitted values.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue the same command, which was stopped, from its last iterate.")
    ] = False,
    out: Out = None,
) -> FitReport:
    """Fit parameters of a model to measured logs, by multiple shooting or by prediction error. Other commands use the
    values by `--parameters fitted.json`.
    """
    lists = {"--free": free, "--offset": offset, "--lag": lag}
    names = {option: names_in(text, option) for option, text in lists.items()}
    loaded = load(model).set(setting)
    demand_in_time(loaded, shift)
    folder = folder_of(out, loaded)
    folder.demand("fitted.json", BEGUN)
    stopped, new = _Stopped(folder), None if write is None else _NewModel(write, loaded)
    begun = stopped.progress() if resume else None
    if new:
        new.demand()
    plant = loaded.plant
    window = WINDOWS["forward" if between == "hold" else between]  # held from its sample to the next
    grid: dict[str, Any] = {"dt": setting.longest, "window": window, "varying": bool(loaded.limits)}
    logs = logs_of(plant, data, held_out, named=columns, shift=shift, **grid)
    logs = logs.inspected(loaded, observer)
    early(*logs.summaries())  # the faults first, since a fit of a faulty log takes as long
    fitted = partial(
        fit,
        plant,
        free=names["--free"] or None,
        offset=names["--offset"],
        between=between,
        lag=names["--lag"],
        seed=seed,
        robust=robust,
        by=by.value,
    )
    judged, result = _fitted_twice(fitted, logs, starts, AGAIN * robust, jobs, stopped, begun)
    no_rows: tuple[list[PredictionErrors], str] = ([], "no rows were held out")
    errors, unjudged = _judgement(loaded, observer, judged, logs, between) if logs.held_out else no_rows
    proposals = (
        *proposed_options(result, logs.allowed, robust, names["--offset"]),
        *proposed_lags(result, partial(_with_lag, fitted, result, logs, names["--lag"]), names["--lag"]),
    )
    report = FitReport(loaded.path, equations(plant), result, judged, logs, by, errors, unjudged, proposals)
    saved = folder.save(report, "fitted.json", rendered(report.figures()), [write] if write else ())
    folder.remove(BEGUN)
    if new:
        new.write(result)
    return saved


def _fitted_twice(
    fitted: Callable[..., Fit],
    logs: Logs,
    starts: int,
    again: int,
    jobs: int,
    stopped: "_Stopped",
    begun: Progress | None,
) -> tuple[Fit, Fit]:
    """Return the fit without the validation rows, and the fit from all rows, which begins where the former ended;
    `again`: passes after the starts."""
    total = (starts + again + (1 + again) * logs.parted) * ITERATIONS
    with Bar("iterations", total) as bar, stopped.kept(bar) as each:
        judged = fitted(*logs.learned, starts=starts, jobs=jobs, each=each, resume=begun)
        if not logs.parted:
            return judged, judged
        bar.reach((starts + again) * ITERATIONS)
        whole = fitted(*logs.allowed, starts=1, begin=judged.values, each=lambda _: bar.tick())
        return judged, whole if whole.settled else judged  # the last iterate may be anywhere


def _with_lag(fitted: Callable[..., Fit], result: Fit, logs: Logs, lags: Sequence[str], output: str) -> Fit:
    """Return the fit of all rows with a lag of the further `output`, which begins where the fit `result` ended; `lags`:
    the outputs that have a lag already."""
    with Bar(f"a lag of {output}", ITERATIONS) as bar:
        every = (*lags, output)
        return fitted(*logs.allowed, starts=1, begin=result.values, lag=every, each=lambda _: bar.tick())


@dataclass(frozen=True)
class _Stopped:
    """The file in a folder with the progress of an interrupted fit."""

    folder: Folder

    def progress(self) -> Progress:
        return progress_of(table_of(begun_work(self.folder, BEGUN, "fit"), "hgogen fit"))

    @contextmanager
    def kept(self, bar: Bar) -> Iterator[Callable[[Progress], None]]:
        last: Progress | None = None
        written = -math.inf

        def each(progress: Progress) -> None:
            nonlocal last, written
            last = progress
            bar.reach(progress.start * ITERATIONS + progress.iteration)
            if monotonic() - written > EVERY:
                write(progress)
                written = monotonic()

        def write(progress: Progress) -> None:
            self.folder.write({BEGUN: json_text(progress, indent=0) + "\n"})

        try:
            with interruptible():
                yield each
        except KeyboardInterrupt:
            if last is not None:
                write(last)
                where = f"iteration {last.iteration} of search {last.start + 1}"
                note(f"the fit was stopped; the same command with --resume goes on from {where}")
            raise


@dataclass(frozen=True)
class _NewModel:
    """The file for a new model with the fitted values, and the `model` that was fitted."""

    path: Path
    model: Model

    def demand(self) -> None:
        """Demand a new TOML file and a plant that plain text can express, before the fit starts: otherwise its result
        would be lost."""
        path, option = self.path, "--write"
        if path.suffix != ".toml":
            raise typer.BadParameter(f"{path} must end in .toml, the language of a plain-text model", param_hint=option)
        if os.path.lexists(path):
            raise typer.BadParameter(f"{path} is there already; give the name of a new file", param_hint=option)
        Folder(path.parent).demand(path.name)
        to_text(self.model.plant)

    def write(self, result: Fit) -> None:
        tables: dict[str, Any] = {}
        source = self.model.path
        if self.model.plain:
            known = read(Path(source))
            tables = {name: getattr(known, name) for name in OTHER_KEYS}
        else:
            note(f"what {source} says beside its plant, as its tuning and trials, is Python and not in the new model")
        filled_tables = {name: value for name, value in tables.items() if value}
        Folder(self.path.parent).write({self.path.name: to_text(result.plant, filled_tables)})


def _judgement(
    model: Model, observer: str | None, result: Fit, logs: Logs, between: str
) -> tuple[list[PredictionErrors], str]:
    try:
        judged = list(_judged(model, observer, result, logs, between))
    except HgogenError as error:
        if observer is not None:  # requested by name
            raise
        return [], f"no observer estimates the rows held out: {error}"
    return judged, "" if judged else "its observer rejects every sample in the rows held out"


def _judged(model: Model, observer: str | None, result: Fit, logs: Logs, between: str) -> Iterator[PredictionErrors]:
    """Yield the errors in the validation rows, with inputs `between` samples as in the fit: it holds an input from its
    row to the next one, and a step that since the call before, so that the step gets each input a row later."""
    fitted = model.valued({p.name: float(p.nominal or 0.0) for p in result.plant.parameters})
    added = {one.name: one.value for one in result.offsets}  # the offset of each output's sensor
    offsets = np.array([added.get(y.name, 0.0) for y in result.plant.outputs])
    whole = logs.whole
    limits, as_fitted = model.limits or step_limits(whole), not model.plant.discrete
    for record, log, cut in ((logs.records[k], whole[k], cut) for k, cut in logs.judging.items()):
        u, y = record.of(model.plant.supplied), record.of(model.plant.outputs)
        if as_fitted and between == "hold":
            u = np.concatenate([u[:1], u[:-1]])
        errors = []
        for variant, samples in ((fitted, y - offsets), (model, y)):
            step = _step(variant, observer, limits or record.report.dt, result.noise).undelayed
            if as_fitted and step.clock.between != between:
                step = step.rebuilt(between=between)
            step.reset(float(record.t[0]))
            done = step.run(u=u, y=samples, engine=quickest_engine(step, len(samples)), dt=log.given(step))
            errors.append(predictions(step, done.since(cut), u[cut:], samples[cut:], _AHEAD))
        for one, other in zip(*errors, strict=True):
            yield PredictionErrors(record.report.path, one.output, one.ahead, one.model, other.model, one.copying)


def _verdicts(judged: Sequence[PredictionErrors], by: By = By.SIMULATION) -> Iterator[str]:
    rivals = {"copying": "than by copying the last value", "unfitted": "than before the fit"}
    several = len({one.record for one in judged}) > 1
    for record, output in dict.fromkeys((one.record, one.output) for one in judged):
        rows_of = f"the rows held out of {record}" if several else "the rows held out"
        rows = [(one.ahead, one) for one in judged if (one.record, one.output) == (record, output) and one.ahead]
        for rival, than in rivals.items():
            worse = [k for k, one in rows if one.fitted > WORSE * (getattr(one, rival) or math.inf)]
            remark = f"; {_FEEDBACK}" if by is By.PREDICTION and max(worse, default=1) > 1 else ""
            if worse:
                ahead = ", ".join(map(str, worse))
                yield f"{output} is predicted worse {than}, {ahead} samples ahead, in {rows_of}{remark}"


def _step(
    model: Model, observer: str | None, dt: float | tuple[float, float], noise: tuple[Mapping[str, float], ...]
) -> CallableStep:
    judge, (process, sample) = observer or judging_observer(model), noise
    model = model.sampled(dt)
    if judge != JUDGE or observer or model.tuning.tables or not process:
        return model.step(judge)
    return replace(model, tables={JUDGE: {"form": "original", "Q": process, "noise": sample}}).step(JUDGE)


def proposed_options(result: Fit, logs: Sequence[Log], robust: bool, fitted: Iterable[str]) -> Iterator[str]:
    """Yield sentences that propose --robust if residuals have outliers, and --offset if residuals have a mean; `logs`:
    those of the fit `result`; `fitted`: the outputs that have an offset already."""
    if outlying := [name for name, part in result.outlying.items() if part > OUTLYING and not robust]:
        yield (
            f"{', '.join(outlying)} has outliers: with --robust a large residual counts by its size, not by its square"
        )
    for j, y in enumerate(result.plant.outputs):
        pairs = zip(logs, result.fitted, strict=True)
        e = np.concatenate([y.difference(log.y[: len(f), j], f[:, j]) for log, f in pairs])
        e = e[np.isfinite(e)]
        if y.name in fitted or not e.std() > FINE * result.spread[y.name]:
            continue
        error = e.std() * math.sqrt(min(integrated_autocorrelation_time(e - e.mean()), len(e)) / len(e))
        if abs(e.mean()) > max(STEADY * error, SIZE * e.std()):
            yield f"residuals of {y.name} have a mean of {e.mean():.3g}: an unknown offset, --offset {y.name}"


def proposed_lags(result: Fit, with_lag: Callable[[str], Fit], fitted: Iterable[str]) -> Iterator[str]:
    """Yield a sentence that proposes --lag for each output whose residuals are not white, have no outliers, and are
    clearly smaller with a lag; `with_lag(y)`: the fit with a lag of the sensor of y; `fitted`: the outputs that have a
    lag already."""
    for name, test in result.whiteness.items():
        white = test is None or test.white or result.error[name] <= FINE * result.spread[name]
        if white or name in fitted or result.plant.discrete or result.outlying[name] > OUTLYING:
            continue
        try:
            slow = with_lag(name)
        except HgogenError:  # of a periodic output that reads an input
            continue
        lag = slow.lags[-1]
        if slow.settled and not lag.at and slow.error[name] < LESS * result.error[name]:
            yield (
                f"with --lag {name}, of {lag.value:.3g} {lag.unit}, residuals of {name} are {slow.error[name]:.3g} in "
                f"place of {result.error[name]:.3g}: its sensor lags or is late, which hgogen inspect tells apart with "
                "these parameters"
            )


def _without_offset(result: Fit) -> Iterator[str]:
    """Yield sentences on how to remove a fitted offset in later commands, whose observers do not model it."""
    for one in (each for each in result.offsets if math.isfinite(each.deviation)):
        correction = f"'{one.name}=[COLUMN] - ({one.value:.5g})'"
        yield f"no observer knows the offset of {one.name}: tune and run take it off by --map {correction}, in its unit"


def fit_tables(
    result: Fit, notes: Iterable[str], changes: Mapping[str, ParameterChange] = MappingProxyType({})
) -> RenderableType:
    """Return the tables of fitted parameters and residuals, with the notes of the fit and the `notes` on the logs;
    `changes`: each parameter as fitted without and with the validation rows."""
    before, rows = ("before", *(["without rows held out"] if changes else [])), "fitted parameters"
    title = f"{rows}, from all rows" if changes else rows
    parts = headed(title, "name", "value", "standard error", *before, "unit", numbers=3 + len(before))
    for one in result.parameters:
        spread = "at its end" if one.at else _spread(one.deviation)
        former = [f"{changes[one.name].judged:.5g}"] if changes else []
        parts.add_row(one.name, f"{one.value:.5g}", spread, f"{one.nominal:.5g}", *former, Text(one.unit))
    empty = [""] * bool(changes)
    for one in result.lags:
        parts.add_row(f"lag of {one.name}", f"{one.value:.5g}", _spread(one.deviation), "", *empty, Text(one.unit))
    for one in result.offsets:
        parts.add_row(f"offset of {one.name}", f"{one.value:.5g}", _spread(one.deviation), "0", *empty, Text(one.unit))
    for what, levels in zip(("process noise of", "noise of a sample of"), result.noise, strict=True):
        for name, level in levels.items():
            unit = ("variance of a sample" if result.plant.discrete else "density") * (levels is result.noise[0])
            parts.add_row(f"{what} {name}", f"{level:.3g}", "", "", *empty, unit)
    follows = headed(_ALONG[result.by], "output", "fitted", "before", "Ljung-Box", "limit", numbers=5)
    for name, error in result.error.items():
        test = result.whiteness[name]
        white = ("", "") if test is None else (f"{test.statistic:.4g}", f"{test.limit:.4g}")
        follows.add_row(name, f"{error:.4g}", f"{result.unfitted[name]:.4g}", *white)
    return Group(parts, "", follows, *map(Text, (*notes, *result.notes())), "")


_ALONG = {
    "simulation": "RMS error of the outputs along the record, from its first state; Ljung-Box tests whiteness",
    "prediction": "RMS error of predictions one sample ahead along the record; Ljung-Box tests whiteness",
}


def _spread(deviation: float) -> str:
    return f"{deviation:.2g}" if math.isfinite(deviation) else "not told"
