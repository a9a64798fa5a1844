"""Low-power high-gain observer: 2n - 2 states in place of n, and powers of the gain up to l^2 in place of l^n.

    p_i' = q_i + c_i(xhat, u) + l k_i1 e_i                     i = 1, .., n-1
    q_i' = q_(i+1) + c_(i+1)(xhat, u) + l^2 k_i2 e_i           i = 1, .., n-2
    q_(n-1)' = c_n(xhat, u) + l^2 k_(n-1)2 e_(n-1)
    e_1 = y - p_1,   e_i = q_(i-1) - p_i,   xhat = (p_1, q_1, .., q_(n-1)),   l = theta

in the coordinates of `integrators`, the argument of c saturated to the declared box. p and q are the fields `xi_p` and
`xi_q`, of the paper's pairs xi_i = (p_i, q_i): p_i estimates w_i, q_i w_(i+1). The linear error core has l times the
2n - 2 specified poles; k_i = (2, (n - i)/i) places all of them at -l (`gains`). Source: Astolfi, Marconi, "A high-gain
nonlinear observer with limited gain power", IEEE TAC 60 (2015), with c_n alone; the rows c_1..c_(n-1) of a triangular
form are an extension: c_i/l^(i-1) is Lipschitz in the scaled errors, uniformly in l >= 1.
"""

from collections.abc import Iterable, Mapping, Sequence

import casadi as ca
import numpy as np

from hgogen.analysis.ranges import Limits, saturated
from hgogen.check import Claims, Verdict
from hgogen.estimators.core import core_at_one
from hgogen.estimators.gains import errors, injected, pair_gains
from hgogen.estimators.integrators import integrators, listed, observer_on, rows, shifted
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.observer import Observer, demand_form, positive_theta
from hgogen.part import Ode
from hgogen.program import sym
from hgogen.prove.error_models import on_integrators
from hgogen.prove.inclusion import Layout
from hgogen.prove.region import theta_checks
from hgogen.reading.given import BadGain
from hgogen.rigor.definite import demand_hurwitz
from hgogen.starting import starts
from hgogen.theorem import FORM, OPERATION, Hypothesis, Theorem

REFERENCE = "Astolfi, Marconi, A high-gain nonlinear observer with limited gain power, IEEE TAC 60 (2015)"
EQUATIONS = (
    "p_i' = q_i + c_i + theta k_i1 e_i, q_i' = q_(i+1) + c_(i+1) + theta^2 k_i2 e_i, q_n = 0",
    "e_1 = y - p_1, e_i = q_(i-1) - p_i, xhat = (p_1, q_1, .., q_(n-1)), p = xi_p, q = xi_q",
)
THEOREM = Theorem(
    "the estimate converges exponentially from any initial state, for theta large enough",
    (
        *FORM,
        Hypothesis("the linear error core is Hurwitz", verdict=Verdict.PROVED, reason="others are refused"),
        Hypothesis("theta is large enough", (Claims("low_power", "theta"),), reason="of its declared value"),
        *OPERATION,
    ),
    REFERENCE,
)


@starts(
    "n is 4 or more: its gains have no power of theta above 2",
    "as `high_gain`; less noise in the estimate for n > 2",
    "2n-2",
    lambda s: {"theta": s.theta},
)
def low_power(
    form: Form,
    *,
    theta: float,
    gains: Sequence[Sequence[float]] | np.ndarray | None = None,
    poles: Sequence[complex] | None = None,
    initial: Mapping[str, float] | Sequence[float] | None = None,
    saturate: Limits = None,
    arguments: bool = True,
    accept: Iterable[str] = (),
) -> Observer:
    """The observer p_i' = q_i + c_i + l k_i1 e_i, q_i' = q_(i+1) + c_(i+1) + l^2 k_i2 e_i, e_1 = y - p_1, e_i = q_(i-1)
    - p_i, i < n, l = theta, of a chain w_i' = w_(i+1) + c_i(w, u) (a form of one output with constant a_i, n >= 2).

    Checks: `low_power.convergence` (a bound on theta is proved), `low_power.theta` (theta is above it).

    Args: `theta` > 0; `gains` k (n - 1, 2), or the 2n - 2 `poles` of the linear error core at theta = 1, by default all
    at -1; `initial` the plant's state; `saturate` limits of the values of b, by the state of the row, and `arguments`
    whether its argument is clamped as well; `accept` ids of refuted checks to ignore.

    Raises: `Refuted`; `NotHurwitz` for gains whose core does not decay; `BadPoles`; `BadGain` for theta <= 0, gains of
    another shape, or a form that is no chain of at least two integrators.
    """
    accept = demand_form("low_power", form, accept, requires=integrators)
    high, chain = positive_theta(theta), integrators("low_power", saturated(form, saturate, arguments))
    n, pairs = chain.n, chain.n - 1
    if n < 2:
        raise BadGain("low_power", f"wants at least two states, {form.system.name} has {n}; use high_gain")
    k = pair_gains("low_power", n, gains, poles)
    w, level = chain.field(initial, high.initial[0]), sym("gain", "theta")
    fields = (
        rows(w, "xi_p", range(pairs), "p_i, first of the pair xi_i: estimate of the states but the last"),
        rows(w, "xi_q", range(1, n), "q_i, second of the pair xi_i: estimate of the states but the first"),
    )

    def linear(values: Mapping[str, Graph], y: Graph, valid: Graph) -> dict[str, Graph]:
        p, q = values["xi_p"], values["xi_q"]
        onto_p, onto_q = injected(k, level, errors(valid * (y - p[0]), p, q))
        return {"xi_p": q + onto_p, "xi_q": shifted(q) + onto_q}

    def remainder(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        c = chain.nonlinear(ca.vertcat(values["xi_p"][0], values["xi_q"]), u)
        return {"xi_p": c[:pairs], "xi_q": c[1:]}

    part = Ode(fields, remainder, linear, chain.offset)
    core, measured = core_at_one(part)
    demand_hurwitz("gains", core, "leave them out: (2, (n - i)/i)")
    order = (*range(pairs), *range(1, n))
    layout = Layout(order, order, (True,) * (2 * pairs), (0, *range(pairs, 2 * pairs)))
    numbers = {"gains": k}
    error = on_integrators(chain, layout, core, measured, numbers)
    return observer_on(
        chain,
        "low_power",
        parts=(part,),
        gains=(high,),
        w=ca.vertcat(sym("state", "xi_p", pairs)[0], sym("state", "xi_q", pairs)),
        theorem=THEOREM,
        equations=(*EQUATIONS, f"(k_i1, k_i2) = {', '.join(map(listed, k))}"),
        reference=REFERENCE,
        claims=lambda: theta_checks("low_power", form, high.initial[0], error),
        accepted=accept,
        error=error,
    )
