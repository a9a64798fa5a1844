"""Parameters of a plant from measured logs, with their identifiability.

A sensor may lag, y' = (h(x, u) - y)/tau, with tau an unknown of the fit. A lag below half a sample is indistinguishable
from none; of one above a quarter of a log too little is observed. The sensor of an angle, which turns, has as its state
the lag d = h - y itself, which does not: d' = h' - d/tau, with h' the derivative of h(x) along the flow.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, Literal

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.analysis.observability import observability
from hgogen.logs.problem import (
    Information,
    Predicting,
    Problem,
    Progress,
    Searches,
    Shooting,
    Solution,
    Solver,
    digests,
    steps_and_growth,
)
from hgogen.logs.records import BadLog, Log, middle_of, quantum_of, validated_log
from hgogen.reading.given import count, requires_any_plant, requires_switches, signals_named
from hgogen.registry import Displayed
from hgogen.rigor.rank import NothingMeasured, NowhereDefined
from hgogen.rigor.tape import NoTape
from hgogen.run.campaign import Workers
from hgogen.run.consistency import WRONG, Whiteness, corner, deviation, integrated_autocorrelation_time, whiteness
from hgogen.sentence import Encoded
from hgogen.signal import Signal, in_turn, resting
from hgogen.system import System, valued

Array = np.ndarray
Place = Literal["", "low", "high"]
FINE = 1e-4  # of an output's spread: smaller residuals are integration errors
SAME = 1e-2  # difference of costs, as in `excess_cost`, of starts that ended at one minimum
_COLOURED = {
    "simulation": "the model lacks something, or the noise is slow, as that of a coarse encoder; where noise "
    "moves the plant, --by prediction (by=) fits it along",
    "prediction": "each depends on those before it, so that the model, or the time of an input or sensor, is wrong",
}
_UNSETTLED = {
    "simulation": "narrower ranges, or, of a plant that is unstable or that noise moves, --by prediction",
    "prediction": "or narrower ranges",
}
NONE = 1e-6  # component of a direction: less is rounding


@dataclass(frozen=True)
class Structure:
    """The structural identifiability of parameters, lags and offsets: whether any log of these outputs could determine
    them."""

    rank: Annotated[int, "how many sums of them the outputs tell at most"]
    count: Annotated[int, "number of parameters, lags and offsets"]
    hidden: Annotated[tuple[str, ...], "those that are proved not to be told by themselves"]
    doubtful: Annotated[tuple[str, ...], "those of which that is not known"]
    unseen: Annotated[tuple[str, ...], "what hides them, in words"]
    repairs: Annotated[tuple[str, ...], "states and parameters, of which measuring one as well would show all"]


@dataclass(frozen=True)
class Estimate:
    """The estimate of a parameter, of a lag, or of the offset of an output.

    `nominal`: the value before the fit; `deviation`: the standard error, infinite if the logs do not determine the
    value, or it lies at an end of its range; `at`: "low" or "high" at an end of its range, "" within.
    """

    name: str
    value: float
    nominal: float
    deviation: float
    unit: str
    at: Place


@dataclass(frozen=True)
class SearchEnd:
    """The result of one search by IPOPT: its final cost, status and number of iterations."""

    cost: Annotated[float, "cost without the pull"]
    status: Annotated[str, "how IPOPT ended"]
    iterations: Annotated[int, "number of iterations"]


def _by_name(each: Iterable[Estimate], what: str) -> dict[str, Any]:
    return {one.name: getattr(one, what) for one in each}


@dataclass(frozen=True, eq=False)
class Fit(Encoded, Displayed):
    """The result of `fit`.

    `plant`: with the fitted values; `parameters`, `offsets` and `lags` of outputs: their estimates; `fitted`: the
    outputs (N, p) of each log, NaN for missing samples; `starts`: the result from each start, for a robust fit that of
    the last pass; `noise`: of a fit by prediction, the density of process noise by state (of a discrete plant its
    variance in a sample) and the deviation of a sample by output. They are Q, and R over the period, of a `riccati` in
    the plant's own coordinates. A state whose rate is by definition another state has a negligible density.
    """

    json_keys = (
        "by parameters=values deviation nominal at_end lags=lag_values offsets=offset_values first error spread "
        "unfitted alike untold joint confined outlying whiteness rivals noise=levels starts=ends above_start"
    )

    by: Annotated[str, "the error that is least, of which the residuals are: simulation or prediction"]
    plant: System
    parameters: tuple[Estimate, ...]
    lags: tuple[Estimate, ...]
    offsets: tuple[Estimate, ...]
    first: Annotated[tuple[dict[str, float], ...], "the state of each record at its first sample"]
    fitted: tuple[Array, ...]
    error: Annotated[dict[str, float], "RMS of each output's residual, in its unit"]
    spread: Annotated[dict[str, float], "RMS of each output about its mean"]
    unfitted: Annotated[dict[str, float], "RMS residual of the plant as it was given, its states fitted alone"]
    alike: Annotated[dict[str, float], "by output, how many residuals tell as much as one that is independent"]
    untold: Annotated[tuple[dict[str, float], ...], "directions that the records do not tell, in units of ranges"]
    joint: Annotated[Structure | None, "what no record tells; null where the records tell all"]
    confined: Annotated[tuple[str, ...], "the states that lie at an end of their range"]
    starts: tuple[Solution, ...]
    outlying: Annotated[dict[str, float], "by output, the share of residuals beyond 5 robust deviations"]
    whiteness: Annotated[dict[str, Whiteness | None], "test of each output's residuals, of innovations over deviations"]
    rivals: Annotated[tuple[dict[str, float], ...], "estimates of starts that ended elsewhere at the same cost"]
    noise: tuple[dict[str, float], dict[str, float]]
    above_start: Annotated[
        float, "by how much the cost exceeds that of the plant as given: a share, or a log likelihood"
    ]

    @property
    def values(self) -> dict[str, float]:
        """Fitted values of parameters by name."""
        return _by_name(self.parameters, "value")

    @property
    def deviation(self) -> dict[str, float]:
        """Standard errors of parameters, infinite (null) where the records do not tell."""
        return _by_name(self.parameters, "deviation")

    @property
    def nominal(self) -> dict[str, float]:
        """Values of parameters before the fit."""
        return _by_name(self.parameters, "nominal")

    @property
    def at_end(self) -> dict[str, Place]:
        """The parameters at an end of their range, each with "low" or "high"."""
        return _by_name([one for one in self.parameters if one.at], "at")

    @property
    def lag_values(self) -> dict[str, float]:
        """Time constants of the lags of outputs."""
        return _by_name(self.lags, "value")

    @property
    def offset_values(self) -> dict[str, float]:
        """Offsets of outputs."""
        return _by_name(self.offsets, "value")

    @property
    def levels(self) -> dict[str, dict[str, float]]:
        """The fitted noise of a fit by prediction error: process, the density by state, and sample, the standard
        deviation by output."""
        return dict(zip(("process", "sample"), self.noise, strict=True))

    @property
    def ends(self) -> tuple[SearchEnd, ...]:
        """The result of the search from each start."""
        return tuple(SearchEnd(one.cost, one.status, one.iterations) for one in self.starts)

    @property
    def settled(self) -> bool:
        """Whether a search that reached the least cost, up to rounding, converged."""
        best = min(one.cost for one in self.starts)
        return any(one.settled and excess_cost(self.by, one.cost, best) <= SAME for one in self.starts)

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for each parameter at an end of its range, and one if the fit ended with a higher cost than it
        began with."""
        ranged = {p.name: p.bounded for p in self.plant.parameters}
        lines = []
        for one in self.parameters:
            if one.at and ranged[one.name]:
                lines.append(f"{one.name} lies at the {one.at} end of its range; widen it, or leave {one.name} out")
            elif one.at:
                hint = "its sign, the sign of a column, or a unit may be wrong"
                lines.append(
                    f"{one.name} has no range and ended at the limit of the search from {one.nominal:g}; {hint}"
                )
        if self.above_start:
            cost = _HIGHER[self.by](self.above_start)
            lines.append(
                f"the fit ended with a higher cost than that of the declared values ({cost}): keep those, narrow the "
                "ranges, or add --starts"
            )
        return tuple(lines)

    def notes(self) -> tuple[str, ...]:
        """Sentences on the reliability of the result."""
        turning = [y.name for y in self.plant.outputs if y.period]
        lines = list(self.warnings)
        for one in self.lags:
            if one.at == "low":
                lines.append(f"the logs show no lag of {one.name} of half a sample or more")
            elif math.isfinite(one.deviation):
                behind, tau = f"{one.name}_behind", f"{one.value:.3g}"
                state = f"a state {behind}' = (output - {behind})/{tau} as output"
                if one.name in turning:
                    state = f"a state {behind}' = (rate of the output) - {behind}/{tau}, which the output is less by"
                lines.append(f"the sensor of {one.name} lags, which the model lacks: declare {state}")
        lines += [
            f"{name} reaches an end of its range in the fit; if the plant may leave this range, widen it"
            for name in self.confined
        ]
        lines += [self._undetermined(parts) for parts in self.untold]
        lines += [line for name in self.alike for line in self._followed(name)]
        for name, part in self.outlying.items():
            if part and self.error[name] > FINE * self.spread[name]:
                lines.append(f"{part:.2g} of the residuals of {name} lie beyond 5 times their typical size")
        return (*lines, *self._searched())

    def _undetermined(self, parts: Mapping[str, float]) -> str:
        total = " ".join(f"{part:+.2g} {name}" for name, part in parts.items())
        statement = f"determine {total} (in units of ranges)"
        fix = f"its fitted value is arbitrary: {'fix one of them' if len(parts) > 1 else 'fix it'}"
        joint, hidden = self.joint, set(self.joint.hidden if self.joint else ())
        doubtful = hidden.union(self.joint.doubtful if self.joint else ())
        inside = [set(each) <= hidden for each in self.untold]
        if joint is not None and set(parts) <= hidden and sum(inside) <= joint.count - joint.rank:
            measured = " or ".join(name for name in joint.repairs if name not in parts)
            more = f", or measure {measured} as well" if measured else ""
            return f"no log of these outputs would {statement}; {fix}{more}"
        if set(parts) & doubtful:
            unknown = f"the logs do not {statement}, and whether other logs would is not known"
            return f"{unknown}; {fix}, or move the plant more"
        others = ", though others would," if joint is not None else ""
        more = "" if len(parts) > 1 and not others else ", or move the plant more"
        return f"the logs do not{others} {statement}; {fix}{more}"

    def _followed(self, name: str) -> Iterator[str]:
        if not self.spread[name]:
            yield f"{name} is constant in the logs, which then determine little; give a log in which the plant moves"
        if self.error[name] >= self.spread[name] > 0:
            yield f"{name} is fitted no better than by its mean; are its unit, sign and offset right?"
        test, tau = self.whiteness[name], self.alike[name]
        if test is None or test.white or self.error[name] <= FINE * self.spread[name]:
            return
        what = "residuals" if self.by == "simulation" else "innovations"
        count = f", {tau:.3g} of them count as one independent sample in the standard errors" if tau > 1.05 else ""
        limits = f"Ljung-Box {test.statistic:.3g}, limit {test.limit:.3g}"
        yield f"{what} of {name} are not white ({limits}){count}: {_COLOURED[self.by]}"

    def _searched(self) -> Iterator[str]:
        best = min(one.cost for one in self.starts)
        excess = [excess_cost(self.by, one.cost, best) for one in self.starts]
        higher = [more for more in excess if more > SAME]
        here = len(excess) - len(higher) - len(self.rivals)
        if len(self.starts) > 1:
            ended = f"{here} of {len(excess)} starts ended at this minimum"
            yield f"{ended}, {len(higher)} {_HIGHER[self.by](min(higher))} or more" if higher else ended
        if self.rivals:
            values = ", ".join(f"{name} = {value:.5g}" for name, value in self.rivals[0].items())
            yield f"{values} fit equally well, within 1 %: narrow a range so that one of the two fits is left"
        if not self.settled:
            yield f"the search did not settle; take more starts, {_UNSETTLED[self.by]}"


def excess_cost(by: str, cost: float, best: float) -> float:
    """Return by how much a `cost` exceeds the `best` cost: the relative difference for a sum of squares ("simulation"),
    the difference for a log likelihood ("prediction"); `by`: which of the two."""
    if by == "prediction":
        return cost - best
    return cost / best - 1 if best else 0.0


_HIGHER: Mapping[str, Callable[[float], str]] = {
    "simulation": lambda more: f"at {1 + more:.3g} times its cost",
    "prediction": lambda more: f"less likely by a factor exp({more:.3g})",
}


def structure(plant: System, free: Sequence[Signal], offset: Sequence[Signal]) -> Structure | None:
    """Return what no log of these outputs can determine about the parameters `free` and the outputs' offsets; None if
    derivatives of the outputs are undefined.

        rank d(y, y', ..)/d(x, p) - rank d(y, y', ..)/dx

    is the number of combinations of the parameters and offsets p that the outputs determine at most, on almost every
    trajectory (`analysis/observability`). If the Fisher information has a smaller rank, a log with more excitation may
    determine the others. That no log determines a parameter is proved only by a symmetry of the plant that changes it.
    The rank alone is computed at random points. On one branch of a plant with kinks it does not cover logs that change
    the branch, which determine thresholds.
    """
    added = {y: Signal(f"offset_of_{y.name}", y.unit, nominal=0) for y in offset}
    shifted = tuple(h + added.get(y, 0) for y, h in zip(plant.outputs, plant.output, strict=True))
    extended = replace(plant, parameters=(*plant.parameters, *added.values()), output=shifted)
    try:
        whole = observability(extended, unknown=(*(p.name for p in free), *(o.name for o in added.values())))
    except (NothingMeasured, NowhereDefined, NoTape):
        return None
    names = {p.name: p.name for p in free} | {o.name: f"offset of {y.name}" for y, o in added.items()}
    joint = whole.joint
    if joint is None:
        return None
    proved = () if whole.scope else joint.lost
    return Structure(
        joint.rank.rank - whole.rank,
        len(names),
        tuple(names[s.name] for s in joint.rank.unobservable if s.name in names and s in proved),
        tuple(names[s.name] for s in joint.rank.unobservable if s.name in names and s not in proved),
        tuple(map(str, joint.symmetries)),
        tuple(s.name for s in joint.repairs if s not in added.values()),
    )


def aligned_directions(V: Array, hidden: Array) -> Array:
    """Return an orthonormal basis of the span of the directions V (q, k), in which as many vectors as possible involve
    only the parameters in the mask `hidden` (q)."""
    if hidden.all() or not hidden.any():
        return V
    turned = V @ np.linalg.svd(V[~hidden])[2].T
    return np.where(np.abs(turned) > NONE, turned, 0.0)


BETWEEN, BY = ("hold", "line"), ("simulation", "prediction")
EQUAL = 1e-6  # difference of costs, as in `excess_cost`: less is rounding, and the first start is preferred
AGAIN = 4  # passes of a robust fit, each with the corner of the last one's residuals
LEAST, FIRST, MOST = 0.5, 2.0, 0.25  # of a lag: bound and start in samples; bound in logs
SEGMENTS = 60  # of a log, about
WIDE = 100.0  # bounds of a parameter without a range: this factor above and below its nominal value
GROWN = 3.0  # largest log growth of errors in a segment
PART = 0.05  # component of a direction: a parameter with less is not involved
UNTOLD = 1.0  # standard error in units, above which the logs do not determine a direction
ROUNDED = 1e-10  # relative eigenvalue of the information: less is rounding
AT = 1e-6  # distance from the end of a range that counts as at it, in units


class CannotFit(BadLog):
    """The error for logs from which the parameters cannot be fitted, or parameters that cannot be fitted at all."""


@dataclass(frozen=True, eq=False)
class Task:
    """The problem of a fit. `given`: the plant; `plant`: the plant with additional states for the lags of its sensors;
    `chosen`: the fitted parameters without the `lags`; `by`: one of `BY`; `corner`: the corner c of each output's
    pseudo-Huber loss, None for least squares; `begin`: values of parameters at which searches begin, instead of the
    nominal ones; `noise` (p): the standard deviation of each output's residuals by which they are divided, by default
    the `sizes` of the outputs."""

    given: System
    plant: System
    chosen: tuple[Signal, ...]
    lags: tuple[Signal, ...]
    records: tuple[Log, ...]
    offset: tuple[Signal, ...]
    between: str
    by: str
    corner: Array | None = None
    begin: Mapping[str, float] = field(default_factory=dict)
    noise: Array | None = None

    @property
    def free(self) -> tuple[Signal, ...]:
        """The fitted parameters of the plant, followed by the time constants of its sensors' lags."""
        return (*self.chosen, *self.lags)

    @cached_property
    def spread(self) -> Array:
        """The standard deviation of each output's samples (p); for an angle by differences within half a turn."""
        columns = zip(self.plant.outputs, np.concatenate([record.y for record in self.records]).T, strict=True)
        return np.sqrt([np.nanmean(y.difference(column, y.mean(column)) ** 2) for y, column in columns])

    @property
    def sizes(self) -> Array:
        """The `spread` of each output (p), 1 for a constant output."""
        return np.where(self.spread > 0, self.spread, 1.0)

    def corners(self, unknowns: Array) -> Array:
        """Return the corner c of the pseudo-Huber loss of each output (p), from its residuals at the `unknowns` (v)."""
        return np.array([corner(e) for e in self.problem.residuals(unknowns)])

    def weighted(self, unknowns: Array, size: Callable[[Array], float]) -> "Task":
        """Return the same fit with the residuals of each output divided by their `size` at the `unknowns` (v), such as
        the RMS, at least the integration errors and the output's resolution: the most likely fit of outputs with
        unknown noise. The task itself if it has one output, or if it fits the noise."""
        rms = self.problem.scale * np.array([size(e) for e in self.problem.residuals(unknowns)])
        columns = np.concatenate([record.y for record in self.records]).T
        least = np.maximum(FINE * self.sizes, np.array([quantum_of(y) for y in columns]) / math.sqrt(12))
        alike = self.by == "prediction" or len(rms) == 1 or (rms <= least).all()
        return self if alike else replace(self, noise=np.maximum(rms, least))

    @cached_property
    def problem(self) -> Problem:
        """The problem of the fit, by Runge-Kutta steps that are short enough for the plant's fastest mode. Raises:
        `CannotFit`."""
        period = max(float(record.ahead.max()) for record in self.records)
        steps, growing = steps_and_growth(self.plant, period)
        samples = max(len(record.y) for record in self.records)
        scale = self.sizes if self.noise is None else self.noise
        if self.by == "simulation":
            return self.shooting(scale, samples, steps, growing * period)
        parts = (self.plant, self.free, self.records, scale, samples, steps, self.between, self.offset)
        unit = np.array([_unit(x) for x in self.plant.states])
        return Predicting(*parts, unit=unit, robust=self.corner is not None)

    def shooting(self, scale: Array, samples: int, steps: int, growing: float) -> Problem:
        """Return the multiple-shooting problem with segments so short that errors grow by at most exp(GROWN) in each;
        `growing`: the log of their growth in a sample; `scale` (p): divisors of residuals; `samples`: those of the
        longest segment; `steps`: Runge-Kutta steps a sample."""
        length = math.ceil(samples / SEGMENTS)
        length = max(1, min(length, int(GROWN / growing))) if growing else length
        parts = (self.plant, self.free, self.records, scale, length, steps, self.between, self.offset)
        return Shooting(*parts, corner=self.corner)

    @cached_property
    def solver(self) -> Solver:
        """The solver of the problem, with bounds and scales of the unknowns from the declared ranges."""
        segments = sum(self.problem.segments)
        ends = [*map(_bounds, self.free), *[(-math.inf, math.inf)] * len(self.offset)]
        ends += [x.limits for x in self.plant.states] * segments
        unit = [*map(_unit, self.free), *(self.sizes[self.plant.outputs.index(y)] for y in self.offset)]
        unit += [_unit(x) for x in self.plant.states] * segments
        ends += [(low, high) for _, low, high in self.problem.levels]
        unit += [1.0] * len(self.problem.levels)
        low, high = np.array(ends, dtype=float).T
        return Solver(self.problem, low, high, np.array(unit))

    @property
    def nominal(self) -> Array:
        """The unknowns (v) of the fit with the parameters at their nominal values, or at the values in `begin`."""
        values = [float(self.begin.get(p.name, self.plant.nominal[p])) for p in self.free]
        levels = [start for start, _, _ in self.problem.levels]
        return np.array([*values, *[0.0] * len(self.offset), *self._nodes, *levels])

    def drawn(self, draw: np.random.Generator) -> Array:
        """Return the unknowns (v) with random parameters: uniform in a declared range, else log-uniform between half
        and twice the nominal value."""
        start = self.nominal
        for i, p in enumerate(self.free):
            start[i] = draw.uniform(*p.interval) if p.bounded else start[i] * 2 ** draw.uniform(-1, 1)
        return start

    @property
    def _nodes(self) -> list[float]:
        nodes: list[float] = []
        for record, segments in zip(self.records, self.problem.segments, strict=True):
            at, every_row = np.arange(segments) * self.problem.length, np.arange(len(record.y))
            courses: dict[sp.Expr, Array] = {}
            outputs = zip(self.plant.outputs, record.y.T, self.given.output, self.plant.output, strict=True)
            for y, column, *expressions in outputs:
                there = np.flatnonzero(np.isfinite(column))
                for x, slope, level in measured_states(self.plant.states, expressions):
                    course = y.unwrapped(column) if x.period else y.nearest(column, slope * middle_of(x) + level)
                    courses[x] = np.interp(every_row, there, (course[there] - level) / slope)
            courses = with_rates(self.plant, courses, self.problem.length, np.cumsum(record.elapsed))
            rows = [courses[x][at] if x in courses else np.full(segments, resting(x)) for x in self.plant.states]
            nodes += np.array(rows).T.ravel().tolist()
        return nodes

    def result(self, best: Solution, ended: Sequence[Solution]) -> Fit:
        """Return the `Fit` at the solution `best`, with standard errors and identifiability; `ended`: the solutions of
        all starts."""
        known = self.problem.information(best.unknowns, self.solver.unit)
        count, inner = len(self.free), len(self.chosen)
        follow = [integrated_autocorrelation_time(e) for e in known.tell]
        deviations, untold, joint = self._deviations(known, max(follow), best.unknowns)
        estimates = tuple(self._estimate(i, best.unknowns[i], deviations[i]) for i in range(count + len(self.offset)))
        *_, nodes = self.problem.parts(ca.DM(best.unknowns))
        begins = (zip(self.given.states, at[:, 0].full().ravel().tolist(), strict=False) for at in nodes)
        first = ({x.name: float(x.turned(value)) for x, value in states} for states in begins)
        before = self.given_task.problem.information(self.given_solution.unknowns, self.given_task.solver.unit)
        return Fit(
            self.by,
            valued(self.given, {e.name: e.value for e in estimates[:inner]}),
            estimates[:inner],
            tuple(replace(e, name=y) for e, y in zip(estimates[inner:count], self._lagging, strict=True)),
            estimates[count:],
            tuple(first),
            tuple(in_turn(self.plant.outputs, log.y - e) for log, e in zip(self.records, known.residuals, strict=True)),
            self._by_output(map(_rms, known.outputs)),
            self._by_output(self.spread.tolist()),
            self._by_output(map(_rms, before.outputs)),
            self._by_output(follow),
            untold,
            joint,
            self._confined(best.unknowns),
            tuple(ended),
            self._by_output(float(np.mean(np.abs(e) > WRONG * deviation(e))) for e in known.outputs),
            self._by_output(map(whiteness, known.tell)),
            tuple(self._rivals(best, ended, deviations)),
            self.problem.noise(best.unknowns),
            self.above_given(best.cost) if self.corner is None else 0.0,
        )

    @cached_property
    def given_task(self) -> "Task":
        """The fit of the states alone, with the plant's parameters at their nominal values."""
        return replace(self, plant=self.given, chosen=(), lags=(), offset=(), corner=None, begin={})

    @cached_property
    def given_solution(self) -> Solution:
        """The states with which the plant at its nominal parameters follows the logs best."""
        return self.given_task.solver.solve(self.given_task.nominal)

    def above_given(self, cost: float) -> float:
        """Return by how much (as `excess_cost`) a `cost` exceeds that at the nominal parameters; 0 if it does not, or
        if the residuals are integration errors alone."""
        residuals = sum(np.isfinite(record.y).sum() for record in self.records)
        fine = self.by == "simulation" and cost < FINE**2 * residuals
        excess = excess_cost(self.by, cost, self.given_solution.cost)
        return excess if excess > EQUAL and not fine else 0.0

    def from_given(self) -> Array:
        """Return the unknowns (v) with the parameters at their nominal values and the states of `given_solution`."""
        start, own = self.nominal, self.given_task.problem
        *_, nodes = self.problem.parts(ca.DM(start))
        *_, solved = own.parts(ca.DM(self.given_solution.unknowns))
        if self.problem.segments != own.segments:  # a lag asks for shorter ones
            return start
        columns = [ca.vertcat(of_given, mine[own.n :, :]) for of_given, mine in zip(solved, nodes, strict=True)]
        first, last = self.problem.constants, self.problem.size - len(self.problem.levels)
        start[first:last] = np.concatenate([column.full().T.ravel() for column in columns])
        return start

    def _deviations(
        self, known: Information, together: float, unknowns: Array
    ) -> tuple[Array, tuple[dict[str, float], ...], Structure | None]:
        """Return the standard errors of parameters and offsets, in their units; the directions that the logs do not
        determine, in units of the ranges; and the structural identifiability if there are such directions. A parameter
        at an end of its range is fixed there. `together`: how many residuals have the information of one independent
        residual."""
        every_name = [*map(str, self.free), *(f"offset of {y}" for y in self.offset)]
        inner = np.array([not self._end(i, value) for i, value in enumerate(unknowns[: len(every_name)])])
        names = [name for name, within in zip(every_name, inner, strict=True) if within]
        before = self.solver.unit[: len(inner)][inner]
        ranged = np.array([*(p.bounded for p in self.free), *[True] * len(self.offset)])[inner]
        unit = np.where(ranged, before, np.maximum(before, np.abs(unknowns[: len(inner)][inner])))
        every = np.concatenate(known.tell)
        fitted = len(names) + self.problem.n * len(self.records)  # each costs a degree of freedom
        freedom = len(every) - fitted
        noise = max(float(every @ every) / freedom * together, np.finfo(float).tiny) if freedom > 0 else math.inf
        weights, V = np.linalg.eigh(known.M[np.ix_(inner, inner)] * np.outer(unit / before, unit / before) / noise)
        weights = np.where(weights > ROUNDED * weights.max(initial=0.0), weights, np.finfo(float).tiny)
        errors = 1 / np.sqrt(weights)
        sure = errors <= UNTOLD
        spread = np.sqrt(V[:, sure] ** 2 @ errors[sure] ** 2) * unit
        deviations = np.full(len(inner), math.inf)
        deviations[inner] = np.where((np.abs(V[:, ~sure]) > PART).any(axis=1), math.inf, spread)
        if sure.all():
            return deviations, (), None
        free = [p for p, within in zip(self.free, inner, strict=False) if within]
        offset = [y for y, within in zip(self.offset, inner[len(self.free) :], strict=True) if within]
        joint = structure(self.plant, free, offset)
        hidden = np.array([joint is not None and name in (*joint.hidden, *joint.doubtful) for name in names])
        return deviations, tuple(_parts(names, v) for v in aligned_directions(V[:, ~sure], hidden).T), joint

    def _rivals(self, best: Solution, ended: Sequence[Solution], deviations: Array) -> Iterator[dict[str, float]]:
        """Yield the parameters, lags and offsets of other minima: from starts with the
        best cost whose values differ from the best by more than a standard error."""
        names = [
            *map(str, self.chosen),
            *(f"lag of {y}" for y in self._lagging),
            *(f"offset of {y}" for y in self.offset),
        ]
        away = np.maximum(deviations, FINE * self.solver.unit[: len(names)])
        for one in ended:
            values = one.unknowns[: len(names)]
            same = one.settled and excess_cost(self.by, one.cost, best.cost) <= SAME
            if same and (np.abs(values - best.unknowns[: len(names)]) > away).any():
                yield dict(zip(names, values.tolist(), strict=True))

    @property
    def _lagging(self) -> list[str]:
        pairs = zip(self.plant.outputs, self.given.output, self.plant.output, strict=True)
        return [y.name for y, h, behind in pairs if h != behind]

    def _confined(self, unknowns: Array) -> tuple[str, ...]:
        room = np.minimum(unknowns - self.solver.low, self.solver.high - unknowns) / self.solver.unit
        count = sum(self.problem.segments) * self.problem.n
        nodes = room[self.problem.constants :][:count].reshape(-1, self.problem.n)
        return tuple(x.name for x, least in zip(self.plant.states, nodes.min(axis=0), strict=True) if least <= AT)

    def _estimate(self, i: int, value: float, deviation: float) -> Estimate:
        at = self._end(i, value)
        if i >= len(self.free):
            y = self.offset[i - len(self.free)]
            return Estimate(y.name, float(y.difference(value, 0.0)), 0.0, float(deviation), y.unit, at)
        p = self.free[i]
        within = float(np.clip(value, *_bounds(p)))
        return Estimate(p.name, within, float(p.nominal or 0.0), float(deviation), p.unit, at)

    def _end(self, i: int, value: float) -> Place:
        low, high, width = self.solver.low[i], self.solver.high[i], AT * self.solver.unit[i]
        return "low" if value <= low + width else "high" if value >= high - width else ""

    def _by_output(self, values: Iterable[Any]) -> dict[str, Any]:
        return dict(zip(map(str, self.plant.outputs), values, strict=True))


@requires_any_plant
@requires_switches
def fit(
    plant: System,
    *records: Log,
    free: Iterable[str | Signal] | None = None,
    offset: Iterable[str | Signal] = (),
    lag: Iterable[str | Signal] = (),
    between: Literal["hold", "line"] = "hold",
    by: Literal["simulation", "prediction"] = "simulation",
    starts: int = 3,
    seed: int = 0,
    robust: bool = False,
    jobs: int | None = 1,
    each: Callable[[Progress], None] = lambda progress: None,
    resume: Progress | None = None,
    begin: Mapping[str, float] | None = None,
) -> Fit:
    """Return the parameters with which the plant follows the logs best.

    `records`: inputs u (N, m), outputs y (N, p), NaN for missing samples, and their period; `free`: the fitted
    parameters, by default those with a declared range, which bounds them; a parameter without a range stays between a
    hundredth of its value and a hundred times its value. `offset`: the outputs with an unknown constant added; `lag`:
    those whose sensor has an unknown first-order lag; `between`: the course of inputs between samples; `by`: the error
    to minimise, that of a "simulation", by multiple shooting, or the "prediction" error of a Kalman filter whose noise
    is fitted too, for an unstable plant or one with process noise; `starts`: the number of searches, the first from the
    nominal values, the others from random values within the ranges, by `seed`; `robust`: whether outliers, as of a
    failed sensor, cost their distance instead of its square; `jobs`: processes for the starts, None for one for each
    core, which do not change the result; `each(progress)` is called after every iteration, with several processes after
    every start; `resume`: the progress of the same fit, stopped earlier, which is continued; `begin`: values of
    parameters at which the first search begins, such as those of an earlier fit, by default the nominal ones.

    Raises: `Misfit` if `plant` is no plant; `CannotFit`; `CannotGoOn`; `BadGain` for invalid counts and names;
    `BadShape`, `BadNames` for logs of another shape.
    """
    if not records or not all(isinstance(record, Log) for record in records):
        raise CannotFit("records", "are missing; give logs, such as hg.Log(u, y, dt)")
    for name, value, ways in (("between", between, BETWEEN), ("by", by, BY)):
        if value not in ways:
            raise CannotFit(f"{name}={value!r}", f"is none of {', '.join(ways)}")
    if plant.discrete and lag:
        raise CannotFit(f"plant {plant.name!r}", "is discrete in time, and a lag is fitted to differential equations")
    starts, seed = count("starts", starts, 1, 1000), count("seed", seed, 0, 2**53)
    chosen, logs = (
        _free(plant, free),
        tuple(validated_log(plant, record, k).of(plant.inputs) for k, record in enumerate(records, 1)),
    )
    period, duration = max(record.dt for record in logs), min(record.duration for record in logs)
    slow, lags = lagged(plant, _named("lag", lag, plant.outputs), period, duration)
    _named("begin", begin or (), plant.parameters)
    outputs = _named("offset", offset, plant.outputs)
    task = Task(plant, slow, chosen, tuple(lags), logs, outputs, between, by, begin=begin or {})
    options = {
        **(begin or {}),
        "free": task.free,
        "offset": task.offset,
        "between": between,
        "by": by,
        "starts": starts,
        "seed": seed,
    }
    searches = Searches(digests(plant, logs, {**options, "robust": robust}), each, resume)
    return _best(task, searches, starts, np.random.default_rng(seed), AGAIN if robust else 0, jobs)


def lagged(plant: System, outputs: Sequence[Signal], period: float, duration: float) -> tuple[System, list[Signal]]:
    """Return the plant with one more state for the first-order lag of each of these outputs' sensors, and the time
    constants tau of the lags as parameters, in the order of the outputs.

    `period`, `duration`: the length of a sample and of the shortest log, in the plant's time. Raises: `CannotFit` for a
    periodic output that depends on an input, whose derivative no log holds.
    """
    low, high = LEAST * period, max(MOST * duration, 2 * FIRST * period)
    flow, output, states, lags = list(plant.flow), list(plant.output), list(plant.states), list[Signal]()
    for y in outputs:
        behind = Signal(f"{y.name}_behind", y.unit, f"{y.name} as its sensor shows it")
        tau = Signal(f"lag_of_{y.name}", plant.time, f"lag of the sensor of {y.name}", FIRST * period, low, high)
        row = plant.outputs.index(y)
        h = output[row]
        if y.period is None:
            flow.append((h - behind) / tau)
            output[row] = behind
        else:
            if h.free_symbols & set(plant.inputs):
                raise CannotFit(
                    f"output {y.name!r}", "is periodic and reads an input; its lag is not fitted, leave it out"
                )
            flow.append(sum(h.diff(x) * f for x, f in zip(plant.states, plant.flow, strict=True)) - behind / tau)
            output[row] = h - behind
        states.append(behind)
        lags.append(tau)
    parameters = (*plant.parameters, *lags)
    slow = replace(plant, states=tuple(states), parameters=parameters, flow=tuple(flow), output=tuple(output))
    return slow, lags


def _best(task: Task, searches: Searches, starts: int, draw: np.random.Generator, passes: int, jobs: int | None) -> Fit:
    """Return the fit from the best of `starts` starts. The searches of several outputs continue with weights from the
    residuals of each output; a robust fit then continues with `passes` passes, since the residuals of least squares
    include those of outliers."""
    begins = [task.nominal, *(task.drawn(draw) for _ in range(starts - 1))]
    ended = _from_starts(task, searches, begins, jobs) if jobs != 1 else ()
    for begin in begins[len(ended) :]:
        ended = searches.solved(task.solver, begin, ended)
    best = best_of(task.by, ended)
    if best is None:
        raise CannotFit(f"plant {task.given.name!r}", "has no finite residuals from any start; narrow the ranges")
    if task.above_given(best.cost):
        ended = searches.solved(task.solver, task.from_given(), ended)
        best = best_of(task.by, ended) or best
    every = ended  # and the searches that continue them
    if (weighted := task.weighted(best.unknowns, deviation if passes else _rms)) is not task:
        every, ended = _continued(weighted, searches, best, ended)
        task, best = weighted, best_of(task.by, ended) or best
    for _ in range(passes):
        task = replace(task, corner=task.corners(best.unknowns))
        every = searches.solved(task.solver, best.unknowns, every)
        best = every[-1]
    return task.result(best, (best,) if passes else ended)


def _continued(
    task: Task, searches: Searches, best: Solution, ended: tuple[Solution, ...]
) -> tuple[tuple[Solution, ...], tuple[Solution, ...]]:
    """Return the searches that `ended` with other weights, followed by those of the task that continue the searches of
    about the `best` cost; and the solution of each start: continued, or else with its cost relative to the best one."""
    again = [one for one in ended if excess_cost(task.by, one.cost, best.cost) <= SAME]
    every = ended
    for one in again:
        every = searches.solved(task.solver, one.unknowns, every)
    new = dict(zip(again, every[len(ended) :], strict=True))
    return every, tuple(new.get(one) or replace(one, cost=one.cost / best.cost * new[best].cost) for one in ended)


def _from_starts(task: Task, searches: Searches, begins: Sequence[Array], jobs: int | None) -> tuple[Solution, ...]:
    """Return the solutions of the searches from `begins` by `jobs` processes, after those that are known already; an
    interrupted search is repeated."""
    ended = searches.resumed.ended[: len(begins)] if searches.resumed else ()
    solutions, known = dict(enumerate(ended)), len(ended)
    for number, solution in Workers(replace(task), jobs).results(_searched, list(enumerate(begins))[known:]):
        solutions[number] = solution
        while len(ended) in solutions:
            ended = (*ended, solutions[len(ended)])
        searches.each(Progress(searches.task, ended, 0, begins[min(len(ended), len(begins) - 1)]))
    return ended


def _searched(task: Task, numbered: tuple[int, Array]) -> tuple[int, Solution]:
    number, begin = numbered
    return number, task.solver.solve(begin)


def measured_states(states: Sequence[Signal], rows: Iterable[sp.Expr]) -> Iterator[tuple[Signal, float, float]]:
    """Yield the states that single outputs measure, y = slope x + level, each with slope and level; `rows`: the output
    equations."""
    for row in rows:
        for x in row.free_symbols & set(states) if len(row.free_symbols) == 1 else ():
            slope = row.diff(x)
            if slope.is_number and slope:
                yield x, float(slope), float(row.xreplace({x: 0}))


def with_rates(plant: System, courses: Mapping[sp.Expr, Array], length: int, t: Array) -> dict[sp.Expr, Array]:
    """Return the courses (N) of states by symbol, extended by the states that are by definition their rates (x_i' =
    +-x_j): differences over `length` rows at the times `t` (N)."""
    complete, half = dict(courses), max(1, length // 2)
    for _ in plant.states:
        for x, rate in zip(plant.states, plant.flow, strict=True):
            for sign in (1, -1):
                if x in complete and sign * rate in plant.states and sign * rate not in complete:
                    rows = np.arange(len(complete[x]))
                    first, last = np.maximum(rows - half, 0), np.minimum(rows + half, len(rows) - 1)
                    change = complete[x][last] - complete[x][first]
                    complete[sign * rate] = sign * change / np.maximum(t[last] - t[first], np.finfo(float).tiny)
    return complete


def best_of(by: str, ended: Sequence[Solution]) -> Solution | None:
    """Return the solution of least cost among the searches that converged, or among all if none did; the first of equal
    ones. None if no cost is finite. `by`: "simulation" or "prediction"."""
    finite = [one for one in ended if np.isfinite(one.cost)]
    settled = [one for one in finite if one.settled] or finite
    least = min((one.cost for one in settled), default=0.0)
    return next((one for one in settled if excess_cost(by, one.cost, least) <= EQUAL), None)


def _free(plant: System, free: Iterable[str | Signal] | None) -> tuple[Signal, ...]:
    what = f"plant {plant.name!r}"
    if plant.origin is not None:
        raise CannotFit(what, "is recast; fit the plant that it was recast from")
    chosen = plant.tunable if free is None else _named("parameter", free, plant.parameters)
    if not plant.parameters:
        raise CannotFit(what, "has no parameter; declare what is unknown as one, with low= and high=")
    if not chosen:
        listed = ", ".join(map(str, plant.parameters))
        reason = f"has no parameter with a range; name those that are unknown, --free a,b or free=, among {listed}"
        raise CannotFit(what, reason)
    for p in chosen:
        if not p.bounded and not p.nominal:
            raise CannotFit(f"parameter {p.name!r}", "is 0 and has no range; declare low= and high=")
        if p.bounded and p.low == p.high:
            raise CannotFit(f"parameter {p.name!r}", "has a range of one point; widen it, or leave it out")
    return chosen


def _named(what: str, names: Iterable[str | Signal], signals: Sequence[Signal]) -> tuple[Signal, ...]:
    return signals_named(what, names, signals, lambda name, fix: CannotFit(f"{what} {name!r}", f"is unknown; {fix}"))


def _parts(names: Sequence[str], direction: Array) -> dict[str, float]:
    signed = direction * np.sign(direction[np.argmax(np.abs(direction))])
    return {name: float(part) for name, part in zip(names, signed, strict=True) if abs(part) > PART}


def _rms(e: Array) -> float:
    return float(np.sqrt(np.mean(e**2)))


def _bounds(p: Signal) -> tuple[float, float]:
    if p.bounded:
        return p.interval
    ends = (float(p.nominal or 0.0) / WIDE, float(p.nominal or 0.0) * WIDE)
    return min(ends), max(ends)


def _unit(s: Signal) -> float:
    low, high = s.interval
    return high - low if s.bounded else abs(s.nominal or 0.0) or 1.0
