"""That the error of an observer contracts as its step runs, and how far noise moves it, verified again.

The inequality is that of `inequality`. As a polynomial in h it is negative on a piece of a line where its Bernstein
coefficients are. What holds at (h, theta) holds at (h theta/theta', theta') of a larger theta': there h M is the same
but for smaller slopes of b.
"""

from collections.abc import Mapping
from fractions import Fraction
from functools import cache
from itertools import chain, product
from math import comb
from typing import Any

from ..box import NotShown
from ..chain import built
from ..context import Context, Shown, short
from ..cores import INJECTED
from ..file import Claim, part
from ..inequality import demand_falls, demand_kept, demand_negative, ends, form_of, method_of, place, within
from ..matrix import (
    Matrix,
    above_zero,
    column,
    entries,
    inverse,
    matrix,
    scalar,
    times,
    transposed,
)
from ..rule import on_chains
from ..uncertain import ERROR, ErrorInclusion, error_inclusion

_PIECES = 24  # of a range of step lengths
_CORNERS = 8  # states up to which all corners of the first errors are tried


def step(context: Context, claim: Claim) -> Shown:
    """|e+|_P^2 <= (1 - alpha dt) |e|_P^2 at the observer's theta."""
    observer, evidence = built(context, claim), claim.evidence
    theta, h, alpha = scalar(observer.numbers, "theta"), scalar(evidence, "dt"), scalar(evidence, "alpha")
    if not (theta > 0 and h > 0 and 0 <= alpha * h < 1):
        raise NotShown("theta or dt is not positive, or alpha dt is below 0 or not below 1")
    error = error_inclusion(context, observer, evidence)
    demand_falls(error.at(theta), method_of(evidence), h, alpha, evidence)
    rate = f"|e|_P^2 falls at each call{f', by {short(alpha * h, -1)} of itself' if alpha else ''}"
    return Shown(f"by {part(evidence, 'method', str)} at dt = {short(h)}, theta = {short(theta)}, {rate}", error.boxes)


def throughout(context: Context, claim: Claim) -> Shown:
    """|e+|_P < |e|_P at the claim's theta, at most the observer's, at every step length up to a longest."""
    observer, evidence = built(context, claim), claim.evidence
    theta, error, method = scalar(evidence, "theta"), error_inclusion(context, observer, evidence), method_of(evidence)
    if not 0 < theta <= scalar(observer.numbers, "theta"):
        raise NotShown("its theta is not between 0 and the observer's")
    parts, end = error.at(theta), Fraction(0)
    if not method.degree:
        raise NotShown("by its method the form is no polynomial in dt")
    pieces = part(evidence, "pieces", list)
    if not 0 < len(pieces) <= _PIECES:
        raise NotShown(f"it has no pieces, or more than {_PIECES}")
    for piece in pieces:
        if not isinstance(piece, dict) or set(piece) != {"low", "high", "P", "S"}:
            raise NotShown("a piece is no object of low, high, P and S")
        low, high = scalar(piece, "low"), scalar(piece, "high")
        if low != end or not low < high:
            raise NotShown("its pieces do not follow each other from 0")
        degree = method.degree
        values = [form_of(parts, method, low + (high - low) * Fraction(k, degree), piece) for k in range(degree + 1)]
        size = len(values[0])
        for each in times(_bernstein(degree), [list(chain(*value)) for value in values]):
            demand_negative("its polynomial", [each[i : i + size] for i in range(0, len(each), size)])
        end = high
    at = f"theta = {short(theta)} and every dt up to {short(end, -1)}"
    beyond = f"at each larger theta while theta dt is at most {short(theta * end, -1)}"
    return Shown(f"by {part(evidence, 'method', str)} |e|_P falls at {at}, and {beyond}", error.boxes)


def noise(context: Context, claim: Claim) -> Shown:
    """|z_i| <= bound of an error e in |e|_P <= 1, which stays there while the samples of an output err by at most 1:

    its inputs are those at both ends of a call."""
    observer, evidence = built(context, claim), claim.evidence
    theta, h = scalar(observer.numbers, "theta"), scalar(evidence, "dt")
    if not (theta > 0 and h > 0):
        raise NotShown("theta and dt are not positive")
    error, method = error_inclusion(context, observer, evidence), method_of(evidence)
    parts = error.at(theta)
    said: dict[tuple[int, int], str] = {}
    for one in part(evidence, "bounds", list):
        if not isinstance(one, dict) or set(one) != {"state", "output", "alpha", "P", "S", "bound"}:
            raise NotShown("a bound is no object of state, output, alpha, P, S and bound")
        state, output = place(one, "state", len(context.z)), place(one, "output", len(context.form.output))
        context.demand_seen(output)
        if (state, output) in said:
            raise NotShown("a bound stands twice")
        if not error.measured:
            raise NotShown("its gains are no numbers in these coordinates")
        bound = above_zero(one, "bound")
        demand_kept(parts, method, h, one, ends(method, parts, output))
        within(one, error.picks[state], error.scales(context, theta), bound)
        said[state, output] = f"{context.z[state]} by at most {short(bound, 1)} for 1 of output {output + 1}"
    if not said:
        raise NotShown("it has no bounds")
    at = f"by {part(evidence, 'method', str)} at dt = {short(h)}, theta = {short(theta)}"
    return Shown(f"{at}, noise moves {', '.join(said.values())}", error.boxes)


def start(context: Context, claim: Claim) -> Shown:
    """|e|_P < |e|_P of the call before, and |z_i| <= bound of all e that begin with |z| <= first, by |e(0)|_P^2 <= V at
    the corners and bound^2 P >= V c'c, z_i = c e: for the limits of the fields that estimate, and for each state."""
    observer, evidence = built(context, claim), claim.evidence
    theta, h, n = scalar(observer.numbers, "theta"), scalar(evidence, "dt"), len(context.z)
    if not (theta > 0 and h > 0) or n > _CORNERS:
        raise NotShown(f"theta and dt are not positive, or it has more than {_CORNERS} states")
    error, method = error_inclusion(context, observer, evidence), method_of(evidence)
    scales, first = error.scales(context, theta), column(evidence, "first", n)
    if min(first) < 0:
        raise NotShown("a first error is negative")
    clear, peaks = part(evidence, "clear", dict), entries(evidence, "peaks", n)
    if any(not isinstance(one, dict) for one in peaks):
        raise NotShown("a peak is no object")
    begins, parts = list[Fraction](), error.at(theta)
    for one in (clear, *peaks):
        demand_falls(parts, method, h, Fraction(0), one)
        begins.append(_largest(error, scales, first, matrix(one, "P", len(scales), len(scales))))
    multiple, limits = above_zero(clear, "multiple"), _limits(clear, error)
    for k, limit in limits.items():
        within(clear, k, scales, limit / multiple, begins[0])
    said = []
    for z, field, one, V in zip(context.z, error.picks, peaks, begins[1:], strict=True):
        bound = above_zero(one, "bound")
        within(one, field, scales, bound, V)
        said.append(f"{z} by at most {short(bound, 1)}")
    at = f"by {part(evidence, 'method', str)} at dt = {short(h)}, theta = {short(theta)}"
    from_ = f"from errors of up to {short(multiple, -1)} times {', '.join(short(x) for x in first)}"
    clear_of = ", ".join(short(limit, 1) for _, limit in sorted(limits.items()))
    return Shown(f"{at}, {from_} no field errs by more than {clear_of}; from these once {', '.join(said)}", error.boxes)


def _limits(clear: Mapping[str, Any], error: ErrorInclusion) -> dict[int, Fraction]:
    """The limits of all fields that estimate, by place from 0. Raises: `NotShown`."""
    limits = {}
    for one in part(clear, "limits", list):
        if not isinstance(one, dict) or set(one) != {"field", "limit"}:
            raise NotShown("a limit is no object of field and limit")
        limits[place(one, "field", len(error.N))] = above_zero(one, "limit")
    if limits.keys() != {k for k, fed in enumerate(error.fed) if fed}:
        raise NotShown("its limits are not those of the fields that estimate")
    return limits


def _largest(error: ErrorInclusion, scales: list[Fraction], first: list[Fraction], P: Matrix) -> Fraction:
    """The largest |e(0)|_P^2, of fields that begin with the error of the state that they estimate, or with none."""
    sides = [s * first[i] * fed for s, i, fed in zip(scales, error.index, error.fed, strict=True)]
    largest = Fraction(0)
    for signs in product((1,), *[(1, -1)] * (len(first) - 1)):
        e = [[side * signs[i] for side, i in zip(sides, error.index, strict=True)]]
        ((value,),) = times(times(e, P), transposed(e))
        largest = max(largest, value)
    return largest


@cache
def _bernstein(degree: int) -> list[list[Fraction]]:
    """The Bernstein coefficients of a polynomial from its values at k/degree: the inverse of the basis there."""
    at = [Fraction(k, degree) for k in range(degree + 1)]
    return inverse([[comb(degree, j) * t**j * (1 - t) ** (degree - j) for j in range(degree + 1)] for t in at])


_STEP = (*ERROR, "method")
RULES = (
    on_chains(INJECTED, ("step",), step, (*_STEP, "dt", "alpha", "P", "S")),
    on_chains(INJECTED, ("shorter", "tuned"), throughout, (*_STEP, "theta", "pieces")),
    on_chains(INJECTED, ("noise",), noise, (*_STEP, "dt", "bounds")),
    on_chains(INJECTED, ("start",), start, (*_STEP, "dt", "first", "clear", "peaks")),
)
