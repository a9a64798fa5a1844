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
    limits = list[tuple[Field, list[Limit]]]()
    for kind, fields in (("plant", plant), ("gain", gains)):
        for field in fields:
            place, ends = Place(kind, field.name), zip(field.box, field.initial, strict=True)
            each = [Limit(place, k, field.size, *end, nominal) for k, (end, nominal) in enumerate(ends)]
            limits.append((field, each))
    every = [limit for _, each in limits for limit in each]
    if len(every) >= FEWEST and all(limit.low > -INF and limit.high < INF for limit in every):
        return (_block("each parameter in its range", every, rows=True), *derived)
    blocks = (_block(f"{field.name} in its range", each) for field, each in limits)
    return (*blocks, *derived)


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
