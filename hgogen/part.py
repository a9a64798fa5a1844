"""The parts of an observer as data: the memory of a part and its action, in continuous time or at a sample.

A method (`method.py`) turns the parts that are differential equations into statements. Every part may use these places:
`state.u` the input at the last call, `work.u` the input now, `work.e` the innovation y_j - h_j(z, u) of the output
under update.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import casadi as ca
import numpy as np

from hgogen.errors import HgogenError
from hgogen.graph import Graph, wrapped
from hgogen.program import Bit, Field, Group, Program, Section, sym
from hgogen.system import System


def on_line(c: float | Graph, last: Graph, now: Graph, turns: Sequence[float | None] = ()) -> Graph:
    """Return the linear interpolation between `last` and `now`, at the fraction c of the step; exactly an end for c = 0
    or 1. `turns`: the period of each element that is an angle, which is interpolated the shorter way round."""
    if not isinstance(c, ca.SX) and c in (0.0, 1.0):
        return now if c == 1.0 else last
    difference = now - last
    if any(turns):
        pairs = zip(ca.vertsplit(difference), turns, strict=True)
        difference = ca.vertcat(*(wrapped(each, period) for each, period in pairs))
    return last + c * difference


SUBSTEPS = 8  # the largest number of sub-steps in a call, by default


@dataclass(frozen=True)
class Varying:
    """The limits of the time between two calls where it varies: at least `shortest`. A time above `longest` of the
    `Clock` is divided into at most `substeps` equal steps of at most that length; any further time is not predicted."""

    shortest: float
    substeps: int = SUBSTEPS


@dataclass(eq=False)
class NeedsFixedStep(HgogenError):
    """The error for a constant step length, requested of a clock whose step length varies."""

    text = "dt varies, and this needs one step length: give hg.sample a number for dt"


Guards = Literal["all", "none"]
Prefer = Literal["speed", "flash"]
First = Literal["update", "predict"]


@dataclass(frozen=True)
class Clock:
    """The sampling of a step: the step length dt, `longest`, 1 for a discrete plant, whose equations count samples;
    `between`: the course of the input between samples; the numbers of inputs and outputs; `every`: the number of steps
    between two samples of each output, empty where it is 1 for all; the `guards` of the step; `prefer`: the choice of a
    method, "speed", or "flash" for a short program; `turns`: the period of each input that is an angle; `report`: the
    names of the reports on the estimate; `sampling`: for a discrete plant the time between two samples, which no
    equation reads; `first`: "update", or "predict" if the first call predicts before it corrects; `varying`: for a step
    that is given the time since the last call, its limits; `times`: how many inputs, the last ones, are times."""

    longest: float
    between: str
    inputs: int
    outputs: int
    every: tuple[int, ...] = ()
    guards: Guards = "all"
    prefer: Prefer = "speed"
    turns: tuple[float | None, ...] = ()
    report: tuple[str, ...] = ()
    sampling: float | None = None
    first: First = "update"
    varying: Varying | None = None
    times: int = 0

    @property
    def dt(self) -> float:
        """The step length where it is a constant. Raises: `NeedsFixedStep`."""
        if self.varying:
            raise NeedsFixedStep
        return self.longest

    @property
    def h(self) -> Any:
        """The length of a prediction step, over which the model is integrated: a number, or an SX scalar where it
        varies."""
        return sym("work", "h") if self.varying else self.longest

    @property
    def passed(self) -> Any:
        """The time since the last call, limited to what the steps predict: a number, or an SX scalar where it
        varies."""
        return sym("state", "elapsed") if self.varying else self.longest

    @property
    def share(self) -> Any:
        """The ratio of the time since the last call to dt, at most 1: the constant 1, or an SX scalar."""
        return ca.fmin(self.passed * (1 / self.longest), 1) if self.varying else 1

    @property
    def evenness(self) -> float:
        """The ratio of the shortest time between two calls to the longest one; 1 for a constant dt."""
        return self.varying.shortest / self.longest if self.varying else 1.0

    @property
    def guarded(self) -> bool:
        """Whether the step has guards: clamps, and tests of samples."""
        return self.guards == "all"

    @property
    def periods(self) -> tuple[float, ...]:
        """The time between two samples of each output (p)."""
        return tuple(map(self.period, range(self.outputs)))

    def period(self, output: int) -> float:
        """Return the longest time (s) between two samples of an output: dt, or `every` times dt."""
        return self.longest * self.every[output] if self.every else self.longest

    def u(self, c: float | Graph) -> Graph:
        """Return the input (m) at the fraction c of the step: on the line from the last value, or constant."""
        return self.between_samples(c, sym("state", "u", self.inputs), sym("work", "u", self.inputs))

    def between_samples(self, c: float | Graph, last: Graph, now: Graph, h: Any = None) -> Graph:
        """Return the input (m) at the fraction c of a step between two samples, `h` apart, by default as long as a
        prediction; a time is exact."""
        u = now if self.between == "hold" else on_line(c, last, now, self.turns)
        if not self.times or (not isinstance(c, ca.SX) and c == 1.0):
            return u
        first, values = self.inputs - self.times, list[Graph](ca.vertsplit(now))
        return ca.vertcat(
            *ca.vertsplit(u)[:first], *(each - (1 - c) * (self.h if h is None else h) for each in values[first:])
        )

    def signals(self, c: float | Graph) -> dict[str, Graph]:
        """Return the arguments of an equation at the fraction c of the step: input, measurement, and its validity."""
        return {"u": self.u(c), "y": self.y(c), "valid": self.valid}

    @property
    def sizes(self) -> dict[str, int]:
        """The sizes of u, y and valid by name, as far as they vary: without guards `valid` is constant."""
        return {"u": self.inputs, "y": self.outputs} | ({"valid": self.outputs} if self.guarded else {})

    @property
    def constants(self) -> dict[str, Graph]:
        """The signals that are constant, by name: without guards `valid` is 1, since every sample is used."""
        return {} if self.guarded else {"valid": self.valid}

    @property
    def u_now(self) -> Graph:
        """The input (m) of this call, which the section `predict` has just stored, for the sections after it."""
        return sym("state", "u", self.inputs)

    def y(self, c: float | Graph) -> Graph:
        """Return the measurement (p) at the fraction c of the step, on the line between two valid samples."""
        return on_line(c, sym("work", "y_last", self.outputs), sym("work", "y", self.outputs))

    @property
    def valid(self) -> Graph:
        """The validity (p) of each output's sample, 1 or 0, as SX; without guards 1."""
        return sym("work", "valid", self.outputs) if self.guarded else ca.SX.ones(self.outputs)

    @property
    def sampled(self) -> Graph:
        """The flags (p), 1 or 0, of outputs with a usable sample in the last call, for the sections after `predict` of
        a step that integrates with the measurement; without guards all are 1."""
        return sym("state", "y_valid", self.outputs) > 0 if self.guarded else ca.SX.ones(self.outputs)


def clock_of(plant: System, dt: float, between: str, **options: Any) -> Clock:
    """Return the `Clock` of a step for a plant; `options`: further members of the clock."""
    turns, counts = tuple(u.period for u in plant.inputs), (len(plant.inputs), len(plant.outputs))
    return Clock(dt, between, *counts, turns=turns, times=len(plant.times), **options)


@dataclass(frozen=True)
class Joint:
    """The joint innovations of k outputs: `program` computes the places that both graphs read; `bias` (k) is subtracted
    from y - h(z); `covariance` (k, k) is S = H P H' + R; both are SX."""

    program: Program
    bias: Graph
    covariance: Graph


@dataclass(frozen=True, eq=False)
class Pieces:
    """The contribution of a part to a step: memory, and statements for each section.

    `update` has one program for each output, run when its sample is valid; `uses_output`: whether `predict` reads the
    measurement; `bits`: status bits of the part, or its texts for status bits of the step; `rule`: the name of the
    method that integrates the part, where it is not the step's; `choice`: which of two programs was selected, and why;
    `inner`: sections that these statements call; `covariance`: P (n, n) of the estimate as an SX of its fields, if it
    has one; `projected`: returns, for an SX C (k, n), C P C' and the statements that compute what it reads; `joint`:
    returns the joint innovations of outputs at the prediction; `inside`: converts statements on the fields of the part
    to statements on the step's memory; `congruence`: returns, for an SX N (n, n), statements that replace P by N P N';
    `project`: statements that project the estimates of members onto their ranges; `constrain`: statements that project
    the estimate onto the plant's invariants; `gate`: statements before the updates that decide which samples they may
    use; `verdicts`: the state's field with the verdict on an output, for each output with a gate; `correct`: statements
    after the updates, which then store their samples only.
    """

    fields: tuple[Field, ...] = ()
    groups: tuple[Group, ...] = ()
    derived: tuple[Field, ...] = ()
    bits: tuple[Bit, ...] = ()
    tune: Program = ()
    predict: Program = ()
    update: tuple[Program, ...] = ()
    adapt: Program = ()
    uses_output: bool = False
    rule: str = ""
    choice: str = ""
    inner: tuple[Section, ...] = ()
    covariance: Graph | None = None
    projected: Callable[[Graph], tuple[Program, Graph]] | None = None
    joint: Callable[[tuple[int, ...]], Joint] | None = None
    inside: Callable[[Program], Program] = tuple
    congruence: Callable[[Graph], Program] | None = None
    project: Program = ()
    constrain: Program = ()
    gate: Program = ()
    verdicts: Mapping[int, str] = field(default_factory=dict)
    correct: Program = ()


class Part:
    """A piece of an observer as data, such as its differential equation; `stepping.discretise.pieces` converts it to
    memory and statements."""


@dataclass(frozen=True, eq=False)
class Ode(Part):
    """Any continuous estimator: field' = linear(values, y - offset(u), valid) + residual(values, u, y, valid), by field
    name, of u (m), y (p), valid (p).

    `linear`: the terms linear in the fields and the measurement with coefficients free of states and inputs, the error
    core; None without one. `frozen`: fields in those coefficients, such as a gain that adapts, each with the values at
    which the core is the fastest. `core`: the error core as numbers, for an estimator that has one in other coordinates
    only, or (k, n, n) where it varies with the input. An invalid output must have no effect on the right-hand side.
    """

    fields: tuple[Field, ...]
    residual: Callable[[Mapping[str, Graph], Graph, Graph, Graph], Mapping[str, Graph]]
    linear: Callable[[Mapping[str, Graph], Graph, Graph], Mapping[str, Graph]] | None = None
    offset: Callable[[Graph], Graph] | None = None
    frozen: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    derived: tuple[Field, ...] = ()
    tune: Program = ()
    core: np.ndarray | None = None

    def rhs(self, values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        """Return the whole right-hand side."""
        residual = dict(self.residual(values, u, y, valid))
        if self.linear is None:
            return residual
        lines = self.linear(values, y if self.offset is None else y - self.offset(u), valid)
        return {name: lines[name] + residual[name] if name in lines else residual[name] for name in residual}


@dataclass(frozen=True, eq=False)
class Jump(Part):
    """A part of an observer that changes at samples, not by a method: `build` returns its memory and statements.
    `flow`: the rates, SX by field name, of the differential equation that it solves exactly, if there is one."""

    build: Callable[[Clock], Pieces]
    flow: Mapping[str, Graph] = field(default_factory=dict)
