"""Cascade of high-gain differentiators, saturated between the stages: no peaking, and no model of the last row.

    v_1' = v_2 + l alpha_1 (y - v_1)                        xhat_1 = v_1
    v_2' = l^2 alpha_2 (y - v_1)                            xhat_2 = sat(v_2 - c_1(xhat, u))
    v_i' = l alpha_i (xhat_(i-1) - v_i),   i = 3, .., n     xhat_i = sat(v_i' - c_(i-1)(xhat, u)),   l = theta

in the coordinates of `integrators`; sat clamps to the declared range of w_i. c_n is not used, and the error is of the
order of mu = 1/l, never 0: about i mu w_i' for i >= 2 and the default alpha = (2, 1, .., 1), every pole at -l. Without
samples the last rates stay constant. The paper's z are z_1 = v_1, z_2 = mu v_2, z_i = -v_i. Source: Khalil, "Cascade
high-gain observers in output feedback control", Automatica 80 (2017), for chains w_i' = w_(i+1); the rows c_1..c_(n-1)
of a triangular form are an extension.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.check import Verdict
from hgogen.estimators.core import Model, Saturate, demand_ranges, numbers, of_form, saturating
from hgogen.estimators.gains import BadPoles, coefficients
from hgogen.estimators.integrators import Integrators, integrators, listed, observer_on, unmodelled
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.observer import Observer, demand_form, high_gain_parameter
from hgogen.program import INF, Field, column, sym
from hgogen.reading.given import BadGain, reals
from hgogen.rigor.bounds import bound
from hgogen.rigor.tape import NoTape
from hgogen.signal import resting
from hgogen.starting import starts
from hgogen.theorem import FORM, OPERATION, Hypothesis, Theorem

REFERENCE = "Khalil, Cascade high-gain observers in output feedback control, Automatica 80 (2017)"
EQUATIONS = (
    "v_1' = v_2 + theta alpha_1 (y - v_1), v_2' = theta^2 alpha_2 (y - v_1), v_i' = theta alpha_i (xhat_(i-1) - v_i)",
    "xhat_1 = v_1, xhat_2 = sat(v_2 - c_1), xhat_i = sat(v_i' - c_(i-1)), sat to the declared range of the state",
)
THEOREM = Theorem(
    "the error becomes of the order of 1/theta, and never 0: the last row of the model is not used",
    (
        *FORM,
        Hypothesis("every alpha_i is positive", verdict=Verdict.PROVED, reason="others are refused"),
        Hypothesis("theta is large enough", verdict=Verdict.UNKNOWN, reason="no bound is computed"),
        *OPERATION,
    ),
    REFERENCE,
)


@starts(
    "there is no model of the last row z_n'",
    "practical convergence only: an error O(1/theta) remains",
    "2n-2",
    lambda s: {"theta": s.theta},
    quick=math.inf,
)
def cascade(
    form: Form,
    *,
    theta: float,
    gains: Sequence[float] | np.ndarray | None = None,
    poles: Sequence[complex] | None = None,
    initial: Mapping[str, float] | Sequence[float] | None = None,
    accept: Iterable[str] = (),
) -> Observer:
    """The observer v_1' = v_2 + l alpha_1 e, v_2' = l^2 alpha_2 e, e = y - v_1, v_i' = l alpha_i (xhat_(i-1) - v_i),
    xhat_i = sat(v_i' - c_(i-1)), l = theta, of a chain w_i' = w_(i+1) + c_i(w, u) (a form of one output with constant
    a_i), n >= 2 states, all but the first with ranges.

    Args: `theta` = 1/mu >= 1; `gains` alpha (n), positive, or the n `poles` of the linear error core at theta = 1, at
    most one pair of them complex, by default all at -1; `initial` the plant's state; `accept` ids of refuted checks to
    ignore.

    Raises: `Refuted`; `BadPoles`; `BadGain` for theta < 1, gains of another length or not positive, a state without a
    range, or a form that is no chain of at least two integrators.
    """
    accept = demand_form("cascade", form, accept, requires=integrators)
    high, chain = high_gain_parameter(theta), integrators("cascade", form)
    n, level = chain.n, sym("gain", "theta")
    if n < 2:
        raise BadGain("cascade", f"wants at least two states, {form.system.name} has {n}; use high_gain")
    demand_ranges("cascade", form, range(1, n))
    for i, row in enumerate(form.b[:-1]):
        if row.free_symbols & {*form.states[i + 1 :]}:
            raise BadGain(
                f"b_{i + 1} = {row}", f"reads a state after {form.states[i]}; use the form phase, or low_power"
            )
    alpha = _alpha(n, gains, poles)

    def estimates(v: Graph, saturate: Saturate, model: Model) -> list[Graph]:
        states = [v[0]]
        for i in range(1, n):
            rate = v[1] if i == 1 else level * alpha[i] * (states[-1] - v[i])
            c = model(ca.vertcat(*states, ca.SX.zeros(n - i)))
            states.append(saturate(rate - c[i - 1], i))
        return states

    def lines(
        values: Mapping[str, Graph], y: Graph, valid: Graph, saturate: Saturate, model: Model
    ) -> dict[str, Graph]:
        v = values["v"]
        e, states = valid * (y - v[0]), estimates(v, saturate, model)
        first = (v[1] + level * alpha[0] * e, level * level * alpha[1] * e)
        return {"v": ca.vertcat(*first, *(level * alpha[i] * (states[i - 1] - v[i]) for i in range(2, n)))}

    u = sym("state", "u", len(form.system.inputs))
    return observer_on(
        chain,
        "cascade",
        parts=(saturating(chain, (_field(chain, high.initial[0] * alpha, initial),), lines), unmodelled(form)),
        gains=(high,),
        w=ca.vertcat(*estimates(sym("state", "v", n), chain.saturated, lambda w: chain.nonlinear(w, u))),
        theorem=THEOREM,
        equations=(*EQUATIONS, f"alpha = {listed(alpha)}"),
        reference=REFERENCE,
        accepted=accept,
        practical=True,
    )


def _alpha(n: int, gains: Any, poles: Any) -> np.ndarray:
    """Return alpha (n) from `gains` or `poles`; v_1 and v_2 get the complex pair of poles, or else the two fastest
    poles."""
    if gains is not None and poles is not None:
        raise BadGain("cascade", "takes gains or poles, not both; leave one out")
    if poles is None:
        alpha = reals("gains", [2.0, *[1.0] * (n - 1)] if gains is None else gains)
        if alpha.shape != (n,) or not (np.isfinite(alpha).all() and (alpha > 0).all()):
            raise BadGain(f"gains = {gains!r}", f"must be {n} positive numbers, one for each state")
        return alpha
    coefficients(poles, n)
    values = sorted(map(complex, poles), key=lambda pole: (pole.imag == 0, pole.real))
    if any(pole.imag for pole in values[2:]):
        raise BadPoles(tuple(values), "one pair at most may be complex: the stages after the first have one state each")
    return np.array([*np.poly(values[:2]).real[1:], *(-pole.real for pole in values[2:])])


def _field(chain: Integrators, slopes: np.ndarray, initial: Mapping[str, float] | Sequence[float] | None) -> Field:
    """Return the memory field of v (n), initially in equilibrium with the initial estimate; `slopes` (n): theta alpha.
    The outer box of v_i is the outer box of w_(i-1); that of v_2 bounds w_1'."""
    w, n = chain.field(initial, float(slopes[0])), chain.n
    u = column(map(resting, chain.form.system.inputs))
    c = numbers(chain.nonlinear(ca.SX(ca.DM(w.initial)), u), of_form(chain.form)).reshape(-1)
    rates = [w.initial[i + 1] + c[i] for i in range(n - 1)]
    system, states, (bottom, top) = chain.form.system, chain.form.states, (-INF, INF)
    with suppress(NoTape):  # the range of c_1 on the declared box
        around = system.box_with(states)
        enclosure = bound(sp.sympify(chain.products[0] * chain.form.b[0]), around)
        bottom, top = enclosure.low, enclosure.high
    low = (w.low[0], w.low[1] + bottom, *w.low[1 : n - 1])
    high = (w.high[0], w.high[1] + top, *w.high[1 : n - 1])
    start = (w.initial[0], rates[0], *(w.initial[i - 1] - rates[i - 1] / slopes[i] for i in range(2, n)))
    return replace(
        w,
        name="v",
        initial=tuple(map(float, np.clip(start, low, high))),
        low=low,
        high=high,
        labels=(w.labels[0], f"rate of {w.labels[0]}", *(f"low-passed {label}" for label in w.labels[1 : n - 1])),
        meaning="the stages",
    )
