"""The filters of a discrete plant z+ = f(z, u): their equations, and the theorem of the extended Kalman filter.

    z <- f(z, u),  P <- F P F' + Q,  F = df/dz at the estimate before, which a sample has corrected
    at a sample of y_j:  K = P c'/(R_j + c P c'),  z <- z + K (y_j - h_j),  P <- P - K c P

Q and R are the covariance that a step adds and the variance of a sample, as they stand. Nothing is scaled by the
sampling period. Source of the theorem: K. Reif, S. Guenther, E. Yaz, R. Unbehauen, "Stochastic stability of the
discrete-time extended Kalman filter", IEEE TAC 44 (1999).
"""

from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Form
from hgogen.reading.given import BadGain
from hgogen.sentence import because
from hgogen.theorem import OPERATION, Hypothesis, Theorem

REFERENCE = (
    "Reif, Guenther, Yaz, Unbehauen, Stochastic stability of the discrete-time extended Kalman filter, IEEE TAC 44 "
    "(1999), theorem 3.1"
)
PREDICTION = "z <- f(z, u), P <- F P F' + Q, F = df/dz at the corrected z"
CORRECTION = "at a sample of y_j: K = P c'/(R_j + c P c'), z <- z + K (y_j - h_j), P <- P - K c P, c = dh_j/dz"
# hypotheses of continuous time
_CONTINUOUS = ("y and the input are known at all times", "y is measured without noise")
THEOREM = Theorem(
    "the mean square of the error stays bounded",
    (
        Hypothesis(
            "the first error, the noises and the terms of second order of f and h are small enough",
            verdict=Verdict.UNKNOWN,
            reason="the theorem's constants are existential: no number is known to be small enough",
            reference="theorem 3.1",
        ),
        Hypothesis(
            "the covariance stays between two positive bounds",
            verdict=Verdict.UNKNOWN,
            reason="nothing here bounds the covariance along a trajectory",
            reference="theorem 3.1",
        ),
        Hypothesis(
            "df/dz is not singular",
            verdict=Verdict.UNKNOWN,
            reason="it is not examined on the ranges",
            reference="theorem 3.1",
        ),
        *(each for each in OPERATION if each.claim not in _CONTINUOUS),
    ),
    REFERENCE,
)


def no_proof(observer: str) -> Check:
    """Return the check `OBSERVER.convergence` of a discrete plant, unknown."""
    reason = because("no proof here is made of discrete plants")
    return Check(
        ClaimId(observer, "convergence"), THEOREM.conclusion, Verdict.UNKNOWN, reason, fix="Validate by trials."
    )


def demand_plain_gain(form: Form, theta: float) -> None:
    """Raise `BadGain` for a discrete plant and a theta above 1, which speeds up differential equations."""
    if form.system.discrete and theta != 1:
        reason = "speeds up the correction of differential equations, and the plant is discrete in time; leave it at 1"
        raise BadGain(f"theta = {theta:g}", reason)
