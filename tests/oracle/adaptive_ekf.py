"""Oracle: the adaptive high-gain extended Kalman filter, sampled, in plain numpy.

    z' = f(z,u) = A(u) z + b(z,u),   y = C(u) z,   F = A + b*
    P  <- Phi P Phi' + h Q_theta,   Phi = I + hF + (hF)^2/2,
          Q_theta = theta Delta^-1 Q Delta^-1,   Delta = diag(1, 1/theta, .., 1/theta^(n-1))
    z  <- z + K (y - C z),  P <- P - K C P,   K = P C'/(r + C P C'),   r = R/(theta h)
    theta' = mu(I) F_0(theta) + lambda (1 - mu(I)) (1 - theta),
          F_0 = theta^2/T up to theta_1, (theta - 2 theta_1)^2/T above
    I      = sum over a sliding window d of h |y - yhat|^2, yhat predicted without correction from z(t - d)

N. Boizot, E. Busvelle, J.-P. Gauthier, An adaptive high-gain observer for nonlinear systems, Automatica 46
(2010), equations (3)-(6); continuous-discrete as in the same authors' ECC 2009 paper. P is kept in full.
One call takes u_k, y_k: predict, update, then theta, which the next call's Q and R use.
Every array leads with one axis of independent records (noise seeds), s of them; n states, one output.
It is written apart from the package and imports nothing of it, so that agreement means something.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Form:
    """The plant: f, its Jacobian F, over any leading axes of z; C for one u. Saturating b is the caller's."""

    f: Callable[[Array, float], Array]  # (..., n), u -> (..., n)
    F: Callable[[Array, float], Array]  # (..., n), u -> (..., n, n)
    C: Callable[[float], Array]  # u -> (n,)


# --- mu: how much of the innovation counts as a disturbance, 0..1 -------------------------------------------


def smoothstep(gamma_0: float, gamma_1: float) -> Callable[[Array], Array]:
    """C1, exactly 0 up to gamma_0 and 1 from gamma_1: equation (6)."""

    def mu(innovation: Array) -> Array:
        x = np.clip((innovation - gamma_0) / (gamma_1 - gamma_0), 0.0, 1.0)
        weight: Array = x * x * (3.0 - 2.0 * x)
        return weight

    return mu


def logistic(m: float, beta: float) -> Callable[[Array], Array]:
    """The paper's figure 1: 1/(1 + exp(-beta (I - m))), never exactly 0."""

    def mu(innovation: Array) -> Array:
        weight: Array = 1.0 / (1.0 + np.exp(-beta * (innovation - m)))
        return weight

    return mu


# --- theta: constant, decaying, adaptive --------------------------------------------------------------------


@dataclass(frozen=True)
class Constant:
    """theta(t) = theta; theta = 1 is the plain extended Kalman filter."""

    initial: float = 1.0

    def next(self, theta: Array, innovation: Array, dt: float) -> Array:
        return theta


@dataclass(frozen=True)
class Decaying:
    """theta(t) = 1 + (theta_0 - 1) exp(-decay t)."""

    initial: float
    decay: float

    def next(self, theta: Array, innovation: Array, dt: float) -> Array:
        return 1.0 + (theta - 1.0) * math.exp(-self.decay * dt)


@dataclass(frozen=True)
class Adaptive:
    """The law (4)-(5) by the exact flows of its two terms, the rise first; 1 <= theta <= 2 theta_1."""

    theta_1: float
    rise: float  # Delta T
    decay: float  # lambda
    mu: Callable[[Array], Array]
    initial: float = 1.0

    def next(self, theta: Array, innovation: Array, dt: float) -> Array:
        mu = self.mu(innovation)
        risen = self.risen(theta, mu * dt / self.rise)
        fallen = 1.0 + (risen - 1.0) * np.exp(-self.decay * (1.0 - mu) * dt)
        return np.clip(fallen, 1.0, 2.0 * self.theta_1)

    def risen(self, theta: Array, s: Array) -> Array:
        """theta after a time s of theta' = theta^2 up to theta_1, then theta' = (theta - 2 theta_1)^2."""
        until_theta_1 = np.maximum(1.0 / theta - 1.0 / self.theta_1, 0.0)
        below = 1.0 / (1.0 / theta - np.minimum(s, until_theta_1))
        distance = 2.0 * self.theta_1 - np.maximum(theta, self.theta_1)
        above = 2.0 * self.theta_1 - distance / (1.0 + distance * np.maximum(s - until_theta_1, 0.0))
        return np.where(s <= until_theta_1, below, above)


# --- the innovation's predictors ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Staggered:
    """M + 1 copies of the model, one restarted from z every d/M; the oldest is d to d (1 + 1/M) old."""

    d: float
    M: int = 4

    def slots(self, dt: float) -> tuple[int, int, int]:
        """Copies, samples between restarts, samples N of one window."""
        window = round(self.d / dt)
        assert window % self.M == 0, "the window must be a whole number of restarts"
        return self.M + 1, window // self.M, window


@dataclass(frozen=True)
class Window:
    """The textbook's: at every sample k the model is simulated anew from z(k - N), samples k - N + 1 .. k.

    N copies, one started at each sample and kept running, make the numbers of N steps repeated every sample.
    Before a window has passed it starts from the first corrected z, with the samples there are.
    """

    d: float

    def slots(self, dt: float) -> tuple[int, int, int]:
        window = round(self.d / dt)
        return window, 1, window


@dataclass(frozen=True)
class Predictors:
    z: Array  # (s, m, n)
    total: Array  # (s, m), sum of h |y - yhat|^2
    count: Array  # (s, m), valid samples seen
    oldest: int = 0
    tick: int = 0

    def renewed(self, slot: int | slice, z: Array) -> "Predictors":
        """Start a slot (or all of them) again at the estimate z (s, n)."""
        z_all, total, count = self.z.copy(), self.total.copy(), self.count.copy()
        z_all[:, slot] = z if isinstance(slot, int) else z[:, None]
        total[:, slot], count[:, slot] = 0.0, 0.0
        return replace(self, z=z_all, total=total, count=count)


# --- the observer -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Observer:
    """Q (n, n) and R: intensities of continuous noise; P0 (n, n) = S(0)^-1; z0 (n,); dt in the units of d."""

    form: Form
    Q: Array
    R: float
    P0: Array
    z0: Array
    dt: float
    theta: Constant | Decaying | Adaptive = Constant()
    innovation: Staggered | Window | None = None
    between: Literal["line", "hold"] = "line"


@dataclass(frozen=True)
class State:
    z: Array  # (s, n)
    P: Array  # (s, n, n)
    theta: Array  # (s,)
    innovation: Array  # (s,)
    u: float | None  # the input of the last call; None before the first
    predictors: Predictors | None


def start(observer: Observer, seeds: int) -> State:
    """The state before the first sample."""
    z = np.tile(observer.z0, (seeds, 1))
    predictors = None
    if observer.innovation is not None:
        slots = observer.innovation.slots(observer.dt)[0]
        empty = np.zeros((seeds, slots))
        predictors = Predictors(np.repeat(z[:, None], slots, axis=1), empty, empty)
    theta = np.full(seeds, observer.theta.initial)
    return State(z, np.tile(observer.P0, (seeds, 1, 1)), theta, np.zeros(seeds), None, predictors)


def step(observer: Observer, state: State, u: float, y: Array) -> State:
    """One sample: predict, update, adapt. y (s,), NaN where a sample is missing."""
    first = state.u is None
    predicted = state if first else predict(observer, state, u)
    updated = update(observer, predicted, u, y)
    if first:
        if isinstance(observer.innovation, Window) and updated.predictors is not None:
            updated = replace(updated, predictors=updated.predictors.renewed(slice(None), updated.z))
        return replace(updated, u=u)
    return replace(adapt(observer, updated), u=u)


def predict(observer: Observer, state: State, u: float) -> State:
    """From the last sample to this one: RK4 on z, Phi P Phi' + h Q_theta, Heun on the predictors."""
    h, f = observer.dt, observer.form.f
    u0 = u if observer.between == "hold" or state.u is None else state.u
    um = (u0 + u) / 2.0
    k1 = f(state.z, u0)
    k2 = f(state.z + h / 2.0 * k1, um)
    middle = state.z + h / 2.0 * k2
    k3 = f(middle, um)
    k4 = f(state.z + h * k3, u)
    z = state.z + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)

    hF = h * observer.form.F(middle, um)
    Phi = np.eye(z.shape[-1]) + hF + hF @ hF / 2.0
    P = Phi @ state.P @ np.swapaxes(Phi, -1, -2) + h * process_noise(observer.Q, state.theta)
    P = (P + np.swapaxes(P, -1, -2)) / 2.0

    predictors = state.predictors
    if predictors is not None:
        k1 = f(predictors.z, u0)
        k2 = f(predictors.z + h * k1, u)
        predictors = replace(predictors, z=predictors.z + h / 2.0 * (k1 + k2))
    return replace(state, z=z, P=P, predictors=predictors)


def process_noise(Q: Array, theta: Array) -> Array:
    """Q_theta = theta Delta^-1 Q Delta^-1, (s, n, n)."""
    powers = theta[:, None] ** np.arange(len(Q))
    return theta[:, None, None] * powers[:, :, None] * Q * powers[:, None, :]


def update(observer: Observer, state: State, u: float, y: Array) -> State:
    """The measurement's scalar update, and the predictors' sums, where y is valid."""
    valid = np.isfinite(y)
    y = np.where(valid, y, 0.0)
    C = observer.form.C(u)
    predictors = state.predictors
    if predictors is not None:
        cost = observer.dt * (y[:, None] - predictors.z @ C) ** 2
        total = predictors.total + np.where(valid[:, None], cost, 0.0)
        predictors = replace(predictors, total=total, count=predictors.count + valid[:, None])

    PC = state.P @ C
    alpha = observer.R / (state.theta * observer.dt) + PC @ C
    K = PC / alpha[:, None]
    z = state.z + K * (y - state.z @ C)[:, None]
    P = state.P - K[:, :, None] * PC[:, None, :]
    P = np.where(valid[:, None, None], P, state.P)
    return replace(state, z=np.where(valid[:, None], z, state.z), P=P, predictors=predictors)


def adapt(observer: Observer, state: State) -> State:
    """The oldest predictor's innovation, the theta it gives, and the restart that is due."""
    predictors, innovation = state.predictors, state.innovation
    if predictors is not None and observer.innovation is not None:
        slots, period, window = observer.innovation.slots(observer.dt)
        count = np.maximum(predictors.count[:, predictors.oldest], 1.0)
        innovation = predictors.total[:, predictors.oldest] * np.minimum(1.0, window / count)
        predictors = replace(predictors, tick=predictors.tick + 1)
        if predictors.tick == period:
            renewed = predictors.renewed(predictors.oldest, state.z)
            predictors = replace(renewed, tick=0, oldest=(predictors.oldest + 1) % slots)
    theta = observer.theta.next(state.theta, innovation, observer.dt)
    return replace(state, theta=theta, innovation=innovation, predictors=predictors)


@dataclass(frozen=True)
class Record:
    """What each call left: z (s, k, n), theta (s, k), innovation (s, k); and the last state."""

    z: Array
    theta: Array
    innovation: Array
    last: State


def run(observer: Observer, u: Array, y: Array) -> Record:
    """Call after call over inputs u (k,) and outputs y (s, k)."""
    seeds, calls = y.shape
    z = np.empty((seeds, calls, len(observer.z0)))
    theta, innovation = np.empty((seeds, calls)), np.empty((seeds, calls))
    state = start(observer, seeds)
    for k in range(calls):
        state = step(observer, state, float(u[k]), y[:, k])
        z[:, k], theta[:, k], innovation[:, k] = state.z, state.theta, state.innovation
    return Record(z, theta, innovation, state)
