"""The Riccati observer on P = S S' as straight-line statements, S lower triangular with a positive diagonal.

    time         S S' = [Phi S, sqrt(h) W] [Phi S, sqrt(h) W]',  W W' = Q_theta, by Gram-Schmidt on the rows of the
                 stack, each made orthogonal to those before it: the triangle of a QR factorisation without its Q
    measurement  of row c and variance r, f = S' c', from the last column to the first, b = 0 and alpha = r at first:
                 beta = sqrt(alpha/(alpha + f_j^2)), S_ij <- beta (S_ij - f_j b_i/alpha), b_i <- b_i + f_j S_ij (with S
                 before), alpha <- alpha + f_j^2; the gain is b/alpha

Numbers of the size of a standard deviation: half the decades of P, in exchange for n square roots a step, n a sample
and, where the past is forgotten, n (n + 1)/2 a step for the prior's samples. Source: Carlson, "Fast triangular
formulation of the square root filter", AIAA Journal 11 (1973); Potter's update (Battin 1964) keeps no triangle;
Kaminski, Bryson, Schmidt, IEEE TAC 16 (1971).
"""

import casadi as ca
import numpy as np

from hgogen.estimators.covariance import factor, lower, pack, packed_triangle, prior_status, unpack_lower
from hgogen.estimators.factored import Moved, capped, common, entries, largest, smallest
from hgogen.estimators.riccati_part import Riccati
from hgogen.graph import Graph
from hgogen.part import Clock, Pieces
from hgogen.program import Block, Field, Place, Program, sym
from hgogen.reading.given import BadGain

RULE = "continuous-discrete, S S'"
LARGEST = 7  # states: beyond, straight-line code fills the flash


def square_root(part: Riccati, clock: Clock) -> Pieces:
    """Predict, then one scalar update for each output.

    Raises: `BadGain` for more than 7 states.
    """
    n = part.dynamics.n
    if n > LARGEST:
        raise BadGain("cholesky", f"takes up to {LARGEST} states, there are {n}; take continuous_discrete, which loops")
    moved, S, update = Moved(part, clock), symbols(part), []
    for j in range(clock.outputs):
        after, gain = carlson(S, S.T @ moved.row(j).T, moved.variance(j))
        update.append((moved.corrected(gain, sym("work", "e"), written(after)),))
    bounded = within_cap(part, clock) if part.forgetting is None else _renewed(part, clock)
    return Pieces(
        fields=(part.z, _root(part, clock)),
        covariance=S @ S.T,
        **common(part, clock),
        predict=(_predict(part, clock), *bounded),
        update=tuple(update),
    )


def triangle(stack: Graph) -> Graph:
    """The lower triangular SX matrix S (n, n), positive diagonal, with S S' = stack stack' (n, k), and values worth a
    name."""
    n = stack.shape[0]
    rows, S, names = [stack[i, :].T for i in range(n)], ca.SX(n, n), dict[str, Graph]()
    for j in range(n):
        S[j, j] = ca.sqrt(ca.dot(rows[j], rows[j]))
        inverse = 1 / S[j, j]
        unit = rows[j] * inverse
        names |= {f"s{j + 1}{j + 1}": S[j, j]} | ({f"s{j + 1}{j + 1}_inverse": inverse} if j < n - 1 else {})
        names |= {f"q{j + 1}_{k + 1}": unit[k] for k in range(unit.shape[0])}
        for i in range(j + 1, n):
            S[i, j] = ca.dot(rows[i], unit)
            names[f"s{i + 1}{j + 1}"] = S[i, j]
            rows[i] = rows[i] - S[i, j] * unit
    return S, names


def carlson(S: Graph, f: Graph, r: Graph) -> tuple[Graph, Graph]:
    """S after one scalar measurement of variance r whose row c (1, n) has f = S'c' (n), and the gain (n)."""
    n, after = S.shape[0], ca.SX(S)
    alpha, b = r, ca.SX(n, 1)
    for j in reversed(range(n)):
        if f[j].is_zero():
            continue
        grown = alpha + f[j] * f[j]
        beta, share = ca.sqrt(alpha / grown), f[j] / alpha
        for i in range(j, n):
            after[i, j] = beta * (S[i, j] - share * b[i])
            b[i] = b[i] + f[j] * S[i, j]
        alpha = grown
    return after, b / alpha


def _root(part: Riccati, clock: Clock) -> Field:
    n, deviation = part.dynamics.n, np.sqrt(largest(part))
    start = np.linalg.cholesky(part.covariance)
    floor = np.sqrt(smallest(part, clock, factor(part.covariance)[1]))
    ends = [(floor[i] if i == j else -deviation[i], deviation[i]) for i, j in lower(n)]
    low, high = (tuple(map(float, each)) for each in zip(*ends, strict=True))
    meaning = "S of the covariance P = S S', lower triangle"
    return packed_triangle("root", start, meaning, low=low, high=high)


def symbols(part: Riccati) -> Graph:
    """S (n, n) as it stands in the state."""
    n = part.dynamics.n
    return unpack_lower(sym("state", "root", n * (n + 1) // 2), n)


def written(S: Graph) -> dict[Place, Graph]:
    """What makes S (n, n) that of the state."""
    return {Place("state", "root"): pack(S)}


def _predict(part: Riccati, clock: Clock) -> Block:
    moved = Moved(part, clock)
    stages = moved.stages()
    transition, S = moved.transition(stages), symbols(part)
    if part.forgetting is not None:
        S = ca.sqrt(sym("derived", "growth")) * S
    shaped = part.scaled_factor() @ ca.diag(ca.sqrt(moved.weights()))
    S, names = triangle(ca.horzcat(transition @ S, shaped))
    return Block(
        f"z by classical Runge-Kutta; P = S S' by {moved.equation}",
        {Place("state", part.z.name): stages.result["z"], **written(S)},
        {**stages.names, **entries("Phi", transition), **names},
    )


def _renewed(part: Riccati, clock: Clock) -> Program:
    blocks = []
    for i, row in enumerate(Moved(part, clock).priors(), 1):
        S = symbols(part)
        S, _ = carlson(S, S.T @ row.T, ca.SX(1))
        blocks.append(Block(f"what is forgotten of z{i} tends to S_0", written(S)))
    return (*blocks, prior_status(part, _variances(part)))


def _variances(part: Riccati) -> list[Graph]:
    S = symbols(part)
    return [ca.dot(S[i, :], S[i, :]) for i in range(part.dynamics.n)]


def within_cap(part: Riccati, clock: Clock) -> Program:
    """P held below its cap."""
    S = symbols(part)

    def scaled(scale: Graph) -> dict[Place, Graph]:
        return written(ca.diag(scale) @ S)

    return capped(clock, part, _variances(part), scaled)
