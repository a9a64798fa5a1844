"""How fast a step contracts, and at which step lengths and gains it still does.

A solver finds the weights, rationals prove them; what is searched is only proved where it ends. A proof is of one step
length and one theta.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache

import numpy as np

from hgogen.guarantees.inclusion import Inclusion, Uncertain
from hgogen.guarantees.inequality import NOW, ErrorStep, Inequality, corners, flow
from hgogen.guarantees.quadratic import Array, Weights, inverse_root, negative, proved
from hgogen.guarantees.semidefinite import sought

ROWS = 48  # fields and slopes of all stages: beyond, a solver takes longer than a check may
CLOSE = 1.02  # a search ends where its ends are that close
_HALVINGS = 6  # of the rate
_FIRST = Fraction(3, 4)  # of the rate at slopes that are held, which no norm exceeds, where one is looked for first
_LATER = Fraction(1, 3)  # of what was tried, where next
_PASSES = 2
_SHARES = (Fraction(1), Fraction(199, 200), Fraction(19, 20), Fraction(0))  # of a rate found in floats, for proofs
_WHAT = "a proof of the step"
_NOTHING = Fraction(0)
_LENGTHS = 16  # of which steps are remembered


@dataclass(frozen=True)
class Contracts:
    """A proof at `theta` and the step length `h`: |e+|_P^2 <= (1 - alpha h) |e|_P^2, by the `weights`."""

    theta: Fraction
    h: Fraction
    alpha: Fraction
    weights: Weights

    @property
    def rate(self) -> float:
        """r (1/s) with |e|_P <= exp(-r t) at the samples, rounded down."""
        lost = self.alpha * self.h  # by a logarithm of 1 - lost, a short step would lose its digits
        return -math.log1p(-float(lost)) / 2 / float(self.h) * (1 - 1e-9) if lost < 1 else math.inf


@dataclass(frozen=True)
class Steps:
    """The steps of a method on the error of an observer, at one theta and any length, of which proofs are sought."""

    error: Inclusion
    way: ErrorStep
    theta: Fraction

    @cached_property
    def at(self) -> Callable[[Fraction], Inequality]:
        """The step of a length h, made once for the last lengths, as each is asked for at several rates."""
        return lru_cache(maxsize=_LENGTHS)(lambda h: self.way(h, self._uncertain))

    @cached_property
    def _uncertain(self) -> Uncertain:
        return self.error.at(self.theta)

    def may_contract(self, h: Fraction) -> bool:
        """Whether floats find a proof, so that one in rationals is worth a try.

        Raises: `NoSolver`.
        """
        step = self.at(h)
        return step.rows <= ROWS and unstable(step) is None and self.weights(h, Fraction(0)) is not None

    def weights(self, h: Fraction, alpha: Fraction) -> tuple[Array, Array] | None:
        """Weights in floats for |e+|_P^2 <= (1 - alpha h) |e|_P^2; None where a solver finds none.

        Raises: `NoSolver`.
        """
        if self.coordinates is None:
            return None
        form = self.at(h).falls(alpha)
        weights = sought((form,), _WHAT, self.coordinates)
        return weights if weights is not None and negative((form.floats,), *weights, self.coordinates) else None

    @cached_property
    def coordinates(self) -> Array | None:
        """P^(-1/2) (N, N) of continuous time, near which the P of a step are; None where a solver finds none. It is
        sought near that of the linear part, and where that is far off once more."""
        W = self.error.coordinates
        for _ in range(_PASSES):
            weights = sought((flow(self._uncertain).falls(NOW),), _WHAT, W)
            if weights is None:
                return None
            W = inverse_root(weights[0])
        return W

    def proved(self, h: Fraction) -> Contracts | None:
        """A proof with a rate that is close to the largest that the inequality gives; None where none is found.

        Raises: `NoSolver`.
        """
        if not self.may_contract(h):
            return None
        slow, fast = Fraction(0), Fraction((1 - _frozen(self.at(h))[0] ** 2) / float(h))
        for k in range(_HALVINGS):
            middle = Fraction(math.sqrt(slow * fast)) if slow else fast * (_LATER if k else _FIRST)
            slow, fast = (middle, fast) if self.weights(h, middle) else (slow, middle)
        for alpha in (slow * share for share in _SHARES):
            weights = self.certain(h, alpha)
            if weights:
                return Contracts(self.theta, h, alpha, weights)
        return None

    def certain(self, h: Fraction, alpha: Fraction = _NOTHING) -> Weights | None:
        """Weights in rationals that prove |e+|_P^2 <= (1 - alpha h) |e|_P^2; None where none are found.

        Raises: `NoSolver`.
        """
        weights = self.weights(h, alpha)
        return weights and proved((self.at(h).falls(alpha),), *weights)


def farthest(holds: Callable[[Fraction], bool], start: Fraction, end: Fraction, close: float = CLOSE) -> Fraction:
    """A value between `start`, where it holds, and `end`, close to the last up to which it does as far as is tried."""
    if holds(end):
        return end
    while not 1 / close < start / end < close:
        middle = Fraction(math.sqrt(start) * math.sqrt(end))
        start, end = (middle, end) if holds(middle) else (start, middle)
    return start


def unstable(step: Inequality) -> Array | None:
    """Slopes d (m) in [-1, 1] at which, held, errors do not decay; None where none of those tried is so."""
    radius, d = _frozen(step)
    return d if radius >= 1 else None


def _frozen(step: Inequality) -> tuple[float, Array]:
    """The largest factor by which errors decay at slopes that are held, of those tried, and these slopes."""
    d = corners(step.slopes)
    radius = np.abs(np.linalg.eigvals(step.frozen(d))).max(axis=1)
    worst = int(radius.argmax())
    return float(radius[worst]), d[worst]
