"""What the commands of the command line do, apart from talking to a terminal."""

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.calling.samples import Engine, Run
from hgogen.certificates.admitted import Admitted, admitted
from hgogen.certificates.error_bound import ErrorBound
from hgogen.check import Check, Refuted, refuted
from hgogen.commands.process import note
from hgogen.form import Form
from hgogen.guarantees.bounded_theta import Nothing
from hgogen.guarantees.lmi import NoSolver
from hgogen.guarantees.signed import Signed
from hgogen.model import MissingPart, Model
from hgogen.program import Field
from hgogen.reading.given import BadGain
from hgogen.reading.measured import Record
from hgogen.reading.named import BadNames, by_name, written
from hgogen.sentence import Sentence, equations
from hgogen.signal import Signal
from hgogen.theorem import Row, Theorem, rows
from hgogen.trial import Trajectory, Trial, try_out
from hgogen.trials import alarm
from hgogen.trials.agreement import Agreement, agreement
from hgogen.trials.comparison import Measured
from hgogen.trials.leaving import Left, left, notes
from hgogen.trials.metrics import Metrics, Summary, metrics, summary
from hgogen.trials.proposed import proposed_trial
from hgogen.which_forms import Survey

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Tick = Callable[[], None]


@dataclass(frozen=True)
class Checked:
    """The claims about a model: of its step's observer, or of a form where it has no step or the observer refused it.

    `observer`: its name, or ""; `theorem`: the observer's; `notes`: what is not claimed, and why; `demanded`:
    whether there is an observer, which needs what is refuted; `step`: the step that was built, of the tuning `tuning`,
    "" of the model's own; `known`: how far its errors go under what the model says of noise and the like, None where it
    says nothing; `dt`: up to which dt its step is certified, advised and admitted, where the first may be.
    """

    plant: str
    form: Form
    checks: tuple[Check, ...]
    accepted: tuple[str, ...]
    observer: str = ""
    theorem: Theorem | None = None
    notes: tuple[str, ...] = ()
    demanded: bool = True
    step: CallableStep | None = None
    tuning: str = ""
    known: ErrorBound | None = None
    dt: Admitted | None = None

    @property
    def gains(self) -> tuple[Field, ...]:
        """The observer's."""
        return self.step.gains if self.step else ()

    @property
    def shown(self) -> bool:
        """Whether the checks tell more than why the plant is not in the form."""
        return self.demanded or self.form.structured

    @property
    def head(self) -> tuple[Sentence, ...]:
        """The form's coordinates and equations, and the observer's gains, line by line."""
        title, *lines = self.form.head
        gains = (Sentence.of("  {gain}", gain=written(gain)) for gain in self.gains)
        limits = (Sentence.of("  {limits}", limits=dt.sentence) for dt in (self.dt,) if dt)
        return (title, *self._recast, *lines, *gains, *limits)

    @property
    def _recast(self) -> list[Sentence]:
        """The states that the observer's plant has in the place of the declared ones."""
        origin = self.form.system.origin
        if origin is None:
            return []
        pairs = zip(self.form.system.states, origin.forward, strict=True)
        change = equations({new: old for new, old in pairs if new.name != str(old)})
        return [Sentence.of("  with {change}", change=change)]

    @property
    def hypotheses(self) -> tuple[Row, ...]:
        """What the observer's theorem assumes, and what is known of it."""
        return rows(self.theorem, self.checks) if self.theorem else ()

    @property
    def open(self) -> tuple[Check, ...]:
        """The refuted checks that nobody accepted."""
        return refuted(self.checks, self.accepted)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        listed = [{**c.as_dict(), "accepted": c.id in self.accepted} for c in self.checks]
        z, y = self.form.states, self.form.system.outputs
        equations = {
            "coordinates": _texts(z, self.form.to_form),
            "flow": _texts(z, self.form.flow),
            "outputs": _texts(y, self.form.output),
        }
        theorem = self.theorem and {
            "conclusion": self.theorem.conclusion,
            "reference": self.theorem.reference,
            "hypotheses": [row.as_dict() for row in self.hypotheses],
        }
        refused = [c.id for c in self.open]
        said = {"checks": listed, "refuted": refused, "theorem": theorem, "notes": list(self.notes)}
        gains = {gain.name: by_name(gain) for gain in self.gains}
        own = {"gains": gains, "dt": self.dt and self.dt.as_dict()}
        return {"plant": self.plant, "form": self.form.kind, **equations, **own, **said}


def _texts(signals: Iterable[Signal], expressions: Iterable[Any]) -> dict[str, str]:
    return {s.name: str(expression) for s, expression in zip(signals, expressions, strict=True)}


def checked(model: Model, asked: Survey | None = None, name: str | None = None) -> Checked:
    """The claims of a model's tuning `name`, by default of its step; of a model without an observer those of the best
    of the forms `asked`, by default of those that do not take seconds. With them what the model declares of inequality
    (38).

    Raises: `MissingPart`, `ModelFails`.
    """
    claims, declared = _checked(model, asked, name), model.dissipation
    if declared is None:
        return claims
    note = f"of the errors e of {declared.system.name}: {declared.conclusion}"
    return replace(claims, checks=(*claims.checks, *declared.checks), notes=(*claims.notes, note))


def _checked(model: Model, asked: Survey | None, name: str | None) -> Checked:
    if name is None and not model.has("step"):
        asked = asked or hg.survey(model.plant)
        form = getattr(hg.forms, model.setting.form)(model.plant) if model.setting.form else asked.best
        notes = (*model.notes, _alone(model, asked, form))
        return Checked(model.plant.name, form, form.checks, (), notes=notes, demanded=False)
    try:
        step = model.step(name)
    except Refuted as error:
        if error.form is None:
            raise
        note = f"the observer of {model.path} is refused on this form, so its own claims are not in the list"
        known = tuple(check.id for check in error.form.checks if check.id in error.accepted)
        return Checked(model.plant.name, error.form, error.form.checks, known, notes=(*model.notes, note))
    observer = step.observer
    plain = Checked(model.plant.name, observer.form, observer.checks, observer.accepted, observer.name)
    own = replace(plain, theorem=observer.theorem, notes=model.notes, step=step, tuning=name or "")
    try:
        return _as_it_runs(own, step, model)
    except NoSolver as missing:
        return replace(own, notes=(*own.notes, str(missing)))


def bound_of(step: CallableStep, model: Model) -> ErrorBound | None:
    """How well each state is known under what the model says of noise and the like; None where it says nothing.

    Raises: `NoSolver`; `MissingPart` for what is no size, or of no signal.
    """
    if model.bounds is None:
        return None
    try:
        return hg.error_bound(step, **model.bounds.sizes)
    except (BadNames, BadGain) as error:
        raise MissingPart(model.path, "bounds", f"in bounds, {error}") from None


def proved(step: CallableStep, model: Model, say: Callable[[str], None]) -> ErrorBound | None:
    """`bound_of`, None without a solver; `say` is called with what stands in the way."""
    try:
        known = bound_of(step, model)
    except NoSolver as missing:
        say(str(missing))
        return None
    if known and known.missing:
        say(f"{model.path}: {known.missing}")
    return known


def stating(step: CallableStep, model: Model, known: ErrorBound | None) -> CallableStep:
    """The step whose code states what is known of its errors, or that nothing is; as it is where the model does not
    ask."""
    if model.bounds is None:
        return step
    return replace(step, signed=known.signed if known else Signed())


def _as_it_runs(claims: Checked, step: CallableStep, model: Model) -> Checked:
    """The claims with what is proved of the step itself, of an observer of which it can be; of another why not, where
    the model asks how far it errs.

    Raises: `NoSolver`; `MissingPart` for bounds in the model's file that are none.
    """
    error, gains = bound_of(step, model), _gains(step.observer, model)
    if step.observer.error is None:
        own = (error.check, *gains) if error else ()
        return replace(claims, checks=(*claims.checks, *own), known=error)
    known, noise, start = hg.contraction(step), hg.noise_gain(step), hg.start_set(step)
    bounds = (bound.check for bound in (noise, start, error) if bound and not isinstance(bound, Nothing))
    own = (*known.checks, *bounds, *gains)
    return replace(claims, checks=(*claims.checks, *own), known=error, dt=admitted(step, known))


def _gains(observer: hg.Observer, model: Model) -> tuple[Check, ...]:
    """The L2 gain and the bounds in continuous time under the noise and the disturbances that the model says, where it
    asks for them. Raises: `NoSolver`."""
    if model.bounds is None or not model.bounds.gains:
        return ()
    sizes = {what: each for what, each in model.bounds.sizes.items() if what in ("noise", "disturbance")}
    return hg.l2_gain(observer, **sizes).check, hg.iss_gain(observer, **sizes).check


def _alone(model: Model, asked: Survey, form: Form) -> str:
    """What a model without an observer does not claim."""
    proved = ", ".join(row.kind for row in asked.proved)
    if form.structured or model.setting.form:
        return f"{model.path} has no observer: the checks are those of the {form.kind} form alone"
    if proved:
        return f"{model.path} has no observer; of the forms asked its plant is in {proved}, proved, and in no other"
    return f"{model.path} has no observer, and its plant has the structure of none of the forms asked"


def trials(model: Model) -> tuple[Trial, ...]:
    """The model's own, else one that is made of its ranges, and said. Raises: `NoTrial`, `MissingPart`."""
    if model.has("trial"):
        return model.trials()
    trial = proposed_trial(model.plant)
    at = ", ".join(f"{state} = {value:g}" for state, value in trial.start.items())
    span = f"over {trial.duration:.3g} {model.plant.time} from {at}"
    note(f"{model.path} has no trial; it is tried on one that stays in its ranges, {span}")
    return (trial,)


@dataclass(frozen=True, eq=False)
class Tried:
    """A trial over its seeds: the first seed's trajectory, every seed's metrics, and where the plant itself leaves its
    ranges."""

    trial: Trial
    first: Trajectory
    each: tuple[Metrics, ...]
    left: tuple[Left, ...]


def tried(step: CallableStep, trial: Trial, engine: Engine, seeds: Sequence[int], tick: Tick) -> Tried:
    """The step over a trial; `tick` is called after each seed."""
    first: Trajectory | None = None
    each: list[Metrics] = []
    for trajectory in try_out(step, trial, engine, seeds):
        first = first or trajectory
        each.append(metrics(step, trajectory))
        tick()
    assert first is not None  # a trial without seeds has been refused
    return Tried(trial, first, tuple(each), left(step.observer.form.system, first))


def summaries(step: CallableStep, done: Sequence[Tried], engine: Engine, say: Callable[[str], None]) -> list[Summary]:
    """All seeds of each trial in one, with the trial's alarm ratio; `say` is called with what is wrong."""
    ratios = [(one, alarm.ratio(step, one.trial, engine, [m.seed for m in one.each])) for one in done]
    summed = [summary(one.trial, one.each, ratio, step.time) for one, ratio in ratios]
    for sentence in (*departures(done, step.time), *alarm.complaints(summed)):
        say(sentence)
    return summed


def departures(done: Iterable[Tried], unit: str) -> Iterator[str]:
    """A sentence for each trial whose plant leaves its ranges."""
    return chain.from_iterable(notes(one.trial.name, one.left, unit) for one in done)


def told(summaries: Iterable[Summary], done: Iterable[Tried]) -> list[dict[str, Any]]:
    """The trials for JSON: the summary of each, and where the plant leaves its ranges."""
    pairs = zip(summaries, done, strict=True)
    return [{**one.as_dict(), "left": [each.as_dict() for each in tried.left]} for one, tried in pairs]


def agreements(c: Iterable[Tried], python: Iterable[Tried], dt: float) -> tuple[Agreement, ...]:
    """C against Python, on the first seed of each trial."""
    pairs = zip(c, python, strict=True)
    return tuple(agreement((a.first, a.each[0]), (b.first, b.each[0]), dt) for a, b in pairs)


def figures(step: CallableStep, done: Iterable[Tried], known: ErrorBound | None = None) -> dict[str, "Figure"]:
    """The figures of each trial, by file name without ending: the states, what theta did, and where bounds of the
    errors are `known` the errors with them."""
    from hgogen.trials import figures as figure

    drawn = {}
    for one in done:
        drawn[f"{one.trial.name}_states"] = figure.states(step, one.first)
        if known and known.bounds:
            of = {step.observer.name: one.first.error}
            drawn[f"{one.trial.name}_errors"] = figure.errors(
                step.states, one.first.truth.t, of, one.trial.events, step.time, known.bounds
            )
        if one.first.traces:
            drawn[f"{one.trial.name}_theta"] = figure.adaptation(step, one.first.truth.t, one.first.traces)
    return drawn


def errors(each: Sequence[Measured], unit: str) -> "Figure":
    """The errors of several observers on the first seed of one trial; `unit`: that of the plant's time."""
    from hgogen.trials import figures as figure

    first = each[0].first
    of = {one.name: one.first.error for one in each}
    return figure.errors(each[0].states, first.truth.t, of, first.trial.events, unit)


def record_figures(
    step: CallableStep, name: str, record: Record, run: Run, truth: Mapping[str, np.ndarray]
) -> dict[str, "Figure"]:
    """The figures of a measured record, by file name without ending; `truth` (N,) by state."""
    from hgogen.trials import figures as figure
    from hgogen.trials import record_figures as drawing

    drawn = {
        f"{name}_states": drawing.states(step, record.t, run, record.of(step.outputs), truth),
        f"{name}_innovations": drawing.innovations(step, record.t, run),
    }
    if run.traces:
        drawn[f"{name}_theta"] = figure.adaptation(step, record.t, run.traces)
    return drawn


def flagged(step: CallableStep, status: np.ndarray) -> dict[str, int]:
    """In how many samples each status bit was raised; only those that were."""
    counts = {bit.name: int(np.count_nonzero(status & np.uint32(1 << k))) for k, bit in enumerate(step.bits)}
    return {name: count for name, count in counts.items() if count}


def estimates(step: CallableStep, record: Record, run: Run) -> str:
    """The estimates as CSV text: time, what was measured, the estimated states, traces, status; empty where
    missing."""
    measured = [f"{s.name}_measured" if s.name in run.names else s.name for s in step.outputs]
    numbers = np.column_stack([record.t, record.of(step.outputs), run.x, *run.traces.values()])
    return _csv(["t", *measured, *run.names, *run.traces, "status"], numbers, run.status)


def innovations(step: CallableStep, record: Record, run: Run) -> str:
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
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    behind = [[] for _ in numbers] if status is None else status[:, None].tolist()
    for row, last in zip(numbers.tolist(), behind, strict=True):
        writer.writerow([*("" if value != value else f"{value:.10g}" for value in row), *last])
    return stream.getvalue()


def window(model: Model, option: str, observer: str | None = None) -> float:
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
    raise MissingPart(model.path, "tuning", reason)
