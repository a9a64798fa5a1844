"""The figures that commands write, by file name without ending."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hgogen.call import CallableStep
from hgogen.certificates.error_bound import ErrorBound
from hgogen.commands.trial_runs import Tried
from hgogen.reading.measured import Record
from hgogen.run.comparison import Measured
from hgogen.run.samples import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figures(step: CallableStep, done: Iterable[Tried], known: ErrorBound | None = None) -> dict[str, "Figure"]:
    """The figures of each trial, by file name without ending: the states, what theta did, and where bounds of the
    errors are `known` the errors with them."""
    from hgogen.run import figures as figure

    drawn = {}
    for one in done:
        drawn[f"{one.trial.name}_states"] = figure.states(step, one.first)
        if known and known.bounds:
            of = {step.observer.name: one.first.error}
            drawn[f"{one.trial.name}_errors"] = figure.errors(
                step.states, one.first.truth.t, of, one.trial.events, step.time, known.bounds
            )
        if one.first.traces:
            drawn[f"{one.trial.name}_theta"] = figure.adaptation(step, one.first.truth.t, one.first.traces)
    return drawn


def errors(each: Sequence[Measured], unit: str) -> "Figure":
    """The errors of several observers on the first seed of one trial; `unit`: that of the plant's time."""
    from hgogen.run import figures as figure

    first = each[0].first
    of = {one.name: one.first.error for one in each}
    return figure.errors(each[0].states, first.truth.t, of, first.trial.events, unit)


def record_figures(
    step: CallableStep, name: str, record: Record, run: Run, truth: Mapping[str, np.ndarray]
) -> dict[str, "Figure"]:
    """The figures of a measured record, by file name without ending; `truth` (N,) by state."""
    from hgogen.run import figures as figure

    drawn = {
        f"{name}_states": figure.record_states(step, record.t, run, record.of(step.outputs), truth),
        f"{name}_innovations": figure.record_innovations(step, record.t, run),
    }
    if run.traces:
        drawn[f"{name}_theta"] = figure.adaptation(step, record.t, run.traces)
    return drawn
