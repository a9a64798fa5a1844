"""Jumps by a whole turn in samples of an angle that is wrapped into one turn.

An angle in (-pi, pi] has a course that is smooth on the circle: taken the short way round, a step that crosses the end
of the turn is as long as those around it, and no value lies outside of one turn. A course of plain numbers has no such
jumps, unless a sensor fails, or a plant switches between two values, which leaves the middle of the turn empty.
"""

import math
from collections.abc import Iterable, Iterator

import numpy as np

from hgogen.errors import ReportedWarning
from hgogen.signal import Signal
from hgogen.system import System

RADIANS, DEGREES = 2 * math.pi, 360.0
UNITS = {"rad": RADIANS, **dict.fromkeys(("deg", "degree", "degrees", "°"), DEGREES)}  # the turn in these
_BEYOND, _HARDLY = 0.05, 2e-4  # of a turn: how far noise may take values out of it; in the unit of an angle
_REACH = 8  # steps on both sides that a jump is compared with
_LONGER = 5.0  # times the median of these, and _ROUGH of a turn: the longest step across the end
_ROUGH, _LONGEST = 0.01, 0.25  # of a turn
_MORE = 3.0  # times as many steps as fit no angle: least number of jumps by a turn
_MIDDLE, _THROUGH = 0.5, 0.05  # of a turn; least share of the samples of a course through the middle of a turn
_LEAST = 10  # samples
_LARGEST = 1e15  # of a turn
_FULL = 2e-3  # how far a course may be larger than a round turn
_ROUND = (1, 2, 2.4, 3, 3.6, 4, 5, 6, 8, 10)  # digits of turns in other units
_SAME = 0.03  # relative difference of two turns that count as one


class JumpsByTurn(ReportedWarning):
    """The warning that samples of an output jump by a whole turn although the output has no declared period."""


def first_jump(values: np.ndarray, turn: float, through: bool = True) -> int | None:
    """Return the index of the first sample after a jump by a `turn`, of samples (N,) of an angle that is wrapped into
    one turn, NaN where missing; None if they are no such angle. `through`: whether the angle must pass through the
    middle of the turn."""
    there = np.flatnonzero(np.isfinite(values))
    course = values[there]
    if len(course) < _LEAST or np.ptp(course) > (1 + (_BEYOND if through else _HARDLY)) * turn:
        return None
    age = np.diff(there)
    steps = np.where(age <= np.median(age), np.diff(course), 0.0)
    turns = np.floor(steps / turn + 0.5)
    jumps, short = turns != 0, np.abs(steps - turns * turn)
    long = short > _LONGEST * turn
    if (jumps & ~long).sum() < max(1, _MORE * long.sum()):  # before the medians, which take long
        return None
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(short, _REACH, "reflect"), 2 * _REACH + 1)[jumps]
    smooth = short[jumps] <= np.minimum(_LONGER * np.median(windows, axis=1) + _ROUGH * turn, _LONGEST * turn)
    whole, broken = np.flatnonzero(jumps)[smooth], (~smooth).sum() + (long & ~jumps).sum()
    if not len(whole) or len(whole) < _MORE * broken:
        return None
    middle = np.abs(course - (course.min() + course.max()) / 2) < _MIDDLE / 2 * turn
    if through and middle.mean() < _THROUGH:
        return None
    return int(there[1 + whole[0]])


def turn_of(signal: Signal, values: np.ndarray, widths: Iterable[float]) -> tuple[float, int] | None:
    """Return the turn by which samples (N,) of a signal jump, with the index of the first sample after a jump; None
    without one. Tried are 2 pi, 360, the `widths` of declared ranges, a power of two (counts of an encoder), and a
    round number that is the width of the samples' range, such as 400 (gon)."""
    course = values[np.isfinite(values) & (np.abs(values) < _LARGEST)]
    if len(course) < _LEAST or 2 * (1 + _BEYOND) * np.abs(np.diff(course)).max() < np.ptp(course):
        return None  # a jump is longer than half of a turn, which the course hardly leaves
    turns: list[float] = []
    size = min(float(np.ptp(course)) or 1.0, _LARGEST)
    decade = 10.0 ** math.floor(math.log10(size))
    filled = (digits * decade for digits in _ROUND if 1 - _BEYOND <= size / (digits * decade) <= 1 + _FULL)
    for turn in (RADIANS, DEGREES, *widths, 2.0 ** max(8, math.ceil(math.log2(size))), *filled):
        if all(abs(turn / other - 1) > (_FULL if turn < size * (1 + _BEYOND) else _SAME) for other in turns):
            turns.append(turn)
            at = first_jump(values, turn, through=UNITS.get(signal.unit) != turn)
            if at is not None:
                return turn, at
    return None


Course = tuple[int, Signal, tuple[float, ...], str]


def unwrapped_outputs(plant: System) -> tuple[Course, ...]:
    """Return, for each output without a declared period, its index, its signal, the widths of the declared ranges of
    the output and of the state that it equals, and the names for which a period would have to be declared: the output's
    and those of the states in it."""
    courses = []
    for j, (y, row) in enumerate(zip(plant.outputs, plant.output, strict=True)):
        if y.period is None:
            measured = [x for x in plant.states if (slope := row.diff(x)).is_number and slope]
            equal = (x for x in measured if x == row)
            widths = tuple(s.interval[1] - s.interval[0] for s in (y, *equal) if s.bounded)
            courses.append((j, y, widths, " and ".join(s.name for s in (y, *measured))))
    return tuple(courses)


def jumps_by_turns(courses: Iterable[Course], samples: np.ndarray, dt: float, time: str) -> Iterator[str]:
    """Yield a sentence for each output whose samples jump by a whole turn. `courses`: the outputs without a period, as
    `unwrapped_outputs` returns them; `samples` (N, p): one row each `dt`, in the unit `time`."""
    for j, y, widths, names in courses:
        column = samples[:, j]
        jump = turn_of(y, column, widths)
        if jump is None:
            continue
        turn, at = jump
        step = column[at] - column[:at][np.isfinite(column[:at])][-1]
        unit = f" {y.unit}" if y.unit else ""
        yield (
            f"{y.name} jumps by {step:.4g}{unit} at sample {at} ({at * dt:.6g} {time} after the first), a whole turn, "
            f"which is taken for a motion of the plant: declare period = {turn_text(turn)} of {names}, in place of low "
            "and high"
        )


def other_angle(signal: Signal, values: np.ndarray) -> str | None:
    """Return "degrees" if samples (N,) of a periodic signal that is declared in radians jump by 360, "radians" for the
    converse, else None."""
    pairs = {"degrees": (RADIANS, DEGREES), "radians": (DEGREES, RADIANS)}
    return next(
        (
            unit
            for unit, (own, turn) in pairs.items()
            if signal.period and math.isclose(signal.period, own) and first_jump(values, turn, through=False)
        ),
        None,
    )


def turn_text(turn: float) -> str:
    """Return a turn as text for a declaration: 2*pi, or the number."""
    return "2*pi" if turn == RADIANS else f"{turn:g}"
