"""Sampled-data realisations of the linear core of an observer, its nonlinear rest by a scheme of order 2.

    x' = M x + B v + r(x, u, y),  v = y - o(u)                 M, B constant: the core of `Ode.linear`
    a  = Phi x + Gamma_0 v_0 + Gamma_1 v_1 + Psi_0 r_0         r_0 = r(x, u_0, y_0)
    x+ = a + Psi_1 (r_1 - r_0)                                 r_1 = r(a, u_1, y_1)

where 0 and 1 are the ends of a step; a method gives the matrices, which `tune` computes of the gains. Where a sample is
missing, M and B are those of `Ode.linear` without it. The core sets no limit to the step; the rest does, by its slope.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import chain, product

import casadi as ca
import numpy as np

from hgogen.discretisation.stability import Lengths, Limit
from hgogen.errors import BadArgument
from hgogen.estimators.core import Core, core
from hgogen.estimators.riccati_part import Riccati
from hgogen.estimators.transient import first_unstable, lengths
from hgogen.graph import Graph
from hgogen.observer import Observer
from hgogen.part import Clock, Ode, Pieces
from hgogen.program import INF, Block, Field, Kernel, Place, Program, When, sym

MOST = 3  # outputs: each may be missing, and every pattern of samples has matrices of its own
MEANINGS = {  # of the matrices, of which the elements are stored that are not 0 by their structure
    "Phi": "the core's transition over a step",
    "Gamma_0": "weight of the last sample",
    "Gamma_1": "weight of this sample",
    "Psi_0": "weight of the nonlinear rest",
    "Psi_1": "weight of the change of the nonlinear rest",
}
Pattern = tuple[bool, ...]  # which outputs have a sample


class NoRealisation(BadArgument):
    """An observer that has no linear core with constant coefficients."""

    text = "{what} realises a linear error core with constant coefficients; {reason}"


@dataclass(frozen=True, eq=False)
class Matrices:
    """Phi (N, N), Gamma_0, Gamma_1 (N, p), Psi_0, Psi_1 (N, N) as SX of the places that `program` writes."""

    program: Program
    Phi: Graph
    Gamma_0: Graph
    Gamma_1: Graph
    Psi_0: Graph
    Psi_1: Graph


@dataclass(frozen=True)
class Sampled:
    """A method by its `matrices`, of a core and a step length (s), and `numbers`: (Phi, Psi_0, Psi_1) (N, N) of h M;
    `equations`: lines for reports."""

    name: str
    matrices: Callable[[Core, float], Matrices]
    numbers: Callable[[np.ndarray, float], tuple[np.ndarray, np.ndarray, np.ndarray]]
    equations: tuple[str, ...]
    exact = True  # the core is realised, not integrated
    prediction = None

    def ode(self, part: Ode, clock: Clock) -> Pieces:
        """One step of every field of the part at once.

        Raises: `NoRealisation`.
        """
        if part.frozen:
            raise NoRealisation(self.name, f"here {min(part.frozen)} adapts, and the core with it: take rk4")
        if part.linear is None:
            raise NoRealisation(self.name, "this observer has none: take rk4")
        if clock.outputs > MOST:
            raise NoRealisation(self.name, f"for at most {MOST} outputs, each of which may be missing: take rk4")
        updates = {seen: _update(self, part, clock, seen) for seen in product((False, True), repeat=clock.outputs)}
        names = [f"seen_{j + 1}" for j in range(clock.outputs)] if clock.outputs > 1 else ["seen"]
        flags = [Place("work", name) for name in names]
        named = Block("is there a sample?", {flag: clock.valid[j] > 0 for j, flag in enumerate(flags)})
        return Pieces(
            fields=part.fields,
            derived=(*part.derived, *chain.from_iterable(update.derived for update in updates.values())),
            tune=(*part.tune, *chain.from_iterable(update.tune for update in updates.values())),
            predict=(named, *_chosen(flags, (), updates)),
            uses_output=True,
        )

    def ode_lengths(self, part: Ode, observer: Observer, dt: float) -> Lengths:
        """The step lengths of the nonlinear rest: the core sets no limit."""
        return lengths(part, observer, dt, self, Limit(INF, ""))

    def transition(self, core: np.ndarray, M: np.ndarray, h: float) -> np.ndarray:
        """a = (Phi + Psi_0 J) e, e+ = a + Psi_1 J (a - e), J = M - core the rest's slope (k, N, N)."""
        J, (Phi, Psi_0, Psi_1) = M - core, self.numbers(core, h)
        first = Phi + Psi_0 @ J
        return np.asarray(first + Psi_1 @ J @ (first - np.eye(len(core))))

    def refused(self, core: np.ndarray, M: np.ndarray) -> np.ndarray:
        """The refused step lengths (k), by trying lengths in turn."""
        return first_unstable(core, M, self)

    def riccati(self, part: Riccati, clock: Clock) -> Pieces:
        """Refused. Raises: `NoRealisation`."""
        raise NoRealisation(self.name, "that of a Riccati observer moves with its covariance: take continuous_discrete")

    def riccati_lengths(self, part: Riccati, dt: float) -> Lengths:
        """There are none: `riccati` refuses the observer."""
        return Lengths()


def _chosen(flags: list[Place], known: Pattern, updates: Mapping[Pattern, Pieces]) -> Program:
    """The update for the samples that are there."""
    if not flags:
        return updates[known].predict
    there, missing = (_chosen(flags[1:], (*known, value), updates) for value in (True, False))
    return (When(flags[0], there, missing),)


def _update(method: Sampled, part: Ode, clock: Clock, seen: Pattern) -> Pieces:
    """The step for one pattern of samples: its matrices as derived values, how `tune` has them, what `predict` does."""
    line = core(part, clock.outputs, tuple(map(float, seen)))
    assert line is not None
    (label, suffix), valid = _named(seen), ca.SX(ca.DM(list(map(float, seen))))

    def rest(x: Graph, c: float) -> Graph:
        """The nonlinear rest r (N) of the fields' column (N) at an end of the step, 0 or 1."""
        rates = part.rest(_split(part, x), clock.u(c), clock.y(c), valid)
        return ca.densify(ca.vertcat(*(rates[field.name] for field in part.fields)))

    start = rest(line.x, 0.0)
    bent = [i for i in range(start.numel()) if not start[i].is_zero()]  # the rows that have a rest
    whole = method.matrices(line, clock.dt)
    matrices = {"Phi": whole.Phi, "Gamma_0": whole.Gamma_0, "Gamma_1": whole.Gamma_1}
    matrices |= {"Psi_0": whole.Psi_0[:, bent], "Psi_1": whole.Psi_1[:, bent]}
    matrices = {name: ca.sparsify(matrix) for name, matrix in matrices.items()}
    held = {name: _held(Place("derived", f"{name}{label}"), matrix) for name, matrix in matrices.items()}
    guess = held["Phi"] @ line.x + held["Psi_0"] @ start[bent, :]
    guess += held["Gamma_0"] @ _source(part, clock, 0.0) + held["Gamma_1"] @ _source(part, clock, 1.0)
    after = guess + held["Psi_1"] @ (rest(guess, 1.0) - start)[bent, :]
    nonempty = {name: matrix for name, matrix in matrices.items() if matrix.nnz()}
    stored = {Place("derived", f"{name}{label}"): ca.vertcat(*matrix.nonzeros()) for name, matrix in nonempty.items()}
    step = Block(
        f"{', '.join(field.name for field in part.fields)}: one step by {method.name}{suffix}",
        {Place("state", name): piece for name, piece in _split(part, after).items()},
        {f"guess_{name}": piece for name, piece in _split(part, guess).items()},
    )
    return Pieces(
        derived=tuple(
            Field(f"{name}{label}", (0.0,) * matrix.nnz(), meaning=f"{MEANINGS[name]}{suffix}, by columns")
            for name, matrix in nonempty.items()
        ),
        tune=(*whole.program, Block(f"the core over a step{suffix}", stored)),
        predict=(step,),
    )


def _source(part: Ode, clock: Clock, c: float) -> Graph:
    """The measurement without its offset, v (p), at an end of the step."""
    return clock.y(c) if part.offset is None else clock.y(c) - part.offset(clock.u(c))


def _split(part: Ode, x: Graph) -> dict[str, Graph]:
    """The parts of a column (N) by the names of the fields."""
    ends = np.cumsum([0, *(field.size for field in part.fields)]).tolist()
    return dict(zip((field.name for field in part.fields), ca.vertsplit(x, ends), strict=True))


def _held(place: Place, matrix: Graph) -> Graph:
    """A sparse matrix whose elements lie in a place, by columns."""
    return ca.SX(matrix.sparsity(), sym(*place, matrix.nnz())) if matrix.nnz() else ca.SX(*matrix.shape)


def _named(seen: Pattern) -> tuple[str, str]:
    """What ends the names of values for these samples, and what ends a sentence on them."""
    if all(seen):
        return "", ""
    there = ", ".join(str(j) for j, valid in enumerate(seen, 1) if valid)
    if not there:
        return "_blind", ", without a sample"
    return "_" + "".join("01"[valid] for valid in seen), f", with sample {there} only"


# --- what methods compute their matrices with --------------------------------------------------------------


def balanced(X: Graph) -> tuple[Program, int]:
    """S^-1 X S of an SX matrix (N, N) in `work.core`, S in `work.scale`; and its size: an array of one element would be
    no array in C, so that X of one element gets a row and a column of zeros."""
    size = max(2, X.shape[0])
    wide = ca.SX(size, size)
    wide[: X.shape[0], : X.shape[0]] = X
    dense = ca.densify(wide.T)
    block = Block("the linear core, by rows", {Place("work", "core"): ca.reshape(dense, -1, 1)})
    arguments = ((Place("work", "core"), size**2), (Place("work", "scale"), size))
    return (block, Kernel("balance", size, None, arguments)), size


def spread(place: Place, X: Graph, size: int) -> Graph:
    """S F S^-1 (N, N) of a function F of S^-1 X S, which lies by rows in a place. By the structure of X some elements
    of F are 0, and these are left out."""
    n, scale, F = X.shape[0], sym("work", "scale", size), sym(*place, size**2)
    links = np.array(ca.DM(X.sparsity(), 1)) + np.eye(n)
    reached = np.linalg.matrix_power(links, n) > 0
    unscaled = ca.SX(n, n)
    for i, j in zip(*np.nonzero(reached), strict=True):
        unscaled[int(i), int(j)] = F[int(i) * size + int(j)] * (1 if i == j else scale[int(i)] / scale[int(j)])
    return unscaled
