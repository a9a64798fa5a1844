"""Prediction errors of an estimate on a measured log: the model continues from the state at sample k, open loop.

    error(h) = RMS over k of y_{k+h} - yhat_{k+h|k},   u known ahead

compared with copying the last measured y, and with the model alone from its first estimate (open loop over the log).
The model is the form's, its nonlinear part evaluated in the declared ranges, by one classical Runge-Kutta step a
sample. A predicted output is limited to its declared range, as the sensor is. A sample that the step rejected counts as
missing, for comparison and for copying. In a log of more than MOST samples k is a random one of each two, three, .., so
that there are at most MOST predictions.

Such errors also identify a column with other units, an offset or another sign than the model declares: its values are
outside the output's range, and the step rejects them. A few maps are tried. Among those that bring nine in ten values
into the declared range we prefer the smallest ratio of the model's error to that of copying; among maps of nearly the
same ratio a map of units, and an offset last.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, ClassVar

import numpy as np

from hgogen.call import CallableStep
from hgogen.discretisation.runge_kutta import OpenLoop, evaluated, open_loop
from hgogen.errors import HgogenError
from hgogen.reading.given import names_of
from hgogen.run.gates import raised
from hgogen.run.samples import Engine, Run, last_values
from hgogen.signal import Signal, differences, resting, with_times
from hgogen.step import Step
from hgogen.stepping.guards import readings

MOST = 100_000  # predictions of each horizon, for an RMS error accurate to half a percent


@dataclass(frozen=True)
class Prediction:
    """RMS errors of the prediction of an output `ahead` samples ahead: by the `model`, and by `copying` the last
    value."""

    output: Annotated[str, "the output"]
    ahead: Annotated[int | None, "samples ahead; null for open loop over the whole record"]
    model: Annotated[float, "error from the estimate"]
    copying: Annotated[float | None, "error of the last measured value"]
    count: Annotated[int, "samples compared"]
    rejected: Annotated[int, "samples of the output that the step rejected, in the whole record"]


@dataclass(frozen=True, eq=False)
class Forecast:
    """Errors (N, p) of predictions `ahead` samples ahead (None: open loop), at the predicted samples: of the `model`,
    and of `copying` the last measured value (None in open loop); `compared` (N, p): the mask of errors."""

    ahead: int | None
    model: np.ndarray
    copying: np.ndarray | None
    compared: np.ndarray


def predictions(
    step: Step, run: Run, u: np.ndarray, y: np.ndarray, ahead: Iterable[int], tick: Callable[[], None] = lambda: None
) -> tuple[Prediction, ...]:
    """Return the RMS errors of predictions of y (N, p) that start from the estimates of a run with inputs u (N, m): for
    each horizon in `ahead` (samples), then in open loop. `tick` is called after each sample up to the longest
    horizon."""
    lost = rejected(step, run, y).sum(axis=0).tolist()
    return tuple(
        Prediction(
            signal.name,
            one.ahead,
            rms(one.model[one.compared[:, j], j]) or 0.0,
            None if one.copying is None else rms(one.copying[one.compared[:, j], j]),
            int(one.compared[:, j].sum()),
            lost[j],
        )
        for one in forecasts(step, run, u, y, ahead, tick)
        for j, signal in enumerate(step.outputs)
        if one.compared[:, j].any()
    )


def forecasts(
    step: Step, run: Run, u: np.ndarray, y: np.ndarray, ahead: Iterable[int], tick: Callable[[], None] = lambda: None
) -> Iterator[Forecast]:
    """Yield the errors (N, p) of predictions of y (N, p) that start from the estimates of a run with inputs u (N, m):
    for each horizon in `ahead` (samples), then in open loop."""
    y = np.where(rejected(step, run, y), np.nan, y)
    holding, limits = bool(step.observer.form.fallback), step.clock.varying
    spent = np.diff(run.t, append=run.t[-1:]) if limits else np.zeros(0)  # to the next sample
    steps = min(math.ceil(spent.max(initial=step.dt) / step.dt), limits.substeps) if limits else 1
    model = open_loop(step.observer.form, None if limits else step.clock.dt, step.clock.between, steps)
    u = _as_used(step, run, u)
    wanted, last, count = sorted(set(ahead)), last_values(y), len(y)
    farthest = max((h for h in wanted if h < count), default=0)
    later = np.concatenate([u, np.repeat(u[-1:], farthest, axis=0)])  # with the last one repeated
    starts = _starts(count)
    spent = np.concatenate([spent, np.zeros(farthest)])[:, None]
    move, read = model.move.map(len(starts)), model.read.map(len(starts))
    z = evaluated(model.entry.map(len(starts)), run.x[starts], u[starts])
    for h in range(1, farthest + 1):
        elapsed = [spent[starts + h - 1]] if limits else []
        z = evaluated(move, z, later[starts + h - 1], later[starts + h], *elapsed)
        tick()
        if h in wanted:
            from_here = starts[starts + h < count]
            predicted = _limited(evaluated(read, z, later[starts + h]), step.outputs, holding)[: len(from_here)]
            yield _compared(step.outputs, h, from_here + h, predicted, y, last[from_here], holding)
    alone = _alone(model, run.x[:1], u, [spent[: count - 1]] if limits else []) if count > 1 else y[:0]
    yield _compared(step.outputs, None, np.arange(1, count), _limited(alone, step.outputs, holding), y, None, holding)


def _alone(model: OpenLoop, first: np.ndarray, u: np.ndarray, elapsed: Sequence[np.ndarray]) -> np.ndarray:
    """Return the outputs (N - 1, p) at inputs u (N, m), but for the first, from the estimate `first` (1, n) alone."""
    start, later = evaluated(model.entry, first, u[:1]), len(u) - 1
    z = evaluated(model.move.mapaccum(later), start, u[:-1], u[1:], *elapsed)
    return evaluated(model.read.map(later), z, u[1:])


def _starts(count: int) -> np.ndarray:
    """Return the samples, of `count`, where predictions start: all,
    or a random one of each few, since sensors may be periodic."""
    few = max(1, -(-count // MOST))
    blocks = np.arange(0, count, few)
    chosen = blocks + np.random.default_rng(0).integers(few, size=len(blocks))
    return np.asarray(np.minimum(chosen, count - 1))


def _compared(
    outputs: tuple[Signal, ...],
    ahead: int | None,
    places: np.ndarray,
    predicted: np.ndarray,
    y: np.ndarray,
    copied: np.ndarray | None,
    holding: bool,
) -> Forecast:
    def at_its_sample(values: np.ndarray) -> np.ndarray:
        errors = np.full(y.shape, np.nan)
        errors[places] = differences(outputs, values, y[places])
        return errors

    there = np.zeros(y.shape, bool)
    there[places] = np.isfinite(y[places]) & (np.isfinite(predicted) | (not holding))
    if copied is None:
        return Forecast(ahead, at_its_sample(predicted), None, there)
    copying = at_its_sample(copied)
    return Forecast(ahead, at_its_sample(predicted), copying, there & np.isfinite(copying))


def rejected(step: Step, run: Run, y: np.ndarray) -> np.ndarray:
    """Return the mask (N, p) of the samples of y that are there, but were rejected by the step."""
    return np.asarray(np.isfinite(y) & raised(step, run.status, ("MISSING", "REJECTED"), names_of(step.outputs)))


def rms(error: np.ndarray) -> float:
    """Return the root mean square of an error; large values do not overflow when squared."""
    most = float(np.abs(error).max(initial=0.0))
    return most * float(np.sqrt(np.mean((error / most) ** 2))) if most else 0.0


def _as_used(step: Step, run: Run, u: np.ndarray) -> np.ndarray:
    """Return the inputs (N, m) as the step used them: the last ones that it did not refuse, then the times of the
    plant."""
    inputs, plant = step.inputs, step.observer.form.system
    holding = last_values(np.where(raised(step, run.status, ("REUSED",), names_of(inputs)), np.nan, u))
    low, high = np.array([s.limits for s in inputs]).reshape(-1, 2).T
    used = np.clip(np.where(np.isnan(holding), list(map(resting, inputs)), holding), low, high)
    return with_times(plant.inputs, used, run.times or [0.0] * len(plant.times), run.t - run.t[:1])


def _limited(y: np.ndarray, outputs: tuple[Signal, ...], holding: bool) -> np.ndarray:
    low, high = np.array([s.limits for s in outputs]).T
    return np.asarray(np.clip(np.where(np.isinf(y) & holding, np.nan, y), low, high))


Array = np.ndarray
MOST_REJECTED = 0.5  # share of rejected samples from which the log does not fit the output
FITS = 0.9  # least share of values that a fitting map brings into the declared range
AHEAD = 5  # samples ahead of the predictions that compare maps
AS_WELL = 1.5  # factor on the least error up to which a map counts as equally good
RADIANS, DEGREES = ("rad", "rad/s", "rad/s^2"), ("deg", "°", "deg/s", "°/s", "deg/s^2")
LENGTHS, ACCELERATIONS = ("m",), ("m/s^2", "m/s2", "m/s**2")
TEMPERATURES = ("K", "degC", "°C", "C")


@dataclass(frozen=True)
class Map:
    """A map y -> scale y + shift of an output, such as a change of unit. `text`: the map as an expression of a column
    {}; `mends`: the cause that the map corrects; `units`: the units of outputs to which the map applies, any if empty;
    `declared`: whether it applies only to outputs with a declared unit."""

    text: str
    scale: float
    shift: float
    mends: str
    units: tuple[str, ...] = ()
    declared: bool = False

    def inside(self, values: Array, ends: tuple[float, float]) -> float:
        """Return the share 0..1 of the values that the map brings into the range `ends`."""
        mapped = self.scale * values + self.shift
        return float(np.mean((mapped >= ends[0]) & (mapped <= ends[1])))

    def fits(self, unit: str, values: Array, ends: tuple[float, float]) -> bool:
        """Return whether the map applies to an output with this `unit` and brings nine in ten of the `values` into the
        range `ends`."""
        return (not self.units or unit in self.units or not (unit or self.declared)) and self.inside(
            values, ends
        ) >= FITS


AS_IT_IS = Map("{}", 1.0, 0.0, "")
MAPS = (
    Map("pi/180*{}", math.pi / 180, 0.0, "degrees, where the model has radians", RADIANS),
    Map("180/pi*{}", 180 / math.pi, 0.0, "radians, where the model has degrees", DEGREES),
    Map("{} + 273.15", 1.0, 273.15, "degrees Celsius, where the model has kelvin", TEMPERATURES[:1]),
    Map("{} - 273.15", 1.0, -273.15, "kelvin, where the model has degrees Celsius", TEMPERATURES[1:]),
    Map("5/9*({} - 32) + 273.15", 5 / 9, 273.15 - 160 / 9, "degrees Fahrenheit, where the model has kelvin", ("K",)),
    Map("5/9*({} - 32)", 5 / 9, -160 / 9, "degrees Fahrenheit, where the model has Celsius", TEMPERATURES[1:]),
    Map("-{}", -1.0, 0.0, "the other sign"),
    Map("{}/1000", 1e-3, 0.0, "a factor of 1000, as of milli"),
    Map("1000*{}", 1e3, 0.0, "a factor of 1000, as of kilo"),
    Map("{}/100", 1e-2, 0.0, "a factor of 100, as of per cent"),
    Map("{}/100", 1e-2, 0.0, "centimetres, where the model has metres", LENGTHS, declared=True),
    Map("9.80665*{}", 9.80665, 0.0, "g, where the model has m/s^2", ACCELERATIONS, declared=True),
)


@dataclass(frozen=True)
class Rejection:
    """An output of which the step rejected most samples, and the map (change of unit, offset) that corrects the
    samples."""

    output: Annotated[str, "the output"]
    count: Annotated[int, "number of its samples"]
    share: Annotated[float, "share of them that the step rejected"]
    values: Annotated[tuple[float, float], "ends of their middle nine in ten"]
    range: Annotated[tuple[float, float], "the range that the model reads"]
    map: Annotated[str, "the map that makes it fit, as --map takes it, or empty"]
    mends: Annotated[str, "what that map mends, or empty"]

    def __str__(self) -> str:
        return f"{self.finding}; {self.fix}"

    @property
    def signal(self) -> str:
        """The name of the output."""
        return self.output

    @property
    def finding(self) -> str:
        """A clause on the rejected samples: their share and values, and the range of the model."""
        (low, high), (least, most) = self.values, self.range
        return (
            f"{100 * self.share:.3g} % of the samples of {self.output} were rejected: they lie about "
            f"{low:.4g}..{high:.4g}, and the model's range is {least:g}..{most:g}"
        )

    @property
    def fix(self) -> str:
        """The command-line option that corrects the samples, or other advice."""
        if not self.map:
            return f"no usual map makes it fit: check column, unit and sign, or widen the range of {self.output}"
        return f'it looks like {self.mends}: say --map {self.output}="{self.map}"'


@dataclass(eq=False)
class MostlyRejected(HgogenError):
    """The error for a log of which the step rejected most samples of an output."""

    status: ClassVar[int] = 1
    rejections: tuple[Rejection, ...]

    def __str__(self) -> str:
        return "; ".join(map(str, self.rejections))


def rejections(
    step: CallableStep,
    run: Run,
    u: Array,
    y: Array,
    columns: Mapping[str, str],
    engine: Engine | None,
    dt: Array | None = None,
) -> tuple[Rejection, ...]:
    """Return a `Rejection` for each output of which a run over u (N, m), y (N, p) rejected most samples; `columns`: the
    column of each output, as written in the option --map; `dt` as for `step.run`."""
    lost, there = rejected(step, run, y), np.isfinite(y)
    ranges = readings(step.observer.form)
    each = []
    for j, signal in enumerate(step.outputs):
        count = int(there[:, j].sum())
        if not count or lost[:, j].sum() <= MOST_REJECTED * count:
            continue
        best = _best(step, u, y, j, ranges[j], partial(step.run, engine=engine, dt=dt))
        low, high = np.quantile(y[there[:, j], j], (0.05, 0.95))
        text, mends = (best.text.format(columns.get(signal.name, signal.name)), best.mends) if best else ("", "")
        share = float(lost[:, j].sum()) / count
        each.append(Rejection(signal.name, count, share, (float(low), float(high)), ranges[j], text, mends))
    return tuple(each)


@dataclass(frozen=True)
class Clamped:
    """An input that is outside of its declared range in most samples: the number of these samples, their share, a
    clause on the cause, and the correction."""

    signal: str
    count: int
    share: float
    finding: str
    fix: str

    def __str__(self) -> str:
        return f"{self.finding}; {self.fix}"


def clamped(step: CallableStep, u: Array, columns: Mapping[str, str]) -> Iterator[Clamped]:
    """Yield each input of u (N, m) that is outside of its declared range in most samples; samples of 0, which are 0 in
    any unit, are not counted. `columns`: the column of each input."""
    for signal, values in zip(step.inputs, u.T, strict=True):
        values, ends = values[np.isfinite(values) & (values != 0)], signal.limits
        beyond = 1 - AS_IT_IS.inside(values, ends) if len(values) else 0.0
        if beyond <= MOST_REJECTED:
            continue
        best = max((one for one in MAPS if one.fits(signal.unit, values, ends)), key=_known, default=None)
        done = "clamped there" if step.clock.guarded else "taken as it is, by a step without guards"
        finding = (
            f"{signal.name} is beyond its declared range, {ends[0]:g}..{ends[1]:g}, in {100 * beyond:.3g} % of the "
            f"samples that are not 0, and {done}"
        )
        fix = "check its column and its unit, or widen the range"
        if best:
            column = columns.get(signal.name, signal.name)
            fix = f'it may be {best.mends}: --map {signal.name}="{best.text.format(column)}"'
        yield Clamped(signal.name, round(beyond * len(values)), beyond, finding, fix)


def _best(
    step: CallableStep, u: Array, y: Array, j: int, ends: tuple[float, float], run: Callable[..., Run]
) -> Map | None:
    values = y[np.isfinite(y[:, j]), j]
    maps = [*MAPS]
    middle = float(np.median(values)) - (ends[0] + ends[1]) / 2
    shift = float(f"{-middle:.3g}") if math.isfinite(middle) else 0.0
    if shift:  # an offset that moves the median of the values to the middle of the range
        text = f"{{}} {'+' if shift > 0 else '-'} {abs(shift):g}"
        maps.append(Map(text, 1.0, shift, f"an offset of about {-shift:g}, unless the range is too narrow"))
    fitting = [one for one in maps if one.fits(step.outputs[j].unit, values, ends)]
    errors = [_error(step, u, y, j, one, run) for one in fitting]
    as_well = [one for one, error in zip(fitting, errors, strict=True) if error <= AS_WELL * min(errors)]
    return max(as_well, key=_known, default=None)


def _known(one: Map) -> tuple[bool, bool, float]:
    return bool(one.units), not one.shift, abs(one.scale)


def _error(step: CallableStep, u: Array, y: Array, j: int, one: Map, run: Callable[..., Run]) -> float:
    y = y.copy()
    y[:, j] = one.scale * y[:, j] + one.shift
    step.reset()
    rows = predictions(step, run(u=u, y=y), u, y, (AHEAD,))
    ratios = [row.model / row.copying for row in rows if row.output == step.outputs[j].name and row.copying]
    return ratios[0] if ratios else math.inf
