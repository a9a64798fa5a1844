"""Multiple shooting: a plant on measured records as one nonlinear least-squares problem.

    minimise   1/2 sum_k sum_j ((y_k,j - h_j(x_k, u_k; p) - o_j)/s_j)^2
    subject to x_(k+1) = F(x_k, u_k, u_(k+1); p),

F by classical Runge-Kutta, a few steps a sample. A record is cut into segments; the state where one begins is unknown,
and the next begins where it ends. So short a motion depends on its parameters nearly linearly, where that over a whole
record may turn or grow many times.

H. G. Bock, "Numerical treatment of inverse problems in chemical reaction kinetics", Springer Series in Chemical
Physics 18 (1981).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from hgogen.discretisation.runge_kutta import RK4, advance, repeated
from hgogen.graph import Graph, to_casadi
from hgogen.identification.records import Log
from hgogen.part import on_line
from hgogen.program import column
from hgogen.signal import Signal
from hgogen.system import System

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Shooting:
    """The problem of a plant on records.

    `free`: the parameters that are fitted, the others at their nominal values; `scale` (p): of each output, by which
    residuals are divided; `length`: samples of a segment; `steps`: Runge-Kutta steps a sample; `between`: how inputs
    go on between samples, "hold" or "line"; `offset`: the outputs that have an unknown constant added.

    The vector of unknowns is (free, offsets, the states at the beginnings of all segments, record by record).
    """

    plant: System
    free: tuple[Signal, ...]
    records: tuple[Log, ...]
    scale: Array
    length: int
    steps: int
    between: str = "hold"
    offset: tuple[Signal, ...] = ()

    @cached_property
    def output(self) -> Array:
        """The number of the output of each residual."""
        return np.concatenate([np.nonzero(np.isfinite(record.y))[1] for record in self.records])

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
    def segments(self) -> tuple[int, ...]:
        """Of each record."""
        return tuple(-(-len(record.y) // self.length) for record in self.records)

    @property
    def size(self) -> int:
        """The number of unknowns."""
        return len(self.free) + len(self.offset) + self.n * sum(self.segments)

    def parts(self, unknowns: Graph) -> tuple[Graph, Graph, tuple[Graph, ...]]:
        """The parameters, offsets, and for each record the states (n, segments) where its segments begin."""
        a, b = len(self.free), len(self.free) + len(self.offset)
        nodes, begin = [], b
        for count in self.segments:
            nodes.append(ca.reshape(unknowns[begin : begin + self.n * count], self.n, count))
            begin += self.n * count
        return unknowns[:a], unknowns[a:b], tuple(nodes)

    @cached_property
    def graph(self) -> tuple[Any, Any, Any]:
        """The unknowns (MX), the residuals where something was measured, and the gaps between segments, as columns."""
        v = ca.MX.sym("v", self.size)
        p, o, every = self.parts(v)
        residuals, gaps = [], []
        for record, nodes in zip(self.records, every, strict=True):
            errors, gap = self._of_record(record, nodes, p, o)
            residuals.append(errors)
            gaps.append(gap)
        return v, ca.vertcat(*residuals), ca.vertcat(*gaps)

    def _of_record(self, record: Log, nodes: Any, p: Any, o: Any) -> tuple[Any, Any]:
        """The segments side by side, the last one filled up with samples that count for nothing."""
        L, count, N = self.length, nodes.shape[1], len(record.y)
        u = record.u[np.minimum(np.arange(count * L + 1), N - 1)]
        now, then = (part.reshape(count, L, -1).transpose(0, 2, 1) for part in (u[:-1], u[1:]))
        states, at = [nodes], nodes
        for k in range(L):
            at = self.step.map(count)(at, p, now[:, :, k].T, then[:, :, k].T, record.dt)
            states.append(at)
        read = [self.reading.map(count)(x, p, o, now[:, :, k].T) for k, x in enumerate(states[:-1])]
        place, output = np.nonzero(np.isfinite(record.y))
        table = ca.vertcat(*[ca.vec(each) for each in read])  # by sample of a segment, segment and output
        rows = (place % L * count + place // L) * record.y.shape[1] + output
        errors = (table[rows.tolist()] - record.y[place, output]) / self.scale[output]
        return errors, ca.vec(nodes[:, 1:] - at[:, :-1])

    def _of(self, rows: Sequence[Any], x: Graph, p: Graph, u: Graph) -> Graph:
        values: dict[Any, Graph] = {q: ca.SX(float(value)) for q, value in self.plant.nominal.items()}
        values |= dict(zip(self.plant.states, ca.vertsplit(x), strict=True))
        values |= dict(zip(self.free, ca.vertsplit(p), strict=True)) if self.free else {}
        values |= dict(zip(self.plant.inputs, ca.vertsplit(u), strict=True)) if self.plant.inputs else {}
        return column(to_casadi(rows, values))
