"""The triangular (observability canonical) form for one output.

    z' = A(u) z + b(z, u),   y = C(u) z,
    A = superdiagonal a_2(u)..a_n(u),   C = (a_1(u), 0..0),   0 < a_m <= a_i(u) <= a_M,
    b_i of z_1..z_i and u only, Lipschitz; where it is asked for, a_i(u, z_1) for i >= 2, with a_i z_i Lipschitz,
    so that (a_i(u, z_1) - a_i(u, x_1)) x_i counts as b does.

z is the plant's state in another order, some with the other sign. The order follows the dependencies: the
output brings in one state, that state's derivative the next, and so on. A known offset c(u), as in
y = a_1(u) z_1 + c(u), stays in the output; it changes no innovation.

N. Boizot, E. Busvelle, J.-P. Gauthier, "An adaptive high-gain observer for nonlinear systems", Automatica 46
(2010), form (3).
"""

from dataclasses import dataclass, replace

import sympy as sp

from hgogen.check import Check, ClaimId, Verdict
from hgogen.errors import HgogenError
from hgogen.evidence.grounds import ByForm
from hgogen.form import Asking, Form
from hgogen.sentence import Reason
from hgogen.structure.chain import Chains, Shape, levelwise, of_plant
from hgogen.structure.chord import settled, signs_of
from hgogen.structure.coordinates import coordinates, form_in
from hgogen.structure.defined import defined
from hgogen.structure.lipschitz import lipschitz
from hgogen.structure.positive import positive, sign
from hgogen.system import System

_REFERENCE = "Boizot, Busvelle, Gauthier, Automatica 46 (2010), form (3)"


@dataclass(eq=False)
class OneOutput(HgogenError):
    """The triangular form is for one output."""

    system: str
    outputs: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"system {self.system!r} has {len(self.outputs)} outputs, {', '.join(self.outputs)}, and the "
            "triangular form takes one; keep one of them, or use the form original (block forms are for several)"
        )


@Asking(1, ({}, {"measured": True}), most=1)
def triangular(plant: System, *, measured: bool = False) -> Form:
    """The plant in triangular form, by permutation and sign.

    Args: `measured` lets a_2..a_n vary with the measured state z_1 as well, A(u, z_1).

    The form is the plant whatever the verdicts: where the structure is not shown, b keeps what A does not hold. A
    plant whose structure is refuted comes back in its own order with that one check; observers refuse it.

    Checks: `triangular.structure`; `triangular.a_1`..`triangular.a_n` (0 < a_m <= a_i <= a_M on the box of
    inputs, parameters and, where a_i varies with it, z_1); `triangular.offset` (c is defined there) where there is
    one; `triangular.lipschitz`, of b and the a_i(u, z_1) z_i.

    Raises: `OneOutput`.
    """
    if len(plant.outputs) != 1:
        raise OneOutput(plant.name, tuple(y.name for y in plant.outputs))
    shape, rows = Shape.MEASURED if measured else Shape.CONSTANT, of_plant(plant)
    chains = levelwise(rows)
    answer, why = chains.answer(shape)
    if answer is False or chains.broken:
        verdict = Verdict.REFUTED if answer is False else Verdict.UNKNOWN
        refused = _structure(verdict, why, _fix(chains, shape, plant))
        return form_in(coordinates(plant), "triangular", (refused,), _REFERENCE)
    links = [settled(link, shape, plant, chains.order[0]) for link in chains.links[0]]
    z = coordinates(plant, chains.order, signs_of(links, plant))
    before = (1, *z.signs)
    a = [s * link.gain * t for s, link, t in zip(before, links, z.signs, strict=False)]
    A = sp.ImmutableDenseMatrix(len(a), len(a), lambda i, j: z.carry(a[j]) if j == i + 1 else 0)
    offset, *rest = (s * z.carry(link.rest) for s, link in zip(before, links, strict=False))
    b = (*rest, z.flow[-1])
    checks = [
        _structure(Verdict.PROVED if answer else Verdict.UNKNOWN, why, ""),
        *(positive(ClaimId("triangular", "a", i), f"a_{i}", gain, plant) for i, gain in enumerate(a, 1)),
    ]
    c = links[0].rest
    if c != 0 and c.free_symbols.isdisjoint(plant.states):
        checks.append(defined(ClaimId("triangular", "offset"), "c", c, plant))
    parts = A, b, (a[0] * z.states[0] + offset,)
    form = form_in(z, "triangular", checks, _REFERENCE, parts=parts)
    name = "b" if form.nonlinear == form.b else "b, with the a_i(z_1) z_i,"
    steep = lipschitz("triangular", map(z.back, form.nonlinear), plant, name)
    return replace(form, checks=(*form.checks, steep))


def _structure(verdict: Verdict, reason: Reason, fix: str) -> Check:
    id, claim = ClaimId("triangular", "structure"), "each row brings in one new state, linearly"
    if verdict is Verdict.PROVED:
        return Check(id, claim, verdict, reason, proofs=(ByForm(),))
    return Check(id, claim, verdict, reason, fix=fix)


def _fix(chains: Chains, shape: Shape, plant: System) -> str:
    """A form that the same chain may have, else what any plant has left."""
    if shape is Shape.CONSTANT and chains.answer(Shape.MEASURED)[0]:
        return "Let slopes vary with the measured state, by the form's option measured, which riccati takes."
    if chains.answer(Shape.UNIFORM)[0] and all(sign(link.slope, plant) for link in chains.links[0]):
        return "Use the form uniform, for slopes that vary and keep off zero, which riccati takes."
    return "Measure another output."
