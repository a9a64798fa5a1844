"""Kalman-like observer with forgetting, for plants that are state-affine up to output injection.

    z' = A(u, y) z + b(u, y) + S^-1 C' R^-1 (y - C z - d)
    S' = -rho (S - S_0) - A' S - S A + C' R^-1 C - S Q_0 S,   Q_0 = q rho S_0^-1,   q = 1e-14
    P = S^-1:   P' = rho (P - P S_0 P) + A P + P A' + Q_0 - P C' R^-1 C P

For every trajectory (e' S e)' = -rho (e' S e - e' S_0 e) - |C e|^2/R - e' S Q_0 S e: e' S e decays like exp(-rho
(1 - s) t) or faster, where s is the largest eigenvalue of S_0 P. The effect of Q_0 on S is at most that of forgetting
at the rate rho (1 + q w), where w is the largest eigenvalue of S_0^-1 S. At that constant rate the equation of S is
linear, and S is at least the Gramian of the samples plus the contribution of S_0. Where the input is regularly
persistent, that Gramian is at least a multiple a of the unit matrix and s <= |S_0|/a; if this is below 1, |e| decays
like exp(-rho (1 - s) t/2) from any initial state. No gain needs to be large, and an a_i may be zero.

The source has S_0 = 0, with which P grows like exp(rho t) where the input or missing samples make a state unobservable.
Here S_0 is the inverse of the squares of the outer box's half-widths, far below S where the state is observable. S_0
acts like a sample of every state that equals the estimate, with the information rho S_0 per second. Without
observability S_0^1/2 P S_0^1/2 stays below max(initial, 1 + q + 2 max(mu, 0)/rho), where mu is the largest logarithmic
norm of M = S_0^1/2 A S_0^-1/2, and P keeps the correlations due to A. The status COVARIANCE_LIMITED is set where sum_i
P_ii S_0ii, which is at least s, is above 1/2; where it is not set, s < 1 at that sample. Initially s is at most 1/4.

The source has Q_0 = 0, with which S grows without bound in modes that decay faster than exp(-rho t/2), and P becomes
singular in floating-point arithmetic. With Q_0, w stays below max(initial, max(x, 0)/q + sqrt((1 + m)/q)), x = 2
nu/rho - 1, where nu is the largest logarithmic norm of -M and rho m the largest eigenvalue of S_0^-1/2 C' R^-1 C
S_0^-1/2: no eigenvalue of S_0^1/2 P S_0^1/2 falls below 1/w. After a step no D_i of P = L D L' is below h Q_0ii
whatever the rounding, since Gram-Schmidt on [Phi L, I] turns the unit matrix into a unit triangular one. q is the
squared rounding unit of a float: Q_0 adds far less than P where the state is observable.

In modes that decay so fast, P is small with or without samples: about q/x of S_0^-1 without samples, for x > 0. After a
jump of the plant the error in such a mode decays hardly faster than in the plant, and its effect on other states decays
like exp(-rho t/2). A rho above twice the rate of every mode avoids this. A and b read the measurement without filtering
its noise.

Source: H. Hammouri, J. de Leon Morales, "Observer synthesis for state-affine systems", 29th IEEE CDC (1990); G.
Besancon, G. Bornard, H. Hammouri, European Journal of Control 2 (1996), for the output injection; M. Salgado, G.
Goodwin, R. Middleton, International Journal of Control 47 (1988), for the terms in S_0 and Q_0 (delta P^2, beta I).
"""

from collections.abc import Iterable, Mapping
from typing import Any

import casadi as ca
import numpy as np

from hgogen.analysis.chain import with_measured_states
from hgogen.analysis.dynamics import Dynamics
from hgogen.check import ClaimId, Claims, Verdict, demand
from hgogen.estimators.noise import declares_noise
from hgogen.estimators.persistence import gramian_bound, persistent, seconds
from hgogen.estimators.riccati_part import Riccati, positive_gain, positive_numbers, spd
from hgogen.estimators.theta import constant
from hgogen.form import Form
from hgogen.observer import Observer, demand_form, gain, state_field
from hgogen.program import Bit, sym
from hgogen.reading.given import BadGain, Matrix, Values, by_coordinate, by_output, names_of, positive
from hgogen.sentence import same
from hgogen.signal import LOST
from hgogen.starting import starts, two_digits
from hgogen.theorem import OPERATION, Hypothesis, Theorem

REFERENCE = "Hammouri, de Leon Morales, Observer synthesis for state-affine systems, CDC 1990"
EQUATIONS = (
    "z' = A(u, y) z + b(u, y) + S^-1 C' R^-1 (y - C z - d)",
    "S' = -rho (S - S_0) - A' S - S A + C' R^-1 C - S Q_0 S,   P = S^-1",
)
SHARE = 1e-14  # q: the squared rounding unit of a float
PERSISTENCE = ClaimId("kalman_like", "persistence")
GRAMIAN = ClaimId("kalman_like", "gramian")
THEOREM = Theorem(
    "the estimate converges from any initial state, |error| like exp(-rho (1 - s) t/2), s the largest eigenvalue of "
    "S_0 P",
    (
        Hypothesis("x' = A(u, y) x + b(u, y), y = C(u) x + d(u)", (Claims("state_affine", "structure"),)),
        Hypothesis(
            "A(u, y) x + b(u, y) is Lipschitz in x, so that A is bounded", (Claims("state_affine", "lipschitz"),)
        ),
        Hypothesis("z is a change of coordinates, and its ranges hold the plant's", (Claims("recast"),), optional=True),
        Hypothesis(
            "the input is regularly persistent: over some time the outputs show every state, again and again",
            (Claims("kalman_like", "persistence"),),
        ),
        Hypothesis("S(0), R are positive definite, rho > 0", verdict=Verdict.PROVED, reason="else it is refused"),
        *OPERATION,
        Hypothesis(
            "the largest eigenvalue s of S_0 P is below 1: the input shows more than S_0 does",
            reason="where the status COVARIANCE_LIMITED is unset, s < 1 at that sample: s is at most the sum of P_ii "
            "S_0ii, and the status tells that this is above 1/2",
        ),
    ),
    REFERENCE,
)

LIMITED = Bit(
    "COVARIANCE_LIMITED",
    "the sum of P_ii S_0ii is above 1/2, and s may be 1 or more: samples are missing, or the input shows too little",
    "wait for samples, excite the plant; if it stays while the input varies, lower rho, or scale R down",
)


@starts(
    "a_i(u) is 0 at times and the plant is state-affine",
    "a regularly persistent input, which is checked",
    "n(n+3)/2",
    lambda s: {"rho": two_digits(1 / s.longest), "R": s.variance(), "covariance": s.start()},
)
@declares_noise
def kalman_like(
    form: Form,
    *,
    rho: float,
    R: float | Values,
    inputs: Mapping[str, Any] | None = None,
    period: Any = None,
    window: float | None = None,
    initial: Values | None = None,
    covariance: Matrix | None = None,
    accept: Iterable[str] = (),
) -> Observer:
    """The observer z' = A(u, y) z + b(u, y) + P C' R^-1 (y - C z - d), P' = rho (P - P S_0 P) + A P + P A' - P C' R^-1
    C P, of `forms.state_affine(plant)`, any number of outputs; S_0 = diag(1/l_i^2), l_i the half-widths of the outer
    box.

    Args: `rho` > 0 (1/s), the forgetting rate; `R` positive, one for each output, unit y^2 s: that of the noise (for
    white noise of variance v per sample, v dt), so that P is distinct from S_0^-1; `noise`, `R_per_sample` in place of
    R, and `density`, as in `riccati`; `inputs`, `period`: the future
    inputs, where they are known, for the check of persistence (see `estimators.persistence`; `hgogen.excitation`
    analyses measured data); `window` (s) of the Gramian whose smallest eigenvalue is bounded, by default that period,
    or 1/rho where A and C are constant; `initial` the plant's state; `covariance` P(0), diagonal (n) or (n, n), by the
    names of the states or in their order, default the squares of the half-widths of the ranges, 1 without one; `accept`
    ids of refuted checks to ignore.

    Checks: `kalman_like.persistence`; `kalman_like.gramian`, a lower bound of the observability Gramian over every
    window of the inputs.

    Raises: `Refuted`; `BadGain`; `BadNames`.
    """
    if isinstance(form, Form) and form.kind != "state_affine":
        raise BadGain("kalman_like", f"takes the form state_affine, not one of kind {form.kind}")
    accept = demand_form("kalman_like", form, accept, deferred=(PERSISTENCE,))
    check = persistent(PERSISTENCE, form, inputs, period)
    demand((*form.checks, check), accept, form)
    (rate,), n, outputs = positive_numbers("rho", rho, 1), form.n, len(form.output)
    variances = positive_numbers("R", by_output("R", R, form), outputs)
    length = None if window is None else positive("window", window)
    dynamics, z = Dynamics(form), state_field(form, initial, 1.0)
    half = np.array([(s.interval[1] - s.interval[0]) / 2 if s.bounded else 1.0 for s in form.states])
    start = spd("covariance", half**2 if covariance is None else by_coordinate("covariance", covariance, form), n)
    # the diagonal of S_0^-1: the square of the outer box's half-width, 1e12 P(0) without a range, raised until
    # no eigenvalue of S_0 P(0) is above 1/4
    variance, outer = np.diag(start), np.array([(high - low) / 2 for low, high in z.box])
    correlated = np.linalg.eigvalsh(start / np.outer(np.sqrt(variance), np.sqrt(variance)))[-1]
    widest = np.where(np.isfinite(outer), outer**2, 1e12 * variance)
    unseen = np.maximum(np.minimum(widest, LOST), 4 * correlated * variance)
    noise = SHARE * unseen
    gains = (
        gain("rho", rate, 1e-3 * rate, 1e3 * rate, "rate at which the past is forgotten", "1/s"),
        positive_gain("R", variances, "output noise", "y^2 s", names_of(form.system.outputs)),
    )
    part = Riccati(
        dynamics=dynamics,
        z=z,
        theta=constant(1.0),
        weights=sym("gain", "rho") * ca.SX(ca.DM(noise)),
        factor=np.eye(n),
        R=sym("gain", "R", outputs),
        covariance=start,
        cap=unseen,
        limited=LIMITED,
        nominal=(rate * np.diag(noise), np.array(variances)),
        forgetting=gains[0],
        measured_state=with_measured_states(dynamics),
        period=seconds(period),
    )
    return Observer(
        form=form,
        name="kalman_like",
        parts=(part,),
        gains=gains,
        z=sym("state", "z", n),
        dynamics=dynamics,
        claims=lambda: (*form.checks, check, gramian_bound(GRAMIAN, form, check, variances, length, 1 / rate)),
        accepted=accept,
        theorem=THEOREM,
        equations=(*EQUATIONS, f"S_0^-1 = diag({', '.join(map(same, unseen))}),   Q_0 = {SHARE:g} rho S_0^-1"),
        reference=REFERENCE,
    )
