"""One norm in which an error falls, whatever its slopes: in continuous time, at a theta, and from which theta on.

    V = e'P e,   V' <= -alpha V:   M'P + P M + alpha P < 0   for every M = M_0 + G diag(d) H, |d_j| <= 1

M is affine in each slope d_j, so that the corners, 2^m of m slopes, stand for all. Of more slopes than are worth that,
one form has a multiplier S_j >= 0 for each:

    [M_0'P + P M_0 + alpha P + H'S H, P G; G'P, -S] < 0

A P that serves a theta at the corners serves every larger one: M/theta is N and the slopes over theta^(degree + 1), and
those of a degree above -1 have 0 in their ranges, which shrink. What the form shows holds at the corners.

How far theta or the rate goes is searched in floats, with weights that are known as far as these reach and with others
from there, and proved where that ends. A solver finds P and S, rationals prove them. Without a solver, or of more rows
than it is asked for, P is one that is at hand, or that of large theta alone, N'P + P N = -I with all that moves in N at
its middle: it may serve too, from a larger theta on.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import numpy as np

from hgogen.analysis.evidence import Evidence
from hgogen.prove.contracting import farthest
from hgogen.prove.inclusion import Inclusion, Slope, Uncertain
from hgogen.prove.inequality import NOW, corners, falling, flow
from hgogen.prove.lmi import NoSolver, no_solver
from hgogen.prove.quadratic import (
    Array,
    Quadratic,
    Weights,
    floats,
    inverse_root,
    negative,
    proved,
    rational,
    reach,
    verified,
)
from hgogen.prove.semidefinite import Margin, widest
from hgogen.rigor import outward
from hgogen.rigor.definite import number
from hgogen.sentence import NONE, Reason, because, point, up

ROWS = 48  # of one form with multipliers: beyond, a solver takes longer than a check may
_WHAT = "one norm for all slopes"
LOWEST = Fraction(1, 100)  # theta that is looked for
FACTOR, TIMES = 4, 24  # by which theta is raised, and how often, until there is a norm
_STEP, _ROUNDS = 1.1, 8  # shorter ones are not worth new weights
CLOSE = 1.003  # where a search with known weights ends
SLOW = Fraction(1, 2**12)  # of the fastest rate: where a rate is looked for first
SHARES = tuple(Fraction(k, 200) for k in (200, 199, 190, 100, 0))  # of a rate that is proved
_BEYOND = tuple(Fraction(k, 1000) for k in (1000, 1001, 1010, 1050))  # of a theta that is proved
_BELOW = tuple(1 - Fraction(1, 2**k) for k in (10, 20, 30))  # of a theta, for one that is hardly smaller
_JOIN = 2  # forms at a time
_NARROWER = Fraction(99, 100)
_THETAS = 16  # of which what the error obeys is remembered

Pair = tuple[Array, Array]  # P and S, in floats


@dataclass(frozen=True)
class Falls:
    """A proof that V' <= -alpha V at `theta`, by the `weights`; their S is empty where corners stand one by one.
    `others`: what V holds beside P, by name."""

    theta: Fraction
    alpha: Fraction
    weights: Weights
    others: Evidence = field(default_factory=dict, hash=False)

    @property
    def rate(self) -> float:
        """r (1/s) with |e|_P <= exp(-r t), rounded down."""
        return outward.number(self.alpha / 2)[0]

    @property
    def written(self) -> Evidence:
        """P and the others, and S where there are multipliers."""
        return {"P": self.weights.P, **self.others} | ({"S": self.weights.S} if self.weights.S else {})


@dataclass(frozen=True, eq=False)
class Moved:
    """What a gain that moves makes of e' = M e: `shift` comes to M over theta; `cores` N, of which e' = theta N e is
    without b; and `ways` W, where W e comes to e' besides, times any share >= 0. All of FLINT's rationals."""

    shift: Array
    cores: tuple[Array, ...] = ()
    ways: tuple[Array, ...] = ()

    def forms(
        self, e: Uncertain, theta: Fraction, alpha: Any, hull: Sequence[Sequence[Fraction]]
    ) -> Iterator[Quadratic]:
        """Those of `falling`, and those of what is beside, which are as large."""
        known = floats if e.M.dtype == float else np.asarray
        shifted = falling(replace(e, M=e.M + known(self.shift * number(theta))), alpha, hull)
        yield from shifted
        k = shifted[0].size - len(e.M)
        still = replace(e, G=0 * e.G[:, :k], H=0 * e.H[:k])
        for core in self.cores:
            yield flow(replace(still, M=known(core * number(theta)))).falls(alpha)
        for way in self.ways:
            yield flow(replace(still, M=known(way * number(theta)))).falls(NOW)


def worth_trying(last: Fraction, first: Fraction, declared: Fraction) -> Iterator[Fraction]:
    """Thetas at which a proof is tried, of which floats know it from `last` to `first`: short ones, from the smallest
    on; below the declared one where that is the first."""
    tried = [Fraction(up(last * share, 3)) for share in _BEYOND] + [first * share for share in _BELOW] + [first]
    return (theta for theta in tried if first > declared or theta < first)


STILL = Moved(rational([[0]]))  # of a constant gain


@dataclass(frozen=True)
class FunctionSearch:
    """The `error` of an observer in continuous time, for which functions that fall are sought, at `theta` and beyond.
    `how`: what they are. A kind of function says which weights it has in floats at a theta and an alpha (`_weights`),
    which thetas and alphas these serve (`_thetas`, `_alphas`), and what it proves there (`at`)."""

    error: Inclusion
    theta: Fraction
    how: str = "one norm"
    close: ClassVar[tuple[float, float]] = (1.02, 1.1)  # where a search for weights ends: for theta, for a rate

    def at(self, theta: Fraction, alpha: Fraction = NOW) -> Falls | None:
        """A proof of that rate at a theta; None where none is found."""
        raise NotImplementedError

    @property
    def missing(self) -> Reason:
        """Why there is a proof at no theta."""
        raise NotImplementedError

    def obstacle(self, states: Sequence[Any]) -> Reason:
        """Why there is none at theta."""
        raise NotImplementedError

    def _weights(self, theta: Fraction, alpha: Fraction = NOW) -> Any:
        raise NotImplementedError

    def _thetas(self, by: Any) -> Callable[[Fraction], bool]:
        raise NotImplementedError

    def _alphas(self, by: Any) -> Callable[[Fraction], bool]:
        raise NotImplementedError

    @cached_property
    def fastest(self) -> Falls | None:
        """A proof at theta with a rate close to the largest; None where none is found."""
        theta, weights = self.theta, self._known
        if weights is None:
            return None
        most, alpha = self._most, Fraction(0)
        if self._alphas(weights)(most * SLOW):
            ends = most * SLOW, most
            alpha = _reached(*ends, weights, self._alphas, lambda a: self._weights(theta, a), self.close[1])
        tried = (self.at(theta, alpha * share) for share in SHARES)
        return next(filter(None, tried), None)

    @cached_property
    def least(self) -> Falls | None:
        """A proof at a theta close to the least, which is below the one at hand where there are weights at that; None
        where none is found."""
        first = self._first
        if first is None:
            return None
        theta, weights = first
        lowest = self.theta if theta > self.theta else min(LOWEST, theta / 2)
        end = farthest(lambda at: self._slowest(at)[0] < 0, theta, lowest, CLOSE)
        last = _reached(theta, end, weights, self._thetas, self._weights, self.close[0])
        return next(filter(None, map(self.at, worth_trying(last, theta, self.theta))), None)

    @property
    def _most(self) -> Fraction:
        """What no alpha at theta exceeds."""
        return Fraction(-2 * self.slowest[0])

    def unstable(self, states: Sequence[Any]) -> Reason:
        """The slopes at which, held, errors do not decay at theta; `NONE` where none of those tried is so."""
        speed, d = self.slowest
        if speed < 0:
            return NONE
        return because("with {slopes}, held there, errors do not decay", slopes=point(self.error.named(states, d)))

    @cached_property
    def _known(self) -> Any:
        """Weights at theta; None where there are none, or an error does not decay with slopes that are held."""
        return self._weights(self.theta) if self.slowest[0] < 0 else None

    @cached_property
    def _first(self) -> tuple[Fraction, Any] | None:
        """The first theta from the one at hand on at which there are weights, and these."""
        if self._known is not None:
            return self.theta, self._known
        for k in range(1, TIMES):
            weights = self._weights(self.theta * FACTOR**k)
            if weights is not None:
                return self.theta * FACTOR**k, weights
        return None

    @cached_property
    def _moving(self) -> Callable[[Fraction], Uncertain]:
        """What the error obeys at a theta, once for the last ones, as each is asked for at several rates."""
        return lru_cache(maxsize=_THETAS)(self.error.at)

    def _slowest(self, theta: Fraction) -> tuple[float, Array]:
        """The largest real part of an eigenvalue at the corners that are tried, and the corner."""
        e = self._moving(theta).floats
        d = np.array(self.error.hull, dtype=float) if self.error.hull else corners(e.G.shape[1])
        parts = np.linalg.eigvals(e.M + (e.G * d[:, None]) @ e.H).real.max(axis=1)
        return float(parts.max()), d[parts.argmax()]

    @cached_property
    def slowest(self) -> tuple[float, Array]:
        """That at theta."""
        return self._slowest(self.theta)


@dataclass(frozen=True)
class Flow(FunctionSearch):
    """Norms for an `error`; of an observer whose gain moves, what else it obeys where it is `moved`. `first` (n, n): a
    P > 0 in floats that may serve."""

    moved: Moved = STILL
    first: Array | None = None

    def _thetas(self, by: Any) -> Callable[[Fraction], bool]:
        P, S = by
        return lambda theta: negative(self._floats(theta, NOW), P, S, self._coordinates)

    def _alphas(self, by: Any) -> Callable[[Fraction], bool]:
        (P, S), theta, most = by, self.theta, self._most
        last = most * reach(self._floats(theta, Fraction(0)), self._floats(theta, most), P, S, self._coordinates)
        return lambda a: a <= last

    def obstacle(self, states: Sequence[Any]) -> Reason:
        """Why there is no proof at theta: slopes at which, held, errors do not decay, or the one that hinders most."""
        held = self.unstable(states)
        if held:
            return held
        try:
            most = self._hindrance
        except NoSolver as missing:
            return missing.reason
        if most is None or most.entry is None:
            return because("no norm is found for all slopes in their ranges")
        (i, j), low, high = most.entry, float(most.low), float(most.high)
        pattern = "no norm is found for all slopes in their ranges, db_{i}/d{z} in [{low:.3g}, {high:.3g}] hinders most"
        return because(pattern, i=i + 1, z=states[j], low=low, high=high)

    def by(self, weights: Weights, alpha: Fraction) -> Falls | None:
        """A proof at theta by these weights; None where they show nothing."""
        P, S = rational(weights.P), rational(weights.S)
        forms = self._exactly(self.theta, alpha)
        return Falls(self.theta, alpha, weights) if verified(forms, P, S) else None

    @property
    def missing(self) -> Reason:
        """Why there is no norm at any theta."""
        return no_solver(_WHAT) or because(
            "no norm is found in which the linear part of the error falls, whatever moves in it"
        )

    @cached_property
    def _hindrance(self) -> Slope | None:
        """The slope of b whose narrowing would bring the forms at theta nearest to being negative."""
        forms = self._floats(self.theta, Fraction(0))
        best = widest(forms, _WHAT, self._coordinates, priced=True) if forms[0].size <= ROWS else None
        if best is None:
            return None
        values, gains = [form.value(best.P, best.S) for form in forms], dict[Slope, float]()
        for k, slope in enumerate(self.error.slopes):
            if slope.entry is None or slope.low == slope.high:
                continue
            less = replace(slope, low=slope.low * _NARROWER, high=slope.high * _NARROWER)
            slopes = (*self.error.slopes[:k], less, *self.error.slopes[k + 1 :])
            others = replace(self, error=replace(self.error, slopes=slopes))._floats(self.theta, Fraction(0))
            moved = (form.value(best.P, best.S) - value for form, value in zip(others, values, strict=True))
            gains[slope] = sum(float((price * by).sum()) for price, by in zip(best.prices, moved, strict=True))
        return min(gains, key=gains.__getitem__, default=None)

    def at(self, theta: Fraction, alpha: Fraction = Fraction(0)) -> Falls | None:
        """A proof of that rate at a theta; None where none is found."""
        weights = self._weights(theta, alpha)
        known = weights and self._proved(self._exactly(theta, alpha), *weights)
        return Falls(theta, alpha, known) if known else None

    def _proved(self, forms: Sequence[Quadratic], P: Array, S: Array) -> Weights | None:
        """Weights near those in floats that prove the forms."""
        return proved(forms, P, S)

    def _weights(self, theta: Fraction, alpha: Fraction = Fraction(0)) -> Any:
        """Weights in floats with which the forms are negative."""
        forms = self._floats(theta, alpha)
        weights = self._sought(forms)
        return weights if weights is not None and negative(forms, *weights, self._coordinates) else None

    def _sought(self, forms: tuple[Quadratic, ...]) -> Pair | None:
        if forms[0].size > ROWS:
            return self._plain(forms)
        try:
            best = self._widest(forms)
        except NoSolver:
            return self._plain(forms)
        return (best.P, best.S) if best is not None and best.margin > 0 else None

    def _widest(self, forms: tuple[Quadratic, ...]) -> Margin | None:
        """The weights with the largest margin for the forms that ask for most: these are few, and are remembered. The
        others are checked, and join them until no form has less than half of the margin."""
        W, few, last = self._coordinates, self._binding, len(forms) - 1
        while True:
            few.extend({0, last} - {*few} if not few else ())
            best = widest([forms[k] for k in few], _WHAT, W)
            if best is None or best.margin <= 0 or len(few) == len(forms):
                return best
            values = [form.value(best.P, best.S) for form in forms]
            if W is not None:  # with multiplied relations as they are
                T = np.eye(forms[0].size)
                T[: len(W), : len(W)] = W
                values = [T.T @ value @ T for value in values]
            seen = np.array(values)
            largest = np.linalg.eigvalsh(seen).max(axis=1)
            order = [int(k) for k in largest.argsort()[::-1] if largest[k] > -best.margin / 2 and k not in few]
            if not order:
                return best
            few.extend(order[:_JOIN])

    @cached_property
    def _binding(self) -> list[int]:
        """The numbers of the forms that ask for most, as far as they are known."""
        return []

    def _plain(self, forms: tuple[Quadratic, ...]) -> Pair | None:
        """The first P, its trace n, or that of the linear part alone, and S with which slopes take least from it; None
        where it shows nothing."""
        first = self.first
        P = self.error.alone if first is None else np.asarray(first * len(first) / np.trace(first))
        if P is None:
            return None
        n = len(P)
        return P, np.linalg.norm(P @ forms[0].pairs[0][1][:, n:], axis=0)

    def _exactly(self, theta: Fraction, alpha: Fraction) -> tuple[Quadratic, ...]:
        return self._forms(self._moving(theta), theta, alpha)

    def _floats(self, theta: Fraction, alpha: Fraction) -> tuple[Quadratic, ...]:
        return self._forms(self._moving(theta).floats, theta, float(alpha))

    def _forms(self, e: Uncertain, theta: Fraction, alpha: Any) -> tuple[Quadratic, ...]:
        return tuple(self.moved.forms(e, theta, alpha, self.error.hull))

    @cached_property
    def _coordinates(self) -> Array | None:
        """P^(-1/2) of the first P, near which the P that are sought are."""
        return self.error.coordinates if self.first is None else inverse_root(self.first)


def _reached(
    start: Fraction,
    end: Fraction,
    weights: Any,
    serving: Callable[[Any], Callable[[Fraction], bool]],
    seek: Callable[[Fraction], Any],
    close: float,
) -> Fraction:
    """How far from the start towards the end there are weights: first as far as those reach that are known, and from
    there again with those that are sought there; then by halving."""
    for _ in range(_ROUNDS):
        value = farthest(serving(weights), start, end, CLOSE)
        better = seek(value) if not 1 / _STEP < value / start < _STEP else None
        start = value
        if better is None:
            break
        weights = better
    return farthest(lambda at: seek(at) is not None, start, end, close)
