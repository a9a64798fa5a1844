"""What SymPy folds away from a text: places where it has no real value as written, and has one as read.

exp(log(x)) is read as x, x/x as 1, sqrt(x)**2 as x. An operation demands something of its argument:

    log a, a**s     a >= 0, a != 0           a**(p/q), q > 1, p > 0    a >= 0      1/a       a != 0
    tan a           cos a != 0               asin a, acos a            1 - a**2 >= 0
    acosh a         a - 1 >= 0               atanh a                   1 - a**2 >= 0, != 0
    atan2(a, b)     a**2 + b**2 != 0

A demand of the text is lost if no operation of what is read makes it. What a Piecewise demands is not followed, in
either: a branch that is not taken demands nothing.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import sympy as sp

from hgogen.check import Verdict
from hgogen.errors import HgogenError
from hgogen.reading.filename import cut
from hgogen.rigor.bounds import bound, nonzero
from hgogen.rigor.box import Box
from hgogen.rigor.singular import parts
from hgogen.sentence import NONE, Reason, because


class Demand(NamedTuple):
    """There is no real value where `of` is zero, "=", or negative, "<"."""

    relation: str
    of: sp.Expr


_DEMANDS: dict[type, Callable[..., tuple[Demand, ...]]] = {
    sp.log: lambda a: (Demand("<", a), Demand("=", a)),
    sp.tan: lambda a: (Demand("=", sp.cos(a)),),
    sp.asin: lambda a: (Demand("<", 1 - a**2),),
    sp.acos: lambda a: (Demand("<", 1 - a**2),),
    sp.acosh: lambda a: (Demand("<", a - 1),),
    sp.atanh: lambda a: (Demand("<", 1 - a**2), Demand("=", 1 - a**2)),
    sp.atan2: lambda a, b: (Demand("=", a**2 + b**2),),
}


def of_call(function: object, *arguments: sp.Expr) -> Iterator[Demand]:
    """What function(arguments) demands."""
    if function is sp.sqrt:
        yield from of_power(arguments[0], sp.S.Half)
    elif isinstance(function, type) and function in _DEMANDS:
        for demand in _DEMANDS[function](*arguments):
            yield from _plain(demand)


def of_power(base: sp.Expr, exponent: sp.Expr) -> Iterator[Demand]:
    """What base**exponent demands; a**0 is 1, also where a = 0."""
    if exponent == 0:
        return
    if not exponent.is_integer:
        yield from _plain(Demand("<", base))
    if exponent.is_positive is not True:
        yield from _plain(Demand("=", base))


def lost(written: Iterable[Demand], reading: sp.Expr) -> tuple[Demand, ...]:
    """The demands of the `written` expression that its `reading` does not make, each once."""
    written = dict.fromkeys(written)
    demanded: set[Demand] = set()
    for node in parts(reading) if written else ():
        if isinstance(node, sp.Pow):
            demanded.update(of_power(node.base, node.exp))
        else:
            demanded.update(of_call(node.func, *node.args))
    return tuple(demand for demand in written if demand not in demanded)


def _plain(demand: Demand) -> Iterator[Demand]:
    """The demand as one of each factor that may fail it, without positive numbers; a divisor makes its own demands."""
    if not demand.of.free_symbols:  # the parser has judged the numbers
        return
    yield from (_signs if demand.relation == "<" else _zeros)(demand.of)


def _signs(value: sp.Expr) -> Iterator[Demand]:
    """A root is not negative where it is real."""
    pairs = [(factor.primitive()[1], factor.as_base_exp()[1]) for factor in sp.Mul.make_args(value)]
    left = [factor for factor, exponent in pairs if exponent.is_integer and not factor.is_nonnegative]
    if left:
        yield Demand("<", sp.Mul(*left))


def _zeros(value: sp.Expr) -> Iterator[Demand]:
    for factor in sp.Mul.make_args(value.primitive()[1]):
        base, exponent = factor.as_base_exp()
        if factor.is_number or factor.is_zero is False or exponent.is_negative:
            continue
        if base != value and isinstance(base, sp.Mul | sp.Pow | sp.Add):
            yield from _zeros(base)
        elif isinstance(base, sp.Abs):
            yield from _zeros(base.args[0])
        else:
            yield Demand("=", -base if base.could_extract_minus_sign() else base)


@dataclass(frozen=True)
class Fold:
    """A text, the `reading` that SymPy makes of it, and the demands that are `lost`."""

    text: str
    reading: sp.Expr
    lost: tuple[Demand, ...]

    def on(self, box: Box) -> Reason:
        """What is read otherwise than written, as far as it is not excluded on the closed box; `NONE` if it is."""
        places: dict[sp.Expr, str] = {}
        for relation, a in self.lost:
            if not _met(relation, a, box):
                places[a] = "<=" if places.get(a, relation) != relation else relation
        if not places:
            return NONE
        pattern = "SymPy reads {text} as {reading}, also where {places: or }; {reading} is what is meant here"
        where = [because("{a} {relation} 0", a=cut(str(a)), relation=relation) for a, relation in places.items()]
        return because(pattern, text=cut(self.text), reading=cut(str(self.reading)), places=where)


def _met(relation: str, a: sp.Expr, box: Box) -> bool:
    try:
        return nonzero(a, box).verdict is Verdict.PROVED if relation == "=" else bound(a, box).low >= 0
    except HgogenError:
        return False
