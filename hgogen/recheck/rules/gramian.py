"""How much every window of a declared course shows of a state-affine plant's state, verified again.

    x' = A(u) x + b,  y = C(u) x + d:   W(s, d) = D (integral_s^(s+d) Phi' C' R^-1 C Phi) D >= bound

D are the half-widths of the ranges of the states, 1 without one. A moving course is cut into pieces of `piece`, a
window into 2^level and one more: one that begins in a piece k has W >= exp(-2 piece a) M, M that of the 2^level pieces
after it, a >= |A + A'|/2 on the piece. A still one has windows of 2^level. C is weighted by `weights` s_j with s_j^2
R_j <= 1. The course has the period, which the pieces of `starts` cover, and keeps to the ranges of the inputs, to which
an observer clamps them.
"""

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from ..arithmetic import Undefined, evaluate
from ..box import Box, NotShown, covered, ranged
from ..context import Context, Shown, cut, short
from ..file import Claim, part
from ..interval import Interval, between, intervals, point
from ..matrix import above_zero, column, demand_nonnegative, scalar
from ..moved import ORDER, Series, balls, piece
from ..moved import Shown as Moved
from ..rule import Rule
from ..structure import CHAINS
from ..taylor import Taylor, taylor
from ..text import Expression, expression
from .persistence import course, inside, periodic, slopes_of

_LEVEL, _STARTS = 9, 2000
_GROUP = 8  # pieces whose series have one bound of what they leave


def least(context: Context, claim: Claim) -> Shown:
    """Every window's smallest eigenvalue is at least the bound, for all parameter values."""
    (inputs, _), evidence = course(context, claim), claim.evidence
    level, starts = (_count(evidence, name, most) for name, most in (("level", _LEVEL), ("starts", _STARTS)))
    length, bound = above_zero(evidence, "piece"), above_zero(evidence, "bound")
    moving = [text for text in inputs.values() if text.names]
    if bool(moving) is not bool(starts) or bool(moving) is not ("period" in evidence):
        raise NotShown("its course moves without a period, or has one and is still")
    if moving:
        period = expression(part(evidence, "period", str), {})
        periodic(moving, period)
        if (point(length * starts) - evaluate(period, {}, intervals)).sign <= 0:
            raise NotShown("its pieces do not cover the period")
    inside(context, {name: text for name, text in inputs.items() if not text.names}, expression("0", {}))
    whole: Box = {"t": (Fraction(0), length * (starts + 2**level))}
    for name, text in inputs.items():
        if text.names:
            covered(whole, ".", ranged(text, *context.form.box[name]))
    windows = _Course(context, inputs, _weights(context, evidence))
    try:
        windows.demand(length, level, starts, bound)
    except Undefined as reason:
        raise NotShown(f"A or C has no series along the course: {reason}") from reason
    excitation = ", ".join(f"{name} = {cut(text.text)}" for name, text in inputs.items()) or "every input"
    window = length * (2**level + bool(starts))
    by = f"by the ranges and R = {', '.join(short(value) for value in column(evidence, 'R', len(context.form.output)))}"
    return Shown(f"{excitation} shows at least {short(bound, -1)}, {by}, in every window of {short(window, 1)}")


def _count(evidence: Mapping[str, Any], name: str, most: int) -> int:
    value = scalar(evidence, name)
    if value.denominator > 1 or not 0 <= value <= most:
        raise NotShown(f"its {name} is no number up to {most}")
    return int(value)


def _weights(context: Context, evidence: Mapping[str, Any]) -> list[Fraction]:
    outputs = len(context.form.output)
    R, weights = (column(evidence, name, outputs) for name in ("R", "weights"))
    if any(s < 0 or r <= 0 or s * s * r > 1 for s, r in zip(weights, R, strict=True)):
        raise NotShown("its weights are more than R allows, or R is not positive")
    return weights


class _Course:
    """A and C along the inputs, in scaled coordinates."""

    def __init__(self, context: Context, inputs: Mapping[str, Expression], weights: list[Fraction]) -> None:
        self.form, self.z, self.inputs, self.weights = context.form, context.z, inputs, weights
        ranges = (self.form.box[z] for z in self.z)
        self.half = [  # half the width of a range, 1 of one that has none
            (Fraction(high) - Fraction(low)) / 2 if -math.inf < low < high < math.inf else Fraction(1)
            for low, high in ranges
        ]
        self.ends = {name: between(*self.form.box[name]) for name in context.file.parameters}
        self.group = -1
        self.around: tuple[Series, Series] = ([], [])

    def demand(self, length: Fraction, level: int, starts: int, bound: Fraction) -> None:
        """That the bound holds of every window. Raises: `NotShown`, `Undefined`."""
        if not starts:
            window = self.piece(Fraction(0), length)
            for _ in range(level):
                window = window.then(window)
            return _demand(window, bound)
        parts = [self.piece(k * length, length) for k in range(starts + 2**level)]
        for step in (2**q for q in range(level)):
            parts = [one.then(other) for one, other in zip(parts, parts[step:], strict=False)]
        for k, window in enumerate(parts[1:]):
            _demand(window, bound / self.left(k * length, length))
        return None

    def piece(self, begin: Fraction, length: Fraction) -> Moved:
        """Of a piece of time."""
        A, C = self.series(point(begin), ORDER + 1)
        group = begin // (_GROUP * length)
        if group != self.group:
            ends = (_GROUP * length * each for each in (group, group + 1))
            self.group, self.around = group, self.series(between(*ends), ORDER + 2)
        return piece(A, C, self.around, length)

    def left(self, begin: Fraction, length: Fraction) -> Fraction:
        """What is left at least of |v|^2 from anywhere in a piece to its end."""
        (A,), _ = self.series(between(begin, begin + length), 1)
        steep = (A + A.turned).times(Fraction(1, 2)).fractions
        size = max(sum(map(abs, row)) for row in steep[0]) + steep[1]
        low, _ = intervals.function("exp", (point(-2 * length * size),)).exactly
        return Fraction(low)

    def series(self, time: Interval, order: int) -> tuple[Series, Series]:
        """The coefficients of A and C below the order, at a time."""
        arithmetic = taylor(order)
        none = arithmetic.number(Fraction(0)).coefficients
        moving = Taylor((time, point(Fraction(1)), *none[2:])[:order])
        known = {name: Taylor((value, *none[1:])) for name, value in self.ends.items()}
        known |= {name: evaluate(text, {"t": moving}, arithmetic) for name, text in self.inputs.items()}
        A = [[evaluate(entry, known, arithmetic) for entry in row] for row in self.form.A]
        C = [slopes_of(output, self.z, known, arithmetic) for output in self.form.output]
        d = self.half
        shares = (
            [[d[j] / d[i] for j in range(len(d))] for i in range(len(d))],
            [[s * x for x in d] for s in self.weights],
        )
        return _coefficients(A, shares[0], order), _coefficients(C, shares[1], order)


def _coefficients(rows: list[list[Taylor]], shares: list[list[Fraction]], order: int) -> Series:
    pairs = [list(zip(row, map(point, share), strict=True)) for row, share in zip(rows, shares, strict=True)]
    return [balls([[x.coefficients[k] * share for x, share in row] for row in pairs]) for k in range(order)]


def _demand(window: Moved, bound: Fraction) -> None:
    """That W - bound has no negative eigenvalue."""
    middle, off = window.W.fractions
    rest = [[x - (bound + off) * (i == j) for j, x in enumerate(row)] for i, row in enumerate(middle)]
    demand_nonnegative({"W less the bound": rest})


RULES = (
    Rule(
        ("kalman_like",),
        ("gramian",),
        least,
        ("inputs", "period", "piece", "level", "starts", "R", "weights", "bound"),
        ("state_affine", *CHAINS),
        rests=("{kind}.structure", "kalman_like.persistence"),
        about="the plant in {kind} form",
    ),
)
