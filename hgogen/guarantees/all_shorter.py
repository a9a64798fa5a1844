"""That a step contracts at every length up to one, each with the same slopes.

For fixed weights the form of an explicit method is a polynomial in h, of degree d = 2 s - 1 for s stages. On a piece
[a, b] it is a mean of its d + 1 Bernstein coefficients, so that it is negative there where these are; they are what
takes its values at d + 1 points, and are exact (Farouki, "The Bernstein polynomial basis: a centennial retrospective",
Computer Aided Geometric Design 29 (2012), 3.1). Pieces that have no weights are halved.
"""

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from math import comb

import numpy as np
from flint import fmpq_mat

from hgogen.algebra.definite import positive
from hgogen.guarantees.contracting import Steps
from hgogen.guarantees.quadratic import Array, Weights, floats, on_grid, rational, times

_PIECES = 12  # that are tried before it is given up
_GRID = 60  # bits after the point of the weights
_NOTHING = Fraction(0)


@dataclass(frozen=True)
class Piece:
    """A proof by the same `weights` at every step length from `low` to `high`."""

    low: Fraction
    high: Fraction
    weights: Weights


def all_shorter(steps: Steps, longest: Fraction) -> tuple[Piece, ...]:
    """Proofs of every step length above 0 up to the longest; none where not all are proved, or where the form is no
    polynomial in the length.

    Raises: `NoSolver`.
    """
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
