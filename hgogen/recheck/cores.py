"""The linear error cores of observers on a chain of integrators, from their numbers: N of e' = theta N e.

Their equations stand in the docstring of `rules/in_continuous_time.py`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from typing import Any

from .box import NotShown
from .matrix import Matrix, column, companion, matrix, minus, scalar, transposed, zeros

Numbers = Mapping[str, Any]
_SATURATED = 8  # states up to which the saturations are tried in all their combinations


@dataclass(frozen=True)
class Core:
    """The core N at its `vertices`: with saturations that pass nothing first, and all last. Field k is scaled by the
    unit of its `index` i(k), from 0, and by theta^-`power`; `fed` says whether c_i(k) enters, `picks` which field
    stands for w_i in the argument of c, `measured` by what an error of the sample enters, over theta."""

    vertices: list[Matrix]
    index: list[int]
    power: list[int]
    fed: list[bool]
    picks: list[int]
    measured: list[Fraction]

    @property
    def gates(self) -> list[tuple[int, list[Fraction]]]:
        """What each saturation takes away: the field whose error it passes, and the column by which that enters the
        core beside the last vertex, where all is passed."""
        whole, columns = self.vertices[-1], []
        for k in reversed(range(len(self.vertices).bit_length() - 1)):
            taken = minus(self.vertices[-1 - 2**k], whole)
            columns += [(j, list(each)) for j, each in enumerate(transposed(taken)) if any(each)]
        return columns


def _filtered(numbers: Numbers, n: int) -> Core:
    alpha, beta, L = scalar(numbers, "alpha"), scalar(numbers, "beta"), column(numbers, "gains", n)
    N = zeros(2 * n, 2 * n)
    for i in range(n):
        if i + 1 < n:
            N[i][i + 1] = Fraction(1)
        N[i][n + i] = L[i]
        N[n + i][n + i] = -alpha
        N[n + i][n + i - 1 if i else 0] = beta if i else -beta
    estimate, filters = [*range(n)], [*range(1, n + 1)]
    measured = [Fraction(0)] * n + [beta] + [Fraction(0)] * (n - 1)
    return Core([N], 2 * estimate, estimate + filters, [True] * n + [False] * n, estimate, measured)


def _filtered_injection(numbers: Numbers, n: int) -> Core:
    m = len(numbers["G"]) if isinstance(numbers["G"], list) else 0
    F, G, NH = matrix(numbers, "F", m, m), column(numbers, "G", m), matrix(numbers, "NH", n, m)
    above = [[Fraction(int(j == i + 1)) for j in range(n)] + NH[i] for i in range(n)]
    below = [[-G[i], *[Fraction(0)] * (n - 1), *F[i]] for i in range(m)]
    order = [*range(n), *[0] * m]
    return Core([above + below], order, order, [True] * n + [False] * m, [*range(n)], [Fraction(0)] * n + G)


def _low_power(numbers: Numbers, n: int) -> Core:
    _has_pairs(n)
    order, N = [*range(n - 1), *range(1, n)], _pairs(matrix(numbers, "gains", n - 1, 2), [1] * n)
    picks, k = [0, *range(n - 1, 2 * n - 2)], matrix(numbers, "gains", n - 1, 2)
    return Core([N], order, order, [True] * (2 * n - 2), picks, _onto(k, 0, n - 1, 2 * n - 2))


def _peaking_free(numbers: Numbers, n: int) -> Core:
    """The core in which p_n follows p_1, .., p_(n-1), at every combination of saturated and free states."""
    _has_pairs(n)
    if n > _SATURATED:
        raise NotShown(f"saturations of more than {_SATURATED} states are not tried")
    k, last = matrix(numbers, "gains", n - 1, 2), scalar(numbers, "last")
    vertices = []
    for shares in product((0, 1), repeat=n - 1):
        inner = [[*row[: n - 1], Fraction(0), *row[n - 1 :]] for row in _pairs(k, [1, *shares])]
        follows = [Fraction(0)] * (2 * n - 1)
        follows[n - 1], follows[-1] = -last, last * shares[-1]
        vertices.append([*inner[: n - 1], follows, *inner[n - 1 :]])
    order = [*range(n), *range(1, n)]
    return Core(vertices, order, order, [True] * (2 * n - 1), [*range(n)], _onto(k, 0, n, 2 * n - 1))


def _onto(k: Matrix, p: int, q: int, size: int) -> list[Fraction]:
    """What an error of the sample adds to the first pair, whose fields stand at p and q."""
    return [k[0][0] if at == p else k[0][1] if at == q else Fraction(0) for at in range(size)]


def _has_pairs(n: int) -> None:
    """That there is a state beside the first: of one state there are no pairs, nor an error. Raises: `NotShown`."""
    if n < 2:
        raise NotShown("the observer is one of at least two states")


def _pairs(k: Matrix, shares: list[int]) -> Matrix:
    """The core of p_1, .., p_m, q_1, .., q_m; `shares` (m + 1): what passes of the error of y, q_1, .., q_m."""
    m = len(k)
    N = zeros(2 * m, 2 * m)
    for i, (first, second) in enumerate(k):
        N[i][m + i] += 1
        if i + 1 < m:
            N[m + i][m + i + 1] += shares[i + 2]
        for row, gain in ((i, first), (m + i, second)):
            N[row][i] -= gain
            if i:
                N[row][m + i - 1] += gain * shares[i]
    return N


def _injected(numbers: Numbers, n: int) -> Core:
    """The core with all of the error injected, of an observer that injects less of it, or by a gain that moves."""
    gains, order = column(numbers, "gains", n), [*range(n)]
    return Core([companion(gains)], order, order, [True] * n, order, gains)


OF_A_GAIN: tuple[str, ...] = ("high_gain", "circle_criterion")  # of a core A - K C, K a matrix
CONSTANT: tuple[str, ...] = ("filtered", "filtered_injection", "low_power", "peaking_free")  # of a core of its own
INJECTED = (*OF_A_GAIN, *CONSTANT)  # of a constant injection
CORES: Mapping[str, Callable[[Numbers, int], Core]] = {
    "filtered": _filtered,
    "filtered_injection": _filtered_injection,
    "low_power": _low_power,
    "peaking_free": _peaking_free,
    **dict.fromkeys(("stubborn", "dead_zone", "updated_gain", "adaptive_lmi"), _injected),
}
