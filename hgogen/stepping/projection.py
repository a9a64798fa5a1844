"""The nearest estimate that fits a sample, for the restart of an observer, and the nearest one in the declared ranges.

    x <- x_0,   then, for each output that is judged, the most trusted one last,
    x <- sat(x + V g (y_j - h_j(z(x), u)) / (g' V g)),   g = dh_j/dx at x,   V = diag(width of the outer box)^2

with the initial values x_0 of the fields on which the estimate z(x) depends, and the clamp sat to the declared ranges.
x is the nearest point to x_0, in units of the outer box, at which the linearised output equals the measured one. Where
h is nonlinear, or several outputs are fitted, this is repeated SWEEPS times (Gauss-Newton).

Where dh/dx is 0 at x_0, as for y = x^2 at 0, the sample has no information about x: x_0 is then another point of the
ranges, with a nonzero dh/dx. A sample of y = x^2 cannot determine the sign of x.

The projection onto the declared ranges is in the metric of the filter where it has a covariance:

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
- So a bound on V = e' P^-1 e holds with this guard, for a plant inside its ranges. It does not hold for the difference
  of two estimates of which one is projected, nor for a nonlinear Psi: there a is the gradient at sat(z), and the step
  is a Gauss-Newton step.

Without a covariance P is the diagonal of the squared widths of the outer box. This includes a constant injection, whose
Lyapunov matrix is known only after a search and changes with the gains. For g(z) = z_k the formula then clamps z_k.
This increases the error of no component, since |min(max(z_k, l), h) - x_k| <= |z_k - x_k| for l <= x_k <= h, but it may
increase V with another matrix: for S = [1 -.99; -.99 1] and e = (1, 1) it is .02, and 1 with e_1 = 0. The same P is
used instead of a covariance in columns (more than 7 states).

Where P overflows and a value is lost, the previous value is used. Source: Simon, "Optimal State Estimation" (2006),
7.5.
"""

from collections.abc import Iterator, Mapping, Sequence

import casadi as ca
import numpy as np

from hgogen.analysis.dynamics import clamp, into_range
from hgogen.estimators.core import nominal, numbers
from hgogen.graph import Graph
from hgogen.observer import Observer
from hgogen.part import Clock, Pieces
from hgogen.program import INF, Block, Field, Place, Program, column, stacked, sym
from hgogen.signal import LOST
from hgogen.stepping.guards import readings
from hgogen.stepping.members import read_fields

SWEEPS = 3
FLAT = 1e-2  # of the span of an output: a sample with a smaller change over the outer box has no information
ELSEWHERE = 32  # tried points of the ranges


def nearest(
    observer: Observer, clock: Clock, fields: tuple[Field, ...], samples: Mapping[int, tuple[Graph, Graph]]
) -> Program:
    """Return the blocks that set the `fields` x to the point nearest to their initial values x_0 at which the
    linearised outputs equal the samples: x <- sat(x + V g (y_j - h_j)/(g' V g)), g = dh_j/dx, with the `weights` V.
    `samples`: by output, the measurement and whether it is plausible, the most trusted output last."""
    u = sym("state", "u", len(observer.form.system.inputs))
    x = stacked(fields)
    h = observer.dynamics.output(observer.z, u)
    limits, V = _range_ends(observer, fields, x), weights(fields)
    turns = [period for field in fields for period in field.turns]
    g = observer.dynamics.output_jacobian(observer.z, u) @ ca.jacobian(observer.z, x)
    slopes = {j: g[j, :].T for j in samples}
    spans = [high - low for low, high in readings(observer.form)]
    straight = len(samples) == 1 and all(ca.jacobian(slope, x).nnz() == 0 for slope in slopes.values())
    start = _start_point(observer, clock, fields, slopes, np.array([spans[j] for j in samples]), V, limits)
    blocks = [Block("the estimate restarts", placed(fields, ca.SX(ca.DM(start))))]
    for _ in range(1 if straight else SWEEPS):
        for j, (y, plausible) in samples.items():
            across = ca.dot(slopes[j], V * slopes[j])
            least = (1e-6 * spans[j]) ** 2 if spans[j] < INF else 1e-30
            error = observer.dynamics.output_error(j, y, h[j])
            projected = x + V * slopes[j] * (error / ca.fmax(across, least))
            ranges = enumerate(zip(limits, turns, strict=True))
            fitted = column(in_range_or(projected[i], *each, x[i]) for i, each in ranges)
            value = ca.if_else(plausible, fitted, x) if len(samples) > 1 else fitted
            output = observer.form.system.outputs[j]
            blocks.append(Block(f"from the sample of {output}", placed(fields, value), part=f"fit_{output}"))
    return tuple(blocks)


def in_range_or(value: Graph, end: tuple[float, float], period: float | None, other: Graph) -> Graph:
    """Return a value clamped to a range, or an angle wrapped to its turn; `other` if the value is beyond `LOST`. No
    plausible sample leads there; the test lets a static analyser bound the result."""
    return ca.if_else(ca.fabs(value) <= LOST, into_range(value, end, period), other)


def placed(fields: tuple[Field, ...], value: Graph) -> dict[Place, Graph]:
    """Return the assignments of the elements of the SX column `value` to the fields, one field after the other."""
    parts = ca.vertsplit(value, np.cumsum([0, *(field.size for field in fields)]).tolist())
    return {Place("state", field.name): part for field, part in zip(fields, parts, strict=True)}


def weights(fields: tuple[Field, ...]) -> Graph:
    """Return V (k), the squared widths of the fields' outer boxes, as a column."""
    widths = np.array([high - low for field in fields for low, high in field.box])
    widths[~np.isfinite(widths)] = max(widths[np.isfinite(widths)], default=1.0)
    weights = ca.DM(widths)
    return weights * weights  # infinite without the warning of NumPy


def _range_ends(observer: Observer, fields: tuple[Field, ...], x: Graph) -> list[tuple[float, float]]:
    limits = [end for field in fields for end in field.box]
    for k, end in enumerate(observer.dynamics.box):
        equal = [i for i in range(len(limits)) if ca.is_equal(ca.SX(observer.z[k]), x[i])]
        for i in equal:
            low, high = max(end[0], limits[i][0]), min(end[1], limits[i][1])
            limits[i] = (low, high) if low < high else limits[i]
    return limits


def _start_point(
    observer: Observer,
    clock: Clock,
    fields: tuple[Field, ...],
    slopes: Mapping[int, Graph],
    spans: np.ndarray,
    V: Graph,
    limits: list[tuple[float, float]],
) -> np.ndarray:
    """Return x_0 of a restart: the initial values, or another point of the ranges if more outputs depend on x there."""
    least = (FLAT * np.where(np.isfinite(spans), spans, 0.0)) ** 2
    places = [Place("state", field.name) for field in fields]
    sizes = np.cumsum([field.size for field in fields])[:-1]
    fixed = {Place("state", "u"): np.zeros(len(observer.form.system.inputs)), **nominal(observer)}

    def informative(point: np.ndarray) -> int:
        values = {**fixed, **dict(zip(places, np.split(point, sizes), strict=True))}
        across = [numbers(ca.dot(slope, V * slope), values).item() for slope in slopes.values()]
        return int((np.nan_to_num(across) > least).sum())

    first = np.array([value for field in fields for value in field.initial])
    low, high = np.array(limits).T
    low, high = np.where(np.isfinite(low), low, first - 1), np.where(np.isfinite(high), high, first + 1)
    draws = np.random.default_rng(0).uniform(0.25, 0.75, (ELSEWHERE, len(first)))
    best = first
    for point in (low + share * (high - low) for share in draws):
        if informative(best) == len(slopes):
            break
        best = point if informative(point) > informative(best) else best
    return best


def estimate_fields(observer: Observer, fields: tuple[Field, ...]) -> tuple[Field, ...]:
    """Return the real fields of the state on which the estimate depends."""
    read = read_fields([observer.z])
    return tuple(field for field in fields if field.name in read and field.kind == "real")


def projection(observer: Observer, pieces: Pieces) -> Program:
    """Return the program that projects an observer's estimate onto its ranges, in the metric of P if there is one."""
    if pieces.project:
        return pieces.project
    fields = estimate_fields(observer, pieces.fields)
    x = stacked(fields)
    value = _clamped(observer, x) if pieces.covariance is None else None
    if value is None:
        value = _projected(observer, pieces, fields, x)
    raised = {Place("status", "PROJECTED_ONTO_RANGES"): ca.SX(1)}
    return (Block("the estimate back onto its declared ranges", {**placed(fields, value), **raised}),)


def _clamped(observer: Observer, x: Graph) -> Graph | None:
    value = ca.SX(x)
    for g, _, end in _ranges(observer, x):
        equal = [i for i in range(x.numel()) if ca.is_equal(ca.SX(g), x[i])]
        if not equal:
            return None
        value[equal[0]] = clamp(value[equal[0]], *end)
    return value


def _projected(observer: Observer, pieces: Pieces, fields: tuple[Field, ...], x: Graph) -> Graph:
    known = pieces.covariance is not None and pieces.covariance.shape[0] == x.numel()
    P: Graph = pieces.covariance if known else ca.diag(ca.SX(weights(fields)))
    projected = x
    for g, slope, end in _ranges(observer, x):
        now, a = ca.substitute([g, slope], [x], [projected])
        across = P @ a
        projected = projected - across * ((now - clamp(now, *end)) / ca.dot(a, across))
    return _within(x, projected, [end for field in fields for end in field.limits])


def _within(x: Graph, projected: Graph, outer: Sequence[tuple[float, float]]) -> Graph:
    """Return the last point on the segment from x to `projected` that is in the outer box; a clamp removes rounding
    errors."""
    step, share = projected - x, ca.SX(1)
    for i, (low, high) in enumerate(outer):
        room = ca.if_else(step[i] > 0, high - x[i], x[i] - low)
        share = ca.if_else(share * ca.fabs(step[i]) > room, room / ca.fabs(step[i]), share)
    reached = x + share * step
    return column(in_range_or(reached[i], end, None, x[i]) for i, end in enumerate(outer))


def _ranges(observer: Observer, x: Graph) -> Iterator[tuple[Graph, Graph, tuple[float, float]]]:
    """Yield g, a function of the observer's states x (k), its gradient dg/dx
    (k) and its range, for each declared range: first those of plant
    states that are no coordinates, then those of the coordinates."""
    z, dynamics, u = observer.z, observer.dynamics, sym("state", "u", len(observer.form.system.inputs))
    map_ = ca.jacobian(z, x)
    for value, slope, end in dynamics.behind_ranges(z, u):
        yield value, ca.densify((slope @ map_).T), end
    for k, end in enumerate(dynamics.box):
        if end[0] > -INF or end[1] < INF:
            yield z[k], ca.densify(map_[k, :].T), end
