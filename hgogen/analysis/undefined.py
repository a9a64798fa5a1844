"""Places in the declared ranges where an equation of a plant, or a derivative that an observer needs, has no finite
value.

Each part of a row is searched for a pole, a logarithm of 0 or a root of a negative number. A finite value everywhere is
proved by outward-rounded intervals or exact algebra. A place without one is proved by a point: an exact one, a zero
between two signs of a divisor, or an enclosed argument outside of the part's domain.

A signal without a declared range may have any value, and only its resting value is known to occur. A part that is
singular at other values of it alone is not refuted, and `where` says which values these are.

The rows of a plant as they are written are kept for these checks. A form, or SymPy itself, may have lost a part: (u x +
u)/u is x + 1 in a form, and has no value at u = 0. Every claim about values on the box assumes that the plant has one
there.

The box decides on which side of a kink or jump the plant is: |x| is x where x >= 0. Where it does not decide it, the
plant has several branches (`rigor.rank`).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache, partial
from math import inf

import numpy as np
import sympy as sp

from hgogen.analysis.manifold import projection
from hgogen.check import Check, ClaimId, Verdict
from hgogen.rigor.bounds import Cause, bound, nonzero, problem_of, special_point
from hgogen.rigor.box import Box, Point, box, exact
from hgogen.rigor.invariant import restricted
from hgogen.rigor.periodic import exact_turn
from hgogen.rigor.rank import SampledBranches, at_values, sampled_branches
from hgogen.rigor.singular import (
    CHORD,
    NONZERO,
    POSITIVE,
    Condition,
    Resolved,
    bounded_logs,
    chord_ends,
    conditions,
    mapped_parts,
    minimal,
    off_origin,
    one_sided,
    possibly_undefined,
    resolved,
    with_limited_slopes,
)
from hgogen.rigor.tape import NoTape, slope
from hgogen.sentence import Sentence, because
from hgogen.signal import Signal, resting
from hgogen.system import System

MAKER = "singular"  # of claims with the ids singular.NAME, NAME the state or the output of a row
FIX = "Narrow the ranges so that it stays away from there."
_SLOPES = "each derivative of {row} by a state"
_NO_SAMPLE = "there the step uses no sample of {name}, and raises UNDEFINED_{name}"
_LAST_RATE = "there the step goes on with the last finite value of the rate of {name}, and raises HELD_{name}"
_ZERO_SLOPES = "there the step takes the derivatives of the rate of {name} for 0, and raises HELD_{name}"
_CHORDS = "{what} has no finite value at {zeros: or }; the step takes the slope of the chord where {places: or }"
_REASONS = {
    Verdict.REFUTED: "{what} has no finite value {places: or }",
    Verdict.UNKNOWN: "it is not decided whether {what} has a finite value {places: or }",
    Verdict.WHERE: "{what} has no finite value {places: or }; there is no declared range of {names}",
}
_INSIDE = {  # by relation: the closed interval outside of which an argument has no value
    POSITIVE: (0.0, inf),
    "{of} >= 0": (0.0, inf),
    "{of} >= 1": (1.0, inf),
    "-1 <= {of} <= 1": (-1.0, 1.0),
    "-1 < {of} < 1": (-1.0, 1.0),
}
_ARGUMENT = {
    sp.log: POSITIVE,
    sp.asin: "-1 <= {of} <= 1",
    sp.acos: "-1 <= {of} <= 1",
    sp.atanh: "-1 < {of} < 1",
    sp.acosh: "{of} >= 1",
}


@dataclass(frozen=True)
class Gap:
    """A place, or possible place, where a part of an expression has no value: the `condition` that fails, such as a
    divisor not 0. `verdict`: refuted, with a `point`; where, for some inputs alone; or unknown."""

    condition: Condition
    verdict: Verdict
    point: Point


@lru_cache(maxsize=64)
def undefined_values(plant: System) -> tuple[Check, ...]:
    """Return the checks `singular.NAME` of the equations (rate or output NAME) that are not proved to be finite on the
    declared ranges."""
    named = ((signal, Sentence.of("{row}", row=text), row) for signal, text, row in _rows(plant))
    rows = ((signal, text, (bounded_logs(row),), _LAST_RATE) for signal, text, row in named)
    return tuple(check for row in rows if (check := _check(plant, *row)))


@lru_cache(maxsize=64)
def undefined_slopes(plant: System) -> tuple[Check, ...]:
    """Return the checks `singular.NAME` of the equations (rate or output NAME) that are finite on the declared ranges,
    but whose partial derivatives by the states may not be."""
    known = {check.id.fact for check in undefined_values(plant)}
    rows = ((signal, text, resolved(row)) for signal, text, row in _rows(plant) if signal.name not in known)
    return tuple(check for row in rows if (check := _slopes_check(plant, *row)))


def _slopes_check(plant: System, signal: Signal, text: str, row: sp.Expr) -> Check | None:
    what, states = Sentence.of(_SLOPES, row=text), [x for x in plant.states if row.has(x)]
    written = _check(plant, signal, what, [slope(row, x) for x in states], _ZERO_SLOPES)
    program = with_limited_slopes(row, plant.box, CHORD, CHORD)
    if written is None or program == row:
        return written
    ends = chord_ends(row, plant.box)
    infinite = _check(plant, signal, what, [slope(program, x) for x in states], _ZERO_SLOPES)
    if infinite or not ends:
        return infinite
    zeros = [because("{e} = 0", e=e.args[0] if isinstance(e, sp.Abs) else e) for e in ends]
    places = [because("{e} < {end}", e=e, end=f"{float(end):.2g}") for e, end in ends.items()]
    reason = because(_CHORDS, what=what, zeros=zeros, places=places)
    return replace(written, verdict=Verdict.WHERE, reason=reason, fix="", consequence="")


def _rows(plant: System) -> Iterator[tuple[Signal, str, sp.Expr]]:
    yield from ((x, f"{x.name}{plant.next_mark}", row) for x, row in zip(plant.states, plant.flow, strict=True))
    yield from ((y, y.name, row) for y, row in zip(plant.outputs, plant.output, strict=True))


def _check(
    plant: System, signal: Signal, what: Sentence, expressions: Sequence[sp.Expr], accepted: str
) -> Check | None:
    failures = gaps(expressions, plant)
    if not failures:
        return None
    verdicts = [gap.verdict for gap in failures]
    worst = next(v for v in (Verdict.REFUTED, Verdict.UNKNOWN, Verdict.WHERE) if v in verdicts)
    worse = [gap for gap in failures if gap.verdict is worst]
    read = set[sp.Symbol]().union(*(gap.condition.of.free_symbols for gap in worse))
    unbounded = [s.name for s in (*plant.states, *plant.inputs) if s in read and not s.bounded]
    reason = because(_REASONS[worst], what=what, places=[gap.condition.failure for gap in worse], names=unbounded)
    claim = Sentence.of("{what} has a finite value on the declared ranges", what=what)
    follows = (_NO_SAMPLE if signal in plant.outputs else accepted).format(name=signal.name)
    check = Check(ClaimId(MAKER, signal.name), claim, worst, reason, fix=FIX, consequence=follows)
    if worst is Verdict.WHERE:
        return replace(check, fix=f"Declare low= and high= for {', '.join(unbounded)}.")
    point = worse[0].point
    return replace(check, witness={s.name: float(value) for s, value in point.items()})


def gaps(expressions: Iterable[sp.Expr], plant: System) -> tuple[Gap, ...]:
    """Return the places where expressions of the plant's signals have no finite value on the declared ranges, or may
    have none."""
    around = plant.box
    loose = [s for s in (*plant.states, *plant.inputs) if not s.bounded]
    known = {**around, **{s: (Fraction(str(resting(s))),) * 2 for s in loose}}
    by_condition: dict[Condition, Gap] = {}
    for part in _doubtful(map(resolved, expressions), around):
        condition = _condition(part)
        if condition in by_condition or _holds(condition, around):
            continue
        point = _failure(part, condition, known)
        free = {*part.free_symbols} & {*loose}
        verdict = Verdict.REFUTED if point is not None else Verdict.WHERE if free else Verdict.UNKNOWN
        at = {s: Fraction(resting(s)) for s in loose if s in part.free_symbols} | (point or {})
        by_condition[condition] = Gap(condition, verdict, at if point is not None else {})
    return tuple(by_condition[condition] for condition in minimal(by_condition))


def _doubtful(expressions: Iterable[sp.Expr], around: Box) -> Iterator[sp.Expr]:
    rows = list(expressions)
    quotients = {node: sp.Piecewise(*node.args, evaluate=False) for row in rows for node in row.atoms(Resolved)}
    parts = possibly_undefined((row.xreplace(quotients) for row in rows), around)
    yield from (p for p in parts if p not in quotients.values() and not _chooses_values(p, around))
    if quotients:
        yield from _doubtful((part for node in quotients for part in node.reads), around)


def _chooses_values(part: sp.Expr, around: Box) -> bool:
    """Return whether a Piecewise or Min/Max evaluates roots only of radicands
    that are not negative, and no other part that may be undefined."""
    if not isinstance(part, sp.Piecewise) or part.args[-1].cond != sp.true:
        return False
    chosen = [cond for _, cond in part.args]
    if len(chosen) == 2:
        chosen[1] = sp.Not(chosen[0])
    choices = zip((branch for branch, _ in part.args), chosen, strict=True)
    needed = ((_condition(inner), cond) for branch, cond in choices for inner in possibly_undefined((branch,), around))
    return all(need.relation == "{of} >= 0" and _above(cond) == sp.expand(need.of) for need, cond in needed)


def _above(condition: sp.Basic) -> sp.Expr | None:
    return sp.expand(condition.gts - condition.lts) if hasattr(condition, "gts") else None


def _condition(part: sp.Expr) -> Condition:
    if isinstance(part, sp.Pow):
        base, exponent = part.base, part.exp
        if exponent.is_Integer and exponent.is_negative:
            return Condition(NONZERO, base)
        if exponent.is_Rational and exponent.is_positive:
            return Condition("{of} >= 0", base)
        return Condition(POSITIVE, base)
    if isinstance(part, sp.tan):
        return Condition(NONZERO, sp.cos(part.args[0]))
    if isinstance(part, sp.atan2):
        return off_origin(part)
    if type(part) in _ARGUMENT:
        return Condition(_ARGUMENT[type(part)], part.args[0])
    return Condition("{of} has a value", part)


def _holds(condition: Condition, around: Box) -> bool:
    try:
        if condition.relation == NONZERO:
            return nonzero(condition.of, around, refute=False).never
        if condition.relation == POSITIVE:
            sign = nonzero(condition.of, around, refute=False)
            return sign.verdict is Verdict.PROVED and sign.sign > 0
        if condition.relation not in _INSIDE:
            return False
        low, high = _INSIDE[condition.relation]
        known = bound(condition.of, around)
        open_ended = "<=" not in condition.relation and ">=" not in condition.relation
        inside = low < known.low and known.high < high if open_ended else low <= known.low and known.high <= high
        return known.defined and inside
    except NoTape:
        return False


def _failure(part: sp.Expr, condition: Condition, around: Box) -> Point | None:
    try:
        problem = problem_of(part, around)
        if problem is None:  # at the fixed values
            return {}
        special = special_point(problem.expression, problem.program, problem.sides, ("undefined",))
        if special:
            return special[1]
        if condition.relation == NONZERO:
            sign = nonzero(condition.of, around)
            return dict(sign.witness) if sign.cause in (Cause.ZERO, Cause.CROSSING) else None
        unknown_exponent = isinstance(part, sp.Pow) and (part.exp.is_Integer or not part.exp.is_Rational)
        if condition.relation not in _INSIDE or unknown_exponent:  # it may have a value outside of its domain
            return None
        low, high = _INSIDE[condition.relation]
        known = bound(condition.of, around)
    except NoTape:
        return None
    if known.least is not None and known.least.value < low:
        return dict(known.least.point)
    return dict(known.most.point) if known.most is not None and known.most.value > high else None


# ---------------------------------------------------------------- written


def equations_as_written(plant: System) -> tuple[sp.Expr, ...]:
    """Return the plant's equations as the user has written them; for a plant in new coordinates also each part of the
    original equations, in the new states.

    (x1 - x2)/(2 x1 - 2 x2) has no value at x1 = x2; with x1 = w + x2 SymPy simplifies it to 1/2.
    """
    rows = (*plant.flow, *plant.output)
    if plant.origin is None:
        return rows
    before = plant.origin.plant
    back = dict(zip(before.states, plant.origin.backward, strict=True))
    return (*rows, *mapped_parts(equations_as_written(before), lambda part: part.xreplace(back)))


@lru_cache(maxsize=16)
def part_without_value(plant: System) -> sp.Expr | None:
    """Return a part of the plant's equations, as written, that may be infinite or not real on the declared ranges; None
    where there is none."""
    return next(iter(possibly_undefined(equations_as_written(plant), plant.box)), None)


@lru_cache(maxsize=16)
def value_conditions(plant: System) -> tuple[Condition, ...]:
    """Return the conditions under which the plant as written has a value, without those that are proved on the whole
    box."""
    return conditions(equations_as_written(plant), plant.box)


def if_valued(check: Check, plant: System) -> Check:
    """Return the `check` of a claim about values on the declared ranges, with the verdict unknown instead of proved
    where the plant may have no value somewhere."""
    part = part_without_value(plant) if check.verdict is Verdict.PROVED else None
    if part is None:
        return check
    reason = because("{part} of the plant is not shown to have a value on the box", part=part)
    return Check(check.id, check.claim, Verdict.UNKNOWN, reason, fix="Narrow the ranges so that it has one.")


def on_box(plant: System) -> System:
    """Return the plant with each kink or jump replaced by the branch that holds on its whole box, where there is
    one."""
    around = plant.box
    flow, output = (tuple(one_sided(row, around) for row in rows) for rows in (plant.flow, plant.output))
    return plant if (flow, output) == (plant.flow, plant.output) else replace(plant, flow=flow, output=output)


def wrapped_angles(plant: System) -> dict[sp.Expr, Condition]:
    """Return the nodes atan2(y, x) whose cut causes no jump of an output, because they occur only in outputs with a
    period, which contains whole turns of them; each with the condition under which it is smooth."""
    angles, others = set[sp.Expr](), [*plant.flow]
    for output, row in zip(plant.outputs, plant.output, strict=True):
        for term in sp.Add.make_args(row):
            share, node = term.as_independent(sp.atan2, as_Add=False)
            turns = exact(share) * 2 * sp.pi / exact_turn(output.period) if output.period is not None else sp.nan
            angles |= {node} if isinstance(node, sp.atan2) and turns.is_integer else set()
            others += [] if node in angles else [term]
    alone = sorted((node for node in angles if not any(row.has(node) for row in others)), key=str)
    return {written: off_origin(exact(node)) for node in alone for written in (node, exact(node))}


def on_branches(plant: System, loose: Iterable[sp.Symbol]) -> SampledBranches:
    """Return the branches of flow, output and constraints, in this order, that the declared ranges reach, with the
    `loose` parameters in their ranges and the others at their nominal values. For a plant with constraints: the
    branches that points on the constraints reach, with the rows simplified there (`rigor.invariant.restricted`).

    Raises: `NowhereDefined` where a comparison has no value at these points; `NoTape` for a function without interval
    arithmetic.
    """
    loose, plain, constraints = tuple(loose), on_box(plant), plant.constraints
    fixed = {p: value for p, value in plant.nominal.items() if p not in loose}
    rows = (*(restricted(row, constraints) for row in (*plain.flow, *plain.output)), *constraints)
    rows, sides = at_values(rows, fixed), box((*plant.states, *plant.inputs, *loose))
    if not constraints:
        return sampled_branches(rows, sides)
    nearest = projection(rows[-len(constraints) :], plant.states, loose)

    def project(place: Mapping[sp.Symbol, Fraction], outside: bool = False) -> Mapping[sp.Symbol, Fraction] | None:
        point, values = ([float(place[s]) for s in symbols] for symbols in (plant.states, loose))
        at = nearest(np.array(point), values)
        if at is None:
            return None
        states = {x: Fraction(float(value)) for x, value in zip(plant.states, at, strict=True)}
        within = all(sides[x][0] <= value <= sides[x][1] for x, value in states.items())
        return {**place, **states} if within or outside else None

    inside = sampled_branches(rows, sides, project)
    return inside if inside.branches else sampled_branches(rows, sides, partial(project, outside=True))
