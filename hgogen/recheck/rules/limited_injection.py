"""The convergence of an observer that injects through a saturation or a dead zone whose level adapts, verified again.

    w' = A w + c(w, u) + diag(l, .., l^n) K i(e),   e = y - w_1,   sigma' = l (-lambda sigma + r e^2),   l = theta
    stubborn: i(e) = sat e = e - q,   dead_zone: i(e) = e - sat e = e - s,   |sat e| <= sqrt sigma

`gains` are K, `decay` is lambda. In eps_i = units_i l^(1-i) (w_i - plant's), units_1 = 1, with N = A - K C so scaled,
P > 0, and one mu > 0, tau >= 0 for which the symmetric form

    dead_zone  eps'(N'P + P N) eps + 2 eps'P K s + mu (r eps_1^2 - lambda s^2) + 2 tau s (eps_1 - s)
    stubborn   eps'(N'P + P N) eps + 2 eps'P K q + mu (2 eps_1 C (N eps + K q) + lambda (eps_1 - q)^2 - r eps_1^2)
               + 2 tau q (eps_1 - q)

is negative, the core decays: V = eps'P eps + mu sigma of the dead zone, for sigma >= s^2, s (eps_1 - s) >= 0; V =
eps'P eps + mu max(eps_1^2 - sigma, 0) of the other, for sigma = (eps_1 - q)^2 where q is not 0, and where it is, N'P +
P N is negative too. With c the error has N + J/l in the place of N, J of slopes in ranges (`uncertain`), in which both
are affine: at their corners, or with multipliers S, d (v h' + h v') <= S h h' + v v'/S for |d| <= 1. With a/l of V
beside them V' <= -a V, where of the dead zone a <= l lambda. What holds at a theta holds at every larger one: J/l
shrinks, and its ranges hold 0. Source of the observers: Astolfi, Alessandri, Zaccarian, IEEE TAC 66(2) (2021).
"""

from collections.abc import Callable, Iterator, Mapping
from fractions import Fraction
from itertools import product
from typing import Any

from ..box import NotShown
from ..chain import built
from ..context import Context, Shown
from ..falling import WORK, Decay, clamped, decays
from ..file import Built, Claim, Observer, above_zero, column, matrix, signless
from ..inequality import demand_negative
from ..matrix import Matrix, companion, demand_positive, dot, plus, scaled, similar, times, twice
from ..rule import of_observer
from ..uncertain import error_inclusion

Form = Callable[[Matrix], Matrix]  # of N, in which it is affine


def core(context: Context, claim: Claim) -> Shown:
    """The linear core decays behind its saturation or dead zone."""
    observer, n = built(context, claim), len(context.z)
    units = _units(claim.evidence, n)
    N = similar(units, companion(column(observer.numbers, "gains", n)))
    for form in _forms(observer, units, claim.evidence, Fraction(0)):
        demand_negative("form", form(N))
    return Shown("the linear error core decays, by a quadratic form")


def _falls(context: Context, claim: Claim, slopes: Mapping[str, Any], level: Fraction, alpha: Fraction) -> int:
    """V' <= -alpha V at a theta, by the claim's V, whatever the slopes; with how many boxes these are shown."""
    observer, evidence = built(context, claim), claim.evidence
    error = error_inclusion(context, observer, slopes)
    if observer.name == "dead_zone" and alpha > level * above_zero(observer.numbers, "decay"):
        raise NotShown("its alpha is above theta decay")
    parts = error.at(level)
    G, H, N = parts.G, parts.H, scaled(1 / level, parts.M)
    n, m = len(N), len(H)
    moves = [[[row[j] * h / level for h in H[j]] for row in G] for j in range(m)]
    forms = _forms(observer, _units(slopes, n), evidence, alpha / level)
    if "S" in evidence:
        S = column(evidence, "S", m)
        if min(S, default=Fraction(1)) <= 0:
            raise NotShown("its S is not positive")
        for form in forms:
            demand_negative("form", _bounded(form, N, moves, H, S))
        return error.boxes
    if 2**m * n**3 > WORK:
        raise NotShown("it has no S, and more corners of its slopes than are tried one by one")
    for form, d in product([*forms], product((-1, 1), repeat=m)):
        demand_negative("form", form(plus(N, *(scaled(Fraction(x), move) for x, move in zip(d, moves, strict=True)))))
    return error.boxes


def _bounded(form: Form, N: Matrix, moves: list[Matrix], H: Matrix, S: list[Fraction]) -> Matrix:
    """The form at N, with what each slope adds to it at most."""
    whole = base = form(N)
    for move, read, s in zip(moves, H, S, strict=True):
        by = plus(form(plus(N, move)), scaled(Fraction(-1), base))
        h = [*read, *[Fraction(0)] * (len(base) - len(read))]
        along = [dot(row, h) for row in by]
        twice_own = dot(along, h)
        v = [x - y * twice_own / 2 for x, y in zip(along, h, strict=True)]
        added = [[s * h[i] * h[j] + v[i] * v[j] / s for j in range(len(h))] for i in range(len(h))]
        whole = plus(whole, added)
    return whole


def _units(evidence: Mapping[str, Any], n: int) -> list[Fraction]:
    units = column(evidence, "units", n)
    if units[0] != 1 or min(units) <= 0:
        raise NotShown("its units are not positive with the first 1")
    return units


def _forms(observer: Observer, units: list[Fraction], evidence: Mapping[str, Any], a: Fraction) -> Iterator[Form]:
    """The forms of N with a times V beside them: (n + 1, n + 1), and (n, n) where all of the error is injected."""
    n, numbers = len(units), observer.numbers
    gains, decay, r = column(numbers, "gains", n), above_zero(numbers, "decay"), above_zero(numbers, "r")
    mu, tau = above_zero(evidence, "mu"), signless(evidence, "tau")
    K, P = [s * k for s, k in zip(units, gains, strict=True)], matrix(evidence, "P", n, n)
    demand_positive({"P": P})

    def behind(N: Matrix) -> Matrix:
        top, side = plus(twice(P, N), scaled(a, P)), [row[0] for row in times(P, [[k] for k in K])]
        side[0] += tau
        if observer.name == "dead_zone":
            top[0][0] += mu * r
            last = mu * (a - decay) - 2 * tau
        else:
            for j in range(n):
                top[0][j] += mu * N[0][j]
                top[j][0] += mu * N[0][j]
            top[0][0] += mu * (decay - r)
            side[0] += mu * (K[0] - decay + a)
            last = mu * (decay - a) - 2 * tau
        whole = [[*row, end] for row, end in zip(top, side, strict=True)]
        return [*whole, [*side, last]]

    yield behind
    yield lambda N: plus(twice(P, N), scaled(a, P))


OBSERVERS = dict.fromkeys(("stubborn", "dead_zone"), Built(("theta", "decay", "r", "gains")))
_V = ("P", "mu", "tau", "S")
RULES = (
    of_observer((*OBSERVERS,), ("core",), core, ("units", "P", "mu", "tau")),
    *decays((*OBSERVERS,), Decay(_falls), ("scale", "slopes", "units"), _V),
    clamped((*OBSERVERS,)),
)
