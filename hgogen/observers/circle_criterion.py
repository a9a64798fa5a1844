"""High-gain observer that puts the output error into the argument of the nonlinear part as well.

    z' = A z + b(sat(z + N_theta (y - C z)), u) + diag(theta, .., theta^n) K (y - C z),   N_theta = (theta^(j-1) N_j)

on chains with constant a_i. With J = db/dz the error equation contains J (I - N C) e instead of J e. For N_1 = 1/a_1
and N_j = 0 otherwise, b reads the sample instead of z_1, and its partial derivative in z_1 has no effect on the error.
Other N, such as those of `hg.design.gain` with an `argument`, reduce the effect of the other partial derivatives. In
return, measurement noise enters b. At theta = 1 it is the observer of Arcak, Kokotovic, "Nonlinear observers: a circle
criterion design and robustness analysis", Automatica 37 (2001), (5), with b clamped. With the powers of theta, a proof
at one theta is valid for every larger one.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import sympy as sp

from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.hypotheses import clamped_lipschitz
from hgogen.analysis.scaling import chain_errors, output_weights
from hgogen.estimators.gains import ScaledGain, columns
from hgogen.estimators.integrators import injected_chains
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.observer import Observer, demand_form, positive_theta, state_field
from hgogen.part import Ode
from hgogen.program import Field, sym
from hgogen.prove.constant_gain import argument_obstacle, bounded, constant_gain, entries_of, injected, sample_in_place
from hgogen.prove.region import theta_checks
from hgogen.reading.given import BadGain
from hgogen.starting import starts
from hgogen.theorem import FORM, HURWITZ, OPERATION, Theorem, large_theta

REFERENCE = "Arcak, Kokotovic, Nonlinear observers: a circle criterion design, Automatica 37 (2001)"
EQUATIONS = (
    "z' = A z + b(sat(z + N_theta (y - C z)), u) + diag(theta, .., theta^n) K (y - C z)",
    "N_theta = (theta^(p(j) - p(k)) N_jk), p(j) the power of theta that scales z_j",
)
THEOREM = Theorem(
    "the estimate converges exponentially from any initial state",
    (*FORM, HURWITZ, large_theta("circle_criterion"), *OPERATION),
    REFERENCE,
)

_FAR = 1e15  # an entry this large overflows with powers of theta and in single precision


@starts(
    "b varies strongly with the measured state, or a designed gain should pass less noise",
    "constant a_i; convergence is proved above a bound on theta; measurement noise also enters b",
    "n",
    lambda s: s.high,
)
def circle_criterion(
    form: Form,
    *,
    theta: float,
    poles: Sequence[Any] | None = None,
    gains: Sequence[Any] | np.ndarray | None = None,
    argument: Sequence[Any] | np.ndarray | None = None,
    initial: Mapping[str, float] | Sequence[float] | None = None,
    accept: Iterable[str] = (),
) -> Observer:
    """The observer z' = A z + b(z + N_theta e, u) + diag(theta, .., theta^n) K e, e = y - C z, N_theta = (theta^(j-1)
    N_j), on a form in chains z_i' = a_i z_(i+1) + b_i(z, u) with constant a_i.

    Checks: `circle_criterion.convergence` (a bound on theta is proved), `circle_criterion.theta` (theta is above it).

    Args: `theta` > 0; `poles` (n) of A - K C, or `gains` K (n), of several chains a sequence of these, or a matrix (n,
    q) of gains, as in `high_gain`; `argument` N (n), of several chains likewise, in units of a state over those of the
    output, up to 1e15, by default 1/a_1 in the row of each chain's first state and 0 elsewhere: b then reads the
    sample; `initial` the plant's state; `accept` ids of refuted checks to ignore.

    Raises: `Refuted`; `BadPoles`; `NotHurwitz`; `BadGain` for theta <= 0, gains of another length, or a form that has
    no chains or an a_i that depends on an input.
    """
    accept = demand_form("circle_criterion", form, accept)
    high, dynamics = positive_theta(theta), Dynamics(form)
    theta = high.initial[0]
    chosen = constant_gain("circle_criterion", form, poles, gains, output_weights(form, None), endless=True)
    if why := argument_obstacle(form):
        raise BadGain("circle_criterion", f"does not take this form: {why}; use high_gain")
    entries = _entries(form, argument)
    placed = zip(columns(form, len(entries)), entries, strict=True)
    values = {replace(at, power=at.power - 1): sp.sympify(entry) for at, entry in placed if entry != 0}
    printed = tuple(sp.Float(float(x)) if x.is_Rational and not x.is_Integer else x for x in values.values())
    N = ScaledGain("N", printed, tuple(values), "gain into the argument of b")
    error = injected(chosen.error, form, entries)
    return Observer(
        form=form,
        name="circle_criterion",
        parts=(_part(dynamics, chosen.K, N, state_field(form, initial, theta)),),
        gains=(high,),
        z=sym("state", "z", form.n),
        dynamics=dynamics,
        claims=lambda: (
            *form.checks,
            *clamped_lipschitz("circle_criterion", form),
            *theta_checks("circle_criterion", form, theta, error),
        ),
        accepted=accept,
        theorem=THEOREM.with_chains() if len(form.blocks) > 1 else THEOREM,
        equations=(*EQUATIONS, f"K = {chosen.K}", f"N = {N}"),
        reference=REFERENCE,
        error=bounded(error, form),
    )


def _entries(form: Form, argument: Any) -> tuple[sp.Expr, ...]:
    if argument is None:
        return sample_in_place(form)
    if isinstance(argument, Sequence | np.ndarray) and len(argument) == 0:
        raise BadGain("argument", "is empty, as of a designed gain where none does better: take high_gain")
    entries = entries_of("argument", argument, form)
    if not any(entries):
        raise BadGain("argument", "is 0 throughout, so that nothing is injected into b: take high_gain")
    if max(map(abs, entries)) > _FAR:
        raise BadGain(f"argument = {argument!r}", f"must be numbers up to {_FAR:g}; take other units")
    return tuple(sp.Rational(Fraction(x)) for x in entries)


def _part(dynamics: Dynamics, K: ScaledGain, N: ScaledGain, z: Field) -> Ode:
    """Return z' = A z + K (y - C z - offset) + b(z + N (y - C z - offset), u) as a differential equation."""
    form, weights = dynamics.form, output_weights(dynamics.form, None)

    def remainder(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        z = values["z"]
        e = chain_errors(form, weights, dynamics.error(y, dynamics.output(z, u)), valid)
        return {"z": dynamics.nonlinear(z + N.injection(e, dynamics.n), u)}

    part = injected_chains(dynamics, K, weights, remainder)
    return replace(part, fields=(z,), derived=(K.field, N.field), tune=(K.tuned(form), N.tuned(form)))
