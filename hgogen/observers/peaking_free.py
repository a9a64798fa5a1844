"""Low-power high-gain observer without peaking: the estimate that a pair passes to the next is saturated to its range.

    p_i' = q_i + c_i(p, u) + l alpha_i e_i                            i = 1, .., n-1
    q_i' = sat q_(i+1) + c_(i+1)(p, u) + l^2 beta_i e_i               i = 1, .., n-2
    q_(n-1)' = c_n(p, u) + l^2 beta_(n-1) e_(n-1)
    p_n' = c_n(p, u) + l alpha_n e_n
    e_1 = y - p_1,   e_i = sat q_(i-1) - p_i,   xhat = p,   l = theta

in the coordinates of `integrators`; sat q_i is q_i clamped to the declared range of w_(i+1), the argument of c to the
declared box. p and q are the fields `xi_p` and `xi_q`, of the pairs xi_i = (p_i, q_i): p_i estimates w_i, q_i w_(i+1).
Without saturation the linear error core is that of the low-power observer with the additional pole -l alpha_n. Source:
Astolfi, Marconi, Praly, Teel, "Low-power peaking-free high-gain observers", Automatica 98 (2018), with c_n alone; the
rows c_1..c_(n-1) of a triangular form are an extension.
"""

from collections.abc import Iterable, Mapping, Sequence

import casadi as ca
import numpy as np

from hgogen.check import Claims, Verdict
from hgogen.estimators.core import (
    Model,
    Saturate,
    core_at_one,
    demand_ranges,
    saturating,
    saturation_columns,
    vertices,
)
from hgogen.estimators.gains import errors, injected, pair_gains
from hgogen.estimators.integrators import integrators, listed, observer_on, rows, shifted
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.observer import Observer, demand_form, positive_theta
from hgogen.program import sym
from hgogen.prove.error_models import on_integrators
from hgogen.prove.inclusion import Layout
from hgogen.prove.region import theta_checks
from hgogen.reading.given import BadGain, positive
from hgogen.rigor.definite import demand_hurwitz
from hgogen.sentence import same
from hgogen.starting import starts
from hgogen.theorem import FORM, OPERATION, Hypothesis, Theorem

REFERENCE = "Astolfi, Marconi, Praly, Teel, Low-power peaking-free high-gain observers, Automatica 98 (2018)"
EQUATIONS = (
    "p_i' = q_i + c_i + theta alpha_i e_i, p_n' = c_n + theta alpha_n e_n",
    "q_i' = sat q_(i+1) + c_(i+1) + theta^2 beta_i e_i, q_n = 0",
    "e_1 = y - p_1, e_i = sat q_(i-1) - p_i, xhat = p, p = xi_p, q = xi_q, sat to the declared range of the state",
)
THEOREM = Theorem(
    "the estimate converges exponentially from any initial state, its peak bounded whatever theta, for theta large "
    "enough",
    (
        *FORM,
        Hypothesis("the linear error core is Hurwitz", verdict=Verdict.PROVED, reason="others are refused"),
        Hypothesis("alpha_i, beta_i > 0, each pair by itself is Hurwitz", verdict=Verdict.PROVED, reason="as the last"),
        Hypothesis(
            "one P > 0 has N'P + P N < 0 for the core N with every saturation open or shut",
            (Claims("peaking_free", "convergence"),),
        ),
        Hypothesis("theta is large enough", (Claims("peaking_free", "theta"),), reason="of its declared value"),
        *OPERATION,
    ),
    REFERENCE,
)


@starts(
    "as `low_power`, and the estimate must not peak before it settles",
    "declared ranges of the states, to which internal estimates are clamped",
    "2n-2",
    lambda s: {"theta": s.theta},
    quick=0,
    costly=True,
)
def peaking_free(
    form: Form,
    *,
    theta: float,
    gains: Sequence[Sequence[float]] | np.ndarray | None = None,
    poles: Sequence[complex] | None = None,
    last: float = 1.0,
    initial: Mapping[str, float] | Sequence[float] | None = None,
    accept: Iterable[str] = (),
) -> Observer:
    """The observer p_i' = q_i + c_i + l alpha_i e_i, q_i' = sat q_(i+1) + c_(i+1) + l^2 beta_i e_i, e_1 = y - p_1, e_i
    = sat q_(i-1) - p_i, l = theta, xhat = p, of a chain w_i' = w_(i+1) + c_i(w, u) (a form of one output with constant
    a_i, n >= 2 states with ranges).

    Checks: `peaking_free.convergence` (a bound on theta is proved, including the saturations), `peaking_free.theta`
    (theta is above it).

    Args: `theta` > 0; `gains` (alpha_i, beta_i) (n - 1, 2), or 2n - 2 `poles` at theta = 1, by default (2, (n - i)/i):
    all poles at -1; `last` alpha_n > 0; `initial` the plant's state; `accept` ids of refuted checks to ignore.

    Raises: `Refuted`; `NotHurwitz` for gains whose core does not decay; `BadPoles`; `BadGain` for theta <= 0, gains of
    another shape or not positive, a state without a range, or a form that is no chain of at least two integrators.
    """
    accept = demand_form("peaking_free", form, accept, requires=integrators)
    high, chain = positive_theta(theta), integrators("peaking_free", form)
    n, pairs, alpha = chain.n, chain.n - 1, positive("last", last)
    if n < 2:
        raise BadGain("peaking_free", f"wants at least two states, {form.system.name} has {n}; use high_gain")
    demand_ranges("peaking_free", form, range(1, n))
    k = _positive_pairs(n, gains, poles)
    w, level = chain.field(initial, high.initial[0]), sym("gain", "theta")
    fields = (
        rows(w, "xi_p", range(n), "p_i, first of the pair xi_i: estimate"),
        rows(w, "xi_q", range(1, n), "q_i, second of the pair xi_i: estimate of the states but the first"),
    )

    def lines(
        values: Mapping[str, Graph], y: Graph, valid: Graph, saturate: Saturate, model: Model
    ) -> dict[str, Graph]:
        p, q, c = values["xi_p"], values["xi_q"], model(values["xi_p"])
        sat = ca.vertcat(*(saturate(q[i - 1], i) for i in range(1, n)))
        onto_p, onto_q = injected(k, level, errors(valid * (y - p[0]), p, sat))
        last = level * alpha * (sat[pairs - 1] - p[pairs])
        return {"xi_p": ca.vertcat(q + onto_p, last) + c, "xi_q": shifted(sat) + onto_q + c[1:]}

    part = saturating(chain, fields, lines)
    core, measured = core_at_one(part)
    demand_hurwitz("gains", core, "leave them out: (2, (n - i)/i)")
    order = (*range(n), *range(1, n))
    layout = Layout(order, order, (True,) * (n + pairs), tuple(range(n)))
    cores = tuple(vertices(chain, fields, lines))
    numbers = {"gains": k, "last": alpha}
    error = on_integrators(chain, layout, cores[-1], measured, numbers, saturation_columns(cores))
    return observer_on(
        chain,
        "peaking_free",
        parts=(part,),
        gains=(high,),
        w=sym("state", "xi_p", n),
        theorem=THEOREM,
        equations=(*EQUATIONS, f"(alpha_i, beta_i) = {', '.join(map(listed, k))}, alpha_n = {same(alpha)}"),
        reference=REFERENCE,
        claims=lambda: theta_checks("peaking_free", form, high.initial[0], error),
        accepted=accept,
        error=error,
    )


def _positive_pairs(
    n: int, gains: Sequence[Sequence[float]] | np.ndarray | None, poles: Sequence[complex] | None
) -> np.ndarray:
    k = pair_gains("peaking_free", n, gains, poles)
    if not (k > 0).all():
        raise BadGain(f"gains = {k.tolist()}", "must all be positive: a pair behind a saturation decays by itself")
    return k
