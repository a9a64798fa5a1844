"""A campaign: one step on one trial, many times, each with noise, first states and parameters of its own.

Run k has the noise of seed k and draw k of the Latin hypercube of all runs (`trials/varied.py`): its numbers are the
same whoever computes it, and after whatever was computed before. Runs go out in batches (`trials/spread.py`); what
comes back are numbers only. Runs that share their inputs are taken by the compiled step at once, which gives of each,
byte for byte, what `trial.tried` gives.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import chain
from typing import Any

import numpy as np
import sympy as sp

from hgogen import targets
from hgogen.call import CallableStep
from hgogen.calling import native
from hgogen.calling.samples import Engine
from hgogen.errors import BadArgument
from hgogen.reading.door import Misfit, asks
from hgogen.reading.given import count
from hgogen.step import Step, demand_choice
from hgogen.system import System
from hgogen.trial import BadTrial, Plant, Trajectory, Trial, Truth, first_memory, records, tried
from hgogen.trials.metrics import Metrics, metrics
from hgogen.trials.spread import Workers
from hgogen.trials.varied import Draws, hypercube, varied

MOST = 10_000_000  # runs
MANY = 64  # runs: fewer are integrated sooner than it takes to compile what does
BATCH, ALONE = 64, 8  # runs that go out together; where each has a truth of its own
WORTH = 5_000_000  # samples of a step from which on it takes less time than to compile what takes them together
HELD = 1 << 20  # numbers of measurements of runs that differ by more than their seeds


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

        Raises: `BadGain` for a number that is none; `BadTrial` of a trial that does not fit its plant; `NoScheduler`
        where none answers; `NotInstalled` without the package of a cluster.
        """
        last = len(self.draws) - 1
        wanted = range(last + 1) if numbers is None else [count("run", number, 0, last) for number in numbers]
        return _outcomes(self, wanted, jobs, scheduler)

    def drawn(self, numbers: Sequence[int]) -> Draws:
        """The draws of runs."""
        return replace(self.draws, values=self.draws.values[list(numbers)])


@asks(Step, "a step, as hg.sample makes it")
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
    # meets what does not fit, and compiles once for all
    ready = Ready(replace(each, draws=each.drawn(())), len(each.draws))
    size = ALONE if each.draws.moves else BATCH
    batches = (numbers[first : first + size] for first in range(0, len(numbers), size))
    pieces = ((batch, each.drawn(batch)) for batch in batches)
    for outcomes in Workers(ready, jobs, scheduler).results(Ready.outcomes, pieces):
        yield from outcomes


class Ready:
    """A campaign with what its runs share: the plant's equations, the step's first memory, and where nothing moves the
    plant from run to run, its truth.

    `runs`: how many there are, few of which are not worth what is compiled for many.

    Raises: `BadTrial` of a trial that does not fit its plant.
    """

    def __init__(self, campaign: Campaign, runs: int) -> None:
        self.campaign, self.runs = campaign, runs
        many = runs >= MANY
        step, trial, moves = campaign.step, campaign.trial, campaign.draws.moves
        free = campaign.draws.free(campaign.plant)
        self._plant = Plant(campaign.plant, trial, step.dt, free, many and moves)
        self._memory = first_memory(step, trial)
        self._truth = None if moves else self._plant.truth(trial.start)
        if many and moves:
            with suppress(BadTrial):
                self._plant.truth(trial.start, [float(campaign.plant.nominal[p]) for p in free])
        compiled, samples = campaign.engine == "c", len(self._plant.times)
        held = (ALONE if moves else BATCH if campaign.draws.varied else 1) * samples * len(campaign.plant.outputs)
        self._together = compiled and runs * samples >= WORTH and held <= HELD
        if compiled:
            run = step.run_many if self._together else step.run
            run(np.zeros((0, len(step.inputs))), np.zeros((0, len(step.samples))), engine="c")

    def __reduce__(self) -> tuple[Any, ...]:
        """The campaign, which makes it again: a pickle holds no graphs."""
        return Ready, (self.campaign, self.runs)

    def outcomes(self, piece: tuple[Sequence[int], Draws]) -> list[Outcome]:
        """The outcomes of runs, of each its draw; those that differ by their seeds alone have their noise made
        together."""
        numbers, draws = piece
        if not draws.varied and self._truth is not None:
            return list(self._tried(self._truth, self.campaign.trial, numbers, draws))
        step, later, made = self.campaign.step, list[Ahead](), dict[int, Outcome]()
        named = {number: replace(draws, values=draws.values[row : row + 1]) for row, number in enumerate(numbers)}
        for number, alone in named.items():
            trial = alone.trial(self.campaign.trial, 0)
            try:
                truth = self._truth or self._plant.truth(trial.start, alone.parameters(0))
            except BadTrial as error:
                made[number] = Outcome(number, alone.named(0), None, error.reason)
                continue
            if self._together:
                later += next(ahead(step, trial, truth, [number]))
            else:
                made |= {one.run: one for one in self._tried(truth, trial, [number], alone)}
        for one in together(step, self._memory, later) if later else ():
            made[one.seed] = Outcome(one.seed, named[one.seed].named(0), metrics(step, one))
        return [made[number] for number in numbers]

    def _tried(self, truth: Truth, trial: Trial, numbers: Sequence[int], draws: Draws) -> Iterator[Outcome]:
        step = self.campaign.step
        each: Iterator[Trajectory]
        if self._together:
            runs = ahead(step, trial, truth, numbers)
            each = chain.from_iterable(together(step, self._memory, some) for some in runs)
        else:
            each = tried(step, trial, truth, self._memory, numbers, self.campaign.engine)
        for row, trajectory in enumerate(each):
            yield Outcome(trajectory.seed, draws.named(row), metrics(step, trajectory))


@dataclass(frozen=True, eq=False)
class Ahead:
    """A run before it is taken: its trial, seed and truth, the inputs u (N, m), and what is measured, y (N, p)."""

    trial: Trial
    seed: int
    truth: Truth
    u: np.ndarray
    y: np.ndarray


def ahead(step: CallableStep, trial: Trial, truth: Truth, seeds: Sequence[int]) -> Iterator[list[Ahead]]:
    """The runs of seeds, as many as are made at once."""
    for some, u, measured in records(step, trial, truth, seeds):
        yield [Ahead(trial, seed, truth, u, y) for seed, y in zip(some, measured, strict=True)]


def together(step: CallableStep, start: bytes, runs: Sequence[Ahead]) -> Iterator[Trajectory]:
    """The compiled step over runs with the same inputs, from the memory `start`."""
    step.restore(start)
    y = np.stack([step.arriving(one.y) for one in runs])
    many = step.run_many(runs[0].u, y, jobs=1, traces=True, engine="c")
    for k, one in enumerate(runs):
        x, status = (np.ascontiguousarray(array[k]) for array in (many.x, many.status))
        traces = {name: np.ascontiguousarray(values[k]) for name, values in many.traces.items()}
        yield Trajectory(one.trial, one.seed, one.truth, one.y, x, traces, status, "c")
