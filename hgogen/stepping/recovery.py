"""Recovery: an estimate outside its ranges is projected onto them, a lost estimate restarts from the sample.

Separate counters count the signs of a fault at each plausible sample of a judged output, including samples that are
rejected as absurdly far from the prediction:

    y_j     |e_j| > max(SHARE s_j, min(SIGMAS sqrt(S_j), SHARE s_j r_j))   e_j = y_j - yhat_j before the correction
    range   the estimate is outside a declared range by more than MARGIN of its width, at the samples of any output

with the width s_j of the range of y_j and, for a filter, the variance S_j of e_j and the ratio r_j >= 1 of this
sensor's noise to that of the best sensor, relative to their ranges. So a sensor with a large R causes no restart by
errors that R explains, unless all sensors have a large R: then Q and R may be known only up to a factor. The fault
counter c of y_j has the sign of the last error that raised it:

    |c| <- |c| + 1           if the sign occurs and e_j has the sign of c, or c = 0
    |c| <- max(|c| - m, 0)   if it occurs and e_j has the other sign, which becomes that of c
    |c| <- max(|c| - 1, 0)   otherwise
    c <- c + p or max(c - p, 0)   for range, if it occurs or not; p is the period of the sample in dt

    |c| >= w:  a guard acts; |c| <- min(w, M/2), w <- min(2 w, M)
    c = 0:     w <- W
    W = T/(period of y_j), of range p T/dt of p outputs judged;   m = 1/(lambda period of y_j), at least 2
                                                                  T, lambda: see below

Where the time between two calls varies, 1 and p are multiplied by min(that time/dt, 1), dt the longest step: a count
that has risen by w has lasted for at least w dt and w samples.

The guard of y_j is a restart. The guard of range is a projection (stepping/projection.py). It is a restart where the
estimate is outside by more than FAR of a width, at a false equilibrium or in a corner of its outer box, and where w is
above W: since the last guard there was no fault-free period as long as its waiting time, so the projection did not
help.

Independent errors that are symmetric about 0 cause no restart, however large and frequent they are. Where a share q of
them is a sign, |c| > 0 changes on average by at most q/2 - 2 q/2 - (1 - q) = q/2 - 1 < 0. From 1 it reaches w before 0
with a probability of at most x^(1 - w), x = (2 - q + sqrt((2 - q)^2 + 4 q^2))/(2 q) >= 1.618: x^|c| is a martingale for
m = 2, as q x/2 + (1 - q)/x + q/(2 x^2) = 1. Hence w is at least FEWEST. Errors that change their sign within m samples,
faster than the plant, such as a tone or coloured noise of a sensor, cause no restart either: |c| rises by less than m
between two changes, and falls by m at each. A restart requires errors as slow as the plant at more than half of the
samples for the time T.

This law is a heuristic based on rates at equilibrium, not a theorem. It can be wrong: an observer may need longer to
converge, and a plant may stay beyond its declared ranges with a correct estimate. So w doubles, up to M = 1024 W or the
largest count, and c is kept: a guard acts again when the sign has lasted twice as long in all, and later every M/2
samples. After a fault that has lasted longer than T, the next restart comes at the latest after the same time again. w
is reset to W after w samples without a fault. Counters outside their ranges, or with a wrong checksum because memory
was corrupted, are reset when a sign occurs: a limit that is too high would not be noticed otherwise. A theorem of
convergence holds from the last restart on.

Restart from the sample: all memory is reset except the lasting fields and the fields of the estimate, which fit the
sample (stepping/projection.py). A cold restart could converge to the same false attractor.

For a Riccati observer R defines the trust s_j^2/R_j in each sensor, relative to its range. A sensor is not used to
judge the estimate if its trust is less than LEAST times that in another, and if its declared noise exceeds its range,
R_j/period_j > s_j^2: its error may be permanent. S_j, before the correction by y_j with r = R_theta/period_j and
c = dh_j/dz, is c P c' + r. After the correction, when this law reads P, c P c' has become p = r c P c'/(c P c' + r), so
that S_j is r^2/(r - p). A method that integrates with the measurement corrects little in a step: there S_j is p + r.

An observer without a model of its last row, whose error does not tend to 0, has no sign range, and neither has an
observer without a range of a state. An output without a range has no sign y_j. An observer without a sign has no law of
recovery.

T is the settling time:

    T = max(2 ln(100 r)/mu, 2/lambda)

An observer that converges at the rate mu needs T/2 to reduce an error as wide as the outer box, r times the declared
one, to a hundredth of the declared one. The other half allows for multiple poles, and for a model that works against
the gain. mu is the slowest rate of the linear error core, at the geometric mean of the ends of a varying gain. For a
Riccati observer it is the geometric mean of the rates of its steady closed loop, the median over points of the box: the
slow modes are taken to be the least observable. A filter that is slower restarts, and then waits longer. With
forgetting at the rate rho no mode is slower than rho/2: its closed loop is that of F + rho/2. A plant may deviate from
its model for a time that depends on its own rate, such as a tank that overflows: lambda is the geometric mean of
|eigenvalues| of its Jacobian, the median over points of the box.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, reduce
from math import ceil, log
from typing import Any

import casadi as ca
import numpy as np

from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.linearised import Singular, jacobians_on_box
from hgogen.estimators.core import core, nominal, numbers
from hgogen.estimators.riccati_part import Riccati, RiccatiVariant, frozen_riccati
from hgogen.graph import Graph
from hgogen.observer import Observer
from hgogen.part import Clock, Ode, Pieces
from hgogen.program import INF, Block, Call, Field, Place, Program, Section, Statement, When, scalar, stacked, sym
from hgogen.stepping.discretise import demand_countable
from hgogen.stepping.guards import any_of, outside, plausible, readings
from hgogen.stepping.members import reset_fields, reset_groups
from hgogen.stepping.parallel import Parallel
from hgogen.stepping.projection import estimate_fields, nearest, projection

FINE = 100  # the declared box over a settled error
HIDDEN = 1e-6  # of the fastest rate: a slower mode is a rounding error
POINTS = 6  # corners of the box, and as many points inside, at which a linearisation is evaluated
GONE = 0.05  # the size of an eigenvalue of a map whose mode is gone after a sample
SAMPLES = 10  # the inverse of a rate, where none is known


def settling_time(observer: Observer, clock: Clock, r: float) -> float:
    """Return the settling time T = max(2 ln(100 r)/mu, 2/lambda) in the model's time unit, mu the observer's slowest
    rate, lambda the plant's typical rate, `r` the width of the outer box over the declared one."""
    plant = plant_rate(observer.dynamics)
    return max(2 * log(FINE * r) / rate(observer, clock), 0.0 if plant is None else 2 / plant)


@lru_cache(maxsize=32)
def plant_rate(dynamics: Dynamics) -> float | None:
    """Return the typical rate lambda of a plant: the geometric mean of the absolute eigenvalues of its Jacobian, for a
    discrete plant of their absolute logarithms, as the median over points of the box; None where the Jacobian is 0, or
    not finite at a point."""
    try:
        slopes, _ = jacobians_on_box(dynamics, POINTS)
    except Singular:
        return None
    sizes = np.abs(np.linalg.eigvals(slopes))
    if dynamics.form.system.discrete:
        sizes = np.abs(np.log(np.maximum(sizes, GONE)))
    return _typical(sizes)


def _typical(decays: np.ndarray) -> float | None:
    """Return the median over k points of the geometric mean of `decays` (k, n) above rounding errors."""
    means = [np.exp(np.log(row[row > HIDDEN * row.max()]).mean()) for row in decays if row.max() > 0]
    return float(np.median(means)) if means else None


def rate(observer: Observer, clock: Clock) -> float:
    """Return the slowest rate mu at which errors of the observer decay; if none is known, the rate of ten samples."""
    mu = [mu for part in observer.parts if (mu := _rate(part, observer, clock)) is not None]
    return min(mu, default=1 / (SAMPLES * clock.longest))


def _rate(part: Any, observer: Observer, clock: Clock) -> float | None:
    match part:
        case Ode():
            firsts = {field.name: np.array(field.initial) for field in part.fields}
            middle = {name: tuple(np.sqrt(firsts[name] * most)) for name, most in part.frozen.items()}
            line = core(replace(part, frozen=middle), clock.outputs)
            matrix = part.core if line is None else numbers(line.M, nominal(observer))
            if matrix is None or not np.isfinite(matrix).all():
                return None
            decays = -np.linalg.eigvals(matrix).real.ravel()
            return min(decays[decays > 0].tolist(), default=None)
        case Riccati():
            riccati = frozen_riccati(part.dynamics).of(*part.linearised(POINTS), *part.typical, part.scaling)
            decays = riccati.decay_rates(part.theta.late)
            if part.forgetting is not None:
                decays = np.maximum(decays, part.forgetting.initial[0] / 2)
            return _typical(decays[decays[:, 0] > HIDDEN * decays[:, -1]])
        case RiccatiVariant():
            return _rate(part.plain, observer, clock)
        case Parallel():
            return rate(part.member, clock)
    return None


@dataclass(frozen=True)
class Sign:
    """The detection of a fault by counting samples: with a large error of `output` (index), or for None with an
    estimate outside its ranges. `meaning`: the text after "at which"; `time` (the model's unit): the shortest duration
    of the sign before a restart or projection; as counts, `wait` W, the first limit, `most` M, the largest, and
    `change` m, the decrease for an error of the other sign."""

    name: str
    output: int | None
    meaning: str
    time: float
    wait: int
    most: int
    change: int = 0

    @property
    def count(self) -> str:
        """The name of the state's field of the fault count c."""
        return f"fault_count_{self.name}"

    @property
    def limit(self) -> str:
        """The name of the state's field of the limit w: at |c| >= w the observer restarts or is projected."""
        return f"fault_limit_{self.name}"

    @property
    def fields(self) -> tuple[Field, ...]:
        """The state's fields of the fault count c and of its limit w."""
        least = 0 if self.output is None else -self.most
        signed = "" if self.output is None else ", with the sign of the last error"
        counted, guard = f"samples at which {self.meaning}{signed}", f"{self.count} at which a guard acts"
        return (
            scalar(self.count, 0.0, low=least, high=self.most, meaning=counted),
            scalar(self.limit, self.wait, low=self.wait, high=self.most, meaning=guard),
        )

    @property
    def counted(self) -> Block:
        """The block of code c <- s max(|c| + change, 0), at most M, with the temporaries `moves_NAME`, the change, and
        `side_NAME` of the sign s.

        Count and limit were tested to be in their ranges, and stay there. A count at its maximum is at its limit as
        well, which a static analyser need not infer.
        """
        change, limit = sym("work", f"moves_{self.name}"), sym("state", self.limit)
        size = ca.fmin(ca.fmax(self.size + change, 0), self.most)
        return Block(
            f"count of {self.name}",
            {
                Place("state", self.count): self._signed(sym("work", f"side_{self.name}"), size),
                Place("state", self.limit): ca.if_else(size <= 0, self.wait, limit),
            },
        )

    @property
    def over(self) -> Graph:
        """Whether the fault count |c| has reached its limit w, SX."""
        return self.size >= sym("state", self.limit)

    @property
    def size(self) -> Graph:
        """The absolute value |c| of the fault count, SX."""
        count = sym("state", self.count)
        return count if self.output is None else ca.fabs(count)

    def _signed(self, side: Graph, size: Graph) -> Graph:
        return size if self.output is None else ca.if_else(side < 0, -size, size)

    @property
    def longest(self) -> float:
        """The longest time between two restarts due to this sign, in the model's unit."""
        return self.time * self.most / self.wait / 2

    @property
    def later(self) -> Block:
        """The block that doubles the limit w after a restart or projection, up to M, and sets |c| to min(w, M/2)."""
        count, limit = sym("state", self.count), sym("state", self.limit)
        least = ca.fmin(limit, self.most / 2)  # the size of the count has reached it
        doubled = {self.count: self._signed(count, least), self.limit: ca.fmin(2 * limit, self.most)}
        return Block("the fault limit doubles", {Place("state", name): value for name, value in doubled.items()})


SHARE = 0.1  # of the range of an output: a larger innovation is a sign
SIGMAS = 3  # standard deviations of an innovation that is no sign, for a sensor that is noisier than the best
MARGIN = 0.05  # of a range: noise and bias put the estimate beyond the edge at which a plant stays
LEAST = 0.01  # of the trust in the best sensor
ROUNDED = 2.0**-20  # of r: a smaller r - p is a rounding error
FAR = 0.5  # of a range: the estimate is at a false equilibrium, from where a projection does not bring it back
FEWEST = 30  # samples with a sign before a guard acts: independent noise does not reach it
DOUBLED = 1024  # the largest limit over the first
LONGEST = 1 << 23  # a float adds two such counts exactly


@dataclass(frozen=True)
class Sampled:
    """A sample of an output, as SX scalars: its value `y`, whether it is `valid`, and its `error` y - yhat before the
    correction."""

    y: Graph
    valid: Graph
    error: Graph


Samples = Mapping[int, Sampled]  # by output


@dataclass(frozen=True, eq=False)
class Recovery:
    """The law that counts signs of a fault, then restarts the estimate or projects it onto its ranges; `pieces`: the
    parts of the observer; `sections`: the number of sections of the step that evaluate the law."""

    observer: Observer
    clock: Clock
    pieces: Pieces
    sections: int

    @cached_property
    def judged(self) -> tuple[int, ...]:
        """The indices of the outputs by which the estimate is judged, the least trusted first, those without a range
        before the others; all, in their order, for an observer without noise."""
        trust, bounded = self._trust, np.isfinite(self._spans)
        if trust is None or not bounded.any():
            return tuple(range(len(bounded)))
        periods = np.array([self.clock.period(j) for j in range(len(bounded))])
        worthless = (trust < LEAST * trust.max()) & (trust * periods < 1) & bounded
        return tuple(int(j) for j in np.argsort(trust, kind="stable") if not worthless[j])

    @cached_property
    def _trust(self) -> np.ndarray | None:
        """The ratio s_j^2/R_j for each output (p), s_j its range and R_j its noise
        variance, 0 without a range; None for an observer without noise."""
        riccati, spans = _riccati(self.observer), np.array(self._spans)
        return None if riccati is None else np.where(np.isfinite(spans), spans, 0.0) ** 2 / riccati.typical[1]

    @cached_property
    def signs(self) -> tuple[Sign, ...]:
        """The signs of a fault that this observer counts; empty for a step without guards."""
        outputs = [j for j in self.judged if self._spans[j] < INF]
        ranges = not self.observer.practical and not self._outside.is_constant()
        most = int(LONGEST * self.clock.evenness)  # a smaller part of a sample is not lost in such a count
        longest = most // max(1, len(outputs) + ranges)
        if not self.clock.guarded or not (outputs or ranges):
            return ()
        time, p, dt = settling_time(self.observer, self.clock, self._widest()), len(self.judged), self.clock.longest
        signs, rate = [], plant_rate(self.observer.dynamics)
        if not self.observer.form.system.discrete:
            demand_countable(self.observer.form, dt, most // 2, SHARE)
        for j in outputs:
            period, y = self.clock.period(j), self.observer.form.system.outputs[j].name
            wait = max(FEWEST, ceil(min(time / period, longest // 2)))
            name, meaning = "y" if p == 1 else f"y_{y}", f"{y} is off by {SHARE:.0%} of its span"
            change = wait // 2 if rate is None else min(max(2, ceil(1 / (rate * period))), wait // 2)
            signs.append(Sign(name, j, meaning, wait * period, wait, min(DOUBLED * wait, longest), change))
        if ranges:
            wait = max(FEWEST * p, ceil(min(p * time / dt, longest // 2)))
            meaning = f"the estimate is out of a range by {MARGIN:.0%} of it"
            signs.append(Sign("range", None, meaning, wait * dt / p, wait, min(DOUBLED * wait, longest)))
        return tuple(signs)

    @cached_property
    def _outside(self) -> Graph:
        return outside(self.observer)

    @cached_property
    def _readings(self) -> list[tuple[float, float]]:
        return readings(self.observer.form)

    @cached_property
    def _spans(self) -> list[float]:
        return [high - low for low, high in self._readings]

    @property
    def fields(self) -> tuple[Field, ...]:
        """The state's fields of fault counts c, their limits w, and a checksum of these."""
        fields = tuple(field for sign in self.signs for field in sign.fields)
        if not fields:
            return ()
        most = sum(2 * sign.most - sign.wait for sign in self.signs)
        meaning = "checksum of fault counts and limits"
        return (*fields, scalar("fault_checksum", 0.0, low=0.0, high=most, meaning=meaning))

    @property
    def _sum(self) -> Graph:
        """The checksum of fault counters: the sum of the sizes of all
        counts, and of all limits less their initial values."""
        return sum(s.size + (sym("state", s.limit) - s.wait) for s in self.signs)

    @cached_property
    def inner(self) -> tuple[Section, ...]:
        """The sections that others call: one counts estimates outside their ranges, the other one projects the estimate
        onto the ranges."""
        return (*self._counting, *self._projecting)

    @cached_property
    def _counting(self) -> tuple[Section, ...]:
        if self.sections < 2 or self.clock.every or not self.signs:
            return ()
        return (Section("count_range", "check the fault counts, and count the range", self._counted_range(1)),)

    @cached_property
    def _projecting(self) -> tuple[Section, ...]:
        if self.sections < 2 or not self._projection:
            return ()
        return (Section("project_onto_ranges", "project the estimate onto its declared ranges", self._projection),)

    def _counted_range(self, weight: int) -> Program:
        unchanged = ca.fabs(self._sum - sym("state", "fault_checksum")) < 0.5
        counts = [(sym("state", field.name), field) for sign in self.signs for field in sign.fields]
        inside = [ca.logic_and(c >= field.low[0], c <= field.high[0]) for c, field in counts]
        sound = reduce(ca.logic_and, inside, unchanged)
        spoiled = Block(
            "was a fault count or limit spoiled?",
            {Place("work", "spoiled"): ca.logic_not(sound)},
            part="counts_spoiled",
        )
        program: list[Statement] = [spoiled, When(Place("work", "spoiled"), self.cleared)]
        weight *= self.clock.share
        change = ca.if_else(outside(self.observer, MARGIN), weight, -weight)
        for sign in self.signs:
            if sign.output is None:
                changed = {Place("work", f"moves_{sign.name}"): change}
                program += [Block("is the estimate out of a range?", changed), sign.counted]
        return tuple(program)

    @cached_property
    def _projection(self) -> Program:
        ranges = any(sign.output is None for sign in self.signs)
        return projection(self.observer, self.pieces) if ranges else ()

    def watch(self, samples: Samples, notice: bool) -> Program:
        """Return the statements of the law at the end of a section that has corrected by `samples`. `notice`: whether
        they also raise the status bit OUTSIDE_BOX."""
        bit = {Place("status", "OUTSIDE_BOX"): self._outside} if notice else {}
        samples = {j: samples[j] for j in self.judged if j in samples}
        if not self.signs or not samples:
            return (Block("is the estimate outside the declared box?", bit),) if bit else ()
        weight = len(samples)  # the weights of all judged outputs add up to their number in a time dt
        if weight < len(self.judged):
            weight = self.clock.every[next(iter(samples))] if self.clock.every else 1
        signs = [sign for sign in self.signs if sign.output is None or sign.output in samples]
        rejected = any_of(ca.logic_not(sample.valid) for sample in samples.values())
        sampled = any_of(self._plausible(j, sample) for j, sample in samples.items())
        beyond = [
            self._outside if s.output is None else ca.fabs(samples[s.output].error) > SHARE * self._spans[s.output]
            for s in signs
        ]
        suspect = any_of([*beyond, ca.logic_not(sym("state", "fault_checksum") <= 0), rejected])
        judged_by = Block(
            "is there a sample to judge by?", {Place("work", "sampled"): sampled}, part="sample_in_plausible_range"
        )
        ranges = tuple(map(Call, self._counting)) or self._counted_range(weight)
        outputs = [sign for sign in signs if sign.output is not None]
        change = {place: value for sign in outputs for place, value in self._changes(sign, samples).items()}
        signs_ = Block(
            "a count goes up by 1 at a large error, far down at one of the other sign, else down by 1",
            change,
            part="find_signs",
        )
        counts = (signs_, *(sign.counted for sign in outputs)) if outputs else ()
        remember = Block("the checksum of fault counts and limits", {Place("state", "fault_checksum"): self._sum})
        judged = (*ranges, *counts, *self._guard(signs, samples), remember)
        return (
            Block(
                "is the estimate out of a range or far from a sample, or does a fault count run?",
                {**bit, Place("work", "suspect"): suspect},
                part="suspect",
            ),
            When(Place("work", "suspect"), (judged_by, When(Place("work", "sampled"), judged, part="count_faults"))),
        )

    @cached_property
    def cleared(self) -> Program:
        """The program that resets fault counts and limits to their values before the first call."""
        return reset_fields("state", self.fields, part="clear_fault_counts")

    @cached_property
    def other_memory(self) -> Program:
        """The program that resets all memory except estimate and lasting fields; copies of the model start from it."""
        estimate, pieces = self._estimate_fields(), self.pieces
        fields = [field for field in pieces.fields if field not in estimate and not field.lasting]
        groups = reset_groups("state", pieces.fields, pieces.groups, self.observer.z)
        return (*reset_fields("state", fields, part="clear_rest"), *groups)

    def _changes(self, sign: Sign, samples: Samples) -> dict[Place, Graph]:
        """Return the assignments that change |c| of the fault counter c at these samples, and a value with the sign of
        the new c."""
        assert sign.output is not None
        sample, count = samples[sign.output], sym("state", sign.count)
        deviates = ca.logic_not(ca.fabs(sample.error) <= self._limit(sign.output))  # true for nan as well
        one = self.clock.share
        change = ca.if_else(deviates, ca.if_else(count * sample.error < 0, -sign.change, one), -one)
        if len(samples) > 1:
            deviates = ca.logic_and(deviates, self._plausible(sign.output, sample))
            change = ca.if_else(self._plausible(sign.output, sample), change, 0)
        return {
            Place("work", f"moves_{sign.name}"): change,
            Place("work", f"side_{sign.name}"): ca.if_else(deviates, sample.error, count),
        }

    def _limit(self, j: int) -> Graph:
        """Return the limit of |y - yhat| of output j beyond which the error is a sign of a fault."""
        least, trust, riccati = SHARE * self._spans[j], self._trust, _riccati(self.observer)
        noisier = float(np.sqrt(trust.max() / trust[j])) if trust is not None and trust[j] > 0 else 1.0
        if riccati is None or noisier <= 1:
            return ca.SX(least)
        variance = riccati.R[j] / self.clock.period(j)
        if self.pieces.covariance is not None:
            c = ca.sparsify(riccati.dynamics.output_jacobian(self.observer.z, self.clock.u_now)[j, :])
            r = riccati.scaling.variance(riccati.R[j], riccati.theta.value, j, self.clock.period(j))
            p = ca.dot(c, c @ self.pieces.covariance)
            variance = r * r / ca.fmax(r - p, ROUNDED * r) if self.pieces.update else r + p
        return ca.fmax(least, ca.fmin(SIGMAS * ca.sqrt(variance), least * noisier))

    def _plausible(self, j: int, sample: Sampled) -> Graph:
        """Return whether a sample is used to judge the estimate: it is valid, or it is absurdly far from the
        prediction."""
        signal = self.observer.form.system.outputs[j]
        return ca.logic_or(sample.valid, plausible(signal, self._readings[j], sample.y))

    def _guard(self, signs: list[Sign], samples: Samples) -> Program:
        acts, lost = Place("work", "acts"), Place("work", "lost")
        over = {sign: Place("work", f"over_{sign.name}") for sign in signs}
        helpless = []
        for sign in signs:
            if sign.output is not None:
                helpless.append(sign.over)
            else:  # a projection has not helped, by the limit of the sign, or the estimate is far outside
                strayed = ca.logic_or(sym("state", sign.limit) > sign.wait, outside(self.observer, FAR))
                helpless.append(ca.logic_and(sign.over, strayed))
        writes = {place: sign.over for sign, place in over.items()}
        later = (When(place, (sign.later,)) for sign, place in over.items())
        project = tuple(map(Call, self._projecting)) or self._projection
        fitted = {j: (s.y, self._plausible(j, s)) for j, s in samples.items()}
        restart = (  # memory is reset, with the nearest estimate to the initial one that fits the samples
            *nearest(self.observer, self.clock, self._estimate_fields(), fitted),
            Block("the estimate has restarted from the sample", {Place("status", "RESTARTED_FROM_SAMPLE"): ca.SX(1)}),
            *self.other_memory,
            *self.pieces.constrain,
        )
        return (
            Block("is a fault count at its limit?", {acts: any_of(sign.over for sign in signs)}),
            When(
                acts,
                (
                    Block(
                        "which fault counts are at their limits, and must the estimate restart?",
                        {**writes, lost: any_of(helpless)},
                        part="choose_recovery",
                    ),
                    *later,
                    When(lost, restart, project, part="restart_from_sample"),
                ),
                part="recover",
            ),
        )

    def _estimate_fields(self) -> tuple[Field, ...]:
        return estimate_fields(self.observer, self.pieces.fields)

    def _widest(self) -> float:
        fields = self._estimate_fields()
        x = stacked(fields)
        values = {Place("state", field.name): np.array(field.initial) for field in fields}
        values |= {Place("state", "u"): np.zeros(len(self.observer.form.system.inputs)), **nominal(self.observer)}
        slope = np.abs(numbers(ca.jacobian(self.observer.z, x), values))
        outer = np.array([high - low for field in fields for low, high in field.box])
        inner = np.array([high - low for low, high in self.observer.dynamics.box])
        reach = slope @ np.where(np.isfinite(outer), outer, 0.0)
        comparable = np.isfinite(inner) & np.isfinite(reach) & (inner > 0)
        return float(np.clip(np.max(reach[comparable] / inner[comparable], initial=1.0), 1.0, 1e9))


def _riccati(observer: Observer) -> Riccati | None:
    for part in observer.parts:
        inner = _riccati(part.member) if isinstance(part, Parallel) else part
        plain = inner.plain if isinstance(inner, RiccatiVariant) else inner
        if isinstance(plain, Riccati):
            return plain
    return None
