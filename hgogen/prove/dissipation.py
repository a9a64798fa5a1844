"""The Hamilton-Jacobi inequality of an error system: its L2 gain, and a region where the error stays.

    V(0) = 0,  V(e) > 0,   dV/de F(e, x) + |dV/de G(e, x)|^2/(2 mu^2) + |e|^2/2 < 0     for e other than 0

gives V' <= -|e|^2/2 + mu^2 |w|^2/2 along e' = F + G w: input-to-state stability, with the L2 gain mu from w to e, while
e stays where it holds. On a box of e that is the case in the part of {V <= level} in the box, which touches none of its
faces, as long as V(e(0)) + mu^2/2 times the integral of |w|^2 is below the level.

With V_ee the Hessian of V and F_e the slope of F, V_e(e) and F(e) are averages of V_ee e and F_e e over the points of
the way from 0 to e, and P G G'P is a convex function of P: the left side is at most - e'N e, N an average of

    N(c, d) = -(V_ee(c) F_e(d) + F_e(d)'V_ee(c) + V_ee(c) G G'V_ee(c)/mu^2 + I)/2

over such points c and d, which `second_order` decides. Source: Alessandri, "On Hamilton-Jacobi approaches to state
reconstruction for dynamic systems", Mathematical Problems in Engineering (2020), theorem 1, (21), (38), (39).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

import sympy as sp

from hgogen.analysis.evidence import Evidence, end, spelled, tree
from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Form
from hgogen.prove.error_system import BadErrorSystem, Equations, ErrorSystem, Injection, error_box
from hgogen.reading.door import Misfit, limits
from hgogen.reading.named import names_of, quadratic
from hgogen.rigor.bounds import Proof, bound
from hgogen.rigor.box import Box
from hgogen.rigor.definite import symmetric, unsymmetric
from hgogen.rigor.identity import is_zero
from hgogen.rigor.points import exact, kind
from hgogen.rigor.second_order import Answer, SecondOrder, negative
from hgogen.rigor.slope import JUMPS, KINKS, lipschitz_bound
from hgogen.sentence import NONE, Down, Reason, because, down, up

LIMIT = 4000
_SHARP = 1e-2  # of V's range on a face


@dataclass(frozen=True)
class Dissipates:
    """What a claim of (38) is about, and what was found of it: the `answer`, of the `left` side or of V, or `floor`,
    below which {V <= c} keeps off the faces of the box `within` of the errors."""

    system: ErrorSystem
    V: sp.Expr
    mu: sp.Rational
    within: Box = field(hash=False)
    answer: Answer | None = field(default=None, hash=False)
    left: sp.Expr | None = None
    floor: Fraction | None = None

    @property
    def unwritten(self) -> str:
        """Why a certificate cannot show it, "" where it can."""
        return "" if self.system.origin else "of an error system that is given and not made of the plant"

    def evidence(self, form: Form) -> Evidence | None:
        """The error system, and the floor or the bisections."""
        if self.system.origin is None:
            return None
        system = {"system": self._about(self.system.origin)}
        if self.floor is not None:
            return {**system, "floor": self.floor}
        answer = self.answer
        if answer is None or answer.basis is None:
            return None
        whole = self.left is None or answer.share == 1
        return {
            **system,
            "share": answer.share,
            "basis": answer.basis.tolist(),
            "slabs": [_slab(proof, -1 if self.left is None else 1) for proof in answer.proofs[1:]],
            **({} if whole else {"left": spelled(self.left, self._names)}),
        }

    @property
    def _names(self) -> set[str]:
        """The names of the errors and of the signals of the error system."""
        return {s.name for s in (*self.system.errors, *self.system.box)}

    def _about(self, made: Injection | Equations) -> dict[str, Any]:
        """How the error system is made of the plant, outputs by their places, the ranges of e, V and mu."""
        names = self._names | {s.name for s in made.names}
        if isinstance(made, Equations):
            system, seen = self.system, {y: sp.Symbol(f"y_{k}", real=True) for k, y in enumerate(made.outputs, 1)}
            known = names | {y.name for y in seen.values()}
            own: dict[str, Any] = {
                "observer": [spelled(row.xreplace(seen), known) for row in made.observer],
                "unknown": [w.name for w in made.unknown],
                "along": {x.name: spelled(value, names) for x, value in made.along},
                "flow": [spelled(row, names) for row in system.flow],
                "noise": _rows(system.noise, names),
            }
        else:
            own = {key: _rows(M, names) for key, M in (("gain", made.gain), ("G1", made.G1), ("G2", made.G2))}
        errors = [{"name": s.name, "low": end(low), "high": end(high)} for s, (low, high) in self.within.items()]
        return {**own, "errors": errors, "V": spelled(self.V, names), "mu": str(self.mu)}


@dataclass(frozen=True)
class Dissipation:
    """What is known of (38) for V and mu on the box `within` of the errors.

    `checks`: `dissipation.positive`, (21); `dissipation.inequality`, (38); `dissipation.level`. `level`: every
    {V <= c} with c below it keeps off the faces of the box; None where it is not proved. `witness`: the exact point
    that refutes (38), or (21).
    """

    system: ErrorSystem
    V: sp.Expr
    mu: sp.Rational
    within: Box = field(hash=False)
    checks: tuple[Check, ...]
    level: Fraction | None
    witness: Mapping[sp.Symbol, Fraction] = field(default_factory=dict, hash=False)

    @property
    def proved(self) -> bool:
        """Whether every check is."""
        return all(check.verdict is Verdict.PROVED for check in self.checks)

    @property
    def conclusion(self) -> str:
        """What holds, in one sentence."""
        if not self.proved or self.level is None:
            return "nothing is concluded"
        made = self.system.origin
        condition = f" and {made.condition}" if isinstance(made, Equations) and made.condition else ""
        return (
            f"in continuous time, from e(0) in the box with V(e(0)) + {_above(self.mu**2 / 2)} * integral of |w|^2 < "
            f"{down(float(self.level), 9)} on, the error stays in the box, with the L2 gain {_above(self.mu)} from w "
            f"to e; without w it tends to 0; as long as the plant keeps to its ranges{condition}"
        )

    def __str__(self) -> str:
        return "\n".join([f"{self.system.name}: {self.conclusion}", *(f"  {check}" for check in self.checks)])


def dissipation(system: ErrorSystem, V: Any, *, mu: Any, within: Any, boxes: int = LIMIT) -> Dissipation:
    """Inequality (38) of an error system, proved or refuted on a box.

    Args: `V` an expression of the system's errors, or a matrix P (n, n) for e'P e, symmetric but for rounding (1e-12),
    in their order or with rows by name; `mu` > 0; `within` the box of the errors: half widths (n), or ranges
    (low, high) around 0, in their order or by name, of the error or of its state; `boxes` at most for each question of
    a sign.

    Raises: `BadErrorSystem`; `BadNames`; `Misfit`.
    """
    if not isinstance(system, ErrorSystem):
        raise Misfit("dissipation", system, "an error system: hg.error_system(plant, gain)")
    limits("dissipation", boxes)
    around, level, mu = error_box(system, within), _function(system, V), _positive("mu", mu)
    obstacle = _obstacle(system, level, around, boxes)
    zero = dict.fromkeys(system.errors, sp.S.Zero)
    if kind(level, zero) in ("> 0", "< 0"):
        point = dict.fromkeys(system.errors, Fraction(0))
        positive = Answer(Verdict.REFUTED, because("V(0) is not 0"), point)
    else:
        positive = negative(_positive_function(system, level, around), boxes, obstacle)
    lost = because("{part} of the plant may have no value, and cancels in e'", part=system.lost)
    doubt = system.doubt if system.lost is None else lost  # whether e' is that of the plant
    answers = (positive, negative(_inequality(system, level, mu, around), boxes, doubt or obstacle))
    floor = _floor(level, around, boxes)
    subject = Dissipates(system, level, mu, around)
    checks = (
        _check("positive", "V(0) = 0 and V(e) > 0 for every other e of the box (21)", answers[0], "-V", subject),
        _check(
            "inequality",
            f"dV/de F + |dV/de G|^2/(2 mu^2) + |e|^2/2 < 0 for every e of the box but 0, mu = {mu} (38)",
            answers[1],
            "the left side",
            replace(subject, left=_inequality(system, level, mu, around).value),
        ),
        _level(floor, subject),
    )
    witness = next((answer.point for answer in answers[::-1] if answer.point), {})
    return Dissipation(system, level, mu, around, checks, floor, witness)


def _function(system: ErrorSystem, V: Any) -> sp.Expr:
    """V as an expression of the errors."""
    n, V = len(system.errors), quadratic("V", V, names_of(system.errors), aliases=system.aliases)
    try:
        level = sp.sympify(V, strict=True) if isinstance(V, sp.Basic | int | float) else sp.Matrix(V)
    except (sp.SympifyError, ValueError, TypeError):
        raise BadErrorSystem(f"V = {V!r}", "is neither an expression of the errors nor a matrix") from None
    if isinstance(level, sp.MatrixBase):
        if level.shape != (n, n):
            raise BadErrorSystem(f"V of shape {level.shape}", f"must be a symmetric {n} x {n} matrix, for V = e'V e")
        P, e = level.applyfunc(exact), sp.Matrix(system.errors)
        # but for rounding: e'P e is that of (P + P')/2
        rational = all(entry.is_Rational for entry in P)
        even = symmetric([[Fraction(x) for x in row] for row in P.tolist()]) is not None if rational else P == P.T
        if not even:
            raise BadErrorSystem("V", unsymmetric("V"))
        level = (e.T * P * e)[0, 0]
    strange = level.free_symbols - {*system.errors}
    if strange:
        names = ", ".join(e.name for e in system.errors)
        raise BadErrorSystem("V", f"uses {min(map(str, strange))}; it is a function of the errors {names} alone")
    return sp.expand(exact(level))


def _positive(name: str, value: Any) -> sp.Rational:
    try:
        number = exact(sp.sympify(value))
    except (sp.SympifyError, TypeError):
        number = None
    if number is None or not number.is_Rational or not number > 0:
        raise BadErrorSystem(f"{name} = {value!r}", "must be a positive number")
    return number


def _obstacle(system: ErrorSystem, V: sp.Expr, around: Box, boxes: int) -> Reason:
    """Why F and dV/de are not shown to be averages of their slopes, or `NONE`.

    F(0, x) = 0, dV/de(0) = 0 and V(0) = 0; no kinks, no jumps, slopes that are bounded on the whole box.
    """
    zero, box = dict.fromkeys(system.errors, sp.S.Zero), {**system.plain, **around}
    slopes = tuple(V.diff(e) for e in system.errors)
    for what, rows in (("V", (V,)), ("dV/de", slopes)):
        if any(kind(row, zero) != "= 0" for row in rows):
            return because("{what} does not vanish at e = 0", what=what)
    if not all(is_zero(row.xreplace(zero), system.plain) for row in system.flow):
        return because("F is not shown to vanish at e = 0")
    for what, rows in (("F", system.flow), ("dV/de", slopes)):
        if any(row.has(*JUMPS, *KINKS) for row in rows):
            return because("{what} has kinks or jumps", what=what)
        if lipschitz_bound(rows, system.errors, box, boxes=boxes, relative=1.0).verdict is not Verdict.PROVED:
            return because("{what} is not shown to have a bounded slope", what=what)
    return NONE


def _copies(system: ErrorSystem, label: str) -> tuple[sp.Symbol, ...]:
    return tuple(sp.Dummy(f"{e.name}_{label}", real=True) for e in system.errors)


def _positive_function(system: ErrorSystem, V: sp.Expr, around: Box) -> SecondOrder:
    """V as the average of its Hessian."""
    copy = _copies(system, "c")
    hessian = sp.hessian(V, system.errors).xreplace(dict(zip(system.errors, copy, strict=True))) / 2
    return SecondOrder(-V, hessian, (copy,), system.errors, around, {})


def _inequality(system: ErrorSystem, V: sp.Expr, mu: sp.Rational, around: Box) -> SecondOrder:
    """The left side of (38), and N."""
    errors, G = system.errors, sp.Matrix(system.noise)
    here, there, c, d = sp.Matrix(errors), _copies(system, "e"), _copies(system, "c"), _copies(system, "d")
    F = sp.Matrix(system.flow)
    slope = sp.Matrix([[V.diff(e) for e in errors]])
    value = (slope * F)[0, 0] + (slope * G * G.T * slope.T)[0, 0] / (2 * mu**2) + (here.T * here)[0, 0] / 2
    hessian = sp.hessian(V, errors).xreplace(dict(zip(errors, c, strict=True)))
    steep = F.jacobian(errors).xreplace(dict(zip(errors, d, strict=True)))
    pushed = hessian * G.xreplace(dict(zip(errors, there, strict=True)))
    N = -(hessian * steep + steep.T * hessian + pushed * pushed.T / mu**2 + sp.eye(len(errors))) / 2
    return SecondOrder(value, N, (c, d, there), errors, around, system.plain, system.states)


def _floor(V: sp.Expr, around: Box, boxes: int) -> Fraction | None:
    """A lower bound of V on the faces of the box, short and not far below it, or None where none is positive.

    Of e'P e it is the least end_i^2/(P^-1)_ii, where an ellipsoid first touches a face.
    """
    e = sp.Matrix(list(around))
    P = sp.hessian(V, list(around)) / 2
    other = P.free_symbols or sp.expand(V - (e.T * P * e)[0, 0]) != 0
    if other or not P.is_positive_definite:
        faces = [{**around, e: (end, end)} for e, ends in around.items() for end in ends]
        lowest = min(bound(V, face, boxes=boxes, relative=_SHARP).low for face in faces)
        return Fraction(down(lowest, 9)) if lowest > 0 else None
    nearest = (sp.Rational(min(Fraction(end) ** 2 for end in ends)) for ends in around.values())
    least = min(end / share for end, share in zip(nearest, P.inv().diagonal(), strict=True))
    return Fraction(down(Fraction(least), 9))


def _level(floor: Fraction | None, subject: Dissipates) -> Check:
    claim = "a set {V <= c} lies in the box and touches none of its faces"
    if floor is None:
        doubt = because("V is not shown to be positive on the faces")
        return Check(ClaimId("dissipation", "level"), claim, Verdict.UNKNOWN, doubt)
    proofs = (replace(subject, floor=floor),)
    reason = because("for every c < {floor}", floor=Down(float(floor), 9))
    return Check(ClaimId("dissipation", "level"), claim, Verdict.PROVED, reason, proofs=proofs)


def _check(what: str, claim: str, answer: Answer, side: str, subject: Dissipates) -> Check:
    """`side`: the name of what must be negative."""
    there = because("{side} is {value:.3g} there", side=side, value=answer.value)
    reason = answer.reason if answer.value is None else there
    witness = {s.name: float(number) for s, number in answer.point.items()}
    proofs = (replace(subject, answer=answer),)
    return Check(ClaimId("dissipation", what), claim, answer.verdict, reason, witness, proofs=proofs)


def _above(number: sp.Rational) -> str:
    return up(Fraction(number), 9)


def _rows(M: sp.ImmutableDenseMatrix, names: set[str]) -> list[list[str]]:
    return [[spelled(cell, names) for cell in row] for row in M.tolist()]


def _slab(proof: Proof, way: int) -> dict[str, Any]:
    """S < 0 (`way` 1), or -V < 0 as V > 0 (-1), half of what was proved, so that a weaker arithmetic reaches it."""
    assert proof.high is not None  # it is negative
    return {"tree": tree(proof), "bound": way * Fraction(f"{float(proof.high) / 2:.6g}")}
