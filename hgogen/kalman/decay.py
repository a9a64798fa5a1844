"""The theorem's bound on the error of a filter whose theta decays, Busvelle's slides (1):

    |e(t)|^2 <= R(lambda, c) exp(-a t) Lambda(theta_0, t, lambda) |e(0)|^2
    Lambda = theta_0^(2 (n - 1) + a/lambda) exp(-(a/lambda) theta_0 (1 - exp(-lambda t)))

for 0 < lambda <= lambda_0, theta_0 large enough for that lambda and S(0) >= c. a > 0 and R are existential constants,
so they are arguments here. The slides print 0 <= lambda, but at lambda = 0 there is no a/lambda.
"""

import math

from hgogen.reading.given import BadGain, positive, real


def log_growth(theta_0: float, t: float, rate: float, *, n: int, a: float) -> float:
    """log Lambda(theta_0, t, rate) of n states; `rate` is lambda (1/s), `t` (s), `a` (1/s).

    Raises: `BadGain` for theta_0 < 1, t < 0, a number of states below 1, a rate or an a that is not above 0.
    """
    theta_0, t, rate, a = real("theta_0", theta_0), real("t", t), positive("rate", rate), positive("a", a)
    if not 1 <= theta_0 < math.inf:
        raise BadGain(f"theta_0 = {theta_0!r}", "must be a finite number, at least 1")
    if not 0 <= t < math.inf:
        raise BadGain(f"t = {t!r}", "must be a finite time from the start, not negative")
    if n not in range(1, 1 << 16):
        raise BadGain(f"n = {n!r}", "must be the number of states")
    power = 2 * (n - 1) + a / rate
    return power * math.log(theta_0) + a / rate * theta_0 * math.expm1(-rate * t)


def error_bound(theta_0: float, t: float, rate: float, *, n: int, a: float, R: float, initial: float = 1.0) -> float:
    """The bound on |e(t)| for |e(0)| = `initial`, with the constants `a` (1/s) and `R` of the theorem; infinite where
    no float holds it.

    Raises: `BadGain`, also for an R or an initial error that is not above 0.
    """
    grown = log_growth(theta_0, t, rate, n=n, a=a) - a * t + math.log(positive("R", R))
    exponent = grown / 2 + math.log(positive("initial", initial))
    return math.exp(exponent) if exponent < math.log(1.7e308) else math.inf
