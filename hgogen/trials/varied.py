"""What a campaign varies: first states, parameters and noise of the plant, each within an interval.

A draw is a point of the box of these intervals. N draws are a Latin hypercube: of each quantity, one draw lies in each
of N equal parts of its interval, in an order of its own. The observer knows of none of them: it keeps its nominal
parameters and the trial's estimate. Source: McKay, Beckman, Conover, Technometrics 21 (1979).
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from hgogen.errors import BadArgument, nearest
from hgogen.modelfiles.scenario import OrnsteinUhlenbeck
from hgogen.reading.given import real
from hgogen.signal import Signal
from hgogen.system import System
from hgogen.trial import Trial

STATES, PARAMETERS, NOISE = "x0", "parameters", "noise"  # all of a kind
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_INTERVAL = re.compile(rf"({_NUMBER})\.\.({_NUMBER})")
_SHARE = re.compile(rf"({_NUMBER})%")
_USE = "write NAME, NAME=10%, NAME=0.2 or NAME=0.8..1.2, with commas between them"


class BadVariation(BadArgument):
    """What a campaign cannot vary."""

    text = "vary {what!r}: {reason}"


@dataclass(frozen=True)
class Varied:
    """A quantity and its interval: `what` is "start" of a state, "parameter", or "noise", a factor of each output's."""

    name: str
    what: Literal["start", "parameter", "noise"]
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Draws:
    """`values` (N, k) of `varied` (k)."""

    varied: tuple[Varied, ...]
    values: np.ndarray

    def __len__(self) -> int:
        return len(self.values)

    @property
    def moves(self) -> bool:
        """Whether the plant's truth differs from draw to draw."""
        return any(each.what != "noise" for each in self.varied)

    def named(self, row: int) -> dict[str, float]:
        """The values of a draw by name."""
        return dict(zip((each.name for each in self.varied), map(float, self.values[row]), strict=True))

    def trial(self, trial: Trial, row: int) -> Trial:
        """The trial with the first states and the noise of a draw."""
        pairs = list(zip(self.varied, map(float, self.values[row]), strict=True))
        start = {each.name: value for each, value in pairs if each.what == "start"}
        factor = math.prod(value for each, value in pairs if each.what == "noise")
        noise = {
            name: replace(one, sigma=factor * one.sigma)
            if isinstance(one, OrnsteinUhlenbeck)
            else replace(one, amplitude=factor * one.amplitude)
            for name, one in trial.noise.items()
        }
        return replace(trial, start={**trial.start, **start}, noise=noise)

    def parameters(self, row: int) -> list[float]:
        """The values of the parameters of a draw, in the order of `free`."""
        pairs = zip(self.varied, map(float, self.values[row]), strict=True)
        return [value for each, value in pairs if each.what == "parameter"]

    def free(self, plant: System) -> list[Signal]:
        """The parameters that vary."""
        by_name = {p.name: p for p in plant.parameters}
        return [by_name[each.name] for each in self.varied if each.what == "parameter"]


def hypercube(varied: Sequence[Varied], count: int, seed: int) -> Draws:
    """So many draws, the same ones for the same seed."""
    rng = np.random.default_rng([seed, count])
    shares = [(rng.permutation(count) + rng.random(count)) / count for _ in varied]
    columns = [each.low + share * (each.high - each.low) for each, share in zip(varied, shares, strict=True)]
    return Draws(tuple(varied), np.column_stack(columns) if columns else np.zeros((count, 0)))


def varied(asked: str | Mapping[str, str | float | None], plant: System, trial: Trial) -> tuple[Varied, ...]:
    """What is asked for: names, "x0" for all first states, "parameters" for all with a range, "noise" for the size of
    every output's noise, each with an interval as in "a=10%" (of its value in the trial), "a=0.2" (to both sides),
    "a=0.8..1.2"; without one it is the declared range. A mapping gives the same by name.

    Raises: `BadVariation`.
    """
    if not isinstance(asked, str | Mapping) or not all(isinstance(name, str) for name in asked):
        raise BadVariation(str(asked), "is no text and no mapping by name; write \"x0,a=10%\" or {'a': '10%'}")
    pairs = _split(asked) if isinstance(asked, str) else asked.items()
    listed: dict[str, Varied] = {}
    for name, width in pairs:
        for each in _of(name, width, plant, trial):
            if each.name in listed:
                raise BadVariation(name, f"{each.name} varies already; name it once")
            listed[each.name] = each
    return tuple(listed.values())


def _split(text: str) -> Iterator[tuple[str, str | None]]:
    for part in text.split(","):
        name, equals, width = (piece.strip() for piece in part.partition("="))
        if not name or (equals and not width):
            raise BadVariation(text, _USE)
        yield name, width or None


def _of(name: str, width: str | float | None, plant: System, trial: Trial) -> Iterator[Varied]:
    states, parameters = ({s.name: s for s in signals} for signals in (plant.states, plant.parameters))
    if name == NOISE:
        yield Varied(NOISE, "noise", *_factor(width, trial))
    elif name == STATES:
        yield from (_start(s, width, trial) for s in plant.states)
    elif name == PARAMETERS:
        several = [p for p in plant.parameters if p.bounded or width is not None]
        if not several:
            raise BadVariation(name, f"{plant.name} has no parameter with a range; declare low= and high=, or name one")
        yield from (_parameter(p, width) for p in several)
    elif name in states:
        yield _start(states[name], width, trial)
    elif name in parameters:
        yield _parameter(parameters[name], width)
    else:
        known = (STATES, PARAMETERS, NOISE, *states, *parameters)
        raise BadVariation(name, nearest(name, known, f"what can vary is {', '.join(known)}"))


def _start(state: Signal, width: str | float | None, trial: Trial) -> Varied:
    low, high = _interval(state, width, float(trial.start[state.name]))
    return Varied(state.name, "start", low, high)


def _parameter(parameter: Signal, width: str | float | None) -> Varied:
    low, high = _interval(parameter, width, float(parameter.nominal or 0))
    return Varied(parameter.name, "parameter", low, high)


def _interval(signal: Signal, width: str | float | None, middle: float) -> tuple[float, float]:
    """The interval about a value, within the declared range. Raises: `BadVariation`."""
    if width is None and not signal.bounded:
        raise BadVariation(signal.name, "it has no range; declare low= and high=, or say how far, as in 10% or 0.2")
    low, high = signal.interval if width is None else _read(signal.name, width, middle)
    bottom, top = signal.interval
    if low < bottom or high > top:
        reason = f"[{low:g}, {high:g}] leaves its range [{bottom:g}, {top:g}]; say less, or declare a wider range"
        raise BadVariation(signal.name, reason)
    return low, high


def _factor(width: str | float | None, trial: Trial) -> tuple[float, float]:
    if not trial.noise:
        raise BadVariation(NOISE, f"the trial {trial.name} has none; declare a trial with noise, or leave it out")
    if width is None:
        raise BadVariation(NOISE, "say by which factor, as in noise=50% or noise=0.5..2")
    low, high = _read(NOISE, width, 1.0)
    if low < 0:
        raise BadVariation(NOISE, f"a factor from {low:g} on is below 0; say less")
    return low, high


def _read(name: str, width: str | float, middle: float) -> tuple[float, float]:
    """The ends of an interval as it is written. Raises: `BadVariation`."""
    text = str(width).strip()
    if ends := _INTERVAL.fullmatch(text):
        low, high = map(float, ends.groups())
    else:
        share = _SHARE.fullmatch(text)
        if not share and not re.fullmatch(_NUMBER, text):
            raise BadVariation(name, f"{text!r} is no interval; {_USE}")
        half = abs(middle) * float(share[1]) / 100 if share else real(name, float(text))
        low, high = middle - half, middle + half
    if not -math.inf < low < high < math.inf:
        raise BadVariation(name, f"{text!r} leaves nothing to vary about {middle:g}; {_USE}")
    return low, high
