"""Campaigns as `simulate` and `compare` run them: many runs of each step on each trial, and what they say."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Annotated

import typer
from rich.console import RenderableType
from rich.text import Text

from hgogen.call import CallableStep
from hgogen.commands.options import Runs
from hgogen.commands.output import Bar, headed
from hgogen.commands.process import note
from hgogen.run.campaign import (
    BadCampaign,
    Campaign,
    Outcome,
    Spread,
    Tally,
    campaign,
    earlier,
    results_head,
    results_line,
)
from hgogen.run.metrics import criterion
from hgogen.run.samples import Engine
from hgogen.target import lines_of
from hgogen.trial import Trial

RUNS = 1000  # where nothing is said
NAMED = 5  # lines that are left out


@dataclass(frozen=True, eq=False)
class CampaignRow:
    """The campaign of a step on a trial, called `name`."""

    json_keys = (
        "trial=campaign.trial.name observer=name engine=campaign.engine criterion runs failed "
        "varied=campaign.draws.varied quantiles run?"
    )

    name: Annotated[str, "name of the tuning"]
    campaign: Campaign
    tally: Tally
    repeat: int | None

    @property
    def criterion(self) -> str:
        """What settled means."""
        return criterion(self.campaign.trial, self.campaign.step.time)

    @property
    def runs(self) -> int:
        """Number of runs."""
        return len(self.campaign.draws)

    @property
    def failed(self) -> int:
        """Number of runs without a truth."""
        return self.tally.failed

    @property
    def quantiles(self) -> list[Spread]:
        """The quantities over the runs."""
        return self.tally.spreads()

    @property
    def run(self) -> Outcome | None:
        """The run of --repeat."""
        return None if self.repeat is None else self.tally.last

    def notes(self) -> Iterator[str]:
        """What is wrong with runs."""
        if self.tally.failure:
            share = f"{self.tally.failed} of {len(self.tally)} runs without a truth"
            first = f"of run {self.tally.failure.run} {self.tally.failure.failed}"
            yield f"{self.name}, trial {self.campaign.trial.name}: {share}; {first}"

    def tables(self) -> Iterator[RenderableType]:
        """A row for each quantity, or the numbers of one run."""
        every, run = self.repeat is None, self.run
        which = f"{len(self.tally)} runs" if every else f"run {self.repeat}"
        columns = ("5 %", "50 %", "95 %", "worst", "of run") if every else ("",)
        title = f"{self.name}, trial {self.campaign.trial.name}, {which}"
        table = headed(title, "", *columns, numbers=len(columns))
        for spread in self.quantiles:
            values = (spread.low, spread.middle, spread.high, spread.worst)
            numbers = ["never" if value is None else f"{value:.3g}" for value in values]
            table.add_row(Text(spread.name), *([*numbers, str(spread.run)] if every else numbers[:1]))
        yield table
        drawn = [f"{each.name} in {each.low:g} .. {each.high:g}" for each in self.campaign.draws.varied]
        yield Text(f"settled: {self.criterion}; varied: {', '.join(drawn) or 'noise seeds alone'}")
        if run is None:
            yield Text("the same options and --repeat K run number K alone, and say what was drawn for it\n")
            return
        varied = "".join(f", {key} = {value:.6g}" for key, value in run.varied.items())
        yield Text(f"run {self.repeat}: noise of seed {self.repeat}{varied}\n")


def campaigns(
    steps: Callable[[Trial], Mapping[str, CallableStep]],
    trials: Iterable[Trial],
    engine: Engine,
    asked: Runs,
    seeds: int | None,
) -> tuple[CampaignRow, ...]:
    """The campaign of each step, by name, on each trial.

    Raises: `BadParameter` for options that exclude each other; as `trials.campaign` does.
    """
    if seeds is not None:
        raise typer.BadParameter("run k of a campaign has the noise of seed k; give --runs", param_hint="--seeds")
    each = [
        (name, campaign(step, trial, RUNS if asked.runs is None else asked.runs, asked.vary, asked.draw or 0, engine))
        for trial in trials
        for name, step in steps(trial).items()
    ]
    if asked.repeat is not None and asked.repeat >= min(len(one.draws) for _, one in each):
        raise typer.BadParameter(f"the runs are numbered from 0 to {len(each[0][1].draws) - 1}", param_hint="--repeat")
    with Bar("runs", sum(len(one.draws) if asked.repeat is None else 1 for _, one in each)) as bar:
        rows = tuple(CampaignRow(name, one, _tallied(name, one, asked, bar), asked.repeat) for name, one in each)
    note(*(sentence for row in rows for sentence in row.notes()))
    if all(row.tally.failed == len(row.tally) for row in rows):
        raise BadCampaign("vary", "leaves no run whose plant can be integrated; vary less, or shorten the trial")
    return rows


def _tallied(name: str, one: Campaign, asked: Runs, bar: Bar) -> Tally:
    """What all runs, or the one that is asked for, say; each goes into the folder of results as it comes."""
    tally, first = Tally(len(one.draws), one.step.time), asked.repeat or 0
    wanted = range(first, len(one.draws) if asked.repeat is None else first + 1)
    with _results(name, one, asked.results) as (known, add):
        for outcome in known:
            if outcome.run in wanted:
                tally.add(outcome)
        bar.advance_by(len(tally))
        left = [number for number in wanted if number not in tally]
        for outcome in one.run(left, asked.jobs if len(left) > 1 else 1, asked.scheduler) if left else ():
            tally.add(outcome)
            add(results_line(outcome))
            bar.tick()
    return tally


@contextmanager
def _results(
    name: str, one: Campaign, folder: Path | None
) -> Iterator[tuple[Iterable[Outcome], Callable[[str], None]]]:
    """The outcomes that a folder of results holds, and what adds the line of another."""
    if folder is None:
        yield (), lambda line: None
        return
    file = f"{one.trial.name}_{name}.jsonl"
    with lines_of(file, folder) as (lines, add):
        first = next(lines, None)
        if first is None:
            add(results_head(one))
        yield _valid(one, lines if first is None else chain([first], lines), str(folder / file)), add


def _valid(one: Campaign, lines: Iterable[str], file: str) -> Iterator[Outcome]:
    """The outcomes of the lines of a file; says which lines are left out."""
    dropped = list[int]()
    for number, outcome in enumerate(earlier(one, lines, file), 2):
        if outcome is None:
            dropped.append(number)
        else:
            yield outcome
    if dropped:
        listed = ", ".join(map(str, dropped[:NAMED])) + (", .." if len(dropped) > NAMED else "")
        note(f"{file}: {len(dropped)} lines ({listed}) hold no outcome of this campaign: left out, their runs repeated")
