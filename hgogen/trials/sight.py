"""How much the outputs show of the direction of the state that they show least, as a share of their ranges.

    sigma = min over |v| = 1 of  rms_j | R^-1 C(t_j) Phi(t_j, t) S v |,    t_j from t to t + d,   Phi' = (df/dx) Phi

S: half the declared ranges of the states, R: half those of the outputs (of an output without one: half of what it
takes on), C = dh/dx. It is the smallest singular value of the linearised map from the state to a window of outputs, in
units of the ranges: an error of the whole range in the direction v moves the outputs by sigma of theirs, in the root
mean square over the window. Full rank says only that it is not 0; where it is far below the noise of a sensor, no
observer with that window tells v. It is measured, not proved.

With a trial, t runs along it and d is a tenth of it. Without one the linearisation is frozen at fixed points of the box
of states and inputs, and d is the longest time that a state takes to cross its range at its fastest there, cut where
an error grows e^5 fold. Source: A. Krener, K. Ide, "Measures of unobservability", 48th IEEE CDC (2009), whose local
unobservability index is the reciprocal of the smallest singular value.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from hgogen.errors import HgogenError
from hgogen.graph import to_casadi
from hgogen.signal import Signal
from hgogen.system import System
from hgogen.trial import Trial, simulate

HOPELESS = 1e-3  # of the range of an output: about what a sensor of 10 bits resolves
_GRID, _FINEST = 200, 4000  # samples of a trial: at least, at most
_SHARE = 10  # windows one after the other in a trial, and starts of windows in each
_TURN = 0.5  # what the fastest mode may grow, decay or turn by from one sample to the next
_POINTS, _GROWTH, _SAMPLES = 32, 5.0, (20, 1000)


@dataclass(eq=False)
class NoSight(HgogenError):
    """What is missing for a measure of how much the outputs show."""

    reason: str

    def __str__(self) -> str:
        return f"how much the outputs show is not measured: {self.reason}"


@dataclass(frozen=True)
class Sight:
    """What the outputs show of the least seen direction of the state.

    `least`, `median`: of sigma, over the windows of a trial or the points of the box; `window`: d, the longest of
    them, in the plant's time `unit`; `trial`: its name, "" for points; `where`: the least one is attained there, the
    time at which its window begins, or the point; `direction`: v there, by state, in half ranges, largest first.
    """

    least: float
    median: float
    window: float
    unit: str
    trial: str
    where: Mapping[str, float]
    direction: Mapping[str, float]

    @property
    def hopeless(self) -> bool:
        """Whether half of all windows or points show less than any usual sensor resolves."""
        return self.median < HOPELESS

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        names = ("least", "median", "window", "unit", "trial", "hopeless")
        values = {name: getattr(self, name) for name in names}
        return {**values, "where": dict(self.where), "direction": dict(self.direction)}

    def __str__(self) -> str:
        (weak, _), *_ = self.direction.items()
        over = (
            f"windows of {self.window:.3g} {self.unit} along trial {self.trial}" if self.trial else "points of the box"
        )
        at = ", ".join(f"{name} = {value:.3g}" for name, value in self.where.items())
        return (
            f"least seen: an error as large as the range, mostly in {weak}, moves the outputs by {self.least:.2g} of "
            f"theirs at {at}; median {self.median:.2g} over {over}"
        )


@dataclass(frozen=True)
class _Linear:
    """df/dx (n, n) and dh/dx (p, n) in half ranges, each at N points."""

    A: np.ndarray
    C: np.ndarray


def sight(plant: System, trial: Trial | None = None) -> Sight:
    """The least seen direction along a trial without noise, else at fixed points of the declared box; parameters are
    nominal.

    Raises: `NoSight` where a state (without a trial also an input) has no range, or the model no value; `BadTrial` for
    a trial that cannot be integrated; `NoGraph`.
    """
    _ranged((*plant.states, *(() if trial else plant.inputs)))
    with np.errstate(all="ignore"):
        return _along(plant, trial) if trial else _at_points(plant)


@dataclass(frozen=True)
class Pace:
    """How fast a plant is on its box: the shortest and the longest time that a state takes to cross its range, at its
    fastest among fixed points, and the fastest mode of its linearisation there (1/time); 0 where nothing moves."""

    shortest: float
    longest: float
    fastest: float


def pace(plant: System) -> Pace:
    """Raises: as `sight` without a trial."""
    return _on_box(plant)[-1]


def _along(plant: System, trial: Trial) -> Sight:
    """The Sight along the trial, over windows that begin at every hundredth of it."""
    coarse = simulate(plant, trial, trial.duration / _GRID)
    fastest = np.abs(np.linalg.eigvals(_linear(plant, coarse.x, coarse.u).A)).max() * trial.duration / _TURN
    pieces = min(_FINEST, _GRID * max(1, math.ceil(fastest / _GRID)))
    truth = simulate(plant, trial, trial.duration / pieces) if pieces > _GRID else coarse
    linearised = _linear(plant, truth.x, truth.u)
    moves = _exponential((linearised.A[:-1] + linearised.A[1:]) / 2 * (trial.duration / pieces))
    length, step = pieces // _SHARE, pieces // _SHARE**2
    starts = range(0, pieces - length + 1, step)
    each = [_weakest(moves[k : k + length], linearised.C[k : k + length + 1]) for k in starts]
    at = [{"t": k * trial.duration / pieces} for k in starts]
    return replace(_least(plant, each, at), window=trial.duration / _SHARE, trial=trial.name)


def _at_points(plant: System) -> Sight:
    """The Sight of the linearisation frozen at points of the box."""
    points, linearised, rates = _on_box(plant)
    each = [_frozen(A, C, rates.longest or 1.0) for A, C in zip(linearised.A, linearised.C, strict=True)]
    at = [{s.name: float(v) for s, v in zip((*plant.states, *plant.inputs), point, strict=True)} for point in points]
    return replace(_least(plant, each, at), window=rates.longest or 1.0)


def _on_box(plant: System) -> tuple[np.ndarray, _Linear, Pace]:
    """Points of the box (N, n + m) where the model has a value, its linearisation there, and its pace."""
    signals = (*plant.states, *plant.inputs)
    _ranged(signals)
    points = _lattice(signals)
    x, u = points[:, : len(plant.states)], points[:, len(plant.states) :]
    with np.errstate(all="ignore"):
        linearised, rates = _linear(plant, x, u), np.array(_functions(plant)[0](x.T, u.T)).T
        known = (
            np.isfinite(rates).all(1) & np.isfinite(linearised.A).all((1, 2)) & np.isfinite(linearised.C).all((1, 2))
        )
        if not known.any():
            raise NoSight(f"the model has no value at any of {_POINTS} points of the box")
        crossing = 2 * np.array([_half(s) for s in plant.states]) / np.abs(rates[known]).max(axis=0)
    moving = crossing[np.isfinite(crossing)]
    finite = _Linear(linearised.A[known], linearised.C[known])
    fastest = np.abs(np.linalg.eigvals(finite.A)).max()
    return points[known], finite, Pace(float(min(moving, default=0)), float(max(moving, default=0)), float(fastest))


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


def _linear(plant: System, x: np.ndarray, u: np.ndarray) -> _Linear:
    """At x (N, n), u (N, m)."""
    _, output, slopes = _functions(plant)
    S = np.array([_half(s) for s in plant.states])
    n, count = len(plant.states), len(x)
    F, H = (np.array(part) for part in slopes(x.T, u.T))
    A = F.T.reshape(count, n, n).transpose(0, 2, 1) * S / S[:, None]  # CasADi counts by columns
    C = H.T.reshape(count, n, len(plant.outputs)).transpose(0, 2, 1) * S
    y = np.array(output(x.T, u.T))
    R = np.array([_half(s) if s.bounded else _extent(row) for s, row in zip(plant.outputs, y, strict=True)])
    return _Linear(A, C / R[:, None])


def _functions(plant: System) -> tuple[Any, Any, Any]:
    """f, h and (df/dx, dh/dx), the latter as columns, as functions of x (n) and u (m)."""
    x, u = ca.SX.sym("x", len(plant.states)), ca.SX.sym("u", len(plant.inputs))
    symbols = dict(zip(plant.states, ca.vertsplit(x), strict=True))
    symbols |= dict(zip(plant.inputs, ca.vertsplit(u), strict=True)) if plant.inputs else {}
    symbols |= {p: float(value) for p, value in plant.nominal.items()}
    f, h = (ca.densify(ca.vertcat(*to_casadi(part, symbols))) for part in (plant.flow, plant.output))
    slopes = [ca.vec(ca.densify(ca.jacobian(part, x))) for part in (f, h)]
    return tuple(ca.Function(name, [x, u], parts) for name, parts in (("f", [f]), ("h", [h]), ("slopes", slopes)))  # type: ignore[return-value]


def _ranged(signals: tuple[Signal, ...]) -> None:
    loose = [s.name for s in signals if not s.bounded]
    if loose or not signals:
        raise NoSight(f"no range is declared for {', '.join(loose)}" if loose else "the plant has no states")


def _half(signal: Signal) -> float:
    low, high = signal.interval
    return (high - low) / 2


def _extent(values: np.ndarray) -> float:
    """Half of what an output takes on, or its size where it does not move."""
    values = values[np.isfinite(values)]
    half, size = (np.ptp(values) / 2, np.abs(values).max()) if len(values) else (0.0, 0.0)
    return float(half or size or 1.0)


def _lattice(signals: tuple[Signal, ...]) -> np.ndarray:
    """The middle of the box, and points of the additive recurrence of Roberts (2018), which fill it evenly."""
    k = len(signals)
    phi = 1.5
    for _ in range(60):  # the root of phi^(k+1) = phi + 1
        phi = (1 + phi) ** (1 / (k + 1))
    shares = (0.5 + np.arange(_POINTS)[:, None] * phi ** -np.arange(1.0, k + 1)) % 1
    low, high = np.array([s.interval for s in signals]).T
    return np.asarray(low + shares * (high - low))


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
