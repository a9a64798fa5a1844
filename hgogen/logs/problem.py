"""Fitting problems: the unknowns of a plant on measured logs, its discrete-time model, and the search.

    x_(k+1) = F(x_k, u_k, u_(k+1); p),   y_k = h(x_k, u_k; p) + o

F by classical Runge-Kutta, a few steps a sample, or the map of a discrete plant. The unknowns are the parameters p, the
offsets o, and the initial states of the segments of the logs.

Identifiability: with F the Fisher information on (parameters and offsets p, the others s), and A the Jacobian of the
equality constraints, of which the columns of p and s are A_p and A_s,

    M = F_pp - [F_ps  A_p'] [[F_ss, A_s'], [A_s, 0]]^-1 [[F_sp], [A_p]]

is the information on p when s is optimal for each p, all in units of ranges. To F_ss 1e-10 is added: an unobservable
state is known to lie somewhere in its range. M^-1 sigma^2 is the covariance of p if residuals are white.

IPOPT solves the problem with exact derivatives, from one start after the other, with unknowns in units of their ranges.
A quadratic penalty pulls each parameter and offset to its start, with weight 1e-3 per unit: a direction that the logs
do not determine stays at its start instead of drifting to a bound. For a determined direction 1e-6 of a squared unit is
negligible.

T. Soederstroem, P. Stoica, System Identification (1989), chapters 7 and 11.
"""

import hashlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from hgogen.discretisation.runge_kutta import advance, plant_tableau, repeated
from hgogen.graph import Graph, to_casadi
from hgogen.logs.likelihood import SURE, Innovations, log_odds, spans_of, states_with_noise
from hgogen.logs.records import BadLog, Log, quantum_of
from hgogen.part import on_line
from hgogen.program import column
from hgogen.registry import version
from hgogen.rigor.singular import TINY, with_limited_slopes
from hgogen.run.consistency import influence
from hgogen.sentence import Encoded
from hgogen.signal import Signal, plural, resting
from hgogen.system import System
from hgogen.trial import deferred_interrupt

Array = np.ndarray
SOMEWHERE = 1e-10
POINTS = 40
FOLLOWED = 1.0  # |h lambda| of a Runge-Kutta step, at most
MOST_STEPS = 50  # Runge-Kutta steps in a sample, at most
_STEPS = 64  # Runge-Kutta steps in one graph of scalars
PROCESS = (0.0, -24.0, 12.0)  # log of Q_i T over the squared size of the state, T a record: its start and bounds
SAMPLE = (-4.0, -18.0, 2.0)  # log of r_j over the squared scale of the output: a deviation from a ten-thousandth on


@dataclass(frozen=True, eq=False)
class Information:
    """The Fisher information `M` (q, q) of the parameters and offsets in their units, for residuals of standard
    deviation 1; `residuals`: (N, p) of each log, in the units of the outputs, NaN for missing samples; `tell`: by
    output, the residuals of all logs weighted by the loss, in the units of M."""

    M: Array
    residuals: tuple[Array, ...]
    tell: tuple[Array, ...]

    @property
    def outputs(self) -> tuple[Array, ...]:
        """The residuals of each output, those of all logs in sequence."""
        return tuple(column[np.isfinite(column)] for column in np.concatenate(self.residuals).T)


@dataclass(frozen=True, eq=False)
class _OnRecords:
    """The problem of fitting a plant to data logs, by multiple shooting (`Shooting`) or prediction
    error (`Predicting`). `scale` (p): the divisor of each output's residuals; `length`: samples
    of a segment; `steps`: Runge-Kutta steps a sample; `between`: inputs between samples, "hold"
    or "line"; `offset`: the outputs with an unknown constant added. The vector of unknowns is
    (parameters `free`, offsets, the initial states of all segments, log by log, noise levels)."""

    plant: System
    free: tuple[Signal, ...]
    records: tuple[Log, ...]
    scale: Array
    length: int
    steps: int
    between: str = "hold"
    offset: tuple[Signal, ...] = ()

    @property
    def levels(self) -> tuple[tuple[float, float, float], ...]:
        return ()

    def noise(self, unknowns: Array) -> tuple[dict[str, float], dict[str, float]]:
        return {}, {}

    @cached_property
    def step(self) -> Any:
        """The CasADi function (x, p, u now, u then, dt) -> x at the next sample of the plant x' = f(x, u; p)."""
        x, p, h = ca.SX.sym("x", self.n), ca.SX.sym("p", len(self.free)), ca.SX.sym("dt")
        u, then = (ca.SX.sym(name, len(self.plant.inputs)) for name in ("u", "then"))

        def rate(values: Any, c: float) -> dict[str, Graph]:
            turns, count = [s.period for s in self.plant.inputs], len(self.plant.supplied)
            now = on_line(c, u, then, turns)
            now = ca.vertcat(u[:count, :], now[count:, :]) if self.between == "hold" else now
            return {"x": (1 if self.plant.discrete else h) * self._of(self.plant.flow, values["x"], p, now)}

        advanced = advance(repeated(plant_tableau(self.plant), self.steps), rate, {"x": x}, 1.0).result[
            "x"
        ]  # in samples
        return ca.Function("step", [x, p, u, then, h], [advanced])

    @cached_property
    def reading(self) -> Any:
        x, p, o = ca.SX.sym("x", self.n), ca.SX.sym("p", len(self.free)), ca.SX.sym("o", len(self.offset))
        u = ca.SX.sym("u", len(self.plant.inputs))
        added = [o[self.offset.index(y)] if y in self.offset else 0 for y in self.plant.outputs]
        return ca.Function("reading", [x, p, o, u], [self._of(self.plant.output, x, p, u) + ca.vertcat(*added)])

    @cached_property
    def output(self) -> Array:
        return np.concatenate([np.nonzero(np.isfinite(record.y))[1] for record in self.records])

    def by_output(self, values: Array) -> tuple[Array, ...]:
        return tuple(values[self.output == j] for j in range(len(self.plant.outputs)))

    @property
    def n(self) -> int:
        return len(self.plant.states)

    @property
    def constants(self) -> int:
        return len(self.free) + len(self.offset)

    @property
    def segments(self) -> tuple[int, ...]:
        return tuple(-(-len(record.y) // self.length) for record in self.records)

    @property
    def size(self) -> int:
        return self.constants + self.n * sum(self.segments) + len(self.levels)

    def parts(self, unknowns: Graph) -> tuple[Graph, Graph, tuple[Graph, ...]]:
        a, b = len(self.free), self.constants
        nodes, begin = [], b
        for count in self.segments:
            nodes.append(ca.reshape(unknowns[begin : begin + self.n * count], self.n, count))
            begin += self.n * count
        return unknowns[:a], unknowns[a:b], tuple(nodes)

    def _of(self, rows: Sequence[Any], x: Graph, p: Graph, u: Graph) -> Graph:
        values: dict[Any, Graph] = {q: ca.SX(float(value)) for q, value in self.plant.nominal.items()}
        values |= dict(zip(self.plant.states, ca.vertsplit(x), strict=True))
        values |= dict(zip(self.free, ca.vertsplit(p), strict=True)) if self.free else {}
        values |= dict(zip(self.plant.inputs, ca.vertsplit(u), strict=True)) if self.plant.inputs else {}
        return column(to_casadi([with_limited_slopes(row, self.plant.box, TINY) for row in rows], values))


def short_way(differences: Any, signals: Sequence[Signal]) -> Any:
    """Return the differences (column, MX) of two values of these signals; for a periodic signal the difference within
    half a period."""
    periods = np.array([signal.period or 0.0 for signal in signals])
    if not periods.any():
        return differences
    turns = ca.floor(differences * ca.DM(np.divide(1, periods, out=np.zeros_like(periods), where=periods > 0)) + 0.5)
    return differences - ca.DM(periods) * turns


def schur_complement(F: Any, A: Any, q: int) -> Array:
    """Return the information M (q, q) on the first q unknowns when all others are optimal: the Schur complement of the
    Hessian F (v, v) under the constraints A dx = 0; F and A (gaps, v) may be sparse."""
    F, A = ca.DM(F), ca.DM(A)
    A_p, A_s = A[:, :q], A[:, q:]
    F_regular = F[q:, q:] + SOMEWHERE * ca.DM.eye(F.shape[0] - q)
    K = ca.blockcat([[F_regular, A_s.T], [A_s, ca.DM(A.shape[0], A.shape[0])]])
    side = ca.vertcat(F[q:, :q], A_p)
    M = (F[:q, :q] - side.T @ ca.solve(K, side, "qr")).full()
    return np.asarray((M + M.T) / 2)


def tables(records: Sequence[Log], outputs: Sequence[Array]) -> tuple[Array, ...]:
    """Return tables (N, p) for each log, NaN for missing samples, from the values of each output at its measured
    samples, log after log."""
    arrays = [np.full(record.y.shape, np.nan) for record in records]
    for j, values in enumerate(outputs):
        begin = 0
        for record, table in zip(records, arrays, strict=True):
            there = np.isfinite(record.y[:, j])
            end = begin + int(there.sum())
            table[there, j] = values[begin:end]
            begin = end
    return tuple(arrays)


def steps_and_growth(plant: System, period: float) -> tuple[int, float]:
    """Return the number of Runge-Kutta steps a sample that the plant's fastest mode requires (1 for a discrete plant),
    and the growth rate of errors; `period`: that of the samples. Raises: `BadLog` for samples too slow for the
    plant."""
    fastest, growing = rates(plant)
    if plant.discrete:
        return 1, math.log(max(fastest, 1.0)) / period
    steps = max(1, math.ceil(fastest * period / FOLLOWED))
    if steps > MOST_STEPS:
        reason = f"moves at rates up to {fastest:.3g}, too fast for samples {period:g} apart"
        fix = f"are the times in {plural(plant.time)}? Else narrow its ranges, or give a log with more samples"
        raise BadLog(f"plant {plant.name!r}", f"{reason}; {fix}")
    return steps, growing


def rates(plant: System) -> tuple[float, float]:
    """Return the largest modulus and the largest real part (0 if none is positive) of an eigenvalue of df/dx, over the
    nominal point at rest and random points of the declared ranges."""
    draw, n, signals = np.random.default_rng(0), len(plant.states), (*plant.states, *plant.inputs, *plant.parameters)
    symbols = {s: ca.SX.sym(s.name) for s in signals}
    at = column(symbols.values())
    flow = column(to_casadi([with_limited_slopes(row, plant.box) for row in plant.flow], symbols))
    jacobian = ca.Function("jacobian", [at], [ca.jacobian(flow, at)[:, :n]])
    spectra = [np.zeros(1)]
    for k in range(POINTS):
        J = jacobian([draw.uniform(*s.interval) if s.bounded and k else resting(s) for s in signals]).full()
        if np.isfinite(J).all():
            spectra.append(np.linalg.eigvals(J))
    every = np.concatenate(spectra)
    return float(np.abs(every).max()), float(max(0.0, every.real.max()))


@dataclass(frozen=True, eq=False)
class Shooting(_OnRecords):
    """Multiple shooting: the fit of a plant to logs as one nonlinear least-squares problem.

        minimise   1/2 sum_k sum_j ((y_k,j - h_j(x_k, u_k; p) - o_j)/s_j)^2
        subject to x_(k+1) = F(x_k, u_k, u_(k+1); p)

    A log is cut into segments with unknown initial states; constraints join the end of each to the beginning of the
    next. A short trajectory depends nearly linearly on its parameters; one over a whole log may rotate or grow many
    times.

    A residual e costs e^2/2, or with a corner c the pseudo-Huber loss c^2 (sqrt(1 + (e/c)^2) - 1), which grows like c
    |e| beyond c. `corner` (p): of each output, in units of its scale, None for squares.

    Sources: H. G. Bock, "Numerical treatment of inverse problems in chemical reaction kinetics", Springer Series in
    Chemical Physics 18 (1981); of the loss: Charbonnier, Blanc-Feraud, Aubert, Barlaud, IEEE Trans. Image Processing 6
    (1997).
    """

    corner: Array | None = None

    @cached_property
    def graph(self) -> tuple[Any, Any, Any]:
        """The fit as CasADi graphs: the unknowns, the cost, and the gaps between segments, which are 0 at a
        solution."""
        v, errors, gaps = self.followed
        if self.corner is None:
            return v, ca.sumsqr(errors) / 2, gaps
        c = ca.DM(self.corner[self.output])
        return v, ca.sum1(c**2 * (ca.sqrt(1 + (errors / c) ** 2) - 1)), gaps

    @cached_property
    def followed(self) -> tuple[Any, Any, Any]:
        """The simulation as CasADi columns: the unknowns, the residuals of the measured samples, and the gaps between
        segments."""
        v = ca.MX.sym("v", self.size)
        p, o, every = self.parts(v)
        errors, gaps = [], []
        for record, nodes in zip(self.records, every, strict=True):
            of_record, gap = self._of_record(record, nodes, p, o)
            errors.append(of_record)
            gaps.append(gap)
        return v, ca.vertcat(*errors), ca.vertcat(*gaps)

    def residuals(self, unknowns: Array) -> tuple[Array, ...]:
        """Return the residuals of each output's measured samples over its scale, log after log, at the `unknowns`
        (v)."""
        v, errors, _ = self.followed
        return self.by_output(ca.Function("residuals", [v], [errors])(unknowns).full().ravel())

    def information(self, unknowns: Array, unit: Array) -> Information:
        """Return the Fisher information of the parameters at the unknowns (v), whose sizes are `unit` (v). The states
        are eliminated: the continuity constraints of multiple shooting determine them."""
        v, errors, gaps = self.followed
        at = ca.Function("at", [v], [ca.jacobian(errors, v), ca.jacobian(gaps, v)])
        J, A = (table @ ca.diag(unit) for table in at(unknowns))
        residuals = self.residuals(unknowns)
        units = [e * scale for e, scale in zip(residuals, self.scale, strict=True)]
        corners = (None,) * len(units) if self.corner is None else self.corner
        tell = [e if c is None else influence(e, c) for e, c in zip(residuals, corners, strict=True)]
        return Information(schur_complement(J.T @ J, A, self.constants), tables(self.records, units), tuple(tell))

    def _of_record(self, record: Log, nodes: Any, p: Any, o: Any) -> tuple[Any, Any]:
        """Return the residuals of a data log and the gaps between its segments;
        `nodes`: their initial states, `p`: parameters, `o`: offsets. One map
        computes all segments; the last is padded with samples that do not count."""
        L, count, N = self.length, nodes.shape[1], len(record.y)
        u = record.u[np.minimum(np.arange(count * L + 1), N - 1)]
        now, then = (part.reshape(count, L, -1) for part in (u[:-1], u[1:]))
        ahead = np.pad(record.ahead, (0, count * L - N), constant_values=record.dt).reshape(count, L)
        parts = -(-L * self.steps // _STEPS)
        read, at, size = [], nodes, -(-L // parts)
        for k in range(0, L, size):
            inputs = (part[:, k : k + size].reshape(count, -1).T for part in (now, then))
            outputs, at = self._stretch(min(size, L - k)).map(count)(at, p, o, *inputs, ahead[:, k : k + size].T)
            read.append(outputs)
        table = ca.vec(ca.vertcat(*read))  # by segment, sample and output
        place, output = np.nonzero(np.isfinite(record.y))
        errors = record.y[place, output] - table[(place * record.y.shape[1] + output).tolist()]
        errors = short_way(errors, [self.plant.outputs[j] for j in output]) / self.scale[output]
        return errors, short_way(ca.vec(nodes[:, 1:] - at[:, :-1]), self.plant.states * (count - 1))

    def _stretch(self, samples: int) -> Any:
        """Return the function (x, p, offsets, u and the next u of `samples`
        samples, their times to the next) -> (y at the samples, x after them), a graph of scalars
        (SX): its second derivatives are twice as fast in CasADi."""
        x, p, o = (ca.SX.sym("v", size) for size in (self.n, len(self.free), len(self.offset)))
        now, then = (ca.SX.sym("u", len(self.plant.inputs), samples) for _ in range(2))
        at, ahead, read = x, ca.SX.sym("ahead", samples), []
        for k in range(samples):
            read.append(self.reading(at, p, o, now[:, k]))
            at = self.step(at, p, now[:, k], then[:, k], ahead[k])
        return ca.Function("stretch", [x, p, o, ca.vec(now), ca.vec(then), ahead], [ca.vertcat(*read), at])


@dataclass(frozen=True, eq=False)
class Predicting(_OnRecords):
    """Prediction error: the fit of a plant with process noise to logs, by the likelihood of a filter's innovations.

        x' = f(x, u; p) + w,   y = h(x, u; p) + o + v,   w of the density Q, v of the variance r at a sample
        minimise   sum_k sum_j (e_k,j^2/s_k,j + log s_k,j)/2     over p, o, the first states, log Q_i and log r_j

    with the innovations e of an extended Kalman filter and their variances s (`innovations`). The filter absorbs the
    disturbances, and errors that an unstable plant would let grow. Without Q this is the simulation error, which
    disturbances under feedback bias. Simpson's rule gives what w adds to the covariance in a sample,

        integral over a sample of  Phi(t) Q Phi(t)',   Phi(1/2) = I + D/2 - D^2/8,   D = Phi(1) - I

    The Fisher information is the sum over k and j of de de'/s + ds ds'/(2 s^2). `unit` (n): the sizes of the states;
    `robust`: whether samples may be outliers, as in `logs.likelihood`.

    Sources: K. J. Astroem, "Maximum likelihood and prediction error methods", Automatica 16 (1980); N. R. Kristensen,
    H. Madsen, S. B. Joergensen, "Parameter estimation in stochastic grey-box models", Automatica 40 (2004).
    """

    unit: Array | None = None
    robust: bool = False

    @property
    def noisy(self) -> tuple[str, ...]:
        """The names of the states that have process noise."""
        return states_with_noise([x.name for x in self.plant.states], self.plant.states, self.plant.flow)

    @property
    def levels(self) -> tuple[tuple[float, float, float], ...]:
        """The start and the bounds of the logarithms of Q_i and r_j; r_j is at least q^2/12 by the quantum q of its
        output."""
        start, low, high = SAMPLE
        quanta = [quantum_of(column) for column in np.concatenate([record.y for record in self.records]).T]
        pairs = zip(quanta, self.scale, strict=True)
        least = [min(max(low, 2 * math.log(q / (math.sqrt(12) * unit))) if q else low, high) for q, unit in pairs]
        return (*[PROCESS] * len(self.noisy), *((max(start, each), each, high) for each in least))

    def noise(self, unknowns: Array) -> tuple[dict[str, float], dict[str, float]]:
        """Return at the `unknowns` (v) the density Q_i of process noise by state (negligible for a state without
        process noise), and the standard deviation of a sample by output."""
        logs = np.asarray(unknowns)[self.size - len(self.levels) :]
        process = self._density(ca.DM(logs)).full().ravel()
        samples = self.scale * np.exp(logs[len(self.noisy) :] / 2)
        density = zip([x.name for x in self.plant.states], process.tolist(), strict=True)
        deviation = zip([y.name for y in self.plant.outputs], samples.tolist(), strict=True)
        return dict(density), dict(deviation)

    @cached_property
    def graph(self) -> tuple[Any, Any, Any]:
        """The fit as CasADi graphs: the unknowns, -log of the likelihood, and an empty column of constraints."""
        v, cost, _, _ = self._series
        return v, cost, ca.MX(0, 1)

    def residuals(self, unknowns: Array) -> tuple[Array, ...]:
        """Return the innovations of each output over their standard deviations, at the `unknowns` (v)."""
        return self.by_output(np.divide(*self._at(unknowns)))

    def information(self, unknowns: Array, unit: Array) -> Information:
        """Return the Fisher information of the parameters at the unknowns (v), whose sizes are `unit` (v), with the
        first states and the noise levels optimal for all parameter values."""
        v, _, e, s = self._series
        F = ca.Function("fisher", [v], [self._fisher(v, e, s)])(unknowns) * ca.DM(np.outer(unit, unit))
        tell, (errors, deviations) = self.residuals(unknowns), map(self.by_output, self._at(unknowns))
        if self._spans is not None:
            each = zip(tell, deviations, self._spans, strict=True)
            odds = [log_odds(r * r, 2 * np.log(deviation), span) for r, deviation, span in each]
            weights = [np.exp(-np.logaddexp(0, -of_output)) for of_output in odds]
            tell = tuple(r * w / w.mean() for r, w in zip(tell, weights, strict=True))
        return Information(schur_complement(F, ca.DM(0, self.size), self.constants), tables(self.records, errors), tell)

    def _fisher(self, v: Any, e: Any, s: Any) -> Any:
        J = ca.jacobian(ca.vertcat(e, s), v)  # in one pass
        of_e, of_s = J[: e.numel(), :] / ca.sqrt(s), J[e.numel() :, :] / s
        return of_e.T @ of_e + of_s.T @ of_s / 2

    def _at(self, unknowns: Array) -> tuple[Array, Array]:
        v, _, e, s = self._series
        values = ca.Function("at", [v], [e, ca.sqrt(s)])(unknowns)
        return values[0].full().ravel(), values[1].full().ravel()

    @cached_property
    def _series(self) -> tuple[Any, Any, Any, Any]:
        v = ca.MX.sym("v", self.size)
        p, o, every = self.parts(v)
        theta = ca.vertcat(p, o, v[self.size - len(self.levels) :])
        costs, errors, variances = [], [], []
        for record, nodes in zip(self.records, every, strict=True):
            memory = ca.vertcat(nodes[:, 0], ca.DM.zeros(self.n**2))
            cost, e, s = self._filter.along(record, memory, theta)
            there = np.flatnonzero(np.isfinite(record.y).ravel()).tolist()  # by sample and output, as a column of e is
            costs.append(ca.sum2(cost))
            errors.append(ca.vec(e)[there])
            variances.append(ca.vec(s)[there])
        return v, sum(costs), ca.vertcat(*errors), ca.vertcat(*variances)

    @cached_property
    def _filter(self) -> Innovations:
        a, b, theta = len(self.free), self.constants, ca.SX.sym("theta", self.constants + len(self.levels) + 1)
        x, Phi = ca.SX.sym("x", self.n), ca.SX.sym("Phi", self.n, self.n)
        u, then = (ca.SX.sym(name, len(self.plant.inputs)) for name in ("u", "then"))
        p, o, levels, dt = theta[:a], theta[a:b], theta[b:-1], theta[-1]
        samples = ca.DM(self.scale**2) * ca.exp(levels[len(self.noisy) :])
        Q = ca.diag(self._density(levels))
        return Innovations(
            ca.Function("move", [x, u, then, theta], [self.step(x, p, u, then, dt)]),
            ca.Function("read", [x, u, theta], [self.reading(x, p, o, u)]),
            ca.Function("process", [theta, Phi], [Q if self.plant.discrete else accumulated_noise(Phi, Q * dt)]),
            ca.Function("sensor", [theta], [samples]),
            self.plant.outputs,
            np.array([x.limits for x in self.plant.states]).T,
            self._spans,
        )

    @cached_property
    def _spans(self) -> Array | None:
        return spans_of(self.plant.outputs, self.records) if self.robust else None

    def _density(self, levels: Any) -> Any:
        """Return the process noise density Q (n) from the logarithms
        `levels`; negligible for a state without noise of its own."""
        duration = max(len(one.y) if self.plant.discrete else one.duration for one in self.records)
        shares = dict(zip(self.noisy, ca.vertsplit(levels[: len(self.noisy)]), strict=True))
        each = [ca.exp(shares[x.name]) if x.name in shares else SURE for x in self.plant.states]
        return ca.vertcat(*each) * ca.DM(np.asarray(self.unit) ** 2 / duration)


Problem = Shooting | Predicting


def accumulated_noise(Phi: Any, Q: Any) -> Any:
    """Return the covariance that white noise of the density Q (n, n) adds over a sample with transition matrix Phi (n,
    n): the integral of Phi(t) Q Phi(t)', by Simpson's rule."""
    eye = ca.DM.eye(Phi.shape[0])
    D = Phi - eye
    half = eye + D / 2 - D @ D / 8
    return (Phi @ Q @ Phi.T + 4 * half @ Q @ half.T + Q) / 6


PULL = 1e-3
ITERATIONS = 200
TOLERANCE = 1e-8
_OPTIONS = {"print_level": 0, "sb": "yes", "max_iter": ITERATIONS, "tol": TOLERANCE}
_CONTINUED = {"bound_push": 1e-8, "bound_frac": 1e-8}  # to continue from an iterate close to a bound
_OTHER = {
    "plant": "another plant",
    "records": "other records",
    "options": "other options",
    "version": "another version of hgogen",
}


@dataclass(frozen=True, eq=False)
class Solution:
    """The end of a search: the `unknowns` with their `cost` (without the penalty), IPOPT's `status` and number of
    `iterations`; `settled`: whether the search converged."""

    unknowns: Array
    cost: float
    status: str
    iterations: int
    settled: bool


@dataclass(frozen=True, eq=False)
class Solver:
    """A solver (IPOPT) of the problem of a fit: `low`, `high` (v): the bounds of the unknowns, possibly infinite;
    `unit` (v): their sizes."""

    problem: Problem
    low: Array
    high: Array
    unit: Array

    def solve(
        self, start: Array, at: Array | None = None, each: Callable[[int, Array], None] = lambda k, last: None
    ) -> Solution:
        """Return the solution of a search that begins from the unknowns `start` (v), or continues from `at` (v); a
        penalty pulls parameters and offsets towards `start`. `each(k, last)` is called after iteration k with its
        unknowns."""
        begin, first = (np.clip(v, self.low, self.high) / self.unit for v in (start, start if at is None else at))
        watch, solver = self._watched if at is None else self._callback_and_solver(_OPTIONS | _CONTINUED)
        watch.begin(lambda k, w: each(k, w * self.unit))
        bounds = {"lbx": self.low / self.unit, "ubx": self.high / self.unit, "lbg": 0, "ubg": 0}
        with deferred_interrupt() as watch.interrupts:
            result = solver(x0=first, p=begin[: self._pulled], **bounds)
        if watch.raised:
            raise watch.raised[0]
        end = result["x"].full().ravel() * self.unit
        cost, stats = float(self._cost(end)), solver.stats()
        return Solution(end, cost, stats["return_status"], stats["iter_count"], bool(stats["success"]))

    @property
    def _pulled(self) -> int:
        return self.problem.constants

    @cached_property
    def _watched(self) -> tuple["_Watch", Any]:
        """The callback and the solver that all searches from a start share,
        since building derivatives takes as long as some searches do."""
        return self._callback_and_solver(_OPTIONS)

    def _callback_and_solver(self, ipopt: dict[str, Any]) -> tuple["_Watch", Any]:
        watch = _Watch(self.problem.size, self._nlp["g"].numel())
        options: Any = {"print_time": False, "ipopt": ipopt, "iteration_callback": watch, "show_eval_warnings": False}
        return watch, ca.nlpsol("fit", "ipopt", self._nlp, options)

    @cached_property
    def _cost(self) -> Any:
        v, cost, _ = self.problem.graph
        return ca.Function("cost", [v], [cost])

    @cached_property
    def _nlp(self) -> dict[str, Any]:
        v, cost, gaps = self.problem.graph
        w, p = ca.MX.sym("w", self.problem.size), ca.MX.sym("p", self._pulled)
        least, jumps = ca.Function("problem", [v], [cost, gaps])(w * self.unit)
        return {"x": w, "p": p, "f": least + ca.sumsqr(PULL * (w[: self._pulled] - p)) / 2, "g": jumps}


class _Watch(ca.Callback):
    """The callback that CasADi calls after each iteration of IPOPT."""

    def __init__(self, unknowns: int, gaps: int) -> None:
        super().__init__()
        self.sizes = {"x": unknowns, "f": 1, "g": gaps, "lam_x": unknowns, "lam_g": gaps, "lam_p": 0}
        self.construct("watch", {})

    def begin(self, each: Callable[[int, Array], None]) -> None:
        self.each, self.count, self.interrupts, self.raised = each, 0, list[Any](), list[Exception]()

    def get_n_in(self) -> int:
        """Return the number of values that a CasADi solver passes to its callback."""
        return int(ca.nlpsol_n_out())

    def get_sparsity_in(self, i: int) -> Any:
        """Return the shape of value `i` that a CasADi solver passes to its callback: a column, empty if unneeded."""
        return ca.Sparsity.dense(self.sizes.get(ca.nlpsol_out(i), 0), 1)

    def eval(self, entries: Any) -> list[int]:
        """Report the iterate. Return 0 to continue, a positive number to stop after a Ctrl-C or an error, which CasADi
        would replace by its own."""
        try:
            self.each(self.count, entries[ca.nlpsol_out().index("x")].full().ravel())
        except Exception as error:
            self.raised.append(error)
        self.count += 1
        return [len(self.interrupts) + len(self.raised)]


class CannotGoOn(BadLog):
    """The error for saved progress that is invalid, or belongs to another fit or tuning."""


@dataclass(frozen=True, eq=False)
class Progress(Encoded):
    """The progress of a fit, which is identified by the digests `task`: the results of the searches that `ended`, and
    of the running one the `iteration` and its unknowns `at` (v)."""

    task: Mapping[str, str]
    ended: tuple[Solution, ...]
    iteration: int
    at: Array

    @property
    def start(self) -> int:
        """The number of the running search, from 0: first one for each start, then those with weights from the noise of
        the outputs, then the passes of a robust fit."""
        return len(self.ended)


def progress_of(table: Mapping[str, Any]) -> Progress:
    """Return the progress of a fit from a `table` that `as_dict` returned. Raises: `CannotGoOn`."""
    try:
        ended = []
        for one in table["ended"]:
            cost = float("nan") if one["cost"] is None else float(one["cost"])
            how = (str(one["status"]), int(one["iterations"]), bool(one["settled"]))
            ended.append(Solution(np.array(one["unknowns"], dtype=float), cost, *how))
        task = {str(what): str(digest) for what, digest in table["task"].items()}
        return Progress(task, tuple(ended), int(table["iteration"]), np.array(table["at"], dtype=float))
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        raise CannotGoOn("the stopped fit", "is not as a fit leaves it; fit anew") from None


def digests(plant: System, records: Iterable[Log], options: Mapping[str, Any]) -> dict[str, str]:
    """Return the digests that identify a fit or a tuning: those of the plant, the logs, the options, and the
    version."""
    signals = [(s.name, s.nominal, s.interval, *([s.period] if s.period else [])) for s in plant.signals]
    arrays = [part for log in records for part in (log.u.tobytes(), log.y.tobytes(), log.ahead.tobytes())]
    return {
        "plant": _digest(signals, plant.flow, plant.output, plant.time),
        "records": _digest(*arrays),
        "options": _digest(*sorted(options.items())),
        "version": version(),
    }


def demand_same(what: str, stopped: Mapping[str, str], task: Mapping[str, str]) -> None:
    """Raise `CannotGoOn` if the digests of a `stopped` fit or tuning differ from those of the `task`; `what`: its name
    in the message."""
    if others := [_OTHER[part] for part, digest in task.items() if stopped.get(part) != digest]:
        raise CannotGoOn(what, f"is of {' and '.join(others)}; give it what it was begun with, or begin anew")


def _digest(*parts: Any) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part if isinstance(part, bytes) else f"{part}\n".encode())
    return digest.hexdigest()[:16]


@dataclass(frozen=True, eq=False)
class Searches:
    """The searches of a fit, one after the other; those that the progress `resumed` contains are not repeated. `each`
    is called after every iteration."""

    task: Mapping[str, str]
    each: Callable[[Progress], None]
    resumed: Progress | None

    def __post_init__(self) -> None:
        if self.resumed is not None:
            demand_same("the stopped fit", self.resumed.task, self.task)

    def solved(self, solver: Solver, begin: Array, ended: tuple[Solution, ...]) -> tuple[Solution, ...]:
        """Return the solutions `ended`, followed by that of one more search, by `solver` from the unknowns `begin`."""
        resumed = self.resumed
        if resumed is not None and len(ended) < resumed.start:
            return (*ended, resumed.ended[len(ended)])
        here = resumed is not None and len(ended) == resumed.start and resumed.iteration
        at = resumed.at if resumed is not None and here else None
        if at is not None and len(at) != len(begin):
            raise CannotGoOn("the stopped fit", "has another number of unknowns; fit anew")
        return (*ended, solver.solve(begin, at, lambda k, last: self.each(Progress(self.task, ended, k, last))))
