"""A campaign: one step on one trial, many times, each with noise, first states and parameters of its own.

Run k has the noise of seed k and draw k of the Latin hypercube of all runs (`trials/varied.py`): its numbers are the
same whoever computes it, and after whatever was computed before. Runs go out in batches (`trials/spread.py`); what
comes back are numbers only.
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
from hgogen.trial import BadTrial, Plant, Trajectory, Trial, Truth, first_memory, tried
from hgogen.trials.metrics import Metrics, metrics
from hgogen.trials.spread import Workers
from hgogen.trials.together import HELD, WORTH, Ahead, ahead, together
from hgogen.trials.varied import Draws, hypercube, varied

MOST = 10_000_000  # runs
MANY = 64  # runs: fewer are integrated sooner than it takes to compile what does
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
    for outcomes in Workers(ready, jobs, scheduler).results(_worked, pieces):
        yield from outcomes


def _worked(ready: "Ready", piece: tuple[Sequence[int], Draws]) -> list[Outcome]:
    return list(ready.outcomes(*piece))


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

    def outcomes(self, numbers: Sequence[int], draws: Draws) -> Iterator[Outcome]:
        """The outcomes of runs, of each its draw; those that differ by their seeds alone have their noise made
        together."""
        if not draws.varied and self._truth is not None:
            yield from self._tried(self._truth, self.campaign.trial, numbers, draws)
            return
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
        yield from (made[number] for number in numbers)

    def _tried(self, truth: Truth, trial: Trial, numbers: Sequence[int], draws: Draws) -> Iterator[Outcome]:
        for row, trajectory in enumerate(self._trajectories(truth, trial, numbers)):
            yield Outcome(trajectory.seed, draws.named(row), metrics(self.campaign.step, trajectory))

    def _trajectories(self, truth: Truth, trial: Trial, numbers: Sequence[int]) -> Iterator[Trajectory]:
        step = self.campaign.step
        if not self._together:
            return tried(step, trial, truth, self._memory, numbers, self.campaign.engine)
        return chain.from_iterable(together(step, self._memory, runs) for runs in ahead(step, trial, truth, numbers))
