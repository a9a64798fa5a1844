"""A plant on its declared box, where the box decides on which side of a kink or jump it is: |x| is x where x >= 0."""

from dataclasses import replace

import sympy as sp

from hgogen.algebra.tabulated import Table
from hgogen.intervals.box import box
from hgogen.intervals.one_sided import one_sided
from hgogen.system import System


def on_box(plant: System) -> System:
    """The plant without kinks and jumps whose side its box decides."""
    around = box(plant.signals, plant.nominal)
    flow, output = (tuple(one_sided(row, around) for row in rows) for rows in (plant.flow, plant.output))
    return plant if (flow, output) == (plant.flow, plant.output) else replace(plant, flow=flow, output=output)


def within_tables(plant: System) -> tuple[tuple[sp.Expr, ...], tuple[sp.Expr, ...]]:
    """The flow and the output, of a plant with tables on its box: beyond its points a table is flat, which says nothing
    of what it shows between them."""
    tables = any(row.has(Table) for row in (*plant.flow, *plant.output))
    seen = on_box(plant) if tables else plant
    return seen.flow, seen.output
