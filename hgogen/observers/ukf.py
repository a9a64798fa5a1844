"""Unscented Kalman filter in square-root form: sigma points represent mean and covariance, without a Jacobian.

    points   z and z +- g s_i,  S S' = P,  g = alpha sqrt(n + kappa)
    time     z, P: mean and covariance of the points after a Runge-Kutta step each; P <- P + h Q
    sample   K = S f/(r + |f|^2),  z <- z + K (y - mean of h),  P <- P - K (r + |f|^2) K'

f are half the differences of h over pairs of points, and r = R/h plus the second-order terms of these pairs. On a
linear plant it is the Kalman filter. Compare it with `riccati` at the same Q, R and P(0): it includes second-order
effects, at the cost of 2n + 1 evaluations of the model per step. Source: Julier, "The scaled unscented transformation",
ACC 2002; van der Merwe, Wan, ICASSP 2001.
"""

from collections.abc import Iterable, Mapping
from fractions import Fraction
from math import sqrt

from hgogen.check import Verdict
from hgogen.estimators import discrete
from hgogen.estimators.gate import Gates, with_gates
from hgogen.estimators.noise import declares_noise
from hgogen.estimators.riccati_part import SampledFilter, Variances, extended
from hgogen.estimators.square_root import LARGEST, Unscented
from hgogen.form import Form
from hgogen.observer import Observer, demand_form
from hgogen.program import sym
from hgogen.reading.given import BadGain, Matrix, Values, positive, real
from hgogen.sentence import up
from hgogen.starting import starts
from hgogen.theorem import FORM, OPERATION, Hypothesis, Theorem

REFERENCE = (
    "van der Merwe, Wan, The square-root unscented Kalman filter for state and parameter-estimation, ICASSP 2001"
)
EQUATIONS = (
    "points z, z +- g s_i with S S' = P; z, P: their mean and covariance after a step, P <- P + h Q",
    "K = S f/(r + |f|^2), z <- z + K (y - mean of h), f the half differences of h over pairs of points",
)
MAP_EQUATIONS = (
    "points z, z +- g s_i with S S' = P, drawn anew for each sample; z, P: mean and covariance after f, P <- P + Q",
    EQUATIONS[1],
)
THEOREM = Theorem(
    "the estimate's mean square error stays bounded",
    (
        *FORM,
        Hypothesis(
            "the first error, the noises and the terms that the points miss are small enough",
            verdict=Verdict.UNKNOWN,
            reason="the theorem's constants are existential: no number is known to be small enough",
            reference="theorem 1",
        ),
        Hypothesis(
            "the outputs are linear in the state, and the covariance stays between two positive bounds",
            verdict=Verdict.UNKNOWN,
            reason="nothing here bounds the covariance along a trajectory",
            reference="theorem 1",
        ),
        *OPERATION,
    ),
    "Xiong, Zhang, Chan, Performance evaluation of UKF-based nonlinear filtering, Automatica 42 (2006)",
)


@starts(
    "the noise is known and the model is strongly nonlinear over one standard deviation of the estimate",
    "as `riccati`; a spread of the sigma points",
    "n(n+3)/2",
    lambda scale: scale.kalman,
    quick=LARGEST,
)
@declares_noise
def ukf(
    form: Form,
    *,
    Q: Matrix,
    R: float | Values | Variances,
    U: Mapping[str, float] | None = None,
    alpha: float = 1.0,
    beta: float = 2.0,
    kappa: float = 0.0,
    initial: Values | None = None,
    covariance: Matrix | None = None,
    gate: Gates | None = None,
    update: str = "sequential",
    accept: Iterable[str] = (),
) -> Observer:
    """The unscented Kalman filter of `form`, of up to 7 states: P = S S', and mean and covariance after the model from
    its values at the sigma points z, z +- g s_i, s_i the columns of S.

    Args: `Q`, `R`, `U`, `noise`, .., `initial`, `covariance`, `gate`, `update` as in `riccati`; `alpha` > 0, `beta` and
    `kappa` > -n of the scaled unscented transform, with beta >= -alpha^2 kappa/n, which keeps P positive definite; a
    point lies g = alpha sqrt(n + kappa) standard deviations from the estimate, 1e-3 <= g <= 1e3. In single precision,
    rounding adds about 6e-8 |z|/g to a standard deviation and 6e-8 |z|/g^2 to the estimate at each step, for g = 1e-3
    6 % of z. `accept` ids of refuted checks to ignore.

    Raises: `Refuted` for a refuted hypothesis that is not accepted; `BadGain`; `BadNames`; `Singular` for a model
    whose Jacobian is finite nowhere.
    """
    accept = demand_form("ukf", form, accept, discrete=True)
    if form.n > LARGEST:
        raise BadGain("ukf", f"takes up to {LARGEST} states, there are {form.n}; take riccati, which loops")
    reach, more = _points(form.n, positive("alpha", alpha), real("beta", beta), real("kappa", kappa))
    share = 6e-8 / reach**2
    rounding = f"; in single precision a step rounds the estimate by some {share:.0e} of it" * (share > 1e-5)
    filter = extended(form, Q, R, covariance, initial, tangent=False, U=U, gate=gate, update=update)
    part, theorem = filter.part, discrete.THEOREM if form.system.discrete else THEOREM
    observer = Observer(
        form=form,
        name="ukf",
        parts=(
            SampledFilter(part, "the unscented filter", lambda clock: Unscented(part, clock, reach, more).pieces()),
        ),
        gains=filter.gains,
        z=sym("state", "z", form.n),
        dynamics=part.dynamics,
        claims=lambda: (*form.checks, discrete.no_proof(form, "ukf", theorem)),
        accepted=accept,
        theorem=theorem,
        equations=(
            *(MAP_EQUATIONS if form.system.discrete else EQUATIONS),
            f"g = {reach:g}, alpha = {alpha:g}, beta = {beta:g}{rounding}",
            *filter.equations,
        ),
        reference=REFERENCE,
    )
    return with_gates(observer, filter.part.gates)


def _points(n: int, alpha: float, beta: float, kappa: float) -> tuple[float, float]:
    """Return g = alpha sqrt(n + kappa), the distance of a sigma point, and beta - alpha^2."""
    if not kappa > -n:
        raise BadGain(f"kappa = {kappa:g}", f"must be above -{n}, the number of states with a minus")
    reach = alpha * sqrt(n + kappa)
    if not 1e-3 <= reach <= 1e3:
        wanted = "must be from 1e-3 to 1e3: floats lose what closer points differ by"
        raise BadGain(f"alpha sqrt(n + kappa) = {reach:g}", wanted)
    least = -(Fraction(str(alpha)) ** 2) * Fraction(str(kappa)) / n  # of decimals, as 0.1^2 * 0.8/2 = 0.004
    if not (abs(beta) <= 1e6 and Fraction(str(beta)) >= least):
        wanted = f"must be from -alpha^2 kappa/n = {up(least, 6)} to 1e6, so that the covariance stays positive"
        julier = "; with a negative kappa, such as Julier's 3 - n, it may not: take kappa = 0, or a beta from there on"
        raise BadGain(f"beta = {beta:g}", wanted + julier * (kappa < 0))
    return reach, beta - alpha**2
