"""Updated-gain high-gain observer: the gain follows the norm of the model's Jacobian at the estimate.

    w' = A w + c(w, u) + D_L K (y - w_1),   D_L = diag(L, .., L^n),   N = A - K C
    L' = L (p_1 (p_2 - L) + p_3 Gamma),   L(0) >= p_2,   Gamma = |D_L^-1 (dc/dw)(sat w, u) D_L|, Frobenius norm

in the coordinates of `integrators`, the argument of c saturated to the declared box. L is advanced by the exact flow of
its law with Gamma constant over a sample, L/(E + p_1 L (1 - E)/a), a = p_1 p_2 + p_3 Gamma, E = exp(-a dt): for every
dt, L stays between p_2 and p_2 + (p_3/p_1) sup Gamma. With error_i = L^(i-1+b) eps_i, D = diag(b, .., b + n - 1),

    d/dt eps'P eps = eps'(L (N'P + P N) + (p_1 (L - p_2) - p_3 Gamma) (D P + P D)) eps + 2 eps'P delta

with |delta| <= Gamma |eps| where Gamma bounds the increments of c, since it is no less than the spectral norm. So D
P + P D > 0, N'P + P N + p_1 (D P + P D) < 0 and p_3 (D P + P D) >= 2 lambda_max(P) are sufficient. The paper's Gamma
has no D_L; this one is never larger for L >= 1 and permits a lower gain. Where c is evaluated at x = Psi(w) in the
plant's ranges, dc/dw is dc/dx (dPhi/dx)^-1 there, which a clamp does not set to 0.

Gamma at the estimate bounds the increments of c to first order only. Where p_2 alone is large enough, the error
converges whatever Gamma is: this is proved by another P, for all partial derivatives of c in their ranges
(`proved_above`). Source: Andrieu, Praly, Astolfi, "High gain observers with updated gain and homogeneous correction
terms", Automatica 45 (2009), with linear correction terms; the cap on L, which the step length requires, is an
extension.
"""

import operator
from collections.abc import Iterable, Mapping, Sequence
from functools import reduce

import casadi as ca
import numpy as np

from hgogen.check import Claims, Verdict
from hgogen.estimators.integrators import (
    Integrators,
    capped,
    injection_gains,
    integrators,
    listed,
    observer_on,
    time_varying_gain,
)
from hgogen.form import Form
from hgogen.observer import Observer, demand_form, gain
from hgogen.part import Clock, Jump, Pieces
from hgogen.program import Block, Field, Place, scalar, sym
from hgogen.prove.semidefinite import STATES
from hgogen.prove.varying_gain import proved_above
from hgogen.prove.varying_gain import update_checks as checks
from hgogen.reading.given import BadGain, positive
from hgogen.sentence import same
from hgogen.starting import Gains, Scale, starts, two_digits
from hgogen.theorem import FORM, OPERATION, Hypothesis, Theorem

REFERENCE = (
    "Andrieu, Praly, Astolfi, High gain observers with updated gain and homogeneous correction terms, "
    "Automatica 45 (2009)"
)
EQUATIONS = (
    "w' = A w + c(w, u) + diag(L, .., L^n) K (y - w_1)",
    "L' = L (p_1 (p_2 - L) + p_3 Gamma), Gamma = |diag(L, .., L^n)^-1 dc/dw(sat w, u) diag(L, .., L^n)|_F, "
    "by its exact flow with Gamma held over a sample",
)
_HURWITZ = Hypothesis(
    "A - K C is Hurwitz with a P for which D P + P D > 0",
    verdict=Verdict.PROVED,
    reason="in rational arithmetic; others are refused",
)
_START = Hypothesis("L(0) >= p_2 >= 1", verdict=Verdict.PROVED, reason="others are refused")
_CAP = Hypothesis(
    "in continuous time the gain does not reach its cap",
    (Claims("updated_gain", "cap"),),
    reason="a step holds Gamma over a sample, and with it the gain may reach the cap: watch GAIN_LIMITED",
)
_ENOUGH = Hypothesis(
    "p_2 is large enough for every rate at which the gain may fall", (Claims("updated_gain", "theta"),)
)
_CONCLUSION = "the estimate converges exponentially, and the gain stays bounded"
THEOREM = Theorem(
    _CONCLUSION,
    (
        *FORM,
        _HURWITZ,
        Hypothesis("p_1 is small enough", (Claims("updated_gain", "p_1"),)),
        Hypothesis("p_3 is large enough", (Claims("updated_gain", "p_3"),)),
        _START,
        Hypothesis(
            "Gamma at the estimate bounds the increments of c between estimate and plant",
            verdict=Verdict.UNKNOWN,
            reason="the Jacobian there bounds them to first order in the error; a larger p_3, or p_2, leaves room",
        ),
        _CAP,
        *OPERATION,
    ),
    REFERENCE,
)
BY_P_2 = Theorem(_CONCLUSION, (*FORM, _HURWITZ, _ENOUGH, _START, *OPERATION), REFERENCE)

CLAMPED = Hypothesis(
    "Gamma bounds them, too, where a state of x = Psi(w) is clamped to its range",
    verdict=Verdict.UNKNOWN,
    reason="it is the model's slope there, a sum over the states; what the clamp leaves of the sum may be larger",
)


def _starting(scale: Scale) -> Gains:
    least, cap = max(1.0, two_digits(scale.theta / 2)), two_digits(10 * scale.theta)
    return {"p_1": 0.15, "p_2": least, "p_3": 6, "cap": cap, "poles": scale.poles, "b": scale.n / 2}


@starts(
    "b varies strongly in a part of the ranges only",
    "gains p_1, p_2, p_3 that satisfy an inequality",
    "n + 1",
    _starting,
)
def updated_gain(
    form: Form,
    *,
    p_1: float,
    p_2: float,
    p_3: float,
    cap: float,
    poles: Sequence[complex] | None = None,
    gains: Sequence[float] | np.ndarray | None = None,
    b: float = 1.0,
    start: float | None = None,
    initial: Mapping[str, float] | Sequence[float] | None = None,
    accept: Iterable[str] = (),
) -> Observer:
    """The observer w' = A w + c(w, u) + D_L K (y - w_1), D_L = diag(L, .., L^n), of a chain of integrators (a form of
    one output with constant a_i); L' = L (p_1 (p_2 - L) + p_3 Gamma), Gamma the norm of D_L^-1 (dc/dw) D_L.

    Checks: `updated_gain.p_1` (N'P + P N + p_1 (D P + P D) < 0), `updated_gain.p_3` (p_3 (D P + P D) >= 2
    lambda_max(P)), for the P of N'P + P N = -I, N = A - K C; `updated_gain.cap` (L' < 0 at the cap);
    `updated_gain.convergence` (a bound on p_2 is proved, whatever Gamma is), `updated_gain.theta` (p_2 is above it).

    Args: `p_1` > 0 (decay of L, without unit), `p_2` >= 1 (1/s), the lower end of L, `p_3` > 0 (weight of Gamma); `cap`
    > p_2 the largest L; `poles` (n) of A - K C, or `gains` K (n) in their place; `b` > 0 of D = diag(b, .., b + n - 1);
    `start` L(0) from p_2, its default, to the cap; `initial` the plant's state; `accept` ids of refuted checks to
    ignore.

    Raises: `Refuted`; `BadPoles`; `NotHurwitz`; `BadGain` where D P + P D is not positive definite, with the smallest b
    for which it is, for other numbers that do not fit, or a form that is no chain of integrators.
    """
    accept = demand_form("updated_gain", form, accept, requires=integrators)
    chain = integrators("updated_gain", form)
    if chain.n > STATES:
        raise BadGain("updated_gain", f"proves its gains for {STATES} states at most, {form.system.name} has {chain.n}")
    K = injection_gains("updated_gain", poles, gains, chain.n)
    fall, low, rise = positive("p_1", p_1), positive("p_2", p_2), positive("p_3", p_3)
    top, first = positive("cap", cap), low if start is None else positive("start", start)
    if not 1 <= low < top:
        raise BadGain(f"p_2 = {p_2!r}", f"must be at least 1 and below cap = {top:g}")
    if not low <= first <= top:
        raise BadGain(f"start = {start!r}", f"must be from p_2 = {low:g} to cap = {top:g}")
    shift = positive("b", b)
    proved = checks(chain, K, shift, fall, low, rise, top)
    theorem = THEOREM if form.behind is None else THEOREM.under(CLAMPED)
    if proved_above(proved, "updated_gain"):
        theorem = BY_P_2
    w = chain.field(initial, top)
    L = scalar("L", first, low=1.0, high=top, unit="1/s", meaning="gain, which follows the slope of the model")
    return observer_on(
        chain,
        "updated_gain",
        parts=(time_varying_gain(chain, w, K, L), Jump(lambda clock: _update(clock, chain, w)), capped(L)),
        gains=(
            gain("p_1", fall, 1e-3 * fall, fall, "how fast the gain falls"),
            gain("p_2", low, 1.0, low, "where the gain falls to", "1/s"),
            gain("p_3", rise, 1e-3 * rise, 1e3 * rise, "how much the gain follows the slope of the model"),
        ),
        w=sym("state", "w", chain.n),
        theorem=theorem,
        equations=(*EQUATIONS, f"K = {listed(K)}, L(0) = {same(first)}, L <= {same(top)}"),
        reference=REFERENCE,
        claims=lambda: proved,
        accepted=accept,
        traces=("L",),
    )


def _update(clock: Clock, chain: Integrators, w: Field) -> Pieces:
    L, p_1, p_2, p_3 = sym("state", "L"), sym("gain", "p_1"), sym("gain", "p_2"), sym("gain", "p_3")
    dynamics, z = chain.dynamics, chain.z(sym("state", w.name, chain.n))
    J = dynamics.jacobian(z, clock.u_now) - dynamics.linear(clock.u_now)
    scale = {i: 1 if p == 1 else chain.scale[i] for i, p in enumerate(chain.products)}
    total = ca.SX(0)  # the square of Gamma
    for i, j in ((i, j) for i in range(chain.n) for j in range(chain.n) if not J[i, j].is_zero()):
        power = reduce(operator.mul, [L if j > i else 1 / L] * abs(j - i), ca.SX(1))
        entry = scale[i] * J[i, j] / scale[j] * power
        total += entry * entry
    rate = p_1 * p_2 + p_3 * ca.sqrt(total)
    decayed = ca.exp(-clock.dt * rate)
    after = L / (decayed + p_1 * L * (1 - decayed) / rate)
    title = "L by the exact flow of its law over a sample"
    return Pieces(adapt=(Block(title, {Place("state", "L"): after}, {"rate": rate, "left": decayed}),))
