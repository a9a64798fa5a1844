"""Whether an error with a model decays behind a saturation or a dead zone whose level adapts, at a theta and beyond.

    eps' = l (N eps - K (eps_1 - i(eps_1))) + J eps,   sigma' = l (-lambda sigma + r eps_1^2),   l = theta

V is that of the linear core (`sector`), with N + J/l in the place of N: its form is affine in each slope of b, as J is,
so that it is negative for all slopes in their ranges where it is at the corners. So is what is left where q = 0,
(N + J/l)'P + P (N + J/l). Of more slopes than are worth corners, each is bounded by a multiplier: with h its reading
and v what it enters, d (v h' + h v') <= S h h' + v v'/S for |d| <= 1. V' <= -alpha V asks for alpha/l times V beside
the form; of the dead zone, whose V holds sigma, alpha is l lambda at most. A V that serves a theta serves every larger
one, as J/l shrinks, and 0 is in the ranges (`common_norm`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from flint import fmpq_mat

from hgogen.algebra.definite import positive
from hgogen.chains.columns import as_matrix
from hgogen.chains.injection import companion
from hgogen.chains.integrators import Integrators
from hgogen.evidence.grounds import Evidence
from hgogen.guarantees.bounded_theta import Nothing
from hgogen.guarantees.common_norm import (
    CLOSE,
    FACTOR,
    LOWEST,
    SHARES,
    SLOW,
    TIMES,
    Flow,
    worth_trying,
)
from hgogen.guarantees.contracting import farthest
from hgogen.guarantees.inclusion import Inclusion, from_form, inclusion, nominal_units, plain
from hgogen.guarantees.inequality import one_by_one
from hgogen.guarantees.quadratic import Array, fractions, rational
from hgogen.guarantees.sector import Decay
from hgogen.guarantees.steepness import obstacle
from hgogen.intervals import outward
from hgogen.sentence import Reason, because

_SMALL = 1e-9  # of a form's entries: by how much it is negative where floats take it to be
_BITS = 24  # of a multiplier


@dataclass(frozen=True)
class Function:
    """A proof that V' <= -alpha V at `theta`, by `P` (n, n), mu and tau; `S` is empty where corners were taken."""

    theta: Fraction
    alpha: Fraction
    P: tuple[tuple[Fraction, ...], ...]
    mu: Fraction
    tau: Fraction
    S: tuple[Fraction, ...]

    @property
    def rate(self) -> float:
        """r (1/s) with |error(t)| <= c exp(-r t) (|error(0)| + sqrt sigma(0)), rounded down."""
        return outward.number(self.alpha / 2)[0]

    @property
    def written(self) -> Evidence:
        """P, mu and tau, and S where there are multipliers."""
        return {"P": self.P, "mu": self.mu, "tau": self.tau} | ({"S": self.S} if self.S else {})


@dataclass(frozen=True)
class Behind:
    """The `error` with all of it injected, of gains `K` (n), behind what adapts; the `decays` of its linear core."""

    error: Inclusion
    theta: Fraction
    K: tuple[Fraction, ...]
    decays: tuple[Decay, ...]
    how: str = "one function"

    @cached_property
    def least(self) -> Function | None:
        """At a theta close to the least; below the one at hand where there is a proof at that."""
        reaches = [(*reach, one) for one in self.decays for reach in self._reach(one)]
        if not reaches:
            return None
        last, first, one = min(reaches, key=lambda reach: reach[:2])
        return next(filter(None, (self._proved(one, at) for at in worth_trying(last, first, self.theta))), None)

    @cached_property
    def fastest(self) -> Function | None:
        """At theta, with a rate close to the largest that these V give; None where there is none."""
        best = max(((self._rate(one), k) for k, one in enumerate(self.decays)), default=(Fraction(-1), 0))
        if best[0] < 0:
            return None
        tried = (self._proved(self.decays[best[1]], self.theta, best[0] * share) for share in SHARES)
        return next(filter(None, tried), None)

    @property
    def missing(self) -> Reason:
        """Why there is no proof at any theta."""
        return because("the linear core is not shown to decay")

    def obstacle(self, states: Sequence[Any]) -> Reason:
        """Why there is none at theta."""
        held = self._flow.unstable(states)
        return held or because("no function is found for all slopes in their ranges")

    @cached_property
    def _flow(self) -> Flow:
        """The error with all of it injected, at theta."""
        return Flow(self.error, self.theta)

    def _reach(self, one: Decay) -> Iterator[tuple[Fraction, Fraction]]:
        """The least theta of a V in floats, and the first from the declared one on at which it serves, where there is
        one."""
        for k in range(TIMES):
            first = self.theta * FACTOR**k
            if self._holds(one, first):
                end = self.theta if k else min(LOWEST, first / 2)
                yield farthest(lambda at: self._holds(one, at), first, end, CLOSE), first
                return

    def _rate(self, one: Decay) -> Fraction:
        """The largest alpha of a V at theta, in floats; below 0 where it does not fall."""
        if not self._holds(one, self.theta):
            return Fraction(-1)
        most = Fraction(-2 * self._flow.slowest[0])
        if one.adaptation.shape.most:
            most = min(most, self.theta * one.adaptation.decay)
        first = most * SLOW

        def holds(alpha: Fraction) -> bool:
            return self._holds(one, self.theta, alpha)

        return farthest(holds, first, most, CLOSE) if holds(first) else Fraction(0)

    def _holds(self, one: Decay, theta: Fraction, alpha: Fraction = Fraction(0)) -> bool:
        e, P = self.error.at(theta).floats, np.array(self._P(one), dtype=float)
        parts = e.M / float(theta), e.G / float(theta), e.H
        forms = self._forms(one, parts, P, float(one.mu), float(one.tau), float(alpha / theta))
        return all(np.linalg.eigvalsh(form).max() < -_SMALL * np.abs(form).max() for form in forms)

    def _proved(self, one: Decay, theta: Fraction, alpha: Fraction = Fraction(0)) -> Function | None:
        e = self.error.at(theta)
        parts = tuple(np.array(fractions(M), dtype=object).reshape(M.shape) for M in (e.M, e.G, e.H))
        M, G, H = parts
        P = np.array(self._P(one), dtype=object)
        forms = self._forms(one, (M / theta, G / theta, H), P, one.mu, one.tau, alpha / theta)
        if one.adaptation.shape.most and alpha > theta * one.adaptation.decay:
            return None
        if not all(positive(fmpq_mat(rational(-form).tolist())) for form in forms):
            return None
        S = () if one_by_one(len(P), len(H)) else tuple(_multiplier(v) for v in (P @ G / theta).T)
        return Function(theta, alpha, self._P(one), one.mu, one.tau, S)

    def _P(self, one: Decay) -> tuple[tuple[Fraction, ...], ...]:
        """P of a V in the errors of the inclusion."""
        t = [one.growth**i / unit for i, unit in enumerate(self.error.units)]
        return tuple(tuple(t[i] * x * t[j] for j, x in enumerate(row)) for i, row in enumerate(one.P))

    def _forms(self, one: Decay, parts: tuple[Array, Array, Array], P: Array, mu: Any, tau: Any, a: Any) -> list[Array]:
        """The forms that are negative where V' <= -alpha V, a = alpha/theta, of M/theta, G/theta and H."""
        (N, G, H), way, n = parts, one.adaptation, len(P)
        K = np.array([type(mu)(unit * k) for unit, k in zip(self.error.units, self.K, strict=True)])
        base = way.form(N, K, P, mu, tau)
        moves = [way.form(N + np.outer(g, h), K, P, mu, tau) - base for g, h in zip(G.T, H, strict=True)]
        base = base + a * way.value(P, mu)
        inner = N.T @ P + P @ N + a * P
        turns = [np.outer(P @ g, h) + np.outer(h, P @ g) for g, h in zip(G.T, H, strict=True)]
        if one_by_one(len(P), len(H)):
            ends = list(product((-1, 1), repeat=len(H)))
            return [_moved(form, by, d) for form, by in ((base, moves), (inner, turns)) for d in ends]
        S = [type(mu)(_multiplier(v)) for v in (P @ G).T]
        wide = [np.append(h, 0 * mu) for h in H]
        return [_bounded(base, moves, wide, S), _bounded(inner[:n], turns, list(H), S)]


def _moved(form: Array, by: Sequence[Array], d: Sequence[int]) -> Array:
    return np.asarray(sum((sign * move for sign, move in zip(d, by, strict=True)), form))


def _bounded(form: Array, by: Sequence[Array], reads: Sequence[Array], S: Sequence[Any]) -> Array:
    """The form with what each move v h' + h v' comes to at most, either way."""
    for move, h, s in zip(by, reads, S, strict=True):
        v = move @ h - h * (h @ move @ h) / 2
        form = form + s * np.outer(h, h) + np.outer(v, v) / s
    return form


def _multiplier(v: Array) -> Fraction:
    """A short rational near |v|, above 0."""
    return Fraction(max(1, round(float(np.linalg.norm(v.astype(float))) * 2**_BITS)), 2**_BITS)


def behind(
    chain: Integrators, theta: float, K: np.ndarray, decays: tuple[Decay, ...], numbers: Any
) -> Behind | Nothing:
    """What is sought of an observer of gains K on a chain, that is built with the `numbers`."""
    reason = obstacle(chain.form)
    if reason:
        return Nothing(reason)
    near_z = nominal_units(chain)
    if isinstance(near_z, Nothing):
        return near_z
    units, gains = [unit / near_z[0] for unit in near_z], [Fraction(k) for k in K.tolist()]
    form, scale = chain.form, from_form(chain.form, units)
    error = inclusion(form, plain(form), companion(np.array(gains)), as_matrix(form, gains), scale, units, numbers)
    return error if isinstance(error, Nothing) else Behind(error, Fraction(theta), tuple(gains), decays)
