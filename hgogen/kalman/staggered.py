"""The innovation by staggered copies of the model: M + 1 of them, one restarted from the estimate every d/M.

Each copy sums dt |y - yhat|^2. The oldest has an age between d and d (1 + 1/M); its sum is scaled down to d by its
number of valid samples and never scaled up.
"""

from dataclasses import dataclass, field, replace

import casadi as ca

from hgogen.discretisation.runge_kutta import Tableau
from hgogen.graph import Graph
from hgogen.kalman.kalman_theorems import STAGGERED
from hgogen.kalman.predictor import (
    INNOVATION,
    MOST,
    Predictor,
    Predictors,
    Weights,
    beyond,
    clamped,
    in_order,
    samples,
    summed,
)
from hgogen.part import Clock, Pieces
from hgogen.program import INF, Block, Field, Group, Loop, Place, Program, When, scalar, sym
from hgogen.structure.dynamics import Dynamics
from hgogen.theorem import Hypothesis

_Z, _SUM, _SAMPLES = (Place("predictor", name) for name in ("z", "sum", "samples"))
_OLDEST, _TICK = Place("state", "oldest"), Place("state", "tick")
_RESTART, _BEYOND = Place("work", "restart"), Place("work", "beyond")


@dataclass(frozen=True)
class Staggered:
    """See the module; `d` (s), `predictors` M, `tableau` that moves them, `weights` of the outputs' squares."""

    d: float
    predictors: int
    tableau: Tableau
    weights: Weights = field(default=(), hash=False)
    hypothesis: Hypothesis = STAGGERED

    def part(self, dynamics: Dynamics, z: Field) -> Predictors:
        """M + 1 copies of the model in the group `predictor`."""
        weights = in_order(self.weights, dynamics)

        def build(predictor: Predictor, clock: Clock) -> Pieces:
            return _Copies(
                predictor, clock, samples(self.d, clock.dt, self.predictors), self.predictors, weights
            ).pieces

        return Predictors(Predictor(dynamics, z, self.tableau), build)


@dataclass(frozen=True)
class _Copies:
    """M + 1 `predictors` at a clock: `count` samples in the window, M `shares` of it."""

    predictor: Predictor
    clock: Clock
    count: int
    shares: int
    weights: tuple[float, ...]

    @property
    def members(self) -> int:
        return self.shares + 1

    @property
    def period(self) -> int:
        """Samples between two restarts."""
        return self.count // self.shares

    @property
    def most(self) -> int:
        """Samples at which a count of them stops."""
        return self.members * self.period + 1

    @property
    def n(self) -> int:
        return self.predictor.dynamics.n

    @property
    def total(self) -> Graph:
        """Each output's sum (p)."""
        return sym("predictor", "sum", self.clock.outputs)

    @property
    def valid(self) -> Graph:
        """Each output's number of samples in the sum (p)."""
        return sym("predictor", "samples", self.clock.outputs)

    @property
    def pieces(self) -> Pieces:
        return Pieces(
            fields=(
                INNOVATION,
                scalar("oldest", 0, kind="index", high=self.members - 1, meaning="index of the oldest predictor"),
                scalar("tick", 0, kind="index", high=self.period - 1, meaning="samples since the last restart"),
            ),
            groups=(self._group(),),
            predict=(Loop("predictor", self.members, self._move()),),
            update=tuple(self._accumulate(j) for j in range(self.clock.outputs)),
            adapt=self._adapt(),
        )

    def _group(self) -> Group:
        p = self.clock.outputs
        zeros, many = (0.0,) * p, (float(self.most),) * p
        sums = Field("sum", zeros, low=zeros, high=(MOST,) * p, unit="y^2 s", meaning="sum of dt (y - yhat)^2")
        counts = Field("samples", zeros, "index", (-INF,) * p, many, meaning="valid samples in the sum")
        fields = (replace(self.predictor.z, meaning="predicted state"), sums, counts)
        return Group("predictor", self.members, fields, "copies of the model that run without correction")

    def _move(self) -> Program:
        z, field = sym("predictor", "z", self.n), self.predictor.z
        moved = self.predictor.moved(z, self.clock.u, self.clock.dt)
        advance = Block(f"each predictor by {self.predictor.tableau.name}, without correction", {_Z: moved})
        still = [k for k in range(self.n) if ca.is_equal(moved[k], z[k], 1)]
        if not self.clock.guarded or len(still) == self.n:
            return (advance,)
        return (
            advance,
            Block("is it beyond its box, or lost?", {_BEYOND: beyond(field, z, still)}),
            When(_BEYOND, (Block("keep it in its box", {_Z: clamped(field, z, still)}),), idle=True),
        )

    def _accumulate(self, output: int) -> Program:
        """The sample of an output in every predictor's sum."""
        total, valid = self.total, self.valid
        z = sym("predictor", "z", self.n)
        error = sym("work", "measurement") - self.predictor.dynamics.output(z, self.clock.u_now)[output]
        squared = ca.fmin(total[output] + self.clock.period(output) * error * error, MOST)
        more = ca.if_else(valid[output] < self.most, valid[output] + 1, self.most)
        add = Block("its squared output error", {_SUM: _with(total, output, squared)})
        tally = Block("one more sample", {_SAMPLES: _with(valid, output, more)})
        return (Loop("predictor", self.members, (add, tally)),)

    def _adapt(self) -> Program:
        """The innovation is read of the oldest predictor, which then restarts if it is due."""
        numbers = [max(1, self.count // every) for every in self.clock.every] or [self.count]
        wanted = ca.SX(ca.DM(numbers)) if len({*numbers}) > 1 else numbers[0]  # of each output in the window
        scaled = self.total * (wanted / ca.fmax(self.valid, wanted))
        text = "innovation: the sum of the oldest predictor, scaled to the window, never scaled up"
        read = Block(text, {Place("state", "innovation"): summed(self.weights, scaled)})
        tick, after = sym("state", "tick") + 1, sym("state", "oldest") + 1
        over = tick >= self.period
        due = {_RESTART: over, _TICK: ca.if_else(over, 0, tick)}
        none, estimate = ca.SX.zeros(self.clock.outputs), sym("state", self.predictor.z.name, self.n)
        restart = Block("the oldest predictor restarts from the estimate", {_Z: estimate, _SUM: none})
        empty = Block("no sample yet", {_SAMPLES: none})
        rotate = Block("the next one is the oldest", {_OLDEST: ca.if_else(after >= self.members, 0, after)})
        return (
            Loop("predictor", 1, (read,), start=_OLDEST),
            Block(f"one predictor restarts every {self.period} samples", due),
            When(_RESTART, (Loop("predictor", 1, (restart, empty), start=_OLDEST), rotate)),
        )


def _with(values: Graph, index: int, value: Graph) -> Graph:
    """The SX column with another element."""
    return ca.vertcat(*(value if i == index else values[i] for i in range(values.numel())))
