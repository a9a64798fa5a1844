"""What is known of the high-gain extended Kalman filter, by the law of theta: theorems as data.

    theta = 1         local convergence: the extended Kalman filter
    theta constant    convergence from anywhere for theta large enough
    theta decaying    the same, then a Kalman filter
    theta adaptive    theorem 5: convergence from anywhere, Kalman filter where the innovation is small

Their constants are existential: the theorems say that there are such d, theta_1, .., not which. Sources: Boizot,
Busvelle, Gauthier, Automatica 46 (2010), with the numbers of its equations; Gauthier, Kupka, "Deterministic Observation
Theory and Applications" (2001); Busvelle's slides on decaying theta.
"""

from dataclasses import replace

from hgogen.check import Claims, Verdict
from hgogen.form import Form
from hgogen.theorem import FORM, OPERATION, Hypothesis, Theorem

_DEFINITE = Hypothesis(
    "Q, S(0) are positive definite and R > 0",
    verdict=Verdict.PROVED,
    reason="else the observer is refused",
    reference="(4)",
)
_OF_LOWER_RANK = replace(
    _DEFINITE,
    verdict=Verdict.UNKNOWN,
    reason="Q has an eigenvalue 0; its noise reaches every state of the model as it is linearised at a point",
)
_BUILT = (
    Hypothesis(
        "b is smooth and of compact support",
        verdict=Verdict.UNKNOWN,
        reason="its argument is clamped to the ranges, which bounds b and bends it at their edge",
        reference="section 2.2",
    ),
    _DEFINITE,
    Hypothesis(
        "the first estimate lies in the ranges", verdict=Verdict.PROVED, reason="else it is refused", reference="(4)"
    ),
)
_EXISTENTIAL = "the theorem's constants are existential: no number is known to be large or small enough"
_ANYWHERE = "the estimate converges exponentially from any initial state"


_OPERATION = (
    *OPERATION,
    Hypothesis(
        "the covariance does not touch its cap",
        reason="watch the status COVARIANCE_LIMITED: the cap is no part of the Riccati equation",
    ),
)


def _large(claim: str, reference: str) -> Hypothesis:
    return Hypothesis(claim, verdict=Verdict.UNKNOWN, reason=_EXISTENTIAL, reference=reference)


KALMAN = Theorem(
    "the estimate converges exponentially if the first error is small enough",
    (
        *FORM,
        *_BUILT,
        Hypothesis(
            "the first error is small enough",
            reason="how small is not known: the theorem's constants are existential: no number is known to be large or "
            "small enough",
            reference="(18)",
        ),
        *_OPERATION,
    ),
    "Boizot, Busvelle, Gauthier, Automatica 46 (2010), local inequality (17)",
)
LINEAR = Theorem(
    f"{_ANYWHERE}: the plant is linear",
    (
        Hypothesis(
            "z' = A z + b(u), y = C z + d(u), A and C constant, (C, A) observable, (A, Q) controllable",
            (Claims("riccati", "convergence"),),
            reference="section 7",
        ),
        Hypothesis(
            "Q has no negative eigenvalue, P(0) is positive definite and R > 0",
            verdict=Verdict.PROVED,
            reason="else the observer is refused",
        ),
        *_OPERATION,
    ),
    "Kalman, Bucy, New results in linear filtering and prediction theory, J. Basic Engineering 83 (1961), section 7",
)
HIGH_GAIN = Theorem(
    f"{_ANYWHERE}, for theta large enough",
    (*FORM, *_BUILT, _large("theta is large enough", "(16)"), *_OPERATION),
    "Boizot, Busvelle, Gauthier, Automatica 46 (2010), global inequality (16); Gauthier, Kupka 2001, chapter 6",
)
DECAYING = Theorem(
    f"{_ANYWHERE}, for theta_0 large and the rate small enough",
    (*FORM, *_BUILT, _large("0 < rate <= lambda_0, and theta_0 large enough for that rate", "theorem"), *_OPERATION),
    "Busvelle, Parallel high-gain and non high-gain extended Kalman filters (slides), theorem",
)
ADAPTIVE = Theorem(
    f"{_ANYWHERE} (theorem 5)",
    (
        *FORM,
        *_BUILT,
        Hypothesis(
            "theta(0) = 1 and 1 <= theta <= 2 theta_1",
            verdict=Verdict.PROVED,
            reason="by the exact flow of its law",
            reference="(4), (5)",
        ),
        _large("d, Delta T small, theta_1 large, lambda > 0 and gamma_1 small enough", "theorem 5, (18), (21)"),
        *_OPERATION,
    ),
    "Boizot, Busvelle, Gauthier, Automatica 46 (2010), theorem 5",
)

_MODIFIED = "R is not scaled, and Q_theta = theta^2 Delta^-1 Q Delta^-1"
SCALED_AS = {  # by what theta scales
    "process": Hypothesis(
        _MODIFIED, verdict=Verdict.PROVED, reason="by construction", reference="the modified extended Kalman filter"
    ),
    "both": Hypothesis(
        _MODIFIED,
        verdict=Verdict.UNKNOWN,
        reason="here R/theta and theta Delta^-1 Q Delta^-1: with S/theta for the theorem's S the same observer at "
        "constant theta; while theta decays, S' here has the term rate (theta - 1)/theta S more",
        reference="the modified extended Kalman filter",
    ),
}

_LATE = replace(
    SCALED_AS["process"],
    verdict=Verdict.UNKNOWN,
    reason="the slides are of one output; chains of unequal length, aligned at their ends, have delta R delta",
)

SMOOTHSTEP = Hypothesis(
    "mu = 0 up to gamma_0, mu = 1 from gamma_1 on", verdict=Verdict.PROVED, reason="by its formula", reference="(6)"
)
LOGISTIC = Hypothesis(
    "mu = 0 up to gamma_0, mu = 1 from gamma_1 on",
    verdict=Verdict.REFUTED,
    reason="a logistic is never 0 nor 1; it holds theta a little above 1",
    reference="(6)",
)
WINDOW = Hypothesis(
    "the innovation is an integral over the last d seconds",
    verdict=Verdict.UNKNOWN,
    reason="it is a sum over the samples, of a model run by a method with the step dt",
    reference="(4)",
)
STAGGERED = Hypothesis(
    "the innovation is an integral over the last d seconds",
    verdict=Verdict.UNKNOWN,
    reason="it is a sum over the samples, and M staggered predictors look back over d to d (1 + 1/M) seconds",
    reference="(4)",
)
OTHER_COORDINATES = Hypothesis(
    "the filter works in the coordinates z = Phi(x)",
    verdict=Verdict.REFUTED,
    reason="it stays in the plant's, where z_i' = a_(i+1) z_(i+1) + b_i is not shown",
    reference="(3)",
)
_READS = "b_(i,j) reads z_(k,l) for l <= "
ALIGNMENTS = {  # by the alignment of the chains
    "top": Hypothesis(
        f"{_READS}j only (top)",
        (Claims("block_triangular", "structure"),),
        reason="the paper is of one output; in Delta z, top, its inequalities are the same",
    ),
    "end": Hypothesis(
        f"{_READS}j + n_k - n_i only (end)",
        (Claims("block_triangular", "structure"),),
        reference="Boizot, thesis (2010), chapter 5",
    ),
    "cascade": Hypothesis(
        f"{_READS}j or j + n_k - n_i only",
        verdict=Verdict.UNKNOWN,
        reason="the chains are one after the other, and read each other as a whole",
    ),
}


def of_form(theorem: Theorem, form: Form, *, definite: bool = True) -> Theorem:
    """The theorem with what the form brings: chains of several outputs, coordinates in which the filter does not
    work; and whether Q is positive definite."""
    if not definite:
        ranked = (_OF_LOWER_RANK if each is _DEFINITE else each for each in theorem.hypotheses)
        theorem = replace(theorem, hypotheses=tuple(ranked))
    if form.kind == "block_triangular":
        more = ALIGNMENTS.get(form.alignment)
        chains = theorem.with_chains().under(*((more,) if more else ()))
        late = form.alignment == "end" and len(set(form.blocks)) > 1
        instead = {SCALED_AS["process"]: _LATE} if late else {}
        return replace(chains, hypotheses=tuple(instead.get(each, each) for each in chains.hypotheses))
    return theorem if form.jacobian is None else theorem.under(OTHER_COORDINATES)
