"""What the runs of a campaign say together: quantiles of their numbers, of which some bytes a run are remembered."""

from array import array
from dataclasses import dataclass

import numpy as np

from hgogen.trials.campaign import Outcome


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
