"""A plant on its declared box, where the box decides on which side of a kink or jump it is: |x| is x where x >= 0.

Where the box does not decide it, the plant has several branches (`algebra.reached`).
"""

from collections.abc import Iterable
from dataclasses import replace

import sympy as sp

from hgogen.algebra.rank import at_values
from hgogen.algebra.reached import Reached, reached
from hgogen.intervals.box import box
from hgogen.intervals.one_sided import one_sided
from hgogen.system import System


def on_box(plant: System) -> System:
    """The plant without kinks and jumps whose side its box decides."""
    around = plant.box
    flow, output = (tuple(one_sided(row, around) for row in rows) for rows in (plant.flow, plant.output))
    return plant if (flow, output) == (plant.flow, plant.output) else replace(plant, flow=flow, output=output)


def on_branches(plant: System, loose: Iterable[sp.Symbol]) -> Reached:
    """The branches of flow and output, in this order, that the declared box reaches: the `loose` parameters in their
    ranges, the others at their nominal values.

    Raises: `NowhereDefined` where a comparison has no value at these; `NoTape` for a function without a rule.
    """
    loose, plain = tuple(loose), on_box(plant)
    fixed = {p: value for p, value in plant.nominal.items() if p not in loose}
    return reached(at_values((*plain.flow, *plain.output), fixed), box((*plant.states, *plant.inputs, *loose)))
