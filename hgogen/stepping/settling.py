"""Settling time T: for how long an estimate may show the sign of a fault (stepping/recovery.py) before a guard acts.

    T = max(2 ln(100 r)/mu, 2/lambda)

An observer that converges at the rate mu takes half of T to bring an error as wide as the outer box, r times the
declared one, down to a hundredth of the declared one; the other half is for poles that coincide, and for a model that
works against the gain. mu is the slowest rate of the linear error core, at the geometric mean of the ends between which
a gain moves; of a Riccati observer the geometric mean of those of its closed loop at rest, the median over points of
the box, as if slow modes were the least observable. That need not be so: a filter that is slower restarts, and then
waits for longer. One that forgets at the rate rho has no slower mode than rho/2: its closed loop is that of F + rho/2.
A plant may do for a time what its model does not know, as a tank that overflows, and that takes as long as it is slow:
lambda is the geometric mean of |eigenvalues| of its Jacobian, the median over points of the box.
"""

from dataclasses import replace
from math import log
from typing import Any

import numpy as np

from hgogen.analysis.linearised import Singular, jacobians_on_box
from hgogen.discretisation.stability import closed_loop_rates
from hgogen.estimators.core import core, nominal, numbers
from hgogen.estimators.riccati_part import Around, Riccati
from hgogen.observer import Observer
from hgogen.part import Clock, Ode
from hgogen.stepping.parallel import Parallel

FINE = 100  # an error so many times smaller than the declared box has settled
HIDDEN = 1e-6  # of the fastest rate: a slower mode is a rounding error
POINTS = 6  # corners of the box, and as many points inside, at which a linearisation is judged
SAMPLES = 10  # the inverse of a rate, where none is known


def settling_time(observer: Observer, clock: Clock, r: float) -> float:
    """T of the module, in the model's unit; r is by how much the outer box is wider than the declared one."""
    plant = plant_rate(observer)
    return max(2 * log(FINE * r) / rate(observer, clock), 0.0 if plant is None else 2 / plant)


def plant_rate(observer: Observer) -> float | None:
    """The rate lambda of the module; None where the Jacobian is 0, or not finite at a point of the box."""
    try:
        slopes, _ = jacobians_on_box(observer.dynamics, POINTS)
    except Singular:
        return None
    return _typical(np.abs(np.linalg.eigvals(slopes)))


def _typical(decays: np.ndarray) -> float | None:
    """The median over points (k, n) of the geometric mean of what is not of rounding; None for no point."""
    means = [np.exp(np.log(row[row > HIDDEN * row.max()]).mean()) for row in decays if row.max() > 0]
    return float(np.median(means)) if means else None


def rate(observer: Observer, clock: Clock) -> float:
    """The rate mu of the observer's slowest part; that of ten samples where none is known."""
    known = [mu for part in observer.parts if (mu := _rate(part, observer, clock)) is not None]
    return min(known, default=1 / (SAMPLES * clock.dt))


def _rate(part: Any, observer: Observer, clock: Clock) -> float | None:
    match part:
        case Ode():
            firsts = {field.name: np.array(field.initial) for field in part.fields}
            middle = {name: tuple(np.sqrt(firsts[name] * most)) for name, most in part.frozen.items()}
            line = core(replace(part, frozen=middle), clock.outputs)
            matrix = part.core if line is None else numbers(line.M, nominal(observer))
            if matrix is None or not np.isfinite(matrix).all():
                return None
            decays = -np.linalg.eigvals(matrix).real.ravel()
            return min(decays[decays > 0].tolist(), default=None)
        case Riccati():
            decays = closed_loop_rates(*part.linearised(POINTS), *part.nominal, part.theta.late, part.scaling)
            if part.forgetting is not None:
                decays = np.maximum(decays, part.forgetting.initial[0] / 2)
            return _typical(decays[decays[:, 0] > HIDDEN * decays[:, -1]])
        case Around():
            return _rate(part.plain, observer, clock)
        case Parallel():
            return rate(part.member, clock)
    return None
