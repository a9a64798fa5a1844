"""Validation of steps on separate rows: prediction errors at several horizons, errors of hidden states, innovations.

    NIS = mean of e^2/s, 1 for innovations e as large as their variance s

Two predictors without a model are compared: copying the last value, and extrapolating the last two measured values
(differencing), which also estimates a state that is by definition the rate of an output.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np

from hgogen.call import CallableStep
from hgogen.logs.records import AS_WELL, Log, readable
from hgogen.logs.tune import Calibration, Tuned
from hgogen.run.backends import quickest_engine
from hgogen.run.consistency import LAGS, correlations
from hgogen.run.prediction import forecasts, rms
from hgogen.run.samples import last_values
from hgogen.signal import Signal, differences
from hgogen.system import System

Array = np.ndarray
COPYING, DIFFERENCING = "copying", "differencing"
HELD_OUT, ALL = "in the rows held out", "in all rows"
COLOURED = 5  # correlations beyond their bound; a white log has more in one case of 5,000
CONSISTENT = 2.0  # factor by which the NIS of a consistent filter may differ from 1
_MODELLESS = (COPYING, DIFFERENCING)


@dataclass(frozen=True, eq=False)
class ValidationLog:
    """A log whose rows from `cut` on are validation data; `truth`: measured courses (N) of hidden states, by name."""

    log: Log
    cut: int
    truth: Mapping[str, Array]


@dataclass(frozen=True)
class Judged:
    """The RMS errors of a tuning on the validation rows, and the whiteness of its innovations by their first `LAGS`
    autocorrelations; mappings are empty if nothing could be compared."""

    name: Annotated[str, "name of the tuning"]
    errors: Annotated[Mapping[int, Mapping[str, float]], "RMS errors of predictions, by samples ahead and output"]
    hidden: Annotated[Mapping[str, float], "RMS errors of hidden states"]
    nis: Annotated[Mapping[str, float], "mean normalised innovation squared by output"]
    coloured: Annotated[Mapping[str, int], "by output, how many correlations of innovations are not white"] = field(
        default_factory=dict
    )


def judged(
    plant: System,
    calibration: Calibration,
    others: Mapping[str, CallableStep],
    records: Sequence[ValidationLog],
    ahead: Iterable[int],
    each: Callable[[], None] = lambda: None,
) -> tuple[Judged, ...]:
    """Return the validation errors of tuned observers, of the steps `others` by name, and of predictors without a
    model, on the validation rows of the logs; `ahead`: prediction horizons in samples; `each()` is called after every
    step."""
    horizons = tuple(sorted(set(ahead)))
    records = [replace(record, log=readable(plant, record.log, k)) for k, record in enumerate(records, 1)]
    steps = {row.name: row.first.step for row in calibration.rows} | dict(others)
    validation_rows = [(record.log, record.cut) for record in records]
    innovations = {row.name: row.innovations(validation_rows) for row in calibration.rows}
    rows = []
    for name, step in steps.items():
        errors, scaled = _of_step(step, records, horizons), innovations.get(name, {})
        nis = {y: float(np.mean(e**2)) for y, e in scaled.items()}
        rows.append(Judged(name, *errors, nis, {y: coloured(e) for y, e in scaled.items()}))
        each()
    return (*rows, *_without_a_model(plant, records, horizons))


def coloured(e: Array) -> int:
    """Return how many of the first `LAGS` autocorrelations of a sequence (N,) are beyond 2/sqrt(N), as 1 in 20 of white
    noise are (Box, Jenkins, Time Series Analysis, 1970)."""
    r = correlations(e, min(LAGS, len(e) - 1))
    return 0 if r is None else int(np.count_nonzero(abs(r) > 2 / np.sqrt(len(e))))


def _of_step(
    step: CallableStep, records: Sequence[ValidationLog], ahead: tuple[int, ...]
) -> tuple[dict[int, dict[str, float]], dict[str, float]]:
    squares: dict[int, list[Array]] = {h: [] for h in ahead}
    hidden: dict[str, list[Array]] = {}
    step = step.undelayed
    engine = quickest_engine(step, sum(len(record.log.y) for record in records))
    for record in records:
        log = record.log.of(step.inputs)
        step.reset(log.start)
        run = step.run(u=log.u, y=log.y, engine=engine, dt=log.given(step))
        for one in forecasts(step, run, log.u, log.y, ahead):
            if one.ahead is not None:
                squares[one.ahead].append(np.where(one.compared, one.model, np.nan)[record.cut :])
        for name, true in record.truth.items():
            hidden.setdefault(name, []).append(run.off(name, true)[record.cut :, None])
    names = [y.name for y in step.outputs]
    errors = {h: dict(zip(names, _rms(parts), strict=True)) for h, parts in squares.items() if parts}
    return errors, {name: _rms(parts)[0] for name, parts in hidden.items()}


def _without_a_model(plant: System, records: Sequence[ValidationLog], ahead: tuple[int, ...]) -> tuple[Judged, ...]:
    # states that are by definition the rate of an output, or its negative: the output's number and the sign
    flow = dict(zip(plant.states, plant.flow, strict=True))
    signed = [(sign * flow[x], j, sign) for j, x in enumerate(plant.output) if x in flow for sign in (1, -1)]
    rates = {str(rate): (j, sign) for rate, j, sign in signed if rate in plant.states}
    errors: dict[str, dict[int, list[Array]]] = {name: {h: [] for h in ahead} for name in (COPYING, DIFFERENCING)}
    hidden: dict[str, list[Array]] = {}
    for record in records:
        y = record.log.y
        t = np.arange(len(y)) * record.log.dt if record.log.times is None else record.log.times
        last, at, rates_now = _last_two(plant.outputs, y, t)
        for h in ahead:
            for name, rate in ((COPYING, 0.0), (DIFFERENCING, rates_now[:-h])):
                guess = last[:-h] + (t[h:, None] - at[:-h]) * rate
                errors[name][h].append(differences(plant.outputs, guess, y[h:])[max(0, record.cut - h) :])
        for state, (output, sign) in rates.items():
            if state in record.truth:
                rate = sign * rates_now[:, output]
                hidden.setdefault(state, []).append((rate - record.truth[state])[record.cut :, None])
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


def _last_two(outputs: Sequence[Signal], y: Array, t: Array) -> tuple[Array, Array, Array]:
    """Return for each sample of y (N, p) at the times t (N) the last value up to it, the time of
    that value, and the rate of change between the last two values, 0 if there is only one."""
    count = np.arange(len(y))[:, None]
    at = np.maximum.accumulate(np.where(np.isfinite(y), count, -1), axis=0)
    before = np.take_along_axis(at, np.maximum(at - 1, 0), axis=0)
    there = (at > 0) & (before >= 0) & (before < at)
    last = last_values(y)
    change = differences(outputs, last, np.take_along_axis(last, np.maximum(before, 0), axis=0))
    return last, t[at], np.where(there, change, 0.0) / np.where(there, t[at] - t[before], 1)


def _rms(parts: Sequence[Array]) -> list[float]:
    columns = np.concatenate(parts).T
    finite = (column[~np.isnan(column)] for column in columns)
    return [rms(column) if len(column) else math.nan for column in finite]


def verdicts(
    calibration: Calibration, rows: Sequence[Judged], where: str = HELD_OUT, explained: bool = False
) -> tuple[str, ...]:
    """Return sentences that judge a calibration by its validation errors `rows`; `where`: words for the rows of the
    logs on which it was validated; `explained`: whether a fault of the logs explains large innovations."""
    judged = {row.name: row for row in rows}
    best = judged[calibration.best.name]
    return (
        *_selection(calibration),
        *(() if explained else _innovation_doubts(calibration.best, best, where)),
        *_doubts(calibration.best),
        *_disagreements(calibration, best, judged, where),
    )


def _selection(calibration: Calibration) -> Iterator[str]:
    best, first, states = calibration.best, calibration.rows[0], calibration.truth
    measure, rival = _ahead(calibration.ahead), "copying the last value"
    if states:
        measure = f"by the truth of {', '.join(states)}"
        rival = "its mean value" if len(states) == 1 else "their mean values"
    sentence = (
        f"take {best.name}: {measure}, its error is {best.error:.3g} times that of {rival}, on segments from which its "
        "gains were not learned"
    )
    finals = {row.name: row.error for row in calibration.final}
    if best is first:
        yield f"{sentence}; this is the least error"
    elif first not in calibration.credible and first.hidden is not None and best.hidden is not None:
        ratio = math.sqrt(first.hidden.mean() / best.hidden.mean())
        by_truth = f"by the truth {ratio:.3g} times that of {best.name}"
        yield f"{sentence}; {first.name} has the error {first.error:.3g}, but {by_truth}"
    elif best not in calibration.tied:
        rivals = ", ".join(f"{name} {error:.3g}" for name, error in finals.items() if name != best.name)
        learned = f"with gains learned from all rows {rivals}, and {best.name} {finals[best.name]:.3g}"
        yield f"{sentence}; {first.name} has the error {first.error:.3g}, but {learned}"
    else:
        cheaper = "knows its noise" if first.noise is None else "costs less"
        why = "has a proof" if best.rank[0] < first.rank[0] else cheaper
        equal = f"{first.name} has the error {first.error:.3g}, not clearly less when segments are compared"
        yield f"{sentence}; {equal}, and {best.name} {why}"
    if best.error >= 1:
        yield (
            f"no gains of {best.name} predict better than {rival}: the model does not predict "
            "these logs; fit its parameters, check ranges, units and period, or give a longer log"
        )


def _ahead(samples: int) -> str:
    return f"{samples} sample{'s' * (samples > 1)} ahead"


def _disagreements(calibration: Calibration, best: Judged, judged: Mapping[str, Judged], where: str) -> Iterator[str]:
    """Yield the tunings that are as good as the `best`, and those that another error measure prefers, a sentence
    each."""
    others = [f"{row.name} ({row.error:.3g})" for row in calibration.tied if row.name != best.name]
    if others:
        equal = f"their errors differ by at most {100 * (AS_WELL - 1):.0f} %"
        yield f"as good as {best.name} ({calibration.best.error:.3g}), since {equal}: {', '.join(others)}"
    other_measures = [*_other_horizons(best, judged), *_of_hidden_states(best, judged, calibration.truth)]
    if other_measures:
        yield f"by errors other than the one that chose {best.name}, {where}: {'; '.join(other_measures)}"


def _rival(error: float, others: Mapping[str, float], verb: str, measure: str) -> Iterator[str]:
    """Yield a sentence if the least of `others` (errors by name) is clearly less than `error`, with the predictors
    without a model that are as good."""
    finite = {name: other for name, other in others.items() if other == other}
    name = min((each for each in finite if each not in _MODELLESS), key=lambda each: finite[each], default="")
    for each in (name, *_MODELLESS):
        other = finite.get(each, math.inf)
        if other * AS_WELL < error:
            yield f"{each} {verb} better{measure}, {other:.3g} for {error:.3g}"
        elif each in _MODELLESS and other <= AS_WELL * error:
            yield f"{each} {verb} as well{measure}, {other:.3g} for {error:.3g}"


def _other_horizons(best: Judged, judged: Mapping[str, Judged]) -> Iterator[str]:
    for ahead, errors in best.errors.items():
        for output, error in errors.items():
            others = {name: row.errors[ahead][output] for name, row in judged.items() if row is not best}
            yield from _rival(error, others, f"predicts {output}", f" {_ahead(ahead)}")


def _of_hidden_states(best: Judged, judged: Mapping[str, Judged], tuned_on: Sequence[str]) -> Iterator[str]:
    for state, error in best.hidden.items():
        others = {name: row.hidden[state] for name, row in judged.items() if state in row.hidden and row is not best}
        measure = "" if state in tuned_on else " by its truth, which is not tuned on"
        yield from _rival(error, others, f"estimates {state}", measure)


def _innovation_doubts(best: Tuned, judged: Judged, where: str) -> Iterator[str]:
    for output, nis in judged.nis.items():
        if not 1 / CONSISTENT <= nis <= CONSISTENT:
            more = "more" if nis > 1 else "less"
            yield (
                f"innovations of {output} are {math.sqrt(nis):.2g} times as large as {best.name} assumes, "
                f"{where}: they scatter {more} there, and its variances are not to be trusted"
            )
    for output, count in judged.coloured.items():
        if count > COLOURED:
            yield (
                f"innovations of {output} are not white, {count} of the first {LAGS} correlations, {where}: the plant "
                "does more than the model, a sensor or an input is late, or the noise is slow; see longer horizons too"
            )


def _doubts(best: Tuned) -> Iterator[str]:
    thetas = sorted({numbers.theta for numbers, _ in best.tried})
    if len(thetas) > 1 and best.numbers.theta in (thetas[0], thetas[-1]):
        end = "least" if best.numbers.theta == thetas[0] else "largest that a step of this period takes"
        yield f"its theta {best.numbers.theta:g} is the {end}"
    for output, least in best.below_quantum.items():
        yield (
            f"R of {output} is at its least, a deviation of {least:.3g} by the steps in which {output} comes, and less "
            "would be more likely: the model is wrong, not the sensor; fit it, or choose gains by predictions "
            "further ahead, such as --ahead 25"
        )
    if best.noise is not None and not best.noise.settled:
        yield "the search for Q and R did not settle; give a longer log, or one in which the plant moves more"
