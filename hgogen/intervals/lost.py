"""What an expression reads that an equal one no longer has: x/x is 1, which has a value where x/x has none."""

from collections.abc import Iterable

import sympy as sp

from hgogen.algebra.points import exact
from hgogen.algebra.tape import NoTape, tape
from hgogen.intervals.box import Box, sides
from hgogen.intervals.search import everywhere, search
from hgogen.intervals.singular import singular

_BOXES = 60
STRANGE = (sp.nan, sp.zoo, sp.oo, -sp.oo, sp.I)


def lost(before: Iterable[sp.Expr], after: Iterable[sp.Expr], box: Box) -> sp.Expr | None:
    """A part of `before` that is not proved to be a finite real number on the box, and that `after` does not have.

    A part stays in `after` where something there asks for the same, as 1/x does for x/x.
    """
    conditions = set(singular(after, box).values())
    parts = singular(before, box).items()
    return next((part for part, needs in parts if needs not in conditions and not is_defined(part, box)), None)


def is_defined(e: sp.Expr, box: Box) -> bool:
    """Whether it is proved that e is a finite real number on the whole box."""
    fixed, around = sides(exact(e), box)
    if fixed.has(*STRANGE):
        return False
    try:
        program = tape([fixed], around.symbols)
    except NoTape:
        return False
    return search(program, around.outer, around.inner, everywhere, _BOXES).defined
