"""That the error of an observer contracts as its step runs, verified again.

    X_i = e + h sum_j a_ij w_j,   w_i = M X_i + G p_i,   p_i = diag(d_i) H X_i,   e+ = e + h sum_i b_i w_i

e is the error of two estimates that are given the same samples (`uncertain`); M takes its slopes at their middles, G
and H what is beside, |d_ij| <= 1 for each stage by itself. With v = (e, p_1, .., p_s), e+ = e + h D v, H X_i = Q_i v,
P > 0 and S >= 0 diagonal

    2 e'P D v + h |D v|_P^2 + alpha |e|_P^2 + sum of Q_i'S_i Q_i - p_i'S_i p_i < 0   for all v

shows |e+|_P^2 <= (1 - alpha h) |e|_P^2. For given P and S it is a polynomial in h of degree 2 s - 1, which is negative
on a piece of a line where its Bernstein coefficients are. What holds at (h, theta) holds at (h theta/theta', theta') of
a larger theta': there h M is the same but for smaller slopes of b. The methods are Euler's, Heun's and the classical
one of Runge and Kutta.
"""

from collections.abc import Mapping
from fractions import Fraction
from functools import cache
from math import comb
from typing import Any

from ..box import NotShown
from ..chain import built
from ..context import Context, Shown, short
from ..cores import CORES
from ..file import Claim, part
from ..interval import point
from ..matrix import (
    Matrix,
    column,
    demand_nonnegative,
    demand_positive,
    matrix,
    plus,
    scalar,
    scaled,
    times,
    transposed,
    unit,
    zeros,
)
from ..slope import positive
from ..structure import on_chains
from ..text import number
from ..uncertain import error_inclusion

_ROWS = 60  # of an inequality
_PIECES = 24  # of a range of step lengths
_METHODS: Mapping[str, tuple[tuple[tuple[str, ...], ...], tuple[str, ...]]] = {
    "Euler": (((),), ("1",)),
    "Heun": (((), ("1",)), ("1/2", "1/2")),
    "classical Runge-Kutta": (((), ("1/2",), ("0", "1/2"), ("0", "0", "1")), ("1/6", "1/3", "1/3", "1/6")),
}


def step(context: Context, claim: Claim) -> Shown:
    """|e+|_P^2 <= (1 - alpha dt) |e|_P^2 at the observer's theta."""
    observer, evidence = built(context, claim), claim.evidence
    theta, h, alpha = scalar(observer.numbers, "theta"), scalar(evidence, "dt"), scalar(evidence, "alpha")
    if not (theta > 0 and h > 0 and 0 <= alpha * h < 1):
        raise NotShown("theta, dt and alpha are not positive, or alpha dt is not below 1")
    error, method = error_inclusion(context, observer, evidence), _method(evidence)
    form = _form(error.at(theta), method, h, evidence)
    _definite("its inequality", plus(form, _corner(alpha, evidence, len(form))))
    rate = f"|e|_P^2 falls by {short(alpha * h, -1)} of itself at each call"
    return Shown(f"by {part(evidence, 'method', str)} at dt = {short(h)}, theta = {short(theta)}, {rate}", error.boxes)


def throughout(context: Context, claim: Claim) -> Shown:
    """|e+|_P < |e|_P at the claim's theta, at most the observer's, at every step length up to a longest."""
    observer, evidence = built(context, claim), claim.evidence
    theta, error, method = scalar(evidence, "theta"), error_inclusion(context, observer, evidence), _method(evidence)
    if not 0 < theta <= scalar(observer.numbers, "theta"):
        raise NotShown("its theta is not between 0 and the observer's")
    parts, end = error.at(theta), Fraction(0)
    pieces = part(evidence, "pieces", list)
    if not 0 < len(pieces) <= _PIECES:
        raise NotShown(f"it has no pieces, or more than {_PIECES}")
    for piece in pieces:
        if not isinstance(piece, dict) or set(piece) != {"low", "high", "P", "S"}:
            raise NotShown("a piece is no object of low, high, P and S")
        low, high = scalar(piece, "low"), scalar(piece, "high")
        if low != end or not low < high:
            raise NotShown("its pieces do not follow each other from 0")
        degree = 2 * len(method[1]) - 1
        values = [_form(parts, method, low + (high - low) * Fraction(k, degree), piece) for k in range(degree + 1)]
        for weights in _bernstein(degree):
            _definite("its polynomial", plus(*(scaled(w, value) for w, value in zip(weights, values, strict=True))))
        end = high
    at = f"theta = {short(theta)} and every dt up to {short(end, -1)}"
    beyond = f"at each larger theta while theta dt is at most {short(theta * end, -1)}"
    return Shown(f"by {part(evidence, 'method', str)} |e|_P falls at {at}, and {beyond}", error.boxes)


def noise(context: Context, claim: Claim) -> Shown:
    """|z_i| <= bound of an error e in |e|_P <= 1, which stays there while the samples of an output err by at most 1:

    2 e'P D v + h |D v|_P^2 + alpha |e|_P^2 + .. - lambda_1 v^2 - lambda_2 v+^2 < 0,   lambda_1 + lambda_2 <= alpha
    """
    observer, evidence = built(context, claim), claim.evidence
    theta, h = scalar(observer.numbers, "theta"), scalar(evidence, "dt")
    if not (theta > 0 and h > 0):
        raise NotShown("theta and dt are not positive")
    error, method = error_inclusion(context, observer, evidence), _method(evidence)
    said: dict[tuple[int, int], str] = {}
    for one in part(evidence, "bounds", list):
        if not isinstance(one, dict) or set(one) != {"state", "output", "alpha", "P", "S", "bound"}:
            raise NotShown("a bound is no object of state, output, alpha, P, S and bound")
        state, output = _place(one, "state", len(context.z)), _place(one, "output", len(context.form.output))
        if (state, output) in said:
            raise NotShown("a bound stands twice")
        if not error.measured:
            raise NotShown("its gains are no numbers in these coordinates")
        alpha, bound, S = scalar(one, "alpha"), scalar(one, "bound"), part(one, "S", list)
        lambdas = column({"S": S[-2:]}, "S", 2)
        if not (0 < alpha * h < 1 and bound > 0 and min(lambdas) >= 0 and sum(lambdas) <= alpha):
            raise NotShown("alpha dt is not between 0 and 1, or its lambda exceed alpha")
        column_of = [[theta * row[output]] for row in error.measured]
        form = _form(error.at(theta), method, h, one, column_of)
        _definite("its inequality", plus(form, _corner(alpha, one, len(form))))
        number_of = context.value(error.scale[state]).number
        if not number_of:
            raise NotShown("its scale is no number")
        c = [Fraction(0)] * len(error.N)
        c[error.picks[state]] = theta ** error.power[error.picks[state]] / number_of
        P = matrix(one, "P", len(c), len(c))
        demand_nonnegative({"bound": [[bound**2, *c], *([x, *row] for x, row in zip(c, P, strict=True))]})
        said[state, output] = f"{context.z[state]} by at most {short(bound, 1)} for 1 of output {output + 1}"
    if not said:
        raise NotShown("it has no bounds")
    at = f"by {part(evidence, 'method', str)} at dt = {short(h)}, theta = {short(theta)}"
    return Shown(f"{at}, noise moves {', '.join(said.values())}", error.boxes)


def _place(holder: Mapping[str, Any], key: str, count: int) -> int:
    """A place from 0, given from 1. Raises: `NotShown`."""
    value = scalar(holder, key)
    if value.denominator > 1 or not 1 <= value <= count:
        raise NotShown(f"its {key} is none of 1 to {count}")
    return int(value) - 1


Method = tuple[list[list[Fraction]], list[Fraction]]


def _method(evidence: Mapping[str, Any]) -> Method:
    known = _METHODS.get(part(evidence, "method", str))
    if known is None:
        raise NotShown(f"its method is none of {', '.join(_METHODS)}")
    rows, weights = known
    return [[number(a) for a in row] for row in rows], [number(b) for b in weights]


def _form(
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


def _corner(alpha: Fraction, evidence: Mapping[str, Any], size: int) -> Matrix:
    """alpha |e|_P^2."""
    P, whole = evidence["P"], zeros(size, size)
    for i, row in enumerate(matrix(evidence, "P", len(P), len(P))):
        for j, value in enumerate(row):
            whole[i][j] = alpha * value
    return whole


def _definite(what: str, form: Matrix) -> None:
    """That a symmetric form is negative: by its elimination in intervals, where these are too wide in fractions.

    Raises: `NotShown`.
    """
    negated = scaled(Fraction(-1), form)
    if transposed(negated) == negated and positive([[point(value) for value in row] for row in negated]):
        return
    demand_positive({f"{what}, negated,": negated})


@cache
def _bernstein(degree: int) -> list[list[Fraction]]:
    """The Bernstein coefficients of a polynomial from its values at k/degree: the inverse of the basis there."""
    size, at = degree + 1, [Fraction(k, degree) for k in range(degree + 1)]
    rows = [[comb(degree, j) * t**j * (1 - t) ** (degree - j) for j in range(size)] for t in at]
    rows = [[*row, *one] for row, one in zip(rows, unit(size), strict=True)]
    for k in range(size):
        pivot = next(i for i in range(k, size) if rows[i][k])
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [x / rows[k][k] for x in rows[k]]
        for i in range(size):
            if i != k:
                factor = rows[i][k]
                rows[i] = [x - factor * y for x, y in zip(rows[i], rows[k], strict=True)]
    return [row[size:] for row in rows]


_OF_GAIN, _OF_CORE = ("core", "ranges"), ("units",)
RULES = tuple(
    rule
    for name, own in (("high_gain", _OF_GAIN), *((name, _OF_CORE) for name in CORES))
    for keys in [("scale", "slopes", "method", *own)]
    for rule in (
        *on_chains(name, "step", step, (*keys, "dt", "alpha", "P", "S")),
        *on_chains(name, "shorter", throughout, (*keys, "theta", "pieces")),
        *on_chains(name, "tuned", throughout, (*keys, "theta", "pieces")),
        *on_chains(name, "noise", noise, (*keys, "dt", "bounds")),
    )
)
