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

A signal that the step accepts is tried with a shift, or negated:

    J = sum over outputs of (RMS error of predictions h ahead, over that of copying)^2,   h = 5

J is the median over `SEGMENTS` segments of the log, since the first depends on a wrong first estimate. Longer shifts
are tried until J has passed its minimum. A common shift of all signals has no effect, so the only output of a plant is
shifted by shifting its inputs: of a plant with one input, an input that acts late and outputs of which all samples come
late give the same log, up to its ends. A shift or sign is better if sqrt(J) is less than `CLEAR` times the present one,
less in nearly all segments, and less than that of copying, since a worse model says nothing about signals. The other
sign, or unit, must also be better than the signal with only its mean so changed: an offset, or a wrong estimate of an
unobservable state, has the effect of the mean.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, ClassVar

import numpy as np

from hgogen.call import CallableStep
from hgogen.discretisation.runge_kutta import evaluated, open_loop
from hgogen.errors import HgogenError
from hgogen.reading.given import names_of
from hgogen.reading.measured import shifted
from hgogen.run.gates import raised
from hgogen.run.samples import Engine, Run, last_values
from hgogen.signal import Signal, derived, differences, resting, with_times
from hgogen.step import Step
from hgogen.stepping.guards import readings

MOST = 100_000  # predictions of each horizon, for an RMS error accurate to half a percent


@dataclass(frozen=True)
class Prediction:
    """RMS errors of predicting an output `ahead` samples ahead: by the `model`, by `copying` the last value."""

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
    """Return the RMS errors of predictions of y (N, p) from the estimates of a run with inputs u (N, m): for each
    number of samples in `ahead`, then in open loop. `tick` is called after each sample up to the longest horizon."""
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
    """Yield the errors (N, p) of predictions of y (N, p) from the estimates of a run with inputs u (N, m), for each
    number of samples in `ahead`, then in open loop."""
    y = np.where(rejected(step, run, y), np.nan, y)
    holding, limits = bool(step.observer.form.fallback), step.clock.varying
    spent = np.diff(run.t, append=run.t[-1:]) if limits else np.zeros(0)  # to the next sample
    steps = min(math.ceil(spent.max(initial=step.dt) / step.dt), limits.substeps) if limits else 1
    model = open_loop(step.observer.form, None if limits else step.clock.dt, step.clock.between, steps)
    u = _as_used(np.where(raised(step, run.status, ("REUSED",), names_of(step.inputs)), np.nan, u), step.inputs)
    plant = step.observer.form.system
    u = with_times(plant.inputs, u, run.times or [0.0] * len(plant.times), step.dt)
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
    alone = np.empty((0, len(step.outputs)))
    if count > 1:
        start = evaluated(model.entry, run.x[:1], u[:1])
        elapsed = [spent[: count - 1]] if limits else []
        alone = evaluated(model.move.mapaccum(count - 1), start, u[:-1], u[1:], *elapsed)
        alone = evaluated(model.read.map(count - 1), alone, u[1:])
    yield _compared(step.outputs, None, np.arange(1, count), _limited(alone, step.outputs, holding), y, None, holding)


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
    """Return the mask (N, p) of the samples of y that the step rejected though they are not missing."""
    return np.asarray(np.isfinite(y) & raised(step, run.status, ("MISSING", "REJECTED"), names_of(step.outputs)))


def rms(error: np.ndarray) -> float:
    """Return the root mean square of an error, without overflow of squares."""
    most = float(np.abs(error).max(initial=0.0))
    return most * float(np.sqrt(np.mean((error / most) ** 2))) if most else 0.0


def _as_used(u: np.ndarray, inputs: tuple[Signal, ...]) -> np.ndarray:
    holding, (low, high) = last_values(u), np.array([s.limits for s in inputs]).reshape(-1, 2).T
    return np.asarray(np.clip(np.where(np.isnan(holding), list(map(resting, inputs)), holding), low, high))


def _limited(y: np.ndarray, outputs: tuple[Signal, ...], holding: bool) -> np.ndarray:
    low, high = np.array([s.limits for s in outputs]).T
    return np.asarray(np.clip(np.where(np.isinf(y) & holding, np.nan, y), low, high))


Array = np.ndarray
MOST_REJECTED = 0.5  # share of rejected samples from which the log does not fit the output
FITS = 0.9  # least share of values that a fitting map brings into the declared range
AHEAD = 5  # samples ahead of the predictions that compare maps, shifts and signs
AS_WELL = 1.5  # factor on the least error up to which a map counts as equally good
ANGLES, TEMPERATURES = ("rad", "deg", "°"), ("K", "degC", "°C", "C")
LEAST_SHIFT = 3  # samples up to which shifts are tried, and beyond the best one
LONGEST = 20_000  # most samples of a comparison
CLEAR = 0.8  # ratio of RMS errors below which one is clearly less; an early input helps an observer that lags
SEGMENTS = 8
LEAST = 10  # samples of a segment


@dataclass(frozen=True)
class Map:
    """A map y -> scale y + shift of an output, such as a change of unit; `text`: the map as expression of a column {},
    `mends`: the cause that it repairs, `units`: the units of outputs to which it applies, any if empty."""

    text: str
    scale: float
    shift: float
    mends: str
    units: tuple[str, ...] = ()

    def inside(self, values: Array, ends: tuple[float, float]) -> float:
        """Return the share 0..1 of the values that the map brings into the range `ends`."""
        mapped = self.scale * values + self.shift
        return float(np.mean((mapped >= ends[0]) & (mapped <= ends[1])))

    def fits(self, unit: str, values: Array, ends: tuple[float, float]) -> bool:
        """Return whether the map applies to an output in this unit and brings its values into the range `ends`."""
        return (not self.units or not unit or unit in self.units) and self.inside(values, ends) >= FITS


AS_IT_IS = Map("{}", 1.0, 0.0, "")
MAPS = (
    Map("pi/180*{}", math.pi / 180, 0.0, "degrees, where the model has radians", ANGLES[:1]),
    Map("180/pi*{}", 180 / math.pi, 0.0, "radians, where the model has degrees", ANGLES[1:]),
    Map("{} + 273.15", 1.0, 273.15, "degrees Celsius, where the model has kelvin", TEMPERATURES[:1]),
    Map("{} - 273.15", 1.0, -273.15, "kelvin, where the model has degrees Celsius", TEMPERATURES[1:]),
    Map("5/9*({} - 32) + 273.15", 5 / 9, 273.15 - 160 / 9, "degrees Fahrenheit, where the model has kelvin", ("K",)),
    Map("5/9*({} - 32)", 5 / 9, -160 / 9, "degrees Fahrenheit, where the model has Celsius", TEMPERATURES[1:]),
    Map("-{}", -1.0, 0.0, "the other sign"),
    Map("{}/1000", 1e-3, 0.0, "a factor of 1000, as of milli"),
    Map("1000*{}", 1e3, 0.0, "a factor of 1000, as of kilo"),
    Map("{}/100", 1e-2, 0.0, "a factor of 100, as of per cent"),
)


@dataclass(frozen=True)
class Rejection:
    """An output most of whose samples the step rejected, and the map (change of unit, offset) that mends it."""

    output: Annotated[str, "the output"]
    count: Annotated[int, "number of its samples"]
    share: Annotated[float, "share of them that the step rejected"]
    values: Annotated[tuple[float, float], "ends of their middle nine in ten"]
    range: Annotated[tuple[float, float], "the range that the model reads"]
    map: Annotated[str, "the map that makes it fit, as --map takes it, or empty"]
    mends: Annotated[str, "what that map mends, or empty"]

    def __str__(self) -> str:
        (low, high), (least, most), y = self.values, self.range, self.output
        finding = (
            f"{100 * self.share:.3g} % of the samples of {y} were rejected: they lie about {low:.4g}..{high:.4g}, and "
            f"the model reads {least:g}..{most:g}"
        )
        if not self.map:
            return f"{finding}; no usual map makes it fit: check column, unit and sign, or widen the range of {y}"
        return f'{finding}; it looks like {self.mends}: say --map {y}="{self.map}"'


@dataclass(eq=False)
class MostlyRejected(HgogenError):
    """An error: the step rejected most samples of a log."""

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
    engine: Engine,
    dt: Array | None = None,
) -> tuple[Rejection, ...]:
    """Return a `Rejection` for each output most of whose samples a run over u (N, m), y (N, p) rejected; `columns`: the
    operand of --map for each output, ready for an expression; `dt` as for `step.run`."""
    lost, there = rejected(step, run, y), np.isfinite(y)
    ranges = readings(step.observer.form)
    each = []
    for j, signal in enumerate(step.outputs):
        count = int(there[:, j].sum())
        if not count or lost[:, j].sum() <= MOST_REJECTED * count:
            continue
        best = _best(step, u, y, j, ranges[j], partial(step.run, engine=engine, dt=dt))
        low, high = np.quantile(y[there[:, j], j], (0.05, 0.95))
        text, mends = (best.text.format(columns[signal.name]), best.mends) if best else ("", "")
        share = float(lost[:, j].sum()) / count
        each.append(Rejection(signal.name, count, share, (float(low), float(high)), ranges[j], text, mends))
    return tuple(each)


def clamped(step: CallableStep, u: Array, columns: Mapping[str, str]) -> Iterator[str]:
    """Yield a sentence for each input of u (N, m) that is outside its range, where guards clamp it, in most samples;
    `columns`: the column of each input."""
    for signal, values in zip(step.inputs, u.T, strict=True):
        values, ends = values[np.isfinite(values)], signal.limits
        beyond = 1 - AS_IT_IS.inside(values, ends) if len(values) else 0.0
        if beyond <= MOST_REJECTED:
            continue
        best = max((one for one in MAPS if one.fits(signal.unit, values, ends)), key=_known, default=None)
        done = "clamped there" if step.clock.guarded else "taken as it is, by a step without guards"
        finding = (
            f"{signal.name} is beyond its declared range, {ends[0]:g}..{ends[1]:g}, in {100 * beyond:.3g} % of the "
            f"samples, and {done}"
        )
        fix = "check its column and its unit, or widen the range"
        if best:
            fix = f'it may be {best.mends}: --map {signal.name}="{best.text.format(columns[signal.name])}"'
        yield f"{finding}; {fix}"


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


FACTORS = {  # of an input that is tried in another unit
    -1.0: ("the other sign of {}", "-{}"),
    1e-3: ("a thousandth of {}, as of milli", "{}/1000"),
    1e3: ("a thousand times {}, as of kilo", "1000*{}"),
    math.pi / 180: ("{} from degrees to radians", "pi/180*{}"),
    180 / math.pi: ("{} from radians to degrees", "180/pi*{}"),
}


@dataclass(frozen=True)
class Better:
    """A signal with which the log fits the model better if it is shifted by samples, or times a factor; errors are
    medians over segments of the log."""

    signal: Annotated[str, "the signal"]
    shift: Annotated[int, "samples later than it was logged"]
    factor: Annotated[float, "-1 for the other sign, else of another unit"]
    error: Annotated[float, "RMS error with it over that of copying"]
    present: Annotated[float, "RMS error as it is over that of copying"]
    late: Annotated[tuple[str, ...], "outputs of which samples that come so late give the same log"] = ()

    def sentence(self, before: int, operand: str) -> str:
        """Return the advice for the command line; `before`: the shift in samples that is set already, `operand`: the
        signal's column in an expression."""
        errors = f"{self.error:.3g} times the error of copying {AHEAD} steps ahead for {self.present:.3g}"
        if self.factor != 1:
            what, text = FACTORS[self.factor]
            other, fix = what.format(self.signal), f'--map {self.signal}="{text.format(operand)}"'
        else:
            count = f"{abs(self.shift)} sample{'s' * (abs(self.shift) > 1)} {'later' if self.shift > 0 else 'earlier'}"
            other, fix = f"{self.signal} taken {count}", f"--shift {self.signal}={before + self.shift}"
        better = f"with {other} predictions are clearly better, {errors}"
        if not self.late:
            return f"{better}: {fix}"
        names, delays = " and ".join(self.late), ", ".join(f"{y} = {self.shift}" for y in self.late)
        ages = " ".join(f'--map {y}_age="{self.shift} + 0*{operand}"' for y in self.late)
        return (
            f"{better}. Two readings fit equally: samples of {names} come {self.shift} late, say delays = {{{delays}}} "
            f"in the model and {ages}, by which the estimate is of now; or {self.signal} acts {self.shift} late, say "
            f"{fix} and delay it in the firmware too. Another output without delay, a --truth, or a look at the "
            "hardware decides"
        )


def better(
    step: CallableStep, u: Array, y: Array, first: int, engine: Engine, dt: Array | None = None
) -> Better | None:
    """Return the shift or sign of a signal with which u (N, m), y (N, p) from `first` on fit better; or None. `dt` as
    for `step.run`; with it no signal is shifted, since samples then count no time."""
    u, y = u[:LONGEST], y[:LONGEST]
    run = partial(step.run, engine=engine, dt=None if dt is None else dt[:LONGEST])
    if len(y) - first < SEGMENTS * LEAST:
        return None
    scale, copying = _scale(step.outputs, y), math.sqrt(y.shape[1])

    def squares(other: tuple[Array, Array]) -> Array:
        return _squares(step, *other, first, scale, run)

    present = squares((u, y))
    if not np.isfinite(present).any():
        return None
    now = _typical(present)
    best: Better | None = None
    for j, signal in enumerate((*step.inputs, *step.outputs)):
        if signal.name in derived(step.inputs) or (j >= u.shape[1] and y.shape[1] == 1):
            continue
        factors = FACTORS if j < u.shape[1] else (-1.0,)
        tried = [(0, factor, squares(_changed(step, u, y, j, 0, factor))) for factor in factors]
        for way in (1, -1) if dt is None else ():
            tried += [(shift, 1.0, those) for shift, those in _shifts(step, u, y, j, way, squares)]
        for shift, factor, those in tried:
            error = _typical(those)
            if not (error < CLEAR * now and error < (best.error if best else copying)):
                continue
            gains = _means(present - those)
            if sum(gain > 0 for gain in gains) < max(2, len(gains) - 1):
                continue  # by chance nearly all are above 0 in one of 28 logs
            others = () if factor == 1 else _alternatives(step, u, y, j, factor)
            if all(error < CLEAR * _typical(squares(other)) for other in others):
                late = step.outputs if u.shape[1] - len(derived(step.inputs)) == 1 > j and shift > 0 else ()
                best = Better(signal.name, shift, factor, error, now, tuple(each.name for each in late))
    return best


def _shifts(
    step: CallableStep, u: Array, y: Array, j: int, way: int, squares: Callable[[tuple[Array, Array]], Array]
) -> Iterator[tuple[int, Array]]:
    """Yield shifts of the signal number `j` and their squared errors, in one direction until the error has been above
    its minimum for a few."""
    least, at = math.inf, 0
    for size in range(1, len(y) // SEGMENTS):
        those = squares(_changed(step, u, y, j, way * size, 1.0))
        yield way * size, those
        error = _typical(those)
        if error < least:
            least, at = error, size
        if size >= LEAST_SHIFT + (at if at > 1 else 0):
            return


def _changed(step: CallableStep, u: Array, y: Array, j: int, shift: int, factor: float) -> tuple[Array, Array]:
    """Return u (N, m), y (N, p) with the signal number `j`, and its derivatives, shifted and times a factor."""
    whole, names = np.hstack([u, y]), [s.name for s in (*step.inputs, *step.outputs)]
    derivatives = (names.index(name) for name, (source, _) in derived(step.inputs).items() if source == names[j])
    columns = [j, *derivatives]
    whole[:, columns] = factor * np.column_stack([shifted(whole[:, i], shift) for i in columns])
    return whole[:, : u.shape[1]], whole[:, u.shape[1] :]


def _alternatives(step: CallableStep, u: Array, y: Array, j: int, factor: float) -> Iterator[tuple[Array, Array]]:
    """Yield u (N, m), y (N, p) with only the mean of the signal number `j` times a factor, and with that mean alone."""
    whole, signal = np.hstack([u, y]), (*step.inputs, *step.outputs)[j]
    mean = signal.mean(whole[:, j])
    for values in (whole[:, j] + (factor - 1) * mean, np.full(len(u), factor * mean)):
        whole[:, j] = values
        yield whole[:, : u.shape[1]].copy(), whole[:, u.shape[1] :].copy()


def _scale(outputs: Sequence[Signal], y: Array) -> Array:
    """The RMS error of copying each output (p); 1 for a constant output."""
    errors = differences(outputs, last_values(y)[:-AHEAD], y[AHEAD:]).T
    return np.array([rms(error[np.isfinite(error)]) or 1.0 for error in errors])


def _squares(step: CallableStep, u: Array, y: Array, first: int, scale: Array, run: Callable[..., Run]) -> Array:
    """Return the sum over outputs of (error/scale)^2 of
    predictions for each sample (N), NaN without an error."""
    if len(y) <= first + AHEAD:
        return np.full(len(y), np.nan)
    step.reset()
    for one in forecasts(step, run(u=u, y=y), u, y, (AHEAD,)):
        if one.ahead is not None:
            with np.errstate(over="ignore", invalid="ignore"):
                squares = np.where(one.compared, (one.model / scale) ** 2, np.nan)
            there = np.isfinite(squares)
            total = np.where(there, squares, 0.0).sum(axis=1)
            total[~there.any(axis=1) | (np.arange(len(y)) < first)] = np.nan
            return np.asarray(total)
    return np.full(len(y), np.nan)


def _typical(squares: Array) -> float:
    """Return the root of the median, over segments of a data
    log, of the mean of `squares` (N); inf without any."""
    means = _means(squares)
    return math.sqrt(float(np.median(means))) if means else math.inf


def _means(values: Array) -> list[float]:
    return [float(np.nanmean(part)) for part in np.array_split(values, SEGMENTS) if np.isfinite(part).any()]
