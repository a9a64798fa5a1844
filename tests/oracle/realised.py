"""Sampled-data steps of x' = M x + B v by scipy: the exact one, v on the line between samples, and the bilinear one."""

import numpy as np
from scipy.linalg import expm

Array = np.ndarray


def exact(M: Array, B: Array, h: float) -> tuple[Array, Array, Array]:
    """Phi, Gamma_0, Gamma_1 of x+ = Phi x + Gamma_0 v_0 + Gamma_1 v_1: exp of one matrix with v and its slope in it."""
    n, p = B.shape
    wide = np.block([[M, B, np.zeros((n, p))], [np.zeros((p, n + p)), np.eye(p)], [np.zeros((p, n + 2 * p))]])
    moved = expm(h * wide)[:n]
    slope = moved[:, n + p :] / h
    return moved[:, :n], moved[:, n : n + p] - slope, slope


def bilinear(M: Array, B: Array, h: float) -> tuple[Array, Array, Array]:
    """The same for (1 - h M/2) x+ = (1 + h M/2) x + h/2 B (v_0 + v_1)."""
    left, right = np.eye(len(M)) - h / 2 * M, np.eye(len(M)) + h / 2 * M
    source = np.linalg.solve(left, h / 2 * B)
    return np.linalg.solve(left, right), source, source


def run(steps: tuple[Array, Array, Array], start: Array, v: Array) -> Array:
    """States (N, n) at the samples v (N, p)."""
    Phi, before, now = steps
    states = [np.array(start, dtype=float)]
    for k in range(len(v) - 1):
        states.append(Phi @ states[-1] + before @ v[k] + now @ v[k + 1])
    return np.array(states)
