"""What `tune` does first: each parameter in its range, and its nominal value where it is not a number."""

from collections.abc import Iterable

import casadi as ca

from hgogen.graph import Graph
from hgogen.program import INF, Block, Field, Limit, Place, Program, column, sym
from hgogen.stepping.guards import LARGEST_NUMBER, any_of

FEWEST = 3  # rows of which a table is shorter than the statements
LIMITED = Place("status", "PARAMETER_LIMITED")


def limit_parameters(plant: tuple[Field, ...], gains: tuple[Field, ...], derived: Program) -> Program:
    """The program that limits the parameters and then computes the derived gains."""
    fields = [(kind, field) for kind, fields in (("plant", plant), ("gain", gains)) for field in fields]
    limits = [_limits(kind, field) for kind, field in fields]
    bounded = [limit for group in limits for limit in group if limit.low > -INF and limit.high < INF]
    if len(bounded) == sum(map(len, limits)) >= FEWEST:
        return (_block("each parameter in its range", bounded, rows=True), *derived)
    blocks = (_block(f"{field.name} in its range", group) for (_, field), group in zip(fields, limits, strict=True))
    return (*blocks, *derived)


def _limits(kind: str, field: Field) -> list[Limit]:
    """Those of the elements of a field."""
    place = Place(kind, field.name)
    ends = zip(field.box, field.initial, strict=True)
    return [Limit(place, k, field.size, low, high, nominal) for k, ((low, high), nominal) in enumerate(ends)]


def _block(title: str, limits: Iterable[Limit], rows: bool = False) -> Block:
    """The block that does it, which says so in the status."""
    values = dict[Place, list[Graph]]()
    changed = []
    limits = tuple(limits)
    for limit in limits:
        value = sym(*limit.place, limit.size)[limit.index]
        clamped = ca.fmin(ca.fmax(value, limit.low), limit.high)
        taken = ca.if_else(ca.fabs(value) <= LARGEST_NUMBER, clamped, limit.nominal)
        values.setdefault(limit.place, []).append(taken)
        changed.append(ca.logic_not(ca.logic_and(value >= limit.low, value <= limit.high)))
    writes = {place: column(each) for place, each in values.items()}
    return Block(title, {**writes, LIMITED: any_of(changed)}, limits=limits if rows else ())
