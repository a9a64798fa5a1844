"""Steady-state Kalman filters: the constant gain of a settled Riccati equation, and the convergence of the filter.

1. The gain to which the Riccati equation of a form settles, linearised at a point:

    0 = F P + P F' + Q_theta - P C' R_theta^-1 C P,   P C' R_theta^-1 = (theta^(p(i) - p(k) + 1) K_ik)

F and C are those of the form at the point, Q_theta and R_theta of `scaling`. In scaled coordinates, with N = Delta F
Delta^-1/theta = A + Delta b* Delta^-1/theta and P = Delta^-1 S^-1 Delta^-1, theta cancels:

    0 = N S^-1 + S^-1 N' + Q - S^-1 C' R^-1 C S^-1,   K = S^-1 C' R^-1

K depends on theta by the slopes of b alone: `observers.high_gain` with this K has at this theta the gains of the
settled filter, and another theta is that of a constant gain. Source: of the equation, Boizot, Busvelle, Gauthier,
Automatica 46 (2010), (4); of its refinement, D. L. Kleinman, IEEE TAC 13 (1968).

2. The convergence of a Kalman filter of a linear plant with constant coefficients, by ranks in exact arithmetic:

    x' = A x + b(u),  y = C x + d(u),   P' = A P + P A' + Q - P C' R^-1 C P,   e' = (A - P C' R^-1 C) e

Where (C, A) is observable and (A, Q) controllable, P converges from every P(0) > 0 to the one positive definite P of
the algebraic equation, for which A - P C' R^-1 C is Hurwitz, so that e converges exponentially from everywhere. Both
ranks are n where the matrices sum_k (A')^k C'C A^k and sum_k A^k Q Q' (A')^k, k < n, are positive definite. Source: R.
E. Kalman, R. S. Bucy, "New results in linear filtering and prediction theory", J. Basic Engineering 83 (1961), section
7.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import sympy as sp
from flint import fmpq_mat

from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.linearised import jacobians_at
from hgogen.analysis.ranges import fixed_parameters
from hgogen.analysis.scaling import exponents
from hgogen.analysis.undefined import undefined_values
from hgogen.discretisation.stability import FrozenRiccati
from hgogen.estimators.riccati_part import positive_numbers, spd
from hgogen.form import Form
from hgogen.observer import state_field
from hgogen.prove.constant_gain import constant_chains
from hgogen.prove.quadratic import lyapunov
from hgogen.reading.given import (
    BadGain,
    BadNames,
    Matrix,
    Values,
    by_coordinate,
    by_output,
    in_order,
    names_of,
    positive,
    real,
    requires_form,
)
from hgogen.rigor import definite
from hgogen.rigor.box import exact as exactly
from hgogen.rigor.definite import demand_hurwitz, exact, hurwitz, nonnegative
from hgogen.sentence import Reason, because, same
from hgogen.signal import Signal

Rows = tuple[tuple[float, ...], ...]

_WEAKEST = 1e-9  # least singular value of an observable state, over the largest
_SETTLED = 1e-9  # residual of the equation, over its largest term
_LARGER = (1.5, 2, 3, 5, 10, 20, 50, 100, 1000)  # factors of theta that are tried where its gain does not decay
_ROUNDS = 4  # of Kleinman's refinement, which squares the error


@requires_form
def steady_gain(
    form: Form,
    Q: Matrix,
    R: float | Values,
    theta: float = 1.0,
    *,
    at: Mapping[str, float],
    u: Mapping[str, float] | None = None,
) -> tuple[float, ...] | Rows:
    """Return the constant gain K of the observer `riccati` after its Riccati equation has settled at an operating
    point: (n), for several chains rows (n, q). The observer `high_gain(form, theta=theta, gains=K)` then has the
    injection P C'R^-1 of this equation's solution P.

    Args: `Q`, `R`, `theta` as of `observers.riccati`: Q diagonal (n) or (n, n), unit z^2/s, R of each output, unit y^2
    s; `at`: the operating point, every state of the plant by name; `u`: every input by name; parameters have their
    nominal values. Proofs about the observer are those of any constant gain: they do not assume the operating point.
    Raises: `BadGain` for Q, R, theta that are not positive, a point outside its ranges, or one at which not every state
    is observable; `BadNames`; `NotHurwitz` where the decay needs the slopes of b, which a clamped estimate does not
    have; `Misfit`.
    """
    demand_chains(form)
    noise, level = spd("Q", by_coordinate("Q", Q, form), form.n), positive("theta", theta)
    variances = np.array(positive_numbers("R", by_output("R", R, form), len(form.output)))
    point, place = _point(form, at, u)
    (F,), (C,) = jacobians_at(Dynamics(form), point[None])
    inputs = dict(zip(form.system.inputs, point[form.n :].tolist(), strict=True))
    A = np.array(form.A.subs(form.system.nominal).subs(inputs).tolist(), dtype=float)
    powers = np.array(exponents(form), dtype=float)

    def at_theta(value: float) -> np.ndarray:
        scaled = F * value ** (powers[None, :] - powers[:, None] - 1)  # Delta F Delta^-1/theta; C is as it is
        return _settled(scaled, C, noise, variances, place)

    K = at_theta(level)
    if not hurwitz(A - K @ C):
        larger = (level * factor for factor in _LARGER)
        enough = next((value for value in larger if hurwitz(A - at_theta(value) @ C)), None)
        ways = "raise Q of states whose b is steep" if enough is None else f"theta = {enough:g} would do"
        fix = f"they lean on the slopes of b at {place}, and those of a clamped estimate are 0; {ways}"
        demand_hurwitz(f"the steady gains at theta = {level:g}", A - K @ C, fix)
    return tuple(K[:, 0].tolist()) if len(form.output) == 1 else tuple(map(tuple, K.tolist()))


def demand_chains(form: Form) -> None:
    """Demand a form with a chain for each output, as a constant gain needs in place of a filter's. Raises:
    `BadGain`."""
    constant_chains("steady_gain", form)
    if form.jacobian is not None or len(form.leads) < len(form.output):
        reason = "wants coordinates in which the gain acts, and a chain for each output"
        raise BadGain("steady_gain", f"{reason}; take a form in chains, and leave outputs without one out of the plant")


def _point(form: Form, at: Any, u: Any) -> tuple[np.ndarray, str]:
    states, inputs = form.system.declared.states, form.system.inputs
    values = {**_values("at", at, states), **_values("u", {} if u is None else u, inputs)}
    z = state_field(form, values, 1.0).initial
    place = ", ".join(f"{name} = {same(value)}" for name, value in values.items())
    return np.array([*z, *(values[s.name] for s in inputs)]), place


def _values(what: str, values: Any, signals: Sequence[Signal]) -> dict[str, float]:
    names = names_of(signals)
    if not isinstance(values, Mapping):
        example = ", ".join(f"{name!r}: 0" for name in names)
        raise BadNames(what, f"= {values!r} is no mapping from names to numbers; give {{{example}}}")
    known = {}
    for signal, value in zip(signals, in_order(what, values, names), strict=True):
        known[signal.name] = number = real(f"{what} {signal.name}", value)
        low, high = signal.interval
        if not (np.isfinite(number) and low <= number <= high):
            raise BadGain(f"{what} {signal.name} = {number:g}", f"must be finite and in [{low:g}, {high:g}]")
    return known


def _settled(N: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray, place: str) -> np.ndarray:
    """Return the steady Kalman gain K = P C'R^-1 (n, p) of the P > 0 with N P + P N' + Q - P C'R^-1 C P = 0."""
    observed, F = [C], N / max(np.linalg.norm(N), 1e-300)
    for _ in N[1:]:
        observed.append(observed[-1] @ F)
    rows = np.vstack(observed)
    singular = np.linalg.svd(rows / np.maximum(np.abs(rows).max(axis=0), 1e-300), compute_uv=False)
    (P,) = FrozenRiccati.of(N[None], C[None], Q, R).steady(1.0)
    if not (singular[-1] > _WEAKEST * singular[0] and np.isfinite(P).all()):
        what = "shows not every state: (A, C) of the plant linearised there is not observable"
        raise BadGain(f"the point {place}", f"{what}; take one, or an input, at which the outputs show all of them")
    for _ in range(_ROUNDS):
        K = P @ C.T / R
        refined = lyapunov((N - K @ C).T, Q + K * R @ K.T)
        P = P if refined is None else refined
    K = P @ C.T / R
    residual = np.abs(N @ P + P @ N.T + Q - K * R @ K.T).max()
    sound = residual <= _SETTLED * max(np.abs(N @ P).max(), np.abs(Q).max())
    if not (sound and definite.positive(definite.exact(definite.rationals(P))) and hurwitz(N - K @ C)):
        raise BadGain(f"the point {place}", "has an equation too badly scaled to be solved; take units nearer to 1")
    return np.asarray(K)


STATES = 40  # above, products of rational matrices are slow


@dataclass(frozen=True)
class Linear:
    """The constant matrices of a linear plant z' = A z + b(u), y = C z + d(u), in rationals: `A` (n, n), `C` (p, n)."""

    A: definite.Matrix
    C: definite.Matrix


def linear(form: Form) -> Linear | Reason:
    """Return the constant matrices A and C of a linear form z' = A z + b(u), y = C z + d(u), in rationals; or the
    reason why the form has none."""
    z = {*form.states}
    if form.n > STATES:
        return because("the ranks of more than {most} states are not computed", most=STATES)
    if form.jacobian is not None or form.behind is not None:
        return because("the filter works in other coordinates than the form's")
    if form.limits:
        return because("values of b are limited")
    if undefined_values(form.system):
        return because("a rate or an output is not known to have a finite value everywhere")
    known = dict(fixed_parameters(form))
    slopes = sp.Matrix(form.output).jacobian(form.states)
    A, b, h, C = (exactly(sp.Matrix(rows)).xreplace(known) for rows in (form.A, form.b, form.output, slopes))
    d = (h - C * sp.Matrix(form.states)).expand()  # the slope of a jump is 0 elsewhere
    if (b.free_symbols | C.free_symbols | d.free_symbols) & z:
        return because("it is not linear in the state")
    if moving := sorted((A.free_symbols | C.free_symbols), key=str):
        return because("its coefficients vary with {names}", names=moving)
    if not all(e.is_Rational for e in (*A, *C)):
        return because("a coefficient is not rational")
    return Linear(*(tuple(tuple(Fraction(int(e.p), int(e.q)) for e in row) for row in M.tolist()) for M in (A, C)))


def divergence_reason(plant: Linear, Q: definite.Matrix, theta: float) -> Reason | None:
    """Return the reason why the Kalman filter of a linear plant with Q (n, n) and a constant theta is not proved to
    converge, by the ranks of (C, A) and (A, Q); None where it is."""
    A, C, noise = exact(plant.A), exact(plant.C), exact(Q)
    if not theta > 0:
        return because("theta is not positive")
    if noise != noise.transpose() or not nonnegative(noise):
        return because("Q is not symmetric, or has a negative eigenvalue")
    if not definite.positive(_gramian(A, C.transpose() * C, True)):
        return because("(C, A) is not observable: C, C A, .. have a rank below {n}", n=len(plant.A))
    if definite.positive(noise):
        return None
    if theta != 1:
        return because("Q is not positive definite, and theta scales it")
    if not definite.positive(_gramian(A, noise * noise, False)):
        return because(
            "(A, Q) is not controllable: Q, A Q, .. have a rank below {n}; the gain may vanish in a direction without "
            "noise",
            n=len(plant.A),
        )
    return None


def _gramian(A: Any, start: Any, turned: bool) -> fmpq_mat:
    """Return sum_k (A')^k M A^k for k < n where `turned`, else sum_k A^k M (A')^k."""
    total = term = start
    outer, inner = (A.transpose(), A) if turned else (A, A.transpose())
    for _ in range(A.nrows() - 1):
        term = outer * term * inner
        total = total + term
    return total
