"""How far inputs drive the error of a constant injection in continuous time, verified again.

    e' = (M + G diag(d) H) e + B v,   |d_j| <= 1,   as `uncertain` builds it at the observer's theta

By `inequality` |e|_P <= 1 stays so while each |v_k| <= 1; with |C e|^2 in the place of alpha |e|_P^2, and lambda_k <=
mu^2, the L2 norm of C e is at most mu times that of v. Inputs are noise of samples, of sizes by output, and
what comes to the rows of the form beside b.
"""

from fractions import Fraction

from ..box import NotShown
from ..chain import built
from ..context import Context, Shown, short
from ..cores import INJECTED
from ..file import Claim, part
from ..inequality import FLOW, NOW, Input, Parts, demand_kept, demand_negative, form_of, multipliers, within
from ..matrix import above_zero, column, entries, scalar, unit
from ..rule import on_chains
from ..uncertain import ERROR, ErrorInclusion, error_inclusion


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
        if not isinstance(one, dict) or set(one) != {"alpha", "P", "S", "bound"}:
            raise NotShown("a bound is no object of alpha, P, S and bound")
        bound = above_zero(one, "bound")
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


_INPUTS = (*ERROR, "noise", "beside")
RULES = (
    on_chains(INJECTED, ("l2_gain",), l2_gain, (*_INPUTS, "counts", "mu", "P", "S")),
    on_chains(INJECTED, ("iss_gain",), iss_gain, (*_INPUTS, "bounds")),
)
