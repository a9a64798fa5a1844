"""The convergence of an observer of a constant injection in continuous time, verified again.

    high_gain            z' = A z + b(sat z, u) + diag(theta, .., theta^n) K (y - C z), on a chain for each output
    circle_criterion     the same with b(sat(z + N_theta (y - C z)), u), N_theta of the entries `argument`
    switched_gain        the same with one of two theta, held for a time
    filtered             w_i' = w_(i+1) + c_i + L_i eta_i,   eta_i' = -theta alpha eta_i + theta^2 beta eta_(i-1)
    filtered_injection   w' = A w + c + diag(theta, .., theta^n) NH eta,   eta' = theta F eta + theta G (y - w_1)
    low_power            p_i' = q_i + c_i + theta k_i1 e_i,   q_i' = q_(i+1) + c_(i+1) + theta^2 k_i2 e_i,   i < n
    peaking_free         the same with sat q_(i+1) in q_i', e_i = sat q_(i-1) - p_i, and p_n' = c_n + theta last e_n

with eta_0 = y - w_1, e_1 = y - p_1, e_i = q_(i-1) - p_i, q_n = 0; b and c take the estimate clamped to the box, sat is
to the range of the state; `gains` are K, L, or the pairs k. K acts chain by chain, or is a matrix, whose entry for the
state i and the output of chain k stands times theta^(p(i) - p(k) + 1), p the powers that scale states. The errors e of
fields, in units and over powers of theta, obey e' = M e with slopes in ranges (`uncertain`); P > 0 with M'P + P M +
alpha P < 0 for all of them shows V' <= -alpha V, V = e'P e. What holds at the `least` theta holds at every larger one:
M/theta is N and slopes over theta^(degree + 1), those of a degree above -1 have 0 in their ranges, which shrink, and
the others stay.

A switch between gains multiplies e by D = diag((low/theta)^p), so that V becomes at most `up` times what it was, or
`down` times: up P_low - D P_high D >= 0, down P_high - D^-1 P_low D^-1 >= 0. Held for a time T with alpha T > log(up
down) in the high gain, V falls from cycle to cycle.

How far inputs drive the error: e' = M e + B v at the observer's theta. By `inequality` |e|_P <= 1 stays so while each
|v_k| <= 1; with |C e|^2 in the place of alpha |e|_P^2, and lambda_k <= mu^2, the L2 norm of C e is at most mu times
that of v. Inputs are noise of samples, of sizes by output, and what comes to the rows of the form beside b.

Sources of the observers: Gauthier, Hammouri, Othman, IEEE TAC 37 (1992); Ahrens, Khalil, Automatica 45 (2009); Astolfi,
Jungers, Zaccarian, ECC (2018); Astolfi, Marconi, IEEE TAC 60 (2015); Astolfi, Marconi, Praly, Teel, Automatica 98
(2018).
"""

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from ..box import NotShown
from ..chain import built
from ..context import Context, Shown, short
from ..falling import Decay, clamped, decays, demand_decays
from ..file import Built, Claim, Observer, above_zero, column, entries, fields, matrix, part, scalar
from ..inequality import FLOW, NOW, Input, Parts, demand_kept, demand_negative, form_of, multipliers, within
from ..interval import intervals, point
from ..matrix import demand_nonnegative, minus, scaled, unit
from ..rule import on_chains
from ..uncertain import ERROR, INJECTED, ErrorInclusion, error_inclusion, with_endless


def _least(observer: Observer) -> tuple[str, Fraction]:
    """The name and the value of the least theta, which of two is not above the other. Raises: `NotShown`."""
    name = "theta_low" if "theta_low" in observer.numbers else "theta"
    least = scalar(observer.numbers, name)
    if least > scalar(observer.numbers, "theta"):
        raise NotShown("theta_low is above theta")
    return name, least


def _said(observer: Observer) -> str:
    if "hold" in observer.numbers:
        return "the error decays exponentially between switches, in every gain above {}"
    return "the error converges exponentially for every theta above {}"


def held(context: Context, claim: Claim) -> Shown:
    """The time hold is long enough; that the low gain's norm falls is another claim."""
    numbers, evidence = built(context, claim).numbers, claim.evidence
    theta, low, hold = (above_zero(numbers, name) for name in ("theta", "theta_low", "hold"))
    up, down = above_zero(evidence, "up"), above_zero(evidence, "down")
    alpha, bound = scalar(evidence, "alpha"), context.file.claim(f"{claim.maker}.convergence")
    if alpha < 0 or bound is None:
        raise NotShown("its alpha is negative, or there is no bound on theta")
    error = error_inclusion(context, built(context, claim), bound.evidence)
    demand_decays(error.at(theta), alpha, evidence)
    size, other = len(error.N), context.file.claim(f"{claim.maker}.theta")
    if other is None or not other.evidence:
        raise NotShown("there is no norm of the low gain")
    high, slow = matrix(evidence, "P", size, size), matrix(other.evidence, "P", size, size)
    D = [(low / theta) ** p for p in error.power]
    entering = [[x * D[i] * D[j] for j, x in enumerate(row)] for i, row in enumerate(high)]
    leaving = [[x / D[i] / D[j] for j, x in enumerate(row)] for i, row in enumerate(slow)]
    demand_nonnegative({"up P_low - D P_high D": minus(scaled(up, slow), entering)})
    demand_nonnegative({"down P_high - D^-1 P_low D^-1": minus(scaled(down, high), leaving)})
    lost = intervals.function("log", (point(up * down),))
    if (point(alpha * hold) - lost).sign <= 0:
        raise NotShown(f"hold = {short(hold)} is not shown to be long enough")
    return Shown(f"in continuous time, hold = {short(hold)} is long enough: switching keeps the error's decay")


def _falls(context: Context, claim: Claim, slopes: Mapping[str, Any], level: Fraction, alpha: Fraction) -> int:
    """V' <= -alpha V at a theta, by the claim's V, whatever the slopes; with how many boxes these are shown."""
    error = with_endless(context, built(context, claim), slopes)
    demand_decays(error.at(level), alpha, claim.evidence)
    return error.boxes


# --- inputs


def l2_gain(context: Context, claim: Claim) -> Shown:
    """The L2 gain from the claim's inputs to the errors of the states, weighed by what they count for."""
    error, parts, scales, inputs, said = _of(context, claim)
    evidence, n, mu = claim.evidence, len(context.z), above_zero(claim.evidence, "mu")
    if max(multipliers(evidence, inputs)) > mu**2:
        raise NotShown("a lambda is above mu^2")
    form, counts = form_of(parts, FLOW, NOW, evidence, inputs), column(evidence, "counts", n)
    for count, field in zip(counts, error.picks, strict=True):
        form[field][field] += (count / scales[field]) ** 2
    demand_negative("its inequality", form)
    of = ", ".join(f"{short(x)} {z}" for x, z in zip(counts, context.z, strict=True))
    return Shown(f"in continuous time, {said}, the L2 gain to the error of {of} is at most {short(mu, 1)}", error.boxes)


def iss_gain(context: Context, claim: Claim) -> Shown:
    """The bound to which the error of each state comes."""
    error, parts, scales, inputs, said = _of(context, claim)
    bounds = list[str]()
    each = entries(claim.evidence, "bounds", len(context.z))
    for z, field, one in zip(context.z, error.picks, each, strict=True):
        bound = above_zero(fields(one, "a bound", ("alpha", "P", "S", "bound")), "bound")
        demand_kept(parts, FLOW, NOW, one, inputs)
        within(one, field, scales, bound)
        bounds.append(f"{z} comes to at most {short(bound, 1)}")
    return Shown(f"in continuous time, {said}, the error of {', '.join(bounds)}", error.boxes)


def _of(context: Context, claim: Claim) -> tuple[ErrorInclusion, Parts, list[Fraction], list[Input], str]:
    """The error at the observer's theta, its scales, the inputs, and words for these. Raises: `NotShown`."""
    observer, evidence = built(context, claim), claim.evidence
    theta, error = scalar(observer.numbers, "theta"), error_inclusion(context, observer, evidence)
    if not theta > 0 or not error.measured:
        raise NotShown("its theta is not positive, or its gains are no numbers in these coordinates")
    scales, said, p = error.scales(context, theta), list[str](), len(context.form.output)
    inputs, nothing = list[Input](), [Fraction(0)] * p
    for j, size in enumerate(column(evidence, "noise", p)):
        if size:
            context.demand_seen(j)
            inputs.append(Input([unit(p)[j]], [Fraction(0)] * len(scales)) * size)
            said.append(f"under noise of {short(size)} in output {j + 1}")
    for beside in part(evidence, "beside", list):
        rows = column({"beside": beside}, "beside", len(context.z))
        fields = zip(scales, error.index, error.fed, strict=True)
        inputs.append(Input([nothing], [-scale * rows[i] * fed for scale, i, fed in fields]))
        said.append(f"under ({', '.join(short(x) for x in rows)}) beside b")
    if not inputs:
        raise NotShown("nothing enters")
    return error, error.at(theta), scales, inputs, ", ".join(said)


OBSERVERS = {
    "high_gain": Built(("theta",), ("gains",), ("weights",)),
    "circle_criterion": Built(("theta",), ("gains", "argument"), ("weights",)),
    "switched_gain": Built(("theta", "theta_low", "hold"), ("gains",), ("weights",)),
    "filtered": Built(("theta", "alpha", "beta", "gains")),
    "filtered_injection": Built(("theta", "F", "G", "NH")),
    "low_power": Built(("theta", "gains")),
    "peaking_free": Built(("theta", "gains", "last")),
}
_NORM = ("P", "S")
_INPUTS = (*ERROR, "noise", "beside")
RULES = (
    *decays((*OBSERVERS,), Decay(_falls, _least, _said), ERROR, _NORM),
    on_chains(("switched_gain",), ("hold",), held, ("alpha", *_NORM, "up", "down"), "switched_gain.theta"),
    clamped((*OBSERVERS,)),
    on_chains(INJECTED, ("l2_gain",), l2_gain, (*_INPUTS, "counts", "mu", "P", "S")),
    on_chains(INJECTED, ("iss_gain",), iss_gain, (*_INPUTS, "bounds")),
)
