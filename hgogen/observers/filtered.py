"""High-gain observer with low-pass filters in its output injection: 2n states, no power of the gain above 2.

    x_i' = x_(i+1) + c_i(x, u) + l_i eta_i                     i = 1, .., n, x_(n+1) = 0
    eta_1' = -k alpha eta_1 + k^2 beta (y - x_1)
    eta_i' = -k alpha eta_i + k^2 beta eta_(i-1)               i = 2, .., n,   k = theta

in the coordinates of `integrators`, the argument of c saturated to the declared box. eta_i settles at (k beta/alpha)^i
times a constant y - x_1, so that with alpha = beta = 1 the injection is that of `high_gain` at low frequencies. The
linear error core is similar to k M, M of `gains`, which decays if and only if the poles of A - L C lie inside the
parabola alpha^2 Re + beta Im^2 < 0. Source: Astolfi, Jungers, Zaccarian, "Output injection filtering redesign in
high-gain observers", ECC 2018, (7), Theorem 1, with c_n alone; the rows c_1..c_(n-1) of a triangular form are an
extension.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from hgogen.analysis.ranges import Limits, saturated
from hgogen.check import Claims, Verdict
from hgogen.estimators.core import core_at_one
from hgogen.estimators.gains import coefficients, demand_parabola, filtered_core, parabola_advice
from hgogen.estimators.integrators import integrators, listed, observer_on, shifted
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.observer import Observer, demand_form, positive_theta
from hgogen.part import Ode
from hgogen.program import Field, sym
from hgogen.prove.error_models import on_integrators
from hgogen.prove.inclusion import Layout
from hgogen.prove.region import theta_checks
from hgogen.reading.given import BadGain, positive, reals
from hgogen.rigor.definite import demand_hurwitz
from hgogen.sentence import same
from hgogen.starting import starts, two_digits, whole
from hgogen.theorem import FORM, OPERATION, Hypothesis, Theorem

REFERENCE = "Astolfi, Jungers, Zaccarian, Output injection filtering redesign in high-gain observers, ECC (2018)"
EQUATIONS = (
    "w_i' = w_(i+1) + c_i(w, u) + l_i eta_i",
    "eta_1' = -theta alpha eta_1 + theta^2 beta (y - w_1), eta_i' = -theta alpha eta_i + theta^2 beta eta_(i-1)",
)
THEOREM = Theorem(
    "the estimate converges exponentially from any initial state, for theta large enough",
    (
        *FORM,
        Hypothesis(
            "the poles of A - L C lie inside the parabola alpha^2 Re + beta Im^2 < 0, so that M is Hurwitz",
            verdict=Verdict.PROVED,
            reason="in exact arithmetic; others are refused",
            reference="Lemma 1",
        ),
        Hypothesis("theta is large enough", (Claims("filtered", "theta"),), reason="of its declared value"),
        *OPERATION,
    ),
    f"{REFERENCE}, Theorem 1",
)


@starts(
    "the noise has high frequencies, which it attenuates more than `high_gain`",
    "a theta several times that of `high_gain`; poles inside a parabola",
    "2n",
    lambda s: s.high | {"alpha": s.corner, "beta": whole(two_digits(s.corner / 3))},
)
def filtered(
    form: Form,
    *,
    theta: float,
    alpha: float,
    beta: float,
    poles: Sequence[complex] | None = None,
    gains: Sequence[float] | np.ndarray | None = None,
    initial: Mapping[str, float] | Sequence[float] | None = None,
    saturate: Limits = None,
    arguments: bool = True,
    accept: Iterable[str] = (),
) -> Observer:
    """The observer x_i' = x_(i+1) + c_i(x, u) + l_i eta_i, eta_1' = -k alpha eta_1 + k^2 beta (y - x_1), eta_i' = -k
    alpha eta_i + k^2 beta eta_(i-1), k = theta, of a chain of integrators (a form of one output with constant a_i).

    Checks: `filtered.convergence` (a bound on theta is proved), `filtered.theta` (theta is above it).

    Args: `theta` > 0, the paper's k; `alpha`, `beta` > 0 of the filters, whose rate is theta alpha; `poles` (n) of
    A - L C inside the parabola, or `gains` L (n) in their place; `initial` the plant's state; `saturate` limits of the
    values of b, by the state of the row, and `arguments` whether its argument is clamped as well; `accept` ids of
    refuted checks to ignore.

    Raises: `Refuted`; `BadPoles`; `OutsideParabola` with the ratio alpha^2/beta that admits the poles; `NotHurwitz` for
    gains whose core does not decay; `BadGain` for other numbers that do not fit, or a form that is no chain of
    integrators.
    """
    accept = demand_form("filtered", form, accept, requires=integrators)
    high, chain = positive_theta(theta), integrators("filtered", saturated(form, saturate, arguments))
    n, level = chain.n, sym("gain", "theta")
    a, b = positive("alpha", alpha), positive("beta", beta)
    L = _gains(poles, gains, n, a, b)
    fields = (chain.field(initial, high.initial[0]), Field("eta", (0.0,) * n, meaning="filtered output injection"))

    def linear(values: Mapping[str, Graph], y: Graph, valid: Graph) -> dict[str, Graph]:
        w, eta = values["w"], values["eta"]
        source = ca.vertcat(valid * (y - w[0]), *(eta[i] for i in range(n - 1)))
        return {"w": shifted(w) + ca.DM(L) * eta, "eta": level * (level * (b * source) - a * eta)}

    def remainder(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        return {"w": chain.nonlinear(values["w"], u), "eta": ca.SX(n, 1)}

    part = Ode(fields, remainder, linear, chain.offset)
    estimate, filters = tuple(range(n)), tuple(range(1, n + 1))
    layout = Layout(2 * estimate, estimate + filters, (True,) * n + (False,) * n, estimate)
    core, measured = core_at_one(part)
    numbers = {"alpha": a, "beta": b, "gains": L}
    error = on_integrators(chain, layout, core, measured, numbers)
    return observer_on(
        chain,
        "filtered",
        parts=(part,),
        gains=(high,),
        w=sym("state", "w", n),
        theorem=THEOREM,
        equations=(*EQUATIONS, f"alpha = {same(a)}, beta = {same(b)}, L = {listed(L)}"),
        reference=REFERENCE,
        claims=lambda: theta_checks("filtered", form, high.initial[0], error),
        accepted=accept,
        error=error,
    )


def _gains(poles: Any, gains: Any, n: int, alpha: float, beta: float) -> np.ndarray:
    if (poles is None) == (gains is None):
        raise BadGain("filtered", "takes either the poles of A - L C or the gains L; give one of the two")
    if gains is None:
        L = coefficients(poles, n)
        demand_parabola(poles, alpha, beta)
        fix = "rounded to doubles, these poles are at the parabola's edge; take them further inside"
    else:
        L = reals("gains", gains)
        if L.shape != (n,) or not np.isfinite(L).all():
            raise BadGain(f"gains = {gains!r}", f"must be {n} finite numbers, one for each state")
        fix = parabola_advice(L, alpha, beta)
    demand_hurwitz("poles" if gains is None else "gains", filtered_core(L, alpha, beta), fix)
    return L
