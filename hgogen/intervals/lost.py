"""What an expression reads that an equal one no longer has: x/x is 1, which has a value where x/x has none.

A Piecewise does not read a branch that is not taken, nor a Heaviside its value at 0 elsewhere: what stands in these
asks for nothing by itself, and each of them is one part.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping

import sympy as sp

from hgogen.algebra.points import exact
from hgogen.algebra.tape import NoTape, tape
from hgogen.intervals.box import Box, sides
from hgogen.intervals.search import everywhere, search
from hgogen.intervals.singular import Condition, minimal, singular

_BOXES = 60
STRANGE = (sp.nan, sp.zoo, sp.oo, -sp.oo, sp.I)
_CHOOSING = (sp.Piecewise, sp.Heaviside)
_ENDLESS = (sp.log, sp.tan, sp.atanh)  # no value where their condition fails; asin(1) and atan2(1, 0) have one


def lost(before: Iterable[sp.Expr], after: Iterable[sp.Expr], box: Box) -> sp.Expr | None:
    """A part of `before` that is not proved to be a finite real number on the box, and that `after` does not have.

    A part stays in `after` where it is read there, or something is that has no value in the same places, as 1/x**2 for
    1/x. What a point of the box takes out, as k = 0 the log(x) of k log(x), does not stay.
    """
    every = tuple(dict.fromkeys(part for row in before for part in parts(row)))
    rows = tuple(sides(exact(row), box)[0] for row in after)
    stays = {part for row in rows for part in parts(row)}
    needs = singular((*every, *rows), box)
    poles = {needs[part] for part in stays if part in needs and _endless(part)}

    def shares(part: sp.Expr) -> bool:
        return part in stays or singular((part,), box).get(part) in poles

    read = (part for part in every if _asks(part, needs))
    return next((part for part in read if not (shares(sides(exact(part), box)[0]) or is_defined(part, box))), None)


def doubtful(expressions: Iterable[sp.Expr], box: Box) -> tuple[sp.Expr, ...]:
    """The parts that are not proved to be finite real numbers on the box."""
    every = tuple(dict.fromkeys(part for e in expressions for part in parts(e)))
    needs = singular(every, box)
    return tuple(part for part in every if _asks(part, needs) and not is_defined(part, box))


def conditions(expressions: Iterable[sp.Expr], box: Box) -> tuple[Condition, ...]:
    """What must hold for the doubtful parts to have values: of 1/u that u != 0, of one that chooses that it has one."""
    asked = set[Condition]()
    for part in doubtful(expressions, box):
        needs = () if isinstance(part, _CHOOSING) else singular((part,), box).values()
        asked.update(needs or (Condition("{of} has a value", part),))
    return minimal(asked)


def parts(e: sp.Expr) -> Iterator[sp.Expr]:
    """The powers and functions whose values the expression reads, outermost first."""
    walk = sp.preorder_traversal(e)
    for node in walk:
        if isinstance(node, (sp.Pow, sp.Function)):
            yield node
        if isinstance(node, _CHOOSING):
            walk.skip()


def put_apart(expressions: Iterable[sp.Expr], put: Callable[[sp.Expr], sp.Expr]) -> Iterator[sp.Expr]:
    """Each part with `put` by itself, where the whole might lose it: (a - b)/(2 a - 2 b) with a = b + w is 1/2 at
    once. Of a Piecewise as well what it loses."""
    for part in dict.fromkeys(part for e in expressions for part in parts(e)):
        whole = put(part)
        yield whole
        if isinstance(part, _CHOOSING):
            within = (put(node) for node in part.atoms(sp.Pow, sp.Function) - {part})
            yield from (node for node in within if not whole.has(node))


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


def _asks(part: sp.Expr, needs: Mapping[sp.Expr, Condition]) -> bool:
    """Whether the part may ask for something, or choose what has no value, or nothing."""
    if not isinstance(part, _CHOOSING):
        return part in needs
    ends = not isinstance(part, sp.Piecewise) or part.args[-1].cond == sp.true
    return part in needs or not ends or any(node in needs for node in part.atoms(sp.Pow, sp.Function))


def _endless(part: sp.Expr) -> bool:
    power = isinstance(part, sp.Pow) and part.exp.is_Rational and part.exp.is_negative
    return bool(power) or isinstance(part, _ENDLESS)
