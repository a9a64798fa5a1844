"""The hypotheses of forms on the closed box of states, inputs and parameters, as checks with their proofs.

    positive       0 < a_m <= a <= a_M         nonzero_slope         0 < m <= |slope|
    finite_offset  c is a finite real number   bounded_nonlinearity  |a_1 .. a_i b_i| <= mu

They are proved by outward-rounded intervals and bisection, and refuted by a point. A parameter without a range is at
its value.

    lipschitz  b is Lipschitz in the state on the declared box, uniformly in inputs and parameters

The bound L_b = sup |db/dx| comes from outward-rounded intervals (`slope`). A state without a range is unbounded here,
because an observer does not clamp it.

An observer evaluates b with its argument clamped to the box of z. z = Phi(x) maps the plant's box to a part of that
box. A proof on this image says nothing about the remainder of the box of z, through which the estimate may pass. A
clamp of each component is Lipschitz, so that b after the clamp is Lipschitz if b is on the box (`clamped_lipschitz`).
"""

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

import sympy as sp

from hgogen.analysis.evidence import Evidence, Slopes, enclosure, point, sides
from hgogen.analysis.undefined import if_valued, value_conditions, wrapped_angles
from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Form
from hgogen.rigor.bounds import Cause, Proof, Sign, bound, contains_zero, counted, enclose, ends, nonzero
from hgogen.rigor.box import EVERYTHING, box, exact, points, sign_at, substituted_where_real, witness
from hgogen.rigor.singular import CHORD, minimal, one_sided, reasons, singular, with_limited_slopes
from hgogen.rigor.slope import JUMPS, lipschitz_bound
from hgogen.rigor.tape import NoTape, with_norms
from hgogen.rigor.tape import slope as slope_of
from hgogen.sentence import NONE, Down, Reason, Sentence, Up, because, joined
from hgogen.signal import Signal
from hgogen.system import System

_FEW = 200  # boxes for a sign that only chooses coordinates
_OF_OFFSETS = 2000
_OF_PRODUCTS = 500  # mu need not be the least


# ---------------------------------------------------------------- gains: 0 < a_m <= a <= a_M


@dataclass(frozen=True)
class Gain:
    """The gain a_i of z_(i-1)' = a_i z_i + .., named by its indices `at`: (i) in a single chain, (i, j) for number j in
    chain i."""

    at: tuple[int, ...]

    def of(self, form: Form) -> sp.Expr:
        """Return the gain a_i of a form as an expression with exact numbers."""
        chain, index = self.at if len(self.at) == 2 else (1, *self.at)
        return exact(sp.sympify(form.gains[chain - 1][index - 1]))


@dataclass(frozen=True)
class Bounded(Gain):
    """The evidence, by a `proof`, that a chain's gain a has bounds 0 < a_m <= a <= a_M on the box."""

    proof: Proof = field(hash=False)

    def evidence(self, form: Form) -> Evidence | None:
        """Return the proved range of the gain a on the box."""
        return enclosure(form, self.of(form), self.proof)


class NotPositive(Gain):
    """The evidence against a chain's gain a > 0: a point of the box at which it is zero, negative or undefined."""

    def evidence(self, form: Form) -> Evidence | None:
        """Return the exact point where a is not positive; None where only a point next to a zero is known."""
        a = self.of(form)
        where = sides(form, a.free_symbols)
        sign = nonzero(a, where)
        below = sign.range.least
        if sign.cause in (Cause.ZERO, Cause.UNDEFINED, Cause.PART):
            return {"expression": a, "witness": point(sign.witness, where)}
        negative = below is not None and below.value < 0
        return {"expression": a, "witness": point(below.point, where)} if below and negative else None


def sign(a: sp.Expr, system: System) -> int:
    """Return 1 if the expression `a` is positive on the box, -1 if it is negative (proved, or else at all sample
    points), 0 otherwise."""
    a, signals = _varying(a, system)
    with suppress(NoTape):
        answer = nonzero(a, system.box, boxes=_FEW)
        if answer.verdict is Verdict.PROVED:
            return answer.sign
    kinds = {sign_at(a, point) for point in points(signals)}
    return 1 if kinds == {"> 0"} else -1 if kinds == {"< 0"} else 0


def positive(id: ClaimId, name: str, a: sp.Expr, system: System) -> Check:
    """Return the check `id` that 0 < a_m <= a <= a_M on the box, for an expression `a` called `name` in reports.

    proved: by outward-rounded intervals and bisection. refuted: with a point where a is zero, negative or not finite
    and real, or next to a zero. unknown: a range is missing, or the bisection does not decide.
    """
    claim = Sentence.of("0 < a_m <= {name} = {a} <= a_M on the box", name=name, a=a)
    check = Check(id, claim, Verdict.UNKNOWN, NONE, subject=a)
    a, signals = _varying(a, system)
    try:
        answer = nonzero(a, system.box)
    except NoTape as missing:
        return replace(check, reason=missing.reason)
    if answer.verdict is Verdict.PROVED and answer.sign > 0:
        return _proved(check, a, answer, signals, system)
    below = answer.range.least
    if answer.verdict is Verdict.REFUTED:
        reason, place = answer.reason, answer.witness
    elif below is not None and below.value < 0:
        reason, place = because("is negative"), below.point
    else:
        return _unknown(check, answer.reason, signals)
    fix, consequence = _fix(name, signals, system)
    why = because("{name} {reason}", name=name, reason=reason)
    refuted = replace(check, verdict=Verdict.REFUTED, reason=why, witness=witness(place))
    return replace(refuted, fix=fix, consequence=consequence, disproof=NotPositive(id.at))


def _proved(check: Check, a: sp.Expr, first: Sign, signals: tuple[Signal, ...], system: System) -> Check:
    extent = first.range if first.exact else bound(a, system.box)
    low, high = first.exact or (max(extent.low, first.range.low), min(extent.high, first.range.high))
    if high == math.inf:
        return _unknown(check, because("{boxes} boxes give no upper bound", boxes=extent.boxes), signals)
    tightest = extent if extent.low > 0 else first.range
    sure = first.exact or (tightest.low, tightest.high)
    proofs = (Bounded(check.id.at, Proof((a,), *ends(*sure), tightest.variables, tightest.tree)),)
    on = because("outward-rounded intervals on {boxes}", boxes=counted(max(extent.boxes, first.range.boxes)))
    how = first.reason if first.exact else on
    reason = because("between {low} and {high}, by {how}", low=Down(low), high=Up(high), how=how)
    if a.is_Rational:
        reason = because("it is {a}", a=a)
    return replace(check, verdict=Verdict.PROVED, reason=reason, proofs=proofs)


def _unknown(check: Check, reason: Reason, signals: tuple[Signal, ...]) -> Check:
    return _unranged(check, signals) or replace(check, reason=because("no point refutes it, {reason}", reason=reason))


def _unranged(check: Check, signals: tuple[Signal, ...]) -> Check | None:
    unbounded = [s.name for s in signals if not s.bounded]
    fix = f"Declare low= and high= for {', '.join(unbounded)}."
    reason = because("no range is declared for {names}", names=unbounded)
    return replace(check, reason=reason, fix=fix) if unbounded else None


def _varying(a: sp.Expr, system: System) -> tuple[sp.Expr, tuple[Signal, ...]]:
    a = exact(substituted_where_real(a, system.constants))
    return a, tuple(s for s in system.signals if s in a.free_symbols)


def _fix(name: str, signals: tuple[Signal, ...], system: System) -> tuple[str, str]:
    if not signals:
        return f"{name} is a constant; correct the model or the parameter's value.", ""
    names, inputs = (", ".join(s.name for s in some) for some in (signals, [u for u in signals if u in system.inputs]))
    coasts = f"the observer predicts without correction while {name} is near 0"
    consequence = f"{coasts}: the states behind it are then seen only through changes of {inputs}"
    return f"Restrict the range of {names} so that {name} keeps one sign.", consequence if inputs else ""


# ---------------------------------------------------------------- slopes: 0 < m <= |slope|


@dataclass(frozen=True)
class Slope:
    """A partial derivative of a form's equation: dh/dz_1 of the output h for `index` 1, else dF_(index-1)/dz_index of
    the rate z_i' = F_i."""

    index: int

    def of(self, form: Form) -> sp.Expr:
        """Return the partial derivative as an expression with exact numbers."""
        rate = form.output[0] if self.index == 1 else form.flow[self.index - 2]
        return slope_of(exact(sp.sympify(rate)), form.states[self.index - 1])


class AwayFromZero(Slope):
    """The evidence that a partial derivative s satisfies 0 < m <= |s| on the box of states, inputs and parameters."""

    def evidence(self, form: Form) -> Evidence | None:
        """Return the proved range of the partial derivative, under the keys of a certificate."""
        dF = self.of(form)
        where = sides(form, dF.free_symbols)
        bounds = bound(dF, where)
        return enclosure(form, dF, bounds if bounds.low > 0 or bounds.high < 0 else nonzero(dF, where).range)


class Vanishing(Slope):
    """The evidence that a partial derivative is zero somewhere on the box, or has both signs."""

    def evidence(self, form: Form) -> Evidence | None:
        """Return a point where the partial derivative is zero, or two where it has opposite signs; None where no exact
        one is known."""
        dF = self.of(form)
        where = sides(form, dF.free_symbols)
        sign = nonzero(dF, where)
        least, most = sign.range.least, sign.range.most
        if least is not None and most is not None and least.value < 0 < most.value:
            return {"expression": dF, "witness": point(least.point, where), "other": point(most.point, where)}
        return {"expression": dF, "witness": point(sign.witness, where)} if sign.cause is Cause.ZERO else None


def nonzero_slope(id: ClaimId, name: str, slope: sp.Expr, plant: System) -> Check:
    """Return the check `id` that 0 < m <= |slope| on the box, for a partial derivative `slope` called `name` in
    reports; a parameter without a range has its value.

    proved: by outward-rounded intervals and bisection, with the margin m. refuted: with a point where it is zero or
    undefined, or between two of its signs. unknown: with the number of boxes tried, or the missing ranges.
    """
    claim, around = Sentence.of("0 < m <= |{name}| = |{slope}| on the box", name=name, slope=slope), plant.box
    try:
        sign = nonzero(slope, around)
    except NoTape as error:
        return Check(id, claim, Verdict.UNKNOWN, error.reason)
    if sign.verdict is Verdict.PROVED:
        pattern = "it is at least {margin}" if sign.sign > 0 else "it is at most -{margin}"
        return Check(id, claim, sign.verdict, because(pattern, margin=Down(sign.margin)), subject=slope)
    if sign.verdict is Verdict.REFUTED:
        fix = f"Narrow the ranges so that {name} keeps one sign."
        reason = because("{name} {reason}", name=name, reason=sign.reason)
        return Check(id, claim, sign.verdict, reason, witness(sign.witness), fix)
    loose = ", ".join(s.name for s in plant.signals if s in slope.free_symbols and around[s] == EVERYTHING)
    fix = f"Declare low= and high= for {loose}." if loose else ""
    return Check(id, claim, Verdict.UNKNOWN, sign.reason, fix=fix)


# ---------------------------------------------------------------- offsets and b


@dataclass(frozen=True)
class Offset:
    """The evidence that the offset c_i of an output y_i = a_(i,1) z_(i,1) + c_i, i = `chain`, is finite on the box of
    inputs and parameters."""

    chain: int

    def evidence(self, form: Form) -> Evidence | None:
        """Return the proved range of c_i."""
        z = form.states[form.heads[self.chain - 1]]
        c = exact(sp.sympify(form.output[self.chain - 1])).subs(z, 0)
        return enclosure(form, c, bound(c, sides(form, c.free_symbols)))


def finite_offset(id: ClaimId, name: str, c: sp.Expr, system: System) -> Check:
    """Return the check `id` that `c`, an expression of inputs and parameters called `name` in reports, is finite and
    real on the box.

    It is proved by outward-rounded intervals and bisection, refuted by a point, and unknown otherwise.
    """
    claim = Sentence.of("{name} = {c} is a finite real number on the box", name=name, c=c)
    check = Check(id, claim, Verdict.UNKNOWN, NONE)
    c, signals = _varying(c, system)
    around = box(signals, system.nominal)
    try:
        extent = bound(c, around, boxes=_OF_OFFSETS)
    except NoTape as missing:
        return replace(check, reason=missing.reason)
    if extent.defined:
        reason = because("outward-rounded intervals find no singular point")
        return replace(check, verdict=Verdict.PROVED, reason=reason, proofs=(Offset(*id.at or (1,)),))
    unranged = _unranged(check, signals)
    if unranged:
        return unranged
    fix = f"Narrow the ranges so that {name} is defined everywhere."
    for place in points(signals):
        if sign_at(c, place) == "undefined":
            reason = because("{name} is not a finite real number", name=name)
            return replace(check, verdict=Verdict.REFUTED, reason=reason, witness=witness(place), fix=fix)
    poles = singular([c], around)
    holds = because("holds where {conditions: and }", conditions=reasons(minimal(poles.values())))
    return replace(check, reason=holds if poles else extent.note, fix=fix)


def bounded_nonlinearity(id: ClaimId, form: Form, products: Sequence[sp.Expr]) -> Check:
    """Return the check `id` that the nonlinear parts of the chain of integrators are bounded, |c_i| = |a_1 .. a_i b_i|
    <= mu on the box: proved with the bound mu, or unknown. `products` (n): a_1 .. a_i.

    A theorem on x_i' = x_(i+1), x_n' = phi is about the phi of the chain of integrators, c_i = a_1 .. a_i b_i, and not
    about b_n. It needs no slope of phi, so the plant as it is written has to be checked here: a form makes x + 1 of (u
    x + u)/u, which has no value at u = 0. Where the phi of a phase form, the last b_i, has poles in the box of z, it is
    evaluated as a function of the plant's states.
    """
    claim = "phi is bounded on the declared ranges of states and inputs"
    rows, states = (form.b, form.states) if form.behind is None else (form.behind, form.system.states)
    read = {s for row in rows for s in row.free_symbols}
    unbounded = [s.name for s in (*states, *form.system.inputs) if s in read and not s.bounded]
    if unbounded:
        fix = f"Declare a range for {', '.join(unbounded)}; of an input's derivative by rates=((low, high), ..)."
        reason = because("no range is declared for {names}; an input that steps has none", names=unbounded)
        return Check(id, claim, Verdict.UNKNOWN, reason, fix=fix)
    around = form.system.box_with(states)
    try:
        ranges = [bound(a * row, around, boxes=_OF_PRODUCTS) for a, row in zip(products, rows, strict=True) if row != 0]
    except NoTape as missing:
        return Check(id, claim, Verdict.UNKNOWN, because("{what} may be unbounded", what=missing.what))
    if not all(values.finite and values.defined for values in ranges):
        return Check(id, claim, Verdict.UNKNOWN, because("no bound was found; it may have poles on the box"))
    mu = max((max(abs(values.low), abs(values.high)) for values in ranges), default=0.0)
    proved = Check(id, claim, Verdict.PROVED, because("mu <= {mu}, by outward-rounded intervals", mu=Up(mu)))
    return if_valued(proved, form.system)


# ---------------------------------------------------------------- lipschitz


BOXES = 500  # of a clamped b, whose bound need not be the least
_NARROW = "Narrow the ranges so that it stays away from there."
_SINGULAR = "{what} may jump or be singular"
_AT_PSI = because("b is taken at Psi(z), clamped to the plant's ranges")


def lipschitz(maker: str, b: Iterable[sp.Expr], system: System, name: str = "b") -> Check:
    """Return the check `MAKER.lipschitz`, that b is Lipschitz in the states on the box. `maker`: the form's name; `b`:
    expressions of the plant's states, inputs and parameters, called `name` in reports. The check covers the plant as it
    is written as well.

    The verdicts:

        proved: with the Lipschitz constant L_b, and every part of the plant is finite and real on the box
        refuted: with a point towards which a partial derivative tends to infinity
        where: for some inputs or parameters alone b, or the plant as written, may be singular; closed parts of the
        box without these have a bound
        unknown: a range is missing, there may be a jump or a singular state, near which no bound is known, the
        bisection gives no bound, or a part of the plant may have no value
    """
    claim = f"{name} is Lipschitz in the state on the box"
    check = Check(ClaimId(maker, "lipschitz"), claim, Verdict.UNKNOWN, NONE)
    around, entries, angles = system.box, tuple(b), wrapped_angles(system)
    rows = tuple(one_sided(row, around) for row in entries)
    behind = (node for node in angles if enclose(node.args[1], around)[1] < 0)
    left = {node: sp.atan2(*(-e for e in node.args)) for node in behind if contains_zero(enclose(node.args[0], around))}
    uncut = tuple(row.xreplace(left) for row in rows)  # off by half a turn, and cut elsewhere
    try:
        steepest = lipschitz_bound(uncut, system.states, around)
    except NoTape as missing:
        reason = because(_SINGULAR, what=missing.what)
        return replace(check, reason=reason, fix="Write it with functions that are known.")
    if steepest.verdict is Verdict.PROVED:
        bound = Slopes(Proof(entries, None, ends(0.0, steepest.high)[1], steepest.variables, steepest.tree))
        on = because(
            "L_b <= {L_b}, by outward-rounded intervals on {boxes}",
            L_b=Up(steepest.high),
            boxes=counted(steepest.boxes),
        )
        reason = on if steepest.high else because("it does not depend on the state")
        wrapped = because("errors of outputs with a period the short way round") if uncut != rows else NONE
        proved = replace(
            check, verdict=Verdict.PROVED, reason=joined(reason, wrapped), proofs=() if wrapped else (bound,)
        )
        return if_valued(proved, system)
    if steepest.verdict is Verdict.REFUTED:
        place = witness(steepest.witness)
        return replace(check, verdict=Verdict.REFUTED, reason=steepest.reason, witness=place, fix=_NARROW)
    return replace(check, **_undecided(rows, system, steepest.reason))


def with_chords(check: Check, b: Iterable[sp.Expr], system: System) -> Check:
    """Return the check `lipschitz` of b as it applies to filters without a theorem: unknown instead of refuted where
    the derivatives that the step uses, which are those of a chord near 0 of a power, have a bound."""
    rows, around = tuple(b), system.box
    chords = tuple(with_limited_slopes(one_sided(row, around), around, CHORD, CHORD) for row in rows)
    if check.verdict is not Verdict.REFUTED or chords == rows:
        return check
    if lipschitz_bound(chords, system.states, around).verdict is not Verdict.PROVED:
        return check
    reason = because("{why}; the step takes the slope of a chord there", why=check.reason)
    return replace(check, verdict=Verdict.UNKNOWN, reason=reason, witness={}, fix="")


def _undecided(rows: Sequence[sp.Expr], system: System, reason: Reason) -> dict[str, Any]:
    around = system.box
    nodes = {node for row in map(with_norms, rows) for node in row.atoms(*JUMPS)}
    angles = wrapped_angles(system)
    jumps = sorted((node for node in nodes if node.has(*system.states) and node not in angles), key=str)
    if jumps:
        why = because("{part} may jump", part=jumps[0])
        return {"reason": why, "fix": "Write saturations with sympy.Min and sympy.Max."}
    slopes = [row.diff(x) for row in rows for x in system.states if x in row.free_symbols]
    poles = singular([*rows, *slopes], around)
    poles |= {node: condition for node, condition in angles.items() if node in poles}
    read = {s for row in rows for s in row.free_symbols & {*system.states, *system.inputs}}
    unbounded = sorted(s.name for s in read if not s.bounded)
    if unbounded:
        why = because("no bound without a range for {names}", names=unbounded)
        return {"reason": why, "fix": f"Declare low= and high= for {', '.join(unbounded)}."}
    if not poles:
        return {"reason": reason}
    conditions = minimal((*poles.values(), *value_conditions(system)))
    if any(part.has(*system.states) for part in (*poles, *(each.of for each in conditions))):
        places = [condition.failure for condition in conditions]
        why = because("no uniform bound is shown; it may be singular {places: or }", places=places)
        return {"reason": why, "fix": _NARROW}
    holds = because("holds on every closed part of the box where {conditions: and }", conditions=reasons(conditions))
    return {"verdict": Verdict.WHERE, "reason": holds, "fix": _NARROW}


def clamped_lipschitz(observer: str, form: Form, *, boxes: int = BOXES) -> tuple[Check, ...]:
    """Return the check `OBSERVER.lipschitz`, that b(sat(z), u) is Lipschitz on the box of z, for a form whose z are
    more than the plant's states in some order and with signs. () for b = 0, and where z are these states: there the
    form's own check covers the box. `boxes`: the most boxes of a bisection."""
    if not any(form.b) or all(any(z in (x, -x) for x in form.system.states) for z in form.to_form):
        return ()
    claim = "b is Lipschitz in z on the whole box of z, to which its argument is clamped"
    check = Check(ClaimId(observer, "lipschitz"), claim, Verdict.UNKNOWN, because("it is not clamped"))
    if form.free:
        return (check,)
    if form.behind is None:
        proof = _steepest(form.b, form.states, form, boxes)
        if isinstance(proof, Reason):
            return (replace(check, reason=proof),)
        assert proof.high is not None
        reason = because("L_b <= {L_b}, by outward-rounded intervals", L_b=Up(proof.high))
        return (replace(check, verdict=Verdict.PROVED, reason=reason, proofs=(Slopes(proof),)),)
    # unknown, not refuted: beyond the image of the plant's box b is not the plant's
    if isinstance(_steepest(form.from_form, form.states, form, boxes), Reason):
        poles = "{taken}, of which no slope is proved: Psi may have poles in the box of z"
        return (replace(check, reason=because(poles, taken=_AT_PSI)),)
    why = _steepest(form.behind, form.system.states, form, boxes)
    if isinstance(why, Reason):
        return (replace(check, reason=joined(_AT_PSI, why)),)
    reason = because("{taken}, both of bounded slope, by outward-rounded intervals", taken=_AT_PSI)
    return (replace(check, verdict=Verdict.PROVED, reason=reason),)


def _steepest(rows: Sequence[sp.Expr], states: Sequence[Signal], form: Form, boxes: int) -> Proof | Reason:
    around = form.system.box_with(states)
    try:
        steepest = lipschitz_bound(rows, states, around, boxes=boxes)
    except NoTape as missing:
        return because(_SINGULAR, what=missing.what)
    if steepest.verdict is not Verdict.PROVED or not math.isfinite(steepest.high):
        return steepest.reason
    return Proof(tuple(rows), None, Fraction(steepest.high), steepest.variables, steepest.tree)
