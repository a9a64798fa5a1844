"""Persistence of inputs: a lower bound of the observability Gramian over windows of time.

The transition matrix of x' = A x over a piece of time, and the Gramian of y = C x there, follow from the Taylor series
of A and C:

    Phi' = A Phi,   W = integral Phi' C' C Phi,   in balls of integers over 2^192: the middle, and the radius

Phi and Phi' C' C Phi are series to an order N. The coefficient N + 1, taken anywhere in the piece, bounds the remainder
(Lagrange): its entries are at most those of the series of norms, the largest sums of a row or column, of A and C on the
whole piece, from |Phi| <= exp(length |A|).

Inputs make every state of a state-affine plant observable, by a measure for every window:

    x' = A(u) x + b,   y = C(u) x + d,   N_0 = C,   N_(k+1) = N_k A + N_k':   rank n of N_0, .., N_(n-1) at a time t_0

makes the observability Gramian over any window with t_0 inside positive definite; a periodic input has such a time in
every window of two periods. An input is constant, or reads the time in sin and cos only, whose arguments advance by a
multiple of 2 pi in a period. The observer clamps an input to its range: at t_0 the input is strictly inside, or it is
constant and in the range. A and C are finite on the box, by the claim on the form's structure. Source: L. M. Silverman,
H. E. Meadows, SIAM J. Control 5 (1967).

    W(s, d) = D (integral_s^(s+d) Phi' C' R^-1 C Phi) D >= bound

D are the half-widths of the ranges of the states, 1 without one. A time-varying course is cut into pieces of `piece`, a
window into 2^level and one more: a window that begins in a piece k has W >= exp(-2 piece a) M, M that of the 2^level
pieces after it, a >= |A + A'|/2 on the piece. A constant course has windows of 2^level. C is weighted by `weights` s_j
with s_j^2 R_j <= 1. The pieces of `starts` cover the period of the course, which stays in the ranges of the inputs, to
which an observer clamps them. Derivatives in t are Taylor coefficients, for all parameters in their box.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from operator import mul
from typing import Any, TypeVar

from ..algebra import Algebra, Quotient
from ..arithmetic import Undefined, Unproved, determinant, evaluate, total
from ..box import Attempt, Box, covered, narrowed, ranged, shortened
from ..context import CHAINS, Context, Finding, Rule, algebra_of, demand_only, printed
from ..file import Claim, above_zero, column, part, whole
from ..interval import Interval, Taylor, between, intervals, padded_series, point, taylor
from ..matrix import Matrix, demand_nonnegative, unit
from ..text import Expression, expression

ORDER = 9  # N
_BITS = 192
_ONE = 1 << _BITS
Value = TypeVar("Value")


@dataclass(frozen=True)
class BallMatrix:
    """A matrix of balls: the midpoints `mid` and the radii `off` of the entries, as integers in units of 2^-192."""

    mid: list[list[int]]
    off: list[list[int]]

    def __add__(self, other: "BallMatrix") -> "BallMatrix":
        return BallMatrix(_sum(self.mid, other.mid), _sum(self.off, other.off))

    def __matmul__(self, other: "BallMatrix") -> "BallMatrix":
        columns = list(zip(zip(*other.mid, strict=True), zip(*other.off, strict=True), strict=True))
        pairs = [[_dot(m, r, *column) for column in columns] for m, r in zip(self.mid, self.off, strict=True)]
        return BallMatrix([[m for m, _ in row] for row in pairs], [[r for _, r in row] for row in pairs])

    @property
    def transposed(self) -> "BallMatrix":
        """The transpose."""
        return BallMatrix(*([list(column) for column in zip(*rows, strict=True)] for rows in (self.mid, self.off)))

    def times(self, share: Fraction) -> "BallMatrix":
        """Return the matrix multiplied by a number `share` > 0, rounded outward."""
        p, q = share.numerator, share.denominator
        return BallMatrix(_each(self.mid, lambda x: x * p // q), _each(self.off, lambda x: x * p // q + 2))

    @property
    def norm(self) -> int:
        """An upper bound of the largest sum of |entries| in a row or column, in units of 2^-192."""
        sizes = [[abs(m) + r for m, r in zip(*rows, strict=True)] for rows in zip(self.mid, self.off, strict=True)]
        return max(map(sum, chain(sizes, zip(*sizes, strict=True))))

    @property
    def fractions(self) -> tuple[Matrix, Fraction]:
        """The symmetric part of the midpoints, and a bound of the largest sum of radii in a row, as fractions."""
        n = range(len(self.mid))
        even = Matrix([[Fraction(self.mid[i][j] + self.mid[j][i], 2 * _ONE) for j in n] for i in n])
        return even, max(Fraction(sum(self.off[i][j] + self.off[j][i] for j in n), 2 * _ONE) for i in n)


def _sum(a: list[list[int]], b: list[list[int]]) -> list[list[int]]:
    return [[x + y for x, y in zip(*rows, strict=True)] for rows in zip(a, b, strict=True)]


def _each(rows: Iterable[Iterable[Value]], what: Callable[[Value], int]) -> list[list[int]]:
    return [[what(value) for value in row] for row in rows]


def _dot(m: Sequence[int], r: Sequence[int], n: Sequence[int], s: Sequence[int]) -> tuple[int, int]:
    middle = sum(map(int.__mul__, m, n))
    away = sum(abs(a) * d + b * (abs(c) + d) for a, b, c, d in zip(m, r, n, s, strict=True))
    return middle >> _BITS, (away >> _BITS) + 2


def ball_matrix(rows: Sequence[Sequence[Interval]]) -> BallMatrix:
    """Return a matrix of intervals as a matrix of balls. Raises: `Unproved` if an interval is not finite."""
    ends = [[_whole(x) for x in row] for row in rows]
    mid = _each(ends, lambda pair: (pair[0] + pair[1]) >> 1)
    return BallMatrix(mid, _each(ends, lambda pair: ((pair[1] - pair[0]) >> 1) + 1))


def _whole(x: Interval) -> tuple[int, int]:
    if not x.finite:
        raise Unproved("A or C is not finite along the course")
    low, high = (Fraction(end) for end in x.exactly)
    return low.numerator * _ONE // low.denominator, -(-high.numerator * _ONE // high.denominator)


@dataclass(frozen=True)
class Window:
    """The transition matrix Phi of x' = A x over a window of time, and the observability Gramian W = integral Phi' C' C
    Phi of y = C x."""

    Phi: BallMatrix
    W: BallMatrix

    def then(self, after: "Window") -> "Window":
        """Return the window that joins this one and the next one, `after`."""
        return Window(after.Phi @ self.Phi, self.W + self.Phi.transposed @ after.W @ self.Phi)


Series = Sequence[BallMatrix]


def piece(A: Series, C: Series, around: tuple[Series, Series], length: Fraction) -> Window:
    """Return the transition matrix and the Gramian over a piece of time of some `length`, in balls: from the Taylor
    coefficients of A and C at its beginning, below N + 1, and the coefficients `around`, below N + 2, which hold on the
    whole piece and bound the remainder."""
    n, p = len(A[0].mid), len(C[0].mid)
    unit = [[_ONE * (i == j) for j in range(n)] for i in range(n)]
    Phi = [BallMatrix(unit, [[0] * n for _ in range(n)])]
    for k in range(ORDER):
        Phi.append(_coefficient(A, Phi, k).times(Fraction(1, k + 1)))
    V = [_coefficient(C, Phi, k) for k in range(ORDER + 1)]
    rates = [_coefficient([v.transposed for v in V], V, k) for k in range(ORDER + 1)]
    remainder, lost = _remainders(around, p, length)
    end, gramian = _off(n, remainder) + Phi[0], _off(n, lost)
    for k in range(1, ORDER + 1):
        end += Phi[k].times(length**k)
    for k in range(ORDER + 1):
        gramian += rates[k].times(length ** (k + 1) / (k + 1))
    return Window(end, gramian)


def _remainders(around: tuple[Series, Series], p: int, length: Fraction) -> tuple[int, int]:
    a, c = ([one.norm for one in series] for series in around)
    grown = intervals.function("exp", (point(Fraction(a[0], _ONE) * length),))
    phi = [_whole(grown)[1]]
    for k in range(ORDER + 1):
        phi.append(-(-_above(a, phi, k) // (k + 1)))
    v = [_above(c, phi, k) for k in range(ORDER + 2)]
    h, N = length, ORDER + 1
    return _up(phi[N], h**N), _up(p * _above(v, v, N), h ** (N + 1) / (N + 1))


def _up(value: int, share: Fraction) -> int:
    return -(-value * share.numerator // share.denominator)


def _above(a: Sequence[int], b: Sequence[int], k: int) -> int:
    """Return an upper bound of coefficient k of the product of two series, given by upper bounds of their coefficients
    in units of 2^-192."""
    return (sum(a[i] * b[k - i] for i in range(k + 1)) >> _BITS) + 1


def _coefficient(a: Series, b: Series, k: int) -> BallMatrix:
    first, last = a[: k + 1], b[k::-1]
    wide = ([list(chain(*rows)) for rows in zip(*each, strict=True)] for each in _parts(first))
    return BallMatrix(*wide) @ BallMatrix(*([*chain(*each)] for each in _parts(last)))


def _parts(series: Series) -> Iterator[tuple[list[list[int]], ...]]:
    return zip(*((one.mid, one.off) for one in series), strict=True)


def _off(n: int, size: int) -> BallMatrix:
    return BallMatrix([[0] * n for _ in range(n)], [[size] * n for _ in range(n)])


MOST = 5  # states, beyond which determinants and derivatives are too long
_TURNS = 1000  # of an argument over a period
_LEVEL, _STARTS = 9, 2000
_GROUP = 8  # pieces whose series share a bound of the remainder
TIME = {"t": (-math.inf, math.inf)}


def claimed_inputs(context: Context, claim: Claim) -> tuple[dict[str, Expression], set[str]]:
    """Return the claim's inputs u(t) as expressions in the time t, by name, and the names that A and C read, which must
    be these inputs and parameters. Raises: `Unproved`."""
    _ = context.equations
    form, texts = context.form, part(claim.evidence, "inputs", dict)
    inputs = {name: expression(text, TIME) for name, text in texts.items()}
    read = {name for row in form.A for entry in row for name in entry.names}
    read |= {name for output in form.output for name in output.names} - set(context.z)
    demand_only(inputs, context.file.inputs, "the claim's input")
    demand_only(read, (*inputs, *context.file.parameters), "A or C")
    return inputs, read


def persistent(context: Context, claim: Claim) -> Finding:
    """Prove that the state of x' = A(u) x + b, y = C(u) x + d is observable along the claim's inputs u(t), for all
    parameters: C, C A + C', .. have rank n at some time."""
    (inputs, read), evidence, form = claimed_inputs(context, claim), claim.evidence, context.form
    if len(context.z) > MOST:
        raise Unproved(f"the rank of more than {MOST} states is not computed")
    texts = (*inputs.values(), *form.output, *(entry for entries in form.A for entry in entries))
    if any(text.kinked for text in texts):
        raise Unproved("an input, A or C has kinks or jumps")
    at = expression(part(evidence, "at", str), {})
    moving = [text for text in inputs.values() if text.names]
    if moving:
        period = expression(part(evidence, "period", str), {})
        demand_period(moving, period)
        length = _value(period)
        if length.sign <= 0 or not length.at_most(Fraction(10**9)):
            raise Unproved(f"the period {shortened(period.text)} is not shown to be positive, or is too long")
        turn: Box = {"t": (Fraction(0), next(Fraction(2**k) for k in range(1, 64) if length.at_most(Fraction(2**k))))}
        for text in moving:
            covered(turn, ".", ranged(text, -math.inf, math.inf))
    demand_inside(context, inputs, at)
    parameters = narrowed(form.box, read & set(context.file.parameters))
    boxes = covered(parameters, ".", _full(context, inputs, at))
    full = f"shows all {len(context.z)} states: C, C A + C', .. have full rank at t = {at.text}"
    return Finding(f"{_printed(inputs)} {full}", boxes)


def _printed(inputs: Mapping[str, Expression]) -> str:
    return ", ".join(f"{name} = {shortened(text.text)}" for name, text in inputs.items()) or "every input"


def _value(text: Expression) -> Any:
    return evaluate(text, {}, intervals)


def demand_period(texts: Sequence[Expression], period: Expression) -> None:
    """Demand that the time t occurs in the expressions only as sin or cos of c t + d, where c times the period is a
    multiple of 2 pi. Raises: `Unproved`."""
    algebra = algebra_of(TIME)
    for text in texts:
        raw: list[bool] = []  # whether an instruction reads the time outside sin and cos
        for op, args, _ in text.instructions:
            loose = op == "symbol" or any(raw[place] for place in args)
            if loose and op in ("sin", "cos"):
                inner = Expression(text.text, text.instructions, args[0], text.names)
                turns = algebra.speed(inner, {"t": algebra.one}) * algebra.read(period)
                loose = not _whole_turns(turns, algebra)
            raw.append(loose)
        if raw[text.result]:
            raise Unproved(f"{shortened(period.text)} is not shown to be a period of {shortened(text.text)}")


def _whole_turns(turns: Quotient, algebra: Algebra) -> bool:
    pi = algebra.function("pi", ())
    each = (k for size in range(1, _TURNS + 1) for k in (size, -size))
    return any(algebra.is_zero(turns - algebra.number(Fraction(2 * k)) * pi) for k in each)


def demand_inside(context: Context, inputs: Mapping[str, Expression], at: Expression) -> None:
    """Demand that each input is inside its range at the time `at`; strictly inside if it varies. Raises: `Unproved`."""
    for name, text in inputs.items():
        low, high = context.form.box[name]
        value = evaluate(text, {"t": _value(at)}, intervals)
        exact = None if text.names else algebra_of({}).read(text).number
        inner = exact is not None and low <= exact <= high
        above = low == -math.inf or (value - point(Fraction(low))).sign > 0
        below = high == math.inf or (point(Fraction(high)) - value).sign > 0
        if not (inner or (above and below)):
            raise Unproved(f"{name} = {shortened(text.text)} is not shown to be inside its range at t = {at.text}")


def _full(context: Context, inputs: Mapping[str, Expression], at: Expression) -> Any:
    """Return a function that attempts to prove on a box of parameters that the observability matrix N, with the rows C,
    C A + C', .., has full rank at the time `at`: det(N'N) is not 0; for one output det N."""
    n = len(context.z)

    def attempt(box: Box) -> Attempt:
        try:
            rows = _rows(context, inputs, {**context.form.box, **box}, _value(at))
            columns = [*zip(*rows, strict=True)]
            whole = rows if len(rows) == n else [[total(map(mul, p, q)) for q in columns] for p in columns]
            return Attempt(bool(rows) and determinant(whole).sign != 0)
        except Undefined:
            return Attempt(False)

    return attempt


def _rows(context: Context, inputs: Mapping[str, Expression], box: Box, time: Interval) -> list[list[Interval]]:
    """Return the rows of the observability matrix at a time, over a box of parameters: N_0 = C, N_(k+1) = N_k A + N_k',
    k < n - 1."""
    n = range(len(context.z))
    A, N = series_of(context, inputs, box, time, len(n))
    rows = [[x.coefficients[0] for x in row] for row in N]
    for _ in n[1:]:
        A, inner = ([[Taylor(x.coefficients[:-1]) for x in row] for row in M] for M in (A, N))
        rates = [
            [Taylor(tuple(point(Fraction(k)) * c for k, c in enumerate(x.coefficients) if k)) for x in row] for row in N
        ]
        N = [
            [total((rate[j], *(x * A[k][j] for k, x in enumerate(row)))) for j in n]
            for row, rate in zip(inner, rates, strict=True)
        ]
        rows += [[x.coefficients[0] for x in row] for row in N]
    return rows


def series_of(
    context: Context, inputs: Mapping[str, Expression], box: Box, time: Interval, order: int
) -> tuple[list[list[Taylor]], list[list[Taylor]]]:
    """Return A (n, n) and C (p, n) as Taylor series in time, below an order, at a `time` along the inputs, for all
    parameters in the box. Column k of C is y(z_k = 1) - y(0), for outputs that are affine in z. Raises: `Undefined`."""
    arithmetic, z = taylor(order), context.z
    zero, one = arithmetic.number(Fraction(0)), arithmetic.number(Fraction(1))
    known = {name: padded_series((between(*box[name]),), order) for name in context.file.parameters}
    moving = padded_series((time, point(Fraction(1))), order)
    known |= {name: evaluate(text, {"t": moving}, arithmetic) for name, text in inputs.items()}
    A = [[evaluate(entry, known, arithmetic) for entry in row] for row in context.form.A]
    remainder, C = {**known, **dict.fromkeys(z, zero)}, []
    for output in context.form.output:
        d = evaluate(output, remainder, arithmetic)
        C.append([evaluate(output, {**remainder, name: one}, arithmetic) - d for name in z])
    return A, C


# --- the Gramian over every window


def smallest_eigenvalue(context: Context, claim: Claim) -> Finding:
    """Prove that the smallest eigenvalue of the observability Gramian over every window of time is at least the claim's
    bound, for all parameters."""
    (inputs, _), evidence = claimed_inputs(context, claim), claim.evidence
    level, starts = (whole(evidence, name, 0, most) for name, most in (("level", _LEVEL), ("starts", _STARTS)))
    length, bound = above_zero(evidence, "piece"), above_zero(evidence, "bound")
    _demand_period([text for text in inputs.values() if text.names], evidence, length, starts)
    demand_inside(context, {name: text for name, text in inputs.items() if not text.names}, expression("0", {}))
    span: Box = {"t": (Fraction(0), length * (starts + 2**level))}
    for name, text in inputs.items():
        if text.names:
            covered(span, ".", ranged(text, *context.form.box[name]))
    R, weights = (column(evidence, name, len(context.form.output)) for name in ("R", "weights"))
    if any(s < 0 or r <= 0 or s * s * r > 1 for s, r in zip(weights, R, strict=True)):
        raise Unproved("its weights are more than R allows, or R is not positive")
    windows = _Course(context, inputs, weights)
    try:
        windows.demand(length, level, starts, bound)
    except Undefined as reason:
        raise Unproved(f"A or C has no series along the course: {reason}") from reason
    window = length * (2**level + bool(starts))
    by = f"by the ranges and R = {', '.join(printed(value) for value in R)}"
    return Finding(
        f"{_printed(inputs)} shows at least {printed(bound, -1)}, {by}, in every window of {printed(window, 1)}"
    )


def _demand_period(moving: Sequence[Expression], evidence: Mapping[str, Any], length: Fraction, starts: int) -> None:
    """Demand that inputs that vary with t have a period, and that the first `starts` pieces of a `length` cover it.
    Raises: `Unproved`."""
    if bool(moving) is not bool(starts) or bool(moving) is not ("period" in evidence):
        raise Unproved("its course moves without a period, or has one and is still")
    if moving:
        period = expression(part(evidence, "period", str), {})
        demand_period(moving, period)
        if (point(length * starts) - evaluate(period, {}, intervals)).sign <= 0:
            raise Unproved("its pieces do not cover the period")


class _Course:
    def __init__(self, context: Context, inputs: Mapping[str, Expression], weights: list[Fraction]) -> None:
        self.context, self.inputs, self.weights = context, inputs, weights
        ranges = (context.form.box[z] for z in context.z)
        self.half = [  # half the width of a range, 1 if unbounded
            (Fraction(high) - Fraction(low)) / 2 if -math.inf < low < high < math.inf else Fraction(1)
            for low, high in ranges
        ]
        self.group = -1
        self.around: tuple[Series, Series] = ([], [])

    def demand(self, length: Fraction, level: int, starts: int, bound: Fraction) -> None:
        """Demand that the observability Gramian W >= bound over every window of 2^level pieces of a length, beginning
        in any of the first `starts` pieces. Raises: `Unproved`."""
        if not starts:
            window = self.piece(Fraction(0), length)
            for _ in range(level):
                window = window.then(window)
            return _demand(window, bound)
        parts = [self.piece(k * length, length) for k in range(starts + 2**level)]
        for step in (2**q for q in range(level)):
            parts = [one.then(other) for one, other in zip(parts, parts[step:], strict=False)]
        for k, window in enumerate(parts[1:]):
            _demand(window, bound / self.remaining(k * length, length))
        return None

    def piece(self, begin: Fraction, length: Fraction) -> Window:
        A, C = self.series(point(begin), ORDER + 1)
        group = begin // (_GROUP * length)
        if group != self.group:
            ends = (_GROUP * length * each for each in (group, group + 1))
            self.group, self.around = group, self.series(between(*ends), ORDER + 2)
        return piece(A, C, self.around, length)

    def remaining(self, begin: Fraction, length: Fraction) -> Fraction:
        """Return a lower bound of |x|^2 at the end of a piece of time over |x|^2 at any time in it, for x' = A x."""
        (A,), _ = self.series(between(begin, begin + length), 1)
        steep = (A + A.transposed).times(Fraction(1, 2)).fractions
        size = max(sum(map(abs, row)) for row in steep[0]) + steep[1]
        low, _ = intervals.function("exp", (point(-2 * length * size),)).exactly
        return Fraction(low)

    def series(self, time: Interval, order: int) -> tuple[Series, Series]:
        A, C = series_of(self.context, self.inputs, self.context.form.box, time, order)
        d = self.half
        shares = (
            [[d[j] / d[i] for j in range(len(d))] for i in range(len(d))],
            [[s * x for x in d] for s in self.weights],
        )
        return _coefficients(A, shares[0], order), _coefficients(C, shares[1], order)


def _coefficients(rows: list[list[Taylor]], shares: list[list[Fraction]], order: int) -> Series:
    pairs = [list(zip(row, map(point, share), strict=True)) for row, share in zip(rows, shares, strict=True)]
    return [ball_matrix([[x.coefficients[k] * share for x, share in row] for row in pairs]) for k in range(order)]


def _demand(window: Window, bound: Fraction) -> None:
    """Demand that W - bound I is positive semidefinite for the Gramian W of a window. Raises: `Unproved`."""
    middle, off = window.W.fractions
    demand_nonnegative({"W less the bound": middle - (bound + off) * unit(len(middle))})


_INPUTS = ("inputs", "period")
_ABOUT = "the plant in {kind} form"
_KINDS = ("state_affine", *CHAINS)
RULES = (
    Rule(
        *(("kalman_like",), ("persistence",), persistent, (*_INPUTS, "at"), _KINDS),
        assumes=("{kind}.structure",),
        about=_ABOUT,
    ),
    Rule(
        *(("kalman_like",), ("gramian",), smallest_eigenvalue),
        (*_INPUTS, "piece", "level", "starts", "R", "weights", "bound"),
        _KINDS,
        assumes=("{kind}.structure", "kalman_like.persistence"),
        about=_ABOUT,
    ),
)
