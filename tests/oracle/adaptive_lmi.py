"""The observer (46) with the projected law (90) on the pendulum (91) of Alessandri 2020, in plain numpy and scipy.

x1' = x2,  x2' = -0.5 sin x1 - 0.5 x2 + x3,  x3' = 0,  y = x1
xhat' = the same + (gamma k1, gamma^2 k2, gamma^3 k3) (y - xhat1)
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

K = np.array([8.9661, 16.5213, 9.1275])
P = np.array([[1.2192, -0.6803, 0.1906], [-0.6803, 0.7829, -0.6874], [0.1906, -0.6874, 1.0244]])
SIGMA, ALPHA, LEVEL, LOW, HIGH = 0.05, 50.0, 0.1, 20.53, 80.0
PLANT, ESTIMATE = np.array([0.0, 0.0, 0.01]), np.ones(3)


def pendulum(x: np.ndarray) -> np.ndarray:
    return np.array([x[1], -0.5 * math.sin(x[0]) - 0.5 * x[1] + x[2], 0.0])


def corrected(estimate: np.ndarray, gamma: float, e: float) -> np.ndarray:
    return pendulum(estimate) + np.array([gamma, gamma**2, gamma**3]) * K * e


def stepped(y: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Estimates (N, 3) and gamma (N): classical Runge-Kutta, y on the line between samples, NaN where it is missing:
    then nothing but the model, gamma at rest. gamma is clipped in every slope and after each step."""

    def slope(state: np.ndarray, measured: float) -> np.ndarray:
        gamma = min(max(state[3], LOW), HIGH)
        if math.isnan(measured):
            return np.append(pendulum(state[:3]), 0.0)
        e = measured - state[0]
        return np.append(corrected(state[:3], gamma, e), ALPHA * gamma if abs(e) > LEVEL else -SIGMA * gamma**2)

    state = np.append(ESTIMATE, LOW)
    states = [state]
    for last, now in pairwise(y):
        before = now if math.isnan(last) or math.isnan(now) else last
        middle = (before + now) / 2
        k1 = slope(state, before)
        k2 = slope(state + dt / 2 * k1, middle)
        k3 = slope(state + dt / 2 * k2, middle)
        k4 = slope(state + dt * k3, now)
        state = state + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        state[3] = min(max(state[3], LOW), HIGH)
        states.append(state)
    return np.array(states)[:, :3], np.array(states)[:, 3]


@dataclass(frozen=True)
class Continuous:
    """`turns`: when gamma changes its direction, `back` when it is at its lower end again (s); `peak` of gamma;
    `errors` (3) their peaks; `last`: when |e| is last above 1e-2 and 1e-3 (s)."""

    turns: tuple[float, ...]
    back: float
    peak: float
    errors: np.ndarray
    last: tuple[float, float]


def crossed(level: float, direction: float) -> Callable[[float, np.ndarray], float]:
    """|y - xhat1| passes d downwards (-1) or upwards (1): the end of an arc."""

    def event(t: float, s: np.ndarray) -> float:
        return abs(s[0] - s[3]) - level

    event.terminal, event.direction = True, direction
    return event


def rested(t: float, s: np.ndarray) -> float:
    return s[6] - LOW


rested.terminal, rested.direction = True, -1.0
QUIET, LOUD = crossed(LEVEL, -1.0), crossed(LEVEL, 1.0)
# gamma' and what ends it, with what comes after it; gamma_sup is not met on this path
MODES = {
    "rising": (lambda gamma: ALPHA * gamma, {QUIET: "falling"}),
    "falling": (lambda gamma: -SIGMA * gamma**2, {LOUD: "rising", rested: "resting"}),
    "resting": (lambda gamma: 0.0, {LOUD: "rising"}),
}


def continuous(end: float = 1.0) -> Continuous:
    """In continuous time: DOP853 from switch to switch, each found as a zero."""
    t, state, mode = 0.0, np.concatenate([PLANT, ESTIMATE, [LOW]]), "rising"
    switches, times, path = [], [], []
    while t < end:
        change, ends = MODES[mode]

        def rate(t: float, s: np.ndarray, change: Callable[[float], float] = change) -> np.ndarray:
            return np.concatenate([pendulum(s[:3]), corrected(s[3:6], s[6], s[0] - s[3]), [change(s[6])]])

        options = {"rtol": 1e-12, "atol": 1e-12, "max_step": 1e-3, "dense_output": True}
        arc = solve_ivp(rate, (t, end), state, method="DOP853", events=list(ends), **options)
        times.append(np.linspace(t, arc.t[-1], 20_001))
        path.append(arc.sol(times[-1]))
        t, state = float(arc.t[-1]), arc.y[:, -1]
        if arc.status == 1:
            (mode,) = (after for after, hits in zip(ends.values(), arc.t_events, strict=True) if len(hits))
            switches.append((t, mode))
    at, states = np.concatenate(times), np.concatenate(path, axis=1)
    e = states[:3] - states[3:6]
    size = np.linalg.norm(e, axis=0)
    return Continuous(
        turns=tuple(when for when, after in switches if after != "resting"),
        back=next(when for when, after in switches if after == "resting"),
        peak=float(states[6].max()),
        errors=np.abs(e).max(axis=1),
        last=(float(at[size > 1e-2][-1]), float(at[size > 1e-3][-1])),
    )


def projected(gamma: float, r: float) -> float:
    """gamma' of the law (90), projected: it leaves an end of its range inwards."""
    if r > LEVEL:
        return ALPHA * gamma if gamma < HIGH else 0.0
    return -SIGMA * gamma**2 if gamma > LOW else 0.0


def printed(gamma: float, r: float) -> float:
    """gamma' of the law (90) as it is printed: 0 at both ends of its range, whatever the residual."""
    return projected(gamma, r) if LOW < gamma < HIGH else 0.0


def under(law: Callable[[float, float], float], gamma: float, end: float, dt: float = 1e-4) -> tuple[float, float]:
    """gamma at the end, and when |e| is last above 1e-2, by small Euler steps of the quiet pendulum."""
    x, estimate, late = PLANT.astype(float), ESTIMATE.astype(float), 0.0
    for k in range(round(end / dt)):
        e = x[0] - estimate[0]
        change = law(gamma, abs(e))
        x, estimate = x + dt * pendulum(x), estimate + dt * corrected(estimate, gamma, e)
        gamma = min(max(gamma + dt * change, LOW), HIGH)
        late = k * dt if np.linalg.norm(x - estimate) > 1e-2 else late
    return gamma, late
