"""The innovation as the paper defines it: the model runs again from the estimate d ago at every sample.

A ring remembers N + 1 estimates, inputs and outputs, N = d/dt: N model steps a sample.
"""

from dataclasses import dataclass, field, replace

import casadi as ca

from hgogen.discretisation.runge_kutta import Tableau
from hgogen.graph import Graph
from hgogen.kalman.kalman_theorems import WINDOW
from hgogen.kalman.predictor import (
    INNOVATION,
    MOST,
    Predictor,
    Predictors,
    Weights,
    clamped,
    in_order,
    samples,
    summed,
)
from hgogen.part import Clock, Pieces
from hgogen.program import Block, Field, Group, Loop, Place, Program, scalar, sym
from hgogen.structure.dynamics import Dynamics
from hgogen.theorem import Hypothesis

_NEWEST, _FILLED = Place("state", "newest"), Place("state", "filled")
_RECENT_Y, _RECENT_VALID = Place("state", "recent_y"), Place("state", "recent_valid")
_OLDEST, _FIRST, _STEPS = (Place("work", name) for name in ("oldest", "first", "steps"))
_Z, _U, _SUM = (Place("work", name) for name in ("zw", "uw", "sum"))


@dataclass(frozen=True)
class Window:
    """See the module; `d` (s), `tableau` that moves the model, `weights` of the outputs' squares."""

    d: float
    tableau: Tableau
    weights: Weights = field(default=(), hash=False)
    hypothesis: Hypothesis = WINDOW

    def part(self, dynamics: Dynamics, z: Field) -> Predictors:
        """A ring of N + 1 samples in the group `past`."""
        weights = in_order(self.weights, dynamics)

        def build(predictor: Predictor, clock: Clock) -> Pieces:
            return _Ring(predictor, clock, samples(self.d, clock.dt), weights).pieces

        return Predictors(Predictor(dynamics, z, self.tableau), build)


@dataclass(frozen=True)
class _Ring:
    """The last samples at a clock; `steps`: N of the window."""

    predictor: Predictor
    clock: Clock
    steps: int
    weights: tuple[float, ...]

    @property
    def size(self) -> int:
        """Samples that are remembered."""
        return self.steps + 1

    @property
    def n(self) -> int:
        return self.predictor.dynamics.n

    @property
    def pieces(self) -> Pieces:
        p = self.clock.outputs
        zeros, after = (0.0,) * p, sym("state", "newest") + 1
        newest = {_NEWEST: ca.if_else(after >= self.size, 0, after)}
        sample = {"z": sym("state", self.predictor.z.name, self.n)}
        sample |= {"y": sym("state", "recent_y", p), "valid": sym("state", "recent_valid", p)}
        sample |= {"u": sym("state", "u", self.clock.inputs)} if self.clock.inputs else {}
        store = Block("store", {Place("past", name): value for name, value in sample.items()})
        start = {_Z: sym("past", "z", self.n), _SUM: ca.SX(0), **self._input()}
        oldest = Block("the model starts from the estimate d ago", start)
        again = Block(f"the model again by {self.predictor.tableau.name}, its squared output error", self._replay())
        return Pieces(
            fields=(
                INNOVATION,
                scalar("newest", 0, kind="index", high=self.size - 1, meaning="index of the newest sample"),
                scalar("filled", 0, kind="index", high=self.size, meaning="samples in the window"),
                Field("recent_y", zeros, meaning="measurement of this call"),
                Field("recent_valid", zeros, meaning="1 where it counts"),
            ),
            groups=(self._group(),),
            predict=(Block("no sample yet", {_RECENT_VALID: ca.SX.zeros(p)}),),
            update=tuple(self._remember(j) for j in range(p)),
            adapt=(
                Block("the newest sample takes the place of the oldest", newest),
                Loop("past", 1, (store,), start=_NEWEST),
                self._find(),
                Loop("past", 1, (oldest,), start=_OLDEST),
                Loop("past", self.steps, (again,), start=_FIRST, active=_STEPS),
                Block("innovation", {Place("state", "innovation"): sym("work", "sum")}),
            ),
        )

    def _group(self) -> Group:
        zeros = (0.0,) * self.clock.outputs
        fields = [replace(self.predictor.z, meaning="estimate")]
        fields += [Field("u", (0.0,) * self.clock.inputs, meaning="input")] if self.clock.inputs else []
        fields += [Field("y", zeros, meaning="measurement"), Field("valid", zeros, meaning="1 where it counts")]
        return Group("past", self.size, tuple(fields), "the samples of the window")

    def _remember(self, output: int) -> Program:
        """The sample of an output in this call."""
        p = self.clock.outputs
        y, valid = ca.SX(sym("state", "recent_y", p)), ca.SX(sym("state", "recent_valid", p))
        y[output], valid[output] = sym("work", "measurement"), 1
        return (Block("this sample", {_RECENT_Y: y, _RECENT_VALID: valid}),)

    def _find(self) -> Block:
        newest, filled, size = sym("state", "newest"), sym("state", "filled"), self.size
        count = ca.if_else(filled < size, filled + 1, size)
        oldest = ca.if_else(newest + 1 < count, newest + 1 + size - count, newest + 1 - count)
        first = ca.if_else(oldest + 1 >= size, 0, oldest + 1)
        writes = {_FILLED: count, _OLDEST: oldest, _FIRST: first, _STEPS: count - 1}
        return Block("the window starts at the oldest sample", writes)

    def _input(self) -> dict[Place, Graph]:
        """The input of a sample, which is the one before the next sample's; none where the plant has none."""
        return {_U: sym("past", "u", self.clock.inputs)} if self.clock.inputs else {}

    def _replay(self) -> dict[Place, Graph]:
        """One step of the model, and the squared error of its output in the sum."""
        p, m, clock = self.clock.outputs, self.clock.inputs, self.clock
        y, valid, u, before = sym("past", "y", p), sym("past", "valid", p), sym("past", "u", m), sym("work", "uw", m)
        moved = self.predictor.moved(sym("work", "zw", self.n), lambda c: clock.between_samples(c, before, u), clock.dt)
        moved = clamped(self.predictor.z, moved) if clock.guarded else moved
        error = y - self.predictor.dynamics.output(moved, u)
        rates = ca.SX(ca.DM(clock.every)) * valid if clock.every else valid
        squares = summed(self.weights, rates * (error * error))
        return {_Z: moved, _SUM: ca.fmin(sym("work", "sum") + clock.dt * squares, MOST), **self._input()}
