"""The convergence of an observer with a constant gain, verified again, on a chain for each output.

    z' = A z + b(sat z, u) + diag(theta, .., theta^n) K (y - C z)   converges exponentially for every
    theta > max(1, 2 peak L),   N'P + P N <= -I,   0 < P <= peak I,   N = S (A - K C) S^-1,   L >= |S db/dz S^-1|

S diagonal, constant in time; of several outputs diag(theta, .., theta^(n_i)) K_i on each chain, aligned at the top or
at the end. N is a matrix of numbers, or linear in a_i with ranges, and then in the hull of those at the ends of the
ranges, S and K being numbers. In e = Delta S (z - x), Delta = diag(1, 1/theta, ..) along the chains, V = e'P e has the
derivative V' <= -(theta - 2 peak L) |e|^2: theta turns b's Jacobian, whose rows read states of no higher power of
theta, into one of no larger norm, and clamping brings each component nearer to the plant's. Source of the observer:
Gauthier, Hammouri, Othman, IEEE TAC 37 (1992).
"""

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from itertools import product

from ..box import NotShown
from ..chain import built, constants, core_of, invertible, slope, steady, wanted_gain
from ..context import RANGE, Context, Shown, enclosed, on, short
from ..file import Built, Claim, Observer
from ..matrix import Matrix, decaying, demand_positive, entries, matrix, minus, scalar, scaled, unit, zeros
from ..rule import STEEP
from ..structure import clamped, on_chains
from ..text import Expression
from ..threshold import above

_CORNERS = 1024  # of the a_i's ranges


def convergence(context: Context, claim: Claim) -> Shown:
    """Every theta above the bound converges; the structure of the form is another claim."""
    _ = context.equations
    evidence, n, box = claim.evidence, len(context.z), context.form.box
    observer = built(context, claim)
    gains = observer.gains
    if context.form.alignment not in ("", "top", "end"):
        raise NotShown("its chains are not aligned at the top or at the end")
    scale = constants(context, entries(evidence, "scale", n))
    boxes = steady(context, gains) + invertible(context, scale)
    if ("core" in evidence) is ("ranges" in evidence):
        raise NotShown("its evidence has not one of a core and ranges")
    if "core" in evidence:
        vertices = [core_of(context, scale, gains, matrix(evidence, "core", n, n))]
    else:
        vertices, more = _corners(context, claim, scale, gains)
        boxes += more
    _decays(vertices, matrix(evidence, "P", n, n), scalar(evidence, "peak"))
    boxes += slope(context, evidence, scale)[1]
    above = f"{_OUTCOMES[observer.name]} above {short(threshold(observer, claim), 1)}"
    return Shown(f"in continuous time, without noise, {above}{on(box)}", boxes)


def threshold(observer: Observer, claim: Claim) -> Fraction:
    """max(1, 2 peak L) of a claim of convergence."""
    return max(Fraction(1), 2 * scalar(claim.evidence, "peak") * scalar(claim.evidence, "bound"))


def _corners(
    context: Context, claim: Claim, scale: list[Expression], gains: tuple[Expression, ...]
) -> tuple[list[Matrix], int]:
    """S (A - K C) S^-1 at the ends of the ranges of the a_i, which the claim states, and the number of boxes that show
    the ranges."""
    blocks, n = context.form.blocks, len(context.z)
    places = [(k, i) for k, size in enumerate(blocks, 1) for i in range(1, size + 1)]
    ends, boxes = [], 0
    for place, enclosure in zip(places, entries(claim.evidence, "ranges", n), strict=True):
        if not isinstance(enclosure, Mapping) or enclosure.keys() != set(RANGE):
            raise NotShown(f"a range of an a_i is no object with {', '.join(RANGE)}")
        low, high, shown = enclosed(context, replace(claim, evidence=enclosure), *wanted_gain(context, place))
        boxes += shown.boxes
        ends.append((low,) if low == high else (low, high))
    S, K = ([_number(context, text) for text in texts] for texts in (scale, gains))
    heads = [sum(blocks[: k - 1]) for k, _ in places]
    if 2 ** sum(len(pair) > 1 for pair in ends) > _CORNERS:
        raise NotShown(f"its a_i have more than {_CORNERS} combinations of ends")
    return [_closed(a, S, K, heads) for a in product(*ends)], boxes


def _number(context: Context, text: Expression) -> Fraction:
    value = context.value(text).number
    if value is None:
        raise NotShown(f"{text.text} is no number, which the a_i of a range want")
    return value


def _closed(a: tuple[Fraction, ...], S: list[Fraction], K: list[Fraction], heads: list[int]) -> Matrix:
    """S (A - K C) S^-1: a_1 of each chain in C, the others above the diagonal of A."""
    N = zeros(len(a), len(a))
    for i, head in enumerate(heads):
        N[i][head] -= S[i] * K[i] * a[head] / S[head]
        if i > head:
            N[i - 1][i] += S[i - 1] * a[i] / S[i]
    return N


def _decays(vertices: list[Matrix], P: Matrix, peak: Fraction) -> None:
    """P > 0, peak I - P > 0, -I - N'P - P N > 0, in exact fractions."""
    above = minus(scaled(peak, unit(len(P))), P)
    demand_positive({"P": P, "peak I - P": above})
    for N in vertices:
        demand_positive({"-I - N'P - P N": decaying(N, P)})


_OUTCOMES = {  # of a gain that stays; switching is another claim's, of the time that a gain is held
    "high_gain": "the error converges exponentially for every theta",
    "switched_gain": "the error decays exponentially between switches, in every gain",
}
_KEYS = (*STEEP, "scale", "core", "ranges", "P", "peak")
OBSERVERS = {
    "high_gain": Built(("theta",), ("gains",)),
    "switched_gain": Built(("theta", "theta_low", "hold"), ("gains",)),
}
RULES = (
    *on_chains("high_gain", "convergence", convergence, _KEYS),
    *on_chains("high_gain", "theta", above(threshold), rests=("high_gain.convergence",)),
    *on_chains("switched_gain", "convergence", convergence, _KEYS),
    *on_chains("switched_gain", "theta", above(threshold, "theta_low"), rests=("switched_gain.convergence",)),
    *map(clamped, OBSERVERS),
)
