"""The state of a plant at the first sample of a log, as the first samples imply it.

    minimise  sum_k sum_j ((y_kj - h_j(x_k, u_k))/sigma_j)^2 + sum_i ((x_i(0) - d_i)/S_i)^2,   x_(k+1) = F(x_k, u_k)

over x(0) by the Gauss-Newton method, with d the start of the observer, where a measured state is its first sample, and
S half of the ranges. The window ends with the 10th sample of each output; sigma is the scatter of an output about its
neighbours, at least the noise of its quantum. A residual of more than 2 typical ones may be an outlier, and counts as 2
of them. A state counts as known if its deviation is below S_i/2.

Where inputs and outputs are constant in the window, up to their noise, the other states are taken at rest: with

    sum_i (r_i/.001)^2,   r_i = (F_i(x, u_0) - x_i)/(sum_j (dF_i/dx_j - delta_ij)^2 S_j^2)^(1/2)

added to the sum, if the result is at rest, |r_i| < .004, and gives the outputs within 4 sigma.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hgogen.call import CallableStep
from hgogen.discretisation.runge_kutta import evaluated, open_loop
from hgogen.logs.records import quantum_of
from hgogen.run.consistency import OF_MEDIAN
from hgogen.signal import Signal, differences, resting

Array = np.ndarray
SAMPLES, ROWS = 10, 200  # of each output, of the log at most
ITERATIONS, HALVINGS = 10, 6
KNOWN = 0.5  # deviation over half of the range of a state that the window determines
CONSTANT, NOISE = 1e-3, 4.0  # change of an input over its range; of an output, or a residual, over its deviation
FAR = 2.0  # typical residuals: an outlier
STEADY = 1e-3  # r of a plant at steady
LEAST, SMALL = 1e-4, 1e-6  # sigma over the spread of an output; difference quotients over half of the range


def first_states(
    step: CallableStep, u: Array, y: Array, elapsed: Array | None, measured: Mapping[str, float], steady: bool = False
) -> dict[str, float]:
    """Return the initial states, by name, that the first samples of a log u (N, m), y (N, p) determine, without those
    in `measured`. `elapsed` (N): the time since the row before, for a step in which dt varies; `steady`: whether to
    return only states of a plant at rest, none if the samples change."""
    form = step.observer.form
    states = [signal for signal, _ in form.estimates]
    size = np.array([(s.interval[1] - s.interval[0]) / 2 if s.bounded else 1.0 for s in states])
    default = {s.name: resting(s) for s in states} | dict(step.observer.initial) | dict(measured)
    d = np.array([default[s.name] for s in states], dtype=float)
    enough = np.flatnonzero((np.isfinite(y[:ROWS]).cumsum(axis=0) >= SAMPLES).all(axis=1))
    if not len(enough) or not (size > 0).all() or {s.name for s in states} <= measured.keys():
        return {}
    rows = slice(0, int(enough[0]) + 1)
    window = _Window(step, u[rows], y[rows], None if elapsed is None else elapsed[rows], _scatter(step.outputs, y))
    if steady and ((np.ptp(u[rows], axis=0) > CONSTANT * np.ptp(u, axis=0)).any() or (window.change > NOISE).any()):
        return {}
    points = d + np.vstack([0 * size, np.diag(SMALL * size)])
    rates = window.rates(points)
    units = np.sqrt((((rates[1:] - rates[0]) / SMALL) ** 2).sum(axis=0)) * STEADY
    moving = (units > 0) & steady  # not of a constant

    def residuals(x: Array) -> Array:
        errors = np.hstack([window.residuals(x), window.rates(x)[:, moving] / units[moving]])
        return np.where(np.isfinite(errors), errors, np.inf)

    low, high = np.array([s.limits for s in states], dtype=float).T
    best = _minimum(residuals, d, size, low, high)
    if best is None or (steady and np.abs(residuals(best.x[None])).max() > NOISE):
        return {}  # as where the log is of something else, or of no plant at rest
    pairs = zip(states, best.x, best.deviation < KNOWN, strict=True)
    return {s.name: float(s.turned(value)) for s, value, sure in pairs if sure and s.name not in measured}


class _Minimum(NamedTuple):
    """The minimum x (n) of the sum, and the deviation (n) of each state there over half of its range."""

    x: Array
    deviation: Array


def _minimum(residuals: Callable[[Array], Array], d: Array, size: Array, low: Array, high: Array) -> _Minimum | None:
    """Return the minimum of the sum of squares by a search from d (n); None if a residual has no value, or no step
    improves on d."""
    x, M = d, np.eye(len(d))
    for _ in range(ITERATIONS):
        errors = residuals(np.vstack([x, x + np.diag(SMALL * size)]))
        if not np.isfinite(errors).all():
            return None
        typical = max(1.0, OF_MEDIAN * float(np.median(np.abs(errors[0]))))
        weights = np.minimum(1, FAR * typical / np.maximum(np.abs(errors[0]), typical))  # of outliers
        J = (weights * (errors[1:] - errors[0])).T / SMALL  # by states over their sizes
        M = J.T @ J + np.eye(len(x))
        change = size * np.linalg.solve(M, -J.T @ (weights * errors[0]) - (x - d) / size)
        candidates = np.vstack([x, np.clip(x + change * 0.5 ** np.arange(HALVINGS)[:, None], low, high)])
        costs = ((weights * residuals(candidates)) ** 2).sum(axis=1) + (((candidates - d) / size) ** 2).sum(axis=1)
        better = 1 + np.flatnonzero(costs[1:] < (1 - 1e-9) * costs[0])
        if not len(better):
            break
        x = candidates[better[0]]
    return None if x is d else _Minimum(x, np.sqrt(np.diag(np.linalg.inv(M))))


def _scatter(outputs: Sequence[Signal], y: Array) -> Array:
    """Return the deviation sigma (p) of each output from the line through its neighbours, at least q/sqrt(12)."""
    sigmas = []
    for signal, column in zip(outputs, y.T, strict=True):
        present = signal.unwrapped(column)
        present = present[np.isfinite(present)]
        scatter = OF_MEDIAN * float(np.median(np.abs(np.diff(present, 2)))) / math.sqrt(6)
        least = max(LEAST * float(np.ptp(present)), np.finfo(float).tiny)
        sigmas.append(max(scatter, quantum_of(column) / math.sqrt(12), least))
    return np.array(sigmas)


class _Window:
    """The first rows of a log, with the model by which they are predicted."""

    def __init__(self, step: CallableStep, u: Array, y: Array, elapsed: Array | None, sigma: Array) -> None:
        self.outputs, self.u, self.y, self.elapsed, self.sigma = step.outputs, u, y, elapsed, sigma
        self.model = open_loop(step.observer.form, None if elapsed is not None else step.clock.dt, step.clock.between)

    @property
    def change(self) -> Array:
        """The mean of each output (p) in the second half of the window minus that in the first, over its deviation."""
        columns = zip(self.outputs, self.y.T, strict=True)
        halves = [np.array_split(each[np.isfinite(each)], 2) for each in (s.unwrapped(column) for s, column in columns)]
        return np.array([abs(b.mean() - a.mean()) * math.sqrt(len(a)) for a, b in halves]) / (1.41 * self.sigma)

    def rates(self, x: Array) -> Array:
        """Return the changes F(x, u_0) - x in a sample (k, n), in the coordinates of the form, for states x (k, n)."""
        u = np.tile(self.u[0], (len(x), 1))
        z = evaluated(self.model.entry.map(len(x)), x, u)
        ahead = [] if self.elapsed is None else [np.full((len(x), 1), self.elapsed[1:].mean())]
        return np.asarray(evaluated(self.model.move.map(len(x)), z, u, u, *ahead) - z)

    def residuals(self, x: Array) -> Array:
        """Return the residuals (k, r) over sigma for initial states x (k, n), infinite where the model diverges."""
        k, parts = len(x), []
        move, read, entry = (f.map(k) for f in (self.model.move, self.model.read, self.model.entry))
        inputs = [np.tile(row, (k, 1)) for row in self.u]
        z = evaluated(entry, x, inputs[0])
        for row, there in enumerate(np.isfinite(self.y)):
            off = differences(self.outputs, np.tile(self.y[row], (k, 1)), evaluated(read, z, inputs[row]))
            parts.append((off / self.sigma)[:, there])
            if row + 1 < len(self.y):
                ahead = [] if self.elapsed is None else [np.full((k, 1), self.elapsed[row + 1])]
                z = evaluated(move, z, inputs[row], inputs[row + 1], *ahead)
        errors = np.concatenate(parts, axis=1)
        return np.where(np.isfinite(errors), errors, np.inf)
