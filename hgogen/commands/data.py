"""Measured logs on the command line: the columns of signals, the validation rows, and the summary of a log."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Group, RenderableType
from rich.text import Text

from hgogen.call import CallableStep
from hgogen.commands.command import Columns, engine_here, once
from hgogen.commands.output import Bar
from hgogen.errors import HgogenError
from hgogen.logs.changes import Better
from hgogen.logs.clocks import is_of_unit, time_findings
from hgogen.logs.finding import Finding
from hgogen.logs.findings import ReadOptions, findings
from hgogen.logs.records import Log, demand_regular, log_of, range_warnings, step_limits
from hgogen.model import Model
from hgogen.reading.log import mapping, shifts_of
from hgogen.reading.measured import COMMAND, WITHOUT_PERIOD, Record, Report, Window, read
from hgogen.run.samples import Run
from hgogen.sentence import by_reason
from hgogen.system import System

HELD_OUT, LARGEST_PART = 0.3, 0.9  # part at the end of each log that judges: by default, and at most


@dataclass(frozen=True, eq=False)
class Logs:
    """The logs of a plant. In each log, the rows from its entry in `cuts` on are validation rows (none if that is the
    log's length). The first `given` logs are used for learning, the others only for validation. `faulty`: the signals
    with a fault of each log, None if no observer judged the log."""

    plant: System
    records: tuple[Record, ...]
    cuts: tuple[int, ...]
    given: int
    shifts: Mapping[str, int] = field(default_factory=dict)
    findings: Annotated[tuple[tuple[Finding, ...], ...], "faults of each log"] = ()
    faulty: tuple[tuple[str, ...] | None, ...] = ()

    @property
    def learned(self) -> tuple[Log, ...]:
        """The training rows, those before the cuts, of the logs used for learning."""
        records = zip(self.records[: self.given], self.cuts, strict=False)
        return tuple(log_of(record, self.plant, cut) for record, cut in records)

    @property
    def allowed(self) -> tuple[Log, ...]:
        """The logs used for learning, with all their rows."""
        return self.whole[: self.given]

    @property
    def parted(self) -> bool:
        """Whether a log used for learning has validation rows."""
        return any(len(log.y) > cut for log, cut in zip(self.allowed, self.cuts, strict=False))

    @property
    def held_out(self) -> bool:
        """Whether any log has validation rows."""
        return any(len(log.y) > cut for log, cut in zip(self.whole, self.cuts, strict=True))

    @property
    def judging(self) -> dict[int, int]:
        """The first validation row by the number of each log that has validation rows; 0 for every log if none has
        any."""
        cuts = dict(enumerate(self.cuts))
        lengths = [len(record.t) for record in self.records]
        return {k: cut for k, cut in cuts.items() if cut < lengths[k]} or dict.fromkeys(cuts, 0)

    @property
    def reports(self) -> tuple[Report, ...]:
        """The findings about each log's file, such as gaps and the sampling period."""
        return tuple(record.report for record in self.records)

    @property
    def whole(self) -> tuple[Log, ...]:
        """The logs with all rows, both training and validation rows."""
        return tuple(log_of(record, self.plant) for record in self.records)

    def notes(self) -> tuple[str, ...]:
        """Return sentences on signals that leave the declared ranges, with the file's name if there are several
        logs."""
        several, faulty = len(self.records) > 1, self.faulty or (None,) * len(self.records)
        return tuple(
            f"{record.report.path}: {note}" if several else note
            for record, log, names in zip(self.records, self.whole, faulty, strict=True)
            for note in range_warnings(self.plant, log, names)
        )

    def inspected(self, model: Model, observer: str | None = None) -> "Logs":
        """Return the logs with their faults, found by the step of the model's observer, or of `JUDGE` with first gains;
        only faults of the times if no step can be made."""
        faults, faulty = list[tuple[Finding, ...]](), list[tuple[str, ...] | None]()
        with Bar("looking for faults", 2 * len(self.records)) as bar:
            for record, log in zip(self.records, self.whole, strict=True):
                step, each = (
                    judging_step(model, observer, model.limits or step_limits([log]) or log.dt),
                    [*time_findings(record)],
                )
                bar.tick()
                if step is not None:
                    each = findings_by(step, record, log, self.shifts)
                faults.append(tuple(each))
                faulty.append(None if step is None else faulty_signals(each))
                bar.tick()
        return replace(self, findings=tuple(faults), faulty=tuple(faulty))

    def inspected_again(self, step: CallableStep) -> tuple[tuple[Finding, ...], ...]:
        """Return the faults of each log that a run of this `step` reveals and that are not known yet."""
        pairs = zip(self.records, self.whole, self.findings, strict=True)
        known = [(record, log, {(one.signal, one.fault) for one in faults}) for record, log, faults in pairs]
        return tuple(
            tuple(one for one in findings_by(step, record, log, self.shifts) if (one.signal, one.fault) not in names)
            for record, log, names in known
        )

    def summaries(self) -> Iterator[RenderableType]:
        """Yield the printed summary of each log, and its faults."""
        for report, faults in zip(self.reports, self.findings, strict=True):
            yield log_summary(report)
            yield from fault_lines(faults)
        yield from map(Text, self.notes())

    def columns(self, names: Sequence[str]) -> tuple[dict[str, np.ndarray], ...]:
        """Return by name the columns of each log that are no signals."""
        return tuple({name: record.values[:, record.names.index(name)] for name in names} for record in self.records)


def logs_of(
    plant: System,
    data: Sequence[Path],
    held_out: Sequence[str] | None,
    *,
    dt: float | None = None,
    named: Columns,
    other_columns: Mapping[str, str] = MappingProxyType({}),
    options: Mapping[str, str] = MappingProxyType({}),
    shift: Sequence[str] | None,
    window: Window,
    varying: bool = False,
) -> Logs:
    """Return the logs in files, resampled with the period `dt`, by default with their own period; an irregular log has
    by default the times of its rows. `held_out`: texts of the option --held-out, a share of each log or names of logs
    for validation only; `named`: the columns; `other_columns`: further columns by name, set by the command-line
    `options`; `shift`: texts SIGNAL=SAMPLES, None for none; `window`: the averaging window of inputs; `varying`:
    whether regular logs also have the times of their rows.

    Raises: `BadRecord`.
    """
    mapped = mapping(str(data[0]), named.map_ or (), plant.supplied, plant.outputs)
    columns = {**mapped, **other_columns}
    shifts = shifts_of(str(data[0]), shift or (), plant.supplied, plant.outputs)
    inputs = {s.name: window for s in plant.supplied}
    first = plant.declared
    signals = {s.name: s for s in plant.signals} | {truth_name(x.name): x for x in first.states}
    words: dict[str, Any] = {**named.reading(), "dt": dt, "unit": plant.time}
    words |= {"signals": signals, "inputs": inputs, "caller": replace(COMMAND, others=options)}
    words["own_times"] = "always" if varying else "irregular"
    part, judges = parts_of(held_out or ())
    each = (named.begun(read(path, columns, **words)).shifted(shifts, plant.supplied) for path in (*data, *judges))
    records = tuple(one.without(named.missing or (), plant.supplied, plant.outputs) for one in each)
    for record in records:
        demand_regular(plant, record.report)
    cuts = [round(len(record.t) * (1 - part)) for record in records[: len(data)]]
    return Logs(plant, records, (*cuts, *[0] * len(judges)), len(data), shifts)


def demand_in_time(model: Model, shift: Sequence[str] | None) -> None:
    """Demand a --shift for each output whose samples come late in a tuning of the model, since parameters and gains are
    learned from samples at the rows of their measurement. `shift`: texts SIGNAL=SAMPLES. Raises:
    `typer.BadParameter`."""
    tables = [table for table in model.tuning.tables.values() if isinstance(table, Mapping)]
    late = {y: most for table in tables for y, most in (table.get("delays") or {}).items()}
    shifted = {text.partition("=")[0].strip() for text in shift or ()}
    if missing := {y: most for y, most in late.items() if y not in shifted}:
        options = " ".join(f"--shift {y}={-most}" for y, most in missing.items())
        raise typer.BadParameter(
            f"the model's delays say that samples of {', '.join(missing)} come late, but parameters and gains are "
            f"learned from samples at the rows of their measurement: add {options}, or 0 if the log has them there "
            "already, and map no ages; leave the delays in the model",
            param_hint="--shift",
        )


JUDGE = "riccati"  # the observer that judges logs if the model has none


def judging_step(model: Model, observer: str | None, dt: float | tuple[float, float]) -> CallableStep | None:
    """Return the step with the period `dt` by which a log is judged; None if the model has no observer and no first
    gains."""
    try:
        return model.sampled(dt).step(observer or judging_observer(model)).undelayed
    except HgogenError:
        return None


def judging_observer(model: Model) -> str | None:
    """Return the name of the observer by which logs are judged if the user names none: that of the model's first
    tuning, else `JUDGE`; None for the model's own step."""
    return None if model.has("step") else next(iter(model.tuning.tables), JUDGE)


def log_findings(
    step: CallableStep,
    record: Record,
    run: Run,
    u: np.ndarray,
    y: np.ndarray,
    shifts: Mapping[str, int] = MappingProxyType({}),
    first: int = 0,
) -> tuple[list[Finding], Better | None]:
    """Return the faults of a log u (N, m), y (N, p) by the `run` of a step over it, and a change of signals with which
    the log fits the model better; `shifts`: the shifts that are set; `first`: the sample from which on errors count."""
    times = time_findings(record, step.clock.varying is not None, step.advised)
    if step.dt > step.advised and any(map(is_of_unit, times)):  # no sample can be judged
        return times, None
    elapsed = record.elapsed if step.clock.varying else None
    begin = float(record.t[0] if record.stamps is None else np.nanmin(record.stamps))
    written = ReadOptions(shifts, record.operands, record.clock[1], begin, step.dt)
    faults, change = findings(step, run, u, y, first, engine=engine_here(), written=written, dt=elapsed)
    return [*times, *faults], change


def findings_by(step: CallableStep, record: Record, log: Log, shifts: Mapping[str, int]) -> list[Finding]:
    """Return the faults of a log by a run of the step from its initial estimate; arguments as in `log_findings`."""
    samples = log.of(step.inputs)
    step.reset(log.start)
    run = step.run(u=samples.u, y=samples.y, engine=engine_here(), dt=samples.given(step))
    return log_findings(step, record, run, samples.u, samples.y, shifts)[0]


def faulty_signals(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Return the names of the signals with a fault, each once."""
    return tuple(dict.fromkeys(name for one in findings for name in one.signal.split(", ") if name))


def fault_lines(findings: Iterable[Finding]) -> Iterator[Text]:
    """Yield a line to print for each fault."""
    for one in findings:
        yield Text.assemble((f"{one.signal}, {one.fault}: ", "bold"), str(one))


def parts_of(held_out: Sequence[str]) -> tuple[float, list[Path]]:
    """Return the share of each log that is held out (0 if files are named), and the files of logs for validation only;
    `held_out`: a number or file names. Raises: `typer.BadParameter`."""
    if not held_out:
        return HELD_OUT, []
    judges = [Path(text) for text in held_out if Path(text).exists()]
    if len(judges) == len(held_out):
        return 0.0, judges
    try:
        (part,) = map(float, held_out)
        if 0 <= part <= LARGEST_PART:
            return part, []
    except ValueError:
        pass
    reason = f"{', '.join(held_out)!r:.80} is neither a part from 0 to {LARGEST_PART:g} of each log nor files of logs"
    raise typer.BadParameter(reason, param_hint="--held-out")


def truth_of(plant: System, pairs: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Return, for each state with a measured truth, the name of the column that holds it among the signals, and the
    file's column or expression; `pairs`: texts STATE=COLUMN. Raises: `typer.BadParameter`."""
    names = [x.name for x in plant.declared.states]
    columns = []
    for text in pairs:
        state, _, column = (part.strip() for part in text.partition("="))
        if state not in names or not column:
            reason = f"{text!r} must read STATE=COLUMN; the states are {', '.join(names)}"
            raise typer.BadParameter(reason, param_hint="--truth")
        columns.append((state, (truth_name(state), column)))
    return once(columns, "--truth")


def truth_options(true: Mapping[str, tuple[str, str]]) -> dict[str, str]:
    """Return for each column of a measured state the command-line option of the user, such as `--truth w=COLUMN`;
    `true`: the result of `truth_of`, the keys are names by `truth_name`."""
    return {name: f"--truth {state}=COLUMN" for state, (name, _) in true.items()}


def truth_name(state: str) -> str:
    """Return the name of the column, among the signals, that holds the measured truth of a state."""
    return f"truth of {state}"


def too_far(ahead: Iterable[int], compared: Iterable[int | None]) -> Iterator[str]:
    """Yield a sentence on the horizons in `ahead` (samples) that are not in `compared`, since the log has no samples to
    compare there."""
    far = ", ".join(map(str, sorted({*ahead} - {*compared})))
    if far:
        yield f"there is no sample to compare with predictions {far} samples ahead"


@dataclass(frozen=True)
class Begin:
    """The initial estimate of a state, and where it comes from."""

    value: Annotated[float, "the value"]
    why: Annotated[str, "where it comes from"]


def log_summary(
    read: Report,
    begins: Mapping[str, Begin] | None = None,
    findings: Iterable[Finding] = (),
    states: Sequence[str] = (),
) -> RenderableType:
    """Return the printed summary of a log; `begins`: the initial estimates by state that the log gives; `findings`:
    faults that are printed below, whose causes are not repeated here; `states`: those of the plant."""
    uneven = any(one.fault == "jitter" for one in findings)
    lines = [line for line in read.sentences() if not (uneven and WITHOUT_PERIOD in line)]
    if begins:
        grouped = by_reason((f"{name} = {one.value:g}", one.why) for name, one in begins.items())
        at = ", ".join(f"{', '.join(values)} ({why})" for why, values in grouped.items())
        others = ", ".join(name for name in states if name not in begins)
        more = f"; the log gives no start of {others}: the observer's `initial` is taken" if others else ""
        lines.append(f"the estimate starts at {at}{more}")
    return Group(Text(read.path, style="bold"), *(Text(f"  {line}") for line in lines), "")
