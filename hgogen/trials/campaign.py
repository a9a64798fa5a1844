"""A campaign: one step on one trial, many times, each with noise, first states and parameters of its own.

Run k has the noise of seed k and draw k of the Latin hypercube of all runs (`trials/varied.py`): its numbers are the
same whoever computes it, and after whatever was computed before. Runs go out in batches to processes of this machine,
or of a Dask cluster, by joblib; what comes back are numbers only.
"""

import json
import pickle
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from hashlib import sha256
from typing import Any

import numpy as np
import sympy as sp

from hgogen import targets
from hgogen.call import CallableStep
from hgogen.calling import native
from hgogen.calling.samples import Engine
from hgogen.errors import BadArgument
from hgogen.reading.given import count
from hgogen.reading.optional import library
from hgogen.system import System
from hgogen.trial import BadTrial, Plant, Trial, Truth, first_memory, tried
from hgogen.trials.metrics import Metrics, Response, metrics
from hgogen.trials.varied import Draws, hypercube, varied

MOST, MOST_JOBS = 10_000_000, 1000  # runs; processes
PATIENCE = "10s"  # until a scheduler answers
BATCH, ALONE = 64, 8  # runs that go out together; where each has a truth of its own


class BadCampaign(BadArgument):
    """A campaign, or a file of one, that cannot be run."""


@dataclass(frozen=True)
class Outcome:
    """Run number `run`: what was varied, by name, and its metrics, None where its plant could not be integrated, with
    the reason in `failed`."""

    run: int
    varied: Mapping[str, float]
    metrics: Metrics | None
    failed: str = ""

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def outcome(row: Mapping[str, Any]) -> Outcome:
    """What `as_dict` gave."""
    values = row["metrics"]
    responses = tuple(Response(**one) for one in values["responses"]) if values else ()
    return Outcome(**{**row, "metrics": values and Metrics(**{**values, "responses": responses})})


@dataclass(frozen=True, eq=False)
class Campaign:
    """What is run: `step` on `trial` so many times, `draws` of what varies, by `engine`."""

    step: CallableStep
    trial: Trial
    draws: Draws
    engine: Engine

    @property
    def plant(self) -> System:
        """The plant as first declared."""
        return self.step.observer.form.system.declared

    @property
    def digest(self) -> str:
        """What the numbers of a run depend on, the program of the step as its C: a file of results of another campaign
        has another. Where nothing but the seed varies, a run does not depend on how many there are."""
        step, plant = self.step, self.plant
        scenario = {name: value for name, value in vars(self.trial).items() if name != "seeds"}
        scenario |= {"inputs": {name: sp.srepr(sp.sympify(one)) for name, one in self.trial.inputs.items()}}
        program = dict(targets.c99(step, real=step.real, check=False))
        known = (program, step.tuned, plant.flow, plant.output, plant.nominal, scenario, self.draws.varied)
        return sha256(repr(known).encode() + self.draws.values.tobytes()).hexdigest()[:16]

    def run(
        self, numbers: Sequence[int] | None = None, jobs: int | None = None, scheduler: str | None = None
    ) -> Iterator[Outcome]:
        """The outcomes of runs as they come, in no order; of all runs by default.

        `jobs`: processes, by default one for each core, 1 for none but this; `scheduler`: the address of a Dask
        cluster.

        Raises: `BadGain` for a number that is none; `BadTrial` of a trial that does not fit its plant; `BadCampaign`
        where no scheduler answers; `NotInstalled` without the package of a cluster.
        """
        last = len(self.draws) - 1
        wanted = range(last + 1) if numbers is None else [count("run", number, 0, last) for number in numbers]
        return _outcomes(self, wanted, None if jobs is None else count("jobs", jobs, 1, MOST_JOBS), scheduler)

    def drawn(self, numbers: Sequence[int]) -> Draws:
        """The draws of runs."""
        return replace(self.draws, values=self.draws.values[list(numbers)])


def campaign(
    step: CallableStep,
    trial: Trial,
    runs: int,
    vary: str | Mapping[str, str | float | None] | None = None,
    seed: int = 0,
    engine: Engine | None = None,
) -> Campaign:
    """A campaign of a step on a trial: `outcomes = list(hg.campaign(step, trial, 1000, vary="x0").run())`.

    Args: `runs` how many, from 1 to 10^7; `vary` as in `trials.varied.varied`, None for noise alone; `seed` of the
    draws; `engine` as in `Step.run`.

    Raises: `BadVariation`; `BadCampaign`.
    """
    plant = step.observer.form.system.declared
    number = count("runs", runs, 1, MOST)
    drawn = hypercube(() if vary is None else varied(vary, plant, trial), number, count("seed", seed, 0, 2**31))
    return Campaign(step, trial, drawn, engine or native.engine())


def _outcomes(each: Campaign, numbers: Sequence[int], jobs: int | None, scheduler: str | None) -> Iterator[Outcome]:
    ready = Ready(each)  # which meets what does not fit here, and compiles the step once for all processes
    size = ALONE if each.draws.moves else BATCH
    batches = [numbers[first : first + size] for first in range(0, len(numbers), size)]
    if jobs == 1 and scheduler is None:
        yield from (one for batch in batches for one in ready.outcomes(batch, each.drawn(batch)))
        return
    sent = pickle.dumps(replace(each, draws=each.drawn(())))
    yield from _spread(((sent, batch, each.drawn(batch).values) for batch in batches), jobs, scheduler)


def _spread(tasks: Iterable[tuple[Any, ...]], jobs: int | None, scheduler: str | None) -> Iterator[Outcome]:
    """The tasks by joblib, on a cluster where there is a scheduler."""
    from joblib import Parallel, delayed, parallel_config

    def results() -> Iterator[Outcome]:
        parallel = Parallel(n_jobs=jobs or -1, return_as="generator_unordered", batch_size=1)
        for outcomes in parallel(delayed(_worked)(*task) for task in tasks):
            yield from outcomes

    if scheduler is None:
        with parallel_config(backend="loky"):
            yield from results()
        return
    with _client(scheduler), parallel_config(backend="dask"):
        yield from results()


def _client(address: str) -> Any:
    """A client of a Dask cluster. Raises: `BadCampaign`, `NotInstalled`."""
    distributed = library("distributed", f"scheduler {address}", "cluster")
    try:
        return distributed.Client(address, timeout=PATIENCE)
    except (OSError, ValueError) as error:
        raise BadCampaign(f"scheduler {address}", f"does not answer: {error}") from None


@lru_cache(maxsize=4)
def _opened(sent: bytes) -> "Ready":
    """A campaign in the process that works on it: a step is made again of what made it, once."""
    return Ready(pickle.loads(sent))


def _worked(sent: bytes, numbers: Sequence[int], values: np.ndarray) -> list[Outcome]:
    ready = _opened(sent)
    return list(ready.outcomes(numbers, replace(ready.campaign.draws, values=values)))


class Ready:
    """A campaign with what its runs share: the plant's equations, the step's first memory, and where nothing moves the
    plant from run to run, its truth.

    Raises: `BadTrial` of a trial that does not fit its plant.
    """

    def __init__(self, campaign: Campaign) -> None:
        self.campaign = campaign
        step, trial = campaign.step, campaign.trial
        self._plant = Plant(campaign.plant, trial, step.dt, campaign.draws.free(campaign.plant))
        self._memory = first_memory(step, trial)
        self._truth = None if campaign.draws.moves else self._plant.truth(trial.start)
        if campaign.engine == "c":
            step.run(np.zeros((0, len(step.inputs))), np.zeros((0, len(step.samples))), engine="c")

    def outcomes(self, numbers: Sequence[int], draws: Draws) -> Iterator[Outcome]:
        """The outcomes of runs, of each its draw; those that differ by their seeds alone have their noise made
        together."""
        if not draws.varied and self._truth is not None:
            yield from self._tried(self._truth, self.campaign.trial, numbers, draws)
            return
        for row, number in enumerate(numbers):
            alone = replace(draws, values=draws.values[row : row + 1])
            trial = alone.trial(self.campaign.trial, 0)
            try:
                truth = self._truth or self._plant.truth(trial.start, alone.parameters(0))
            except BadTrial as error:
                yield Outcome(number, alone.named(0), None, error.reason)
            else:
                yield from self._tried(truth, trial, [number], alone)

    def _tried(self, truth: Truth, trial: Trial, numbers: Sequence[int], draws: Draws) -> Iterator[Outcome]:
        step, engine = self.campaign.step, self.campaign.engine
        for row, trajectory in enumerate(tried(step, trial, truth, self._memory, numbers, engine)):
            yield Outcome(trajectory.seed, draws.named(row), metrics(step, trajectory))


# --- results in a file ----------------------------------------------------------------------------------------


def head(each: Campaign) -> str:
    """The first line of a file of results."""
    return json.dumps({"campaign": each.digest, "trial": each.trial.name}) + "\n"


def line(one: Outcome) -> str:
    """The line of an outcome; infinite numbers stand as Python's JSON writes them."""
    return json.dumps(one.as_dict()) + "\n"


def earlier(each: Campaign, text: str, name: str) -> dict[int, Outcome]:
    """The outcomes that the whole lines of a file of results hold, by number.

    Raises: `BadCampaign` for the file, called `name`, of another campaign, or with a damaged line.
    """
    lines = text.splitlines(keepends=True)
    if not lines:
        return {}
    if lines[0] != head(each):
        raise BadCampaign(name, "holds the results of another campaign, or none; give another folder, or remove it")
    outcomes = [_read(one, f"{name}, line {k}") for k, one in enumerate(lines[1:], 2)]
    return {one.run: one for one in outcomes}


def _read(text: str, place: str) -> Outcome:
    try:
        return outcome(json.loads(text))
    except (ValueError, TypeError, KeyError):
        reason = "holds no outcome of a run: it was damaged; remove this line, and its run is repeated"
        raise BadCampaign(place, reason) from None


# --- what it says ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Spread:
    """A quantity over the runs: its 5 %, 50 % and 95 % quantiles, the worst and the run that had it; None, which counts
    as the worst, for what never happened."""

    name: str
    low: float | None
    middle: float | None
    high: float | None
    worst: float | None
    run: int


def spreads(outcomes: Iterable[Outcome], unit: str = "s") -> list[Spread]:
    """Times to settle after each event, steady errors by state, and the largest theta where it moves, over the runs
    that were integrated; `unit`: that of the plant's time."""
    each = sorted((one for one in outcomes if one.metrics), key=lambda one: one.run)
    if not each:
        return []
    numbers = [one.run for one in each]
    known: list[Metrics] = [one.metrics for one in each if one.metrics]
    listed: dict[str, list[float | None]] = {}
    for k, event in enumerate(known[0].responses):
        listed[f"settled after {event.time:g} {unit}"] = [one.responses[k].settled for one in known]
    listed |= {f"steady error of {state}": [one.rms[state] for one in known] for state in known[0].rms}
    if known[0].responses[0].peak is not None:
        listed["peak of theta"] = [max(r.peak or 0.0 for r in one.responses) for one in known]
    return [_spread_of(name, values, numbers) for name, values in listed.items()]


def _spread_of(name: str, values: Sequence[float | None], numbers: Sequence[int]) -> Spread:
    """The quantiles of what happened in some order of lateness; "inverted_cdf" gives a value that some run had."""
    array = np.array([np.inf if value is None or np.isnan(value) else value for value in values])
    quantiles = np.quantile(array, (0.05, 0.5, 0.95), method="inverted_cdf")
    worst = int(np.argmax(array))
    low, middle, high, most = (float(value) if np.isfinite(value) else None for value in (*quantiles, array[worst]))
    return Spread(name, low, middle, high, most, numbers[worst])
