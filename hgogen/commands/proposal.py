"""First gains of an observer, from the ranges of its plant alone: a place to begin, tuned by no trial.

    T = the shortest time in which a state crosses its range,   theta = 2 n/T, at least 2,   poles at -1 (times theta)
    dt = the least of 1/(20 theta) and 1/(5 lambda), lambda the fastest mode of the plant
    Q_i = S_i^2/D,  P_i(0) = S_i^2/4,  R_j = (Y_j/100)^2 dt,   S, Y half of the ranges, D the longest crossing time

so that the error of a high gain decays some times while the plant crosses its range, a step resolves both, a state may
wander over its range in the time that it takes to cross it, and a sensor errs by 1 % of half its range, the declared
one, else what the ranges of states and inputs give. Where nothing moves, or no range is known, T = D = 1, S = Y = 1.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hgogen.form import Form
from hgogen.signal import Signal
from hgogen.stepping.guards import readings
from hgogen.system import System
from hgogen.trials.sight import NoSight, Pace, pace

Gains = dict[str, Any]


@dataclass(frozen=True)
class Scale:
    """What the rules read: theta, dt and D in the plant's time, S by the names of the form's states, Y of outputs."""

    theta: float
    dt: float
    longest: float
    states: Mapping[str, float]
    outputs: Mapping[str, float]
    blocks: tuple[int, ...]

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.states)

    @property
    def poles(self) -> Any:
        """All at -1, a tuple for each chain where there are several."""
        each = tuple((-1,) * size for size in self.blocks)
        return each[0] if len(each) == 1 else each

    @property
    def reading(self) -> float:
        """Y of the first output."""
        return next(iter(self.outputs.values()))

    def squares(self, factor: float) -> Gains:
        """S_i^2 times a factor, by name."""
        return {name: _two(s * s * factor) for name, s in self.states.items()}

    def noise(self, exponent: int = 1) -> Any:
        """R, or its inverse, a number for one output."""
        each = {name: _two(((y / 100) ** 2 * self.dt) ** exponent) for name, y in self.outputs.items()}
        return each if len(each) > 1 else next(iter(each.values()))


@dataclass(frozen=True)
class Proposal:
    """Where to take an observer, and its first gains, or `none`: why it has none, where `like` is admitted,
    an observer for the same plants. `filtering`: whether it is sampled
    with its covariance, by the default method, or as a differential equation, by Runge and Kutta; `dear`: whether it
    asks a solver for its proof, which takes seconds."""

    where: str
    gains: Callable[[Scale], Gains] | None = None
    filtering: bool = False
    dear: bool = False
    none: str = ""
    like: str = ""


def scale(form: Form) -> Scale:
    """The numbers that the rules take of a form and its plant."""
    rates = _pace(form.system)
    theta = max(2.0, _two(2 * form.n / rates.shortest)) if rates.shortest else 2.0 * form.n
    dt = min(1 / (20 * theta), 1 / (5 * rates.fastest) if rates.fastest else math.inf)
    states = dict(zip(form.names, map(_half, form.states), strict=True))
    outputs = {y.name: _span(*ends) for y, ends in zip(form.system.outputs, readings(form), strict=True)}
    return Scale(theta, _two(dt), rates.longest or 1.0, states, outputs, form.blocks)


def _pace(plant: System) -> Pace:
    try:
        return pace(plant)
    except NoSight:  # ranges are missing: a time and a range of 1, as the first lines say
        return Pace(1.0, 1.0, 0.0)


def _half(signal: Signal) -> float:
    return _span(*signal.interval)


def _span(low: float, high: float) -> float:
    """Half of what lies between two ends, 1 of ends that are not known, and of an output that stands still."""
    half = (high - low) / 2
    return half if 0 < half < math.inf else 1.0


def _two(value: float) -> float:
    """Two digits."""
    return float(f"{value:.1e}")


def _high(scale: Scale) -> Gains:
    return {"theta": scale.theta, "poles": scale.poles}


def _filter(scale: Scale) -> Gains:
    """A filter of n states, each behind the one before, that decays three times as fast as the core."""
    n = scale.n
    F = -3 * np.eye(n, dtype=int) + np.eye(n, k=-1, dtype=int)
    H = np.diag([math.comb(n, i) for i in range(1, n + 1)])
    rows: list[Any] = [tuple(tuple(int(v) for v in row) for row in matrix) for matrix in (F, H)]
    return {"theta": scale.theta, "F": rows[0], "G": (1, *(0,) * (n - 1)), "H": rows[1]}


def _switched(scale: Scale) -> Gains:
    low = max(1.0, _two(scale.theta / 4))
    return {
        "theta": max(scale.theta, 2 * low),
        "theta_low": low,
        "threshold": _two(scale.reading / 20),
        "hold": _two(2 / low),
        "poles": scale.poles,
    }


def _tracking(scale: Scale) -> Gains:
    y = scale.reading
    return {
        "k_0": _two(scale.theta / 2),
        "k_max": _two(10 * scale.theta),
        "gamma": _two((scale.theta / y) ** 2),
        "strip": _two(y / 50),
        "reach": _two(y / 2),
        "poles": scale.poles,
        "model": True,
    }


def _updated(scale: Scale) -> Gains:
    return {"p_1": 0.15, "p_2": max(1.0, _two(scale.theta / 2)), "p_3": 6, "cap": _two(10 * scale.theta)} | {
        "poles": scale.poles,
        "b": scale.n / 2,
    }


def _kalman(scale: Scale) -> Gains:
    return {"Q": scale.squares(1 / scale.longest), "R": scale.noise(), "covariance": scale.squares(1 / 4)}


def _weights(scale: Scale) -> Gains:
    """The inverses of a Kalman filter's."""
    told = {"Q": scale.squares(1 / scale.longest), "P0": scale.squares(1 / 4)}
    inverse = {gain: {name: _two(1 / v) for name, v in values.items()} for gain, values in told.items()}
    return {**inverse, "R": scale.noise(-1)}


# Where to take each is the column of that name in docs/observers.md.
PROPOSALS: Mapping[str, Proposal] = {
    "high_gain": Proposal("you begin: the model is known, the noise small", _high),
    "low_power": Proposal("n is 4 or more: no power of theta above 2", lambda s: {"theta": s.theta}),
    "peaking_free": Proposal(
        "as `low_power`, and nothing may peak before it settles", lambda s: {"theta": s.theta}, dear=True
    ),
    "filtered": Proposal(
        "the noise is at high frequency: it rolls off faster", lambda s: {**_high(s), "alpha": 3, "beta": 1}
    ),
    "filtered_injection": Proposal("you have a filter of your own for the injection", _filter),
    "switched_gain": Proposal("it should settle fast and then be quiet", _switched),
    "updated_gain": Proposal("the model is steep in places only", _updated),
    "adaptive_lmi": Proposal(
        "the gain should rise with the error, and fall again",
        none="its K and P solve matrix inequalities, which design.adaptive_gain of hgogen does, in Python",
        like="filtered",
    ),
    "stubborn": Proposal("the sensor has outliers", lambda s: {**_high(s), "decay": 0.5, "r": 3}),
    "dead_zone": Proposal("small noise should not be injected at all", lambda s: {**_high(s), "decay": 1, "r": 0.3}),
    "cascade": Proposal("there is no model of the last row", lambda s: {"theta": s.theta}),
    "lambda_tracking": Proposal("there is no model of phi and no idea of a gain", _tracking),
    "riccati": Proposal(
        "the noise is known (theta = 1 is the Kalman filter), there are several outputs, or a_i varies with u",
        _kalman,
        filtering=True,
    ),
    "hamilton_jacobi": Proposal("you think in weights of a cost", _weights, filtering=True),
    "kalman_like": Proposal(
        "a_i(u) vanishes at times and the plant is state-affine",
        lambda s: {"rho": _two(1 / s.longest), "R": s.noise(), "covariance": s.squares(1 / 4)},
        filtering=True,
    ),
    "bank": Proposal(
        "jumps come and no threshold for them is known",
        none="it goes around another observer: tune that one, then name it as the member, with count = 3 and for the "
        "period the time that it takes to settle",
        like="riccati",
    ),
}
