"""How far inputs of a step drive an error, of several the shares, verified again.

They keep to |e|_P <= 1 while each is at most 1 (`inequality`). Inputs are errors of the samples of an output at both
ends of a call, errors of what is injected at a stage, what the plant does beside a step of the method in a row of its
form, over h, which the sample at the end of the call shows, and what comes to an element of e itself, over h. A share
is of inputs in one unit.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any

from ..box import NotShown
from ..chain import built
from ..context import Context, Shown, short
from ..cores import INJECTED
from ..file import Claim, part
from ..follows import demand_followed
from ..inequality import Input, Method, demand_kept, ends, method_of, place, tableau_of, within
from ..left_by_core import demand_left_by_core
from ..matrix import above_zero, column, entries, inverse, matrix, scalar, unit
from ..remainder import demand_remainder
from ..rounding import demand_rounding, equation_of
from ..rule import on_chains
from ..text import number
from ..uncertain import ERROR, ErrorInclusion, error_inclusion

_KINDS = ("noise", "rounded", "late", "disturbance", "parameters", "method", "rounding")
_FINE = 2**200  # parts of a root
_CLEAR, _BESIDE = "while the plant keeps clear of the ends of its ranges", "beside what the method leaves"
_SHARE = {"inputs", "follows", "samples", "stages", "beside", "fields", "unit", "bounds"}


def error(context: Context, claim: Claim) -> Shown:
    """The share of each part in the error of each field that estimates."""
    observer, evidence = built(context, claim), claim.evidence
    theta, h = scalar(observer.numbers, "theta"), scalar(evidence, "dt")
    if not (theta > 0 and h > 0):
        raise NotShown("theta and dt are not positive")
    inclusion, method = error_inclusion(context, observer, evidence), method_of(evidence)
    parts, scales, shares = inclusion.at(theta), inclusion.scales(context, theta), part(evidence, "shares", list)
    if not inclusion.measured:
        raise NotShown("its gains are no numbers in these coordinates")
    if not shares:
        raise NotShown("it has no shares")
    by_kind = dict[str, Mapping[str, Any]]()
    totals, wanted = dict.fromkeys(range(len(scales)), Fraction(0)), {k for k, fed in enumerate(inclusion.fed) if fed}
    for share in shares:
        if not isinstance(share, dict) or set(share) != _SHARE:
            raise NotShown(f"a share is no object of {', '.join(sorted(_SHARE))}")
        kind, _ = part(share, "inputs", str), part(share, "follows", dict)
        if kind not in _KINDS or kind in by_kind:
            raise NotShown(f"its inputs are none of {', '.join(_KINDS)}, each once")
        size, inputs = above_zero(share, "unit"), _inputs(context, inclusion, method, h, theta, share)
        by_kind[kind] = share
        bounds = part(share, "bounds", list)
        if {_field(one, len(scales)) for one in bounds} != wanted or len(bounds) > len(wanted):
            raise NotShown("its bounds are not those of the fields that estimate, each once")
        for one in bounds:
            k, bound = _field(one, len(scales)), above_zero(one, "bound")
            demand_kept(parts, method, h, one, inputs)
            within(one, k, scales, bound / size)
            totals[k] += bound
    sizes, under, boxes = _followed(context, inclusion, theta, evidence, by_kind)
    states = zip(context.z, inclusion.picks, strict=True)
    said = ", ".join(f"{z} by at most {short(totals[k], 1)}" for z, k in states)
    at = f"by {part(evidence, 'method', str)} at dt = {short(h)}, theta = {short(theta)}"
    return Shown(f"{at}, {'; '.join(sizes)} move {said} in all, {under}", inclusion.boxes + boxes)


def _followed(
    context: Context,
    error: ErrorInclusion,
    theta: Fraction,
    evidence: Mapping[str, Any],
    shares: Mapping[str, Mapping[str, Any]],
) -> tuple[list[str], str, int]:
    """That the sizes follow: what they are, under what, and with how many boxes. Raises: `NotShown`."""
    h, left, rounding = scalar(evidence, "dt"), shares.get("method"), shares.get("rounding")
    others = {kind: share for kind, share in shares.items() if share is not left and share is not rounding}
    boxes = demand_followed(context, h, others)
    sizes = list[str]()
    for kind, share in others.items():
        stated = [short(size, -1) for size in map(number, share["follows"]["sizes"]) if size]
        sizes.append(f"{kind} of {', '.join(stated)}")
    if rounding:
        equation = equation_of(context, error, theta, rounding["follows"])
        totals = _reached(shares.values(), equation.scales)
        said, more = demand_rounding(equation, tableau_of(evidence), h, rounding, shares, totals)
        sizes, boxes = [*sizes, said], boxes + more
    if left is None:
        return sizes, _BESIDE, boxes
    if method_of(evidence).degree:
        motion, more = demand_remainder(context, tableau_of(evidence), h, left)
    else:
        motion, more = demand_left_by_core(context, error, theta, evidence, left)
    return [*sizes, motion.said], f"{_CLEAR} by {motion.clear}", boxes + more


def _reached(shares: Iterable[Mapping[str, Any]], scales: Sequence[Fraction]) -> list[Fraction]:
    """By field (N), at least how far all shares move its error."""
    return [sum(each, Fraction(0)) for each in zip(*(_moved(share, scales) for share in shares), strict=True)]


def _moved(share: Mapping[str, Any], scales: Sequence[Fraction]) -> list[Fraction]:
    """By field (N), at least how far a share moves its error: by its bound, of one without by the norms in which the
    inputs keep e within 1."""
    N, unit = len(scales), scalar(share, "unit")
    moved = {_field(one, N): scalar(one, "bound") for one in share["bounds"]}
    if len(moved) < N:
        inverses = [inverse(matrix(one, "P", N, N)) for one in share["bounds"]]
        for k in set(range(N)) - set(moved):
            moved[k] = unit * _root(min(M[k][k] for M in inverses)) / abs(scales[k])
    return [moved[k] for k in range(N)]


def _root(value: Fraction) -> Fraction:
    """A number at least the square root, and hardly above."""
    return Fraction(math.isqrt(value.numerator * _FINE**2 // value.denominator) + 1, _FINE)


def _field(one: Any, count: int) -> int:
    """The field of a bound, from 0. Raises: `NotShown`."""
    if not isinstance(one, dict) or set(one) != {"field", "alpha", "P", "S", "bound"}:
        raise NotShown("a bound is no object of field, alpha, P, S and bound")
    return place(one, "field", count)


def _inputs(
    context: Context, error: ErrorInclusion, method: Method, h: Fraction, theta: Fraction, share: Mapping[str, Any]
) -> list[Input]:
    """The inputs of a share that are not 0, in its unit. Raises: `NotShown`."""
    p, n, stages, parts = len(context.form.output), len(context.z), len(method.nodes), error.at(theta)
    nothing, still, scales = [Fraction(0)] * p, [Fraction(0)] * len(error.N), error.scales(context, theta)
    inputs = list[Input]()
    for j, size in enumerate(_sizes(share, "samples", p)):
        if size:
            context.demand_seen(j)
            inputs += [end * size for end in ends(method, parts, j)]
    for j, row in enumerate(entries(share, "stages", p) if share["stages"] != [] else []):
        for i, size in enumerate(_sizes({"stages": row}, "stages", stages)):
            if size:
                context.demand_seen(j)
                inputs.append(Input([unit(p)[j] if k == i else nothing for k in range(stages)], still) * size)
    for i, size in enumerate(_sizes(share, "beside", n)):
        onto = [-s * (fed and at == i) for s, fed, at in zip(scales, error.fed, error.index, strict=True)]
        moved = Input([nothing] * stages, onto)
        for j in (j for j, z in enumerate(context.seen) if z == context.z[i]):
            slope = context.first_gain(j).number
            if slope is None:
                raise NotShown("the slope of an output is no number")
            moved += ends(method, parts, j)[1] * (h * slope)
        inputs += [moved * size] if size else []
    for k, size in enumerate(_sizes(share, "fields", len(error.N))):
        itself = Input([nothing] * stages, [Fraction(int(k == at)) for at in range(len(error.N))])
        inputs += [itself * size] if size else []
    if not inputs:
        raise NotShown("a share has no inputs")
    return [each * (1 / scalar(share, "unit")) for each in inputs]


def _sizes(share: Mapping[str, Any], key: str, count: int) -> list[Fraction]:
    """`count` sizes that are not negative, or none. Raises: `NotShown`."""
    sizes = column(share, key, count) if share[key] != [] else []
    if any(size < 0 for size in sizes):
        raise NotShown(f"a size of its {key} is negative")
    return sizes


RULES = (on_chains(INJECTED, ("error",), error, (*ERROR, "method", "dt", "shares")),)
