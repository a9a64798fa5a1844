"""How much the outputs show of the direction of the state that they show least, as a share of their ranges.

    sigma = min over |v| = 1 of  rms_j | R^-1 C(t_j) Phi(t_j, t) S v |,    t_j from t to t + d,   Phi' = (df/dx) Phi

S: half the declared ranges of the states, R: half those of the outputs (of an output without one: half of what it
takes on), C = dh/dx. It is the smallest singular value of the linearised map from the state to a window of outputs, in
units of the ranges: an error of the whole range in the direction v moves the outputs by sigma of theirs, in the root
mean square over the window. Full rank says only that it is not 0; where it is far below the noise of a sensor, no
observer with that window tells v. It is measured, not proved.

With a trial, t runs along it and d is a tenth of it. Without one the linearisation is frozen at fixed points of the box
of states and inputs, and d is the longest time that a state takes to cross its range at its fastest there, cut where
an error grows e^5 fold. A frozen plant may show nothing of what its motion shows, as an induction motor whose flux
stands still of its speed under an unknown load: how much, a trial tells. A long chain shows its end when it is frozen
as well, but less than numbers resolve: which of the two it is, is told by the rank of the frozen plant. Source:
A. Krener, K. Ide, "Measures of unobservability", 48th IEEE CDC (2009), whose local unobservability index is the
reciprocal of the smallest singular value.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import sympy as sp

from hgogen.analysis.pace import NoSight, linear, on_box, ranged
from hgogen.rigor.box import box
from hgogen.rigor.rank import NowhereDefined, observability
from hgogen.rigor.tape import NoTape
from hgogen.sentence import Encoded
from hgogen.system import System
from hgogen.trial import Trial, simulate

_NOTHING = 1e-12  # of a range: above what rounding leaves of an exact 0
HOPELESS = 1e-3  # of the range of an output: about what a sensor of 10 bits resolves
_GRID, _FINEST = 200, 4000  # samples of a trial: at least, at most
_SHARE = 10  # windows one after the other in a trial, and starts of windows in each
_TURN = 0.5  # what the fastest mode may grow, decay or turn by from one sample to the next
_GROWTH, _SAMPLES = 5.0, (20, 1000)


@dataclass(frozen=True)
class Sight(Encoded):
    """What the outputs show of the least seen direction of the state, v."""

    json_keys = "least median window unit trial by_motion hopeless where direction"

    least: Annotated[float, "least sigma over the windows of a trial, or the points of the box"]
    median: Annotated[float, "median of sigma over them"]
    window: Annotated[float, "the longest window d"]
    unit: Annotated[str, "unit of the plant's time"]
    trial: Annotated[str, "name of the trial, empty for points of the box"]
    where: Annotated[Mapping[str, float], "where the least one is attained: begin of its window, or the point"]
    direction: Annotated[Mapping[str, float], "the direction v there by state, in half ranges, largest first"]
    by_motion: Annotated[bool, "whether the plant frozen at points hides v, so that only its motion shows v"] = False

    @property
    def hopeless(self) -> bool:
        """Whether half of all windows or points show less than any usual sensor resolves."""
        return self.median < HOPELESS and not self.by_motion

    def __str__(self) -> str:
        (weak, _), *_ = self.direction.items()
        over = (
            f"windows of {self.window:.3g} {self.unit} along trial {self.trial}" if self.trial else "points of the box"
        )
        if self.by_motion:
            frozen = f"frozen at points of the box, the plant does not show {weak}"
            return f"{frozen}; how much its motion does, a trial tells"
        at = ", ".join(f"{name} = {value:.3g}" for name, value in self.where.items())
        least, median = as_share(self.least), as_share(self.median)
        return (
            f"least seen: an error as large as the range, mostly in {weak}, moves the outputs by {least} of theirs at "
            f"{at}; median {median} over {over}"
        )


def as_share(value: float, digits: int = 2) -> str:
    """A share in words: of one that numbers do not resolve, what it is less than."""
    return f"{value:.{digits}g}" if value == 0 or value >= _NOTHING else f"less than {_NOTHING:g}"


def sight(plant: System, trial: Trial | None = None) -> Sight:
    """The least seen direction along a trial without noise, else at fixed points of the declared box; parameters are
    nominal. Raises: `NoSight` where a state (without a trial also an input) has no range, or the model no value;
    `BadTrial` for a trial that cannot be integrated; `NoGraph`."""
    ranged((*plant.states, *(() if trial else plant.inputs)))
    with np.errstate(all="ignore"):
        if trial:
            return _along(plant, trial)
        points, linearised, rates = on_box(plant)
        window = rates.longest or 1.0
        each = [_frozen(A, C, window) for A, C in zip(linearised.A, linearised.C, strict=True)]
        names = [s.name for s in (*plant.states, *plant.inputs)]
        at = [dict(zip(names, map(float, point), strict=True)) for point in points]
        seen = replace(_least(plant, each, at), window=window)
        return replace(seen, by_motion=seen.median < _NOTHING and not _shown_frozen(plant))


def _along(plant: System, trial: Trial) -> Sight:
    """The Sight along the trial, over windows that begin at every hundredth of it."""
    coarse = simulate(plant, trial, trial.duration / _GRID)
    fastest = np.abs(np.linalg.eigvals(linear(plant, coarse.x, coarse.u).A)).max() * trial.duration / _TURN
    pieces = min(_FINEST, _GRID * max(1, math.ceil(fastest / _GRID)))
    truth = simulate(plant, trial, trial.duration / pieces) if pieces > _GRID else coarse
    linearised = linear(plant, truth.x, truth.u)
    moves = _exponential((linearised.A[:-1] + linearised.A[1:]) / 2 * (trial.duration / pieces))
    length, step = pieces // _SHARE, pieces // _SHARE**2
    starts = range(0, pieces - length + 1, step)
    each = [_weakest(moves[k : k + length], linearised.C[k : k + length + 1]) for k in starts]
    at = [{"t": k * trial.duration / pieces} for k in starts]
    return replace(_least(plant, each, at), window=trial.duration / _SHARE, trial=trial.name)


def _shown_frozen(plant: System) -> bool:
    """Whether e' = (df/dx) e, y = (dh/dx) e shows all of e at almost every point (x, u) at which it is frozen."""
    e = sp.Matrix(sp.symbols(f"e:{len(plant.states)}", cls=sp.Dummy))
    A, C = (sp.Matrix(rows).jacobian(plant.states) for rows in (plant.flow, plant.output))
    sides = {**box(plant.signals, plant.nominal), **dict.fromkeys(e, (-1, 1))}
    try:
        return observability(A * e, C * e, tuple(e), sides=sides).known.rank == len(e)
    except (NoTape, NowhereDefined):
        return False


def _frozen(A: np.ndarray, C: np.ndarray, window: float) -> tuple[float, np.ndarray]:
    values = np.linalg.eigvals(A)
    window = min(window, _GROWTH / max(values.real.max(), 1e-300))
    low, high = _SAMPLES
    count = int(min(high, max(low, math.ceil(np.abs(values).max() * window / _TURN))))
    move = _exponential(A[None] * (window / count))
    return _weakest(np.repeat(move, count, axis=0), np.repeat(C[None], count + 1, axis=0))


def _weakest(moves: np.ndarray, C: np.ndarray) -> tuple[float, np.ndarray]:
    """sigma and v of one window: its transitions (m, n, n) and its C (m + 1, p, n)."""
    n = C.shape[2]
    Phi, rows = np.eye(n), [C[0]]
    for move, now in zip(moves, C[1:], strict=True):
        Phi = move @ Phi
        rows.append(now @ Phi)
    rows[0], rows[-1] = rows[0] / math.sqrt(2), rows[-1] / math.sqrt(2)  # the trapezoidal rule
    tall = np.concatenate(rows) / math.sqrt(len(moves))
    if not np.isfinite(tall).all():
        return math.nan, np.zeros(n)
    _, values, directions = np.linalg.svd(np.linalg.qr(tall, mode="r") if len(tall) > n else tall)
    return (float(values[-1]) if len(values) == n else 0.0), directions[-1]


def _least(plant: System, each: list[tuple[float, np.ndarray]], at: list[dict[str, float]]) -> Sight:
    known = [(value, v, where) for (value, v), where in zip(each, at, strict=True) if math.isfinite(value)]
    if not known:
        raise NoSight("the linearised model has no finite values")
    least, v, where = min(known, key=lambda one: one[0])
    shares = {s.name: float(share) for s, share in zip(plant.states, v, strict=True)}
    direction = dict(sorted(shares.items(), key=lambda pair: -abs(pair[1])))
    return Sight(least, float(np.median([one[0] for one in known])), 0.0, plant.time, "", where, direction)


def _exponential(matrices: np.ndarray) -> np.ndarray:
    """The exponential of each matrix of (N, n, n), by its series to order 12 at less than 1/2 in norm, and squaring."""
    norm = np.abs(matrices).sum(axis=2).max(initial=0.0)
    halvings = max(0, math.ceil(math.log2(2 * norm))) if 0 < norm < math.inf else 0
    small = matrices / 2.0**halvings
    total = term = np.broadcast_to(np.eye(matrices.shape[1]), matrices.shape)
    for k in range(1, 13):
        term = term @ small / k
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return np.asarray(total)
