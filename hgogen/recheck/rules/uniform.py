"""The uniform form: each row brings in one state, with a slope that keeps clear of zero, and the slope of it all.

    z_i' = F_i(z_1, .., z_(i+1), u),   y = h(z_1, u),   dh/dz_1, dF_(i-1)/dz_i never 0

and of the plant's own coordinates the slope alone.
"""

from ..algebra import Quotient
from ..box import NotShown, witnessed
from ..context import RANGE, Context, Shown, enclosed, finite, only, witness
from ..file import Claim, FormFile, part
from ..rule import POINT, Needed, Rule
from ..slope import at_kinks, continuous, differentiable
from ..structure import ranges_kept
from ..tables import jumps
from ..text import Expression, expression


def _structure(context: Context, claim: Claim) -> Shown:
    """F_i reads z_1..z_(i+1), y reads z_1."""
    _ = context.equations
    z = context.z
    for i, row in enumerate(context.rates):
        only(row.names & set(z), z[: i + 2], f"F_{i + 1}")
    if len(context.form.output) != 1:
        raise NotShown("the uniform form has one output")
    only(context.form.output[0].names & set(z), z[:1], "the output")
    ranges_kept(context)
    return Shown(f"{' -> '.join(('y', *z))}, and the form's equations are the plant's")


def _slope(context: Context, claim: Claim) -> Shown:
    """dh/dz_1, or dF_(i-1)/dz_i, is bounded and bounded away from zero on the box."""
    wanted, rate = _wanted_slope(context, *claim.at)
    low, high, shown = enclosed(context, claim.evidence, wanted, rate, lambda text: at_kinks(text, rate, context))
    if low <= 0 <= high:
        raise NotShown("its bounds do not keep clear of zero")
    continuous((rate,), (context.z[claim.at[0] - 1],), context.form.box)
    return Shown(f"{claim.what}: {shown.sentence}", shown.boxes)


def _wanted_slope(context: Context, index: int) -> tuple[Quotient, Expression]:
    _ = context.equations
    if not 1 <= index <= len(context.z):
        raise NotShown("the form has no such row")
    rate = context.form.output[0] if index == 1 else context.rates[index - 2]
    return context.slope(rate, context.z[index - 1]), rate


def _no_slope(context: Context, claim: Claim) -> Shown:
    """A slope is zero at a point of the box that is at no kink; or it has opposite signs at two, and what it is of is
    continuous."""
    wanted, rate = _wanted_slope(context, *claim.at)
    text = expression(part(claim.evidence, "expression", str), context.form.box)
    context.same(text, wanted, f"its expression {text.text} is not what the form has")
    keys = [key for key in ("witness", "other") if key in claim.evidence]
    read = at_kinks(text, rate, context)
    signs = [witnessed(read, witness(claim, context.form.box, text.names, key)) for key in keys]
    if signs == ["zero"]:
        differentiable((rate, text), witness(claim, context.form.box, text.names | rate.names))
        return Shown(f"{text.text} is zero at its witness")
    if sorted(signs) != ["negative", "positive"]:
        raise NotShown(f"{text.text} is not shown to be zero, or to change its sign")
    if any(step.op == "sign" or jumps(step.op) for step in rate.instructions):
        raise NotShown(f"{rate.text} is not shown to be continuous")
    boxes = finite(text, context.form.box) + finite(rate, context.form.box)
    return Shown(f"{text.text} changes its sign", boxes)


def _rows(form: FormFile) -> tuple[str, ...]:
    return (*(f"uniform.slope_{i}" for i in range(1, len(form.states) + 1)), "uniform.lipschitz")


_UNIFORM, _OF_SLOPE = ("uniform",), {"uniform": 1}
NEEDED = {"uniform": Needed("uniform.structure", _rows)}
RULES = (
    Rule((), ("structure",), _structure, kinds=_UNIFORM),
    Rule((), ("slope",), _slope, RANGE, _UNIFORM, _OF_SLOPE),
    Rule((), ("slope",), _no_slope, (*POINT, "other"), _UNIFORM, _OF_SLOPE, verdict="refuted"),
)
