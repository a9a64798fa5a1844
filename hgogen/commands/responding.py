"""The command `response`: what measurement noise does to the estimate of a model's observer."""

import math
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import hgogen as hg
from hgogen.commands import tables
from hgogen.commands.command import Folder, Json, ModelArgument, Tuned, command, rendered, show
from hgogen.commands.headed import file_list
from hgogen.commands.logs import numbers_in
from hgogen.commands.process import note
from hgogen.model import load
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.trials.response import Response, pace

COUNT = 6  # frequencies of the table, unless they are given
POINTS = 200  # frequencies of the figure


@command()
def response_(
    model: ModelArgument,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    omega: Annotated[
        str, typer.Option("--omega", help="Frequencies in rad per unit of the model's time, such as 50,100,300.")
    ] = "",
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder of the figure; by default none.")] = None,
    as_json: Json = False,
) -> None:
    """Tell what sinusoidal noise of an output does to each estimate: the error's amplitude over the noise's, of the
    linear error core in continuous time and as its step discretises it.

    By default at frequencies around the core's poles. With --out a figure is drawn, response.svg and response.png.

    JSON keys: model, observer, coordinates ("plant", or "form" where the plant's states are nonlinear in the form's,
    whose names are then given), dt, omega, gains (output, state, continuous, step: a number for each omega, of the
    step null beyond the Nyquist frequency pi/dt), files.
    """
    loaded = load(model).set(setting)
    step = loaded.step(observer)
    slow, fast = pace(step.observer)
    frequencies = (
        numbers_in(omega, f"numbers in rad/{step.time}, such as 50,100,300", "--omega")
        if omega
        else _around(slow, fast, step.dt)
    )
    continuous, sampled = hg.response(step.observer, frequencies), hg.response(step, frequencies)
    paths: list[Path] = []
    if out is not None:
        from hgogen.trials import figures as figure

        folder = Folder(out)
        folder.demand("response.svg")
        span = np.geomspace(min(slow / 10, *frequencies), max(10 * fast, *frequencies), POINTS)
        drawn = figure.response(
            hg.response(step.observer, span), hg.response(step, span[span < math.pi / step.dt]), step.time
        )
        paths += folder.write(rendered({"response": drawn}))
    value = {
        "model": loaded.path,
        "observer": step.observer.name,
        "coordinates": continuous.coordinates,
        "dt": step.dt,
        "omega": list(frequencies),
        "gains": _gains(continuous, sampled),
        "files": [str(path) for path in paths],
    }
    if continuous.coordinates == "form":
        note("the plant's states are nonlinear in the observer's coordinates: the gains are those of the form's states")
    for name, values in continuous.held.items():
        at = ", ".join(f"{value:g}" for value in values)
        note(f"{name} adapts: the gains are those at {at}, where the core is the fastest")
    if sampled.aliased.any():
        beyond = ", ".join(f"{w:g}" for w in sampled.omega[sampled.aliased])
        rate, are = f"rad/{step.time}", "are" if sampled.aliased.sum() > 1 else "is"
        what = f"{beyond} {rate} {are} beyond the Nyquist frequency pi/dt"
        note(f"{what} = {math.pi / step.dt:g} {rate}: the samples show a slower alias, and the step has no gain there")
    show(as_json, value, tables.responses(continuous, sampled, step.time), *([file_list(paths)] if paths else []))


def _around(slow: float, fast: float, dt: float) -> tuple[float, ...]:
    """From a tenth of the slowest pole to ten times the fastest, below pi/dt, to two digits."""
    high = min(10 * fast, 0.9 * math.pi / dt)
    low = min(max(slow / 10, high / 1e4), high / 10)
    return tuple(float(f"{value:.2g}") for value in np.geomspace(low, high, COUNT))


def _gains(continuous: Response, sampled: Response) -> list[dict[str, object]]:
    aliased = sampled.aliased.tolist()
    return [
        {
            "output": output,
            "state": state,
            "continuous": continuous.gain[:, i, j].tolist(),
            "step": [
                None if alias else gain for alias, gain in zip(aliased, sampled.gain[:, i, j].tolist(), strict=True)
            ],
        }
        for j, output in enumerate(continuous.outputs)
        for i, state in enumerate(continuous.states)
    ]
