"""The noise of a plant from a record, by the likelihood of the innovations of an extended Kalman filter.

F by classical Runge-Kutta, a sample on, Q diagonal. It is maximised over log Q_i and log sigma_j^2 by IPOPT with exact
gradients (logs/innovations.py), from several starts: it has several maxima.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import casadi as ca
import numpy as np

from hgogen.discretisation.open_loop import open_loop
from hgogen.form import Form
from hgogen.logs.innovations import SURE, Innovations, moved_by_noise
from hgogen.logs.records import Log
from hgogen.signal import resting
from hgogen.starting import Scale

Array = np.ndarray
Ended = tuple[float, Array, bool]  # log L a sample, logarithms, whether it settled
STARTS = tuple(product((-12.0, -4.0, 4.0), (-16.0, -8.0, 0.0)))  # log of process noise and of samples, in their units
BOUND = 32.0  # of these logarithms
SAME = 0.1  # of a logarithm: maxima no farther apart are one
_OPTIONS: Any = {
    "print_time": False,
    "show_eval_warnings": False,
    "ipopt": {
        "print_level": 0,
        "sb": "yes",
        "hessian_approximation": "limited-memory",
        "max_iter": 150,
        "tol": 1e-6,
    },
}


@dataclass(frozen=True)
class Noise:
    """A maximum: `process` Q_i by coordinates (z^2/time), `sample` sigma_j of a sample by output, `likelihood`: log L a
    sample, and whether the search `settled` there."""

    process: Mapping[str, float]
    sample: Mapping[str, float]
    likelihood: float
    settled: bool


@dataclass(frozen=True, eq=False)
class Likelihood:
    """The likelihood of records on a form; `scale`: the units; `between`: how inputs go on, "line" or "hold"; `steps`:
    Runge-Kutta steps a sample."""

    form: Form
    records: Sequence[Log]
    scale: Scale
    between: str
    steps: int

    def ended(self, number: int) -> Ended:
        """Where the search from a start, of `STARTS`, ends."""
        process, sample = STARTS[number]
        start = [process] * len(self._noisy) + [sample] * len(self.form.output)
        end = self._solver(x0=start, lbx=-BOUND, ubx=BOUND)
        return -float(end["f"]), end["x"].full().ravel(), bool(self._solver.stats()["success"])

    def maxima(self, ended: Iterable[Ended]) -> tuple[Noise, ...]:
        """The maxima at which searches ended: those that settled, then the others, the most likely first."""
        finite = [one for one in ended if np.isfinite(one[0])]
        maxima, places = list[Noise](), list[Array]()
        for one in sorted(finite, key=lambda one: (not one[2], -one[0])):
            place = np.maximum(one[1], -BOUND / 2)  # noise at its lower bound is none, however small
            if not any(np.abs(place - other).max() < SAME for other in places):
                places.append(place)
                maxima.append(self._noise(*one))
        return tuple(maxima)

    def innovations(self, noise: Noise, record: Log) -> tuple[Array, ...]:
        """e (N - 1, p) and its variances s, NaN where nothing was measured."""
        logs = [np.log(noise.process[name] / unit) for name, unit in self._noisy.items()]
        logs += [2 * np.log(noise.sample[name] / unit) for name, unit in self.scale.outputs.items()]
        _, e, s = self._over(record, ca.DM(logs))
        there = np.isfinite(record.y[1:])
        return tuple(np.where(there, np.array(each).T[1:], np.nan) for each in (e, s))

    def _noise(self, likelihood: float, logs: Array, settled: bool) -> Noise:
        count = len(self._noisy)
        process = {name: SURE * q for name, q in self.scale.units.items()}
        process |= {name: float(unit * np.exp(g)) for (name, unit), g in zip(self._noisy.items(), logs, strict=False)}
        pairs = zip(self.scale.outputs.items(), logs[count:], strict=True)
        return Noise(process, {name: float(unit * np.exp(g / 2)) for (name, unit), g in pairs}, likelihood, settled)

    @cached_property
    def _noisy(self) -> dict[str, float]:
        """The coordinates with noise of their own, with its unit S^2/D."""
        names = moved_by_noise(self.form.names, self.form.states, self.form.flow)
        return {name: self.scale.units[name] for name in names}

    @cached_property
    def _filter(self) -> Innovations:
        """On the form, of the logarithms."""
        n, p = self.form.n, len(self.form.output)
        model = open_loop(self.form, self.records[0].dt, self.between, self.steps)
        z, g = ca.SX.sym("z", n), ca.SX.sym("g", len(self._noisy) + p)
        now, then = (ca.SX.sym(name, len(self.form.system.inputs)) for name in ("now", "then"))
        dt, order = self.records[0].dt, list(self._noisy)
        process = [
            q * dt * (ca.exp(g[order.index(name)]) if name in order else SURE) for name, q in self.scale.units.items()
        ]
        samples = [unit**2 * ca.exp(g[len(self._noisy) + j]) for j, unit in enumerate(self.scale.outputs.values())]
        return Innovations(
            ca.Function("move", [z, now, then, g], [model.move(z, now, then)]),
            ca.Function("read", [z, now, g], [model.read(z, now)]),
            ca.Function("process", [g, ca.SX.sym("Phi", n, n)], [ca.diag(ca.vertcat(*process))]),
            ca.Function("sensor", [g], [ca.vertcat(*samples)]),
            np.array([[-np.inf] * n, [np.inf] * n]),  # its dynamics are taken in the box
        )

    def _over(self, record: Log, g: Any) -> tuple[Any, Any, Any]:
        """The start holds the first sample, which so corrects nothing."""
        return self._filter.along(record, self._start(record), g, first=False)

    def _start(self, record: Log) -> Array:
        """z and P at the first sample: what an output shows of the plant's states, the others at rest."""
        system = self.form.system
        shown = dict(zip(system.output, record.y.T, strict=True))
        states = [signal for signal, _ in self.form.estimates]
        x = [float(shown[s][np.isfinite(shown[s])][0]) if s in shown else resting(s) for s in states]
        model = open_loop(self.form, self.records[0].dt, self.between)
        z = np.array(model.enter(x, record.u[0])).ravel()
        P = np.diag([s * s / 4 for s in self.scale.states.values()])
        return np.concatenate([np.where(np.isfinite(z), z, 0.0), P.ravel()])

    @cached_property
    def _solver(self) -> Any:
        g = ca.MX.sym("g", len(self._noisy) + len(self.form.output))
        total = sum(ca.sum2(self._over(record, g)[0]) for record in self.records)
        count = sum(len(record.y) - 1 for record in self.records)
        return ca.nlpsol("likelihood", "ipopt", {"x": g, "f": total / count}, _OPTIONS)
