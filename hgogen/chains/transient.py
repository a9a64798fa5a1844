"""Two step lengths of a method: from where on an error grows for ever, and one at which it hardly grows more than in
continuous time.

An error e' = M e at a fixed point becomes e <- T(h) e by a step of length h. Of the points where M is stable,
    refused   the least h from which a T(h) has an eigenvalue beyond 1
    take      half of the largest h at which max over k of |T(h)^k| <= 1.5 max over t of |exp(M t)|, of each point
Below `refused` T(h)^k can still grow far before it decays: of an n-fold eigenvalue 7, 98, 1656 fold for n = 2, 3, 4 by
classical Runge-Kutta at 90 % of `refused`. |.| is the largest sum of a row, in coordinates in which rows and columns of
M are of about the same size (`balance`), so that the powers of a high gain do not count. `take` proves nothing: it is
found at the points that are tried, between which an error moves on its way. For that is the half, which trials of the
shipped models asked for. Gains and parameters stand at their declared values: at others, to which they may be tuned,
both lengths may be shorter. By a method that is exact for the core, `take` is also at most half of what follows the
model where it oscillates or grows, 1/|lambda| of its own Jacobian. A filter's `take` is of `kalman.closed_loop`.
"""

import math
from dataclasses import replace
from functools import lru_cache
from typing import Protocol

import numpy as np

from hgogen.chains.frozen import Frozen, frozen
from hgogen.discretisation.growth import BY_TRIAL, GROWTH, WIDER, continuous, growth, longest
from hgogen.discretisation.kernels import balance
from hgogen.discretisation.stability import AXIS, Lengths, Limit, pace
from hgogen.observer import Observer
from hgogen.part import Ode

Array = np.ndarray
SHARE = 0.5
DEEPEST = 1 / 8  # of `refused`: where the search for `take` ends
SHORT, LONGEST = 0.05, 1e4  # over the fastest eigenvalue: where a search begins and ends
HALVINGS = 12  # of the interval in which `refused` lies
ROUNDING = 1e-7  # of an eigenvalue of T


class Way(Protocol):
    """A method as it moves frozen errors: of the linear core (N, N) and M (k, N, N), which may be scaled alike."""

    @property
    def exact(self) -> bool:
        """Whether the core limits no step, so that nothing but the model's own motion asks for a short one."""
        ...

    def transition(self, core: Array, M: Array, h: float) -> Array:
        """T(h) (k, N, N)."""
        ...

    def refused(self, core: Array, M: Array) -> Array:
        """The least h for each stable M (k) from which T(h) has an eigenvalue beyond 1; inf where there is none."""
        ...

    def __hash__(self) -> int:
        """Equal ways are asked once."""
        ...


def lengths(part: Ode, observer: Observer, dt: float, way: Way, core: Limit, rule: str = "") -> Lengths:
    """The step lengths of a part of the observer; `core`: what its linear core alone admits, `rule` as in `Lengths`.

    The costly `take` is computed only for a step `dt` that may exceed it.
    """
    errors, limits = _judged(part, observer), _limits(part, observer, way)
    tightest, at = core, int(limits.argmin()) if len(limits) else -1
    if limits.min(initial=math.inf) < core.dt:
        why = f"beyond it errors grow that decay in continuous time, of the estimate {errors.at(at)}"
        tightest = Limit(float(limits[at]), why, at)
    may_exceed = dt > SHARE * _shortest(errors.M, tightest.dt)
    take = _advised(part, observer, way, tightest.dt) if may_exceed else math.inf
    take = min(take, SHARE * pace(errors.blind)) if way.exact else take
    return Lengths(refused=tightest.dt, take=take, why=tightest.why, basis=BY_TRIAL, rule=rule)


@lru_cache(maxsize=16)
def _judged(part: Ode, observer: Observer) -> Frozen:
    """The stable errors, in coordinates that are balanced."""
    errors = frozen(part, observer)
    decaying = stable(errors.M)
    scale = np.ones(errors.M.shape[-1])
    balance(np.abs(np.concatenate((errors.M, errors.core[None]))).max(axis=0).reshape(-1), scale)
    M, core = (X * scale / scale[:, None] for X in (errors.M[decaying], errors.core))
    return replace(errors, M=M, points=errors.points[decaying], core=core)


@lru_cache(maxsize=16)
def _limits(part: Ode, observer: Observer, way: Way) -> Array:
    errors = _judged(part, observer)
    return way.refused(errors.core, errors.M)


@lru_cache(maxsize=16)
def _advised(part: Ode, observer: Observer, way: Way, refused: float) -> float:
    errors = _judged(part, observer)
    return advised(errors.core, errors.M, way, refused)


def stable(M: Array) -> Array:
    """Which of the M (k, N, N) have all their eigenvalues in the left half plane."""
    spectrum = np.linalg.eigvals(M)
    return np.asarray((spectrum.real < -AXIS * np.abs(spectrum).max(axis=1)[:, None]).all(axis=1))


def first_unstable(core: Array, M: Array, way: Way) -> Array:
    """`Way.refused` by trying step lengths in turn, of which the first decides: inf for the other M."""
    limits, fastest = np.full(len(M), math.inf), _fastest(M)
    if not fastest:
        return limits

    def radius(h: float) -> Array:
        return np.asarray(np.abs(np.linalg.eigvals(way.transition(core, M, h))).max(axis=1))

    good, bad = 0.0, SHORT / fastest
    while (radius(bad) <= 1 + ROUNDING).all():
        good, bad = bad, WIDER * bad
        if bad > LONGEST / fastest:
            return limits
    for _ in range(HALVINGS):
        middle = (good + bad) / 2
        good, bad = (middle, bad) if (radius(middle) <= 1 + ROUNDING).all() else (good, middle)
    limits[radius(bad).argmax()] = good
    return limits


def advised(core: Array, M: Array, way: Way, refused: float) -> float:
    """The length `take` for stable, balanced M (k, N, N), or half an eighth of `refused`; inf where there is no
    limit."""
    fastest = np.abs(np.linalg.eigvals(M)).max(axis=1, initial=0.0)
    if not fastest.any():
        return math.inf
    most = GROWTH * continuous(M, SHORT / np.where(fastest > 0, fastest, 1.0))
    end = min(refused, LONGEST / _fastest(M))

    def grows(h: float) -> bool:
        return bool((growth(way.transition(core, M, h)) > most).any())

    largest = longest(grows, _shortest(M, refused), end)
    return SHARE * (end if math.isinf(largest) and end == refused else largest)


def _shortest(M: Array, refused: float) -> float:
    """The step length at which the search for `take` ends, which follows every M in any case."""
    fastest = _fastest(M)
    return DEEPEST * refused if math.isfinite(refused) else SHORT / fastest if fastest else math.inf


def _fastest(M: Array) -> float:
    return float(np.abs(np.linalg.eigvals(M)).max(initial=0.0))
