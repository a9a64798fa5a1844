"""Does another time or sign of a signal fit a record better: predictions with it shifted by a few samples, or negated.

    J = sum over outputs of (RMS error of predictions h ahead, over that of copying)^2,   h = 5

the median of `SEGMENTS` of the record, since what a wrong first estimate makes of the first tells nothing of signals.
Shifting all signals alike changes nothing, so that the only output of a plant is shifted by its inputs. Another is
better where sqrt(J) is less than `CLEAR` times what it is, less in nearly all segments, and less than that of copying,
since a model that predicts worse tells nothing of signals. The other sign has to be better as well than the signal with
the mean of its negative, which is all that a signal tells that stands still: a wrong estimate of a hidden state, or an
offset, may do the same.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hgogen.call import CallableStep
from hgogen.calling.samples import Engine, held_last
from hgogen.reading.differences import derived
from hgogen.reading.measured import shifted
from hgogen.trials.prediction import forecasts, rms

Array = np.ndarray
AHEAD, MOST = 5, 3  # samples ahead of the predictions; samples of the shifts tried
LONGEST = 20_000  # samples that are looked at
CLEAR = 0.8  # times the RMS error: clearly less; an observer that lags gains some by an input that comes early
SEGMENTS = 8
LEAST = 10  # samples of a segment


@dataclass(frozen=True)
class Better:
    """A signal taken `shift` samples later, or with its `sign`, and the RMS errors, over those of copying, with it and
    as it is: those of a segment of the record, the median of all."""

    signal: str
    shift: int
    sign: int
    error: float
    present: float

    def sentence(self, before: int, operand: str) -> str:
        """What to say on the command line, where the signal is shifted by `before` already, and its column in an
        expression is `operand`."""
        errors = f"{self.error:.3g} times the error of copying {AHEAD} steps ahead for {self.present:.3g}"
        if self.sign < 0:
            other, fix = f"the other sign of {self.signal}", f'--map {self.signal}="-{operand}"'
        else:
            count = f"{abs(self.shift)} sample{'s' * (abs(self.shift) > 1)} {'later' if self.shift > 0 else 'earlier'}"
            other, fix = f"{self.signal} taken {count}", f"--shift {self.signal}={before + self.shift}"
        return f"with {other} predictions are clearly better, {errors}: {fix}"


def better(step: CallableStep, u: Array, y: Array, first: int, engine: Engine) -> Better | None:
    """The other time or sign of one signal that fits the samples u (N, m), y (N, p) clearly better, from the number
    `first` on; None where none does."""
    u, y = u[:LONGEST], y[:LONGEST]
    if len(y) - first < SEGMENTS * LEAST:
        return None
    scale, copying = _scale(y), math.sqrt(y.shape[1])
    present = _squares(step, u, y, first, scale, engine)
    if not np.isfinite(present).any():
        return None
    now = _typical(present)
    best: Better | None = None
    for signal, shift, sign, other_u, other_y in _others(step, u, y):
        squares = _squares(step, other_u, other_y, first, scale, engine)
        error = _typical(squares)
        if not (error < CLEAR * now and error < (best.error if best else copying)):
            continue
        gains = _means(present - squares)
        if sum(gain > 0 for gain in gains) < max(2, len(gains) - 1):
            continue  # nearly all are above 0 by chance in one of 28 records
        level = _squares(step, *_levelled(step, u, y, signal), first, scale, engine) if sign < 0 else None
        if level is None or error < CLEAR * _typical(level):
            best = Better(signal, shift, sign, error, now)
    return best


def _others(step: CallableStep, u: Array, y: Array) -> Iterator[tuple[str, int, int, Array, Array]]:
    """The signals with another shift or sign: name, shift, sign, and the samples."""
    whole, m = np.hstack([u, y]), u.shape[1]
    names: Sequence[str] = [s.name for s in (*step.inputs, *step.outputs)]
    rates = derived(step.inputs)
    alone = [j for j in range(len(names)) if (j < m or y.shape[1] > 1) and names[j] not in rates]
    shifts = [k for size in range(1, MOST + 1) for k in (size, -size)]
    for j, shift, sign in [(j, 0, -1) for j in alone] + [(j, shift, 1) for j in alone for shift in shifts]:
        other, moved = whole.copy(), [j, *(names.index(name) for name, (of, _) in rates.items() if of == names[j])]
        other[:, moved] = sign * np.column_stack([shifted(whole[:, i], shift) for i in moved])
        yield names[j], shift, sign, other[:, :m], other[:, m:]


def _levelled(step: CallableStep, u: Array, y: Array, signal: str) -> tuple[Array, Array]:
    """The samples with those of one signal about the mean of their negatives."""
    whole = np.hstack([u, y])
    j = [s.name for s in (*step.inputs, *step.outputs)].index(signal)
    values = whole[np.isfinite(whole[:, j]), j]
    whole[:, j] -= 2 * values.mean() if len(values) else 0.0
    return whole[:, : u.shape[1]], whole[:, u.shape[1] :]


def _scale(y: Array) -> Array:
    """The RMS error of copying (p); 1 of an output that stands still."""
    errors = (held_last(y)[:-AHEAD] - y[AHEAD:]).T
    return np.array([rms(error[np.isfinite(error)]) or 1.0 for error in errors])


def _squares(step: CallableStep, u: Array, y: Array, first: int, scale: Array, engine: Engine) -> Array:
    """The sum over outputs of squared errors over `scale` at each sample, NaN where nothing was compared."""
    if len(y) <= first + AHEAD:
        return np.full(len(y), np.nan)
    step.reset()
    for one in forecasts(step, step.run(u=u, y=y, engine=engine), u, y, (AHEAD,)):
        if one.ahead is not None:
            with np.errstate(over="ignore", invalid="ignore"):
                squares = np.where(one.compared, (one.model / scale) ** 2, np.nan)
            there = np.isfinite(squares)
            total = np.where(there, squares, 0.0).sum(axis=1)
            total[~there.any(axis=1) | (np.arange(len(y)) < first)] = np.nan
            return np.asarray(total)
    return np.full(len(y), np.nan)


def _typical(squares: Array) -> float:
    """The root of the median of the means (N,) of segments; infinite where nothing was compared."""
    means = _means(squares)
    return math.sqrt(float(np.median(means))) if means else math.inf


def _means(values: Array) -> list[float]:
    """The mean of each segment in which there are some."""
    return [float(np.nanmean(part)) for part in np.array_split(values, SEGMENTS) if np.isfinite(part).any()]
