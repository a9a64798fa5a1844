"""The state of a plant at the first sample of a log, as the first samples imply it.

    minimise  sum_k sum_j ((y_kj - h_j(x_k, u_k))/sigma_j)^2 + sum_i ((x_i(0) - d_i)/S_i)^2,   x_(k+1) = F(x_k, u_k)

over x(0) by the Gauss-Newton method, with d the start of the observer, where a measured state is its first sample, and
S half of the ranges. The window ends with the 10th sample of each output; sigma is the scatter of an output about its
neighbours, at least the noise of its quantum. A state counts as known if its deviation is below S_i/2.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from hgogen.call import CallableStep
from hgogen.discretisation.runge_kutta import evaluated, open_loop
from hgogen.logs.records import quantum_of
from hgogen.signal import Signal, differences, resting

Array = np.ndarray
SAMPLES, ROWS = 10, 200  # of each output, of the log at most
ITERATIONS, HALVINGS = 10, 6
KNOWN = 0.5  # deviation over half of the range of a state that the window determines
LEAST, SMALL = 1e-4, 1e-6  # sigma over the spread of an output; difference quotients over half of the range


def first_states(
    step: CallableStep, u: Array, y: Array, elapsed: Array | None, measured: Mapping[str, float]
) -> dict[str, float]:
    """Return the initial states, by name, that the first samples of a log u (N, m), y (N, p) determine, without the
    `measured` ones; `elapsed` (N): the time since the row before, for a step in which dt varies."""
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
    low, high = np.array([s.limits for s in states], dtype=float).T
    x = d
    for _ in range(ITERATIONS):
        points = np.vstack([x, x + np.diag(SMALL * size)])
        errors = window.residuals(points)
        if not np.isfinite(errors).all():
            return {}
        J = (errors[1:] - errors[0]).T / SMALL  # by states over their sizes
        M = J.T @ J + np.eye(len(x))
        move = size * np.linalg.solve(M, -J.T @ errors[0] - (x - d) / size)
        candidates = np.clip(x + move * 0.5 ** np.arange(HALVINGS)[:, None], low, high)
        costs = (window.residuals(candidates) ** 2).sum(axis=1) + (((candidates - d) / size) ** 2).sum(axis=1)
        better = np.flatnonzero(costs < (1 - 1e-9) * float(errors[0] @ errors[0] + (((x - d) / size) ** 2).sum()))
        if not len(better):
            break
        x = candidates[better[0]]
    if x is d:  # as where the log is of something else
        return {}
    known = np.sqrt(np.diag(np.linalg.inv(M))) < KNOWN
    pairs = zip(states, x, known, strict=True)
    return {s.name: float(s.turned(value)) for s, value, sure in pairs if sure and s.name not in measured}


def _scatter(outputs: Sequence[Signal], y: Array) -> Array:
    """Return the deviation sigma (p) of each output from the line through its neighbours, at least q/sqrt(12)."""
    sigmas = []
    for signal, column in zip(outputs, y.T, strict=True):
        present = signal.unwrapped(column)
        present = present[np.isfinite(present)]
        scatter = 1.4826 * float(np.median(np.abs(np.diff(present, 2)))) / math.sqrt(6)
        least = max(LEAST * float(np.ptp(present)), np.finfo(float).tiny)
        sigmas.append(max(scatter, quantum_of(column) / math.sqrt(12), least))
    return np.array(sigmas)


class _Window:
    """The first rows of a log, and the model of a step over them."""

    def __init__(self, step: CallableStep, u: Array, y: Array, elapsed: Array | None, sigma: Array) -> None:
        self.outputs, self.u, self.y, self.elapsed, self.sigma = step.outputs, u, y, elapsed, sigma
        self.model = open_loop(step.observer.form, None if elapsed is not None else step.clock.dt, step.clock.between)

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
