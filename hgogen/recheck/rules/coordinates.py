"""A change of coordinates: it and its inverse are smooth and undo each other, the new states keep to their ranges."""

from collections.abc import Sequence

from ..box import Box, covered, ranged
from ..context import Context, Shown, narrowed
from ..file import Claim
from ..rule import Rule
from ..slope import regular
from ..text import Expression


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
    boxes = 0
    for name, row in zip(context.z, context.form.to_form, strict=True):
        box = narrowed(context.plant.box, row.names)
        boxes += covered(box, ".", ranged(row, *context.form.box[name]))
    return Shown("the form's states keep to their ranges while the plant's do", boxes)


_ABOUT = "the form's coordinates"
RULES = (
    Rule(("recast",), ("inverse",), _inverse, about=_ABOUT),
    Rule(("recast",), ("range",), _range, about=_ABOUT),
)
