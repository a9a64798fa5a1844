"""The phase form for one output: coordinates y, y', y'', ..; derivatives of inputs are known signals.

    z = Phi(x, u, u', ..) = (y, y', .., y^(n-1)),   z_i' = z_{i+1},   z_n' = phi(z, u, u', ..),   y = z_1

where det dPhi/dx is proved to have no zero on the box and the inverse x = Psi(z, u, ..) is found. Otherwise the plant
keeps its coordinates and the form carries dPhi/dx: an observer multiplies its correction by the inverse. Derivatives of
inputs that occur in these equations become inputs of the plant, and the user supplies them.

J.-P. Gauthier, H. Hammouri, S. Othman, "A simple observer for nonlinear systems, applications to bioreactors", IEEE
TAC 37 (1992); E. Bullinger, A. Ilchmann, F. Allgoewer, NOLCOS 1998, form (1).
"""

from dataclasses import replace

import sympy as sp

from hgogen.analysis.carried import (
    ROUGH,
    Derivatives,
    TransformedPlant,
    by_construction,
    full_rank,
    lipschitz_on_image,
    one_to_one,
)
from hgogen.analysis.determinant import determinant, readable_determinant
from hgogen.analysis.maps import rates, size, time_derivative, without_derivative
from hgogen.analysis.undefined import if_valued, on_box
from hgogen.check import ClaimId, Verdict
from hgogen.form import Form, NoForm, SurveySettings, one_output
from hgogen.rigor.box import exact
from hgogen.rigor.field import TooLarge
from hgogen.sentence import NONE, because
from hgogen.system import System

LIMIT = 20_000  # nodes of y .. y^(n)
_REFERENCE = "Gauthier, Hammouri, Othman, IEEE TAC 37 (1992)"
_RANGES = "Declare rates=((low, high), ..) of the input, one pair for each derivative."


class NoPhase(NoForm):
    """The error that a plant is not proved to have the coordinates z = (y, y', .., y^(n-1))."""


@SurveySettings(4, most=1, costly=True, slow=True)
def phase(plant: System, *, original: bool = False, recovered: bool = False) -> Form:
    """Return the plant in phase form z_i' = z_(i+1), z_n' = phi(z, u, u', ..), y = z_1, whose coordinates are the
    output and its derivatives, z = Phi(x, u, ..) = (y, y', .., y^(n-1)); or the plant in its own coordinates, with
    dPhi/dx, where Phi has no inverse in formulas, or its full rank is not proved.

    Args: `original`: the plant always keeps its coordinates; phi, and the derivatives of inputs that only phi contains,
    are then not needed. `recovered`: an observer evaluates phi at Psi(z), the inverse of Phi, clamped to the plant's
    ranges, as it always does where phi may have poles in the box of z. The image of the plant's box is often a thin
    part of the box of z; phi is far larger elsewhere and would require a larger theta. No bound on theta is proved with
    `recovered`.

    Checks: `phase.chain` (by construction, where the plant has a value and y .. y^(n-2) have derivatives);
    `phase.inputs` (the derivatives of inputs that occur have ranges); `phase.rank` (det dPhi/dx has no zero on the
    box); `phase.inverse` (Phi is one to one on the box); `phase.lipschitz` (phi, as a function of z).

    Raises: `NoPhase` for several outputs, or derivatives of more than `LIMIT` nodes; `BadSystem` where a signal has the
    name of an input's derivative.
    """
    carried = _map(plant)
    J, (*_, phi) = carried.jacobian.tolist(), carried.rows
    try:
        det = determinant(J)
    except TooLarge as error:
        raise NoPhase(plant.name, f"has no determinant of dPhi/dx here: {error}") from error
    regular = full_rank(carried, det.value, readable_determinant(J, det).value)
    # only where the plant is defined: (x1 x3)' = x2 holds for x1' = x2/x3, x3' = 0, but not at x3 = 0
    by_rates = by_construction(ClaimId("phase", "chain"), "y = z_1, z_i' = z_(i+1)", carried.Phi[:-1])
    chain = if_valued(replace(by_rates, proofs=(Derivatives(),)), plant)
    within = {s for e in carried.Phi for s in e.free_symbols}
    names = [u.name if u in within else because("{input} (phi alone)", input=u.name) for u in carried.known]
    inputs = carried.supplied(names, "{names} must be supplied as inputs; no range is declared for {loose}", _RANGES)
    rank, back = if_valued(regular, plant), carried.inverse()
    inverse = if_valued(one_to_one(carried, back, rank), plant)
    claim = "phi is Lipschitz in z on the image of the box"
    missing = [c.id for c in (rank, inverse) if c.verdict is not Verdict.PROVED]
    obstacle = because("in z it needs {checks: and }", checks=missing) if missing else NONE
    reason = because("phi is Lipschitz in x, and Phi is smooth, one to one and of full rank on a closed, bounded box")
    steep = lipschitz_on_image("phase", claim, [phi], carried.plant, "phi", obstacle, reason)
    checks = (chain, inputs, rank, inverse, steep)
    if original or back is None or regular.verdict is not Verdict.PROVED:
        return carried.in_x(checks)
    return carried.in_z(back, checks, recovered)


def _map(plant: System) -> TransformedPlant:
    """Return the plant in z = (y, y', .., y^(n-1)): z' = A
    z + b, where only the last entry phi of b is not 0."""
    n = len(plant.states)
    one_output(plant, "; the phase form takes one: keep one", NoPhase)
    plain = on_box(plant)
    flow, chain = rates(plain, n + 1), [exact(plain.output[0])]
    while len(chain) <= n:
        chain.append(time_derivative(chain[-1], flow))
        if size(chain) > LIMIT:
            reason = f"has derivatives of more than {LIMIT} nodes, at y^({len(chain) - 1}); use the form original"
            raise NoPhase(plant.name, reason)
    carried = TransformedPlant("phase", _REFERENCE, plant, (*chain[:n],), (*(sp.S.Zero,) * (n - 1), chain[n]), n)
    if any(e.has(*ROUGH) for e in (*chain, *carried.jacobian)):
        rough = without_derivative((*plant.flow, *plant.output)) or "something"
        raise NoPhase(plant.name, f"has no derivatives to order {n} here: {rough}")
    return carried
