"""Recovery: an estimate that good samples do not bring back restarts from the sample.

Signs that it is lost are counted at each plausible sample of an output that is judged, each by itself, one that is not
used for being absurdly far from the prediction among them:

    y_j     |y_j - yhat_j| > SHARE times what y_j can span, at the samples of y_j
    range   the estimate is outside a declared range by more than MARGIN of its width, at the samples of any

    c <- c + p_j  where the sign shows,   c <- max(c - p_j, 0)  elsewhere         p_j = 1, of range its period in dt
    c >= w:  the estimate restarts from the sample; c <- min(w, M/2), w <- min(2 w, M)
    c = 0:   w <- W
    W = T/(period of y_j), of range p T/dt of p outputs judged                    T of stepping/patience.py

An estimate that shows a sign at more than half of the samples for as long as T is taken not to converge, but to sit in
a corner of its outer box, or at a false equilibrium beyond the ranges, where the model is evaluated at the edge. That
is a judgement by rates at rest and no theorem. It can be wrong: an observer may need longer to converge, a plant may
rest beyond its declared ranges and the estimate be right. So each restart doubles w, up to M = 1024 W, or what can be
counted, and leaves c: it comes again when the sign has shown for twice as long in all, and later every M/2 samples:
after a fault that has lasted for longer than T, the next restart comes no later than once more that time. w is W again
when the samples have been good for as long as w. An estimate that is far at fewer samples, as one that swings through
the truth, is not told from a sensor with outliers. Counts that are out of their ranges, or not what they were left at,
of memory that was spoiled, begin anew where a sign shows: a patience that is too long would not show. A theorem of
convergence holds from the last restart on.

Restart from the sample: all memory is as after a reset but for what lasts, and the fields that the estimate is read
from, which fit the sample (stepping/nearest.py). A cold restart would fall into the same attractor.

An observer without a model of its last row, whose error never tends to 0, has no sign range; nor has one without a
range of a state, nor an output without a range a sign y_j. An observer without a sign has no such law.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, reduce
from math import ceil

import casadi as ca
import numpy as np

from hgogen.chains.core import nominal, numbers
from hgogen.graph import Graph
from hgogen.observer import Observer
from hgogen.part import Clock, Pieces
from hgogen.program import INF, Block, Field, Place, Program, When, scalar, sym
from hgogen.stepping.guards import any_of, outside, plausible, readings
from hgogen.stepping.members import fresh, fresh_groups, read_fields
from hgogen.stepping.nearest import nearest
from hgogen.stepping.patience import patience
from hgogen.stepping.trust import trusted

SHARE = 0.1  # of what an output can span: an innovation beyond it is a sign
MARGIN = 0.05  # of a range: the estimate of a plant that rests at the edge may lie beyond it, of noise and bias
FEWEST = 5  # samples that show a sign before a restart
DOUBLED = 1024  # times the first wait: the longest
LONGEST = 1 << 23  # a float adds two such counts exactly


@dataclass(frozen=True)
class Sampled:
    """A sample of an output as SX scalars: `y`, whether it is `valid`, its `error` before the correction."""

    y: Graph
    valid: Graph
    error: Graph


Samples = Mapping[int, Sampled]  # by output


@dataclass(frozen=True)
class Sign:
    """A sign that an estimate is lost: of `output`, or of the range of a state for None. `meaning` says of what, after
    "at which"; `time` (the model's unit) for which it shows at least before the first restart, `wait` (W) and `most`
    (M) as counts."""

    name: str
    output: int | None
    meaning: str
    time: float
    wait: int
    most: int

    @property
    def doubt(self) -> str:
        """The field of the state that counts it, c."""
        return f"doubt_{self.name}"

    @property
    def patience(self) -> str:
        """The field of the count at which the estimate restarts, w."""
        return f"patience_{self.name}"

    @property
    def fields(self) -> tuple[Field, ...]:
        """What is remembered of it."""
        evidence, limit = "evidence of valid samples that the estimate is lost", "doubt at which it restarts"
        return (
            scalar(self.doubt, 0.0, low=0.0, high=self.most, meaning=evidence),
            scalar(self.patience, self.wait, low=self.wait, high=self.most, meaning=limit),
        )

    def counted(self, weight: int) -> Program:
        """One sample more that shows it, where `work.shows_NAME` says so, or that does not; `work.over_NAME` says
        whether the count is at its end. Doubt and patience are in their ranges, which was asked."""
        doubt, limit, over = sym("state", self.doubt), sym("state", self.patience), Place("work", f"over_{self.name}")
        more = Block("more doubt", {Place("state", self.doubt): ca.fmin(doubt + weight, self.most)})
        ended = Block("is patience at its end?", {over: doubt >= limit})
        less = {
            Place("state", self.doubt): ca.fmax(doubt - weight, 0),
            Place("state", self.patience): ca.if_else(doubt <= weight, self.wait, limit),
            over: ca.SX(0),
        }
        return (When(Place("work", f"shows_{self.name}"), (more, ended), (Block("less doubt", less),)),)

    @property
    def longest(self) -> float:
        """The longest time between two restarts by it."""
        return self.time * self.most / self.wait / 2

    @property
    def later(self) -> Block:
        """The next restart by this sign asks for twice the doubt."""
        limit = sym("state", self.patience)
        doubled = {self.doubt: ca.fmin(limit, self.most / 2), self.patience: ca.fmin(2 * limit, self.most)}
        return Block("patience doubles", {Place("state", name): value for name, value in doubled.items()})


@dataclass(frozen=True, eq=False)
class Recovery:
    """The law for an observer whose parts are `pieces`; see the module."""

    observer: Observer
    clock: Clock
    pieces: Pieces

    @cached_property
    def judged(self) -> tuple[int, ...]:
        """The outputs by which the estimate is judged."""
        return trusted(self.observer, self.clock)

    @cached_property
    def signs(self) -> tuple[Sign, ...]:
        """What is counted of this observer."""
        outputs = [j for j in self.judged if self._spans[j] < INF]
        ranges = not self.observer.practical and not self._outside.is_constant()
        longest = LONGEST // max(1, len(outputs) + ranges)
        if not self.clock.guarded or not (outputs or ranges):
            return ()
        time, p, dt = patience(self.observer, self.clock, self._widest()), len(self.judged), self.clock.dt
        signs = []
        for j in outputs:
            period, y = self.clock.period(j), self.observer.form.system.outputs[j].name
            wait = min(max(FEWEST, ceil(time / period)), longest // 2)
            name, meaning = "y" if p == 1 else f"y_{y}", f"{y} is off by {SHARE:.0%} of its span"
            signs.append(Sign(name, j, meaning, wait * period, wait, min(DOUBLED * wait, longest)))
        if ranges:
            wait = min(max(FEWEST * p, ceil(p * time / dt)), longest // 2)
            meaning = f"the estimate is out of a range by {MARGIN:.0%} of it"
            signs.append(Sign("range", None, meaning, wait * dt / p, wait, min(DOUBLED * wait, longest)))
        return tuple(signs)

    @cached_property
    def _outside(self) -> Graph:
        """Whether the estimate is outside a declared range; SX."""
        return outside(self.observer)

    @cached_property
    def _readings(self) -> list[tuple[float, float]]:
        """What each output can read."""
        return readings(self.observer.form)

    @cached_property
    def _spans(self) -> list[float]:
        """What each output can span."""
        return [high - low for low, high in self._readings]

    @property
    def fields(self) -> tuple[Field, ...]:
        """What the law remembers."""
        fields = tuple(field for sign in self.signs for field in sign.fields)
        if not fields:
            return ()
        most = sum(field.high[0] - field.low[0] for field in fields)
        meaning = "all doubt, and patience beyond the first: checks them"
        return (*fields, scalar("doubt_sum", 0.0, low=0.0, high=most, meaning=meaning))

    @property
    def _sum(self) -> Graph:
        """The sum of all doubt, and of the patience beyond the first; SX."""
        return sum(sym("state", sign.doubt) + (sym("state", sign.patience) - sign.wait) for sign in self.signs)

    def watch(self, samples: Samples, says: bool) -> Program:
        """The law at the end of a section that has corrected the estimate.

        `says`: whether this section also raises OUTSIDE_BOX.
        """
        bit = {Place("status", "OUTSIDE_BOX"): self._outside} if says else {}
        samples = {j: samples[j] for j in self.judged if j in samples}
        if not self.signs or not samples:
            return (Block("is the estimate outside the declared box?", bit),) if bit else ()
        signs = [sign for sign in self.signs if sign.output is None or sign.output in samples]
        rejected = any_of(ca.logic_not(sample.valid) for sample in samples.values())
        sampled = any_of(self._plausible(j, sample) for j, sample in samples.items())
        beyond = [self._outside if sign.output is None else self._beyond(sign, samples) for sign in signs]
        doubtful = any_of([*beyond, ca.logic_not(sym("state", "doubt_sum") <= 0), rejected])
        shows = {sign: self._shows(sign, samples) for sign in signs}
        judged_by = Block("is there a sample to judge by?", {Place("work", "sampled"): sampled})
        judgement = Block(
            "which signs show?", {Place("work", f"shows_{sign.name}"): value for sign, value in shows.items()}
        )
        counts = (statement for sign in signs for statement in self._counted(sign, samples))
        over = Block("is it lost?", {Place("work", "lost"): any_of(sym("work", f"over_{sign.name}") for sign in signs)})
        judged = (*self._checked, judgement, *counts, over, When(Place("work", "lost"), self._restart(signs, samples)))
        remember = Block("remember what doubt and patience add up to", {Place("state", "doubt_sum"): self._sum})
        return (
            Block("is the estimate where it cannot be for long?", {**bit, Place("work", "doubtful"): doubtful}),
            When(Place("work", "doubtful"), (judged_by, When(Place("work", "sampled"), (*judged, remember)))),
        )

    @property
    def _checked(self) -> Program:
        """Doubt and patience as after a reset, where they are out of their ranges or not what they were left at."""
        same = ca.fabs(self._sum - sym("state", "doubt_sum")) < 0.5
        counts = [(sym("state", field.name), field) for sign in self.signs for field in sign.fields]
        inside = [ca.logic_and(c >= field.low[0], c <= field.high[0]) for c, field in counts]
        sound = reduce(ca.logic_and, inside, same)
        spoiled = Block("was doubt or patience spoiled?", {Place("work", "spoiled"): ca.logic_not(sound)})
        return (spoiled, When(Place("work", "spoiled"), self.calm))

    @cached_property
    def calm(self) -> Program:
        """Doubt and patience as after a reset."""
        return fresh("state", self.fields, part="clear_doubt")

    @cached_property
    def rest(self) -> Program:
        """What is remembered beside the estimate as after a reset, but for what lasts; members start from the
        estimate."""
        shown, pieces = self._shown(), self.pieces
        fields = [field for field in pieces.fields if field not in shown and not field.lasting]
        groups = fresh_groups("state", pieces.fields, pieces.groups, self.observer.z)
        return (*fresh("state", fields, part="clear_rest"), *groups)

    def _beyond(self, sign: Sign, samples: Samples) -> Graph:
        """Whether the error of a sign's output is larger than its limit; not where the error is not a number."""
        assert sign.output is not None
        return ca.fabs(samples[sign.output].error) > SHARE * self._spans[sign.output]

    def _shows(self, sign: Sign, samples: Samples) -> Graph:
        """Whether a sign shows, where there is a sample to judge by."""
        if sign.output is None:
            return outside(self.observer, MARGIN)
        return ca.logic_not(ca.fabs(samples[sign.output].error) <= SHARE * self._spans[sign.output])

    def _plausible(self, j: int, sample: Sampled) -> Graph:
        """Whether the estimate is judged by a sample: a valid one, or one that is absurdly far from the prediction."""
        return ca.logic_or(sample.valid, plausible(self._readings[j], sample.y))

    def _counted(self, sign: Sign, samples: Samples) -> Program:
        """A sign's count moved by these samples."""
        if sign.output is None:
            return sign.counted(self._weight(tuple(samples)))
        if len(samples) == 1:
            return sign.counted(1)
        taken = Place("work", f"counts_{sign.name}")
        return (
            Block(
                "is there a sample to judge by?",
                {
                    taken: self._plausible(sign.output, samples[sign.output]),
                    Place("work", f"over_{sign.name}"): ca.SX(0),
                },
            ),
            When(taken, sign.counted(1)),
        )

    def _weight(self, judged: tuple[int, ...]) -> int:
        """The count p_j of a judgement by these outputs, so that all of them add up to p in a time dt."""
        if len(judged) == len(self.judged):
            return len(self.judged)
        return self.clock.every[judged[0]] if self.clock.every else 1

    def _restart(self, signs: list[Sign], samples: Samples) -> Program:
        """Memory as after a reset, but for the estimate, which is the nearest to it that fits the samples."""
        shown = self._shown()
        later = (When(Place("work", f"over_{sign.name}"), (sign.later,)) for sign in signs)
        return (
            *later,
            *nearest(self.observer, self.clock, shown, {j: (s.y, self._plausible(j, s)) for j, s in samples.items()}),
            Block("the estimate has restarted from the sample", {Place("status", "RESTARTED_FROM_SAMPLE"): ca.SX(1)}),
            *self.rest,
        )

    def _shown(self) -> tuple[Field, ...]:
        """The fields that the estimate is read from."""
        read = read_fields([self.observer.z])
        return tuple(field for field in self.pieces.fields if field.name in read and field.kind == "real")

    def _widest(self) -> float:
        """The largest ratio r, over the coordinates, of the widths of the outer box and the declared one."""
        shown = self._shown()
        x = ca.vertcat(*(sym("state", field.name, field.size) for field in shown))
        values = {Place("state", field.name): np.array(field.initial) for field in shown}
        values |= {Place("state", "u"): np.zeros(len(self.observer.form.system.inputs)), **nominal(self.observer)}
        slope = np.abs(numbers(ca.jacobian(self.observer.z, x), values))
        outer = np.array([high - low for field in shown for low, high in field.box])
        inner = np.array([high - low for low, high in self.observer.dynamics.box])
        reach = slope @ np.where(np.isfinite(outer), outer, 0.0)
        known = np.isfinite(inner) & np.isfinite(reach) & (inner > 0)
        return float(np.clip(np.max(reach[known] / inner[known], initial=1.0), 1.0, 1e9))
