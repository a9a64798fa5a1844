"""Noise from a quiet record, and the thresholds that follow from it.

    sigma: standard deviation about a straight line;  tau: the lag at which the autocorrelation falls to 1/e
    s^2 = (2/N) (1 + 2 sum_{k=1..N-1} (1 - k/N) rho^k),  rho = exp(-2 dt/tau),  N = d/dt
    gamma_0 = sigma^2 d (1 + k s),  k = 6.5,  gamma_1 = 2 gamma_0

sigma^2 d is the mean of the innovation when nothing but noise is there, s its standard deviation over that mean. The
mean alone, which Boizot, Busvelle, Gauthier 2010 propose as threshold, is exceeded four times in ten; it is the foot.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hgogen.errors import BadArgument

SPREADS = 6.5  # standard deviations of the quiet innovation between its mean and gamma_0
LEAST = 100  # samples without which a standard deviation and a correlation say little


class TooLittle(BadArgument):
    """A record too short, or without any noise, to learn from."""


class BadInterval(BadArgument):
    """An interval of time that is not in the record."""


class BadWindow(BadArgument):
    """A window shorter than the sampling period or longer than the quiet part."""


@dataclass(frozen=True)
class Suggestion:
    """What a quiet record suggests."""

    output: Annotated[str, "the output"]
    samples: Annotated[int, "number of samples"]
    sigma: Annotated[float, "standard deviation about a straight line, in the unit of y"]
    tau: Annotated[float, "correlation time (s); 0: white"]
    d: Annotated[float, "window of the innovation (s)"]
    spread: Annotated[float, "the quiet innovation's spread over its mean"]
    gamma_0: Annotated[float, "theta may rise above it (y^2 s)"]
    gamma_1: Annotated[float, "theta rises fully above it (y^2 s)"]
    R: Annotated[float, "spectral density of the noise (y^2 s)"]
    notes: Annotated[tuple[str, ...], "doubts"]


def quiet(t: np.ndarray, begin: float | None, end: float | None, unit: str = "s") -> np.ndarray:
    """Which of the times t (N,), N >= 2, evenly spaced, lie in begin..end; None: from the first, to the last; times in
    the unit. Raises: `BadInterval` unless the interval lies within the record, to a sample."""
    first, last, dt = float(t[0]), float(t[-1]), float(t[1] - t[0])
    low, high = first if begin is None else begin, last if end is None else end
    if not first - 1.5 * dt < low < high < last + 1.5 * dt:  # 0..10 s holds the samples 0, dt, .. 10 - dt
        reason = f"is not an interval in the record, which runs from {first:g} to {last:g} {unit}"
        fix = "give --from and --to within it, the earlier first"
        raise BadInterval(f"the quiet part {low:g}..{high:g} {unit}", f"{reason}; {fix}")
    inside: np.ndarray = (t >= low) & (t <= high)
    return inside


def suggest(output: str, y: np.ndarray, dt: float, d: float, unit: str = "s") -> Suggestion:
    """sigma, tau and thresholds from y (N,), sampled every `dt`, NaN where missing, for the window `d`, both in the
    unit. Raises: `TooLittle`, `BadWindow`."""
    there = np.isfinite(y)
    if there.sum() < LEAST:
        raise TooLittle(output, f"has {there.sum()} samples; give at least {LEAST} from a quiet part of the record")
    if not dt * (1 - 1e-9) <= d <= len(y) * dt * (1 + 1e-9):
        within = f"{dt:g}..{len(y) * dt:g} {unit}, from the sampling period to the length of the quiet part"
        raise BadWindow(f"the window d = {d:g} {unit}", f"must lie within {within}; give another by --window")
    t = np.arange(len(y)) * dt
    residual = y - np.polyval(np.polyfit(t[there], y[there], 1), t)
    sigma = float(np.std(residual[there], ddof=2))
    if sigma <= 1e-12 * float(np.abs(y[there]).max()):
        raise TooLittle(output, "is constant or a straight line: there is no noise to learn from")
    tau = correlation_time(residual, dt)
    window = max(1, round(d / dt))
    relative = spread(window, dt, tau)
    gamma = sigma**2 * d * (1 + SPREADS * relative)
    rho = math.exp(-dt / tau) if tau else 0.0
    notes = []
    kurtosis = float(np.mean(residual[there] ** 4)) / sigma**4
    if not 2 < kurtosis < 5:  # 3 for noise, 1.5 for a sine, more for steps and outliers
        notes.append(
            f"the values are not spread as noise is (kurtosis {kurtosis:.2g}, not about 3): is this part quiet?"
        )
    if tau > len(y) * dt / 30:
        notes.append(
            f"the correlation time is {tau:.3g} {unit} in a record of {len(y) * dt:.3g} {unit}: this part is not "
            "quiet, or too short; sigma holds the plant's own motion"
        )
    density = sigma**2 * dt * (1 + rho) / (1 - rho)
    return Suggestion(output, int(there.sum()), sigma, tau, d, relative, gamma, 2 * gamma, density, tuple(notes))


def correlation_time(residual: np.ndarray, dt: float) -> float:
    """The lag (s) at which the autocorrelation of a residual (N,), NaN where missing, falls to 1/e; 0 for white noise.

    Between samples the logarithm is interpolated, which is exact for an Ornstein-Uhlenbeck process. White: the first
    lag's correlation is within two standard deviations, 2/sqrt(N), of 0.
    """
    there = np.isfinite(residual).astype(float)
    value = np.where(there > 0, residual, 0.0)
    variance = float(np.sum(value**2) / np.sum(there))
    sums, pairs = _lagged(value), np.maximum(np.rint(_lagged(there)), 1.0)
    last = 1.0
    for lag, now in enumerate((sums[1 : len(value) // 2] / pairs[1 : len(value) // 2] / variance).tolist(), 1):
        if lag == 1 and now < 2 / math.sqrt(float(np.sum(there))):
            return 0.0
        if now <= math.exp(-1):
            if now <= 0:
                return lag * dt
            return float((lag - 1 + (1 + math.log(last)) / math.log(last / now)) * dt)
        last = now
    return len(value) // 2 * dt


def _lagged(value: np.ndarray) -> np.ndarray:
    """The sums over k of value_k value_(k+lag) (N,), by lag; of twice the length, so that the ends do not meet."""
    spectrum = np.abs(np.fft.rfft(value, 2 * len(value))) ** 2
    return np.fft.irfft(spectrum, 2 * len(value))[: len(value)]


def spread(window: int, dt: float, tau: float) -> float:
    """Standard deviation over mean of the innovation of pure noise over `window` samples."""
    if tau == 0:
        return math.sqrt(2 / window)
    k = np.arange(1, window)
    return math.sqrt(2 / window * (1 + 2 * float(np.sum((1 - k / window) * np.exp(-2 * dt / tau * k)))))
