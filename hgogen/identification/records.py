"""Measured records as arrays, and what is demanded of them."""

import math
from dataclasses import dataclass

import numpy as np

from hgogen.calling.samples import held_last, table
from hgogen.errors import BadArgument
from hgogen.signal import resting
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
