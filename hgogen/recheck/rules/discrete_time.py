"""Contraction of an observer's error at each call of its step, and its response to noise and other inputs.

The inequality is that of `inequality`. As a polynomial in h it is negative on an interval if its Bernstein coefficients
are. A proof at (h, theta) holds at (h theta/theta', theta') for a larger theta': there h M is the same except for
smaller slopes of b.

Inputs keep |e|_P <= 1 while each is at most 1. They are errors of the samples of an output at both ends of a call,
errors of the injected sample at a stage, deviations of the plant from a step of the method in a row of its form, over
h, which the sample at the end of the call contains, and errors added to an element of e itself, over h. A share
consists of inputs in one unit.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property, reduce
from math import comb
from operator import add
from typing import Any

from ..arithmetic import Unproved
from ..context import Context, Finding, chains_rule, observer_of, printed
from ..file import Claim, above_zero, column, entries, fields, matrix, part, scalar
from ..inclusion import ERROR, INJECTED, ErrorInclusion, error_inclusion
from ..inequality import (
    BOUND,
    NORM,
    ErrorMatrices,
    Input,
    Method,
    demand_falls,
    demand_kept,
    demand_negative,
    demand_within,
    ends,
    form_of,
    index_under,
    method_of,
    tableau_of,
)
from ..local_error import demand_core_error, demand_remainder
from ..matrix import Matrix, inverse, outer, unit_row, zeros
from ..plant_motion import demand_declared_sizes
from ..program import demand_rounding, equation_of
from ..text import number

_PIECES = 24  # of a range of step lengths
_FINE = 2**200  # parts of a root


@dataclass(frozen=True)
class _Running:
    """The error dynamics of an observer whose program takes steps of length `h` by a `method`, at the observer's
    theta."""

    context: Context
    error: ErrorInclusion
    method: Method
    h: Fraction
    theta: Fraction
    evidence: Mapping[str, Any]

    @cached_property
    def parts(self) -> ErrorMatrices:
        """The matrices of the error dynamics e' = M e + G p + (B + R) v at theta."""
        return self.error.at(self.theta)

    @cached_property
    def scales(self) -> list[Fraction]:
        """The factors s (N): e_k = s_k times the error of the form's state that observer state k estimates."""
        return self.error.scales(self.context, self.theta)

    @property
    def at(self) -> str:
        return f"by {self.evidence['method']} at dt = {printed(self.h)}, theta = {printed(self.theta)}"

    @property
    def estimating(self) -> set[int]:
        return {k for k, fed in enumerate(self.error.fed) if fed}


def _running(context: Context, claim: Claim) -> _Running:
    observer, evidence = observer_of(context, claim), claim.evidence
    theta, h = scalar(observer.numbers, "theta"), scalar(evidence, "dt")
    if not (theta > 0 and h > 0):
        raise Unproved("theta and dt are not positive")
    return _Running(context, error_inclusion(context, observer, evidence), method_of(evidence), h, theta, evidence)


def step(context: Context, claim: Claim) -> Finding:
    """Prove |e+|_P^2 <= (1 - alpha dt) |e|_P^2 in a step of length dt, at the observer's theta."""
    run, alpha = _running(context, claim), scalar(claim.evidence, "alpha")
    if not 0 <= alpha * run.h < 1:
        raise Unproved("alpha dt is below 0 or not below 1")
    demand_falls(run.parts, run.method, run.h, alpha, claim.evidence)
    rate = f"|e|_P^2 falls at each call{f', by {printed(alpha * run.h, -1)} of itself' if alpha else ''}"
    return Finding(f"{run.at}, {rate}", run.error.boxes)


def throughout(context: Context, claim: Claim) -> Finding:
    """Prove |e+|_P < |e|_P for a step of any length up to a longest one, at the claim's theta, which is at most the
    observer's; the lengths are divided into pieces with a P each."""
    observer, evidence = observer_of(context, claim), claim.evidence
    theta, error, method = scalar(evidence, "theta"), error_inclusion(context, observer, evidence), method_of(evidence)
    if not 0 < theta <= scalar(observer.numbers, "theta"):
        raise Unproved("its theta is not between 0 and the observer's")
    parts, end, degree = error.at(theta), Fraction(0), method.degree
    if not degree:
        raise Unproved("by its method the form is no polynomial in dt")
    pieces = part(evidence, "pieces", list)
    if not 0 < len(pieces) <= _PIECES:
        raise Unproved(f"it has no pieces, or more than {_PIECES}")
    for piece in pieces:
        fields(piece, "a piece", ("low", "high", *NORM))
        low, high = scalar(piece, "low"), scalar(piece, "high")
        if low != end or not low < high:
            raise Unproved("its pieces do not follow each other from 0")
        values = [form_of(parts, method, low + (high - low) * Fraction(k, degree), piece) for k in range(degree + 1)]
        for weights in _bernstein(degree):
            terms = (x * value for x, value in zip(weights, values, strict=True) if x)
            demand_negative("its polynomial", reduce(add, terms))
        end = high
    at = f"theta = {printed(theta)} and every dt up to {printed(end, -1)}"
    beyond = f"at each larger theta while theta dt is at most {printed(theta * end, -1)}"
    return Finding(f"by {evidence['method']} |e|_P falls at {at}, and {beyond}", error.boxes)


@cache
def _bernstein(degree: int) -> Matrix:
    """Return the matrix that maps the values of a polynomial at k/degree to its Bernstein coefficients on [0, 1]."""
    at = [Fraction(k, degree) for k in range(degree + 1)]
    return inverse(Matrix([comb(degree, j) * t**j * (1 - t) ** (degree - j) for j in range(degree + 1)] for t in at))


def noise(context: Context, claim: Claim) -> Finding:
    """Prove bounds of states' errors while the error of one output's samples is at most 1, by an invariant set |e|_P <=
    1. The inputs are the samples' errors at both ends of a step."""
    run, phrase = _running(context, claim), dict[tuple[int, int], str]()
    for one in part(claim.evidence, "bounds", list):
        fields(one, "a bound", ("state", "output", *BOUND))
        state, output = index_under(one, "state", len(context.z)), index_under(one, "output", len(context.form.output))
        context.demand_observed(output)
        if (state, output) in phrase:
            raise Unproved("a bound stands twice")
        if not run.error.measured:
            raise Unproved("its gains are no numbers in these coordinates")
        bound = above_zero(one, "bound")
        demand_kept(run.parts, run.method, run.h, one, ends(run.method, run.parts, output))
        demand_within(one, run.error.picks[state], run.scales, bound)
        phrase[state, output] = f"{context.z[state]} by at most {printed(bound, 1)} for 1 of output {output + 1}"
    if not phrase:
        raise Unproved("it has no bounds")
    return Finding(f"{run.at}, noise moves {', '.join(phrase.values())}", run.error.boxes)


# --- from initial errors


def start(context: Context, claim: Claim) -> Finding:
    """Prove that |e|_P decreases at each call, and that with initial errors |z_i| <= `first`_i each estimating state of
    the observer stays within its limit and each state's error within its bound: |e(0)|_P^2 <= V at the corners, bound^2
    P >= V c'c for an error c e."""
    run, evidence, n = _running(context, claim), claim.evidence, len(context.z)
    scales, first = run.scales, column(evidence, "first", n)
    clear, peaks = part(evidence, "clear", dict), entries(evidence, "peaks", n)
    if any(not isinstance(one, dict) for one in peaks):
        raise Unproved("a peak is no object")
    begins = list[Fraction]()
    for one in (clear, *peaks):
        demand_falls(run.parts, run.method, run.h, Fraction(0), one)
        begins.append(run.error.largest(scales, first, matrix(one, "P", len(scales), len(scales))))
    multiple, limits = above_zero(clear, "multiple"), _limits(clear, run)
    for k, limit in limits.items():
        demand_within(clear, k, scales, limit / multiple, begins[0])
    phrase = []
    for z, field, one, V in zip(context.z, run.error.picks, peaks, begins[1:], strict=True):
        bound = above_zero(one, "bound")
        demand_within(one, field, scales, bound, V)
        phrase.append(f"{z} by at most {printed(bound, 1)}")
    from_ = f"from errors of up to {printed(multiple, -1)} times {', '.join(printed(x) for x in first)}"
    clear_of = ", ".join(printed(limit, 1) for _, limit in sorted(limits.items()))
    erring = f"no field errs by more than {clear_of}; from these once {', '.join(phrase)}"
    return Finding(f"{run.at}, {from_} {erring}", run.error.boxes)


def _limits(clear: Mapping[str, Any], run: _Running) -> dict[int, Fraction]:
    limits = {}
    for one in part(clear, "limits", list):
        fields(one, "a limit", ("field", "limit"))
        limits[index_under(one, "field", len(run.error.N))] = above_zero(one, "limit")
    if limits.keys() != run.estimating:
        raise Unproved("its limits are not those of the fields that estimate")
    return limits


# --- shares of inputs

_KINDS = ("noise", "rounded", "late", "disturbance", "parameters", "method", "rounding")
_CLEAR, _DEVIATION = "while the plant keeps clear of the ends of its ranges", "beside what the method leaves"
_SHARE = {"inputs", "follows", "samples", "stages", "beside", "fields", "unit", "bounds"}
Shares = Mapping[str, Mapping[str, Any]]  # by their inputs


def error(context: Context, claim: Claim) -> Finding:
    """Prove bounds of the errors of the observer's estimates as the sum of the effects of each kind of input: noise,
    rounding, the method, .."""
    run, shares, by_kind = (
        _running(context, claim),
        part(claim.evidence, "shares", list),
        dict[str, Mapping[str, Any]](),
    )
    parts, scales, totals = run.parts, run.scales, dict.fromkeys(range(len(run.scales)), Fraction(0))
    if not run.error.measured:
        raise Unproved("its gains are no numbers in these coordinates")
    if not shares:
        raise Unproved("it has no shares")
    for share in shares:
        by_kind |= {_kind(share, by_kind): share}
        size, inputs = above_zero(share, "unit"), _inputs(run, share)
        bounds = part(share, "bounds", list)
        if {_field(one, len(scales)) for one in bounds} != run.estimating or len(bounds) > len(run.estimating):
            raise Unproved("its bounds are not those of the fields that estimate, each once")
        for one in bounds:
            k, bound = _field(one, len(scales)), above_zero(one, "bound")
            demand_kept(parts, run.method, run.h, one, inputs)
            demand_within(one, k, scales, bound / size)
            totals[k] += bound
    sizes, under, boxes = _followed(run, by_kind)
    states = zip(context.z, run.error.picks, strict=True)
    phrase = ", ".join(f"{z} by at most {printed(totals[k], 1)}" for z, k in states)
    return Finding(f"{run.at}, {'; '.join(sizes)} move {phrase} in all, {under}", run.error.boxes + boxes)


def _kind(share: Any, known: Shares) -> str:
    if not isinstance(share, dict) or set(share) != _SHARE:
        raise Unproved(f"a share is no object of {', '.join(sorted(_SHARE))}")
    part(share, "follows", dict)
    kind: str = part(share, "inputs", str)
    if kind not in _KINDS or kind in known:
        raise Unproved(f"its inputs are none of {', '.join(_KINDS)}, each once")
    return kind


def _followed(run: _Running, shares: Shares) -> tuple[list[str], str, int]:
    context, evidence, method, rounding = run.context, run.evidence, shares.get("method"), shares.get("rounding")
    others = {kind: share for kind, share in shares.items() if share is not method and share is not rounding}
    boxes, sizes = demand_declared_sizes(context, run.h, others), list[str]()
    for kind, share in others.items():
        stated = [printed(size, -1) for size in map(number, share["follows"]["sizes"]) if size]
        sizes.append(f"{kind} of {', '.join(stated)}")
    if rounding:
        equation = equation_of(context, run.error, run.theta, rounding["follows"])
        each = zip(*(_bounds_of(share, equation.scales) for share in shares.values()), strict=True)
        totals = [sum(bounds, Fraction(0)) for bounds in each]  # bounds of the effect of all shares on each field (N)
        phrase, more = demand_rounding(equation, tableau_of(evidence), run.h, rounding, shares, totals)
        sizes, boxes = [*sizes, phrase], boxes + more
    if method is None:
        return sizes, _DEVIATION, boxes
    if run.method.degree:
        motion, more = demand_remainder(context, tableau_of(evidence), run.h, method)
    else:
        motion, more = demand_core_error(context, run.error, run.theta, evidence, method)
    return [*sizes, motion.phrase], f"{_CLEAR} by {motion.clear}", boxes + more


def _bounds_of(share: Mapping[str, Any], scales: Sequence[Fraction]) -> list[Fraction]:
    """Return a bound of the effect of a share of the inputs on the error of each observer state (N): the bound that the
    share states, else that which follows from e'P e <= 1."""
    N, unit = len(scales), scalar(share, "unit")
    bounds = {_field(one, N): scalar(one, "bound") for one in share["bounds"]}
    if len(bounds) < N:
        inverses = [inverse(matrix(one, "P", N, N)) for one in share["bounds"]]
        for k in set(range(N)) - set(bounds):
            bounds[k] = unit * _root(min(M[k][k] for M in inverses)) / abs(scales[k])
    return [bounds[k] for k in range(N)]


def _root(value: Fraction) -> Fraction:
    return Fraction(math.isqrt(value.numerator * _FINE**2 // value.denominator) + 1, _FINE)


def _field(one: Any, count: int) -> int:
    return index_under(fields(one, "a bound", ("field", *BOUND)), "field", count)


def _inputs(run: _Running, share: Mapping[str, Any]) -> list[Input]:
    context, error, method = run.context, run.error, run.method
    p, n, stages = len(context.form.output), len(context.z), len(method.nodes)
    still, inputs = [Fraction(0)] * len(error.N), list[Input]()
    for j, size in enumerate(_sizes(share, "samples", p)):
        if size:
            context.demand_observed(j)
            inputs += [end * size for end in ends(method, run.parts, j)]
    for j, row in enumerate(entries(share, "stages", p) if share["stages"] != [] else []):
        for i, size in enumerate(_sizes({"stages": row}, "stages", stages)):
            if size:
                context.demand_observed(j)
                inputs.append(Input(outer(unit_row(i, stages), unit_row(j, p)), still) * size)
    for i, size in enumerate(_sizes(share, "beside", n)):
        deviation = _deviation(run, i)
        inputs += [deviation * size] if size else []
    for k, size in enumerate(_sizes(share, "fields", len(error.N))):
        inputs += [Input(zeros(stages, p), unit_row(k, len(error.N))) * size] if size else []
    if not inputs:
        raise Unproved("a share has no inputs")
    return [each * (1 / scalar(share, "unit")) for each in inputs]


def _deviation(run: _Running, i: int) -> Input:
    """Return the input "the plant's state i deviates by 1 at the end of a step", with the effect on the outputs that
    measure the state."""
    context, error, method = run.context, run.error, run.method
    onto = (-1 * error.lifted(run.scales)).T[i]
    deviation = Input(zeros(len(method.nodes), len(context.form.output)), onto)
    for j in (j for j, z in enumerate(context.observed) if z == context.z[i]):
        slope = context.first_gain(j).number
        if slope is None:
            raise Unproved("the slope of an output is no number")
        deviation += ends(method, run.parts, j)[1] * (run.h * slope)
    return deviation


def _sizes(share: Mapping[str, Any], key: str, count: int) -> list[Fraction]:
    sizes = column(share, key, count) if share[key] != [] else []
    if any(size < 0 for size in sizes):
        raise Unproved(f"a size of its {key} is negative")
    return sizes


_STEP = (*ERROR, "method")
RULES = (
    chains_rule(INJECTED, ("step",), step, (*_STEP, "dt", "alpha", *NORM)),
    chains_rule(INJECTED, ("shorter", "tuned"), throughout, (*_STEP, "theta", "pieces")),
    chains_rule(INJECTED, ("noise",), noise, (*_STEP, "dt", "bounds")),
    chains_rule(INJECTED, ("start",), start, (*_STEP, "dt", "first", "clear", "peaks")),
    chains_rule(INJECTED, ("error",), error, (*_STEP, "dt", "shares")),
)
