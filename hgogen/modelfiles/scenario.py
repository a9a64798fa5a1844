"""What a trial is made of, and as what each of its fields may be given.

noise     n_{k+1} = rho n_k + sigma sqrt(1 - rho^2) g_k,  rho = exp(-dt/tau),  n_0 = sigma g_0;  or a sin(omega t)
jump      x_i becomes a value at a time
settled   |error of x_i| <= band for a while
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

import numpy as np

from hgogen.errors import HgogenError
from hgogen.modelfiles.setting import SEEDS
from hgogen.reading import filename
from hgogen.reading.door import scalar
from hgogen.reading.expression import parse
from hgogen.signal import Signal

FEW = 16  # columns, up to which lists are faster than rows of an array; the numbers are the same
t = Signal("t", "", "time")  # inputs of a trial are expressions of this


@dataclass(eq=False)
class BadTrial(HgogenError):
    """A trial that does not fit its plant, or that cannot be integrated."""

    trial: str
    reason: str

    def __str__(self) -> str:
        return f"trial {filename.shown(self.trial)}: {self.reason}"


@dataclass(frozen=True)
class OrnsteinUhlenbeck:
    """Noise of standard deviation `sigma` (the output's unit) and correlation time `tau`, 0 for white."""

    sigma: float
    tau: float = 0.0

    def at(self, times: np.ndarray, rngs: Sequence[np.random.Generator]) -> np.ndarray:
        """The noise (N, k) at evenly spaced `times` (N) of each of k generators."""
        normal = np.column_stack([rng.standard_normal(len(times)) for rng in rngs])
        rho = math.exp(-(times[1] - times[0]) / self.tau) if self.tau > 0 else 0.0
        scaled = self.sigma * normal
        scaled[1:] *= math.sqrt(1.0 - rho * rho)
        if scaled.shape[1] < FEW:
            return np.column_stack([_recursion(column.tolist(), rho) for column in scaled.T])
        return np.asarray(_recursion(scaled, rho))


@dataclass(frozen=True)
class Sine:
    """A tone of `amplitude` (the output's unit) and frequency `omega` (rad per time), the same for every seed."""

    amplitude: float
    omega: float

    def at(self, times: np.ndarray, rngs: Sequence[np.random.Generator]) -> np.ndarray:
        """The noise (N, k) at `times` (N)."""
        return np.tile(self.amplitude * np.sin(self.omega * times)[:, None], len(rngs))


@dataclass(frozen=True)
class Jump:
    """At `time` the state `state` becomes `value`."""

    time: float
    state: str
    value: float


@dataclass(frozen=True)
class Settled:
    """What "settled" means: |error of `state`| <= `band` for `hold` from then on."""

    state: str
    band: float
    hold: float


def _recursion(values: Any, rho: float) -> Any:
    """values_k + rho values_(k-1), in place, of a list of numbers or of the rows of an array."""
    for k in range(1, len(values)):
        values[k] += rho * values[k - 1]
    return values


# --- as what a field may be given ---------------------------------------------------------------------------


def read_field(trial: Any, key: str, value: Any) -> Any:
    """A trial's field `key` of what is given for it: a count of seeds, one jump alone, and a standard deviation for a
    noise are turned into what they stand for. Raises: `BadTrial`."""
    if key not in _FIELDS:
        return value
    reader, wanted = _FIELDS[key]
    try:
        return reader(value)
    except HgogenError as error:
        raise BadTrial(str(trial), f"{key}: {error}") from None
    except (TypeError, ValueError, OverflowError):
        raise BadTrial(str(trial), f"{key} = {filename.shown(value)} must be {wanted}") from None


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


def _number(value: Any) -> Any:
    if isinstance(value, bool | str):
        raise TypeError
    float(value)
    return value


def _each(reader: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda entries: {_text(name): reader(value) for name, value in dict(entries).items()}


def _input(value: Any) -> Any:
    return parse(value, {"t": t}) if isinstance(value, str) else scalar(value, "an input")


def _noise(value: Any) -> Any:
    noise = OrnsteinUhlenbeck(_number(value)) if isinstance(value, Real) else value
    return _of(noise, OrnsteinUhlenbeck | Sine)


def _jumps(jumps: Any) -> tuple[Jump, ...]:
    return tuple(_of(one, Jump) for one in ((jumps,) if isinstance(jumps, Jump) else jumps))


def _of(entry: Any, kind: Any) -> Any:
    """A value of a class above, whose fields are numbers, but for the name of a state."""
    if not isinstance(entry, kind):
        raise TypeError
    for key, value in vars(entry).items():
        (_text if key == "state" else _number)(value)
    return entry


def _seeds(seeds: Any) -> tuple[int, ...]:
    if isinstance(seeds, Integral) and not isinstance(seeds, bool):
        if int(seeds) > SEEDS:
            raise ValueError
        seeds = range(int(seeds))
    seeds = tuple(seeds)
    if not all(isinstance(seed, Integral) and not isinstance(seed, bool) and int(seed) >= 0 for seed in seeds):
        raise ValueError
    return tuple(map(int, seeds))


def _unless_none(reader: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda value: None if value is None else reader(value)


_STATE = "a number for each state by name, such as {'x1': 1.0}"
_FIELDS: dict[str, tuple[Callable[[Any], Any], str]] = {
    "name": (lambda name: filename.demand(_text(name)), "text"),
    "duration": (_number, "a number"),
    "start": (_each(_number), _STATE),
    "estimate": (_each(_number), _STATE),
    "inputs": (_each(_input), "an expression of hgogen.trial.t, or a number, for each input by name"),
    "noise": (_each(_noise), "a standard deviation, an OrnsteinUhlenbeck or a Sine for each output by name"),
    "jumps": (_jumps, "a Jump(time, state, value), or several in a tuple"),
    "settled": (_unless_none(lambda value: _of(value, Settled)), "a Settled(state, band, hold), or None"),
    "steady": (_unless_none(_number), "a number, or None"),
    "seeds": (_seeds, f"a count from 1 to {SEEDS}, or whole numbers from 0 in a tuple, such as (0, 1)"),
}
