"""High-gain observer whose gain adapts to the output error, K and P from linear matrix inequalities.

    w_i' = w_(i+1) + c_i(w, u) + gamma^i k_i (y - w_1),   w_(n+1) = 0                                       (46), (47)
    r = |y - w_1|
    gamma' = alpha gamma          if r > d and gamma < gamma_sup
             -sigma gamma^2       if r <= d and gamma > gamma_inf
             0                    else: gamma is clipped to [gamma_inf, gamma_sup] in every slope and after each step

in the coordinates of `integrators`, the argument of c saturated to the declared box. K, P and sigma satisfy (54). With
D P + P D >= 0, gamma may then rise at any rate and fall no faster than sigma gamma^2 (`hgogen.design` computes them,
`adaptive_gain` verifies them). The smallest gamma_inf with a proof of convergence follows from another P, with the
partial derivatives of c instead of their norm in (62) (`varying_gain_checks`). The law is the projection of (90), which
read literally never leaves gamma_inf or gamma_sup. gamma is constant while no sample is valid. gamma_sup is part of the
law, since assumption 3 requires a bounded gamma: no status bit reports it, and no theorem is suspended there. Source:
Alessandri, "On Hamilton-Jacobi approaches to state reconstruction for dynamic systems", Mathematical Problems in
Engineering (2020), theorems 5-7, (46), (87), (90).
"""

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np

from hgogen.analysis.dynamics import clamp
from hgogen.check import ClaimId, Claims, Verdict, demand
from hgogen.errors import HgogenError
from hgogen.estimators.gains import as_matrix
from hgogen.estimators.integrators import Integrators, companion, integrators, observer_on, scaled, shifted
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.observer import Observer, demand_form, gain
from hgogen.part import Ode
from hgogen.program import Field, scalar, sym
from hgogen.prove.adaptive_design import adaptive_gain
from hgogen.prove.error_models import on_integrators, plain
from hgogen.prove.inclusion import Nothing
from hgogen.prove.varying_gain import (
    Assumptions,
    Candidate,
    Disturbance,
    Law,
    VaryingGain,
    candidate,
    numbers,
    steepness,
    varying_gain_checks,
)
from hgogen.prove.varying_gain import adaptive_checks as checks
from hgogen.prove.varying_gain import disturbance as as_disturbance
from hgogen.reading.given import BadGain, positive, reals
from hgogen.rigor.definite import demand_hurwitz
from hgogen.sentence import NONE, same
from hgogen.starting import Gains, Scale, starts, two_digits
from hgogen.theorem import FORM, OPERATION, Hypothesis, Theorem

REFERENCE = "Alessandri, On Hamilton-Jacobi approaches to state reconstruction for dynamic systems (2020), theorems 5-7"
EQUATIONS = (
    "w_i' = w_(i+1) + c_i(w, u) + gamma^i k_i (y - w_1), w_(n+1) = 0",
    "gamma' = rise gamma while |y - w_1| > threshold, -sigma gamma^2 else, in [gamma_inf, gamma_sup]",
)
_FACTS = ("definite", "shrink", "decay", "convergence", "theta", "attenuation")
DESIGN_CHECKS = tuple(ClaimId("adaptive_lmi", fact) for fact in _FACTS)
_MOVING = tuple(ClaimId("adaptive_lmi", fact) for fact in ("convergence", "theta"))  # which nothing refutes
THEOREM = Theorem(
    "the estimate converges exponentially from any initial state, and is input-to-state stable under disturbances",
    (
        *FORM,
        Hypothesis("P is positive definite", (Claims("adaptive_lmi", "definite"),), reference="theorem 5"),
        Hypothesis(
            "(A - K C)'P + P (A - K C) + sigma (D P + P D) + lambda I <= 0 for a lambda > 0",
            (Claims("adaptive_lmi", "decay"),),
            reference="(54)",
        ),
        Hypothesis("D P + P D >= 0", (Claims("adaptive_lmi", "shrink"),), reference="missing in theorem 5"),
        Hypothesis(
            "gamma is continuous, at least 1 and bounded, and gamma' >= -sigma gamma^2",
            verdict=Verdict.PROVED,
            reason="by its law, also where it slides along r = d",
            reference="assumption 3, (55)",
        ),
        Hypothesis("gamma_inf is large enough", (Claims("adaptive_lmi", "theta"),), reference="in place of (56), (62)"),
        Hypothesis(
            "the L2 gain from the declared disturbance to the error in w is at most mu",
            (Claims("adaptive_lmi", "attenuation"),),
            reference="theorem 7",
            optional=True,
        ),
        *OPERATION,
    ),
    REFERENCE,
)


def _starting(scale: Scale) -> Gains | str:
    """Return K and P for a Lipschitz constant of 1, and gamma from theta/4 to theta; a text if there are none."""
    if scale.n < 2:
        return "one state needs no inequality; take high_gain"
    try:
        design = adaptive_gain(scale.n, slope=1.0)
    except HgogenError as error:
        return str(error)
    gains = {"K": design.K, "P": design.P, "sigma": design.sigma}
    least = max(1.0, two_digits(scale.theta / 4))
    return gains | {"gamma": (least, 4 * least), "rise": scale.theta, "threshold": two_digits(scale.reading / 20)}


@starts(
    "the gain should rise with the output error, and fall again",
    "K and P from `hg.design`, verified in rational arithmetic",
    "n + 1",
    _starting,
    quick=0,
)
def adaptive_lmi(
    form: Form,
    *,
    gamma: tuple[float, float],
    K: Sequence[float],
    P: Sequence[Sequence[float]] | np.ndarray,
    sigma: float,
    rise: float,
    threshold: float,
    disturbance: tuple[Any, Any] | None = None,
    initial: Mapping[str, float] | Sequence[float] | None = None,
    accept: Iterable[str] = (),
) -> Observer:
    """The observer w_i' = w_(i+1) + c_i(w, u) + gamma^i k_i (y - w_1) of a chain of integrators (a form of one output
    with constant a_i). Its gain gamma rises by gamma' = alpha gamma while |y - w_1| > d, else falls by gamma' = -sigma
    gamma^2.

    Checks: `adaptive_lmi.definite` (P > 0), `.decay` ((A - K C)'P + P (A - K C) + sigma (D P + P D) + lambda I <= 0 for
    a lambda > 0), `.shrink` (D P + P D >= 0), `.convergence` (a bound on gamma_inf is proved), `.theta` (gamma_inf is
    above it), `.attenuation` (of a disturbance); `.lipschitz` in coordinates other than the plant's states.

    Args: `gamma` (gamma_inf, gamma_sup), 1 <= gamma_inf < gamma_sup, with gamma(0) = gamma_inf; `K` (n), `P` (n, n),
    `sigma` > 0 of `hgogen.design`, for a chain of n integrators; `rise` alpha (1/s) > 0; `threshold` d > 0 in the unit
    of y, above the noise; `disturbance` (G_1 (n, m), G_2 (m)) of m disturbances of w' and y; `initial` the plant's
    state; `accept` ids of refuted checks to ignore.

    Raises: `Refuted`, also for a P that one of the first three checks refutes; `NotHurwitz`; `BadGain`.
    """
    accept = demand_form("adaptive_lmi", form, accept, deferred=DESIGN_CHECKS, requires=integrators)
    chain, ends = integrators("adaptive_lmi", form), reals("gamma", gamma)
    if ends.shape != (2,) or not 1 <= ends[0] < ends[1] < np.inf:
        raise BadGain(f"gamma = {gamma!r}", "must be (gamma_inf, gamma_sup) with 1 <= gamma_inf < gamma_sup, finite")
    low, high = map(float, ends)
    design = candidate(K, P, sigma, chain.n)
    if not design.sigma:
        raise BadGain("sigma = 0", "would keep gamma from falling; design K and P for a positive sigma")
    gains = np.array([float(k) for k in design.K])
    demand_hurwitz("K", companion(gains), "take K and P of hgogen.design")
    bound = steepness(chain, low)
    k, reason = (None, bound.reason) if isinstance(bound, Nothing) else (bound.proof.high, NONE)
    proved = None if isinstance(bound, Nothing) else bound
    disturbed = None if disturbance is None else as_disturbance(disturbance, chain.n)
    extent = Fraction(low), Fraction(high)
    driven = None if disturbed is None else _driven(chain, design, extent, disturbed)
    guarantees = Assumptions(*extent, k, reason, disturbed, proved, driven)
    law = Law("gamma_inf", low, design.sigma, easing=False, b=Fraction(1), P=np.array(design.P, dtype=float))
    facts = checks("adaptive_lmi", design, guarantees)
    demand((*form.checks, *facts), accept, form, _MOVING)
    tunable = (
        _wide("rise", rise, "alpha, rate at which gamma rises", "1/s"),
        _wide("threshold", threshold, "d, output error above which gamma rises", form.system.outputs[0].unit),
        gain("sigma", float(design.sigma), 0.0, float(design.sigma), "gamma falls like -sigma gamma^2"),
    )
    w = chain.field(initial, high)
    level = scalar("gamma", low, low=low, high=high, meaning="high-gain parameter")
    return observer_on(
        chain,
        "adaptive_lmi",
        parts=(_part(chain, w, level, gains),),
        gains=tunable,
        w=sym("state", "w", chain.n),
        theorem=THEOREM,
        equations=(
            *EQUATIONS,
            f"K = {tuple(gains.tolist())}, gamma_inf = {same(low)}, gamma_sup = {same(high)}",
            f"P = {tuple(map(tuple, reals('P', P).tolist()))}",
        ),
        reference=REFERENCE,
        claims=lambda: (
            *facts,
            *varying_gain_checks("adaptive_lmi", chain, design.K, law, numbers(design, guarantees)),
        ),
        accepted=accept,
        traces=("gamma",),
    )


def _driven(
    chain: Integrators, design: Candidate, ends: tuple[Fraction, Fraction], disturbed: Disturbance
) -> VaryingGain | None:
    K, form = np.array([float(k) for k in design.K]), chain.form
    error = on_integrators(chain, plain(form), companion(K), as_matrix(form, design.K), {})
    if isinstance(error, Nothing):
        return None
    return VaryingGain(error, *ends, design.sigma, disturbed.plant, disturbed.measurement)


def _part(chain: Integrators, w: Field, moving: Field, K: np.ndarray) -> Ode:
    ((low, high),) = moving.box

    def linear(values: Mapping[str, Graph], y: Graph, valid: Graph) -> dict[str, Graph]:
        w, level = values["w"], clamp(values["gamma"], low, high)
        return {"w": shifted(w) + scaled(K, level) * (valid * (y - w[0]))}

    def remainder(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        level = clamp(values["gamma"], low, high)
        loud = ca.fabs(y - chain.offset(u) - values["w"][0]) > sym("gain", "threshold")
        law = level * ca.if_else(loud, sym("gain", "rise"), -sym("gain", "sigma") * level)
        return {"w": chain.nonlinear(values["w"], u), "gamma": valid * law}

    return Ode((w, moving), remainder, linear, chain.offset, frozen={"gamma": (high,)})


def _wide(name: str, nominal: Any, meaning: str, unit: str) -> Field:
    value = positive(name, nominal)
    return gain(name, value, 1e-3 * value, 1e3 * value, meaning, unit)
