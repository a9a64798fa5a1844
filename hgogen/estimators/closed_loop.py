"""The closed loop of a Riccati observer that predicts and corrects, frozen at points of its box.

At F and C of a point the steady step of length h moves an error by

    T(h) = (1 - P C'(h/R) C) R_4(hF),   P^-1 = (exp(rho h) Phi P Phi' + h Q)^-1 + (1 - exp(-rho h)) S_0 + C'(h/R) C,

Phi = 1 + hF + (hF)^2/2 and R_4 the polynomial of classical Runge-Kutta, in whose place the plant has exp(hF). As h -> 0
that is e' = (F - P C'R^-1 C) e, whose error never grows in e'P^-1 e. In this norm, P of h -> 0, |T(h)^k| tells how far
Phi and R_4 are from exp(hF), and how much a sample has to correct at once. Beside the error, z itself moves: R_4 errs
by 2 % a step of a mode that turns by 1.2 in it. The corners lie a little inside: no plant stays at the very ends of all
its ranges, where a root or a fraction may be steep without bound. While it passes by one, an error may grow ten fold
before it decays; it must decay there too, for a plant may rest near a corner. An F that is read at samples moves with
them from point to point: there it is half of that, which trials of the shipped models asked for. Source of the
doubling: Chu, Fan, Lin, Wang, International Journal of Control 77 (2004).
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from hgogen.analysis.linearised import jacobians_on_box
from hgogen.analysis.scaling import Scaling
from hgogen.discretisation.growth import GROWTH, WIDER, continuous, growth, longest, polynomial
from hgogen.discretisation.runge_kutta import HEUN, RK4
from hgogen.discretisation.stability import pace, steady_covariance
from hgogen.estimators.riccati_part import Riccati

Array = np.ndarray
Flags = NDArray[np.bool_]
POINTS, EDGE = 12, 0.005  # corners of the box, and as many points inside; how far of each range the corners are
FOLLOWED = 1.2  # |h lambda| of a mode that turns: |exp(ix) - R_4(ix)| = x^5/120 is .02 there
PASSING = 10.0  # of the growth in continuous time, at a corner: more is much there
MOVED = 0.25  # over the fastest eigenvalue of every F: a shorter step moves no mode so far that its length resonates
STILL = 1e-9  # of the fastest eigenvalue: one of F that is 0
SHORT = 0.05  # over the fastest eigenvalue: a step that follows every F and every closed loop
LONGEST = 100  # over the fastest eigenvalue of every F: where the search for what is refused ends
ROUNDING = 1e-7  # of an eigenvalue of T
DOUBLED, SETTLED = 50, 1e-12  # doublings of a covariance's steps, at most, and a change that is none
SHARE = 0.5  # of what no error grows at, where F is read at samples
SAMPLES = 16  # of an input with a declared period, in one: on the line between them it errs by 2 %


@dataclass(frozen=True, eq=False)
class Loops:
    """F, N = C'R^-1 C, Q and rho S_0 (k, n, n), in coordinates in which the steady P of h -> 0 is 1, and rho.

    P starts from the values `starts` (s, k, n, n). With L = `back` (k, n, n), L P L' is the covariance, whose cap is
    `cap` (n), which may be inf. An error may grow by `most` (k) more than in continuous time.
    """

    F: Array
    N: Array
    Q: Array
    prior: Array
    rho: float
    starts: Array
    back: Array
    cap: Array
    most: Array

    @property
    def continuous(self) -> Array:
        """F - P N (k, n, n)."""
        return np.asarray(self.F - self.N)

    def transition(self, h: float) -> Array:
        """T(h) (k, n, n)."""
        *_, (_, _, P) = _doubled(*self._step(h))
        return self._transition(h, P)

    def way(self, h: float) -> Array:
        """The largest P_ii/cap_i (k) from every start to where P settles, after 1, 2, 3, 4, 6, 8, 12, .. steps."""
        return self._way(list(_doubled(*self._step(h))))

    def _way(self, doubled: Sequence[tuple[Array, Array, Array]], enough: float = 0.0) -> Array:
        """`way`, without what comes after a step from which on no share exceeds `enough`.

        From P <= c P_s, c >= 1, with the steady P_s, no later P exceeds c P_s, for a step of c P is at most c steps of
        P; and c is at most the trace of P_s^-1 P.
        """
        settled, one = doubled[-1][2], np.eye(self.F.shape[-1])
        with np.errstate(all="ignore"):
            inverse, bound = _solved(settled, one), self._shares(settled).max(axis=1)
        half, now = self.starts, self.starts
        largest = np.zeros(len(self.F))
        with np.errstate(all="ignore"):
            for A, G, H in doubled:
                P = np.concatenate((now, half))
                moved = H + A.swapaxes(1, 2) @ P @ _solved(one + G @ P, A)
                half, now = now, moved[: len(now)]
                largest = np.maximum(largest, self._shares(moved).max(axis=(0, 2)))
                later = np.maximum(1.0, (inverse * now).sum(axis=(2, 3))) * bound
                if (later <= enough).all():
                    break
        return largest

    def settles(self, h: float) -> Array:
        """Whether no error grows for ever at a point (k), neither by the steady P nor by what its cap leaves of it."""
        *_, (_, _, P) = _doubled(*self._step(h))
        return _decays(self._transition(h, P)) & _decays(self._transition(h, self._capped(P)))

    def longest(self, end: float) -> float:
        """The largest h up to which no error grows much, and no P reaches its cap that does not for h -> 0. The
        value does not depend on `end`; it is inf where it lies beyond `end`."""
        model, loop = (np.abs(np.linalg.eigvals(M)).max(initial=0.0) for M in (self.F, self.continuous))
        fastest = max(model, loop)
        if not fastest or SHORT / fastest > end:
            return math.inf
        start, coarse_end = SHORT / fastest, MOVED / max(model, STILL * fastest)
        most = self.most * continuous(self.continuous, np.full(len(self.F), start))
        free = cache(lambda: self.way(start) <= 1)  # as seldom asked as a cap is reached

        def grows(h: float) -> bool:
            doubled = list(_doubled(*self._step(h)))
            T = self._transition(h, doubled[-1][2])
            if (growth(T) > most).any():
                return True
            reached = ~(self._way(doubled, enough=1.0) <= 1)
            return bool(reached.any() and (free() & reached).any())

        return longest(grows, start, end, coarse_end)

    def refused(self, start: float) -> float:
        """The largest h from `start` on up to which errors settle at one of the F at least; inf for any h, or none."""
        fastest = np.abs(np.linalg.eigvals(self.F)).max(initial=0.0)

        def lost(h: float) -> bool:
            return not self.settles(h).any()

        start = WIDER ** math.floor(math.log(start, WIDER))  # the same steps are tried wherever the search begins
        return longest(lost, start, LONGEST / fastest) if fastest and not lost(start) else math.inf

    def _step(self, h: float) -> tuple[Array, Array, Array]:
        """A, G, H (k, n, n) of P <- H + A' P (1 + G P)^-1 A, of P before a sample."""
        grown = math.exp(min(self.rho * h, 100.0))  # beyond which all is forgotten
        Phi = polynomial(h * self.F, HEUN.polynomial)
        return (math.sqrt(grown) * Phi).swapaxes(1, 2), h * self.N + self._forgotten(h), h * self.Q

    def _transition(self, h: float, P: Array) -> Array:
        """T(h) by P before a sample."""
        one, seen, forgotten = np.eye(self.F.shape[-1]), h * self.N, self._forgotten(h)
        corrected = one - _solved(one + P @ (seen + forgotten), P @ seen)
        return np.asarray(corrected @ polynomial(h * self.F, RK4.polynomial))

    def _forgotten(self, h: float) -> Array | float:
        return -math.expm1(-self.rho * h) / self.rho * self.prior if self.rho else 0.0

    def _capped(self, P: Array) -> Array:
        """P (k, n, n), the covariance's rows and columns scaled by min(1, cap_i/P_ii)."""
        scale = 1 / np.maximum(self._shares(P), 1.0)
        moved = np.linalg.solve(self.back, scale[..., None] * self.back)
        return np.asarray(moved @ P @ np.swapaxes(moved, 1, 2))

    def _shares(self, P: Array) -> Array:
        """P_ii/cap_i (.., k, n) of P (.., k, n, n)."""
        return np.asarray(((self.back @ P) * self.back).sum(axis=-1) / self.cap)


def advised(part: Riccati, dt: float) -> tuple[float, float]:
    """The step length beyond which errors settle at no point of the box, inf where dt is no longer than is advised; and
    the one that is: up to it no error grows much at a point of the box, and the motion of the model is
    followed, inf where nothing up to `dt` is too long for that."""
    F, C = part.slopes(POINTS, EDGE)
    whole = F if part.known is None else jacobians_on_box(part.dynamics, POINTS, edge=EDGE)[0]
    low, peak = min(part.theta.late, part.theta.rest or part.theta.peak), part.theta.peak
    every = together([loops(part, F, C, theta, low) for theta in sorted({low, math.sqrt(low * peak), peak})])
    inputs = math.inf if part.period is None else part.period / SAMPLES
    share = 1.0 if part.known is None else SHARE
    take = min(inputs, FOLLOWED * pace(whole), share * every.longest(dt / share))
    if dt <= take:
        return math.inf, take
    return every.refused(take), take


def together(every: Sequence[Loops]) -> Loops:
    """The closed loops of several that have the same rho and caps."""
    F, N, Q, prior, back, most = (
        np.concatenate([getattr(each, name) for each in every]) for name in ("F", "N", "Q", "prior", "back", "most")
    )
    starts = np.concatenate([each.starts for each in every], axis=1)
    return Loops(F, N, Q, prior, every[0].rho, starts, back, every[0].cap, most)


def loops(part: Riccati, F: Array, C: Array, theta: float, rest: float) -> Loops:
    """The closed loops at F (k, n, n), C (k, p, n) that have a steady covariance at a theta; P starts at P(0), and at
    its steady value at the theta `rest`."""
    Q, _ = part.nominal
    rho = part.forgetting.initial[0] if part.forgetting is not None else 0.0
    n, scaling = len(Q), part.scaling
    prior = rho * np.diag(1 / part.cap) if rho else np.zeros((n, n))
    noise = scaling.process(theta) * Q * np.outer(scaling.spread(theta), scaling.spread(theta))
    steady = {each: _steady(part, F, C, each, rho) for each in {theta, rest}}
    P, rested = steady[theta], steady[rest]
    there, settled = _definite(P), _definite(rested)
    starts = np.array([np.broadcast_to(part.covariance, F.shape), np.where(settled[:, None, None], rested, P)])
    F, C, P, starts = F[there], C[there], P[there], starts[:, there]
    corners = len(there) // 2  # after the middle, and before as many points inside
    most = np.concatenate(([GROWTH], np.full(corners, PASSING), np.full(len(there) - 1 - corners, GROWTH)))
    N = np.swapaxes(C, 1, 2) @ (C / scaling.variances(np.asarray(part.nominal[1]), theta)[:, None])
    L = np.linalg.cholesky(P)
    inverse = np.linalg.inv(L)
    turned, back = np.swapaxes(L, 1, 2), np.swapaxes(inverse, 1, 2)
    return Loops(
        inverse @ F @ L,
        turned @ N @ L,
        inverse @ noise @ back,
        turned @ prior @ L,
        rho,
        inverse @ starts @ back,
        L,
        np.full(n, np.inf) if rho else part.cap,
        most[there],
    )


def _steady(part: Riccati, F: Array, C: Array, theta: float, rho: float) -> Array:
    """The steady P (k, n, n) of h -> 0."""
    (Q, R), n, scaling = part.nominal, len(part.cap), part.scaling
    if rho:
        C, R = np.concatenate((C, np.broadcast_to(np.eye(n), F.shape)), axis=1), np.concatenate((R, part.cap / rho))
    every = Scaling(scaling.states, (*scaling.outputs, *(0,) * (len(R) - len(scaling.outputs))), scaling.gauge)
    return steady_covariance(F + rho / 2 * np.eye(n), C, Q, R, theta, every)


def _decays(T: Array) -> Flags:
    """Whether each T (k, n, n) is finite and has no eigenvalue beyond 1."""
    finite = np.isfinite(T).all(axis=(1, 2))
    radius = np.abs(np.linalg.eigvals(np.where(finite[:, None, None], T, 0.0))).max(axis=1)
    return np.asarray(finite & (radius <= 1 + ROUNDING))


def _definite(P: Array) -> Flags:
    return np.array([bool(np.isfinite(X).all() and np.linalg.eigvalsh(X).min() > 0) for X in P], dtype=bool)


def _doubled(A: Array, G: Array, H: Array) -> Iterator[tuple[Array, Array, Array]]:
    """The maps of 1, 2, 4, .. steps (k, n, n) in one, until H is the steady P; where there is none, H is not finite or
    it is large."""
    one = np.eye(A.shape[-1])
    for _ in range(DOUBLED):
        yield A, G, H
        with np.errstate(all="ignore"):
            W = one + G @ H
            left, right = _solved(W, np.array((A, G)))
            more = A.swapaxes(1, 2) @ H @ left
            G, H, A = G + A @ right @ A.swapaxes(1, 2), H + (more + more.swapaxes(1, 2)) / 2, A @ left
            if not (np.abs(more) > SETTLED * np.abs(H).max(axis=(1, 2), keepdims=True)).any():
                break
    yield A, G, H


def _solved(W: Array, B: Array) -> Array:
    """The solutions W^-1 B (.., n, n), nan where W is not finite or singular."""
    W, B = np.broadcast_arrays(W, B)
    finite = np.isfinite(W)
    if finite.all():
        with suppress(np.linalg.LinAlgError):  # raised for one that is singular
            return np.asarray(np.linalg.solve(W, B))
    good = finite.all(axis=(-2, -1))
    good[good] = np.abs(np.linalg.det(W[good])) > 0
    solution = np.full(B.shape, np.nan)
    solution[good] = np.linalg.solve(W[good], B[good])
    return solution
