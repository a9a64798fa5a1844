"""A plant of one output carried to coordinates z = Phi(x, u, u', ..) in which it is a chain of integrators.

    z_i' = z_(i+1) + b_i,   y = z_1 + o(u):   z within what Phi is on the plant's box, x = Psi(z, u, ..)

or left in its own, with dPhi/dx, through whose inverse an observer corrects. Beyond the image of the plant's box the
arguments of tables may leave their points.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import sympy as sp

from hgogen.algebra.interpolation import held
from hgogen.algebra.points import exact
from hgogen.analysis.determinant import determinant
from hgogen.analysis.lie import derivatives, input_derivatives, rates, size, without_derivative, without_rates
from hgogen.check import Check, ClaimId, Verdict
from hgogen.evidence.enclosing import enclosure
from hgogen.evidence.grounds import Evidence
from hgogen.form import Form
from hgogen.intervals.bounds import bound, nonzero, problem_of
from hgogen.intervals.box import Box, box
from hgogen.intervals.search import everywhere
from hgogen.intervals.singular import singular
from hgogen.sentence import NONE, Reason, because
from hgogen.signal import Signal
from hgogen.structure.coordinates import coordinates, form_in
from hgogen.structure.inverse import inverse, tidy
from hgogen.structure.lipschitz import lipschitz
from hgogen.structure.univalent import Weights, minor, subsets, weighted
from hgogen.system import System

BOXES = 2000
ROUGH = (sp.DiracDelta, sp.Derivative, sp.Subs)  # what a derivative has that there is not
_RANGES = 300  # the ranges of z are where b is clamped: a few percent wider is no harm
_POLES = 200  # b is large, and with poles in the box of z, as they often are, more boxes do not help


@dataclass(frozen=True)
class Carried:
    """The map `Phi` (n) and b (n) as `rows`, dPhi/dx, and y - z_1, the `offset`, of the states and inputs of `plant`;
    `before` is the user's, without the derivatives of inputs; `kind` and `reference` of its form."""

    kind: str
    reference: str
    plant: System
    before: System
    Phi: tuple[sp.Expr, ...]
    rows: tuple[sp.Expr, ...]
    jacobian: sp.ImmutableDenseMatrix
    offset: sp.Expr = sp.S.Zero

    @property
    def images(self) -> dict[Signal, sp.Expr]:
        """Phi by the states of the form, which have no range yet."""
        return dict(zip(coordinates(self.plant).states, self.Phi, strict=True))

    @property
    def box(self) -> Box:
        """The box of the plant."""
        return box(self.plant.signals, self.plant.nominal)

    @property
    def known(self) -> tuple[Signal, ...]:
        """The derivatives of inputs that enter, which the user supplies."""
        return self.plant.inputs[len(self.before.inputs) :]

    def supplied(self, names: Sequence[str | Reason], doubt: str, fix: str) -> Check:
        """The check `KIND.inputs`, that the derivatives of inputs that enter, called `names`, have ranges; `doubt`: how
        it is said that the `loose` ones have none."""
        id, claim = ClaimId(self.kind, "inputs"), "the derivatives of inputs that enter have ranges"
        loose = [u.name for u in self.known if not u.bounded]
        if loose:
            return Check(id, claim, Verdict.UNKNOWN, because(doubt, names=names, loose=loose), fix=fix)
        enter = because("{names} enter, to be supplied, in declared ranges", names=names)
        return Check(id, claim, Verdict.PROVED, enter if names else because("none enters"))

    def inverse(self) -> dict[sp.Symbol, sp.Expr] | None:
        """Psi; None where none is found."""
        plant = self.plant
        fixed = {p: value for p, value in self.before.nominal.items() if not p.bounded}
        return inverse(self.images, plant.states, (*plant.inputs, *plant.parameters), fixed)

    def in_z(self, back: Mapping[sp.Symbol, sp.Expr], checks: Iterable[Check], recovered: bool) -> Form:
        """The form in z, each with the range that Phi has on the box; `recovered`: b is taken at Psi(z), as it is where
        it may have poles in the box of z."""
        plant, n, box_x = self.plant, len(self.Phi), self.box
        (y,) = plant.outputs
        states = []
        for k, (s, image) in enumerate(self.images.items()):
            values = bound(image, box_x, boxes=_RANGES)
            low, high = (values.low, values.high) if values.finite and values.low < values.high else (None, None)
            meaning = f"derivative of {y.name} of order {k}" if k else y.meaning or y.name
            states.append(Signal(s.name, y.derivative(k, plant.time).unit, meaning, low=low, high=high))
        rename = dict(zip(self.images, states, strict=True))
        psi = {x: held(e.xreplace(rename)) for x, e in back.items()}
        b = tuple(min((e := held(row).xreplace(psi), tidy(e)), key=lambda e: size([e])) for row in self.rows)
        around = box((*states, *plant.inputs, *plant.parameters), plant.nominal)
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
        """The form in the plant's coordinates, with dPhi/dx and those derivatives of inputs that it reads."""
        plant = self.before
        read = tuple(u for u in self.plant.inputs if u in plant.inputs or u in self.jacobian.free_symbols)
        z = coordinates(replace(plant, inputs=read) if len(read) > len(plant.inputs) else plant)
        J = sp.ImmutableDenseMatrix(self.jacobian.applyfunc(z.carry))
        return form_in(z, f"{self.kind}, original coordinates", checks, self.reference, jacobian=J)


def carried(
    kind: str,
    reference: str,
    plant: System,
    Phi: Sequence[sp.Expr],
    rows: Sequence[sp.Expr],
    orders: int,
    offset: sp.Expr = sp.S.Zero,
) -> Carried:
    """The plant carried by Phi, with the derivatives of its inputs, up to these orders, that enter.

    Raises: `BadSystem` where a signal has the name of one.
    """
    n, known = len(Phi), input_derivatives((*Phi, *rows), plant, orders)
    extended = replace(plant, inputs=(*plant.inputs, *known)) if known else plant
    J = sp.ImmutableDenseMatrix(n, n, lambda i, j: Phi[i].diff(plant.states[j]))
    return Carried(kind, reference, extended, plant, tuple(Phi), tuple(rows), J, offset)


def by_construction(id: ClaimId, claim: str, moving: Iterable[sp.Expr]) -> Check:
    """The check that coordinates move as their derivatives along the plant say; unknown where one of those that are
    `moving` has a jump or a kink, at which it has no derivative."""
    rough = without_derivative(moving)
    if rough:
        fix = "Write jumps and kinks as smooth functions, or use another form."
        return Check(id, claim, Verdict.UNKNOWN, rough, fix=fix)
    return Check(id, claim, Verdict.PROVED, because("by construction"))


def on_image(
    maker: str, claim: str, rows: Iterable[sp.Expr], plant: System, name: str, doubt: Reason, reason: Reason
) -> Check:
    """The check `MAKER.lipschitz` of what is a function of the coordinates on the image of the plant's box: on one that
    is compact, a one to one map of full rank has a smooth inverse on its compact image.

    `rows`: the same in the plant's states, called `name`; `doubt`: why the map is not known to be such, or `NONE`;
    `reason`: of one that is.
    """
    unknown = Check(ClaimId(maker, "lipschitz"), claim, Verdict.UNKNOWN, NONE)
    loose = [s.name for s in (*plant.states, *plant.inputs) if not s.bounded]
    if loose:
        return replace(unknown, reason=because("no range is declared for {names}", names=loose))
    if doubt:
        return replace(unknown, reason=doubt)
    check = replace(lipschitz(maker, rows, plant, name), claim=claim)
    if check.verdict is not Verdict.PROVED:
        return check
    return replace(check, reason=reason, proofs=())  # what bounds the slope in x says nothing of that in z


def _defined(e: sp.Expr, around: Box, boxes: int) -> bool:
    if not singular([exact(e)], around):
        return True
    problem = problem_of(e, around)
    return problem is not None and problem.search(everywhere, boxes).defined


def undefined(expressions: Iterable[sp.Expr], plant: System) -> sp.Expr | None:
    """The first expression that is not proved to be finite and real on the whole box."""
    box_x = box(plant.signals, plant.nominal)
    doubtful = (e for e in dict.fromkeys(expressions) if not (e.is_number or e.is_polynomial()))
    return next((e for e in doubtful if not _defined(e, box_x, BOXES)), None)


# ---------------------------------------------------------------- evidence of Phi = (y, y', .., y^(n-1))


class Derivatives:
    """The chain of y and its derivatives."""

    def evidence(self, form: Form) -> Evidence | None:
        """Phi = (y, y', ..), in the plant's states, its inputs and their derivatives."""
        Phi = _derivatives(form)
        return {"chain": Phi} if Phi else None


class FullRank:
    """det dPhi/dx away from zero."""

    def evidence(self, form: Form) -> Evidence | None:
        """The range of the determinant on the box of the plant."""
        J = _jacobian(form)
        return None if J is None else _enclosed(form, determinant(J.tolist()).value)


@dataclass(frozen=True)
class OneToOne:
    """All principal minors of weighted rows of dPhi/dx above zero."""

    weights: Weights

    def evidence(self, form: Form) -> Evidence | None:
        """The weights, and the range of each minor on the box of the plant."""
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
    """The range of a determinant of the plant's signals, with the derivatives of its inputs."""
    system, det = form.system, exact(determinant)
    known = [u.derivative(k) for u in system.inputs for k in range(form.n)]
    every = box((*known, *system.signals), system.nominal)
    where = {s: every[s] for s in sorted(det.free_symbols, key=str)}
    return enclosure(form, det, nonzero(det, where).range, where)


def _jacobian(form: Form) -> sp.Matrix | None:
    """dPhi/dx of the plant as it was declared; None of one in other coordinates."""
    Phi = _derivatives(form)
    return None if Phi is None else sp.Matrix([[entry.diff(x) for x in form.system.states] for entry in Phi])


def _derivatives(form: Form) -> tuple[sp.Expr, ...] | None:
    """Phi of the plant as it was declared; None of one in other coordinates."""
    system = form.system
    if system.origin is not None:
        return None
    return derivatives(exact(system.output[0]), rates(without_rates(system), form.n), form.n)
