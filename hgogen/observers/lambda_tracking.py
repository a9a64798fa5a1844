"""lambda-tracking: a gain that grows while the output error lies outside a strip, and needs no model of phi.

    xhat_i' = xhat_(i+1) + p_i k^i e           i = 1, .., n - 1,   e = y - xhat_1
    xhat_n' = p_n k^n e                        (with `model`: + c_n(xhat, u), and c_i in the rows above)
    k' = gamma d(e)^2,  k(0) = k_0,  d(e) = |e| - lambda, limited to [0, lambda_hat - lambda]
    k <- max(k/2, k_0)  once |e| <= lambda over a time in which the integral of k is 2 ln(100 r)/mu,
                        at most N = ceil(log2(k_max/k_0)) times after an |e| that was far by a fault

on the phase form x_i' = x_(i+1), x_n' = phi(x, u, u', ..), y = x_1. The estimate of the plant's states is the inverse
of the form at xhat, and stays constant where the inverse is not finite. Without phi the error is of order 1/k and never
0:

    limsup |x_i - xhat_i| <= 2 mu |P| sqrt(cond P)/k(0)^(n+1-i),   |phi| <= mu,   A'P + P A = -I,  A = [shift - p C]

The gain of the paper never falls, so that one fault amplifies the noise for ever. Here the gain is halved when the
error has stayed in the strip for twice the settling time of the core at k: the time in which its slowest rate k mu
reduces an error as wide as the outer box, r times the declared one, to a hundredth. It is halved only after a fault,
and for each fault at most as often as it takes from k_max to k_0. A fault is a large error, beyond lambda_hat, or
beyond twice the strip and a tenth of the range of y, after one of two conditions: the error has been in the strip while
the integral of k grew by 1/mu; or large errors have changed their sign TURNS times, as those of spurious samples from
the start do. The initial error changes its sign n - 1 times where the core's poles are real, and has decayed by
exp(-TURNS pi z/sqrt(1 - z^2)) where they have the damping ratio z. Without a fault the law is that of the paper; after
the last fault the theorem holds once the gain no longer falls. A phi that grows again after long periods at small
values, or that requires the gain which was just halved, causes large errors without any fault: then the gain may rise
and fall for ever.

Source: Bullinger, Ilchmann, Allgoewer, "A simple adaptive observer for nonlinear systems", NOLCOS 1998, (2), (4), (5);
the paper's (14) lacks the factor sqrt(cond P), which its own (11) requires. The variant with phi, the cap k_max on the
gain, which the step length requires, and the fall of the gain are extensions.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import ceil, log, log2
from typing import Any

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.analysis.hypotheses import bounded_nonlinearity
from hgogen.check import ClaimId, Claims, Verdict
from hgogen.estimators.integrators import (
    GAIN_LIMITED,
    Integrators,
    capped,
    companion,
    injection_gains,
    integrators,
    last_error,
    listed,
    observer_on,
    time_varying_gain,
    unmodelled,
)
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.observer import Observer, demand_form, gain
from hgogen.part import Clock, Jump, Pieces
from hgogen.program import INF, Block, Field, Place, When, scalar, sym
from hgogen.reading.given import BadGain, positive, reals
from hgogen.sentence import same
from hgogen.starting import Gains, Scale, starts, two_digits
from hgogen.stepping.guards import readings
from hgogen.stepping.recovery import FINE, SHARE
from hgogen.theorem import FORM, LIPSCHITZ, OPERATION, Hypothesis, Theorem

REFERENCE = "Bullinger, Ilchmann, Allgoewer, A simple adaptive observer for nonlinear systems, NOLCOS (1998)"
EQUATIONS = (
    "w_i' = w_(i+1) + p_i k^i e, w_n' = {phi}p_n k^n e, e = y - w_1",
    "k' = gamma d(e)^2, d(e) = |e| - strip limited to [0, reach - strip]",
)
_LAW = (
    Hypothesis(
        "phi is bounded along the plant's motion",
        (Claims("lambda_tracking", "phi"),),
        reason="where an input steps that a derivative of y reads, phi has no bound, and the theorem starts again",
        reference="Theorem 2",
    ),
    Hypothesis("s^n + p_1 s^(n-1) + .. + p_n is Hurwitz", verdict=Verdict.PROVED, reason="others are refused"),
    Hypothesis(
        "reach > strip > 0, gamma > 0, k(0) > 0",
        verdict=Verdict.PROVED,
        reason="others are refused, and tuning keeps them; (5)",
    ),
    Hypothesis(
        "once settled, the output error is far from the strip no more than finitely often",
        reason="far is beyond reach, or beyond twice the strip and a tenth of what y can span; each time, by a fault, "
        "a phi that has grown, or a fall of the gain, lets the gain fall again: watch the trace k; the theorem holds "
        "from the last fall on",
    ),
    Hypothesis(
        "the gain does not reach its cap",
        reason="watch the status GAIN_LIMITED; the theorem knows no cap, and no bound on the gain",
    ),
    *OPERATION,
)
THEOREM = Theorem(
    "the gain converges, the output error tends to the strip |e| <= strip, and the error of the estimate is of order "
    "1/k: it does not tend to 0",
    (*(hypothesis for hypothesis in FORM if hypothesis is not LIPSCHITZ), *_LAW),  # bounded is enough
    f"{REFERENCE}, Theorem 2 and, corrected, Theorem 3",
)
MODELLED = Theorem(
    "the gain converges, the output error tends to the strip |e| <= strip, and the error of the estimate is of order "
    "1/k; it tends to 0 where the gain ends above what the slope of phi asks for, of which the law knows nothing",
    (
        *FORM,
        Hypothesis(
            "the theorems hold with the model's terms in the rows",
            verdict=Verdict.UNKNOWN,
            reason="an extension: the paper has rows without a model, and x_n' = phi alone",
        ),
        *_LAW,
    ),
    f"{REFERENCE}, Theorems 2 and 3, extended",
)


TURNS = 16  # changes of sign
GROWN = replace(
    GAIN_LIMITED,
    action="after outliers the gain falls by halves; if it stays, raise strip, or declare a higher cap, and a "
    "shorter dt for it",
)


def _starting(scale: Scale) -> Gains:
    """Return initial gains: k from theta/2 to 10 theta, and gamma = (theta/r)^2, r the range of y."""
    y, strip, reach = scale.reading, two_digits(scale.reading / 50), two_digits(scale.reading / 2)
    moving = {
        "k_0": two_digits(scale.theta / 2),
        "k_max": two_digits(10 * scale.theta),
        "gamma": two_digits((scale.theta / y) ** 2),
    }
    return moving | {"strip": strip, "reach": reach, "poles": scale.poles, "model": True}


@starts(
    "there is no model of the last row z_n' and no guess of a gain",
    "practical convergence only: an output error within a strip remains; the gain falls only after a fault",
    "n + 1",
    _starting,
)
def lambda_tracking(
    form: Form,
    *,
    k_0: float,
    k_max: float,
    gamma: float,
    strip: float,
    reach: float,
    gains: Sequence[float] | np.ndarray | None = None,
    poles: Sequence[complex] | None = None,
    model: bool = False,
    initial: Mapping[str, float] | Sequence[float] | None = None,
    start: Sequence[float] | np.ndarray | None = None,
    accept: Iterable[str] = (),
) -> Observer:
    """The observer xhat_i' = xhat_(i+1) + p_i k^i e, xhat_n' = p_n k^n e, e = y - xhat_1, k' = gamma (|e| - lambda)^2
    while |e| > lambda, on a phase form x_i' = x_(i+1), x_n' = phi, or with `model`, which adds c_i(xhat, u), on any
    form of one output with constant a_i.

    Without `model` neither phi nor inputs that only phi reads, such as the last derivative of u, are used.

    Checks: `lambda_tracking.phi` (phi is bounded on the box); `lambda_tracking.lipschitz` with `model`, in coordinates
    other than the plant's states.

    Args: `k_0` the gain k(0) > 0 and `k_max` > k_0 its cap (1/s); `gamma` > 0 its adaptation rate (1/(y^2 s^2));
    `strip` lambda > 0 and `reach` lambda_hat > strip (unit of y); `gains` p (n), or `poles` (n) of s^n + p_1
    s^(n-1) + .. in their place; `initial` the plant's state, or `start` (n), (y, y', ..) of the chain; `accept` ids of
    refuted checks to ignore.

    Raises: `Refuted`; `BadPoles`; `NotHurwitz`; `BadGain` for other numbers that do not fit, or a form that is no chain
    of integrators, or, without `model`, has nonlinear terms other than phi.
    """
    accept = demand_form("lambda_tracking", form, accept, requires=integrators)
    declared = integrators("lambda_tracking", form)
    chain = declared if model else integrators("lambda_tracking", _unmodelled(form))
    p = injection_gains("lambda_tracking", poles, gains, chain.n)
    least, most = positive("k_0", k_0), positive("k_max", k_max)
    if not least < most:
        raise BadGain(f"k_max = {k_max!r}", f"must be above k_0 = {least:g}; the gain only grows")
    width, end = positive("strip", strip), positive("reach", reach)
    if not width < end:
        raise BadGain(f"reach = {reach!r}", f"must be above strip = {width:g}")
    widest = (width + end) / 2  # tuning keeps strip below reach
    rate = positive("gamma", gamma)
    w = _started(chain.field(initial, most), chain, start)
    k = scalar(
        "k", least, low=least, high=most, lasting=True, unit="1/s", meaning="gain, which grows outside the strip"
    )

    def law(e: Graph) -> Graph:
        room = ca.fmax(sym("gain", "reach") - sym("gain", "strip"), 0)
        outside = ca.fmin(ca.fmax(ca.fabs(e) - sym("gain", "strip"), 0), room)
        return sym("gain", "gamma") * (outside * outside)

    return observer_on(
        chain,
        "lambda_tracking",
        parts=(
            time_varying_gain(chain, w, p, k, law),
            Jump(lambda clock: _falls(clock, chain, w, p, k)),
            capped(k, GROWN),
            *(() if model else (unmodelled(form),)),
        ),
        gains=(
            gain("gamma", rate, 1e-3 * rate, 1e3 * rate, "how fast the gain grows", "1/(y^2 s^2)"),
            gain("strip", width, 1e-3 * width, widest, "output error up to which the gain rests", "y"),
            gain("reach", end, end, 1e3 * end, "output error from which it grows no faster", "y"),
        ),
        w=sym("state", "w", chain.n),
        theorem=MODELLED if model else THEOREM,
        equations=(
            *(line.format(phi="c_n + " if model else "") for line in EQUATIONS),
            f"p = {listed(p)}, k(0) = {same(least)}, k <= {same(most)}",
        ),
        reference=REFERENCE,
        claims=lambda: (bounded_nonlinearity(ClaimId("lambda_tracking", "phi"), form, declared.products),),
        accepted=accept,
        traces=("k",),
        practical=not model,
    )


def _falls(clock: Clock, chain: Integrators, w: Field, p: np.ndarray, k: Field) -> Pieces:
    ((least, most),) = k.box
    slowest = float(-np.linalg.eigvals(companion(p)).real.max())
    needed, times = 2 * log(FINE * max(3.0, most ** (chain.n - 1))) / slowest, float(ceil(log2(most / least)))
    signed, turns = last_error(chain, w, clock), sym("state", "turns")
    e, inside, falls = ca.fabs(signed), sym("state", "quiet"), sym("state", "falls")
    level, sampled = sym("state", "k"), clock.sampled
    (low, high), reach = readings(chain.form)[0], sym("gain", "reach")
    far = ca.fmin(reach, ca.fmax(2 * sym("gain", "strip"), SHARE * (high - low))) if high - low < INF else reach
    counted = ca.if_else(e <= sym("gain", "strip"), ca.fmin(inside + level * clock.dt, needed), 0)
    settled = ca.fmax(sym("state", "settled"), inside >= 1 / slowest)
    turned = ca.if_else(signed * turns > 0, turns, ca.sign(signed) * ca.fmin(ca.fabs(turns) + 1, TURNS))
    fault = ca.logic_or(sym("state", "settled") > 0, ca.fabs(turns) >= TURNS)
    allowed = ca.if_else(ca.logic_and(e > far, fault), times, falls)
    test = ca.logic_and(inside >= needed, ca.logic_and(falls >= 1, level > least))
    fall = {
        Place("state", "quiet"): ca.SX(0),
        Place("state", "falls"): ca.fmax(falls - 1, 0),
        Place("state", "k"): ca.fmax(level / 2, least),
    }
    return Pieces(
        fields=(
            scalar("quiet", 0.0, low=0.0, high=needed, meaning="integral of k since the error is inside the strip"),
            scalar(
                "settled",
                0.0,
                low=0.0,
                high=1.0,
                lasting=True,
                meaning="1 once it was inside for a while: what is far then is a fault",
            ),
            scalar(
                "turns",
                0.0,
                low=-TURNS,
                high=TURNS,
                lasting=True,
                meaning="sign changes of a large error, signed as the last",
            ),
            scalar("falls", 0.0, low=0.0, high=times, lasting=True, meaning="how often the gain may still fall"),
        ),
        adapt=(
            Block(
                "has the output error stayed inside the strip?",
                {
                    Place("state", "quiet"): ca.if_else(sampled, counted, inside),
                    Place("state", "turns"): ca.if_else(ca.logic_and(sampled, e > far), turned, turns),
                    Place("state", "falls"): ca.if_else(sampled, allowed, falls),
                    Place("state", "settled"): settled,
                },
            ),
            Block("may the gain fall?", {Place("work", "falling"): test}),
            When(Place("work", "falling"), (Block("it falls by half", fall),)),
        ),
    )


def _started(w: Field, chain: Integrators, start: Any) -> Field:
    if start is None:
        return w
    values = reals("start", start)
    if values.shape != (chain.n,):
        raise BadGain(f"start of shape {values.shape}", f"must have {chain.n} numbers: the output and its derivatives")
    for name, value, (low, high) in zip(w.labels, values, w.box, strict=True):
        if not (np.isfinite(value) and low <= value <= high):
            raise BadGain(f"start {name} = {value:g}", f"must be finite and in its outer box [{low:g}, {high:g}]")
    return replace(w, initial=tuple(map(float, values)))


def _unmodelled(form: Form) -> Form:
    """Return the form z' = A z with b = 0, and without the inputs that
    only b depends on. Only the last entry of b may differ from 0."""
    if any(row != 0 for row in form.b[:-1]):
        reason = "takes a form with b in its last row only where it has no model: take the form phase, or model=True"
        raise BadGain("lambda_tracking", reason)
    system, none = form.system, (sp.S.Zero,) * form.n
    rows = (*system.flow, *system.output, *form.to_form, *form.from_form, *form.output, *form.A)
    read = tuple(u for u in system.inputs if any(u in sp.sympify(row).free_symbols for row in rows))
    behind = None if form.behind is None else none
    return replace(form, system=replace(system, inputs=read), b=none, behind=behind)
