"""The error of a high gain on the uniform form, against the plant, and one norm in which it decays.

    z' = F(z, u) + diag(g_1, .., g_n) (y - h(z, u)),   F_k = s_k z_(k+1) + b_k(sat z, u),   y = a z_1 + c
    g_i = theta^i K_i/(a F_1' .. F_(i-1)') at (sat z, u),   F_k' = dF_k/dz_(k+1)

s_k is a number between the ends of the range of F_k': so F_k goes on beyond the ranges, and its mean slope from the
plant's state to any estimate is in that range still. With e = z - x, exactly, in e_i s_1 .. s_(i-1)/theta^(i-1),

    e' = (theta (N - diag(K_1, K_2 q_1, K_3 q_1 q_2, ..) 1 C) + slopes) e,   q_k in the range of s_k/F_k'

N the shift. The slopes are those of b: of F_k in z_(k+1), which stay as theta grows, and in z_j, j <= k, which shrink,
whose ranges hold 0. So one P > 0 that decays for all of them at some theta decays for every larger one, at a rate that
grows with it. The matrix is affine in each slope and in each q_k, so that it is in the hull of those at all
combinations of their ends: of few that is what is shown, of many with a multiplier for each slope, and each
K_i q_1 .. q_(i-1) a slope of its own (`common_norm`). The difference of two estimates obeys no such equation, for it
holds (g(z) - g(z~)) (y - h(z~)).
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import product

import numpy as np
import sympy as sp

from hgogen.analysis.evidence import Evidence, enclosure, outward
from hgogen.analysis.polytope import fixed, span
from hgogen.check import Verdict
from hgogen.form import Form
from hgogen.prove.bounded_theta import Nothing
from hgogen.prove.inclusion import Inclusion, Slope, inclusion, of_field, plain
from hgogen.prove.inequality import one_by_one
from hgogen.rigor.bounds import Range
from hgogen.rigor.kinks import slope
from hgogen.rigor.points import exact, largest_exponent
from hgogen.sentence import Reason, because

STATES = 6  # of more the search for P takes longer than a check may
_OPERATIONS, _EXPONENT = 100, 100  # of a slope that is factored
Shares = list[tuple[Fraction, Fraction]]  # the range of each q_k


def slopes_on(form: Form) -> tuple[sp.Expr, ...]:
    """F_1', .., F_(n-1)' of a form in the order of its chain, constants at their values."""
    known, slopes = dict(fixed(form)), []
    for row, z in zip(form.flow, form.states[1:], strict=False):
        each = exact(slope(sp.sympify(row), z).xreplace(known))
        # in factors a variable stands less often and ranges are narrower; as it is where that may take long
        brief = sp.count_ops(each) <= _OPERATIONS and largest_exponent(each) <= _EXPONENT
        slopes.append(sp.factor(each) if brief else each)
    return tuple(slopes)


def middles(form: Form) -> tuple[sp.Rational, ...] | Reason:
    """s_1, .., s_(n-1), each short and in the range of its F_k'; or why there are none."""
    numbers = []
    for k, each in enumerate(slopes_on(form), 1):
        known = _range(each, form)
        if known is None or known.low <= 0 <= known.high:
            return because("F_{k}' = {slope} has no finite range that keeps off zero on the box", k=k, slope=each)
        middle = math.copysign(math.sqrt(known.low * known.high), known.low)
        short = sp.Rational(f"{middle:.3g}")
        numbers.append(short if known.low <= short <= known.high else sp.Rational(Fraction(middle)))
    return tuple(numbers)


def uniform_error(form: Form, K: Sequence[float]) -> Inclusion | Nothing:
    """What the error obeys of the gains K (n), on a form whose A holds the s_k above its diagonal and nothing else."""
    if form.n > STATES:
        return Nothing(because("the bound is computed for up to {most} states", most=STATES))
    open_ = [check.id for check in form.checks if check.verdict is not Verdict.PROVED]
    if open_:
        return Nothing(because("the bound rests on {check}, which is not proved", check=open_[0]))
    gains, known = tuple(map(Fraction, K)), _shares(form)
    if isinstance(known, Nothing):
        return known
    shares, ranges = known
    n, units = form.n, [Fraction(1)]
    A = np.array([[Fraction(str(form.A[i, j])) for j in range(n)] for i in range(n)], dtype=object)
    for k in range(n - 1):
        units.append(units[-1] * A[k, k + 1])
    scale = tuple(map(sp.Rational, units))
    error = inclusion(form, plain(form), A, np.zeros((n, 0)), scale, units, {"gains": gains})
    if isinstance(error, Nothing):
        return error
    # what each K_i q_1 .. q_(i-1) brings is a slope of its own
    every = [_injected(gains, q) for q in product(*shares)]
    ends = [(min(each), max(each)) for each in zip(*every, strict=True)]
    first = of_field(0, n)
    pushes = tuple(Slope(first, tuple(Fraction(-int(k == i)) for k in range(n)), *ends[i], -1) for i in range(n))
    hull = _together(len(error.varying), pushes, gains, shares)
    return replace(error, slopes=(*error.slopes, *pushes), own={"shares": ranges}, hull=hull)


def _shares(form: Form) -> tuple[Shares, list[Evidence | None]] | Nothing:
    """The range of each q_k = s_k/F_k', and the evidence of that of 1/F_k'."""
    shares, ranges = Shares(), list[Evidence | None]()
    for k, dF in enumerate(slopes_on(form)):
        inverse, s = exact(sp.sympify(1 / dF)), Fraction(str(form.A[k, k + 1]))
        known = _range(inverse, form)
        if known is None:
            return Nothing(because("1/({slope}) has no finite range on the box", slope=dF))
        ranges.append(enclosure(form, inverse, known))
        number = Fraction(str(inverse)) if inverse.is_Rational else None
        ends = [outward(known.low, -1), outward(known.high, 1)] if number is None else [number] * 2
        low, high = sorted(s * end for end in ends)
        shares.append((low, high))
    return shares, ranges


def _together(
    of_b: int, pushes: Sequence[Slope], gains: Sequence[Fraction], shares: Shares
) -> tuple[tuple[Fraction, ...], ...]:
    """The places of so many slopes of b, and of these, at all combinations of ends; none of too many."""
    ends = [sorted(set(pair)) for pair in shares]
    if not one_by_one(len(gains), of_b + sum(len(pair) > 1 for pair in ends)):
        return ()
    places = [
        tuple(
            (2 * x - push.low - push.high) / (push.high - push.low)
            for x, push in zip(_injected(gains, q), pushes, strict=True)
            if push.low < push.high
        )
        for q in product(*ends)
    ]
    signs = product((Fraction(-1), Fraction(1)), repeat=of_b)
    return tuple((*d, *place) for d in signs for place in places)


def _injected(gains: Sequence[Fraction], q: Sequence[Fraction]) -> tuple[Fraction, ...]:
    """K_1, K_2 q_1, K_3 q_1 q_2, .."""
    return tuple(k * math.prod(q[:i]) for i, k in enumerate(gains))


def _range(expression: sp.Expr, form: Form) -> Range | None:
    known = span(expression, form)
    return known if known and known.defined and known.finite else None
