"""Oracle: the modified FitzHugh-Nagumo trial of Boizot, Busvelle and Gauthier (2010), (22) and section 5.

    x1' = x1 - x1^3/3 - x2 u,   x2' = eps (3 sin x1 - x2 - eta),   eta' = 0 between jumps,   y = x1 + n,
    u = sin t

The observer's form, after a sign, z = (x1, x2, -eta):
    z1' = -u z2 + (z1 - z1^3/3),   z2' = eps z3 + eps (3 sin z1 - z2),   z3' = 0,   the b terms at sat(z)
n is an Ornstein-Uhlenbeck process, discretised exactly: n_{k+1} = rho n_k + sigma sqrt(1 - rho^2) g.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from . import adaptive_ekf as ekf
from .adaptive_ekf import Array

EPS = 0.8
DT = 0.01
START = (1.06, 2.69)
# Of x1, x2, eta. Wide enough for every estimate, stage and predictor of the trials below, theta = 8 included.
BOX = np.array([[-3.5, 3.5], [-10.0, 10.0], [-8.0, 8.0]])


@dataclass(frozen=True)
class Scenario:
    """eta at the start and after each jump (time, new value); the length in the plant's time units."""

    jumps: tuple[tuple[float, float], ...]
    duration: float
    eta: float = 5.0


FIRST = Scenario(((50.0, -6.0),), 100.0)
SECOND = Scenario(((30.0, -6.0), (60.0, -3.0), (90.0, 5.0), (120.0, 5.2), (150.0, -6.0), (180.0, 3.0)), 210.0)


def times(scenario: Scenario, dt: float = DT) -> Array:
    """The sample times, both ends included."""
    return dt * np.arange(round(scenario.duration / dt) + 1, dtype=np.float64)


@cache
def truth(scenario: Scenario, dt: float = DT, substeps: int = 5) -> Array:
    """x1, x2, eta at the sample times (k, 3), not to be written to; eta is already the new one at the time of its
    jump."""
    t = times(scenario, dt)
    eta = np.full(len(t), scenario.eta)
    for time, value in scenario.jumps:
        eta[round(time / dt) :] = value
    x = np.empty((len(t), 3))
    x[:, 2] = eta
    x1, x2 = x[0, :2] = START
    h = dt / substeps
    for k in range(len(t) - 1):
        for i in range(substeps):
            x1, x2 = _rk4(x1, x2, float(eta[k]), t[k] + i * h, h)
        x[k + 1, :2] = x1, x2
    x.setflags(write=False)
    return x


def _flow(x1: float, x2: float, eta: float, t: float) -> tuple[float, float]:
    return x1 - x1**3 / 3.0 - x2 * math.sin(t), EPS * (3.0 * math.sin(x1) - x2 - eta)


def _rk4(x1: float, x2: float, eta: float, t: float, h: float) -> tuple[float, float]:
    a1, a2 = _flow(x1, x2, eta, t)
    b1, b2 = _flow(x1 + h / 2 * a1, x2 + h / 2 * a2, eta, t + h / 2)
    c1, c2 = _flow(x1 + h / 2 * b1, x2 + h / 2 * b2, eta, t + h / 2)
    d1, d2 = _flow(x1 + h * c1, x2 + h * c2, eta, t + h)
    return x1 + h / 6 * (a1 + 2 * b1 + 2 * c1 + d1), x2 + h / 6 * (a2 + 2 * b2 + 2 * c2 + d2)


def noise(seeds: range, samples: int, sigma: float = 0.2, tau: float = 0.1, dt: float = DT) -> Array:
    """Stationary Ornstein-Uhlenbeck noise (s, samples): standard deviation sigma, correlation time tau."""
    rho = math.exp(-dt / tau)
    n = sigma * np.array([np.random.default_rng(seed).standard_normal(samples) for seed in seeds])
    n[:, 1:] *= math.sqrt(1.0 - rho * rho)
    for k in range(1, samples):
        n[:, k] += rho * n[:, k - 1]
    return n


def form(box: Array = BOX) -> ekf.Form:
    """The observability form; box (3, 2) of (x1, x2, eta) saturates the argument of b and of its Jacobian.

    b does not depend on z3, so eta's range clamps nothing here.
    """
    (low_1, high_1), (low_2, high_2) = box[:2]

    def f(z: Array, u: float) -> Array:
        s1 = np.clip(z[..., 0], low_1, high_1)
        s2 = np.clip(z[..., 1], low_2, high_2)
        dz = np.zeros_like(z)
        dz[..., 0] = -u * z[..., 1] + (s1 - s1**3 / 3.0)
        dz[..., 1] = EPS * z[..., 2] + EPS * (3.0 * np.sin(s1) - s2)
        return dz

    def F(z: Array, u: float) -> Array:
        s1 = np.clip(z[..., 0], low_1, high_1)
        J = np.zeros((*z.shape, 3))
        J[..., 0, 0] = 1.0 - s1**2
        J[..., 0, 1] = -u
        J[..., 1, 0] = EPS * 3.0 * np.cos(s1)
        J[..., 1, 1] = -EPS
        J[..., 1, 2] = EPS
        return J

    return ekf.Form(f, F, lambda u: np.array([1.0, 0.0, 0.0]))


def observer(
    theta: ekf.Constant | ekf.Decaying | ekf.Adaptive,
    innovation: ekf.Staggered | ekf.Window | None = None,
    box: Array = BOX,
    dt: float = DT,
) -> ekf.Observer:
    """The reference gains: Q, R, S(0) = I, z(0) = 0."""
    Q = np.diag([0.1, 0.01, 2.3e-4])
    return ekf.Observer(form(box), Q, 1.0, np.eye(3), np.zeros(3), dt, theta, innovation)


def adaptive(gamma_0: float = 0.16, gamma_1: float = 0.32) -> ekf.Adaptive:
    """theta_1 = 4, Delta T = .1, lambda = 1, smoothstep from gamma_0 to gamma_1."""
    return ekf.Adaptive(4.0, 0.1, 1.0, ekf.smoothstep(gamma_0, gamma_1))


# --- metrics ------------------------------------------------------------------------------------------------


def settling(t: Array, error: Array, since: float, band: float = 0.3, hold: float = 3.0) -> Array:
    """Time from `since` until |error| (s, k) stays within band for `hold`; NaN where it never does."""
    dt, first = t[1] - t[0], int(np.searchsorted(t, since - 1e-9))
    samples = round(hold / dt) + 1
    inside = np.concatenate([np.zeros((len(error), 1)), np.cumsum(np.abs(error[:, first:]) <= band, axis=1)], axis=1)
    held = inside[:, samples:] - inside[:, :-samples] == samples
    return np.where(held.any(axis=1), held.argmax(axis=1) * dt, np.nan)


def rms(t: Array, error: Array, low: float, high: float) -> Array:
    """Root mean square of error (s, k) over low <= t < high, each record."""
    part = error[:, (t >= low) & (t < high)]
    mean_square: Array = np.mean(part**2, axis=1)
    return np.sqrt(mean_square)


def calm_again(t: Array, theta: Array, since: float, level: float = 1.05) -> Array:
    """Time from `since` until theta (s, k) is under level for good."""
    after = theta[:, t >= since] >= level
    last = after.shape[1] - 1 - after[:, ::-1].argmax(axis=1)
    return np.where(after.any(axis=1), (last + 1) * (t[1] - t[0]), 0.0)
