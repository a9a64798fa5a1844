"""Trust: by which outputs an estimate is judged, and fitted where it restarts.

A Riccati observer is told by R how far each sensor is trusted. In units of what they can span, a sensor is trusted
span_j^2/R_j. One that is trusted less than LEAST times as much as another, and whose declared noise at a sample is
wider than all that it can span, R_j/period_j > span_j^2, says nothing of the estimate: it may be off for ever.
"""

from typing import Any

import numpy as np

from hgogen.kalman.riccati_part import Around, Riccati
from hgogen.observer import Observer
from hgogen.part import Clock
from hgogen.stepping.guards import readings
from hgogen.stepping.parallel import Parallel

LEAST = 0.01  # of the trust in the best sensor


def trusted(observer: Observer, clock: Clock) -> tuple[int, ...]:
    """The outputs by which the estimate is judged, the least trusted one first, one without a range before the others;
    all, in their order, where nothing says how far to trust them."""
    R = next((R for part in observer.parts if (R := _noise(part)) is not None), None)
    spans = np.array([high - low for low, high in readings(observer.form)])
    if R is None or not np.isfinite(spans).any():
        return tuple(range(len(spans)))
    trust = np.where(np.isfinite(spans), spans, 0.0) ** 2 / R
    periods = np.array([clock.period(j) for j in range(len(spans))])
    worthless = (trust < LEAST * trust.max()) & (trust * periods < 1) & np.isfinite(spans)
    return tuple(int(j) for j in np.argsort(trust, kind="stable") if not worthless[j])


def _noise(part: Any) -> np.ndarray | None:
    """R (p) as declared; None of an observer without one."""
    match part:
        case Riccati():
            return part.nominal[1]
        case Around():
            return _noise(part.plain)
        case Parallel():
            return next((R for each in part.member.parts if (R := _noise(each)) is not None), None)
    return None
