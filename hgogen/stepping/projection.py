"""Projection of an estimate onto the declared ranges, in the metric of the filter where it has a covariance.

    for each declared range l <= g(z) <= h in turn:   z <- z - P a (g(z) - min(max(g(z), l), h))/(a' P a),   a = dg/dz

g is a coordinate z_k, or a state of the plant x_i = Psi_i(z) where z is another coordinate. Let S = P^-1, e = z - x
with a truth x inside the ranges, V = e' S e, and g(z) = a'z > h.

- The formula is the projection onto the half-space {a'z <= h} in the norm of S: z+ = z - lambda P a minimises
  (z+ - z)' S (z+ - z) under a'z+ = h, with lambda = (a'z - h)/(a' P a) >= 0.
- V does not grow: V+ = V - 2 lambda a'e + lambda^2 a' P a, and a'e >= a'z - h = lambda a' P a, since a'x <= h. So
  V+ <= V - lambda^2 a' P a. Several ends in turn each leave V no larger, though the last estimate may be outside again
  by a little where P is correlated.
- Where z+ is outside its outer box, the estimate goes from z towards z+ as far as the box allows: V is convex, so it is
  no larger than at z anywhere on this way. A clamp of z+ to the box may make it larger: with a correlated P of three
  states V went from 45 to 22 by the projection, and to 243 by the clamp.
- So a bound on V = e' P^-1 e holds with this guard at work, for a plant inside its ranges. It says nothing of two
  estimates, of which one alone is projected, and nothing where Psi is nonlinear: there a is the gradient at sat(z), and
  the step is one of Gauss and Newton.

Without a covariance P is the diagonal of the squared widths of the outer box, for a constant injection too: its
Lyapunov matrix is known only after a search, and moves with the gains. For g(z) = z_k the formula then clamps z_k. No
component's error grows by that, since |min(max(z_k, l), h) - x_k| <= |z_k - x_k| for l <= x_k <= h, but V of another
matrix may: of S = [1 -.99; -.99 1] and e = (1, 1) it is .02, and 1 with e_1 = 0. The same P stands for a covariance
that is kept in columns (more than 7 states).

A value that is lost, of a P that overflows, stays as it was. Source: Simon, "Optimal State Estimation" (2006), 7.5.
"""

from collections.abc import Iterator, Sequence

import casadi as ca

from hgogen.analysis.dynamics import clamp
from hgogen.graph import Graph
from hgogen.observer import Observer
from hgogen.part import Pieces
from hgogen.program import INF, Block, Field, Place, Program, column, sym
from hgogen.stepping.members import read_fields
from hgogen.stepping.nearest import kept, placed, weights


def estimate_fields(observer: Observer, fields: tuple[Field, ...]) -> tuple[Field, ...]:
    """The real fields of the state that the estimate is read from."""
    read = read_fields([observer.z])
    return tuple(field for field in fields if field.name in read and field.kind == "real")


def projection(observer: Observer, pieces: Pieces) -> Program:
    """The program that projects the estimate of an observer with these pieces onto its ranges; see the module."""
    if pieces.project:
        return pieces.project
    fields = estimate_fields(observer, pieces.fields)
    x = ca.vertcat(*(sym("state", field.name, field.size) for field in fields))
    value = _clamped(observer, x) if pieces.covariance is None else None
    if value is None:
        value = _projected(observer, pieces, fields, x)
    raised = {Place("status", "PROJECTED_ONTO_RANGES"): ca.SX(1)}
    return (Block("the estimate back onto its declared ranges", {**placed(fields, value), **raised}),)


def _clamped(observer: Observer, x: Graph) -> Graph | None:
    """The fields x, each clamped to its range; None where a range is not that of a field alone."""
    value = ca.SX(x)
    for g, _, end in _ranges(observer, x):
        same = [i for i in range(x.numel()) if ca.is_equal(ca.SX(g), x[i])]
        if not same:
            return None
        value[same[0]] = clamp(value[same[0]], *end)
    return value


def _projected(observer: Observer, pieces: Pieces, fields: tuple[Field, ...], x: Graph) -> Graph:
    """The fields x projected onto one range after the other."""
    known = pieces.covariance is not None and pieces.covariance.shape[0] == x.numel()
    P: Graph = pieces.covariance if known else ca.diag(ca.SX(weights(fields)))
    moved = x
    for g, slope, end in _ranges(observer, x):
        now, a = ca.substitute([g, slope], [x], [moved])
        across = P @ a
        moved = moved - across * ((now - clamp(now, *end)) / ca.dot(a, across))
    return _within(x, moved, [end for field in fields for end in field.box])


def _within(x: Graph, moved: Graph, outer: Sequence[tuple[float, float]]) -> Graph:
    """The last point on the way from x to `moved` that is in the outer box; the clamp is of its rounding."""
    way, share = moved - x, ca.SX(1)
    for i, (low, high) in enumerate(outer):
        room = ca.if_else(way[i] > 0, high - x[i], x[i] - low)
        share = ca.if_else(share * ca.fabs(way[i]) > room, room / ca.fabs(way[i]), share)
    reached = x + share * way
    return column(kept(reached[i], end, x[i]) for i, end in enumerate(outer))


def _ranges(observer: Observer, x: Graph) -> Iterator[tuple[Graph, Graph, tuple[float, float]]]:
    """g as an SX of the fields x (k), its gradient (k) and its ends, of each declared range: first those of states of
    the plant that are no coordinates, then those of the coordinates."""
    z, dynamics, u = observer.z, observer.dynamics, sym("state", "u", len(observer.form.system.inputs))
    map_ = ca.jacobian(z, x)
    for value, slope, end in dynamics.behind_ranges(z, u):
        yield value, ca.densify((slope @ map_).T), end
    for k, end in enumerate(dynamics.box):
        if end[0] > -INF or end[1] < INF:
            yield z[k], ca.densify(map_[k, :].T), end
