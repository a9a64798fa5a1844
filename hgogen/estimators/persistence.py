"""Regular persistence: inputs that make every state of a state-affine plant observable.

    x' = A(u, y) x + b(u, y),  y = C(u) x + d(u),   Phi' = A Phi,  Phi(s) = I,   W(s, T) = integral_s^(s+T) Phi' C'C Phi

The input is regularly persistent if some T, a > 0 have W(s, T) >= a I for every s.

A known constant or periodic input is proved to be regularly persistent where A(t), C(t) depend on nothing else and the
rows N_0 = C, N_(k+1) = N_k A + N_k' have rank n at one time t_0. Then C Phi x = 0 near t_0 only for x = 0, W over any
window with t_0 inside is positive definite, and every window of two periods contains such a time. The observer clamps
an input to its declared range: the clamped input is periodic as well, and equals the input around a t_0 at which the
input is inside the range. A and C are proved to be finite for every input in its range, so that Phi exists. A constant
input without that rank is refuted. For measured data see `hgogen.excitation`. Source: G. Besancon, G. Bornard, H.
Hammouri, European Journal of Control 2 (1996); L. M. Silverman, H. E. Meadows, SIAM J. Control 5 (1967), for the rank.

A lower bound of the observability Gramian of a state-affine plant over every window of its declared inputs.

    W(s, d) = D (integral_s^(s+d) Phi' C' R^-1 C Phi) D,   Phi' = A Phi,  Phi(s) = 1,   D the half-widths of the ranges

An eigenvalue e means that the outputs within d determine the direction of its eigenvector with a variance of 1/e in
units of the squared ranges. A time-varying course of A and C is cut into pieces of length g. A window consists of m + 1
of them: a window that begins in piece k contains the next m pieces, so that with M = W(t_(k+1), m g)

    W(s, d) >= X' M X,   |X v|^2 >= exp(-2 g a) |v|^2,   X over the remainder of piece k, a >= |A + A'|/2 on it

in scaled coordinates. M is enclosed in balls, and its smallest eigenvalue is bounded in rationals. It is not proved
that the plant's input follows its declared course.

Two successive intervals with (Phi_1, W_1) and (Phi_2, W_2) have (Phi_2 Phi_1, W_1 + Phi_1' W_2 Phi_1) together. On a
piece, Phi and Phi' C' C Phi are Taylor series at its begin up to an order N. By Lagrange the remainder is the
coefficient N + 1 at some time in the piece, entry by entry. It is bounded by the series whose coefficients are the
norms of those of A and C on the whole piece, with |Phi| <= exp(length |A|); an entry of V' V, V = C Phi, is at most
|V|^2. Arb's balls are rounded outward.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from typing import Any

import flint
import sympy as sp

from hgogen.analysis.determinant import determinant
from hgogen.analysis.evidence import Evidence, text_with_names
from hgogen.analysis.undefined import equations_as_written, if_valued
from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Form
from hgogen.reading.expression import BadExpression, parse
from hgogen.reading.given import BadGain
from hgogen.rigor.bounds import bound, nonzero
from hgogen.rigor.box import Box, box, exact
from hgogen.rigor.definite import fraction, number, root, smallest
from hgogen.rigor.field import TooLarge, is_zero
from hgogen.rigor.series import BallSeries, Plant, Undecided, between, evaluate
from hgogen.rigor.singular import possibly_undefined
from hgogen.rigor.slope import JUMPS, KINKS
from hgogen.rigor.tape import NoTape, tape
from hgogen.sentence import NONE, Down, Reason, Sentence, Up, because, down, equations
from hgogen.signal import Signal

t = Signal("t", "", "time")  # equal to that of a trial
_EXACTLY = 'Write a multiple of pi as such: period = "2*pi", not 6.283185, which is the period of no sine of t.'
_SHORTEST = "Give the shortest period, a constant as a rational number, or judge a record by hgogen.excitation."
_SHARES = (
    sp.Rational(1, 7),
    sp.Rational(2, 5),
    sp.Rational(3, 4),
)  # of the period: times at which the rank is computed


@dataclass(frozen=True)
class Persistent:
    """A proof that inputs u(t) are regularly persistent: the rows N_0 = C, N_(k+1) = N_k A + N_k' have rank n at the
    time `at` (s). `inputs`: u(t) by name, with their `period` (s) where one varies."""

    inputs: Mapping[str, sp.Expr] = field(hash=False)
    at: sp.Expr = sp.S.Zero
    period: sp.Expr | None = None

    def evidence(self, form: Form) -> Evidence:
        """Return the evidence for a certificate: the inputs as texts of functions of t, and the time at which the rank
        is n."""
        period = {} if self.period is None else {"period": text_with_names(self.period, set())}
        inputs = {name: text_with_names(e, {"t"}) for name, e in self.inputs.items()}
        return {"inputs": inputs, "at": text_with_names(self.at, set()), **period}


def persistent(id: ClaimId, form: Form, inputs: Mapping[str, Any] | None = None, period: Any = None) -> Check:
    """Return the check that the inputs are regularly persistent, for all parameter values; it is vacuous where A, C
    read no input.

    Args: `inputs`: for each input by name an expression of `hgogen.trial.t`, its text, or a number; None for unknown
    inputs. `period` (s): the common period of varying inputs, such as 2*sympy.pi or "2*pi".

    The module defines the verdicts proved and refuted (for a constant input). All others are unknown, also where exact
    algebra would take too long.

    Raises: `BadGain` for names that are not the plant's inputs, or expressions of anything but the time.
    """
    waveforms = None if inputs is None else _waveforms(form, inputs)
    claim: Sentence | str = "the input is regularly persistent"
    if waveforms:
        claim = Sentence.of("the input is regularly persistent: {waveforms}", waveforms=equations(waveforms))
    check = Check(id, claim, Verdict.UNKNOWN, NONE)

    def answer(verdict: Verdict, reason: Reason, fix: str = "") -> Check:
        return Check(id, check.claim, verdict, reason, fix=fix)

    if not form.structured:
        return answer(Verdict.UNKNOWN, because("it is not shown that the plant is state-affine, with this A and C"))
    symbols = set[sp.Symbol]().union(*(matrix.free_symbols for matrix in along_time(form, waveforms or {})))
    if timed := symbols & {*form.system.times}:
        return answer(Verdict.UNKNOWN, because("A or C is a function of the time {times}", times=timed))
    measured = sorted(str(z) for z in symbols & {*form.states})
    if measured:
        fix = "Ask along a record: hgogen.excitation.along(form, R, u, y, dt, d)."
        reason = because("A depends on {states}, which is measured, not known beforehand", states=measured)
        return answer(Verdict.UNKNOWN, reason, fix)
    if waveforms is None and symbols & {*form.system.inputs}:
        fix = "Give inputs= and period= where it is, or judge a record by hgogen.excitation.along."
        return answer(Verdict.UNKNOWN, because("the input is not known beforehand"), fix)
    try:
        return _judged(answer, form, waveforms, period)
    except TooLarge as error:
        return answer(Verdict.UNKNOWN, error.reason, _SHORTEST)


def _judged(answer: Callable[..., Check], form: Form, waveforms: Mapping[str, sp.Expr] | None, period: Any) -> Check:
    read = set[sp.Symbol]().union(*(matrix.free_symbols for matrix in along_time(form, {})))
    A, C = along_time(form, waveforms or {})
    broken = _broken(form, waveforms) if waveforms else None
    if broken is not None:
        pattern = "{part} of the plant is not shown to be a finite real number all the time"
        return answer(Verdict.UNKNOWN, because(pattern, part=broken))
    if waveforms is None or t not in A.free_symbols | C.free_symbols:
        values = {u: waveforms[u.name] for u in form.system.inputs if u in read} if waveforms else {}
        obstacle = _constant_obstacle(form, A, C, values)
        constants = {u: e for u, e in (waveforms or {}).items() if u in {x.name for x in read}}
        known = answer(Verdict.UNKNOWN, obstacle) if obstacle else _constant(answer, form, A, C)
        return replace(known if waveforms else if_valued(known, form.system), proofs=(Persistent(constants),))
    return _periodic(answer, form, waveforms, A, C, period)


def _periodic(
    answer: Callable[..., Check],
    form: Form,
    waveforms: Mapping[str, sp.Expr],
    A: sp.Matrix,
    C: sp.Matrix,
    period: Any,
) -> Check:
    if period is None:
        reason = because("the input varies, and no period is given")
        return answer(Verdict.UNKNOWN, reason, f"Give its period. {_EXACTLY}")
    length, rough = _expression("period", period), (*JUMPS, *KINKS)
    if not (length.is_positive and length.is_finite) or A.has(*rough) or C.has(*rough):
        reason = because("the period is no positive number, or A(t), C(t) have kinks or jumps")
        return answer(Verdict.UNKNOWN, reason)
    later = (
        sp.expand_mul(e.xreplace({t: t + length})) for e in waveforms.values()
    )  # 20*pi*(t + 1/10) keeps its brackets
    if not all(is_zero(e - now) for e, now in zip(later, waveforms.values(), strict=True)):
        reason = because("it is not shown that {period} is a period", period=period)
        return answer(Verdict.UNKNOWN, reason, _EXACTLY)
    obstacle = _unbounded(form, waveforms, length)
    if obstacle:
        return answer(Verdict.UNKNOWN, obstacle)
    A, C = (matrix.xreplace({t: length * t}) for matrix in (A, C))  # in periods, however short they are
    for share in _SHARES:
        if _inside(form, waveforms, share * length) and _full(form, A, C, share, 1 / length):
            pattern = "rank {n} of C, C A + C', .. at t = {t:.3g}, and so in every period"
            reason = because(pattern, n=form.n, t=float(share * length))
            return replace(answer(Verdict.PROVED, reason), proofs=(Persistent(waveforms, share * length, length),))
    pattern = "no rank {n} of C, C A + C', .. was found at {times} times with the input inside its range"
    return answer(Verdict.UNKNOWN, because(pattern, n=form.n, times=len(_SHARES)))


def seconds(period: Any) -> float | None:
    """Return the declared `period`, an expression, as a number in the model's time unit; None if it is None or not
    positive. Raises: `BadGain` for an expression with symbols other than the time."""
    length = None if period is None else _expression("period", period)
    return float(length) if length is not None and length.is_positive and length.is_finite else None


def _waveforms(form: Form, inputs: Mapping[str, Any]) -> dict[str, sp.Expr]:
    names = [u.name for u in form.system.supplied]
    if not isinstance(inputs, Mapping):
        raise BadGain(f"inputs = {inputs!r}", "must be a mapping from inputs to expressions of the time")
    for name in inputs:
        if name not in names:
            fix = f"; its inputs are {', '.join(names)}" if names else ", which has none"
            raise BadGain(f"inputs {name!r}", f"is no input of the plant{fix}")
    for name in names:
        if name not in inputs:
            raise BadGain(f"inputs {name!r}", f"must be given, as every one of {', '.join(names)}")
    return {name: _expression(f"inputs {name}", inputs[name]) for name in names}


def _expression(name: str, value: Any) -> sp.Expr:
    try:
        expression = parse(value, {"t": t}) if isinstance(value, str) else sp.sympify(value, strict=True)
    except (BadExpression, sp.SympifyError) as error:
        raise BadGain(f"{name} = {value!r}", f"is no expression of the time: {error}") from None
    if not isinstance(expression, sp.Expr) or expression.free_symbols - {t}:
        raise BadGain(f"{name} = {value}", "must be an expression of hgogen.trial.t alone")
    return exact(expression)


def along_time(form: Form, waveforms: Mapping[str, sp.Expr]) -> tuple[sp.Matrix, sp.Matrix]:
    """Return A (n, n) and C (p, n) of a state-affine form with u(t) = `waveforms`, by name, as its inputs."""
    system = form.system
    values = {u: waveforms[u.name] for u in system.inputs if u.name in waveforms}
    values |= {p: exact(sp.sympify(value)) for p, value in system.nominal.items() if not p.bounded}
    C = sp.Matrix([[sp.diff(row, z) for z in form.states] for row in form.output])
    return tuple(matrix.applyfunc(exact).xreplace(values) for matrix in (sp.Matrix(form.A), C))


def _broken(form: Form, waveforms: Mapping[str, sp.Expr]) -> sp.Expr | None:
    """Return a subexpression of the plant that may be infinite at some time for the
    inputs u(t) = `waveforms` and states in their ranges, or None. A and C may not
    contain it: a/b is 1 for a = b = sin t, but the plant is undefined at t = 0."""
    system, around = form.system, box(form.system.signals, form.system.nominal)
    values = {u: waveforms[u.name] for u in system.supplied}
    values |= {p: exact(sp.sympify(value)) for p, value in system.nominal.items() if not p.bounded}
    parts = possibly_undefined(map(exact, equations_as_written(system)), around)
    return next((part for part in parts if not _finite(exact(part.xreplace(values)), around)), None)


def _unbounded(form: Form, waveforms: Mapping[str, sp.Expr], length: sp.Expr) -> Reason:
    period = {t: (Fraction(0), Fraction(int(sp.ceiling(length))))}
    rough: Any = next(iter(equations({name: e for name, e in waveforms.items() if not _finite(e, period)})), None)
    loose = {u.name: waveforms[u.name] for u in form.system.supplied if not u.bounded}
    ranged = [u for u in form.system.inputs if u.bounded]
    around = box((*ranged, *form.system.parameters), form.system.nominal) | period
    entries = (e for matrix in along_time(form, loose) for e in matrix)
    rough = rough or next((e for e in entries if not _finite(e, around)), None)
    unbounded = because("{part} is not shown to be a finite real number over the whole period", part=rough)
    return NONE if rough is None else unbounded


def _constant_obstacle(form: Form, A: sp.Matrix, C: sp.Matrix, constants: Mapping[Signal, sp.Expr]) -> Reason:
    for u, value in constants.items():
        if not _finite(value, {}):
            return because("{input} = {value} is not shown to be a finite real number", input=u, value=value)
        low, high = box((u,))[u]
        extent = bound(value, {})
        inside = low <= Fraction(value) <= high if value.is_Rational else low < extent.low and extent.high < high
        if u.bounded and not inside:
            pattern = "{input} = {value} is not shown to be in the range of {input}, to which the observer clamps it"
            return because(pattern, input=u, value=value)
    around = box(form.system.parameters, form.system.nominal)
    rough = next((e for matrix in (A, C) for e in matrix if not _finite(e, around)), None)
    return NONE if rough is None else because("{part} is not shown to be a finite real number", part=rough)


def _finite(e: sp.Expr, around: Box) -> bool:
    try:
        extent = bound(e, around)
    except NoTape:
        return False
    return extent.defined and extent.finite


def _inside(form: Form, waveforms: Mapping[str, sp.Expr], when: sp.Expr) -> bool:
    extents = {u: bound(waveforms[u.name].xreplace({t: when}), {}) for u in form.system.supplied if u.bounded}
    ranges = box(extents)
    return all(ranges[u][0] < value.low and value.high < ranges[u][1] for u, value in extents.items())


def _rows(A: sp.Matrix, C: sp.Matrix, count: int, rate: sp.Expr = sp.S.One) -> sp.Matrix:
    """Return the stacked rows N_0 = C, N_(k+1) = N_k A + N_k', k < `count`, N_k' = `rate` dN_k/dt."""
    rows = [C]
    for _ in range(count - 1):
        rows.append(rows[-1] * A + rate * rows[-1].diff(t))
    return sp.Matrix.vstack(*rows)


def _size(rows: sp.Matrix) -> sp.Expr:
    """Return det(N'N) of N = `rows` (m, n), the sum of squares of its n x n minors: 0 for a rank below n."""
    square = rows if rows.rows == rows.cols else rows.T * rows
    return determinant(square.tolist()).value


def _full(form: Form, A: sp.Matrix, C: sp.Matrix, when: sp.Rational, rate: sp.Expr = sp.S.One) -> bool:
    """Return whether N_0 = C, N_(k+1) = N_k A + N_k' are proved
    to have rank n at t = `when` for all parameters."""
    around = box(form.system.parameters, form.system.nominal) | {t: (when, when)}
    try:
        return nonzero(_size(_rows(A, C, form.n, rate)), around).verdict is Verdict.PROVED
    except NoTape:
        return False


def _constant(answer: Callable[..., Check], form: Form, A: sp.Matrix, C: sp.Matrix) -> Check:
    if _full(form, A, C, sp.S.Zero):
        check = answer(Verdict.PROVED, because("the pair (C, A) has rank {n}", n=form.n))
    elif is_zero(_size(_rows(A, C, form.n)), box(form.system.parameters, form.system.nominal)):
        fix = "Vary the input, so that it shows the states that a constant one hides."
        check = answer(Verdict.REFUTED, because("the pair (C, A) has a rank below {n}", n=form.n), fix)
    else:
        check = answer(Verdict.UNKNOWN, because("it is not shown that the pair (C, A) has rank {n}", n=form.n))
    return check


_LEVELS = (7, 9)  # a window has 2^7 + 1 pieces, or 2^9 + 1 where the plant is fast
_MOST = 2000  # pieces of all windows
_SHARE = Fraction(999, 1000)  # of the eigenvalue that is claimed, so that another arithmetic can verify it
_DIGITS = 12  # of the length of a piece, and of the bound
_BITS = 40  # of the weights
ORDER = 9  # N
_BALLS = BallSeries(0)


@dataclass(frozen=True)
class WindowGramian:
    """Phi over an interval, Phi' = A Phi, and W = integral Phi'C'C Phi (n, n) over it, as matrices of Arb's balls."""

    Phi: Any
    W: Any

    def then(self, after: "WindowGramian") -> "WindowGramian":
        """Return Phi and W over this interval 1 and the interval 2, `after`, which follows it: (Phi_2 Phi_1, W_1 +
        Phi_1' W_2 Phi_1)."""
        return WindowGramian(after.Phi * self.Phi, self.W + self.Phi.transpose() * after.W * self.Phi)


class Course:
    """A linear plant x' = A(t) x, y = C(t) x that yields its transition matrix and its observability Gramian with
    rigorous error bounds, by Taylor series in the time; A (n, n), C (p, n). `ends`: each parameter in A and C, with the
    ends of its interval. Raises: `NoTape` for an expression without a series."""

    def __init__(self, A: sp.Matrix, C: sp.Matrix, time: sp.Symbol, ends: Sequence[tuple[sp.Symbol, Any, Any]]) -> None:
        self.n, self.p = A.rows, C.rows
        self._plant = Plant(tape([*A, *C], (time, *(symbol for symbol, _, _ in ends))), 0, 0, 1 + len(ends))
        self._constants = [between(Fraction(low), Fraction(high)) for _, low, high in ends]

    def piece(self, begin: Fraction, length: Fraction) -> WindowGramian:
        """Return Phi and W over [begin, begin + length] (s). Raises: `Undecided`, `ZeroDivisionError`."""
        h, order = flint.arb(number(length)), ORDER + 1
        A, C = self._series(flint.arb(number(begin)), order)
        Phi = [flint.arb_mat(self.n, self.n, [int(i == j) for i in range(self.n) for j in range(self.n)])]
        for k in range(ORDER):
            Phi.append(_convolved(A, Phi, k) * (1 / flint.arb(k + 1)))
        V = [_convolved(C, Phi, k) for k in range(order)]
        rates = [_convolved([v.transpose() for v in V], V, k) for k in range(order)]
        error, gramian_error = self._remainders(begin, length)
        end = sum((Phi[k] * h**k for k in range(1, order)), Phi[0] + _around(self.n, error))
        terms = (rates[k] * (h ** (k + 1) * (1 / flint.arb(k + 1))) for k in range(order))
        return WindowGramian(end, sum(terms, _around(self.n, gramian_error)))

    def steepest(self, begin: Fraction, length: Fraction) -> Any:
        """Return a bound a >= |A + A'|/2, a ball, on the times [begin, begin + length] (s)."""
        (A,), _ = self._series(between(begin, begin + length), 1)
        return _norm((A + A.transpose()) * (1 / flint.arb(2)))

    def _remainders(self, begin: Fraction, length: Fraction) -> tuple[Any, Any]:
        """Return bounds of the Taylor remainders of Phi and Phi'C'C Phi over
        `length` (s) from `begin`, Phi the transition matrix of x' = A x."""
        h, order = flint.arb(number(length)), ORDER + 2
        A, C = self._series(between(begin, begin + length), order)
        a, c = ([_norm(each) for each in series] for series in (A, C))
        phi = [(h * a[0]).exp()]
        for k in range(ORDER + 1):
            phi.append(_convolved(a, phi, k) * (1 / flint.arb(k + 1)))
        v = [_convolved(c, phi, k) for k in range(order)]
        rate = _convolved(v, v, ORDER + 1)
        return phi[-1] * h ** (ORDER + 1), rate * h ** (ORDER + 2) * (1 / flint.arb(ORDER + 2))

    def _series(self, time: Any, order: int) -> tuple[list[Any], list[Any]]:
        values = [_BALLS.series([time, 1], order), *(_BALLS.series([value], order) for value in self._constants)]
        rows = [_BALLS.coefficients(row, order) for row, _ in evaluate(self._plant, _BALLS, values, order, 1)]
        square = self.n * self.n
        A, C = rows[:square], rows[square:]
        return (
            [_BALLS.matrix(self.n, self.n, (row[k] for row in A)) for k in range(order)],
            [_BALLS.matrix(self.p, self.n, (row[k] for row in C)) for k in range(order)],
        )


def _convolved(a: Sequence[Any], b: Sequence[Any], k: int) -> Any:
    """Return sum_i a_i b_(k-i), the coefficient k of the product of two power series `a` and `b`."""
    total = a[0] * b[k]
    for i in range(1, k + 1):
        total = total + a[i] * b[k - i]
    return total


def _norm(M: Any) -> Any:
    """Return the largest absolute row or column sum of M: its
    upper end bounds the spectral norm |M| and each entry."""
    rows = [[abs(M[i, j]) for j in range(M.ncols())] for i in range(M.nrows())]
    sums = [sum(row, flint.arb(0)) for row in (*rows, *zip(*rows, strict=True))]
    total = sums[0]
    for each in sums[1:]:
        total = total.max(each)
    return total


def _around(n: int, size: Any) -> Any:
    return flint.arb_mat(n, n, [flint.arb(0, size.abs_upper())] * (n * n))


@dataclass(frozen=True)
class GramianBound:
    """The lower `bound` e of all eigenvalues of the Gramian W over every window of m + 1 pieces, m = 2^`level`, each
    `piece` (s) long, that begins in one of the first `starts` pieces; W = D (integral Phi'C'R^-1 C Phi) D, D the
    half-widths of the ranges.

    For constant A and C a window has m pieces and begins at any time, and `starts` is 0. `inputs` u(t) by name, with
    their `period` (s) where one varies; `R` (p) and `weights` (p): s_j with s_j^2 R_j <= 1.
    """

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
        """The length (s) of a window."""
        return self.piece * ((1 << self.level) + bool(self.starts))

    def evidence(self, form: Form) -> Evidence:
        """Return all fields as numbers and texts for a certificate, from which a checker computes W again."""
        period = {} if self.period is None else {"period": text_with_names(self.period, set())}
        inputs = {name: text_with_names(e, {"t"}) for name, e in self.inputs.items()}
        pieces = {"piece": self.piece, "level": Fraction(self.level), "starts": Fraction(self.starts)}
        return {"inputs": inputs, **period, **pieces, "R": self.R, "weights": self.weights, "bound": self.bound}


def gramian_bound(
    id: ClaimId, form: Form, persistence: Check, R: Sequence[float], length: float | None, memory: float
) -> Check:
    """Return the check, for all parameter values, of a lower bound on the eigenvalues of the observability Gramian over
    every window of the inputs that the check `persistence` proves persistent.

    `R` (p): noise of the outputs; `length` (s) of a window, by default the inputs' period, or `memory` (s) where A and
    C are constant.
    """
    claim: Sentence | str = "every window of the input's course shows every state by a known share of its range"
    inputs = next((one for one in persistence.proofs if isinstance(one, Persistent)), None)
    if persistence.verdict is not Verdict.PROVED or inputs is None:
        reason = because("it is asked of a course that is declared in closed form, and shown to be persistent")
        fix = "Give inputs= and period= where they are known, or judge a record by hgogen.excitation.along."
        return Check(id, claim, Verdict.UNKNOWN, reason, fix=fix)
    first, *_ = noise = tuple(map(Fraction, R))
    proof = _bounded_windows(form, inputs, tuple(each / first for each in noise), length or _period(inputs) or memory)
    if isinstance(proof, Reason):
        return Check(id, claim, Verdict.UNKNOWN, proof, fix="Take another window=, or narrower ranges of parameters.")
    s = 1 / root(first, _BITS)  # a common factor of R scales the Gramian, which is computed once
    weights = tuple(s * each for each in proof.weights)
    proof = replace(proof, R=noise, weights=weights, bound=s * s * proof.bound)
    claim = Sentence.of("every window of {d} {unit} shows every state", d=Up(proof.window, 3), unit=form.system.time)
    pattern = "the smallest eigenvalue of its Gramian, by ranges and R, is at least {bound}; in outward-rounded balls"
    return Check(id, claim, Verdict.PROVED, because(pattern, bound=Down(proof.bound, 3)), proofs=(proof,))


@lru_cache(maxsize=64)
def _bounded_windows(form: Form, inputs: Persistent, R: tuple[Fraction, ...], length: float) -> GramianBound | Reason:
    width = [Fraction(s.interval[1]) - Fraction(s.interval[0]) if s.bounded else Fraction(2) for s in form.states]
    weights = tuple(1 / root(value, _BITS) for value in R)
    A, C = along_time(form, inputs.inputs)
    D, s = (sp.diag(*map(sp.Rational, diagonal)) for diagonal in ([each / 2 for each in width], weights))
    ends = [(p, *box((p,), form.system.nominal)[p]) for p in form.system.tunable]
    period = _period(inputs)
    try:
        course, reason = Course(D.inv() * A * D, s * C * D, t, ends), NONE
        for level in _LEVELS:
            pieces = 2**level + (period is not None)
            piece = Fraction(down(length / pieces, _DIGITS))
            starts = 0 if period is None else math.ceil(period / float(piece)) + 1
            if starts + pieces > _MOST:
                return reason or because("the window is too short beside the period")
            if outside := _outside(form, inputs, piece * (starts + pieces)):
                return outside
            least = min(_windows(course, piece, level, starts))
            if least > 0:
                claimed = Fraction(f"{float(least * _SHARE):.{_DIGITS}g}")
                return GramianBound(inputs.inputs, inputs.period, piece, level, starts, R, weights, claimed)
            pattern = "no bound above 0 is shown by {pieces} pieces of a window of {length:.3g}"
            reason = because(pattern, pieces=pieces, length=float(piece * pieces))
    except (NoTape, Undecided, ZeroDivisionError, OverflowError):
        return because("A and C are not shown to have finite series along the course")
    return reason


def _period(inputs: Persistent) -> float | None:
    return None if inputs.period is None else float(inputs.period)


def _outside(form: Form, inputs: Persistent, end: Fraction) -> Reason:
    """Return the reason why an observer, which clamps inputs to their ranges, may use another u(t) for t <= `end`;
    `NONE` if it does not."""
    for u in form.system.supplied:
        if u.bounded and u.name in inputs.inputs:
            extent = bound(inputs.inputs[u.name], {t: (Fraction(0), end)})
            low, high = box((u,))[u]
            if not (extent.defined and low <= extent.low and extent.high <= high):
                return because("{u} is not shown to keep to its range, to which an observer clamps it", u=u)
    return NONE


def _windows(course: Course, piece: Fraction, level: int, starts: int) -> Iterator[Fraction]:
    """Yield a lower bound of the smallest eigenvalue of the observability
    Gramian W for each window that begins in one of the `starts` pieces; one
    bound, for any window, if A and C are constant and `starts` is 0."""
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
        shrinkage = (-2 * flint.arb(number(piece)) * course.steepest(k * piece, piece)).exp()
        yield _smallest(window) * fraction(shrinkage.lower().fmpq())


def _smallest(window: WindowGramian) -> Fraction:
    """Return a lower bound of the smallest eigenvalue of W: the smallest eigenvalue of the matrix of the balls'
    centres, minus the largest row sum of their radii."""
    n = range(window.W.nrows())
    balls = [[(window.W[i, j] + window.W[j, i]) / 2 for j in n] for i in n]
    if not all(ball.is_finite() for row in balls for ball in row):
        return Fraction(0)
    middle = flint.fmpq_mat([[ball.mid().fmpq() for ball in row] for row in balls])
    least, _ = smallest((middle + middle.transpose()) / 2)
    return least - max(sum(fraction(ball.rad().fmpq()) for ball in row) for row in balls)
