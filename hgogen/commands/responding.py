"""The command `response`: what measurement noise does to the estimate of a model's observer."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Group
from rich.text import Text

import hgogen as hg
from hgogen.commands.command import ModelReport, command
from hgogen.commands.options import ModelArgument, Tuned, numbers_in
from hgogen.commands.output import Folder, Written, headed, rendered
from hgogen.commands.process import note
from hgogen.model import load
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.run.continuous import Response, pace

COUNT = 6  # frequencies of the table, unless they are given
POINTS = 200  # frequencies of the figure


@dataclass(frozen=True, eq=False)
class Gain:
    """The gain from the noise of an output to the error of a state."""

    output: Annotated[str, "output with the noise"]
    state: Annotated[str, "state with the error"]
    continuous: Annotated[list[float], "gain in continuous time at each omega"]
    step: Annotated[list[float | None], "gain of the step at each omega; null beyond the Nyquist frequency pi/dt"]


@dataclass(frozen=True, eq=False)
class Gains(ModelReport):
    """What sinusoidal noise does to estimates."""

    json_keys = "model observer coordinates=continuous.coordinates dt omega gains files"

    observer: Annotated[str, "name of the observer"]
    dt: Annotated[float, "sampling period"]
    omega: Annotated[tuple[float, ...], "frequencies in rad per unit of the model's time"]
    continuous: Response
    sampled: Response
    unit: str
    files: Written = ()

    @property
    def gains(self) -> list[Gain]:
        """The gains of each output and state."""
        gains = list[Gain]()
        for j, output in enumerate(self.continuous.outputs):
            for i, state in enumerate(self.continuous.states):
                values = zip(self.sampled.aliased, self.sampled.gain[:, i, j].tolist(), strict=True)
                step = [None if alias else gain for alias, gain in values]
                gains.append(Gain(output, state, self.continuous.gain[:, i, j].tolist(), step))
        return gains

    def notes(self) -> Iterator[str]:
        """What limits the gains."""
        if self.continuous.coordinates == "form":
            bent = "the plant's states are nonlinear in the observer's coordinates"
            yield f"{bent}: the gains are those of the form's states"
        for name, values in self.continuous.held.items():
            at = ", ".join(f"{value:g}" for value in values)
            yield f"{name} adapts: the gains are those at {at}, where the core is the fastest"
        if self.sampled.aliased.any():
            beyond = ", ".join(f"{w:g}" for w in self.sampled.omega[self.sampled.aliased])
            rate, are = f"rad/{self.unit}", "are" if self.sampled.aliased.sum() > 1 else "is"
            what = f"{beyond} {rate} {are} beyond the Nyquist frequency pi/dt = {math.pi / self.dt:g} {rate}"
            yield f"{what}: the samples show a slower alias, and the step has no gain there"

    def tables(self) -> Iterator[Any]:
        """A row for each pair and frequency."""
        head = f"|H(j omega)| from noise to estimate: the linear error core, and its step of {self.dt:g} {self.unit}"
        columns = ("noise of", "error of", f"omega (rad/{self.unit})", "continuous", "step")
        table = headed(head, *columns, numbers=3)
        for column in table.columns[2:]:
            column.no_wrap = True  # half a number is another number
        for one in self.gains:
            first = one.output, one.state
            for w, exact, discrete in zip(self.omega, one.continuous, one.step, strict=True):
                step = "-" if discrete is None else f"{discrete:.4g}"
                table.add_row(*map(Text, first), f"{w:g}", f"{exact:.4g}", step)
                first = ("", "")
        yield Group(table, "")


@command(Gains)
def response_(
    model: ModelArgument,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    omega: Annotated[
        str, typer.Option("--omega", help="Frequencies in rad per unit of the model's time, such as 50,100,300.")
    ] = "",
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder of the figure; by default none.")] = None,
) -> Gains:
    """Tell what sinusoidal noise of an output does to each estimate: the error's amplitude over the noise's, of the
    linear error core in continuous time and as its step discretises it.

    By default at frequencies around the core's poles. With --out a figure is drawn, response.svg and response.png.
    """
    loaded = load(model).set(setting)
    step = loaded.step(observer)
    slow, fast = pace(step.observer)
    asked = f"numbers in rad/{step.time}, such as 50,100,300"
    frequencies = numbers_in(omega, asked, "--omega") if omega else _around(slow, fast, step.dt)
    continuous, sampled = hg.response(step.observer, frequencies), hg.response(step, frequencies)
    paths: list[Path] = []
    if out is not None:
        from hgogen.run import figures as figure

        Folder(out).demand("response.svg")
        span = np.geomspace(min(slow / 10, *frequencies), max(10 * fast, *frequencies), POINTS)
        below = span[span < math.pi / step.dt]
        drawn = figure.response(hg.response(step.observer, span), hg.response(step, below), step.time)
        paths = Folder(out).write(rendered({"response": drawn}))
    gains = Gains(
        loaded.path, step.observer.name, step.dt, tuple(frequencies), continuous, sampled, step.time, tuple(paths)
    )
    note(*gains.notes())
    return gains


def _around(slow: float, fast: float, dt: float) -> tuple[float, ...]:
    """From a tenth of the slowest pole to ten times the fastest, below pi/dt, to two digits."""
    high = min(10 * fast, 0.9 * math.pi / dt)
    low = min(max(slow / 10, high / 1e4), high / 10)
    return tuple(float(f"{value:.2g}") for value in np.geomspace(low, high, COUNT))
