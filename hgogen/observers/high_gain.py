"""Standard high-gain observer with a constant gain.

    z' = A z + b(sat z, u) + diag(theta, .., theta^n) K (y - C z)

A - K C is Hurwitz, with its poles or the gains K as arguments; for several outputs chain by chain, or with one matrix K
for all chains. The argument of b is saturated to the declared box, the linear part is not. On a plant in its own
coordinates with the Jacobian of Phi = (h, L h, .., L^(n-1) h) (forms.phase),

    z' = f(sat z, u) + (dPhi/dx)^-1(sat z, u, u', ..) diag(theta, .., theta^n) K (y - h(z, u)),

without correction where |det dPhi/dx| is at most `singular` times its largest value on the box. Source: Gauthier,
Hammouri, Othman 1992; in the form of Astolfi, Jungers, Zaccarian 2018, (3). Boizot, Busvelle, Gauthier 2010, remark 1,
exclude an A(u) for a constant gain; here one quadratic Lyapunov function for the ranges of the a_i admits it
(`prove.convergence`).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.hypotheses import clamped_lipschitz
from hgogen.analysis.linearised import largest_determinant
from hgogen.analysis.ranges import Limits, limit_lines, saturated
from hgogen.analysis.scaling import chain_errors, output_weights, redundant_outputs, unused
from hgogen.check import Claims, Verdict
from hgogen.estimators.integrators import injected_chains
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.observer import Observer, demand_form, positive_theta, state_field
from hgogen.part import Ode
from hgogen.program import Block, Place, sym
from hgogen.prove.constant_gain import ConstantGain, constant_gain
from hgogen.prove.region import theta_checks
from hgogen.reading.given import BadGain, real
from hgogen.starting import starts
from hgogen.theorem import FORM, HURWITZ, OPERATION, Hypothesis, Theorem, large_theta

REFERENCE = "Gauthier, Hammouri, Othman, A simple observer for nonlinear systems, IEEE TAC 37 (1992)"
_STANDARD = "z' = A z + b(sat z, u) + diag(theta, .., theta^n) K (y - C z)"
_SEVERAL = f"{_STANDARD}, on the chain of each output"
_COUPLED = "z' = A z + b(sat z, u) + (theta^(p(i) - p(k) + 1) K_ik) (y - C z), p(i) the power of theta that scales z_i"
_ORIGINAL = "z' = f(sat z, u) + (dPhi/dx)^-1 diag(theta, .., theta^n) K (y - h(z, u)), Phi = (h, L h, .., L^(n-1) h)"
THEOREM = Theorem(
    "the estimate converges exponentially from any initial state",
    (*FORM, HURWITZ, large_theta("high_gain"), *OPERATION),
    REFERENCE,
)
DRIVEN = Hypothesis(
    "one P > 0 has (A - K C)'P + P (A - K C) < 0 for every input",
    (Claims("high_gain", "convergence"),),
    reason="K does not follow the input",
)
INSIDE = Hypothesis(
    "the estimate keeps to the declared ranges",
    reason="watch the status OUTSIDE_BOX: beyond them dPhi/dx is taken at their edge, not at the estimate",
)


@starts(
    "the model is known and the noise is small: the first choice",
    "constant a_i, or `hg.forms.phase`; convergence is proved above a bound on theta",
    "n",
    lambda s: s.high,
)
def high_gain(
    form: Form,
    *,
    theta: float,
    poles: Sequence[Any] | None = None,
    gains: Sequence[Any] | np.ndarray | None = None,
    initial: Mapping[str, float] | Sequence[float] | None = None,
    saturate: Limits = None,
    arguments: bool = True,
    singular: float = 1e-3,
    weights: Mapping[str, float] | None = None,
    accept: Iterable[str] = (),
) -> Observer:
    """The observer z' = A z + b(z, u) + K_theta (y - C z), K_theta = diag(theta, .., theta^n) K, on a form in chains
    z_i' = a_i z_(i+1) + b_i, one for each output, or in the plant's coordinates on a form with Phi = (y, y', ..): x' =
    f + (dPhi/dx)^-1 K_theta (y - h).

    Checks: `high_gain.convergence` (a bound on theta is proved), `high_gain.theta` (theta is above it);
    `high_gain.lipschitz` in coordinates other than the plant's states (b on the whole box of z).

    Args: `theta` > 0; `poles` (n) of A - K C with negative real parts, for a_i free of inputs (the poles of the
    observer's linear core are theta times these); or `gains` K (n), for any a_i in ranges, such as
    hg.design.constant_gain(form). For several chains either is a sequence, one entry for each chain, or `gains` is a
    matrix (n, q): each row acts on the errors of all q chains' outputs, the entry of chain k times theta^(p(row) - p(k)
    + 1), which is theta^j with aligned tops. `initial` the plant's state; `saturate` limits of the values of b, by the
    state of the row, and `arguments` whether its argument is clamped as well; `singular` (0..1) switches the correction
    off near a zero of det dPhi/dx, unless it is proved to have none; `weights`, by name, default 1, in the mean error
    of outputs that measure the same state: 1/v_j is optimal for noise of variance v_j in the unit of the first;
    `accept` ids of refuted checks to ignore.

    Raises: `Refuted`; `BadPoles`; `NotHurwitz` for gains that do not decay at the ends of the ranges of the a_i;
    `BadGain` for theta <= 0, gains of another length, a form that has no chains, or poles on an A(u).
    """
    accept = demand_form("high_gain", form, accept)
    form = saturated(form, saturate, arguments)
    high, dynamics = positive_theta(theta), Dynamics(form)
    theta = high.initial[0]
    by_weight = output_weights(form, weights)
    chosen = constant_gain("high_gain", form, poles, gains, by_weight)
    z, least = state_field(form, initial, theta), _least(dynamics, singular)
    part = replace(
        _part(dynamics, chosen, theta, least, by_weight),
        fields=(z,),
        derived=(chosen.K.field,),
        tune=(chosen.K.tuned(form),),
    )
    equation, theorem = _STANDARD, THEOREM
    if len(form.blocks) > 1:
        equation = _COUPLED if chosen.K.coupled else _SEVERAL
    if form.jacobian is not None:
        equation, theorem = _ORIGINAL, theorem.under(INSIDE)
    theorem = theorem.under(DRIVEN) if chosen.driven else theorem
    notices: tuple[Block, ...] = ()
    if least is not None:
        at, u = dynamics.saturated(sym("state", "z", form.n)), sym("state", "u", len(form.system.inputs))
        shut = ca.logic_not(ca.fabs(dynamics.determinant(at, u)) > least)
        notices = (Block("near a singular point there is no correction", {Place("status", "SINGULAR"): shut}),)
    return Observer(
        form=form,
        name="high_gain",
        parts=(part,),
        gains=(high,),
        z=sym("state", "z", form.n),
        dynamics=dynamics,
        claims=lambda: (
            *form.checks,
            *clamped_lipschitz("high_gain", form),
            *theta_checks("high_gain", form, theta, chosen.error),
        ),
        accepted=accept,
        theorem=theorem.with_chains() if len(form.blocks) > 1 else theorem,
        equations=(equation, f"K = {chosen.K}", *_means(form, weights), *limit_lines(form)),
        reference=REFERENCE,
        notices=notices,
        error=chosen.error,
    )


def _means(form: Form, weights: Any) -> Iterator[str]:
    names, numbers = [y.name for y in form.system.outputs], output_weights(form, weights)
    for chain in (chain for chain in redundant_outputs(form) if len(chain) > 1):
        weighed = (f"{numbers[each.output]:g} {names[each.output]}" for each in chain)
        lead = names[chain[0].output]
        yield f"y - C z of {lead}: the mean of {', '.join(weighed)}, by weight, of the samples that are there"
    if spare := [names[j] for j in unused(form)]:
        yield f"{', '.join(spare)} {'has' if len(spare) == 1 else 'have'} no chain, and no part in the correction"


def _part(dynamics: Dynamics, chosen: ConstantGain, theta: float, least: float | None, weights: Sequence[float]) -> Ode:
    """Return z' = A z + b(z, u) + K_theta (y - C z - offset) as a differential equation."""
    if dynamics.form.jacobian is not None:
        return _in_original(dynamics, least, theta, np.array(chosen.K.values, dtype=float))
    if chosen.driven:
        return _driven(dynamics, chosen, theta, weights)

    def remainder(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        return {"z": dynamics.nonlinear(values["z"], u)}

    return injected_chains(dynamics, chosen.K, weights, remainder)


def _driven(dynamics: Dynamics, chosen: ConstantGain, theta: float, weights: Sequence[float]) -> Ode:
    """Return z' = A(u) z + b(z, u) + K_theta (y - C(u) z - offset) as a differential equation."""

    def remainder(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        z = values["z"]
        e = chain_errors(dynamics.form, weights, dynamics.error(y, dynamics.output(z, u)), valid)
        return {"z": dynamics.flow(z, u) + chosen.K.injection(e, dynamics.n)}

    return Ode((), remainder, core=theta * chosen.vertices)


def _in_original(dynamics: Dynamics, least: float | None, theta: float, p: np.ndarray) -> Ode:
    """Return x' = f(sat x, u) + (dPhi/dx)^-1 K_theta (y - h(x, u)),
    with correction 0 for |det dPhi/dx| <= `least`."""
    n = dynamics.n

    def remainder(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        push = dynamics.pulled(sym("derived", "K", n), values["z"], u, least)
        return {
            "z": dynamics.flow(values["z"], u) + push * (valid * dynamics.error(y, dynamics.output(values["z"], u)))
        }

    return Ode((), remainder, core=theta * (np.diag(np.ones(n - 1), 1) - np.outer(p, np.eye(n)[0])))


def _least(dynamics: Dynamics, share: float) -> float | None:
    share = real("singular", share)
    if not 0 <= share <= 1:
        raise BadGain(f"singular = {share!r}", "must be a share, from 0 to 1")
    form = dynamics.form
    proved = any(check.verdict is Verdict.PROVED for check in form.about("rank"))
    return None if form.jacobian is None or proved else share * largest_determinant(dynamics)
