"""Minimum-energy estimator of Hamilton-Jacobi theory, with a value function truncated after second order.

    minimise  |xhat(0) - x0|^2_P0 + integral of |xhat' - f(xhat)|^2_Q + |y - h(xhat)|^2_R
    xhat' = f + Pi^-1 h_x'R (y - h)
    Pi'   = -Pi f_x - f_x'Pi - Pi Q^-1 Pi + h_x'R h_x - s sum_j R_j (y_j - h_j) d2h_j,    Pi(0) = P0

2 Pi is the Hessian of the value function at its minimum xhat; its third derivatives are neglected, which is exact for a
linear model. Q, R, P0 are weights, the inverses of a Kalman filter's covariances: without the last term the estimator
is the extended Kalman filter with Q^-1, R^-1, P0^-1, and every method for its covariance P = Pi^-1 serves. The last
term could make Pi indefinite; the factor 0 <= s <= 1 keeps it positive definite (`stepping.discretise`). Source:
Alessandri, "On Hamilton-Jacobi approaches to state reconstruction for dynamic systems", Mathematical Problems in
Engineering (2020), (3), (18).
"""

from collections.abc import Iterable

import numpy as np
import sympy as sp

from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.hypotheses import clamped_lipschitz
from hgogen.analysis.linearised import evaluated
from hgogen.analysis.undefined import if_valued
from hgogen.check import Check, ClaimId, Claims, Verdict
from hgogen.estimators.noise import declares_weights
from hgogen.estimators.riccati_part import Riccati, cap, factor, positive_gain, positive_numbers, spd
from hgogen.estimators.theta import KALMAN, OTHER_COORDINATES, constant
from hgogen.form import Form
from hgogen.observer import Observer, demand_form, gain, state_field
from hgogen.part import Jump, Pieces
from hgogen.program import Bit, Block, Field, Place, sym
from hgogen.reading.given import BadGain, Matrix, Values, by_coordinate, by_output, matrix_line, names_of, real
from hgogen.rigor.slope import JUMPS
from hgogen.sentence import because
from hgogen.starting import starts
from hgogen.stepping.discretise import MinimumEnergy
from hgogen.theorem import Hypothesis

REFERENCE = (
    "Alessandri, On Hamilton-Jacobi approaches to state reconstruction for dynamic systems, "
    "Mathematical Problems in Engineering (2020), (18)"
)
EQUATIONS = ("xhat' = f + Pi^-1 h_x' R (y - h)", "Pi' = -Pi f_x - f_x' Pi - Pi Q^-1 Pi + h_x' R h_x", "P = Pi^-1")
CURVED = (*EQUATIONS[:1], f"{EQUATIONS[1]} - s sum_j R_j (y_j - h_j) d2h_j", EQUATIONS[2])
THEOREM = KALMAN.under(
    Hypothesis(
        "the value function is quadratic, so that the estimate minimises the cost",
        (Claims("hamilton_jacobi", "quadratic"),),
        reference="(16)-(18)",
    )
)

LIMITED = Bit(
    "COVARIANCE_LIMITED",
    "P = Pi^-1 reached its cap: a long loss of measurements, or weights much too small for the declared ranges",
    "wait for measurements; if it stays while they come, scale the weights Q and R up together",
)


@starts(  # the weights are the inverses of the covariances that a Kalman filter starts with
    "you prefer to choose the weights of a cost function",
    "as `riccati`; the curvature of the output is optional",
    "n(n+3)/2",
    lambda scale: {"Q": scale.density(-1), "P0": scale.start(-1), "R": scale.variance(-1)},
)
@declares_weights
def hamilton_jacobi(
    form: Form,
    *,
    Q: Matrix,
    R: float | Values,
    P0: Matrix | None = None,
    curvature: float = 0.0,
    initial: Values | None = None,
    accept: Iterable[str] = (),
) -> Observer:
    """The minimum-energy estimator z' = f + Pi^-1 h_z'R (y - h), Pi' = -Pi f_z - f_z'Pi - Pi Q^-1 Pi + h_z'R h_z - s
    sum_j R_j (y_j - h_j) d2h_j/dz2, 0 <= s <= 1, on any form, of any number of outputs.

    Args: weights by the names of the form's coordinates, or in their order: `Q` of the model's error, diagonal (n) or
    symmetric positive definite (n, n), unit s/z^2; `R` positive, one for each output, unit 1/(y^2 s) (for white noise
    of variance v per sample, R = 1/(v dt)); `noise`, `R_per_sample`, `Q_per_sample` in place of these, and `density`,
    are of the noise, not its inverse, as in `riccati`; `P0` of the initial error, in the same format as Q, unit 1/z^2,
    default the unit matrix. `curvature`: the largest rate (1/s) at which the outputs' second derivatives may change Pi;
    0 omits them. With them every method integrates (z, Pi) or (z, P) by a Runge-Kutta method. `initial` the plant's
    state; `accept` ids of refuted checks to ignore.

    Checks: `hamilton_jacobi.quadratic` (proved for a model that is affine in the state, else unknown);
    `hamilton_jacobi.lipschitz` in coordinates other than the plant's states.

    Raises: `Refuted`; `BadNames`; `BadGain` for weights of another shape or not positive, and a negative rate;
    `Singular` for a model whose Jacobian is finite nowhere.
    """
    accept = demand_form("hamilton_jacobi", form, accept, linearises=True)
    n, outputs, dynamics = form.n, len(form.output), Dynamics(form, tangent=True)
    weight = spd("Q", by_coordinate("Q", Q, form), n)
    start = spd("P0", np.ones(n) if P0 is None else by_coordinate("P0", P0, form), n)
    precisions, rate = positive_numbers("R", by_output("R", R, form), outputs), real("curvature", curvature)
    if not 0 <= rate < np.inf:
        raise BadGain(f"curvature = {curvature!r}", "must be a finite rate (1/s), not negative; 0 leaves the term out")
    noise, covariance, variances = _inverse("Q", weight), _inverse("P0", start), tuple(1 / r for r in precisions)
    upper, weights = (each[::-1] for each in factor(weight[::-1, ::-1]))  # Q = U W U', U unit upper triangular
    shape = np.linalg.inv(upper[:, ::-1]).T  # so that Q^-1 = shape W^-1 shape'
    z = state_field(form, initial, 1.0)
    plain = Riccati(
        dynamics=dynamics,
        z=z,
        theta=constant(1.0),
        weights=sym("derived", "Q_inverse", n),
        factor=shape,
        R=1 / sym("gain", "R", outputs),
        covariance=covariance,
        cap=cap(dynamics, z, noise, variances, covariance, 1.0),
        limited=LIMITED,
        nominal=(noise, np.array(variances)),
    )
    u = sym("work", "u", len(form.system.inputs))
    curved = rate > 0 and any(slope.nnz() for slope in dynamics.output_curvature(sym("state", "z", n), u))
    part = MinimumEnergy(plain, sym("gain", "curvature"), rate) if curved else plain
    inverse = Field("Q_inverse", (0.0,) * n, unit="z^2/s", meaning="inverse of Q, diagonal factor")
    inverted = Block("inverse weights", {Place("derived", "Q_inverse"): 1 / sym("gain", "Q", n)})
    return Observer(
        form=form,
        name="hamilton_jacobi",
        parts=(Jump(lambda clock: Pieces(derived=(inverse,), tune=(inverted,))), part),
        gains=(
            positive_gain("Q", weights, "weight of the model's error", "s/z^2", form.names),
            positive_gain("R", precisions, "weight of the output", "1/(y^2 s)", names_of(form.system.outputs)),
            *([gain("curvature", rate, rate / 1e6, rate, "largest rate of the curvature term", "1/s")] * curved),
        ),
        z=sym("state", "z", n),
        dynamics=dynamics,
        claims=lambda: (*form.checks, *evaluated(form), *clamped_lipschitz("hamilton_jacobi", form), _quadratic(form)),
        accepted=accept,
        theorem=THEOREM if form.jacobian is None else THEOREM.under(OTHER_COORDINATES),
        equations=(*(CURVED if curved else EQUATIONS), *matrix_line("Q", weight, form)),
        reference=REFERENCE,
    )


def _inverse(name: str, matrix: np.ndarray) -> np.ndarray:
    inverse = np.linalg.inv(matrix)
    return spd(f"the inverse of {name}", (inverse + inverse.T) / 2, len(matrix))


def _quadratic(form: Form) -> Check:
    rows = sp.Matrix([*form.flow, *form.output])
    affine = not rows.has(*JUMPS) and not rows.jacobian(form.states).free_symbols & {*form.states}
    check = Check(
        ClaimId("hamilton_jacobi", "quadratic"),
        "the value function is quadratic, so that the estimate minimises the cost",
        Verdict.PROVED if affine else Verdict.UNKNOWN,
        because("the model is affine in the state")
        if affine
        else because("its third derivatives are left out: an approximation near its minimum"),
    )
    return if_valued(check, form.system)
