"""The convergence of a high gain on the uniform form, verified again.

    z' = F(z, u) + diag(g_1, .., g_n) (y - h),   F_k = s_k z_(k+1) + b_k(sat z, u),   y = a z_1 + c
    g_i = theta^i K_i/(a F_1' .. F_(i-1)') at (sat z, u),   F_k' = dF_k/dz_(k+1)

    e' = (theta (N - diag(K_1, K_2 q_1, K_3 q_1 q_2, ..) 1 C) + slopes) e,   q_k in the range of s_k/F_k'

for e_i = s_1 .. s_(i-1) (z_i - x_i)/theta^(i-1), x the plant's state in its ranges, N the shift, the slopes those of b,
each with 0 in its range, as a clamp lets a share of an error pass. A slope of F_k in z_(k+1) grows as theta does, and
the others do not grow: what decays in |e|_P at the least theta decays at every larger one. The matrix is affine in
each slope and in each q_k. So P > 0 with M'P + P M + alpha P < 0 at all combinations of ends shows |e|_P^2 to fall like
exp(-alpha t); else multipliers S >= 0 of the slopes do, each K_i q_1 .. q_(i-1) taken for a slope of its own.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from itertools import product
from math import prod
from typing import Any

from ..box import NotShown
from ..chain import built, constants
from ..context import Context, enclosed, only
from ..falling import Decay, corners_of, decays, demand_decays
from ..file import Built, Claim, column, entries
from ..inequality import Parts
from ..matrix import zeros
from ..slope import at_kinks, continuous
from ..text import Expression
from ..uncertain import ErrorInclusion, Slope, bounded_slopes, of_field

_CORNERS = 1024  # of slopes and shares
Shares = list[tuple[Fraction, Fraction]]


def _falls(context: Context, claim: Claim, ranges: Mapping[str, Any], level: Fraction, alpha: Fraction) -> int:
    """V' <= -alpha V at a theta, by the claim's P, whatever the slopes; with how many boxes these are shown."""
    _ = context.equations
    observer, n = built(context, claim), len(context.z)
    K, s = column(observer.numbers, "gains", n), _above(context)
    only(context.form.output[0].names & set(context.z), context.z[:1], "the output")
    _ = context.first_gain(0)
    scale, every = constants(context, entries(ranges, "scale", n)), [*range(n)]
    if [context.value(text).number for text in scale] != [prod(s[:i], start=Fraction(1)) for i in every]:
        raise NotShown("its scale is not that of the slopes above the diagonal of A")
    slopes, boxes = bounded_slopes(context, ranges, scale, every, [True] * n, every, every, least=-1)
    shares, more = _shares(context, ranges, s)
    if "S" in claim.evidence:
        demand_decays(_inclusion(n, [*slopes, *_of_products(K, shares)]).at(level), alpha, claim.evidence)
    else:
        for corner in _corners(_inclusion(n, slopes).at(level), K, shares, level):
            demand_decays(corner, alpha, claim.evidence)
    return boxes + more


def _above(context: Context) -> list[Fraction]:
    """The numbers s_k above the diagonal of A, where it has nothing else. Raises: `NotShown`."""
    numbers = []
    for i, row in enumerate(context.form.A):
        for j, text in enumerate(row):
            entry = context.value(text)
            if j != i + 1:
                if not context.algebra.is_zero(entry):
                    raise NotShown(f"A[{i + 1},{j + 1}] is not zero")
                continue
            if not entry.number:
                raise NotShown(f"A[{i + 1},{j + 1}] is no number, or zero")
            numbers.append(entry.number)
    return numbers


def _shares(context: Context, evidence: Mapping[str, Any], s: list[Fraction]) -> tuple[Shares, int]:
    """The range of each s_k/F_k', and with how many boxes these are shown. Raises: `NotShown`."""
    shares, boxes, one = Shares(), 0, context.algebra.number(Fraction(1))
    for k, (number, range_) in enumerate(zip(s, entries(evidence, "shares", len(s)), strict=True)):
        rate, z = context.rates[k], context.z[k + 1]

        def read(text: Expression, rate: Expression = rate) -> Expression:
            return at_kinks(text, rate, context)

        low, high, shown = enclosed(context, range_, one / context.slope(rate, z), rate, read)
        if low <= 0 <= high:
            raise NotShown("the bounds of a slope do not keep clear of zero")
        continuous((rate,), (z,), context.form.box)
        shares.append((min(number * low, number * high), max(number * low, number * high)))
        boxes += shown.boxes
    return shares, boxes


def _inclusion(n: int, slopes: list[Slope]) -> ErrorInclusion:
    shift = zeros(n, n)
    for k in range(n - 1):
        shift[k][k + 1] = Fraction(1)
    every = [*range(n)]
    return ErrorInclusion(shift, slopes, 0, [], every, [True] * n, every, every, [], [])


def _injected(K: list[Fraction], q: tuple[Fraction, ...]) -> list[Fraction]:
    """K_1, K_2 q_1, K_3 q_1 q_2, .."""
    return [k * prod(q[:i], start=Fraction(1)) for i, k in enumerate(K)]


def _of_products(K: list[Fraction], shares: Shares) -> Iterator[Slope]:
    """Each K_i q_1 .. q_(i-1) as a slope of its own."""
    every, n = [_injected(K, q) for q in product(*shares)], range(len(K))
    for i in n:
        ends = [each[i] for each in every]
        yield Slope(of_field(0, len(K)), [Fraction(-int(k == i)) for k in n], min(ends), max(ends), -1)


def _corners(parts: Parts, K: list[Fraction], shares: Shares, theta: Fraction) -> Iterator[Parts]:
    """What the error obeys at all combinations of ends. Raises: `NotShown`."""
    ends = [sorted(set(pair)) for pair in shares]
    if 2 ** len(parts.H) * prod(map(len, ends)) > _CORNERS:
        raise NotShown(f"its slopes have more than {_CORNERS} combinations of ends")
    for moved in corners_of(parts):
        for q in product(*ends):
            push = _injected(K, q)
            whole = [[x - theta * push[i] * (j == 0) for j, x in enumerate(row)] for i, row in enumerate(moved)]
            yield replace(parts, M=whole, G=[[] for _ in whole], H=[])


_NAME = "uniform_injection"
_DECAY = Decay(_falls, said=lambda _: "the error against the plant converges exponentially for every theta above {}")
_SLOPES, _NORM = ("scale", "slopes", "shares"), ("P", "S")
OBSERVERS = {_NAME: Built(("theta", "gains"))}
RULES = tuple(
    replace(rule, kinds=("uniform",), rests=rests)
    for rule, rests in zip(
        decays((_NAME,), _DECAY, _SLOPES, _NORM),
        (("uniform.structure", "uniform.slope_1"), (f"{_NAME}.convergence",)),
        strict=True,
    )
)
