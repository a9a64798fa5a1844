"""The command `tune`: gains of observers from measured records."""

import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from enum import StrEnum
from typing import Annotated, Any, TypeVar

import typer

from hgogen.calibration.advise import Advised
from hgogen.calibration.grid import Calibration, Tuned
from hgogen.calibration.judged import ALL, HELD_OUT, Held, Judged, judged, verdicts
from hgogen.calibration.tune import tune
from hgogen.call import CallableStep
from hgogen.check import worst
from hgogen.commands import log_tables
from hgogen.commands.advice import KNOWN
from hgogen.commands.command import (
    Bar,
    Jobs,
    Json,
    ModelArgument,
    Out,
    command,
    engine_here,
    folder_of,
    json_text,
    show,
)
from hgogen.commands.headed import file_list
from hgogen.commands.logs import (
    Between,
    Data,
    Deep,
    HeldOut,
    Shift,
    Truth,
    horizons,
    logs_of,
    names_in,
    too_far,
    truth_of,
    truth_options,
)
from hgogen.commands.process import note
from hgogen.commands.running import Map, Period, Time
from hgogen.emit.cost import cost
from hgogen.errors import HgogenError
from hgogen.model import Model, load
from hgogen.modelfiles.first import everywhere
from hgogen.modelfiles.json_file import equations
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.reading.averaged import WINDOWS
from hgogen.reading.differences import derived, said_of
from hgogen.sentence import because
from hgogen.which_forms import Row, of

Named = TypeVar("Named", Tuned, Advised)  # a row of gains, which has a name


class TunedOn(StrEnum):
    """What gains are chosen by."""

    PREDICTIONS = "predictions"
    TRUTH = "truth"


Names = Annotated[str | None, typer.Option("--observers", "--observer", metavar="A,B,..", help="By default all.")]


@command()
def tune_(
    model: ModelArgument,
    data: Data,
    observers: Names = None,
    setting: Setting = AS_WRITTEN,
    time: Time = None,
    period: Period = None,
    map_: Map = None,
    shift: Shift = None,
    truth: Truth = None,
    tune_on: Annotated[
        TunedOn, typer.Option("--tune-on", help="Choose gains by predictions, or by the truth of --truth.")
    ] = TunedOn.PREDICTIONS,
    between: Annotated[Between, typer.Option(help="How inputs go on between samples.")] = Between.LINE,
    held_out: HeldOut = 0.3,
    ahead: Annotated[int, typer.Option(min=1, help="Samples ahead by which gains are chosen.")] = 1,
    segments: Annotated[
        int, typer.Option(min=2, help="Of each record, by which gains that others chose are judged.")
    ] = 5,
    horizon: Annotated[str, typer.Option(help="Samples ahead of the errors held out, such as 1,5,25.")] = "1,5,25",
    deep: Deep = False,
    jobs: Jobs = None,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Tune the observers that a plant admits to measured records, and say which to take. The file `tuned.json` that it
    writes is what `--tuning` of every command that makes a step takes.

    JSON keys: model, equations (of its plant), records (as in `run`), tuning (tables by name), take, ahead, truth (the
    states tuned on), segments, rows (name, form, error: cross-validated, in errors of copying, errors held out by
    samples ahead and output, hidden by state, nis by output, coloured by output: how many correlations of the
    innovations are not those of white noise, known: of its convergence, operations, functions, state in bytes,
    likelihood), refused (why, by observer), notes, files.
    """
    aheads, names = horizons(horizon, "--horizon"), names_in(observers, "--observers")
    loaded = load(model).set(setting)
    plant, folder = loaded.plant, folder_of(out, loaded)
    folder.demand("tuned.json")
    true = truth_of(plant, truth or ())
    if tune_on is TunedOn.TRUTH and not true:
        raise typer.BadParameter(
            "truth is asked for and there is none; add --truth STATE=COLUMN", param_hint="--tune-on"
        )
    beside = dict(true.values())
    logs = logs_of(
        plant,
        data,
        held_out,
        dt=setting.dt,
        time=time,
        period=period,
        pairs=map_,
        shift=shift,
        beside=beside,
        options=truth_options(true),
        window=WINDOWS[between.value],
    )
    measured = [{state: columns[name] for state, (name, _) in true.items()} for columns in logs.columns(list(beside))]
    seen = [
        {state: course[:cut] for state, course in each.items()} for each, cut in zip(measured, logs.cuts, strict=True)
    ]
    with Bar("trials", None) as bar:
        calibration = tune(
            plant,
            *logs.learned,
            observers=names or None,
            ahead=ahead,
            segments=segments,
            truth=seen if tune_on is TunedOn.TRUTH else (),
            between=between.value,
            method=setting.method or "continuous_discrete",
            real=setting.real or "double",
            rows=forms_asked(loaded, deep),
            jobs=jobs,
            each=lambda _: bar.tick(),
        )
    calibration = replace(calibration, rows=renamed(loaded, calibration.rows, "tuned"))
    held = [
        Held(log, cut if held_out else 0, each) for log, cut, each in zip(logs.whole, logs.cuts, measured, strict=True)
    ]
    declared = _declared(loaded, logs.whole[0].dt)
    rows = judged(plant, calibration, declared, held, aheads, engine_here())
    steps = (*(one.first.step for one in calibration.rows), *declared.values())
    own = {u.name for u in plant.inputs}
    rates = {name: of for step in steps for name, of in derived(step.inputs).items() if name not in own}
    said = verdicts(calibration, rows, HELD_OUT if held_out else ALL)
    notes = (*logs.notes(), *said_of(rates), *said, *too_far(aheads, rows[0].errors))
    paths = folder.demand("tuned.json")
    each = [_row(calibration, row) for row in rows]
    report = {
        "model": loaded.path,
        "equations": equations(plant),
        "records": [record.report for record in logs.records],
        "take": calibration.best.name,
        "tuning": {row.name: row.table for row in calibration.rows},
        "ahead": ahead,
        "truth": list(calibration.truth),
        "segments": segments,
        "rows": each,
        "refused": dict(calibration.refused),
        "notes": list(notes),
        "files": list(map(str, paths)),
    }
    folder.write({"tuned.json": json_text(report) + "\n"})
    shown = (
        *(log_tables.report(record.report) for record in logs.records),
        log_tables.tuned(each, calibration.best.name, notes, calibration.refused, bool(held_out), calibration.truth),
    )
    show(as_json, report, *shown, file_list(paths))


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


def _row(calibration: Calibration, row: Judged) -> dict[str, Any]:
    """For JSON and the table."""
    tuned = next((one for one in calibration.rows if one.name == row.name), None)
    gains: dict[str, Any] = {}
    if tuned is not None:
        used = cost(tuned.first.step)
        gains = {
            "form": tuned.first.row.name,
            "error": tuned.error,
            "known": KNOWN[tuned.first.known][0],
            "operations": used.operations,
            "functions": used.functions,
            "state": used.state,
            "likelihood": tuned.noise.likelihood if tuned.noise else None,
        }
    return {
        "name": row.name,
        **gains,
        "held_out": {str(h): dict(errors) for h, errors in row.errors.items()},
        "hidden": dict(row.hidden),
        "nis": dict(row.nis),
        "coloured": dict(row.coloured),
    }
