"""Figures of a trial or of a measured log, as in Boizot, Busvelle, Gauthier 2010, figures 2 to 4.

One panel for each state, with the truth black, the estimate red and measurements light grey; then the innovation with
its thresholds, and theta. An angle is drawn as a course without jumps, beyond its turn. As SVG and PNG; the same
numbers give the same bytes.
"""

import io
import re
from collections.abc import Mapping, Sequence
from textwrap import shorten
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from hgogen.run.continuous import Response
from hgogen.run.gramian import ObservabilityMeasure, as_share
from hgogen.run.samples import Run
from hgogen.signal import Signal
from hgogen.step import Step
from hgogen.system import System
from hgogen.trial import Trajectory

if TYPE_CHECKING:
    from hgogen.certificates.rate_and_noise import Point

TRUTH, ESTIMATE, MEASURED = "black", "#c8102e", "#c4c4c4"
STYLE: Any = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same glyphs everywhere
    **dict.fromkeys(("font.size", "axes.titlesize", "axes.labelsize"), 8.5),
    **dict.fromkeys(("axes.spines.top", "axes.spines.right"), False),
    **dict.fromkeys(("axes.linewidth", "xtick.major.width", "ytick.major.width"), 0.6),
    "lines.linewidth": 1.0,
    "legend.frameon": False,
    "svg.hashsalt": "hgogen",
    "svg.fonttype": "path",
}
GREEK = (
    *("alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "kappa", "lambda", "mu", "nu", "xi"),
    *("rho", "sigma", "tau", "phi", "chi", "psi", "omega"),
)
WIDTH, PANEL, BOTTOM = 6.6, 1.35, 0.42  # inches
COLUMNS, ROW, HANDLE, LETTER = 4, 0.18, 0.4, 0.068  # most columns of a legend; inches of its rows, lines and letters
PARTS = 100  # parts of the time axis in which the largest error is drawn, since errors cross 0
COLOURS = ("#000000", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # of Okabe and Ito
LINE, EDGE = 80, 0.03  # letters of a panel's title; inches between a label and the edge of the page
DASHES = ("-", "--", ":", "-.")
FAR = 1e300
BINS = 700  # parts of the time axis in each of which a line has its smallest and its largest value
MARKED = "#6f6f6f"  # colour of measurements drawn as marks
SLOW = 0.5  # share of samples below which a sensor's values are drawn as marks
_ROOM = 1.5  # factor of the margins above and below the lines, for at least two ticks
_LOOKS: Any = {
    "continuous": {"color": ESTIMATE, "marker": "."},
    "step": {"color": TRUTH, "linestyle": "--", "marker": "."},
}
Array = np.ndarray
Points = Sequence[tuple[float, float]]


@rc_context(STYLE)
def states(step: Step, trajectory: Trajectory) -> Figure:
    """Return a figure of a trial with a panel for each state: the truth, the estimate, and a measurement if an output
    measures the state directly."""
    t, true = trajectory.truth.t, trajectory.truth.x
    figure, axes = panels(len(step.states), t, step.time)
    for i, (axis, signal) in enumerate(zip(axes, step.states, strict=True)):
        j, course = measured_as(step, signal), signal.unwrapped(true[:, i])
        if j is not None:
            y = step.outputs[j].nearest(trajectory.y[:, j], course)
            axis.plot(*thinned(t, y), color=MEASURED, linewidth=0.6, label="measured")
        axis.plot(*thinned(t, course), color=TRUTH, label="truth")
        axis.plot(*thinned(t, signal.nearest(trajectory.x[:, i], course)), color=ESTIMATE, label="estimate")
        caption(axis, signal.name, signal.unit, signal.meaning)
    legend(figure, axes)
    return figure


@rc_context(STYLE)
def fitted(plant: System, t: Array, measured: Array, fitted: Array) -> Figure:
    """Return a figure with a panel for each output of a log: the values `measured` (N, p) at the times t (N,), and
    those of the fitted plant."""
    figure, axes = panels(len(plant.outputs), t, plant.time)
    for axis, signal, y, z in zip(axes, plant.outputs, measured.T, fitted.T, strict=True):
        course = signal.unwrapped(y)
        axis.plot(*thinned(t, course), color=MEASURED, linewidth=3, label="measured")
        axis.plot(*thinned(t, signal.nearest(z, course)), color=ESTIMATE, label="fitted")
        caption(axis, signal.name, signal.unit, signal.meaning)
    legend(figure, axes, ("measured", "fitted"))
    return figure


@rc_context(STYLE)
def adaptation(step: Step, t: Array, traces: Mapping[str, Array]) -> Figure:
    """Return a figure with a panel for each of the `traces` (N,), by name, over t (N,): an innovation with its
    thresholds, and theta from 0 on."""
    own = [name for name in step.observer.traces if name in traces]  # those of reports are in no panel
    names = sorted(own, key=lambda name: ("innovation", "theta", name).index(name))
    fields = {field.name: field for field in step.layout.state}
    figure, axes = panels(len(names), t, step.time, top=0.24)
    for axis, name in zip(axes, names, strict=True):
        values = traces[name]
        if name == "innovation":
            _innovation(axis, step, t, values)
            continue
        axis.plot(*thinned(t, values), color=TRUTH)
        if name == "theta":
            axis.set_ylim(bottom=0, top=1.05 * max(2.0, float(values.max())))
            axis.yaxis.set_major_locator(MaxNLocator(5, integer=True))
            unit, meaning = "", "high-gain parameter (1: extended Kalman filter)"
        else:
            unit, meaning = (step.unit(fields[name]), fields[name].meaning) if name in fields else ("", name)
        caption(axis, name, unit, meaning)
    return figure


@rc_context(STYLE)
def errors(
    states: Sequence[Signal],
    t: Array,
    of: Mapping[str, Array],
    events: Sequence[float] = (),
    unit: str = "s",
    bounds: Mapping[str, float] = MappingProxyType({}),
) -> Figure:
    """Return a figure with a panel for each state: the largest |estimate - truth| in each of `PARTS` parts of the time,
    on a logarithmic axis, with a line for each observer and a legend on the right.

    `of`: errors (N, n) of one seed by observer. A part ends at each of the `events`, so that no line rises before one.
    `bounds`: the proved bound of the settled error, by state.
    """
    cuts = np.linspace(0, len(t), min(PARTS, len(t)), endpoint=False, dtype=int)
    first = np.union1d(cuts, [k for k in np.searchsorted(t, np.asarray(events) - 1e-9) if k < len(t)]).astype(int)
    names = [*of, "proved"] if any(state.name in bounds for state in states) else [*of]
    margin = HANDLE + LETTER * max(map(len, names))
    rows = ROW * len(names) - PANEL * len(states)
    figure, axes = panels(len(states), t, unit, top=max(0.4, 0.1 + rows), margin=margin)
    for i, (axis, signal) in enumerate(zip(axes, states, strict=True)):
        axis.set_yscale("log")
        for k, (name, error) in enumerate(of.items()):
            size = np.maximum.reduceat(np.abs(error[:, i]), first)
            positive = np.where(size > 0, size, np.nan)  # 0 has no logarithm
            axis.plot(t[first], positive, label=name, drawstyle="steps-post", **line_style(k))
        if signal.name in bounds:
            axis.axhline(bounds[signal.name], color=TRUTH, linestyle=":", linewidth=0.8, label="proved")
        caption(axis, signal.name, signal.unit, f"|error| of {signal.meaning or signal.name}")
    axes[0].set_title(f"one seed, the largest in each 1/{PARTS} of the time", loc="right", pad=3, fontsize=7)
    return _named_on_the_right(figure, max((list(axis.get_lines()) for axis in axes), key=len), names)


@rc_context(STYLE)
def over_theta(settled: Mapping[str, Points], noise: Mapping[str, Points], unit: str) -> Figure:
    """Return a figure of two panels over theta: the settling time, and the largest noise of an estimate relative to its
    state's range. `settled`, `noise`: pairs (theta, value) by observer, one line each."""
    margin = HANDLE + LETTER * max(map(len, noise))
    figure, axes = panels(
        2, np.array([1.0, 2.0]), unit, top=max(0.4, 0.1 + ROW * len(noise) - 2 * PANEL), margin=margin
    )
    every = sorted({theta for points in noise.values() for theta, _ in points})
    for k, name in enumerate(noise):
        for axis, points in zip(axes, (settled[name], noise[name]), strict=True):
            axis.loglog(*np.array(points or [(np.nan, np.nan)]).T, marker=".", label=name, **line_style(k))
    axes[0].set_xlim(every[0], every[-1] if len(every) > 1 else every[0] + 1)
    axes[0].set_title("time to settle", loc="left", pad=3)
    axes[0].set_ylabel(unit)
    axes[1].set_title("noise of an estimate, over its state's range", loc="left", pad=3)
    axes[1].set_xlabel("theta")
    return _named_on_the_right(figure, axes[1].get_lines(), list(noise))


@rc_context(STYLE)
def least_direction(measure: ObservabilityMeasure) -> Figure:
    """Return a bar chart of the least observable direction: the |component| of each state, in units of half its range,
    with the observability measure as the title."""
    names, shares = list(measure.direction), list(map(abs, measure.direction.values()))
    height = BOTTOM + 0.3 + 0.25 * len(names)
    figure = Figure(figsize=(WIDTH, height))
    axis = figure.subplots()
    figure.subplots_adjust(left=0.105, right=0.955, top=1 - 0.25 / height, bottom=BOTTOM / height)
    axis.barh([_symbol(name) for name in names], shares, color=ESTIMATE)
    axis.invert_yaxis()
    axis.set_xlim(0, 1)
    axis.set_xlabel("share in the least observable direction, of half the range of each state")
    over = f"along trial {measure.trial}" if measure.trial else "over points of the ranges"
    axis.set_title(f"outputs move by {as_share(measure.median)} of their ranges (median {over})", loc="left", pad=3)
    return figure


def _named_on_the_right(figure: Figure, lines: Sequence[Any], names: Sequence[str]) -> Figure:
    at = (figure.axes[0].get_position().x1 + 0.01, 1.0)
    figure.legend(lines, names, loc="upper left", bbox_to_anchor=at, borderaxespad=0.2)
    return figure


@rc_context(STYLE)
def response(continuous: Response, sampled: Response, unit: str) -> Figure:
    """Return a figure with a panel for each state: the gain |H| over the frequency omega, of the observer in continuous
    time and, dashed, of its step; `unit`: the unit of time."""
    several = len(continuous.outputs) > 1
    drawn = ((continuous, "continuous", {"color": ESTIMATE}), (sampled, "step", {"color": TRUTH, "linestyle": "--"}))
    figure, axes = panels(len(continuous.states), continuous.omega, unit)
    for i, (axis, state) in enumerate(zip(axes, continuous.states, strict=True)):
        for j, output in enumerate(continuous.outputs):
            for one, name, style in drawn:
                label = f"{output}, {name}" if several else name
                axis.loglog(one.omega, one.gain[:, i, j], label=label, alpha=0.7**j, **style)
        axis.axhline(1, color=MEASURED, linewidth=0.6)
        axis.set_ylabel(f"|H| to {_symbol(state)}")
    axes[-1].set_xlabel(f"frequency of the noise (rad/{unit})")
    names = [str(line.get_label()) for line in axes[0].get_lines()]
    legend(figure, axes, [name for name in names if not name.startswith("_")])
    return figure


def line_style(k: int) -> Any:
    """Return the colour and the dashes of line number `k` in a figure with many lines."""
    return {"color": COLOURS[k % len(COLOURS)], "linestyle": DASHES[k // len(COLOURS) % len(DASHES)]}


def measured_as(step: Step, state: Signal) -> int | None:
    """Return the index of the output that is equal to this state; None if there is none."""
    output = step.observer.form.system.output
    return output.index(state) if state in output else None


def _innovation(axis: Axes, step: Step, t: Array, values: Array) -> None:
    """Draw the innovation on a logarithmic axis, since it varies by orders of magnitude."""
    axis.set_yscale("log")
    at, drawn = thinned(t, np.where(values > 0, values, np.nan))
    axis.plot(at, drawn, color=TRUTH)
    if (values > 0).any():
        axis.set_ylim(bottom=np.quantile(values[values > 0], 0.02) / 2)  # the innovation may be close to 0
    aligned = {"gamma_0": "top", "gamma_1": "bottom", "centre": "center"}
    for gain in step.layout.gains:
        if gain.name in aligned:
            level = gain.initial[0]
            axis.axhline(level, color=ESTIMATE, linewidth=0.7, dashes=(5, 3))
            axis.annotate(
                _symbol(gain.name) if gain.name != "centre" else "$m$",
                (1.0, level),
                xycoords=("axes fraction", "data"),
                xytext=(3, 0),
                textcoords="offset points",
                va=aligned[gain.name],
                color=ESTIMATE,
                annotation_clip=False,
            )
    units = {s.unit for s in step.outputs}
    unit = f"{units.pop()}² {step.time}" if len(units) == 1 and "" not in units else f"y² {step.time}"
    caption(axis, "I_d", unit, "innovation over the window d")


def _symbol(name: str) -> str:
    match = re.fullmatch(r"([A-Za-z]+)_?(\d*)", name)
    if not match or (len(match[1]) > 1 and match[1] not in GREEK):
        return name
    letter = match[1] if len(match[1]) == 1 else f"\\{match[1]}"
    return f"${letter}_{{{match[2]}}}$" if match[2] else f"${letter}$"


def panels(panels: int, t: Array, unit: str, top: float = 0.4, margin: float = 0.0) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure with `panels` axes, one below the other, over the times t; `top`, `margin`: inches above and to
    the right of the axes; `unit`: the unit of time."""
    height, width = PANEL * panels + top + BOTTOM, WIDTH + margin
    figure = Figure(figsize=(width, height))
    grid = figure.subplots(panels, 1, sharex=True, squeeze=False)[:, 0]
    sides = {"left": 0.105 * WIDTH / width, "right": 0.955 * WIDTH / width}
    figure.subplots_adjust(**sides, top=1 - top / height, bottom=BOTTOM / height, hspace=0.38)
    grid[-1].set_xlabel(f"time ({unit})")
    grid[-1].set_xlim(float(t[0]), float(t[-1]))
    figure.align_ylabels(grid)
    return figure, list(grid)


def caption(axis: Axes, name: str, unit: str, meaning: str) -> None:
    """Set the label (name and unit) and the title (meaning) of a panel."""
    symbol = "$I_d$" if name == "I_d" else _symbol(name)
    axis.set_ylabel(f"{symbol} ({unit})" if unit else symbol)
    axis.set_title(shorten(meaning, LINE, placeholder=" .."), loc="left", pad=3)


def legend(figure: Figure, axes: Sequence[Axes], names: Sequence[str] = ("truth", "estimate", "measured")) -> None:
    """Add a legend above the panels, with each name once."""
    lines = {line.get_label(): line for axis in axes for line in (*axis.get_lines(), *axis.collections, *axis.patches)}
    order = [name for name in names if name in lines]
    room = int(WIDTH / (HANDLE + LETTER * max(map(len, order))))  # columns that fit
    figure.legend(
        [lines[name] for name in order],
        order,
        loc="upper right",
        ncols=max(1, min(len(order), COLUMNS, room)),
        bbox_to_anchor=(0.96, 1.0),
        borderaxespad=0.2,
        handlelength=1.6,
        columnspacing=1.4,
    )


def thinned(t: Array, values: Array) -> tuple[Array, Array]:
    """Return fewer samples (t, values) that draw the same line: the extremes in each bin, with gaps at NaN and beyond
    `FAR`."""
    values = np.where(np.abs(values) < FAR, values, np.nan)
    if len(t) <= 2 * BINS:
        return t, values
    keep = [0, len(t) - 1]
    for part in np.array_split(np.arange(len(t)), BINS):
        piece = values[part]
        if np.isnan(piece).all():
            keep.append(part[0])
        else:
            keep += [part[np.nanargmin(piece)], part[np.nanargmax(piece)]]
    index = np.unique(keep)
    return t[index], values[index]


@rc_context(STYLE)
def svg(figure: Figure) -> str:
    """Return the figure as SVG text, without date, version and random ids."""
    stream = io.StringIO()
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return stream.getvalue()


@rc_context(STYLE)
def png(figure: Figure) -> bytes:
    """Return the figure as PNG bytes, 160 dots an inch."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=160, metadata={"Software": None})
    return stream.getvalue()


def make_room(figure: Figure) -> None:
    """Move the panels of a figure to the right if a label would be cut off."""
    beyond = -float(figure.get_tightbbox().x0)
    if beyond > 0:
        figure.subplots_adjust(left=figure.subplotpars.left + (beyond + EDGE) / figure.get_figwidth())


def plotted(figure: Figure) -> Sequence[Axes]:
    """Return the axes of a figure after registering it with pyplot, which notebooks and `pyplot.show` require."""
    from matplotlib import pyplot  # it chooses a backend

    make_room(figure)
    pyplot.figure(figure)
    return figure.axes


@rc_context(STYLE)
def files(name: str, figure: Figure) -> dict[str, bytes]:
    """Return the figure as NAME.svg and NAME.png, bytes by file name, with room on the left for long labels."""
    make_room(figure)
    return {f"{name}.svg": svg(figure).encode(), f"{name}.png": png(figure)}


@rc_context(STYLE)
def record_states(step: Step, t: Array, run: Run, y: Array, truth: Mapping[str, Array]) -> Figure:
    """Return a figure with a panel for each state of a run over the samples y (N, p) at times t (N,), NaN where
    missing; `truth` (N,) by state."""
    figure, axes = panels(len(step.states), t, step.time)
    for i, (axis, signal) in enumerate(zip(axes, step.states, strict=True)):
        j, x = measured_as(step, signal), signal.unwrapped(run.x[:, i])
        if j is not None:
            _measured(axis, t, step.outputs[j].nearest(y[:, j], x), "measured", MEASURED, 3.0)
        axis.plot(*thinned(t, x), color=ESTIMATE, linewidth=1.6, label="estimate")
        if signal.name in truth:
            _measured(axis, t, signal.nearest(truth[signal.name], x), "truth", TRUTH, 0.6)
        if run.covariance is not None:
            _band(axis, t, x, np.sqrt(np.maximum(run.covariance[:, i, i], 0.0)))
        caption(axis, signal.name, signal.unit, signal.meaning)
    legend(figure, axes, ("truth", "estimate", "2 sigma", "measured"))
    return figure


@rc_context(STYLE)
def record_innovations(step: Step, t: Array, run: Run) -> Figure:
    """Return a figure with a panel for each output: the innovations in a run, with the band of 2 sigma by the
    observer."""
    assert run.innovations is not None  # of a step
    figure, axes = panels(len(step.outputs), t, step.time)
    for j, (axis, signal) in enumerate(zip(axes, step.outputs, strict=True)):
        e = run.innovations[:, j]
        _measured(axis, t, e, "innovation", TRUTH, 0.6)
        if run.variances is not None:
            there = np.isfinite(run.variances[:, j])
            _band(axis, t[there], np.zeros(int(there.sum())), np.sqrt(run.variances[there, j]))
        caption(axis, signal.name, signal.unit, f"innovation of {signal.meaning or signal.name}")
    legend(figure, axes, ("innovation", "2 sigma"))
    return figure


@rc_context(STYLE)
def log_faults(
    signals: Sequence[Signal], t: Array, values: Array, faults: Mapping[str, Sequence[tuple[int, int]]], unit: str
) -> Figure:
    """Return a figure with a panel for each of the `signals`: its `values` (N, k) at the times t (N,), with the
    stretches of samples (first, last) of its `faults` shaded; `unit`: the unit of time."""
    figure, axes = panels(len(signals), t, unit)
    half = float(np.median(np.diff(t))) / 2
    for axis, signal, column in zip(axes, signals, values.T, strict=True):
        _measured(axis, t, column, "measured", MEASURED, 0.8)
        for first, last in faults[signal.name]:
            axis.axvspan(t[first] - half, t[last] + half, color=ESTIMATE, alpha=0.25, linewidth=0, label="fault")
        caption(axis, signal.name, signal.unit, signal.meaning or signal.name)
    legend(figure, axes, ("measured", "fault"))
    return figure


def _measured(axis: Axes, t: Array, values: Array, label: str, colour: str, width: float) -> None:
    there = np.isfinite(values)
    if there.mean() < SLOW:
        dark = MARKED if colour == MEASURED else colour  # marks are above the lines, since they are small
        axis.plot(*thinned(t[there], values[there]), ".", markersize=4, color=dark, zorder=3, label=label)
    else:
        axis.plot(*thinned(t, values), color=colour, linewidth=width, label=label)


def _band(axis: Axes, t: Array, middle: Array, sigma: Array) -> None:
    """Draw the band `middle` +- 2 sigma, the widest in each of `BINS`
    parts of the time; the axis grows by a quarter at most."""
    bottom, top = axis.get_ylim()
    low, high = (np.where(abs(ends) < FAR, ends, np.nan) for ends in (middle - 2 * sigma, middle + 2 * sigma))
    if len(t) > 2 * BINS:
        first = np.linspace(0, len(t), BINS, endpoint=False, dtype=int)
        t, low, high = t[first], np.fmin.reduceat(low, first), np.fmax.reduceat(high, first)
    axis.fill_between(t, low, high, label="2 sigma", color=ESTIMATE, alpha=0.18, linewidth=0)
    (least, most), room = axis.get_ylim(), (top - bottom) / 4
    axis.set_ylim(max(least, bottom - room), min(most, top + room))


@rc_context(STYLE)
def curve(points: Sequence["Point"], step: Step) -> Figure:
    """Return a figure of designed gains over the rate of decay: a panel for each state of the form with the bounds of
    its error by the noise of each output, and a panel with the longest dt. The first of the `points` is the present
    tuning, drawn as a cross."""
    form, time = step.observer.form, step.observer.form.system.time
    tuning, gains = points[0], sorted(points[1:], key=lambda one: one.about)
    rates = [one.about for one in points]
    figure, axes = panels(form.n + 1, np.array([min(rates) / 1.2, max(rates) * 1.2]), time)
    for axis, state in zip(axes, form.names, strict=False):
        for k, output in enumerate(y.name for y in form.system.outputs):
            for label, style in _LOOKS.items():
                place = state, output
                bounds: list[float] = [getattr(one, label).get(place, np.nan) for one in (*gains, tuning)]
                axis.loglog([one.about for one in gains], bounds[:-1], label=label, alpha=0.7**k, **style)
                axis.loglog([tuning.about], bounds[-1:], "x", color=style["color"], label="_")
        axis.set_ylabel(f"error of {state}")
    dts = [np.nan if one.longest is None else one.longest for one in (*gains, tuning)]
    axes[-1].loglog([one.about for one in gains], dts[:-1], marker=".", color=TRUTH)
    axes[-1].loglog([tuning.about], dts[-1:], "x", color=TRUTH)
    axes[-1].axhline(step.dt, color=MEASURED, linewidth=0.6)
    axes[-1].set(ylabel=f"longest dt ({time})", xlabel=f"rate (1/{time}); noise of 1; the tuning: a cross")
    for axis in axes:
        low, high = axis.get_ylim()
        if low < high:  # the panel is not empty
            axis.set_ylim(low / _ROOM, high * _ROOM)
        _in_full(axis.yaxis)
    _in_full(axes[-1].xaxis)
    legend(figure, axes, tuple(_LOOKS))
    return figure


def _in_full(axis: Axis) -> None:
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())
