"""Kalman filters in plain numpy whose samples correct together: extended, unscented, and iterated by Gauss-Newton.

The batch forms of textbooks: K = P C' (C P C' + R)^-1 with the rows and columns of the samples that are there; sigma
points by their weights, drawn anew from the Cholesky factor of the predicted covariance.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Model:
    """x' = f(x, u), or x+ = f(x, u) of a `discrete` model, y = h(x); `turns`: the periods of the states and of the
    outputs, inf without one."""

    f: Callable[[Array, Array], Array]
    F: Callable[[Array, Array], Array]
    h: Callable[[Array], Array]
    H: Callable[[Array], Array]
    turns: tuple[Array, Array]
    onto: Callable[[Array, Array], tuple[Array, Array]] = lambda z, P: (z, P)
    discrete: bool = False


def short(e: Array, turns: Array) -> Array:
    """The shortest way round."""
    finite = np.isfinite(turns)
    return np.where(finite, e - np.where(finite, turns, 1) * np.round(e / np.where(finite, turns, 1)), e)


def advanced(model: Model, z: Array, u: tuple[Array, Array], dt: float) -> tuple[Array, Array]:
    """The state after classical Runge-Kutta, and that of the third stage."""
    if model.discrete:
        return model.f(z, u[0]), z
    middle = (u[0] + u[1]) / 2
    k1 = model.f(z, u[0])
    k2 = model.f(z + dt / 2 * k1, middle)
    at = z + dt / 2 * k2
    k3 = model.f(at, middle)
    k4 = model.f(z + dt * k3, u[1])
    return z + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4), at


def spread(alpha: float, beta: float, kappa: float, n: int) -> tuple[float, Array, Array]:
    """The distance of sigma points, and their weights for means and covariances."""
    lam = alpha**2 * (n + kappa) - n
    mean = np.full(2 * n + 1, 1 / (2 * (n + lam)))
    mean[0] = lam / (n + lam)
    covariance = mean.copy()
    covariance[0] += 1 - alpha**2 + beta
    return np.sqrt(n + lam), mean, covariance


def points(z: Array, P: Array, reach: float) -> Array:
    S = np.linalg.cholesky(P)
    return np.vstack((z, z + reach * S.T, z - reach * S.T))


def run(
    kind: str,
    model: Model,
    noises: tuple[Array, Array],  # Q as a density, R of one sample
    start: tuple[Array, Array],
    dt: float,
    log: tuple[Array, Array],
    scaled: tuple[float, float, float] = (1.0, 2.0, 0.0),
    passes: int = 4,
) -> tuple[Array, Array]:
    """The estimates (N, n) and covariances (N, n, n) by "riccati", "ukf" or "iterated_ekf", from inputs and samples."""
    (Q, R), (z, P), (u, y), n = noises, start, log, len(start[0])
    reach, mean, weight = spread(*scaled, n)
    rows, covariances = [], []
    for k, sample in enumerate(y):
        if k:
            ends = (u[k - 1], u[k])
            if kind == "ukf":
                moved = np.array([advanced(model, x, ends, dt)[0] for x in points(z, P, reach)])
                off = short(moved - moved[0], model.turns[0])
                shift = mean @ off
                z = moved[0] + shift
                P = (weight[:, None] * (off - shift)).T @ (off - shift) + dt * Q
            else:
                z_after, at = advanced(model, z, ends, dt)
                A = dt * model.F(at, (u[k - 1] + u[k]) / 2)
                Phi = model.F(at, u[k - 1]) if model.discrete else np.eye(n) + A + A @ A / 2
                z, P = z_after, Phi @ P @ Phi.T + dt * Q
            z, P = model.onto(z, P)
        there = np.flatnonzero(np.isfinite(sample))
        if len(there):
            turns, r = model.turns[1][there], R[np.ix_(there, there)]
            if kind == "ukf":
                at = points(z, P, reach)
                read = np.array([model.h(x) for x in at])[:, there]
                off = short(read - read[0], turns)
                shift = mean @ off
                S = (weight[:, None] * (off - shift)).T @ (off - shift) + r
                across = (weight[:, None] * (at - z)).T @ (off - shift)
                K = across @ np.linalg.inv(S)
                e = short(short(sample[there] - read[0], turns) - shift, turns)
                z, P = z + K @ e, P - K @ S @ K.T
            else:
                at = z
                if kind == "iterated_ekf":
                    at = iterated(model, z, P, r, sample, there, passes)
                C = model.H(at)[there]
                K = P @ C.T @ np.linalg.inv(C @ P @ C.T + r)
                e = short(sample[there] - model.h(z)[there], turns)
                z, P = (z + K @ e if kind == "riccati" else at), P - K @ C @ P
            z, P = model.onto(z, P)
        rows.append(z)
        covariances.append(P)
    return np.array(rows), np.array(covariances)


def iterated(model: Model, z: Array, P: Array, R: Array, sample: Array, there: Array, passes: int) -> Array:
    """The state after Gauss-Newton passes on the cost of all samples, each halved where it does not decrease."""
    inverse, weight, turns = np.linalg.inv(P), np.linalg.inv(R), model.turns[1][there]

    def error(x: Array) -> Array:
        return short(sample[there] - model.h(x)[there], turns)

    def cost(x: Array) -> float:
        return float((x - z) @ inverse @ (x - z) + error(x) @ weight @ error(x))

    x, share, before = z, 1.0, cost(z)
    for _ in range(passes):
        C = model.H(x)[there]
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
        target = z + K @ (error(x) + C @ (x - z))
        tried = x + share * (target - x)
        if cost(tried) < before:
            x, before, share = tried, cost(tried), 1.0
        else:
            share /= 2
    return x
