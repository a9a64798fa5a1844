"""The default for firmware: predict between samples, correct at a sample, covariance as P = L D L'.

    z  <- one classical Runge-Kutta step of z' = f(z, u)
    P  <- Phi P Phi' + h Q_theta,  Phi = I + h F + (h F)^2/2,  F at the step's midpoint      (Thornton)
    at a valid sample of y_j, with r = R_j/(theta h), c = dh_j/dz:
       alpha = r + c P c',  K = P c'/alpha,  z <- z + K (y_j - h_j),  P <- P - K c P          (Bierman)

No square root, positive definite by construction, no limit on h from the covariance. Differential equations that are no
Riccati observer go by classical Runge-Kutta. Source: Boizot, Busvelle, Gauthier, ECC 2009 (continuous-discrete case);
the factored updates are Thornton's and Bierman's.
"""

from dataclasses import dataclass
from functools import reduce

import casadi as ca

from hgogen.covariance import factor, measurement_update, pack_unit_lower, time_update, unit_lower
from hgogen.method import Explicit
from hgogen.observer import Clock, Ode, Pieces, Riccati
from hgogen.program import Bit, Block, Field, Program, When, column, sym
from hgogen.runge_kutta import RK4, advance

# Below this a variance counts as 0; L stays within +-LARGEST: both only catch rounding and drop-outs.
SMALLEST, LARGEST = 1e-20, 1e9

CAPPED = Bit(
    "COVARIANCE_LIMITED",
    "the covariance reached its cap, as after a long loss of measurements",
    "none; the estimate is poor until measurements return",
)


@dataclass(frozen=True)
class ContinuousDiscrete:
    """See the module."""

    name: str = "continuous-discrete, L D L'"

    def ode(self, part: Ode, clock: Clock) -> Pieces:
        """By classical Runge-Kutta."""
        return Explicit(RK4, "information").ode(part, clock)

    def riccati(self, part: Riccati, clock: Clock) -> Pieces:
        """Predict, then one scalar update for each output."""
        return Pieces(
            fields=(part.z, *_factors(part)),
            bits=(CAPPED,),
            predict=(_predict_state(part, clock), *_cap(part)),
            update=tuple(_update(part, clock, j) for j in range(clock.outputs)),
        )


continuous_discrete = ContinuousDiscrete()


def _factors(part: Riccati) -> tuple[Field, ...]:
    n = part.dynamics.n
    start, diagonal = factor(part.covariance)
    lower = tuple(float(start[i, j]) for j in range(n) for i in range(j + 1, n))
    labels = tuple(f"{i + 1},{j + 1}" for j in range(n) for i in range(j + 1, n))
    size = len(lower)
    d = Field(
        "D",
        tuple(float(value) for value in diagonal),
        low=(SMALLEST,) * n,
        high=tuple(float(value) for value in part.cap),
        meaning="diagonal factor of the covariance P = L D L'",
    )
    if not lower:
        return (d,)
    L = Field(
        "L",
        lower,
        low=(-LARGEST,) * size,
        high=(LARGEST,) * size,
        labels=labels,
        meaning="unit lower factor of P, strict lower triangle by columns",
    )
    return (L, d)


def _symbols(part: Riccati) -> tuple[ca.SX, ca.SX, ca.SX]:
    n = part.dynamics.n
    lower = unit_lower(sym("state.L", n * (n - 1) // 2), n) if n > 1 else ca.SX.eye(1)
    return sym(f"state.{part.z.name}", n), lower, sym("state.D", n)


def _written(L: ca.SX, d: ca.SX) -> dict[str, ca.SX]:
    return {"state.L": pack_unit_lower(L), "state.D": d} if d.numel() > 1 else {"state.D": d}


def _predict_state(part: Riccati, clock: Clock) -> Block:
    z, L, d = _symbols(part)
    h, n = clock.dt, part.dynamics.n
    stages = advance(RK4, lambda v, c: {"z": part.dynamics.flow(v["z"], clock.u(c))}, {"z": z}, h)
    F = part.dynamics.jacobian(stages.arguments[2]["z"], clock.u(0.5))
    transition = ca.sparsify(ca.SX.eye(n) + h * F + (h * h / 2) * (F @ F))
    weights = h * part.theta * part.weights
    L, d, names = time_update(L, d, transition, part.scaled_factor(), weights)
    Phi = {f"Phi_{i + 1}{j + 1}": transition[i, j] for i in range(n) for j in range(n) if transition[i, j].n_dep()}
    return Block(
        "z by classical Runge-Kutta; P = L D L' by P <- Phi P Phi' + h Q_theta",
        {f"state.{part.z.name}": stages.result["z"], **_written(L, d)},
        {**stages.names, **Phi, **names},
    )


def _cap(part: Riccati) -> Program:
    """Where P_ii exceeds its cap scale row i of the factor, a congruence: P stays positive definite."""
    _, L, d = _symbols(part)
    n = part.dynamics.n
    variance = column(ca.dot(L[i, :].T ** 2, d) for i in range(n))
    caps = [float(value) for value in part.cap]
    tests = [variance[i] > caps[i] for i in range(n)]
    scale = ca.vertcat(*(ca.sqrt(ca.fmin(1, caps[i] / variance[i])) for i in range(n)))
    test = Block("largest variances", {"work.capped": reduce(ca.logic_or, tests)})
    scaled = ca.diag(scale) @ L @ ca.diag(1 / scale)
    apply = Block("cap", {**_written(scaled, scale**2 * d), "status.COVARIANCE_LIMITED": ca.SX(1)})
    return (test, When("work.capped", (apply,)))


def _update(part: Riccati, clock: Clock, output: int) -> Program:
    z, L, d = _symbols(part)
    row = ca.sparsify(part.dynamics.output_jacobian(z, clock.u(1.0))[output, :])
    variance = part.R[output] / (part.theta * clock.dt)
    L, d, gain = measurement_update(L, d, row, variance)
    return (
        Block(
            "correct by the scalar update",
            {f"state.{part.z.name}": z + gain * sym("work.e"), **_written(L, d)},
            {f"K{i + 1}": gain[i] for i in range(part.dynamics.n)},
        ),
    )
