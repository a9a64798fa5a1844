"""A form in chains: its structure, 0 < a_m <= a_i <= a_M, and known offsets.

    z' = A(u) z + b(z, u),   y_i = a_1 z_1 + c of its chain

Source: N. Boizot, E. Busvelle, J.-P. Gauthier, Automatica 46 (2010), form (3).
"""

from ..box import NotShown, witnessed
from ..chain import place_of, wanted_gain
from ..context import RANGE, Context, Shown, enclosed, only, witness
from ..file import Claim, FormFile, part
from ..rule import POINT, Needed, Rule
from ..structure import structure
from ..text import expression


def _gain(context: Context, claim: Claim) -> Shown:
    """0 < a_m <= a_i <= a_M on the box."""
    wanted, source = wanted_gain(context, claim.at)
    low, _, shown = enclosed(context, claim.evidence, wanted, source)
    if low <= 0:
        raise NotShown("its lower bound is not above zero")
    return Shown(f"{claim.what}: {shown.sentence}", shown.boxes)


def _no_gain(context: Context, claim: Claim) -> Shown:
    """At a point of the box a_i is zero or negative."""
    wanted, source = wanted_gain(context, claim.at)
    text = expression(part(claim.evidence, "expression", str), context.form.box)
    context.same(text, wanted, f"its expression {text.text} is not what the form has")
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
    rest = context.value(context.form.output[chain - 1]) - context.first_gain(chain - 1) * context.letters[head]
    text = expression(part(claim.evidence, "expression", str), context.form.box)
    only(text.names & set(context.z), (), "the offset")
    return enclosed(context, claim.evidence, rest, text)[2]


def _rows(form: FormFile) -> tuple[str, ...]:
    rows = [f"a_{i}" for i in range(1, len(form.states) + 1)]
    return (*(f"triangular.{row}" for row in rows), "triangular.lipschitz")


def _rows_of_chains(form: FormFile) -> tuple[str, ...]:
    rows = [f"a_{k}_{i}" for k, size in enumerate(form.blocks, 1) for i in range(1, size + 1)]
    return (*(f"block_triangular.{row}" for row in rows), "block_triangular.lipschitz")


_KINDS = ("triangular", "block_triangular")
_OF_A, _OF_OFFSET = {"triangular": 1, "block_triangular": 2}, {"block_triangular": 1}
NEEDED = {
    "triangular": Needed("triangular.structure", _rows),
    "block_triangular": Needed("block_triangular.structure", _rows_of_chains),
}
RULES = (
    Rule((), ("structure",), structure, kinds=_KINDS),
    Rule((), ("a",), _gain, RANGE, _KINDS, _OF_A),
    Rule((), ("a",), _no_gain, POINT, _KINDS, _OF_A, verdict="refuted"),
    Rule((), ("offset",), _offset, RANGE, _KINDS, _OF_OFFSET),
)
