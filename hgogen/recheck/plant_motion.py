"""How fast a plant moves on its ranges, from which sizes of what a method leaves follow."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

from .box import NotShown, covered, ranged
from .context import Context, narrowed, only, short
from .matrix import column


@dataclass(frozen=True)
class PlantMotion:
    """In steps of length `h`: at most how fast inputs move (m), and bounds of sup|F| (n) of the rows F."""

    context: Context
    h: Fraction
    rates: list[Fraction]
    speeds: list[Fraction]

    def demand(self) -> int:
        """That the bounds are those of the plant, and that no input is in what outputs show; with how many boxes.

        Raises: `NotShown`."""
        context = self.context
        for j in self.shown:
            only(context.form.output[j].names & set(context.file.inputs), (), "an output")
        for u, rate in zip(context.file.inputs, self.rates, strict=True):
            if rate < 0 or (rate and u not in self.read):
                raise NotShown("one of its rates is negative, or of an input that the plant does not read")
        return demand_speeds(context, self.speeds)

    @cached_property
    def read(self) -> frozenset[str]:
        """The names that the rows read."""
        return frozenset(name for row in self.context.rates for name in row.names)

    @cached_property
    def shown(self) -> dict[int, tuple[int, Fraction]]:
        """By output, the place of the state that it shows, and dy/dz; without those that show none, which are not
        injected. Raises: `NotShown`."""
        shown = dict[int, tuple[int, Fraction]]()
        for j, z in ((j, z) for j, z in enumerate(self.context.seen) if z):
            slope = self.context.first_gain(j).number
            if not slope:
                raise NotShown("the slope of an output is no number")
            shown[j] = self.context.z.index(z), slope
        return shown

    @property
    def said(self) -> str:
        """What is left, and how fast inputs move, in words."""
        each = zip(self.context.file.inputs, self.rates, strict=True)
        moving = [f"{u} moves at up to {short(rate, -1)}" for u, rate in each if u in self.read]
        return f"what the method leaves{' as ' if moving else ''}{', '.join(moving)}"

    @property
    def clear(self) -> str:
        """By how much the plant keeps clear of the ends of its ranges, in words."""
        each = zip(self.context.z, self.speeds, strict=True)
        return ", ".join(f"{short(self.h * speed, 1)} in {z}" for z, speed in each)


def demand_speeds(context: Context, speeds: Sequence[Fraction]) -> int:
    """That no row of the plant is faster on its ranges; with how many boxes. Raises: `NotShown`."""
    rows = zip(context.rates, speeds, strict=True)
    return sum(covered(narrowed(context.form.box, row.names), ".", ranged(row, -most, most)) for row, most in rows)


def motion_of(context: Context, h: Fraction, follows: Mapping[str, Any]) -> PlantMotion:
    """That of which a share says that its sizes follow. Raises: `NotShown`."""
    rates, speeds = column(follows, "rates", len(context.file.inputs)), column(follows, "speeds", len(context.z))
    return PlantMotion(context, h, rates, speeds)


def demand_keys(follows: Mapping[str, Any], keys: tuple[str, ...]) -> None:
    """That it has these and no others. Raises: `NotShown`."""
    if set(follows) != {*keys}:
        raise NotShown(f"the sizes of the method do not follow from {', '.join(keys)}")
