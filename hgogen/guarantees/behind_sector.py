"""Whether an error with a model decays behind a saturation or a dead zone whose level adapts, at a theta and beyond.

    eps' = l (N eps - K (eps_1 - i(eps_1))) + J eps,   sigma' = l (-lambda sigma + r eps_1^2),   l = theta

V is that of the linear core (`sector`), with N + J/l in the place of N: its form is affine in each slope of b, as J is,
so that it is negative for all slopes in their ranges where it is at the corners. So is what is left where q = 0,
(N + J/l)'P + P (N + J/l). Of more slopes than are worth corners, each is bounded by a multiplier: with h its reading
and v what it enters, d (v h' + h v') <= S h h' + v v'/S for |d| <= 1. V' <= -alpha V asks for alpha/l times V beside
the form; of the dead zone, whose V holds sigma, alpha is l lambda at most. A V that serves a theta serves every larger
one, as J/l shrinks, and 0 is in the ranges (`common_norm`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import product
from typing import Any, ClassVar

import numpy as np
from flint import fmpq_mat

from hgogen.algebra.definite import positive
from hgogen.chains.columns import as_matrix
from hgogen.chains.injection import companion
from hgogen.chains.integrators import Integrators
from hgogen.guarantees.bounded_theta import Nothing
from hgogen.guarantees.common_norm import CLOSE, SLOW, Falls, Search
from hgogen.guarantees.inclusion import from_form, inclusion, nominal_units, plain
from hgogen.guarantees.inequality import one_by_one
from hgogen.guarantees.quadratic import Array, Weights, fractions, rational
from hgogen.guarantees.sector import Decay
from hgogen.guarantees.steepness import obstacle
from hgogen.sentence import Reason, because

_SMALL = 1e-9  # of a form's entries: by how much it is negative where floats take it to be
_BITS = 24  # of a multiplier


@dataclass(frozen=True)
class Behind(Search):
    """The `error` with all of it injected, of gains `K` (n), behind what adapts; the `decays` of its linear core, of
    which V are those that are sought."""

    how: str = "one function"
    K: tuple[Fraction, ...] = ()
    decays: tuple[Decay, ...] = ()
    close: ClassVar[tuple[float, float]] = (CLOSE, CLOSE)

    @property
    def missing(self) -> Reason:
        """Why there is no proof at any theta."""
        return because("the linear core is not shown to decay")

    def obstacle(self, states: Sequence[Any]) -> Reason:
        """Why there is none at theta."""
        return self.unstable(states) or because("no function is found for all slopes in their ranges")

    def at(self, theta: Fraction, alpha: Fraction = Fraction(0)) -> Falls | None:
        """A proof of that rate at a theta; None where none of these V shows it."""
        holding = (one for one in self.decays if self._holds(one, theta, alpha))
        return next(filter(None, (self._shown(one, theta, alpha) for one in holding)), None)

    @cached_property
    def _known(self) -> Decay | None:
        """The V that falls at theta, one that has a rate where there is one."""
        return self._weights(self.theta, self._most * SLOW) or self._weights(self.theta)

    @property
    def _most(self) -> Fraction:
        slowest = [self.theta * one.adaptation.decay for one in self.decays if one.adaptation.shape.most]
        return min([Fraction(-2 * self.slowest[0]), *slowest])

    def _weights(self, theta: Fraction, alpha: Fraction = Fraction(0)) -> Decay | None:
        return next((one for one in self.decays if self._holds(one, theta, alpha)), None)

    def _serves(self, by: Decay, theta: Fraction) -> bool:
        return self._holds(by, theta)

    def _serving(self, by: Decay) -> Callable[[Fraction], bool]:
        return lambda alpha: self._holds(by, self.theta, alpha)

    def _holds(self, one: Decay, theta: Fraction, alpha: Fraction = Fraction(0)) -> bool:
        e, P = self.error.at(theta).floats, np.array(self._P(one), dtype=float)
        parts = e.M / float(theta), e.G / float(theta), e.H
        forms = self._forms(one, parts, P, float(one.mu), float(one.tau), float(alpha / theta))
        return all(np.linalg.eigvalsh(form).max() < -_SMALL * np.abs(form).max() for form in forms)

    def _shown(self, one: Decay, theta: Fraction, alpha: Fraction) -> Falls | None:
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
        return Falls(theta, alpha, Weights(self._P(one), S), {"mu": one.mu, "tau": one.tau})

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
    return error if isinstance(error, Nothing) else Behind(error, Fraction(theta), K=tuple(gains), decays=decays)
