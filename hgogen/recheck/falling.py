"""That a norm falls whatever the slopes of an inclusion: V = e'P e, V' <= -alpha V for e' = (M + G diag(d) H) e.

M is affine in each |d_j| <= 1, so that the corners stand for all; with multipliers S >= 0 one form stands for them:

    [M'P + P M + alpha P + H'S H, P G; G'P, -S] < 0
"""

from collections.abc import Mapping
from fractions import Fraction
from itertools import product
from typing import Any

from .box import NotShown
from .interval import point
from .matrix import Matrix, column, demand_positive, matrix, plus, scaled, times, transposed, twice, unit, zeros
from .slope import definite
from .stages import Parts

WORK = 2**16  # corners times fields^3
_ROWS = 100  # of one form


def demand_falls(parts: Parts, alpha: Fraction, evidence: Mapping[str, Any]) -> None:
    """V' <= -alpha V by the evidence's P, and its S where it has one. Raises: `NotShown`."""
    M, G, H, n, m = parts.M, parts.G, parts.H, len(parts.M), len(parts.H)
    P = matrix(evidence, "P", n, n)
    demand_positive({"P": P})
    if "S" in evidence:
        _at_once(P, column(evidence, "S", m), plus(M, scaled(alpha / 2, unit(n))), G, H)
        return
    if 2**m * n**3 > WORK:
        raise NotShown("it has no S, and more corners of its slopes than are tried one by one")
    for d in product((-1, 1), repeat=m):
        moved = times([[x * sign for x, sign in zip(row, d, strict=True)] for row in G], H) if m else zeros(n, n)
        demand_negative("its inequality", plus(twice(P, plus(M, moved)), scaled(alpha, P)))


def _at_once(P: Matrix, S: list[Fraction], M: Matrix, G: Matrix, H: Matrix) -> None:
    """The one form, M with alpha/2 beside it."""
    n, m = len(M), len(S)
    if n + m > _ROWS:
        raise NotShown(f"its inequality has more than {_ROWS} rows")
    if any(value < 0 for value in S):
        raise NotShown("its S has a negative number")
    form = zeros(n + m, n + m)
    top, side = twice(P, M), times(P, G) if m else []
    if m:
        top = plus(top, times(transposed(H), [[value * x for x in row] for value, row in zip(S, H, strict=True)]))
    for i, row in enumerate(top):
        form[i][:n] = row
        for j in range(m):
            form[i][n + j] = form[n + j][i] = side[i][j]
    for j, value in enumerate(S):
        form[n + j][n + j] = -value
    demand_negative("its inequality", form)


def demand_negative(what: str, form: Matrix) -> None:
    """That a symmetric form is negative: by its elimination in intervals, where these are too wide in fractions.

    Raises: `NotShown`.
    """
    negated = scaled(Fraction(-1), form)
    known = definite([[point(value) for value in row] for row in negated]) if transposed(negated) == negated else 0
    if known < 0:
        raise NotShown(f"{what} is not negative")
    if not known:
        demand_positive({f"{what}, negated,": negated})
