"""Prediction error: a plant that noise moves, on measured records, by the likelihood of what a filter predicts.

    x' = f(x, u; p) + w,   y = h(x, u; p) + o + v,   w of the density Q, v of the variance r at a sample
    minimise   sum_k sum_j (e_k,j^2/s_k,j + log s_k,j)/2     over p, o, the first states, log Q_i and log r_j

with the innovations e of an extended Kalman filter and their variances s (`innovations`). The filter takes up what
moves the plant beside its inputs, and errors that an unstable plant would let grow: without Q this is the error of a
simulation, which such noise biases under feedback. What w adds to the covariance in a sample is Simpson's rule of

    integral over a sample of  Phi(t) Q Phi(t)',   Phi(1/2) = I + D/2 - D^2/8,   D = Phi(1) - I

The Fisher information is the sum over k and j of de de'/s + ds ds'/(2 s^2).

Sources: K. J. Astroem, "Maximum likelihood and prediction error methods", Automatica 16 (1980); N. R. Kristensen, H.
Madsen, S. B. Joergensen, "Parameter estimation in stochastic grey-box models", Automatica 40 (2004).
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from hgogen.identification.innovations import SURE, Innovations, moved_by_noise
from hgogen.identification.problem import Information, Problem, eliminated, tables
from hgogen.identification.whiteness import influence

Array = np.ndarray
PROCESS = (0.0, -24.0, 12.0)  # log of Q_i T over the squared size of the state, T a record: its start and bounds
SAMPLE = (-4.0, -18.0, 2.0)  # log of r_j over the squared scale of the output: a deviation from a ten-thousandth on


@dataclass(frozen=True, eq=False)
class Predicting(Problem):
    """The problem of a plant on records; `unit` (n): the sizes of its states; `corner`: of the innovations over their
    deviations, infinite for squares."""

    unit: Array | None = None
    corner: float = math.inf

    @property
    def noisy(self) -> tuple[str, ...]:
        """The states with noise of their own."""
        return moved_by_noise([x.name for x in self.plant.states], self.plant.states, self.plant.flow)

    @property
    def levels(self) -> tuple[tuple[float, float, float], ...]:
        """Logarithms of Q_i and r_j."""
        return (*[PROCESS] * len(self.noisy), *[SAMPLE] * len(self.plant.outputs))

    def noise(self, unknowns: Array) -> tuple[dict[str, float], dict[str, float]]:
        """Q_i by state, next to nothing of one without noise of its own, and the deviation of a sample, by output."""
        logs = np.asarray(unknowns)[self.size - len(self.levels) :]
        process = self._density(ca.DM(logs)).full().ravel()
        samples = self.scale * np.exp(logs[len(self.noisy) :] / 2)
        density = zip([x.name for x in self.plant.states], process.tolist(), strict=True)
        deviation = zip([y.name for y in self.plant.outputs], samples.tolist(), strict=True)
        return dict(density), dict(deviation)

    @cached_property
    def graph(self) -> tuple[Any, Any, Any]:
        """The unknowns, -log of the likelihood, and nothing that must be 0."""
        v, cost, _, _ = self._series
        return v, cost, ca.MX(0, 1)

    def residuals(self, unknowns: Array) -> tuple[Array, ...]:
        """The innovations over their deviations."""
        return self.by_output(np.divide(*self._at(unknowns)))

    def information(self, unknowns: Array, unit: Array) -> Information:
        """What is left where the first states and the levels of noise fit best beside each p."""
        v, _, e, s = self._series
        F = ca.Function("fisher", [v], [self._fisher(v, e, s)])(unknowns) * ca.DM(np.outer(unit, unit))
        tell = self.residuals(unknowns)
        if self.corner < math.inf:
            tell = tuple(influence(each, self.corner) for each in tell)
        units = self.by_output(self._at(unknowns)[0])
        return Information(eliminated(F, ca.DM(0, self.size), self.constants), tables(self.records, units), tell)

    def _fisher(self, v: Any, e: Any, s: Any) -> Any:
        J = ca.jacobian(ca.vertcat(e, s), v)  # in one pass
        of_e, of_s = J[: e.numel(), :] / ca.sqrt(s), J[e.numel() :, :] / s
        return of_e.T @ of_e + of_s.T @ of_s / 2

    def _at(self, unknowns: Array) -> tuple[Array, Array]:
        """All e where something was measured, and their deviations."""
        v, _, e, s = self._series
        values = ca.Function("at", [v], [e, ca.sqrt(s)])(unknowns)
        return values[0].full().ravel(), values[1].full().ravel()

    @cached_property
    def _series(self) -> tuple[Any, Any, Any, Any]:
        """The unknowns (MX), the cost, and e and s where something was measured, as columns."""
        v = ca.MX.sym("v", self.size)
        p, o, every = self.parts(v)
        theta = ca.vertcat(p, o, v[self.size - len(self.levels) :])
        costs, errors, variances = [], [], []
        for record, nodes in zip(self.records, every, strict=True):
            memory = ca.vertcat(nodes[:, 0], ca.DM.zeros(self.n**2))
            cost, e, s = self._filter(record.dt).along(record, memory, theta)
            there = np.flatnonzero(np.isfinite(record.y).ravel()).tolist()  # by sample and output, as a column of e is
            costs.append(ca.sum2(cost))
            errors.append(ca.vec(e)[there])
            variances.append(ca.vec(s)[there])
        return v, sum(costs), ca.vertcat(*errors), ca.vertcat(*variances)

    def _filter(self, dt: float) -> Innovations:
        """At a period, with theta of the parameters, offsets and levels."""
        a, b, theta = len(self.free), self.constants, ca.SX.sym("theta", self.constants + len(self.levels))
        x, Phi = ca.SX.sym("x", self.n), ca.SX.sym("Phi", self.n, self.n)
        u, then = (ca.SX.sym(name, len(self.plant.inputs)) for name in ("u", "then"))
        p, o, levels = theta[:a], theta[a:b], theta[b:]
        samples = ca.DM(self.scale**2) * ca.exp(levels[len(self.noisy) :])
        return Innovations(
            ca.Function("move", [x, u, then, theta], [self.step(x, p, u, then, dt)]),
            ca.Function("read", [x, u, theta], [self.reading(x, p, o, u)]),
            ca.Function("process", [theta, Phi], [gathered(Phi, ca.diag(self._density(levels) * dt))]),
            ca.Function("sensor", [theta], [samples]),
            np.array([x.interval for x in self.plant.states]).T,
            self.corner,
        )

    def _density(self, levels: Any) -> Any:
        """Q (n), of the logarithms; of a state without noise of its own next to nothing."""
        duration = max(len(record.y) * record.dt for record in self.records)
        shares = dict(zip(self.noisy, ca.vertsplit(levels[: len(self.noisy)]), strict=True))
        each = [ca.exp(shares[x.name]) if x.name in shares else SURE for x in self.plant.states]
        return ca.vertcat(*each) * ca.DM(np.asarray(self.unit) ** 2 / duration)


def gathered(Phi: Any, Q: Any) -> Any:
    """What noise that has Q (n, n) in a sample adds to the covariance along it."""
    eye = ca.DM.eye(Phi.shape[0])
    D = Phi - eye
    half = eye + D / 2 - D @ D / 8
    return (Phi @ Q @ Phi.T + 4 * half @ Q @ half.T + Q) / 6
