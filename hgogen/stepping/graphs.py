"""A step, and its continuous observer, as CasADi functions of vectors.

step         (state, u, y, p) -> next, x, status    one call: the memory after it, the estimate, the status
derivative   (state, u, y, p) -> rate               of the observer's differential equations
estimate     (state, u, p) -> x                     from the state of these
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import chain
from math import prod
from operator import add
from typing import Literal

import casadi as ca

from hgogen.graph import Graph
from hgogen.method import Explicit
from hgogen.part import Clock, Ode
from hgogen.program import Block, Field, Place, Program, lines_of, sym
from hgogen.signal import Signal
from hgogen.step import Step
from hgogen.stepping.discretise import NoEquation, equation, tuned
from hgogen.stepping.entries import Entry, Vector, distinct, of_field, of_line, of_signals
from hgogen.stepping.guards import LARGEST_NUMBER, limit_parameters
from hgogen.stepping.members import read_fields
from hgogen.stepping.status import EXACT
from hgogen.stepping.symbolic import Memory, Shape, Symbolic, shapes


@dataclass(frozen=True)
class Flow:
    """The continuous observer: two functions, their state, and the names of its fields that are held."""

    derivative: ca.Function
    estimate: ca.Function
    state: Vector
    held: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Graphs:
    """The functions of a step; `graph` gives that of a block."""

    made: Step
    graph: Callable[[Block], ca.Function]

    @cached_property
    def memory(self) -> Vector:
        """All that a call remembers."""
        step = self.made
        entries = [entry for field in step.layout.state for entry in self._of(field)]
        for line in lines_of(step.layout.groups):
            entries += [entry for field in line[-1].fields for entry in of_line(line, field, step.unit(field))]
        return Vector("memory", tuple(entries))

    @cached_property
    def inputs(self) -> tuple[Vector, Vector, Vector]:
        """u, y, and the parameters: the gains, then what can be tuned of the plant."""
        step = self.made
        layout = step.layout
        gains = [entry for field in layout.gains for entry in self._of(field)]
        plant = distinct((e for f in layout.plant for e in self._of(f)), (g.name for g in layout.gains), "plant")
        signals = of_signals("inputs", step.inputs), of_signals("outputs", step.samples)
        return *signals, Vector("parameters", (*gains, *plant))

    @cached_property
    def estimates(self) -> Vector:
        """The estimated states, as a vector with names."""
        return of_signals("estimates", self.made.states)

    def step(self) -> ca.Function:
        """One call; its status is a number, or one for each 32 bits."""
        step, state, lies = (
            self.made,
            ca.MX.sym("state", len(self.memory)),
            shapes(self.made.layout.state, self.made.layout.groups),
        )
        (u, y, p), memory = self._symbols, {**self._tuned(step.code.tuning), **_parts(state, lies)}
        memory |= _scalars("input", step.inputs, u) | _scalars("output", step.samples, y)
        for section in step.code.sections:
            memory = self._symbolic.section(section.program, memory)
        x = self._estimated(memory)
        after = ca.veccat(*(memory[place] for place in lies))
        raised = [memory[bit.place] for bit in step.layout.raised] or [ca.MX(0)]
        words = [raised[k : k + EXACT] for k in range(0, len(raised), EXACT)]
        status = ca.vertcat(*(reduce(add, (2.0**k * each for k, each in enumerate(word))) for word in words))
        arguments, shown = ["state", "u", "y", "p"], ["next", "x", "status"]
        return ca.Function(f"{step.name}_step", [state, u, y, p], [after, x, status], arguments, shown)

    def flow(self) -> Flow:
        """The continuous observer. Raises: `NoEquation`."""
        if self.made.ages:
            raise NoEquation("a delayed observer", "it goes back to samples of the past")
        own = [field for ode in self._odes for field in ode.fields]
        others = read_fields([self.made.observer.z, *self._rates.values()]) | self._rates.keys()
        others -= {"u", *(field.name for field in own)}
        (u, y, p), name, fields = (
            self._symbols,
            self.made.name,
            [*own, *(f for f in self.made.layout.state if f.name in others)],
        )
        state = ca.MX.sym("state", sum(field.size for field in fields))
        derived = chain.from_iterable(tuned(part, self._clock) for part in self.made.observer.parts)
        tuning = limit_parameters(*self.made.layout.limited, tuple(derived))
        memory = {**self._tuned(tuning), **_parts(state, {Place("state", f.name): (f.size, 1) for f in fields})}
        memory |= {Place("state", "u"): u, Place("work", "u"): u} if u.numel() else {}
        memory[Place("work", "valid")] = valid = ca.fabs(y) <= LARGEST_NUMBER
        memory[Place("work", "y")] = ca.if_else(valid, y, 0)  # which leaves no trace, see `Ode`
        rates = [ca.SX(self._rates.get(field.name, ca.SX.zeros(field.size))) for field in fields]
        moved = {Place("work", "rate"): ca.vertcat(*rates)}
        rate = self._symbolic.program((Block("the rates", moved),), memory)[Place("work", "rate")]
        arguments = ["state", "u", "y", "p"]
        return Flow(
            ca.Function(f"{name}_derivative", [state, u, y, p], [rate], arguments, ["rate"]),
            ca.Function(f"{name}_estimate", [state, u, p], [self._estimated(memory)], ["state", "u", "p"], ["x"]),
            Vector("continuous state", tuple(entry for field in fields for entry in self._of(field))),
            tuple(field.name for field, rate in zip(fields, rates, strict=True) if rate.is_zero()),
        )

    # --- the continuous observer

    @property
    def _clock(self) -> Clock:
        return Clock(self.made.dt, self.made.clock.between, len(self.made.inputs), len(self.made.outputs))

    @cached_property
    def _odes(self) -> list[Ode]:
        method = self.made.method
        view: Literal["information", "covariance"] = method.view if isinstance(method, Explicit) else "covariance"
        return [ode for part in self.made.observer.parts if (ode := equation(part, view))]

    @cached_property
    def _rates(self) -> dict[str, Graph]:
        clock, rates = self._clock, dict[str, Graph]()
        u, y = sym("work", "u", clock.inputs), sym("work", "y", clock.outputs)
        for ode in self._odes:
            values = {field.name: sym("state", field.name, field.size) for field in ode.fields}
            rates |= ode.rhs(values, u, y, clock.valid)
        return rates

    # --- what both share

    @property
    def _symbolic(self) -> Symbolic:
        return Symbolic({line[-1].name: line for line in lines_of(self.made.layout.groups)}, self.graph)

    @cached_property
    def _symbols(self) -> list[Graph]:
        """u, y, p."""
        return [ca.MX.sym(name, len(vector)) for name, vector in zip("uyp", self.inputs, strict=True)]

    def _of(self, field: Field) -> Iterable[Entry]:
        return of_field(field, self.made.unit(field))

    def _tuned(self, tuning: Program) -> Memory:
        """The parameters in their ranges, those derived from them, and the bits of the status that this raises."""
        step = self.made
        lies = {
            Place(kind, f.name): (f.size, 1)
            for kind, fields in (("gain", step.layout.gains), ("plant", step.layout.plant))
            for f in fields
        }
        zeros = {Place("derived", f.name): ca.MX.zeros(f.size) for f in step.layout.derived}
        bits = {bit.place: ca.MX(0) for bit in step.layout.bits}
        return self._symbolic.section(tuning, {**zeros, **bits, **_parts(self._symbols[2], lies)})

    def _estimated(self, memory: Memory) -> Graph:
        shown = self._symbolic.section(self.made.code.estimate, memory)
        return ca.vertcat(*(shown[Place("estimate", signal.name)] for signal in self.made.states))


def _parts(vector: Graph, lies: dict[Place, Shape]) -> Memory:
    memory, start = Memory(), 0
    for place, shape in lies.items():
        memory[place] = ca.reshape(vector[start : start + prod(shape)], *shape)
        start += prod(shape)
    return memory


def _scalars(struct: str, signals: Iterable[Signal], vector: Graph) -> Memory:
    return {Place(struct, signal.name): vector[k] for k, signal in enumerate(signals)}
