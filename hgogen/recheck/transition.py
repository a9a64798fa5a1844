"""The matrix exponential's weights of a core X, to a width that is known.

    exp X = 1 + X phi_1,   phi_1 = 1 + X phi_2,   phi_2 = 1/2 + X/3! + X^2/4! + ..

phi_2 by its series for X/2^k of a norm of at most 1/2, in intervals; then k doublings of X,

    phi_2(2 X) = (phi_0 phi_2 + phi_1 + phi_2)/4,   phi_1(2 X) = (phi_0 phi_1 + phi_1)/2,   phi_0(2 X) = phi_0^2
"""

from fractions import Fraction
from functools import lru_cache, reduce
from math import factorial
from operator import add

from .box import NotShown
from .interval import Interval, between, point
from .matrix import Matrix

_TERMS = 24  # of the series
_DOUBLINGS = 40
Intervals = list[list[Interval]]


def weight(X: Matrix) -> tuple[Matrix, Fraction]:
    """A matrix, and by how much none of its elements is beside that of phi_2(X). Raises: `NotShown`."""
    return _weight(tuple(map(tuple, X)))


@lru_cache(maxsize=8)  # the inequalities of one claim share it
def _weight(X: tuple[tuple[Fraction, ...], ...]) -> tuple[Matrix, Fraction]:
    norm, k, n = max(sum(map(abs, row), Fraction(0)) for row in X), 0, len(X)
    while norm > Fraction(1, 2):
        norm, k = norm / 2, k + 1
    if k > _DOUBLINGS:
        raise NotShown("its core is too fast for its dt")
    small = [[point(x / 2**k) for x in row] for row in X]
    one = [[point(Fraction(i == j)) for j in range(n)] for i in range(n)]
    left = 2 * norm**_TERMS / factorial(_TERMS + 2)  # the terms that are left out are together below twice the first
    phi_2 = [[between(-left, left)] * n for _ in range(n)]
    power = one
    for j in range(_TERMS):
        phi_2 = _sum(phi_2, _over(factorial(j + 2), power))
        power = _product(small, power)
    phi_1 = _sum(one, _product(small, phi_2))
    phi_0 = _sum(one, _product(small, phi_1))
    for _ in range(k):
        phi_2 = _over(4, _sum(_product(phi_0, phi_2), phi_1, phi_2))
        phi_1 = _over(2, _sum(_product(phi_0, phi_1), phi_1))
        phi_0 = _product(phi_0, phi_0)
    ends = [[(_known(low), _known(high)) for low, high in (each.exactly for each in row)] for row in phi_2]
    middles = [[(low + high) / 2 for low, high in row] for row in ends]
    return middles, max((high - low) / 2 for row in ends for low, high in row)


def _known(end: Fraction | float) -> Fraction:
    """An end that is a number. Raises: `NotShown`."""
    if not isinstance(end, Fraction):
        raise NotShown("its core has no exponential that intervals bound")
    return end


def _product(a: Intervals, b: Intervals) -> Intervals:
    columns = list(zip(*b, strict=True))
    return [[reduce(add, (x * y for x, y in zip(row, each, strict=True))) for each in columns] for row in a]


def _sum(*terms: Intervals) -> Intervals:
    return [[reduce(add, each) for each in zip(*rows, strict=True)] for rows in zip(*terms, strict=True)]


def _over(divisor: int, a: Intervals) -> Intervals:
    share = point(Fraction(1, divisor))
    return [[share * x for x in row] for row in a]
