"""Offsets and slow drifts of signals, found in the innovations of an observer, with the signals that explain them.

    n_j(k) = c_j + noise,   or   n_j(k) = a_j + c_j (k - k_0)/(N - k_0) + noise,   n = e/sqrt(s)

for each output j from the sample k_0 on, outliers left out. The standard error of c counts correlated innovations by
tau, as `run.consistency` does. A signal explains the c_j of all outputs if an offset, or a straight line, taken off it
takes them away: its size is found by Newton's method from the change of c with it, in least squares over the standard
errors. Of such signals the one is named of which the innovations are smallest; one with nearly the same is named too.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hgogen.call import CallableStep
from hgogen.logs.finding import Finding
from hgogen.run.consistency import integrated_autocorrelation_time
from hgogen.run.prediction import rms
from hgogen.run.samples import Engine
from hgogen.signal import Signal, derived

Array = np.ndarray
BEGIN = 0.1  # of the log: its innovations do not count
LEAST = 40  # innovations of an output
ERRORS, SIZE = 6.0, 0.3  # standard errors, standard deviations: least mean of innovations that are off
_BEYOND = 7.0  # standard deviations of an outlier
_EXPLAINED, _ALIKE = 0.1, 1.02  # share of c^2 that may stay; ratio of mean squares of explanations that are alike
_ITERATIONS = 3


@dataclass(frozen=True)
class Coefficient:
    """The estimated coefficient c of a trend in an output's innovations (`value`), its standard error (`error`), and
    the standard deviation of the innovations about the trend (`spread`)."""

    value: float
    error: float
    spread: float

    def strength(self, times: float) -> float:
        """Return the ratio of the coefficient to the limits of detection; `times`: a factor on the limit of its
        size."""
        size = abs(self.value) / (times * SIZE * max(self.spread, 1.0))
        return min(abs(self.value) / (ERRORS * self.error), size) if self.error else 0.0


def normalised(innovations: Array, variances: Array | None) -> Array:
    """Return innovations (N, p) in standard deviations: by the observer's `variances` (N, p), or, if it has none, by
    their RMS."""
    if variances is not None:
        return np.asarray(innovations / np.sqrt(variances))
    return np.asarray(innovations / [rms(e[np.isfinite(e)]) or 1.0 for e in innovations.T])


def coefficient(n: Array, begin: int, ramp: bool) -> Coefficient | None:
    """Return the mean of innovations (N,) from the sample `begin` on or, with `ramp`, their change over the log by a
    straight line; None if there are too few. Outliers are left out."""
    at = np.flatnonzero(np.isfinite(n[begin:])) + begin
    values = n[at]
    if len(values) < LEAST or not np.std(values) > 0:
        return None
    middle = float(np.median(values))
    inside = np.abs(values - middle) <= _BEYOND * max(1.4826 * float(np.median(np.abs(values - middle))), 1e-300)
    at, values = at[inside], values[inside]
    place = (at - begin) / max(len(n) - begin, 1)
    columns = np.column_stack([place, np.ones(len(at))]) if ramp else np.ones((len(at), 1))
    solution = np.linalg.lstsq(columns, values, rcond=None)[0]
    residual = values - columns @ solution
    spread, tau = float(residual.std()), min(integrated_autocorrelation_time(residual), len(values) / 4)
    inverse = float(np.linalg.inv(columns.T @ columns)[0, 0])
    return Coefficient(float(solution[0]), spread * math.sqrt(tau * inverse), spread)


class Explanation(NamedTuple):
    """A signal whose offset (or slope a sample) of this `size` explains the trends in all innovations, with the mean
    square of the innovations after correction (`squares`)."""

    squares: float
    signal: Signal
    size: float


class Fault(NamedTuple):
    """The words for a kind of trend: what the innovations do, with {} for the coefficient, and the name of the fault; a
    factor on the limit of its size."""

    what: str
    name: str
    factor: float


FAULTS = {
    "offset": Fault("have a mean of {:.3g} sigma", "an offset", 1.0),
    "drift": Fault("change steadily by {:.3g} sigma", "a drift", 3.0),
}


@dataclass(frozen=True, eq=False)
class Trends:
    """The trends in the innovations `off` (N, p) of a step over a log u (N, m), y (N, p); `dt` as for `step.run`."""

    step: CallableStep
    u: Array
    y: Array
    off: Array
    engine: Engine | None
    dt: Array | None = None

    @property
    def begin(self) -> int:
        """The first sample whose innovation is counted."""
        return math.ceil(BEGIN * len(self.y))

    @cached_property
    def signals(self) -> tuple[Signal, ...]:
        """The signals of the log: inputs, then outputs."""
        return (*self.step.inputs, *self.step.outputs)

    def coefficients(self, off: Array, ramp: bool) -> list[Coefficient | None]:
        """Return the coefficient of each output in the innovations `off` (N, p): the mean, or the slope with `ramp`."""
        return [coefficient(n, self.begin, ramp) for n in off.T]

    def explanations(self, ramp: bool, now: Sequence[Coefficient | None]) -> list[Explanation]:
        """Return the signals that explain the coefficients `now` by an offset (with `ramp`: a slope a sample), the best
        first."""
        used = [j for j, one in enumerate(now) if one is not None and one.error > 0]
        errors = np.array([one.error for one in now if one is not None and one.error > 0])
        present = np.array([one.value for one in now if one is not None and one.error > 0]) / errors
        course = (np.arange(len(self.y)) if ramp else np.ones(len(self.y)))[:, None]
        whole, rates = np.hstack([self.u, self.y]), derived(self.step.inputs)

        def of(k: int, size: float) -> tuple[Array, float]:
            changed = whole.copy()
            changed[:, [k]] -= size * course
            off = self._off(changed)
            those = self.coefficients(off, ramp)
            values = [math.inf if (c := those[j]) is None else c.value for j in used]
            squares = off[self.begin :] ** 2
            there = squares[np.isfinite(squares)]
            return np.array(values) / errors, float(np.minimum(there, _BEYOND**2).sum()) / max(len(there), 1)

        explained: list[Explanation] = []
        for k, signal in enumerate(self.signals):
            values = whole[np.isfinite(whole[:, k]), k]
            if signal.name in rates or not len(values):
                continue
            scale = 0.1 * (float(np.std(values)) or abs(float(np.mean(values))) or 1.0)
            h = scale / len(self.y) if ramp else scale
            size, at, squares = 0.0, present, math.inf
            for _ in range(_ITERATIONS):
                slope = (of(k, size + h)[0] - at) / h
                if not np.isfinite(slope).all() or not slope @ slope > 0:
                    break
                size -= float(slope @ at) / float(slope @ slope)
                at, squares = of(k, size)
                if not np.isfinite(at).all():
                    break
            if np.isfinite(at).all() and at @ at < _EXPLAINED * (present @ present):
                explained.append(Explanation(squares, signal, float(f"{size:.3g}")))
        explained.sort(key=lambda one: one.squares)
        return [one for one in explained if one.squares <= _ALIKE * explained[0].squares]

    def _off(self, whole: Array) -> Array:
        self.step.reset()
        m = self.u.shape[1]
        with np.errstate(all="ignore"):
            run = self.step.run(u=whole[:, :m], y=whole[:, m:], engine=self.engine, dt=self.dt)
            assert run.innovations is not None  # of a step
            return normalised(run.innovations, run.variances)

    def findings(self, written: Callable[[Signal, float, bool], str], constants: Sequence[str]) -> Iterator[Finding]:
        """Yield the finding of a signal's drift or offset; `written(signal, size, ramp)`: the option that subtracts it;
        `constants`: the states that the model holds constant."""
        present = {fault: self.coefficients(self.off, fault == "drift") for fault in FAULTS}
        strengths = {
            fault: [c.strength(FAULTS[fault].factor) if c else 0.0 for c in now] for fault, now in present.items()
        }
        candidates = []
        for fault, now in present.items():
            if max(strengths[fault]) > 1:
                explained = self.explanations(fault == "drift", now)
                candidates.append((explained[0].squares if explained else math.inf, fault, explained))
        if not candidates:
            return
        _, fault, explained = min(candidates, key=lambda one: one[0])
        ramp, j = fault == "drift", int(np.argmax(strengths[fault]))
        one = present[fault][j]
        assert one is not None  # of the largest strength
        name, errors = self.step.outputs[j].name, abs(one.value) / one.error
        text = (
            f"innovations of {name} {FAULTS[fault].what.format(one.value)}, {errors:.3g} of its standard errors from 0"
        )
        fixes = [
            f"{each.signal.name} has {FAULTS[fault].name}, {written(each.signal, each.size, ramp)}"
            + f" (hgogen fit --offset {each.signal.name} learns it)" * (not ramp and each.signal in self.step.outputs)
            for each in explained
        ]
        fix = ", or equally ".join(fixes) or "no single signal explains it: the model is wrong, or several sensors are"
        if constants:
            fix = f"{fix}, or {', '.join(constants)}, with too small a Q or covariance, does not learn it: raise them"
        rows, signal = ((self.begin, len(self.y) - 1),), explained[0].signal.name if explained else name
        yield Finding(signal, fault, rows, len(self.y) - self.begin, strengths[fault][j], text, fix)
