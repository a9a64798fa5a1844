"""How far a frozen error e <- T(h) e grows on its way, and the longest step length h up to which that is not much."""

import math
from collections.abc import Callable
from functools import reduce

import numpy as np

Array = np.ndarray
GROWTH = 1.5  # of the growth in continuous time: more is much
BY_TRIAL = "found by trying errors at points of the declared box with the gains as declared, no proof"
WIDER, NARROWINGS = 1.2, 4  # of a search: the ratio of its steps, and the halvings of the logarithm of the last one
COARSE_STEPS = 8  # steps of a search at a time where it is coarse: 4.3 fold
TOGETHER, DECAYED = 8, 0.999  # powers at a time, and below 1 by more than rounding
POWERS, BASES, DOUBLINGS = 48, (24, 29, 34, 41), 12  # the k tried: to 48, and these times powers of two


def polynomial(X: Array, coefficients: tuple[float, ...]) -> Array:
    """The sum of c_j X^j (k, N, N), the constant first."""
    total, power = np.zeros_like(X), np.broadcast_to(np.eye(X.shape[-1]), X.shape)
    for c in coefficients:
        total, power = total + c * power, power @ X
    return total


def growth(T: Array) -> Array:
    """The largest |T^k| over the powers k >= 0 that are tried, at least 1, for each T (k, N, N). None after one that is
    below 1 is larger than those up to it, as |T^(j+k)| <= |T^j| |T^k|."""
    powers = np.empty((POWERS, *T.shape))
    largest: Array = np.ones(len(T))
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows has grown
        powers[0] = T
        for start in range(0, POWERS, TOGETHER):
            for k in range(max(1, start), start + TOGETHER):
                np.matmul(powers[k - 1], T, out=powers[k])
            sizes = _size(powers[start : start + TOGETHER])
            largest = np.maximum(largest, sizes.max(axis=0))
            if (sizes.min(axis=0) < DECAYED).all():
                return largest
        squares = powers[[k - 1 for k in BASES]]
        for _ in range(DOUBLINGS):
            squares = squares @ squares
            sizes = _size(squares)
            largest = np.maximum(largest, sizes.max(axis=0))
            if (sizes < DECAYED).all():
                break
    return np.where(np.isnan(largest), math.inf, largest)


def continuous(M: Array, units: Array) -> Array:
    """The largest |exp(M t)| for each M (k, N, N) over t at multiples of `units` (k)."""
    return growth(polynomial(M * units[:, None, None], tuple(1 / math.factorial(j) for j in range(9))))


def longest(grows: Callable[[float], bool], start: float, end: float, coarse_end: float = 0.0) -> float:
    """The largest h up to which an error does not grow, of start, WIDER start, .. and the halvings between two of them,
    so that it is one number for every `end`: `start` where it grows there; inf where it is beyond `end`. It is sought
    from below, for an error may grow at a length but not at a longer; up to `coarse_end`, in COARSE_STEPS at a time.
    """
    fine, step = max(0, math.floor(math.log(coarse_end / start, WIDER))) if coarse_end else 0, 0
    good = bad = start
    while not grows(bad):
        if bad >= end:
            return math.inf
        step += 1 if step >= fine else (fine - step) % COARSE_STEPS or COARSE_STEPS  # so that one of them is at `fine`
        good, bad = bad, start * WIDER**step
    while bad > 1.001 * good * WIDER**0.5**NARROWINGS:
        middle = math.sqrt(good * bad)
        good, bad = (good, middle) if grows(middle) else (middle, bad)
    return good if good <= max(start, end) else math.inf


def _size(T: Array) -> Array:
    """The largest sum of a row, of each; inf or NaN for what is not finite. Entry by entry: NumPy takes long for sums
    of a few numbers."""
    rows = reduce(np.add, np.moveaxis(np.abs(T), -1, 0))
    return np.asarray(reduce(np.maximum, np.moveaxis(rows, -1, 0)))
