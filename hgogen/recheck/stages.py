"""The inequality of a step of an explicit Runge-Kutta method on what the error obeys, built again.

    X_i = e + h sum_j a_ij w_j,   w_i = M X_i + G p_i,   p_i = diag(d_i) H X_i,   e+ = e + h sum_i b_i w_i

e is the error of two estimates that are given the same samples (`uncertain`); M takes its slopes at their middles, G
and H what is beside, |d_ij| <= 1 for each stage by itself. With v = (e, p_1, .., p_s), e+ = e + h D v, H X_i = Q_i v,
P > 0 and S >= 0 diagonal

    2 e'P D v + h |D v|_P^2 + alpha |e|_P^2 + sum of Q_i'S_i Q_i - p_i'S_i p_i < 0   for all v

shows |e+|_P^2 <= (1 - alpha h) |e|_P^2. For given P and S it is a polynomial in h of degree 2 s - 1. The methods are
Euler's, Heun's and the classical one of Runge and Kutta.
"""

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from .box import NotShown
from .file import part
from .interval import point
from .matrix import (
    Matrix,
    column,
    demand_positive,
    matrix,
    plus,
    scaled,
    times,
    transposed,
    unit,
    zeros,
)
from .slope import positive
from .text import number

_ROWS = 60  # of an inequality
_METHODS: Mapping[str, tuple[tuple[tuple[str, ...], ...], tuple[str, ...]]] = {
    "Euler": (((),), ("1",)),
    "Heun": (((), ("1",)), ("1/2", "1/2")),
    "classical Runge-Kutta": (((), ("1/2",), ("0", "1/2"), ("0", "0", "1")), ("1/6", "1/3", "1/3", "1/6")),
}
Method = tuple[list[list[Fraction]], list[Fraction]]  # a_ij of each stage, and b


def method_of(evidence: Mapping[str, Any]) -> Method:
    """The coefficients of the method that the evidence names. Raises: `NotShown`."""
    known = _METHODS.get(part(evidence, "method", str))
    if known is None:
        raise NotShown(f"its method is none of {', '.join(_METHODS)}")
    rows, weights = known
    return [[number(a) for a in row] for row in rows], [number(b) for b in weights]


def form_of(
    parts: tuple[Matrix, Matrix, Matrix],
    method: Method,
    h: Fraction,
    evidence: Mapping[str, Any],
    B: Matrix | None = None,
) -> Matrix:
    """2 e'P D v + h |D v|_P^2 + sum of Q'S Q - p'S p, without alpha; P and S are shown to have their signs. With B
    (N, 1) an error of the samples at both ends of the step is in v, on the line between them, and S goes on with it."""
    (M, G, H), (rows, weights) = parts, method
    n, m, s, inputs = len(M), len(H), len(weights), 2 if B else 0
    size = n + s * m
    if size > _ROWS:
        raise NotShown(f"its inequality has more than {_ROWS} rows")
    P, S = matrix(evidence, "P", n, n), column(evidence, "S", s * m + inputs)
    demand_positive({"P": P})
    if any(value < 0 for value in S):
        raise NotShown("its S has a negative number")
    one = unit(size + inputs)
    start, rates, reads = one[:n], list[Matrix](), list[list[Fraction]]()
    for i, row in enumerate(rows):
        X = plus(start, *(scaled(h * a, w) for a, w in zip(row, rates, strict=True)))
        reads += times(H, X) if m else []
        rate = [times(M, X), *([times(G, one[n + i * m : n + (i + 1) * m])] if m else [])]
        if B:
            c = sum(row, Fraction(0))  # where the stage stands
            rate.append(times(B, plus(scaled(1 - c, one[size : size + 1]), scaled(c, one[size + 1 :]))))
        rates.append(plus(*rate))
    D = plus(*(scaled(b, w) for b, w in zip(weights, rates, strict=True)))
    PD = times(P, D)
    linear = times(transposed(start), PD)
    form = plus(linear, transposed(linear), scaled(h, times(transposed(D), PD)))
    if m:
        weighed = [[value * x for x in row] for value, row in zip(S, reads, strict=False)]
        form = plus(form, times(transposed(reads), weighed))
    for k, value in enumerate(S):
        form[n + k][n + k] -= value
    return form


def corner(alpha: Fraction, evidence: Mapping[str, Any], size: int) -> Matrix:
    """alpha |e|_P^2."""
    P, whole = evidence["P"], zeros(size, size)
    for i, row in enumerate(matrix(evidence, "P", len(P), len(P))):
        for j, value in enumerate(row):
            whole[i][j] = alpha * value
    return whole


def definite(what: str, form: Matrix) -> None:
    """That a symmetric form is negative: by its elimination in intervals, where these are too wide in fractions.

    Raises: `NotShown`.
    """
    negated = scaled(Fraction(-1), form)
    if transposed(negated) == negated and positive([[point(value) for value in row] for row in negated]):
        return
    demand_positive({f"{what}, negated,": negated})
