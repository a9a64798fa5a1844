"""What a run over a record gives, as CSV text."""

import csv
import io
from collections.abc import Sequence

import numpy as np

from hgogen.call import CallableStep
from hgogen.calling.samples import Run
from hgogen.reading.measured import Record


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
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    behind = [[] for _ in numbers] if status is None else status[:, None].tolist()
    for row, last in zip(numbers.tolist(), behind, strict=True):
        writer.writerow([*("" if value != value else f"{value:.10g}" for value in row), *last])
    return stream.getvalue()
