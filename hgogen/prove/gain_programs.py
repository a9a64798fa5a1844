"""The convex programs behind an adaptive gain: K and P in floats, of which nothing is proved here.

    minimise gamma = (4 k lambda_max(P) + 1)/(2 lambda)                                                         (88)
    or       mu = sqrt(2 s) gamma^n                                                                             (89)
    over P > 0, Y = P K, lambda, s:   D P + P D >= 0,   |Y| <= largest,
    Phi = A'P + P A - Y C - C'Y' + sigma (D P + P D) + lambda I <= 0,                                           (54)
    and for (89)   Phi + (delta_1 P P + delta_2 Y Y')/s <= 0                                               (85), (87)

in the notation of `adaptive_gain`. (88) is linear-fractional: one semidefinite program in P/t, Y/t. (89) is one
at each gamma with 2 lambda gamma >= 4 k lambda_max(P) + 1, and gamma is searched. Source: Alessandri, "On
Hamilton-Jacobi approaches to state reconstruction for dynamic systems" (2020); Boyd, Vandenberghe, "Convex
Optimization", 4.3.2.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hgogen.prove.lmi import solved

_REACH = 1e3  # how far above its smallest value gamma is searched
_STEPS = 12  # of a search on a grid, and of the one inside its best cells


@dataclass(frozen=True)
class Task:
    """What is asked of a chain of `n` integrators with the slope k.

    `bounds`: "sigma", "largest" of |Y|, and what "gamma" and "mu" may be at most, inf for no bound; `deltas` None
    without a disturbance; `K` (n, 1) where the gain is given and only P is sought; D P + P D >= `margin` lambda;
    `least` what gamma may be at least, from where k holds.
    """

    n: int
    slope: float
    bounds: Mapping[str, float]
    deltas: tuple[float, float] | None
    K: np.ndarray | None
    margin: float
    least: float = 1.0

    def bounded(self, name: str, value: float) -> "Task":
        """The task with another bound of that name."""
        return replace(self, bounds={**self.bounds, name: value})


@dataclass(frozen=True)
class Optimum:
    """P (n, n) and Y = P K (n, 1) as the solver leaves them; `gamma` and `mu` (inf without a disturbance)."""

    P: np.ndarray
    Y: np.ndarray
    gamma: float
    mu: float


def best(cp: Any, task: Task) -> Optimum | None:
    """The smallest gamma, or mu where there is a disturbance, within the bounds; None where the solver finds none.

    `cp`: `lmi.solver`.
    """
    optimum = _fractional(cp, task)
    if optimum is None or optimum.gamma > task.bounds["gamma"]:
        return None
    if task.deltas is None:
        return optimum
    low = max(task.least, optimum.gamma * (1 + 1e-6))
    high = min(task.bounds["gamma"], _REACH * low)
    if low > high:
        return None
    at = _attenuation(cp, task)
    grid = np.geomspace(low, high, _STEPS).tolist()
    tried = [at(gamma) for gamma in grid]
    place = int(np.argmin([math.inf if one is None else one.mu for one in tried]))
    inside = np.geomspace(grid[max(place - 1, 0)], grid[min(place + 1, _STEPS - 1)], _STEPS + 1).tolist()
    each = [one for one in (tried[place], *map(at, inside)) if one is not None and one.mu <= task.bounds["mu"]]
    return min(each, key=lambda one: one.mu, default=None)


def _fractional(cp: Any, task: Task) -> Optimum | None:
    """(88) by one program in P/t, Y/t, with lambda/t = 1/2."""
    t, peak = cp.Variable(nonneg=True), cp.Variable()
    P, Y = _unknown(cp, task)
    limits = _limits(cp, task, P, Y, peak, 0.5, t)
    problem = cp.Problem(cp.Minimize(4 * task.slope * peak + t), limits)
    value = solved(cp, problem, P)
    if value is None or not t.value > 0:
        return None
    return Optimum(value / t.value, np.asarray(Y.value) / t.value, max(1.0, float(problem.value)), math.inf)


def _attenuation(cp: Any, task: Task) -> Callable[[float], Optimum | None]:
    """(89) at a gamma: the smallest s, and what it gives."""
    assert task.deltas is not None
    n, (first, second) = task.n, map(math.sqrt, task.deltas)
    P, Y = _unknown(cp, task)
    peak, decay, s, level = cp.Variable(), cp.Variable(), cp.Variable((1, 1)), cp.Parameter(nonneg=True)
    phi, zero = _phi(task, P, Y, decay), np.zeros((n, 1))
    rows = [[-phi, first * P, second * Y], [first * P, s[0, 0] * np.eye(n), zero], [second * Y.T, zero.T, s]]
    limits = [*_limits(cp, task, P, Y, peak, decay, 1.0), 4 * task.slope * peak + 1 <= 2 * level * decay]
    problem = cp.Problem(cp.Minimize(s[0, 0]), [*limits, cp.bmat(rows) >> 0])

    def at(gamma: float) -> Optimum | None:
        level.value = gamma
        value = solved(cp, problem, P)
        if value is None or not s.value[0, 0] > 0:
            return None
        return Optimum(value, np.asarray(Y.value), gamma, math.sqrt(2 * float(s.value[0, 0])) * gamma**n)

    return at


def _unknown(cp: Any, task: Task) -> tuple[Any, Any]:
    """P and Y = P K."""
    P = cp.Variable((task.n, task.n), PSD=True)
    return P, cp.Variable((task.n, 1)) if task.K is None else P @ task.K


def _phi(task: Task, P: Any, Y: Any, decay: Any) -> Any:
    n = task.n
    A, C, D = np.diag(np.ones(n - 1), 1), np.eye(1, n), _powers(n)
    return A.T @ P + P @ A - Y @ C - C.T @ Y.T + task.bounds["sigma"] * (D @ P + P @ D) + decay * np.eye(n)


def _limits(cp: Any, task: Task, P: Any, Y: Any, peak: Any, decay: Any, scale: Any) -> list[Any]:
    """(54), D P + P D >= 0, P <= peak I, |Y| <= largest."""
    one, D, largest = np.eye(task.n), _powers(task.n), task.bounds["largest"]
    limits = [_phi(task, P, Y, decay) << 0, D @ P + P @ D >> task.margin * decay * one, P << peak * one]
    return limits if math.isinf(largest) else [*limits, cp.norm(Y) <= largest * scale]


def _powers(n: int) -> np.ndarray:
    """D."""
    return np.diag(np.arange(1.0, n + 1))
