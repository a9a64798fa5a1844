"""The same function on a box, without the kinks and jumps whose side the box decides: |x| is x where x >= 0.

What is proved of a side is proved in exact or outward-rounded arithmetic, on the closed box. What is left out is a
finite real number there: max(sqrt(x - 1), 5) stays where x may be below 1, for it has no value there, and |x|/x, which
would be 1, where x may be 0.
"""

import math
from collections.abc import Iterable
from functools import lru_cache

import sympy as sp

from hgogen.check import Verdict
from hgogen.rigor.bounds import nonzero
from hgogen.rigor.box import Box, End
from hgogen.rigor.glance import between, rational
from hgogen.rigor.interpolation import Cells, Table, applied, replaced
from hgogen.rigor.kinks import Norm, bent, off_zero, rooted, shared, signed
from hgogen.rigor.points import STRANGE
from hgogen.rigor.search import is_defined
from hgogen.rigor.singular import lost
from hgogen.rigor.tape import NoTape

_KINDS = (sp.Abs, sp.Min, sp.Max, sp.sign, sp.Heaviside, sp.Piecewise, Table)
_OPERATIONS = 200  # of an argument whose side is asked for
_BOXES = 60
_LEAST = sp.Rational(1, 2**120)  # of a sum of squares whose root is computed: a number in float as well, of root 2^-60
_SMALL = 2.0**-40  # below it the least is taken of squares in a unit of their own: it would be no small part of them
_MOST = 60  # halvings of their root, so that a float holds one over the unit


def one_sided(expression: sp.Expr, box: Box) -> sp.Expr:
    """The expression where its symbols are in the box; equal to it wherever it is defined there."""
    return _visited(expression, box) if _bends(expression) else expression


def _bends(expression: sp.Expr) -> bool:
    return expression.has(*_KINDS) or any(rooted(node) for node in expression.atoms(sp.Pow))


def _visited(node: sp.Expr, box: Box) -> sp.Expr:
    if isinstance(node, sp.Piecewise):
        return _chosen(node, box)
    if isinstance(node, Table):  # without its ends along the axes where its argument keeps within its points
        arguments = [_visited(argument, box) for argument in node.args]
        return applied(between(node, arguments, box), arguments, node.order)
    if not node.args:
        return node
    args = [_visited(part, box) if isinstance(part, sp.Expr) else part for part in node.args]
    if isinstance(node, (sp.Min, sp.Max)):
        return _extreme(type(node), args, box)
    built = node if args == list(node.args) else node.func(*args)
    simplified = _plain(built, box)
    return node if simplified != node and lost(args, (simplified,), box) is not None else simplified


def computed(expression: sp.Expr, box: Box) -> sp.Expr:
    """The expression as programs compute it on the box, whose arguments are clamped to it: `one_sided`, so that a slope
    at an end of the box is that within, tables that go on where the box leaves them by rounding alone as well,
    kinks at one place with one side, and norms with a slope where they are 0."""
    return _computed(expression, tuple(box.items())) if _bends(expression) else expression


@lru_cache(maxsize=512)  # the same rows are asked for at each stage of a step
def _computed(expression: sp.Expr, sides: tuple[tuple[sp.Symbol, tuple[End, End]], ...]) -> sp.Expr:
    box = dict(sides)

    def cells(node: Table) -> Cells:
        return between(node, [one_sided(part, box) for part in node.args], box, program=True)

    return off_zero(shared(one_sided(replaced(expression, cells), box)), _LEAST, lambda squares: _unit(squares, box))


def _unit(squares: sp.Expr, box: Box) -> sp.Rational:
    """1, or of what is small on the whole box a power of 4 about as large, which is exact to divide by."""
    _, high = rational(squares, box)
    if not 0 < high < _SMALL:
        return sp.S.One
    return sp.Rational(1, 4 ** min(int(-math.log2(high) / 2), _MOST))


def _plain(e: sp.Expr, box: Box) -> sp.Expr:
    """An expression, whose parts are simplified already, without the kinks at its own node."""
    if isinstance(e, sp.Mul) and any(isinstance(part, sp.sign) for part in e.args):
        whole = signed(e)
        return e if whole == e else _visited(whole, box)
    if isinstance(e, sp.Abs) or (isinstance(e, Norm) and len(e.args) == 1):
        return _size(e.args[0], box)
    if isinstance(e, sp.sign):
        return sp.Integer(_constant(e.args[0], box)) or e
    if isinstance(e, sp.Heaviside):
        way = _constant(e.args[0], box)
        return e if way == 0 else sp.Integer(way > 0)
    if isinstance(e, sp.Pow) and rooted(e):
        whole = bent(e)
        return e if whole == e or not whole.is_Function or len(whole.args) > 1 else _size(whole.args[0], box)
    return e


def _size(argument: sp.Expr, box: Box) -> sp.Expr:
    """|e|, factor by factor."""
    sized: list[sp.Expr] = []
    rest: list[sp.Expr] = []
    for factor in sp.Mul.make_args(argument):
        way = _side(factor, box)
        (sized if way else rest).append(way * factor if way else factor)
    return sp.Mul(*sized, sp.Abs(sp.Mul(*rest)))


def _extreme(kind: type[sp.Expr], args: Iterable[sp.Expr], box: Box) -> sp.Expr:
    """The Min or Max of the arguments that may attain it on the box."""
    way = 1 if kind is sp.Max else -1
    remaining: list[sp.Expr] = []
    for a in args:
        if any(_side(way * (b - a), box) > 0 for b in remaining) and is_defined(a, box):
            continue
        remaining = [b for b in remaining if _side(way * (a - b), box) <= 0 or not is_defined(b, box)]
        remaining.append(a)
    return kind(*remaining)


def _chosen(node: sp.Piecewise, box: Box) -> sp.Expr:
    """The Piecewise of the branches that may be taken. Of a continuous one, a condition that holds at the edge of a
    branch alone does not count."""
    branches: list[tuple[sp.Expr, sp.Basic]] = []
    smooth = not bent(node).has(sp.Piecewise)
    for value, condition in (tuple(pair.args) for pair in node.args):
        holds = _holds(condition, smooth, box)
        if holds is not False:
            branches.append((_visited(value, box), sp.true if holds else condition))
        if holds:
            break
    return sp.Piecewise(*branches) if branches else node


def _holds(condition: sp.Basic, weakly: bool, box: Box) -> bool | None:
    """Whether a condition holds on the whole box, or nowhere on it."""
    if condition in (sp.true, sp.false):
        return bool(condition)
    if not isinstance(condition, (sp.StrictLessThan, sp.LessThan, sp.StrictGreaterThan, sp.GreaterThan)):
        return None
    rise = condition.gts - condition.lts
    strict = isinstance(condition, (sp.StrictLessThan, sp.StrictGreaterThan))
    above = _side(rise, box) if weakly or not strict else _strict(rise, box)
    below = _side(rise, box) if weakly or strict else _strict(rise, box)
    holds = True if above > 0 else False if below < 0 else None
    return holds if holds is None or is_defined(rise, box) else None


def _constant(e: sp.Expr, box: Box) -> int:
    """`_strict` of what is proved to be defined on the box, else 0."""
    way = _strict(e, box)
    return way if way and is_defined(e, box) else 0


def _side(e: sp.Expr, box: Box) -> int:
    """1 where it is proved that e >= 0 on the box, -1 where e <= 0, else 0; 1 of what is 0."""
    if e.count_ops() > _OPERATIONS or e.has(*STRANGE):
        return 0
    low, high = rational(e, box)
    return 1 if low >= 0 else -1 if high <= 0 else _strict(e, box)


def _strict(e: sp.Expr, box: Box) -> int:
    """1 where it is proved that e > 0 on the box, -1 where e < 0, else 0."""
    if e.count_ops() > _OPERATIONS or e.has(*STRANGE):
        return 0
    low, high = rational(e, box)
    if low > 0 or high < 0:
        return 1 if low > 0 else -1
    try:
        answer = nonzero(e, box, boxes=_BOXES, refute=False)
    except NoTape:
        return 0
    return answer.sign if answer.verdict is Verdict.PROVED else 0
