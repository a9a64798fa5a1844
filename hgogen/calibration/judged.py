"""What steps are worth on rows held out: prediction errors at several horizons, errors of hidden states, innovations.

    NIS = mean of e^2/s, 1 of an innovation e that is as large as the filter says (variance s)

beside two ways without a model: copying the last value, and going on along the last two that were measured
(differencing), which estimates a state that is by definition the rate of an output.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hgogen.calibration.score import readable
from hgogen.calibration.tuned import Calibration
from hgogen.call import CallableStep
from hgogen.calling.samples import Engine, held_last
from hgogen.identification.records import Log
from hgogen.identification.whiteness import LAGS, correlations
from hgogen.system import System
from hgogen.trials.prediction import forecasts, rms

Array = np.ndarray
COPYING, DIFFERENCING = "copying", "differencing"


@dataclass(frozen=True, eq=False)
class Held:
    """A record of which the rows from `cut` on are held out; `truth` (N) of hidden states by name."""

    log: Log
    cut: int
    truth: Mapping[str, Array]


@dataclass(frozen=True)
class Judged:
    """Of one row: `errors` (RMS) of predictions by samples ahead and output, `hidden` (RMS) by state, `nis` by output,
    `coloured` by output: how many of the first `LAGS` correlations of the innovations are not those of white noise;
    empty where there are none."""

    name: str
    errors: Mapping[int, Mapping[str, float]]
    hidden: Mapping[str, float]
    nis: Mapping[str, float]
    coloured: Mapping[str, int] = field(default_factory=dict)


def judged(
    plant: System,
    calibration: Calibration,
    others: Mapping[str, CallableStep],
    records: Sequence[Held],
    ahead: Iterable[int],
    engine: Engine,
) -> tuple[Judged, ...]:
    """The rows tuned, `others` by name, and what does without a model."""
    horizons = tuple(sorted(set(ahead)))
    records = [replace(held, log=readable(plant, held.log, k)) for k, held in enumerate(records, 1)]
    steps = {row.name: row.first.step for row in calibration.rows} | dict(others)
    rows_held = [(held.log, held.cut) for held in records]
    innovations = {row.name: row.innovations(rows_held) for row in calibration.rows}
    rows = [
        Judged(
            name,
            *_of_step(step, records, horizons, engine),
            {y: float(np.mean(e**2)) for y, e in innovations.get(name, {}).items()},
            {y: coloured(e) for y, e in innovations.get(name, {}).items()},
        )
        for name, step in steps.items()
    ]
    return (*rows, *_without_a_model(plant, records, horizons))


def coloured(e: Array) -> int:
    """How many of the first `LAGS` correlations of a sequence (N,) lie beyond 2/sqrt(N), as one in 20 of white noise
    does (Box, Jenkins, Time Series Analysis, 1970)."""
    r = correlations(e, min(LAGS, len(e) - 1))
    return 0 if r is None else int(np.count_nonzero(abs(r) > 2 / np.sqrt(len(e))))


def _of_step(
    step: CallableStep, records: Sequence[Held], ahead: tuple[int, ...], engine: Engine
) -> tuple[dict[int, dict[str, float]], dict[str, float]]:
    squares: dict[int, list[Array]] = {h: [] for h in ahead}
    hidden: dict[str, list[Array]] = {}
    step = step.undelayed
    for held in records:
        log = held.log.of(step.inputs)
        step.reset()
        run = step.run(u=log.u, y=log.y, engine=engine)
        for one in forecasts(step, run, log.u, log.y, ahead):
            if one.ahead is not None:
                squares[one.ahead].append(np.where(one.compared, one.model, np.nan)[held.cut :])
        for name, true in held.truth.items():
            hidden.setdefault(name, []).append((run[name] - true)[held.cut :, None])
    names = [y.name for y in step.outputs]
    errors = {h: dict(zip(names, _rms(parts), strict=True)) for h, parts in squares.items() if parts}
    return errors, {name: _rms(parts)[0] for name, parts in hidden.items()}


def _without_a_model(plant: System, records: Sequence[Held], ahead: tuple[int, ...]) -> tuple[Judged, ...]:
    # the states that are by definition the rate of an output, or minus it: its number and the sign
    flow = dict(zip(plant.states, plant.flow, strict=True))
    signed = [(sign * flow[x], j, sign) for j, x in enumerate(plant.output) if x in flow for sign in (1, -1)]
    rates = {str(rate): (j, sign) for rate, j, sign in signed if rate in plant.states}
    errors: dict[str, dict[int, list[Array]]] = {name: {h: [] for h in ahead} for name in (COPYING, DIFFERENCING)}
    hidden: dict[str, list[Array]] = {}
    for held in records:
        y = held.log.y
        last, age, moved = _last_two(y)
        for h in ahead:
            for name, guess in ((COPYING, last), (DIFFERENCING, last + (age + h) * moved)):
                errors[name][h].append((guess[:-h] - y[h:])[max(0, held.cut - h) :])
        for state, (output, sign) in rates.items():
            if state in held.truth:
                rate = sign * moved[:, output] / held.log.dt
                hidden.setdefault(state, []).append((rate - held.truth[state])[held.cut :, None])
    names = [y.name for y in plant.outputs]
    return tuple(
        Judged(
            name,
            {h: dict(zip(names, _rms(parts), strict=True)) for h, parts in every.items()},
            {s: _rms(parts)[0] for s, parts in hidden.items()} if name == DIFFERENCING else {},
            {},
        )
        for name, every in errors.items()
    )


def _last_two(y: Array) -> tuple[Array, Array, Array]:
    """Of each sample of y (N, p) the last value, how many samples old it is, and the change a sample between the last
    two values, 0 where there is one alone."""
    count = np.arange(len(y))[:, None]
    at = np.maximum.accumulate(np.where(np.isfinite(y), count, -1), axis=0)
    before = np.take_along_axis(at, np.maximum(at - 1, 0), axis=0)
    there = (at > 0) & (before >= 0) & (before < at)
    last = held_last(y)
    change = last - np.take_along_axis(last, np.maximum(before, 0), axis=0)
    return last, count - at, np.where(there, change, 0.0) / np.where(there, at - before, 1)


def _rms(parts: Sequence[Array]) -> list[float]:
    """Of each column, NaN where nothing was compared."""
    columns = np.concatenate(parts).T
    finite = (column[~np.isnan(column)] for column in columns)
    return [rms(column) if len(column) else math.nan for column in finite]
