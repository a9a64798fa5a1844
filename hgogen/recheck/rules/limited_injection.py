"""The convergence of an observer that injects through a saturation or a dead zone whose level adapts, verified again.

    w' = A w + c(w, u) + diag(l, .., l^n) K i(e),   e = y - w_1,   sigma' = l (-lambda sigma + r e^2),   l = theta
    stubborn: i(e) = sat e = e - q,   dead_zone: i(e) = e - sat e = e - s,   |sat e| <= sqrt sigma

`gains` are K, `decay` is lambda. In eps_i = units_i l^(1-i) (w_i - plant's), units_1 = 1, with N = A - K C so scaled,
N'P + P N <= -I, P > 0, and one mu > 0, tau >= 0 for which the symmetric form

    dead_zone  eps'(N'P + P N) eps + 2 eps'P K s + mu (r eps_1^2 - lambda s^2) + 2 tau s (eps_1 - s)
    stubborn   eps'(N'P + P N) eps + 2 eps'P K q + mu (2 eps_1 C (N eps + K q) + lambda (eps_1 - q)^2 - r eps_1^2)
               + 2 tau q (eps_1 - q)

is at most -eta I, the core decays: V = eps'P eps + mu sigma of the dead zone, for sigma >= s^2, s (eps_1 - s) >= 0;
V = eps'P eps + mu max(eps_1^2 - sigma, 0) of the other, for sigma = (eps_1 - q)^2 where q is not 0. With c it does for

    l > max(1, 2 L (lambda_max(P) + m)/eta, 2 L lambda_max(P)),   m = 0 of the dead zone, mu of the saturation,

L >= |S dc/dw S^-1| on the box. Source of the observers: Astolfi, Alessandri, Zaccarian, IEEE TAC 66(2) (2021).
"""

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from ..box import NotShown
from ..chain import built, integrators, slope
from ..context import Context, Shown, on, short
from ..file import Built, Claim, Observer
from ..matrix import (
    Matrix,
    above_zero,
    column,
    companion,
    decaying,
    demand_nonnegative,
    demand_positive,
    matrix,
    minus,
    scalar,
    scaled,
    similar,
    times,
    twice,
    unit,
)
from ..rule import STEEP, of_observer
from ..structure import clamped, on_chains
from ..threshold import above


def core(context: Context, claim: Claim) -> Shown:
    """The linear core decays behind its saturation or dead zone."""
    observer = built(context, claim)
    units = column(claim.evidence, "units", len(context.z))
    demand_positive({"form, negated,": _form(observer, units, claim.evidence)})
    return Shown("the linear error core decays, by a quadratic form")


def convergence(context: Context, claim: Claim) -> Shown:
    """Every theta above the bound converges; the structure of the form is another claim."""
    observer, evidence = built(context, claim), claim.evidence
    scale, n = integrators(context, evidence), len(context.z)
    margin, peak = above_zero(evidence, "margin"), scalar(evidence, "peak")
    P = matrix(evidence, "P", n, n)
    demand_nonnegative(
        {
            "form, negated, less its margin": minus(
                _form(observer, scale.units, evidence), scaled(margin, unit(n + 1))
            ),
            "peak I - P": minus(scaled(peak, unit(n)), P),
        }
    )
    _, boxes = slope(context, evidence, scale.expressions)
    above = f"the error converges exponentially for every theta above {short(threshold(observer, claim), 1)}"
    return Shown(f"in continuous time, without noise, {above}{on(context.form.box)}", scale.boxes + boxes)


def threshold(observer: Observer, claim: Claim) -> Fraction:
    """The bound of a claim of convergence."""
    peak, margin, mu, bound = (scalar(claim.evidence, key) for key in ("peak", "margin", "mu", "bound"))
    weight = peak + (mu if observer.name == "stubborn" else 0)
    if not margin > 0:
        raise NotShown("its margin is not positive")
    return max(Fraction(1), 2 * bound * max(weight / margin, peak))


def _form(observer: Observer, units: list[Fraction], evidence: Mapping[str, Any]) -> Matrix:
    """The form (n + 1, n + 1), times -1, of a P for which N'P + P N <= -I."""
    n, numbers = len(units), observer.numbers
    if units[0] != 1 or min(units) <= 0:
        raise NotShown("its units are not positive with the first 1")
    gains, decay, r = column(numbers, "gains", n), above_zero(numbers, "decay"), above_zero(numbers, "r")
    mu, tau = above_zero(evidence, "mu"), scalar(evidence, "tau")
    if tau < 0:
        raise NotShown("its tau is negative")
    N, K = similar(units, companion(gains)), [s * k for s, k in zip(units, gains, strict=True)]
    P = matrix(evidence, "P", n, n)
    demand_positive({"P": P, "-I - N'P - P N": decaying(N, P)})
    top, side = twice(P, N), [row[0] for row in times(P, [[k] for k in K])]
    side[0] += tau
    if observer.name == "dead_zone":
        top[0][0] += mu * r
        last = -mu * decay - 2 * tau
    else:
        for j in range(n):
            top[0][j] += mu * N[0][j]
            top[j][0] += mu * N[0][j]
        top[0][0] += mu * (decay - r)
        side[0] += mu * (K[0] - decay)
        last = mu * decay - 2 * tau
    whole = [[*row, end] for row, end in zip(top, side, strict=True)]
    return scaled(Fraction(-1), [*whole, [*side, last]])


OBSERVERS = dict.fromkeys(("stubborn", "dead_zone"), Built(("theta", "decay", "r", "gains")))
_KEYS = (*STEEP, "units", "scale", "P", "mu", "tau", "peak", "margin")
RULES = tuple(
    rule
    for name in OBSERVERS
    for rule in (
        of_observer(name, "core", core, ("units", "P", "mu", "tau")),
        *on_chains(name, "convergence", convergence, _KEYS),
        *on_chains(name, "theta", above(threshold), rests=(f"{name}.convergence",)),
        clamped(name),
    )
)
