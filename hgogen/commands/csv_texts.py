"""What a run over a record gives, as CSV text."""

import csv
import io
import re
from collections.abc import Sequence

import numpy as np

from hgogen.call import CallableStep
from hgogen.calling.samples import Run
from hgogen.reading.measured import Record

PIECE = 10_000  # rows at once, whose cells take some ten times as much memory as their text
_NAN = re.compile("nan")


def estimates(step: CallableStep, record: Record, run: Run) -> str:
    """The estimates as CSV text: time, what was measured, the estimated states, traces, status; empty where
    missing."""
    measured = [f"{s.name}_measured" if s.name in run.names else s.name for s in step.outputs]
    numbers = np.column_stack([record.t, record.of(step.outputs), run.x, *run.traces.values()])
    return _csv(["t", *measured, *run.names, *run.traces, "status"], numbers, run.status)


def innovations(step: CallableStep, record: Record, run: Run) -> str:
    """Innovations of the outputs and their variances as CSV text, and the lower triangle of the estimate's covariance
    by columns, P_i_j of states i and j; without variances of an observer that holds none."""
    assert run.innovations is not None  # of a step
    header, columns = ["t", *(f"e_{s.name}" for s in step.outputs)], [record.t, run.innovations]
    if run.variances is not None and run.covariance is not None:
        pairs = [(i, j) for j in range(len(run.names)) for i in range(j, len(run.names))]
        header += [f"s_{s.name}" for s in step.outputs] + [f"P_{run.names[i]}_{run.names[j]}" for i, j in pairs]
        columns += [run.variances, *(run.covariance[:, i, j] for i, j in pairs)]
    return _csv(header, np.column_stack(columns))


def _csv(header: Sequence[str], numbers: np.ndarray, status: np.ndarray | None = None) -> str:
    """Rows of numbers as CSV text, empty for NaN; a status behind each."""
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerow(header)
    cells = ",".join(["%.10g"] * numbers.shape[1])
    pattern = f"{cells},%d\n" if status is not None else f"{cells}\n"
    missing = np.isnan(numbers).any(axis=1)
    columns = [*numbers.T, *([] if status is None else [status])]
    for first in range(0, len(numbers), PIECE):
        rows = zip(*(column[first : first + PIECE].tolist() for column in columns), strict=True)
        text = "".join([pattern % row for row in rows])
        stream.write(_NAN.sub("", text) if missing[first : first + PIECE].any() else text)
    return stream.getvalue()
