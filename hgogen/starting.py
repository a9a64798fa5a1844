"""Starting gains of an observer from the ranges of its plant alone, without a trial.

    T = the shortest time in which a state crosses its range,   theta = 2 n/T, at least 2,   poles at -1 (times theta)
    dt = the least of 1/(20 theta) and 1/(5 lambda), lambda the fastest mode of the plant
    Q_i = S_i^2/D,  P_i(0) = S_i^2/4,  R_j = sigma_j^2 dt,   S half of the ranges, D the longest crossing time
    Q_i <= (a_i D)^2 Q_(i+1),   a_i the least |dz_i'/dz_(i+1)|, where z_i' reads no state of its chain beyond z_(i+1)

The error of a high gain decays several times while the plant crosses its range, and a step resolves both. The variance
of a state grows by its squared half range in the longest crossing time. The second line bounds this growth
by the motion of z_(i+1), which is observed through z_i' alone: its error decays at about a_i sqrt(Q_(i+1)/Q_i),
whatever R is. For a requested dt, theta is at most 1/(20 dt), and at least 1. The default noise sigma of a sensor is 1
% of half its range Y, the declared one, else the range that follows from states and inputs. Where no state moves, or no
range is known, T = D = 1, S = Y = 1.

Each observer has a rule in its own file that computes its gains from these numbers, bound to it by `starts`.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from inspect import signature
from typing import Any, TypeVar

import numpy as np

from hgogen.analysis.linearised import NoLinearisation, Pace, pace, slopes
from hgogen.form import Form
from hgogen.observer import Observer
from hgogen.reading.given import BadGain, cached, positive
from hgogen.signal import LOST
from hgogen.stepping.guards import readings
from hgogen.system import System

PER_SAMPLE = "R_per_sample"  # the argument of filters that is R over the period
MANY = 6  # states: with more the search for a bound on a gain takes seconds
Gains = dict[str, Any]
Make = TypeVar("Make", bound=Callable[..., Observer])


@dataclass(frozen=True)
class Scale:
    """The numbers from which starting gains are computed: theta, dt and the longest time D in which a state crosses its
    range (`longest`), in the plant's time; ranges S and process scales Q by the form's states (`states`, `process`);
    ranges Y and noise sigma by output (`outputs`, `noise`); the lengths of the chains (`blocks`). `spread`: the ratio
    of the fastest to the slowest pole, of poles about -1; `corner`: the speed of filters over theta; `discrete`:
    whether the plant is, so that R and Q are those of a sample."""

    theta: float
    dt: float
    longest: float
    states: Mapping[str, float]
    process: Mapping[str, float]
    outputs: Mapping[str, float]
    noise: Mapping[str, float]
    blocks: tuple[int, ...]
    spread: float = 1
    corner: float = 3
    discrete: bool = False

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.states)

    @property
    def units(self) -> dict[str, float]:
        """The process noise S_i^2/D by the name of state i: its variance grows by S_i^2 in the time D."""
        return {name: s * s * (1 / self.longest) for name, s in self.states.items()}

    @property
    def poles(self) -> Any:
        """The poles, all at -1 or spread about it with geometric mean -1, as a tuple for each chain if there are
        several."""
        each = tuple(tuple(-whole(two_digits(self.spread**k)) for k in evenly(size)) for size in self.blocks)
        return each[0] if len(each) == 1 else each

    @property
    def high(self) -> Gains:
        """The gains `theta` and `poles`, as most high-gain observers accept them."""
        return {"theta": self.theta, "poles": self.poles}

    @property
    def kalman(self) -> Gains:
        """The gains Q, R and P(0), as Kalman filters accept them."""
        return {"Q": self.density(), "R": self.variance(), "covariance": self.start()}

    @property
    def reading(self) -> float:
        """The half-width Y of the range of the first output."""
        return next(iter(self.outputs.values()))

    def start(self, exponent: int = 1) -> Gains:
        """Return P_i(0)^exponent by the name of state i: P_i(0), or for -1 its inverse."""
        return {name: weight(two_digits(s * s / 4) ** exponent) for name, s in self.states.items()}

    def density(self, exponent: int = 1) -> Gains:
        """Return Q_i^exponent by the name of state i: the process noise Q_i, or for -1 its inverse."""
        return {name: weight(two_digits(q) ** exponent) for name, q in self.process.items()}

    def variance(self, exponent: int = 1) -> Any:
        """Return R_j^exponent by the name of output j, a number for one output: the variance R_j, or for -1 its
        inverse."""
        each = {name: weight((sigma**2 * self.dt) ** exponent) for name, sigma in self.noise.items()}
        return each if len(each) > 1 else next(iter(each.values()))


@dataclass(frozen=True)
class Rule:
    """The description of an observer in the documentation, and its rule for starting gains.

    `where`: when to use it; `asks`: what the user must provide; `state`: how many numbers it stores for n states;
    `gains`: its starting gains, or a sentence why it has none; `quick`: the number of states up to which these are
    computed without delay, 0 if they need a solver; `costly`: whether it takes seconds to build with any gains.
    """

    where: str = ""
    asks: str = ""
    state: str = ""
    gains: Callable[[Scale], Gains | str] = lambda scale: "no rule for them stands beside it"
    quick: float = MANY
    costly: bool = False


def starts(
    where: str,
    asks: str,
    state: str,
    gains: Callable[[Scale], Gains | str],
    quick: float = MANY,
    costly: bool = False,
) -> Callable[[Make], Make]:
    """Return a decorator that attaches a `Rule` with these fields to an observer, as its attribute `rule`."""

    def tied(make: Make) -> Make:
        vars(make)["rule"] = Rule(where, asks, state, gains, quick, costly)
        return make

    return tied


def rule(observer: Callable[..., Observer]) -> Rule:
    """Return the `Rule` of an observer: when to use it, and its starting gains; or the empty rule."""
    attached: Rule = getattr(observer, "rule", Rule())
    return attached


@dataclass(frozen=True)
class Starting:
    """Starting gains by argument of the observer, with a sampling period `dt`, or the shortest and the longest; `none`:
    a sentence why there are none."""

    gains: Mapping[str, Any]
    dt: float | tuple[float, float]
    none: str = ""

    def __bool__(self) -> bool:
        return not self.none


def longest(dt: Any) -> float:
    """Return the period `dt`; for a pair (shortest, longest) the longest."""
    return float(dt[-1] if isinstance(dt, list | tuple) else dt)


def per_sample(observer: Callable[..., Observer], gains: Mapping[str, Any], dt: float) -> dict[str, Any]:
    """Return the gains of an observer for a step in which dt varies: R, a density at the period `dt`, is replaced by
    the variance R/dt of one sample. Gains without R, or of an observer without R_per_sample, are unchanged."""
    if "R" not in gains or PER_SAMPLE not in signature(observer).parameters:
        return dict(gains)

    def variance(density: Any) -> Any:
        if isinstance(density, Mapping):
            return {name: variance(each) for name, each in density.items()}
        return (np.asarray(density) / dt).tolist()

    return {PER_SAMPLE if key == "R" else key: variance(each) if key == "R" else each for key, each in gains.items()}


def starting_gains(
    form: Form,
    observer: Callable[..., Observer],
    *,
    dt: float | None = None,
    noise: Mapping[str, float] | None = None,
) -> Starting:
    """Return starting gains on a form for one of `hg.observers`: `observer(form, **start.gains)`, at the dt `start.dt`.

    Args: `dt` the sampling period, in the plant's time, where it is fixed; `noise` the standard deviation of a sample
    by output, where it is known.

    Raises: `BadGain` for a value that is no form or no observer, and for a dt or a noise that is not positive.
    """
    if not isinstance(form, Form):
        raise BadGain(
            "starting_gains", f"takes a form, such as hg.forms.triangular(plant), not a {type(form).__name__}"
        )
    if not callable(observer):
        raise BadGain(f"observer = {observer!r}", "must be one of hg.observers, such as hg.observers.high_gain")
    numbers = scale(form, dt, noise)
    gains, period = gains_of(observer, numbers), dt or numbers.dt
    return Starting({}, period, gains) if isinstance(gains, str) else Starting(gains, period)


def gains_of(observer: Callable[..., Observer], numbers: Scale) -> Gains | str:
    """Return the starting gains of an observer for the `numbers` of a plant, or a sentence why there are none."""
    try:
        return rule(observer).gains(numbers)
    except ArithmeticError:
        return f"they are beyond {LOST:g}; give the signals other units"


def scale(form: Form, dt: float | None = None, noise: Mapping[str, float] | None = None) -> Scale:
    """Return the numbers T, theta, dt, S, .. from which the starting gains on a form are computed, with a fixed period
    `dt` and the noise by output where known. Raises: `BadGain`, as `starting_gains`."""
    dt, noise = None if dt is None else positive("dt", dt), _sigmas(form, noise)
    dt = 1.0 if form.system.discrete else dt
    rates = _pace(form.system)
    theta = max(2.0, two_digits(2 * form.n / rates.shortest)) if rates.shortest else 2.0 * form.n
    if dt is None:
        of_times = (float(time.turn) / 20 for time in form.system.times)
        dt = two_digits(min(1 / (20 * theta), 1 / (5 * rates.fastest) if rates.fastest else math.inf, *of_times))
    else:
        theta = max(1.0, min(theta, two_digits(1 / (20 * dt))))
    states = {name: _span(*z.interval) for name, z in zip(form.names, form.states, strict=True)}
    outputs = {y.name: _span(*ends) for y, ends in zip(form.system.outputs, readings(form), strict=True)}
    deviations = {name: noise.get(name, y / 100) for name, y in outputs.items()}
    longest = rates.longest or 1.0
    chains = tuple(filter(None, form.blocks))
    base = Scale(theta, dt, longest, states, {}, outputs, deviations, chains, discrete=form.system.discrete)
    process = dict(base.units)
    for i, slope in reversed(_slopes(form).items()):  # from the end of each chain
        name, behind = form.names[i], form.names[i + 1]
        process[name] = min(process[name], (slope * base.longest) ** 2 * process[behind])
    return replace(base, process=process)


def _slopes(form: Form) -> dict[int, float]:
    """Return, by the index i, the least |dz_i'/dz_(i+1)| at sample points of the box; only for derivatives of one sign
    there."""
    chains = [form.states[head : head + size] for head, size in zip(form.heads, form.blocks, strict=True)]
    links = [(z, chain[k + 1], {*chain[k + 2 :]}) for chain in chains for k, z in enumerate(chain[:-1])]
    flow = dict(zip(form.states, form.flow, strict=True))
    rows = {z: (flow[z], behind) for z, behind, beyond in links if not flow[z].free_symbols & beyond}
    try:
        values = slopes([*rows.values()], (*form.states, *form.system.inputs), form.system.nominal)
    except NoLinearisation:
        return {}
    one_sided = np.abs(values).min(axis=0) * (np.abs(np.sign(values).sum(axis=0)) == len(values))
    return {form.states.index(z): float(a) for z, a in zip(rows, one_sided, strict=True) if a > 0}


def _sigmas(form: Form, noise: Mapping[str, float] | None) -> Mapping[str, float]:
    if noise is not None and not isinstance(noise, Mapping):
        raise BadGain(f"noise = {noise!r}", "must be a standard deviation for each output by its name, as {'y': 0.01}")
    names = [y.name for y in form.system.outputs]
    for name, sigma in (noise or {}).items():
        if name not in names:
            raise BadGain(f"noise of {name!r}", f"is of no output; the outputs are {', '.join(names)}")
        positive(f"noise of {name!r}", sigma)
    return noise or {}


@cached
def _pace(plant: System) -> Pace:
    try:
        return pace(plant)
    except NoLinearisation:  # ranges are missing: T = D = 1
        return Pace(1.0, 1.0, 0.0)


def evenly(count: int) -> list[float]:
    """Return `count` evenly spaced numbers from -1/2 to 1/2; [0] for one."""
    return [k / (count - 1) - 0.5 if count > 1 else 0.0 for k in range(count)]


def whole(value: float) -> float:
    """Return `value`, as an int if it is a whole number."""
    return int(value) if value == int(value) else value


def _span(low: float, high: float) -> float:
    half = (high - low) / 2
    return half if 0 < half < math.inf else 1.0


def two_digits(value: float) -> float:
    """Return a number rounded to two significant digits."""
    return float(f"{value:.1e}")


def weight(value: float) -> float:
    """Return a weight of a filter, such as 1/Q_i, in two digits. Raises: `OverflowError` beyond the limit of
    weights."""
    if not value <= LOST:
        raise OverflowError
    return two_digits(value)
