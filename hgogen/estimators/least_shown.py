"""How much of its state a state-affine plant shows at least in every window of its input's declared course.

    W(s, d) = D (integral_s^(s+d) Phi' C' R^-1 C Phi) D,   Phi' = A Phi,  Phi(s) = 1,   D the half-widths of the ranges

An eigenvalue e says that within d the outputs tell a direction to a variance 1/e times that of its range. A course that
moves is cut into pieces of g, and a window into m + 1 of them: one that begins in the piece k has the m after it, so
that with M = W(t_(k+1), m g)

    W(s, d) >= X' M X,   |X v|^2 >= exp(-2 g a) |v|^2,   X over what is left of the piece k, a >= |A + A'|/2 on it

in scaled coordinates. M is enclosed in balls, and what it has for a smallest eigenvalue is bounded in rationals. That
the plant's input keeps to its course is not proved. Along a record, see `hgogen.excitation`.

With (Phi, W) of a time, those of it and the one after it together are (Phi_2 Phi_1, W_1 + Phi_1' W_2 Phi_1). Of a piece
Phi and Phi' C' C Phi are Taylor series at the begin to an order N. What they leave is the coefficient N + 1 somewhere
in the piece (Lagrange), entry by entry: at most that of the series whose coefficients are the norms of those of A and C
on the whole piece, from |Phi| <= exp(length |A|); an entry of V' V, V = C Phi, is no more than |V|^2. Arb's balls are
rounded outward.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from typing import Any

import flint
import sympy as sp

from hgogen.analysis.evidence import Evidence, spelled
from hgogen.check import Check, ClaimId, Verdict
from hgogen.estimators.persistence import Persistent, along_time, t
from hgogen.form import Form
from hgogen.rigor.bounds import bound
from hgogen.rigor.box import box
from hgogen.rigor.definite import fraction, number, root, smallest
from hgogen.rigor.series import Balls, Plant, Undecided, between, evaluate
from hgogen.rigor.tape import NoTape, tape
from hgogen.sentence import NONE, Down, Reason, Sentence, Up, because, down

_LEVELS = (7, 9)  # a window has 2^7 pieces and one, or where the plant is fast 2^9
_MOST = 2000  # pieces in all
_SHARE = Fraction(999, 1000)  # of the eigenvalue that is shown, so that another arithmetic reaches it
_DIGITS = 12  # of the length of a piece, and of the bound
_BITS = 40  # of the weights
ORDER = 9  # N
_BALLS = Balls(0)


@dataclass(frozen=True)
class Shown:
    """Of a time: the transition `Phi` over it and what is shown in it, `W` (n, n), matrices of balls."""

    Phi: Any
    W: Any

    def then(self, after: "Shown") -> "Shown":
        """Of this time and the one after it together."""
        return Shown(after.Phi * self.Phi, self.W + self.Phi.transpose() * after.W * self.Phi)


class Course:
    """A (n, n) and C (p, n) as expressions of the time, and of parameters in their `ends`.

    Raises: `NoTape` for what has no series.
    """

    def __init__(self, A: sp.Matrix, C: sp.Matrix, time: sp.Symbol, ends: Sequence[tuple[sp.Symbol, Any, Any]]) -> None:
        self.n, self.p = A.rows, C.rows
        self._plant = Plant(tape([*A, *C], (time, *(symbol for symbol, _, _ in ends))), 0, 0, 1 + len(ends))
        self._constants = [between(Fraction(low), Fraction(high)) for _, low, high in ends]

    def piece(self, begin: Fraction, length: Fraction) -> Shown:
        """Of the piece of that length (s) that begins there. Raises: `Undecided`, `ZeroDivisionError`."""
        h, order = flint.arb(number(length)), ORDER + 1
        A, C = self._series(flint.arb(number(begin)), order)
        Phi = [flint.arb_mat(self.n, self.n, [int(i == j) for i in range(self.n) for j in range(self.n)])]
        for k in range(ORDER):
            Phi.append(_convolved(A, Phi, k) * (1 / flint.arb(k + 1)))
        V = [_convolved(C, Phi, k) for k in range(order)]
        rates = [_convolved([v.transpose() for v in V], V, k) for k in range(order)]
        rest, lost = self._rest(begin, length)
        end = sum((Phi[k] * h**k for k in range(1, order)), Phi[0] + _around(self.n, rest))
        shown = (rates[k] * (h ** (k + 1) * (1 / flint.arb(k + 1))) for k in range(order))
        return Shown(end, sum(shown, _around(self.n, lost)))

    def steepest(self, begin: Fraction, length: Fraction) -> Any:
        """A bound of the largest eigenvalue of |A + A'|/2 on the piece, a ball."""
        (A,), _ = self._series(between(begin, begin + length), 1)
        return _norm((A + A.transpose()) * (1 / flint.arb(2)))

    def _rest(self, begin: Fraction, length: Fraction) -> tuple[Any, Any]:
        """What the two series leave at the end of the piece, balls whose upper ends are the bounds."""
        h, order = flint.arb(number(length)), ORDER + 2
        A, C = self._series(between(begin, begin + length), order)
        a, c = ([_norm(each) for each in series] for series in (A, C))
        phi = [(h * a[0]).exp()]
        for k in range(ORDER + 1):
            phi.append(_convolved(a, phi, k) * (1 / flint.arb(k + 1)))
        v = [_convolved(c, phi, k) for k in range(order)]
        shown = _convolved(v, v, ORDER + 1)
        return phi[-1] * h ** (ORDER + 1), shown * h ** (ORDER + 2) * (1 / flint.arb(ORDER + 2))

    def _series(self, time: Any, order: int) -> tuple[list[Any], list[Any]]:
        """The Taylor coefficients of A and C, below the order, at a ball of times."""
        values = [_BALLS.series([time, 1], order), *(_BALLS.series([value], order) for value in self._constants)]
        rows = [_BALLS.coefficients(row, order) for row, _ in evaluate(self._plant, _BALLS, values, order, 1)]
        square = self.n * self.n
        A, C = rows[:square], rows[square:]
        return (
            [_BALLS.matrix(self.n, self.n, (row[k] for row in A)) for k in range(order)],
            [_BALLS.matrix(self.p, self.n, (row[k] for row in C)) for k in range(order)],
        )


def _convolved(a: Sequence[Any], b: Sequence[Any], k: int) -> Any:
    """The coefficient k of a b."""
    total = a[0] * b[k]
    for i in range(1, k + 1):
        total = total + a[i] * b[k - i]
    return total


def _norm(M: Any) -> Any:
    """The largest sum of sizes of a row, or of a column, a ball whose upper end is the bound: at least the spectral
    norm, and each entry."""
    rows = [[abs(M[i, j]) for j in range(M.ncols())] for i in range(M.nrows())]
    sums = [sum(row, flint.arb(0)) for row in (*rows, *zip(*rows, strict=True))]
    total = sums[0]
    for each in sums[1:]:
        total = total.max(each)
    return total


def _around(n: int, size: Any) -> Any:
    """A matrix of balls about 0."""
    return flint.arb_mat(n, n, [flint.arb(0, size.abs_upper())] * (n * n))


@dataclass(frozen=True)
class LeastShown:
    """The `bound` e of every window of m = 2^`level` pieces of `piece` (s) and one more, that begins in the first
    `starts` of them; where nothing moves of m pieces, wherever it begins, and `starts` is 0. `inputs` by name, with
    their `period` where one varies; `R` (p) and `weights` (p): s_j with s_j^2 R_j <= 1."""

    inputs: Mapping[str, sp.Expr] = field(hash=False)
    period: sp.Expr | None
    piece: Fraction
    level: int
    starts: int
    R: tuple[Fraction, ...]
    weights: tuple[Fraction, ...]
    bound: Fraction

    @property
    def window(self) -> Fraction:
        """d (s)."""
        return self.piece * ((1 << self.level) + bool(self.starts))

    def evidence(self, form: Form) -> Evidence:
        """All of it, of which a checker makes the windows again."""
        period = {} if self.period is None else {"period": spelled(self.period, set())}
        inputs = {name: spelled(e, {"t"}) for name, e in self.inputs.items()}
        pieces = {"piece": self.piece, "level": Fraction(self.level), "starts": Fraction(self.starts)}
        return {"inputs": inputs, **period, **pieces, "R": self.R, "weights": self.weights, "bound": self.bound}


def least_shown(
    id: ClaimId, form: Form, persistence: Check, R: Sequence[float], length: float | None, memory: float
) -> Check:
    """The check of a bound on every window of the course of a check of persistence, for all parameter values.

    `R` (p): of the outputs; `length` (s) of a window, by default the course's period, or `memory` (s) where A and C do
    not move.
    """
    claim: Sentence | str = "every window of the input's course shows every state by a known share of its range"
    known = next((one for one in persistence.proofs if isinstance(one, Persistent)), None)
    if persistence.verdict is not Verdict.PROVED or known is None:
        reason = because("it is asked of a course that is declared in closed form, and shown to be persistent")
        fix = "Give inputs= and period= where they are known, or judge a record by hgogen.excitation.along."
        return Check(id, claim, Verdict.UNKNOWN, reason, fix=fix)
    first, *_ = noise = tuple(map(Fraction, R))
    fact = _least(form, known, tuple(each / first for each in noise), length or _period(known) or memory)
    if isinstance(fact, Reason):
        return Check(id, claim, Verdict.UNKNOWN, fact, fix="Take another window=, or narrower ranges of parameters.")
    s = 1 / root(first, _BITS)  # R as a whole scales the Gramian, which is made once for all of them
    weights = tuple(s * each for each in fact.weights)
    fact = replace(fact, R=noise, weights=weights, bound=s * s * fact.bound)
    claim = Sentence.of("every window of {d} {unit} shows every state", d=Up(fact.window, 3), unit=form.system.time)
    pattern = "the smallest eigenvalue of its Gramian, by ranges and R, is at least {bound}; in outward-rounded balls"
    return Check(id, claim, Verdict.PROVED, because(pattern, bound=Down(fact.bound, 3)), proofs=(fact,))


@lru_cache(maxsize=64)
def _least(form: Form, known: Persistent, R: tuple[Fraction, ...], length: float) -> LeastShown | Reason:
    width = [Fraction(s.interval[1]) - Fraction(s.interval[0]) if s.bounded else Fraction(2) for s in form.states]
    weights = tuple(1 / root(value, _BITS) for value in R)
    A, C = along_time(form, known.inputs)
    D, s = (sp.diag(*map(sp.Rational, diagonal)) for diagonal in ([each / 2 for each in width], weights))
    ends = [(p, *box((p,), form.system.nominal)[p]) for p in form.system.tunable]
    period = _period(known)
    try:
        course, reason = Course(D.inv() * A * D, s * C * D, t, ends), NONE
        for level in _LEVELS:
            pieces = 2**level + (period is not None)
            piece = Fraction(down(length / pieces, _DIGITS))
            starts = 0 if period is None else math.ceil(period / float(piece)) + 1
            if starts + pieces > _MOST:
                return reason or because("the window is too short beside the period")
            if outside := _outside(form, known, piece * (starts + pieces)):
                return outside
            least = min(_windows(course, piece, level, starts))
            if least > 0:
                shown = Fraction(f"{float(least * _SHARE):.{_DIGITS}g}")
                return LeastShown(known.inputs, known.period, piece, level, starts, R, weights, shown)
            pattern = "no bound above 0 is shown by {pieces} pieces of a window of {length:.3g}"
            reason = because(pattern, pieces=pieces, length=float(piece * pieces))
    except (NoTape, Undecided, ZeroDivisionError, OverflowError):
        return because("A and C are not shown to have finite series along the course")
    return reason


def _period(known: Persistent) -> float | None:
    return None if known.period is None else float(known.period)


def _outside(form: Form, known: Persistent, end: Fraction) -> Reason:
    """Why an observer, which clamps inputs to their ranges, may not take the course as it is; `NONE` if it does."""
    for u in form.system.inputs:
        if u.bounded and u.name in known.inputs:
            extent = bound(known.inputs[u.name], {t: (Fraction(0), end)})
            low, high = box((u,))[u]
            if not (extent.defined and low <= extent.low and extent.high <= high):
                return because("{u} is not shown to keep to its range, to which an observer clamps it", u=u)
    return NONE


def _windows(course: Course, piece: Fraction, level: int, starts: int) -> Iterator[Fraction]:
    """A bound of the smallest eigenvalue of each window that begins in one of the pieces of `starts`; where that is 0,
    as A and C do not move, of any window."""
    if not starts:
        window = course.piece(Fraction(0), piece)
        for _ in range(level):
            window = window.then(window)
        yield _smallest(window)
        return
    parts = [course.piece(k * piece, piece) for k in range(starts + 2**level)]
    for step in (2**q for q in range(level)):
        parts = [one.then(other) for one, other in zip(parts, parts[step:], strict=False)]
    for k, window in enumerate(parts[1:]):
        left = (-2 * flint.arb(number(piece)) * course.steepest(k * piece, piece)).exp()
        yield _smallest(window) * fraction(left.lower().fmpq())


def _smallest(window: Shown) -> Fraction:
    """A bound of the smallest eigenvalue of W: that of the middle of the balls, less the largest sum of radii."""
    n = range(window.W.nrows())
    balls = [[(window.W[i, j] + window.W[j, i]) / 2 for j in n] for i in n]
    if not all(ball.is_finite() for row in balls for ball in row):
        return Fraction(0)
    middle = flint.fmpq_mat([[ball.mid().fmpq() for ball in row] for row in balls])
    least, _ = smallest((middle + middle.transpose()) / 2)
    return least - max(sum(fraction(ball.rad().fmpq()) for ball in row) for row in balls)
