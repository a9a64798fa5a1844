"""The uniform form for one output: each row brings in one new state, with any slope that does not vanish.

    z_i' = F_i(z_1..z_{i+1}, u),   z_n' = F_n(z, u),   y = h(z_1, u),
    dh/dz_1 and dF_i/dz_{i+1} bounded away from zero on the box of states, inputs and parameters.

z is the plant's state in another order. The state is then uniquely determined by y, y', .. for every input. The
triangular coordinates of the theorem are

    xi_1 = z_1,   xi_{i+1} = (prod_{k=1..i-1} dF_k/dz_{k+1}) F_i,

whose Jacobian is triangular with the diagonal prod_{k<=i} dF_k/dz_{k+1}; of the derivatives of u only u' enters their
rates. This form stays in z: A z are the terms that are linear in a state, b the rest of F.

H. Hammouri, M. Farza, "Nonlinear observers for locally uniformly observable systems", ESAIM: COCV 9 (2003).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import sympy as sp

from hgogen.algebra.kinks import slope
from hgogen.algebra.points import exact
from hgogen.analysis.written import if_valued
from hgogen.check import Check, ClaimId, Verdict
from hgogen.errors import HgogenError
from hgogen.evidence.enclosing import enclosure, point, sides
from hgogen.evidence.grounds import ByForm, Evidence
from hgogen.form import Asking, Form
from hgogen.intervals.bounds import bound
from hgogen.intervals.sign import Cause, nonzero
from hgogen.structure.apart import apart, without_jumps
from hgogen.structure.chain import Shape, levelwise, of_plant
from hgogen.structure.coordinates import coordinates, form_in
from hgogen.structure.lipschitz import lipschitz
from hgogen.system import System


@dataclass(frozen=True)
class Slope:
    """dh/dz_1 for `index` 1, else dF_(index-1)/dz_index."""

    index: int

    def of(self, form: Form) -> sp.Expr:
        """The slope, exactly."""
        rate = form.output[0] if self.index == 1 else form.flow[self.index - 2]
        return slope(exact(sp.sympify(rate)), form.states[self.index - 1])


class AwayFromZero(Slope):
    """A slope that is away from zero on the box of states, inputs and parameters."""

    def evidence(self, form: Form) -> Evidence | None:
        """Its range."""
        dF = self.of(form)
        where = sides(form, dF.free_symbols)
        bounds = bound(dF, where)
        return enclosure(form, dF, bounds if bounds.low > 0 or bounds.high < 0 else nonzero(dF, where).range)


class Vanishing(Slope):
    """A slope that is zero somewhere, or has both signs."""

    def evidence(self, form: Form) -> Evidence | None:
        """A point where it is zero, or two where it has opposite signs; None where no such point is exact."""
        dF = self.of(form)
        where = sides(form, dF.free_symbols)
        sign = nonzero(dF, where)
        least, most = sign.range.least, sign.range.most
        points: dict[str, Mapping[Any, Any]] = {}
        if least is not None and most is not None and least.value < 0 < most.value:
            points = {"witness": least.point, "other": most.point}
        elif sign.cause is Cause.ZERO:
            points = {"witness": sign.witness}
        return {"expression": dF, **{key: point(at, where) for key, at in points.items()}} if points else None


@dataclass(eq=False)
class OneOutputOnly(HgogenError):
    """The uniform form is for one output."""

    system: str
    outputs: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"system {self.system!r} has {len(self.outputs)} outputs, {', '.join(self.outputs)}, and the uniform form "
            "takes one; keep one of them, or use the form block_triangular"
        )


@Asking(2, most=1)
def uniform(plant: System) -> Form:
    """The plant in uniform form, by permutation.

    Checks: `uniform.structure`; `uniform.slope_1` (dh/dz_1) .. `uniform.slope_n` (dF_{n-1}/dz_n), each bounded away
    from zero; `uniform.lipschitz` (F and h are Lipschitz in the state). A plant without the structure comes back in
    its own order with that one check.

    Raises: `OneOutputOnly`.
    """
    if len(plant.outputs) != 1:
        raise OneOutputOnly(plant.name, tuple(y.name for y in plant.outputs))
    chains = levelwise(of_plant(plant))
    answer, why = chains.answer(Shape.UNIFORM)
    verdict = Verdict.PROVED if answer else Verdict.UNKNOWN if answer is None else Verdict.REFUTED
    ordered = not chains.broken and answer is not False
    z = coordinates(plant, chains.order if ordered else None)
    claim, fix = "y shows one state, each row brings in one new one", "" if answer else "Measure another output."
    proofs = (ByForm(),) if answer else ()
    checks = [Check(ClaimId("uniform", "structure"), claim, verdict, why, fix=fix, proofs=proofs)]
    if ordered:
        for i, link in enumerate(chains.links[0], 1):
            name = f"dF_{i - 1}/dz_{i}" if i > 1 else "dh/dz_1"
            alone = apart(ClaimId("uniform", "slope", i), name, link.slope, plant)
            # what the slope does not show: that the row jumps nowhere, and that the plant has a value
            check = if_valued(replace(alone, proofs=(AwayFromZero(i),), disproof=Vanishing(i)), plant)
            checks.append(without_jumps(check, link))
        checks.append(lipschitz("uniform", (*plant.flow, *plant.output), plant, "F with the output"))
    return form_in(z, "uniform", checks, "Hammouri, Farza, ESAIM: COCV 9 (2003)")
