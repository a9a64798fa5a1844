"""The gains of an adaptive theta from a record in which nothing went wrong.

    d = T/4, a whole number of samples for each of 4 predictors,   T = 2 n/theta: the time to cross a range
    gamma_0 = 1.1 max of I_d along the record with theta = 1,   gamma_1 = 2 gamma_0
    rise time d/4,   rate 1/(3 d)
    theta_1 = the largest of 8, 6, 4, 3, 2 whose alarm ratio is below 1: the mean of I_d with theta at 2 theta_1, over
              gamma_0

so that theta rests at 1 along the record, and comes back to it after an alarm. Q and R are those of the filter with
theta = 1.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from hgogen.calibration.grid import Task
from hgogen.calibration.score import BEGIN
from hgogen.calibration.tuned import Tuned
from hgogen.errors import HgogenError
from hgogen.modelfiles.first import First
from hgogen.starting import Starting, two

FILTER, ADAPTIVE = "riccati", "adaptive"  # what the second adds to is the first
HUGE = 1e12  # times a threshold: never reached, or passed by any innovation
PREDICTORS = 4
PEAKS = (8.0, 6.0, 4.0, 3.0, 2.0)  # theta_1
ABOVE = 1.1  # times the largest innovation


def adaptive(task: Task, plain: Tuned, each: Callable[[str], None] = lambda what: None) -> Tuned | str:
    """The tuned filter with an adaptive theta, or why there is none."""
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
    row = plain.first.row
    assert row.form is not None
    gains = {**plain.first.starting.gains, "theta": {**table, "mu": (gamma_0, 2 * gamma_0)}}
    return First(FILTER, row, Starting(gains, task.dt), task.step(FILTER, row.form, gains))


def _innovations(task: Task, first: First) -> np.ndarray:
    """I_d along the records, but for their beginnings."""
    parts = []
    for record in task.records:
        first.step.reset()
        log = record.of(first.step.inputs)
        innovation = first.step.run(u=log.u, y=log.y, engine=task.judge.engine).traces["innovation"]
        parts.append(innovation[round(BEGIN * len(innovation)) :])
    return np.concatenate(parts)
