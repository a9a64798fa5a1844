"""Oracle: N filters in parallel, restarted one after the other, of which the best is the estimate, in plain numpy.

The members are the records of `adaptive_ekf`, all given the same samples. Every T the oldest of them restarts at
theta_0 and P(0) from the selected estimate and with the selected one's predictors; at every sample the member with
the smallest score among those that stay takes over if its score is below `hysteresis` times that of the selected one.
The score is the innovation over a window, or the squared output error of the newest sample. From Busvelle's slides
"Parallel high-gain and non high-gain extended Kalman filters"; written apart from the package, it imports nothing of
it.
"""

from dataclasses import dataclass, replace

import numpy as np

from . import adaptive_ekf as ekf
from .adaptive_ekf import Array


@dataclass(frozen=True)
class Bank:
    """`member.innovation` gives the score, None: the newest sample's output error; `period` in samples."""

    member: ekf.Observer
    count: int
    period: int
    hysteresis: float


def run(bank: Bank, u: Array, y: Array) -> tuple[Array, Array]:
    """The selected estimate (k, n) and the number of the selected member (k), over u (k,) and y (k,)."""
    state, selected, oldest = ekf.start(bank.member, bank.count), 0, 0
    z, chosen = np.empty((len(y), len(bank.member.z0))), np.empty(len(y), dtype=int)
    for k in range(len(y)):
        state = ekf.step(bank.member, state, float(u[k]), np.full(bank.count, y[k]))
        if k:
            due = k % bank.period == 0
            after = (oldest + 1) % bank.count
            if due and selected == oldest:
                selected = after
            score = _score(bank.member, state, float(u[k]), y[k])
            others = [j for j in range(bank.count) if not (due and j == oldest)]
            best = min(others, key=lambda j: (score[j], j != selected))
            selected = best if score[best] < bank.hysteresis * score[selected] else selected
            if due:
                state, oldest = _restarted(bank, state, oldest, selected), after
        z[k], chosen[k] = state.z[selected], selected
    return z, chosen


def _score(member: ekf.Observer, state: ekf.State, u: float, y: float) -> Array:
    if member.innovation is not None:
        return state.innovation
    return (y - state.z @ member.form.C(u)) ** 2 if np.isfinite(y) else np.zeros(len(state.z))


def _restarted(bank: Bank, state: ekf.State, oldest: int, selected: int) -> ekf.State:
    z, P, theta = state.z.copy(), state.P.copy(), state.theta.copy()
    z[oldest], P[oldest], theta[oldest] = z[selected], bank.member.P0, bank.member.theta.initial
    predictors = state.predictors
    if predictors is not None:
        parts = {name: getattr(predictors, name).copy() for name in ("z", "total", "count")}
        for array in parts.values():
            array[oldest] = array[selected]
        predictors = replace(predictors, **parts)
    return replace(state, z=z, P=P, theta=theta, predictors=predictors)
