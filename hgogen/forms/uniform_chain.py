"""The uniform form as a chain of integrators, which needs first derivatives only, of inputs and of tables.

    z_i' = F_i(z_1..z_{i+1}, u),   z_n' = F_n(z, u),   y = c z_1 + o(u)
    xi_1 = c z_1,   xi_{i+1} = D_i F_i,   D_i = c prod_{k=1..i-1} dF_k/dz_{k+1}
    xi_i' = xi_{i+1} + b_i(xi_1..xi_i, u, u'),   b_i = sum_j<i dxi_i/dz_j F_j + dxi_i/du u',   y = xi_1 + o(u)

dxi/dz is triangular with the diagonal D_1..D_n: where the slopes are never 0, xi is a change of coordinates on the box.
The inverse x = Psi(xi, u) is solved row by row. Where that fails, the plant keeps its coordinates and the form carries
dxi/dx, which reads no derivative of an input. The user supplies u' where it occurs, as in the phase form.

H. Hammouri, M. Farza, "Nonlinear observers for locally uniformly observable systems", ESAIM: COCV 9 (2003). E.
Busvelle's slides also have F_2 of z_1, z_2, z_3 in xi_3.
"""

import sympy as sp

from hgogen.analysis.carried import ROUGH, TransformedPlant, by_construction, lipschitz_on_image, undefined
from hgogen.analysis.chain import Chains, Shape, levelwise, of_plant, without_jumps
from hgogen.analysis.hypotheses import nonzero_slope
from hgogen.analysis.maps import rates as rates_of
from hgogen.analysis.maps import size, without_derivative
from hgogen.analysis.undefined import if_valued
from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Form, NoForm, SurveySettings, one_output
from hgogen.rigor.box import exact
from hgogen.sentence import NONE, because
from hgogen.system import System

LIMIT = 20_000  # nodes of xi and b
_MAKER = "uniform_chain"
_OTHER = "the form original takes any plant with finite slopes"
_REFERENCE = "Hammouri, Farza, ESAIM: COCV 9 (2003)"


class NoUniformChain(NoForm):
    """The error that a plant is not proved to have coordinates xi with xi_i' = xi_(i+1) + b_i(xi_1..xi_i, u, u')."""


@SurveySettings(5, most=1, costly=True, slow=True)
def uniform_chain(plant: System, *, original: bool = False, recovered: bool = False) -> Form:
    """Return the plant as a chain of integrators xi_i' = xi_(i+1) + b_i(xi_1..xi_i, u, u'), y = xi_1 + o(u); or the
    plant in its own coordinates, with dxi/dx, where the map xi(x) has no inverse in formulas, or is not proved to be
    smooth and one to one.

    Args: `original`: the plant always keeps its coordinates; b and u' are then not needed. `recovered`: an observer
    evaluates b at Psi(xi), the inverse of xi(x), clamped to the plant's ranges, as it always does where b may have
    poles in the box of xi. No bound on theta is then proved.

    Checks: `uniform_chain.structure` (y depends on one state, each rate on one new state, and xi has no jump or kink);
    `uniform_chain.slope_1` (c) .. `uniform_chain.slope_n` (dF_{n-1}/dz_n), each bounded away from zero;
    `uniform_chain.smooth` (xi is differentiable and finite on the box); `uniform_chain.inputs` (u' has a range where it
    occurs); `uniform_chain.lipschitz` (b, as a function of xi).

    Raises: `NoUniformChain` for several outputs, a plant that is not proved to be in uniform form, or expressions of
    more than `LIMIT` nodes.
    """
    chains, c, offset = _read(plant)
    carried = _map(plant, chains, c, offset)
    smooth, (links,) = _smooth(carried), chains.links
    steep = [c, *(link.slope for link in links[1:])]
    names = ["dy/dz_1", *(f"dF_{i}/dz_{i + 1}" for i in range(1, len(links)))]
    slopes = [
        without_jumps(nonzero_slope(ClaimId(_MAKER, "slope", i), name, sp.sympify(slope), plant), link)
        for i, (name, slope, link) in enumerate(zip(names, steep, links, strict=True), 1)
    ]
    one_to_one = all(check.verdict is Verdict.PROVED for check in (smooth, *slopes))
    claim = "y = xi_1 up to a known offset, xi_i' = xi_(i+1) + b_i(xi_1, .., xi_i, u, u')"
    structure = by_construction(ClaimId(_MAKER, "structure"), claim, carried.Phi)
    claim = "b is Lipschitz in xi on the image of the box"
    obstacle = NONE if one_to_one else because("in xi it needs slopes that are never 0, and smooth rows")
    reason = because("b is Lipschitz in x, and xi is smooth, one to one and of full rank on a closed, bounded box")
    bounded = lipschitz_on_image(_MAKER, claim, carried.rows, carried.plant, "b", obstacle, reason)
    loose = "{names} must be supplied as inputs, {loose} without a range"
    inputs = carried.supplied([u.name for u in carried.known], loose, "Declare rates=((low, high),) of the input.")
    each = (structure, *slopes, smooth, inputs, bounded)
    checks = tuple(if_valued(check, plant) for check in each)
    back = carried.inverse()
    if original or back is None or not one_to_one:
        return carried.in_x(checks)
    return carried.in_z(back, checks, recovered)


def _read(plant: System) -> tuple[Chains, sp.Expr, sp.Expr]:
    """Return the order of the states z_i, and c and o(u) of y = c z_1 + o(u)."""
    one_output(plant, "; these coordinates take one", NoUniformChain)
    chains = levelwise(of_plant(plant))
    answer, why = chains.answer(Shape.UNIFORM)
    if answer is not True or chains.broken:
        raise NoUniformChain(plant.name, f"is not shown to be in uniform form: {why}; {_OTHER}")
    first = chains.links[0][0]
    c, offset = (sp.simplify(exact(sp.sympify(part))) for part in (first.gain, first.offset))
    if not (first.answer(Shape.CONSTANT)[0] and c.free_symbols <= {*plant.parameters}):
        measured = f"measures {exact(sp.sympify(first.row))}, not a constant times {first.state}"
        raise NoUniformChain(plant.name, f"{measured}; recast {first.state}, or use phase")
    return chains, c, offset


def _map(plant: System, chains: Chains, c: sp.Expr, offset: sp.Expr) -> TransformedPlant:
    """Return xi_1 = c z_1, xi_(i+1) = D_i F_i with b and the Jacobian dxi/dx. Raises: `NoUniformChain`."""
    z, n = chains.order, len(plant.states)
    changes = rates_of(plant, 1)
    plain = dict(zip(plant.states, (exact(sp.sympify(row)) for row in of_plant(plant).flow), strict=True))
    F = [plain[x] for x in z]
    D, xi = c, [c * z[0]]
    for i in range(n - 1):
        xi.append(D * F[i])
        D = D * F[i].diff(z[i + 1])
    rates = {u: changes[u] for u in plant.inputs}
    b = [
        sp.Add(
            *(xi[i].diff(z[j]) * F[j] for j in range(n if i == n - 1 else i)),
            *(xi[i].diff(u) * rate for u, rate in rates.items()),
        )
        for i in range(n)
    ]
    rough = without_derivative((*plant.flow, *plant.output))
    if any(e.has(*ROUGH) for e in (*xi, *b)):
        raise NoUniformChain(plant.name, f"has not the derivatives of these coordinates: {rough or 'something'}")
    if size([*xi, *b]) > LIMIT:
        raise NoUniformChain(plant.name, f"has coordinates of more than {LIMIT} nodes; use the form uniform")
    return TransformedPlant(_MAKER, _REFERENCE, plant, tuple(xi), tuple(b), 1, offset)


# ---------------------------------------------------------------- checks


def _smooth(carried: TransformedPlant) -> Check:
    id, claim = ClaimId(_MAKER, "smooth"), "xi is differentiable, and finite with its slopes, on the box"
    rough = without_derivative((*carried.Phi, *carried.jacobian))
    lost = undefined((*carried.Phi, *carried.jacobian), carried.plant)
    if rough:
        return Check(id, claim, Verdict.UNKNOWN, rough, fix="Write kinks as smooth functions, or use another form.")
    if lost is not None:
        reason = because("{part} was not shown to be finite on the box", part=lost)
        return Check(id, claim, Verdict.UNKNOWN, reason, fix="Narrow the ranges.")
    return Check(id, claim, Verdict.PROVED, because("by its terms and outward-rounded intervals"))
