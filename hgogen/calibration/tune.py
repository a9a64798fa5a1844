"""Gains of observers from measured records: for each observer that the forms of a plant admit, those that predict best.

Gains are chosen by what they predict `ahead` samples ahead, and judged on segments that did not choose them.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Literal

from hgogen.calibration.adaptive import ADAPTIVE, FILTER, adaptive
from hgogen.calibration.grid import Task, observers_named, reasons
from hgogen.calibration.readable import readable
from hgogen.calibration.score import Judge
from hgogen.calibration.tuned import Calibration, Tuned
from hgogen.calling import native
from hgogen.emit.syntax import Real
from hgogen.errors import BadArgument
from hgogen.identification.records import Log
from hgogen.modelfiles.first import everywhere
from hgogen.reading.door import asks_a_plant
from hgogen.system import System
from hgogen.which_forms import Row

SEGMENTS = 5
SAME = 1e-3  # relative: periods of one grid, as typical times between rows tell them


class CannotTune(BadArgument):
    """Records, or observers, from which there are no gains."""


@asks_a_plant
def tune(
    plant: System,
    *records: Log,
    observers: Iterable[str] | None = None,
    ahead: int = 1,
    method: str = "continuous_discrete",
    between: Literal["line", "hold"] = "line",
    real: Real = "double",
    segments: int = SEGMENTS,
    rows: Iterable[Row] | None = None,
    deep: bool = False,
    each: Callable[[str], None] = lambda what: None,
) -> Calibration:
    """The gains with which each observer predicts the records best, at their sampling period.

    `records`: as in `fit`, all of one period; `observers`: names of `hg.observers`, by default all, or "adaptive",
    which comes with riccati; `ahead`: samples, 1 where an estimate of now is wanted; `method` by name, `between` and
    `real`: as in `sample`; `segments` of each record, by which gains are judged that others chose; `rows`: the forms to
    ask, by default those that the plant is in, those that take seconds if `deep`; `each(what)` is called after every
    trial.

    Raises: `CannotTune`; `UnknownObserver`; `BadLog`, `BadShape` for records that are none.
    """
    wanted = None if observers is None else [FILTER if name == ADAPTIVE else name for name in observers]
    names = observers_named(wanted)
    if not records or not all(isinstance(record, Log) for record in records):
        raise CannotTune("records", "are missing; give logs, such as hg.Log(u, y, dt)")
    dts = [record.dt for record in records]
    if max(dts) > (1 + SAME) * min(dts):
        listed = ", ".join(f"{dt:g}" for dt in dict.fromkeys(dts))
        raise CannotTune("records", f"have different periods, {listed}; read them on one grid, as --dt does")
    if ahead < 1 or segments < 2:
        raise CannotTune(f"ahead={ahead}, segments={segments}", "must be at least 1 and 2")
    logs = tuple(replace(readable(plant, record, k), dt=dts[0]) for k, record in enumerate(records, 1))
    judge = Judge(logs, ahead, segments, native.engine())
    if judge.count < 2:
        reason = f"show no change of an output over {ahead} sample{'s' * (ahead > 1)} in at least 2 of their segments"
        raise CannotTune("records", f"{reason}; give longer ones in which the plant moves, or a shorter ahead")
    task = Task(logs, judge, {"method": method, "between": between}, real, each)
    asked = tuple(everywhere(plant, deep=deep) if rows is None else rows)
    done = {name: task.tuned(name, asked) for name in names}
    plain = done.get(FILTER)
    if isinstance(plain, Tuned):
        done[ADAPTIVE] = adaptive(task, plain)
    tuned = sorted((one for one in done.values() if isinstance(one, Tuned)), key=lambda one: one.error)
    if not tuned:
        raise CannotTune(f"plant {plant.name!r}", f"has no observer that can be tuned: {reasons(done)}")
    refused = {name: one for name, one in done.items() if isinstance(one, str)}
    return Calibration(tuple(tuned), refused, ahead, segments)
