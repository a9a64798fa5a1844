"""High-gain extended Kalman filter with constant, decaying or adaptive theta.

    z' = A(u) z + b(z, u) + S^-1 C' R_theta^-1 (y - C z)
    S' = -(A + b*)' S - S (A + b*) + C' R_theta^-1 C - S Q_theta S
    Q_theta = theta Delta^-1 Q Delta^-1,  R_theta = R/theta,  Delta = diag(1, 1/theta, ..., 1/theta^(n-1))

theta = 1 is the extended Kalman filter; an adaptive theta follows the innovation over a sliding window. Several outputs
require chains aligned at their tops or at their ends. Busvelle's slides have another scaling for a theta that decays.
Both scalings are in `scaling`. Source: Boizot, Busvelle, Gauthier, "An adaptive high-gain observer for nonlinear
systems", Automatica 46 (2010), (4)-(6). The observer of the paper is continuous; the default method realises it as
continuous-discrete (the authors' ECC 2009 paper).
"""

import math
from collections.abc import Iterable, Mapping
from fractions import Fraction

from hgogen.analysis.evidence import Grounds
from hgogen.analysis.hypotheses import clamped_lipschitz
from hgogen.analysis.linearised import evaluated
from hgogen.analysis.scaling import ALIGNED, noise_equation, unused
from hgogen.check import Check, ClaimId, Verdict
from hgogen.estimators import discrete
from hgogen.estimators.gate import Gates, with_gates
from hgogen.estimators.noise import declares_noise
from hgogen.estimators.riccati_part import Riccati, Variances, extended, noise_rank
from hgogen.estimators.theta import LINEAR, Constant, Theta, constant, of_form
from hgogen.form import Form
from hgogen.observer import Observer, demand_form
from hgogen.program import sym
from hgogen.prove.steady_filter import Linear, demand_chains, divergence_reason, linear
from hgogen.reading.given import BadGain, Matrix, Values
from hgogen.sentence import because, joined
from hgogen.starting import starts

REFERENCE = "Boizot, Busvelle, Gauthier, An adaptive high-gain observer for nonlinear systems, Automatica 46 (2010)"
_EXISTENTIAL = "the theorem's constants are existential: no number for theta, d, gamma can be proved from it"
_HIGH_GAIN = "the theorem requires a high-gain form, and the plant is in its own coordinates"
_TRIALS = "validate by trials over noise seeds and jumps"
EQUATIONS = (
    "z' = A(u) z + b(z, u) + S^-1 C' R_theta^-1 (y - C z)",
    "S' = -(A + b*)' S - S (A + b*) + C' R_theta^-1 C - S Q_theta S",
)


@starts(
    "the noise is known (theta = 1 is the Kalman filter), there are several outputs, or a_i varies with u",
    "converges from small initial errors; for jumps, use an adaptive theta",
    "n(n+3)/2",
    lambda scale: scale.kalman,
    quick=math.inf,
)
@declares_noise
def riccati(
    form: Form,
    *,
    Q: Matrix,
    R: float | Values | Variances,
    U: Mapping[str, float] | None = None,
    theta: Theta | float = 1.0,
    initial: Values | None = None,
    covariance: Matrix | None = None,
    gate: Gates | None = None,
    update: str = "sequential",
    accept: Iterable[str] = (),
) -> Observer:
    """The high-gain extended Kalman filter of `form`: z' = f(z, u) + P C' R_theta^-1 (y - h), P' = F P + P F' + Q_theta
    - P C' R_theta^-1 C P, Q_theta = theta Delta^-1 Q Delta^-1, R_theta = R/theta, Delta = diag(1, 1/theta, ..).

    Args: `Q` diagonal (n) or a symmetric matrix (n, n) without negative eigenvalues, by the names of the form's
    coordinates or in their order, unit z^2/s; `R` positive, one for each output, unit y^2 s (spectral densities: for
    white noise of variance v per sample, R = v dt); an expression in text or SymPy by an output's name is the variance
    of one sample; `U` noise of inputs by name, densities in u^2 s, which adds f_u U f_u' to Q, f_u = df/du (Q is 0 by
    default then); `theta` a number or a value of `hgogen.theta`; `initial` the plant's state (by name, or n numbers in
    the plant's order); `covariance` P(0) = S(0)^-1, positive definite, in the same format as Q, default the unit
    matrix; `noise`, `R_per_sample` in place of R: the standard deviation, or the variance, of one sample by output, R =
    v T for samples T apart; `noise` of an input in place of U, U = v dt; `Q_per_sample` in place of Q: the covariance
    that a step of dt adds, P <- Phi P Phi' + Q_per_sample with Phi = I + dt F + (dt F)^2/2 by the default method, Q =
    Q_per_sample/dt; `density` says that Q and R are densities (`estimators.noise`); `gate` innovation gates, by an
    output or a tuple of outputs that pass together: a probability such as 0.999, or an `hg.Gate` (`estimators.gate`),
    by default none; `update` "sequential", one output after the other, or "joint": h and dh/dz of all outputs at the
    prediction, as other libraries do, with R a number, one for each output, or a matrix (p, p) (`estimators.factored`);
    `accept` ids of refuted checks to ignore. A matrix that is symmetric up to rounding (1e-12) is replaced by (Q +
    Q')/2. For a discrete plant Q, R and U are those of a sample, and theta is 1.

    Checks: `riccati.convergence` (proved for a linear plant with constant coefficients, a constant theta and no gate,
    where (C, A) is observable and (A, Q) controllable, else unknown); `riccati.lipschitz` in coordinates other than the
    plant's states (b on the whole box of z).

    Raises: `Refuted` for a refuted hypothesis that is not accepted; `BadGain`; `BadNames`; `Singular` for a model
    whose Jacobian is finite nowhere.
    """
    accept = demand_form("riccati", form, accept, linearises=True, discrete=True)
    theta = theta if isinstance(theta, Theta) else constant(theta)
    discrete.demand_plain_gain(form, theta.peak)
    _demand_scaled(form, theta)
    filter = extended(form, Q, R, covariance, initial, theta, U=U, gate=gate, update=update)
    dynamics, z = filter.part.dynamics, filter.part.z
    mapped = form.system.discrete
    convergence = discrete.no_proof(form, "riccati") if mapped else _convergence(theta, form, filter.part)
    continuous = (*EQUATIONS, noise_equation(form, theta.scaled))
    proved = convergence.verdict is Verdict.PROVED
    observer = Observer(
        form=form,
        name="riccati",
        parts=(filter.part, *theta.parts(dynamics, z)),
        gains=(*filter.gains, *theta.gains),
        z=sym("state", "z", form.n),
        dynamics=dynamics,
        claims=lambda: (*form.checks, *evaluated(form), *clamped_lipschitz("riccati", form), convergence),
        accepted=accept,
        theorem=LINEAR if proved else of_form(theta.theorem, form, rank=noise_rank(filter.part, form.names)),
        equations=(
            *((discrete.PREDICTION, discrete.CORRECTION) if mapped else continuous),
            theta.law(form.system.time),
            *filter.equations,
        ),
        reference=discrete.REFERENCE if mapped else REFERENCE,
        traces=theta.traces,
    )
    return with_gates(observer, filter.part.gates)


def _demand_scaled(form: Form, theta: Theta) -> None:
    argument, outputs = f"theta up to {theta.peak:g}", form.system.outputs
    if theta.peak == 1 or len(form.output) == 1:
        return
    if form.alignment not in ALIGNED:
        raise BadGain(
            argument,
            f"wants a chain for each of the {len(outputs)} outputs of {form.system.name}, aligned at the tops or the "
            'ends; take the form block_triangular, align "top" or "end", or theta = 1',
        )
    if unused_outputs := unused(form):
        names = ", ".join(outputs[j].name for j in unused_outputs)
        raise BadGain(
            argument,
            f"wants outputs that show the first state of a chain, {names} of {form.system.name} shows another; leave "
            "it out of the plant, or take theta = 1",
        )


def _convergence(theta: Theta, form: Form, part: Riccati) -> Check:
    """Return the check that the estimate converges: proved for a linear plant and a constant theta, else unknown."""
    id, plant = ClaimId("riccati", "convergence"), linear(form)
    if part.disturbed or part.correlated is not None or part.varying is not None:
        why = "outputs with independent noises" if part.varying is None else "a constant R"
        why = "a constant Q, without noise of inputs" if part.disturbed else why
        reason = because("the proof is made for {why}", why=why)
        return Check(id, theta.theorem.conclusion, Verdict.UNKNOWN, reason, fix=_TRIALS)
    if isinstance(plant, Linear) and isinstance(theta, Constant):
        Q, R = part.noise_covariance, part.nominal[1].tolist()
        obstacle = divergence_reason(plant, Q, theta.theta)
        if obstacle is None:
            numbers = {"theta": Fraction(theta.theta), "Q": Q, "R": tuple(map(Fraction, R))}
            reason = because("the plant is linear, (C, A) is observable and (A, Q) controllable, by exact ranks")
            return Check(id, LINEAR.conclusion, Verdict.PROVED, reason, proofs=(Grounds(numbers, plant),))
        return Check(id, LINEAR.conclusion, Verdict.UNKNOWN, obstacle, fix=_TRIALS)
    reason = because(_HIGH_GAIN if form.kind == "original" else _EXISTENTIAL)
    conclusion, fix = theta.theorem.conclusion, _TRIALS
    try:
        demand_chains(form)
    except BadGain:
        return Check(id, conclusion, Verdict.UNKNOWN, reason, fix=fix)
    settled = because("in chains the gain to which it settles can be proved as it runs, by hg.design.steady_gain")
    fix = f"{fix}, or take high_gain with the gain to which it settles"
    return Check(id, conclusion, Verdict.UNKNOWN, joined(reason, settled), fix=fix)
