"""What a trial shows of an observer with a covariance: how V = e' S e falls from call to call, and what bounds S keeps.

    V_k = e' S e,   S = P^-1, e = z - z(x) after the sample k;   scaled S = theta^g Delta^-1 S Delta^-1

Theorems on such observers have V' <= -alpha V and alpha_1 <= scaled S <= alpha_2 with constants that are existential
(Boizot, Busvelle, Gauthier, Automatica 46 (2010)); g is 1 where theta scales Q alone, else 0 (`scaling`). These are
theirs on one trajectory of a trial, without noise: shown in trials, and proved of no other one. Where V has
fallen to a millionth since an event, rounding and the step's remainder begin to count, and the rest is left out.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated

import casadi as ca
import numpy as np

from hgogen.call import CallableStep
from hgogen.form import Form
from hgogen.graph import to_casadi
from hgogen.run.covariances import uncertainty
from hgogen.run.samples import Engine, Run
from hgogen.trial import Trial, feeds, first_memory, simulate

SMALL = 1e-6  # share of the largest V since an event, up to which V has fallen


@dataclass(frozen=True)
class Falling:
    """How V = e' S e falls on a trial without noise."""

    trial: Annotated[str, "name of the trial"]
    ratio: Annotated[float | None, "largest V_(k+1)/V_k; null where no V is above what rounding leaves"]
    time: Annotated[float | None, "after which time that is"]
    calls: Annotated[int, "number of calls"]
    eigenvalues: Annotated[tuple[float, float], "least and largest eigenvalue of scaled S along the trial"]

    def sentence(self, unit: str) -> str:
        """In one line; `unit`: that of the model's time."""
        low, high = self.eigenvalues
        bounds = f"scaled S has eigenvalues from {low:.3g} to {high:.3g}"
        if self.ratio is None:
            return f"shown in trials, not proved: {bounds}"
        most = (
            f"V = e' S e becomes at most {self.ratio:.6g} times itself from call to call (after {self.time:g} {unit})"
        )
        return f"shown in trials, not proved: without noise {most}; {bounds}"


def falling(step: CallableStep, trial: Trial, engine: Engine | None = None) -> Falling | None:
    """Of a step whose covariance is that of its estimate; None of another. Raises: as `hgogen.trial.try_out`."""
    known = uncertainty(step)
    if known is None or known.members is not None:
        return None
    quiet = replace(trial, noise={})
    truth = simulate(step.observer.form.system.declared, quiet, step.dt)
    (fed,) = feeds(step, quiet, truth, (0,))
    step.restore(first_memory(step, quiet))
    run = step.run(u=fed.u, y=step.arriving(fed.y), engine=engine)
    P, e = _in_form(step.observer.form, run, truth.x, fed.u)
    there = np.isfinite(P).all(axis=(1, 2)) & np.isfinite(e).all(axis=1)
    P, e = P[there], e[there]
    scaling, peak = known.part.scaling, known.part.theta.peak
    theta = run.traces.get("theta", np.full(len(there), peak))[:, None]
    Delta = (theta ** -(np.array(scaling.states, dtype=float) + scaling.gauge / 2))[there]  # with theta^(-g/2)
    spread = np.linalg.eigvalsh(P * Delta[:, :, None] * Delta[:, None, :])
    if not (spread.size and (spread > 0).all()):
        return None
    V = np.einsum("ki,ki->k", e, np.linalg.solve(P, e[:, :, None])[:, :, 0])
    pairs = list(_ratios(truth.t[there], V, trial))
    ratio, time = max(pairs) if pairs else (None, None)
    return Falling(trial.name, ratio, time, len(pairs), (float(1 / spread.max()), float(1 / spread.min())))


def _in_form(form: Form, run: Run, truth: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """P (N, n, n) and e (N, n) of the form's coordinates, from those of the plant's states as declared."""
    x, inputs = ca.SX.sym("x", len(run.names)), ca.SX.sym("u", u.shape[1])
    symbols = dict(zip(form.system.declared.states, ca.vertsplit(x), strict=True))
    symbols |= dict(zip(form.system.inputs, ca.vertsplit(inputs), strict=True)) if u.shape[1] else {}
    symbols |= {p: float(value) for p, value in form.system.nominal.items()}
    z = ca.vertcat(*to_casadi(form.entry, symbols))
    there = ca.Function("z", [x, inputs], [ca.densify(z), ca.densify(ca.jacobian(z, x))])
    estimate, wide = map(np.array, there(run.x.T, u.T))
    slope = wide.reshape(form.n, len(u), -1).swapaxes(0, 1)
    P = run.covariance
    assert P is not None  # the step has one
    return slope @ P @ slope.swapaxes(1, 2), (estimate - np.array(there(truth.T, u.T)[0])).T


def _ratios(t: np.ndarray, V: np.ndarray, trial: Trial) -> Iterator[tuple[float, float]]:
    """V_(k+1)/V_k and the time, of the calls between two events, while V is not small."""
    for begin, end in pairwise((*trial.events, np.inf)):
        here = (t >= begin - 1e-9) & (t < end - 1e-9)
        level, time = V[here], t[here]
        large = level > SMALL * level.max(initial=0.0)
        fallen = int(np.argmin(large)) if not large.all() else len(level)
        for k in range(min(fallen, len(level) - 1)):
            yield float(level[k + 1] / level[k]), float(time[k])
