"""That the error of an observer contracts as its step runs, verified again.

    e' = (theta N + sum over slopes of theta^-degree d onto of') e,   d in [low, high] each by itself, within one stage
    X_i = e + h sum_j a_ij w_j,   w_i = M X_i + G p_i,   p_i = diag(d_i) H X_i,   e+ = e + h sum_i b_i w_i

e holds the errors of fields over their units and theta^power: of two estimates that are given the same samples. A slope
of b_i in z_j, in these coordinates, has 0 in its range, as a clamp lets a share of the error pass, and the degree
power(i) - power(j); an a_i that moves, and a saturation in the core, have the degree -1. M takes the slopes at their
middles, G and H what is beside. With v = (e, p_1, .., p_s), e+ = e + h D v, H X_i = Q_i v, P > 0 and S >= 0 diagonal

    2 e'P D v + h |D v|_P^2 + alpha |e|_P^2 + sum of Q_i'S_i Q_i - p_i'S_i p_i < 0   for all v

shows |e+|_P^2 <= (1 - alpha h) |e|_P^2. For given P and S it is a polynomial in h of degree 2 s - 1, which is negative
on a piece of a line where its Bernstein coefficients are. What holds at (h, theta) holds at (h theta/theta', theta') of
a larger theta': there h M is the same but for smaller slopes of b. The cores are those of `linear_core` and
`constant_gain`; the methods are Euler's, Heun's and the classical one of Runge and Kutta.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from math import comb
from typing import Any

from ..box import NotShown, covered
from ..chain import built, constants, core_of, integrators, invertible, wanted_gain
from ..context import RANGE, Context, Shown, enclosed, narrowed, short
from ..cores import CORES
from ..file import Claim, Observer, part
from ..interval import point
from ..matrix import (
    Matrix,
    column,
    demand_positive,
    entries,
    matrix,
    plus,
    scalar,
    scaled,
    similar,
    times,
    transposed,
    unit,
    zeros,
)
from ..slope import continuous, positive, steep
from ..structure import on_chains
from ..text import Expression, number

_ROWS = 60  # of an inequality
_PIECES = 24  # of a range of step lengths
_METHODS: Mapping[str, tuple[tuple[tuple[str, ...], ...], tuple[str, ...]]] = {
    "Euler": (((),), ("1",)),
    "Heun": (((), ("1",)), ("1/2", "1/2")),
    "classical Runge-Kutta": (((), ("1/2",), ("0", "1/2"), ("0", "0", "1")), ("1/6", "1/3", "1/3", "1/6")),
}


@dataclass(frozen=True)
class _Slope:
    """What the error of the field `of` brings into the rates by `onto`, over theta^`degree`: in [low, high]."""

    of: int
    onto: list[Fraction]
    low: Fraction
    high: Fraction
    degree: int


@dataclass(frozen=True)
class _Error:
    """N and the slopes, with how many boxes they were shown."""

    N: Matrix
    slopes: list[_Slope]
    boxes: int

    def at(self, theta: Fraction) -> tuple[Matrix, Matrix, Matrix]:
        """M (N, N), G (N, m) and H (m, N)."""
        M, G, H = scaled(theta, self.N), [], []
        for slope in self.slopes:
            share = theta**-slope.degree
            for row, x in zip(M, slope.onto, strict=True):
                row[slope.of] += x * share * (slope.low + slope.high) / 2
            if slope.low < slope.high:
                G.append([x * share * (slope.high - slope.low) / 2 for x in slope.onto])
                H.append([Fraction(int(k == slope.of)) for k in range(len(M))])
        return M, transposed(G) if G else [[] for _ in M], H


def step(context: Context, claim: Claim) -> Shown:
    """|e+|_P^2 <= (1 - alpha dt) |e|_P^2 at the observer's theta."""
    observer, evidence = built(context, claim), claim.evidence
    theta, h, alpha = scalar(observer.numbers, "theta"), scalar(evidence, "dt"), scalar(evidence, "alpha")
    if not (theta > 0 and h > 0 and 0 <= alpha * h < 1):
        raise NotShown("theta, dt and alpha are not positive, or alpha dt is not below 1")
    error, method = _error(context, observer, evidence), _method(evidence)
    form = _form(error.at(theta), method, h, evidence)
    _definite("its inequality", plus(form, _corner(alpha, evidence, len(form))))
    rate = f"|e|_P^2 falls by {short(alpha * h, -1)} of itself at each call"
    return Shown(f"by {part(evidence, 'method', str)} at dt = {short(h)}, theta = {short(theta)}, {rate}", error.boxes)


def throughout(context: Context, claim: Claim) -> Shown:
    """|e+|_P < |e|_P at the claim's theta, at most the observer's, at every step length up to a longest."""
    observer, evidence = built(context, claim), claim.evidence
    theta, error, method = scalar(evidence, "theta"), _error(context, observer, evidence), _method(evidence)
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


Method = tuple[list[list[Fraction]], list[Fraction]]


def _method(evidence: Mapping[str, Any]) -> Method:
    known = _METHODS.get(part(evidence, "method", str))
    if known is None:
        raise NotShown(f"its method is none of {', '.join(_METHODS)}")
    rows, weights = known
    return [[number(a) for a in row] for row in rows], [number(b) for b in weights]


def _form(parts: tuple[Matrix, Matrix, Matrix], method: Method, h: Fraction, evidence: Mapping[str, Any]) -> Matrix:
    """2 e'P D v + h |D v|_P^2 + sum of Q'S Q - p'S p, without alpha; P and S are shown to have their signs."""
    (M, G, H), (rows, weights) = parts, method
    n, m, s = len(M), len(H), len(weights)
    size = n + s * m
    if size > _ROWS:
        raise NotShown(f"its inequality has more than {_ROWS} rows")
    P, S = matrix(evidence, "P", n, n), column(evidence, "S", s * m)
    demand_positive({"P": P})
    if any(value < 0 for value in S):
        raise NotShown("its S has a negative number")
    one = unit(size)
    start, rates, reads = one[:n], list[Matrix](), list[list[Fraction]]()
    for i, row in enumerate(rows):
        X = plus(start, *(scaled(h * a, w) for a, w in zip(row, rates, strict=True)))
        reads += times(H, X) if m else []
        forced = times(G, one[n + i * m : n + (i + 1) * m]) if m else zeros(n, size)
        rates.append(plus(times(M, X), forced))
    D = plus(*(scaled(b, w) for b, w in zip(weights, rates, strict=True)))
    PD = times(P, D)
    linear = times(transposed(start), PD)
    form = plus(linear, transposed(linear), scaled(h, times(transposed(D), PD)))
    if m:
        form = plus(
            form, times(transposed(reads), [scaled(value, [row])[0] for value, row in zip(S, reads, strict=True)])
        )
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


# --- what the error obeys


def _error(context: Context, observer: Observer, evidence: Mapping[str, Any]) -> _Error:
    """N and the slopes of the file's observer, from its numbers and the plant. Raises: `NotShown`."""
    _ = context.equations
    return (_of_gain if observer.name == "high_gain" else _of_core)(context, observer, evidence)


def _of_core(context: Context, observer: Observer, evidence: Mapping[str, Any]) -> _Error:
    """That of an observer with a core of its own on one chain of integrators."""
    scale, n = integrators(context, evidence), len(context.z)
    core = CORES[observer.name](observer.numbers, n)
    t = [scale.units[i] for i in core.index]
    slopes, boxes = _slopes(context, evidence, scale.expressions, [*range(n)], core.fed, core.index, core.picks)
    for of, onto in core.gates:
        moved = [x * t[k] / t[of] for k, x in enumerate(onto)]
        slopes.append(_Slope(of, moved, Fraction(0), Fraction(1), -1))
    return _Error(similar(t, core.vertices[-1]), slopes, boxes + scale.boxes)


def _of_gain(context: Context, observer: Observer, evidence: Mapping[str, Any]) -> _Error:
    """That of a constant gain: the core is a matrix of numbers, or moves with a_i in ranges."""
    n, form = len(context.z), context.form
    if form.alignment not in ("", "top", "end"):
        raise NotShown("its chains are not aligned at the top or at the end")
    scale = constants(context, entries(evidence, "scale", n))
    boxes, longest = invertible(context, scale), max(form.blocks)
    shift = [longest - size if form.alignment == "end" else 0 for size in form.blocks]
    powers = [late + level for late, size in zip(shift, form.blocks, strict=True) for level in range(size)]
    slopes, more = _slopes(context, evidence, scale, powers, [True] * n, [*range(n)], [*range(n)])
    if ("core" in evidence) is ("ranges" in evidence):
        raise NotShown("its evidence has not one of a core and ranges")
    if "core" in evidence:
        return _Error(core_of(context, scale, observer.gains, matrix(evidence, "core", n, n)), slopes, boxes + more)
    moving, seen = _moving(context, observer, evidence, scale)
    return _Error(zeros(n, n), slopes + moving, boxes + more + seen)


def _moving(
    context: Context, observer: Observer, evidence: Mapping[str, Any], scale: list[Expression]
) -> tuple[list[_Slope], int]:
    """The a_i in their ranges: a_1 of a chain by -K, the others from state to state; S and K are numbers."""
    blocks, slopes, boxes = context.form.blocks, [], 0
    S, K = ([_number(context, text) for text in texts] for texts in (scale, observer.gains))
    if any(s != 1 for s in S):
        raise NotShown("its scale is not 1, which the a_i of ranges want")
    places = [(k, i) for k, size in enumerate(blocks, 1) for i in range(1, size + 1)]
    heads = [sum(blocks[: k - 1]) for k, _ in places]
    for at, (place, range_) in enumerate(zip(places, entries(evidence, "ranges", len(places)), strict=True)):
        if not isinstance(range_, Mapping) or range_.keys() != set(RANGE):
            raise NotShown(f"a range of an a_i is no object with {', '.join(RANGE)}")
        low, high, shown = enclosed(context, _as_claim(range_), *wanted_gain(context, place))
        boxes += shown.boxes
        onto = [-k if heads[i] == at else Fraction(0) for i, k in enumerate(K)]
        if at != heads[at]:
            onto[at - 1] = Fraction(1)
        slopes.append(_Slope(at, onto, low, high, -1))
    return slopes, boxes


def _as_claim(evidence: Mapping[str, Any]) -> Claim:
    return Claim("", "proved", evidence, "", "", "", ())


def _number(context: Context, text: Expression) -> Fraction:
    value = context.value(text).number
    if value is None:
        raise NotShown(f"{text.text} is no number, which the a_i of a range want")
    return value


def _slopes(
    context: Context,
    evidence: Mapping[str, Any],
    scale: list[Expression],
    powers: list[int],
    fed: list[bool],
    index: list[int],
    picks: list[int],
) -> tuple[list[_Slope], int]:
    """The slopes of b in the coordinates `scale` z, each with 0 in its range, of every b_i in every z_j that it reads,
    and with how many boxes they are shown. Raises: `NotShown`."""
    form, listed, boxes, slopes = context.form, _listed(evidence), 0, list[_Slope]()
    names = {name for text in (*form.b, *scale) for name in text.names}
    where = narrowed(form.box, names)
    continuous(form.b, context.z, where)
    for i, row in enumerate(form.b):
        for j, z in enumerate(context.z):
            if z not in row.names:
                continue
            if (i, j) not in listed:
                raise NotShown(f"it does not bound the slope of b_{i + 1} in {z}")
            low, high, tree = listed.pop((i, j))
            boxes += covered(where, tree, steep(form.b, context.z, Fraction(0), scale, _entry(i, j, low, high)))
            onto = [Fraction(int(enters and at == i)) for enters, at in zip(fed, index, strict=True)]
            degree = powers[i] - powers[j]
            if degree < 0:
                raise NotShown(f"b_{i + 1} reads {z}, of a higher power of theta")
            slopes.append(_Slope(picks[j], onto, min(low, Fraction(0)), max(high, Fraction(0)), degree))
    if listed:
        raise NotShown("it bounds slopes that are none of b")
    return slopes, boxes


def _listed(evidence: Mapping[str, Any]) -> dict[tuple[int, int], tuple[Fraction, Fraction, str]]:
    """The claimed ranges by row and column, from 0. Raises: `NotShown`."""
    known = {}
    for slope in part(evidence, "slopes", list):
        if not isinstance(slope, dict) or set(slope) != {"row", "column", "low", "high", "tree"}:
            raise NotShown("a slope is no object of row, column, low, high and tree")
        place = scalar(slope, "row") - 1, scalar(slope, "column") - 1
        low, high = scalar(slope, "low"), scalar(slope, "high")
        if place in known or not low <= high or any(k.denominator > 1 for k in place):
            raise NotShown("a slope stands twice, or has no range")
        known[place] = low, high, part(slope, "tree", str)
    return {(int(i), int(j)): bounds for (i, j), bounds in known.items()}


def _entry(i: int, j: int, low: Fraction, high: Fraction) -> Callable[..., bool]:
    """The statement that the entry (i, j) of a matrix in intervals is in a range."""

    def within(J: list[list[Any]], _: Fraction) -> bool:
        return bool(J[i][j].at_least(low) and J[i][j].at_most(high))

    return within


_SLOPES = ("scale", "units", "slopes", "core", "ranges", "method")
RULES = tuple(
    rule
    for name in ("high_gain", *CORES)
    for rule in (
        *on_chains(name, "step", step, (*_SLOPES, "dt", "alpha", "P", "S")),
        *on_chains(name, "shorter", throughout, (*_SLOPES, "theta", "pieces")),
        *on_chains(name, "tuned", throughout, (*_SLOPES, "theta", "pieces")),
    )
)
