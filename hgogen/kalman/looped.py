"""The Riccati observer on P = L D L' with loops over the columns of L, for states too many to unroll.

As `factored`, but that Phi L is made triangular by rotations of the columns that Phi's diagonals above the main one
fill, and that the noise is added by rank-one updates: n^2 for each such diagonal, and n^3/3.
"""

import casadi as ca
import numpy as np

from hgogen.graph import Graph
from hgogen.kalman.factored import Moved, common, diagonal
from hgogen.kalman.riccati_part import Riccati
from hgogen.kalman.weights import is_diagonal
from hgogen.part import Clock, Pieces
from hgogen.program import Block, Field, Group, Kernel, Loop, Place, Program, When, column, sym
from hgogen.reading.given import BadGain
from hgogen.signal import LOST

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
