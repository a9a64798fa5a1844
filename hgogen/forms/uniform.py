"""The uniform form for one output: z_i' reads z_1..z_(i+1), with a partial derivative by z_(i+1) that is never 0.

    z_i' = F_i(z_1..z_{i+1}, u),   z_n' = F_n(z, u),   y = h(z_1, u),
    dh/dz_1 and dF_i/dz_{i+1} bounded away from zero on the box of states, inputs and parameters.

z is a permutation of the plant's state. The state is then uniquely determined by y, y', .. for every input. The
triangular coordinates of the theorem are

    xi_1 = z_1,   xi_{i+1} = (prod_{k=1..i-1} dF_k/dz_{k+1}) F_i,

whose Jacobian is triangular with the diagonal prod_{k<=i} dF_k/dz_{k+1}; their rates depend on u', and on no higher
derivative of u. This form stays in z: A z are the terms that are linear in a state, b the other terms of F.

H. Hammouri, M. Farza, "Nonlinear observers for locally uniformly observable systems", ESAIM: COCV 9 (2003).
"""

from dataclasses import replace

from hgogen.analysis.chain import Shape, levelwise, of_plant, structure, without_jumps
from hgogen.analysis.coordinates import coordinates, form_in
from hgogen.analysis.hypotheses import AwayFromZero, Vanishing, lipschitz, nonzero_slope
from hgogen.analysis.undefined import if_valued
from hgogen.check import ClaimId
from hgogen.form import Form, SurveySettings, one_output
from hgogen.system import System

_ONE = ", and the uniform form takes one; keep one of them, or use the form block_triangular"


@SurveySettings(2, most=1)
def uniform(plant: System) -> Form:
    """Return the plant in uniform form z_i' = F_i(z_1..z_(i+1), u), y = h(z_1, u), by permutation of its states.

    Checks: `uniform.structure`; `uniform.slope_1` (dh/dz_1) .. `uniform.slope_n` (dF_{n-1}/dz_n), each bounded away
    from zero; `uniform.lipschitz` (F and h are Lipschitz in the state). A plant without the structure keeps its own
    order and has only that check.

    Raises: `OneOutput`.
    """
    one_output(plant, _ONE)
    chains = levelwise(of_plant(plant))
    answer = chains.answer(Shape.UNIFORM)
    ordered = not chains.broken and answer[0] is not False
    z = coordinates(plant, chains.order if ordered else None)
    claim = "y shows one state, and each equation brings in one new state"
    checks = [structure("uniform", claim, answer, "Measure another output.")]
    if ordered:
        for i, link in enumerate(chains.links[0], 1):
            name = f"dF_{i - 1}/dz_{i}" if i > 1 else "dh/dz_1"
            alone = nonzero_slope(ClaimId("uniform", "slope", i), name, link.slope, plant)
            # the slope does not prove that the row is continuous and that the plant is defined
            check = if_valued(replace(alone, proofs=(AwayFromZero(i),), disproof=Vanishing(i)), plant)
            checks.append(without_jumps(check, link))
        checks.append(lipschitz("uniform", (*plant.flow, *plant.output), plant, "F with the output"))
    return form_in(z, "uniform", checks, "Hammouri, Farza, ESAIM: COCV 9 (2003)")
