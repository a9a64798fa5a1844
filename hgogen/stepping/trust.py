"""Trust: by which outputs an estimate is judged, and fitted where it restarts, and how large an innovation it expects.

A Riccati observer is told by R how far each sensor is trusted. In units of what they can span, a sensor is trusted
span_j^2/R_j. One that is trusted less than LEAST times as much as another, and whose declared noise at a sample is
wider than all that it can span, R_j/period_j > span_j^2, says nothing of the estimate: it may be off for ever.

The variance of the innovation, before the correction by y_j with r = R_theta/period_j and c = dh_j/dz, is c P c' + r.
After it, as the law of recovery reads P, c P c' has become p = r c P c'/(c P c' + r), so that the variance is
r^2/(r - p). A method that integrates with the measurement corrects by little in a step: p + r.
"""

from typing import Any

import casadi as ca
import numpy as np

from hgogen.graph import Graph
from hgogen.kalman.riccati_part import Around, Riccati
from hgogen.observer import Observer
from hgogen.part import Clock, Pieces
from hgogen.stepping.guards import readings
from hgogen.stepping.parallel import Parallel

LEAST = 0.01  # of the trust in the best sensor
ROUNDED = 2.0**-20  # of r: what is left of it by a sample is rounding below


def trusted(observer: Observer, clock: Clock) -> tuple[int, ...]:
    """The outputs by which the estimate is judged, the least trusted one first, one without a range before the others;
    all, in their order, where nothing says how far to trust them."""
    part = _filter(observer)
    spans = np.array([high - low for low, high in readings(observer.form)])
    if part is None or not np.isfinite(spans).any():
        return tuple(range(len(spans)))
    trust = np.where(np.isfinite(spans), spans, 0.0) ** 2 / part.nominal[1]
    periods = np.array([clock.period(j) for j in range(len(spans))])
    worthless = (trust < LEAST * trust.max()) & (trust * periods < 1) & np.isfinite(spans)
    return tuple(int(j) for j in np.argsort(trust, kind="stable") if not worthless[j])


def noisier_than_best(observer: Observer, j: int) -> float:
    """How many times larger the standard deviation of output j is than that of the best sensor, in units of what they
    can span; 1 where nothing says."""
    part, spans = _filter(observer), np.array([high - low for low, high in readings(observer.form)])
    if part is None:
        return 1.0
    trust = np.where(np.isfinite(spans), spans, 0.0) ** 2 / part.nominal[1]
    return float(np.sqrt(trust.max() / trust[j])) if trust[j] > 0 else 1.0


def innovation_variance(observer: Observer, clock: Clock, pieces: Pieces, j: int) -> Graph | None:
    """The variance of the innovation of output j as the filter knows it after the sample, SX; R_j/period_j alone where
    P is not at hand, None of an observer without a noise."""
    part = _filter(observer)
    if part is None:
        return None
    if pieces.covariance is None:
        return part.R[j] / clock.period(j)
    c = ca.sparsify(part.dynamics.output_jacobian(observer.z, clock.u_now)[j, :])
    r = part.scaling.variance(part.R[j], part.theta.value, j, clock.period(j))
    p = ca.dot(c, c @ pieces.covariance)
    return r * r / ca.fmax(r - p, ROUNDED * r) if pieces.update else r + p


def _filter(observer: Observer) -> Riccati | None:
    """The Riccati part of an observer, or of a bank's member; None without one."""
    return next((each for each in map(_riccati, observer.parts) if each is not None), None)


def _riccati(part: Any) -> Riccati | None:
    match part:
        case Riccati():
            return part
        case Around():
            return part.plain
        case Parallel():
            return _filter(part.member)
    return None
