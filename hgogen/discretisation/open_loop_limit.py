"""The longest step at which a model is followed while samples are missing, over the declared ranges.

While no sample comes, an error of the estimate moves as e' = F e, F the model's Jacobian. A step of length h multiplies
a mode of the eigenvalue lambda by R(h lambda), R the method's stability polynomial. With Re lambda < 0 the mode decays,
and the step follows it up to the first exit of the ray h lambda from the region |R| <= 1. A mode that does not decay
in the plant is no fault of the step, and limits nothing; nor is one whose damping ratio is below DAMPING, which is in
the plant next to one that grows: where damping vanishes somewhere in the ranges, no step would be short enough. The
limit is the least first exit of all decaying modes over
the ranges, so that for every longer dt some point of the ranges has an estimate that diverges, and for no shorter one
that was found.

The least is sought from the middle, corners and random points of the ranges, and from the best of these by moving one
coordinate at a time, to its ends and by steps that halve. That refutes a longer step; a shorter limit may exist.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hgogen.discretisation.runge_kutta import Tableau
from hgogen.discretisation.stability import AXIS, Lengths, spectral_limit

Array = np.ndarray
Slopes = Callable[[Array], Array]
RANDOM = 64  # random points, and as many corners at most
STARTS = 4  # points from which the search goes on
FIRST, SHORTEST = 2.0**-2, 2.0**-10  # of a range: the first and the last step of the search
EDGE = 0.005  # of a range that is left out at its ends where F is not finite at a corner: no plant stays there
ANGLES = 181  # of the half plane Re < 0, between which the search interpolates the first exit
DAMPING = 1e-3  # of a mode that decays: by .6 % in a turn
SEARCHED = "sought over the declared ranges, no proof"


@dataclass(frozen=True, eq=False)
class Ranges:
    """The ends (n), `low` and `high`, of the coordinates `names` of a point, of which the first `states` are the
    model's state."""

    low: Array
    high: Array
    names: tuple[str, ...]
    states: int

    def points(self, shares: Array) -> Array:
        """The points (k, n) at shares of the ranges."""
        return np.asarray(self.low + shares * (self.high - self.low))


@dataclass(frozen=True, eq=False)
class OpenLoopLimit:
    """The longest step `dt`, inf where nothing decays, and the `point` (n) and the `eigenvalue` of F that decide.

    `state`: the name of the state that has the largest share in that mode, each in units of its range.
    """

    dt: float
    point: Array
    eigenvalue: complex
    state: str


def open_loop_limit(slopes: Slopes, ranges: Ranges, polynomial: Sequence[float]) -> OpenLoopLimit:
    """The limit of the Jacobians F (k, N, N) = slopes(points (k, n)), which may be NaN where there is none."""
    shares, edge = _started(slopes, ranges)
    table = _exits(tuple(polynomial))

    def limits(at: Array) -> Array:
        return _interpolated(slopes(ranges.points(at)), table)

    values = limits(shares)
    moving = np.flatnonzero(ranges.high > ranges.low)
    best = values.argsort(kind="stable")[:STARTS]
    if not np.isfinite(values[best[0]]):
        return OpenLoopLimit(np.inf, ranges.points(shares[0]), 0j, "")
    minima, least = _descended(limits, shares[best], values[best], moving, edge)
    point = ranges.points(minima[least.argmin()])
    return _decided(slopes(point[None])[0], point, ranges, polynomial)


def open_loop_lengths(slopes: Slopes, ranges: Ranges, tableau: Tableau, time: str) -> Lengths:
    """The limit as what is advised, with the point of the ranges where it is attained and what happens beyond it."""
    limit = open_loop_limit(slopes, ranges, tableau.polynomial)
    if not np.isfinite(limit.dt):
        return Lengths()
    at = ", ".join(f"{name} = {value:.3g}" for name, value in zip(ranges.names, limit.point, strict=True))
    eigenvalue, turning = f"{limit.eigenvalue.real:.3g}", abs(limit.eigenvalue.imag)
    if turning > AXIS * abs(limit.eigenvalue):
        eigenvalue += f" +- {turning:.3g}i"
    basis = (
        f"beyond it {limit.state} diverges while samples are missing, at {at}, where the model has the "
        f"eigenvalue {eigenvalue} 1/{time} and the step leaves the stability region; {SEARCHED}"
    )
    return Lengths(take=limit.dt, basis=basis, rule=tableau.name)


def _started(slopes: Slopes, ranges: Ranges) -> tuple[Array, float]:
    """Shares (k, n) of the ranges where the search starts, and how far from the ends it stays."""
    n = len(ranges.low)
    rng = np.random.default_rng(1)
    every = 2**n <= RANDOM
    corners = (np.arange(2**n)[:, None] >> np.arange(n)) % 2 if every else rng.integers(0, 2, size=(RANDOM, n))
    finite = np.isfinite(slopes(ranges.points(corners))).all()
    edge = 0.0 if finite else EDGE
    inside = rng.uniform(size=(RANDOM, n))
    return edge + (1 - 2 * edge) * np.vstack([np.full((1, n), 0.5), corners, inside]), edge


def _descended(
    limits: Callable[[Array], Array], points: Array, values: Array, moving: Array, edge: float
) -> tuple[Array, Array]:
    """Of each start (s, n), the point, and its limit (s), where no move of one coordinate finds a shorter one."""
    points, values, lengths = points.copy(), values.copy(), np.full(len(points), FIRST)
    every, rows = np.arange(len(points)), np.arange(len(moving))
    while len(moving) and lengths.max() >= SHORTEST:
        here, move = points[:, moving], lengths[:, None]
        ends = np.full(here.shape, edge), np.full(here.shape, 1 - edge)
        tried = np.repeat(points[:, None], 4 * len(moving), axis=1).reshape(len(points), 4, len(moving), -1)
        for k, moved in enumerate((*ends, here - move, here + move)):
            tried[:, k, rows, moving] = np.clip(moved, edge, 1 - edge)
        moves: Array = tried.reshape(len(points), 4 * len(moving), -1)
        limits_tried = limits(moves.reshape(-1, points.shape[1])).reshape(len(points), -1)
        least = limits_tried.argmin(axis=1)
        better = limits_tried[every, least] < values * (1 - AXIS)
        points[better], values[better] = moves[every, least][better], limits_tried[every, least][better]
        lengths[~better] /= 2
    return points, values


def _decided(F: Array, point: Array, ranges: Ranges, polynomial: Sequence[float]) -> OpenLoopLimit:
    values, vectors = np.linalg.eig(F)
    values = values.astype(complex)
    decaying = np.flatnonzero(_decays(values))
    exits = [spectral_limit(values[[k]].real + 1j * np.abs(values[[k]].imag), polynomial) for k in decaying]
    k = decaying[int(np.argmin(exits))]
    dt, eigenvalue = float(min(exits)), complex(values[k])
    if len(F) != ranges.states:
        return OpenLoopLimit(dt, point, eigenvalue, "the estimate")
    width = (ranges.high - ranges.low)[: len(F)]
    share = np.abs(vectors[:, k]) / np.where(width > 0, width, 1.0)
    return OpenLoopLimit(dt, point, eigenvalue, ranges.names[int(share.argmax())])


def _decays(spectra: Array) -> Array:
    """Which of the eigenvalues (.., N) decay, by more than rounding."""
    sizes = np.abs(spectra)
    rounding = AXIS * sizes.max(axis=-1, keepdims=True, initial=0.0)
    return np.asarray(spectra.real < -np.maximum(rounding, DAMPING * sizes))


def _interpolated(F: Array, exits: Array) -> Array:
    """For each F (k, N, N) the least first exit of its decaying modes (k), between two angles of the table; inf where
    there is none or F is not finite."""
    finite = np.isfinite(F).all(axis=(1, 2))
    spectra = np.linalg.eigvals(np.where(finite[:, None, None], F, 0.0)).astype(complex)
    with np.errstate(divide="ignore", invalid="ignore"):
        radius = np.interp(np.abs(np.angle(spectra)), np.linspace(np.pi / 2, np.pi, ANGLES), exits)
        limits = np.where(_decays(spectra), radius / np.abs(spectra), np.inf)
    return np.asarray(limits.min(axis=1, initial=np.inf))


@lru_cache(maxsize=8)
def _exits(polynomial: tuple[float, ...]) -> Array:
    """The first exits from the stability region along rays from the imaginary axis to the negative real one."""
    rays = np.exp(1j * np.linspace(np.pi / 2, np.pi, ANGLES))
    return np.array([spectral_limit(np.array([ray]), polynomial) for ray in rays])
