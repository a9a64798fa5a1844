"""Gains of observers from measured records: for each observer that the forms of a plant admit, those that predict best.

Gains are chosen by what they predict `ahead` samples ahead, or by a truth that was measured, and judged on segments
that did not choose them.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import numpy as np

from hgogen.emit.syntax import Real
from hgogen.errors import BadArgument, HgogenError, nearest
from hgogen.logs.grid import Calibration, Piece, Task, Tuned, observers_named, reasons, together, tuned
from hgogen.logs.records import Log
from hgogen.logs.score import BEGIN, Ahead, Hidden, Judge, readable
from hgogen.modelfiles.first import First, everywhere
from hgogen.reading.given import asks_a_plant, count, switches
from hgogen.run import native
from hgogen.run.campaign import Workers
from hgogen.starting import two
from hgogen.system import System
from hgogen.which_forms import Row

SEGMENTS = 5
SAME = 1e-3  # relative: periods of one grid, as typical times between rows tell them
FILTER, ADAPTIVE = "riccati", "adaptive"  # what the second adds to is the first
HUGE = 1e12  # times a threshold: never reached, or passed by any innovation
PREDICTORS = 4
PEAKS = (8.0, 6.0, 4.0, 3.0, 2.0)  # theta_1
ABOVE = 1.1  # times the largest innovation


class CannotTune(BadArgument):
    """Records, or observers, from which there are no gains."""


@asks_a_plant
@switches
def tune(
    plant: System,
    *records: Log,
    observers: Iterable[str] | None = None,
    ahead: int = 1,
    method: str = "continuous_discrete",
    between: Literal["line", "hold"] = "line",
    real: Real = "double",
    segments: int = SEGMENTS,
    truth: Sequence[Mapping[str, np.ndarray]] = (),
    rows: Iterable[Row] | None = None,
    deep: bool = False,
    jobs: int | None = 1,
    each: Callable[[str], None] = lambda what: None,
) -> Calibration:
    """The gains with which each observer predicts the records best, at their sampling period.

    `records`: as in `fit`, all of one period; `observers`: names of `hg.observers`, by default all, or "adaptive",
    which comes with riccati; `ahead`: samples, 1 where an estimate of now is wanted; `method` by name, `between` and
    `real`: as in `sample`; `segments` of each record, by which gains are judged that others chose, each of a sample at
    least; `truth`: the courses (N) of hidden states by name, a mapping for each record, by which gains are then chosen
    in the place of predictions; `rows`: the forms to ask, by default those that the plant is in, those that take
    seconds if `deep`; `jobs`: processes that try gains, None for one for each core; `each(what)` is called after every
    trial.

    Raises: `CannotTune`; `BadGain` for counts that are none; `UnknownObserver`; `BadLog`, `BadShape` for records
    that are none.
    """
    wanted = None if observers is None else [FILTER if name == ADAPTIVE else name for name in observers]
    names = observers_named(wanted)
    if not records or not all(isinstance(record, Log) for record in records):
        raise CannotTune("records", "are missing; give logs, such as hg.Log(u, y, dt)")
    dts = [record.dt for record in records]
    if max(dts) > (1 + SAME) * min(dts):
        listed = ", ".join(f"{dt:g}" for dt in dict.fromkeys(dts))
        raise CannotTune("records", f"have different periods, {listed}; read them on one grid, by --dt (dt=)")
    ahead, segments = count("ahead", ahead, 1, 2**31), count("segments", segments, 2, 2**31)
    logs = tuple(replace(readable(plant, record, k), dt=dts[0]) for k, record in enumerate(records, 1))
    true = _truth(plant, truth, logs)
    judge = Judge(logs, Hidden(true) if true else Ahead(ahead), segments, native.engine())
    if judge.count < 2:
        over = "the truth" if true else f"an output over {ahead} sample{'s' * (ahead > 1)}"
        reason = f"show no change of {over} in at least 2 of their segments"
        raise CannotTune("records", f"{reason}; give longer ones in which the plant moves, or a shorter ahead")
    count("segments", segments, 2, judge.most)
    sampling = {"method": method, "between": between, **({"real": real} if real != "double" else {})}
    task = Task(logs, judge, sampling, tuple(everywhere(plant, deep=deep) if rows is None else rows))
    work = partial(_results, Workers(task, jobs), each)
    ends = dict(together({name: tuned(task, name) for name in names}, work))
    done = {name: ends[name] for name in names}
    plain = done.get(FILTER)
    if isinstance(plain, Tuned):
        done[ADAPTIVE] = adaptive(task, plain, each)
    best = sorted((one for one in done.values() if isinstance(one, Tuned)), key=lambda one: one.error)
    if not best:
        raise CannotTune(f"plant {plant.name!r}", f"has no observer that can be tuned: {reasons(done)}")
    refused = {name: one for name, one in done.items() if isinstance(one, str)}
    return Calibration(tuple(best), refused, ahead, segments, tuple(true[0]) if true else ())


def _results(workers: Workers[Task], each: Callable[[str], None], pieces: Iterable[Piece]) -> dict[Piece, Any]:
    listed, results = list(pieces), {}
    for number, result in workers.results(_worked, enumerate(listed)):
        results[listed[number]] = result
        each(listed[number].label)
    return results


def _worked(task: Task, numbered: tuple[int, Piece]) -> tuple[int, Any]:
    number, piece = numbered
    return number, piece.result(task)


def _truth(
    plant: System, truth: Sequence[Mapping[str, np.ndarray]], logs: Sequence[Log]
) -> tuple[Mapping[str, np.ndarray], ...]:
    states = [x.name for x in plant.declared.states]
    if truth and len(truth) != len(logs):
        raise CannotTune("truth", f"is of {len(truth)} records and there are {len(logs)}; give a mapping for each")
    for k, (each, log) in enumerate(zip(truth, logs, strict=False), 1):
        if not each or each.keys() != truth[0].keys():
            raise CannotTune(f"truth of record {k}", "must hold the same states as that of the first, and one at least")
        for name, course in each.items():
            what = f"truth of {name!r:.60}"
            if name not in states:
                raise CannotTune(what, nearest(name, states, f"is of no state; there are {', '.join(states)}"))
            if np.shape(course) != (len(log.y),):
                raise CannotTune(what, f"of record {k} has the shape {np.shape(course)}; make it ({len(log.y)},)")
    return tuple({name: np.asarray(course, dtype=float) for name, course in each.items()} for each in truth)


def adaptive(task: Task, plain: Tuned, each: Callable[[str], None] = lambda what: None) -> Tuned | str:
    """The tuned filter with an adaptive theta, or why there is none, from records in which nothing went wrong.

        d = T/4, a whole number of samples for each of 4 predictors,   T = 2 n/theta: the time to cross a range
        gamma_0 = 1.1 max of I_d along the record with theta = 1,   gamma_1 = 2 gamma_0
        rise time d/4,   rate 1/(3 d)
        theta_1 = the largest of 8, 6, 4, 3, 2 whose alarm ratio is below 1: the mean of I_d with theta at 2 theta_1,
                  over gamma_0

    so that theta rests at 1 along the record, and comes back to it after an alarm. Q and R are those of the filter with
    theta = 1.
    """
    refusals: list[str] = []
    crossing = 2 * plain.numbers.n / plain.numbers.theta  # T
    d = PREDICTORS * max(1, round(crossing / 4 / task.dt / PREDICTORS)) * task.dt
    for theta_1 in PEAKS:
        table = {
            "kind": "adaptive",
            "theta_1": theta_1,
            "rise_time": two(d / 4),
            "rate": two(1 / (3 * d)),
            "innovation": {"kind": "staggered", "d": d, "predictors": PREDICTORS},
        }
        try:
            gamma_0 = two(ABOVE * float(_innovations(task, _first(task, plain, table, HUGE)).max()))
            ratio = float(_innovations(task, _first(task, plain, table, gamma_0 / HUGE)).mean()) / gamma_0
            if ratio >= 1:
                refusals.append(
                    f"an alarm feeds itself, even with theta_1 = {theta_1:g} (alarm ratio {ratio:.2g}): "
                    "the record's noise keeps theta up; fit the model, or take riccati, whose theta stays"
                )
                continue
            first = _first(task, plain, table, gamma_0)
        except HgogenError as error:
            refusals.append(str(error))
            continue
        finally:
            each(ADAPTIVE)
        more = task.judge.errors(first.step) - task.judge.errors(plain.first.step)  # Q and R are chosen already
        return replace(plain, name=ADAPTIVE, first=first, errors=plain.errors + more, tried=())
    return refusals[-1]


def _first(task: Task, plain: Tuned, table: Mapping[str, Any], gamma_0: float) -> First:
    gains = {**plain.first.starting.gains, "theta": {**table, "mu": (gamma_0, 2 * gamma_0)}}
    return task.made(FILTER, plain.first.row, gains)


def _innovations(task: Task, first: First) -> np.ndarray:
    """I_d along the records, but for their beginnings."""
    parts = []
    for record in task.records:
        first.step.reset()
        log = record.of(first.step.inputs)
        innovation = first.step.run(u=log.u, y=log.y, engine=task.judge.engine).traces["innovation"]
        parts.append(innovation[round(BEGIN * len(innovation)) :])
    return np.concatenate(parts)
