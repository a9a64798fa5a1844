"""The hypotheses of a change of coordinates w = w(x), x = x(w), on the declared ranges, parameters over theirs.

`recast.inverse`: both maps are defined and smooth, and undo each other. `recast.range`: w maps the box of the
plant's states into the range that each new state declares, so that no state of the plant is cut off.
"""

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from types import MappingProxyType

import sympy as sp
from sympy.core.evalf import PrecisionExhausted

from hgogen.algebra.points import Point, exact, kind, points, witness
from hgogen.check import Check, ClaimId, Verdict
from hgogen.evidence.grounds import ByForm
from hgogen.intervals.box import Box
from hgogen.intervals.box import box as box_of
from hgogen.intervals.digits import down, up
from hgogen.intervals.glance import Interval, enclose, finite
from hgogen.intervals.singular import minimal, reasons, singular
from hgogen.sentence import Reason, because
from hgogen.signal import Signal
from hgogen.structure.lipschitz import JUMPS, KINKS
from hgogen.system import System

_DIGITS, _HUGE = 5, 10**300  # of the ends that a fix proposes
EMPTY: Mapping[Signal, float] = MappingProxyType({})


@dataclass(frozen=True)
class Change:
    """New states in terms of the plant's (`forward`), replaced states in terms of the new ones (`backward`)."""

    plant: System
    forward: Mapping[Signal, sp.Expr]
    backward: Mapping[Signal, sp.Expr]

    @property
    def states(self) -> tuple[Signal, ...]:
        """Those of the recast plant: the new ones in the place of the replaced, in order."""
        places = dict(zip(self.backward, self.forward, strict=True))
        return tuple(places.get(s, s) for s in self.plant.states)

    @property
    def old(self) -> tuple[Signal, ...]:
        """What `forward` may read."""
        return (*self.plant.states, *self.plant.tunable)

    @property
    def new(self) -> tuple[Signal, ...]:
        """The signals that `backward` may read."""
        unchanged = (x for x in self.plant.states if x not in self.backward)
        return (*self.forward, *unchanged, *self.plant.tunable)


def stand_ins(signals: Iterable[Signal], fixed: Mapping[Signal, float] = EMPTY) -> dict[Signal, sp.Dummy]:
    """Symbols that carry the sign of a signal's range, so that sqrt(w^2) can become w; of its value where `fixed`."""
    ends = {s: (fixed[s], fixed[s]) if s in fixed else s.interval for s in signals}
    dummies = {}
    for s, (low, high) in ends.items():
        assumed = {"nonnegative": True} if low == 0 else {}
        if low > 0 or high < 0:
            assumed = {"positive" if low > 0 else "negative": True}
        dummies[s] = sp.Dummy(s.name, real=True, **assumed)
    return dummies


def checks(change: Change) -> tuple[Check, ...]:
    """`recast.inverse` and `recast.range`.

    proved: outward-rounded intervals, exact substitution. refuted: at a sample point. unknown: neither, or no range.
    """
    fixed = {p: value for p, value in change.plant.nominal.items() if not p.bounded}
    signed = stand_ins((*change.old, *change.forward))
    plain = {dummy: s for s, dummy in signed.items()}

    def tidy(maps: Mapping[Signal, sp.Expr]) -> dict[Signal, sp.Expr]:
        return {s: e.xreplace(signed).xreplace(plain) for s, e in maps.items()}

    maps = ({s: exact(e.xreplace(fixed)) for s, e in maps.items()} for maps in (change.forward, change.backward))
    written = Change(change.plant, *maps)
    tidied = Change(change.plant, tidy(written.forward), tidy(written.backward))
    return _inverse(written, tidied, signed), _range(tidied)


def _inverse(written: Change, change: Change, signed: Mapping[Signal, sp.Dummy]) -> Check:
    """The check `recast.inverse` of a change as it is `written`, which in its ranges is `change`: each map takes what
    the other gives, and that may be in no range, as -1 of w = |x|, x in [0, 1], x = w, w in [-1, 1]."""
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
    left = (gap for gap, _ in gaps if sp.simplify(gap.xreplace(signed)) != 0)
    doubt = _roughness(maps) or next((because("{gap} was not shown to be 0", gap=gap) for gap in left), None)
    if doubt:
        return Check(id, claim, Verdict.UNKNOWN, doubt, fix=narrow)
    reason = because("outward-rounded intervals find no singular point, exact substitution both ways")
    return Check(id, claim, Verdict.PROVED, reason, proofs=(ByForm(),))


def _roughness(maps: list[tuple[Signal, sp.Expr, tuple[Signal, ...]]]) -> Reason | None:
    """Where a map or a slope of it may be singular, jump or have a kink; None if nowhere."""
    for s, e, signals in maps:
        rough = sorted(e.atoms(*JUMPS, *KINKS), key=str)
        if rough:
            return because("{state} = {value} may not be smooth, for {part}", state=s, value=e, part=rough[0])
        poles = singular([e, *(e.diff(x) for x in signals)], box_of(signals))
        if poles:
            pattern = "{state} = {value} is smooth where {conditions: and }"
            return because(pattern, state=s, value=e, conditions=reasons(minimal(poles.values())))
    return None


def _where(e: sp.Expr, signals: tuple[Signal, ...], kinds: tuple[str, ...]) -> Point | None:
    """A sample point where e is of one of the kinds; none without ranges, which say what is meant."""
    read = tuple(s for s in signals if s in e.free_symbols)
    if not all(s.bounded for s in read):
        return None
    return next((point for point in points(read) if kind(e, point) in kinds), None)


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
    """A range of the expression on the box: at the ends of each signal in which a bounded slope keeps its sign."""
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
    """The range on the box, of a number that is no rational by the digits that evalf guarantees."""
    if expression.is_number and not expression.is_Rational and expression.is_real:
        with suppress(PrecisionExhausted):
            value = Fraction(str(expression.evalf(30, strict=True)))
            error = abs(value) / 10**25
            return value - error, value + error
    return enclose(expression, box)


def _at_least(e: sp.Expr, signals: tuple[Signal, ...], reached: Interval) -> str:
    """The range that is proved where it is finite, else what the sample points reach, its ends rounded outwards to few
    digits, as a sentence goes on; nothing where no float holds them."""
    if not finite(reached):
        read = tuple(s for s in signals if s in e.free_symbols)
        values = [value for point in points(read) if (value := e.xreplace(dict(point)).evalf()).is_Float]
        reached = Fraction(str(min(values))), Fraction(str(max(values)))
    if not all(-_HUGE < end < _HUGE for end in reached):
        return ""
    return f" to at least [{down(reached[0], _DIGITS)}, {up(reached[1], _DIGITS)}]"
