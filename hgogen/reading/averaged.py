"""An input on the step's grid from a log that is faster, or irregular: its mean over the time that a sample stands for.

    u_k = 1/(b - a) integral over [a, b] of the log, each row's value held until the next,   a, b = t_k + window dt

so that the integral is kept: charge, volume or heat, whatever happened between two samples. The window is that of what
the step makes of u between samples: half a step to both sides where it goes on the line from one to the next, whose
integral is dt (u_0/2 + u_1 + .. + u_N/2); the step before where a value is the one applied since the last sample.
"""

import numpy as np

Array = np.ndarray
Window = tuple[float, float]
WINDOWS: dict[str, Window] = {"line": (-0.5, 0.5), "hold": (-1.0, 0.0), "forward": (0.0, 1.0)}
FASTER = 0.75  # of the step: a log with a shorter period is averaged
UNEVEN, SHARE = 0.25, 0.1  # of the period, of the rows: more of them so far off it make a log irregular
HELD = 10.0  # typical periods for which a row's value is held: a longer silence is a gap


def wanted(steps: Array, period: float, dt: float) -> bool:
    """Whether inputs are averaged, of the times between rows (N,), their typical `period` and the step `dt`."""
    uneven = np.abs(steps / period - 1) > UNEVEN if period else np.zeros(0, bool)
    return bool(period < FASTER * dt or (len(uneven) and uneven.mean() > SHARE))


def averaged(times: Array, values: Array, first: float, samples: int, dt: float, window: Window, hold: float) -> Array:
    """The means (samples,) of a column (N,) at ascending times (N,) over the windows about first + k dt; from the
    first number on where the one before it is more than the time `hold` old; NaN where there is none."""
    there = np.isfinite(values)
    times, index = np.unique(times[there], return_index=True)
    if not len(times):
        return np.full(samples, np.nan)
    values = values[there][index]
    grid = first + np.arange(samples) * dt
    end = max(float(grid[-1]), float(times[-1]))
    knots = np.append(times, end + dt)
    integral = np.concatenate([[0.0], np.cumsum(values * np.diff(knots))])
    low, high = (np.clip(grid + edge * dt, first, end) for edge in window)
    at = np.searchsorted(times, low + 1e-9 * dt, "right") - 1
    stale = np.where(at < 0, True, low - times[np.maximum(at, 0)] > hold)
    low = np.where(stale, np.append(times, np.inf)[at + 1], low)  # the next number is the first that counts
    at = np.where(stale, np.minimum(at + 1, len(times) - 1), at)
    length = high - low
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (np.interp(high, knots, integral) - np.interp(low, knots, integral)) / length
    mean = np.where(length > 1e-9 * dt, mean, values[at])
    return np.asarray(np.where(~stale | (length > 1e-9 * dt), mean, np.nan))
