"""The convergence of an observer with a linear core of its own on a chain of integrators, verified again.

    filtered             w_i' = w_(i+1) + c_i + L_i eta_i,   eta_i' = -theta alpha eta_i + theta^2 beta eta_(i-1)
    filtered_injection   w' = A w + c + diag(theta, .., theta^n) NH eta,   eta' = theta F eta + theta G (y - w_1)
    low_power            p_i' = q_i + c_i + theta k_i1 e_i,   q_i' = q_(i+1) + c_(i+1) + theta^2 k_i2 e_i,   i < n
    peaking_free         the same with sat q_(i+1) in q_i', e_i = sat q_(i-1) - p_i, and p_n' = c_n + theta last e_n

with eta_0 = y - w_1, e_1 = y - p_1, e_i = q_(i-1) - p_i, q_n = 0; c takes the estimate clamped to the box, sat is to
the range of the state; `gains` are L, or the pairs k. In the errors t_k theta^-p(k) (x_k - w_i(k)), t_k = s_i(k), the
core is theta N, N its matrix at theta = 1; a sat on the way of an error is a factor in [0, 1], so that N is in the hull
of those with 0 and with 1. G feeds c_i(k) into the fields that estimate. The error decays exponentially for every

    theta > max(1, 2 push L),   N'P + P N <= -I,   P > 0,   push >= |P G|,   L >= |S dc/dw S^-1| on the box

since V = e'P e has V' <= -(theta - 2 push L) |e|^2. Sources of the observers: Astolfi, Jungers, Zaccarian, ECC (2018);
Astolfi, Marconi, IEEE TAC 60 (2015); Astolfi, Marconi, Praly, Teel, Automatica 98 (2018).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from typing import Any

from ..box import NotShown
from ..chain import built, integrators, slope
from ..context import Context, Shown, on, short
from ..file import Built, Claim, Observer
from ..matrix import (
    Matrix,
    above_zero,
    column,
    decaying,
    demand_positive,
    matrix,
    minus,
    scalar,
    scaled,
    similar,
    times,
    transposed,
    unit,
    zeros,
)
from ..rule import STEEP
from ..structure import clamped, on_chains
from ..threshold import above

Numbers = Mapping[str, Any]
_SATURATED = 8  # states up to which the saturations are tried in all their combinations


@dataclass(frozen=True)
class Core:
    """The core N at its vertices. Field k is scaled by its `index` i(k), from 0; `fed` says whether c_i(k) enters."""

    vertices: list[Matrix]
    index: list[int]
    fed: list[bool]


def convergence(context: Context, claim: Claim) -> Shown:
    """Every theta above the bound converges; the structure of the form is another claim."""
    observer, evidence = built(context, claim), claim.evidence
    scale = integrators(context, evidence)
    core = _CORES[observer.name](observer.numbers, len(context.z))
    t, size = [scale.units[i] for i in core.index], len(core.index)
    P = matrix(evidence, "P", size, size)
    demand_positive({"P": P})
    for N in core.vertices:
        demand_positive({"-I - N'P - P N": decaying(similar(t, N), P)})
    _pushed(P, core, above_zero(evidence, "push"), len(context.z))
    _, boxes = slope(context, evidence, scale.expressions)
    above = f"the error converges exponentially for every theta above {short(threshold(observer, claim), 1)}"
    return Shown(f"in continuous time, without noise, {above}{on(context.form.box)}", scale.boxes + boxes)


def threshold(observer: Observer, claim: Claim) -> Fraction:
    """max(1, 2 push L) of a claim of convergence."""
    return max(Fraction(1), 2 * scalar(claim.evidence, "push") * scalar(claim.evidence, "bound"))


def _pushed(P: Matrix, core: Core, push: Fraction, n: int) -> None:
    """push^2 I - G'P P G > 0, G (size, n) of zeros and ones."""
    G = [[Fraction(int(fed and i == at)) for i in range(n)] for at, fed in zip(core.index, core.fed, strict=True)]
    PG = times(P, G)
    demand_positive({"push^2 I - G'P P G": minus(scaled(push**2, unit(n)), times(transposed(PG), PG))})


def _filtered(numbers: Numbers, n: int) -> Core:
    alpha, beta, L = scalar(numbers, "alpha"), scalar(numbers, "beta"), column(numbers, "gains", n)
    N = zeros(2 * n, 2 * n)
    for i in range(n):
        if i + 1 < n:
            N[i][i + 1] = Fraction(1)
        N[i][n + i] = L[i]
        N[n + i][n + i] = -alpha
        N[n + i][n + i - 1 if i else 0] = beta if i else -beta
    return Core([N], [*range(n), *range(n)], [True] * n + [False] * n)


def _filtered_injection(numbers: Numbers, n: int) -> Core:
    m = len(numbers["G"]) if isinstance(numbers["G"], list) else 0
    F, G, NH = matrix(numbers, "F", m, m), column(numbers, "G", m), matrix(numbers, "NH", n, m)
    above = [[Fraction(int(j == i + 1)) for j in range(n)] + NH[i] for i in range(n)]
    below = [[-G[i], *[Fraction(0)] * (n - 1), *F[i]] for i in range(m)]
    return Core([above + below], [*range(n), *[0] * m], [True] * n + [False] * m)


def _low_power(numbers: Numbers, n: int) -> Core:
    return Core(
        [_pairs(matrix(numbers, "gains", n - 1, 2), [1] * n)], [*range(n - 1), *range(1, n)], [True] * (2 * n - 2)
    )


def _peaking_free(numbers: Numbers, n: int) -> Core:
    """The core in which p_n follows p_1, .., p_(n-1), at every combination of saturated and free states."""
    if n > _SATURATED:
        raise NotShown(f"saturations of more than {_SATURATED} states are not tried")
    k, last = matrix(numbers, "gains", n - 1, 2), scalar(numbers, "last")
    vertices = []
    for shares in product((0, 1), repeat=n - 1):
        inner = [[*row[: n - 1], Fraction(0), *row[n - 1 :]] for row in _pairs(k, [1, *shares])]
        follows = [Fraction(0)] * (2 * n - 1)
        follows[n - 1], follows[-1] = -last, last * shares[-1]
        vertices.append([*inner[: n - 1], follows, *inner[n - 1 :]])
    return Core(vertices, [*range(n), *range(1, n)], [True] * (2 * n - 1))


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


_CORES: Mapping[str, Callable[[Numbers, int], Core]] = {
    "filtered": _filtered,
    "filtered_injection": _filtered_injection,
    "low_power": _low_power,
    "peaking_free": _peaking_free,
}


OBSERVERS = {
    "filtered": Built(("theta", "alpha", "beta", "gains")),
    "filtered_injection": Built(("theta", "F", "G", "NH")),
    "low_power": Built(("theta", "gains")),
    "peaking_free": Built(("theta", "gains", "last")),
}
RULES = tuple(
    rule
    for name in OBSERVERS
    for rule in (
        *on_chains(name, "convergence", convergence, (*STEEP, "units", "scale", "P", "push")),
        *on_chains(name, "theta", above(threshold), rests=(f"{name}.convergence",)),
        clamped(name),
    )
)
