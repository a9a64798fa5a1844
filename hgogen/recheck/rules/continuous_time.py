"""The convergence in continuous time of an observer with constant injection.

    high_gain            z' = A z + b(sat z, u) + diag(theta, .., theta^n) K (y - C z), on a chain for each output
    circle_criterion     the same with b(sat(z + N_theta (y - C z)), u), N_theta of the entries `argument`
    switched_gain        the same with one of two theta, held for a time
    filtered             w_i' = w_(i+1) + c_i + L_i eta_i,   eta_i' = -theta alpha eta_i + theta^2 beta eta_(i-1)
    filtered_injection   w' = A w + c + diag(theta, .., theta^n) NH eta,   eta' = theta F eta + theta G (y - w_1)
    low_power            p_i' = q_i + c_i + theta k_i1 e_i,   q_i' = q_(i+1) + c_(i+1) + theta^2 k_i2 e_i,   i < n
    peaking_free         the same with sat q_(i+1) in q_i', e_i = sat q_(i-1) - p_i, and p_n' = c_n + theta last e_n

with eta_0 = y - w_1, e_1 = y - p_1, e_i = q_(i-1) - p_i, q_n = 0; b and c have the estimate clamped to the box as
argument, sat clamps to the range of the state; `gains` are K, L, or the pairs k. K acts chain by chain, or is a matrix,
whose entry for the state i and the output of chain k is multiplied by theta^(p(i) - p(k) + 1), p the powers that scale
states. The errors e of fields, in units and over powers of theta, obey e' = M e with slopes in ranges (`inclusion`); P
> 0 with M'P + P M + alpha P < 0 for all of them proves V' <= -alpha V, V = e'P e. A decay at the `least` theta holds at
every larger one: M/theta is N and slopes over theta^(degree + 1). Slopes of a degree above -1 have 0 in their ranges,
which shrink, and the other slopes stay.

A switch between gains multiplies e by D = diag((low/theta)^p), so that V becomes at most `up` times its value, or
`down` times: up P_low - D P_high D >= 0, down P_high - D^-1 P_low D^-1 >= 0. If the high gain is held for a time T with
alpha T > log(up down), V decreases from cycle to cycle.

The response of the error to inputs: e' = M e + B v at the observer's theta. By `inequality` |e|_P <= 1 is invariant
while each |v_k| <= 1; with |C e|^2 instead of alpha |e|_P^2, and lambda_k <= mu^2, the L2 norm of C e is at most mu
times that of v. Inputs are noise of samples, of sizes by output, and disturbances added to b in the rows of the form.

Sources of the observers: Gauthier, Hammouri, Othman, IEEE TAC 37 (1992); Ahrens, Khalil, Automatica 45 (2009), with the
dwell time of Hespanha, Morse, CDC 1999; Astolfi, Jungers, Zaccarian, ECC (2018); Astolfi, Marconi, IEEE TAC 60 (2015);
Astolfi, Marconi, Praly, Teel, Automatica 98 (2018).

The convergence of a high gain on the uniform form:

    z' = F(z, u) + diag(g_1, .., g_n) (y - h),   F_k = s_k z_(k+1) + b_k(sat z, u),   y = a z_1 + c
    g_i = theta^i K_i/(a F_1' .. F_(i-1)') at (sat z, u),   F_k' = dF_k/dz_(k+1)

    e' = (theta (N - diag(K_1, K_2 q_1, K_3 q_1 q_2, ..) 1 C) + slopes) e,   q_k in the range of s_k/F_k'

for e_i = s_1 .. s_(i-1) (z_i - x_i)/theta^(i-1), x the plant's state in its ranges, N the shift, the slopes those of b,
each with 0 in its range, because a clamp passes only a share of an error. A slope of F_k in z_(k+1) grows as theta
does, and the others do not grow: a decay of |e|_P at the least theta holds at every larger one. The matrix is affine in
each slope and in each q_k. So P > 0 with M'P + P M + alpha P < 0 at all combinations of ends proves that |e|_P^2
decreases like exp(-alpha t); else multipliers S >= 0 of the slopes prove it, with each K_i q_1 .. q_(i-1) as a slope of
its own.

The convergence of a Kalman filter of a linear plant with constant coefficients:

    z' = A z + b(u),  y = C z + d(u):   sum_k (A')^k C'C A^k > 0,  sum_k A^k Q Q' (A')^k > 0,  k < n,  R > 0

A and C are those of the certificate's form, whose b reads no state. With (C, A) observable and (A, Q) controllable P of
the Riccati equation converges to the solution for which A - P C' R^-1 C is Hurwitz. A constant `theta` above 1 scales Q
by rows and columns, so that it must be positive definite. Source: R. E. Kalman, R. S. Bucy, J. Basic Engineering 83
(1961), section 7.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from itertools import product
from math import prod
from typing import Any

from ..arithmetic import Unproved
from ..box import demand_continuous
from ..context import Context, Finding, Rule, chains_rule, constants, demand_only, enclosed, inner, observer_of, printed
from ..file import Claim, Observer, ObserverKeys, above_zero, column, entries, fields, matrix, part, scalar
from ..inclusion import (
    ERROR,
    INJECTED,
    ErrorInclusion,
    UncertainTerm,
    bounded_slopes,
    error_inclusion,
    one_sided_inclusion,
)
from ..inequality import (
    BOUND,
    FLOW,
    NORM,
    NOW,
    Decay,
    ErrorMatrices,
    Input,
    clamped,
    corners_of,
    decays,
    demand_decays,
    demand_kept,
    demand_l2,
    demand_within,
)
from ..interval import intervals, point
from ..matrix import Matrix, demand_nonnegative, demand_positive, outer, unit_row, zeros
from ..text import Expression


def _least(observer: Observer) -> tuple[str, Fraction]:
    name = "theta_low" if "theta_low" in observer.numbers else "theta"
    least = scalar(observer.numbers, name)
    if least > scalar(observer.numbers, "theta"):
        raise Unproved("theta_low is above theta")
    return name, least


def _phrase(observer: Observer) -> str:
    if "hold" in observer.numbers:
        return "the error decays exponentially between switches, in every gain above {}"
    return "the error converges exponentially for every theta above {}"


def dwell(context: Context, claim: Claim) -> Finding:
    """Prove that `hold`, the time for which the switched gain stays high, is long enough: alpha hold > log(up down),
    with the decay rate alpha of V at the high gain and the factors up and down of V at the two switches. The decay at
    the low gain is another claim."""
    numbers, evidence = observer_of(context, claim).numbers, claim.evidence
    theta, low, hold = (above_zero(numbers, name) for name in ("theta", "theta_low", "hold"))
    up, down = above_zero(evidence, "up"), above_zero(evidence, "down")
    alpha, bound = scalar(evidence, "alpha"), context.file.claim(f"{claim.maker}.convergence")
    if alpha < 0 or bound is None:
        raise Unproved("its alpha is negative, or there is no bound on theta")
    error = error_inclusion(context, observer_of(context, claim), bound.evidence)
    demand_decays(error.at(theta), alpha, evidence)
    size, other = len(error.N), context.file.claim(f"{claim.maker}.theta")
    if other is None or not other.evidence:
        raise Unproved("there is no norm of the low gain")
    high, slow = matrix(evidence, "P", size, size), matrix(other.evidence, "P", size, size)
    D, back = ([ratio**p for p in error.power] for ratio in (low / theta, theta / low))
    demand_nonnegative({"up P_low - D P_high D": up * slow - high.weighed(D).T.weighed(D)})
    demand_nonnegative({"down P_high - D^-1 P_low D^-1": down * high - slow.weighed(back).T.weighed(back)})
    lost = intervals.function("log", (point(up * down),))
    if (point(alpha * hold) - lost).sign <= 0:
        raise Unproved(f"hold = {printed(hold)} is not shown to be long enough")
    return Finding(f"in continuous time, hold = {printed(hold)} is long enough: switching keeps the error's decay")


def _falls(context: Context, claim: Claim, slopes: Mapping[str, Any], level: Fraction, alpha: Fraction) -> int:
    """Prove V' <= -alpha V, V = e'P e, at theta = `level`, for all partial derivatives in the ranges `slopes`; return
    the number of boxes."""
    error = one_sided_inclusion(context, observer_of(context, claim), slopes)
    demand_decays(error.at(level), alpha, claim.evidence)
    return error.boxes


# --- initial errors


def region(context: Context, claim: Claim) -> Finding:
    """Prove that with initial errors |z_i| <= `first`_i the errors of all injected periodic outputs stay below half a
    turn: V = e'P e does not grow, is at most `level` at the start, and level C P^-1 C' < (period/2)^2, C the row of an
    output."""
    observer, evidence, n = observer_of(context, claim), claim.evidence, len(context.z)
    theta, error = above_zero(observer.numbers, "theta"), one_sided_inclusion(context, observer, evidence)
    demand_decays(error.at(theta), Fraction(0), evidence)
    scales, level, first = error.scales(context, theta), above_zero(evidence, "level"), column(evidence, "first", n)
    P, turning = matrix(evidence, "P", len(scales), len(scales)), list[str]()
    for j, (turn, z) in enumerate(zip(context.turns, context.observed, strict=True)):
        if turn is None or not z:
            continue
        field = error.picks[context.z.index(z)]
        c = [context.output_slope(j) / scales[field] * x for x in unit_row(field, len(scales))]
        demand_positive({"half a turn": (turn.ends[0] / 2) ** 2 * P - level * outer(c, c)})
        turning.append(str(j + 1))
    if not turning:
        raise Unproved("no periodic output is injected")
    if error.largest(scales, first, P) > level:
        raise Unproved("its initial errors are not within its level")
    sizes = ", ".join(f"{z} by at most {printed(size, -1)}" for z, size in zip(context.z, first, strict=True))
    below = f"the errors of outputs {', '.join(turning)} stay below half a turn"
    return Finding(f"in continuous time, without noise, from initial errors of {sizes} {below}", error.boxes)


# --- inputs


def l2_gain(context: Context, claim: Claim) -> Finding:
    """Prove that the L2 gain from the claim's inputs v, noise and disturbances, to the states' errors, weighted by
    `counts`, is at most mu: V' + |C e|^2 - mu^2 |v|^2 < 0."""
    error, parts, scales, inputs, phrase = _error_and_inputs(context, claim)
    mu, counts = above_zero(claim.evidence, "mu"), column(claim.evidence, "counts", len(context.z))
    demand_l2(parts, claim.evidence, inputs, [(k, x / scales[k]) for k, x in zip(error.picks, counts, strict=True)], mu)
    states = ", ".join(f"{printed(x)} {z}" for x, z in zip(counts, context.z, strict=True))
    return Finding(
        f"in continuous time, {phrase}, the L2 gain to the error of {states} is at most {printed(mu, 1)}", error.boxes
    )


def iss_gain(context: Context, claim: Claim) -> Finding:
    """Prove the ultimate bound of each state's error under the claim's bounded inputs, noise and disturbances."""
    error, parts, scales, inputs, phrase = _error_and_inputs(context, claim)
    bounds = list[str]()
    each = entries(claim.evidence, "bounds", len(context.z))
    for z, field, one in zip(context.z, error.picks, each, strict=True):
        bound = above_zero(fields(one, "a bound", BOUND), "bound")
        demand_kept(parts, FLOW, NOW, one, inputs)
        demand_within(one, field, scales, bound)
        bounds.append(f"{z} comes to at most {printed(bound, 1)}")
    return Finding(f"in continuous time, {phrase}, the error of {', '.join(bounds)}", error.boxes)


def _error_and_inputs(
    context: Context, claim: Claim
) -> tuple[ErrorInclusion, ErrorMatrices, list[Fraction], list[Input], str]:
    observer, evidence = observer_of(context, claim), claim.evidence
    theta, error = scalar(observer.numbers, "theta"), error_inclusion(context, observer, evidence)
    if not theta > 0 or not error.measured:
        raise Unproved("its theta is not positive, or its gains are no numbers in these coordinates")
    scales, phrase, p = error.scales(context, theta), list[str](), len(context.form.output)
    inputs = list[Input]()
    for j, size in enumerate(column(evidence, "noise", p)):
        if size:
            context.demand_observed(j)
            inputs.append(Input(Matrix([unit_row(j, p)]), [Fraction(0)] * len(scales)) * size)
            phrase.append(f"under noise of {printed(size)} in output {j + 1}")
    for added in part(evidence, "beside", list):
        rows = column({"beside": added}, "beside", len(context.z))
        inputs.append(Input(zeros(1, p), (-1 * error.lifted(scales)).applied(rows)))
        phrase.append(f"under ({', '.join(printed(x) for x in rows)}) beside b")
    if not inputs:
        raise Unproved("nothing enters")
    return error, error.at(theta), scales, inputs, ", ".join(phrase)


_CORNERS = 1024  # of slopes and shares
Shares = list[tuple[Fraction, Fraction]]


def _uniform_falls(context: Context, claim: Claim, ranges: Mapping[str, Any], level: Fraction, alpha: Fraction) -> int:
    """Prove V' <= -alpha V, V = e'P e, at theta = `level`, for the high-gain observer on the uniform form, whose
    partial derivatives lie in `ranges`; return the number of boxes."""
    _ = context.equations
    observer, n = observer_of(context, claim), len(context.z)
    K, s = column(observer.numbers, "gains", n), _above(context)
    demand_only(context.form.output[0].names & set(context.z), context.z[:1], "the output")
    _ = context.first_gain(0)
    scale, every = constants(context, entries(ranges, "scale", n)), [*range(n)]
    if [context.value(text).number for text in scale] != [prod(s[:i], start=Fraction(1)) for i in every]:
        raise Unproved("its scale is not that of the slopes above the diagonal of A")
    slopes, boxes = bounded_slopes(context, ranges, scale, every, [True] * n, every, every, least=-1)
    shares, more = _shares(context, ranges, s)
    if "S" in claim.evidence:
        demand_decays(_inclusion(n, [*slopes, *_of_products(K, shares)]).at(level), alpha, claim.evidence)
    else:
        for corner in _corners(_inclusion(n, slopes).at(level), K, shares, level):
            demand_decays(corner, alpha, claim.evidence)
    return boxes + more


def _above(context: Context) -> list[Fraction]:
    numbers = []
    for i, row in enumerate(context.form.A):
        for j, text in enumerate(row):
            entry = context.value(text)
            if j != i + 1:
                if not context.algebra.is_zero(entry):
                    raise Unproved(f"A[{i + 1},{j + 1}] is not zero")
                continue
            if not entry.number:
                raise Unproved(f"A[{i + 1},{j + 1}] is no number, or zero")
            numbers.append(entry.number)
    return numbers


def _shares(context: Context, evidence: Mapping[str, Any], s: list[Fraction]) -> tuple[Shares, int]:
    """Return the range of each share s_k/F_k' that the evidence states and that is proved here, s_k = A_(k,k+1), F_k' =
    dF_k/dz_(k+1); and the number of boxes."""
    shares, boxes, one = Shares(), 0, context.algebra.number(Fraction(1))
    for k, (number, range_) in enumerate(zip(s, entries(evidence, "shares", len(s)), strict=True)):
        rate, z = context.rates[k], context.z[k + 1]

        def read(text: Expression, rate: Expression = rate) -> Expression:
            return context.at_kinks(text, rate)

        low, high, finding = enclosed(context, range_, one / context.slope(rate, z), rate, read)
        if low <= 0 <= high:
            raise Unproved("the bounds of a slope do not keep clear of zero")
        demand_continuous((rate,), (z,), context.form.box)
        shares.append((min(number * low, number * high), max(number * low, number * high)))
        boxes += finding.boxes
    return shares, boxes


def _inclusion(n: int, slopes: list[UncertainTerm]) -> ErrorInclusion:
    every, shift = [*range(n)], Matrix([unit_row(k + 1, n) for k in range(n)])
    return ErrorInclusion(shift, slopes, 0, Matrix([]), every, [True] * n, every, every, [], [])


def _injected(K: list[Fraction], q: tuple[Fraction, ...]) -> list[Fraction]:
    """Return the gains K_1, K_2 q_1, K_3 q_1 q_2, .."""
    return [k * prod(q[:i], start=Fraction(1)) for i, k in enumerate(K)]


def _of_products(K: list[Fraction], shares: Shares) -> Iterator[UncertainTerm]:
    """Yield for each i the uncertain term of the gain K_i q_1 .. q_(i-1), the q_k in their ranges `shares`."""
    every, n = [_injected(K, q) for q in product(*shares)], range(len(K))
    for i in n:
        ends = [each[i] for each in every]
        yield UncertainTerm(unit_row(0, len(K)), [Fraction(-int(k == i)) for k in n], min(ends), max(ends), -1)


def _corners(parts: ErrorMatrices, K: list[Fraction], shares: Shares, theta: Fraction) -> Iterator[ErrorMatrices]:
    ends = [sorted(set(pair)) for pair in shares]
    if 2 ** len(parts.H) * prod(map(len, ends)) > _CORNERS:
        raise Unproved(f"its slopes have more than {_CORNERS} combinations of ends")
    for corner in corners_of(parts):
        for q in product(*ends):
            whole = corner - theta * outer(_injected(K, q), unit_row(0, len(K)))
            yield replace(parts, M=whole, G=zeros(len(K), 0), H=zeros(0, len(K)), E=zeros(0, parts.B.width))


def convergence(context: Context, claim: Claim) -> Finding:
    """Prove that the error of a Kalman filter of z' = A z + b(u), y = C z + d(u) converges exponentially from any
    initial error, since (C, A) is observable and (A, Q) is controllable."""
    observer, form, n = observer_of(context, claim), context.form, len(context.z)
    A, C = matrix(claim.evidence, "A", n, n), matrix(claim.evidence, "C", len(form.output), n)
    _linear(context, A, C)
    Q, R = matrix(observer.numbers, "Q", n, n), column(observer.numbers, "R", len(form.output))
    theta = scalar(observer.numbers, "theta")
    if theta <= 0 or any(r <= 0 for r in R):
        raise Unproved("its theta or R is not positive")
    demand_positive({"sum of (A')^k C'C A^k": _gramian(A.T, C.T @ C)})
    if theta != 1:
        demand_positive({"Q": Q})
    demand_nonnegative({"Q": Q})
    demand_positive({"sum of A^k Q Q (A')^k": _gramian(A, Q @ Q)})
    known = "(C, A) is observable, (A, Q) is controllable"
    return Finding(f"in continuous time, without noise, the error converges exponentially from everywhere: {known}")


def _linear(context: Context, A: Matrix, C: Matrix) -> None:
    """Demand that the certificate's form is z' = A z + b(u), y = C z + d(u)."""
    _ = context.equations
    form, algebra = context.form, context.algebra
    for texts, row in zip(form.A, A, strict=True):
        for entry, number in zip(texts, row, strict=True):
            context.same(entry, algebra.number(number), "A is not that of the form")
    for nonlinear in form.b:
        demand_only(nonlinear.names & set(context.z), (), "b")
    letters = algebra.names
    still = {**letters, **dict.fromkeys(context.z, algebra.zero)}
    for output, row in zip(form.output, C, strict=True):
        finding = inner(algebra, [algebra.number(each) for each in row], [letters[name] for name in context.z])
        context.same(output, algebra.read(output, still) + finding, "C is not that of the form")


def _gramian(A: Matrix, start: Matrix) -> Matrix:
    """Return the sum over k < n of A^k M (A')^k, M = `start`."""
    total, term = start, start
    for _ in range(len(A) - 1):
        term = A @ term @ A.T
        total += term
    return total


_UNIFORM, _CHAINS = "uniform_injection", (*INJECTED, "switched_gain")
OBSERVERS = {
    _UNIFORM: ObserverKeys(("theta", "gains")),
    "riccati": ObserverKeys(("theta", "Q", "R")),
    "high_gain": ObserverKeys(("theta",), ("gains",), ("weights",)),
    "circle_criterion": ObserverKeys(("theta",), ("gains", "argument"), ("weights",)),
    "switched_gain": ObserverKeys(("theta", "theta_low", "hold"), ("gains",), ("weights",)),
    "filtered": ObserverKeys(("theta", "alpha", "beta", "gains")),
    "filtered_injection": ObserverKeys(("theta", "F", "G", "NH")),
    "low_power": ObserverKeys(("theta", "gains")),
    "peaking_free": ObserverKeys(("theta", "gains", "last")),
}
_INPUTS = (*ERROR, "noise", "beside")
_UNIFORM_DECAY = Decay(
    _uniform_falls, phrase=lambda _: "the error against the plant converges exponentially for every theta above {}"
)
RULES = (
    *(
        replace(rule, kinds=("uniform",), assumes=assumes)
        for rule, assumes in zip(
            decays((_UNIFORM,), _UNIFORM_DECAY, ("scale", "slopes", "shares"), NORM),
            (("uniform.structure", "uniform.slope_1"), (f"{_UNIFORM}.convergence",)),
            strict=True,
        )
    ),
    Rule(("riccati",), ("convergence",), convergence, ("A", "C"), about="the filter of a linear plant", turning=None),
    *decays(_CHAINS, Decay(_falls, _least, _phrase), ERROR, NORM, ("{maker}.region",)),
    chains_rule(INJECTED, ("region",), region, (*ERROR, *NORM, "level", "first"), turning=()),
    chains_rule(("switched_gain",), ("hold",), dwell, ("alpha", *NORM, "up", "down"), "switched_gain.theta"),
    clamped(_CHAINS),
    chains_rule(INJECTED, ("l2_gain",), l2_gain, (*_INPUTS, "counts", "mu", *NORM)),
    chains_rule(INJECTED, ("iss_gain",), iss_gain, (*_INPUTS, "bounds")),
)
