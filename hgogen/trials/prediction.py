"""How well an estimate predicts a measured record: the model runs on from the state at sample k, without
correction.

    error(h) = RMS over k of y_{k+h} - yhat_{k+h|k},   u known ahead

beside copying the last measured y, and beside the model alone from its first estimate (open loop). The
model is the form's, its nonlinear part evaluated in the declared box, by one classical Runge-Kutta step a
sample; a predicted reading is limited to the output's declared range, as the sensor's is. A sample that the step
rejected is as good as missing: nothing is compared with it, and nothing copied from it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from hgogen.calling.samples import Run, held_last
from hgogen.discretisation.runge_kutta import RK4, advance
from hgogen.graph import Graph, to_casadi
from hgogen.part import on_line
from hgogen.program import column, sym
from hgogen.signal import Signal
from hgogen.step import Step
from hgogen.structure.dynamics import Dynamics


@dataclass(frozen=True)
class Prediction:
    """RMS prediction errors of the output `output`, `ahead` samples ahead (None: open loop over the whole
    record).

    `model`: from the estimate; `copying`: the last measured value instead; `count`: samples compared; `rejected`:
    samples of the output that the step rejected, in the whole record.
    """

    output: str
    ahead: int | None
    model: float
    copying: float | None
    count: int
    rejected: int

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def predictions(step: Step, run: Run, u: np.ndarray, y: np.ndarray, ahead: Iterable[int]) -> tuple[Prediction, ...]:
    """The prediction errors on y (N, p) from the estimates of a run with inputs u (N, m): for each number of samples
    ahead, then in open loop."""
    x, unused = run.x, _raised(step, ("MISSING", "REJECTED"), step.outputs, run.status)
    rejected = np.isfinite(y) & unused
    y = np.where(rejected, np.nan, y)
    move, read, enter = _functions(step)
    u = _as_the_step_takes_it(np.where(_raised(step, ("REUSED",), step.inputs, run.status), np.nan, u), step.inputs)
    z = np.array(enter(x.T))
    last = held_last(y)
    wanted, errors = sorted(set(ahead)), []
    for h in range(1, max(wanted, default=0) + 1):
        now, after = _shifted(u, h - 1), _shifted(u, h)
        z = np.array(move(z, now.T, after.T))
        if h in wanted and h < len(y):
            predicted = _limited(np.array(read(z, after.T)).T, step.outputs)[:-h]
            errors += _errors(step, h, predicted, y[h:], last[:-h])
    alone = np.array(move.mapaccum(len(y) - 1)(enter(x[0]), u[:-1].T, u[1:].T)) if len(y) > 1 else z[:, :0]
    free = _limited(np.array(read(alone, u[1:].T)).T, step.outputs)
    errors += _errors(step, None, free, y[1:], None)
    lost = dict(zip((s.name for s in step.outputs), rejected.sum(axis=0).tolist(), strict=True))
    return tuple(replace(one, rejected=lost[one.output]) for one in errors)


def _raised(step: Step, bits: Iterable[str], signals: Sequence[Signal], status: np.ndarray) -> np.ndarray:
    """Whether one of the bits of each signal is raised in each sample (N, k)."""
    names = [each.name for each in step.bits]
    masks = [sum(1 << names.index(f"{bit}_{s.name}") for bit in bits) for s in signals]
    return np.asarray(status[:, None] & np.array(masks, np.uint32) != 0)


def _errors(
    step: Step, ahead: int | None, predicted: np.ndarray, y: np.ndarray, copied: np.ndarray | None
) -> list[Prediction]:
    result = []
    for j, signal in enumerate(step.outputs):
        there = np.isfinite(y[:, j]) if copied is None else np.isfinite(y[:, j] + copied[:, j])
        model = _rms(predicted[there, j] - y[there, j])
        copying = None if copied is None else _rms(copied[there, j] - y[there, j])
        if there.any():
            result.append(Prediction(signal.name, ahead, model or 0.0, copying, int(there.sum()), 0))
    return result


def _rms(error: np.ndarray) -> float:
    """The root mean square of an error, computed without squares that overflow."""
    most = float(np.abs(error).max(initial=0.0))
    return most * float(np.sqrt(np.mean((error / most) ** 2))) if most else 0.0


def _functions(step: Step) -> tuple[Any, Any, Any]:
    """CasADi functions: z one sample on from (z, u now, u then), the reading from (z, u), z from the
    plant's state."""
    form = step.observer.form
    dynamics = Dynamics(form)
    z, x = ca.SX.sym("z", form.n), ca.SX.sym("x", len(step.states))
    u0, u1 = (ca.SX.sym(name, len(step.inputs)) for name in ("u0", "u1"))

    def between(c: float) -> Graph:
        return u1 if step.between == "hold" else on_line(c, u0, u1)

    moved = advance(RK4, lambda v, c: {"z": dynamics.flow(v["z"], between(c))}, {"z": z}, step.dt).result["z"]
    plant = dict(zip(step.states, ca.vertsplit(x), strict=True))
    plant |= {p: ca.SX(float(value)) for p, value in form.system.nominal.items()}
    return (
        ca.Function("move", [z, u0, u1], [_nominal(step, moved)]),
        ca.Function("read", [z, u1], [_nominal(step, dynamics.output(z, u1))]),
        ca.Function("enter", [x], [column(to_casadi(form.entry, plant))]),
    )


def _nominal(step: Step, graph: Graph) -> Graph:
    """The graph with tunable parameters at their nominal values."""
    tunable = [(sym("plant", field.name), field.initial[0]) for field in step.plant]
    return ca.substitute([graph], [s for s, _ in tunable], [ca.SX(v) for _, v in tunable])[0] if tunable else graph


def _as_the_step_takes_it(u: np.ndarray, inputs: tuple[Signal, ...]) -> np.ndarray:
    """A missing input is the last one there was; each lies in its range."""
    held = held_last(u)
    for i, signal in enumerate(inputs):
        low, high = signal.interval
        resting = signal.nominal if signal.nominal is not None else min(max(0.0, low), high)
        held[:, i] = np.clip(np.where(np.isnan(held[:, i]), resting, held[:, i]), low, high)
    return held


def _shifted(u: np.ndarray, by: int) -> np.ndarray:
    """u (N, m) `by` samples later; the last one is repeated."""
    return np.concatenate([u[by:], np.repeat(u[-1:], min(by, len(u)), axis=0)])[: len(u)]


def _limited(y: np.ndarray, outputs: tuple[Signal, ...]) -> np.ndarray:
    low, high = np.array([s.interval for s in outputs]).T
    return np.asarray(np.clip(y, low, high))
