"""Patience: for how long an estimate may be far from where it can be (stepping/recovery.py) before it is lost.

    T = max(2 ln(100 r)/mu, 2/lambda),   T_c = max(2 ln(100 r)/nu, 2/lambda)

An observer that converges at the rate mu takes half of T to bring an error as wide as the outer box, r times the
declared one, down to a hundredth of the declared one; the other half is for poles that coincide, and for a model that
works against the gain. mu is the slowest rate of the linear error core, at the geometric mean of the ends between which
a gain moves; of a Riccati observer that of its closed loop at rest, the median over points of the box. There clear
signs are given a shorter time: nu is the geometric mean of all the rates, as if y showed slow modes least, which need
not be so.
A plant may do for a time what its model does not know, as a tank that overflows, and that takes as long as it is slow:
lambda is the geometric mean of |eigenvalues| of its Jacobian, the median over points of the box.
"""

from dataclasses import dataclass, replace
from math import log
from typing import Any

import numpy as np

from hgogen.chains.core import core, nominal, numbers
from hgogen.kalman.curvature import Curved
from hgogen.kalman.riccati import Riccati
from hgogen.observer import Clock, Observer, Ode
from hgogen.stability import closed_loop_rates
from hgogen.stepping.parallel import Parallel
from hgogen.structure.dynamics import Singular

FINE = 100  # an error so many times smaller than the declared box has settled
HIDDEN = 1e-6  # of the fastest rate: a mode so much slower is not seen, of rounding
POINTS = 6  # corners of the box, and as many points inside, at which a linearisation is judged
SAMPLES = 10  # the inverse of a rate, where none is known


@dataclass(frozen=True)
class Patience:
    """Times for which an estimate may be far, and show clear signs of it; in the model's unit."""

    far: float
    clear: float


@dataclass(frozen=True)
class Rates:
    """At which a linearised error decays, per unit of time: the slowest, and what is typical of all."""

    slow: float
    typical: float


def patience(observer: Observer, clock: Clock, r: float) -> Patience:
    """T and T_c of the module; r is by how much the outer box is wider than the declared one."""
    known, plant = rates(observer, clock), plant_rate(observer)
    least = 0.0 if plant is None else 2 / plant
    return Patience(*(max(2 * log(FINE * r) / rate, least) for rate in (known.slow, known.typical)))


def plant_rate(observer: Observer) -> float | None:
    """lambda of the module; None where the Jacobian is 0, or not finite at a point of the box."""
    try:
        slopes, _ = observer.dynamics.linearised(POINTS)
    except Singular:
        return None
    return _typical(np.abs(np.linalg.eigvals(slopes)))


def _typical(decays: np.ndarray) -> float | None:
    """The median over points (k, n) of the geometric mean of what is not of rounding; None for no point."""
    means = [np.exp(np.log(row[row > HIDDEN * row.max()]).mean()) for row in decays if row.max() > 0]
    return float(np.median(means)) if means else None


def rates(observer: Observer, clock: Clock) -> Rates:
    """Of the observer's slowest part; that of ten samples where none is known."""
    known = [rate for part in observer.parts if (rate := _rates(part, clock))]
    return min(known, key=lambda rate: rate.slow, default=Rates(*2 * (1 / (SAMPLES * clock.dt),)))


def _rates(part: Any, clock: Clock) -> Rates | None:
    match part:
        case Ode():
            firsts = {field.name: np.array(field.initial) for field in part.fields}
            middle = {name: tuple(np.sqrt(firsts[name] * most)) for name, most in part.frozen.items()}
            line = core(replace(part, frozen=middle), clock.outputs)
            matrix = part.core if line is None else numbers(line.M, clock.nominal)
            decays = np.zeros(0) if matrix is None else -np.linalg.eigvals(matrix).real.ravel()
            decays = decays[decays > 0]
            return Rates(float(decays.min()), float(decays.min())) if len(decays) else None
        case Riccati():
            decays = closed_loop_rates(*part.linearised(POINTS), *part.nominal, part.theta.late, part.scaling)
            decays = decays[decays[:, 0] > HIDDEN * decays[:, -1]]
            typical = _typical(decays)
            return None if typical is None else Rates(float(np.median(decays[:, 0])), typical)
        case Curved():
            return _rates(part.plain, clock)
        case Parallel():
            return rates(part.member, replace(clock, nominal=nominal(part.member)))
    return None
