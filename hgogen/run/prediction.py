"""How well an estimate predicts a measured record: the model runs on from the state at sample k, without correction.

    error(h) = RMS over k of y_{k+h} - yhat_{k+h|k},   u known ahead

beside copying the last measured y, and beside the model alone from its first estimate (open loop). The model is the
form's, its nonlinear part evaluated in the declared box, by one classical Runge-Kutta step a sample; a predicted
reading is limited to the output's declared range, as the sensor's is. A sample that the step rejected is as good as
missing: nothing is compared with it, and nothing copied from it. Of a record of more than MOST samples k is one at
random of each two, three, .., so that at most MOST predictions are made.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hgogen.discretisation.open_loop import evaluated, open_loop
from hgogen.run.covariances import raised
from hgogen.run.samples import Run, held_last
from hgogen.signal import Signal, resting
from hgogen.step import Step

MOST = 100_000  # predictions of each horizon: independent errors have their root mean square to half a percent


@dataclass(frozen=True)
class Prediction:
    """RMS prediction errors of an output."""

    output: Annotated[str, "the output"]
    ahead: Annotated[int | None, "samples ahead; null for open loop over the whole record"]
    model: Annotated[float, "error from the estimate"]
    copying: Annotated[float | None, "error of the last measured value"]
    count: Annotated[int, "samples compared"]
    rejected: Annotated[int, "samples of the output that the step rejected, in the whole record"]


@dataclass(frozen=True, eq=False)
class Forecast:
    """Errors (N, p) of predictions `ahead` samples ahead (None: in open loop), at the samples predicted: of the
    `model`, and of `copying` the last measured value (None in open loop); `compared` (N, p): where there are any."""

    ahead: int | None
    model: np.ndarray
    copying: np.ndarray | None
    compared: np.ndarray


def predictions(
    step: Step, run: Run, u: np.ndarray, y: np.ndarray, ahead: Iterable[int], tick: Callable[[], None] = lambda: None
) -> tuple[Prediction, ...]:
    """The prediction errors on y (N, p) from the estimates of a run with inputs u (N, m): for each number of samples
    ahead, then in open loop. `tick` is called after each sample ahead of the farthest."""
    lost = rejected(step, run, y).sum(axis=0).tolist()
    return tuple(
        Prediction(
            signal.name,
            one.ahead,
            rms(one.model[one.compared[:, j], j]) or 0.0,
            None if one.copying is None else rms(one.copying[one.compared[:, j], j]),
            int(one.compared[:, j].sum()),
            lost[j],
        )
        for one in forecasts(step, run, u, y, ahead, tick)
        for j, signal in enumerate(step.outputs)
        if one.compared[:, j].any()
    )


def forecasts(
    step: Step, run: Run, u: np.ndarray, y: np.ndarray, ahead: Iterable[int], tick: Callable[[], None] = lambda: None
) -> Iterator[Forecast]:
    """As `predictions`, sample by sample."""
    y = np.where(rejected(step, run, y), np.nan, y)
    model, held = open_loop(step.observer.form, step.dt, step.clock.between), bool(step.observer.form.held)
    u = _as_the_step_takes_it(np.where(raised(step, run.status, ("REUSED",), step.inputs), np.nan, u), step.inputs)
    wanted, last, count = sorted(set(ahead)), held_last(y), len(y)
    farthest = max((h for h in wanted if h < count), default=0)
    later = np.concatenate([u, np.repeat(u[-1:], farthest, axis=0)])  # of which the last one is repeated
    starts = _starts(count)
    move, read = model.move.map(len(starts)), model.read.map(len(starts))
    z = evaluated(model.enter.map(len(starts)), run.x[starts], u[starts])
    for h in range(1, farthest + 1):
        z = evaluated(move, z, later[starts + h - 1], later[starts + h])
        tick()
        if h in wanted:
            from_here = starts[starts + h < count]
            predicted = _limited(evaluated(read, z, later[starts + h]), step.outputs, held)[: len(from_here)]
            yield _compared(h, from_here + h, predicted, y, last[from_here], held)
    alone = np.empty((0, len(step.outputs)))
    if count > 1:
        start = evaluated(model.enter, run.x[:1], u[:1])
        alone = evaluated(model.move.mapaccum(count - 1), start, u[:-1], u[1:])
        alone = evaluated(model.read.map(count - 1), alone, u[1:])
    yield _compared(None, np.arange(1, count), _limited(alone, step.outputs, held), y, None, held)


def _starts(count: int) -> np.ndarray:
    """The samples from which is predicted: all, or one at random of each few, as sensors may have periods."""
    few = max(1, -(-count // MOST))
    blocks = np.arange(0, count, few)
    chosen = blocks + np.random.default_rng(0).integers(few, size=len(blocks))
    return np.asarray(np.minimum(chosen, count - 1))


def _compared(
    ahead: int | None, places: np.ndarray, predicted: np.ndarray, y: np.ndarray, copied: np.ndarray | None, held: bool
) -> Forecast:
    """Predictions and copies of y at places; of a model `held` where it has no value, there is none there."""

    def at_its_sample(values: np.ndarray) -> np.ndarray:
        errors = np.full(y.shape, np.nan)
        errors[places] = values - y[places]
        return errors

    there = np.zeros(y.shape, bool)
    there[places] = np.isfinite(y[places]) & (np.isfinite(predicted) | (not held))
    if copied is None:
        return Forecast(ahead, at_its_sample(predicted), None, there)
    copying = at_its_sample(copied)
    return Forecast(ahead, at_its_sample(predicted), copying, there & np.isfinite(copying))


def rejected(step: Step, run: Run, y: np.ndarray) -> np.ndarray:
    """Whether the step did not use a sample that there is (N, p)."""
    return np.asarray(np.isfinite(y) & raised(step, run.status, ("MISSING", "REJECTED"), step.outputs))


def rms(error: np.ndarray) -> float:
    """The root mean square of an error, computed without squares that overflow."""
    most = float(np.abs(error).max(initial=0.0))
    return most * float(np.sqrt(np.mean((error / most) ** 2))) if most else 0.0


def _as_the_step_takes_it(u: np.ndarray, inputs: tuple[Signal, ...]) -> np.ndarray:
    """A missing input is the last one there was; each lies in its range."""
    held, (low, high) = held_last(u), np.array([s.interval for s in inputs]).reshape(-1, 2).T
    return np.asarray(np.clip(np.where(np.isnan(held), list(map(resting, inputs)), held), low, high))


def _limited(y: np.ndarray, outputs: tuple[Signal, ...], held: bool) -> np.ndarray:
    """Predictions in the ranges of the outputs; of a model that is `held` where it has no value, none there."""
    low, high = np.array([s.interval for s in outputs]).T
    return np.asarray(np.clip(np.where(np.isinf(y) & held, np.nan, y), low, high))
