"""A plant in other coordinates: w = w(x), x = x(w), w' = (dw/dx f)(x(w), u).

The recast plant is a System. Its estimates are reported in the coordinates of the plant it was recast from. Its
hypotheses hold on the declared ranges, parameters over theirs. `recast.inverse`: both maps are defined and smooth, and
inverse to each other. `recast.range`: w maps the box of the plant's states into the declared range of each new state,
so that no state of the plant is cut off.
"""

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import sympy as sp
from sympy.core.evalf import PrecisionExhausted

from hgogen.analysis.evidence import ByForm
from hgogen.analysis.maps import stand_ins
from hgogen.check import Check, ClaimId, Verdict
from hgogen.reading.given import Misfit, requires_plant
from hgogen.rigor.bounds import Interval, enclose, finite
from hgogen.rigor.box import Box, RationalPoint, exact, points, sign_at, witness
from hgogen.rigor.box import box as box_of
from hgogen.rigor.singular import lost_part, minimal, reasons, singular
from hgogen.rigor.slope import JUMPS, KINKS
from hgogen.sentence import Reason, because, down, up
from hgogen.signal import Signal
from hgogen.system import BadSystem, Origin, System

_DIGITS, _HUGE = 5, 10**300  # digits, and the largest size, of the ends in a proposed fix


@dataclass(frozen=True)
class Change:
    """A change of coordinates: `forward` maps each new state w to its expression w(x) of the plant's states, `backward`
    maps each replaced state x to its expression x(w) of the new and the unchanged states."""

    plant: System
    forward: Mapping[Signal, sp.Expr]
    backward: Mapping[Signal, sp.Expr]

    @property
    def states(self) -> tuple[Signal, ...]:
        """The states of the plant in new coordinates: the new states in the places of the replaced ones."""
        places = dict(zip(self.backward, self.forward, strict=True))
        return tuple(places.get(s, s) for s in self.plant.states)

    @property
    def old(self) -> tuple[Signal, ...]:
        """The signals that w(x), `forward`, may depend on."""
        return (*self.plant.states, *self.plant.tunable)

    @property
    def new(self) -> tuple[Signal, ...]:
        """The signals that x(w), `backward`, may depend on."""
        unchanged = (x for x in self.plant.states if x not in self.backward)
        return (*self.forward, *unchanged, *self.plant.tunable)


@requires_plant
def recast(plant: System, coordinates: Mapping[Signal, Any], inverse: Mapping[Signal, Any]) -> System:
    """Return the plant in coordinates in which some of its states are replaced by new ones.

    Args: `coordinates`: maps each new state (a Signal with its own range) to an expression of the plant's states;
    `inverse`: maps each replaced state of the plant to an expression of the new and the unchanged states. The new
    states take the places of the replaced ones, in order. For a plant that already is in new coordinates both changes
    are composed.

    Raises: `Misfit`; `BadSystem` where the numbers of states differ, a map contains an input or an unknown name, or a
    new state has the name of one that is reported. Whether the maps are smooth and inverse to each other is a Check,
    `recast.inverse`; whether the new ranges are wide enough is another, `recast.range`.
    """
    for what, maps in (("coordinates", coordinates), ("inverse", inverse)):
        if not isinstance(maps, Mapping):
            raise Misfit(f"recast, {what}=", maps, "a mapping from states to their expressions, such as {w: x1 + x2}")
    new, old = tuple(coordinates), tuple(inverse)
    for state in old:
        if state not in plant.states:
            raise BadSystem(plant.name, f"the inverse names {state}, which is no state of it")
    if len(new) != len(old):
        raise BadSystem(plant.name, f"{len(new)} new states for {len(old)} replaced ones; give as many")
    change = Change(plant, *({s: exact(sp.sympify(e)) for s, e in maps.items()} for maps in (coordinates, inverse)))
    _readable(change)
    reported = {s.name for s in (*plant.states, *plant.declared.states)}
    for w in new:  # claims name a state, new or reported
        if w.name in reported:
            raise BadSystem(plant.name, f"the new state {w} has the name of one of its states; give it another")
    return _recast(change if plant.origin is None else _at_once(change, plant.origin))


def _at_once(change: Change, before: Origin) -> Change:
    first, forward = before.plant, dict(zip(change.plant.states, before.forward, strict=True))
    forward |= {w: e.xreplace(forward) for w, e in change.forward.items()}
    back = {x: e.xreplace(change.backward) for x, e in zip(first.states, before.backward, strict=True)}
    new = [w for w in change.states if w not in first.states]
    return Change(first, {w: forward[w] for w in new}, {x: e for x, e in back.items() if x not in change.states})


def _recast(change: Change) -> System:
    plant, states = change.plant, change.states
    plain = stand_ins((*plant.states, *change.forward))
    back = {dummy: signal for signal, dummy in plain.items()}
    forward = {s: change.forward.get(s, s).xreplace(plain) for s in states}
    backward = {plain[x]: e.xreplace(plain) for x, e in change.backward.items()}
    flow = [exact(f).xreplace(plain) for f in plant.flow]  # a product of floats would be rounded
    ones = [plain[s] for s in plant.states]
    rates = [sum(sp.diff(forward[w], x) * f for x, f in zip(ones, flow, strict=True)) for w in states]
    rows = [_substituted(sp.sympify(rate), backward, back, plant, sp.powdenest) for rate in rates]
    for w, rate in zip(states, rows, strict=True):
        if rate.has(sp.DiracDelta, sp.Derivative) and w in change.forward:
            what = f"{w} = {change.forward[w]} jumps, so that it has no rate there; take one that is continuous"
            raise BadSystem(plant.name, what)
    output = [_substituted(exact(h).xreplace(plain), backward, back, plant) for h in plant.output]
    invariants = tuple(_substituted(exact(c).xreplace(plain), backward, back, plant) for c in plant.invariants)
    result = replace(plant, states=states, flow=tuple(rows), output=tuple(output), invariants=invariants)
    reported = tuple(backward.get(x, x).xreplace(back) for x in ones)
    to = tuple(forward[w].xreplace(back) for w in states)
    return replace(result, origin=Origin(plant, to, reported, checks(change)))


def _substituted(
    row: sp.Expr,
    backward: Mapping[sp.Symbol, sp.Expr],
    back: Mapping[sp.Symbol, Signal],
    plant: System,
    tidy: Callable[[sp.Expr], sp.Expr] = sp.sympify,
) -> sp.Expr:
    plain = row.subs(backward)
    unexpanded, expanded = plain.xreplace(back), sp.expand(tidy(plain)).xreplace(back)
    signals = (s for s in unexpanded.free_symbols if isinstance(s, Signal))
    part = lost_part((unexpanded,), (expanded,), box_of(signals, plant.nominal))
    return expanded if part is None else unexpanded


def _readable(change: Change) -> None:
    """Raise `BadSystem` if a map depends on an input, whose
    derivative is not known, or on an undeclared symbol."""
    plant = change.plant
    for maps, states in ((change.forward, {*plant.states}), (change.backward, {*change.states})):
        for s, e in maps.items():
            for symbol in sorted(e.free_symbols - states - {*plant.parameters}, key=str):
                what = f"the input {symbol}, whose derivative is not known" if symbol in plant.inputs else symbol
                allowed = ", ".join(sorted(map(str, states)))
                raise BadSystem(plant.name, f"{s} = {e} reads {what}; write it in {allowed} and parameters")


# ---------------------------------------------------------------- checks


def checks(change: Change) -> tuple[Check, ...]:
    """Return the checks of a change of coordinates: `recast.inverse`, w(x(w)) = w and x(w(x)) = x, and `recast.range`,
    w(x) in its range on the box of x.

    proved: by outward-rounded intervals and exact substitution. refuted: at a sample point. unknown: neither, or no
    range.
    """
    signed = stand_ins((*change.old, *change.forward))
    plain = {dummy: s for s, dummy in signed.items()}

    def tidy(maps: Mapping[Signal, sp.Expr]) -> dict[Signal, sp.Expr]:
        return {s: e.xreplace(signed).xreplace(plain) for s, e in maps.items()}

    maps = (
        {s: exact(e.xreplace(change.plant.constants)) for s, e in maps.items()}
        for maps in (change.forward, change.backward)
    )
    written = Change(change.plant, *maps)
    tidied = Change(change.plant, tidy(written.forward), tidy(written.backward))
    return _inverse(written, tidied, signed), _range(tidied)


def _inverse(written: Change, change: Change, signed: Mapping[Signal, sp.Dummy]) -> Check:
    """Return the check that the maps w(x) and x(w) of a change of states are smooth and
    inverse to each other. `signed`: symbols with the signs of the declared ranges.
    Only one composition is not enough: w = |x|, x in [0, 1], x = w, w in [-1, 1]."""
    id = ClaimId("recast", "inverse")
    claim = "the change of coordinates and its inverse are smooth and undo each other on the declared ranges"
    narrow = "Narrow the ranges so that both maps are smooth there, or correct the inverse."
    there = [*((s, e, change.old) for s, e in change.forward.items())]
    back = [*((s, e, change.new) for s, e in change.backward.items())]
    maps = there + back
    for s, e, signals in maps:
        point = _where(e, signals, ("undefined",))
        if point is not None:
            reason = because("{state} = {value} is not a finite real number", state=s, value=e)
            return Check(id, claim, Verdict.REFUTED, reason, witness(point), narrow)
    gaps = [(e.xreplace(written.forward) - x, change.old) for x, e in written.backward.items()]
    gaps += [(e.xreplace(written.backward) - w, change.new) for w, e in written.forward.items()]
    for gap, signals in gaps:
        point = _where(gap, signals, ("> 0", "< 0"))
        if point is not None:
            return Check(id, claim, Verdict.REFUTED, because("{gap} is not 0", gap=gap), witness(point), narrow)
    unproved = (gap for gap, _ in gaps if sp.simplify(gap.xreplace(signed)) != 0)
    obstacle = _roughness(maps) or next((because("{gap} was not shown to be 0", gap=gap) for gap in unproved), None)
    if obstacle:
        return Check(id, claim, Verdict.UNKNOWN, obstacle, fix=narrow)
    reason = because("outward-rounded intervals find no singular point, exact substitution both ways")
    return Check(id, claim, Verdict.PROVED, reason, proofs=(ByForm(),))


def _roughness(maps: list[tuple[Signal, sp.Expr, tuple[Signal, ...]]]) -> Reason | None:
    for s, e, signals in maps:
        rough = sorted(e.atoms(*JUMPS, *KINKS), key=str)
        if rough:
            return because("{state} = {value} may not be smooth, for {part}", state=s, value=e, part=rough[0])
        poles = singular([e, *(e.diff(x) for x in signals)], box_of(signals))
        if poles:
            pattern = "{state} = {value} is smooth where {conditions: and }"
            return because(pattern, state=s, value=e, conditions=reasons(minimal(poles.values())))
    return None


def _where(e: sp.Expr, signals: tuple[Signal, ...], kinds: tuple[str, ...]) -> RationalPoint | None:
    read = tuple(s for s in signals if s in e.free_symbols)
    if not all(s.bounded for s in read):
        return None
    return next((point for point in points(read) if sign_at(e, point) in kinds), None)


def _range(change: Change) -> Check:
    id, claim = ClaimId("recast", "range"), "the new states keep to their ranges while the plant's states do"
    wide, loose = list[Reason](), set()
    for w, e in change.forward.items():
        if w.low is None or w.high is None:
            continue
        low, high = (Fraction(repr(end)) for end in (w.low, w.high))
        reached = image(e, change.old)
        if low <= reached[0] and reached[1] <= high:
            continue
        below = _where(e - sp.Rational(low), change.old, ("< 0",))
        point = below or _where(e - sp.Rational(high), change.old, ("> 0",))
        if point is not None:
            fix = f"Widen the range of {w}{_at_least(e, change.old, reached)}."
            leaves = because("{state} = {value} leaves [{low:g}, {high:g}]", state=w, value=e, low=w.low, high=w.high)
            return Check(id, claim, Verdict.REFUTED, leaves, witness(point), fix)
        pattern = "{state} = {value} was not shown to stay in [{low:g}, {high:g}]"
        wide.append(because(pattern, state=w, value=e, low=w.low, high=w.high))
        loose |= {s.name for s in change.old if s in e.free_symbols and not s.bounded}
    if wide:
        names = ", ".join(sorted(loose))
        fix = f"Declare low= and high= for {names}." if names else "Widen its range."
        return Check(id, claim, Verdict.UNKNOWN, wide[0], fix=fix)
    reason = because("outward-rounded intervals, exact at the ends")
    return Check(id, claim, Verdict.PROVED, reason, proofs=(ByForm(),))


def image(expression: sp.Expr, signals: tuple[Signal, ...]) -> Interval:
    """Return the range of an expression over the ranges of the `signals`; its ends are exact where partial derivatives
    are bounded and of one sign."""
    box = box_of(signals)
    slopes = {s: expression.diff(s) for s in signals if s.bounded and s in expression.free_symbols}
    if singular([expression], box):
        return -math.inf, math.inf
    if expression.atoms(*JUMPS, *KINKS) or singular(slopes.values(), box):
        return enclose(expression, box)
    low, high = enclose(expression, box)
    bottom = top = expression
    for s, slope in slopes.items():
        least, most = enclose(slope, box)
        ends = [sp.Rational(end) for end in box[s]]
        if least >= 0 or most <= 0:
            first, last = ends if least >= 0 else ends[::-1]
            bottom, top = bottom.xreplace({s: first}), top.xreplace({s: last})
    return max(low, _value(bottom, box)[0]), min(high, _value(top, box)[1])


def _value(expression: sp.Expr, box: Box) -> Interval:
    if expression.is_number and not expression.is_Rational and expression.is_real:
        with suppress(PrecisionExhausted):
            value = Fraction(str(expression.evalf(30, strict=True)))
            error = abs(value) / 10**25
            return value - error, value + error
    return enclose(expression, box)


def _at_least(e: sp.Expr, signals: tuple[Signal, ...], reached: Interval) -> str:
    if not finite(reached):
        read = tuple(s for s in signals if s in e.free_symbols)
        values = [value for point in points(read) if (value := e.xreplace(dict(point)).evalf()).is_Float]
        reached = Fraction(str(min(values))), Fraction(str(max(values)))
    if not all(-_HUGE < end < _HUGE for end in reached):
        return ""
    return f" to at least [{down(reached[0], _DIGITS)}, {up(reached[1], _DIGITS)}]"
