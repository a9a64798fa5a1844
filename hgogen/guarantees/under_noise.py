"""How far errors of the samples move an estimate, by any course of them, for ever.

    |e+|_P^2 <= (1 - alpha h) |e|_P^2 + h (lambda_1 v^2 + lambda_2 v+^2),   lambda_1 + lambda_2 <= alpha

v and v+ are the errors of an output's samples at the ends of a call, at most 1, else independent of each other. Then
|e|_P <= 1 stays so, and from elsewhere |e|_P^2 - 1 falls to 1 - alpha h of itself at each call: |c e| comes to no more
than sqrt(c P^-1 c'), and stays there. P is sought for the least of that, at an alpha that is searched.
"""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from flint import fmpq_mat

from hgogen.algebra.definite import fraction, number, root
from hgogen.guarantees.contracting import Steps
from hgogen.guarantees.lmi import solved, solver
from hgogen.guarantees.quadratic import Array, Quadratic, Weights, floats, on_grid, verified

_WHAT = "a bound of the noise"
_SEARCHED = 7  # values of alpha
_SHARE = Fraction(999_999, 1_000_000)  # of alpha for the lambda, so that they are below it when they are rounded
_BITS = (34, 48)


@dataclass(frozen=True)
class NoiseBound:
    """A proof that |c e| <= `bound` where the samples of one output err by at most 1: by the `weights`, of which the
    last two of S are the lambda, at `alpha`."""

    alpha: Fraction
    weights: Weights
    bound: Fraction


def noise_bound(steps: Steps, h: Fraction, output: int, c: Array, most: Fraction) -> NoiseBound | None:
    """A small bound of |c e|, c (N) of FLINT's rationals, for a step that is proved with the rate `most`; None where
    none is proved.

    Raises: `NoSolver`.
    """

    def at(alpha: Fraction) -> NoiseBound | None:
        return _at(steps, h, output, c, alpha)

    return _least(at, most)


def _least(at: Callable[[Fraction], NoiseBound | None], most: Fraction) -> NoiseBound | None:
    """The least bound over alpha, which has one minimum: by the golden section of its logarithm."""
    low, high, ratio = 1 / 32, 1.0, (5**0.5 - 1) / 2
    tried: dict[float, NoiseBound | None] = {}

    def value(share: float) -> float:
        if share not in tried:
            tried[share] = at(Fraction(share) * most)
        one = tried[share]
        return float(one.bound) if one else float("inf")

    for _ in range(_SEARCHED):
        span = (high / low) ** (1 - ratio)
        if value(low * span) < value(high / span):
            high = high / span
        else:
            low = low * span
    proofs = [one for one in tried.values() if one]
    return min(proofs, key=lambda one: one.bound, default=None)


def _at(steps: Steps, h: Fraction, output: int, c: Array, alpha: Fraction) -> NoiseBound | None:
    form, W = steps.at(h).bounded(alpha, output), steps.coordinates
    if W is None:
        return None
    candidate = _sought(form.floats, floats(c[None])[0], float(alpha), W)
    if candidate is None:
        return None
    P, S = candidate
    for bits in _BITS:
        exactly = on_grid(P, bits + _places(P)), on_grid(S, bits + _places(P))
        if sum(exactly[1][-2:]) <= number(alpha) and verified(form, *exactly):
            inverse = fmpq_mat(exactly[0].tolist()).inv()
            row = fmpq_mat([c.tolist()])
            return NoiseBound(alpha, Weights.of(*exactly), root(fraction((row * inverse * row.transpose())[0, 0])))
    return None


def _places(P: Array) -> int:
    """The bits by which the trace of P lies below 1."""
    return max(0, -int(np.floor(np.log2(np.trace(P)))))


def _sought(of: Quadratic, c: Array, alpha: float, W: Array) -> tuple[Array, Array] | None:
    """P and S in floats with a small c P^-1 c', sought in coordinates x of e = W x, the inputs scaled such that x is
    near 1."""
    cp, n = solver(_WHAT), len(W)
    size, count = of.pairs[0][0].shape[1], len(of.Q)
    T, back = np.eye(size), np.linalg.inv(W)
    T[:n, :n] = W
    enters, reads = back @ of.pairs[0][1][:, n:], of.Q[:-2, :n] @ W
    unit = alpha / float(np.linalg.norm(enters[:, -2:]))
    even = np.sqrt(np.linalg.norm(reads, axis=1) / np.linalg.norm(enters[:, :-2], axis=0))
    g = np.append(even, [unit, unit])
    T[range(n, size), range(n, size)] = g
    pairs = [(back @ X @ T, back @ Y @ T) for X, Y in of.pairs]
    Q, Z = of.Q @ T / g[:, None], of.Z @ T / g[:, None]
    P, S, reach = cp.Variable((n, n), PSD=True), cp.Variable(count, nonneg=True), cp.Variable()
    total = sum((X.T @ P @ Y + Y.T @ P @ X for X, Y in pairs), Q.T @ cp.diag(S) @ Q - Z.T @ cp.diag(S) @ Z)
    row = (c @ W)[None] / np.linalg.norm(c @ W)
    held = cp.bmat([[cp.reshape(reach, (1, 1), order="C"), row], [row.T, P]])
    small = 1e-7 * np.eye(size)
    limits: list[Any] = [(total + total.T) / 2 << -small, held >> 0, cp.sum(S[-2:]) <= float(_SHARE) * alpha]
    value = solved(cp, cp.Problem(cp.Minimize(reach), limits), P)
    if value is None or S.value is None:
        return None
    multipliers = np.maximum(S.value, 0.0)
    scaled = np.append(multipliers[:-2] * unit**2 / g[:-2] ** 2, multipliers[-2:])
    return back.T @ value @ back * unit**2, scaled
