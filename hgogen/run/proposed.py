"""A trial of a plant that has none: a motion within its ranges, and a first estimate that is wrong.

    x(0) = m + c s S,   u(t) = m + c S sin(2 pi t/D),   xhat(0) = m,   duration 10 D

m: the middle and S: half of a range; D: the longest time in which a state crosses its range at its fastest; s: a sign
for each state; c = 1/2, 1/4 or 1/10. Of these motions that one is taken which stays longest in all ranges of the
states, the first of equals; where it leaves them, the trial ends before.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import cycle, islice

import numpy as np
import sympy as sp

from hgogen.analysis.pace import NoSight, pace
from hgogen.errors import BadArgument
from hgogen.reading.given import asks_a_plant
from hgogen.signal import Signal
from hgogen.system import System
from hgogen.trial import BadTrial, Plant, Trial, t

CROSSINGS = 10.0  # times D
SAMPLES = 2000  # at which a motion is looked at
SHARES = (0.5, 0.25, 0.1)  # c
SIGNS = ((1,), (1, -1), (-1,))
PARTS = tuple(0.5**k for k in range(7, -1, -1))  # of the duration
BEFORE = 0.9  # of the time to leave
LEAST = 0.1  # of D: a shorter motion is no trial


class NoTrial(BadArgument):
    """A plant of which no trial can be made from its ranges."""


@asks_a_plant
def proposed_trial(plant: System) -> Trial:
    """The trial, without noise, of the plant as first declared. Raises: `NoTrial` where a state or an input has no
    range, nothing moves, or every motion leaves the ranges at once."""
    first = plant.declared
    if unknown := [s.name for s in (*first.states, *first.inputs) if not s.bounded]:
        raise NoTrial(f"plant {plant.name!r}", f"has no range of {', '.join(unknown)}, and no trial; declare either")
    try:
        longest = pace(first).longest
    except NoSight as error:
        raise NoTrial(f"plant {plant.name!r}", str(error)) from None
    if not longest:
        raise NoTrial(f"plant {plant.name!r}", "does not move within its ranges; declare a trial")
    motions = list(_motions(first, longest))
    stays = [_stay(first, one) for one in motions]
    best = int(np.argmax(stays))
    if stays[best] < LEAST * longest:
        raise NoTrial(
            f"plant {plant.name!r}",
            f"leaves its ranges within {stays[best]:.2g} {first.time} on every motion that was tried; declare a "
            "trial in which it is held there",
        )
    motion = motions[best]
    return motion if stays[best] >= motion.duration else replace(motion, duration=BEFORE * stays[best])


def _motions(plant: System, longest: float) -> Iterator[Trial]:
    middle = {x.name: _middle(x) for x in plant.states}
    for share in SHARES:
        for signs in SIGNS:
            signed = zip(plant.states, islice(cycle(signs), len(plant.states)), strict=True)
            start = {x.name: _middle(x) + share * sign * _half(x) for x, sign in signed}
            inputs = {u.name: _middle(u) + share * _half(u) * sp.sin(2 * sp.pi * t / longest) for u in plant.inputs}
            yield Trial("proposed", CROSSINGS * longest, start, inputs, estimate=middle, seeds=(0,))


def _stay(plant: System, trial: Trial) -> float:
    """How long the plant stays in its ranges: parts that double are integrated until it leaves them, or escapes."""
    low, high = np.array([s.interval for s in plant.states]).T
    stayed = 0.0
    for part in PARTS:
        duration = part * trial.duration
        try:
            x = Plant(plant, replace(trial, duration=duration), duration / SAMPLES).states(trial.start)
        except BadTrial:
            return stayed
        outside = np.flatnonzero(((x < low) | (x > high)).any(axis=1))
        if len(outside):
            return float(outside[0] * duration / SAMPLES)
        stayed = duration
    return stayed


def _middle(signal: Signal) -> float:
    return math.fsum(signal.interval) / 2


def _half(signal: Signal) -> float:
    return (signal.interval[1] - signal.interval[0]) / 2
