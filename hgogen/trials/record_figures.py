"""Figures of a run over a measured record: states with their 2 sigma and the truth, and innovations with theirs.

A sensor slower than the step is drawn as marks, since nothing was measured between them.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hgogen.calling.samples import Run
from hgogen.step import Step
from hgogen.trials.figures import (
    BINS,
    ESTIMATE,
    FAR,
    MEASURED,
    STYLE,
    TRUTH,
    caption,
    legend,
    measured_as,
    panels,
    thin,
)

Array = np.ndarray
MARKED = "#6f6f6f"  # what was measured, as marks
SLOW = 0.5  # of the samples: a sensor that gives fewer is drawn as marks
BAND: Any = {"color": ESTIMATE, "alpha": 0.18, "linewidth": 0}


def states(step: Step, t: Array, run: Run, y: Array, truth: Mapping[str, Array]) -> Figure:
    """One panel for each state of a run over the samples y (N, p) at times t (N,), NaN where missing; `truth` (N,) by
    state."""
    with rc_context(STYLE):
        figure, axes = panels(len(step.states), t, step.time)
        for i, (axis, signal) in enumerate(zip(axes, step.states, strict=True)):
            j, x = measured_as(step, signal), run.x[:, i]
            if j is not None:
                _measured(axis, t, y[:, j], "measured", MEASURED, 3.0)
            axis.plot(*thin(t, x), color=ESTIMATE, linewidth=1.6, label="estimate")
            if signal.name in truth:
                _measured(axis, t, truth[signal.name], "truth", TRUTH, 0.6)
            if run.covariance is not None:
                limits = axis.get_ylim()
                _band(axis, t, x, np.sqrt(np.maximum(run.covariance[:, i, i], 0.0)))
                axis.set_ylim(*_around(limits, axis.get_ylim()))
            caption(axis, signal.name, signal.unit, signal.meaning)
        legend(figure, axes, ("truth", "estimate", "2 sigma", "measured"))
    return figure


def innovations(step: Step, t: Array, run: Run) -> Figure:
    """One panel for each output: its innovations, and the 2 sigma that the observer takes them to have."""
    assert run.innovations is not None  # of a step
    with rc_context(STYLE):
        figure, axes = panels(len(step.outputs), t, step.time)
        for j, (axis, signal) in enumerate(zip(axes, step.outputs, strict=True)):
            e = run.innovations[:, j]
            _measured(axis, t, e, "innovation", TRUTH, 0.6)
            if run.variances is not None:
                limits, there = axis.get_ylim(), np.isfinite(run.variances[:, j])
                _band(axis, t[there], np.zeros(int(there.sum())), np.sqrt(run.variances[there, j]))
                axis.set_ylim(*_around(limits, axis.get_ylim()))
            caption(axis, signal.name, signal.unit, f"innovation of {signal.meaning or signal.name}")
        legend(figure, axes, ("innovation", "2 sigma"))
    return figure


def _measured(axis: Axes, t: Array, values: Array, label: str, colour: str, width: float) -> None:
    """A broad line shows beside an estimate that lies on it, a thin one within it; a slow sensor's values are marks."""
    there = np.isfinite(values)
    if there.mean() < SLOW:
        dark = MARKED if colour == MEASURED else colour  # and above the lines, since a mark is small
        axis.plot(*thin(t[there], values[there]), ".", markersize=4, color=dark, zorder=3, label=label)
    else:
        axis.plot(*thin(t, values), color=colour, linewidth=width, label=label)


def _band(axis: Axes, t: Array, middle: Array, sigma: Array) -> None:
    """The widest 2 sigma in each of so many parts of the time that a line needs."""
    low, high = (np.where(abs(ends) < FAR, ends, np.nan) for ends in (middle - 2 * sigma, middle + 2 * sigma))
    if len(t) > 2 * BINS:
        first = np.linspace(0, len(t), BINS, endpoint=False, dtype=int)
        t, low, high = t[first], np.fmin.reduceat(low, first), np.fmax.reduceat(high, first)
    axis.fill_between(t, low, high, label="2 sigma", **BAND)


def _around(limits: tuple[float, float], wide: tuple[float, float]) -> tuple[float, float]:
    """Limits of an axis that show a band as far as a quarter beyond what else there is: at first it may be vast."""
    room = (limits[1] - limits[0]) / 4
    return max(wide[0], limits[0] - room), min(wide[1], limits[1] + room)
