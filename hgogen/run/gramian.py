"""The observability Gramian of a window along a trajectory: how well the window d shows each direction of the state.

    W(t, d) = integral_t^(t+d) Phi' C' C Phi ds,   Phi' = (df/dx) Phi,  Phi(t) = I,  C = dh/dx

along x(t), u(t). The window's innovation, the integral of |y - yhat|^2, of an initial error e is e' W e + o(|e|^2): to
first order at least the smallest eigenvalue times |e|^2; the eigenvector is the direction that shows least. It carries
the units of the states: it compares windows, and directions of states of like size. Source: N. Boizot, E. Busvelle,
J.-P. Gauthier, Automatica 46 (2010), the innovation and its lemma on observability over a window.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import accumulate
from typing import Annotated

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.errors import BadArgument
from hgogen.graph import CVODES, to_casadi
from hgogen.reading.given import Misfit, asks_a_plant, real
from hgogen.sentence import Encoded
from hgogen.signal import plural
from hgogen.system import System
from hgogen.trial import Trial, simulate, t

_OPTIONS = {**CVODES, "abstol": 1e-12, "reltol": 1e-10}
_PIECES = 10  # of the shortest window: between two starts of a window


class BadWindows(BadArgument):
    """Windows that are no lengths of time within the trial."""

    text = "windows {what}: {reason}"


@dataclass(frozen=True, eq=False)
class Gramian(Encoded):
    """The observability Gramian of a window along a trajectory.

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
        """(least, most) of the smallest eigenvalue along the trajectory."""
        return float(self.smallest.min()), float(self.smallest.max())

    @property
    def median(self) -> float:
        """The median of the smallest eigenvalue along the trajectory."""
        return float(np.median(self.smallest))

    @property
    def weakest(self) -> tuple[str, float]:
        """The state with the largest share in the direction that shows least, and its mean square share (0..1)."""
        shares = (self.direction**2).mean(axis=0)
        return self.states[int(np.argmax(shares))], float(shares.max())

    def __str__(self) -> str:
        (low, high), (name, share) = self.range, self.weakest
        return (
            f"d = {self.d:g}: smallest eigenvalue {low:.2g} .. {high:.2g}, median {self.median:.2g}; "
            f"weakest direction {name} ({share:.0%} of its square)"
        )


@asks_a_plant
def gramian(plant: System, trial: Trial, d: float | Iterable[float]) -> tuple[Gramian, ...]:
    """The windows `d` along a trial without noise, one value each, in the order of `d`.

    Windows begin every tenth of the shortest; a length is rounded to a whole number of those. A window that spans a
    jump of the trial follows the plant through the jump. Parameters are nominal.

    Raises: `Misfit`; `BadGain` for what is no time; `BadWindows`, `BadTrial`.
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
    """The transition matrix (N, n, n) over each piece of the trajectory, and the Gramian (N, n, n) of the piece."""
    n, pieces = len(plant.states), len(x) - 1
    state, Phi, W = ca.SX.sym("x", n), ca.SX.sym("Phi", n, n), ca.SX.sym("W", n, n)
    begin, share = ca.SX.sym("begin"), ca.SX.sym("share")
    u = to_casadi([sp.sympify(trial.inputs[s.name]) for s in plant.inputs], {t: begin + share})
    symbols = dict(zip(plant.states, ca.vertsplit(state), strict=True)) | dict(zip(plant.inputs, u, strict=True))
    symbols |= {p: float(value) for p, value in plant.nominal.items()}
    flow = ca.vertcat(*to_casadi(plant.flow, symbols))
    shown = ca.jacobian(ca.vertcat(*to_casadi(plant.output, symbols)), state) @ Phi
    rates = ca.vertcat(flow, ca.vec(ca.jacobian(flow, state) @ Phi), ca.vec(shown.T @ shown))
    ode = {"x": ca.vertcat(state, ca.vec(Phi), ca.vec(W)), "p": begin, "t": share, "ode": rates}
    solver = ca.integrator("window", "cvodes", ode, 0.0, grid, _OPTIONS)
    fresh = np.concatenate([np.eye(n).ravel(), np.zeros(n * n)])
    starts = np.vstack([x[:-1].T, np.tile(fresh[:, None], pieces)])
    ends = np.array(solver(x0=starts, p=grid * np.arange(pieces)[None, :])["xf"])
    Phi_end, W_end = (ends[n + k * n * n : n + (k + 1) * n * n].T.reshape(pieces, n, n) for k in (0, 1))
    return Phi_end.transpose(0, 2, 1), W_end.transpose(0, 2, 1)  # CasADi counts by columns


def window(states: tuple[str, ...], steps: tuple[np.ndarray, np.ndarray], grid: float, pieces: int) -> Gramian:
    """W over `pieces` steps of length `grid` (s), of transitions and Gramians W_k (N, n, n): sum of Phi' W_k Phi, Phi
    the product of the transitions before step k; one value for each step at which a whole window begins."""
    (transitions, gramians), n = steps, len(states)
    count = len(transitions) - pieces + 1
    sums = np.empty((count, n, n))
    for k in range(count):
        before = accumulate(transitions[k : k + pieces - 1], lambda Phi, step: step @ Phi, initial=np.eye(n))
        sums[k] = sum(Phi.T @ W @ Phi for Phi, W in zip(before, gramians[k : k + pieces], strict=True))
    values, vectors = np.linalg.eigh(sums)
    start = grid * np.arange(count)
    return Gramian(pieces * grid, states, start, values[:, 0], values[:, -1], vectors[:, :, 0])
