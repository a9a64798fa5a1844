"""The unscented filter on P = S S' as straight-line statements: sigma points in place of Jacobians.

    points       z and z +- g s_i, s_i the columns of S, g = alpha sqrt(n + kappa)
    of a map m   a_i = (m(z + g s_i) - m(z - g s_i))/2g,  b_i = (m(z + g s_i) + m(z - g s_i) - 2 m(z))/2g,
                 d = sum b_i/g:  the mean m(z) + d,  the covariance sum a_i a_i' + sum b_i b_i' + (beta - alpha^2) d d'
    time         m is one classical Runge-Kutta step of f; S S' = that covariance + h Q, by Gram-Schmidt
    measurement  m = h_j:  f = (a_1, .., a_n),  r = R_j/h + sum b_i^2 + (beta - alpha^2) d^2,  then Carlson's update of
                 S with f and r, and z <- z + K (y_j - h_j(z) - d)

These are the scaled unscented transform's sums, put together by pairs of points. Its weight of the middle point is
negative for a small alpha; here nothing is taken away as long as alpha^2 <= beta, so that S needs no downdate and is
positive definite by construction. For a beta below alpha^2, c = (alpha^2 - beta)/g^2, the b_i have a part of their sum
B less, sum b_i b_i' - c B B' = sum (b_i - s B)(b_i - s B)', s = (1 - sqrt(1 - n c))/n, as long as n c <= 1: that is
beta >= -alpha^2 kappa/n. An output that is linear in the state has f = S'c' without a difference, which in
floats would lose what a point near the estimate has in common with it. Source: Julier, "The scaled unscented
transformation", ACC 2002; van der Merwe, Wan, "The square-root unscented Kalman filter for state and
parameter-estimation", ICASSP 2001; the sums by pairs as in Norgaard, Poulsen, Ravn, Automatica 36 (2000).
"""

from dataclasses import dataclass, replace
from math import sqrt

import casadi as ca

from hgogen.estimators.factored import Moved
from hgogen.estimators.riccati_part import Riccati
from hgogen.estimators.square_root import RULE, carlson, square_root, symbols, triangle, within_cap, written
from hgogen.graph import Graph
from hgogen.part import Clock, Pieces
from hgogen.program import Block, Place, Program, sym


@dataclass(frozen=True, eq=False)
class Unscented:
    """A Kalman filter by sigma points: `reach` g > 0, how many deviations a point lies off the estimate, and `more`
    beta - alpha^2 >= -g^2/n, the weight of d d'."""

    plain: Riccati
    reach: float
    more: float


@dataclass(frozen=True)
class Transformed:
    """The sums of a map's values at the sigma points: `middle` m(z) (k), `slopes` the a_i and `bends` the b_i (k, n),
    less what a negative weight of d d' takes away, `drift` d (k)."""

    middle: Graph
    slopes: Graph
    bends: Graph
    drift: Graph


def unscented(part: Unscented, clock: Clock) -> Pieces:
    """The pieces of a step, with the fields and the cap of `square_root`.

    Raises: `BadGain` for more states than it takes.
    """
    return replace(
        square_root(part.plain, clock),
        predict=(*_predict(part, clock), *within_cap(part.plain, clock)),
        update=tuple(_update(part, clock, j) for j in range(clock.outputs)),
        rule=RULE,
    )


def _points(part: Unscented, z: Graph) -> tuple[list[Graph], list[Graph]]:
    """z + g s_i and z - g s_i."""
    S = symbols(part.plain)
    steps = [part.reach * S[:, i] for i in range(S.shape[1])]
    return [z + step for step in steps], [z - step for step in steps]


def _transformed(part: Unscented, middle: Graph, above: list[Graph], below: list[Graph]) -> Transformed:
    """The sums of a map, from its values at z and at the points on both sides of it."""
    pairs = list(zip(above, below, strict=True))
    half = 1 / (2 * part.reach)
    slopes = ca.horzcat(*(half * (up - down) for up, down in pairs))
    bends = ca.horzcat(*(half * (up - middle + (down - middle)) for up, down in pairs))
    drift = ca.sum2(bends) * (1 / part.reach)
    if part.more < 0:
        n = len(pairs)
        share = (1 - sqrt(max(0.0, 1 + n * part.more / part.reach**2))) / n
        bends = ca.horzcat(*(bends[:, i] - share * part.reach * drift for i in range(n)))
    return Transformed(middle, slopes, bends, drift)


def _predict(part: Unscented, clock: Clock) -> Program:
    """Each point moves by itself, then z and S are those of all."""
    moved, n = Moved(part.plain, clock), part.plain.dynamics.n
    above, below = _points(part, moved.z)
    sides = {"above": "z + g s_", "below": "z - g s_"}
    points = {"middle": ("z", moved.z)}
    for (side, title), drawn in zip(sides.items(), (above, below), strict=True):
        points |= {f"{side}_{i + 1}": (f"{title}{i + 1}", z) for i, z in enumerate(drawn)}
    read = {name: sym("work", name, n) for name in points}
    sums = _transformed(part, read["middle"], *([read[f"{side}_{i + 1}"] for i in range(n)] for side in sides))
    noise = part.plain.scaled_factor() @ ca.diag(ca.sqrt(moved.weights()))
    S, names = triangle(ca.horzcat(sums.slopes, sums.bends, sqrt(max(0.0, part.more)) * sums.drift, noise))
    after = {Place("state", part.plain.z.name): sums.middle + sums.drift, **written(S)}
    blocks = []
    for name, (title, point) in points.items():
        stages = moved.stages_from(point)
        result = {Place("work", name): stages.result["z"]}
        blocks.append(Block(f"{title} by classical Runge-Kutta", result, stages.names))
    return (*blocks, Block("the mean of the points, and P = S S' of their covariance + h Q", after, names))


def _update(part: Unscented, clock: Clock, output: int) -> Program:
    moved, S = Moved(part.plain, clock), symbols(part.plain)
    row, r = moved.row(output), moved.variance(output)

    def h(z: Graph) -> Graph:
        return part.plain.dynamics.output(z, clock.u_now)[output]

    if linear(part.plain, clock, output):
        f, drift, title = S.T @ row.T, ca.SX(0), "correct by the scalar update"
    else:
        above, below = _points(part, moved.z)
        sums = _transformed(part, h(moved.z), [h(z) for z in above], [h(z) for z in below])
        f, drift, title = sums.slopes.T, sums.drift, "correct by what the sigma points read"
        r = r + ca.sumsqr(sums.bends) + max(0.0, part.more) * drift**2
    S, gain = carlson(S, f, r)
    return (moved.corrected(gain, sym("work", "e") - drift, written(S), title),)


def linear(plain: Riccati, clock: Clock, output: int) -> bool:
    """Whether an output is linear in the state, so that its row is free of it."""
    return not ca.depends_on(Moved(plain, clock).row(output), sym("state", plain.z.name, plain.dynamics.n))
