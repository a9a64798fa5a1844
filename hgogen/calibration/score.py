"""How well a step predicts records, segment by segment.

    c_j^2 = mean over all records of (y_j(k+h) - y_j(k))^2
    E_s = mean over outputs j of the mean over segment s of (e_j(k+h|k)/c_j)^2

so that copying the last value has 1. An output that stands still in a record has no c_j and does not count there, nor
does a segment in which nothing can be compared. A gain is chosen on the segments but one, and judged by that one; what
is said of it is the root of the mean of these judgements (cross-validation).
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from hgogen.call import CallableStep
from hgogen.calling.samples import Engine, held_last
from hgogen.identification.records import Log
from hgogen.trials.prediction import forecasts

Array = np.ndarray
Key = TypeVar("Key", bound=Hashable)
ALIKE = 2e-3  # of E: a thousandth of an error, as two filters that differ by rounding have
BEGIN = 0.05  # of a record, in which an estimate may find its way


@dataclass(frozen=True)
class Judge:
    """What steps are judged by: `records`, `ahead` samples, in so many `segments` a record of mean length, run by
    `engine`."""

    records: Sequence[Log]
    ahead: int
    segments: int
    engine: Engine

    def errors(self, step: CallableStep) -> Array:
        """E_s (segments of all records in which something can be compared), infinite where the estimate is lost."""
        with np.errstate(all="ignore"):
            parts = zip(self.records, self._scales, self._parts, strict=True)
            return np.concatenate([self._of(step, *each) for each in parts])

    @property
    def count(self) -> int:
        """How many segments have an error."""
        return sum(map(len, self._parts))

    @cached_property
    def _moves(self) -> list[Array]:
        """(y_j(k+h) - y_j(k))^2 at each sample of the records that has a last value, else NaN; (N, p)."""
        h, moves = self.ahead, []
        for record in self.records:
            squares = np.full(record.y.shape, np.nan)
            squares[h:] = (record.y[h:] - held_last(record.y)[: len(record.y[h:])]) ** 2
            moves.append(squares)
        return moves

    @cached_property
    def _scales(self) -> list[Array]:
        """c_j^2 (p) of all records, for each record NaN of an output that stands still there or is never compared."""
        whole = np.array([_mean(column) for column in np.concatenate(self._moves).T])
        moving = [np.array([_mean(column) > 0 for column in squares.T]) for squares in self._moves]
        return [np.where(moves, whole, np.nan) for moves in moving]

    @cached_property
    def _parts(self) -> list[list[Array]]:
        """Of each record the samples of its segments, of those in which something can be compared; a record has as
        many as its length is of the mean one's, and one at least."""
        every, mean = [], sum(map(len, self._moves)) / len(self._moves)
        for squares, scale in zip(self._moves, self._scales, strict=True):
            there = np.isfinite(squares / scale).any(axis=1)
            count = max(1, round(self.segments * len(squares) / mean))
            parts = np.array_split(np.arange(round(BEGIN * len(squares)), len(squares)), count)
            every.append([part for part in parts if there[part].any()])
        return every

    def _of(self, step: CallableStep, record: Log, scale: Array, parts: Sequence[Array]) -> Array:
        step.reset()
        run = step.run(u=record.u, y=record.y, engine=self.engine)
        errors = next(forecasts(step, run, record.u, record.y, (self.ahead,)))
        squares = np.where(errors.compared, errors.model, np.nan) ** 2
        if not np.isfinite(run.x).all() or not np.isfinite(squares[errors.compared]).all():
            return np.full(len(parts), np.inf)
        means = [[_mean(column) for column in (squares / scale)[part].T] for part in parts]
        each = np.array([_mean(np.array(outputs)) for outputs in means])
        return np.where(np.isnan(each), np.inf, each)


def _mean(values: Array) -> float:
    """Of what is finite, NaN where nothing is."""
    there = values[np.isfinite(values)]
    return float(there.mean()) if len(there) else np.nan


def chosen(errors: Mapping[Key, Array]) -> tuple[Key, Array]:
    """Of candidates the one with the least errors over all segments; and of each segment the error there of the one
    that is chosen on the others."""
    keys, table = list(errors), np.array(list(errors.values()))
    segments = range(table.shape[1])
    judged = [table[int(np.argmin(np.delete(table, s, axis=1).sum(axis=1))), s] for s in segments]
    return keys[int(np.argmin(table.sum(axis=1)))], np.array(judged)


def as_good(errors: Array, best: Array) -> bool:
    """Whether errors by segment are above the best by no more than one standard error (the rule of Breiman, Friedman,
    Olshen, Stone, Classification and Regression Trees, 1984), that of their difference or that of the best, whichever
    is less: errors that scatter widely are no reason to prefer them. Errors that differ by rounding are as good."""
    difference = errors - best
    scatter = min(difference.std(ddof=1), best.std(ddof=1)) / np.sqrt(len(difference))
    return bool(difference.mean() <= max(scatter, ALIKE * best.mean()))
