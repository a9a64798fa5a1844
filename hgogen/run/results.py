"""The results of a campaign in a file: a head that names the campaign, then a line of JSON for each run as it comes.

Anything may have happened to the file since. A line counts only where it can be one of this campaign: its run has the
values that were drawn for it, and its metrics are those of this trial and of these states. What the runs say together
are quantiles of their numbers, of which some bytes a run are remembered.
"""

import json
import math
from array import array
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, Any

import numpy as np

from hgogen.run.campaign import MOST, BadCampaign, Campaign, Outcome
from hgogen.run.metrics import Metrics, Response


def head(each: Campaign) -> str:
    """The first line of a file of results."""
    return json.dumps({"campaign": each.digest, "trial": each.trial.name}) + "\n"


def line(one: Outcome) -> str:
    """The line of an outcome; infinite numbers stand as Python's JSON writes them."""
    return json.dumps(asdict(one)) + "\n"


def earlier(each: Campaign, lines: Iterable[str], name: str) -> Iterator[Outcome | None]:
    """The outcome of each line behind the head, None for one that holds no outcome of this campaign. Raises:
    `BadCampaign` for the file, called `name`, of another campaign."""
    for number, one in enumerate(lines):
        if number:
            yield outcome(each, one)
        elif one != head(each):
            raise BadCampaign(name, "holds the results of another campaign, or none; give another folder, or remove it")


def outcome(each: Campaign, text: str) -> Outcome | None:
    """The outcome of a campaign that a line holds; None where it holds none."""
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
    else:  # of noise alone there may be more runs than are asked for now
        drawn = _is_count(one.run, MOST - 1) and one.varied == {}
    return one if drawn and (failed or _was_measured(each, one)) else None


def _was_measured(each: Campaign, one: Outcome) -> bool:
    """Whether metrics have the events of the trial, the states of the step, and values that they can have: the error
    of an estimate that escaped is infinite, or NaN."""
    trial, made = each.trial, one.metrics
    if made is None or one.failed != "" or made.seed != one.run or made.engine not in ("c", "python"):
        return False
    samples = round(trial.duration / each.step.dt) + 1
    longest = samples * each.step.dt
    return (
        [response.time for response in made.responses] == list(trial.events)
        and all(_is_response(response, longest, samples) for response in made.responses)
        and isinstance(made.rms, Mapping)
        and list(made.rms) == [state.name for state in each.step.states]
        and all(_is_number(value, 0, math.inf, nan=True) for value in made.rms.values())
        and _is_count(made.clamped, samples)
    )


def _is_response(one: Response, longest: float, samples: int) -> bool:
    times = all(value is None or _is_number(value, 0, longest) for value in (one.settled, one.calm))
    peak = one.peak is None or _is_number(one.peak, -math.inf, math.inf, nan=True)
    share = one.loud is None or _is_number(one.loud, 0, 1)
    return times and peak and share and (one.triggers is None or _is_count(one.triggers, samples))


def _is_count(value: Any, most: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most


def _is_number(value: Any, low: float, high: float, nan: bool = False) -> bool:
    return isinstance(value, float) and (low <= value <= high or (nan and math.isnan(value)))


@dataclass(frozen=True)
class Spread:
    """A quantity over the runs; None, which counts as the worst, for what never happened."""

    name: Annotated[str, "the quantity"]
    low: Annotated[float | None, "5 % quantile; null: never"]
    middle: Annotated[float | None, "median; null: never"]
    high: Annotated[float | None, "95 % quantile; null: never"]
    worst: Annotated[float | None, "the worst; null: never"]
    run: Annotated[int, "the run that had the worst"]


class Tally:
    """The numbers of so many runs, told one after the other, each once: times to settle after each event, steady errors
    by state, and the largest theta where it moves; `unit`: that of the plant's time.

    `failed`: runs without a truth, of which `failure` is the first; `last`: the outcome that was told last.
    """

    def __init__(self, runs: int, unit: str = "s") -> None:
        self.failed = 0
        self.failure: Outcome | None = None
        self.last: Outcome | None = None
        self._unit, self._seen, self._names = unit, bytearray(runs), list[str]()
        self._runs, self._numbers = array("q"), array("d")

    def __len__(self) -> int:
        return len(self._runs) + self.failed

    def __contains__(self, run: int) -> bool:
        return bool(self._seen[run])

    def add(self, one: Outcome) -> None:
        """Tell an outcome."""
        if one.run in self:
            return
        self._seen[one.run], self.last = 1, one
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
        """Over the runs that were integrated."""
        runs = np.frombuffer(self._runs, dtype=np.int64)
        order, table = np.argsort(runs), np.frombuffer(self._numbers).reshape(len(runs), len(self._names))
        columns = zip(self._names, table.T, strict=True)
        return [_spread_of(name, column[order], runs[order]) for name, column in columns] if len(runs) else []


def _spread_of(name: str, values: np.ndarray, runs: np.ndarray) -> Spread:
    """The quantiles of what happened in some order of lateness, infinity for never; "inverted_cdf" gives a value that
    some run had."""
    quantiles = np.quantile(values, (0.05, 0.5, 0.95), method="inverted_cdf")
    worst = int(np.argmax(values))
    low, middle, high, most = (float(value) if np.isfinite(value) else None for value in (*quantiles, values[worst]))
    return Spread(name, low, middle, high, most, int(runs[worst]))
