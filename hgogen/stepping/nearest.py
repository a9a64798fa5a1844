"""The nearest estimate that fits a sample: from where an observer restarts.

    x <- x_0,   then, for each output that is judged, the most trusted one last,
    x <- sat(x + V g (y_j - h_j(z(x), u)) / (g' V g)),   g = dh_j/dx at x,   V = diag(width of the outer box)^2

with x_0 the first values of the fields that the estimate z(x) is read from, and sat the declared ranges: the nearest
point to x_0, in units of the outer box, at which the linearised output is what was measured. Where h is not linear, or
several outputs are fitted, that is done SWEEPS times (Gauss and Newton).

Where the output is flat at x_0, as y = x^2 is at 0, the sample would tell nothing: x_0 is then another point of the
ranges, at which it does. Which of the two signs of x is right no sample of y = x^2 tells.
"""

from collections.abc import Mapping

import casadi as ca
import numpy as np

from hgogen.analysis.dynamics import clamp
from hgogen.estimators.core import nominal, numbers
from hgogen.graph import Graph
from hgogen.observer import Observer
from hgogen.part import Clock
from hgogen.program import INF, Block, Field, Place, Program, column, sym
from hgogen.signal import LOST
from hgogen.stepping.guards import readings

SWEEPS = 3
FLAT = 1e-2  # of what an output can span: a slope that moves it by less over the whole outer box tells nothing
ELSEWHERE = 32  # points of the ranges that are tried


def nearest(
    observer: Observer, clock: Clock, shown: tuple[Field, ...], samples: Mapping[int, tuple[Graph, Graph]]
) -> Program:
    """The `shown` fields of the state set to x of the module; `samples` by output, the most trusted last: what was
    measured, and whether that is plausible."""
    u = sym("state", "u", len(observer.form.system.inputs))
    x = ca.vertcat(*(sym("state", field.name, field.size) for field in shown))
    h = observer.dynamics.output(observer.z, u)
    limits, V = _ends(observer, shown, x), weights(shown)
    g = observer.dynamics.output_jacobian(observer.z, u) @ ca.jacobian(observer.z, x)
    slopes = {j: g[j, :].T for j in samples}
    spans = [high - low for low, high in readings(observer.form)]
    straight = len(samples) == 1 and all(ca.jacobian(slope, x).nnz() == 0 for slope in slopes.values())
    start = _start(observer, clock, shown, slopes, np.array([spans[j] for j in samples]), V, limits)
    blocks = [Block("the estimate restarts", placed(shown, ca.SX(ca.DM(start))))]
    for _ in range(1 if straight else SWEEPS):
        for j, (y, plausible) in samples.items():
            across = ca.dot(slopes[j], V * slopes[j])
            least = (1e-6 * spans[j]) ** 2 if spans[j] < INF else 1e-30
            moved = x + V * slopes[j] * ((y - h[j]) / ca.fmax(across, least))
            fitted = column(kept(moved[i], end, x[i]) for i, end in enumerate(limits))
            value = ca.if_else(plausible, fitted, x) if len(samples) > 1 else fitted
            blocks.append(Block(f"from the sample of {observer.form.system.outputs[j]}", placed(shown, value)))
    return tuple(blocks)


def kept(value: Graph, end: tuple[float, float], other: Graph) -> Graph:
    """A value clamped to a range, another where it is lost; of a plausible sample none is, which an analyser sees."""
    return ca.if_else(ca.fabs(value) <= LOST, clamp(value, *end), other)


def placed(shown: tuple[Field, ...], value: Graph) -> dict[Place, Graph]:
    """The writes of an SX column to the fields, one after the other."""
    parts = ca.vertsplit(value, np.cumsum([0, *(field.size for field in shown)]).tolist())
    return {Place("state", field.name): part for field, part in zip(shown, parts, strict=True)}


def weights(shown: tuple[Field, ...]) -> Graph:
    """The squared widths of the outer box, V of the module, as a column."""
    widths = np.array([high - low for field in shown for low, high in field.box])
    widths[~np.isfinite(widths)] = max(widths[np.isfinite(widths)], default=1.0)
    weights = ca.DM(widths)
    return weights * weights  # infinite without a word where NumPy warns


def _ends(observer: Observer, shown: tuple[Field, ...], x: Graph) -> list[tuple[float, float]]:
    """The declared range of each x_i that is a state z_k, else its outer box."""
    limits = [end for field in shown for end in field.box]
    for k, end in enumerate(observer.dynamics.box):
        same = [i for i in range(len(limits)) if ca.is_equal(ca.SX(observer.z[k]), x[i])]
        for i in same:
            low, high = max(end[0], limits[i][0]), min(end[1], limits[i][1])
            limits[i] = (low, high) if low < high else limits[i]
    return limits


def _start(
    observer: Observer,
    clock: Clock,
    shown: tuple[Field, ...],
    slopes: Mapping[int, Graph],
    spans: np.ndarray,
    V: Graph,
    limits: list[tuple[float, float]],
) -> np.ndarray:
    """x_0: the first values, or the point of the ranges at which the most outputs, of these spans, tell something."""
    least = (FLAT * np.where(np.isfinite(spans), spans, 0.0)) ** 2
    places = [Place("state", field.name) for field in shown]
    sizes = np.cumsum([field.size for field in shown])[:-1]
    rest = {Place("state", "u"): np.zeros(len(observer.form.system.inputs)), **nominal(observer)}

    def seen(point: np.ndarray) -> int:
        values = {**rest, **dict(zip(places, np.split(point, sizes), strict=True))}
        across = [numbers(ca.dot(slope, V * slope), values).item() for slope in slopes.values()]
        return int((np.nan_to_num(across) > least).sum())

    first = np.array([value for field in shown for value in field.initial])
    low, high = np.array(limits).T
    low, high = np.where(np.isfinite(low), low, first - 1), np.where(np.isfinite(high), high, first + 1)
    draws = np.random.default_rng(0).uniform(0.25, 0.75, (ELSEWHERE, len(first)))
    best = first
    for point in (low + share * (high - low) for share in draws):
        if seen(best) == len(slopes):
            break
        best = point if seen(point) > seen(best) else best
    return best
