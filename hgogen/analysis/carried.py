"""A plant of one output transformed to coordinates z = Phi(x, u, u', ..) in which it is a chain of integrators.

    z_i' = z_(i+1) + b_i,   y = z_1 + o(u):   z in the range of Phi on the plant's box, x = Psi(z, u, ..)

An observer can also stay in the plant's coordinates and correct through the inverse of dPhi/dx. Outside the image of
the plant's box the arguments of tables may leave their breakpoints.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property

import sympy as sp

from hgogen.analysis.coordinates import coordinates, form_in
from hgogen.analysis.determinant import Weights, determinant, minor, subsets, univalent, weighted
from hgogen.analysis.evidence import Evidence, enclosure
from hgogen.analysis.hypotheses import lipschitz
from hgogen.analysis.maps import (
    cancel_factors,
    derivatives,
    input_derivatives,
    inverse,
    rates,
    size,
    without_derivative,
    without_rates,
)
from hgogen.analysis.undefined import value_conditions
from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Form
from hgogen.rigor.bounds import bound, nonzero, problem_of
from hgogen.rigor.box import Box, box, exact, points, sign_at, witness
from hgogen.rigor.lookup import Table, all_clamped
from hgogen.rigor.search import everywhere
from hgogen.rigor.singular import NONZERO, Condition, reasons, singular
from hgogen.rigor.tape import at_kinks
from hgogen.sentence import NONE, Down, Reason, Sentence, because, equations
from hgogen.signal import Signal
from hgogen.system import System

_FLATTER = "Take the form uniform or triangular, which differentiates no table twice, or write it as a formula."
BOXES = 2000
ROUGH = (sp.DiracDelta, sp.Derivative, sp.Subs)  # in a derivative: it does not exist as a function
_RANGES = 300  # b is clamped to the ranges of z: they may be a few percent too wide
_POLES = 200  # b is large, and often has poles in the box of z: more boxes do not help


@dataclass(frozen=True)
class TransformedPlant:
    """A plant transformed to a chain of integrators by z = Phi(x, u, u', ..): z_i' = z_(i+1) + b_i, y = z_1 + offset.

    `Phi` (n) and `rows`, the b_i (n), are expressions of the states and inputs of `plant`, and of the inputs'
    derivatives up to the order `orders`. `before`: the user's plant; `kind`, `reference`: the name and the paper of the
    resulting form.
    """

    kind: str
    reference: str
    before: System
    Phi: tuple[sp.Expr, ...]
    rows: tuple[sp.Expr, ...]
    orders: int
    offset: sp.Expr = sp.S.Zero

    @cached_property
    def known(self) -> tuple[Signal, ...]:
        """The derivatives of inputs that Phi and b depend on; the user supplies them as further inputs."""
        return input_derivatives((*self.Phi, *self.rows), self.before, self.orders)

    @cached_property
    def plant(self) -> System:
        """The plant with `known` as further inputs. Raises: `BadSystem` where another signal has such a name."""
        return replace(self.before, inputs=(*self.before.inputs, *self.known)) if self.known else self.before

    @cached_property
    def jacobian(self) -> sp.ImmutableDenseMatrix:
        """The Jacobian dPhi/dx (n, n)."""
        return sp.ImmutableDenseMatrix([[e.diff(x) for x in self.before.states] for e in self.Phi])

    @property
    def images(self) -> dict[Signal, sp.Expr]:
        """The map from each new state z_i, a signal still without a range, to the expression Phi_i."""
        return dict(zip(coordinates(self.plant).states, self.Phi, strict=True))

    def supplied(self, names: Sequence[str | Reason], missing: str, fix: str) -> Check:
        """Return the check `KIND.inputs`, that the derivatives of inputs on which Phi and b depend have declared
        ranges. `names`: these derivatives in its text; `missing`: the pattern of the reason where some have no range,
        with the fields {names} and {loose}; `fix`: the remedy."""
        id, claim = ClaimId(self.kind, "inputs"), "the derivatives of inputs that enter have ranges"
        unbounded = [u.name for u in self.known if not u.bounded]
        if unbounded:
            return Check(id, claim, Verdict.UNKNOWN, because(missing, names=names, loose=unbounded), fix=fix)
        listed = because("{names} must be supplied as inputs, in declared ranges", names=names)
        return Check(id, claim, Verdict.PROVED, listed if names else because("none enters"))

    def inverse(self) -> dict[sp.Symbol, sp.Expr] | None:
        """Return the inverse x = Psi(z, u, ..) of z = Phi(x, u, ..), by state as expressions of z; None where the
        solver has no result."""
        plant = self.plant
        return inverse(self.images, plant.states, (*plant.inputs, *plant.parameters), plant.constants)

    def in_z(self, back: Mapping[sp.Symbol, sp.Expr], checks: Iterable[Check], recovered: bool) -> Form:
        """Return the form with the states z, each with the range of Phi_i on the plant's box, and the `checks`. `back`:
        the inverse x = Psi(z) by state; `recovered`: whether observers evaluate b at x = Psi(z); they do so as well
        where b(z) may have poles in the box of z."""
        plant, n, box_x = self.plant, len(self.Phi), self.plant.box
        (y,) = plant.outputs
        states = []
        for k, (s, image) in enumerate(self.images.items()):
            values = bound(image, box_x, boxes=_RANGES)
            low, high = (values.low, values.high) if values.finite and values.low < values.high else (None, None)
            angle = next((x for x in plant.states if x.period is not None and image in (x, -x)), None)
            if angle is not None:  # of which the box has more than a turn
                low, high = sorted(end if image == angle else -end for end in angle.interval)
            period = angle and angle.period
            meaning = f"derivative of {y.name} of order {k}" if k else y.meaning or y.name
            states.append(Signal(s.name, y.derivative(k, plant.time).unit, meaning, low=low, high=high, period=period))
        rename = dict(zip(self.images, states, strict=True))
        psi = {x: all_clamped(e.xreplace(rename)) for x, e in back.items()}
        b = tuple(
            min((e := all_clamped(row).xreplace(psi), cancel_factors(e)), key=lambda e: size([e])) for row in self.rows
        )
        around = plant.box_with(states)
        direct = not recovered and all(row.is_number or _defined(row, around, _POLES) for row in b)
        return Form(
            system=plant,
            kind=self.kind,
            states=tuple(states),
            to_form=self.Phi,
            from_form=tuple(psi[x] for x in plant.states),
            A=sp.ImmutableDenseMatrix(n, n, lambda i, j: int(j == i + 1)),
            b=b,
            output=(states[0] + self.offset,),
            checks=(*plant.checks, *checks),
            reference=self.reference,
            behind=None if direct else self.rows,
        )

    def in_x(self, checks: Iterable[Check]) -> Form:
        """Return the form with the plant's states x as coordinates, in which gains act through (dPhi/dx)^-1, and
        `checks`. The derivatives of inputs in dPhi/dx become inputs."""
        plant = self.before
        read = tuple(u for u in self.plant.inputs if u in plant.inputs or u in self.jacobian.free_symbols)
        z = coordinates(replace(plant, inputs=read) if len(read) > len(plant.inputs) else plant)
        J = sp.ImmutableDenseMatrix(self.jacobian.applyfunc(z.carry))
        return form_in(z, f"{self.kind}, original coordinates", checks, self.reference, jacobian=J)


def by_construction(id: ClaimId, claim: str, moving: Iterable[sp.Expr]) -> Check:
    """Return the check `id`, with the text `claim`, that the rate z_i' of each new coordinate z_i = Phi_i(x) is its
    derivative along the plant. It is proved unless an expression in `moving`, which is differentiated, has a jump or a
    kink; then it is unknown."""
    rough = without_derivative(moving)
    if rough:
        fix = "Write jumps and kinks as smooth functions, or use another form."
        return Check(id, claim, Verdict.UNKNOWN, rough, fix=fix)
    return Check(id, claim, Verdict.PROVED, because("by construction"))


def lipschitz_on_image(
    maker: str, claim: str, rows: Iterable[sp.Expr], plant: System, name: str, obstacle: Reason, reason: Reason
) -> Check:
    """Return the check `MAKER.lipschitz`, that functions of z = Phi(x) are Lipschitz on the image of the plant's box,
    because a one to one map of full rank on a compact box has a smooth inverse. `rows`: these functions as expressions
    of x; `name`: their name in reports; `obstacle`: the reason why Phi is not known to be one to one of full rank, or
    `NONE`; `claim`, `reason`: the texts of the check."""
    unknown = Check(ClaimId(maker, "lipschitz"), claim, Verdict.UNKNOWN, NONE)
    unbounded = [s.name for s in (*plant.states, *plant.inputs) if not s.bounded]
    if unbounded:
        return replace(unknown, reason=because("no range is declared for {names}", names=unbounded))
    if obstacle:
        return replace(unknown, reason=obstacle)
    check = replace(lipschitz(maker, rows, plant, name), claim=claim)
    if check.verdict is not Verdict.PROVED:
        return check
    return replace(check, reason=reason, proofs=())  # a bound of the slope in x is none of the slope in z


def _defined(e: sp.Expr, around: Box, boxes: int) -> bool:
    if not singular([exact(e)], around):
        return True
    problem = problem_of(e, around)
    return problem is not None and problem.search(everywhere, boxes).defined


def undefined(expressions: Iterable[sp.Expr], plant: System) -> sp.Expr | None:
    """Return the first of the expressions that is not proved to be finite and real on the whole box of the plant; None
    where all are."""
    box_x = plant.box
    doubtful = (e for e in dict.fromkeys(expressions) if not (e.is_number or e.is_polynomial()))
    return next((e for e in doubtful if not _defined(e, box_x, BOXES)), None)


# ---------------------------------------------------------------- full rank, and one to one


def full_rank(whole: TransformedPlant, det: sp.Expr, readable_det: sp.Expr) -> Check:
    """Return the check `KIND.rank`, that `det`, the determinant of dPhi/dx, has no zero on the box. The verdict is
    generic where it is not identically 0 but may have zeros. `readable_det`: the determinant as it is printed."""
    claim = Sentence.of("det dPhi/dx = {determinant} has no zero on the box", determinant=readable_det)
    # sign(0) is 0 in the plant's own rows; where SymPy differentiated a kink it stands for all values in [-1, 1]
    reads_signs = any(row.has(sp.sign, sp.Heaviside) for row in (*whole.before.flow, *whole.before.output))
    sign = nonzero(det if reads_signs else at_kinks(det), whole.plant.box, boxes=BOXES)
    fix = "Narrow the ranges, or measure something else; where it is 0 an observer does not correct."
    unknown = Check(ClaimId(whole.kind, "rank"), claim, Verdict.UNKNOWN, sign.reason, fix=fix)
    if sign.verdict is Verdict.REFUTED:
        at_witness = replace(unknown, witness=witness(sign.witness))
        if _written(whole, det, sign.witness):
            return replace(at_witness, reason=because("as it is written it is 0/0 there"))
        return replace(at_witness, verdict=Verdict.REFUTED)
    parts = (*whole.Phi, *whole.jacobian)
    rough = without_derivative(parts)
    if rough:
        return replace(unknown, reason=rough, fix=_FLATTER if any(row.has(Table) for row in parts) else "")
    gap = undefined(parts, whole.plant)
    if sign.verdict is Verdict.PROVED and gap is not None:
        return replace(unknown, reason=because("{part} was not shown to be finite on the box", part=gap), fix="")
    if sign.verdict is Verdict.PROVED:
        reason = because("|det| >= {margin} on the box, {how}", margin=Down(sign.margin), how=sign.reason)
        return replace(unknown, verdict=Verdict.PROVED, reason=reason, fix="", proofs=(FullRank(),))
    read = tuple(s for s in whole.plant.signals if s in det.free_symbols)
    if any(sign_at(det, point) in ("> 0", "< 0") for point in points(read)):
        reason = because("it is not 0 identically; zeros on the box are not excluded: {why}", why=sign.reason)
        return replace(unknown, verdict=Verdict.GENERIC, reason=reason)
    return unknown


def _written(whole: TransformedPlant, det: sp.Expr, point: Mapping[sp.Symbol, Fraction]) -> bool:
    """Return whether `det` = det dPhi/dx is undefined at the
    point although all entries of dPhi/dx have values."""
    at = {s: sp.Rational(value) for s, value in point.items()}
    return sign_at(det, at) == "undefined" and all(sign_at(entry, at) != "undefined" for entry in whole.jacobian)


def one_to_one(whole: TransformedPlant, back: Mapping[sp.Symbol, sp.Expr] | None, rank: Check) -> Check:
    """Return the check `KIND.inverse`, that Phi is one to one on the box. It is proved by `back`, the inverse by state,
    if this is defined on the image; without an inverse by components Phi_i that each depend on one more state, with a
    partial derivative of one sign, or by positive principal minors of dPhi/dx. `rank`: the check of full rank."""
    id, claim = ClaimId(whole.kind, "inverse"), "Phi is one to one on the box, whatever the inputs"
    if back is None:
        return _by_rows(whole, rank, id, claim) or _by_minors(whole, rank, id, claim)
    # the inverse's divisors, without their roots: on the image a root may cancel, and its zero with it
    powers = [p for e in back.values() for p in e.atoms(sp.Pow)]
    divisors = {p.base for p in powers if not (p.exp.is_nonnegative or p.base.is_number)}
    images = whole.images
    parts = {cancel_factors(base.xreplace(images)) for base in divisors}
    signs = {part: nonzero(part, whole.plant.box, boxes=BOXES).verdict for part in sorted(parts, key=str)}
    undecided = [part for part, verdict in signs.items() if verdict is not Verdict.PROVED]
    # roots and functions may leave the inverse undefined as well: each is tested by itself
    entire = (sp.sin, sp.cos, sp.sinh, sp.cosh, sp.tanh, sp.exp, sp.atan, sp.asinh)
    roots = [p.base ** (-p.exp if p.exp.is_negative else p.exp) for p in powers if not p.exp.is_Integer]
    functions = [f for e in back.values() for f in e.atoms(sp.Function) if not isinstance(f, entire)]
    others = [part.xreplace(images) for part in (*roots, *functions)]
    inverse = equations(back)
    if undefined((*whole.Phi, *others), whole.plant) is not None:
        reason = because("{inverse} was not shown to be defined on all of the image", inverse=inverse)
        return Check(id, claim, Verdict.UNKNOWN, reason)
    if undecided:
        factors = sorted({f for e in undecided for f in determinant([[e]]).factors or (e,)}, key=str)
        divided = (Condition(NONZERO, factor) for factor in factors)
        conditions = dict.fromkeys((*divided, *value_conditions(whole.before)))
        holds = because("holds where {conditions: and }: {inverse}", conditions=reasons(conditions), inverse=inverse)
        return Check(id, claim, Verdict.WHERE, holds)
    return Check(id, claim, Verdict.PROVED, because("{inverse}, by exact substitution", inverse=inverse))


def _by_minors(whole: TransformedPlant, rank: Check, id: ClaimId, claim: str) -> Check:
    """Return the check that Phi is one to one, proved if all principal minors of L dPhi/dx are
    positive for a constant matrix L. With a proved check `rank` the inverse of Phi is smooth."""
    none = because("no inverse was found; where the rank is n, nearby states differ")
    if rank.verdict is not Verdict.PROVED:
        return Check(id, claim, Verdict.UNKNOWN, none)
    read = [s for s in whole.plant.signals if s in whole.jacobian.free_symbols]
    known = univalent(whole.jacobian, read, whole.plant.box, BOXES)
    if known is None:
        pattern = "{none}, and the principal minors of dPhi/dx are not shown to be above 0"
        return Check(id, claim, Verdict.UNKNOWN, because(pattern, none=none), fix="Narrow the ranges of the states.")
    rows = [because("({weights:, })", weights=map(str, row)) for row in known]
    pattern = "all principal minors of L dPhi/dx are above 0 on the box (Gale, Nikaido 1965), L = [{rows:; }]"
    return Check(id, claim, Verdict.PROVED, because(pattern, rows=rows), proofs=(OneToOne(known),))


def _by_rows(whole: TransformedPlant, rank: Check, id: ClaimId, claim: str) -> Check | None:
    visited: set[sp.Symbol] = set()
    for row in whole.jacobian.tolist():
        new = {x for x, slope in zip(whole.plant.states, row, strict=True) if slope != 0} - visited
        if len(new) > 1:
            return None
        visited |= new
    if rank.verdict is Verdict.PROVED:
        reason = because("each derivative brings in one state, with a slope that is never 0")
        return Check(id, claim, Verdict.PROVED, reason)
    unproved = because("each derivative brings in one state, with a slope that may be 0")
    return Check(id, claim, Verdict.UNKNOWN, unproved)


# ---------------------------------------------------------------- evidence of Phi = (y, y', .., y^(n-1))


class Derivatives:
    """The evidence that a form has the coordinates z = Phi(x, u, ..) = (y, y', .., y^(n-1))."""

    def evidence(self, form: Form) -> Evidence | None:
        """Return the expressions y, y', .. of the plant's states, its inputs and their derivatives, under the keys of a
        certificate; None where there are none."""
        Phi = _derivatives(form)
        return {"chain": Phi} if Phi else None


class FullRank:
    """The evidence that det dPhi/dx has no zero on the plant's box."""

    def evidence(self, form: Form) -> Evidence | None:
        """Return the range of det dPhi/dx on the plant's box."""
        J = _jacobian(form)
        return None if J is None else _enclosed(form, determinant(J.tolist()).value)


@dataclass(frozen=True)
class OneToOne:
    """The evidence that Phi is one to one: all principal minors of L dPhi/dx are above 0 on the plant's box, with the
    constant matrix L = `weights` (n, n)."""

    weights: Weights

    def evidence(self, form: Form) -> Evidence | None:
        """Return L, and the range of each principal minor of L dPhi/dx on the plant's box, under the keys of a
        certificate; None where one has no proved range."""
        J = _jacobian(form)
        if J is None:
            return None
        weighed, minors = weighted(self.weights, J), []
        for places in subsets(form.n):
            known = _enclosed(form, minor(weighed, places))
            if known is None:
                return None
            minors.append({"places": [place + 1 for place in places], **known})
        return {"weights": self.weights, "minors": minors}


def _enclosed(form: Form, determinant: sp.Expr) -> Evidence | None:
    system, det = form.system, exact(determinant)
    known = [u.derivative(k) for u in system.inputs for k in range(form.n)]
    every = box((*known, *system.signals), system.nominal)
    where = {s: every[s] for s in sorted(det.free_symbols, key=str)}
    return enclosure(form, det, nonzero(det, where).range, where)


def _jacobian(form: Form) -> sp.Matrix | None:
    Phi = _derivatives(form)
    return None if Phi is None else sp.Matrix([[entry.diff(x) for x in form.system.states] for entry in Phi])


def _derivatives(form: Form) -> tuple[sp.Expr, ...] | None:
    system = form.system
    if system.origin is not None:
        return None
    return derivatives(exact(system.output[0]), rates(without_rates(system), form.n), form.n)
