"""Campaigns as `simulate` and `compare` run them: many runs of each step on each trial, and what they say."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import typer
from rich.console import RenderableType
from rich.text import Text

from hgogen.call import CallableStep
from hgogen.calling.samples import Engine
from hgogen.commands import tables
from hgogen.commands.command import Bar, Runs
from hgogen.commands.process import note
from hgogen.target import lines_of
from hgogen.trial import Trial
from hgogen.trials.campaign import BadCampaign, Campaign, Outcome, campaign, earlier, head, line, spreads
from hgogen.trials.metrics import criterion

RUNS = 1000  # where nothing is said


def campaigns(
    steps: Callable[[Trial], Mapping[str, CallableStep]],
    trials: Iterable[Trial],
    engine: Engine,
    asked: Runs,
    seeds: int | None,
) -> tuple[list[dict[str, Any]], list[RenderableType]]:
    """The campaign of each step, by name, on each trial: for JSON, and as tables.

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
    numbers = None if asked.repeat is None else [asked.repeat]
    count = sum(len(one.draws) if numbers is None else 1 for _, one in each)
    with Bar("runs", count) as bar:
        done = [(name, one, _outcomes(name, one, asked, numbers, bar)) for name, one in each]
    rows = [_row(*one) for one in done]
    if numbers is not None:
        rows = [{**row, "run": outcomes[0].as_dict()} for row, (*_, outcomes) in zip(rows, done, strict=True)]
    for (name, one, outcomes), row in zip(done, rows, strict=True):
        if row["failed"]:
            first = next(outcome for outcome in outcomes if outcome.failed)
            share = f"{row['failed']} of {len(outcomes)} runs without a truth"
            note(f"{name}, trial {one.trial.name}: {share}; of run {first.run} {first.failed}")
    if all(row["failed"] == len(outcomes) for row, (*_, outcomes) in zip(rows, done, strict=True)):
        raise BadCampaign("vary", "leaves no run whose plant can be integrated; vary less, or shorten the trial")
    return rows, [part for one in done for part in _shown(*one, asked)]


def _outcomes(name: str, one: Campaign, asked: Runs, numbers: list[int] | None, bar: Bar) -> list[Outcome]:
    """The outcomes of all runs, or of some, in their order; each goes into the folder of results as it comes."""
    with _results(name, one, asked.results) as (known, add):
        wanted = range(len(one.draws)) if numbers is None else numbers
        outcomes = {number: known[number] for number in wanted if number in known}
        bar.advance_by(len(outcomes))
        left = [number for number in wanted if number not in outcomes]
        for outcome in one.run(left, asked.jobs if len(left) > 1 else 1, asked.scheduler) if left else ():
            outcomes[outcome.run] = outcome
            add(line(outcome))
            bar.tick()
    return [outcomes[number] for number in wanted]


@contextmanager
def _results(
    name: str, one: Campaign, folder: Path | None
) -> Iterator[tuple[Mapping[int, Outcome], Callable[[str], None]]]:
    """The outcomes that a folder of results holds, and what adds the line of another."""
    if folder is None:
        yield {}, lambda line: None
        return
    file = f"{one.trial.name}_{name}.jsonl"
    with lines_of(file, folder) as (text, add):
        known = earlier(one, text, str(folder / file))
        if not text:
            add(head(one))
        yield known, add


def _row(name: str, one: Campaign, outcomes: list[Outcome]) -> dict[str, Any]:
    return {
        "trial": one.trial.name,
        "observer": name,
        "engine": one.engine,
        "criterion": criterion(one.trial, one.step.time),
        "runs": len(one.draws),
        "failed": sum(outcome.metrics is None for outcome in outcomes),
        "varied": [asdict(varied) for varied in one.draws.varied],
        "quantiles": [asdict(spread) for spread in spreads(outcomes, one.step.time)],
    }


def _shown(name: str, one: Campaign, outcomes: list[Outcome], asked: Runs) -> Iterator[RenderableType]:
    every = asked.repeat is None
    title = f"{name}, trial {one.trial.name}, {f'{len(outcomes)} runs' if every else f'run {asked.repeat}'}"
    columns = ("5 %", "50 %", "95 %", "worst", "of run") if every else ("",)
    table = tables.headed(title, "", *columns, numbers=len(columns))
    for spread in spreads(outcomes, one.step.time):
        numbers = list(map(_number, (spread.low, spread.middle, spread.high, spread.worst)))
        table.add_row(Text(spread.name), *([*numbers, str(spread.run)] if every else numbers[:1]))
    yield table
    drawn = [f"{each.name} in {each.low:g} .. {each.high:g}" for each in one.draws.varied]
    yield Text(f"settled: {criterion(one.trial, one.step.time)}; varied: {', '.join(drawn) or 'noise seeds alone'}")
    if every:
        yield Text("the same options and --repeat K run number K alone, and say what was drawn for it\n")
        return
    values = "".join(f", {key} = {value:.6g}" for key, value in outcomes[0].varied.items())
    yield Text(f"run {asked.repeat}: noise of seed {asked.repeat}{values}\n")


def _number(value: float | None) -> str:
    return "never" if value is None else f"{value:.3g}"
