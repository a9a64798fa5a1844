"""A map that is one to one on a box though no inverse of it is known, by the signs of minors.

    F: box -> R^n differentiable, all principal minors of its Jacobian above 0 at every point:  F is one to one there

The box is a product of closed intervals, of any length. Such a Jacobian reverses the sign of no vector but 0, which
bisection may show: the theorem asks for each point by itself. It is no matter of determinants alone: that of
exp(x) (cos y, sin y) is exp(2 x), and y comes back. F is one to one where L F is, L a constant invertible matrix: an
order and signs of the rows of F, or about the inverse of its Jacobian at the middle.

D. Gale, H. Nikaido, "The Jacobian matrix and global univalence of mappings", Math. Annalen 159 (1965), theorem 4.
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import chain, combinations, islice, permutations

import numpy as np
import sympy as sp

from hgogen.analysis.determinant import as_written, determinant
from hgogen.check import Verdict
from hgogen.rigor.bounds import nonzero
from hgogen.rigor.box import Box, points
from hgogen.rigor.field import TooLarge
from hgogen.rigor.series import values
from hgogen.rigor.tape import NoTape, tape
from hgogen.signal import Signal

STATES = 5  # 31 minors, and 120 orders of rows
_TRIED = 3  # orders of rows for which a proof is tried
_SMALL = 1e-9  # of the largest minor at a sample point: not above 0
_SHORT = 64  # the largest denominator of a row's weights

Weights = tuple[tuple[Fraction, ...], ...]


def subsets(n: int) -> Iterator[tuple[int, ...]]:
    """All that are not empty, the small ones first."""
    return chain.from_iterable(combinations(range(n), size) for size in range(1, n + 1))


def univalent(jacobian: sp.Matrix, read: Sequence[Signal], box: Box, boxes: int) -> Weights | None:
    """Weights L (n, n) with which all principal minors of L times a Jacobian (n, n) are proved to be above 0 on a box,
    of the signals `read` by it; None where none are found."""
    n = jacobian.rows
    if n > STATES:
        return None
    sampled = _samples(jacobian, read)
    candidates = chain(islice(_orders(sampled), _TRIED), _combined(sampled)) if len(sampled) else ()
    return next((L for L in candidates if _proved(weighted(L, jacobian), box, boxes)), None)


def weighted(L: Weights, jacobian: sp.Matrix) -> sp.Matrix:
    """L times the Jacobian."""
    return sp.Matrix([[sp.Rational(x) for x in row] for row in L]) * jacobian


def minor(matrix: sp.Matrix, places: Sequence[int]) -> sp.Expr:
    """A principal minor, as the matrix is written. Raises: `TooLarge`."""
    rows = matrix.extract(list(places), list(places)).tolist()
    return as_written(rows, determinant(rows)).value


def _samples(jacobian: sp.Matrix, read: Sequence[Signal]) -> np.ndarray:
    """The Jacobian (k, n, n) at sample points of the box, the middle first; none of those where it is no number."""
    n = jacobian.rows
    try:
        program = tape(list(jacobian), read)
    except NoTape:
        return np.zeros((0, n, n))
    at = [[Fraction(point[s].p, point[s].q) for s in read] for point in points(read)]
    matrices = np.array([[float(x.mid()) for x in values(program, place)] for place in at]).reshape(-1, n, n)
    return np.asarray(matrices[np.isfinite(matrices).all(axis=(1, 2))])


def _orders(sampled: np.ndarray) -> Iterator[Weights]:
    """Orders and signs of the rows with which all minors are above 0 at the sample points."""
    n = sampled.shape[-1]
    for order in permutations(range(n)):
        signs = np.sign([sampled[0, k, i] for i, k in enumerate(order)])
        L = np.zeros((n, n))
        L[range(n), order] = signs
        if signs.all() and _positive(L @ sampled):
            yield _short(L)


def _combined(sampled: np.ndarray) -> Iterator[Weights]:
    """About the inverse of the Jacobian at the middle, where all minors are above 0 at the sample points with it."""
    n = sampled.shape[-1]
    if np.linalg.matrix_rank(sampled[0]) == n:
        inverse = np.linalg.inv(sampled[0])
        rows = _short(inverse / np.abs(inverse).max(axis=1, keepdims=True))
        L = np.array(rows, dtype=float)
        if np.linalg.matrix_rank(L) == n and _positive(L @ sampled):
            yield rows


def _positive(matrices: np.ndarray) -> bool:
    """Whether all principal minors of matrices (k, n, n) in floats are above 0."""
    n = matrices.shape[-1]
    every = (np.linalg.det(matrices[np.ix_(range(len(matrices)), s, s)]) for s in map(list, subsets(n)))
    return all(bool((minor > _SMALL * np.abs(minor).max()).all()) for minor in every)


def _short(L: np.ndarray) -> Weights:
    return tuple(tuple(Fraction(x).limit_denominator(_SHORT) for x in row) for row in L.tolist())


def _proved(matrix: sp.Matrix, box: Box, boxes: int) -> bool:
    """Whether all principal minors are proved to be above 0."""
    for places in subsets(matrix.rows):
        try:
            value = minor(matrix, places)
        except TooLarge:
            return False
        where = {s: box[s] for s in sorted(value.free_symbols, key=str)}
        sign = nonzero(value, where, boxes=boxes, refute=False)
        if sign.verdict is not Verdict.PROVED or sign.sign < 0:
            return False
    return True
