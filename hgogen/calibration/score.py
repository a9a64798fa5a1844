"""How well a step predicts records, segment by segment.

    c_j^2 = mean of (y_j(k+h) - y_j(k))^2,   E_s = mean over outputs j of mean over segment s of (e_j(k+h|k)/c_j)^2

so that copying the last value has 1. A gain is chosen on the segments but one, and judged by that one; what is said of
it is the root of the mean of these judgements (cross-validation).
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from hgogen.call import CallableStep
from hgogen.calling.samples import Engine
from hgogen.identification.records import Log
from hgogen.trials.prediction import forecasts

Array = np.ndarray
Key = TypeVar("Key", bound=Hashable)
BEGIN = 0.05  # of a record, in which an estimate may find its way


@dataclass(frozen=True)
class Judge:
    """What steps are judged by: `records`, `ahead` samples, in so many `segments`, run by `engine`."""

    records: Sequence[Log]
    ahead: int
    segments: int
    engine: Engine

    def errors(self, step: CallableStep) -> Array:
        """E_s (segments of all records), infinite where the estimate is lost."""
        with np.errstate(all="ignore"):
            return np.concatenate([self._of(step, record) for record in self.records])

    def _of(self, step: CallableStep, record: Log) -> Array:
        step.reset()
        run = step.run(u=record.u, y=record.y, engine=self.engine)
        errors = next(forecasts(step, run, record.u, record.y, (self.ahead,)))
        assert errors.copying is not None
        squares = np.where(errors.compared, errors.model, np.nan) ** 2
        copied = np.nanmean(np.where(errors.compared, errors.copying, np.nan) ** 2, axis=0)
        shares = squares / np.where(copied > 0, copied, 1.0)
        parts = np.array_split(shares[round(BEGIN * len(shares)) :], self.segments)
        means = np.array(
            [[np.nanmean(column) if np.isfinite(column).any() else 0.0 for column in part.T] for part in parts]
        )
        lost = ~np.isfinite(run.x).all() or np.isinf(squares).any()
        return np.full(len(parts), np.inf) if lost else means.mean(axis=1)


def _mean(values: Array) -> float:
    """Of what was compared, 0 where nothing was."""
    there = values[np.isfinite(values)]
    return float(there.mean()) if len(there) else 0.0


def chosen(errors: Mapping[Key, Array]) -> tuple[Key, Array]:
    """Of candidates the one with the least errors over all segments; and of each segment the error there of the one
    that is chosen on the others."""
    keys, table = list(errors), np.array(list(errors.values()))
    segments = range(table.shape[1])
    judged = [table[int(np.argmin(np.delete(table, s, axis=1).sum(axis=1))), s] for s in segments]
    return keys[int(np.argmin(table.sum(axis=1)))], np.array(judged)


def as_good(errors: Array, best: Array) -> bool:
    """Whether errors by segment are above others by no more than the standard error of their difference (the rule of
    one standard error: Breiman, Friedman, Olshen, Stone, Classification and Regression Trees, 1984)."""
    difference = errors - best
    return bool(difference.mean() <= difference.std(ddof=1) / np.sqrt(len(difference)))
