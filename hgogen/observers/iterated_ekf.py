"""Iterated extended Kalman filter: at each sample the estimate that fits sample and prediction best, by Gauss-Newton.

    minimise  |z+ - z|^2_(P^-1) + (y - h(z+))^2 h/R   at each sample, in passes from z on, by halved steps where needed
    P <- P - K c P,  K = P c'/(R/h + c P c'),  c = dh/dz at z+

Between samples, and for outputs linear in the state, it is the extended Kalman filter. Compare it with `riccati` at the
same Q, R and P(0) where an output is strongly nonlinear over the size of the estimation error. Source: Bell, Cathey,
"The iterated Kalman filter update as a Gauss-Newton method", IEEE TAC 38 (1993).
"""

from collections.abc import Iterable, Mapping

from hgogen.analysis.linearised import evaluated
from hgogen.check import Verdict
from hgogen.estimators import discrete
from hgogen.estimators.gate import Gates, with_gates
from hgogen.estimators.noise import declares_noise
from hgogen.estimators.riccati_part import SampledFilter, Variances, extended, noise_rank
from hgogen.estimators.square_root import LARGEST, Iterated
from hgogen.estimators.theta import KALMAN, of_form
from hgogen.form import Form
from hgogen.observer import Observer, demand_form
from hgogen.program import sym
from hgogen.reading.given import BadGain, Matrix, Values, count
from hgogen.starting import starts
from hgogen.theorem import Hypothesis

REFERENCE = "Bell, Cathey, The iterated Kalman filter update as a Gauss-Newton method, IEEE TAC 38 (1993)"
EQUATIONS = (
    "at a sample: z+ minimises |z+ - z|^2_(P^-1) + (y - h(z+))^2 h/R, in passes from z on",
    "P <- P - K c P, K = P c'/(R/h + c P c'), c = dh/dz at z+",
)
MAP_EQUATIONS = (discrete.PREDICTION, *(line.replace("h/R", "1/R").replace("R/h", "R") for line in EQUATIONS))
THEOREM = KALMAN.under(
    Hypothesis(
        "a sample moves the estimate so little that the first pass is the last",
        verdict=Verdict.UNKNOWN,
        reason="the theorem is of continuous time, where there is nothing to repeat",
    )
)
MOST = 10  # passes: each is the output, its row and a cost in straight-line code


@starts(
    "the noise is known and an output is strongly nonlinear over one standard deviation of the estimate",
    "as `riccati`",
    "n(n+3)/2",
    lambda scale: scale.kalman,
    quick=LARGEST,
)
@declares_noise
def iterated_ekf(
    form: Form,
    *,
    Q: Matrix,
    R: float | Values | Variances,
    U: Mapping[str, float] | None = None,
    passes: int = 4,
    initial: Values | None = None,
    covariance: Matrix | None = None,
    gate: Gates | None = None,
    update: str = "sequential",
    accept: Iterable[str] = (),
) -> Observer:
    """The iterated extended Kalman filter of `form`, of up to 7 states: at a sample, Gauss-Newton passes minimise |w|^2
    + (y_j - h_j(z + S w))^2/r over w, P = S S', and z <- z + S w.

    Args: `Q`, `R`, `U`, `noise`, .., `initial`, `covariance`, `gate`, `update` as in `riccati`; `passes` (1 to 10) of
    Gauss-Newton for each sample of an output that is not linear in the state; `accept` ids of refuted checks to ignore.

    Raises: `Refuted` for a refuted hypothesis that is not accepted; `BadGain`; `BadNames`; `Singular` for a model
    whose Jacobian is finite nowhere.
    """
    accept = demand_form("iterated_ekf", form, accept, linearises=True, discrete=True)
    if form.n > LARGEST:
        raise BadGain("iterated_ekf", f"takes up to {LARGEST} states, there are {form.n}; take riccati, which loops")
    passes = count("passes", passes, 1, MOST)
    filter = extended(form, Q, R, covariance, initial, U=U, gate=gate, update=update)
    part = filter.part
    observer = Observer(
        form=form,
        name="iterated_ekf",
        parts=(SampledFilter(part, "the iterated filter", lambda clock: Iterated(part, clock, passes).pieces()),),
        gains=filter.gains,
        z=sym("state", "z", form.n),
        dynamics=part.dynamics,
        claims=lambda: (*form.checks, *evaluated(form), discrete.no_proof(form, "iterated_ekf", THEOREM)),
        accepted=accept,
        theorem=of_form(THEOREM, form, rank=noise_rank(part, form.names)),
        equations=(
            *(MAP_EQUATIONS if form.system.discrete else EQUATIONS),
            f"at most {passes} passes a sample",
            *filter.equations,
        ),
        reference=REFERENCE,
    )
    return with_gates(observer, filter.part.gates)
