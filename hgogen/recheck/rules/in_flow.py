"""How far inputs drive the error of a constant injection in continuous time, verified again.

    e' = (M + G diag(d) H) e + B v,   |d_j| <= 1,   as `uncertain` builds it at the observer's theta
    [M'P + P M + alpha P + H'S H + C'C, P G, P B; G'P, -S, 0; B'P, 0, -diag(lambda)] < 0,   P > 0, S, lambda >= 0

alpha = 0 and lambda_k <= mu^2 show that the L2 norm of C e is at most mu times that of v; without C, and with
sum lambda_k <= alpha, |e|_P <= 1 stays so while each |v_k| <= 1. Inputs are noise of samples, of sizes by output, and
what comes to the rows of the form beside b.
"""

from fractions import Fraction

from ..box import NotShown
from ..chain import built
from ..context import Context, Shown, short
from ..cores import CONSTANT, OF_A_GAIN
from ..falling import demand_negative, driven
from ..file import Claim, part
from ..matrix import Matrix, above_zero, column, entries, matrix, scalar, transposed
from ..rule import on_chains
from ..stages import Parts, within
from ..uncertain import ErrorInclusion, error_inclusion


def l2_gain(context: Context, claim: Claim) -> Shown:
    """The L2 gain from the claim's inputs to the errors of the states, weighed by what they count for."""
    error, parts, scales, inputs, said = _of(context, claim)
    evidence, n, mu = claim.evidence, len(context.z), above_zero(claim.evidence, "mu")
    form, lambdas = driven(parts, *inputs, evidence)
    if max(lambdas) > mu**2:
        raise NotShown("a lambda is above mu^2")
    for count, field in zip(column(evidence, "counts", n), error.picks, strict=True):
        form[field][field] += (count / scales[field]) ** 2
    demand_negative("its inequality", form)
    counts = ", ".join(f"{short(x)} {z}" for x, z in zip(column(evidence, "counts", n), context.z, strict=True))
    return Shown(
        f"in continuous time, {said}, the L2 gain to the error of {counts} is at most {short(mu, 1)}", error.boxes
    )


def iss_gain(context: Context, claim: Claim) -> Shown:
    """The bound to which the error of each state comes."""
    error, parts, scales, inputs, said = _of(context, claim)
    bounds = list[str]()
    each = entries(claim.evidence, "bounds", len(context.z))
    for z, field, one in zip(context.z, error.picks, each, strict=True):
        if not isinstance(one, dict) or set(one) != {"alpha", "P", "S", "bound"}:
            raise NotShown("a bound is no object of alpha, P, S and bound")
        alpha, bound = above_zero(one, "alpha"), above_zero(one, "bound")
        form, lambdas = driven(parts, *inputs, one)
        if sum(lambdas) > alpha:
            raise NotShown("its lambda exceed alpha")
        for i, row in enumerate(matrix(one, "P", len(scales), len(scales))):
            for j, value in enumerate(row):
                form[i][j] += alpha * value
        demand_negative("its inequality", form)
        within(one, field, scales, bound)
        bounds.append(f"{z} comes to at most {short(bound, 1)}")
    return Shown(f"in continuous time, {said}, the error of {', '.join(bounds)}", error.boxes)


def _of(context: Context, claim: Claim) -> tuple[ErrorInclusion, Parts, list[Fraction], tuple[Matrix, Matrix], str]:
    """The error at the observer's theta, its scales, the columns by which inputs enter the rates (N, q) and what
    slopes read (m, q), and words for these.

    Raises: `NotShown`.
    """
    observer, evidence = built(context, claim), claim.evidence
    theta, error = scalar(observer.numbers, "theta"), error_inclusion(context, observer, evidence)
    if not theta > 0 or not error.measured:
        raise NotShown("its theta is not positive, or its gains are no numbers in these coordinates")
    scales, said, parts = error.scales(context, theta), list[str](), error.at(theta)
    columns, read = list[list[Fraction]](), list[list[Fraction]]()
    for j, size in enumerate(column(evidence, "noise", len(context.form.output))):
        if size:
            context.demand_seen(j)
            columns.append([(x[j] + y[j]) * size for x, y in zip(parts.B, parts.R, strict=True)])
            read.append([x[j] * size for x in parts.E])
            said.append(f"under noise of {short(size)} in output {j + 1}")
    for beside in part(evidence, "beside", list):
        rows = column({"beside": beside}, "beside", len(context.z))
        fields = zip(scales, error.index, error.fed, strict=True)
        columns.append([-scale * rows[i] * fed for scale, i, fed in fields])
        read.append([Fraction(0)] * len(parts.E))
        said.append(f"under ({', '.join(short(x) for x in rows)}) beside b")
    if not columns:
        raise NotShown("nothing enters")
    return error, parts, scales, (transposed(columns), transposed(read)), ", ".join(said)


_INPUTS = ("scale", "slopes", "core", "ranges", "units", "noise", "beside")
RULES = (
    on_chains((*OF_A_GAIN, *CONSTANT), ("l2_gain",), l2_gain, (*_INPUTS, "counts", "mu", "P", "S")),
    on_chains((*OF_A_GAIN, *CONSTANT), ("iss_gain",), iss_gain, (*_INPUTS, "bounds")),
)
