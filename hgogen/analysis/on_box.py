"""A plant on its declared box, where the box decides on which side of a kink or jump it is: |x| is x where x >= 0."""

from dataclasses import replace

import sympy as sp

from hgogen.algebra.tabulated import Table
from hgogen.intervals.box import Box, box
from hgogen.intervals.one_sided import one_sided
from hgogen.system import System

Rows = tuple[sp.Expr, ...]


def on_box(plant: System) -> System:
    """The plant without kinks and jumps whose side its box decides."""
    around = box(plant.signals, plant.nominal)
    flow, output = (tuple(one_sided(row, around) for row in rows) for rows in (plant.flow, plant.output))
    return plant if (flow, output) == (plant.flow, plant.output) else replace(plant, flow=flow, output=output)


def within_tables(plant: System) -> tuple[Rows, Rows]:
    """The flow and the output, of a plant with tables on its box."""
    around = box(plant.signals, plant.nominal)
    return between_points(plant.flow, around), between_points(plant.output, around)


def between_points(rows: Rows, around: Box) -> Rows:
    """The rows on a box where they have tables: beyond its points a table is flat, which says nothing of what it shows
    between them."""
    return tuple(one_sided(row, around) if row.has(Table) else row for row in rows)
