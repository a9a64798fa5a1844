"""Whether an input shows every state of a state-affine plant: regular persistence.

    x' = A(u, y) x + b(u, y),  y = C(u) x + d(u),   Phi' = A Phi,  Phi(s) = I,   W(s, T) = integral_s^(s+T) Phi' C'C Phi

The input is regularly persistent if some T, a > 0 have W(s, T) >= a I for every s.

A known input, constant or periodic, is proved so where A(t), C(t) depend on nothing else: the rows N_0 = C,
N_(k+1) = N_k A + N_k' have rank n at one time t_0. For then no x but 0 has C Phi x = 0 near t_0, W over any window with
t_0 inside is positive definite, and every window of two periods has such a time in it. The observer clamps an input to
its declared range: what it takes is periodic as well, and is the input around a t_0 where that is inside the range. A
and C are shown to be finite for every input in its range, so that Phi exists. A constant input without that rank is
refuted. Along a record, see `hgogen.excitation`. Source: G. Besancon, G. Bornard, H. Hammouri, European Journal of
Control 2 (1996); L. M. Silverman, H. E. Meadows, SIAM J. Control 5 (1967), for the rank.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

import sympy as sp

from hgogen.analysis.determinant import determinant
from hgogen.analysis.evidence import Evidence, spelled
from hgogen.analysis.undefined import if_valued, written
from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Form
from hgogen.reading.expression import BadExpression, parse
from hgogen.reading.given import BadGain
from hgogen.rigor.bounds import bound, nonzero
from hgogen.rigor.box import Box, box, exact
from hgogen.rigor.field import TooLarge, is_zero
from hgogen.rigor.singular import doubtful
from hgogen.rigor.slope import JUMPS, KINKS
from hgogen.rigor.tape import NoTape
from hgogen.sentence import NONE, Reason, Sentence, because, equations
from hgogen.signal import Signal

t = Signal("t", "", "time")  # equal to that of a trial
_EXACTLY = 'Write a multiple of pi as such: period = "2*pi", not 6.283185, which is the period of no sine of t.'
_SHORTEST = "Give the shortest period, a constant as a rational number, or judge a record by hgogen.excitation."
_SHARES = (sp.Rational(1, 7), sp.Rational(2, 5), sp.Rational(3, 4))  # of the period, at which the rank is asked


@dataclass(frozen=True)
class Persistent:
    """What shows that an input is: rank n at the time `at` (s); `inputs` by name, with their `period` where one
    varies."""

    inputs: Mapping[str, sp.Expr] = field(hash=False)
    at: sp.Expr = sp.S.Zero
    period: sp.Expr | None = None

    def evidence(self, form: Form) -> Evidence:
        """The inputs as functions of time, and a time at which they show every state."""
        period = {} if self.period is None else {"period": spelled(self.period, set())}
        inputs = {name: spelled(e, {"t"}) for name, e in self.inputs.items()}
        return {"inputs": inputs, "at": spelled(self.at, set()), **period}


def persistent(id: ClaimId, form: Form, inputs: Mapping[str, Any] | None = None, period: Any = None) -> Check:
    """The check that the inputs are regularly persistent, for all parameter values; any are where A, C read none.

    Args: `inputs`: of each input by name, an expression of `hgogen.trial.t`, its text, or a number, None where they are
    not known beforehand; `period` (s) of them all, as 2*sympy.pi or "2*pi", where one varies.

    The verdicts proved and refuted (of a constant input) are as the module says; all else is unknown, as is what exact
    algebra would need too long for.

    Raises: `BadGain` for names that are not the plant's inputs, or expressions of something else.
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
    """The check for known inputs, or for A and C that read none. Raises: `TooLarge`."""
    read = set[sp.Symbol]().union(*(matrix.free_symbols for matrix in along_time(form, {})))
    A, C = along_time(form, waveforms or {})
    broken = _broken(form, waveforms) if waveforms else None
    if broken is not None:
        pattern = "{part} of the plant is not shown to be a finite real number all the time"
        return answer(Verdict.UNKNOWN, because(pattern, part=broken))
    if waveforms is None or t not in A.free_symbols | C.free_symbols:
        doubt = _doubt(form, A, C, {u: waveforms[u.name] for u in form.system.inputs if u in read} if waveforms else {})
        constants = {u: e for u, e in (waveforms or {}).items() if u in {x.name for x in read}}
        known = answer(Verdict.UNKNOWN, doubt) if doubt else _constant(answer, form, A, C)
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
    """The check for inputs that vary, with A(t) and C(t). Raises: `TooLarge`."""
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
    doubt = _unbounded(form, waveforms, length)
    if doubt:
        return answer(Verdict.UNKNOWN, doubt)
    A, C = (matrix.xreplace({t: length * t}) for matrix in (A, C))  # in periods, however short they are
    for share in _SHARES:
        if _inside(form, waveforms, share * length) and _full(form, A, C, share, 1 / length):
            pattern = "rank {n} of C, C A + C', .. at t = {t:.3g}, and so in every period"
            reason = because(pattern, n=form.n, t=float(share * length))
            return replace(answer(Verdict.PROVED, reason), proofs=(Persistent(waveforms, share * length, length),))
    pattern = "no rank {n} of C, C A + C', .. was found at {times} times with the input inside its range"
    return answer(Verdict.UNKNOWN, because(pattern, n=form.n, times=len(_SHARES)))


def seconds(period: Any) -> float | None:
    """A declared period as a number of the model's time unit; None where none is declared, or it is not positive.

    Raises: `BadGain` for an expression of something else than the time.
    """
    length = None if period is None else _expression("period", period)
    return float(length) if length is not None and length.is_positive and length.is_finite else None


def _waveforms(form: Form, inputs: Mapping[str, Any]) -> dict[str, sp.Expr]:
    """Each input by name as an expression of the time. Raises: `BadGain`."""
    names = [u.name for u in form.system.inputs]
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
    """A number, a text or an expression as an expression of the time alone, with exact numbers. Raises: `BadGain`."""
    try:
        expression = parse(value, {"t": t}) if isinstance(value, str) else sp.sympify(value, strict=True)
    except (BadExpression, sp.SympifyError) as error:
        raise BadGain(f"{name} = {value!r}", f"is no expression of the time: {error}") from None
    if not isinstance(expression, sp.Expr) or expression.free_symbols - {t}:
        raise BadGain(f"{name} = {value}", "must be an expression of hgogen.trial.t alone")
    return exact(expression)


def along_time(form: Form, waveforms: Mapping[str, sp.Expr]) -> tuple[sp.Matrix, sp.Matrix]:
    """A (n, n) and C (p, n) with waveforms in the place of the inputs and fixed parameters at their values."""
    system = form.system
    values = {u: waveforms[u.name] for u in system.inputs if u.name in waveforms}
    values |= {p: exact(sp.sympify(value)) for p, value in system.nominal.items() if not p.bounded}
    C = sp.Matrix([[sp.diff(row, z) for z in form.states] for row in form.output])
    return tuple(matrix.applyfunc(exact).xreplace(values) for matrix in (sp.Matrix(form.A), C))


def _broken(form: Form, waveforms: Mapping[str, sp.Expr]) -> sp.Expr | None:
    """A part of the plant that is not shown to be finite for these inputs at all times and the states in their ranges;
    None if there is none. A and C may have lost it: a/b is 1 for a = b = sin t, and the plant has no value at t = 0."""
    system, around = form.system, box(form.system.signals, form.system.nominal)
    values = {u: waveforms[u.name] for u in system.inputs}
    values |= {p: exact(sp.sympify(value)) for p, value in system.nominal.items() if not p.bounded}
    parts = doubtful(map(exact, written(system)), around)
    return next((part for part in parts if not _finite(exact(part.xreplace(values)), around)), None)


def _unbounded(form: Form, waveforms: Mapping[str, sp.Expr], length: sp.Expr) -> Reason:
    """An input, or an entry of A and C for inputs in their ranges, that is not shown to be finite and real over a
    period; `NONE` if there is none."""
    period = {t: (Fraction(0), Fraction(int(sp.ceiling(length))))}
    rough: Any = next(iter(equations({name: e for name, e in waveforms.items() if not _finite(e, period)})), None)
    loose = {u.name: waveforms[u.name] for u in form.system.inputs if not u.bounded}
    ranged = [u for u in form.system.inputs if u.bounded]
    around = box((*ranged, *form.system.parameters), form.system.nominal) | period
    entries = (e for matrix in along_time(form, loose) for e in matrix)
    rough = rough or next((e for e in entries if not _finite(e, around)), None)
    unbounded = because("{part} is not shown to be a finite real number over the whole period", part=rough)
    return NONE if rough is None else unbounded


def _doubt(form: Form, A: sp.Matrix, C: sp.Matrix, constants: Mapping[Signal, sp.Expr]) -> Reason:
    """What is in the way of a constant input: it is no real number, the observer clamps it, or A, C are not finite;
    `NONE` if nothing."""
    for u, value in constants.items():
        if not _finite(value, {}):
            return because("{input} = {value} is not shown to be a finite real number", input=u, value=value)
        if u.bounded and not _within(value, *box((u,))[u]):
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


def _within(value: sp.Expr, low: Any, high: Any) -> bool:
    """Whether a constant is in the closed range: exactly for a rational, else strictly by rigorous bounds."""
    if value.is_Rational:
        return bool(low <= Fraction(value) <= high)
    extent = bound(value, {})
    return bool(low < extent.low and extent.high < high)


def _inside(form: Form, waveforms: Mapping[str, sp.Expr], when: sp.Expr) -> bool:
    """Whether each input that the observer clamps is strictly inside its range at that time, and so around it."""
    extents = {u: bound(waveforms[u.name].xreplace({t: when}), {}) for u in form.system.inputs if u.bounded}
    ranges = box(extents)
    return all(ranges[u][0] < value.low and value.high < ranges[u][1] for u, value in extents.items())


def _rows(A: sp.Matrix, C: sp.Matrix, count: int, rate: sp.Expr = sp.S.One) -> sp.Matrix:
    """N_0 = C, N_(k+1) = N_k A + N_k', one below the other, of matrices of `rate` times the time (s)."""
    rows = [C]
    for _ in range(count - 1):
        rows.append(rows[-1] * A + rate * rows[-1].diff(t))
    return sp.Matrix.vstack(*rows)


def _size(rows: sp.Matrix) -> sp.Expr:
    """The sum of squares of the minors of n rows, which is det(N'N): 0 where the rank is below n."""
    square = rows if rows.rows == rows.cols else rows.T * rows
    return determinant(square.tolist()).value


def _full(form: Form, A: sp.Matrix, C: sp.Matrix, when: sp.Rational, rate: sp.Expr = sp.S.One) -> bool:
    """Whether the rows of matrices of `rate` times the time (s) have rank n there, for all parameter values: proved."""
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
