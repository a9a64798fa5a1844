"""What a form is: its structure, its rows, how steep it is, and its coordinates, verified again.

    chains    z' = A(u) z + b(z, u),             y_i = a_1 z_1 + c of its chain,   0 < a_m <= a_i <= a_M
    affine    z' = A(s, u) z + b(s, u),          y = C(u) z + d(u),   s the states that outputs show alone
    uniform   z_i' = F_i(z_1, .., z_(i+1), u),   y = h(z_1, u),   dh/dz_1, dF_(i-1)/dz_i never 0

Source of the first: N. Boizot, E. Busvelle, J.-P. Gauthier, Automatica 46 (2010), form (3).
"""

from collections.abc import Callable, Mapping, Sequence

from ..algebra import Quotient
from ..box import Box, NotShown, covered, witnessed
from ..chain import jacobian_bound, place_of, ranges_kept, structure, wanted_gain
from ..context import RANGE, Context, Shown, claimed, enclosed, finite, narrowed, only, witness
from ..file import Claim, FormFile, part
from ..rule import POINT, STEEP, Needed, Rule
from ..slope import at_kinks, continuous, differentiable, regular
from ..tables import jumps
from ..text import Expression, expression

# --- chains


def _gain(context: Context, claim: Claim) -> Shown:
    """0 < a_m <= a_i <= a_M on the box."""
    low, _, shown = enclosed(context, claim.evidence, *wanted_gain(context, claim.at))
    if low <= 0:
        raise NotShown("its lower bound is not above zero")
    return Shown(f"{claim.what}: {shown.sentence}", shown.boxes)


def _no_gain(context: Context, claim: Claim) -> Shown:
    """At a point of the box a_i is zero or negative."""
    wanted, source = wanted_gain(context, claim.at)
    text = claimed(context, claim.evidence, wanted)
    at = witness(claim, context.form.box, text.names | source.names)
    what = witnessed(text, at)
    if what not in ("zero", "negative"):
        raise NotShown(f"{text.text} is not shown to be zero or negative at its witness")
    return Shown(f"{text.text} is {what} at {', '.join(f'{name} = {value}' for name, value in at.items())}")


def _offset(context: Context, claim: Claim) -> Shown:
    """c = y - a_1 z_1 is finite on the box."""
    _ = context.equations
    chain = claim.at[0] if claim.at else 1
    head = context.z[place_of(context, chain, 1)]
    rest = context.value(context.form.output[chain - 1]) - context.first_gain(chain - 1) * context.algebra.names[head]
    text = expression(part(claim.evidence, "expression", str), context.form.box)
    only(text.names & set(context.z), (), "the offset")
    return enclosed(context, claim.evidence, rest, text)[2]


def _rows(form: FormFile) -> tuple[str, ...]:
    rows = (f"triangular.a_{i}" for i in range(1, len(form.states) + 1))
    return (*rows, "triangular.lipschitz")


def _rows_of_chains(form: FormFile) -> tuple[str, ...]:
    rows = (f"block_triangular.a_{k}_{i}" for k, size in enumerate(form.blocks, 1) for i in range(1, size + 1))
    return (*rows, "block_triangular.lipschitz")


# --- affine in the states


def _affine(context: Context, claim: Claim) -> Shown:
    """y = d + sum c_k z_k with d = y(0), c_k = y(z_k = 1) - y(0) for every z, so that both are of no state; A, b read
    states that an output shows alone, with a number for c_k."""
    _ = context.equations
    z, measured, algebra = context.z, list[str](), context.algebra
    rest = {**algebra.names, **dict.fromkeys(z, algebra.zero)}
    for j, output in enumerate(context.form.output, 1):
        d = algebra.read(output, rest)
        slopes = {name: algebra.read(output, {**rest, name: algebra.one}) - d for name in z}
        line = sum((slopes[name] * algebra.names[name] for name in z), start=d)
        if not algebra.is_zero(context.value(output) - line):
            raise NotShown(f"output {j} is not affine in the states")
        seen = [name for name in z if not algebra.is_zero(slopes[name])]
        measured += seen if len(seen) == 1 and slopes[seen[0]].number is not None else []
    for i, (entries, rest_) in enumerate(zip(context.form.A, context.form.b, strict=True), 1):
        for row in (*entries, rest_):
            only(row.names & set(z), measured, f"row {i} of A or b")
    ranges_kept(context)
    return Shown(f"A and b read {', '.join(measured) or 'no state'}, and the form's equations are the plant's")


# --- uniform


def _uniform(context: Context, claim: Claim) -> Shown:
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


def _no_slope(context: Context, claim: Claim) -> Shown:
    """A slope is zero at a point of the box that is at no kink; or it has opposite signs at two, and what it is of is
    continuous."""
    wanted, rate = _wanted_slope(context, *claim.at)
    text = claimed(context, claim.evidence, wanted)
    read = at_kinks(text, rate, context)
    keys = [key for key in ("witness", "other") if key in claim.evidence]
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


def _wanted_slope(context: Context, index: int) -> tuple[Quotient, Expression]:
    _ = context.equations
    if not 1 <= index <= len(context.z):
        raise NotShown("the form has no such row")
    rate = context.form.output[0] if index == 1 else context.rates[index - 2]
    return context.slope(rate, context.z[index - 1]), rate


def _slopes(form: FormFile) -> tuple[str, ...]:
    return (*(f"uniform.slope_{i}" for i in range(1, len(form.states) + 1)), "uniform.lipschitz")


# --- how steep


def _lipschitz(context: Context, claim: Claim) -> Shown:
    """|d rows/dz| <= bound, of the rows that the kind of the form has in `_STEEP`."""
    name, rows = _STEEP[context.form.kind]
    return jacobian_bound(context, claim, rows(context), name)


def _every(context: Context) -> Sequence[Expression]:
    return (*context.rates, *context.form.output)


_STEEP: Mapping[str, tuple[str, Callable[[Context], Sequence[Expression]]]] = {
    **dict.fromkeys(("triangular", "block_triangular"), ("db/dz", lambda context: context.nonlinear)),
    "state_affine": ("d(A z + b)/dz", lambda context: context.rates),
    **dict.fromkeys(("uniform", "original"), ("d(F, h)/dz", _every)),
}

# --- coordinates


def _inverse(context: Context, claim: Claim) -> Shown:
    """z = Z(x) and x = X(z) undo each other and have finite derivatives on their boxes."""
    _ = context.equations
    form, plant = context.form, context.plant
    boxes = _regular(form.to_form, plant.states, plant.box) + _regular(form.from_form, form.states, form.box)
    return Shown("the change of coordinates and its inverse are smooth and undo each other", boxes)


def _regular(rows: Sequence[Expression], names: Sequence[str], box: Box) -> int:
    read = {name for row in rows for name in row.names}
    return covered(narrowed(box, read), ".", regular(rows, [name for name in names if name in read]))


def _range(context: Context, claim: Claim) -> Shown:
    """Each z_i keeps to its range while the plant's states do."""
    return Shown("the form's states keep to their ranges while the plant's do", ranges_kept(context, every=True))


_CHAINS, _UNIFORM = ("triangular", "block_triangular"), ("uniform",)
_OF_A, _OF_OFFSET, _OF_SLOPE = {"triangular": 1, "block_triangular": 2}, {"block_triangular": 1}, {"uniform": 1}
_COORDINATES = "the form's coordinates"
NEEDED = {
    "triangular": Needed("triangular.structure", _rows),
    "block_triangular": Needed("block_triangular.structure", _rows_of_chains),
    "state_affine": Needed("state_affine.structure", lambda form: ("state_affine.lipschitz",)),
    "uniform": Needed("uniform.structure", _slopes),
}
RULES = (
    Rule((), ("structure",), structure, kinds=_CHAINS),
    Rule((), ("a",), _gain, RANGE, _CHAINS, _OF_A),
    Rule((), ("a",), _no_gain, POINT, _CHAINS, _OF_A, verdict="refuted"),
    Rule((), ("offset",), _offset, RANGE, _CHAINS, _OF_OFFSET),
    Rule((), ("structure",), _affine, kinds=("state_affine",)),
    Rule((), ("structure",), _uniform, kinds=_UNIFORM),
    Rule((), ("slope",), _slope, RANGE, _UNIFORM, _OF_SLOPE),
    Rule((), ("slope",), _no_slope, (*POINT, "other"), _UNIFORM, _OF_SLOPE, verdict="refuted"),
    Rule((), ("lipschitz",), _lipschitz, STEEP, (*_STEEP,)),
    Rule(("recast",), ("inverse",), _inverse, about=_COORDINATES),
    Rule(("recast",), ("range",), _range, about=_COORDINATES),
)
