"""The command `tune`: gains of observers from measured records."""

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import typer
from rich.console import Group
from rich.text import Text

from hgogen.call import CallableStep
from hgogen.check import worst
from hgogen.commands import log_tables
from hgogen.commands.advice import KNOWN
from hgogen.commands.command import ModelReport, command
from hgogen.commands.data import Logs, logs_of, too_far, truth_of, truth_options
from hgogen.commands.options import (
    NO_COLUMNS,
    Columns,
    Data,
    Deep,
    HeldOut,
    Jobs,
    ModelArgument,
    Out,
    Shift,
    Truth,
    engine_here,
    horizons,
    names_in,
)
from hgogen.commands.output import Bar, Written, folder_of, headed
from hgogen.commands.process import note
from hgogen.emit.cost import cost
from hgogen.errors import HgogenError
from hgogen.logs.advise import Advised
from hgogen.logs.grid import Calibration, Tuned
from hgogen.logs.judged import ALL, HELD_OUT, Held, Judged, judged, verdicts
from hgogen.logs.tune import tune
from hgogen.model import Model, load
from hgogen.modelfiles.first import everywhere
from hgogen.modelfiles.json_file import equations
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.reading.measured import WINDOWS, said_of
from hgogen.sentence import because
from hgogen.signal import derived
from hgogen.which_forms import Row, of

Named = TypeVar("Named", Tuned, Advised)  # a row of gains, which has a name


TunedOn = Annotated[
    Literal["predictions", "truth"],
    typer.Option("--tune-on", help="Choose gains by predictions, or by the truth of --truth."),
]


Names = Annotated[str | None, typer.Option("--observers", "--observer", metavar="A,B,..", help="By default all.")]


@dataclass(frozen=True)
class TunedGains:
    """What is known of tuned gains and not of declared ones."""

    form: Annotated[str, "the form the observer is built on"]
    error: Annotated[float, "cross-validated error, in errors of copying or, tuned on the truth, of the mean"]
    known: Annotated[str, "what is known of the convergence"]
    operations: Annotated[int, "operations of one call"]
    functions: Annotated[int, "functions (sine, exponential, root, ..) of one call"]
    state: Annotated[int, "bytes of the state"]
    likelihood: Annotated[float | None, "log likelihood of a sample; null where noise was not estimated"]


@dataclass(frozen=True, eq=False)
class TunedRow:
    """An observer with tuned or declared gains; those alone have `gains`."""

    json_keys = "name *gains held_out hidden nis coloured"

    name: Annotated[str, "name of the tuning"]
    gains: TunedGains | None
    held_out: Annotated[Mapping[str, Mapping[str, float]], "RMS errors of predictions, by samples ahead and output"]
    hidden: Annotated[Mapping[str, float], "RMS errors of hidden states"]
    nis: Annotated[Mapping[str, float], "mean normalised innovation squared by output"]
    coloured: Annotated[Mapping[str, int], "by output, how many correlations of innovations are not white"]


@dataclass(frozen=True, eq=False)
class TuneReport(ModelReport):
    """Observers tuned to measured records."""

    json_keys = "model equations records=logs.reports take tuning ahead truth segments rows refused notes files"

    equations: Annotated[list[str], "the plant's equations"]
    logs: Logs
    calibration: Calibration
    ahead: Annotated[int, "samples ahead by which gains are chosen"]
    segments: Annotated[int, "segments of each record, by which gains that others chose are judged"]
    rows: Annotated[tuple[TunedRow, ...], "errors and costs of each observer"]
    notes: Annotated[tuple[str, ...], "what is doubtful, and which to take"]
    held_out: bool
    files: Written = ()

    @property
    def take(self) -> str:
        """Name of the tuning to take."""
        return self.calibration.best.name

    @property
    def tuning(self) -> dict[str, Mapping[str, Any]]:
        """Tables of the tunings by name."""
        return {row.name: row.table for row in self.calibration.rows}

    @property
    def truth(self) -> tuple[str, ...]:
        """The states tuned on."""
        return tuple(self.calibration.truth)

    @property
    def refused(self) -> dict[str, str]:
        """Why observers have no gains, by name."""
        return dict(self.calibration.refused)

    def tables(self) -> Iterator[Any]:
        """The records, and the observers."""
        yield from map(log_tables.report, self.logs.reports)
        ahead = [(h, y) for h, errors in self.rows[0].held_out.items() for y in errors]
        hidden = list(self.rows[0].hidden)
        where = "in the rows held out" if self.held_out else "in all rows, since none were held out"
        title = f"RMS errors {where}: of predictions, by output and samples ahead, and of hidden states"
        columns = *(f"{y} {h}" for h, y in ahead), *hidden
        errors = headed(title, "", "observer", *columns, numbers=len(columns))
        copying = "of predictions, over that of copying the last value"
        of = f"of {', '.join(self.truth)}, over that of the mean" if self.truth else copying
        names = ("", "observer", "form", "cross-validated", "NIS", "operations", "state", "convergence")
        worth = headed(f"tuned observers; cross-validated: {of}", *names)
        for row in self.rows:
            mark, gains = "take" if row.name == self.take else "", row.gains
            numbers = *(row.held_out[h][y] for h, y in ahead), *map(row.hidden.get, hidden)
            errors.add_row(mark, row.name, *map(log_tables.cell, numbers))
            if gains is not None:
                nis = ", ".join(f"{each:.2g}" for each in row.nis.values())
                cost = f"{gains.operations}", f"{gains.state} B"
                worth.add_row(mark, row.name, gains.form, f"{gains.error:.3g}", nis, *cost, gains.known)
        yield Group(errors, "", worth, "", *map(Text, self.notes), "", *log_tables.without(self.refused))


@command(TuneReport)
def tune_(
    model: ModelArgument,
    data: Data,
    observers: Names = None,
    setting: Setting = AS_WRITTEN,
    columns: Columns = NO_COLUMNS,
    shift: Shift = None,
    truth: Truth = None,
    tune_on: TunedOn = "predictions",
    between: Annotated[Literal["hold", "line"], typer.Option(help="How inputs go on between samples.")] = "line",
    held_out: HeldOut = 0.3,
    ahead: Annotated[int, typer.Option(min=1, help="Samples ahead by which gains are chosen.")] = 1,
    segments: Annotated[
        int, typer.Option(min=2, help="Of each record, by which gains that others chose are judged.")
    ] = 5,
    horizon: Annotated[str, typer.Option(help="Samples ahead of the errors held out, such as 1,5,25.")] = "1,5,25",
    deep: Deep = False,
    jobs: Jobs = None,
    out: Out = None,
) -> TuneReport:
    """Tune the observers that a plant admits to measured records, and say which to take. The file `tuned.json` that it
    writes is what `--tuning` of every command that makes a step takes.
    """
    aheads, names = horizons(horizon, "--horizon"), names_in(observers, "--observers")
    loaded = load(model).set(setting)
    plant, folder = loaded.plant, folder_of(out, loaded)
    folder.demand("tuned.json")
    true = truth_of(plant, truth or ())
    if tune_on == "truth" and not true:
        raise typer.BadParameter(
            "truth is asked for and there is none; add --truth STATE=COLUMN", param_hint="--tune-on"
        )
    logs = logs_of(
        plant,
        data,
        held_out,
        dt=setting.dt,
        named=columns,
        shift=shift,
        beside=dict(true.values()),
        options=truth_options(true),
        window=WINDOWS[between],
    )
    measured = [
        {state: each[name] for state, (name, _) in true.items()}
        for each in logs.columns([name for name, _ in true.values()])
    ]
    courses = zip(measured, logs.cuts, strict=True)
    seen = [{state: course[:cut] for state, course in each.items()} for each, cut in courses]
    with Bar("trials", None) as bar:
        calibration = tune(
            plant,
            *logs.learned,
            observers=names or None,
            ahead=ahead,
            segments=segments,
            truth=seen if tune_on == "truth" else (),
            between=between,
            method=setting.method or "continuous_discrete",
            real=setting.real or "double",
            rows=forms_asked(loaded, deep),
            jobs=jobs,
            each=lambda _: bar.tick(),
        )
    calibration = replace(calibration, rows=renamed(loaded, calibration.rows, "tuned"))
    rows, notes = _judged(loaded, calibration, logs, measured, aheads, bool(held_out))
    lines = equations(plant)
    report = TuneReport(loaded.path, lines, logs, calibration, ahead, segments, rows, notes, bool(held_out))
    return folder.save(report, "tuned.json")


def _judged(
    model: Model,
    calibration: Calibration,
    logs: Logs,
    measured: Sequence[Mapping[str, np.ndarray]],
    aheads: Sequence[int],
    held_out: bool,
) -> tuple[tuple[TunedRow, ...], tuple[str, ...]]:
    """The errors of tuned and declared observers in the rows held out, else in all; and what is to say of them."""
    plant = model.plant
    begins = [cut if held_out else 0 for cut in logs.cuts]
    held = list(map(Held, logs.whole, begins, measured))
    declared = _declared(model, logs.whole[0].dt)
    rows = judged(plant, calibration, declared, held, aheads, engine_here())
    steps = (*(one.first.step for one in calibration.rows), *declared.values())
    own = {u.name for u in plant.inputs}
    rates = {name: of for step in steps for name, of in derived(step.inputs).items() if name not in own}
    said = verdicts(calibration, rows, HELD_OUT if held_out else ALL)
    notes = (*logs.notes(), *said_of(rates), *said, *too_far(aheads, rows[0].errors))
    return tuple(_row(calibration, row) for row in rows), notes


def renamed(model: Model, rows: Iterable[Named], word: str) -> tuple[Named, ...]:
    """Rows with names that the model's own tunings do not have: of these one gets a `word` behind."""
    own = replace(model, tables={}).tuning.tables
    return tuple(replace(row, name=f"{row.name}_{word}" if row.name in own else row.name) for row in rows)


def forms_asked(model: Model, deep: bool) -> tuple[Row, ...]:
    """That which is set, else those of the model's own tunings and those that its plant is in; those that take seconds
    if `deep`."""
    if model.setting.form:
        return (of(model.setting.form, model.plant),)
    return (*_own_forms(model), *everywhere(model.plant, deep=deep))


def _own_forms(model: Model) -> Iterator[Row]:
    """The forms that the model's own tunings make by a function of theirs, which no survey of the plant knows."""
    seen: list[Any] = []
    for name, table in model.tuning.tables.items():
        make = table.get("form") if isinstance(table, Mapping) else None
        if callable(make) and make not in seen:
            seen.append(make)
            form = model.tuning.form(name)
            verdict = worst(form.checks).verdict
            why = because("as the tuning {name}", name=name)
            yield Row(form.kind, verdict, (), why, form=form, options={"of": name})


def _declared(model: Model, dt: float) -> dict[str, CallableStep]:
    """The steps of the model's own tunings at the period of the record, as far as there are."""
    steps, refused = {}, {}
    own = replace(model, setting=replace(model.setting, dt=dt), tables={}, take="")
    for name in own.tuning.tables:
        with warnings.catch_warnings(record=True) as raised:
            warnings.simplefilter("always")
            try:
                steps[f"{name}, as declared"] = own.step(name)
            except HgogenError as error:
                refused[name] = str(error)
        for one in raised:
            note(f"of the model's own tuning {name}: {one.message}")
    for name, reason in refused.items():
        note(f"no step at {dt:g} {model.plant.time} of the model's own tuning {name}: {reason}")
    return steps


def _row(calibration: Calibration, row: Judged) -> TunedRow:
    tuned = next((one for one in calibration.rows if one.name == row.name), None)
    gains = None
    if tuned is not None:
        used, likelihood = cost(tuned.first.step), tuned.noise.likelihood if tuned.noise else None
        known = KNOWN[tuned.first.known][0]
        counts = used.operations, used.functions, used.state
        gains = TunedGains(tuned.first.row.name, tuned.error, known, *counts, likelihood)
    errors = {str(h): dict(errors) for h, errors in row.errors.items()}
    return TunedRow(row.name, gains, errors, row.hidden, row.nis, row.coloured)
