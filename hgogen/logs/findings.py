"""Faults of a log, of sensors and of files, each with its samples and the option that mends it.

Of the course x_k of one signal, with the differences d_k = x_k - x_(k-1):

    still     the longest run of one value, over log(N)/log(1/q), the longest by chance of N samples of which the share
              q repeats the one before; while another signal moves, or the model, by this signal alone too:
              the offset of another sensor moves the estimate; `before` where it begins the log
    stale     more samples that repeat the one before than come so near to it, all over the log
    clipped   runs at the largest or least value, which the course meets at full speed
    held      new values in every m-th sample only
    drawn     straight lines between every m-th sample, as an export fills in between slower samples
    code      one value, far from all others, in place of missing ones

Of the normalised innovations n_k = e_k/sqrt(s_k) of an observer, without the first tenth of the log:

    offset    |mean| over its standard error, sqrt(tau/N) times the standard deviation, tau as in `run.consistency`
    drift     the same of the slope of a straight line through them, in place of the mean
    outliers  the median of the squares is that of noise, the mean is not: a few samples, apart from each other
    quantum   steps of a sensor, of which the noise q/sqrt(12) is above the deviation of a sample by R

An offset or drift is that of the signal whose constant, or straight line, takes most of these means or slopes away, by
their change with it, and leaves the innovations smallest; signals that do so equally are named too. Then signals are
tried in other units, with another sign, scale or delay (`logs.changes`).

The limits are chosen so that a healthy log raises nothing; a fault that is smaller than they are is not found.
"""

import math
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from hgogen.call import CallableStep
from hgogen.estimators.noise import sample_deviations
from hgogen.logs.changes import Better, better_change, clear_ratio
from hgogen.logs.finding import Finding, longest, stretches_of
from hgogen.logs.records import Log
from hgogen.logs.trends import Trends, normalised
from hgogen.reading.given import requires
from hgogen.reading.jumps import jumps_by_turns, turn_of, unwrapped_outputs
from hgogen.run.prediction import MOST_REJECTED, Clamped, Rejection, clamped, rejections, rms
from hgogen.run.samples import Engine, Run, table
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
_FAR, _CLOSE = 5.0, 0.3  # ranges of the other values: a code is so far from them, a usual one
_CODES = frozenset((-1.0, 85.0, 127.0, 255.0, 999.0, 4095.0, 9999.0, 32767.0, 65535.0, 99999.0))  # without their sign
_DECIMALS = 11  # significant ones
_SPREAD = 5  # tenths of the log with stale samples
_LEAST_OUTLIERS, _BEYOND = 3, 7.0  # samples; standard deviations of each


@dataclass(frozen=True, eq=False)
class Course:
    """The samples `values` (N,) of a signal, NaN where missing, at the times `t` (N,) from 0 on in the unit `time`.
    `off` (N,): the innovations of an output in standard deviations, NaN where there are none; `alone(k, end)`: the
    innovation at the sample `end` if all other outputs are missing, and this one after the sample k."""

    signal: Signal
    values: Array
    t: Array
    time: str
    off: Array
    alone: Callable[[int, int], float] | None = None

    @property
    def dt(self) -> float:
        """The sampling period, or the mean time between two samples."""
        return float(self.t[-1] / (len(self.t) - 1))

    def stretch(self, first: int, last: int) -> str:
        """Return words for the samples `first` to `last`, with their times."""
        begin = f"{self.t[first]:.6g}"
        if first == last:
            return f"at sample {first} ({begin} {self.time})"
        return f"at samples {first} to {last} ({begin} to {self.t[last]:.6g} {self.time})"

    @cached_property
    def there(self) -> Array:
        """The indices of the samples that are not missing."""
        return np.flatnonzero(np.isfinite(self.values))

    @cached_property
    def present(self) -> Array:
        """The values of the samples that are not missing."""
        return np.asarray(self.values[self.there])

    @cached_property
    def resolution(self) -> float:
        """The last decimal place of the samples, such as 0.01, if they have at most `_DECIMALS` significant digits,
        else 0. It is that of the largest values, which have the fewest decimals if the significant digits are
        limited."""
        largest = float(np.abs(self.present).max()) or 1.0
        first = math.floor(math.log10(largest)) + 1
        values = self.present[np.abs(self.present) >= 10.0 ** (first - 1)]
        for place in range(first, first - _DECIMALS, -1):
            counts = values / 10.0**place
            if np.all(np.abs(counts - np.rint(counts)) < 1e-3):
                return 10.0**place
        return 0.0

    @cached_property
    def quantum(self) -> float:
        """The step q of which all samples are whole multiples; 0 if there is none, or about as many levels as
        samples."""
        levels = np.unique(self.present)
        if not 2 < len(levels) < 0.5 * len(self.present):
            return 0.0
        gaps = np.diff(levels)
        q = float(gaps.min())
        counts = gaps / q
        return q if np.all(np.abs(counts - np.rint(counts)) < 0.02 * np.maximum(1, counts)) else 0.0


def runs(values: Array) -> tuple[Array, Array]:
    """Return the first index and the length of each run of equal values in a sequence (N,)."""
    first = np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))
    return first, np.diff(np.append(first, len(values)))


def still(course: Course, others: Iterable[Course]) -> Iterator[Finding]:
    """Yield the finding that a signal is constant while one of the `others`, or the model's prediction of it, is
    not."""
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
    moving = [other.signal.name for other in others if is_moving(other.values, start, end)]
    if noisy or moving or predicted_motion(course, start, end):
        name, where = course.signal.name, course.stretch(start, end)
        ends = {float(present.max()): "largest", float(present.min()): "least"}
        end_of = ends.get(float(course.values[start]))
        at = f"at its {end_of} value, {course.values[start]:g}, " if end_of else ""
        text = f"{name} stands still {at}{where}, {length} in a row"
        if moving:
            text += f", while {' and '.join(moving)} move{'s' * (len(moving) == 1)}"
        cause = (
            "is it cut off there, or does the sensor hang" if at else "does the sensor hang, or does the plant stick"
        )
        if start == 0:
            cause = "was it filled in before its first sample"
        fix = f"{cause}? --missing {name}={start}..{end} takes them as missing"
        yield Finding(name, "still" if start else "before", ((start, end),), length, strength, text, fix)


def predicted_motion(course: Course, start: int, end: int) -> bool:
    """Return whether the model predicts motion while the signal is constant in the samples `start` to `end`: most
    innovations there are beyond `_STEADILY_OFF`, and so is the deviation when the model, from half of these samples on,
    is corrected by this signal alone."""
    off = np.abs(course.off[start : end + 1])
    if not (np.isfinite(off).any() and np.nanmedian(off) > _STEADILY_OFF):
        return False
    return course.alone is None or not abs(course.alone((start + end) // 2, end)) <= _STEADILY_OFF


def is_moving(values: Array, start: int, end: int) -> bool:
    """Return whether a course (N,) varies by more than a tenth of its range in the samples `start` to `end`; the last
    tenth of them, which may have no effect yet, is not counted."""
    inside, whole = values[start : end + 1 - (end - start) // 10], values[np.isfinite(values)]
    inside = inside[np.isfinite(inside)]
    return len(inside) > 1 and bool(np.ptp(inside) > _MOTION * np.ptp(whole))


def clipped(course: Course) -> Iterator[Finding]:
    """Yield the findings that a signal is clipped at its largest, or at its smallest value."""
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
            fix = f"--missing {course.signal.name}={end:.12g} takes these as missing; the sensor needs a wider range"
            yield Finding(course.signal.name, "clipped", stretches, count, strength, finding, fix)


def every(places: Array) -> int | None:
    """Return the largest m, 2 to 50, of which nearly all gaps between ascending `places` (k) are multiples; None if
    there is none."""
    if len(places) < 8:
        return None
    gaps = np.diff(places)
    for m in range(min(_SLOWEST, int(np.median(gaps))), 1, -1):
        if np.mean(gaps % m == 0) > _REGULAR:
            return m
    return None


def resampled(course: Course, inputs: Iterable[Array]) -> Iterator[Finding]:
    """Yield the finding that a signal has new values, or new slopes, in every m-th sample only; a slope is explained if
    one of the `inputs` (N,) steps at the same samples."""
    there, values, name = course.there, course.present, course.signal.name
    if len(there) < LEAST or np.ptp(there) + 1 != len(there):
        return
    changes = np.flatnonzero(np.diff(values)) + 1
    if (m := every(changes)) is not None:
        period = f"{m * course.dt:g} {course.time}"
        text = f"{name} has a new value in every {m}th sample only, and repeats it in between"
        fix = f"its period is {period}: --missing {name}=repeats, and periods = {{{name} = {m * course.dt:g}}}"
        yield Finding(name, "held", ((0, len(values) - 1),), len(values), float(m), text, fix)
        return
    curvatures = np.abs(np.diff(values, 2))
    straight = curvatures <= 1e-7 * np.abs(values).max() + 1.01 * max(course.quantum, 2 * course.resolution)
    corners = np.flatnonzero(~straight) + 1
    if np.mean(straight) > 0.5 and (m := every(corners)) is not None:
        if any(every(np.flatnonzero(np.diff(u)) + 1) == m for u in inputs):
            return
        text = f"{name} runs in straight lines between every {m}th sample: it was drawn between slower samples"
        options = f"--from row:{int(corners[0]) % m + 1} --every {m}"
        fix = f"it looks ahead by up to {m} samples: take the rows where it was measured, {options}"
        yield Finding(name, "drawn", ((0, len(values) - 1),), len(values), float(m), text, fix)


def codes(course: Course) -> Iterator[Finding]:
    """Yield the finding that a value such as -999 is a code for missing samples."""
    there, values = course.there, course.present
    levels, counts = np.unique(values, return_counts=True)
    for end in (0, -1):
        code, count = float(levels[end]), int(counts[end])
        remaining = values[values != code]
        if len(remaining) < LEAST or not (count > 2 or abs(code) in _CODES):
            continue
        low, high = float(remaining.min()), float(remaining.max())
        far = _CLOSE if abs(code) in _CODES and count > 2 else _FAR
        strength = max(low - code, code - high) / (far * (high - low)) if high > low else 0.0
        if strength > 1:
            at = there[values == code]
            text = f"{course.signal.name} is {code:g} in {count} samples, and {low:g} to {high:g} in all others"
            fix = f"a code for missing samples? --missing {course.signal.name}={code:.12g}"
            yield Finding(course.signal.name, "code", longest(at, at), count, strength, text, fix)


def stale(course: Course) -> Iterator[Finding]:
    """Yield the finding that many single samples repeat the one before, while the other samples differ."""
    change = np.abs(np.diff(course.present))
    repeats, moving = change == 0, change[change > 0]
    if course.quantum or len(moving) < LEAST or not repeats.any():
        return
    by_chance = 0.5 * float(np.sum(moving < 1.5 * moving.min()))  # come as near by chance, on the side above and below
    places = np.flatnonzero(repeats)
    spread = len(np.unique(10 * places // len(change)))
    strength = len(places) / max(_RUN, 4 * by_chance)
    if strength > 1 and spread >= _SPREAD:
        at, name = course.there[places + 1], course.signal.name
        share, first = 100 * len(places) / len(change), course.stretch(int(at[0]), int(at[0]))
        text = f"{len(places)} samples of {name}, {share:.2g} %, repeat the one before, first {first}, as others do not"
        fix = f"stale samples, of a slower sensor or a lost message: --missing {name}=repeats takes them as missing"
        yield Finding(name, "stale", stretches_of(at), len(at), strength, text, fix)


def quantum(course: Course, deviation: float) -> Iterator[Finding]:
    """Yield the finding that the quantum of a sensor is larger than its noise; `deviation`: the standard deviation of a
    sample by R."""
    q, name, unit = course.quantum, course.signal.name, course.signal.unit
    unit = f" {unit}" if unit else ""
    if q / math.sqrt(12) > 2 * deviation:
        text = f"{name} comes in steps of {q:.4g}{unit}, noise of {q / math.sqrt(12):.3g}, and R takes {deviation:.3g}"
        fix = f"give the sensor at least that, noise = {{{name} = {q / math.sqrt(12):.2g}}}"
        whole = ((0, len(course.values) - 1),)
        yield Finding(name, "quantum", whole, len(course.there), q / math.sqrt(12) / (2 * deviation), text, fix)


def pulses(course: Course) -> Iterator[Finding]:
    """Yield the finding that single samples are far from both neighbours while these are close to each other, by r_k =
    x_k - (x_(k-1) + x_(k+1))/2."""
    there, values = course.there, course.present
    r, across = values[1:-1] - (values[:-2] + values[2:]) / 2, np.abs(values[2:] - values[:-2])
    uneven = np.abs(r[r != 0])  # without the stretches in which the course is constant
    middle = 1.4826 * float(np.median(uneven)) if len(uneven) else 0.0
    usual = max(middle, float(np.mean(np.abs(np.diff(values)))) / 10, course.quantum, 1e-300)
    wild = (np.abs(r) > _BEYOND * usual) & (across < 0.3 * np.abs(r))
    at, off = there[np.flatnonzero(wild) + 1], np.abs(course.off)
    predicted = off[at] < _STEADILY_OFF * (np.nanmedian(off) if np.isfinite(off).any() else 0.0)
    at = at[~predicted]
    if len(at) < _LEAST_OUTLIERS:
        return
    name = course.signal.name
    typical, first = float(np.median(np.abs(r[wild]))), int(at[0])
    text = (
        f"{len(at)} samples of {name}, {100 * len(at) / len(there):.2g} % of them, are off both of their neighbours, "
        f"by {typical:.3g} where {usual:.2g} is usual, first {course.stretch(first, first)}"
    )
    fix = f"outliers: fit and tune leave them out by --robust, and a gate rejects them, gate = {{{name} = 0.999}}"
    yield Finding(name, "outliers", longest(at, at), len(at), typical / (_BEYOND * usual), text, fix)


def of_courses(inputs: Sequence[Course], outputs: Sequence[Course], turned: Container[str]) -> Iterator[Finding]:
    """Yield the findings about inputs and outputs that their samples alone reveal, without an observer; an input may be
    constant. `turned`: the names of the outputs that jump by whole turns."""
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
        cut = [] if course.signal.name in turned else [*clipped(course)]
        others = [other for other in signals if other.signal != course.signal]
        hung = [one for one in still(course, others) if not any(one.rows[0] in each.rows for each in cut)]
        slow = [*resampled(course, [other.values for other in inputs])]
        yield from (*cut, *hung, *slow, *(() if slow else stale(course)))
        if not slow and course.signal.name not in turned:
            yield from pulses(course)


def of_turns(step: CallableStep, y: Array) -> Iterator[Finding]:
    """Yield the findings that an output (an angle) jumps by whole turns."""
    for each in unwrapped_outputs(step.observer.form.system.declared):
        for sentence in jumps_by_turns([each], y, step.dt, step.time):
            finding, _, fix = sentence.partition(": ")
            _, at = turn_of(each[1], y[:, each[0]], each[2]) or (0.0, 0)
            yield Finding(each[1].name, "turns", ((at, at),), 1, 2.0, finding, fix)


@dataclass(frozen=True)
class ReadOptions:
    """The command-line options with which a log was read: `before`, the shifts in samples; `operands`, the column of
    each signal as written in an expression; `clock`, the column of times ("" without one); `start`: the first time."""

    before: Mapping[str, int] = field(default_factory=dict)
    operands: Mapping[str, str] = field(default_factory=dict)
    clock: str = ""
    start: float = 0.0
    dt: float = 1.0

    def corrected(self, signal: Signal, size: float, ramp: bool) -> str:
        """Return the option that subtracts from a signal an offset of `size`, or with `ramp` a line with the slope
        `size` a sample."""
        operand = self.operands.get(signal.name, signal.name)
        if not ramp:
            return f'--map {signal.name}="{operand} {"-" if size > 0 else "+"} {abs(size):g}"'
        slope = size / self.dt
        since = f"({self.clock or 't'} - {self.start:.10g})" if self.start else self.clock or "t"
        sign = "-" if slope > 0 else "+"
        state = f"give it a state of its own: {signal.name} + d with d' = 0"
        if not self.clock:
            return state
        return f'--map {signal.name}="{operand} {sign} {abs(slope):.4g}*{since}", or {state}'


@requires(CallableStep, "a step, as hg.sample makes it")
def inspect(step: CallableStep, log: Log) -> tuple[Finding, ...]:
    """Return the faults of a log of a step's plant, by the courses of u (N, m) and y (N, p), and by the innovations of
    the step, which runs over the log from its initial estimate.

    More than 98 of 100 healthy logs have none. Raises: `BadShape` for another number of columns.
    """
    y = table("y", log.y, step.outputs, None)
    samples = replace(log, u=table("u", log.u, step.observer.form.system.supplied, len(y)), y=y).of(step.inputs)
    step.reset(log.start)
    run = step.run(u=samples.u, y=samples.y, dt=samples.given(step))
    written, dt = ReadOptions(dt=step.dt), samples.given(step)
    return tuple(findings(step, run, samples.u, samples.y, engine=step.engine, written=written, dt=dt)[0])


def findings(
    step: CallableStep,
    run: Run,
    u: Array,
    y: Array,
    first: int = 0,
    *,
    engine: Engine | None,
    written: ReadOptions,
    dt: Array | None = None,
) -> tuple[list[Finding], Better | None]:
    """Return the faults of a log u (N, m), y (N, p) over which a step had the results `run`, causes before their
    effects, and a change of signals with which errors from the sample `first` on are smaller; `dt` as for
    `step.run`."""
    step, run = judged(step, run, u, y, engine)
    assert run.innovations is not None  # of a step
    off, turns = normalised(run.innovations, run.variances), [*of_turns(step, y)]
    t = run.t - run.t[0]
    outputs = _courses(step, step.outputs, y, off, t)
    if len(outputs) > 1:
        outputs = [replace(one, alone=partial(_alone, step, u, y, j, engine, dt)) for j, one in enumerate(outputs)]
    turned = {one.signal for one in turns}
    wrong: list[Rejection | Clamped] = [*rejections(step, run, u, y, written.operands, engine, dt)]
    wrong += clamped(step, u, written.operands)
    faults = [*of_courses(_courses(step, step.inputs, u, np.full(u.shape, np.nan), t), outputs, turned)]
    faults += [one for one in turns if one.signal not in {each.signal for each in wrong}]  # the unit first
    whole = ((0, len(y) - 1),)
    change = None if turns else better_change(step, u, y, first, engine, dt)
    if change is not None and wrong:
        wrong, change = ([], change) if {one.signal for one in wrong} & {*change.names} else (wrong, None)
    for one in wrong:
        faults.append(Finding(one.signal, "range", whole, one.count, one.share / MOST_REJECTED, one.finding, one.fix))
    if change is not None:
        text, fix = change.sentence(written.before, written.operands)
        ratio = clear_ratio(change.between) * change.present / max(change.error, 1e-300)
        faults.append(Finding(change.signal, change.fault, whole, len(y), ratio, text, fix))
    deviations, plant = sample_deviations(step), step.observer.form.system.declared
    for course in outputs:
        if (sigma := deviations.get(course.signal.name)) is not None:
            faults += quantum(course, sigma)
    if change is None and not wrong and not turns:
        constants = [x.name for x, rate in zip(plant.states, plant.flow, strict=True) if rate == 0]
        faults += Trends(step, u, y, off, engine, dt).findings(written.corrected, constants)
    return faults, change


def _alone(
    step: CallableStep, u: Array, y: Array, j: int, engine: Engine | None, dt: Array | None, k: int, end: int
) -> float:
    """Return the innovation of output j at the sample `end`, in standard deviations of at most that at sample k, if all
    other outputs are missing, and this one after k; NaN without one."""
    step.reset()
    rows = np.arange(len(y))
    used = np.where((np.arange(y.shape[1]) == j) & ((rows <= k) | (rows == end))[:, None], y, np.nan)
    run = step.run(u=u, y=used, engine=engine, dt=dt)
    assert run.innovations is not None  # of a step
    innovations, last = run.innovations[:, j], rows[: k + 1][np.isfinite(run.innovations[: k + 1, j])]
    deviations = rms(innovations[last]) if run.variances is None else np.sqrt(run.variances[last[-1:], j]).sum()
    return float(innovations[end] / deviations)


def judged(step: CallableStep, run: Run, u: Array, y: Array, engine: Engine | None) -> tuple[CallableStep, Run]:
    """Return the step and the run by which a log u, y is judged. A step for late samples is judged without delays, with
    samples at the rows of their measurement, and with the estimates of the run."""
    if not step.ages:
        return step, run
    return step.undelayed, replace(run, status=step.undelayed.run(u=u, y=y, engine=engine).status)


def _courses(step: CallableStep, signals: Sequence[Signal], values: Array, off: Array, t: Array) -> list[Course]:
    derivatives = derived(step.inputs)
    columns = zip(signals, values.T, off.T, strict=True)
    return [
        Course(s, s.unwrapped(column), t, step.time, each) for s, column, each in columns if s.name not in derivatives
    ]
