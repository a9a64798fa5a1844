"""A plant on its declared box: what it reads as it is written, and its rows there.

A form of a plant, or its rows as they stand, may no longer have what the plant reads: (u x + u)/u is x + 1 in a form,
and has no value at u = 0. Every claim about values on the box rests on the plant's having one there.

The box decides on which side of a kink or jump the plant is: |x| is x where x >= 0. Where it does not decide it, the
plant has several branches (`algebra.reached`).
"""

from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache

import sympy as sp

from hgogen.check import Check, Verdict
from hgogen.rigor.box import box
from hgogen.rigor.rank import Reached, at_values, reached
from hgogen.rigor.singular import Condition, conditions, doubtful, one_sided, put_apart
from hgogen.sentence import because
from hgogen.system import System


def written(plant: System) -> tuple[sp.Expr, ...]:
    """The rows of the plant, and each part of those of the plant that it was recast from, in its own states.

    x1 - x2 over 2 x1 - 2 x2 has no value at x1 = x2; with x1 = w + x2 SymPy makes 1/2 of it.
    """
    rows = (*plant.flow, *plant.output)
    if plant.origin is None:
        return rows
    before = plant.origin.plant
    back = dict(zip(before.states, plant.origin.backward, strict=True))
    return (*rows, *put_apart(written(before), lambda part: part.xreplace(back)))


@lru_cache(maxsize=16)
def valueless(plant: System) -> sp.Expr | None:
    """A part of the plant as it is written that is not shown to be a finite real number on the whole box, or None."""
    return next(iter(doubtful(written(plant), plant.box)), None)


@lru_cache(maxsize=16)
def asked(plant: System) -> tuple[Condition, ...]:
    """The conditions for the plant as it is written to have a value, as far as they are not shown on the whole box."""
    return conditions(written(plant), plant.box)


def if_valued(check: Check, plant: System) -> Check:
    """The check of a claim about values on the box: unknown in place of proved where the plant may have none."""
    part = valueless(plant) if check.verdict is Verdict.PROVED else None
    if part is None:
        return check
    reason = because("{part} of the plant is not shown to have a value on the box", part=part)
    return Check(check.id, check.claim, Verdict.UNKNOWN, reason, fix="Narrow the ranges so that it has one.")


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
