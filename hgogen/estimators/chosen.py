"""The Riccati observer on P = L D L' as straight-line code or as loops, whichever suits what the step is made for.

For speed straight-line code, which carries out fewer operations and steers no loops, as long as its text does not
become too long; for flash the shorter text. Both are counted, not measured: see `discretisation.counting`. In loops
over the columns of L, for states too many to unroll, Phi L is made triangular by rotations of the columns that Phi's
diagonals above the main one fill, and the noise is added by rank-one updates: n^2 for each such diagonal, and n^3/3.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from hgogen.discretisation.counting import carried_out, written
from hgogen.estimators.factored import Moved, common, diagonal, unrolled
from hgogen.estimators.riccati_part import Riccati
from hgogen.estimators.weights import is_diagonal
from hgogen.graph import Graph
from hgogen.part import Clock, Pieces
from hgogen.program import Block, Field, Group, Kernel, Loop, Place, Program, When, column, sym
from hgogen.reading.given import BadGain
from hgogen.signal import LOST

LONGER = {"speed": 1450, "flash": 0}  # operations that straight-line code may be longer than loops; one is some 6 bytes
FULL = 7  # states up to which a full matrix Q or P(0) is taken, which loops do not admit
LARGE = 12  # states beyond which straight-line code is too long in any case, and takes long to make


@dataclass(frozen=True)
class _Way:
    """One of the two programs."""

    name: str
    pieces: Pieces

    @cached_property
    def longest(self) -> int:
        """How many operations its longest section holds."""
        return max(map(written, (self.pieces.predict, *self.pieces.update)))

    def __str__(self) -> str:
        sections = (self.pieces.predict, *self.pieces.update)
        times = sum(carried_out(section).total() for section in sections)
        return f"in {self.name} {self.longest} operations in its longest section, {times} in a period"


def chosen(part: Riccati, clock: Clock) -> Pieces:
    """The pieces of the shorter program, or of the faster one if it is not too long, with a sentence on the choice.
    Where straight-line code is short, loops are not made to be counted."""
    n = part.dynamics.n
    if n <= FULL and not admits(part):
        return replace(unrolled(part, clock), choice="the covariance in straight-line code, as for full matrices")
    if n > LARGE:
        choice = f"the covariance in loops, as for more than {LARGE} states in any case"
        return replace(looped(part, clock), choice=choice)
    straight = _Way("straight-line code", unrolled(part, clock))
    if straight.longest <= LONGER[clock.prefer]:
        return replace(straight.pieces, choice=f"the covariance {straight}, too few for loops to be shorter by enough")
    loops = _Way("loops", looped(part, clock))
    longer = straight.longest - loops.longest > LONGER[clock.prefer]
    taken, other = (loops, straight) if longer else (straight, loops)
    return replace(taken.pieces, choice=f"the covariance {taken}; {other}")


_COLUMNS, _D = Place("column", "v"), Place("state", "D")


def looped(part: Riccati, clock: Clock) -> Pieces:
    """L as the columns of a group, matrix operations as kernels; needs diagonal Q and P(0).

    Raises: `BadGain` where they are not.
    """
    n = part.dynamics.n
    for name, matrix in _matrices(part).items():
        if not is_diagonal(matrix):
            raise BadGain(name, f"must be diagonal for {n} states; full matrices are for up to 7")
    columns = Field("v", (0.0,) * n, meaning="rows below the diagonal")
    return Pieces(
        fields=(part.z, diagonal(part, clock, np.diag(part.covariance).copy())),
        groups=(Group("column", n, (columns,), "columns of the unit lower factor of P"),),
        **common(part, clock),
        predict=_predict(part, clock),
        update=tuple(_update(part, clock, j) for j in range(clock.outputs)),
    )


def admits(part: Riccati) -> bool:
    """Whether loops can take the part's Q and P(0)."""
    return all(map(is_diagonal, _matrices(part).values()))


def _matrices(part: Riccati) -> dict[str, np.ndarray]:
    return {"Q": part.nominal[0], "covariance": part.covariance}


def _predict(part: Riccati, clock: Clock) -> Program:
    moved, n = Moved(part, clock), part.dynamics.n
    stages = moved.stages()
    F = ca.sparsify(moved.jacobian(stages))
    Phi = moved.transition_of(F)
    advanced, entries, said = _applied(sym("column", "v", n), F, Phi, clock.dt)
    band = max(1, Phi.sparsity().bw_upper())
    z = {Place("state", part.z.name): stages.result["z"]}
    forgetting: Program = ()
    noise: Program = ()
    if part.forgetting is not None:
        forgetting = (Block("forgetting", {_D: moved.grown(sym("state", "D", n))}),)
    if part.factor.size:
        w = Place("work", "w")
        scaled = Block("h Q_theta", {w: moved.weights() * part.spread() ** 2})
        noise = (scaled, Kernel("add", n, _COLUMNS, ((_D, n), (w, n))))
    return (
        Block(f"z by classical Runge-Kutta; {said}, but for constants, by columns", z | entries, stages.names),
        Kernel("expand", n, _COLUMNS),
        Loop("column", n, (Block("a column of Phi L", {_COLUMNS: advanced}, spelled=clock.prefer == "speed"),)),
        *forgetting,
        Kernel("triangularise", n, _COLUMNS, ((_D, n),), counts=(band,)),
        *noise,
        *(_limit(part) if clock.guarded or part.forgetting is not None else ()),
    )


def _applied(v: Graph, F: Graph, Phi: Graph, h: float) -> tuple[Graph, dict[Place, Graph], str]:
    """Phi v by Phi, or by F twice where that has fewer products; the writes that hold the entries of that matrix, and
    what it is."""
    if Phi.nnz() <= 2 * F.nnz():
        held, entries = _held("Phi", Phi)
        return held @ v, entries, "Phi = I + hF + (hF)^2/2, F at mid-step"
    held, entries = _held("F", F)
    return v + h * (held @ (v + h / 2 * (held @ v))), entries, "the Jacobian F at mid-step"


def _held(name: str, matrix: Graph) -> tuple[Graph, dict[Place, Graph]]:
    """A sparse matrix whose entries are held in memory, but for numbers, and the writes that hold them."""
    values = matrix.nonzeros()
    moving = [k for k, value in enumerate(values) if not value.is_constant()]
    if not moving:
        return matrix, {}
    symbols, computed = sym("work", name, len(moving)), column(values[k] for k in moving)
    for k, symbol in zip(moving, ca.vertsplit(symbols), strict=True):
        values[k] = symbol
    return ca.SX(matrix.sparsity(), column(values)), {Place("work", name): computed}


def _limit(part: Riccati) -> Program:
    """What limits a variance beyond its cap, or not a number, as it is where an entry of L is none."""
    n, limited = part.dynamics.n, Place("work", "limited")
    v = sym("column", "v", n)
    restarted = column(ca.if_else(ca.fabs(v[i]) <= LOST, v[i], 0) for i in range(n))
    restart = Block("a lost value restarts", {_COLUMNS: restarted})
    said = Block("limited", {Place("status", "COVARIANCE_LIMITED"): ca.SX(1)})
    limits = Block("largest variances", {Place("work", "caps"): ca.SX(ca.DM(part.cap))})
    name, more = ("cap", ()) if part.forgetting is None else ("renew", ((Place("derived", "prior"), n),))
    arguments = ((_D, n), (Place("work", "caps"), n), *more)
    limit = Kernel(name, n, _COLUMNS, arguments, result=limited)
    return (limits, limit, When(limited, (said, Loop("column", n, (restart,)))))


def _update(part: Riccati, clock: Clock, output: int) -> Program:
    moved, n = Moved(part, clock), part.dynamics.n
    c = moved.row(output)
    row = {Place("work", "c"): ca.densify(c).T, Place("work", "r"): moved.variance(output)}
    arguments = ((_D, n), (Place("work", "c"), n), (Place("work", "r"), 1), (Place("work", "K"), n))
    read = max(c.sparsity().get_col(), default=-1) + 1  # elements of c that are not 0 lie before it
    gain = sym("work", "K", n)
    return (
        Block("the measurement's row and variance", row),
        Kernel("correct", n, _COLUMNS, arguments, counts=(read,)),
        Block("correct", {Place("state", part.z.name): moved.z + gain * sym("work", "e")}),
    )
