"""How fast a step contracts, and at which step lengths and gains it still does.

A solver finds the weights, rationals prove them; what is searched is only proved where it ends. A proof is of one step
length and one theta, or of every step length up to one, each with the same slopes: for fixed weights the form of an
explicit method is a polynomial in h, of degree d = 2 s - 1 for s stages. On a piece [a, b] it is a mean of its d + 1
Bernstein coefficients, so that it is negative there where these are; they are what takes its values at d + 1 points,
and are exact (Farouki, "The Bernstein polynomial basis: a centennial retrospective", Computer Aided Geometric Design 29
(2012), 3.1). Pieces that have no weights are halved.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from math import comb

import numpy as np
from flint import fmpq_mat

from hgogen.prove.inclusion import Inclusion, Uncertain
from hgogen.prove.inequality import NOW, ErrorStep, Inequality, corners, flow
from hgogen.prove.quadratic import Array, Weights, floats, inverse_root, negative, on_grid, proved, rational, times
from hgogen.prove.semidefinite import sought
from hgogen.rigor.definite import positive

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
_PIECES = 12  # that are tried before it is given up
_GRID = 60  # bits after the point of the weights


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
        """Whether floats find a proof, so that one in rationals is worth a try. Raises: `NoSolver`."""
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
        """A proof with a rate that is close to the largest that the inequality gives; None where none is found. Raises:
        `NoSolver`."""
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
        """Weights in rationals that prove |e+|_P^2 <= (1 - alpha h) |e|_P^2; None where none are found. Raises:
        `NoSolver`."""
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


@dataclass(frozen=True)
class Piece:
    """A proof by the same `weights` at every step length from `low` to `high`."""

    low: Fraction
    high: Fraction
    weights: Weights


def all_shorter(steps: Steps, longest: Fraction) -> tuple[Piece, ...]:
    """Proofs of every step length above 0 up to the longest; none where not all are proved, or where the form is no
    polynomial in the length. Raises: `NoSolver`."""
    if not steps.at(longest).degree:
        return ()
    left, pieces, tried = [(Fraction(0), longest)], [], 0
    while left:
        low, high = left.pop()
        tried += 1
        piece = _piece(steps, low, high)
        if piece is not None:
            pieces.append(piece)
        elif tried >= _PIECES:
            return ()
        else:
            left += [(low, (low + high) / 2), ((low + high) / 2, high)]
    return tuple(sorted(pieces, key=lambda piece: piece.low))


def _piece(steps: Steps, low: Fraction, high: Fraction) -> Piece | None:
    weights = steps.weights(high, _NOTHING)  # the longest asks for most
    if weights is None:
        return None
    P, S = (on_grid(value, _GRID) for value in weights)
    degree = steps.at(high).degree
    values = [steps.at(low + (high - low) * k / degree).falls(_NOTHING).value(P, S) for k in range(degree + 1)]
    parts = times(_bernstein(degree), np.array([value.ravel() for value in values])).reshape(-1, *values[0].shape)
    if any(np.linalg.eigvalsh(floats(part)).max() >= 0 for part in parts):
        return None
    shown = all(positive(fmpq_mat((-part).tolist())) for part in parts) and positive(fmpq_mat(P.tolist()))
    return Piece(low, high, Weights.of(P, S)) if shown else None


@lru_cache(maxsize=8)
def _bernstein(degree: int) -> Array:
    """(d + 1, d + 1): the Bernstein coefficients of a polynomial from its values at k/d, k = 0, .., d."""
    at = [Fraction(k, degree) for k in range(degree + 1)]
    basis = rational([[comb(degree, j) * t**j * (1 - t) ** (degree - j) for j in range(degree + 1)] for t in at])
    return np.array(fmpq_mat(basis.tolist()).inv().tolist(), dtype=object)
