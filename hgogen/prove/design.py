"""Gains by linear matrix inequalities: found in floats, rounded, verified in rationals.

    gain             K of `observers.high_gain` for a wanted rate, of a small noise bound
    constant_gain    K of `observers.high_gain`, for a_i that vary in ranges
    steady_gain      K of the same, to which the filter `riccati` settles at a point: of Q and R, without a solver
    injection_filter F, G and H of `observers.filtered_injection`, for little noise at a wanted rate
    adaptive_gain    K and P of `observers.adaptive_lmi`, for a time-varying high gain; `slope` is its k for a form
    verified         the checks of any K and P, designed here or not

Numbers that papers give by formula, for the design of a gain by hand, each rounded to the safe side by exact algebra:

    gain_of_poles      L of the poles of A - L C                      Astolfi, Jungers, Zaccarian 2018, remark 1
    core_eigenvalues   those of A - L C, or of M with a filter        (10)
    inside_parabola    whether poles lie in S_(alpha, beta)           (9)
    least_gamma        from which gamma_inf on the error decays       Alessandri 2020, (88)
    attenuation        the L2 gain from a disturbance                 (89)
    disturbed_error    the ultimate bound under a disturbance         (69), corrected
    error_bounds       the error without a model of the last row      Bullinger and others 1998, (14), corrected
    gain_in_time       the gain for a given error and time            theorem 1

A and C are those of a chain of n integrators, D = diag(1, .., n).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from math import isfinite
from typing import Any

import numpy as np

from hgogen.analysis.ranges import chains, corners
from hgogen.check import Check, ClaimId, Verdict
from hgogen.estimators.gains import BadPoles, coefficients, filtered_core, least_ratio, numbers
from hgogen.estimators.integrators import companion
from hgogen.form import Form
from hgogen.prove.adaptive_design import Design, Infeasible, adaptive_gain, slope
from hgogen.prove.error_models import obstacle
from hgogen.prove.filter_design import InjectionFilter, injection_filter
from hgogen.prove.gain_design import Gain, NoGain, gain
from hgogen.prove.inclusion import Nothing
from hgogen.prove.questions import noise_bounds
from hgogen.prove.semidefinite import gains, lyapunov
from hgogen.prove.steady_filter import steady_gain
from hgogen.prove.varying_gain import Candidate, candidate, candidate_checks, definiteness_check
from hgogen.prove.varying_gain import attenuation as block_of
from hgogen.prove.varying_gain import disturbance as as_disturbance
from hgogen.reading.given import BadGain, positive, real, reals, requires_form
from hgogen.rigor.definite import demand_hurwitz, exact, largest, nonnegative, number, root, smallest, unit
from hgogen.sentence import NONE, Reason, because

__all__ = [
    "Checks",
    "Design",
    "DisturbedError",
    "Gain",
    "Infeasible",
    "InjectionFilter",
    "NoGain",
    "adaptive_gain",
    "attenuation",
    "constant_gain",
    "core_eigenvalues",
    "disturbed_error",
    "error_bounds",
    "gain",
    "gain_in_time",
    "gain_of_poles",
    "injection_filter",
    "inside_parabola",
    "least_gamma",
    "noise_bounds",
    "slope",
    "steady_gain",
    "verified",
]


@requires_form
def constant_gain(form: Form, *, largest: float = 100.0) -> tuple[float, ...] | Nothing:
    """Return a constant observer gain K (n), |K| <= `largest`, for a form in one chain whose gains a_i vary in their
    ranges, designed for a small largest eigenvalue of P in the bound on theta of `high_gain`; or the reason why there
    is none. Raises: `NoSolver`; `Misfit` for an argument that is no form; `BadGain`."""
    most = positive("largest", largest)
    one = because("a gain is designed for one output") if len(form.output) > 1 else NONE
    vertices = obstacle(form) or one or corners(chains(form)[0], form)
    if isinstance(vertices, Reason):
        return Nothing(vertices)
    K = gains(vertices, most)
    return Nothing(because("no gain up to {most:g} was found", most=most)) if K is None else tuple(map(float, K))


class Checks(tuple[Check, ...]):
    """A tuple of checks whose text has each check on a line of its own."""

    __slots__ = ()

    def __str__(self) -> str:
        return "\n".join(map(str, self))


def verified(
    K: Any, P: Any, sigma: Any, decay: float | None = None, alphas: tuple[float, float] | None = None
) -> Checks:
    """Return the checks of the three conditions on K and P of the observer `adaptive_lmi`: P > 0; D P + P D >= 0; (A -
    K C)'P + P (A - K C) + sigma (D P + P D) + lambda I <= 0 (Alessandri 2020, (54)).

    D = diag(1, .., n), A and C are those of a chain of integrators; lambda = `decay`, by default any number above 0.
    With `alphas` = (alpha_1, alpha_2) also his (87), in which P P/alpha_1 + P K K'P/alpha_2 is added to (54). Each
    check is proved, or refuted with the eigenvalue. Raises: `BadGain`.
    """
    known = candidate(K, P, sigma)
    checks = list(candidate_checks("adaptive_gain", known, None if decay is None else Fraction(decay)))
    if alphas is not None:
        first, second = map(Fraction, alphas)
        if min(first, second) <= 0:
            raise BadGain(f"alphas = {alphas}", "must be positive")
        block = block_of(known, Fraction(0 if decay is None else decay), first, second)
        level = "a lambda > 0" if decay is None else f"lambda = {decay:g}"
        claim = f"(87) with {level}, alpha_1 = {alphas[0]:g}, alpha_2 = {alphas[1]:g}"
        checks.append(definiteness_check(ClaimId("adaptive_gain", "attenuation"), claim, block, sign=-1))
    return Checks(checks)


_SHARES = tuple(Fraction(k, 16) for k in range(1, 16))  # of the decay that the disturbance uses up
_SQUARES = 12  # squarings of 1 + x/2^12, whose power is below e^x
_STEPS = 60  # of a bisection


def gain_of_poles(poles: Sequence[complex]) -> tuple[float, ...]:
    """Return the gain L (n) with which A - L C, A and C a chain of n integrators, has the eigenvalues `poles`: the
    coefficients after the first of their polynomial. Astolfi, Jungers, Zaccarian, ECC 2018, remark 1. Raises:
    `BadPoles` for poles that do not decay, or are in no conjugate pairs."""
    count = len(numbers(poles))
    if not count:
        raise BadPoles((), "there are none; give one for each integrator")
    return tuple(coefficients(poles, count).tolist())


def core_eigenvalues(L: Any, alpha: float | None = None, beta: float | None = None) -> tuple[complex, ...]:
    """Return the eigenvalues of A - L C (n), A and C a chain of integrators, the fastest first; with a filter's `alpha`
    and `beta` the eigenvalues of the matrix M (2 n) of observer and filter. These are the error's linear part at theta
    = 1, in floats. Astolfi, Jungers, Zaccarian, ECC 2018, (10). Raises: `BadGain` for L that is no column of finite
    numbers, for one of alpha and beta alone, or not positive."""
    gains = _column("L", L)
    if (alpha is None) != (beta is None):
        raise BadGain("core_eigenvalues", "takes both alpha and beta of a filter, or none of them")
    if alpha is None:
        core = companion(gains)
    else:
        core = filtered_core(gains, positive("alpha", alpha), positive("beta", beta))
    return tuple(sorted(map(complex, np.linalg.eigvals(core).tolist()), key=lambda s: (s.real, s.imag)))


def inside_parabola(poles: Sequence[complex], alpha: float, beta: float) -> tuple[bool, ...]:
    """Return, for each pole, whether it lies in the region S = {alpha^2 Re + beta Im^2 < 0}, decided in exact
    arithmetic. If all poles of A - L C do, the matrix M of the error with a filter is Hurwitz (`core_eigenvalues`).
    Astolfi, Jungers, Zaccarian, ECC 2018, (9) and lemma 1. Raises: `BadGain`."""
    ratio = Fraction(positive("alpha", alpha)) ** 2 / Fraction(positive("beta", beta))
    try:
        points = [complex(pole) for pole in poles]
    except (TypeError, ValueError):
        points = [complex("nan")]
    if not all(isfinite(p.real) and isfinite(p.imag) for p in points):
        raise BadGain(f"poles = {poles!r}", "must be finite numbers, as (-1, -2+1j, -2-1j)")
    return tuple(p.real < 0 and least_ratio(p) < ratio for p in points)


def least_gamma(K: Any, P: Any, sigma: float, slope: float, *, decay: float | None = None) -> Fraction:
    """Return the least sufficient high gain of the observer `adaptive_lmi`, max(1, (4 k lambda_max(P) + 1)/(2 lambda))
    rounded up; its lower limit gamma_inf may be any larger number. `slope` is the Lipschitz constant k, `decay` the
    lambda of (54), by default the largest that K, P and sigma permit. Alessandri 2020, (88), which is (70). Raises:
    `BadGain`, also where P > 0, D P + P D >= 0 or (54) does not hold."""
    known, rate = _candidate(K, P, sigma, decay)
    return known.least(_number("slope", slope), rate)


def attenuation(
    K: Any,
    P: Any,
    sigma: float,
    slope: float,
    alphas: tuple[float, float],
    disturbance: tuple[Any, Any],
    *,
    decay: float,
) -> Fraction:
    """Return a bound mu_0 of the L2 gain from a disturbance v to the error of w in w' = .. + G_1 v, y = w_1 + G_2 v,
    rounded up, of the observer `adaptive_lmi` with gamma_sup equal to the least gamma of (88):

        mu_0 = sqrt(2 max(delta_1 alpha_1, delta_2 alpha_2)) gamma^n

    A larger gamma_sup has the bound (gamma_sup/gamma)^n mu_0. `decay` and `alphas` are lambda, alpha_1 and alpha_2 of
    (87); `slope` is the Lipschitz constant k; `disturbance` is (G_1 (n, m), G_2 (m)). Alessandri 2020, (89), with
    delta_1 for the matrix of (72). Raises: `BadGain`, also where (87) does not hold.
    """
    known, rate = _candidate(K, P, sigma, decay)
    if len(alphas) != 2:
        raise BadGain(f"alphas = {alphas!r}", "must be two numbers, alpha_1 and alpha_2 of (87)")
    one, two = (Fraction(positive(f"alpha_{k}", value)) for k, value in enumerate(alphas, 1))
    if not nonnegative(block_of(known, rate, one, two)):
        raise BadGain(f"alphas = {tuple(alphas)}", f"do not satisfy (87) with lambda = {decay:g}; raise them")
    first, second = as_disturbance(disturbance, known.n).deltas
    share = 2 * max(first * one, second * two)
    return root(share, bits=52) * known.least(_number("slope", slope), rate) ** known.n


@dataclass(frozen=True)
class DisturbedError:
    """The bounds of the scaled error e = T^-1 (w - what), T = diag(gamma, .., gamma^n), of the observer `adaptive_lmi`
    under a disturbance |v| <= 1. `level`: V = e'P e decreases wherever |e| is above it, chi of (69), corrected;
    `ultimate`: |e| stays below it after some time; `rate` (1/time): |e|_P decays at least like exp(-rate t) where |e|
    is above `level`. `level` and `ultimate` are proportional to |v|."""

    level: Fraction
    ultimate: Fraction
    rate: Fraction


def disturbed_error(
    K: Any,
    P: Any,
    sigma: float,
    slope: float,
    gamma: float,
    disturbance: tuple[Any, Any],
    *,
    share: float = 0.5,
    decay: float | None = None,
) -> DisturbedError:
    """Return the level 2 lambda_max(P) (|G_1| + |K G_2|)/((1 - share) (gamma lambda - 2 k lambda_max(P))) above which
    the scaled error decreases under a disturbance |v| <= 1, with the ultimate bound and the rate that follow. `gamma`:
    gamma_inf; `slope`: the Lipschitz constant k; `share` (0..1): the share of the decay that remains where |e| is above
    the level; other arguments as in `least_gamma` and `attenuation`.

    Alessandri 2020, theorem 6: the printed (69) lacks 2 lambda_max(P), which (68) has, and the step from V to |e| adds
    a factor sqrt(cond P). Raises: `BadGain`, also for a gamma that (62) does not admit.
    """
    known, rate = _candidate(K, P, sigma, decay)
    driven, remainder = as_disturbance(disturbance, known.n), _number("share", share)
    if not 0 < remainder < 1:
        raise BadGain(f"share = {share!r}", "must be between 0 and 1: how much of the decay is left")
    least, k = _number("gamma", gamma), _number("slope", slope)
    net = least * rate - 2 * k * known.peak
    if not (least > 1 and net > 0):
        above = float(max(Fraction(1), 2 * k * known.peak / rate))
        raise BadGain(f"gamma = {gamma!r}", f"must be above {above:g} = max(1, 2 k lambda_max(P)/lambda), (62)")
    G = exact(driven.plant)
    push = root(largest(G * G.transpose())[1]) + root(_square(known.K) * _square(driven.measurement))
    level = 2 * known.peak * push / ((1 - remainder) * net)
    return DisturbedError(level, level * _condition(known.P, known.peak), remainder * net / (2 * known.peak))


def error_bounds(gains: Any, k: float, phi: float) -> tuple[Fraction, ...]:
    """Return ultimate bounds (n) of the errors |x_i - xhat_i| of a high-gain observer without a model of the plant, 2
    phi |P| sqrt(cond P)/k^(n+1-i) for i = 1, .., n:

        xhat_i' = xhat_(i+1) + p_i k^i (y - xhat_1),   xhat_n' = p_n k^n (y - xhat_1),   A'P + P A <= -I

    `gains`: p (n), with the companion matrix A; `phi`: a bound of |x_n'|; `k` > 0: the first value of a gain that does
    not decrease and converges. Bullinger, Ilchmann, Allgoewer, NOLCOS 1998, (14), which lacks sqrt(cond P). Raises:
    `BadGain`; `NotHurwitz`.
    """
    p, P, peak = _decaying(gains)
    level, most = Fraction(positive("k", k)), _number("phi", phi)
    worst = 2 * most * peak * _condition(P, peak)
    return tuple(worst / level ** (len(p) + 1 - i) for i in range(1, len(p) + 1))


def gain_in_time(gains: Any, *, error: float, time: float, phi: float, start: float) -> float:
    """Return a gain k >= 1 such that the observer of `error_bounds` with any constant gain from k on has |x - xhat| <=
    `error` from `time` on, where |x - xhat| <= `start` at first and |x_n'| <= `phi`.

    With V = n'P n, n_i = e_i/k^(i-1): where |n| >= 2 |P| phi/(s k^n), V' <= -(1 - s) k V/|P|, so |e| is at most the
    larger of 2 |P| sqrt(cond P) phi/(s k) and k^(n-1) sqrt(cond P) start exp(-(1 - s) k t/(2 |P|)), for s in (0, 1).
    Both decrease in k from (n - 1) 2 |P|/((1 - s) t) on. Bullinger, Ilchmann, Allgoewer, NOLCOS 1998, theorem 1, which
    states that such a k exists. Raises: `BadGain`; `NotHurwitz`.
    """
    p, P, peak = _decaying(gains)
    wanted, after = Fraction(positive("error", error)), Fraction(positive("time", time))
    most, first, n = _number("phi", phi), _number("start", start), len(p)
    condition = _condition(P, peak)

    def enough(share: Fraction, k: Fraction) -> bool:
        speed = (1 - share) * after / (2 * peak)
        if k * speed < n - 1 or 2 * peak * condition * most > wanted * share * k:
            return False
        return k ** (n - 1) * condition * first <= wanted * _below_exp(k * speed)

    return min(_least(partial(enough, share)) for share in _SHARES)


def _below_exp(x: Fraction) -> Fraction:
    """Return a number just below e^x, x >= 0: (1 + x/m)^m, m = 2^12, by squares that are rounded down."""
    power = 1 + x / (1 << _SQUARES)
    for _ in range(_SQUARES):
        power = Fraction(int(power * power * (1 << 60)), 1 << 60)
    return power


def _least(enough: Callable[[Fraction], bool]) -> float:
    low, high = 1.0, 1.0
    while not enough(Fraction(high)):
        low, high = high, 2 * high
        if not isfinite(high):
            raise BadGain("the gain", "is beyond a double; ask for a larger error, or a longer time")
    for _ in range(_STEPS if high > 1 else 0):
        middle = (low + high) / 2
        low, high = (low, middle) if enough(Fraction(middle)) else (middle, high)
    return high


def _candidate(K: Any, P: Any, sigma: Any, decay: float | None) -> tuple[Candidate, Fraction]:
    """Return K, P and sigma, which must satisfy (54) with
    lambda = `decay`, and lambda, by default the largest."""
    known = candidate(K, P, sigma)
    rate = None if decay is None else Fraction(positive("decay", decay))
    for check in candidate_checks("design", known):
        if check.verdict is not Verdict.PROVED:
            raise BadGain("K and P", f"do not satisfy {check.claim}: {check.reason}")
    if rate is not None and not nonnegative(known.rate - unit(known.n) * number(rate)):
        raise BadGain(f"decay = {decay!r}", f"is no lambda of (54), of which the largest is {float(known.decay):.6g}")
    return known, known.decay if rate is None else rate


def _decaying(gains: Any) -> tuple[np.ndarray, Any, Fraction]:
    """Return p, the `gains` (n), a P with A'P + P A <= -I, A
    their companion matrix, and an upper bound of |P|."""
    p = _column("gains", gains)
    exactly = np.array([Fraction(x) for x in p.tolist()], dtype=object)
    A = companion(exactly)
    demand_hurwitz("gains", A, "take the coefficients of a polynomial whose roots decay")
    known = lyapunov(tuple(map(tuple, A.tolist())))
    assert known is not None
    return p, known.P, known.peak


def _square(column: Sequence[Fraction]) -> Fraction:
    return sum((x * x for x in column), Fraction(0))


def _condition(P: Any, peak: Fraction) -> Fraction:
    """Return sqrt(`peak`/lambda_min(P)), the root of the condition number of P, rounded up."""
    return root(peak / smallest(exact(P))[0], bits=52)


def _column(name: str, values: Any) -> np.ndarray:
    column = reals(name, values)
    if column.ndim != 1 or not column.size or not np.isfinite(column).all():
        raise BadGain(f"{name} = {values!r}", "must be finite numbers, one for each integrator")
    return column


def _number(name: str, value: Any) -> Fraction:
    known = real(name, value)
    if not 0 <= known < np.inf:
        raise BadGain(f"{name} = {value!r}", "must be a finite number, at least 0")
    return Fraction(known)
