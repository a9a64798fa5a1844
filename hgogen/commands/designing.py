"""The commands `design` and `response`: constant gains for wanted rates, and the effect of noise and of the step on an
observer's estimate.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
import typer
from rich.console import Group
from rich.text import Text

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.certificates.rate_and_noise import Point, designed, tuned
from hgogen.commands.command import ModelArgument, ModelReport, Out, Tuned, command, numbers_in
from hgogen.commands.output import Bar, Folder, Written, folder_of, headed, note, rendered
from hgogen.model import Model, load
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.prove.gain_design import Gain, NoGain
from hgogen.prove.questions import theta_of
from hgogen.run.continuous import Response, pace
from hgogen.sentence import down, same, up

_AROUND = (1 / 3, 1.0, 3.0)  # times the rate of the tuning
_MOST = 20  # rates at most


@dataclass(frozen=True)
class NoiseBound:
    """The bound of the gain from the noise of an output to the estimate of a state."""

    state: Annotated[str, "state with the error"]
    output: Annotated[str, "output with the noise"]
    continuous: Annotated[float | None, "bound in continuous time; null where nothing is proved"]
    step: Annotated[float | None, "bound of the step; null where nothing is proved"]


@dataclass(frozen=True, eq=False)
class DesignedPoint:
    """A designed gain as printed in JSON."""

    json_keys = (
        "observer=point.observer.name designed=point.wanted theta K=point.gain.K argument=point.gain.argument "
        "rate=point.rate longest=point.longest noise"
    )

    point: Point

    @property
    def theta(self) -> float:
        """The gain theta."""
        return float(theta_of(self.point.observer))

    @property
    def noise(self) -> list[NoiseBound]:
        """The effect of noise on each state."""
        one = self.point
        pairs = {**one.continuous, **one.step}
        return [NoiseBound(x, y, one.continuous.get((x, y)), one.step.get((x, y))) for x, y in pairs]


@dataclass(frozen=True, eq=False)
class Designs(ModelReport):
    """The gains for requested rates of decay, and those of the model's tuning."""

    json_keys = (
        "model observer=step.observer.name form=step.observer.form.kind method=step.code.rule dt=step.dt points=rows "
        "refused files"
    )

    step: CallableStep
    points: list[Point]
    refused: Annotated[dict[str, str], "why, by rate"]
    files: Written = ()

    def drawn(self, folder: Folder) -> Self:
        """Return the report with its figure, which is written into a folder."""
        from hgogen.run.figures import curve

        return replace(self, files=tuple(folder.write(rendered({"design": curve(self.points, self.step)}))))

    @property
    def rows(self) -> list[DesignedPoint]:
        """The tuning, then the gain for each rate."""
        return [DesignedPoint(one) for one in self.points]

    def tables(self) -> Iterator[Any]:
        """Yield the gains with their rates."""
        step, time = self.step, self.step.observer.form.system.time
        running = f"by {step.code.rule} at dt = {step.dt:g} {time}"
        head = f"what is proved of gains: how far noise of 1 moves an estimate, {running}"
        columns = ("gain", "error of", "noise of", f"rate (1/{time})", f"dt up to ({time})", "continuous", "step")
        table = headed(head, *columns, numbers=4)
        for one in self.points:
            name = f"{one.observer.name}, the tuning" if one.gain is None else f"theta = {same(one.gain.theta)}"
            first = name, *("-" if value is None else down(value, 3) for value in (one.rate, one.longest))
            form = one.observer.form
            for pair in [(x, y) for x in form.names for y in map(str, form.system.outputs)]:
                known = (each.get(pair) for each in (one.continuous, one.step))
                bounds = ("-" if value is None else up(value, 3) for value in known)
                table.add_row(*map(Text, (first[0], *pair)), *first[1:], *bounds)
                first = ("", "", "")
        gains = [Text(f"  {_call(one.gain)}") for one in self.points if one.gain is not None]
        yield Group(table, "", Text("the gains", style="bold"), *gains, "")


def _call(gain: Gain) -> str:
    arguments = {**gain.arguments, "theta": same(gain.theta)}
    return f"hg.observers.{gain.observer}(form, {', '.join(f'{name}={value}' for name, value in arguments.items())})"


@command(Designs)
def design_(
    model: ModelArgument,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    rates: Annotated[
        str,
        typer.Option("--rates", help="Rates at which errors decay, in 1 per unit of the model's time, such as 1,3."),
    ] = "",
    argument: Annotated[
        bool,
        typer.Option(
            "--argument", help="Search an output error in the argument of b as well, of which circle_criterion is made."
        ),
    ] = False,
    out: Out = None,
) -> Designs:
    """Design constant gains of high_gain for requested rates of decay, each with a small bound of the error by noise,
    and compare them with the model's tuning: the proved rate, the effect of noise on each state in continuous time and
    by the step at the model's dt, and the longest dt for which the step is proved. The default rates are the tuning's
    own, a third and three times that; the tuning is that of --observer, the model's own, or of high_gain. With
    --argument the gains are those of circle_criterion, where these do better. Draws the figure design.svg and
    design.png."""
    loaded = load(model).set(setting)
    folder = folder_of(out, loaded, observer)
    folder.demand("design.svg")
    requested_rates = _rates(rates)
    step = _reference(loaded, observer)
    points, refused = [tuned(step)], dict[float, NoGain]()
    wanted = requested_rates or [_three_digits(points[0].about * k) for k in _AROUND]
    with Bar("gains", len(wanted)) as bar:
        for rate in wanted:
            try:
                points.append(designed(step, rate, argument))
            except NoGain as error:
                refused[rate] = error
            bar.tick()
    if len(refused) == len(wanted):
        raise refused[wanted[-1]]
    note(*map(str, refused.values()))
    reasons = {f"{rate:g}": str(error) for rate, error in refused.items()}
    return Designs(loaded.path, step, points, reasons).drawn(folder)


def _reference(loaded: Model, observer: str | None) -> CallableStep:
    step = loaded.step(observer)
    if step.observer.error is not None:
        return step
    if observer is not None:
        raise typer.BadParameter(
            f"{observer} has no constant gain to be designed; take high_gain", param_hint="--observer"
        )
    return loaded.step("high_gain")


def _rates(text: str) -> Sequence[float]:
    if not text:
        return ()
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if not values or len(values) > _MOST or not all(0 < value < math.inf for value in values):
        reason = f"{text[:60]!r} must be up to {_MOST} positive numbers, such as 1,3,10"
        raise typer.BadParameter(reason, param_hint="--rates")
    return values


def _three_digits(rate: float) -> float:
    digits = 2 - math.floor(math.log10(rate))
    return float(f"{math.floor(rate * 10.0**digits) / 10.0**digits:.3g}")


COUNT = 6  # frequencies of the table, unless they are given
POINTS = 200  # frequencies of the figure


@dataclass(frozen=True, eq=False)
class FrequencyGain:
    """The gain from the noise of an output to the error of a state."""

    output: Annotated[str, "output with the noise"]
    state: Annotated[str, "state with the error"]
    continuous: Annotated[list[float], "gain in continuous time at each omega"]
    step: Annotated[list[float | None], "gain of the step at each omega; null beyond the Nyquist frequency pi/dt"]


@dataclass(frozen=True, eq=False)
class Gains(ModelReport):
    """The frequency response of the estimates to noise of the outputs."""

    json_keys = "model observer coordinates=continuous.coordinates dt omega gains files"

    observer: Annotated[str, "name of the observer"]
    dt: Annotated[float, "sampling period"]
    omega: Annotated[tuple[float, ...], "frequencies in rad per unit of the model's time"]
    continuous: Response
    sampled: Response
    unit: str
    files: Written = ()

    @property
    def gains(self) -> list[FrequencyGain]:
        """The gains of each output and state."""
        gains = list[FrequencyGain]()
        for j, output in enumerate(self.continuous.outputs):
            for i, state in enumerate(self.continuous.states):
                values = zip(self.sampled.aliased, self.sampled.gain[:, i, j].tolist(), strict=True)
                step = [None if alias else gain for alias, gain in values]
                gains.append(FrequencyGain(output, state, self.continuous.gain[:, i, j].tolist(), step))
        return gains

    def notes(self) -> Iterator[str]:
        """Yield the limits of validity of the gains."""
        if self.continuous.coordinates == "form":
            reason = "the plant's states are nonlinear in the observer's coordinates"
            yield f"{reason}: the gains are those of the form's states"
        for name, values in self.continuous.held.items():
            at = ", ".join(f"{value:g}" for value in values)
            yield f"{name} adapts: the gains are those at {at}, where the core is the fastest"
        if self.sampled.aliased.any():
            beyond = ", ".join(f"{w:g}" for w in self.sampled.omega[self.sampled.aliased])
            rate, are = f"rad/{self.unit}", "are" if self.sampled.aliased.sum() > 1 else "is"
            what = f"{beyond} {rate} {are} beyond the Nyquist frequency pi/dt = {math.pi / self.dt:g} {rate}"
            yield f"{what}: the samples show a slower alias, and the step has no gain there"

    def tables(self) -> Iterator[Any]:
        """Yield a row for each pair and frequency."""
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
    """Compute the effect of sinusoidal noise of an output on each estimate: the amplitude of the error over that of the
    noise, for the linear error core in continuous time and for its step.

    By default at frequencies around the core's poles. With --out the figure is drawn as response.svg and response.png.
    """
    loaded = load(model).set(setting)
    step = loaded.step(observer)
    slow, fast = pace(step.observer)
    expected = f"numbers in rad/{step.time}, such as 50,100,300"
    if omega:
        frequencies = numbers_in(omega, expected, "--omega")
    else:  # from a tenth of the slowest pole to ten times the fastest, below pi/dt, to two digits
        high = min(10 * fast, 0.9 * math.pi / step.dt)
        low = min(max(slow / 10, high / 1e4), high / 10)
        frequencies = tuple(float(f"{value:.2g}") for value in np.geomspace(low, high, COUNT))
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
