"""A plant on measured records: its unknowns, and how it moves and is read between samples.

    x_(k+1) = F(x_k, u_k, u_(k+1); p),   y_k = h(x_k, u_k; p) + o

F by classical Runge-Kutta, a few steps a sample. Unknown are the parameters p, the offsets o, and the states where
segments of the records begin.

What the records tell: with F the Fisher information on (parameters and offsets p, the others s), and A the Jacobian of
what must be 0, of which the columns of p and s are A_p and A_s,

    M = F_pp - [F_ps  A_p'] [[F_ss, A_s'], [A_s, 0]]^-1 [[F_sp], [A_p]]

is what is left on p when s fits best beside each p, all in units of ranges. To F_ss 1e-10 is added: a state that no
output shows is known to lie somewhere in its range. M^-1 sigma^2 is the covariance of p where residuals are white.

T. Soederstroem, P. Stoica, System Identification (1989), chapters 7 and 11.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from hgogen.discretisation.runge_kutta import RK4, advance, repeated
from hgogen.graph import Graph, to_casadi
from hgogen.identification.records import BadLog, Log
from hgogen.part import on_line
from hgogen.program import column
from hgogen.reading.time_unit import plural
from hgogen.signal import Signal, resting
from hgogen.system import System

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Information:
    """`M` (q, q) of the parameters and offsets in their units, as above with sigma = 1; `residuals` (N, p) of each
    record, in the units of the outputs, NaN where nothing was measured; `tell`: of each output what its residuals tell,
    record after record, in the units of M."""

    M: Array
    residuals: tuple[Array, ...]
    tell: tuple[Array, ...]

    @property
    def outputs(self) -> tuple[Array, ...]:
        """The residuals of each output, record after record."""
        return tuple(column[np.isfinite(column)] for column in np.concatenate(self.residuals).T)


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

    @cached_property
    def output(self) -> Array:
        """The number of the output of each residual."""
        return np.concatenate([np.nonzero(np.isfinite(record.y))[1] for record in self.records])

    def by_output(self, values: Array) -> tuple[Array, ...]:
        """Those of each output, record after record."""
        return tuple(values[self.output == j] for j in range(len(self.plant.outputs)))

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


SOMEWHERE = 1e-10


def eliminated(F: Any, A: Any, q: int) -> Array:
    """M (q, q), of the first q unknowns; F (v, v) and A (gaps, v) may be sparse."""
    F, A = ca.DM(F), ca.DM(A)
    A_p, A_s = A[:, :q], A[:, q:]
    rest = F[q:, q:] + SOMEWHERE * ca.DM.eye(F.shape[0] - q)
    K = ca.blockcat([[rest, A_s.T], [A_s, ca.DM(A.shape[0], A.shape[0])]])
    side = ca.vertcat(F[q:, :q], A_p)
    M = (F[:q, :q] - side.T @ ca.solve(K, side, "qr")).full()
    return np.asarray((M + M.T) / 2)


def tables(records: Sequence[Log], outputs: Sequence[Array]) -> tuple[Array, ...]:
    """Values of each output where it was measured, record after record, as tables (N, p) of the records."""
    made = [np.full(record.y.shape, np.nan) for record in records]
    for j, values in enumerate(outputs):
        begin = 0
        for record, table in zip(records, made, strict=True):
            there = np.isfinite(record.y[:, j])
            end = begin + int(there.sum())
            table[there, j] = values[begin:end]
            begin = end
    return tuple(made)


POINTS = 40
FOLLOWED = 1.0  # |h lambda| of a Runge-Kutta step, at most
MOST_STEPS = 50  # of a sample


def paced(plant: System, period: float) -> tuple[int, float]:
    """The Runge-Kutta steps of a sample that the fastest mode asks for, and the rate at which errors grow. Raises:
    `BadLog` for samples too slow for the plant."""
    fastest, growing = rates(plant)
    steps = max(1, math.ceil(fastest * period / FOLLOWED))
    if steps > MOST_STEPS:
        reason = f"moves at rates up to {fastest:.3g}, too fast for samples {period:g} apart"
        fix = f"are the times in {plural(plant.time)}? Else narrow its ranges, or give a faster record"
        raise BadLog(f"plant {plant.name!r}", f"{reason}; {fix}")
    return steps, growing


def rates(plant: System) -> tuple[float, float]:
    """The largest modulus of an eigenvalue of df/dx, and the largest real part, 0 where none is positive: at rest, and
    at random points of the declared ranges."""
    draw, n, signals = np.random.default_rng(0), len(plant.states), (*plant.states, *plant.inputs, *plant.parameters)
    symbols = {s: ca.SX.sym(s.name) for s in signals}
    at = column(symbols.values())
    flow = column(to_casadi(plant.flow, symbols))
    jacobian = ca.Function("jacobian", [at], [ca.jacobian(flow, at)[:, :n]])
    spectra = [np.zeros(1)]
    for k in range(POINTS):
        J = jacobian([draw.uniform(*s.interval) if s.bounded and k else resting(s) for s in signals]).full()
        if np.isfinite(J).all():
            spectra.append(np.linalg.eigvals(J))
    every = np.concatenate(spectra)
    return float(np.abs(every).max()), float(max(0.0, every.real.max()))
