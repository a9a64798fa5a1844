"""The observability Gramian of a window of length d along a trajectory, and an observability measure.

    W(t, d) = integral_t^(t+d) Phi' C' C Phi ds,   Phi' = (df/dx) Phi,  Phi(t) = I,  C = dh/dx

along x(t), u(t). The window's innovation, the integral of |y - yhat|^2, for an initial error e is e' W e + o(|e|^2): at
least the smallest eigenvalue times |e|^2, whose eigenvector is the least observable direction. W has the units of the
states, so it compares windows, and directions among states of similar size. Source: N. Boizot, E. Busvelle, J.-P.
Gauthier, Automatica 46 (2010), the innovation and its lemma on observability over a window.

The observability measure sigma of the least observable direction v is in shares of the ranges:

    sigma = min over |v| = 1 of  rms_j | R^-1 C(t_j) Phi(t_j, t) S v |,    t_j from t to t + d,   Phi' = (df/dx) Phi

S: half the declared ranges of the states, R: half those of the outputs (without one, half the range of its values), C =
dh/dx. sigma is the smallest singular value of the linearised map from the state to a window of outputs, in units of the
ranges: an error of the whole range in the direction v changes the outputs by the share sigma of their ranges, in the
root mean square over the window. Full rank means only that sigma is not 0; where it is far below the noise of a sensor,
no observer with that window can estimate v. It is measured, not proved.

With a trial, t runs along it and d is a tenth of it. Without one the linearisation is frozen at fixed points of the
ranges of states and inputs, and d is the longest time in which a state crosses its range at its highest rate, limited
to growth of an error by e^5. A plant may be observable along a trajectory although its frozen linearisation is not, as
the speed of an induction motor under an unknown load with a constant flux; a trial measures this. The end of a long
chain of integrators is observable in the frozen plant, but with a sigma below rounding: the rank of the frozen plant
decides between the two cases. Source: A. Krener, K. Ide, "Measures of unobservability", 48th IEEE CDC (2009), whose
local unobservability index is the reciprocal of the smallest singular value.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Annotated

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.analysis.linearised import NoLinearisation, linear, linearisation_on_box, ranged
from hgogen.errors import BadArgument
from hgogen.graph import CVODES, to_casadi
from hgogen.reading.given import Misfit, real, requires_plant
from hgogen.rigor.box import box
from hgogen.rigor.rank import Model, NowhereDefined, observability
from hgogen.rigor.singular import with_limited_slopes
from hgogen.rigor.tape import NoTape
from hgogen.sentence import Encoded
from hgogen.signal import plural
from hgogen.system import System, demand_continuous
from hgogen.trial import Trial, input_expressions, simulate, t

_OPTIONS = {**CVODES, "abstol": 1e-12, "reltol": 1e-10}
_PIECES = 10  # starts of windows within the shortest one


class BadWindows(BadArgument):
    """The error for windows that are no lengths of time within the trial."""

    text = "windows {what}: {reason}"


@dataclass(frozen=True, eq=False)
class Gramian(Encoded):
    """The observability Gramians W = integral of Phi^T C^T C Phi over windows of the length `d` along a trajectory, Phi
    the transition matrix.

    `start` (N): where each window begins; `smallest`, `largest` (N): eigenvalues of its Gramian; `direction` (N, n):
    the unit eigenvector of the smallest; `states`: names.
    """

    json_keys = "d least=range.0 median most=range.1 weakest=weakest.0 share=weakest.1"

    d: Annotated[float, "length of the window, in the plant's time"]
    states: tuple[str, ...]
    start: np.ndarray
    smallest: np.ndarray
    largest: np.ndarray
    direction: np.ndarray

    @property
    def range(self) -> tuple[float, float]:
        """The smallest and the largest value, along the trajectory, of the Gramian's smallest eigenvalue."""
        return float(self.smallest.min()), float(self.smallest.max())

    @property
    def median(self) -> float:
        """The median, along the trajectory, of the Gramian's smallest eigenvalue."""
        return float(np.median(self.smallest))

    @property
    def weakest(self) -> tuple[str, float]:
        """The state with the largest share in the least observable direction, and its mean square share (0..1)."""
        shares = (self.direction**2).mean(axis=0)
        return self.states[int(np.argmax(shares))], float(shares.max())

    def __str__(self) -> str:
        (low, high), (name, share) = self.range, self.weakest
        return (
            f"d = {self.d:g}: smallest eigenvalue {low:.2g} .. {high:.2g}, median {self.median:.2g}; "
            f"weakest direction {name} ({share:.0%} of its square)"
        )


@requires_plant
def gramian(plant: System, trial: Trial, d: float | Iterable[float]) -> tuple[Gramian, ...]:
    """Return the observability Gramians of windows of the lengths `d` along a trial without noise, one `Gramian` for
    each length.

    A window begins at every tenth of the shortest length, and lengths are rounded to multiples of that. A window across
    a jump of the trial follows the plant through the jump. Parameters are nominal.

    Raises: `Misfit`; `BadGain` for a `d` that is no time; `BadWindows`, `BadTrial`.
    """
    if not isinstance(trial, Trial):
        raise Misfit("gramian, trial=", trial, "a trial, as hgogen.trial.Trial makes it")
    windows = tuple(real("d", one) for one in (d if isinstance(d, Iterable) else (d,)))
    if not windows or not all(0 < one <= trial.duration for one in windows):
        reason = f"must be times in {plural(plant.time)}, above 0 and at most the trial's {trial.duration:g}"
        raise BadWindows(", ".join(f"{d:g}" for d in windows), reason)
    grid = min(windows) / _PIECES
    truth = simulate(plant, trial, grid)
    steps, names = _steps(plant, trial, truth.x, grid), tuple(s.name for s in plant.states)
    return tuple(window(names, steps, grid, max(1, round(one / grid))) for one in windows)


def _steps(plant: System, trial: Trial, x: np.ndarray, grid: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the transition matrix Phi (N, n, n) over each piece of length `grid` (s)
    of the trajectory `x`, and the observability Gramian (N, n, n) of each piece."""
    n, pieces = len(plant.states), len(x) - 1
    state, Phi, W = ca.SX.sym("x", n), ca.SX.sym("Phi", n, n), ca.SX.sym("W", n, n)
    begin, share = ca.SX.sym("begin"), ca.SX.sym("share")
    course = input_expressions(plant, trial)
    u = to_casadi([sp.sympify(course[s.name]) for s in plant.inputs], {t: begin + share})
    symbols = dict(zip(plant.states, ca.vertsplit(state), strict=True)) | dict(zip(plant.inputs, u, strict=True))
    symbols |= {p: float(value) for p, value in plant.nominal.items()}
    rows = ([with_limited_slopes(row, plant.box) for row in part] for part in (plant.flow, plant.output))
    flow, output = (ca.vertcat(*to_casadi(part, symbols)) for part in rows)
    sensitivity = ca.jacobian(output, state) @ Phi
    rates = ca.vertcat(flow, ca.vec(ca.jacobian(flow, state) @ Phi), ca.vec(sensitivity.T @ sensitivity))
    ode = {"x": ca.vertcat(state, ca.vec(Phi), ca.vec(W)), "p": begin, "t": share, "ode": rates}
    solver = ca.integrator("window", "cvodes", ode, 0.0, grid, _OPTIONS)
    fresh = np.concatenate([np.eye(n).ravel(), np.zeros(n * n)])
    starts = np.vstack([x[:-1].T, np.tile(fresh[:, None], pieces)])
    ends = np.array(solver(x0=starts, p=grid * np.arange(pieces)[None, :])["xf"])
    Phi_end, W_end = (ends[n + k * n * n : n + (k + 1) * n * n].T.reshape(pieces, n, n) for k in (0, 1))
    return Phi_end.transpose(0, 2, 1), W_end.transpose(0, 2, 1)  # CasADi counts by columns


def window(states: tuple[str, ...], steps: tuple[np.ndarray, np.ndarray], grid: float, pieces: int) -> Gramian:
    """Return the Gramians of all windows of `pieces` consecutive steps of length `grid` (s); `steps`: the transition
    matrices (N, n, n) and the Gramians W_k (N, n, n) of the steps. A window's Gramian is the sum of Phi' W_k Phi, with
    Phi the product of the transition matrices before step k."""
    (transitions, gramians), n = steps, len(states)
    count = len(transitions) - pieces + 1
    sums = np.empty((count, n, n))
    for k in range(count):
        before = accumulate(transitions[k : k + pieces - 1], lambda Phi, step: step @ Phi, initial=np.eye(n))
        sums[k] = sum(Phi.T @ W @ Phi for Phi, W in zip(before, gramians[k : k + pieces], strict=True))
    values, vectors = np.linalg.eigh(sums)
    start = grid * np.arange(count)
    return Gramian(pieces * grid, states, start, values[:, 0], values[:, -1], vectors[:, :, 0])


_NOTHING = 1e-12  # of a range: above the rounding errors of an exact 0
RESOLVED = 1e-3  # of the range of an output: about the resolution of a sensor of 10 bits
_GRID, _FINEST = 200, 4000  # fewest and most samples of a trial
_SHARE = 10  # consecutive windows in a trial, and starts of windows within each
_TURN = 0.5  # most change |lambda| h of the fastest mode between samples
_GROWTH, _SAMPLES = 5.0, (20, 1000)


@dataclass(frozen=True)
class ObservabilityMeasure(Encoded):
    """The observability measure sigma of a plant (the smallest singular value of the map from the state to a window of
    outputs, scaled by their ranges), and the least observable direction v of the state."""

    json_keys = "least median window unit trial by_motion below_resolution where direction"

    least: Annotated[float, "least sigma over the windows of a trial, or the points of the box"]
    median: Annotated[float, "median of sigma over them"]
    window: Annotated[float, "the longest window d"]
    unit: Annotated[str, "unit of the plant's time"]
    trial: Annotated[str, "name of the trial, empty for points of the box"]
    where: Annotated[Mapping[str, float], "where the least one is attained: begin of its window, or the point"]
    direction: Annotated[Mapping[str, float], "the direction v there by state, in half ranges, largest first"]
    by_motion: Annotated[bool, "whether the plant frozen at points hides v, so that only its motion shows v"] = False

    @property
    def below_resolution(self) -> bool:
        """Whether in half of all windows or points sigma is below the resolution of any usual sensor."""
        return self.median < RESOLVED and not self.by_motion

    def __str__(self) -> str:
        (weak, _), *_ = self.direction.items()
        over = f"windows of {self.window:.3g} {self.unit} along trial {self.trial}" if self.trial else "the ranges"
        if self.by_motion:
            frozen = f"linearised at fixed points of the declared ranges, {weak} is not observable"
            return f"{frozen}; declare a trial, which measures its observability along a motion"
        at = ", ".join(f"{name} = {value:.3g}" for name, value in self.where.items())
        least, median = as_share(self.least), as_share(self.median)
        return (
            f"least observable: if the state, mostly {weak}, changes by its range, the outputs change by {least} times "
            f"their range at {at}; median {median} over {over}"
        )


def as_share(value: float, digits: int = 2) -> str:
    """Return a share as text with `digits` digits; a share below the rounding errors as "less than" their bound."""
    return f"{value:.{digits}g}" if value == 0 or value >= _NOTHING else f"less than {_NOTHING:g}"


def observability_measure(plant: System, trial: Trial | None = None) -> ObservabilityMeasure:
    """Return the observability measure of a plant along a trial without noise, or at fixed points of the declared
    ranges; parameters are nominal. Raises: `NoLinearisation` where a state (without a trial also an input) has no
    range, or the model no value; `BadTrial` for a trial that cannot be integrated; `NoGraph`."""
    demand_continuous(plant, "the observability measure")
    ranged((*plant.states, *(() if trial else plant.inputs)))
    with np.errstate(all="ignore"):
        if trial:
            return _along(plant, trial)
        points, linearised, rates = linearisation_on_box(plant)
        window = rates.longest or 1.0
        at_points = zip(linearised.A, linearised.C, linearised.along, strict=True)
        each = [_frozen(A, C, along, window) for A, C, along in at_points]
        names = [s.name for s in (*plant.states, *plant.inputs)]
        at = [dict(zip(names, map(float, point), strict=True)) for point in points]
        measure = replace(_least(plant, each, at), window=window)
        return replace(measure, by_motion=measure.median < _NOTHING and not _observable_frozen(plant))


def _along(plant: System, trial: Trial) -> ObservabilityMeasure:
    coarse = simulate(plant, trial, trial.duration / _GRID)
    fastest = np.abs(np.linalg.eigvals(linear(plant, coarse.x, coarse.u).A)).max() * trial.duration / _TURN
    pieces = min(_FINEST, _GRID * max(1, math.ceil(fastest / _GRID)))
    truth = simulate(plant, trial, trial.duration / pieces) if pieces > _GRID else coarse
    linearised = linear(plant, truth.x, truth.u)
    transitions = _exponential((linearised.A[:-1] + linearised.A[1:]) / 2 * (trial.duration / pieces))
    length, step = pieces // _SHARE, pieces // _SHARE**2
    starts = range(0, pieces - length + 1, step)
    each = [
        _weakest(transitions[k : k + length], linearised.C[k : k + length + 1], linearised.along[k]) for k in starts
    ]
    at = [{"t": k * trial.duration / pieces} for k in starts]
    return replace(_least(plant, each, at), window=trial.duration / _SHARE, trial=trial.name)


def _observable_frozen(plant: System) -> bool:
    """Return whether the linearisation e' = (df/dx) e, y = (dh/dx) e is observable, frozen at almost any (x, u)."""
    e = sp.Matrix(sp.symbols(f"e:{len(plant.states)}", cls=sp.Dummy))
    A, C = (sp.Matrix(rows).jacobian(plant.states) for rows in (plant.flow, plant.output))
    sides = {**box(plant.signals, plant.nominal), **dict.fromkeys(e, (-1, 1))}
    try:
        return observability(Model(A * e, C * e, tuple(e)), sides=sides).known.rank == len(e)
    except (NoTape, NowhereDefined):
        return False


def _frozen(A: np.ndarray, C: np.ndarray, along: np.ndarray, window: float) -> tuple[float, np.ndarray]:
    values = np.linalg.eigvals(A)
    window = min(window, _GROWTH / max(values.real.max(), 1e-300))
    low, high = _SAMPLES
    count = int(min(high, max(low, math.ceil(np.abs(values).max() * window / _TURN))))
    move = _exponential(A[None] * (window / count))
    return _weakest(np.repeat(move, count, axis=0), np.repeat(C[None], count + 1, axis=0), along)


def _weakest(transitions: np.ndarray, C: np.ndarray, along: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the observability measure sigma and the least observable direction v (n) of one window, from its
    transition matrices (m, n, n) and output matrices C (m + 1, p, n); v in the span of `along` (n, k)."""
    n = along.shape[1]
    Phi, rows = along, [C[0] @ along]
    for move, now in zip(transitions, C[1:], strict=True):
        Phi = move @ Phi
        rows.append(now @ Phi)
    rows[0], rows[-1] = rows[0] / math.sqrt(2), rows[-1] / math.sqrt(2)  # the trapezoidal rule
    tall = np.concatenate(rows) / math.sqrt(len(transitions))
    if not np.isfinite(tall).all():
        return math.nan, np.zeros(len(along))
    _, values, directions = np.linalg.svd(np.linalg.qr(tall, mode="r") if len(tall) > n else tall)
    return (float(values[-1]) if len(values) == n else 0.0), along @ directions[-1]


def _least(plant: System, each: list[tuple[float, np.ndarray]], at: list[dict[str, float]]) -> ObservabilityMeasure:
    known = [(value, v, where) for (value, v), where in zip(each, at, strict=True) if math.isfinite(value)]
    if not known:
        raise NoLinearisation("the linearised model has no finite values")
    least, v, where = min(known, key=lambda one: one[0])
    shares = {s.name: float(share) for s, share in zip(plant.states, v, strict=True)}
    direction = dict(sorted(shares.items(), key=lambda pair: -abs(pair[1])))
    return ObservabilityMeasure(
        least, float(np.median([one[0] for one in known])), 0.0, plant.time, "", where, direction
    )


def _exponential(matrices: np.ndarray) -> np.ndarray:
    """Return the exponentials of matrices (N, n, n), by the series to order 12 for a norm below 1/2, and squaring."""
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
