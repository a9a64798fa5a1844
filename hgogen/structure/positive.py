"""The hypothesis 0 < a_m <= a <= a_M on the closed box of what a varies with, and the sign of a."""

from dataclasses import dataclass, field, replace

import sympy as sp

from hgogen.algebra.points import exact, kind, points, settled
from hgogen.algebra.tape import NoTape
from hgogen.check import Check, ClaimId, Verdict
from hgogen.evidence.enclosing import enclosure, point, sides
from hgogen.evidence.grounds import Evidence
from hgogen.form import Form
from hgogen.intervals.bounds import Proof, bound, box, counted, ends
from hgogen.intervals.digits import Down, Up
from hgogen.intervals.sign import Cause, Sign, nonzero
from hgogen.sentence import NONE, Reason, Sentence, because
from hgogen.signal import Signal
from hgogen.system import System

_FEW = 200  # boxes for a sign that only chooses coordinates


@dataclass(frozen=True)
class Gain:
    """The place of a gain: a_i of the one chain by (i), a_(i,j) of chain i by (i, j)."""

    at: tuple[int, ...]

    def of(self, form: Form) -> sp.Expr:
        """The gain, exactly."""
        chain, index = self.at if len(self.at) == 2 else (1, *self.at)
        return exact(sp.sympify(form.gains[chain - 1][index - 1]))


@dataclass(frozen=True)
class Bounded(Gain):
    """A `proof` of 0 < a_m <= a <= a_M."""

    proof: Proof = field(hash=False)

    def evidence(self, form: Form) -> Evidence | None:
        """The range of the gain."""
        return enclosure(form, self.of(form), self.proof)


class NotPositive(Gain):
    """A gain that is zero, negative or undefined somewhere."""

    def evidence(self, form: Form) -> Evidence | None:
        """Such a point, exactly; None where what is known is next to a zero only."""
        a = self.of(form)
        where = sides(form, a.free_symbols)
        sign = nonzero(a, where)
        least = sign.range.least
        if sign.cause in (Cause.ZERO, Cause.UNDEFINED, Cause.PART):
            witness = sign.witness
        elif least is not None and least.value < 0:
            witness = least.point
        else:
            return None
        return {"expression": a, "witness": point(witness, where)}


def sign(a: sp.Expr, system: System) -> int:
    """1 or -1 if a has that sign on the box (proved, or else at all sample points), 0 otherwise."""
    a, signals = _varying(a, system)
    try:
        answer = nonzero(a, box(system.signals, system.nominal), boxes=_FEW)
    except NoTape:
        answer = None
    if answer and answer.verdict is Verdict.PROVED:
        return answer.sign
    seen = {kind(a, point) for point in points(signals)}
    return 1 if seen == {"> 0"} else -1 if seen == {"< 0"} else 0


def positive(id: ClaimId, name: str, a: sp.Expr, system: System) -> Check:
    """The check that 0 < a_m <= a <= a_M. `name` is what the report calls a.

    proved: by outward-rounded intervals and bisection. refuted: with a point where a is zero, negative or not finite
    and real, or next to a zero. unknown: a range is missing, or the boxes tried do not decide.
    """
    claim = Sentence.of("0 < a_m <= {name} = {a} <= a_M on the box", name=name, a=a)
    check = Check(id, claim, Verdict.UNKNOWN, NONE, subject=a)
    a, signals = _varying(a, system)
    try:
        answer = nonzero(a, box(system.signals, system.nominal))
    except NoTape as missing:
        return replace(check, reason=missing.reason)
    if answer.verdict is Verdict.PROVED and answer.sign > 0:
        return _proved(check, a, answer, signals, system)
    negative = answer.range.least
    if answer.verdict is Verdict.REFUTED:
        reason, witness = answer.reason, answer.witness
    elif negative is not None and negative.value < 0:
        reason, witness = because("is negative"), negative.point
    else:
        return _unknown(check, answer.reason, signals)
    at = {s.name: float(value) for s, value in witness.items()}
    fix, consequence = _fix(name, signals, system)
    why = because("{name} {reason}", name=name, reason=reason)
    refuted = replace(check, verdict=Verdict.REFUTED, reason=why, witness=at)
    return replace(refuted, fix=fix, consequence=consequence, disproof=NotPositive(id.at))


def _proved(check: Check, a: sp.Expr, first: Sign, signals: tuple[Signal, ...], system: System) -> Check:
    """The check with its proof and the tightest known range, once the sign is proved."""
    extent = first.range if first.exact else bound(a, box(system.signals, system.nominal))
    low, high = first.exact or (max(extent.low, first.range.low), min(extent.high, first.range.high))
    if high == float("inf"):
        return _unknown(check, because("{boxes} boxes give no upper bound", boxes=extent.boxes), signals)
    tightest = extent if extent.low > 0 else first.range
    sure = first.exact or (tightest.low, tightest.high)
    proof = Proof((a,), *ends(*sure), tightest.variables, tightest.tree)
    proofs = (Bounded(check.id.at, proof),)
    on = because("outward-rounded intervals on {boxes}", boxes=counted(max(extent.boxes, first.range.boxes)))
    how = first.reason if first.exact else on
    reason = because("between {low} and {high}, by {how}", low=Down(low), high=Up(high), how=how)
    if a.is_Rational:
        reason = because("it is {a}", a=a)
    return replace(check, verdict=Verdict.PROVED, reason=reason, proofs=proofs)


def _unknown(check: Check, reason: Reason, signals: tuple[Signal, ...]) -> Check:
    loose = [s.name for s in signals if not s.bounded]
    if loose:
        fix = f"Declare low= and high= for {', '.join(loose)}."
        return replace(check, reason=because("no range is declared for {names}", names=loose), fix=fix)
    return replace(check, reason=because("no point refutes it, {reason}", reason=reason))


def _varying(a: sp.Expr, system: System) -> tuple[sp.Expr, tuple[Signal, ...]]:
    """a with constants at their values, all numbers exact, and the signals that it then varies with."""
    a = exact(settled(a, {p: value for p, value in system.nominal.items() if not p.bounded}))
    return a, tuple(s for s in (*system.states, *system.inputs, *system.parameters) if s in a.free_symbols)


def _fix(name: str, signals: tuple[Signal, ...], system: System) -> tuple[str, str]:
    """What to do about it, and what follows for him who accepts it."""
    if not signals:
        return f"{name} is a constant; correct the model or the parameter's value.", ""
    names = ", ".join(s.name for s in signals)
    inputs = ", ".join(s.name for s in signals if s in system.inputs)
    narrow = f"Restrict the range of {names} so that {name} keeps one sign"
    if not inputs:
        return f"{narrow}.", ""
    coasts = f"the observer coasts while {name} is near 0"
    consequence = f"{coasts}: the states behind it are then seen only through changes of {inputs}"
    return f"{narrow}.", consequence
