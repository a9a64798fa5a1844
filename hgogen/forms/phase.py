"""The phase form for one output: its derivatives as coordinates, those of the inputs as known signals.

    z = Phi(x, u, u', ..) = (y, y', .., y^(n-1)),   z_i' = z_{i+1},   z_n' = phi(z, u, u', ..),   y = z_1

where det dPhi/dx is proved to have no zero on the box and the inverse x = Psi(z, u, ..) is found; else the plant
keeps its coordinates and the form carries dPhi/dx, through whose inverse an observer corrects. The derivatives of the
inputs that enter become inputs of the plant: the user supplies them.

J.-P. Gauthier, H. Hammouri, S. Othman, "A simple observer for nonlinear systems, applications to bioreactors", IEEE
TAC 37 (1992); E. Bullinger, A. Ilchmann, F. Allgoewer, NOLCOS 1998, form (1).
"""

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction

import sympy as sp

from hgogen.algebra.interpolation import Table
from hgogen.algebra.kinks import at_kinks
from hgogen.algebra.points import exact, kind, points, witness
from hgogen.algebra.rewrite import TooLarge
from hgogen.analysis.determinant import as_written, determinant
from hgogen.analysis.lie import along, rates, size, without_derivative
from hgogen.analysis.written import asked, if_valued, on_box
from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Asking, Form, NoForm, one_output
from hgogen.intervals.bounds import nonzero
from hgogen.intervals.digits import Down
from hgogen.intervals.singular import NONZERO, Condition, reasons
from hgogen.sentence import NONE, Sentence, because, equations
from hgogen.structure.carried import (
    BOXES,
    ROUGH,
    Carried,
    Derivatives,
    FullRank,
    OneToOne,
    by_construction,
    carried,
    on_image,
    undefined,
)
from hgogen.structure.inverse import tidy
from hgogen.structure.univalent import univalent
from hgogen.system import System

LIMIT = 20_000  # nodes of y .. y^(n)
_FLATTER = "Take the form uniform or triangular, which differentiates no table twice, or write it as a formula."
_REFERENCE = "Gauthier, Hammouri, Othman, IEEE TAC 37 (1992)"
_RANGES = "Declare rates=((low, high), ..) of the input, one pair for each derivative."


class NoPhase(NoForm):
    """A plant that has no phase form here."""


@Asking(4, most=1, costly=True, slow=True)
def phase(plant: System, *, original: bool = False, recovered: bool = False) -> Form:
    """The plant in phase form, or with the Jacobian of the map to it.

    With `original` the plant keeps its coordinates in any case: phi, and the derivatives of inputs that enter nothing
    else, are then not needed. With `recovered` an observer reads phi at Psi(z), clamped to the plant's ranges, as it
    does in any case where phi may have poles in the box of z: of that box the image of the plant's is often a thin
    part, beyond which phi is far larger and would ask for as large a theta. No bound on theta is then proved.

    Checks: `phase.chain` (by construction, where the plant has a value and y .. y^(n-2) have derivatives);
    `phase.inputs` (the derivatives of inputs that enter have ranges); `phase.rank` (det dPhi/dx has no zero on the
    box); `phase.inverse` (Phi is one to one on the box); `phase.lipschitz` (phi, as a function of z).

    Raises: `NoPhase` for several outputs, or derivatives of more than `LIMIT` nodes; `BadSystem` where a signal has the
    name of an input's derivative.
    """
    whole = _map(plant)
    J, (*_, phi) = whole.jacobian.tolist(), whole.rows
    try:
        det = determinant(J)
    except TooLarge as error:
        raise NoPhase(plant.name, f"has no determinant of dPhi/dx here: {error}") from error
    regular = _rank(whole, det.value, as_written(J, det).value)
    # where the plant has a value: (x1 x3)' = x2 holds for x1' = x2/x3, x3' = 0, but not at x3 = 0
    by_rates = by_construction(ClaimId("phase", "chain"), "y = z_1, z_i' = z_(i+1)", whole.Phi[:-1])
    chain = if_valued(replace(by_rates, proofs=(Derivatives(),)), plant)
    within = {s for e in whole.Phi for s in e.free_symbols}
    names = [u.name if u in within else because("{input} (phi alone)", input=u.name) for u in whole.known]
    inputs = whole.supplied(names, "{names} enter, to be supplied; no range is declared for {loose}", _RANGES)
    rank, back = if_valued(regular, plant), whole.inverse()
    one_to_one = if_valued(_one_to_one(whole, back, rank), plant)
    claim = "phi is Lipschitz in z on the image of the box"
    missing = [c.id for c in (rank, one_to_one) if c.verdict is not Verdict.PROVED]
    doubt = because("in z it needs {checks: and }", checks=missing) if missing else NONE
    reason = because("phi is Lipschitz in x, and Phi is smooth, one to one and of full rank on a closed, bounded box")
    steep = on_image("phase", claim, [phi], whole.plant, "phi", doubt, reason)
    checks = (chain, inputs, rank, one_to_one, steep)
    if original or back is None or regular.verdict is not Verdict.PROVED:
        return whole.in_x(checks)
    return whole.in_z(back, checks, recovered)


def _map(plant: System) -> Carried:
    """The plant in z = (y, y', ..), whose last row alone has a b, phi. Raises: `NoPhase`."""
    n = len(plant.states)
    one_output(plant, "; the phase form takes one: keep one", NoPhase)
    plain = on_box(plant)
    flow, chain = rates(plain, n + 1), [exact(plain.output[0])]
    while len(chain) <= n:
        chain.append(along(chain[-1], flow))
        if size(chain) > LIMIT:
            reason = f"has derivatives of more than {LIMIT} nodes, at y^({len(chain) - 1}); use the form original"
            raise NoPhase(plant.name, reason)
    whole = carried("phase", _REFERENCE, plant, chain[:n], (*(sp.S.Zero,) * (n - 1), chain[n]), n)
    if any(e.has(*ROUGH) for e in (*chain, *whole.jacobian)):
        rough = without_derivative((*plant.flow, *plant.output)) or "something"
        raise NoPhase(plant.name, f"has no derivatives to order {n} here: {rough}")
    return whole


# ---------------------------------------------------------------- checks


def _rank(whole: Carried, det: sp.Expr, shown: sp.Expr) -> Check:
    """The check of the rank by rigorous bounds of the determinant, `shown` as it is read. The rank is generic where the
    determinant is not 0 identically and its zeros are not excluded."""
    claim = Sentence.of("det dPhi/dx = {determinant} has no zero on the box", determinant=shown)
    # a sign that the plant itself reads is 0 at 0; one that SymPy took for a slope at a kink is a set
    own = any(row.has(sp.sign, sp.Heaviside) for row in (*whole.before.flow, *whole.before.output))
    sign = nonzero(det if own else at_kinks(det), whole.box, boxes=BOXES)
    fix = "Narrow the ranges, or measure something else; where it is 0 an observer does not correct."
    unknown = Check(ClaimId("phase", "rank"), claim, Verdict.UNKNOWN, sign.reason, fix=fix)
    if sign.verdict is Verdict.REFUTED:
        there = replace(unknown, witness=witness(sign.witness))
        if _written(whole, det, sign.witness):
            return replace(there, reason=because("as it is written it is 0/0 there"))
        return replace(there, verdict=Verdict.REFUTED)
    parts = (*whole.Phi, *whole.jacobian)
    rough = without_derivative(parts)
    if rough:
        return replace(unknown, reason=rough, fix=_FLATTER if any(row.has(Table) for row in parts) else "")
    lost = undefined(parts, whole.plant)
    if sign.verdict is Verdict.PROVED and lost is not None:
        return replace(unknown, reason=because("{part} was not shown to be finite on the box", part=lost), fix="")
    if sign.verdict is Verdict.PROVED:
        reason = because("|det| >= {margin} on the box, {how}", margin=Down(sign.margin), how=sign.reason)
        return replace(unknown, verdict=Verdict.PROVED, reason=reason, fix="", proofs=(FullRank(),))
    read = tuple(s for s in whole.plant.signals if s in det.free_symbols)
    if any(kind(det, point) in ("> 0", "< 0") for point in points(read)):
        reason = because("it is not 0 identically; zeros on the box are not excluded: {why}", why=sign.reason)
        return replace(unknown, verdict=Verdict.GENERIC, reason=reason)
    return unknown


def _written(whole: Carried, det: sp.Expr, point: Mapping[sp.Symbol, Fraction]) -> bool:
    """Whether the determinant is undefined there by the way it is written alone: dPhi/dx is not."""
    at = {s: sp.Rational(value) for s, value in point.items()}
    return kind(det, at) == "undefined" and all(kind(entry, at) != "undefined" for entry in whole.jacobian)


def _one_to_one(whole: Carried, back: Mapping[sp.Symbol, sp.Expr] | None, rank: Check) -> Check:
    """The check that Phi is one to one: by the inverse, wherever it is defined on the image, by rows that each bring in
    one state, with a slope, or by the signs of minors."""
    id, claim = ClaimId("phase", "inverse"), "Phi is one to one on the box, whatever the inputs"
    if back is None:
        return _by_rows(whole, rank, id, claim) or _by_minors(whole, rank, id, claim)
    # what the inverse divides by, also under a root: on the image a root may cancel, and its zero with it
    powers = [p for e in back.values() for p in e.atoms(sp.Pow)]
    divisors = {p.base for p in powers if not (p.exp.is_nonnegative or p.base.is_number)}
    images = whole.images
    parts = {tidy(base.xreplace(images)) for base in divisors}
    signs = {part: nonzero(part, whole.box, boxes=BOXES).verdict for part in sorted(parts, key=str)}
    doubts = [part for part, verdict in signs.items() if verdict is not Verdict.PROVED]
    # what beside divisions may leave it undefined: its roots and functions, each by itself
    entire = (sp.sin, sp.cos, sp.sinh, sp.cosh, sp.tanh, sp.exp, sp.atan, sp.asinh)
    roots = [p.base ** (-p.exp if p.exp.is_negative else p.exp) for p in powers if not p.exp.is_Integer]
    functions = [f for e in back.values() for f in e.atoms(sp.Function) if not isinstance(f, entire)]
    others = [part.xreplace(images) for part in (*roots, *functions)]
    inverse = equations(back)
    if undefined((*whole.Phi, *others), whole.plant) is not None:
        doubt = because("{inverse} was not shown to be defined on all of the image", inverse=inverse)
        return Check(id, claim, Verdict.UNKNOWN, doubt)
    if doubts:
        factors = sorted({f for e in doubts for f in determinant([[e]]).factors or (e,)}, key=str)
        conditions = dict.fromkeys((*(Condition(NONZERO, factor) for factor in factors), *asked(whole.before)))
        holds = because("holds where {conditions: and }: {inverse}", conditions=reasons(conditions), inverse=inverse)
        return Check(id, claim, Verdict.WHERE, holds)
    return Check(id, claim, Verdict.PROVED, because("{inverse}, by exact substitution", inverse=inverse))


def _by_minors(whole: Carried, rank: Check, id: ClaimId, claim: str) -> Check:
    """Phi with a Jacobian whose principal minors are above zero; the rank says that it is smooth."""
    none = because("no inverse was found; where the rank is n, nearby states differ")
    if rank.verdict is not Verdict.PROVED:
        return Check(id, claim, Verdict.UNKNOWN, none)
    read = [s for s in whole.plant.signals if s in whole.jacobian.free_symbols]
    known = univalent(whole.jacobian, read, whole.box, BOXES)
    if known is None:
        pattern = "{none}, and the principal minors of dPhi/dx are not shown to be above 0"
        return Check(id, claim, Verdict.UNKNOWN, because(pattern, none=none), fix="Narrow the ranges of the states.")
    rows = [because("({weights:, })", weights=map(str, row)) for row in known]
    pattern = "all principal minors of L dPhi/dx are above 0 on the box (Gale, Nikaido 1965), L = [{rows:; }]"
    return Check(id, claim, Verdict.PROVED, because(pattern, rows=rows), proofs=(OneToOne(known),))


def _by_rows(whole: Carried, rank: Check, id: ClaimId, claim: str) -> Check | None:
    """Phi lower triangular in some order of states: strictly monotone in each, where the determinant has no zero; None
    where it is not."""
    seen: set[sp.Symbol] = set()
    for row in whole.jacobian.tolist():
        new = {x for x, slope in zip(whole.plant.states, row, strict=True) if slope != 0} - seen
        if len(new) > 1:
            return None
        seen |= new
    if rank.verdict is Verdict.PROVED:
        reason = because("each derivative brings in one state, with a slope that is never 0")
        return Check(id, claim, Verdict.PROVED, reason)
    doubt = because("each derivative brings in one state, with a slope that may be 0")
    return Check(id, claim, Verdict.UNKNOWN, doubt)
