"""High-gain observer on the uniform form, with varying partial derivatives from each state to the next.

    z' = F(z, u) + Lambda(z, u)^-1 diag(theta, .., theta^n) K (y - h(z_1, u))
    Lambda = a diag(1, F_1', F_1' F_2', ..),   F_k' = dF_k/dz_(k+1),   y = a z_1 + c

on z_i' = F_i(z_1, .., z_(i+1), u). F and Lambda take z clamped to the declared box. Beyond it F_k is continued linearly
in z_(k+1), F_k = s_k z_(k+1) + b_k(sat z, u), with a slope s_k in the range of F_k'. Source: Hammouri, Farza,
"Nonlinear observers for locally uniformly observable systems", ESAIM: COCV 9 (2003). Its proof scales e by Lambda(z,
u), whose derivative contains theta^i e_1, so that it bounds theta for small errors only. Here convergence from every
initial state is proved by a constant P, for all partial derivatives and gains in their ranges (`uniform_error`). With
binomial K and no other partial derivatives, it exists while the largest F_k' is below 5.8 times the smallest for n = 2,
and 2 times for n = 3.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import sympy as sp

from hgogen.analysis.dynamics import Dynamics
from hgogen.check import Claims
from hgogen.estimators.integrators import companion, injection_gains, listed, scaled
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.observer import Observer, demand_form, positive_theta, state_field
from hgogen.part import Ode
from hgogen.program import Block, Field, Place, sym
from hgogen.prove.error_models import middles, slopes_on, uniform_error
from hgogen.prove.region import theta_checks
from hgogen.reading.given import BadGain
from hgogen.sentence import Reason
from hgogen.starting import starts
from hgogen.theorem import LIPSCHITZ, OPERATION, Hypothesis, Theorem

REFERENCE = "Hammouri, Farza, Nonlinear observers for locally uniformly observable systems, ESAIM: COCV 9 (2003)"
EQUATION = "z' = F(z, u) + Lambda^-1 diag(theta, .., theta^n) K (y - h), Lambda = a diag(1, F_1', F_1' F_2', ..)"
THEOREM = Theorem(
    "the estimate converges exponentially from any initial state",
    (
        Hypothesis("z_i' = F_i(z_1, .., z_(i+1), u), y = h(z_1, u)", (Claims("uniform", "structure"),)),
        Hypothesis("every dF_i/dz_(i+1) keeps off zero", (Claims("uniform", "slope"),)),
        LIPSCHITZ,
        Hypothesis(
            "one P > 0 has (J - g a C)'P + P (J - g a C) < 0 for all slopes and gains in their ranges",
            (Claims("uniform_injection", "convergence"),),
            reason="in the place of the paper's Lyapunov function, which is of small errors",
        ),
        Hypothesis("theta is large enough", (Claims("uniform_injection", "theta"),), reason="of its declared value"),
        *OPERATION,
    ),
    REFERENCE,
)


@starts(
    "the partial derivative of z_i' by z_(i+1) varies with the state, and is never 0",
    "`hg.forms.uniform`; proved if these derivatives vary little, for n = 2 by a factor below 5.8",
    "n",
    lambda s: s.high,
    quick=3,
    costly=True,
)
def uniform_injection(
    form: Form,
    *,
    theta: float,
    poles: Sequence[complex] | None = None,
    gains: Sequence[float] | np.ndarray | None = None,
    initial: Mapping[str, float] | Sequence[float] | None = None,
    accept: Iterable[str] = (),
) -> Observer:
    """The observer z' = F(z, u) + Lambda(z, u)^-1 diag(theta, .., theta^n) K (y - h), Lambda = a diag(1, F_1', F_1'
    F_2', ..), F_k' = dF_k/dz_(k+1), on a uniform form z_i' = F_i(z_1..z_(i+1), u) whose output is y = h = a z_1 + c.

    Checks: `uniform_injection.convergence` (every theta above a bound converges; the proof requires Clarabel, up to six
    states), `uniform_injection.theta` (theta is above it).

    Args: `theta` > 0; `poles` (n) of A - K C, A the shift, or `gains` K (n) in their place; `initial` the plant's
    state; `accept` ids of refuted checks to ignore.

    Raises: `Refuted`; `BadPoles`; `NotHurwitz` for gains that do not decay; `BadGain` for theta <= 0, gains of another
    length, another form, an output that is nonlinear in its state, or a partial derivative that is not proved to be
    nonzero.
    """
    accept = demand_form("uniform_injection", form, accept, requires=_split)
    high, form = positive_theta(theta), _split("uniform_injection", form)
    K = injection_gains("uniform_injection", poles, gains, form.n)
    dynamics, z = Dynamics(form), state_field(form, initial, high.initial[0])
    entries = [sp.diff(form.output[0], form.states[0])]  # of Lambda
    for each in slopes_on(form):
        entries.append(entries[-1] * each)
    inverse = Dynamics(replace(form, jacobian=sp.ImmutableDenseMatrix(sp.diag(*entries))))
    labels = tuple(f"theta{f'^{i}' if i > 1 else ''} K_{i}" for i in range(1, form.n + 1))

    def remainder(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        push = inverse.pulled(sym("derived", "K", form.n), values["z"], u, None)
        return {
            "z": dynamics.flow(values["z"], u) + push * (valid * dynamics.error(y, dynamics.output(values["z"], u)))
        }

    part = Ode(
        (z,),
        remainder,
        core=high.initial[0] * companion(K),
        derived=(Field("K", (0.0,) * form.n, labels=labels, meaning="observer gain"),),
        tune=(Block("observer gain", {Place("derived", "K"): scaled(K, sym("gain", "theta"))}),),
    )
    error = uniform_error(form, tuple(K.tolist()))
    slopes = (f"{float(form.A[k, k + 1]):g} in {z}" for k, z in enumerate(form.states[1:]))
    return Observer(
        form=form,
        name="uniform_injection",
        parts=(part,),
        gains=(high,),
        z=sym("state", "z", form.n),
        dynamics=dynamics,
        claims=lambda: (*form.checks, *theta_checks("uniform_injection", form, high.initial[0], error)),
        accepted=accept,
        theorem=THEOREM,
        equations=(EQUATION, f"K = {listed(K)}", f"beyond the ranges F goes on with the slopes {', '.join(slopes)}"),
        reference=REFERENCE,
    )


def _split(observer: str, form: Form) -> Form:
    """Return the form z' = F(z, u) rewritten as A z + b, A = s_k above its diagonal, b = F - A z."""
    if form.kind != "uniform" or not form.structured:
        fix = "use hg.forms.uniform, or high_gain"
        raise BadGain(observer, f"takes a uniform form, this one is {form.kind}", fix=fix)
    head, output = form.states[0], form.output[0]
    a = sp.diff(output, head)
    if sp.expand(output - a * head).has(head) or a.has(head):
        raise BadGain(observer, f"wants an output that is linear in its state, not {output}; recast the state as it")
    numbers = middles(form)
    if isinstance(numbers, Reason):
        raise BadGain(observer, f"divides by the slopes: {numbers}; declare or narrow the ranges, or use riccati")
    A = sp.zeros(form.n, form.n)
    for k, s in enumerate(numbers):
        A[k, k + 1] = s
    b = form.flow if not numbers else tuple(sp.Matrix(form.flow) - A * sp.Matrix(form.states))
    return replace(form, A=sp.ImmutableDenseMatrix(A), b=tuple(b))
