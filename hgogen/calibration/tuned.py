"""What tuning gives: for each observer the gains that predict best, what they are worth, and which to take."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hgogen.calibration.likelihood import Likelihood, Noise
from hgogen.calibration.score import as_good
from hgogen.emit.cost import cost
from hgogen.identification.records import Log
from hgogen.modelfiles.first import First
from hgogen.starting import Scale
from hgogen.theorem import Convergence

Array = np.ndarray


@dataclass(frozen=True)
class Tuned:
    """The gains of an observer that predict best.

    `name`: the observer's, or "adaptive" of a riccati whose theta adapts; `first`: observer, form and step; `numbers`:
    the scale from which its rule made them; `noise`: the maximum of the `likelihood` that holds Q and R, None where the
    rule does not read both; `sampling`: `method`, `between` and, in float,
    `real`, as a tuning names them; `errors`: by segment,
    cross-validated, as in `calibration/score.py`; `tried`: the scales tried, with their errors over all segments.
    """

    name: str
    first: First
    numbers: Scale
    noise: Noise | None
    likelihood: Likelihood | None = field(repr=False)
    sampling: Mapping[str, str]
    errors: Array
    tried: tuple[tuple[Scale, float], ...] = field(repr=False)

    @property
    def error(self) -> float:
        """RMS of the errors, cross-validated, over that of copying the last value, or of the mean of a truth."""
        return float(np.sqrt(self.errors.mean()))

    @property
    def table(self) -> Mapping[str, Any]:
        """The tuning that makes the same step."""
        return {**self.first.table(self.name), **self.sampling}

    def innovations(self, records: Iterable[tuple[Log, int]]) -> dict[str, Array]:
        """Innovations over their deviations, e/sqrt(s), by output, in rows of records from a number on; empty without
        noise."""
        if self.noise is None or self.likelihood is None:
            return {}
        scaled = []
        for record, cut in records:
            e, s = self.likelihood.innovations(self.noise, record.of(self.likelihood.form.system.inputs))
            scaled.append((e / np.sqrt(s))[max(0, cut - 1) :])
        columns = (column[np.isfinite(column)] for column in np.concatenate(scaled).T)
        return {y: there for y, there in zip(self.noise.sample, columns, strict=True) if len(there)}

    @property
    def rank(self) -> tuple[int, bool, int]:
        """Of those that predict as well: with a proof, with known noise, cheap; the least is taken."""
        return _RANK[self.first.known], self.noise is None, cost(self.first.step).operations


@dataclass(frozen=True)
class Calibration:
    """`rows`: of each observer, the best first; `refused`: why there is none, by observer; `ahead`: samples, and
    `segments` of each record, by which they were chosen, or by the `truth` of these states."""

    rows: tuple[Tuned, ...]
    refused: Mapping[str, str]
    ahead: int
    segments: int
    truth: tuple[str, ...] = ()

    @property
    def tied(self) -> tuple[Tuned, ...]:
        """The rows that predict as well as the best."""
        return tuple(row for row in self.rows if as_good(row.errors, self.rows[0].errors))

    @property
    def best(self) -> Tuned:
        """The row to take: of these the one of the least rank."""
        return min(self.tied, key=lambda row: row.rank)

    def __getitem__(self, name: str) -> Tuned:
        return next(row for row in self.rows if row.name == name)


_RANK = {Convergence.PROVED: 0, Convergence.ABOVE: 0, Convergence.BELOW: 1, Convergence.UNKNOWN: 1, None: 2}
