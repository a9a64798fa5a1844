"""A comparison of gains: the rate of decay, the effect of noise on each state, and the longest step.

The first two are for continuous time, where a gain is designed. Then follow, for the step of each gain, the effect of
noise at its dt, and the longest dt with a proof.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Annotated

from hgogen import observers
from hgogen.call import CallableStep, sample
from hgogen.certificates.contraction import contraction
from hgogen.certificates.input_gains import NoiseGain, noise_gain
from hgogen.observer import Observer
from hgogen.prove.convergence import Flow
from hgogen.prove.gain_design import Gain
from hgogen.prove.gain_design import gain as gain_for
from hgogen.prove.inclusion import Nothing
from hgogen.prove.questions import Bounds, noise_bounds, theta_of
from hgogen.step import StepTooLong

_HALVINGS = 20  # the most halvings of a refused dt
_GUESS = 4.0  # theta over the guess of its rate, where none is proved


@dataclass(frozen=True)
class Point:
    """A point on the trade-off curve of decay rate against noise: an `observer` with its proved rate and noise bounds.
    `gain`: the designed gain, None for one from the user; `continuous`, `step`: the bounds of errors under noise of at
    most 1, by (state, output), in continuous time and for the step at its dt, {} where none are proved."""

    observer: Observer = field(repr=False)
    gain: Gain | None
    wanted: Annotated[float | None, "the rate it is designed for; null for the tuning"]
    rate: Annotated[float | None, "rate of decay proved in continuous time; null: none"]
    continuous: Bounds
    longest: Annotated[float | None, "dt up to which its step is proved; null: none"]
    step: Bounds

    @property
    def about(self) -> float:
        """The proved rate of decay (1/time); theta/4, as a guess, where none is proved."""
        return float(theta_of(self.observer)) / _GUESS if self.rate is None else self.rate


def tuned(step: CallableStep) -> Point:
    """Return the point of the trade-off curve of a step with its own gains, for an observer with a constant injection
    gain. Raises: `NoSolver`."""
    error, known = step.observer.error, noise_bounds(step.observer)
    falls = None if error is None or isinstance(error, Nothing) else Flow(error, theta_of(step.observer)).fastest
    bounds: Mapping[tuple[str, str], float] = {} if isinstance(known, Nothing) else known
    return _as_it_runs(Point(step.observer, None, None, falls.rate if falls else None, bounds, None, {}), step)


def designed(like: CallableStep, rate: float, argument: bool = False) -> Point:
    """Return the point of the trade-off curve of a gain that is designed for a decay `rate` (1/time), for the form, dt
    and method of the step `like`; with `argument` also an N in b(z + N (y - C z)) is designed. Raises: `NoSolver`, and
    the errors of `hg.design.gain`, the observer and `sample`."""
    form = like.observer.form
    gain = gain_for(form, rate=rate, argument=argument)
    observer = getattr(observers, gain.observer)(form, **gain.arguments)
    point = Point(observer, gain, rate, gain.rate, gain.bounds, None, {})
    dt = Fraction(like.clock.dt)
    for _ in range(_HALVINGS):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # about a long dt: the question is the longest with a proof
                step = sample(observer, like.method, float(dt), between=like.clock.between, guards=like.clock.guards)
            return _as_it_runs(point, step, like.dt)
        except StepTooLong:
            dt /= 2
    return point


def _as_it_runs(point: Point, step: CallableStep, dt: float | None = None) -> Point:
    longest, noise = contraction(step).reach.longest, noise_gain(step) if dt in (None, step.dt) else None
    gains = noise.gains if isinstance(noise, NoiseGain) else {}
    return replace(point, longest=None if longest is None else float(longest), step=gains)
