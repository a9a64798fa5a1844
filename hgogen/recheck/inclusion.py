"""The differential inclusion of an observer's error, rebuilt from the plant and the observer's numbers.

    e' = theta (N e + B v) + sum over slopes of theta^-degree d direction (reads'e + from_y'v)

Each d is in [low, high], independently; e holds the errors of fields over their units and theta^power, v those of the
samples over theta^late, `late` the powers of the first states of the outputs' chains. A slope of b_i in z_j, in these
coordinates, has 0 in its range, because a clamp passes only a share of the error, and the degree power(i) - power(j);
an a_i that varies, and a saturation in the core, have the degree -1. The cores are those of `CORES` and of a constant
gain.

An observer may inject the output error into the argument of b, z + N_theta (y - C z). Then b reads for z_j the error
e_j - sum_k N_jk (a_(k,1) e_k - v_k), e_k that of the first state of chain k, v_k that of its sample; N_theta has N_jk
times theta^(p(j) - p(k)), p the powers that scale states, so that the coordinates S z over theta^p are free of theta:
e_j - sum_k (S_j/S_k) N_jk a_(k,1) e_k + S_j N_jk v_k theta^-p(k). The docstring of `rules/continuous_time.py` lists the
equations of the observers.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import product
from operator import mul
from typing import Any

from .arithmetic import Unproved
from .box import covered, demand_continuous, in_ranges, narrowed
from .context import (
    Context,
    constants,
    core_of,
    enclosed,
    gain_of,
    integrators,
    invertible,
    numbers,
    steady,
    wanted_gain,
)
from .file import Observer, column, entries, fields, matrix, part, scalar
from .inequality import ErrorMatrices
from .matrix import Matrix, companion, dot, outer, similar, unit, unit_row, zeros
from .text import Expression

Numbers = Mapping[str, Any]
_CORNERS = 8  # states up to which all corners of the initial errors are tried
_SATURATED = 8  # states up to which all combinations of saturations are tried


@dataclass(frozen=True)
class Core:
    """The linear part e' = theta N e of an observer's error, for an observer with N states on a chain of n integrators
    w. `vertices`: the matrix N (N, N) for each combination of saturations, the first with all of them blocking the
    error, the last with all passing it.

    For observer state k: `index`, the number from 0 of the w_i whose unit e_k has; `power`, the power of theta by which
    e_k is divided; `fed`, whether it is an estimate, to which b is added. `picks` (n): the observer state at which b is
    evaluated for w_i; `measured` (N): the gain of the sample's error, over theta.
    """

    vertices: list[Matrix]
    index: list[int]
    power: list[int]
    fed: list[bool]
    picks: list[int]
    measured: list[Fraction]

    @property
    def gates(self) -> list[tuple[int, list[Fraction]]]:
        """The pairs (j, column), one for each saturation. A saturation that blocks the error of observer state j adds
        the column (N) to column j of the last vertex, in which all saturations pass the error."""
        columns = []
        for k in reversed(range(len(self.vertices).bit_length() - 1)):
            removed = self.vertices[-1 - 2**k] - self.vertices[-1]
            columns += [(j, each) for j, each in enumerate(removed.T) if any(each)]
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
    above = [[*unit_row(i + 1, n), *NH[i]] for i in range(n)]
    below = [[-G[i], *[Fraction(0)] * (n - 1), *F[i]] for i in range(m)]
    order = [*range(n), *[0] * m]
    return Core([Matrix(above + below)], order, order, [True] * n + [False] * m, [*range(n)], [Fraction(0)] * n + G)


def _low_power(numbers: Numbers, n: int) -> Core:
    k, picks = _gains_of_pairs(numbers, n), [0, *range(n - 1, 2 * n - 2)]
    order, padding = [*range(n - 1), *range(1, n)], [Fraction(0)] * (n - 2)
    fed, measured = [True] * (2 * n - 2), [k[0][0], *padding, k[0][1], *padding]
    return Core([_pairs(k, [1] * n)], order, order, fed, picks, measured)


def _peaking_free(numbers: Numbers, n: int) -> Core:
    """Return the linear error dynamics of a peaking-free observer with the states p_1, .., p_n, q_1, .., q_(n-1): a
    vertex for every combination of saturations that block or pass the error."""
    if n > _SATURATED:
        raise Unproved(f"saturations of more than {_SATURATED} states are not tried")
    k, last, padding = _gains_of_pairs(numbers, n), scalar(numbers, "last"), [Fraction(0)] * (n - 2)
    vertices = []
    for shares in product((0, 1), repeat=n - 1):
        inner = [[*row[: n - 1], Fraction(0), *row[n - 1 :]] for row in _pairs(k, [1, *shares])]
        follows = [Fraction(0)] * (2 * n - 1)
        follows[n - 1], follows[-1] = -last, last * shares[-1]
        vertices.append(Matrix([*inner[: n - 1], follows, *inner[n - 1 :]]))
    order, measured = [*range(n), *range(1, n)], [k[0][0], *padding, Fraction(0), k[0][1], *padding]
    return Core(vertices, order, order, [True] * (2 * n - 1), [*range(n)], measured)


def _gains_of_pairs(numbers: Numbers, n: int) -> Matrix:
    if n < 2:
        raise Unproved("the observer is one of at least two states")
    return matrix(numbers, "gains", n - 1, 2)


def _pairs(k: Matrix, shares: list[int]) -> Matrix:
    """Return N (2 m, 2 m) of e' = theta N e for observer states p_1, .., p_m, q_1, .., q_m with gains `k` (m, 2).
    `shares` (m + 1): 1 if the saturation passes the error of y, q_1, .., q_m, else 0."""
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
    """Return the linear error dynamics A - K C on n integrators, K (n) the `gains`. An observer that injects a part of
    the output error, or varies its gain, is treated as one that injects the whole error."""
    gains, order = column(numbers, "gains", n), [*range(n)]
    return Core([companion(gains)], order, order, [True] * n, order, gains)


OF_A_GAIN: tuple[str, ...] = ("high_gain", "circle_criterion")  # with a core A - K C, K a matrix
CONSTANT: tuple[str, ...] = ("filtered", "filtered_injection", "low_power", "peaking_free")  # with their own core
INJECTED = (*OF_A_GAIN, *CONSTANT)  # with a constant injection
CORES: Mapping[str, Callable[[Numbers, int], Core]] = {
    "filtered": _filtered,
    "filtered_injection": _filtered_injection,
    "low_power": _low_power,
    "peaking_free": _peaking_free,
    **dict.fromkeys(("stubborn", "dead_zone", "updated_gain", "adaptive_lmi"), _injected),
}


ERROR = ("scale", "slopes", "core", "ranges", "units")  # keys of the evidence of an error's inclusion
End = Fraction | float
_NO_END = {"low": -math.inf, "high": math.inf}


@dataclass(frozen=True)
class UncertainTerm:
    """A term theta^-`degree` d `direction` (`reads`'e + `from_y`'v) of the error dynamics e', for any factor d in
    [`low`, `high`]: e (N) are the errors of the observer's states, v (p) those of the samples at theta = 1.

    `one_sided`: 1 if d is unbounded above low = high, -1 if it is unbounded below, else 0; `realised`: False for the
    varying part of A - K C, which no method for a realised linear part integrates.
    """

    reads: list[Fraction]
    direction: list[Fraction]
    low: Fraction
    high: Fraction
    degree: int
    from_y: list[Fraction] = field(default_factory=list)
    one_sided: int = 0
    realised: bool = True


@dataclass(frozen=True)
class Argument:
    """The error of the argument of b, `reads` e + `from_y` v: reads (n, n) multiplies the errors e of the states,
    from_y (n, p) the errors v of the samples over their powers of theta. The rows of from_y are empty if its entries
    are not numbers."""

    reads: Matrix
    from_y: Matrix

    @property
    def known(self) -> bool:
        """Return whether the entries of `from_y`, by which the samples' errors enter the argument of b, are numbers."""
        return all(self.from_y)


@dataclass(frozen=True)
class ErrorInclusion:
    """The error dynamics of an observer with N states, e' = theta (`N` e + `measured` v) + the uncertain terms
    `slopes`: N (N, N), measured (N, p) for the errors v of p samples; `boxes`: the number of boxes of its proof.

    For observer state k: `index` i, `power`, with e_k = theta^-power `scale`_i times an error of the form's state z_i,
    and `fed`, whether it estimates z_i. For z_i: `picks`, the observer state at which b is evaluated, and `from_y` (n,
    p), by which the samples' errors are added to it. `late` (p): v is over theta^late; `units` (n): e for an error 1 of
    the integrators w, empty without them.
    """

    N: Matrix
    slopes: list[UncertainTerm]
    boxes: int
    measured: Matrix
    index: list[int]
    fed: list[bool]
    picks: list[int]
    power: list[int]
    scale: list[Expression]
    late: list[int]
    from_y: Matrix = field(default_factory=lambda: Matrix([]))
    units: list[Fraction] = field(default_factory=list)

    def scales(self, context: Context, theta: Fraction) -> list[Fraction]:
        """Return the factors s (N) with e_k = s_k times the error of the form's state that observer state k estimates:
        s_k = theta^-power_k scale_i. Raises: `Unproved` if a scale depends on parameters."""
        values = [context.value(each).number for each in self.scale]
        known = [value for value in values if value]
        if len(known) < len(values):
            raise Unproved("its scale is not of numbers")
        return [known[i] / theta**p for i, p in zip(self.index, self.power, strict=True)]

    def lifted(self, scales: Sequence[Fraction]) -> Matrix:
        """Return the matrix T (N, n) with e = T times the errors of the form's states; its rows are 0 for observer
        states that estimate none. `scales` (N): as the method `scales` returns them."""
        each = zip(scales, self.index, self.fed, strict=True)
        return Matrix([s * (fed and i == at) for at in range(len(self.picks))] for s, i, fed in each)

    def largest(self, scales: Sequence[Fraction], first: Sequence[Fraction], P: Matrix) -> Fraction:
        """Return the largest |e(0)|_P^2 for initial errors of the form's states within +-`first` (n), attained at a
        corner; observer states that estimate none start without error. `scales` (N): as the method `scales` returns
        them. Raises: `Unproved`."""
        if len(first) > _CORNERS:
            raise Unproved(f"it has more than {_CORNERS} states")
        if min(first) < 0:
            raise Unproved("a first error is negative")
        lifted, signs = self.lifted(scales), product((1,), *[(1, -1)] * (len(first) - 1))
        corners = (lifted.applied([*map(mul, first, each)]) for each in signs)
        return max(dot(e, P.applied(e)) for e in corners)

    def at(self, theta: Fraction) -> ErrorMatrices:
        """Return the matrices of the error dynamics at a gain theta: M and R with the slopes d at the middles of their
        ranges, G, H and E with half of the ranges."""
        M, G, H, E = theta * self.N, [], [], []
        late = [theta**-power for power in self.late]
        R, p = zeros(len(M), len(late)), len(late)
        B = theta * (self.measured or R).T.weighed(late).T
        for slope in self.slopes:
            share, from_y = theta**-slope.degree, slope.from_y or [Fraction(0)] * len(late)
            from_y = [x * by for x, by in zip(from_y, late, strict=True)]
            middle = share * (slope.low + slope.high) / 2
            direction = [x * middle for x in slope.direction]
            M, R = M + outer(direction, slope.reads), R + outer(direction, from_y)
            if slope.low < slope.high:
                G.append([x * share * (slope.high - slope.low) / 2 for x in slope.direction])
                H.append(slope.reads)
                E.append(from_y)
        moving = not all(slope.realised for slope in self.slopes)
        one_sided = [slope for slope in self.slopes if slope.one_sided and any(slope.reads)]
        signed = [(slope.direction, [-slope.one_sided * x for x in slope.reads]) for slope in one_sided]
        return ErrorMatrices(
            M, Matrix(G, len(M)).T, Matrix(H, len(M)), theta * self.N, moving, B, R, Matrix(E, p), signed
        )


def error_inclusion(context: Context, observer: Observer, evidence: Mapping[str, Any]) -> ErrorInclusion:
    """Return the error dynamics of the certificate's observer, with the scale and the ranges of slopes in the evidence.
    Raises: `Unproved`, also for a slope that is unbounded on one side."""
    error = one_sided_inclusion(context, observer, evidence)
    if any(slope.one_sided for slope in error.slopes):
        raise Unproved("a slope has no bound, for which this claim is not")
    return error


def one_sided_inclusion(context: Context, observer: Observer, evidence: Mapping[str, Any]) -> ErrorInclusion:
    """Return the error dynamics of the certificate's observer; slopes may be unbounded on one side. Raises:
    `Unproved`."""
    _ = context.equations
    build, strange = (_core_inclusion, ("core", "ranges")) if observer.name in CORES else (_gain_inclusion, ("units",))
    if unread := sorted(evidence.keys() & set(strange)):
        raise Unproved(f"its evidence has a part {unread[0]}, which its observer has not")
    return build(context, observer, evidence)


def _core_inclusion(context: Context, observer: Observer, evidence: Mapping[str, Any]) -> ErrorInclusion:
    scale, n = integrators(context, evidence), len(context.z)
    core = CORES[observer.name](observer.numbers, n)
    t = [scale.units[i] for i in core.index]
    slopes, boxes = bounded_slopes(context, evidence, scale.expressions, [*range(n)], core.fed, core.index, core.picks)
    for j, gated in core.gates:
        column_ = [x * t[k] / t[j] for k, x in enumerate(gated)]
        slopes.append(UncertainTerm(unit_row(j, len(t)), column_, Fraction(0), Fraction(1), -1))
    measured = Matrix([[x * unit] for x, unit in zip(core.measured, t, strict=True)])
    N, boxes, late = similar(t, core.vertices[-1]), boxes + scale.boxes, [0]
    where = (core.index, core.fed, core.picks, core.power)
    return ErrorInclusion(N, slopes, boxes, measured, *where, scale.expressions, late, units=scale.units)


def _gain_inclusion(context: Context, observer: Observer, evidence: Mapping[str, Any]) -> ErrorInclusion:
    """Return the error dynamics of z' = A z + b + diag(theta, theta^2, ..) K (y - C z) with a constant K. S (A - K C)
    S^-1, S = diag(scale), must be a matrix of numbers, or the a_i of the chains vary in stated ranges."""
    n, form = len(context.z), context.form
    if form.alignment not in ("", "top", "end"):
        raise Unproved("its chains are not aligned at the top or at the end")
    scale = constants(context, entries(evidence, "scale", n))
    boxes, longest = steady(context, observer.gains) + invertible(context, scale), max(form.blocks)
    shift = [longest - size if form.alignment == "end" else 0 for size in form.blocks]
    powers = [late + level for late, size in zip(shift, form.blocks, strict=True) for level in range(size)]
    slopes, more = bounded_slopes(context, evidence, scale, powers, [True] * n, [*range(n)], [*range(n)])
    argument = _argument(context, observer, scale)
    for k, slope in enumerate(slopes):  # each slope of b reads one error; the argument of b gives its replacement
        at = slope.reads.index(Fraction(1))
        slopes[k] = replace(slope, reads=argument.reads[at], from_y=argument.from_y[at])
    if ("core" in evidence) is ("ranges" in evidence):
        raise Unproved("its evidence has not one of a core and ranges")
    observed, N = 0, zeros(n, n)
    if "core" in evidence:
        N = core_of(context, scale, observer.gains, matrix(evidence, "core", n, n))
    else:
        moving, observed = _moving(context, observer, evidence, scale)
        slopes = slopes + moving
    measured, each = _by_chain(context, observer, scale) if argument.known else Matrix([]), [*range(n)]
    late = [shift[context.heads.index(z)] if z else 0 for z in context.observed]
    where = (each, [True] * n, each, powers)
    return ErrorInclusion(N, slopes, boxes + more + observed, measured, *where, scale, late, argument.from_y)


def _argument(context: Context, observer: Observer, scale: list[Expression]) -> Argument:
    if "argument" in observer.entries:
        argument = argument_of(context, observer.entries["argument"], scale)
        return replace(argument, from_y=argument.from_y @ _means(context, observer)) if argument.known else argument
    n = len(context.z)
    return Argument(unit(n), zeros(n, len(context.heads)))


def argument_of(context: Context, entries: Sequence[Expression], scale: Sequence[Expression]) -> Argument:
    """Return the error of the argument z + N (y - C z) of b, in the coordinates S z, S = diag(`scale`); `entries`:
    those of N. Raises: `Unproved` if the coefficients of the states' errors are not numbers."""
    S = [context.value(text) for text in scale]
    N = gain_of(context.form.blocks, [context.value(text) for text in entries], context.algebra.zero)
    reads, from_y = unit(len(N)), numbers([s * entry for entry in row] for s, row in zip(S, N, strict=True))
    for k, z in enumerate(context.heads):
        if not z:
            continue
        head, a = context.z.index(z), context.first_gain(k)
        for j, row in enumerate(N):
            share = (row[k] * a * S[j] / S[head]).number
            if share is None:
                raise Unproved("what it injects into the argument of b is not of numbers in these coordinates")
            reads[j][head] -= share
    return Argument(reads, Matrix([[] for _ in N] if from_y is None else from_y))


def _by_chain(context: Context, observer: Observer, scale: list[Expression]) -> Matrix:
    blocks, none = context.form.blocks, context.algebra.zero
    K = gain_of(blocks, [context.value(text) for text in observer.gains], none)
    known = numbers([context.value(s) * k for k in row] for s, row in zip(scale, K, strict=True))
    return Matrix([]) if known is None else Matrix(known) @ _means(context, observer)


def _means(context: Context, observer: Observer) -> Matrix:
    """Return W (p, p) whose row k has the weights of the outputs' errors in the mean of all outputs that measure the
    first state of chain k: for y_j = r_j y with the weight w_j, W_kj = (w_j/r_j) / sum of the w. Raises: `Unproved`."""
    outputs, observed = range(len(context.form.output)), context.observed
    together = [[j for j in outputs if z and observed[j] == z] for z in context.heads]
    if all(len(each) < 2 for each in together):
        return Matrix([[Fraction(int(k == j and bool(z))) for j in outputs] for k, z in enumerate(context.heads)])
    if not isinstance(observer.numbers.get("weights"), list):
        raise Unproved("outputs show one state, and the file does not tell by which weights")
    weights, rows = column(observer.numbers, "weights", len(outputs)), zeros(len(outputs), len(outputs))
    if min(weights) <= 0:
        raise Unproved("a weight of its outputs is not positive")
    for k, each in enumerate(together):
        whole = sum((weights[j] for j in each), Fraction(0))
        for j in each:
            rows[k][j] = weights[j] * context.output_slope(k) / (context.output_slope(j) * whole)
    return rows


def _moving(
    context: Context, observer: Observer, evidence: Mapping[str, Any], scale: list[Expression]
) -> tuple[list[UncertainTerm], int]:
    blocks, slopes, boxes = context.form.blocks, [], 0
    S, K = (numbers([[context.value(text) for text in texts]]) for texts in (scale, observer.gains))
    if S is None or any(s != 1 for s in S[0]) or K is None:
        raise Unproved("its scale is not 1, or its gains are no numbers, which the a_i of ranges want")
    columns = gain_of(blocks, K[0], Fraction(0))
    places = [(k, i) for k, size in enumerate(blocks, 1) for i in range(1, size + 1)]
    for at, (place, range_) in enumerate(zip(places, entries(evidence, "ranges", len(places)), strict=True)):
        low, high, finding = enclosed(context, range_, *wanted_gain(context, place))
        boxes += finding.boxes
        chain, level = place
        direction = [-row[chain - 1] if level == 1 else Fraction(int(i == at - 1)) for i, row in enumerate(columns)]
        slopes.append(UncertainTerm(unit_row(at, len(columns)), direction, low, high, -1, realised=False))
    return slopes, boxes


def bounded_slopes(
    context: Context,
    evidence: Mapping[str, Any],
    scale: list[Expression],
    powers: list[int],
    fed: list[bool],
    index: list[int],
    picks: list[int],
    least: int = 0,
) -> tuple[list[UncertainTerm], int]:
    """Return an uncertain term for each partial derivative S_i db_i/dz_j/S_j that is not 0, S = diag(`scale`), with a
    range that contains 0, and the number of boxes; the ranges of the evidence are proved. Raises: `Unproved`.

    The term has the power of theta `powers`[i] - `powers`[j], which must be at least `least`. `fed`, `index` (N):
    whether an observer state estimates a state of the form, and which one; `picks` (n): the observer state at which b
    is evaluated.
    """
    form, listed, boxes, slopes = context.form, _listed(evidence), 0, list[UncertainTerm]()
    names = {name for text in (*form.b, *scale) for name in text.names}
    where = narrowed(form.box, names)
    demand_continuous(form.b, context.z, where)
    for i, row in enumerate(form.b):
        for j, z in enumerate(context.z):
            if z not in row.names:
                continue
            if (i, j) not in listed:
                raise Unproved(f"it does not bound the slope of b_{i + 1} in {z}")
            low, high, tree = listed.pop((i, j))
            boxes += covered(where, tree, in_ranges(form.b, context.z, {(i, j): (low, high)}, scale))
            direction = [Fraction(int(feeds and at == i)) for feeds, at in zip(fed, index, strict=True)]
            degree = powers[i] - powers[j]
            if degree < least:
                raise Unproved(f"b_{i + 1} reads {z}, of a higher power of theta")
            reads, way = unit_row(picks[j], len(direction)), (high == math.inf) - (low == -math.inf)
            known = [Fraction(end) for end in (min(low, Fraction(0)), max(high, Fraction(0))) if math.isfinite(end)]
            slopes.append(UncertainTerm(reads, direction, known[0], known[-1], degree, one_sided=way))
    if listed:
        raise Unproved("it bounds slopes that are none of b")
    return slopes, boxes


def _listed(evidence: Mapping[str, Any]) -> dict[tuple[int, int], tuple[End, End, str]]:
    known = {}
    for slope in part(evidence, "slopes", list):
        fields(slope, "a slope", ("row", "column", "low", "high", "tree"))
        place = scalar(slope, "row") - 1, scalar(slope, "column") - 1
        low, high = (end if slope[key] is None else scalar(slope, key) for key, end in _NO_END.items())
        none = not low <= high or (low, high) == (-math.inf, math.inf)
        if place in known or none or any(k.denominator > 1 for k in place):
            raise Unproved("a slope stands twice, or has no range")
        known[place] = low, high, part(slope, "tree", str)
    return {(int(i), int(j)): bounds for (i, j), bounds in known.items()}
