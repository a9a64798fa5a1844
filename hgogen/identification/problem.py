"""A plant on measured records: its unknowns, and how it moves and is read between samples.

    x_(k+1) = F(x_k, u_k, u_(k+1); p),   y_k = h(x_k, u_k; p) + o

F by classical Runge-Kutta, a few steps a sample. Unknown are the parameters p, the offsets o, and the states where
segments of the records begin.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from hgogen.discretisation.runge_kutta import RK4, advance, repeated
from hgogen.graph import Graph, to_casadi
from hgogen.identification.information import Information
from hgogen.identification.records import Log
from hgogen.part import on_line
from hgogen.program import column
from hgogen.signal import Signal
from hgogen.system import System

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Problem:
    """Of a plant on records.

    `free`: the parameters that are fitted, the others at their nominal values; `scale` (p): of each output, by which
    residuals are divided; `length`: samples of a segment; `steps`: Runge-Kutta steps a sample; `between`: how inputs
    go on between samples, "hold" or "line"; `offset`: the outputs that have an unknown constant added.

    The vector of unknowns is (free, offsets, the states at the beginnings of all segments, record by record, levels).
    """

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
        """Of the unknowns that are of the problem alone: where they begin, and their bounds."""
        return ()

    @property
    def graph(self) -> tuple[Any, Any, Any]:
        """The unknowns (MX), what is minimised, and what must be 0."""
        raise NotImplementedError

    def noise(self, unknowns: Array) -> tuple[dict[str, float], dict[str, float]]:
        """The density of process noise by state, and the deviation of a sample by output, where they are fitted."""
        return {}, {}

    def residuals(self, unknowns: Array) -> tuple[Array, ...]:
        """Those of each output where it was measured, record after record, over their scale."""
        raise NotImplementedError

    def information(self, unknowns: Array, unit: Array) -> Information:
        """What the records tell, at the unknowns (v), whose sizes are `unit` (v)."""
        raise NotImplementedError

    @cached_property
    def step(self) -> Any:
        """(x, p, u now, u then) -> x one sample on, with dt as the last argument."""
        x, p, h = ca.SX.sym("x", self.n), ca.SX.sym("p", len(self.free)), ca.SX.sym("dt")
        u, then = (ca.SX.sym(name, len(self.plant.inputs)) for name in ("u", "then"))

        def rate(values: Any, c: float) -> dict[str, Graph]:
            now = u if self.between == "hold" else on_line(c, u, then)
            return {"x": h * self._of(self.plant.flow, values["x"], p, now)}

        moved = advance(repeated(RK4, self.steps), rate, {"x": x}, 1.0).result["x"]  # in samples
        return ca.Function("step", [x, p, u, then, h], [moved])

    @cached_property
    def reading(self) -> Any:
        """(x, p, offsets, u) -> y."""
        x, p, o = ca.SX.sym("x", self.n), ca.SX.sym("p", len(self.free)), ca.SX.sym("o", len(self.offset))
        u = ca.SX.sym("u", len(self.plant.inputs))
        added = [o[self.offset.index(y)] if y in self.offset else 0 for y in self.plant.outputs]
        return ca.Function("reading", [x, p, o, u], [self._of(self.plant.output, x, p, u) + ca.vertcat(*added)])

    @property
    def n(self) -> int:
        """The number of states."""
        return len(self.plant.states)

    @property
    def constants(self) -> int:
        """The number of parameters and offsets."""
        return len(self.free) + len(self.offset)

    @property
    def segments(self) -> tuple[int, ...]:
        """Of each record."""
        return tuple(-(-len(record.y) // self.length) for record in self.records)

    @property
    def size(self) -> int:
        """The number of unknowns."""
        return self.constants + self.n * sum(self.segments) + len(self.levels)

    def parts(self, unknowns: Graph) -> tuple[Graph, Graph, tuple[Graph, ...]]:
        """The parameters, offsets, and for each record the states (n, segments) where its segments begin."""
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
        return column(to_casadi(rows, values))
