"""Observer gains from measured logs: for each observer that a plant admits, the gains that predict best.

An observer's rule computes gains from the numbers of a `Scale`. Here the numbers are fitted to the log: Q and R by
maximum likelihood, theta and the longest time on a grid, refined once around the best, then the shape of poles and
filters. Gains are chosen by their predictions `ahead` samples ahead, or by a measured truth, and judged on other
segments (cross-validation).
"""

import os
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from inspect import signature
from itertools import islice, product
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np

from hgogen import methods
from hgogen import observers as every
from hgogen.call import sample
from hgogen.check import refuted
from hgogen.emit.cost import cost
from hgogen.emit.syntax import Real
from hgogen.errors import BadArgument, HgogenError, nearest
from hgogen.estimators.gate import GatedGroup, Gates, gated_groups
from hgogen.estimators.synonyms import SYNONYMS
from hgogen.form import Form
from hgogen.logs.likelihood import MIDDLE, STARTS, Ended, Likelihood, Noise
from hgogen.logs.problem import demand_same, digests, steps_and_growth
from hgogen.logs.records import (
    BEGIN,
    HiddenStateCriterion,
    Judge,
    Log,
    PredictionCriterion,
    as_good,
    chosen,
    clearly_worse,
    readable,
    step_limits,
)
from hgogen.modelfiles.tuning import First, everywhere, value
from hgogen.observer import OF_MAPS, Observer
from hgogen.reading.given import count, requires_any_plant, requires_switches
from hgogen.registry import Displayed
from hgogen.run.backends import quickest_engine
from hgogen.run.campaign import Workers
from hgogen.run.gates import GateShare
from hgogen.sentence import by_reason
from hgogen.starting import Gains, Scale, Starting, gains_of, longest, per_sample, scale, two_digits
from hgogen.step import StepMayFail
from hgogen.system import System
from hgogen.theorem import Convergence
from hgogen.which_forms import Row

Array = np.ndarray
Result = TypeVar("Result")
STEEPEST = 2.0  # least 1/(theta dt)
GOOD_SHARE = 0.999  # share of the good samples of an output that a robust search keeps
GATE = "gate"  # the argument of filters that have gates
GRID = 9  # values of theta, or of the longest time
LONG = np.geomspace(1e-2, 1e2, GRID)  # factors of the longest time
SHAPES: dict[str, tuple[float, ...]] = {"spread": (2, 4), "corner": (1.5, 6)}  # of poles, and of filters
FASTER = (1.0, 1.4)  # times theta, with another shape
_RANK = {Convergence.PROVED: 0, Convergence.ABOVE: 0, Convergence.BELOW: 1, Convergence.UNKNOWN: 1, None: 2}


@dataclass(frozen=True)
class Tuned:
    """The gains of an observer that predict best.

    `name`: the observer's, or "adaptive" for a riccati with an adaptive theta; `first`: observer, form and step;
    `numbers`: the scale from which its rule computed the gains; `noise`: the maximum of the `likelihood`, which gives Q
    and R, None if the rule does not read both; `sampling`: `method`, `between` and, in float, `real`, as in a tuning;
    `errors`: squared, by segment, cross-validated, as in `logs/records.py`; `tried`: the scales tried, with their
    errors over all segments; `hidden`: the squared errors of hidden states by segment, relative to their mean, None
    without a truth.
    """

    name: str
    first: First
    numbers: Scale
    noise: Noise | None
    likelihood: Likelihood | None = field(repr=False)
    sampling: Mapping[str, str]
    errors: Array
    tried: tuple[tuple[Scale, float], ...] = field(repr=False)
    hidden: Array | None = None

    @property
    def error(self) -> float:
        """The cross-validated RMS error, relative to copying the last value, or to the mean of a measured truth."""
        return float(np.sqrt(self.errors.mean()))

    @property
    def table(self) -> Mapping[str, Any]:
        """The tuning as a table of a model file, from which the step of `first` can be built again."""
        return {**self.first.table(self.name), **self.sampling}

    def innovations(self, records: Iterable[tuple[Log, int]]) -> dict[str, Array]:
        """Return the normalised innovations e/sqrt(s) by output; `records`: pairs of a log and the first row to return.
        Empty without fitted noise."""
        if self.noise is None or self.likelihood is None:
            return {}
        scaled = []
        for record, cut in records:
            e, s = self.likelihood.innovations(self.noise, record.of(self.likelihood.form.system.inputs))
            scaled.append((e / np.sqrt(s))[max(0, cut - 1) :])
        columns = (column[np.isfinite(column)] for column in np.concatenate(scaled).T)
        return {y: there for y, there in zip(self.noise.sample, columns, strict=True) if len(there)}

    @property
    def below_quantum(self) -> Mapping[str, float]:
        """The bound q/sqrt(12) of each output whose most likely noise would be smaller than its quantum q allows."""
        return {} if self.noise is None or self.likelihood is None else self.likelihood.below_quantum(self.noise)

    @property
    def rank(self) -> tuple[int, bool, int]:
        """The sort key among rows that predict equally well: first a proof, then known noise, then lower cost."""
        return _RANK[self.first.convergence], self.noise is None, cost(self.first.step).operations


@dataclass(frozen=True, eq=False)
class Task:
    """The problem of tuning observers on logs. `judge`: gives the errors of a step; `rows`: the candidate forms in
    order; `limits`: the period of the logs, or the shortest and the longest dt for irregular ones; `sampling`: the
    method and its options; `gates`: innovation gates, for the filters that have them; `begin`: by the number of the
    form, noise that is likely on a part of the logs."""

    records: tuple[Log, ...]
    judge: Judge
    limits: float | tuple[float, float]
    sampling: Mapping[str, str]
    rows: tuple[Row, ...]
    gates: tuple[GatedGroup, ...] = ()
    begin: Mapping[int, Sequence[Noise]] = field(default_factory=dict)
    _likelihoods: dict[int, Likelihood] = field(default_factory=dict)

    @property
    def dt(self) -> float:
        """The sampling period, or the longest time between two calls."""
        return longest(self.limits)

    def likelihood(self, row: int) -> Likelihood:
        """Return the likelihood of the logs on form number `row`, which is computed once for all observers."""
        if row not in self._likelihoods:
            form = self.rows[row].form
            assert form is not None
            self._likelihoods[row] = likelihood_of(form, self.records, self.dt, self.sampling["between"], self.gates)
        return self._likelihoods[row]

    def starts(self, row: int) -> tuple[tuple[float, float] | Noise, ...]:
        """Return the starting points of the searches for a maximum of the likelihood on form number `row`."""
        return (*self.begin[row], MIDDLE) if row in self.begin else STARTS

    def make_step(self, name: str, row: Row, gains: Gains) -> First:
        """Return the step of the observer `name` on the form in `row` with these gains, at the period of the logs, and
        with the gates if the observer accepts gates. Raises: as the observer and `sample` do."""
        gated = self.gates and GATE in signature(getattr(every, name)).parameters
        gains = {**gains, GATE: dict(group.entry for group in self.gates)} if gated else gains
        return first_of(name, row, gains, self.limits, self.sampling)

    def first(self, name: str, row: int, numbers: Scale) -> First | str:
        """Return the step of the observer `name` on form number `row`, with the gains that the observer's rule computes
        from `numbers`, or the reason why there is no step."""
        gains = gains_of(getattr(every, name), numbers)
        if isinstance(gains, str):
            return gains
        try:
            return self.make_step(name, self.rows[row], gains)
        except HgogenError as error:
            return str(error)


@dataclass(frozen=True)
class Start:
    """A search for a maximum of the likelihood on form number `row`, from starting point `number`; `label`: for
    progress."""

    row: int
    number: int
    label: ClassVar[str] = "likelihood"

    def result(self, task: Task) -> Ended:
        """Return the end of the search for a maximum of the likelihood."""
        return task.likelihood(self.row).ended(task.starts(self.row)[self.number])

    def read(self, stored: Any) -> Ended:
        """Return the end of the search from the lists of numbers in which a file stores it."""
        likelihood, logs, settled = stored
        return likelihood, np.array(logs, dtype=float), settled


@dataclass(frozen=True, eq=False)
class Attempt:
    """An attempt with the observer `label` on form number `row`, with the gains that the observer's rule computes from
    `numbers`."""

    row: int
    label: str
    numbers: Scale

    def result(self, task: Task) -> Array | str:
        """Return the squared errors E_s of the step by segment s of the logs, or the reason why there is no step."""
        first = task.first(self.label, self.row, self.numbers)
        return first if isinstance(first, str) else task.judge.errors(first.step)

    def read(self, stored: Any) -> Array | str:
        """Return the result, squared errors by segment or a reason, from the form in which a file stores it."""
        return stored if isinstance(stored, str) else np.array(stored, dtype=float)


Piece = Start | Attempt
Asking = Generator[list[Piece], list[Any], Result]  # yields pieces of work, receives their results, returns one


def search_together(
    searches: Mapping[str, Asking[Result]], work: Callable[[Iterable[Piece]], Mapping[Piece, Any]], width: int = 1
) -> Iterator[tuple[str, Result]]:
    """Yield the name and result of each search as it ends. A search is a generator that requests pieces of work; `work`
    computes the pieces of `width` searches at a time, equal pieces only once."""
    waiting, results = iter(searches), dict[Piece, Any]()
    answers: dict[str, Any] = dict.fromkeys(islice(waiting, width))
    while answers:
        requests = {}
        for name, answer in answers.items():
            try:
                requests[name] = searches[name].send(answer)
            except StopIteration as end:
                yield name, end.value
        pieces = dict.fromkeys(piece for each in requests.values() for piece in each)
        results |= work(piece for piece in pieces if piece not in results)
        answers = {name: [results[piece] for piece in each] for name, each in requests.items()}
        answers |= dict.fromkeys(islice(waiting, width - len(answers)))


class UnknownObserver(BadArgument):
    """The error for a name that no observer has."""


def observers_named(names: Iterable[str] | None, plant: System) -> tuple[str, ...]:
    """Return the requested names of observers without repetition, by default all observers for such a plant. Raises:
    `UnknownObserver`."""
    known = tuple(every.__all__)
    for name in names or ():
        if name not in (*known, *SYNONYMS):
            fix = nearest(name, [*SYNONYMS, *known], f"there are {', '.join(known)}")
            raise UnknownObserver(f"observer {name[:60]!r}", f"is none; {fix}")
    usual = tuple(name for name in known if name in OF_MAPS or not plant.discrete)
    return usual if names is None else tuple(dict.fromkeys(names))


def reasons(refused: Mapping[str, object]) -> str:
    """Return as one text why observers have no gains, each reason once with its observers; `refused`: the reasons by
    observer."""
    grouped = by_reason((name, str(reason)) for name, reason in refused.items())
    return "; ".join(f"{', '.join(names)}: {reason}" for reason, names in grouped.items())


def first_of(
    observer: str, row: Row, gains: Gains, dt: float | tuple[float, float], sampling: Mapping[str, Any]
) -> First:
    """Return an observer's step with these gains, on the form in `row`, at the period `dt` or, for a pair, between the
    shortest and the longest (R then is the density that corresponds to the variance of a sample at the longest).
    `sampling`: `method`, `between` and `real`, as in a tuning. The warning `StepMayFail` is ignored, since the errors
    reveal it. Raises: as the observer and `sample` do."""
    gains = per_sample(getattr(every, observer), gains, dt[1]) if isinstance(dt, tuple) else gains
    method = getattr(methods, sampling.get("method", "continuous_discrete"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StepMayFail)
        options = {key: entry for key, entry in sampling.items() if key != "method"}
        step = sample(observer_on(row, observer, gains), method, dt, **options)
        return First(observer, row, Starting(gains, dt), step)


def observer_on(row: Row, name: str, gains: Gains) -> Observer:
    """Return the observer `name` with these gains on the form in `row`. Raises: as the observer does."""
    observer: Observer = getattr(every, name)(row.form, **{key: value(key, entry) for key, entry in gains.items()})
    return observer


def thetas(theta: float, dt: float) -> list[float]:
    """Return a grid of gains: from a thirtieth of `theta` to the largest theta for which steps of `dt` are short
    enough."""
    least, largest = max(1.0, theta / 30), 1 / (STEEPEST * dt)
    return [two_digits(each) for each in np.geomspace(least, max(largest, 2 * least), GRID)]


def tuned(task: Task, name: str) -> Asking[Tuned | str]:
    """Return the tuned gains of the observer `name` on the first form that admits it, or the reason why there are none
    (a search, which requests pieces of work)."""
    refusals = ["the plant is in none of its forms"]
    for number, row in enumerate(task.rows):
        if row.form is None or refuted(row.form.checks):
            continue
        search = Search(task, name, number, scale(row.form, task.dt))
        gains = gains_of(getattr(every, name), search.base)
        if isinstance(gains, str):
            return gains
        if (best := (yield from search.search())) is not None:
            return best
        refusals += search.refusals[:1]
    return refusals[:2][-1]


@dataclass(frozen=True, eq=False)
class Search:
    """A search for an observer's gains on form number `row`: the numbers (`Scale`) from which the observer's rule
    computes the gains are varied from `base` on; `scales`: those tried, `refusals`: why some of them gave no step."""

    task: Task
    name: str
    row: int
    base: Scale
    scales: list[Scale] = field(default_factory=list)
    refusals: list[str] = field(default_factory=list)

    def search(self) -> Asking[Tuned | None]:
        """Return the tuned gains: those by the best `Scale` of a grid, or between that and its neighbours in the grid;
        None if no scale gives a step."""
        noisier = {name: 2 * sigma for name, sigma in self.base.noise.items()}
        maxima: tuple[Noise, ...] = ()
        if not any(map(self._takes, self._grid(()))):  # before the likelihood, which takes longer
            return None
        if self._reads(noise=noisier):
            ended = yield [Start(self.row, number) for number in range(len(self.task.starts(self.row)))]
            maxima = self.task.likelihood(self.row).maxima(ended)
        errors = yield from self._tried(self._grid(maxima))
        if errors:
            for others in (self._between, self._shaped):
                best, _ = chosen(errors)
                errors |= yield from self._tried(others(best, errors))
        if not errors:
            return None
        best, judged = chosen(errors)
        first = self.task.first(self.name, self.row, self.scales[best])
        assert isinstance(first, First)  # it was built before
        filters = self._reads(process={name: 2 * q for name, q in self.base.process.items()})
        noise = next((one for one in maxima if filters and one.sample is self.scales[best].noise), None)
        likelihood = self.task.likelihood(self.row) if noise else None
        tried = tuple((self.scales[k], float(np.sqrt(e.mean()))) for k, e in errors.items())
        return Tuned(self.name, first, self.scales[best], noise, likelihood, self.task.sampling, judged, tried)

    def _takes(self, numbers: Scale) -> bool:
        gains = gains_of(getattr(every, self.name), numbers)
        try:
            observer_on(self.task.rows[self.row], self.name, {} if isinstance(gains, str) else gains)
        except HgogenError as error:
            self.refusals.append(gains if isinstance(gains, str) else str(error))
            return False
        return True

    def _tried(self, scales: Iterable[Scale]) -> Asking[dict[int, Array]]:
        """Return the squared errors E_s by segment, by the number of each `Scale` whose estimate does not diverge."""
        new = list(scales)
        results = yield [Attempt(self.row, self.name, numbers) for numbers in new]
        self.refusals.extend(one for one in results if isinstance(one, str))
        known = {len(self.scales) + k: one for k, one in enumerate(results) if not isinstance(one, str)}
        self.scales.extend(new)
        return {k: e for k, e in known.items() if np.isfinite(e).all()}

    def _grid(self, maxima: Sequence[Noise]) -> list[Scale]:
        scales = [self.base]
        if self._reads(theta=2 * self.base.theta):
            values = thetas(self.base.theta, self.task.dt)
            scales = [replace(one, theta=theta) for one in scales for theta in values]
        if self._reads(longest=2 * self.base.longest):
            scales = [replace(one, longest=one.longest * factor) for one in scales for factor in LONG]
        pairs = product(scales, maxima)
        return [replace(one, process=q.process, noise=q.sample) for one, q in pairs] if maxima else scales

    def _between(self, best: int, tried: Iterable[int]) -> Iterator[Scale]:
        middle = self.scales[best]
        varied: dict[str, Callable[[float], Scale]] = {
            "theta": lambda value: replace(middle, theta=value),
            "longest": lambda value: replace(middle, longest=value),
        }
        for name, of in varied.items():
            value, every_value = getattr(middle, name), sorted(getattr(self.scales[k], name) for k in tried)
            neighbours = [o for o in every_value if o < value][-1:] + [o for o in every_value if o > value][:1]
            yield from (of(two_digits((value * other) ** 0.5)) for other in neighbours)

    def _shaped(self, best: int, tried: Iterable[int]) -> Iterator[Scale]:
        middle, largest = self.scales[best], 1 / (STEEPEST * self.task.dt)
        every_theta = {min(two_digits(factor * middle.theta), max(middle.theta, largest)) for factor in FASTER}
        for name, values in SHAPES.items():
            if self._reads(**{name: values[0]}):
                shapes: Iterable[dict[str, Any]] = ({name: value} for value in values)
                yield from (replace(middle, theta=theta, **shape) for shape in shapes for theta in sorted(every_theta))

    def _reads(self, **values: Any) -> bool:
        observer = getattr(every, self.name)
        return gains_of(observer, replace(self.base, **values)) != gains_of(observer, self.base)


@dataclass(frozen=True)
class Calibration(Displayed):
    """The result of `tune`: the tuned observers in `rows`, the best first; `refused`: why others have no gains, by
    name. Gains were chosen by the errors of predictions `ahead` samples ahead, or of measured states (`truth`), on
    `segments` of each log; `gates`: the samples beyond gates, which were left out; `final`: the observers that were
    tuned again on the whole logs, of which the first is recommended."""

    rows: tuple[Tuned, ...]
    refused: Mapping[str, str]
    ahead: int
    segments: int
    truth: tuple[str, ...] = ()
    gates: tuple[GateShare, ...] = ()
    final: tuple[Tuned, ...] = ()

    @property
    def credible(self) -> tuple[Tuned, ...]:
        """The rows that a measured truth does not contradict: their errors of hidden states are within 5 %, or the
        scatter between segments, of the least; all rows without a truth."""
        errors = {row.name: row.hidden for row in self.rows if row.hidden is not None}
        best = min(errors.values(), key=np.mean, default=None)
        contradicted = [name for name, each in errors.items() if best is not None and clearly_worse(each, best)]
        return tuple(row for row in self.rows if row.name not in contradicted)

    @property
    def tied(self) -> tuple[Tuned, ...]:
        """The credible rows that predict as well as the best of them: within 5 %, and not worse segment by segment."""
        credible = self.credible
        return tuple(row for row in credible if as_good(row.errors, credible[0].errors))

    @property
    def best(self) -> Tuned:
        """The recommended observer with its gains: the one of lowest `rank` among the tied rows, tuned on the whole
        logs if that was done."""
        return self[self.final[0].name] if self.final else min(self.tied, key=lambda row: row.rank)

    def __getitem__(self, name: str) -> Tuned:
        return next(row for row in self.rows if row.name == name)


SEGMENTS = 5
SAME = 1e-3  # relative difference of periods that count as one
STOPPED = "the search was stopped before it had gains"
TASK = "task"  # the key of the digests that identify a tuning
FILTER, ADAPTIVE = "riccati", "adaptive"  # the second adapts theta of the first
HUGE = 1e12  # factor of a threshold that no innovation reaches, or each exceeds
PREDICTORS = 4
PEAKS = (8.0, 6.0, 4.0, 3.0, 2.0)  # candidates for theta_1
ABOVE = 1.1  # gamma_0 over the largest innovation


class CannotTune(BadArgument):
    """The error for logs or observers from which no gains can be tuned."""


@requires_any_plant
@requires_switches
def tune(
    plant: System,
    *records: Log,
    observers: Iterable[str] | None = None,
    ahead: int = 1,
    method: str = "continuous_discrete",
    between: Literal["line", "hold"] = "line",
    real: Real = "double",
    segments: int = SEGMENTS,
    truth: Sequence[Mapping[str, np.ndarray]] = (),
    compared: Sequence[Mapping[str, np.ndarray]] = (),
    rows: Iterable[Row] | None = None,
    deep: bool = False,
    gate: Gates | None = None,
    robust: bool = False,
    dt: tuple[float, float] | None = None,
    begin: Iterable[Tuned] = (),
    jobs: int | None = 1,
    done: MutableMapping[str, Any] | None = None,
    each: Callable[[str], None] = lambda what: None,
    ended: Callable[[Calibration], None] = lambda calibration: None,
) -> Calibration:
    """Return the gains with which each observer predicts the logs best, at their sampling period, or, of irregular
    logs, from each sample to the next at its own time.

    `records`: as in `fit`, all of one period; `observers`: names of `hg.observers`, by default all, or "adaptive",
    which includes riccati; `ahead`: the prediction horizon in samples, 1 for an estimate of the present; `method` by
    name, `between` and `real`: as in `sample`; `segments`: of each record for cross-validation, each of a sample at
    least; `truth`: the courses (N) of hidden states by name, a mapping for each record, which then replace predictions;
    `compared`: such courses that choose no gains, but a row clearly worse by them is not the best; `rows`: the
    candidate forms, by default those that the plant is in, slow ones only if `deep`; `gate`: innovation gates, as of
    `riccati`, for the filters that take them: samples beyond them at the most likely Q and R are missing for all
    observers (`logs.likelihood`); `robust`: whether such outliers are left out without gates in the filters, as by
    gates of all outputs that a share of `GOOD_SHARE` of the good samples pass; `dt`: the shortest and the longest of
    steps for logs at their own times, by default those of the logs; `begin`: rows tuned on a part of the logs, on whose
    forms the likelihood is searched from their noise, and from one start more, in place of nine; `jobs`: processes that
    try gains, None for one for each core; `done`: the results by trial of an equal call that was stopped, as lists of
    numbers, which are not computed again, and to which new ones are added; `each(what)` is called after every trial,
    `ended(calibration)` with the result so far after every observer, those to come refused as `STOPPED`.

    Raises: `CannotTune`; `CannotGoOn` for `done` of another call; `BadGain` for invalid counts; `UnknownObserver`;
    `BadLog`, `BadShape` for invalid records.
    """
    wanted = None if observers is None else [FILTER if name == ADAPTIVE else name for name in observers]
    names, candidates = observers_named(wanted, plant), tuple(everywhere(plant, deep=deep) if rows is None else rows)
    limits, gates = dt or _common_period(records), gated_groups(gate, plant.outputs)
    ahead, segments = count("ahead", ahead, 1, 2**31), count("segments", segments, 2, 2**31)
    logs = tuple(readable(plant, record, k) for k, record in enumerate(records, 1))
    logs = tuple(log if isinstance(limits, tuple) else replace(log, dt=limits) for log in logs)
    sampling = {"method": method, "between": between, **({"real": real} if real != "double" else {})}
    every_output = {y.name: GOOD_SHARE for y in plant.outputs} if robust else None
    sought = gates or gated_groups(every_output, plant.outputs)
    logs, shares = _without_outliers(logs, longest(limits), sought, candidates, sampling)
    true = _truth(plant, truth, logs)
    judge = _judge(plant, logs, true, ahead, segments)
    by_truth = partial(_by_truth, _of_hidden(plant, _truth(plant, compared, logs), logs, segments))
    task = Task(logs, judge, limits, sampling, candidates, gates, _noise_by_form(begin, candidates))
    if done is not None:
        _demand_same_task(task, plant, (ahead, segments, true), done)
    work = partial(_results, Workers(task, jobs), {} if done is None else done, each)
    gains: dict[str, Tuned | str] = dict.fromkeys(names, STOPPED)
    searches = {name: tuned(task, name) for name in sorted(names, key=FILTER.__ne__)}  # the filter first
    best: list[Tuned] = []
    for name, one in search_together(searches, work, jobs or os.cpu_count() or 1):
        gains[name] = by_truth(one)
        if name == FILTER and isinstance(one, Tuned):
            gains[ADAPTIVE] = by_truth(adaptive(task, one, each))
        best = sorted((row for row in gains.values() if isinstance(row, Tuned)), key=lambda row: row.error)
        refused = {name: why for name, why in gains.items() if isinstance(why, str)}
        calibration = Calibration(tuple(best), refused, ahead, segments, tuple(true[0]) if true else (), shares)
        ended(calibration)
    if not best:
        raise CannotTune(f"plant {plant.name!r}", f"has no observer that can be tuned: {reasons(gains)}")
    return calibration


def _judge(
    plant: System, logs: tuple[Log, ...], true: tuple[Mapping[str, np.ndarray], ...], ahead: int, segments: int
) -> Judge:
    """Return the judge by predictions `ahead` samples ahead, or by the courses `true` of hidden states if there are
    any. Raises: `CannotTune` for logs without any change; `BadGain` for more segments than samples."""
    judge = _of_hidden(plant, true, logs, segments) or Judge(logs, PredictionCriterion(ahead, plant.outputs), segments)
    if judge.count < 2:
        over = "the truth" if true else f"an output over {ahead} sample{'s' * (ahead > 1)}"
        reason = f"show no change of {over} in at least 2 of their segments"
        raise CannotTune("records", f"{reason}; give longer ones in which the plant moves, or a shorter ahead")
    count("segments", segments, 2, judge.most)
    return judge


def _of_hidden(
    plant: System, true: tuple[Mapping[str, np.ndarray], ...], logs: tuple[Log, ...], segments: int
) -> Judge | None:
    """Return the judge by the courses `true` of hidden states, None without any."""
    named = {x.name: x for x in plant.declared.states}
    return Judge(logs, HiddenStateCriterion(true, tuple(named[state] for state in true[0])), segments) if true else None


def _by_truth(judge: Judge | None, row: Tuned | str) -> Tuned | str:
    """Return the row with its errors of hidden states by `judge`, if there are at least two segments to compare."""
    if judge is None or isinstance(row, str) or judge.count < 2:
        return row
    return replace(row, hidden=judge.errors(row.first.step))


def _noise_by_form(tuned_rows: Iterable[Tuned], candidates: Sequence[Row]) -> dict[int, list[Noise]]:
    noise: dict[int, list[Noise]] = {}
    for one in tuned_rows:
        for k, row in enumerate(candidates):
            if row is one.first.row and one.noise is not None and one.noise not in noise.get(k, ()):
                noise.setdefault(k, []).append(one.noise)
    return noise


def _demand_same_task(task: Task, plant: System, judged: tuple[Any, ...], done: MutableMapping[str, Any]) -> None:
    """Raise `CannotGoOn` if the results `done` belong to another tuning; else store in `done` what identifies this one.
    `judged`: the arguments by which its gains are judged, last the truth."""
    *options, true = judged
    courses = [{name: course.tobytes() for name, course in each.items()} for each in true]
    forms = [(row.name, row.form and (row.form.flow, row.form.to_form)) for row in task.rows]
    sampled = task.limits, task.sampling, task.gates
    identity = digests(plant, task.records, {"judged": (*options, courses), "sampled": sampled, "forms": forms})
    demand_same("the stopped tuning", done.get(TASK, identity), identity)
    done[TASK] = identity


def _without_outliers(
    logs: tuple[Log, ...], dt: float, gates: tuple[GatedGroup, ...], rows: Iterable[Row], sampling: Mapping[str, str]
) -> tuple[tuple[Log, ...], tuple[GateShare, ...]]:
    """Return the logs without the samples beyond the gates, by the likelihood on the first form, and the share of these
    samples for each gate."""
    form = next((row.form for row in rows if row.form is not None and not refuted(row.form.checks)), None)
    if not gates or form is None:
        return logs, ()
    likelihood = likelihood_of(form, logs, dt, sampling["between"], gates)
    cleaned = likelihood.without_outliers()
    shares = []
    for group in gates:
        pairs = [(log.y[:, group.outputs], left.y[:, group.outputs]) for log, left in zip(logs, cleaned, strict=True)]
        counts = np.array([np.isfinite(y).any(axis=1).sum() for pair in pairs for y in pair]).reshape(-1, 2)
        count, left = map(int, counts.sum(axis=0))
        shares.append(GateShare(group.names, count, count - left, 0, group.expected))
    return tuple(replace(log, y=left.y) for log, left in zip(logs, cleaned, strict=True)), tuple(shares)


def likelihood_of(
    form: Form, logs: Iterable[Log], dt: float, between: str, gates: tuple[GatedGroup, ...]
) -> Likelihood:
    """Return the likelihood of logs on a form; `dt`: their period, or the longest of a step; `between`: the course of
    inputs between samples, "line" or "hold"; `gates`: innovation gates."""
    records = [log.of(form.system.inputs) for log in logs]
    steps, _ = steps_and_growth(form.system, max(float(record.ahead.max()) for record in records))
    return Likelihood(form, records, scale(form, dt), between, steps, gates)


def _common_period(records: Sequence[Log]) -> float | tuple[float, float]:
    """Return the common period of the logs or, if any log is irregular, the shortest and the longest dt of a step for
    them."""
    if not records or not all(isinstance(record, Log) for record in records):
        raise CannotTune("records", "are missing; give logs, such as hg.Log(u, y, dt)")
    if (limits := step_limits(records)) is not None:
        return limits
    dts = [record.dt for record in records]
    if max(dts) > (1 + SAME) * min(dts):
        listed = ", ".join(f"{dt:g}" for dt in dict.fromkeys(dts))
        raise CannotTune("records", f"have different periods, {listed}; read them on one grid, by --dt (dt=)")
    return dts[0]


def _results(
    workers: Workers[Task], done: MutableMapping[str, Any], each: Callable[[str], None], pieces: Iterable[Piece]
) -> dict[Piece, Any]:
    listed = list(pieces)
    results = {piece: piece.read(done[repr(piece)]) for piece in listed if repr(piece) in done}
    missing = [piece for piece in listed if piece not in results]
    for number, result in workers.results(_worked, enumerate(missing)):
        piece = missing[number]
        each(piece.label)  # before the result is kept, since a search that Ctrl-C ends has one, too
        results[piece] = result
        done[repr(piece)] = result if isinstance(result, str) else [np.asarray(part).tolist() for part in result]
    return results


def _worked(task: Task, numbered: tuple[int, Piece]) -> tuple[int, Any]:
    number, piece = numbered
    return number, piece.result(task)


def _truth(
    plant: System, truth: Sequence[Mapping[str, np.ndarray]], logs: Sequence[Log]
) -> tuple[Mapping[str, np.ndarray], ...]:
    states = [x.name for x in plant.declared.states]
    if truth and len(truth) != len(logs):
        raise CannotTune("truth", f"is of {len(truth)} records and there are {len(logs)}; give a mapping for each")
    for k, (each, log) in enumerate(zip(truth, logs, strict=False), 1):
        if not each or each.keys() != truth[0].keys():
            raise CannotTune(f"truth of record {k}", "must hold the same states as that of the first, and one at least")
        for name, course in each.items():
            what = f"truth of {name!r:.60}"
            if name not in states:
                raise CannotTune(what, nearest(name, states, f"is of no state; there are {', '.join(states)}"))
            if np.shape(course) != (len(log.y),):
                raise CannotTune(what, f"of record {k} has the shape {np.shape(course)}; make it ({len(log.y)},)")
    return tuple({name: np.asarray(course, dtype=float) for name, course in each.items()} for each in truth)


def adaptive(task: Task, plain: Tuned, each: Callable[[str], None] = lambda what: None) -> Tuned | str:
    """Return the tuned filter `plain` with an adaptive theta, from logs without faults, or the reason why there is
    none.

        d = T/4, a whole number of samples for each of 4 predictors,   T = 2 n/theta: the time to cross a range
        gamma_0 = 1.1 max of I_d along the log with theta = 1,   gamma_1 = 2 gamma_0
        rise time d/4,   rate 1/(3 d)
        theta_1 = the largest of 8, 6, 4, 3, 2 whose alarm ratio is below 1: the mean of I_d with theta at 2 theta_1,
                  over gamma_0

    so that theta stays at 1 along the log, and returns to it after an alarm. Q and R are those of the filter with theta
    = 1.
    """
    refusals, gamma_0 = list[str](), 0.0
    crossing = 2 * plain.numbers.n / plain.numbers.theta  # T
    d = PREDICTORS * max(1, round(crossing / 4 / task.dt / PREDICTORS)) * task.dt
    for theta_1 in PEAKS:
        table = {
            "kind": "adaptive",
            "theta_1": theta_1,
            "rise_time": two_digits(d / 4),
            "rate": two_digits(1 / (3 * d)),
            "innovation": {"kind": "staggered", "d": d, "predictors": PREDICTORS},
        }
        try:
            largest = gamma_0 or ABOVE * float(_innovations(task, _first(task, plain, table, HUGE)).max())
            gamma_0 = two_digits(largest)  # of every theta_1, since theta stays at 1
            ratio = float(_innovations(task, _first(task, plain, table, gamma_0 / HUGE)).mean()) / gamma_0
            if ratio >= 1:
                refusals.append(
                    f"theta does not return to 1, even with theta_1 = {theta_1:g} (alarm ratio {ratio:.2g}): "
                    "noise alone keeps theta high; fit the model, or take riccati, whose theta is constant"
                )
                continue
            first = _first(task, plain, table, gamma_0)
        except HgogenError as error:
            refusals.append(str(error))
            continue
        finally:
            each(ADAPTIVE)
        more = task.judge.errors(first.step) - task.judge.errors(plain.first.step)  # Q and R are chosen already
        return replace(plain, name=ADAPTIVE, first=first, errors=plain.errors + more, tried=())
    return refusals[-1]


def _first(task: Task, plain: Tuned, table: Mapping[str, Any], gamma_0: float) -> First:
    gains = {**plain.first.starting.gains, "theta": {**table, "mu": (gamma_0, 2 * gamma_0)}}
    return task.make_step(FILTER, plain.first.row, gains)


def _innovations(task: Task, first: First) -> np.ndarray:
    """Return the innovation I_d along the logs, the integral of |y - yhat|^2 over the window d, without the beginning
    of each log."""
    parts, engine = [], quickest_engine(first.step, sum(len(record.y) for record in task.records))
    for record in task.records:
        first.step.reset(record.start)
        log = record.of(first.step.inputs)
        run = first.step.run(u=log.u, y=log.y, engine=engine, dt=log.given(first.step))
        innovation = run.traces["innovation"]
        parts.append(innovation[round(BEGIN * len(innovation)) :])
    return np.concatenate(parts)
