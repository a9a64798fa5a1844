"""The commands `tune` and `advise`: observer gains from measured logs, or from a plant's ranges alone."""

import json
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import typer
from rich.console import Group
from rich.text import Text

from hgogen import observers as kinds
from hgogen.call import CallableStep
from hgogen.check import worst
from hgogen.commands.advice import KNOWN
from hgogen.commands.command import (
    NO_COLUMNS,
    Columns,
    Data,
    Deep,
    HeldOut,
    Jobs,
    ModelArgument,
    ModelReport,
    OneTrial,
    Out,
    Shift,
    Truth,
    begun_work,
    command,
    early,
    explained,
    horizons,
    names_in,
    numbers_by_name,
    one_or_all,
)
from hgogen.commands.data import Logs, demand_in_time, fault_lines, logs_of, too_far, truth_of, truth_options
from hgogen.commands.output import (
    Bar,
    Folder,
    Written,
    cell,
    filled,
    folder_of,
    headed,
    interruptible,
    note,
    refusals_table,
    rendered,
)
from hgogen.commands.trial_runs import trials_or_proposed
from hgogen.emit.cost import cost
from hgogen.errors import HgogenError
from hgogen.estimators.gate import Gates
from hgogen.estimators.noise import deviation_lines
from hgogen.logs.advise import Advised, advise
from hgogen.logs.finding import Finding
from hgogen.logs.judged import ALL, HELD_OUT, Judged, ValidationLog, judged, verdicts
from hgogen.logs.likelihood import SURE
from hgogen.logs.records import step_limits
from hgogen.logs.tune import ADAPTIVE, FILTER, STOPPED, Calibration, Tuned, tune
from hgogen.model import Model, load
from hgogen.modelfiles.json_file import equations
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.modelfiles.tuning import everywhere
from hgogen.reading.measured import WINDOWS, difference_notes
from hgogen.sentence import because
from hgogen.signal import derived
from hgogen.system import System
from hgogen.trial import NoTrial
from hgogen.which_forms import Row, of

Named = TypeVar("Named", Tuned, Advised)  # a row of gains, which has a name

TunedOn = Annotated[
    Literal["predictions", "truth"],
    typer.Option("--tune-on", help="Choose gains by predictions, or by the truth of --truth."),
]

Gating = Annotated[
    list[str] | None,
    typer.Option("--gate", metavar="A,B=P", help="Innovation gate of outputs that pass together; repeatable."),
]
Names = Annotated[
    str | None,
    typer.Option("--observers", "--observer", metavar="A,B,..", help="By default all.", callback=explained),
]


@dataclass(frozen=True)
class TunedGains:
    """The properties of tuned gains that are not computed for declared gains."""

    form: Annotated[str, "the form the observer is built on"]
    error: Annotated[float, "cross-validated error, in errors of copying or, tuned on the truth, of the mean"]
    known: Annotated[str, "what is known of the convergence"]
    operations: Annotated[int, "operations of one call"]
    functions: Annotated[int, "functions (sine, exponential, root, ..) of one call"]
    state: Annotated[int, "bytes of the state"]
    likelihood: Annotated[float | None, "log likelihood of a sample; null where noise was not estimated"]


@dataclass(frozen=True, eq=False)
class TunedRow:
    """An observer with tuned or declared gains; `gains` is set for tuned ones only."""

    json_keys = (
        "name=judged.name *gains held_out=judged.errors hidden=judged.hidden nis=judged.nis coloured=judged.coloured"
    )

    judged: Judged
    gains: TunedGains | None


BEGUN = "tune_begun.jsonl"  # the results of an unfinished tuning
GO_ON = "the same command with --resume goes on from the last trial"
FAR = 10.0  # factor by which a gain moves only if the rows held out are unlike the others


@dataclass(frozen=True)
class GainChange:
    """A number among the recommended gains, estimated with and without the validation rows."""

    gain: Annotated[str, "its name, as Q w"]
    judged: Annotated[float, "from the rows that were not held out: its errors are in `rows`"]
    final: Annotated[float, "from all rows: it is in `tuning`"]

    @property
    def largest(self) -> float:
        """The larger absolute value of the two estimates."""
        return max(abs(self.judged), abs(self.final))

    @property
    def factor(self) -> float:
        """The ratio of the larger estimate to the smaller, at least 1; infinite for a change of sign."""
        pair = sorted((self.judged, self.final), key=abs)
        return pair[1] / pair[0] if pair[0] * pair[1] > 0 else 1.0 if pair[0] == pair[1] else math.inf


@dataclass(frozen=True, eq=False)
class TuneReport(ModelReport):
    """The observers tuned to measured logs."""

    json_keys = (
        "model equations records=logs.reports findings take tuning ahead truth segments "
        "rows changes refused notes files"
    )

    equations: Annotated[list[str], "the plant's equations"]
    logs: Logs
    calibration: Calibration
    ahead: Annotated[int, "samples ahead by which gains are chosen"]
    segments: Annotated[int, "segments of each record, by which gains that others chose are judged"]
    rows: Annotated[tuple[TunedRow, ...], "errors and costs of each observer"]
    notes: Annotated[tuple[str, ...], "what is doubtful, and which to take"]
    by_tuned: tuple[tuple[Finding, ...], ...]
    files: Written = ()

    @property
    def findings(self) -> tuple[tuple[Finding, ...], ...]:
        """The faults of each log: those found by first gains, then those that only the tuned filter reveals."""
        return tuple((*first, *more) for first, more in zip(self.logs.findings, self.by_tuned, strict=True))

    @property
    def take(self) -> str:
        """Name of the recommended tuning."""
        return self.calibration.best.name

    @property
    def tuning(self) -> dict[str, Mapping[str, Any]]:
        """Tables of the tunings by name; the recommended one is estimated from all rows, including the validation
        rows."""
        return {row.name: row.table for row in self.written}

    @property
    def written(self) -> tuple[Tuned, ...]:
        """The tunings that are written to the file; the recommended one is estimated from all rows."""
        final = {row.name: row for row in self.calibration.final}
        return tuple(final.get(row.name, row) for row in self.calibration.rows)

    @property
    def changes(self) -> tuple[GainChange, ...]:
        """Numbers among the recommended gains, without and with the validation rows; empty without validation rows."""
        return gain_changes(self.calibration.best, self.calibration.final[0]) if self.calibration.final else ()

    @property
    def truth(self) -> tuple[str, ...]:
        """The states whose measured truth was used for tuning."""
        return tuple(self.calibration.truth)

    @property
    def refused(self) -> dict[str, str]:
        """Why observers have no gains, by name."""
        return dict(self.calibration.refused)

    def tables(self) -> Iterator[Any]:
        """Yield the observers."""
        ahead = [(h, y) for h, errors in self.rows[0].judged.errors.items() for y in errors]
        hidden = list(self.rows[0].judged.hidden)
        none = "in all rows, since none were held out"
        where = "in the rows held out, from which these gains were not learned" if self.logs.held_out else none
        title = f"RMS errors {where}: predictions by output and samples ahead, then hidden states"
        columns = *(f"{y} {h}" for h, y in ahead), *hidden
        errors = headed(title, "", "observer", *columns, numbers=len(columns))
        copying = "the error of predictions divided by that of copying the last value"
        measure = f"the error of {', '.join(self.truth)} divided by that of the mean" if self.truth else copying
        names = ("", "observer", "form", "cross-validated", "NIS", "operations", "state", "convergence")
        comparison = headed(f"tuned observers; cross-validated: {measure}", *names)
        for row in self.rows:
            one, gains = row.judged, row.gains
            mark = "take" if one.name == self.take else ""
            numbers = *(one.errors[h][y] for h, y in ahead), *map(one.hidden.get, hidden)
            errors.add_row(mark, one.name, *map(cell, numbers))
            if gains is not None:
                nis = ", ".join(f"{each:.2g}" for each in one.nis.values())
                cost = f"{gains.operations}", f"{gains.state} B"
                comparison.add_row(mark, one.name, gains.form, f"{gains.error:.3g}", nis, *cost, gains.known)
        steps = {row.name: row.first.step for row in self.written}
        noise = [Text(f"{name}: {line}") for name, step in steps.items() for line in deviation_lines(step)]
        title = f"gains of {self.take}: the errors above are those of the first column; the file has the second"
        changes = headed(title, "gain", "without rows held out", "from all rows", numbers=2)
        for gain in self.changes:
            changes.add_row(gain.gain, cell(gain.judged), cell(gain.final))
        yield Group(
            errors,
            "",
            comparison,
            "",
            *filled(changes),
            *noise,
            *fault_lines(one for faults in self.by_tuned for one in faults),
            *map(Text, self.notes),
            "",
            *refusals_table(self.refused),
        )


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
    between: Annotated[
        Literal["hold", "line"], typer.Option(help="Inputs between samples: held constant, or interpolated linearly.")
    ] = "line",
    held_out: HeldOut = None,
    ahead: Annotated[int, typer.Option(min=1, help="Samples ahead of the predictions by which gains are chosen.")] = 1,
    gate: Gating = None,
    robust: Annotated[
        bool, typer.Option("--robust", help="Ignore outliers when gains are learned, without a gate.")
    ] = False,
    segments: Annotated[
        int, typer.Option(min=2, help="Segments of each log. Each judges gains that were learned on the others.")
    ] = 5,
    horizon: Annotated[
        str, typer.Option(help="Samples ahead of the printed prediction errors, such as 1,5,25.")
    ] = "1,5,25",
    deep: Deep = False,
    jobs: Jobs = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue the same command, which was stopped, from its last trial.")
    ] = False,
    out: Out = None,
) -> TuneReport:
    """Tune all observers that accept the plant by measured logs, and recommend one. Other commands use the gains by
    `--tuning tuned.json`.
    """
    aheads, names = horizons(horizon, "--horizon"), names_in(observers, "--observers")
    loaded = load(model).set(setting)
    demand_in_time(loaded, shift)
    plant, folder = loaded.plant, folder_of(out, loaded)
    path, _ = folder.demand("tuned.json", BEGUN)
    if resume:
        begun_work(folder, BEGUN, "tuning")
    true = truth_of(plant, truth or ())
    if tune_on == "truth" and not true:
        raise typer.BadParameter("needs a measured state; add --truth STATE=COLUMN", param_hint="--tune-on")
    logs = logs_of(
        plant,
        data,
        held_out,
        dt=setting.longest,
        named=columns,
        shift=shift,
        other_columns=dict(true.values()),
        options=truth_options(true),
        window=WINDOWS[between],
        varying=bool(loaded.limits),
    ).inspected(loaded)
    early(*logs.summaries())
    limits = loaded.limits or step_limits(logs.whole)
    measured = [
        {state: each[name] for state, (name, _) in true.items()}
        for each in logs.columns([name for name, _ in true.values()])
    ]
    cut_courses = zip(measured[: logs.given], logs.cuts, strict=False)
    training_truth = [{state: course[:cut] for state, course in each.items()} for each, cut in cut_courses]
    tuned = partial(
        tune,
        plant,
        ahead=ahead,
        segments=segments,
        between=between,
        method=setting.method or "continuous_discrete",
        real=setting.real or "double",
        gate=gates_of(gate or ()),
        robust=robust,
        dt=limits,
        jobs=jobs,
    )
    courses = "truth" if tune_on == "truth" else "compared"
    trained, final_truth = ({courses: known if true else ()} for known in (training_truth, measured[: logs.given]))
    forms = requested_forms(loaded, deep)
    first = partial(tuned, *logs.learned, observers=names or None, rows=forms, **trained)
    again = partial(tuned, *logs.allowed, **final_truth) if logs.parted else None
    with _kept_results(folder, resume) as done:
        searches, number = (partial(first, done=done), again), len(names) or len(kinds.__all__)
        calibration, reason, stopped = _searched(*searches, number, path)
    own, final = (renamed(loaded, rows, "tuned") for rows in (calibration.rows, calibration.final))
    calibration = replace(calibration, rows=own, final=final)
    changes, by_tuned = _change_of_gains(calibration, reason), _faults_by_tuned(logs, calibration)
    rows, notes = _judged(loaded, calibration, logs, measured, aheads, changes, limits, explained=any(by_tuned))
    report = TuneReport(loaded.path, equations(plant), logs, calibration, ahead, segments, rows, notes, by_tuned)
    saved = folder.save(report, "tuned.json")
    if stopped:
        raise KeyboardInterrupt
    folder.remove(BEGUN)
    return saved


class _Results(dict[str, Any]):
    """The results of trials by name, stored as lines of a file; lines that hold no result are ignored."""

    def __init__(self, lines: Iterable[str], add: Callable[[str], None]) -> None:
        self._add = add
        for line in lines:
            with suppress(ValueError, TypeError, RecursionError):
                trial, result = json.loads(line)
                super().__setitem__(trial, result)

    def __setitem__(self, trial: str, result: Any) -> None:
        super().__setitem__(trial, result)
        self._add(json.dumps([trial, result]) + "\n")


@contextmanager
def _kept_results(folder: Folder, resume: bool) -> Iterator[_Results]:
    """Yield the results of a tuning's trials; new ones are appended to a file in the folder, from which a later call
    with `resume` continues."""
    if not resume:
        folder.remove(BEGUN)
    results: _Results | None = None
    try:
        with folder.lines(BEGUN) as (lines, add):
            results = _Results(lines, add)
            yield results
    finally:
        if results is not None and not results:  # as where an argument is refused
            folder.remove(BEGUN)


def _searched(
    first: Callable[..., Calibration], again: Callable[..., Calibration] | None, observers: int, path: Path
) -> tuple[Calibration, str, bool]:
    """Return the calibration by the search `first`, with its best row estimated `again` from all rows; the reason if
    that failed; and whether Ctrl-C ended the search, in which case the observers tuned so far are written to the file
    `path`."""
    so_far, trials = list[Calibration](), count(1)

    def ended(calibration: Calibration) -> None:
        before = {row.name for one in so_far[-1:] for row in one.rows}
        so_far.append(calibration)
        bar.tick()
        new = ((row, KNOWN[row.first.convergence][0]) for row in calibration.rows if row.name not in before)
        note(*(f"{row.name}: cross-validated {row.error:.3g}, convergence {known}" for row, known in new))

    def tried(_: str) -> None:
        check()
        bar.tick(f"observers, {next(trials)} trials", 0)

    try:
        with Bar("observers", observers + 2 * (again is not None)) as bar, interruptible() as check:
            calibration = first(each=tried, ended=ended)
            if again is None:
                return calibration, "", False
            return *tuned_again(calibration, partial(again, each=tried, ended=lambda _: bar.tick())), False
    except KeyboardInterrupt:
        if not any(one.rows for one in so_far[-1:]):
            note(f"the tuning was stopped; {GO_ON}")
            raise
        calibration = so_far[-1]
        have = ", ".join(row.name for row in calibration.rows)
        missing = ", ".join(name for name, why in calibration.refused.items() if why == STOPPED) or "none"
        note(f"stopped; goes to {path}: {have}; missing: {missing}; another Ctrl-C leaves {path.name} as it was")
        note(GO_ON)
        return calibration, "the search was stopped" if again else "", True


def tuned_again(calibration: Calibration, tune_on_all_rows: Callable[..., Calibration]) -> tuple[Calibration, str]:
    """Return the calibration with its best row, and the Kalman filter on the same plant, tuned again on all rows (the
    better one is recommended), and ""; or the unchanged calibration and the reason."""
    best, names = calibration.best, {row.name for row in calibration.rows}
    again = [name for name in dict.fromkeys((best.name, FILTER)) if name in names]
    forms = {id(row): row for row in (calibration[name].first.row for name in again)}
    try:
        known = [calibration[name] for name in again]
        result = tune_on_all_rows(observers=again, rows=forms.values(), begin=known)
    except HgogenError as error:
        return calibration, str(error)
    final = replace(result, rows=tuple(row for row in result.rows if row.name in again))
    if not any(row.name == best.name for row in final.rows):
        return calibration, result.refused.get(best.name, "")
    take = final.best
    return replace(calibration, final=(take, *(row for row in final.rows if row is not take))), ""


def _faults_by_tuned(logs: Logs, calibration: Calibration) -> tuple[tuple[Finding, ...], ...]:
    """Return the faults of each log that the tuned filter reveals, but first gains did not. Where their Q and R are far
    from the true ones, the assumed noise hides a late or biased sensor."""
    rows = (*calibration.final, *calibration.rows)
    tuned_filter = next((row for row in rows if row.first.observer == FILTER and row.name != ADAPTIVE), None)
    if tuned_filter is None:
        return ((),) * len(logs.records)
    with Bar("looking for faults with tuned gains", 1):
        return logs.inspected_again(tuned_filter.first.step)


def gain_changes(judged: Tuned, final: Tuned) -> tuple[GainChange, ...]:
    """Return each number among the gains of an observer in two tunings."""
    before, after = (dict(numbers_in(one.first.starting.gains)) for one in (judged, final))
    return tuple(GainChange(name, before[name], after[name]) for name in before if name in after)


def _change_of_gains(calibration: Calibration, reason: str) -> Iterator[str]:
    """Yield a sentence on how far the recommended gains moved when all rows were used; `reason`: why they could not be
    estimated from all rows, or ""."""
    take = calibration.best
    if reason:
        yield f"the gains of {take.name} were learned without the rows held out, since all rows give none: {reason}"
    if not calibration.final:
        return
    least = {f"Q {name}": SURE * unit for name, unit in take.numbers.units.items()}  # less moves nothing
    changes = [one for one in gain_changes(take, calibration.final[0]) if one.largest >= least.get(one.gain, 0.0)]
    text = (
        f"the errors above are those of gains of {take.name} learned without the rows held out; the file has "
        "its gains from all rows"
    )
    farthest = max(changes, key=lambda one: one.factor, default=None)
    if farthest is None or farthest.factor == 1:
        yield f"{text}; both gains are the same"
        return
    far = f"{farthest.gain} changes most, from {farthest.judged:.2g} to {farthest.final:.2g}"
    unlike = ": the rows held out are unlike the others; judge these gains on another log, by --held-out FILE"
    yield f"{text}; {far}{unlike if farthest.factor > FAR else ''}"


def numbers_in(gains: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers in nested gains, each with the keys that lead to it as its name, such as "Q w"."""
    if isinstance(gains, Mapping | list | tuple):
        pairs = gains.items() if isinstance(gains, Mapping) else enumerate(gains, 1)
        for key, each in pairs:
            yield from numbers_in(each, f"{name} {key}".strip())
    elif isinstance(gains, int | float):
        yield name, float(gains)


def gates_of(texts: Iterable[str]) -> Gates:
    """Return the probability of each innovation gate by its outputs, from texts such as "px, py=0.999". Raises:
    `BadParameter`."""
    gates: dict[str | tuple[str, ...], Any] = {}
    for text in texts:
        outputs, _, probability = text.rpartition("=")
        try:
            gates[outputs.strip()] = float(probability)
        except ValueError:
            reason = f"{text!r:.60} is not OUTPUTS=PROBABILITY, such as y=0.999"
            raise typer.BadParameter(reason, param_hint="--gate") from None
    return gates


_WITHOUT_PERIODS = (
    "the tuned observers have no periods, as the model's own have: give NaN for a sensor without a sample in a call"
)


def _judged(
    model: Model,
    calibration: Calibration,
    logs: Logs,
    measured: Sequence[Mapping[str, np.ndarray]],
    aheads: Sequence[int],
    changes: Iterable[str],
    limits: tuple[float, float] | None,
    explained: bool,
) -> tuple[tuple[TunedRow, ...], tuple[str, ...]]:
    plant = model.plant
    validation_logs = [ValidationLog(logs.whole[k], cut, measured[k]) for k, cut in logs.judging.items()]
    declared = _declared(model, limits or logs.whole[0].dt)
    with Bar("judging", len(calibration.rows) + len(declared)) as bar:
        rows = judged(plant, calibration, declared, validation_logs, aheads, bar.tick)
    steps = (*(one.first.step for one in calibration.rows), *declared.values())
    input_names = {u.name for u in plant.inputs}
    rates = {name: of for step in steps for name, of in derived(step.inputs).items() if name not in input_names}
    judgements = verdicts(
        calibration, rows, HELD_OUT if logs.held_out else ALL, explained=explained or any(logs.findings)
    )
    far = too_far(aheads, rows[0].errors)
    shares = (f"left out as outliers: {share}" for share in calibration.gates)
    without = (_WITHOUT_PERIODS,) if any(step.clock.every for step in declared.values()) else ()
    notes = (*logs.notes(), *difference_notes(rates), *shares, *without, *changes, *far, *judgements)
    return tuple(_row(calibration, row) for row in rows), notes


def renamed(model: Model, rows: Iterable[Named], word: str) -> tuple[Named, ...]:
    """Return the rows; `word` is appended to the names that already belong to one of the model's own tunings."""
    declared_tables = replace(model, tables={}).tuning.tables
    return tuple(replace(row, name=f"{row.name}_{word}" if row.name in declared_tables else row.name) for row in rows)


def requested_forms(model: Model, deep: bool) -> tuple[Row, ...]:
    """Return the candidate forms for tuning: the form that the user has set, else the forms of the model's own tunings,
    followed by those that the plant is in (the slow ones only if `deep`)."""
    if model.setting.form:
        return (of(model.setting.form, model.plant),)
    return (*_custom_forms(model), *everywhere(model.plant, deep=deep))


def _custom_forms(model: Model) -> Iterator[Row]:
    visited: list[Any] = []
    for name, table in model.tuning.tables.items():
        function = table.get("form") if isinstance(table, Mapping) else None
        if callable(function) and function not in visited:
            visited.append(function)
            form = model.tuning.form(name)
            verdict = worst(form.checks).verdict
            why = because("as the tuning {name}", name=name)
            yield Row(form.kind, verdict, (), why, form=form, options={"of": name})


def _declared(model: Model, dt: float | tuple[float, float]) -> dict[str, CallableStep]:
    steps, refused = {}, {}
    model_at_dt = replace(model, setting=replace(model.setting, dt=dt), tables={}, take="")
    for name in model_at_dt.tuning.tables:
        with warnings.catch_warnings(record=True) as raised:
            warnings.simplefilter("always")
            try:
                steps[f"{name}, as declared"] = model_at_dt.step(name)
            except HgogenError as error:
                refused[name] = str(error)
        for one in raised:
            note(f"tuning {name} of the model: {one.message}")
    for name, reason in refused.items():
        at = " to ".join(f"{end:g}" for end in (dt if isinstance(dt, tuple) else (dt,)))
        note(f"tuning {name} of the model has no step at dt = {at} {model.plant.time}: {reason}")
    return steps


def _row(calibration: Calibration, row: Judged) -> TunedRow:
    tuned = next((one for one in calibration.rows if one.name == row.name), None)
    gains = None
    if tuned is not None:
        used, likelihood = cost(tuned.first.step), tuned.noise.likelihood if tuned.noise else None
        known = KNOWN[tuned.first.convergence][0]
        counts = used.operations, used.functions, used.state
        gains = TunedGains(tuned.first.row.name, tuned.error, known, *counts, likelihood)
    return TunedRow(row, gains)


@dataclass(frozen=True, eq=False)
class AdvisedRow:
    """Proposed gains of an observer as printed in JSON."""

    json_keys = (
        "name=gains.name form theta=gains.theta certified=gains.certified settles settled=gains.own.settled noise "
        "sigma=gains.sigma known operations tried=gains.tried"
    )

    gains: Advised

    @property
    def form(self) -> str:
        """The form the observer is built on."""
        return self.gains.first.row.name

    @property
    def settles(self) -> float | None:
        """The smallest theta tried that settles."""
        gains = self.gains
        return gains.settles.theta if gains.settles and gains.theta is not None else None

    @property
    def settled(self) -> float | None:
        """The settling time with the proposed theta."""
        return self.gains.own.settled if self.gains.own else None

    @property
    def noise(self) -> Mapping[str, float]:
        """RMS error of the estimate by noise alone, by state."""
        return self.gains.own.noise if self.gains.own else {}

    @property
    def known(self) -> str:
        """The verdict on convergence."""
        return KNOWN[self.gains.first.convergence][0]

    @property
    def operations(self) -> int:
        """Operations of one call."""
        return cost(self.gains.first.step).operations

    @property
    def drowned(self) -> tuple[str, ...]:
        """The names of the states of which noise alone makes an RMS error above half of the declared range."""
        states = self.gains.first.step.observer.form.system.declared.states
        half = {x.name: (x.interval[1] - x.interval[0]) / 2 for x in states if x.bounded}
        return tuple(name for name, rms in self.noise.items() if rms > half.get(name, math.inf))

    @property
    def rank(self) -> tuple[bool, bool, int, int]:
        """The sort key: rows that settle first, then those not drowned in noise, then by verdict, then by cost."""
        return self.settled is None, bool(self.drowned), KNOWN[self.gains.first.convergence][1], self.operations


@dataclass(frozen=True, eq=False)
class AdviceReport(ModelReport):
    """The proposed gains of observers without a log."""

    json_keys = "model equations take tuning trial rows refused notes files"

    equations: Annotated[list[str], "the plant's equations"]
    trial: Annotated[str | None, "name of the trial; null where none is tried"]
    rows: Annotated[tuple[AdvisedRow, ...], "the gains of each observer"]
    refused: Annotated[Mapping[str, str], "why observers have no gains, by name"]
    unit: str
    files: Written = ()

    @property
    def take(self) -> str:
        """Name of the recommended tuning."""
        return min(self.rows, key=lambda row: row.rank).gains.name

    @property
    def tuning(self) -> dict[str, Mapping[str, Any]]:
        """Tables of the tunings by name."""
        return {row.gains.name: row.gains.table for row in self.rows}

    @property
    def notes(self) -> list[str]:
        """Sentences on states that are drowned in noise, and on each proposed theta, the certified and the settling."""
        drowned = {row.gains.name: row.drowned for row in self.rows if row.drowned}
        noisy = [f"{name}: noise alone moves {', '.join(x)} by over half its range" for name, x in drowned.items()]
        return [*noisy, *(row.gains.sentence for row in self.rows if row.gains.sentence)]

    def figures(self, plant: System) -> dict[str, Any]:
        """Return the figure of settling time and noise over theta; none if only one theta was tried."""
        from hgogen.run import figures

        compared = [row.gains for row in self.rows if len(row.gains.tried) > 1]
        widths = {x.name: x.interval[1] - x.interval[0] if x.bounded else 1.0 for x in plant.states}
        settled, noise = {}, {}
        for one in compared:
            settled[one.name] = [(each.theta, each.settled) for each in one.tried if each.settled]
            worst = (max(v / widths.get(x, 1.0) for x, v in each.noise.items()) for each in one.tried)
            noise[one.name] = [(each.theta, most) for each, most in zip(one.tried, worst, strict=True)]
        return {"advised": figures.over_theta(settled, noise, plant.time)} if compared else {}

    def tables(self) -> Iterator[Any]:
        """Yield a table with the proposed gains of each observer and their results on the trial."""
        states = list(dict.fromkeys(state for row in self.rows for state in row.noise))
        numbers = ("theta", "certified from", "settles from", f"settles in ({self.unit})")
        table = headed("gains from ranges, noise and period", "", "observer", "form", *numbers, numbers=len(numbers))
        sigmas = ", ".join(f"{output} = {sigma:.3g}" for output, sigma in self.rows[0].gains.sigma.items())
        title = (
            f"noise: the RMS error that noise alone causes in an estimate on the trial, for samples with sigma {sigmas}"
        )
        alone = headed(title, "", "observer", "convergence", *states, numbers=len(states))
        for row in self.rows:
            first = "take" if row.gains.name == self.take else "", row.gains.name
            gains = (row.gains.theta, row.gains.certified, row.settles, row.settled)
            table.add_row(*first, row.form, *map(cell, gains))
            alone.add_row(*first, row.known, *map(cell, map(row.noise.get, states)))
        yield Group(table, "", alone, "", *map(Text, self.notes), "", *refusals_table(self.refused))


@command(AdviceReport)
def advise_(
    model: ModelArgument,
    observers: Names = None,
    setting: Setting = AS_WRITTEN,
    noise: Annotated[
        list[str] | None,
        typer.Option("--noise", metavar="OUTPUT=SIGMA", help="Standard deviation of a sample. May be repeated."),
    ] = None,
    settling: Annotated[
        float | None, typer.Option(help="The desired settling time, in the model's unit of time.")
    ] = None,
    trial: OneTrial = None,
    deep: Deep = False,
    jobs: Jobs = None,
    out: Out = None,
) -> AdviceReport:
    """Propose gains for all observers that accept the plant, from its ranges, the sensor noise, the sampling period and
    a desired settling time, and simulate other values of theta. Other commands use the gains by `--tuning
    advised.json`.
    """
    loaded = load(model).set(setting)
    plant, folder = loaded.plant, folder_of(out, loaded)
    folder.demand("advised.json")
    sigmas = numbers_by_name(noise or (), "--noise")
    try:
        chosen = one_or_all(trials_or_proposed(loaded), trial)[0]
    except NoTrial as error:
        chosen = None
        note(f"values of theta are not tried: {error}")
    names = names_in(observers, "--observers")
    with Bar("observers", len(names) or len(kinds.__all__)) as bar:
        advised, refused = advise(
            plant,
            dt=loaded.period,
            noise=sigmas,
            settling=settling,
            observers=names or None,
            trial=chosen,
            rows=requested_forms(loaded, deep),
            jobs=jobs,
            each=lambda _: bar.tick(),
        )
    rows = tuple(map(AdvisedRow, renamed(loaded, advised, "advised")))
    tried_on = chosen.name if chosen else None
    report = AdviceReport(loaded.path, equations(plant), tried_on, rows, refused, plant.time)
    return folder.save(report, "advised.json", rendered(report.figures(plant)))
