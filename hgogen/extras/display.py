"""Values of the pipeline for notebooks: as Markdown with equations in LaTeX, and as figures."""

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import singledispatch
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from hgogen.call import CallableStep
from hgogen.check import Check
from hgogen.emit.document import (
    claims_table,
    form_equations,
    gains_table,
    method_equations,
    observer_equations,
    plant_equations,
)
from hgogen.emit.formula import plain, table
from hgogen.form import Form
from hgogen.logs.fit import Fit
from hgogen.logs.tune import Calibration
from hgogen.model import Model
from hgogen.observer import Observer
from hgogen.run import continuous, figures, gramian
from hgogen.run.samples import Run
from hgogen.system import System
from hgogen.trial import Trial


def markdown_of(value: Any) -> str:
    """Return a value of the pipeline (plant, form, observer, step, ..) as Markdown with equations in LaTeX, for
    notebooks."""
    return "\n".join(f"**{line[3:]}**" if line.startswith("## ") else line for line in _lines(value))


@singledispatch
def _lines(value: Any) -> Iterable[str]:
    raise NotImplementedError(type(value).__name__)


@_lines.register
def _(plant: System) -> Iterable[str]:
    return [f"**{plain(plant.name)}**", *plant_equations(plant)[1:]]


@_lines.register
def _(form: Form) -> Iterable[str]:
    return [f"**{plain(form.system.name)}**", "", *form_equations(form), "", *claims_table(form.checks)]


@_lines.register
def _(check: Check) -> Iterable[str]:
    return [*claims_table([check]), *(f"\n{plain(line)}" for line in (check.advice,) if line)]


@_lines.register
def _(observer: Observer) -> Iterable[str]:
    return [*observer_equations(observer), "", *claims_table(observer.checks, observer.accepted)]


@_lines.register
def _(step: CallableStep) -> Iterable[str]:
    head = f"**{plain(step.name)}**: {step.observer.name} observer, one call every {step.pace}"
    return [head, "", *observer_equations(step.observer), "", *gains_table(step), "", *method_equations(step)]


@_lines.register
def _(run: Run) -> Iterable[str]:
    ends = (
        (
            (f"`{name}`", *(f"{x:.4g}" for x in (column[0], column.min(), column.max(), column[-1])))
            for name, column in zip(run.names, run.x.T, strict=True)
        )
        if len(run.t)
        else ()
    )
    return [
        run.head,
        "",
        *table(("state", "first", "least", "largest", "last"), ends),
    ]


@_lines.register
def _(model: Model) -> Iterable[str]:
    known = ", ".join(f"`{name}`" for name in model.tuning.tables)
    return [*_lines(model.plant), "", f"tunings: {known or 'none'}"]


@_lines.register
def _(fit: Fit) -> Iterable[str]:
    kinds = {"parameter": fit.parameters, "offset": fit.offsets, "lag": fit.lags}
    rows = (
        (kind, f"`{one.name}`", *(f"{x:.5g}" for x in (one.value, one.deviation, one.nominal)), plain(one.unit), one.at)
        for kind, estimates in kinds.items()
        for one in estimates
    )
    head = ("", "name", "estimate", "standard error", "before", "unit", "end of its range")
    errors = ((f"`{name}`", *(f"{by[name]:.4g}" for by in (fit.error, fit.unfitted, fit.spread))) for name in fit.error)
    return [
        *table(head, rows),
        "",
        *table(("output", f"RMS error of {fit.by}", "before", "RMS about the mean"), errors),
        *(f"\n{plain(note)}" for note in fit.notes()),
    ]


@_lines.register
def _(tuned: Calibration) -> Iterable[str]:
    best = tuned.best
    rows = (
        (f"**{row.name}**" if row is best else row.name, row.first.step.observer.form.kind, f"{row.error:.3g}")
        for row in tuned.rows
    )
    unit = "of the mean" if tuned.truth else f"of copying, {tuned.ahead} ahead"
    return [
        *table(("observer", "form", f"error, in errors {unit}"), rows),
        "",
        f"To take: {best.name}, " + ", ".join(f"`{name}` = `{value}`" for name, value in best.table.items()),
        *(f"\n{name}: {plain(why)}" for name, why in tuned.refused.items()),
    ]


# --- figures, which methods of the values return


def run_plot(run: Run, y: np.ndarray, truth: Mapping[str, np.ndarray]) -> Sequence[Axes]:
    """Return the axes of the figure of `Run.plot`; `y` (N, p): the samples at the rows of their measurement; `truth`:
    (N,) by state."""
    assert run.replay is not None  # which the method demands
    return figures.plotted(figures.record_states(run.replay.step, run.t, run, y, truth))


def response_plot(step: CallableStep, omega: Any) -> Sequence[Axes]:
    """Return the axes of the figure of `CallableStep.plot_response`: the frequency response at `omega` (rad/s)."""
    span = continuous.around_poles(step.observer) if omega is None else np.asarray(omega, dtype=float)
    below = span[span < math.pi / step.dt]
    pair = continuous.response(step.observer, span), continuous.response(step, below)
    return figures.plotted(figures.response(*pair, step.time))


def observability_plot(plant: System, trial: Trial | None) -> Sequence[Axes]:
    """Return the axes of the figure of `Form.plot_observability`: the least observable direction of the plant."""
    return figures.plotted(figures.least_direction(gramian.observability_measure(plant, trial)))
