"""That an input shows every state of a state-affine plant again and again, verified again.

    x' = A(u) x + b,   y = C(u) x + d,   N_0 = C,   N_(k+1) = N_k A + N_k':   rank n of N_0, .., N_(n-1) at a time t_0

makes the observability Gramian over any window with t_0 inside positive definite; a periodic input has such a time in
every window of two periods. An input is constant, or reads the time in sin and cos alone, of arguments that a period
takes a whole number of turns further. The observer clamps an input to its range: at t_0 it is strictly inside, or it is
constant and in it. A and C are finite on the box, as the form's structure has it. Derivatives in t are forward, those
of the parameters' box in mpmath's intervals. Source: L. M. Silverman, H. E. Meadows, SIAM J. Control 5 (1967).
"""

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

from ..arithmetic import Arithmetic, Dual, Undefined, dual, evaluate
from ..box import Box, NotShown, Try, covered, ranged, sides
from ..context import Context, Shown, algebra_of, cut, letters_of, narrowed, only, value_of
from ..file import Claim, part
from ..interval import intervals, point
from ..rule import Rule
from ..structure import CHAINS
from ..tables import is_table
from ..text import Expression, expression

MOST = 5  # states, beyond which determinants and derivatives are too long
_KINKS = ("Abs", "sign", "Min", "Max")
_TURNS = 1000  # of an argument over a period
TIME = {"t": (-math.inf, math.inf)}


def course(context: Context, claim: Claim) -> tuple[dict[str, Expression], set[str]]:
    """The inputs of the claim, expressions of the time, and what A and C read, which is of these and of parameters.

    Raises: `NotShown`.
    """
    _ = context.equations
    form, texts = context.form, part(claim.evidence, "inputs", dict)
    inputs = {name: expression(text, TIME) for name, text in texts.items()}
    read = {name for row in form.A for entry in row for name in entry.names}
    read |= {name for output in form.output for name in output.names} - set(context.z)
    only(inputs, context.file.inputs, "the claim's input")
    only(read, (*inputs, *context.file.parameters), "A or C")
    return inputs, read


def persistent(context: Context, claim: Claim) -> Shown:
    """The claim's inputs show every state, for all parameter values."""
    (inputs, read), evidence, form = course(context, claim), claim.evidence, context.form
    if len(context.z) > MOST:
        raise NotShown(f"the rank of more than {MOST} states is not computed")
    texts = (*inputs.values(), *form.output, *(entry for entries in form.A for entry in entries))
    if any(step.op in _KINKS or is_table(step.op) for text in texts for step in text.instructions):
        raise NotShown("an input, A or C has kinks or jumps")
    at = expression(part(evidence, "at", str), {})
    moving = [text for text in inputs.values() if text.names]
    if moving:
        period = expression(part(evidence, "period", str), {})
        periodic(moving, period)
        turn: Box = {"t": (Fraction(0), _above(period))}
        for text in moving:
            covered(turn, ".", ranged(text, -math.inf, math.inf))
    inside(context, inputs, at)
    parameters = narrowed(form.box, read & set(context.file.parameters))
    boxes = covered(parameters, ".", _full(context, inputs, at))
    excitation = ", ".join(f"{name} = {cut(text.text)}" for name, text in inputs.items()) or "every input"
    return Shown(
        f"{excitation} shows all {len(context.z)} states: C, C A + C', .. have full rank at t = {at.text}", boxes
    )


def _value(text: Expression) -> Any:
    """A constant as an interval."""
    return evaluate(text, {}, intervals)


def _above(period: Expression) -> Fraction:
    """A whole number above a positive constant."""
    value = _value(period)
    if value.sign <= 0 or not value.at_most(Fraction(10**9)):
        raise NotShown(f"the period {cut(period.text)} is not shown to be positive, or is too long")
    whole = next(k for k in range(1, 64) if value.at_most(Fraction(2**k)))
    return Fraction(2**whole)


def periodic(texts: Sequence[Expression], period: Expression) -> None:
    """The time stands in sin and cos alone, of arguments c t + d with c times the period a multiple of 2 pi."""
    algebra = algebra_of(TIME)
    letters, one = letters_of(algebra, TIME), algebra.number(Fraction(1))
    for text in texts:
        raw: list[bool] = []  # whether a place reads the time beside sin and cos
        for op, args, _ in text.instructions:
            loose = op == "symbol" or any(raw[place] for place in args)
            if loose and op in ("sin", "cos"):
                inner = Expression(text.text, text.instructions, args[0], text.names)
                moving = Dual(letters["t"], {0: one})
                slope = evaluate(inner, {"t": moving}, dual(algebra.arithmetic)).slopes.get(0)
                turns = slope and slope * value_of(period, letters, algebra)
                loose = not (turns and _whole_turns(turns, algebra))
            raw.append(loose)
        if raw[text.result]:
            raise NotShown(f"{cut(period.text)} is not shown to be a period of {cut(text.text)}")


def _whole_turns(turns: Any, algebra: Any) -> bool:
    """Whether it is 2 pi k for a whole k."""
    pi = algebra.function("pi", ())
    each = (k for size in range(1, _TURNS + 1) for k in (size, -size))
    return any(algebra.is_zero(turns - algebra.number(Fraction(2 * k)) * pi) for k in each)


def inside(context: Context, inputs: Mapping[str, Expression], at: Expression) -> None:
    """Each input is inside its range at t_0: strictly where it moves."""
    for name, text in inputs.items():
        low, high = context.form.box[name]
        value = evaluate(text, {"t": _value(at)}, intervals)
        exact = None if text.names else _rational(text)
        held = exact is not None and low <= exact <= high
        above = low == -math.inf or (value - point(Fraction(low))).sign > 0
        below = high == math.inf or (point(Fraction(high)) - value).sign > 0
        if not (held or (above and below)):
            raise NotShown(f"{name} = {cut(text.text)} is not shown to be inside its range at t = {at.text}")


def _rational(text: Expression) -> Fraction | None:
    """The value of an expression of no names, None where it is not written as a rational number."""
    algebra = algebra_of({})
    value: Fraction | None = value_of(text, {}, algebra).number
    return value


def _full(context: Context, inputs: Mapping[str, Expression], at: Expression) -> Any:
    """The statement that det(N'N) is not zero, N the rows N_0, .., N_(n-1) at t_0; det N of one output."""
    n = len(context.z)

    def attempt(box: Box) -> Try:
        try:
            rows = _rows(context, inputs, at, box)
            whole = rows
            if len(rows) > n:
                columns = list(zip(*rows, strict=True))
                whole = [[_total(a * b for a, b in zip(p, q, strict=True)) for q in columns] for p in columns]
            return Try(_determinant(whole).sign != 0)
        except Undefined:
            return Try(False)

    return attempt


def _rows(context: Context, inputs: Mapping[str, Expression], at: Expression, box: Box) -> list[list[Any]]:
    """Enclosures of the rows of N_0 = C, N_(k+1) = N_k A + N_k', k < n - 1, at t_0."""
    form, z = context.form, context.z
    arithmetic, time = intervals, _value(at)
    for _ in z[1:]:
        one = arithmetic.number(Fraction(1))
        arithmetic, time = dual(arithmetic), Dual(time, {0: one})
    known = {name: _constant(side, len(z) - 1) for name, side in sides(box).items()}
    known |= {
        name: arithmetic.number(Fraction(low))
        for name, (low, high) in form.box.items()
        if low == high and name not in known
    }
    known |= {name: evaluate(text, {"t": time}, arithmetic) for name, text in inputs.items()}
    A = [[evaluate(entry, known, arithmetic) for entry in entries] for entries in form.A]
    C = [slopes_of(output, z, known, arithmetic) for output in form.output]
    rows = [[_base(x) for x in row] for row in C]
    for _ in z[1:]:
        A = [[x.value for x in row] for row in A]
        still = A[0][0] - A[0][0]
        C = [
            [_total(x.value * A[k][j] for k, x in enumerate(row)) + row[j].slopes.get(0, still) for j in range(len(z))]
            for row in C
        ]
        rows += [[_base(x) for x in row] for row in C]
    return rows


def _constant(value: Any, depth: int) -> Any:
    for _ in range(depth):
        value = Dual(value, {})
    return value


def slopes_of(output: Expression, z: Sequence[str], known: Mapping[str, Any], arithmetic: Arithmetic) -> list[Any]:
    """C of an output that is affine in z: y(z_k = 1) - y(0)."""
    zero, one = arithmetic.number(Fraction(0)), arithmetic.number(Fraction(1))
    rest = {**known, **dict.fromkeys(z, zero)}
    d = evaluate(output, rest, arithmetic)
    return [evaluate(output, {**rest, name: one}, arithmetic) - d for name in z]


def _base(x: Any) -> Any:
    while isinstance(x, Dual):
        x = x.value
    return x


def _total(terms: Any) -> Any:
    first, *others = terms
    for other in others:
        first = first + other
    return first


def _determinant(rows: list[list[Any]]) -> Any:
    """The determinant of a square matrix, by expansion along the first row."""
    if len(rows) == 1:
        return rows[0][0]
    terms = []
    for j, entry in enumerate(rows[0]):
        minor = _determinant([[*row[:j], *row[j + 1 :]] for row in rows[1:]])
        terms.append(entry * minor if j % 2 == 0 else -(entry * minor))
    return _total(terms)


RULES = (
    Rule(
        ("kalman_like",),
        ("persistence",),
        persistent,
        ("inputs", "period", "at"),
        ("state_affine", *CHAINS),
        rests=("{kind}.structure",),
        about="the plant in {kind} form",
    ),
)
