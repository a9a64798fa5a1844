"""The noise of a plant from a log, by the likelihood of the innovations of an extended Kalman filter along it.

    e_j = y_j - h_j(x-),   s_j = H_j P- H_j' + r_j,   x = x- + K e,   P = P- - K s K'      outputs one after the other
    x- = F(x, u),   P- = Phi P Phi' + q(Phi),   Phi = dF/dx                                the next sample

A missing sample is skipped. With innovation gates (`estimators.gate`) a sample beyond its gate is an outlier, which is
missing, too, for the filter and for the likelihood of Q and R. The samples that are left have smaller innovations than
all: the mean of d = r' S^-1 r over those with d <= gamma is k kappa instead of k for k samples that pass together,

    kappa = F_(k+2)(gamma)/F_k(gamma),   F_k: the distribution function of chi-square with k degrees of freedom

so that e^2 is divided by kappa. Outliers are sought by a fit with outliers (below), then by gates and fits in turn,
until they repeat. No fit by gates alone decides: with a cost for each outlier, Q and R -> 0 would make all samples
outliers, or none, as the units of y decide.

An innovation costs (e^2/s + log s)/2, so that the sum is -log of the likelihood of the
log, but for a constant. With outliers a sample is one with the probability pi = .05, anywhere in a span W, that of the
output's samples: the filter is that of probabilistic data association, with the density

    p(e) = (1 - pi) N(e; 0, s) + pi/W,   w = (1 - pi) N(e; 0, s)/p(e):   the probability that it is none
    x = x- + w K e,   P = P- - w K s K' + w (1 - w) e^2 K K',   cost -log p(e)

A Student t is no such density: with 4 degrees of freedom R grows by a half and more for outliers of 30 standard
deviations in 5 % of the samples, with this density by some per cent.

Here F is by classical Runge-Kutta, and Q diagonal. The variance of a sample is at least q^2/12, that of rounding to the
quantum q of its column. The likelihood is maximised over log Q_i and log sigma_j^2 by IPOPT
with exact gradients, from several starts, since it has several maxima.

Sources: F. C. Schweppe, IEEE Transactions on Information Theory 11 (1965); Y. Bar-Shalom, T. E. Fortmann, Tracking and
Data Association (1988).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import casadi as ca
import numpy as np
import sympy as sp
from flint import arb

from hgogen.analysis.dynamics import clamp
from hgogen.discretisation.runge_kutta import open_loop
from hgogen.estimators.gate import GatedGroup
from hgogen.estimators.gating import passing_limit, squared_distance
from hgogen.form import Form
from hgogen.graph import wrapped
from hgogen.logs.records import Log, quantum_of, reading_of
from hgogen.program import column
from hgogen.signal import Signal, resting
from hgogen.starting import Scale

Array = np.ndarray
OUTLIERS = 0.05  # pi, of samples with outliers
ROUNDING = 2.0**-24  # of a range: the steps of float
SURE = 1e-10  # units of process noise for a coordinate without any
AT_ONCE = 50  # samples between checkpoints of CasADi's reverse mode


def states_with_noise(names: Sequence[str], states: Sequence[sp.Symbol], flow: Iterable[sp.Expr]) -> tuple[str, ...]:
    """Return the names of the states that have process noise; `flow`: the rates x'. A state whose rate is by definition
    another state (x_i' = +-x_j) has none, since noise would contradict the definition; if no state is left, all have
    noise."""
    by_definition = {*states, *(-x for x in states)}
    noisy = [name for name, row in zip(names, flow, strict=True) if row.expand() not in by_definition]
    return tuple(noisy or names)


@dataclass(frozen=True, eq=False)
class Innovations:
    """An extended Kalman filter as CasADi functions of its parameters theta (q), of which the last is the time to the
    next sample: `move` (x, u now, u then, theta) -> x at the next sample, `read` (x, u, theta) -> y, `process` (theta,
    Phi) -> q (n, n), `sensor` theta -> r (p) of the `outputs`. A correction is clamped to `ends` (2, n), maybe
    infinite; `spans` (p): the span W of each output's outliers, None for a filter without outliers; `gates`: the
    innovation gates."""

    move: Any
    read: Any
    process: Any
    sensor: Any
    outputs: tuple[Signal, ...]
    ends: Array
    spans: Array | None = None
    gates: tuple[GatedGroup, ...] = ()

    @property
    def n(self) -> int:
        """The number of states."""
        return int(self.move.size1_in(0))

    def along(self, record: Log, memory: Any, theta: Any, first: bool = True) -> tuple[Any, Any, Any]:
        """Return the cost (1, N) of a log's samples, their innovations e (p, N) and variances s (p, N); `memory`: the
        predicted state x- and covariance P- at the first sample, which is used for a correction only if `first`."""
        _, cost, e, s, _ = self._over(self._step, record, memory, theta, first)
        return cost, e, s

    def decided(self, record: Log, memory: Any, theta: Any, first: bool = True) -> tuple[Any, Any, Any]:
        """Return the mask (N, p) of the samples that the gates admit, decided one after the other along the log, and
        the innovations e (p, N) and variances s (p, N) of the filter that uses only these samples; arguments as of
        `along`."""
        counted = ca.vertcat(memory, ca.DM.zeros(len(self.gates)))
        _, _, e, s, valid = self._over(self._deciding_step, record, counted, theta, first)
        return np.array(valid).T > 0, e, s

    def _over(self, step: Any, record: Log, memory: Any, theta: Any, first: bool) -> tuple[Any, ...]:
        N = len(record.y)
        there = np.isfinite(record.y)
        y, valid = np.where(there, record.y, 0.0), there.astype(float)
        valid[0] *= first
        columns = (record.u.T, record.u[np.minimum(np.arange(1, N + 1), N - 1)].T, y.T, valid.T, self._kappa(there).T)
        theta = ca.vertcat(ca.repmat(theta, 1, N), record.ahead[None, :])
        results: tuple[Any, ...] = step.mapaccum("over", N, {"base": AT_ONCE})(memory, *columns, theta)
        return results

    def _kappa(self, there: Array) -> Array:
        """Return the mean kappa (N, p) of e^2/s over samples within their gates, `there` (N, p) being the mask of
        samples; 1 without a gate."""
        kappa = np.ones(there.shape)
        for group in self.gates:
            means = np.array([1.0, *(truncated_mean(limit, k) for k, limit in enumerate(group.limits, 1))])
            kappa[:, group.outputs] = means[there[:, group.outputs].sum(axis=1)][:, None]
        return kappa

    @cached_property
    def _step(self) -> Any:
        return self._advanced(deciding=False)

    @cached_property
    def _deciding_step(self) -> Any:
        return self._advanced(deciding=True)

    def _advanced(self, deciding: bool) -> Any:
        """Return the CasADi function (x- and P-, u now, u then, y, valid, kappa, theta) -> (next x- and P-, cost, e, s,
        valid), - before the sample y. A `deciding` one has the counts of gates after P-, and sets `valid` to 0 for
        samples beyond them."""
        n, counts, theta = self.n, len(self.gates) * deciding, ca.SX.sym("theta", *self.move.size_in(3))
        memory = ca.SX.sym("memory", n * (n + 1) + counts)
        now, then = (ca.SX.sym(name, *self.move.size_in(1)) for name in ("now", "then"))
        y, valid, kappa = (ca.SX.sym(name, *self.read.size_out(0)) for name in ("y", "valid", "kappa"))
        entries = (memory, now, then, y, valid, kappa, theta)
        before, P = memory[:n], ca.reshape(memory[n : n * (n + 1)], n, n)
        admitted, counted = self._decided(before, P, now, y, valid, memory[n * (n + 1) :], theta)
        x, P, *outputs = self._corrected(before, P, now, y, admitted if deciding else valid, kappa, theta)
        at = ca.SX.sym("x", n)
        advanced = self.move(at, now, then, theta)
        linear = ca.Function("linear", [at, now, then, theta], [advanced, ca.jacobian(advanced, at)])
        advanced, Phi = linear(x, now, then, theta)
        P = Phi @ P @ Phi.T + self.process(theta, Phi)
        after = ca.vertcat(advanced, ca.vec(P), *counted)
        return ca.Function("filter", list(entries), [after, *outputs, admitted if deciding else valid])

    def _decided(
        self, before: Any, P: Any, u: Any, y: Any, valid: Any, counts: Any, theta: Any
    ) -> tuple[Any, list[Any]]:
        """Return `valid` (p) with 0 for samples beyond their gates, and the `counts` of these in a row, by group; no
        counts, no decisions."""
        if not counts.numel():
            return valid, []
        predicted, r, after, admitted = self.read(before, u, theta), self.sensor(theta), [], ca.SX(valid)
        H = ca.jacobian(predicted, before)
        S = H @ P @ H.T + ca.diag(r)
        for group, count in zip(self.gates, ca.vertsplit(counts), strict=True):
            those = list(group.outputs)
            usable = [valid[j] > 0 for j in those]
            errors = [wrapped(y[j] - predicted[j], self.outputs[j].period) for j in those]
            inside = squared_distance(errors, usable, S[those, those]) <= passing_limit(group, usable)
            sampled = sum(usable[1:], usable[0]) > 0
            rejected = ca.logic_and(ca.logic_and(sampled, ca.logic_not(inside)), count < group.gate.accept_after)
            for j in those:
                admitted[j] = ca.if_else(rejected, 0, valid[j])
            after.append(ca.if_else(rejected, count + 1, ca.if_else(sampled, 0, count)))
        return admitted, after

    def _corrected(self, before: Any, P: Any, u: Any, y: Any, valid: Any, kappa: Any, theta: Any) -> tuple[Any, ...]:
        """Return the corrected x and P, the cost, and the innovation e with its variance
        s, after the sample `y`. `valid` (p): 1 for an output with a sample, else 0; `kappa` (p): the mean of e^2/s."""
        predicted, r, x, cost = self.read(before, u, theta), self.sensor(theta), before, ca.SX(0)
        H, errors, variances = ca.jacobian(predicted, before), [], []
        for j in range(predicted.numel()):
            row = H[j, :]
            s = row @ P @ row.T + r[j]
            e = wrapped(y[j] - predicted[j] - row @ (x - before), self.outputs[j].period)
            gain = valid[j] * P @ row.T / s
            loss, w, between = (e * e / (kappa[j] * s) + ca.log(s)) / 2, 1, 0  # between both cases: of P
            if self.spans is not None:
                odds = log_odds(e * e / s, ca.log(s), self.spans[j])
                loss, w = log_odds(0, 0, self.spans[j]) - softplus(odds), ca.exp(-softplus(-odds))
                between = w * (1 - w) * e * e * gain @ gain.T
            x, P = x + w * gain * e, P - w * gain @ (row @ P) + between
            cost += valid[j] * loss
            errors.append(e)
            variances.append(s)
        x = column(clamp(x[i], *ends) for i, ends in enumerate(self.ends.T))
        return x, (P + P.T) / 2, cost, ca.vertcat(*errors), ca.vertcat(*variances)


def log_odds(square: Any, log_s: Any, span: float) -> Any:
    """Return log((1 - pi) N(e; 0, s)/(pi/W)), the log odds that a sample is no outlier; `square`: e^2/s of its
    innovation; `log_s`: log s; `span`: W."""
    return math.log((1 - OUTLIERS) / OUTLIERS * span / math.sqrt(2 * math.pi)) - (square + log_s) / 2


def softplus(x: Any) -> Any:
    """Return log(1 + exp(x)) of a graph without overflow."""
    return ca.fmax(x, 0) + ca.log1p(ca.exp(-ca.fabs(x)))


def spans_of(outputs: Sequence[Signal], logs: Iterable[Log]) -> Array:
    """Return the span W of outliers of each output (p): the period of a periodic output, else the range of its
    samples."""
    pairs = zip(outputs, np.concatenate([log.y for log in logs]).T, strict=True)
    return np.array([y.period or float(np.nanmax(column) - np.nanmin(column)) or 1.0 for y, column in pairs])


def truncated_mean(limit: float, k: int) -> float:
    """Return kappa, the mean of d/k over d <= `limit`, d chi-square with `k` degrees of freedom."""
    most = arb(limit) / 2
    upper, lower = (most.gamma_lower(arb(degrees) / 2, regularized=1) for degrees in (k + 2, k))
    return float(upper / lower)


Ended = tuple[float, Array, bool]  # log L per sample, logarithms, whether the search settled
STARTS = tuple(product((-12.0, -4.0, 4.0), (-16.0, -8.0, 0.0)))  # log of process and sample noise, in units
MIDDLE = STARTS[len(STARTS) // 2]
ROUNDS = 20  # of gates and fits
BOUND = 32.0  # bound of these logarithms
CONSTANT_NIS = 0.5  # NIS of a sensor that stands on one step
CLEARLY = 10.0  # difference of log L that no chance makes
SAME = 0.1  # difference of logarithms within one maximum
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
    """A maximum of the likelihood: the densities `process` Q_i by coordinate (z^2/time), the standard deviations
    `sample` sigma_j of a sample by output, log L per sample (`likelihood`), and whether the search converged
    (`settled`)."""

    process: Mapping[str, float]
    sample: Mapping[str, float]
    likelihood: float
    settled: bool


@dataclass(frozen=True, eq=False)
class Likelihood:
    """The likelihood of logs on a form, as a function of process and sensor noise; `scale`: the units; `between`: the
    course of inputs between samples, "line" or "hold"; `steps`: Runge-Kutta steps a sample; `gates`: innovation gates,
    beyond which samples were removed from the logs (by `without_outliers`); `robust`: whether samples may be
    outliers."""

    form: Form
    records: Sequence[Log]
    scale: Scale
    between: str
    steps: int
    gates: tuple[GatedGroup, ...] = ()
    robust: bool = False

    def ended(self, begin: tuple[float, float] | Noise) -> Ended:
        """Return the end of a search for a maximum of the likelihood. `begin`: the logarithms of all process noise and
        of all sensor noise (in the units of `scale`), or the noise at which to begin."""
        if isinstance(begin, Noise):
            return self._ended(self._logs(begin))
        process, sample = begin
        return self._ended([process] * len(self._noisy) + [sample] * len(self.form.output))

    def without_outliers(self) -> tuple[Log, ...]:
        """Return the logs without the samples beyond the gates, at the noise that maximises the likelihood of the other
        samples."""
        if not self.gates:
            return tuple(self.records)
        robust = replace(self, gates=(), robust=True)
        ends = [end for end in map(robust.ended, STARTS) if np.isfinite(end[0])]
        if not ends:
            return tuple(self.records)
        logs, cleaned = max(ends, key=lambda end: end[0])[1], list(self.records)
        for _ in range(ROUNDS):
            pairs = zip(self.records, cleaned, strict=True)
            admitted = [self._admitted(record, self._start(last), logs) for record, last in pairs]
            if all(np.array_equal(a.y, b.y, equal_nan=True) for a, b in zip(admitted, cleaned, strict=True)):
                break
            cleaned = admitted
            logs = replace(self, records=cleaned)._ended(logs)[1]
        return tuple(cleaned)

    def _admitted(self, record: Log, memory: Array, logs: Array) -> Log:
        """Return a log without the samples beyond the gates; the first sample, which is not used for a correction,
        stays."""
        mask, _, _ = self._filter.decided(record, memory, ca.DM(logs), first=False)
        mask[0] = True
        return replace(record, y=np.where(mask, record.y, np.nan))

    def _ended(self, start: Any) -> Ended:
        end = self._solver(x0=start, lbx=self._least, ubx=BOUND)
        return -float(end["f"]), end["x"].full().ravel(), bool(self._solver.stats()["success"])

    def maxima(self, ended: Iterable[Ended]) -> tuple[Noise, ...]:
        """Return the maxima of the likelihood at the ends of the searches: converged ones first, then by decreasing
        likelihood."""
        finite = [one for one in ended if np.isfinite(one[0])]
        maxima, places = list[Noise](), list[Array]()
        for one in sorted(finite, key=lambda one: (not one[2], -one[0])):
            place = np.maximum(one[1], -BOUND / 2)  # any noise near its lower bound counts as none
            if not any(np.abs(place - other).max() < SAME for other in places):
                places.append(place)
                maxima.append(self._noise(*one))
        return tuple(maxima)

    def innovations(self, noise: Noise, record: Log) -> tuple[Array, ...]:
        """Return the innovations e (N - 1, p) of a filter with this noise along a log, and their variances s, NaN if
        missing or beyond a gate."""
        there, e, s = self._filter.decided(record, self._start(record), ca.DM(self._logs(noise)), first=False)
        there = there[1:]
        return tuple(np.where(there, np.array(each).T[1:], np.nan) for each in (e, s))

    def below_quantum(self, noise: Noise) -> dict[str, float]:
        """Return by output the least standard deviation q/sqrt(12) of a sensor with the quantum q, where the `noise` is
        at this bound and half of it would be more likely by a factor of exp(10) and more. Then the model is wrong,
        since no sensor has less noise. A sensor that stays on one step is not included: its innovations are below their
        variance."""
        logs, below = self._logs(noise), dict[str, float]()
        squares = np.concatenate([e**2 / s for e, s in (self.innovations(noise, log) for log in self.records)])
        for j, name in enumerate(noise.sample):
            half, place = logs.copy(), len(self._noisy) + j
            half[place] -= math.log(4)
            at_least = logs[place] < self._least[place] + SAME and self._least[place] > -BOUND
            if at_least and np.nanmean(squares[:, j]) > CONSTANT_NIS and self._gain(logs, half) > CLEARLY:
                below[name] = noise.sample[name]
        return below

    def _logs(self, noise: Noise) -> Array:
        process = [np.log(noise.process[name] / unit) for name, unit in self._noisy.items()]
        return np.array(process + [2 * np.log(noise.sample[name] / unit) for name, unit in self.scale.outputs.items()])

    def _gain(self, logs: Array, others: Array) -> float:
        """Return log L of all samples at `others` minus that at `logs`."""
        count = sum(len(record.y) - 1 for record in self.records)
        cost = self._solver.get_function("nlp_f")
        return count * (float(cost(logs, [])) - float(cost(others, [])))

    @cached_property
    def _least(self) -> Array:
        """The least logarithms of the unknowns. For R_j: the variance q^2/12 of rounding to the quantum q of output j,
        plus 5 %, which two printed digits may lose. For Q_i: the rounding to float at each sample, in steps of 2^-24 of
        the range."""
        duration = 1 if self.form.system.discrete else self.scale.dt
        process = math.log((ROUNDING**2 / 12) * self.scale.longest / duration)
        quanta = map(quantum_of, np.concatenate([record.y for record in self.records]).T)
        pairs = zip(quanta, self.scale.outputs.values(), strict=True)
        samples = [math.log(1.05 * q**2 / (12 * unit**2)) if q else -BOUND for q, unit in pairs]
        return np.clip([*[process] * len(self._noisy), *samples], -BOUND, BOUND - 1)

    def _noise(self, likelihood: float, logs: Array, settled: bool) -> Noise:
        count = len(self._noisy)
        process = {name: SURE * q for name, q in self.scale.units.items()}
        process |= {name: float(unit * np.exp(g)) for (name, unit), g in zip(self._noisy.items(), logs, strict=False)}
        pairs = zip(self.scale.outputs.items(), logs[count:], strict=True)
        return Noise(process, {name: float(unit * np.exp(g / 2)) for (name, unit), g in pairs}, likelihood, settled)

    @cached_property
    def _noisy(self) -> dict[str, float]:
        """The coordinates with process noise, each with the unit of its noise density, size^2/time."""
        names = states_with_noise(self.form.names, self.form.states, self.form.flow)
        return {name: self.scale.units[name] for name in names}

    @property
    def _irregular(self) -> bool:
        return any(record.times is not None for record in self.records)

    @cached_property
    def _filter(self) -> Innovations:
        n, p = self.form.n, len(self.form.output)
        model = open_loop(self.form, None if self._irregular else self.records[0].dt, self.between, self.steps)
        z, g = ca.SX.sym("z", n), ca.SX.sym("g", len(self._noisy) + p + 1)
        now, then = (ca.SX.sym(name, len(self.form.system.inputs)) for name in ("now", "then"))
        dt, order = 1 if self.form.system.discrete else g[-1], list(self._noisy)
        process = [
            q * dt * (ca.exp(g[order.index(name)]) if name in order else SURE) for name, q in self.scale.units.items()
        ]
        samples = [unit**2 * ca.exp(g[len(self._noisy) + j]) for j, unit in enumerate(self.scale.outputs.values())]
        return Innovations(
            ca.Function("move", [z, now, then, g], [model.move(z, now, then, *[dt] * self._irregular)]),
            ca.Function("read", [z, now, g], [model.read(z, now)]),
            ca.Function("process", [g, ca.SX.sym("Phi", n, n)], [ca.diag(ca.vertcat(*process))]),
            ca.Function("sensor", [g], [ca.vertcat(*samples)]),
            self.form.system.outputs,
            np.array([[-np.inf] * n, [np.inf] * n]),  # the form clamps the argument of its dynamics itself
            spans_of(self.form.system.outputs, self.records) if self.robust else None,
            self.gates,
        )

    def _start(self, record: Log) -> Array:
        """Return z and P at the first sample: z from the outputs that are states of the plant,
        the others at their defaults. The first sample therefore corrects nothing."""
        system = self.form.system
        first = zip(system.outputs, system.output, record.y.T, strict=True)
        measured = {h: (y, column[np.isfinite(column)][0]) for y, h, column in first}
        states = [signal for signal, _ in self.form.estimates]
        x = [float(reading_of(s, *measured[s])) if s in measured else resting(s) for s in states]
        model = open_loop(self.form, self.records[0].dt, self.between)
        z = np.array(model.entry(x, record.u[0])).ravel()
        P = np.diag([s * s / 4 for s in self.scale.states.values()])
        return np.concatenate([np.where(np.isfinite(z), z, 0.0), P.ravel()])

    @cached_property
    def _solver(self) -> Any:
        g = ca.MX.sym("g", len(self._noisy) + len(self.form.output))
        series = (self._filter.along(record, self._start(record), g, first=False) for record in self.records)
        total = sum(ca.sum2(costs) for costs, _, _ in series)
        count = sum(len(record.y) - 1 for record in self.records)
        return ca.nlpsol("likelihood", "ipopt", {"x": g, "f": total / count}, _OPTIONS)
