"""The step lengths of the shipped models' observers: what is refused, what is advised, and what the trial makes of it.

    python tests/step_lengths.py [MODEL ..]        prints the table, of all models in some minutes

A pair of a model's trial and a tuning counts where the trial, without noise and from the trial's estimate, settles at
the tuning's own period. `longest`: the longest step that is admitted and settles, as all tried between it and `take`,
by bisection; a hold of the trial's criterion shorter than two steps tells nothing, so no step is longer than half of
it.
"""

import math
import sys
import warnings
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import hgogen as hg
from hgogen.errors import HgogenError
from hgogen.method import Method
from hgogen.model import Model, load
from hgogen.observer import Observer
from hgogen.run.metrics import metrics
from hgogen.step import StepMayFail, StepTooLong
from hgogen.trial import Trial, try_out

MODELS = sorted(path for path in (Path(__file__).resolve().parents[1] / "models").glob("*.[pt]*"))
SAMPLES = 3000  # from that many on compiled
MOST = 3_000_000  # samples of a trial
WIDER, BISECTIONS = 1.5, 3
LONG = 1e6  # of a tuning's own period


@dataclass(frozen=True)
class Pair:
    """A trial and the observer of a tuning, by a method."""

    model: str
    tuning: str
    trial: Trial
    observer: Observer
    method: Method
    own: float
    options: Mapping[str, Any]
    grid: float  # dt is this over a whole number; 0: any

    def __str__(self) -> str:
        return f"{self.model}, {self.tuning} by {self.method.name}, {self.trial.name}"

    def fitted(self, dt: float) -> float:
        """The longest dt up to this one that the windows and periods of the observer admit."""
        return self.grid / math.ceil(self.grid / dt * (1 - 1e-9)) if self.grid else dt

    def longer(self, dt: float) -> float:
        """The next length to try, which is admitted."""
        count = round(self.grid / dt) if self.grid else 0
        return max(self.fitted(WIDER * dt), self.grid / (count - 1) if count > 1 else 0)

    def step(self, dt: float) -> Any:
        """The step, without warnings."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StepMayFail)
            return hg.sample(self.observer, self.method, dt, **self.options)

    def settles(self, dt: float) -> bool:
        """Whether the estimate settles after the start and every jump."""
        step = self.step(dt)
        engine = "python" if self.trial.duration / dt < SAMPLES else None
        (run,) = try_out(step, self.trial, engine, [0])
        return all(response.settled is not None for response in metrics(step, run).responses)

    def lengths(self) -> tuple[float, float]:
        """(refused, take), inf where nothing is said; both from the same sentence where there is one."""
        dt = self.fitted(LONG * self.own)
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always", StepMayFail)
                hg.sample(self.observer, self.method, dt, **self.options)
        except StepTooLong as error:
            return error.limit, error.take
        admitted = (float(str(warning.message).split("take dt <= ")[1].split()[0]) for warning in caught)
        return math.inf, min(admitted, default=math.inf)


class TooMany(Exception):
    """A row whose trial at `take` has more than `MOST` samples, in words."""


@dataclass(frozen=True)
class Row:
    """What is told of a pair, and what was seen."""

    pair: Pair
    refused: float
    take: float
    settles: bool
    longest: float

    @property
    def holds(self) -> bool:
        """At `take` the trial settles, and it is at least a quarter of the longest that does."""
        return self.settles and 4 * self.take >= self.longest

    def __str__(self) -> str:
        seen = "settles" if self.settles else "FAILS"
        share = "" if self.holds or not self.settles else f"  take is {self.take / self.longest:.2f} of it"
        return (
            f"{self.pair!s:62} own {self.pair.own:8.3g}  refused {self.refused:8.3g}  take {self.take:8.3g} {seen:7}  "
            f"longest {self.longest:8.3g}{share}"
        )


def row(pair: Pair) -> Row:
    """Tried at `take`, and beyond. Raises: `TooMany`."""
    refused, take = pair.lengths()
    half = pair.trial.settled.hold / 2 if pair.trial.settled else math.inf
    top = min(refused, max(half, pair.own))
    at = pair.fitted(min(take, top))
    if pair.trial.duration / at > MOST:
        raise TooMany(f"{pair!s:62} own {pair.own:8.3g}  refused {refused:8.3g}  take {take:8.3g} not tried: too short")
    good, bad = (at, at) if pair.settles(at) else (pair.own, at)
    settles = good == at
    while good == bad < (longer := min(pair.longer(bad), pair.fitted(top))):
        good, bad = (longer if pair.settles(longer) else good), longer
    for _ in range(BISECTIONS):
        middle = pair.fitted(math.sqrt(good * bad))
        if not good < middle < bad:
            break
        good, bad = (middle, bad) if pair.settles(middle) else (good, middle)
    return Row(pair, refused, take, settles, good)


def pairs(model: Model, names: Collection[str] = ()) -> Iterator[Pair]:
    """Every tuning of a model, or those of `names`, on each of its trials, as shipped, where the trial settles."""
    for trial in model.trials():
        quiet = replace(trial, noise={})
        for name in names or model.tuning.tables:
            step = model.step(name, start=trial.first_estimate)
            options = {"between": step.clock.between}
            if len(set(step.clock.periods)) > 1:
                options["periods"] = dict(zip((y.name for y in step.outputs), step.clock.periods, strict=True))
            pair = Pair(
                model.name, name, quiet, step.observer, step.method, step.dt, options, _grid(model, name, options)
            )
            if trial.settled is not None and pair.settles(pair.own):
                yield pair


def _grid(model: Model, name: str, options: Mapping[str, Any]) -> float:
    """What dt has to divide: a bank's restart period, the window of an innovation, the shortest period."""
    gains = model.tuning.gains(name)
    if "periods" in options:
        return float(min(options["periods"].values()))
    window = gains.get("innovation") or getattr(gains.get("theta"), "innovation", None)
    if "period" in gains and "count" in gains and window is None:
        return float(gains["period"])
    return float(window.d) / getattr(window, "predictors", 1) if window else 0.0


def main(names: list[str]) -> None:
    """The table."""
    failed = 0
    for path in MODELS:
        if names and path.stem not in names:
            continue
        model = load(path)
        try:
            tunings = pairs(model) if model.trials() else ()
        except HgogenError:
            continue
        for pair in tunings:
            try:
                verdict = row(pair)
            except TooMany as error:
                print(error, flush=True)
                continue
            failed += not verdict.holds
            print(verdict, flush=True)
    print(f"{failed} rows in which take fails, or is less than a quarter of the longest")


if __name__ == "__main__":
    main(sys.argv[1:])
