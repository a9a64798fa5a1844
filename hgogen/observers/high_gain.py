"""Standard high-gain observer with a constant gain.

    z' = A z + b(sat z, u) + diag(theta, theta^2, ..., theta^n) K (y - C z),   A, C constant, A - K C Hurwitz

The argument of b is saturated to the declared box, the linear part never. On a plant in its own coordinates with the
Jacobian of Phi = (h, L h, .., L^(n-1) h), forms.phase,

    z' = f(sat z, u) + (dPhi/dx)^-1(sat z, u, u', ..) diag(theta, .., theta^n) K (y - h(z, u)),

without correction where |det dPhi/dx| is at most `singular` times its largest value on the box. Source: Gauthier,
Hammouri, Othman 1992; in the form of Astolfi, Jungers, Zaccarian 2018, (3).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.certified import checks, of_poles
from hgogen.check import Verdict
from hgogen.clamped import clamped
from hgogen.dynamics import Dynamics
from hgogen.form import Form
from hgogen.gains import coefficients
from hgogen.graph import to_casadi
from hgogen.observer import BadGain, Observer, Ode, founded, high_gain_parameter, real, state_field
from hgogen.program import Block, Field, sym
from hgogen.theorem import FORM, OPERATION, Hypothesis, Theorem

REFERENCE = "Gauthier, Hammouri, Othman, A simple observer for nonlinear systems, IEEE TAC 37 (1992)"
_STANDARD = "z' = A z + b(sat z, u) + diag(theta, .., theta^n) K (y - C z)"
_ORIGINAL = "z' = f(sat z, u) + (dPhi/dx)^-1 diag(theta, .., theta^n) K (y - h(z, u)), Phi = (h, L h, .., L^(n-1) h)"
THEOREM = Theorem(
    "the estimate converges exponentially from any initial state",
    (
        *FORM,
        Hypothesis("A - K C is Hurwitz", verdict=Verdict.PROVED, reason="by its poles; others are refused"),
        Hypothesis(
            "theta is large enough", ("high_gain.theta",), reason="of its declared value; it can be tuned down to 1"
        ),
        *OPERATION,
    ),
    REFERENCE,
)
INSIDE = Hypothesis(
    "the estimate keeps to the declared ranges",
    reason="watch the status OUTSIDE_BOX: beyond them dPhi/dx is taken at their edge, not at the estimate",
)


def high_gain(
    form: Form,
    *,
    theta: float,
    poles: Sequence[complex],
    initial: Mapping[str, float] | Sequence[float] | None = None,
    singular: float = 1e-3,
    accept: Iterable[str] = (),
) -> Observer:
    """The standard high-gain observer on a form z_i' = a_i z_(i+1) + b_i whose A does not depend on the input, or in
    the plant's coordinates on a form that carries dPhi/dx.

    Checks: `high_gain.convergence` (a bound on theta is proved), `high_gain.theta` (theta is above it);
    `high_gain.lipschitz` in coordinates other than the plant's states (b on the whole box of z).

    Args: `theta` >= 1; `poles` (n) of A - K C, negative real parts, the observer's linear core has them times theta;
    `initial` the plant's state; `singular` (0..1) switches the correction off near a zero of det dPhi/dx, where that
    is not proved to have none; `accept` ids of refuted checks to build on all the same.

    Raises: `Refuted`; `BadPoles`; `BadGain` for theta < 1, several outputs, or an A that depends on the input.
    """
    accept = founded("high_gain", form, accept)
    n, dynamics = form.n, Dynamics(form)
    high = high_gain_parameter(theta)
    theta = high.initial[0]
    chain = _chain(form)
    p = coefficients(poles, n)
    products = [sp.prod(chain[: i + 1]) for i in range(n)]
    z = state_field(form, initial, theta)
    place = sym("gain.theta")
    tuned = [sp.Float(p[i]) / products[i] for i in range(n)]
    parameters = {s: sym(f"plant.{s.name}") for s in form.system.parameters if s.bounded}
    fixed = {s: v for s, v in form.system.nominal.items() if not s.bounded}
    scaled = _graphs([g.subs(fixed) for g in tuned], parameters, place)
    least = _least(dynamics, singular)
    labels = tuple(f"theta^{i + 1} K_{i + 1}" if i else "theta K_1" for i in range(n))
    part = replace(
        _in_chain(form, dynamics) if form.jacobian is None else _in_original(dynamics, least, theta, p),
        fields=(z,),
        derived=(Field("K", (0.0,) * n, labels=labels, meaning="observer gain"),),
        tune=(Block("observer gain", {"derived.K": scaled}),),
    )
    return Observer(
        form=form,
        name="high_gain",
        parts=(part,),
        gains=(high,),
        z=sym("state.z", n),
        dynamics=dynamics,
        checks=(*form.checks, *clamped("high_gain", form), *checks("high_gain", theta, of_poles(form, p))),
        accepted=accept,
        theorem=THEOREM if form.jacobian is None else THEOREM.under(INSIDE),
        equations=(_ORIGINAL if form.jacobian is not None else _STANDARD,),
        reference=REFERENCE,
        notices=_notices(dynamics, least) if least > 0 else (),
    )


def _in_chain(form: Form, dynamics: Dynamics) -> Ode:
    """z' = A z + K (y - C z - offset), and b."""
    n, still = dynamics.n, ca.SX.zeros(len(form.system.inputs))
    A, C, K = dynamics.linear(still), dynamics.output_jacobian(ca.SX.zeros(n), still), sym("derived.K", n)

    def linear(values: Mapping[str, Any], y: Any, valid: Any) -> dict[str, Any]:
        return {"z": A @ values["z"] + K * (valid * (y - C @ values["z"]))}

    def rest(values: Mapping[str, Any], u: Any, y: Any, valid: Any) -> dict[str, Any]:
        return {"z": dynamics.nonlinear(values["z"], u)}

    return Ode((), rest, linear, lambda u: dynamics.output(ca.SX.zeros(n), u))


def _in_original(dynamics: Dynamics, least: float, theta: float, p: np.ndarray) -> Ode:
    """z' = f(sat z, u) + (dPhi/dx)^-1 K (y - h); the core is that of the phase coordinates."""
    n = dynamics.n

    def rest(values: Mapping[str, Any], u: Any, y: Any, valid: Any) -> dict[str, Any]:
        push, _ = dynamics.pulled(sym("derived.K", n), values["z"], u, least)
        return {"z": dynamics.flow(values["z"], u) + push * (valid * (y - dynamics.output(values["z"], u)))}

    return Ode((), rest, core=theta * (np.diag(np.ones(n - 1), 1) - np.outer(p, np.eye(n)[0])))


def _least(dynamics: Dynamics, share: float) -> float:
    """The |det dPhi/dx| up to which there is no correction; 0 where no zero is to be met."""
    share = real("singular", share)
    if not 0 <= share <= 1:
        raise BadGain(f"singular = {share!r}", "must be a share, from 0 to 1")
    form = dynamics.form
    proved = any(check.id == "phase.rank" and check.verdict is Verdict.PROVED for check in form.checks)
    return 0.0 if form.jacobian is None or proved else share * dynamics.largest_determinant()


def _notices(dynamics: Dynamics, least: float) -> tuple[Block, ...]:
    inputs = dynamics.form.system.inputs
    z, u = sym("state.z", dynamics.n), sym("state.u", len(inputs)) if inputs else ca.SX(0, 1)
    regular = ca.fabs(dynamics.determinant(dynamics.saturated(z), u)) > least
    return (Block("near a singular point there is no correction", {"status.SINGULAR": ca.logic_not(regular)}),)


def _chain(form: Form) -> list[sp.Expr]:
    """a_1..a_n, free of inputs."""
    if len(form.output) != 1:
        raise BadGain("high_gain", f"takes one output, {form.system.name} has {len(form.output)}; use riccati")
    if form.kind == "uniform":
        raise BadGain("high_gain", "wants constant slopes, those of a uniform form vary with the state; use riccati")
    n = form.n
    if form.jacobian is not None:  # the chain is that of the phase coordinates
        return [sp.S.One] * n
    chain = [sp.diff(form.output[0], form.states[0])] + [form.A[i, i + 1] for i in range(n - 1)]
    off_chain = sp.Matrix(n, n, lambda i, j: 0 if j == i + 1 else form.A[i, j])
    if any(entry != 0 for entry in off_chain):
        raise BadGain("high_gain", f"takes a triangular form, this one is {form.kind}; use forms.triangular or riccati")
    for i, a in enumerate(chain, 1):
        if a.free_symbols - {*form.system.parameters}:
            what = "input" if a.free_symbols & {*form.system.inputs} else "state"
            raise BadGain(f"a_{i} = {a}", f"depends on the {what}, a constant gain wants it constant; use riccati")
    return chain


def _graphs(gains: list[sp.Expr], parameters: Mapping[sp.Symbol, Any], theta: Any) -> Any:
    power, result = ca.SX(1), []
    for value in to_casadi(gains, parameters):
        power = power * theta
        result.append(power * value)
    return ca.vertcat(*result)
