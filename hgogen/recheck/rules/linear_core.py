"""The convergence of an observer with a linear core of its own on a chain of integrators, verified again.

    filtered             w_i' = w_(i+1) + c_i + L_i eta_i,   eta_i' = -theta alpha eta_i + theta^2 beta eta_(i-1)
    filtered_injection   w' = A w + c + diag(theta, .., theta^n) NH eta,   eta' = theta F eta + theta G (y - w_1)
    low_power            p_i' = q_i + c_i + theta k_i1 e_i,   q_i' = q_(i+1) + c_(i+1) + theta^2 k_i2 e_i,   i < n
    peaking_free         the same with sat q_(i+1) in q_i', e_i = sat q_(i-1) - p_i, and p_n' = c_n + theta last e_n

with eta_0 = y - w_1, e_1 = y - p_1, e_i = q_(i-1) - p_i, q_n = 0; c takes the estimate clamped to the box, sat is to
the range of the state; `gains` are L, or the pairs k. In the errors t_k theta^-p(k) (x_k - w_i(k)), t_k = s_i(k), the
core is theta N, N its matrix at theta = 1; a sat on the way of an error is a factor in [0, 1], so that N is in the hull
of those with 0 and with 1. G feeds c_i(k) into the fields that estimate. The error decays exponentially for every

    theta > max(1, 2 push L),   N'P + P N <= -I,   P > 0,   push >= |P G|,   L >= |S dc/dw S^-1| on the box

since V = e'P e has V' <= -(theta - 2 push L) |e|^2. Sources of the observers: Astolfi, Jungers, Zaccarian, ECC (2018);
Astolfi, Marconi, IEEE TAC 60 (2015); Astolfi, Marconi, Praly, Teel, Automatica 98 (2018).
"""

from fractions import Fraction

from ..chain import built, integrators, slope
from ..context import Context, Shown, on, short
from ..cores import CORES, Core
from ..file import Built, Claim, Observer
from ..matrix import (
    Matrix,
    above_zero,
    decaying,
    demand_positive,
    matrix,
    minus,
    scalar,
    scaled,
    similar,
    times,
    transposed,
    unit,
)
from ..rule import STEEP
from ..structure import clamped, on_chains
from ..threshold import above


def convergence(context: Context, claim: Claim) -> Shown:
    """Every theta above the bound converges; the structure of the form is another claim."""
    observer, evidence = built(context, claim), claim.evidence
    scale = integrators(context, evidence)
    core = CORES[observer.name](observer.numbers, len(context.z))
    t, size = [scale.units[i] for i in core.index], len(core.index)
    P = matrix(evidence, "P", size, size)
    demand_positive({"P": P})
    for N in core.vertices:
        demand_positive({"-I - N'P - P N": decaying(similar(t, N), P)})
    _pushed(P, core, above_zero(evidence, "push"), len(context.z))
    _, boxes = slope(context, evidence, scale.expressions)
    above = f"the error converges exponentially for every theta above {short(threshold(observer, claim), 1)}"
    return Shown(f"in continuous time, without noise, {above}{on(context.form.box)}", scale.boxes + boxes)


def threshold(observer: Observer, claim: Claim) -> Fraction:
    """max(1, 2 push L) of a claim of convergence."""
    return max(Fraction(1), 2 * scalar(claim.evidence, "push") * scalar(claim.evidence, "bound"))


def _pushed(P: Matrix, core: Core, push: Fraction, n: int) -> None:
    """push^2 I - G'P P G > 0, G (size, n) of zeros and ones."""
    G = [[Fraction(int(fed and i == at)) for i in range(n)] for at, fed in zip(core.index, core.fed, strict=True)]
    PG = times(P, G)
    demand_positive({"push^2 I - G'P P G": minus(scaled(push**2, unit(n)), times(transposed(PG), PG))})


OBSERVERS = {
    "filtered": Built(("theta", "alpha", "beta", "gains")),
    "filtered_injection": Built(("theta", "F", "G", "NH")),
    "low_power": Built(("theta", "gains")),
    "peaking_free": Built(("theta", "gains", "last")),
}
RULES = tuple(
    rule
    for name in OBSERVERS
    for rule in (
        *on_chains(name, "convergence", convergence, (*STEEP, "units", "scale", "P", "push")),
        *on_chains(name, "theta", above(threshold), rests=(f"{name}.convergence",)),
        clamped(name),
    )
)
