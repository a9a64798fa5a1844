"""Monte Carlo campaigns: many runs of a step on a trial, with random noise, initial states and parameters.

Initial states, parameters and noise of the plant vary, each within an interval. The draws are a Latin hypercube: one
draw of each quantity lies in each of N equal parts of its interval, in a random order. The observer keeps its nominal
parameters and the trial's estimate. Run k has the noise of seed k and draw k, so its numbers do not depend on the
process that computes it or on other runs. Runs are distributed in batches to processes of this machine or of a Dask
cluster (`Workers`), which return numbers only. The compiled step computes runs with the same inputs together, with the
same bytes as `trial.tried`. Source: McKay, Beckman, Conover, Technometrics 21 (1979).

A file of results has a head that identifies the campaign, then a line of JSON for each run in the order of completion.
As the file may have been changed, a line counts only if it can be one of this campaign: the run has its drawn values,
and metrics of this trial and these states. `Tally` computes quantiles over the runs, from a few stored bytes for each.
"""

import json
import math
import pickle
import re
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache
from hashlib import sha256
from itertools import islice
from typing import Annotated, Any, Generic, Literal, TypeVar

import numpy as np
import sympy as sp

from hgogen import targets
from hgogen.call import CallableStep
from hgogen.errors import BadArgument, nearest
from hgogen.reading.given import Misfit, count, real, requires
from hgogen.registry import library
from hgogen.run import native
from hgogen.run.metrics import Metrics, Response, metrics
from hgogen.run.samples import Engine
from hgogen.signal import Signal
from hgogen.step import Step, demand_choice
from hgogen.system import System
from hgogen.trial import (
    BadTrial,
    Feed,
    OrnsteinUhlenbeck,
    Plant,
    Trajectory,
    Trial,
    elapsed,
    feeds,
    first_memory,
    run_feeds,
    sample_times,
)

MOST_JOBS = 1000  # processes
TIMEOUT = "10s"  # for the answer of a scheduler
Shared = TypeVar("Shared")
Piece = TypeVar("Piece")
Result = TypeVar("Result")


class NoScheduler(BadArgument):
    """The error for a scheduler of a cluster that does not answer."""


@dataclass(frozen=True, eq=False)
class Workers(Generic[Shared]):
    """The processes that compute pieces of work in parallel: `jobs` on this machine (None: one for each core, 1: this
    process alone), or a Dask cluster whose scheduler has the address `scheduler`. `shared`: the data that every piece
    reads.

    Raises: `BadGain` for jobs that are no number.
    """

    shared: Shared
    jobs: int | None = 1
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.jobs is not None:
            count("jobs", self.jobs, 1, MOST_JOBS)

    def results(self, work: Callable[[Shared, Piece], Result], pieces: Iterable[Piece]) -> Iterator[Result]:
        """Yield `work(shared, piece)` for each piece, in the order of completion; `work`: a top-level function, which
        can be pickled. Raises: `NoScheduler`; `NotInstalled` without the package for clusters; errors of `work`."""
        if self.jobs == 1 and self.scheduler is None:
            yield from (work(self.shared, piece) for piece in pieces)
            return
        from joblib import Parallel, delayed, parallel_config

        client: Any = nullcontext()
        backend = "loky"
        if self.scheduler:
            distributed = library("distributed", f"scheduler {self.scheduler}", "cluster")
            try:
                client, backend = distributed.Client(self.scheduler, timeout=TIMEOUT), "dask"
            except (OSError, ValueError) as error:
                raise NoScheduler(f"scheduler {self.scheduler}", f"does not answer: {error}") from None
        with client, parallel_config(backend=backend):
            parallel = Parallel(n_jobs=self.jobs or -1, return_as="generator_unordered", batch_size=1)
            yield from parallel(delayed(_worked)(work, self._sent, piece) for piece in pieces)

    @cached_property
    def _sent(self) -> bytes:
        return pickle.dumps(self.shared)


@lru_cache(maxsize=4)
def _opened(sent: bytes) -> Any:
    return pickle.loads(sent)


def _worked(work: Callable[[Any, Any], Any], sent: bytes, piece: Any) -> Any:
    return work(_opened(sent), piece)


MOST = 10_000_000  # runs
MANY = 64  # runs from which compiling the plant's integrator saves time
BATCH, ALONE = 64, 8  # runs of a batch; where each run simulates the plant
FEWEST_SAMPLES = 5_000_000  # samples from which compiling the step in lanes saves time
MOST_NUMBERS = 1 << 20  # most measured numbers of runs that are computed together
STATES, PARAMETERS, NOISE = "x0", "parameters", "noise"  # names of whole groups of quantities
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_INTERVAL = re.compile(rf"({_NUMBER})\.\.({_NUMBER})")
_SHARE = re.compile(rf"({_NUMBER})%")
_USE = "write NAME, NAME=10%, NAME=0.2 or NAME=0.8..1.2, with commas between them"


class BadCampaign(BadArgument):
    """The error for a campaign, or a file of its results, that cannot be run."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of one run of a campaign: its number, the values drawn, and its metrics, or why it failed."""

    run: Annotated[int, "number of the run"]
    varied: Annotated[Mapping[str, float], "what was varied, by name"]
    metrics: Annotated[Metrics | None, "its metrics; null where its plant could not be integrated"]
    failed: Annotated[str, "why there are no metrics"] = ""


@dataclass(frozen=True)
class Varied:
    """A quantity that varies between the runs of a campaign (initial state, parameter or noise), with its interval."""

    name: Annotated[str, "what varies"]
    what: Annotated[Literal["start", "parameter", "noise"], "what it is; noise: a factor of each output's"]
    low: Annotated[float, "lower end"]
    high: Annotated[float, "upper end"]


@dataclass(frozen=True, eq=False)
class Draws:
    """The random `values` (N, k) of the k quantities `varied` in the N runs of a campaign."""

    varied: Annotated[tuple[Varied, ...], "what varies from run to run"]
    values: np.ndarray

    def __len__(self) -> int:
        return len(self.values)

    @property
    def truth_varies(self) -> bool:
        """Whether the simulated plant differs from run to run, and not only the noise."""
        return any(each.what != "noise" for each in self.varied)

    def named(self, row: int) -> dict[str, float]:
        """Return the drawn values of run number `row` by the name of the quantity."""
        return dict(zip((each.name for each in self.varied), map(float, self.values[row]), strict=True))

    def trial(self, trial: Trial, row: int) -> Trial:
        """Return the `trial` with the drawn initial states and noise of run number `row`."""
        pairs = list(zip(self.varied, map(float, self.values[row]), strict=True))
        start = {each.name: value for each, value in pairs if each.what == "start"}
        factor = math.prod(value for each, value in pairs if each.what == "noise")
        noise = {
            name: replace(one, sigma=factor * one.sigma)
            if isinstance(one, OrnsteinUhlenbeck)
            else replace(one, amplitude=factor * one.amplitude)
            for name, one in trial.noise.items()
        }
        return replace(trial, start={**trial.start, **start}, noise=noise)

    def parameters(self, row: int) -> list[float]:
        """Return the drawn values of the plant's parameters in run number `row`, in the order of `free`."""
        pairs = zip(self.varied, map(float, self.values[row]), strict=True)
        return [value for each, value in pairs if each.what == "parameter"]

    def free(self, plant: System) -> list[Signal]:
        """Return the parameters of the plant that vary between runs."""
        by_name = {p.name: p for p in plant.parameters}
        return [by_name[each.name] for each in self.varied if each.what == "parameter"]


@dataclass(frozen=True, eq=False)
class Campaign:
    """A Monte Carlo campaign: runs of `step` on `trial`, one for each of the `draws`, by `engine`."""

    step: CallableStep
    trial: Trial
    draws: Draws
    engine: Annotated[Engine, "who runs the step: c or python"]

    @property
    def plant(self) -> System:
        """The plant as the user declared it, before any form changes its states."""
        return self.step.observer.form.system.declared

    @property
    def digest(self) -> str:
        """A digest of everything that determines the numbers of a run (such as the step's C), by which a file of
        results belongs to this campaign. If only the noise varies, it does not depend on the number of runs."""
        step, plant = self.step, self.plant
        scenario = {name: value for name, value in vars(self.trial).items() if name != "seeds"}
        scenario |= {"inputs": {name: sp.srepr(sp.sympify(one)) for name, one in self.trial.inputs.items()}}
        program = dict(targets.c99(step, real=step.real, check=False))
        known = (program, step.tuned, plant.flow, plant.output, plant.nominal, scenario, self.draws.varied)
        return sha256(repr(known).encode() + self.draws.values.tobytes()).hexdigest()[:16]

    def run(
        self, numbers: Sequence[int] | None = None, jobs: int | None = None, scheduler: str | None = None
    ) -> Iterator[Outcome]:
        """Yield the outcomes of the runs with these `numbers`, by default of all runs, in the order of completion.

        `jobs`: processes, by default one for each core, 1 for this process alone; `scheduler`: the address of a Dask
        cluster.

        Raises: `BadGain` for a number of no run; `BadTrial` for a trial that does not fit its plant; `NoScheduler` for
        a scheduler that does not answer; `NotInstalled` without the package of a cluster.
        """
        last = len(self.draws) - 1
        wanted = range(last + 1) if numbers is None else [count("run", number, 0, last) for number in numbers]
        return _outcomes(self, wanted, jobs, scheduler)

    def drawn(self, numbers: Sequence[int]) -> Draws:
        """Return the draws of the runs with these numbers."""
        return replace(self.draws, values=self.draws.values[list(numbers)])


@requires(Step, "a step, as hg.sample makes it")
def campaign(
    step: CallableStep,
    trial: Trial,
    runs: int,
    vary: str | Mapping[str, str | float | None] | None = None,
    seed: int = 0,
    engine: Engine | None = None,
) -> Campaign:
    """Return a Monte Carlo campaign of a step on a trial: `outcomes = list(hg.campaign(step, trial, 1000,
    vary="x0").run())`.

    Args: `runs` the number of runs, 1 to 10^7; `vary` the quantities that vary, as in `varied`, None for noise alone;
    `seed` of the draws; `engine` as in `Step.run`.

    Raises: `Misfit`; `BadVariation`; `BadCampaign`.
    """
    if not isinstance(trial, Trial):
        raise Misfit("campaign, trial=", trial, "a trial, as hgogen.trial.Trial makes it")
    demand_choice("engine", engine, (None, "c", "python"))
    plant = step.observer.form.system.declared
    number = count("runs", runs, 1, MOST)
    drawn = hypercube(() if vary is None else varied(vary, plant, trial), number, count("seed", seed, 0, 2**31))
    return Campaign(step, trial, drawn, engine or native.engine())


def _outcomes(each: Campaign, numbers: Sequence[int], jobs: int | None, scheduler: str | None) -> Iterator[Outcome]:
    # raises errors of the trial, and compiles once for all processes
    ready = PreparedCampaign(replace(each, draws=each.drawn(())), len(each.draws))
    size = ALONE if each.draws.truth_varies else BATCH
    batches = (numbers[first : first + size] for first in range(0, len(numbers), size))
    pieces = ((batch, each.drawn(batch)) for batch in batches)
    for outcomes in Workers(ready, jobs, scheduler).results(PreparedCampaign.outcomes, pieces):
        yield from outcomes


class PreparedCampaign:
    """A campaign with the data that all its runs share: the plant's equations, the step's initial memory, and the
    simulated truth if it is the same for all runs.

    `runs`: the number of runs, which decides whether compiling saves time. Raises: `BadTrial` for a trial that does not
    fit its plant.
    """

    def __init__(self, campaign: Campaign, runs: int) -> None:
        self.campaign, self.runs = campaign, runs
        many = runs >= MANY
        step, trial, truth_varies = campaign.step, campaign.trial, campaign.draws.truth_varies
        free = campaign.draws.free(campaign.plant)
        self._plant = Plant(campaign.plant, trial, step.dt, free, many and truth_varies, sample_times(step, trial))
        self._memory = first_memory(step, trial)
        self._truth = None if truth_varies else self._plant.truth(trial.start)
        if many and truth_varies:
            with suppress(BadTrial):
                self._plant.truth(trial.start, [float(campaign.plant.nominal[p]) for p in free])
        compiled, samples = campaign.engine == "c", len(self._plant.times)
        at_once = ALONE if truth_varies else BATCH if campaign.draws.varied else 1
        fits = at_once * samples * len(campaign.plant.outputs) <= MOST_NUMBERS
        self._together = compiled and runs * samples >= FEWEST_SAMPLES and fits
        if compiled:
            run = step.run_many if self._together else step.run
            nothing = np.zeros((0, len(step.inputs))), np.zeros((0, len(step.samples)))
            run(*nothing, engine="c", dt=0.0 if step.clock.varying else None)

    def __reduce__(self) -> tuple[Any, ...]:
        """The arguments to build it again, since a pickle has no graphs."""
        return PreparedCampaign, (self.campaign, self.runs)

    def outcomes(self, piece: tuple[Sequence[int], Draws]) -> list[Outcome]:
        """Return the outcomes of some runs; `piece`: their numbers and their draws. If no quantity varies, the noise of
        several runs is drawn at once."""
        numbers, draws = piece
        step, engine, outcomes = self.campaign.step, self.campaign.engine, dict[int, Outcome]()
        if not draws.varied and self._truth is not None:
            runs, size = feeds(step, self.campaign.trial, self._truth, numbers), self._truth.at_once
        else:
            runs, size = self._varied(numbers, draws, outcomes), len(numbers)
        memory = self._memory
        each = run_together(step, runs, memory, size) if self._together else run_feeds(step, runs, memory, engine)
        for one in each:
            outcomes[one.seed] = Outcome(one.seed, draws.named(numbers.index(one.seed)), metrics(step, one))
        return [outcomes[number] for number in numbers]

    def _varied(self, numbers: Sequence[int], draws: Draws, outcomes: dict[int, Outcome]) -> Iterator[Feed]:
        for row, number in enumerate(numbers):
            trial = draws.trial(self.campaign.trial, row)
            try:
                truth = self._truth or self._plant.truth(trial.start, draws.parameters(row))
            except BadTrial as error:
                outcomes[number] = Outcome(number, draws.named(row), None, error.reason)
            else:
                yield from feeds(self.campaign.step, trial, truth, [number])


def run_together(step: CallableStep, runs: Iterable[Feed], start: bytes, size: int) -> Iterator[Trajectory]:
    """Yield the trajectories of runs with equal inputs, computed by the compiled step, `size` runs at a time; each run
    starts from the saved state `start`."""
    runs = iter(runs)
    for first in runs:
        some = [first, *islice(runs, size - 1)]
        step.restore(start)
        y = np.stack([step.arriving(one.y) for one in some])
        many = step.run_many(first.u, y, jobs=1, traces=True, engine="c", dt=elapsed(step, first.truth))
        for k, one in enumerate(some):
            x, status = (np.ascontiguousarray(array[k]) for array in (many.x, many.status))
            traces = {name: np.ascontiguousarray(values[k]) for name, values in many.traces.items()}
            yield Trajectory(one.trial, one.seed, one.truth, one.y, x, traces, status, "c")


class BadVariation(BadArgument):
    """The error for a quantity that a campaign cannot vary."""

    text = "vary {what!r}: {reason}"


def hypercube(varied: Sequence[Varied], count: int, seed: int) -> Draws:
    """Return `count` draws of the quantities `varied` by Latin hypercube sampling; equal seeds give equal draws."""
    rng = np.random.default_rng([seed, count])
    shares = [(rng.permutation(count) + rng.random(count)) / count for _ in varied]
    columns = [each.low + share * (each.high - each.low) for each, share in zip(varied, shares, strict=True)]
    return Draws(tuple(varied), np.column_stack(columns) if columns else np.zeros((count, 0)))


def varied(requested: str | Mapping[str, str | float | None], plant: System, trial: Trial) -> tuple[Varied, ...]:
    """Return the requested quantities: names, "x0" for all first states, "parameters" for all with a range, "noise" for
    the size of every output's noise, each with an interval as in "a=10%" (of its value in the trial), "a=0.2" (to both
    sides), "a=0.8..1.2"; without one it is the declared range. A mapping gives the same by name. Raises:
    `BadVariation`."""
    if not isinstance(requested, str | Mapping) or not all(isinstance(name, str) for name in requested):
        raise BadVariation(str(requested), "is no text and no mapping by name; write \"x0,a=10%\" or {'a': '10%'}")
    pairs = _split(requested) if isinstance(requested, str) else requested.items()
    listed: dict[str, Varied] = {}
    for name, width in pairs:
        for each in _quantities(name, width, plant, trial):
            if each.name in listed:
                raise BadVariation(name, f"{each.name} varies already; name it once")
            listed[each.name] = each
    return tuple(listed.values())


def _split(text: str) -> Iterator[tuple[str, str | None]]:
    for part in text.split(","):
        name, equals, width = (piece.strip() for piece in part.partition("="))
        if not name or (equals and not width):
            raise BadVariation(text, _USE)
        yield name, width or None


def _quantities(name: str, width: str | float | None, plant: System, trial: Trial) -> Iterator[Varied]:
    states, parameters = ({s.name: s for s in signals} for signals in (plant.states, plant.parameters))

    def start(state: Signal) -> Varied:
        return Varied(state.name, "start", *_interval(state, width, float(trial.start[state.name])))

    def parameter(p: Signal) -> Varied:
        return Varied(p.name, "parameter", *_interval(p, width, float(p.nominal or 0)))

    if name == NOISE:
        yield Varied(NOISE, "noise", *_factor(width, trial))
    elif name == STATES:
        yield from map(start, plant.states)
    elif name == PARAMETERS:
        several = [p for p in plant.parameters if p.bounded or width is not None]
        if not several:
            raise BadVariation(name, f"{plant.name} has no parameter with a range; declare low= and high=, or name one")
        yield from map(parameter, several)
    elif name in states:
        yield start(states[name])
    elif name in parameters:
        yield parameter(parameters[name])
    else:
        known = (STATES, PARAMETERS, NOISE, *states, *parameters)
        raise BadVariation(name, nearest(name, known, f"what can vary is {', '.join(known)}"))


def _interval(signal: Signal, width: str | float | None, middle: float) -> tuple[float, float]:
    if width is None and not signal.bounded:
        raise BadVariation(signal.name, "it has no range; declare low= and high=, or say how far, as in 10% or 0.2")
    low, high = signal.interval if width is None else _read(signal.name, width, middle)
    bottom, top = signal.limits
    if low < bottom or high > top:
        reason = f"[{low:g}, {high:g}] leaves its range [{bottom:g}, {top:g}]; say less, or declare a wider range"
        raise BadVariation(signal.name, reason)
    return low, high


def _factor(width: str | float | None, trial: Trial) -> tuple[float, float]:
    if not trial.noise:
        raise BadVariation(NOISE, f"the trial {trial.name} has none; declare a trial with noise, or leave it out")
    if width is None:
        raise BadVariation(NOISE, "say by which factor, as in noise=50% or noise=0.5..2")
    low, high = _read(NOISE, width, 1.0)
    if low < 0:
        raise BadVariation(NOISE, f"a factor from {low:g} on is below 0; say less")
    return low, high


def _read(name: str, width: str | float, middle: float) -> tuple[float, float]:
    text = str(width).strip()
    if ends := _INTERVAL.fullmatch(text):
        low, high = map(float, ends.groups())
    else:
        share = _SHARE.fullmatch(text)
        if not share and not re.fullmatch(_NUMBER, text):
            raise BadVariation(name, f"{text!r} is no interval; {_USE}")
        half = abs(middle) * float(share[1]) / 100 if share else real(name, float(text))
        low, high = middle - half, middle + half
    if not -math.inf < low < high < math.inf:
        raise BadVariation(name, f"{text!r} leaves nothing to vary about {middle:g}; {_USE}")
    return low, high


def results_head(each: Campaign) -> str:
    """Return the first line of a campaign's file of results, which identifies the campaign."""
    return json.dumps({"campaign": each.digest, "trial": each.trial.name}) + "\n"


def results_line(one: Outcome) -> str:
    """Return the line of an outcome in a campaign's file of results, as JSON with Python's words for infinite numbers
    and NaN."""
    return json.dumps(asdict(one)) + "\n"


def stored_outcomes(each: Campaign, lines: Iterable[str], name: str) -> Iterator[Outcome | None]:
    """Yield the outcome in each line of a campaign's file of results but the first, None for a line that holds no
    outcome of this campaign. Raises: `BadCampaign` if the first line of the file `name` is that of another campaign."""
    for number, one in enumerate(lines):
        if number:
            yield outcome(each, one)
        elif one != results_head(each):
            raise BadCampaign(name, "holds the results of another campaign, or none; give another folder, or remove it")


def outcome(each: Campaign, text: str) -> Outcome | None:
    """Return the outcome in a line `text` of a campaign's file of results; None if the line holds no outcome of this
    campaign."""
    try:
        row = json.loads(text)
        values = row["metrics"]
        if values is not None:
            responses = tuple(Response(**one) for one in values["responses"])
            values = Metrics(**{**values, "responses": responses})
        one = Outcome(**{**row, "metrics": values})
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    failed = one.metrics is None and isinstance(one.failed, str) and one.failed != "" and one.failed.isprintable()
    if each.draws.varied:
        drawn = _is_count(one.run, len(each.draws) - 1) and one.varied == each.draws.named(one.run)
    else:  # with noise alone the file may have more runs than requested now
        drawn = _is_count(one.run, MOST - 1) and one.varied == {}
    return one if drawn and (failed or _was_measured(each, one)) else None


def _was_measured(each: Campaign, one: Outcome) -> bool:
    trial, values = each.trial, one.metrics
    if values is None or one.failed != "" or values.seed != one.run or values.engine not in ("c", "python"):
        return False
    samples = round(trial.duration / each.step.dt) + 1
    longest = samples * each.step.dt
    return (
        [response.time for response in values.responses] == list(trial.events)
        and all(_is_response(response, longest, samples) for response in values.responses)
        and isinstance(values.rms, Mapping)
        and list(values.rms) == [state.name for state in each.step.states]
        and all(_is_number(value, 0, math.inf, nan=True) for value in values.rms.values())
        and _is_count(values.clamped, samples)
    )


def _is_response(one: Response, longest: float, samples: int) -> bool:
    times = all(value is None or _is_number(value, 0, longest) for value in (one.settled, one.theta_settled))
    peak = one.peak is None or _is_number(one.peak, -math.inf, math.inf, nan=True)
    share = one.loud is None or _is_number(one.loud, 0, 1)
    return times and peak and share and (one.triggers is None or _is_count(one.triggers, samples))


def _is_count(value: Any, most: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most


def _is_number(value: Any, low: float, high: float, nan: bool = False) -> bool:
    return isinstance(value, float) and (low <= value <= high or (nan and math.isnan(value)))


@dataclass(frozen=True)
class Spread:
    """Quantiles over a campaign's runs of a quantity, such as a settling time; None (counted as infinite) where the
    event never happened."""

    name: Annotated[str, "the quantity"]
    low: Annotated[float | None, "5 % quantile; null: never"]
    middle: Annotated[float | None, "median; null: never"]
    high: Annotated[float | None, "95 % quantile; null: never"]
    worst: Annotated[float | None, "the worst; null: never"]
    run: Annotated[int, "the run that had the worst"]


class Tally:
    """The statistics of a campaign's outcomes, which are added one by one: settling times after each event, steady
    errors by state, and the largest theta if theta is adaptive; `unit`: the unit of the plant's time.

    `failed`: the number of runs whose plant cannot be simulated, `failure` the first of them; `last`: the outcome added
    last.
    """

    def __init__(self, runs: int, unit: str = "s") -> None:
        self.failed = 0
        self.failure: Outcome | None = None
        self.last: Outcome | None = None
        self._unit, self._added, self._names = unit, bytearray(runs), list[str]()
        self._runs, self._numbers = array("q"), array("d")

    def __len__(self) -> int:
        return len(self._runs) + self.failed

    def __contains__(self, run: int) -> bool:
        return bool(self._added[run])

    def add(self, one: Outcome) -> None:
        """Add the outcome of a run; a run that was added before is ignored."""
        if one.run in self:
            return
        self._added[one.run], self.last = 1, one
        if one.metrics is None:
            self.failed += 1
            self.failure = one if self.failure is None or one.run < self.failure.run else self.failure
            return
        responses = one.metrics.responses
        numbers = {f"settled after {event.time:g} {self._unit}": event.settled for event in responses}
        numbers |= {f"steady error of {state}": rms for state, rms in one.metrics.rms.items()}
        if responses[0].peak is not None:
            numbers["peak of theta"] = max(event.peak or 0.0 for event in responses)
        self._names = list(numbers)
        self._runs.append(one.run)
        self._numbers.extend(np.inf if value is None or np.isnan(value) else value for value in numbers.values())

    def spreads(self) -> list[Spread]:
        """The quantiles of each quantity over the runs that have metrics."""
        runs = np.frombuffer(self._runs, dtype=np.int64)
        order, table = np.argsort(runs), np.frombuffer(self._numbers).reshape(len(runs), len(self._names))
        columns = zip(self._names, table.T, strict=True)
        return [_spread_of(name, column[order], runs[order]) for name, column in columns] if len(runs) else []


def _spread_of(name: str, values: np.ndarray, runs: np.ndarray) -> Spread:
    """Return the quantiles of `values` (N,) over the runs with the numbers `runs` (N,), infinite if an event never
    happened. By the method "inverted_cdf" each quantile is the value of some run."""
    quantiles = np.quantile(values, (0.05, 0.5, 0.95), method="inverted_cdf")
    worst = int(np.argmax(values))
    low, middle, high, most = (float(value) if np.isfinite(value) else None for value in (*quantiles, values[worst]))
    return Spread(name, low, middle, high, most, int(runs[worst]))
