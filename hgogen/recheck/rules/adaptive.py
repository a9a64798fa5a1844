"""The matrix inequalities of observers with a time-varying gain, adaptive or updated, and with an adaptive level.

With N = A - K C of a chain of integrators, K the observer's `gains`, D = diag(b, .., b + n - 1), b = 1 unless stated,
and e the error of w scaled by the powers of the gain l, e'/l = (N - r D + J(l)/l) e, r = l'/l^2:

    adaptive_lmi   gamma'/gamma^2 >= -sigma,  P > 0,  D P + P D >= 0,  N'P + P N + sigma (D P + P D) + lambda I <= 0.
                   With w' + G_1 v and y + G_2 v, mu^2 >= 2 gamma_sup^(2n) s bounds the L2 gain from v to the error of
                   w, with k >= |T^-1 dc/dw T| at T = diag(gamma_inf, .., gamma_inf^n), and so for every larger gamma,
                   where N'P + P N + sigma (D P + P D) + lambda I + (delta_1 P P + delta_2 P K K'P)/s <= 0,
                   lambda = (4 k lambda_max(P) + 1)/(2 gamma_inf), delta_1 >= 1 + |G_1|^2,
                   delta_2 = G_2 (I + G_1'G_1) G_2'. Or by a separate V, D V + V D >= 0, in e_i = units_i times the
                   error of w_i over gamma^i: with the slopes of c bounded as in `inclusion` at gamma_inf,
                   V' + |w - what|^2 - mu^2 |v|^2 < 0 at gamma' = -sigma gamma^2, at both ends of gamma and, each by
                   itself, of gamma^-i in gamma^-i G_1: in gamma it is convex, in the others linear
    updated_gain   L' = L (p_1 (p_2 - L) + p_3 Gamma), N'P + P N <= -I, D P + P D > 0:
                   N'P + P N + p_1 (D P + P D) < 0,  p_3 (D P + P D) >= 2 lambda_max(P);  L' < 0 where L is at its
                   cap, Gamma <= sup |T^-1 dc/dw T|, Frobenius' norm, T = diag(cap, .., cap^n)
    both           V = e'P e has V' <= -alpha V at every l from the `least` on, where D P + P D > 0 and
                   M'P + P M + alpha P < 0 for each M, with J in the ranges of its slopes, which contain 0:
                   least (N + sigma D) + J(least) for r >= -sigma;
                   least N + J(least) and least (N + p_1 D) for r >= -p_1 (1 - least/l), a combination of both with
                   the shares least/l and 1 - least/l, as J(l)/l shrinks with l

Sources: Alessandri, Mathematical Problems in Engineering (2020), (54)-(62), (70), (87); Andrieu, Praly, Astolfi,
Automatica 45 (2009).

The convergence of an observer with injection through a saturation or a dead zone whose level adapts:

    w' = A w + c(w, u) + diag(l, .., l^n) K i(e),   e = y - w_1,   sigma' = l (-lambda sigma + r e^2),   l = theta
    stubborn: i(e) = sat e = e - q,   dead_zone: i(e) = e - sat e = e - s,   |sat e| <= sqrt sigma

`gains` are K, `decay` is lambda. In eps_i = units_i l^(1-i) (w_i - plant's), units_1 = 1, with N = A - K C so scaled, P
> 0, and one mu > 0, tau >= 0 for which the symmetric form

    dead_zone  eps'(N'P + P N) eps + 2 eps'P K s + mu (r eps_1^2 - lambda s^2) + 2 tau s (eps_1 - s)
    stubborn   eps'(N'P + P N) eps + 2 eps'P K q + mu (2 eps_1 C (N eps + K q) + lambda (eps_1 - q)^2 - r eps_1^2)
               + 2 tau q (eps_1 - q)

is negative, the core decays: for the dead zone with V = eps'P eps + mu sigma, sigma >= s^2, s (eps_1 - s) >= 0; for the
stubborn observer with V = eps'P eps + mu max(eps_1^2 - sigma, 0), sigma = (eps_1 - q)^2 where q is not 0, and where it
is, N'P + P N is negative too. With c the error dynamics have N + J/l instead of N, J of slopes in ranges (`inclusion`),
in which both forms are affine: they are negative at their corners, or with multipliers S, d (v h' + h v') <= S h h' + v
v'/S for |d| <= 1. With a/l of V added V' <= -a V, for the dead zone with a <= l lambda. A decay proved at a theta holds
at every larger one: J/l shrinks, and its ranges hold 0. Source of the observers: Astolfi, Alessandri, Zaccarian, IEEE
TAC 66(2) (2021).
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from itertools import product
from operator import mul
from typing import Any

from ..arithmetic import Unproved
from ..box import frobenius
from ..context import (
    STEEP,
    Context,
    Finding,
    chains_rule,
    integrators,
    observer_of,
    observer_rule,
    on_ranges,
    printed,
    slope,
)
from ..file import Claim, Observer, ObserverKeys, above_zero, column, matrix, part, scalar, signless
from ..inclusion import error_inclusion
from ..inequality import (
    NORM,
    WORK,
    Decay,
    Input,
    clamped,
    decays,
    demand_decays,
    demand_l2,
    demand_negative,
)
from ..matrix import (
    Matrix,
    column_matrix,
    companion,
    decaying,
    demand_nonnegative,
    demand_positive,
    dot,
    lyapunov,
    outer,
    similar,
    unit,
    zeros,
)

# --- adaptive_lmi


def inequality(context: Context, claim: Claim) -> Finding:
    """Prove P > 0, D P + P D >= 0, or N'P + P N + sigma (D P + P D) < 0; D = diag(1, .., n), N = A - K C."""
    observer, P = observer_of(context, claim), _P(context, claim)
    match claim.fact:
        case "definite":
            demand_positive({"P": P})
            return Finding("P is positive definite")
        case "shrink":
            demand_nonnegative({"D P + P D": _spread(P, Fraction(1))})
            return Finding("D P + P D is positive semidefinite")
        case _:
            demand_positive({"-N'P - P N - sigma (D P + P D)": _rate(observer, P)})
            return Finding("N'P + P N + sigma (D P + P D) is negative definite")


def attenuation(context: Context, claim: Claim) -> Finding:
    """Prove that the L2 gain from the disturbance v in w' + G_1 v, y + G_2 v to the error of w is at most the claim's
    mu, by the claim's storage function V, if there is one, else by a formula."""
    return (_by_one_v if "V" in claim.evidence else _by_formula)(context, claim)


def _by_one_v(context: Context, claim: Claim) -> Finding:
    """Prove the L2 gain by the storage function e'V e of the claim, at both ends of the range of the gain gamma and of
    each gamma^-i with a nonzero row i of G_1."""
    observer, evidence, n = observer_of(context, claim), claim.evidence, len(context.z)
    (low, high), mu = column(observer.numbers, "gamma", 2), above_zero(evidence, "mu")
    sigma, m = scalar(observer.numbers, "sigma"), len(part(evidence, "G_2", list))
    if not 0 < low <= high or sigma < 0 or not m:
        raise Unproved("its gamma has no range above zero, its sigma is negative, or its G_2 is no list of numbers")
    G, g = matrix(evidence, "G_1", n, m), column(evidence, "G_2", m)
    error = error_inclusion(context, observer, evidence)
    units, V, parts = column(evidence, "units", n), matrix(evidence, "V", n, n), error.at(low)
    demand_nonnegative({"D V + V D": _spread(V, Fraction(1))})
    weights, D = {"P": evidence["V"], "S": evidence["S"]}, unit(n).weighed(range(1, n + 1))
    ends = [(low**-i, high**-i) if any(row) else (low**-i,) for i, row in enumerate(G, 1)]
    for gamma, powers in product((low, high), product(*ends)):
        M = gamma * (error.N + sigma * D) + parts.M - parts.L
        B = error.measured @ Matrix([g]) - G.weighed(map(mul, units, powers))
        inputs = [Input(zeros(1, len(context.form.output)), each) for each in B.T]
        counted = [(i, gamma ** (i + 1) / unit_) for i, unit_ in enumerate(units)]
        demand_l2(replace(parts, M=M), weights, inputs, counted, mu)
    return _attenuated(context, G, Matrix([g]), mu, error.boxes)


def _by_formula(context: Context, claim: Claim) -> Finding:
    """Prove the claim's bound of the L2 gain by (87) of Alessandri (2020)."""
    observer, evidence = observer_of(context, claim), claim.evidence
    (low, high), P, n = column(observer.numbers, "gamma", 2), _P(context, claim), len(context.z)
    if not 0 < low <= high:
        raise Unproved("its gamma has no range above zero")
    k, peak = scalar(evidence, "bound"), scalar(evidence, "peak")  # bounds of |T^-1 dc/dw T| and of lambda_max(P)
    demand_positive({"P": P})
    demand_nonnegative({"D P + P D": _spread(P, Fraction(1)), "peak I - P": peak * unit(n) - P})
    if not isinstance(evidence.get("G_2"), list) or not evidence["G_2"]:
        raise Unproved("its G_2 is no list of numbers")
    m, share, mu = len(evidence["G_2"]), above_zero(evidence, "share"), above_zero(evidence, "mu")
    G, g, first = matrix(evidence, "G_1", n, m), Matrix([column(evidence, "G_2", m)]), scalar(evidence, "delta_1")
    ((second,),) = g @ (unit(m) + G.T @ G) @ g.T
    PK = P @ column_matrix(column(observer.numbers, "gains", n))
    load, rate = first * (P @ P) + second * (PK @ PK.T), (4 * k * peak + 1) / (2 * low)
    demand_nonnegative(
        {
            "(delta_1 - 1) I - G_1 G_1'": (first - 1) * unit(n) - G @ G.T,
            "matrix of (87), negated,": _rate(observer, P) - rate * unit(n) - 1 / share * load,
        }
    )
    if low < 1 or mu**2 < 2 * share * high ** (2 * n):
        raise Unproved("its mu is too small")
    _, boxes = _at(context, claim, low)
    return _attenuated(context, G, g, mu, boxes)


def _attenuated(context: Context, G: Matrix, g: Matrix, mu: Fraction, boxes: int) -> Finding:
    where = f"G_1 = {_printed(G)}, G_2 = {_printed(g)}{on_ranges(context.form.box)}"
    gain = f"the L2 gain from v in w' + G_1 v, y + G_2 v to the error of w is at most {printed(mu, 1)}"
    return Finding(f"in continuous time, {gain}, {where}", boxes)


def _printed(M: Matrix) -> str:
    return f"[{'; '.join(' '.join(map(str, row)) for row in M)}]"


def _at(context: Context, claim: Claim, gain: Fraction, **norm: Any) -> tuple[Fraction, int]:
    """Return the claim's bound of |T^-1 dc/dw T| for w' = A w + c, T = diag(gain, gain^2, ..), proved here, and the
    number of boxes."""
    scale = integrators(context, claim.evidence)
    if scale.units != [gain ** -(i + 1) for i in range(len(context.z))]:
        raise Unproved(f"its units are not the powers of {printed(gain)}")
    bound, boxes = slope(context, claim.evidence, scale.expressions, **norm)
    return bound, scale.boxes + boxes


def _rate(observer: Observer, P: Matrix) -> Matrix:
    """Return -N'P - P N - sigma (D P + P D), N = A - K C, D = diag(1, .., n), K and sigma the observer's."""
    N = companion(column(observer.numbers, "gains", len(P)))
    return -1 * lyapunov(P, N) - signless(observer.numbers, "sigma") * _spread(P, Fraction(1))


def _P(context: Context, claim: Claim) -> Matrix:
    n, P = len(context.z), claim.evidence.get("P")
    for other in context.file.claims:
        if other.maker == claim.maker and other.fact not in _CONVERGENCE and other.evidence.get("P", P) != P:
            raise Unproved(f"{other.id} tells another P")
    return matrix(claim.evidence, "P", n, n)


def _spread(P: Matrix, b: Fraction) -> Matrix:
    """Return D P + P D, D = diag(b, .., b + n - 1)."""
    return Matrix([[(2 * b + i + j) * value for j, value in enumerate(row)] for i, row in enumerate(P)])


# --- updated_gain


def falls(context: Context, claim: Claim) -> Finding:
    """Prove N'P + P N + p_1 (D P + P D) < 0 for N = A - K C, D = diag(b, .., b + n - 1), with the claim's P and b."""
    p_1, (P, N, spread) = above_zero(observer_of(context, claim).numbers, "p_1"), _weighted(context, claim)
    demand_positive({"-N'P - P N - p_1 (D P + P D)": -1 * lyapunov(P, N) - p_1 * spread})
    return Finding(f"p_1 = {printed(p_1)} is small enough: N'P + P N + p_1 (D P + P D) < 0 {_matrix_words(claim)}")


def rises(context: Context, claim: Claim) -> Finding:
    """Prove p_3 (D P + P D) >= 2 lambda_max(P) for D = diag(b, b + 1, ..), with the claim's P and b; a proved claim on
    p_1 must have the same."""
    p_3, (P, _, spread) = above_zero(observer_of(context, claim).numbers, "p_3"), _weighted(context, claim)
    peak, n = scalar(claim.evidence, "peak"), len(P)
    demand_nonnegative(
        {
            "peak I - P": peak * unit(n) - P,
            "p_3 (D P + P D) - 2 peak I": p_3 * spread - 2 * peak * unit(n),
        }
    )
    for other in context.file.claims:
        if (
            other.id == "updated_gain.p_1"
            and other.verdict == "proved"
            and _same(other.evidence) != _same(claim.evidence)
        ):
            raise Unproved("its P is not that of updated_gain.p_1")
    return Finding(f"p_3 = {printed(p_3)} is large enough: p_3 (D P + P D) >= 2 lambda_max(P) {_matrix_words(claim)}")


def _matrix_words(claim: Claim) -> str:
    return f"for its P and D = diag(b, .., b + n - 1), b = {printed(scalar(claim.evidence, 'b'))}"


def _same(evidence: Mapping[str, Any]) -> tuple[Any, Any]:
    return evidence.get("P"), evidence.get("b")


def below_cap(context: Context, claim: Claim) -> Finding:
    """Prove that the gain L decreases at L = `cap`: L' = L (p_1 (p_2 - L) + p_3 Gamma) < 0."""
    numbers = observer_of(context, claim).numbers
    p_1, p_2, p_3, cap = (above_zero(numbers, name) for name in ("p_1", "p_2", "p_3", "cap"))
    gamma, boxes = _at(context, claim, cap, norm=frobenius)
    if not p_1 * (p_2 - cap) + p_3 * gamma < 0:
        raise Unproved(f"Gamma = {printed(gamma, 1)} is not below p_1 (cap - p_2)/p_3")
    where = f"where Gamma <= {printed(gamma, 1)}{on_ranges(context.form.box)}"
    return Finding(f"in continuous time, L' < 0 at the cap {printed(cap)}, {where}", boxes)


def _weighted(context: Context, claim: Claim) -> tuple[Matrix, Matrix, Matrix]:
    """Return P, N = A - K C and D P + P D, D = diag(b, b + 1, ..); proved are N'P + P N <= -I, P > 0 and D P + P D >
    0."""
    P, b = _P(context, claim), above_zero(claim.evidence, "b")
    N, spread = companion(column(observer_of(context, claim).numbers, "gains", len(P))), _spread(P, b)
    demand_positive({"P": P, "-I - N'P - P N": decaying(N, P), "D P + P D": spread})
    return P, N, spread


# --- both: one norm for every gain and rate


def _by_norm(context: Context, claim: Claim, slopes: Mapping[str, Any], level: Fraction, alpha: Fraction) -> int:
    """Prove V' <= -alpha V, V = e'P e, for every gain from `level` on and every rate of change of the gain; return the
    number of boxes."""
    observer, n = observer_of(context, claim), len(context.z)
    error, P, b = error_inclusion(context, observer, slopes), matrix(claim.evidence, "P", n, n), scalar(slopes, "b")
    D = unit(n).weighed(b + i for i in range(n))
    demand_positive({"D P + P D": lyapunov(P, D)})
    fall, eased = _FALL[claim.maker](observer)
    parts, shift = error.at(level), level * fall * D
    if eased:
        core = level * error.N + shift
        demand_negative("its inequality without b", lyapunov(P, core) + alpha * P)
    demand_decays(parts if eased else replace(parts, M=parts.M + shift), alpha, claim.evidence)
    return error.boxes


def _updated(observer: Observer) -> tuple[Fraction, bool]:
    """Return p_1, the largest rate at which the gain L may decrease, and True: at its least value p_2 the rate is
    zero."""
    numbers = observer.numbers
    if not 0 < scalar(numbers, "p_2") <= scalar(numbers, "cap"):
        raise Unproved("its p_2 is not from 0 to its cap")
    above_zero(numbers, "p_3")
    return above_zero(numbers, "p_1"), True


def _adaptive(observer: Observer) -> tuple[Fraction, bool]:
    """Return sigma, the largest rate at which the gain gamma may decrease, and False: this rate is possible at the
    least gain, too."""
    low, high = column(observer.numbers, "gamma", 2)
    if not 0 < low <= high:
        raise Unproved("its gamma has no range above zero")
    return signless(observer.numbers, "sigma"), False


def _gain(observer: Observer) -> tuple[str, Fraction]:
    if observer.name == "updated_gain":
        return "p_2", scalar(observer.numbers, "p_2")
    return "gamma_inf", column(observer.numbers, "gamma", 2)[0]


def _phrase(observer: Observer) -> str:
    every = f"the error converges exponentially for every {_gain(observer)[0]} above {{}}"
    return f"{every}, at every rate of the gain that its law permits"


_FALL = {"updated_gain": _updated, "adaptive_lmi": _adaptive}
_CONVERGENCE = ("convergence", "theta")
_OF_V = ("slopes", "V", "S")
_SLOPED = (*STEEP, "units", "scale", "P", "peak")


Form = Callable[[Matrix], Matrix]  # an affine function of N


def core(context: Context, claim: Claim) -> Finding:
    """Prove that the linear error decays despite the saturation or dead zone of the output error, with the claim's P,
    mu and tau."""
    observer, n = observer_of(context, claim), len(context.z)
    units = _units(claim.evidence, n)
    N = similar(units, companion(column(observer.numbers, "gains", n)))
    for form in _forms(observer, units, claim.evidence, Fraction(0)):
        demand_negative("form", form(N))
    return Finding("the linear error core decays, by a quadratic form")


def _falls(context: Context, claim: Claim, slopes: Mapping[str, Any], level: Fraction, alpha: Fraction) -> int:
    """Prove V' <= -alpha V at theta = `level` for all partial derivatives in the ranges `slopes`, with the claim's P,
    mu and tau; return the number of boxes."""
    observer, evidence = observer_of(context, claim), claim.evidence
    error = error_inclusion(context, observer, slopes)
    if observer.name == "dead_zone" and alpha > level * above_zero(observer.numbers, "decay"):
        raise Unproved("its alpha is above theta decay")
    parts = error.at(level)
    G, H, N = parts.G, parts.H, 1 / level * parts.M
    n, m = len(N), len(H)
    steps = [1 / level * outer(column_, read) for column_, read in zip(G.T, H, strict=True)]
    forms = _forms(observer, _units(slopes, n), evidence, alpha / level)
    if "S" in evidence:
        S = column(evidence, "S", m)
        if min(S, default=Fraction(1)) <= 0:
            raise Unproved("its S is not positive")
        for form in forms:
            demand_negative("form", _bounded(form, N, steps, H, S))
        return error.boxes
    if 2**m * n**3 > WORK:
        raise Unproved("it has no S, and more corners of its slopes than are tried one by one")
    for form, d in product([*forms], product((-1, 1), repeat=m)):
        demand_negative("form", form(sum((x * each for x, each in zip(d, steps, strict=True)), start=N)))
    return error.boxes


def _bounded(form: Form, N: Matrix, steps: list[Matrix], H: Matrix, S: list[Fraction]) -> Matrix:
    """Return the matrix of an affine `form` at N plus an upper bound of the effect of the uncertainties N + d step, |d|
    <= 1: d (v h' + h v') <= S h h' + v v'/S, h the rows of H."""
    whole = base = form(N)
    for step, read, s in zip(steps, H, S, strict=True):
        h = [*read, *[Fraction(0)] * (len(base) - len(read))]
        along = (form(N + step) - base).applied(h)
        square = dot(along, h)
        v = [x - y * square / 2 for x, y in zip(along, h, strict=True)]
        whole += s * outer(h, h) + 1 / s * outer(v, v)
    return whole


def _units(evidence: Mapping[str, Any], n: int) -> list[Fraction]:
    units = column(evidence, "units", n)
    if units[0] != 1 or min(units) <= 0:
        raise Unproved("its units are not positive with the first 1")
    return units


def _forms(observer: Observer, units: list[Fraction], evidence: Mapping[str, Any], a: Fraction) -> Iterator[Form]:
    """Yield, as functions of N, the matrices of the quadratic form V' + a V: (n + 1, n + 1) with the saturation or dead
    zone, and (n, n) with the whole output error injected."""
    n, numbers = len(units), observer.numbers
    gains, decay, r = column(numbers, "gains", n), above_zero(numbers, "decay"), above_zero(numbers, "r")
    mu, tau = above_zero(evidence, "mu"), signless(evidence, "tau")
    K, P = [s * k for s, k in zip(units, gains, strict=True)], matrix(evidence, "P", n, n)
    demand_positive({"P": P})

    def behind(N: Matrix) -> Matrix:
        top, side = lyapunov(P, N) + a * P, P.applied(K)
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
        return Matrix([*([*row, end] for row, end in zip(top, side, strict=True)), [*side, last]])

    yield behind
    yield lambda N: lyapunov(P, N) + a * P


_GAINS, _LEVELS = ("updated_gain", "adaptive_lmi"), ("stubborn", "dead_zone")
OBSERVERS = {
    "updated_gain": ObserverKeys(("p_1", "p_2", "p_3", "cap", "gains")),
    "adaptive_lmi": ObserverKeys(("gamma", "sigma", "gains")),
    **dict.fromkeys(_LEVELS, ObserverKeys(("theta", "decay", "r", "gains"))),
}
RULES = (
    observer_rule(("updated_gain",), ("p_1",), falls, ("P", "b"), turning=()),
    observer_rule(("updated_gain",), ("p_3",), rises, ("P", "b", "peak"), turning=()),
    chains_rule(("updated_gain",), ("cap",), below_cap, (*STEEP, "units", "scale"), turning=()),
    observer_rule(("adaptive_lmi",), ("definite", "shrink", "decay"), inequality, ("P",), turning=()),
    chains_rule(
        ("adaptive_lmi",), ("attenuation",), attenuation, (*_SLOPED, *_OF_V, "G_1", "G_2", "delta_1", "share", "mu")
    ),
    *decays(_GAINS, Decay(_by_norm, _gain, _phrase), ("scale", "slopes", "units", "b"), NORM),
    observer_rule(_LEVELS, ("core",), core, ("units", "P", "mu", "tau")),
    *decays(_LEVELS, Decay(_falls), ("scale", "slopes", "units"), ("P", "mu", "tau", "S")),
    clamped((*OBSERVERS,)),
)
