"""Switched-gain high-gain observer: a high gain while the output error is large, a low one after it has been small.

    w' = A w + c(w, u) + diag(l, .., l^n) K e,   e = y - w_1
    l = theta_low once |e| <= d at all samples over a time T_d,   l = theta as soon as |e| > d, and at the start

in the coordinates of `integrators`, the argument of c saturated to the declared box; theta and theta_low are k_1 and
k_2 of the paper. A missing sample does not change the timer. Source: Ahrens, Khalil, "High-gain observers in the
presence of measurement noise: a switched-gain approach", Automatica 45 (2009).
"""

from collections.abc import Iterable, Mapping, Sequence
from math import ceil

import casadi as ca
import numpy as np

from hgogen.check import Claims, Verdict
from hgogen.estimators.integrators import (
    Integrators,
    injection_gains,
    integrators,
    last_error,
    listed,
    observer_on,
    time_varying_gain,
)
from hgogen.form import Form
from hgogen.observer import Observer, demand_form, gain, high_gain_parameter
from hgogen.part import Clock, Jump, Pieces
from hgogen.program import Block, Field, Place, scalar, sym
from hgogen.prove.error_models import on_companion
from hgogen.prove.varying_gain import switching_checks
from hgogen.reading.given import BadGain, positive
from hgogen.sentence import same
from hgogen.starting import Gains, Scale, starts, two_digits
from hgogen.theorem import FORM, OPERATION, Hypothesis, Theorem

REFERENCE = (
    "Ahrens, Khalil, High-gain observers in the presence of measurement noise: a switched-gain approach, "
    "Automatica 45 (2009)"
)
EQUATIONS = (
    "w' = A w + c(w, u) + diag(l, .., l^n) K e, e = y - w_1",
    "l = theta_low once |e| <= threshold over the time hold, theta as soon as |e| > threshold",
)
LONGEST = 1_000_000  # samples that the timer counts, exactly in a float too
THEOREM = Theorem(
    "the estimate converges exponentially from any initial state; with noise, its error settles as fast as theta lets "
    "it, at the size that theta_low leaves",
    (
        *FORM,
        Hypothesis("A - K C is Hurwitz", verdict=Verdict.PROVED, reason="others are refused"),
        Hypothesis(
            "theta and theta_low are large enough",
            (Claims("switched_gain", "theta"),),
            reason="of their declared values",
        ),
        Hypothesis(
            "hold is long enough for the error to decay from switch to switch",
            (Claims("switched_gain", "hold"),),
            reason="some ten times 1/theta often are",
        ),
        Hypothesis(
            "the threshold is above what noise makes of e under either gain",
            reason="else the gain stays high: watch the trace level",
        ),
        *OPERATION,
    ),
    REFERENCE,
)


def _starting(scale: Scale) -> Gains:
    """Return initial gains: theta_low = theta/4, a threshold
    of 5 % of the range of y, and a hold of 2/theta_low."""
    low = max(1.0, two_digits(scale.theta / 4))
    threshold, hold = two_digits(scale.reading / 20), two_digits(2 / low)
    return scale.high | {"theta": max(scale.theta, 2 * low), "theta_low": low, "threshold": threshold, "hold": hold}


@starts(
    "the estimate should settle fast and then have little noise",
    "a threshold of the output error, above the noise",
    "n + 1",
    _starting,
)
def switched_gain(
    form: Form,
    *,
    theta: float,
    theta_low: float,
    threshold: float,
    hold: float,
    poles: Sequence[complex] | None = None,
    gains: Sequence[float] | np.ndarray | None = None,
    initial: Mapping[str, float] | Sequence[float] | None = None,
    accept: Iterable[str] = (),
) -> Observer:
    """The observer w' = A w + c(w, u) + diag(l, .., l^n) K e, e = y - w_1, of a chain of integrators (a form of one
    output with constant a_i); l = theta from |e| > d on, l = theta_low once |e| <= d for the time T_d.

    Checks: `switched_gain.convergence` (a bound on a gain is proved), `switched_gain.theta` (both gains are above it),
    `switched_gain.hold` (the decay at the high gain compensates for every switch).

    Args: `theta` > `theta_low` >= 1; `threshold` d > 0 (unit of y); `hold` T_d > 0 (s), rounded up to whole samples;
    `poles` (n) of A - K C, or `gains` K (n) in their place; `initial` the plant's state; `accept` ids of refuted checks
    to ignore.

    Raises: `Refuted`; `BadPoles`; `NotHurwitz`; `BadGain` for other numbers that do not fit, or a form that is no chain
    of integrators; from `sample`, `BadGain` for a hold of more than a million samples.
    """
    accept = demand_form("switched_gain", form, accept, requires=integrators)
    high, chain = high_gain_parameter(theta), integrators("switched_gain", form)
    top, low = high.initial[0], positive("theta_low", theta_low)
    if not 1 <= low < top:
        raise BadGain(f"theta_low = {theta_low!r}", f"must be at least 1 and below theta = {top:g}")
    d, time = positive("threshold", threshold), positive("hold", hold)
    K = injection_gains("switched_gain", poles, gains, chain.n)
    w = chain.field(initial, top)
    level = scalar("level", top, low=1.0, high=top, meaning="gain in force")
    return observer_on(
        chain,
        "switched_gain",
        parts=(time_varying_gain(chain, w, K, level), Jump(lambda clock: _switch(clock, chain, w, time))),
        gains=(
            high,
            gain("theta_low", low, 1.0, low, "high-gain parameter when the output error has stayed small"),
            gain("threshold", d, 1e-3 * d, 1e3 * d, "output error up to which it is small", "y"),
        ),
        w=sym("state", "w", chain.n),
        theorem=THEOREM,
        equations=(*EQUATIONS, f"K = {listed(K)}, hold = {same(time)} {form.system.time}"),
        reference=REFERENCE,
        claims=lambda: switching_checks("switched_gain", form, top, low, time, on_companion(chain, K.tolist())),
        accepted=accept,
        traces=("level",),
    )


def _switch(clock: Clock, chain: Integrators, w: Field, hold: float) -> Pieces:
    """Return the switch and its timer. The timer counts samples
    in a real number, so that it restarts with the estimate."""
    needed = ceil(hold / clock.dt * (1 - 1e-12)) + 1  # n samples span n - 1 periods
    if needed > LONGEST:
        raise BadGain(f"hold = {hold:g}", f"is more than {LONGEST} samples of dt = {clock.dt:g}; shorten it")
    count, high = sym("state", "quiet"), sym("gain", "theta")
    small = ca.fabs(last_error(chain, w, clock)) <= sym("gain", "threshold")
    counted = ca.if_else(small, ca.fmin(count + 1, needed), 0)
    after = ca.if_else(clock.sampled, counted, count)
    low = ca.fmin(sym("gain", "theta_low"), high)
    return Pieces(
        fields=(scalar("quiet", 0.0, low=0.0, high=needed, meaning="samples in a row with a small output error"),),
        adapt=(
            Block("has the output error stayed small?", {Place("state", "quiet"): after}),
            Block(
                "a low gain then, else the high one",
                {Place("state", "level"): ca.if_else(count >= needed, low, high)},
            ),
        ),
    )
