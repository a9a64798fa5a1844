"""The Riccati observer on factors of P: the common part of filter steps, P = L D L' as statements and as loops.

All filters advance z by one classical Runge-Kutta step, with Phi = I + hF + (hF)^2/2 at its midpoint and P <- Phi P
Phi' + h Q_theta, and correct by scalar updates with r = R_theta/h. Where a variance P_ii exceeds its cap, rows of L are
scaled: a congruence, which keeps the correlations. h Q_theta preserves the rank. A part with forgetting needs no cap:

    P <- exp(rho h) Phi P Phi' + h Q_0,   P^-1 <- P^-1 + (1 - exp(-rho h)) S_0,   S_0 = diag(1/cap_i)

The second is a scalar update for each state by a sample equal to the estimate, which changes P only. For A = 0 both
together are S <- exp(-rho h) S + (1 - exp(-rho h)) S_0, exact for any h but for Q_0.

The choice between straight-line code and loops depends on the goal of the step. For speed it is straight-line code,
which has fewer operations and no loop control, unless its text becomes too long; for flash it is the shorter text.
Operations are counted, not measured (`discretisation.kernel_graphs`). In loops over the columns of L, for many states,
rotations make Phi L triangular again in the columns that Phi's diagonals above the main one fill, and rank-one updates
add the noise: n^2 operations for each such diagonal, and n^3/3.

Joint updates: the samples of a call wait, and correct together, with all outputs linearised at the prediction.

    e = y - h(z),  C = dh/dz at the prediction z;  R_u = L diag(d) L' the block of R of the samples that are used
    L^-1 e,  L^-1 C:   samples with independent noises of variances d, which correct one by one:
    z <- z + K (e_j - c_j (z - z before all)),  P <- P - K c_j P

This is K = P C' (C P C' + R_u)^-1, z <- z + K e, as a batch. Rows and columns of L of samples that are not used are
those of the unit matrix, so that the pattern of missing samples needs no branch. Source: Bierman, "Factorization
methods for discrete sequential estimation" (1977), the decorrelation of a measurement's noise.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import combinations
from math import sqrt
from typing import Any

import casadi as ca
import numpy as np

from hgogen.discretisation import kernels
from hgogen.discretisation.kernel_graphs import executed_operations, text_operations
from hgogen.discretisation.runge_kutta import Stages, Tableau, advance, plant_tableau, routine
from hgogen.estimators.gating import raised, with_gating
from hgogen.estimators.riccati_part import (
    Riccati,
    factor,
    is_diagonal,
    lower,
    measurement_update,
    pack,
    packed_triangle,
    prior_status,
    time_update,
    unpack_lower,
)
from hgogen.graph import Graph
from hgogen.part import Clock, Joint, Pieces
from hgogen.program import Block, Field, Group, Kernel, Loop, Place, Program, Statement, When, column, scalar, sym
from hgogen.reading.given import BadGain
from hgogen.signal import LOST, Signal

# D_i stays above SMALLEST of its natural size and |L_ij| within LARGEST of its own: both only catch rounding.
SMALLEST, LARGEST, TINY = 1e-12, 1e9, 1e-35
Writes = dict[Place, Graph]
_READ = ("z", "u", "y", "valid")  # the arguments of flow and Jacobian, in this order
SINGULAR = 1e-10  # of a variance: what is left below it is rounding
POINTS = 12  # corners, and as many points inside, at which the growth of the model is evaluated
LONGER = {"speed": 1450, "flash": 0}  # operations by which straight-line code may exceed loops, of about 6 bytes each
FULL = 7  # states up to which a full matrix Q or P(0) is accepted, which loops do not admit
ROTATED = 1e-6  # of the largest squared entry: a larger error is no rounding
LARGE = 12  # states beyond which straight-line code is always too long, and slow to generate


@dataclass(frozen=True)
class FilterStep:
    """One predict step of length h of a Riccati observer `part` as SX graphs: the prediction of z, the Jacobian F at
    mid-step, and Phi = I + hF + (hF)^2/2. For a discrete plant: z+ = f(z, u), F = df/dz at z, Phi = F, h = 1."""

    part: Riccati
    clock: Clock

    @property
    def motion(self) -> Tableau:
        """The tableau that integrates the plant over a step: classical Runge-Kutta, or the map of a discrete plant."""
        return plant_tableau(self.part.dynamics.form.system)

    @property
    def z(self) -> Graph:
        """The SX symbols of the estimated state z (n)."""
        return sym("state", self.part.z.name, self.part.dynamics.n)

    def stages(self, z: Graph | None = None) -> Stages:
        """Return the stages and the result of a step of the model from `z` (n)."""
        start = {"z": self.z if z is None else z}
        return advance(self.motion, lambda v, c: {"z": self._flow(v["z"], c)["dz"]}, start, self.clock.h)

    @cached_property
    def _flow(self) -> Callable[[Graph, float], dict[str, Graph]]:
        return self._routine("flow", lambda *at: {"dz": self.part.flow(*at)})

    def jacobian(self, stages: Stages) -> Graph:
        """Return F (n, n) at mid-step: at the state of the third Runge-Kutta stage, and the input at half of the step;
        of a discrete plant, F = df/dz at z."""
        jacobian = self._routine("jacobian", lambda *at: {"F": self.part.jacobian(*at)})
        return jacobian(*self._middle(stages))["F"]

    def _middle(self, stages: Stages) -> tuple[Graph, float]:
        stage = 0 if self.motion.map else 2
        return stages.arguments[stage]["z"], self.motion.c[stage]

    def _routine(self, name: str, body: Callable[..., dict[str, Graph]]) -> Callable[[Graph, float], dict[str, Graph]]:
        sizes = {"z": self.part.dynamics.n, **self.clock.sizes}
        call = routine(name, sizes, lambda at: body(*({**at, **self.clock.constants}[key] for key in _READ)))
        return lambda z, c: call({"z": z, **self.clock.signals(c)})

    def transition(self, F: Graph) -> Graph:
        """Return Phi = I + hF + (hF)^2/2 (n, n) of the Jacobian F, as a sparse SX; Phi = F for a discrete plant."""
        if self.motion.map:
            return ca.sparsify(F)
        h = self.clock.h
        return ca.sparsify(ca.SX.eye(self.part.dynamics.n) + h * F + (h * h / 2) * (F @ F))

    def noise(self, stages: Stages) -> tuple[Graph, Graph]:
        """Return W (n, k) at mid-step and the weights h theta^(1+g) w (k), SX, of the process noise of a step, h
        Q_theta = W diag(h theta^(1+g) w) W'."""
        z, c = self._middle(stages)
        W = self.part.scaled_factor(z, self.clock.u(c))
        return W, self.clock.h * self.part.scaling.process(self.part.theta.value) * self.part.densities

    def row(self, output: int) -> Graph:
        """The row c = dh/dz (1, n) of an output, sparse."""
        return ca.sparsify(self.part.dynamics.output_jacobian(self.z, self.clock.u_now)[output, :])

    def variance(self, output: int) -> Graph:
        """Return r = R_theta/h, the variance of one sample of an output, SX scalar; h is its sampling period."""
        R, theta = self.part.density(output, self.z, self.clock.u_now), self.part.theta.value
        period = self.clock.period(output)
        return self.part.scaling.variance(R, theta, output, period)

    def sample_noise(self, outputs: Sequence[int]) -> Graph:
        """Return the covariance (k, k) of the noise of one sample of these outputs, SX."""
        noise = ca.diag(column(map(self.variance, outputs)))
        if self.part.correlated is not None:
            rates = [1 / self.clock.period(j) for j in outputs]
            for a, b in combinations(range(len(outputs)), 2):
                value = self.part.output_noise[outputs[a], outputs[b]] * sqrt(rates[a] * rates[b])
                noise[a, b] = noise[b, a] = value
        return noise

    def common(self) -> dict[str, Any]:
        """Return keyword arguments of `Pieces` that all factorisations of P share: the status bit of the limit of P
        and, with forgetting at the rate rho, exp(rho h) and the roots of (1 - exp(-rho h)) S_0, S_0 the prior. Both use
        one rounded exp, so that S = P^-1 tends to S_0 for any small rho h."""
        part = self.part
        always = {"bits": (part.limited,), "uses_output": part.measured_state is not None}
        if part.forgetting is None:
            return always
        growth = ca.exp(part.rho * self.clock.dt)
        share = ca.fmax(growth - 1, 0) / growth
        prior = ca.sqrt(share / ca.SX(ca.DM(part.cap)))
        meaning = "roots of (1 - exp(-rho dt)) S_0, what a step adds of the prior"
        writes = {Place("derived", "growth"): growth, Place("derived", "prior"): prior}
        return {
            **always,
            "derived": (
                scalar("growth", 1.0, meaning="exp(rho dt), by which the covariance grows in a step"),
                Field("prior", (0.0,) * len(part.cap), meaning=meaning),
            ),
            "tune": (Block("what a step forgets", writes),),
        }

    def smallest(self, values: np.ndarray) -> np.ndarray:
        """Return the lower limits (n) of the D_i of P = L D L': a small fraction of the smallest of three variances,
        D_i(0) = `values` (n), the process noise of one step, and one sample of an output; for a state without process
        noise, the fraction squared times D_i(0)."""
        part, clock = self.part, self.clock
        noise, variances = part.typical
        process = clock.longest * factor(noise)[1] if part.factor.size else values
        natural = np.minimum(values, np.where(process > 0, process, SMALLEST * values))
        least = min(part.scaling.variances(variances, theta).min() for theta in (1.0, part.theta.peak))
        natural[0] = min(natural[0], least / max(clock.period(j) for j in range(clock.outputs)))
        return np.asarray(np.maximum(SMALLEST * natural, TINY))

    def diagonal(self, values: np.ndarray) -> Field:
        """Return the memory field of D (n) of P = L D L', with initial `values` (n) and its limits."""
        return Field(
            "D",
            tuple(float(value) for value in values),
            low=tuple(map(float, self.smallest(values))),
            high=tuple(map(float, largest(self.part))),
            meaning="diagonal factor of the covariance P = L D L'",
        )


def largest(part: Riccati) -> np.ndarray:
    """Return the upper limits (n) of the P_ii: their cap, or with forgetting at a rate rho, 2 (1 + 2 mu/rho) cap_i at
    the smallest rho.

    mu is 0 or the largest logarithmic norm of F in units of sqrt(cap) at points of the box. By S' = -rho (S - S_0) -
    F'S - S F + .., S_0^-1/2 S S_0^-1/2 stays above rho/(rho + 2 mu). The factor 2 allows for Q_0 and for mu between the
    points.
    """
    if part.forgetting is None:
        return part.cap
    unit = np.sqrt(part.cap)
    F = part.slopes(POINTS)[0] * unit / unit[:, None]
    mu = np.linalg.eigvalsh((F + np.swapaxes(F, 1, 2)) / 2).max(initial=0.0)
    return np.asarray(np.minimum(2 * (1 + 2 * mu / part.forgetting.low[0]) * part.cap, LOST))


WAITS = "waits_"  # of names of flags in the state


def _reading(y: Signal) -> str:
    return f"sample_{y}"


def _waits(y: Signal) -> str:
    return f"{WAITS}{y}"


def decorrelated(R: Graph, used: Sequence[Graph]) -> tuple[Graph, Graph]:
    """Return the factors of R_u, the block of `R` (p, p) for the samples that are `used` (p): L (p, p), unit lower
    triangular and sparse, and d (p) with R_u = L diag(d) L'."""
    R, L, d = ca.sparsify(R), ca.SX.eye(len(used)), list[Graph]()
    for j in range(len(used)):
        for k in range(j):
            value = R[j, k] - sum((L[j, m] * L[k, m] * d[m] for m in range(k)), ca.SX(0))
            if not value.is_zero():
                L[j, k] = ca.if_else(ca.logic_and(used[j], used[k]), value / d[k], 0)
        d.append(R[j, j] - sum((L[j, k] ** 2 * d[k] for k in range(j)), ca.SX(0)))
    return L, column(d)


def whitened(L: Graph, rows: Graph) -> Graph:
    """Return L^-1 rows (p, k) for a unit lower triangular L (p, p), sparse."""
    known = list[Graph]()
    for j, row in enumerate(ca.vertsplit(rows)):
        known.append(ca.sparsify(row - sum((L[j, k] * known[k] for k in range(j) if not L[j, k].is_zero()), 0)))
    return ca.vertcat(*known)


def used_block(R: Graph, used: Sequence[Graph]) -> Graph:
    """Return R (p, p) with 0 for the correlations of samples that are not `used` (p)."""
    block = ca.SX(R)
    for j, k in zip(*ca.sparsify(R).sparsity().get_triplet(), strict=True):
        if j != k:
            block[j, k] = ca.if_else(ca.logic_and(used[j], used[k]), R[j, k], 0)
    return block


class FactoredStep(FilterStep, ABC):
    """A step of a Riccati filter on factors of P. Its innovations may have gates; its updates are scalar, one after the
    other, or joint."""

    def completed(self, pieces: Pieces) -> Pieces:
        """Return the memory and statements of the filter with those of its gates. If updates are joint, each update
        stores its sample, and one correction follows after all."""
        pieces = with_gating(pieces, self)
        if not self.part.joint:
            return pieces
        waits = "1 where the sample waits for the correction"
        fields = [scalar(_reading(y), 0.0, unit=y.unit, meaning="sample of this period") for y in self._outputs]
        flags = [scalar(_waits(y), 0, kind="index", high=1, meaning=waits) for y in self._outputs]
        none = Block("no sample waits", {Place("state", _waits(y)): ca.SX(0) for y in self._outputs})

        def stored(y: Signal) -> Program:
            writes = {Place("state", _reading(y)): sym("work", "reading"), Place("state", _waits(y)): ca.SX(1)}
            return (Block(f"the sample of {y} waits for those of other outputs", writes),)

        return replace(
            pieces,
            fields=(*pieces.fields, *fields, *flags),
            predict=(*pieces.predict, none),
            update=tuple(map(stored, self._outputs)),
            correct=(*self.joint_correction(), none),
        )

    @property
    def _outputs(self) -> tuple[Signal, ...]:
        return self.part.dynamics.form.system.outputs

    @property
    def waiting(self) -> list[Graph]:
        """The flags (p), SX, of outputs with a stored sample that the joint correction has not used yet."""
        return [sym("state", _waits(y)) > 0 for y in self._outputs]

    def errors(self, predicted: Graph, drift: Graph | None = None) -> Graph:
        """Return e (p): the stored sample minus `predicted` + `drift` of each output, 0 for an output without a stored
        sample."""
        shift = ca.SX.zeros(len(self._outputs)) if drift is None else drift
        dynamics, each = self.part.dynamics, []
        for j, (y, waits) in enumerate(zip(self._outputs, self.waiting, strict=True)):
            error = dynamics.output_error(j, sym("state", _reading(y)), predicted[j])
            each.append(ca.if_else(waits, dynamics.output_error(j, error, shift[j]), 0))
        return column(each)

    def where_waiting(self, programs: Sequence[Program]) -> Program:
        """Return statements that run the program of each output (p) only if a stored sample of this output waits."""
        places = [Place("work", f"{_waits(y)}_now") for y in self._outputs]
        test = Block("which samples wait?", dict(zip(places, self.waiting, strict=True)))
        return (test, *(When(place, program) for place, program in zip(places, programs, strict=True)))

    def used_variance(self, output: int) -> Graph:
        """Return r, the noise variance of a sample of an output, including the variance that a gate adds to it, SX
        scalar."""
        return self.variance(output) + raised(self.part, output)

    def used_noise(self) -> Graph:
        """Return the noise covariance (p, p) of one sample of all outputs, including the variances that gates add to
        it, SX."""
        every = range(self.clock.outputs)
        return self.sample_noise(every) + ca.diag(column(raised(self.part, j) for j in every))

    def correction(self, output: int) -> Program:
        """Return the statements that correct z and P by the sample of the output with index `output`."""
        return self.scalar_update(self.row(output), self.used_variance(output), sym("work", "e"))

    @abstractmethod
    def scalar_update(self, row: Graph, r: Graph, error: Graph) -> Program:
        """Return the statements that correct z and P by a sample of variance `r` of c z, c = `row` (1, n), whose
        innovation is `error`."""

    def joint_correction(self) -> Program:
        """Return the statements that correct by all stored samples together, linearised at the prediction."""
        every, start = range(self.clock.outputs), Place("work", "predicted_z")
        L, d = decorrelated(self.used_noise(), self.waiting)
        predicted = self.part.dynamics.output(self.z, self.clock.u_now)
        rows, slopes = _in_memory("rows", whitened(L, ca.vertcat(*map(self.row, every))))
        variances, computed = _in_memory("variances", d)
        error = {Place("work", "errors"): whitened(L, self.errors(predicted)), start: self.z}
        read, shift = sym("work", "errors", len(every)), self.z - sym(*start, self.part.dynamics.n)
        each = [self.scalar_update(rows[j, :], variances[j], read[j] - rows[j, :] @ shift) for j in every]
        return (
            Block(
                "the innovations and rows at the prediction, with independent noises", {**error, **slopes, **computed}
            ),
            *self.where_waiting(each),
        )

    @abstractmethod
    def projected(self, rows: Graph) -> tuple[Program, Graph]:
        """Return C P C' (k, k), C = `rows` (k, n), SX, and the program that computes what it reads."""

    def joint(self, outputs: tuple[int, ...]) -> Joint:
        """Return the joint innovations of these outputs, linearised at the prediction."""
        program, spread = self.projected(ca.vertcat(*map(self.row, outputs)))
        return Joint(program, ca.SX.zeros(len(outputs)), spread + self.sample_noise(outputs))

    def state_variances(self, states: list[int]) -> tuple[Program, list[Graph]]:
        """Return the variances P_ii of these states, and the program that computes what they read."""
        program, spread = self.projected(ca.SX.eye(self.part.dynamics.n)[states, :])
        return program, [spread[k, k] for k in range(len(states))]

    @abstractmethod
    def decoupled(self, states: list[int], cleared: list[Graph], variances: list[Graph]) -> Program:
        """Return the program that sets P_ii of each of these `states` to its variance and all other entries of its row
        to 0, where `cleared` holds."""


class Unrolled(FactoredStep):
    """A step of a Riccati filter as straight-line code, predict and then a scalar update for each sample; a subclass
    defines the factors of P that are stored."""

    name: str  # P in terms of its factors
    rule = ""  # the name of the rule, where the method has none

    @property
    @abstractmethod
    def fields(self) -> tuple[Field, ...]:
        """The memory fields of the factors of P."""

    @property
    @abstractmethod
    def covariance(self) -> Graph:
        """The covariance P (n, n) in terms of the stored factors, SX."""

    @property
    @abstractmethod
    def variances(self) -> list[Graph]:
        """The diagonal entries P_ii of the covariance, n SX scalars."""

    @abstractmethod
    def scaled(self, scale: Graph) -> Writes:
        """Return the assignments of the factors of diag(s) P diag(s), with s = `scale` (n)."""

    @abstractmethod
    def sample_update(self, row: Graph, r: Graph) -> tuple[Writes, Graph]:
        """Return assignments of P's factors after y = c z, c = `row` (1, n), of variance `r`, and the gain K (n)."""

    @property
    def named(self) -> str:
        """The name of the rule that advances P, for reports; "" where this is the step's method."""
        return f"discrete, {self.name}" if self.motion.map else self.rule

    @property
    def least(self) -> Graph | None:
        """The variances (n) below which a pivot counts as 0 when a discrete plant's map, which may be singular,
        advances P; None for a Runge-Kutta step."""
        return ca.SX(ca.DM(self.smallest(factor(self.part.covariance)[1]))) if self.motion.map else None

    @abstractmethod
    def time_update(
        self, transition: Graph, growth: Graph | None, noise: tuple[Graph, Graph]
    ) -> tuple[Writes, dict[str, Graph]]:
        """Return the assignments of the factors of growth Phi P Phi' + W diag(w) W', Phi = `transition` (n, n), growth
        = 1 for None and `noise` = (W, w), and the intermediate values that get a name in the code."""

    def decoupled(self, states: list[int], cleared: list[Graph], variances: list[Graph]) -> Program:
        """Return the program that sets P_ii of each of these `states` to its variance and all other entries of its row
        to 0, where `cleared` holds: P <- Z P Z' + W diag(w) W', with Z the unit matrix but 0 in the rows of such
        states, and W the unit vectors of these."""
        one = ca.SX.eye(self.part.dynamics.n)
        keep = ca.SX.ones(self.part.dynamics.n)
        for i, clear in zip(states, cleared, strict=True):
            keep[i] = ca.if_else(clear, 0, 1)
        weights = column(ca.if_else(clear, v, 0) for clear, v in zip(cleared, variances, strict=True))
        factors, _ = self.time_update(ca.diag(keep), None, (one[:, states], weights))
        return (Block("raise the variances of measured states, without covariances", factors),)

    @abstractmethod
    def congruent(self, N: Graph, least: Graph) -> tuple[Writes, dict[str, Graph]]:
        """Return the assignments of the factors of N P N', N (n, n), and the intermediate values that get a name. A
        pivot below `least` (n) is a rounding error and counts as 0."""

    def congruence(self, N: Graph) -> Program:
        """Return the statements P <- N P N', N (n, n), which may be singular."""
        least = self.smallest(factor(self.part.covariance)[1])
        ends = (ca.fmax(SINGULAR * P_ii, float(end)) for P_ii, end in zip(self.variances, least, strict=True))
        factors, names = self.congruent(N, column(ends))
        return (Block(f"P <- N P N', P = {self.name}", factors, names),)

    def pieces(self) -> Pieces:
        """Return the memory fields and the statements of the filter: predict, then one scalar update for each
        output."""
        pieces = Pieces(
            fields=(self.part.z, *self.fields),
            covariance=self.covariance,
            congruence=self.congruence,
            projected=self.projected,
            joint=self.joint,
            **self.common(),
            predict=(*self.prediction(), *self.bounded()),
            update=tuple(map(self.correction, range(self.clock.outputs))),
            rule=self.named,
        )
        return self.completed(pieces)

    def prediction(self) -> Program:
        """Return the statements that advance z by a step of the model, and replace P by Phi P Phi' + h Q_theta, in
        terms of its factors."""
        stages = self.stages()
        Phi, forgets = self.transition(self.jacobian(stages)), self.part.forgetting is not None
        growth = sym("derived", "growth") if forgets else None
        factors, names = self.time_update(Phi, growth, self.noise(stages))
        rows, columns = Phi.shape
        listed = ((f"Phi_{i + 1}{j + 1}", Phi[i, j]) for i in range(rows) for j in range(columns))
        entries = {name: entry for name, entry in listed if entry.n_dep()}  # that are computed
        noise = (" + Q" if self.motion.map else " + h Q_theta") if self.part.factor.size else ""
        propagated = "F P F'" if self.motion.map else "Phi P Phi'"
        equation = "P <- exp(rho h) Phi P Phi' + h Q_0" if forgets else f"P <- {propagated}{noise}"
        writes = {Place("state", self.part.z.name): stages.result["z"], **factors}
        title = f"z by {self.motion.name}; P = {self.name} by {equation}"
        notes = () if self.motion.map else ("the tableau of z:", *(f"  {row}" for row in self.motion.rows))
        return (Block(title, writes, {**stages.names, **entries, **names}, notes=notes),)

    def bounded(self) -> Program:
        """Return the statements that limit P after a prediction. With forgetting the prior S_0 is added to P^-1;
        otherwise, where a P_ii exceeds its cap, P is scaled by the congruence s_i = min(1, cap_i/P_ii). Without guards
        there is no cap."""
        part, variances = self.part, self.variances
        if part.forgetting is not None:
            rows = map(ca.sparsify, ca.vertsplit(ca.diag(sym("derived", "prior", part.dynamics.n))))
            samples = (self.sample_update(row, ca.SX(1))[0] for row in rows)  # of variance 1
            blocks = (Block(f"what is forgotten of z{i} tends to S_0", each) for i, each in enumerate(samples, 1))
            return (*blocks, prior_status(part, variances))
        if not self.clock.guarded:
            return ()
        caps = [float(value) for value in part.cap]
        scale = column(ca.fmin(1, cap / value) for cap, value in zip(caps, variances, strict=True))
        beyond = reduce(ca.logic_or, [value > cap for cap, value in zip(caps, variances, strict=True)])
        limited = {Place("status", "COVARIANCE_LIMITED"): ca.SX(1)}
        return (
            Block("largest variances", {Place("work", "capped"): beyond}),
            When(Place("work", "capped"), (Block("cap", {**self.scaled(scale), **limited}),)),
        )

    def scalar_update(self, row: Graph, r: Graph, error: Graph) -> Program:
        """Return the block that corrects z and P by a sample of variance `r` of c z, c = `row` (1, n)."""
        factors, gain = self.sample_update(row, r)
        return self.corrected(gain, error, factors)

    def corrected(
        self, gain: Graph, error: Graph, factors: Writes, title: str = "correct by the scalar update"
    ) -> Program:
        """Return the statements z <- z + gain error, `gain` (n), and the assignments `factors` of P."""
        z = {Place("state", self.part.z.name): self.z + gain * error}
        return (Block(title, {**z, **factors}, {f"K{i + 1}": k for i, k in enumerate(ca.vertsplit(gain))}),)


class UnitTriangular(Unrolled):
    """A Riccati filter on P = L D L', L unit lower triangular and packed by columns, D diagonal (Thornton, Bierman)."""

    name = "L D L'"

    @property
    def symbols(self) -> tuple[Graph, Graph]:
        """The SX symbols of the stored factors: L (n, n) and the diagonal of D (n)."""
        n = self.part.dynamics.n
        return unpack_lower(sym("state", "L", n * (n - 1) // 2), n, 1), sym("state", "D", n)

    @staticmethod
    def writes(L: Graph, d: Graph) -> Writes:
        """Return the assignments of L (n, n) and of the diagonal `d` (n) of D to the state."""
        return ({Place("state", "L"): ca.densify(pack(L, 1))} if d.numel() > 1 else {}) | {Place("state", "D"): d}

    @property
    def fields(self) -> tuple[Field, ...]:
        """The memory fields of L, for more than one state, and of D."""
        n, deviation = self.part.dynamics.n, np.sqrt(self.part.cap)
        start, values = factor(self.part.covariance)
        ends = tuple(float(LARGEST * deviation[i] / deviation[j]) for i, j in lower(n, 1))
        meaning = "L of P = L D L'"
        L = packed_triangle("L", start, meaning, 1, low=tuple(-end for end in ends), high=ends)
        return (*([L] if n > 1 else []), self.diagonal(values))

    @property
    def covariance(self) -> Graph:
        """P = L D L' (n, n), SX."""
        L, d = self.symbols
        return L @ ca.diag(d) @ L.T

    @property
    def variances(self) -> list[Graph]:
        """The diagonal entries P_ii = sum_j L_ij^2 D_j, n SX scalars."""
        L, d = self.symbols
        return [ca.dot(L[i, :].T ** 2, d) for i in range(self.part.dynamics.n)]

    def scaled(self, scale: Graph) -> Writes:
        """Return the assignments of L, D of diag(s) P diag(s), with s = `scale` (n)."""
        L, d = self.symbols
        return self.writes(ca.diag(scale) @ L @ ca.diag(1 / scale), scale**2 * d)

    def sample_update(self, row: Graph, r: Graph) -> tuple[Writes, Graph]:
        """Return L, D, as assignments, after Bierman's update by y = c z, c = `row` (1, n), of variance `r`, and the
        gain."""
        *factors, gain = measurement_update(*self.symbols, row, r)
        return self.writes(*factors), gain

    def projected(self, rows: Graph) -> tuple[Program, Graph]:
        """Return C P C' (k, k), C = `rows` (k, n), SX, by L'C'."""
        L, d = self.symbols
        f = L.T @ rows.T
        return (), f.T @ ca.diag(d) @ f

    def time_update(
        self, transition: Graph, growth: Graph | None, noise: tuple[Graph, Graph]
    ) -> tuple[Writes, dict[str, Graph]]:
        """Return L, D, as assignments, of growth Phi P Phi' + W diag(w) W' (Thornton), and intermediate values."""
        L, d = self.symbols
        d = d if growth is None else growth * d
        L, d, names = time_update(L, d, transition, *noise, self.least)
        return self.writes(L, d), names

    def congruent(self, N: Graph, least: Graph) -> tuple[Writes, dict[str, Graph]]:
        """Return the assignments of L, D of N P N' (Thornton, without noise), and intermediate values."""
        n = N.shape[0]
        L, d, names = time_update(*self.symbols, N, ca.SX(n, 0), ca.SX(0, 1), least)
        return self.writes(L, d), names


_COLUMNS, _D = Place("column", "v"), Place("state", "D")


class Looped(FactoredStep):
    """A Riccati filter on P = L D L' for many states: the columns of L in an array of structures, the matrix operations
    as loops of library functions; Q and P(0) must be diagonal."""

    @property
    def matrices(self) -> dict[str, np.ndarray]:
        """Q and P(0) (n, n), by the names of the user's arguments, "Q" and "covariance"."""
        return {"Q": self.part.nominal[0], "covariance": self.part.covariance}

    def pieces(self) -> Pieces:
        """Return the memory fields and the statements of the filter. Raises: `BadGain` where Q or P(0) is not
        diagonal."""
        n = self.part.dynamics.n
        for name, matrix in self.matrices.items():
            if not is_diagonal(matrix):
                raise BadGain(name, f"must be diagonal for {n} states; full matrices are for up to 7")
        if not rotates(self.part):
            reason = f"has a singular Jacobian df/dx, or delays in an order that more than {LARGE} states do not admit"
            raise BadGain(self.part.dynamics.form.system.name, f"{reason}; list a state before those that it moves")
        columns = Field("v", (0.0,) * n, meaning="rows below the diagonal")
        pieces = Pieces(
            fields=(self.part.z, self.diagonal(np.diag(self.part.covariance).copy())),
            groups=(Group("column", n, (columns,), "columns of the unit lower factor of P"),),
            projected=self.projected,
            joint=self.joint,
            **self.common(),
            predict=self.prediction(),
            update=tuple(map(self.correction, range(self.clock.outputs))),
            rule="discrete, L D L'" if self.motion.map else "",
        )
        return self.completed(pieces)

    def projected(self, rows: Graph) -> tuple[Program, Graph]:
        """Return C P C' (k, k), C = `rows` (k, n), SX, and the program that computes f = L'c for each row c."""
        n, program, f = self.part.dynamics.n, list[Statement](), []
        for k, row in enumerate(ca.vertsplit(rows)):
            c, product = Place("work", f"row_{k}"), Place("work", f"product_{k}")
            program.append(Block("a row of the outputs", {c: ca.densify(row).T}))
            program.append(Kernel("project", n, _COLUMNS, ((c, n), (product, n))))
            f.append(sym(*product, n))
        every = ca.horzcat(*f)
        return tuple(program), every.T @ ca.diag(sym("state", "D", n)) @ every

    def decoupled(self, states: list[int], cleared: list[Graph], variances: list[Graph]) -> Program:
        """Return the program that sets P_ii of each of these `states` to its variance and all other entries of its row
        to 0, where `cleared` holds."""
        n, fresh = self.part.dynamics.n, Place("work", "fresh_variance")
        values = ca.SX.zeros(n)
        for i, clear, variance in zip(states, cleared, variances, strict=True):
            values[i] = ca.if_else(clear, variance, 0)
        return (
            Block("the variances of measured states", {fresh: values}),
            Kernel("decouple", n, _COLUMNS, ((_D, n), (fresh, n))),
        )

    def prediction(self) -> Program:
        """Return the statements that advance z, and L, D to the factors of Phi P Phi' + h Q_theta."""
        part, n = self.part, self.part.dynamics.n
        stages = self.stages()
        F = ca.sparsify(self.jacobian(stages))
        Phi = self.transition(F)
        advanced, meaning, entries = self._advanced(F, Phi)
        band = max(1, Phi.sparsity().bw_upper())
        z = {Place("state", part.z.name): stages.result["z"]}
        forgetting: Program = ()
        noise: Program = ()
        if part.forgetting is not None:
            forgetting = (Block("forgetting", {_D: sym("derived", "growth") * sym("state", "D", n)}),)
        if part.factor.size:
            w, (W, weights) = Place("work", "w"), self.noise(stages)
            scaled = Block("h Q_theta", {w: weights[:n] * part.spread() ** 2})
            noise = (scaled, Kernel("add", n, _COLUMNS, ((_D, n), (w, n))))
            for k, i in enumerate(part.disturbed.inputs, n):
                u = self.part.dynamics.form.system.inputs[i]
                direction, weight = Place("work", f"direction_{u}"), Place("work", f"noise_of_{u}")
                entries |= {direction: ca.densify(W[:, k]), weight: weights[k]}
                noise += (Kernel("disturb", n, _COLUMNS, ((_D, n), (direction, n), (weight, 1))),)
        return (
            Block(f"z by {self.motion.name}; {meaning}, but for constants, by columns", z | entries, stages.names),
            Kernel("expand", n, _COLUMNS),
            Loop(
                "column", n, (Block("a column of Phi L", {_COLUMNS: advanced}, spelled=self.clock.prefer == "speed"),)
            ),
            *forgetting,
            Kernel("triangularise", n, _COLUMNS, ((_D, n),), counts=(band,)),
            *noise,
            *(self.bounded() if self.clock.guarded or part.forgetting is not None else ()),
        )

    def _advanced(self, F: Graph, Phi: Graph) -> tuple[Graph, str, dict[Place, Graph]]:
        """Return the product Phi v for a column v of L, the meaning of the stored matrix for a comment, and the entries
        of this matrix, Phi or F, that are computed before the loop."""
        v, h = sym("column", "v", self.part.dynamics.n), self.clock.h
        if Phi.nnz() <= 2 * F.nnz():
            operator, entries = _in_memory("Phi", Phi)
            meaning = "Phi = df/dz" if self.motion.map else "Phi = I + hF + (hF)^2/2, F at mid-step"
            return operator @ v, meaning, entries
        operator, entries = _in_memory("F", F)  # F twice has fewer products
        return v + h * (operator @ (v + h / 2 * (operator @ v))), "the Jacobian F at mid-step", entries

    def bounded(self) -> Program:
        """Return the statements that limit each P_ii that exceeds its cap or is not finite, and set lost entries of L
        to 0."""
        n, limited = self.part.dynamics.n, Place("work", "limited")
        v = sym("column", "v", n)
        restarted = column(ca.if_else(ca.fabs(v[i]) <= LOST, v[i], 0) for i in range(n))
        restart = Block("a lost value restarts", {_COLUMNS: restarted})
        raised = Block("limited", {Place("status", "COVARIANCE_LIMITED"): ca.SX(1)})
        limits = Block("largest variances", {Place("work", "caps"): ca.SX(ca.DM(self.part.cap))})
        name, more = ("cap", ()) if self.part.forgetting is None else ("renew", ((Place("derived", "prior"), n),))
        arguments = ((_D, n), (Place("work", "caps"), n), *more)
        limit = Kernel(name, n, _COLUMNS, arguments, result=limited)
        return (limits, limit, When(limited, (raised, Loop("column", n, (restart,)))))

    def scalar_update(self, c: Graph, r: Graph, error: Graph) -> Program:
        """Return the statements that correct z and P by a sample of variance `r` of `c` z, `c` (1, n)."""
        n = self.part.dynamics.n
        row = {Place("work", "c"): ca.densify(c).T, Place("work", "r"): r}
        arguments = ((_D, n), (Place("work", "c"), n), (Place("work", "r"), 1), (Place("work", "K"), n))
        read = max(c.sparsity().get_col(), default=-1) + 1  # elements of c from here on are 0
        return (
            Block("the measurement's row and variance", row),
            Kernel("correct", n, _COLUMNS, arguments, counts=(read,)),
            Block("correct", {Place("state", self.part.z.name): self.z + sym("work", "K", n) * error}),
        )


def _in_memory(name: str, matrix: Graph) -> tuple[Graph, Writes]:
    """Return `matrix` with symbols of the array `name` in place of its entries that are not constant, and the
    assignments of these entries to the array."""
    values = matrix.nonzeros()
    moving = [k for k, value in enumerate(values) if not value.is_constant()]
    if not moving:
        return matrix, {}
    symbols, computed = sym("work", name, len(moving)), column(values[k] for k in moving)
    for k, symbol in zip(moving, ca.vertsplit(symbols), strict=True):
        values[k] = symbol
    return ca.SX(matrix.sparsity(), column(values)), {Place("work", name): computed}


@dataclass(frozen=True)
class _Candidate:
    name: str
    pieces: Pieces

    @cached_property
    def longest(self) -> int:
        return max(map(text_operations, (self.pieces.predict, *self.pieces.update)))

    def __str__(self) -> str:
        sections = (self.pieces.predict, *self.pieces.update)
        times = sum(executed_operations(section).total() for section in sections)
        return f"in {self.name} {self.longest} operations in its longest section, {times} in a period"


def rotates(part: Riccati) -> bool:
    """Return whether plane rotations can factorise Phi P Phi' in loops: always for Phi = I + .., and for a discrete
    plant if a numerical trial at points of the ranges succeeds. They divide by 0 where rows of Phi L begin with zeros,
    as those of many delays do."""
    if not plant_tableau(part.dynamics.form.system).map:
        return True
    n = part.dynamics.n
    L = np.eye(n) + np.tril(np.random.default_rng(1).uniform(0.1, 0.9, (n, n)), -1)
    with np.errstate(all="ignore"):
        for F in part.slopes(POINTS)[0]:
            columns, D, root = (F @ L).T.copy(), np.ones(n), F @ L
            kernels.triangularise(columns, D, max(1, n - 1))
            lower_factor = np.tril(columns.T, -1) + np.eye(n)
            P = (lower_factor * D) @ lower_factor.T
            if not np.abs(P - root @ root.T).max() <= ROTATED * np.abs(root).max() ** 2:
                return False
    return True


def filter_pieces(part: Riccati, clock: Clock) -> Pieces:
    """Return the filter's program, in straight-line code or in loops: the shorter one, or the faster one if it is not
    too long; `choice` of the pieces names the reason. If straight-line code is short, loops are not generated for
    comparison."""
    n, straight_line, loop = part.dynamics.n, UnitTriangular(part, clock), Looped(part, clock)
    if part.dynamics.invariants and n <= LARGE:
        return replace(straight_line.pieces(), choice="the covariance in straight-line code, as for invariants")
    if n <= FULL and not all(map(is_diagonal, loop.matrices.values())):
        return replace(straight_line.pieces(), choice="the covariance in straight-line code, as for full matrices")
    if not rotates(part) and n <= LARGE:
        return replace(straight_line.pieces(), choice="the covariance in straight-line code, as for delays in a map")
    if n > LARGE:
        choice = f"the covariance in loops, as for more than {LARGE} states in any case"
        return replace(loop.pieces(), choice=choice)
    straight = _Candidate("straight-line code", straight_line.pieces())
    if straight.longest <= LONGER[clock.prefer]:
        return replace(straight.pieces, choice=f"the covariance {straight}, too few for loops to be shorter by enough")
    loops = _Candidate("loops", loop.pieces())
    longer = straight.longest - loops.longest > LONGER[clock.prefer]
    best, other = (loops, straight) if longer else (straight, loops)
    return replace(best.pieces, choice=f"the covariance {best}; {other}")
