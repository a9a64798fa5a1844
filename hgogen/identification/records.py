"""Measured records as arrays, and what is demanded of them."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hgogen.calling.samples import held_last, table
from hgogen.errors import BadArgument
from hgogen.reading.differences import derived, difference
from hgogen.signal import Signal, resting
from hgogen.system import System

LEAST = 10  # samples of an output


class BadLog(BadArgument):
    """Records from which nothing can be learned of a plant."""


@dataclass(frozen=True, eq=False)
class Log:
    """A record: u (N, m), finite, and y (N, p), NaN where nothing was measured, a period dt apart."""

    u: np.ndarray
    y: np.ndarray
    dt: float

    def of(self, inputs: Sequence[Signal]) -> "Log":
        """The record with a column for each of the inputs that a form reads: those of the plant, which it holds, and
        behind them derivatives of these, as differences."""
        count, sources = self.u.shape[1], derived(inputs)
        columns = dict(zip((u.name for u in inputs), self.u.T, strict=False))
        rates = [difference(columns[name], order, self.dt) for name, order in (sources[u.name] for u in inputs[count:])]
        return replace(self, u=np.column_stack([self.u, *rates]))


def demanded(plant: System, record: Log, number: int) -> Log:
    """The record as tables of numbers, a missing input as the last one there was. Raises: `BadLog`, `BadShape`."""
    y = table("y", record.y, plant.outputs, None)
    u = table("u", record.u, plant.inputs, len(y))
    name = f"record {number}"
    if isinstance(record.dt, str) or not 0 < record.dt < math.inf:
        raise BadLog(name, f"has the period {record.dt!s:.60}; give a positive time")
    y = np.where(np.isfinite(y), y, np.nan)
    for signal, column in zip(plant.outputs, y.T, strict=True):
        if np.isfinite(column).sum() < LEAST:
            raise BadLog(name, f"has fewer than {LEAST} samples of {signal.name}; give a longer one")
    held = held_last(u)
    return Log(np.where(np.isfinite(held), held, [resting(s) for s in plant.inputs]), y, float(record.dt))


def beyond(plant: System, record: Log) -> Iterator[str]:
    """A sentence for each output that shows a state outside of its declared range."""
    for y, h, column in zip(plant.outputs, plant.output, record.y.T, strict=True):
        state = next((x for x in plant.states if x == h and x.bounded), None)
        if state is None:
            continue
        low, high = state.interval
        outside = column[(column < low) | (column > high)]
        if len(outside):
            farthest = outside[np.argmax(np.maximum(low - outside, outside - high))]
            yield (
                f"{y.name} leaves the declared range of {state.name}, {low:g}..{high:g}, in {len(outside)} of "
                f"{len(column)} samples, as far as {farthest:.4g}: widen it, if the unit and the sign are right"
            )
