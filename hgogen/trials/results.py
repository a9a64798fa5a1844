"""The results of a campaign in a file: a head that names the campaign, then a line of JSON for each run as it comes.

Anything may have happened to the file since. A line counts only where it can be one of this campaign: its run has the
values that were drawn for it, and its metrics are those of this trial and of these states.
"""

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict
from typing import Any

from hgogen.trials.campaign import MOST, BadCampaign, Campaign, Outcome
from hgogen.trials.metrics import Metrics, Response


def head(each: Campaign) -> str:
    """The first line of a file of results."""
    return json.dumps({"campaign": each.digest, "trial": each.trial.name}) + "\n"


def line(one: Outcome) -> str:
    """The line of an outcome; infinite numbers stand as Python's JSON writes them."""
    return json.dumps(asdict(one)) + "\n"


def earlier(each: Campaign, lines: Iterable[str], name: str) -> Iterator[Outcome | None]:
    """The outcome of each line behind the head, None for one that holds no outcome of this campaign.

    Raises: `BadCampaign` for the file, called `name`, of another campaign.
    """
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
        and all(_is_number(value, 0, math.inf) or _is_nan(value) for value in made.rms.values())
        and _is_count(made.clamped, samples)
    )


def _is_response(one: Response, longest: float, samples: int) -> bool:
    times = all(value is None or _is_number(value, 0, longest) for value in (one.settled, one.calm))
    peak = one.peak is None or _is_number(one.peak, -math.inf, math.inf) or _is_nan(one.peak)
    share = one.loud is None or _is_number(one.loud, 0, 1)
    return times and peak and share and (one.triggers is None or _is_count(one.triggers, samples))


def _is_count(value: Any, most: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most


def _is_number(value: Any, low: float, high: float) -> bool:
    return isinstance(value, float) and low <= value <= high


def _is_nan(value: Any) -> bool:
    return isinstance(value, float) and math.isnan(value)
