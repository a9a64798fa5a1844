"""The figure of gains side by side: what noise does to each state, and how long a step may be, over the rate."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from hgogen.certificates.rate_and_noise import Point
from hgogen.step import Step
from hgogen.trials.figures import ESTIMATE, MEASURED, STYLE, TRUTH, legend, panels

_ROOM = 1.5  # above and below what is drawn, so that there are two ticks at least
_LOOKS: Any = {
    "continuous": {"color": ESTIMATE, "marker": "."},
    "step": {"color": TRUTH, "linestyle": "--", "marker": "."},
}


def curve(points: Sequence[Point], step: Step) -> Figure:
    """A panel for each state of the form, the bound of what noise does, of each output, and one for the longest dt. The
    first point is the tuning, a cross beside the lines of the designed gains."""
    form, time = step.observer.form, step.observer.form.system.time
    tuning, gains = points[0], sorted(points[1:], key=lambda one: one.about)
    rates = [one.about for one in points]
    with rc_context(STYLE):
        figure, axes = panels(form.n + 1, np.array([min(rates) / 1.2, max(rates) * 1.2]), time)
        for axis, state in zip(axes, form.names, strict=False):
            for k, output in enumerate(y.name for y in form.system.outputs):
                for label, look in _LOOKS.items():
                    place = state, output
                    bounds: list[float] = [getattr(one, label).get(place, np.nan) for one in (*gains, tuning)]
                    axis.loglog([one.about for one in gains], bounds[:-1], label=label, alpha=0.7**k, **look)
                    axis.loglog([tuning.about], bounds[-1:], "x", color=look["color"], label="_")
            axis.set_ylabel(f"error of {state}")
        dts = [np.nan if one.longest is None else one.longest for one in (*gains, tuning)]
        axes[-1].loglog([one.about for one in gains], dts[:-1], marker=".", color=TRUTH)
        axes[-1].loglog([tuning.about], dts[-1:], "x", color=TRUTH)
        axes[-1].axhline(step.dt, color=MEASURED, linewidth=0.6)
        axes[-1].set_ylabel(f"longest dt ({time})")
        axes[-1].set_xlabel(f"rate (1/{time}); noise of 1; the tuning: a cross")
        for axis in axes:
            low, high = axis.get_ylim()
            if low < high:  # where anything is drawn
                axis.set_ylim(low / _ROOM, high * _ROOM)
            _in_full(axis.yaxis)
        _in_full(axes[-1].xaxis)
        legend(figure, axes, tuple(_LOOKS))
    return figure


def _in_full(axis: Axis) -> None:
    """Ticks at 1, 2, 5, 10 and so on, as numbers and not as powers."""
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())
