"""Faults of a log, of sensors and of files, each with its samples and the option that mends it.

Of the course x_k of one signal, with the differences d_k = x_k - x_(k-1):

    still     the longest run of one value, over log(N)/log(1/q), the longest by chance of N samples of which the share
              q repeats the one before; while another signal moves
    clipped   runs at the largest or least value, which the course meets at full speed
    held      new values in every m-th sample only
    drawn     straight lines between every m-th sample, as an export fills in between slower samples
    code      one value, far from all others, in place of missing ones

Of the normalised innovations e_k/sqrt(s_k) of an observer, without the first tenth of the log:

    offset    |mean| over its standard error, sqrt(tau/N) times the standard deviation, tau as in `run.consistency`
    outliers  the median of the squares is that of noise, the mean is not: a few samples, apart from each other
    quantum   steps of a sensor, of which the noise q/sqrt(12) is above the deviation of a sample by R

The limits are chosen so that a healthy log raises nothing; a fault that is smaller than they are is not found.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np

from hgogen.call import CallableStep
from hgogen.estimators.noise import sample_deviations
from hgogen.logs.records import Log
from hgogen.reading.given import requires
from hgogen.run.consistency import alike
from hgogen.run.prediction import rms
from hgogen.run.samples import Run
from hgogen.sentence import Encoded
from hgogen.signal import Signal, derived

Array = np.ndarray
LEAST = 40  # samples of a course in which faults are searched
_RUN, _BY_CHANCE = 8, 4.0  # samples of a run; times the longest by chance
_RARE, _NOISY = (
    0.1,
    0.3,
)  # share of repeated values, second over first differences: less, and more, where there is noise
_MOTION = 0.1  # of its range in the log: another signal moves
_STEADILY_OFF = 3.0  # standard deviations of the innovations in a run in which the model moves
_PILED = 4.0  # times as many samples at an end as at a level next to it
_REGULAR = 0.95  # share of the changes at every m-th sample
_SLOWEST = 50  # m at most
_FAR = 5.0  # ranges of the other values: a code is so far from them
_CODES = frozenset((-1.0, 85.0, 127.0, 255.0, 999.0, 4095.0, 9999.0, 32767.0, 65535.0, 99999.0))  # without their sign
_BEGIN = 0.1  # of the log: its innovations do not count
_ERRORS, _SIZE = 6.0, 0.3  # standard errors, standard deviations: least mean of innovations that are off
_LEAST_OUTLIERS, _BEYOND = 3, 7.0  # samples; standard deviations of each


@dataclass(frozen=True)
class Finding(Encoded):
    """A fault of a log."""

    signal: Annotated[str, "the signal"]
    fault: Annotated[str, "what is wrong with it, by one word"]
    rows: Annotated[tuple[tuple[int, int], ...], "first and last sample of each stretch, the longest first; 20 at most"]
    count: Annotated[int, "samples concerned"]
    strength: Annotated[float, "its measure over the limit, above 1"]
    finding: Annotated[str, "a sentence"]
    fix: Annotated[str, "what mends it"]

    def __str__(self) -> str:
        return f"{self.finding}: {self.fix}"


@dataclass(frozen=True, eq=False)
class Course:
    """A signal's samples `values` (N,), NaN where missing, at the times `t` (N,) from 0 on in the unit `time`; `off`
    (N,): the innovations of an output in standard deviations, NaN where there is none."""

    signal: Signal
    values: Array
    t: Array
    time: str
    off: Array

    @property
    def dt(self) -> float:
        """The period, or the mean time between two samples."""
        return float(self.t[-1] / (len(self.t) - 1))

    def stretch(self, first: int, last: int) -> str:
        """Return words for the samples `first` to `last`."""
        begin = f"{self.t[first]:.6g}"
        if first == last:
            return f"at sample {first} ({begin} {self.time})"
        return f"at samples {first} to {last} ({begin} to {self.t[last]:.6g} {self.time})"

    @cached_property
    def there(self) -> Array:
        """The numbers of the samples that are not missing."""
        return np.flatnonzero(np.isfinite(self.values))

    @cached_property
    def present(self) -> Array:
        """The samples that are not missing."""
        return np.asarray(self.values[self.there])

    @cached_property
    def quantum(self) -> float:
        """The step q of values that are whole multiples of it, 0 where they have none: as many levels as samples."""
        levels = np.unique(self.present)
        if not 2 < len(levels) < 0.5 * len(self.present):
            return 0.0
        gaps = np.diff(levels)
        q = float(gaps.min())
        counts = gaps / q
        return q if np.all(np.abs(counts - np.rint(counts)) < 0.02 * np.maximum(1, counts)) else 0.0


def runs(values: Array) -> tuple[Array, Array]:
    """Return the first index and the length of each run of equal values (N,)."""
    first = np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))
    return first, np.diff(np.append(first, len(values)))


def still(course: Course, others: Iterable[Array]) -> Iterator[Finding]:
    """Yield the fault of a signal that is constant while one of the `others` (N,), or the model, is not."""
    there, present = course.there, course.present
    first, lengths = runs(present)
    k = int(np.argmax(lengths))
    length, pairs = int(lengths[k]), len(there) - int(lengths[k])
    repeats = (pairs - (len(first) - 1)) / max(pairs, 1)
    by_chance = math.log(len(there)) / -math.log(repeats) if 0 < repeats < 1 else 1.0
    strength = length / max(_RUN, _BY_CHANCE * by_chance)
    if len(first) < 3 or strength <= 1:
        return
    remaining = np.concatenate([present[: first[k]], present[first[k] + length :]])
    noisy = repeats < _RARE and bool(
        np.median(np.abs(np.diff(remaining, 2))) > _NOISY * np.median(np.abs(np.diff(remaining)))
    )
    start, end = int(there[first[k]]), int(there[first[k] + length - 1])
    off = np.abs(course.off[start : end + 1])
    predicted_motion = np.isfinite(off).any() and np.nanmedian(off) > _STEADILY_OFF
    if noisy or predicted_motion or any(is_moving(values, start, end) for values in others):
        name, where = course.signal.name, course.stretch(start, end)
        ends = {float(present.max()): "largest", float(present.min()): "least"}
        end_of = ends.get(float(course.values[start]))
        at = f"at its {end_of} value, {course.values[start]:g}, " if end_of else ""
        text = f"{name} stands still {at}{where}, {length} in a row"
        cause = "is it cut off there, or does the sensor hang" if at else "does the sensor hang, or the plant stick"
        fix = f"{cause}? Take these samples out, or as missing"
        yield Finding(name, "still", ((start, end),), length, strength, text, fix)


def is_moving(values: Array, start: int, end: int) -> bool:
    """Return whether a course (N,) moves by a tenth of its range in the samples `start` to `end`, the last tenth left
    out, which may have no effect yet."""
    inside, whole = values[start : end + 1 - (end - start) // 10], values[np.isfinite(values)]
    inside = inside[np.isfinite(inside)]
    return len(inside) > 1 and bool(np.ptp(inside) > _MOTION * np.ptp(whole))


def clipped(course: Course) -> Iterator[Finding]:
    """Yield the findings that a signal is cut off at its largest, and at its least value."""
    there, values = course.there, course.present
    change = np.abs(np.diff(values))
    moving = change[change > 0]
    if not len(moving):
        return
    first, lengths = runs(values)
    for end, name in ((values.max(), "largest"), (values.min(), "least")):
        at = np.flatnonzero((values[first] == end) & (first > 1))
        if len(at) < 2 or lengths[at].sum() < _RUN:
            continue
        speed = float(np.median(np.abs(values[first[at] - 1] - values[first[at] - 2])))
        levels, counts = np.unique(values, return_counts=True)
        piled = counts[levels == end][0] / counts[np.argsort(np.abs(levels - end))[1:4]].max()
        strength = min(speed / max(0.5 * float(np.median(moving)), 1.5 * course.quantum), piled / _PILED)
        if strength > 1:
            stretches = longest(there[first[at]], there[first[at] + lengths[at] - 1])
            count, text = int(lengths[at].sum()), f"{course.signal.name} is cut off at its {name} value, {end:g}"
            finding = f"{text}, in {count} samples, {len(at)} times, first {course.stretch(*min(stretches))}"
            fix = f"take samples at {end:g} as missing, or give the sensor a wider range"
            yield Finding(course.signal.name, "clipped", stretches, count, strength, finding, fix)


def longest(first: Array, last: Array) -> tuple[tuple[int, int], ...]:
    """Return the stretches `first` to `last` (k), the longest first, 20 at most."""
    order = np.argsort(first - last, kind="stable")[:20]
    return tuple((int(first[k]), int(last[k])) for k in order)


def every(places: Array) -> int | None:
    """Return the largest m, 2 to 50, such that nearly all `places` (k) are at every m-th one; None for none."""
    if len(places) < 8:
        return None
    gaps = np.diff(places)
    for m in range(min(_SLOWEST, int(np.median(gaps))), 1, -1):
        if np.mean(gaps % m == 0) > _REGULAR:
            return m
    return None


def resampled(course: Course, inputs: Iterable[Array]) -> Iterator[Finding]:
    """Yield the finding that a signal has new values, or new slopes, in every m-th sample only; `inputs` (N,) that step
    at the same samples explain a slope."""
    there, values, name = course.there, course.present, course.signal.name
    if len(there) < LEAST or np.ptp(there) + 1 != len(there):
        return
    changes = np.flatnonzero(np.diff(values)) + 1
    if (m := every(changes)) is not None:
        period = f"{m * course.dt:g} {course.time}"
        text = f"{name} has a new value in every {m}th sample only, and repeats it in between"
        fix = f"its period is {period}: leave the repeats empty, and say periods = {{{name} = {m * course.dt:g}}}"
        yield Finding(name, "held", ((0, len(values) - 1),), len(values), float(m), text, fix)
        return
    curvatures = np.abs(np.diff(values, 2))
    straight = curvatures <= 1e-9 * np.abs(values).max() + 1.01 * course.quantum
    corners = np.flatnonzero(~straight) + 1
    if np.mean(straight) > 0.5 and (m := every(corners)) is not None:
        if any(every(np.flatnonzero(np.diff(u)) + 1) == m for u in inputs):
            return
        text = f"{name} runs in straight lines between every {m}th sample: it was drawn between slower samples"
        fix = f"it looks ahead by up to {m} samples: keep every {m}th row, where it was measured"
        yield Finding(name, "drawn", ((0, len(values) - 1),), len(values), float(m), text, fix)


def codes(course: Course) -> Iterator[Finding]:
    """Yield the fault of a value, such as -999, that is a code for missing samples."""
    there, values = course.there, course.present
    levels, counts = np.unique(values, return_counts=True)
    for end in (0, -1):
        code, count = float(levels[end]), int(counts[end])
        remaining = values[values != code]
        if len(remaining) < LEAST or not (count > 2 or abs(code) in _CODES):
            continue
        low, high = float(remaining.min()), float(remaining.max())
        strength = max(low - code, code - high) / (_FAR * (high - low)) if high > low else 0.0
        if strength > 1:
            at = there[values == code]
            text = f"{course.signal.name} is {code:g} in {count} samples, and {low:g} to {high:g} in all others"
            fix = "a code for missing samples? Leave these cells empty"
            yield Finding(course.signal.name, "code", longest(at, at), count, strength, text, fix)


def of_innovations(course: Course, deviation: float | None, constants: Sequence[str]) -> Iterator[Finding]:
    """Yield what the innovations of an output show; `deviation`: of a sample by R, None if the observer has no R;
    `constants`: the states that the model holds constant."""
    begin, name, unit = math.ceil(_BEGIN * len(course.off)), course.signal.name, course.signal.unit
    unit = f" {unit}" if unit else ""
    at = np.flatnonzero(np.isfinite(course.off[begin:])) + begin
    n = course.off[at]
    if len(n) < LEAST or not np.std(n) > 0:
        return
    inside = np.abs(n - np.median(n)) <= _BEYOND * max(1.4826 * float(np.median(np.abs(n - np.median(n)))), 1e-300)
    mean, spread = float(n[inside].mean()), float(n[inside].std())
    tau = min(alike(n[inside] - mean), len(n) / 4)
    errors = abs(mean) / (spread * math.sqrt(tau / inside.sum())) if spread else 0.0
    strength = min(errors / _ERRORS, abs(mean) / (_SIZE * max(spread, 1.0))) if spread else 0.0
    if strength > 1:
        text = f"innovations of {name} have a mean of {mean:.3g} sigma, {errors:.3g} of its standard errors from 0"
        fix = f"a sensor or an input has an offset (of a plant with parameters `hgogen fit --offset {name}` finds it)"
        if constants:
            fix = f"{fix}, or {', '.join(constants)}, held by Q and P(0), does not learn it: raise them"
        yield Finding(name, "offset", ((int(at[0]), int(at[-1])),), len(n), strength, text, fix)
    q = course.quantum
    if deviation is not None and q / math.sqrt(12) > 2 * deviation:
        text = f"{name} comes in steps of {q:.4g}{unit}, noise of {q / math.sqrt(12):.3g}, and R takes {deviation:.3g}"
        fix = f"give the sensor at least that, noise = {{{name} = {q / math.sqrt(12):.2g}}}"
        yield Finding(name, "quantum", (), len(n), q / math.sqrt(12) / (2 * deviation), text, fix)


def pulses(course: Course) -> Iterator[Finding]:
    """Yield the finding that single samples are far from both of their neighbours, r_k = x_k - (x_(k-1) + x_(k+1))/2,
    which are close to each other."""
    there, values = course.there, course.present
    r, across = values[1:-1] - (values[:-2] + values[2:]) / 2, np.abs(values[2:] - values[:-2])
    uneven = np.abs(r[r != 0])  # without the stretches in which the course is constant
    middle = 1.4826 * float(np.median(uneven)) if len(uneven) else 0.0
    usual = max(middle, float(np.mean(np.abs(np.diff(values)))) / 10, course.quantum, 1e-300)
    wild = (np.abs(r) > _BEYOND * usual) & (across < 0.3 * np.abs(r))
    at = there[np.flatnonzero(wild) + 1]
    if len(at) < _LEAST_OUTLIERS:
        return
    name = course.signal.name
    typical, first = float(np.median(np.abs(r[wild]))), int(at[0])
    text = (
        f"{len(at)} samples of {name}, {100 * len(at) / len(there):.2g} % of them, are off both of their neighbours, "
        f"by {typical:.3g} where {usual:.2g} is usual, first {course.stretch(first, first)}"
    )
    fix = f"outliers: take them out, or let a gate reject them, gate = {{{name} = 0.999}}"
    yield Finding(name, "outliers", longest(at, at), len(at), typical / (_BEYOND * usual), text, fix)


def of_courses(inputs: Sequence[Course], outputs: Sequence[Course]) -> Iterator[Finding]:
    """Yield the findings of the inputs, which may stand still, and of the outputs by their courses alone."""
    signals = [*inputs, *outputs]
    for course in signals:
        if len(course.there) < LEAST:
            continue
        coded = [*codes(course)]
        yield from coded
        if course in inputs:
            continue
        for one in coded:
            code = course.values[one.rows[0][0]]
            course = replace(course, values=np.where(course.values == code, np.nan, course.values))
        cut = [*clipped(course)]
        others = [other.values for other in signals if other.signal != course.signal]
        hung = [one for one in still(course, others) if not any(one.rows[0] in each.rows for each in cut)]
        slow = [*resampled(course, [other.values for other in inputs])]
        yield from (*cut, *hung, *slow, *(() if slow else pulses(course)))


@requires(CallableStep, "a step, as hg.sample makes it")
def inspect(step: CallableStep, log: Log) -> tuple[Finding, ...]:
    """Return the faults of a log of a step's plant, by the courses of u (N, m) and y (N, p), and by the innovations of
    the step, which runs over the log from its first estimate.

    A healthy log has none, in 98 of 100 and more. Raises: `BadShape` for another number of columns.
    """
    samples = log.of(step.inputs)
    step.reset(log.start)
    return tuple(findings(step, step.run(u=samples.u, y=samples.y, dt=samples.given(step)), samples.u, samples.y))


def findings(step: CallableStep, run: Run, u: Array, y: Array) -> list[Finding]:
    """Return the faults of a log u (N, m), y (N, p), with the `run` of a step over it."""
    assert run.innovations is not None  # of a step
    sizes = [rms(e[np.isfinite(e)]) or 1.0 for e in run.innovations.T]
    off = run.innovations / (sizes if run.variances is None else np.sqrt(run.variances))
    t = run.t - run.t[0]
    outputs = _courses(step, step.outputs, y, off, t)
    faults = [*of_courses(_courses(step, step.inputs, u, np.full(u.shape, np.nan), t), outputs)]
    deviations, plant = sample_deviations(step), step.observer.form.system.declared
    constants = [x.name for x, rate in zip(plant.states, plant.flow, strict=True) if rate == 0]
    for course in outputs:
        faults += of_innovations(course, deviations.get(course.signal.name), constants)
    return faults


def _courses(step: CallableStep, signals: Sequence[Signal], values: Array, off: Array, t: Array) -> list[Course]:
    derivatives = derived(step.inputs)
    columns = zip(signals, values.T, off.T, strict=True)
    return [
        Course(s, s.unwrapped(column), t, step.time, each) for s, column, each in columns if s.name not in derivatives
    ]
