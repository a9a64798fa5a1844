"""The closed loop of a Riccati observer that predicts and corrects, frozen at points of its box.

At F and C of a point the steady step of length h moves an error by

    T(h) = (1 - P C'(h/R) C) R_4(hF),   P^-1 = (exp(rho h) Phi P Phi' + h Q)^-1 + (1 - exp(-rho h)) S_0 + C'(h/R) C,

Phi = 1 + hF + (hF)^2/2 and R_4 the polynomial of classical Runge-Kutta, in whose place the plant has exp(hF). As h -> 0
that is e' = (F - P C'R^-1 C) e, whose error never grows in e'P^-1 e. In this norm, P of h -> 0, |T(h)^k| tells how far
Phi and R_4 are from exp(hF), and how much a sample has to correct at once. Beside the error, z itself moves: R_4 errs
by 2 % a step of a mode that turns by 1.2 in it. The corners lie a little inside: no plant stays at the very ends of all
its ranges, where a root or a fraction may be steep without bound. An F that is read at samples moves with them from
point to point: there it is half of that, which trials of the shipped models asked for. Source of the doubling: Chu,
Fan, Lin, Wang, International Journal of Control 77 (2004).
"""

import math
from dataclasses import dataclass

import numpy as np

from hgogen.growth import GROWTH, continuous, growth, longest, polynomial
from hgogen.kalman.riccati import Riccati
from hgogen.runge_kutta import HEUN, RK4
from hgogen.scaling import Scaling
from hgogen.stability import pace, steady_covariance

Array = np.ndarray
POINTS, EDGE = 12, 0.005  # corners of the box, and as many points inside; how far of each range the corners are
FOLLOWED = 1.2  # |h lambda| of a mode that turns: |exp(ix) - R_4(ix)| = x^5/120 is .02 there
SHORT = 0.05  # over the fastest eigenvalue: a step that follows every F and every closed loop
DOUBLED, SETTLED = 50, 1e-12  # doublings of a covariance's steps, at most, and a change that is none
SHARE = 0.5  # of what no error grows at, where F is read at samples
SAMPLES = 16  # of an input with a declared period, in one: on the line between them it errs by 2 %


@dataclass(frozen=True, eq=False)
class Loops:
    """F, N = C'R^-1 C, Q and rho S_0 (k, n, n) in coordinates in which the steady P of h -> 0 is 1, and rho."""

    F: Array
    N: Array
    Q: Array
    prior: Array
    rho: float

    @property
    def continuous(self) -> Array:
        """F - P N (k, n, n)."""
        return np.asarray(self.F - self.N)

    def transition(self, h: float) -> Array:
        """T(h) (k, n, n)."""
        one = np.eye(self.F.shape[-1])
        grown = math.exp(min(self.rho * h, 100.0))  # beyond which all is forgotten
        forgotten = -math.expm1(-self.rho * h) / self.rho * self.prior if self.rho else 0.0
        Phi = polynomial(h * self.F, HEUN.polynomial)
        P, seen = _steady(math.sqrt(grown) * Phi, h * self.N + forgotten, h * self.Q), h * self.N
        corrected = one - _solved(one + P @ (seen + forgotten), P @ seen)
        return np.asarray(corrected @ polynomial(h * self.F, RK4.polynomial))

    def longest(self, end: float) -> float:
        """The largest h up to `end` at which no error grows much; inf where none does up to there."""
        fastest = np.abs(np.linalg.eigvals(np.concatenate((self.F, self.continuous)))).max(initial=0.0)
        if not fastest or SHORT / fastest > end:
            return math.inf
        most = GROWTH * continuous(self.continuous, np.full(len(self.F), SHORT / fastest))

        def grows(h: float) -> bool:
            return bool((growth(self.transition(h)) > most).any())

        return longest(grows, SHORT / fastest, end) if grows(end) else math.inf


def advised(part: Riccati, dt: float) -> float:
    """A step length up to which no error grows much at a point of the box, and the motion of the model is followed; inf
    where nothing up to `dt` is too long for that."""
    F, C = part.slopes(POINTS, EDGE)
    whole = part.dynamics.linearised(POINTS, edge=EDGE)[0]
    rest, peak = part.theta.rest, part.theta.peak
    inputs = math.inf if part.period is None else part.period / SAMPLES
    grown = (loops(part, F, C, theta).longest(dt) for theta in {peak, peak if rest is None else rest})
    share = 1.0 if part.known is None else SHARE
    return min(inputs, FOLLOWED * pace(whole), share * min(grown))


def loops(part: Riccati, F: Array, C: Array, theta: float) -> Loops:
    """Those at F (k, n, n), C (k, p, n) that have a steady covariance at a theta."""
    Q, R = part.nominal
    rho = part.forgetting.initial[0] if part.forgetting is not None else 0.0
    n, scaling = len(Q), part.scaling
    prior = rho * np.diag(1 / part.cap) if rho else np.zeros((n, n))
    noise = scaling.process(theta) * Q * np.outer(scaling.spread(theta), scaling.spread(theta))
    N = np.swapaxes(C, 1, 2) @ (C / scaling.variances(np.asarray(R), theta)[:, None])
    seen, variances = (C, R) if not rho else (_and(C, np.eye(n)), np.concatenate((R, part.cap / rho)))
    every = Scaling(scaling.states, (*scaling.outputs, *(0,) * (len(variances) - len(R))), scaling.gauge)
    P = steady_covariance(F + rho / 2 * np.eye(n), seen, Q, variances, theta, every)
    there = np.array([bool(np.isfinite(X).all() and np.linalg.eigvalsh(X).min() > 0) for X in P])
    L = np.linalg.cholesky(P[there])
    inverse = np.linalg.inv(L)
    turned = np.swapaxes(L, 1, 2)
    return Loops(
        inverse @ F[there] @ L,
        turned @ N[there] @ L,
        inverse @ noise @ np.swapaxes(inverse, 1, 2),
        turned @ prior @ L,
        rho,
    )


def _and(C: Array, rows: Array) -> Array:
    return np.concatenate((C, np.broadcast_to(rows, (len(C), *rows.shape))), axis=1)


def _steady(A: Array, G: Array, H: Array) -> Array:
    """P (k, n, n) of P = A (P^-1 + G)^-1 A' + H by doubling; what has none is not finite, or large."""
    A, one = np.swapaxes(A, 1, 2), np.eye(A.shape[-1])
    with np.errstate(all="ignore"):
        for _ in range(DOUBLED):
            W = one + G @ H
            left, right = _solved(W, A), _solved(W, G)
            more = np.swapaxes(A, 1, 2) @ H @ left
            G, H, A = G + A @ right @ np.swapaxes(A, 1, 2), H + (more + np.swapaxes(more, 1, 2)) / 2, A @ left
            if not (np.abs(more) > SETTLED * np.abs(H).max(axis=(1, 2), keepdims=True)).any():
                break
    return H


def _solved(W: Array, B: Array) -> Array:
    """W^-1 B (k, n, n); nan where W is not finite, or singular."""
    good = np.isfinite(W).all(axis=(1, 2))
    good[good] = np.abs(np.linalg.det(W[good])) > 0
    found = np.full(B.shape, np.nan)
    found[good] = np.linalg.solve(W[good], B[good])
    return found
