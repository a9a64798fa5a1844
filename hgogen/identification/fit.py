"""Parameters of a plant from measured records, with what the records tell of them.

A sensor may lag, y' = (h(x, u) - y)/tau, with tau an unknown of the fit. Less than half a sample of it cannot be told
from none, and of more than a quarter of a record too little is seen.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from hgogen.identification.records import BadLog, Log, demanded
from hgogen.identification.result import Fit, above
from hgogen.identification.solution import Progress, Searches, Solution, digests
from hgogen.identification.task import BY, Task
from hgogen.reading.door import asks_a_plant, switches
from hgogen.reading.given import count, signals_named
from hgogen.signal import Signal
from hgogen.system import System

BETWEEN = ("hold", "line")
EQUAL = 1e-6  # of a cost, as in `above`: less is rounding, and the first start, that of the nominal values, counts
AGAIN = 4  # passes of a robust fit, each with the corner of the last one's residuals
LEAST, FIRST, MOST = 0.5, 2.0, 0.25  # of tau: of a sample; of a sample; of a record


class CannotFit(BadLog):
    """Records from which the parameters cannot be fitted, or parameters that cannot be."""


@asks_a_plant
@switches
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
    each: Callable[[Progress], None] = lambda progress: None,
    resume: Progress | None = None,
) -> Fit:
    """The parameters with which the plant follows the records best.

    `records`: inputs u (N, m), outputs y (N, p), NaN where nothing was measured, and their period; `free`: the
    parameters that are fitted, by default those with a range, which bounds them; another stays within a hundredth and a
    hundred times its value. `offset`: the outputs to which an unknown constant is added; `lag`: those whose sensor
    follows by an unknown first-order lag; `between`: how inputs go on between samples; `by`: the error that is least,
    that of a "simulation", by multiple shooting, or, of a plant that noise moves or that is unstable, that of the
    "prediction" of a Kalman filter, whose noise is fitted along; `starts`: the first from the nominal values, the
    others random within the ranges, by `seed`; `robust`: a sample far off, as one of a sensor that failed, counts by
    its distance, not by its square; `each(progress)` is called after every iteration; `resume`: the progress of a fit
    of the same that was stopped, which goes on from there.

    Raises: `Misfit` for no plant; `CannotFit`; `CannotGoOn`; `BadGain` for counts and names that are none; `BadShape`,
    `BadNames` for records of another shape.
    """
    if not records or not all(isinstance(record, Log) for record in records):
        raise CannotFit("records", "are missing; give logs, such as hg.Log(u, y, dt)")
    for name, value, ways in (("between", between, BETWEEN), ("by", by, tuple(BY))):
        if value not in ways:
            raise CannotFit(f"{name}={value!r}", f"is none of {', '.join(ways)}")
    starts, seed = count("starts", starts, 1, 1000), count("seed", seed, 0, 2**53)
    chosen, logs = _free(plant, free), tuple(demanded(plant, record, k) for k, record in enumerate(records, 1))
    period, duration = max(record.dt for record in logs), min(len(record.y) * record.dt for record in logs)
    slow, lags = lagged(plant, _named("lag", lag, plant.outputs), period, duration)
    task = Task(plant, slow, chosen, tuple(lags), logs, _named("offset", offset, plant.outputs), between, by)
    options = {"free": task.free, "offset": task.offset, "between": between, "by": by, "starts": starts, "seed": seed}
    searches = Searches(digests(plant, logs, {**options, "robust": robust}), each, resume)
    return _best(task, searches, starts, np.random.default_rng(seed), AGAIN if robust else 0)


def lagged(plant: System, outputs: Sequence[Signal], period: float, duration: float) -> tuple[System, list[Signal]]:
    """The plant with a state for each of these outputs, and the lags tau as parameters, in the order of the outputs.

    `period`, `duration`: of a sample and of the shortest record, in the plant's time.
    """
    low, high = LEAST * period, max(MOST * duration, 2 * FIRST * period)
    flow, output, states, lags = list(plant.flow), list(plant.output), list(plant.states), list[Signal]()
    for y in outputs:
        behind = Signal(f"{y.name}_behind", y.unit, f"{y.name} as its sensor shows it")
        tau = Signal(f"lag_of_{y.name}", plant.time, f"lag of the sensor of {y.name}", FIRST * period, low, high)
        row = plant.outputs.index(y)
        flow.append((output[row] - behind) / tau)
        output[row] = behind
        states.append(behind)
        lags.append(tau)
    parameters = (*plant.parameters, *lags)
    slow = replace(plant, states=tuple(states), parameters=parameters, flow=tuple(flow), output=tuple(output))
    return slow, lags


def _best(task: Task, searches: Searches, starts: int, draw: np.random.Generator, passes: int) -> Fit:
    """Of the best of the starts; of a robust fit after more passes from there, since the residuals of least squares are
    those of outliers too. Raises: `CannotFit`."""
    ended: tuple[Solution, ...] = ()
    for begin in [task.nominal, *(task.drawn(draw) for _ in range(starts - 1))]:
        ended = searches.solved(task.solver, begin, ended)
    best = best_of(task.by, ended)
    if best is None:
        raise CannotFit(f"plant {task.given.name!r}", "has no finite residuals from any start; narrow the ranges")
    for _ in range(passes):
        task = replace(task, corner=task.corners(best.unknowns))
        ended = searches.solved(task.solver, best.unknowns, ended)
        best = ended[-1]
    return task.result(best, (best,) if passes else ended)


def best_of(by: str, ended: Sequence[Solution]) -> Solution | None:
    """That of the least cost among those that settled, else among the others; of equal ones the first. None where no
    cost is finite."""
    finite = [one for one in ended if np.isfinite(one.cost)]
    settled = [one for one in finite if one.settled] or finite
    least = min((one.cost for one in settled), default=0.0)
    return next((one for one in settled if above(by, one.cost, least) <= EQUAL), None)


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
