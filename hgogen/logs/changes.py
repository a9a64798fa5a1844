"""Changes of a log's signals with which it fits the model better: sign, unit, scale, time, and course between samples.

One signal at a time is tried in another unit or with the other sign, times a factor, an angle plus a constant, shifted
by samples, and inputs as held between samples:

    J = mean over outputs of (RMS error of predictions h ahead, over that of copying)^2

h is 5 samples, then 25, where no change is better over 5: the noise of a fast sensor hides the motion of the plant over
few samples. Delays are tried over 5 alone, since they have less effect over many. J is the median over `SEGMENTS`
segments of the log, since the first depends on a wrong first estimate. Longer shifts are tried until J has passed its
minimum. Inputs are shifted together as well: of all of them shifted, as of one input that acts late, the log is that of
outputs which all come late, up to its ends. A change is better if sqrt(J) is less than `CLEAR` times the present one,
less in nearly all segments, and less than that of copying, since a worse model says nothing about signals. Another
course of inputs has a limit of its own, `CLEAR_COURSE`, and must be better than a shift by a sample. A change must also
be clearly better than

    the signal with only its mean so changed: an offset, or a wrong estimate of an unobservable state, has that effect
    the change in the first quarter of the log alone: that may lead a wrong estimate to the right one, which stays

Of changes that fit equally, up to `EQUALLY`, the one of fewest signals is taken, then that with innovations of the size
that the observer expects; the others are named. Where all outputs and inputs but some have the other sign, an odd plant
has the same log as with those others changed.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from hgogen.call import CallableStep
from hgogen.reading.measured import shifted
from hgogen.run.prediction import AHEAD, AS_IT_IS, MAPS, Map, forecasts, rms
from hgogen.run.samples import Engine, last_values
from hgogen.signal import Signal, derived, differences
from hgogen.stepping.guards import readings

Array = np.ndarray
LEAST_SHIFT = 3  # samples up to which shifts are tried, and beyond the best one
LONGEST = 20_000  # most samples of a comparison
CLEAR = 0.8  # ratio of RMS errors below which one is clearly less; an early input helps an observer that lags
CLEAR_COURSE = 0.9  # the same of the course of inputs between samples, of which there are two
EQUALLY = 1.05  # ratio of errors of changes that fit equally
SEGMENTS = 8
HORIZONS = (AHEAD, 25)  # samples ahead
LEAST = 2  # horizons in a segment
OFFSETS = tuple(k / 8 for k in range(-3, 5))  # turns: first offsets of an angle, and none; the best one is refined
SCALES = (0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.4, 2.0, 3.0, 5.0, 7.0, 10.0)  # first factors; the best one is refined
_USUAL = 0.02  # relative difference to a usual factor, which is taken in its place


def clear_ratio(between: str) -> float:
    """Return the ratio of prediction errors, with over without a change, below which the change is clearly better;
    `between`: the tested course of inputs between samples, "" if the change has none."""
    return CLEAR_COURSE if between else CLEAR


@dataclass(frozen=True)
class Change:
    """A change of some signals (by their numbers among inputs, then outputs): by a map such as another unit, or taken
    `shift` samples later; `between`: another course of inputs between samples, "" for the step's own."""

    signals: tuple[int, ...]
    map: Map = AS_IT_IS
    shift: int = 0
    between: str = ""

    @property
    def simplicity(self) -> int:
        """The rank of the kind of change: 0 for a sign or unit, 1 for a scale, 2 for a delay. For an oscillation half a
        period of delay is the other sign, so the simpler one is preferred."""
        return 2 if self.map == AS_IT_IS else int(self.map not in MAPS)


@dataclass(frozen=True)
class Better:
    """A change of signals with which the log fits the model better; errors are medians over segments of the log."""

    signal: Annotated[str, "the signal, or several with commas"]
    shift: Annotated[int, "samples later than it was logged"]
    factor: Annotated[float, "-1 for the other sign, else of another unit or scale"]
    error: Annotated[float, "RMS error with it over that of copying"]
    present: Annotated[float, "RMS error as it is over that of copying"]
    ahead: Annotated[int, "samples ahead of the predictions with these errors"]
    between: Annotated[str, "the course of inputs between samples that fits, or empty"] = ""
    late: Annotated[tuple[str, ...], "outputs of which samples that come so late give the same log"] = ()
    map: Annotated[str, "the map of the signal, of a column {}"] = "{}"
    looks: Annotated[str, "what the signal looks like"] = ""
    equal: Annotated[tuple["Better", ...], "changes that fit equally"] = ()

    @property
    def fault(self) -> str:
        """The kind of change in one word: between, delay, sign, offset (of an angle) or scale (also another unit)."""
        if self.between or self.shift:
            return "between" if self.between else "delay"
        if self.factor == -1:
            return "sign"
        return "offset" if self.factor == 1 and self.map not in {one.text for one in MAPS} else "scale"

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the changed signals."""
        return tuple(self.signal.split(", "))

    def fix(self, before: Mapping[str, int], operands: Mapping[str, str]) -> str:
        """Return the command-line options that make the change; the arguments are those of `sentence`."""
        held = [f'between = "{self.between}" in the table of the observer'] if self.between else []
        shifts = [f"--shift {name}={before.get(name, 0) + self.shift}" for name in self.names if self.shift]
        maps = [f'--map {n}="{self.map.format(operands.get(n, n))}"' for n in self.names if self.map != "{}"]
        return " ".join([*maps, *(" and ".join([*held, " ".join(shifts)] if shifts else held),)]).strip()

    def sentence(self, before: Mapping[str, int], operands: Mapping[str, str]) -> tuple[str, str]:
        """Return a clause on how the signal differs, and the advice for the command line; `before`: the shifts in
        samples that are set already, `operands`: the column of each signal, as written in an expression."""
        errors = (
            f"predictions {self.ahead} steps ahead have {self.error:.3g} times the error of copying the last "
            f"value, and {self.present:.3g}"
        )
        finding, fix = f"{self.what}: with the change {errors} without", self.fix(before, operands)
        fix = "".join([fix, *(f", or equally {one.what}, {one.fix(before, operands)}" for one in self.equal)])
        if not self.late:
            return finding, fix
        names, age, acts = " and ".join(self.late), abs(self.shift), "act" if len(self.names) > 1 else "acts"
        delays = ", ".join(f"{y} = {age}" for y in self.late)
        clock = operands.get(self.names[0], self.names[0])
        ages = " ".join(f'--map {y}_age="{age} + 0*{clock}"' for y in self.late)
        lag = f"hgogen fit --lag {','.join(self.late)} tells whether a first-order lag fits instead"
        sensor = (
            f"say delays = {{{delays}}} in the table of the observer and {ages}, by which the estimate is that "
            "of the present time"
        )
        if self.signal in self.late:
            return finding, f"{sensor}, or {fix} for this log alone; {lag}"
        inputs = f"{' and '.join(self.names)} {acts}"
        held = (
            f"if {inputs} from its row to the next, as a command does, say {fix}: a call takes the input that acted "
            "before it. Else "
        )
        return finding, (
            f"{held if self.shift == 1 else ''}two explanations fit equally: samples of {names} come {age} late, "
            f"{sensor}; or {inputs} {age} late, say {fix}, and delay it in the firmware too. Another output without "
            "delay, "
            f"--truth, or a look at the hardware tells which; {lag}"
        )

    @property
    def what(self) -> str:
        """A clause on how the signal differs, such as "y looks like degrees"."""
        names, looks = " and ".join(self.names), "look" if len(self.names) > 1 else "looks"
        if self.between:
            course = "held from sample to sample" if self.between == "hold" else "on a line from sample to sample"
            return f"{names} {looks} {course}" + (f", from its own sample on, {self.shift} later" if self.shift else "")
        if self.shift:
            count = f"{abs(self.shift)} sample{'s' * (abs(self.shift) > 1)} {'later' if self.shift > 0 else 'earlier'}"
            fits = "fit if they are" if len(self.names) > 1 else "fits if it is"
            return f"{names} {fits} taken {count}"
        return f"{names} {looks} like {self.looks}"


def better_change(
    step: CallableStep, u: Array, y: Array, first: int, engine: Engine | None, dt: Array | None = None
) -> Better | None:
    """Return the change of signals (unit, sign, scale, delay) with which the log u (N, m), y (N, p) fits the model
    better, by errors from the sample `first` on; None without one. `dt` as for `step.run`; where dt varies no signal is
    shifted, since a number of samples is no fixed time then."""
    u, y, dt = u[:LONGEST], y[:LONGEST], None if dt is None else dt[:LONGEST]
    trials = (ChangeTrial(step, u, y, first, engine, dt, h) for h in HORIZONS)
    return next(filter(None, map(_better, trials)), None)


def _better(trial: "ChangeTrial") -> Better | None:
    """Return the change with which predictions so many samples ahead are clearly better, or None."""
    if not math.isfinite(trial.now):
        return None
    clear: dict[Change, float] = {}
    for change in trial.changes():
        error = trial.error(change)
        equally = EQUALLY * min(clear.values(), default=math.inf)
        limit = min(clear_ratio(change.between) * trial.now, 1.0, equally)
        if error < limit and trial.is_clear(change):
            clear[change] = error
    if not clear:
        return None
    equal = [one for one in clear if clear[one] <= EQUALLY * min(clear.values())]
    equal.sort(key=lambda one: (one.simplicity, clear[one]), reverse=True)
    simplest = {one.signals: one for one in equal}.values()
    best, *others = sorted(simplest, key=lambda one: (len(one.signals), trial.misfit(one)))
    if best.map == NEGATED and (unchanged := tuple(sorted({*trial.free} - {*best.signals}))):
        complement = replace(best, signals=unchanged)
        if complement not in others and trial.error(complement) < EQUALLY * clear[best]:
            others.append(complement)
    return replace(trial.named(best), equal=tuple(map(trial.named, others)))


NEGATED = next(one for one in MAPS if one.scale == -1)


@dataclass(frozen=True, eq=False)
class ChangeTrial:
    """A step on a log u (N, m), y (N, p) on which changes of signals are tried; prediction errors count from the sample
    `first` on."""

    step: CallableStep
    u: Array
    y: Array
    first: int
    engine: Engine | None
    dt: Array | None = None
    ahead: int = HORIZONS[0]
    _known: dict[tuple[Any, ...], Array] = field(default_factory=dict)

    @cached_property
    def signals(self) -> tuple[Signal, ...]:
        """The signals of the log: inputs, then outputs."""
        return (*self.step.inputs, *self.step.outputs)

    @cached_property
    def free(self) -> tuple[int, ...]:
        """The numbers of the signals that may be changed: all but the derivatives of other signals."""
        return tuple(j for j, signal in enumerate(self.signals) if signal.name not in self._rates)

    @cached_property
    def _rates(self) -> Mapping[str, tuple[str, int]]:
        return derived(self.step.inputs)

    @cached_property
    def inputs(self) -> tuple[int, ...]:
        """The numbers of the inputs among the signals in `free`."""
        return tuple(j for j in self.free if j < self.u.shape[1])

    @cached_property
    def now(self) -> float:
        """The prediction error sqrt(J) of the unchanged log; infinite if the log is too short."""
        return self.error(Change(()))

    def changes(self) -> Iterator[Change]:
        """Yield the changes to try; later ones depend on the errors of earlier ones."""
        for j in self.free:
            unit, ends, values = self.signals[j].unit, self._ranges[j], self.values[:, j]
            values = values[np.isfinite(values)]
            if self.signals[j].period:  # modulo a turn no other factor makes sense
                yield Change((j,), NEGATED)
                yield from self._offsets(j)
                continue
            usual = [one for one in MAPS if one.fits(unit, values, ends) and (unit or not one.shift)]
            yield from (Change((j,), one) for one in usual)
            yield from self._scales(j, [one.scale for one in usual if not one.shift])
        if self.dt is not None or self.ahead != HORIZONS[0]:
            return
        groups: list[tuple[int, ...]] = [(j,) for j in self.free if j in self.inputs or self.y.shape[1] > 1]
        groups += [self.inputs] if len(self.inputs) > 1 else []
        for group in groups:
            for way in (1, -1):
                yield from self._shifts(group, way)
        if self.inputs:
            course = "line" if self.step.clock.between == "hold" else "hold"
            yield from (Change(self.inputs, shift=k, between=course) for k in (0, 1))

    def _scales(self, j: int, usual: Sequence[float]) -> Iterator[Change]:
        """Yield changes of the signal number `j` by factors: the best of `SCALES` is refined by parabolas."""

        def of(log: float) -> Change:
            factor = float(f"{math.exp(log):.3g}")
            usual_ones = [each for each in (*usual, *SCALES) if abs(factor / each - 1) < _USUAL]
            factor = min(usual_ones, key=lambda each: abs(factor - each), default=factor)
            text = f"{factor:g}*{{}}" if factor >= 1 else f"{{}}/{1 / factor:.4g}"
            return Change(
                (j,),
                Map(
                    text,
                    factor,
                    0.0,
                    f"itself times {1 / factor:.3g}, by a gear or an amplifier, or by a parameter of the model",
                ),
            )

        logs = [math.log(scale) for scale in SCALES]
        yield from self._refined(of, logs, (0.2, 0.1, 0.05, 0.02))

    def _offsets(self, j: int) -> Iterator[Change]:
        """Yield changes of the angle number `j` by a constant: the best of `OFFSETS` is refined by halving."""
        turn, unit = self.signals[j].period, self.signals[j].unit

        def of(offset: float) -> Change:
            c = float(f"{offset:.3g}")
            looks = f"itself {'-+'[c < 0]} {abs(c):g} {unit}".rstrip() + ", as of a sensor that is mounted turned"
            return Change((j,), Map(f"{{}} {'+-'[c < 0]} {abs(c):g}", 1.0, c, looks))

        assert turn is not None  # of an angle
        yield from self._refined(of, [turn * k for k in OFFSETS], [turn / 2**k for k in range(4, 10)])

    def _refined(
        self, of: Callable[[float], Change], values: Iterable[float], widths: Iterable[float]
    ) -> Iterator[Change]:
        """Yield the best change `of` a number among `values`, and the best with this number moved by the `widths`;
        nothing if it errs more than no change."""

        def error(value: float) -> float:
            return self.error(of(value))

        at = min(values, key=error)
        if error(at) > self.now:
            return
        yield of(at)
        for width in widths:
            at = min((at - width, at, at + width), key=error)
        yield of(at)

    def _shifts(self, group: tuple[int, ...], way: int) -> Iterator[Change]:
        """Yield shifts of signals by more and more samples in the direction `way` (1 or -1), until the error has passed
        its minimum."""
        least, at = math.inf, 0
        for size in range(1, len(self.y) // SEGMENTS):
            yield (change := Change(group, shift=way * size))
            error = self.error(change)
            if error < least:
                least, at = error, size
            if size >= LEAST_SHIFT + (at if at > 1 else 0):
                return

    @cached_property
    def _ranges(self) -> tuple[tuple[float, float], ...]:
        return *(signal.limits for signal in self.step.inputs), *readings(self.step.observer.form)

    @cached_property
    def values(self) -> Array:
        """The samples of inputs and outputs side by side (N, m + p)."""
        return np.hstack([self.u, self.y])

    def changed(self, change: Change) -> Array:
        """Return the samples (N, m + p) after a change of signals, which changes their derivatives too."""
        whole, names = self.values.copy(), [s.name for s in self.signals]
        for j in change.signals:
            one = change.map
            whole[:, j] = shifted(one.scale * self.signals[j].unwrapped(whole[:, j]) + one.shift, change.shift)
            for name, (source, _) in self._rates.items():
                if source == names[j]:
                    k = names.index(name)
                    whole[:, k] = shifted(one.scale * whole[:, k], change.shift)
        return whole

    def error(self, change: Change) -> float:
        """Return the prediction error sqrt(J) after a change of signals."""
        return _typical(self._squares(change))

    def is_clear(self, change: Change) -> bool:
        """Return whether a change is better in nearly all segments, and clearly better than changing only the mean of
        the signal, and than changing only the first quarter of the log."""
        gains = _means(self._squares(Change(())) - self._squares(change))
        if sum(gain > 0 for gain in gains) < max(2, len(gains) - 1):
            return False  # by chance nearly all are above 0 in one of 28 logs
        if any(self.error(change) >= CLEAR * _typical(self._of(other)) for other in self._alternatives(change)):
            return False
        if change.between:
            return all(self.error(change) < self.error(Change(self.inputs, shift=k)) for k in (1, -1))
        half = np.arange(len(self.y)) >= len(self.y) // 2
        begun = self.values.copy()
        begun[: len(begun) // 4] = self.changed(change)[: len(begun) // 4]
        later, other = (np.where(half, each, np.nan) for each in (self._squares(change), self._of(begun)))
        return _typical(later) < CLEAR * _typical(other)

    def _alternatives(self, change: Change) -> Iterator[Array]:
        """Yield the samples (N, m + p) in which only the mean of the changed signals is scaled; for inputs also with
        this mean alone."""
        if change.map.scale == 1:
            return
        for part in (1.0, 0.0) if {*change.signals} <= {*self.inputs} else (1.0,):
            whole = self.values.copy()
            for j in change.signals:
                mean = self.signals[j].mean(whole[:, j])
                whole[:, j] = part * (whole[:, j] - mean) + change.map.scale * mean
            yield whole

    def _squares(self, change: Change) -> Array:
        key = (change.signals, change.map.scale, change.map.shift, change.shift, change.between)
        if key not in self._known:
            step = self.step.rebuilt(between=change.between) if change.between else self.step
            self._known[key] = self._of(self.changed(change), step)
        return self._known[key]

    def _of(self, whole: Array, step: CallableStep | None = None) -> Array:
        """Return the mean over outputs of (error/scale)^2 of predictions for each sample (N), NaN without an error. An
        output with few samples weighs as much as others: each sample counts by the inverse of their share."""
        step, (u, y) = step or self.step, (whole[:, : self.u.shape[1]], whole[:, self.u.shape[1] :])
        nothing = np.full(len(y), np.nan)
        if len(y) - self.first < SEGMENTS * LEAST * self.ahead:
            return nothing
        step.reset()
        with np.errstate(all="ignore"):
            scale = _scale(step.outputs, y, self.ahead)
            for one in forecasts(step, step.run(u=u, y=y, engine=self.engine, dt=self.dt), u, y, (self.ahead,)):
                if one.ahead is not None:
                    squares = np.where(one.compared, (one.model / scale) ** 2, np.nan)
                    there = np.isfinite(squares)
                    compared = there.any(axis=1)
                    weights = compared.sum() / np.maximum(there.sum(axis=0), 1) / max(there.any(axis=0).sum(), 1)
                    mean = np.where(there, squares, 0.0) @ weights
                    return np.where(compared & (np.arange(len(y)) >= self.first), mean, np.nan)
        return nothing

    def misfit(self, change: Change) -> float:
        """Return |log NIS| of the step after a change: by how much its innovations differ from their expected size."""
        whole = self.changed(change)
        self.step.reset()
        u, y = whole[:, : self.u.shape[1]], whole[:, self.u.shape[1] :]
        run = self.step.run(u=u, y=y, engine=self.engine, dt=self.dt)
        if run.variances is None or run.innovations is None:
            return 0.0
        ratio = run.innovations**2 / run.variances
        nis = float(np.median(ratio[np.isfinite(ratio)])) if np.isfinite(ratio).any() else math.inf
        return abs(math.log(nis)) if 0 < nis < math.inf else math.inf

    def named(self, change: Change) -> Better:
        """Return a change as `Better`, with the names of its signals and its errors."""
        names = ", ".join(self.signals[j].name for j in change.signals)
        outputs = tuple(s.name for s in self.step.outputs)
        late: tuple[str, ...] = ()
        if change.shift and not change.between:
            if change.signals == self.inputs and change.shift > 0:
                late = outputs
            elif names in outputs and change.shift < 0:
                late = (names,)
        one = change.map
        errors = self.error(change), self.now
        return Better(names, change.shift, one.scale, *errors, self.ahead, change.between, late, one.text, one.mends)


def _scale(outputs: Sequence[Signal], y: Array, ahead: int) -> Array:
    """Return the RMS error of copying each output (p) so many samples ahead; 1 for a constant output."""
    errors = differences(outputs, last_values(y)[:-ahead], y[ahead:]).T
    return np.array([rms(error[np.isfinite(error)]) or 1.0 for error in errors])


def _typical(squares: Array) -> float:
    """Return the root of the median, over segments of a data
    log, of the mean of `squares` (N); inf without any."""
    means = _means(squares)
    return math.sqrt(float(np.median(means))) if means else math.inf


def _means(values: Array) -> list[float]:
    return [float(np.nanmean(part)) for part in np.array_split(values, SEGMENTS) if np.isfinite(part).any()]
