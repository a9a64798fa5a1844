"""The continuous equations of an observer, integrated by CVODES, to compare a step with.

    Ode       field' = rhs as it stands
    Riccati   z' = f(z, u) + S^-1 C' R_theta^-1 (y - h),  S' = -F'S - S F + C' R_theta^-1 C - S Q_theta S

u is on the line between samples, or held, and y on the line between two valid samples, as in a step. Guards, the
innovation and an adaptive theta act at the samples, as in a step: theta is held between them, a decaying one decays on.
The predictors of the innovation go by 16 steps of classical Runge-Kutta a sample.

So with a constant theta, Euler, Heun and RK4 converge to it with orders 1, 2 and 4 as dt -> 0; with an adaptive one RK4
does where the innovation, too, goes by RK4 (its default, Heun, leaves order 2). Continuous-discrete converges with
order 1, because it applies dt (y - h) at the samples in place of the integral, and so does a decaying theta, which a
step holds. Source: Boizot, Busvelle, Gauthier, Automatica 46 (2010), (4)-(6).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from hgogen.discretisation.runge_kutta import RK4, repeated
from hgogen.discretisation.stability import Lengths
from hgogen.errors import BadArgument
from hgogen.estimators.covariance import information_ode
from hgogen.estimators.innovation import Predictors
from hgogen.estimators.riccati_part import Riccati
from hgogen.estimators.theta import Decaying
from hgogen.graph import CVODES, Graph
from hgogen.observer import Observer
from hgogen.part import Clock, Ode, Pieces
from hgogen.program import Block, Place, sym
from hgogen.reading.given import asks
from hgogen.run.samples import Run, table
from hgogen.step import Step, plan
from hgogen.stepping.machine import Bound, Machine, casadi_block

FINE = repeated(RK4, 16)
TIME = Place("work", "time")  # since the last sample
# CVODES bounds a step's local error; it starts anew at each sample, where u and y have a kink.
OPTIONS = {**CVODES, "abstol": 1e-12, "reltol": 1e-12}


class CannotIntegrate(BadArgument):
    """The continuous observer cannot be followed over an interval between samples."""

    text = "the continuous equations of {what} cannot be integrated over a sample of {reason}"


@asks((Observer, Step), "an observer, one of hg.observers, or a step, as hg.sample makes it")
def reference(source: Observer | Step, u: Any = (), y: Any = (), dt: float = 0.0, *, between: str = "line") -> Run:
    """The continuous observer at the samples of a record, gains and parameters at their nominal values.

    Args: `source`: an observer, or a step, which brings its own dt and between; `u` (N) or (N, m), `y` (N) or (N, p),
    NaN for a missing sample, `dt` (s) apart; `between` as in `hg.sample`. The run's engine is "cvodes".

    Raises: `BadStep`, `BadShape`, `BadWindow`; `CannotIntegrate`.
    """
    observer = source.observer if isinstance(source, Step) else source
    if isinstance(source, Step):
        dt, between = source.dt, source.clock.between
    fine = [
        replace(part, predictor=replace(part.predictor, tableau=FINE)) if isinstance(part, Predictors) else part
        for part in observer.parts
    ]
    step = plan(replace(observer, parts=tuple(fine)), Continuous(), dt, between)
    y = table("y", y, step.outputs, None)
    u = table("u", u, step.inputs, len(y))
    x, traces, status = Machine(step, partial(_bound, step)).record(u, y)
    return Run(
        t=np.arange(len(y)) * dt,
        x=x,
        names=tuple(s.name for s in step.states),
        traces={name: traces[:, j] for j, name in enumerate(step.observer.traces)},
        status=status,
        engine="cvodes",
    )


@dataclass(frozen=True)
class Continuous:
    """The method that leaves differential equations as they are."""

    name: str = "CVODES"
    equations: tuple[str, ...] = ()
    prediction: None = None

    def ode(self, part: Ode, clock: Clock) -> Pieces:
        """All fields of the part at once."""
        return self._moved(part, clock, lambda graph, time: graph)

    def riccati(self, part: Riccati, clock: Clock) -> Pieces:
        """z and S, theta as it is between two samples."""

        def now(graph: Graph, time: Graph) -> Graph:
            if not isinstance(part.theta, Decaying):
                return graph  # theta is held
            theta = 1 + (part.theta.value - 1) * ca.exp(-sym("gain", "rate") * time)
            return ca.substitute(graph, part.theta.value, theta)

        return self._moved(information_ode(part), clock, now)

    def ode_lengths(self, part: Ode, observer: Observer, dt: float) -> Lengths:
        """None: CVODES chooses its steps."""
        return Lengths()

    def riccati_lengths(self, part: Riccati, dt: float) -> Lengths:
        """None: CVODES chooses its steps."""
        return Lengths()

    def _moved(self, part: Ode, clock: Clock, now: Callable[[Graph, Graph], Graph]) -> Pieces:
        time, start = sym(*TIME), {field.name: sym("state", field.name, field.size) for field in part.fields}
        share = time / clock.dt
        u = clock.u(0.0) + share * (clock.u(1.0) - clock.u(0.0))
        y = clock.y(0.0) + share * (clock.y(1.0) - clock.y(0.0))
        rates = part.rhs(start, u, y, clock.valid)
        block = Block(
            f"{', '.join(start)} by CVODES: their rates",
            {Place("state", name): now(ca.SX(rate), time) for name, rate in rates.items()},
            {"time": time, **start},  # named so that they count as read, whether or not a rate needs them
        )
        return Pieces(fields=part.fields, derived=part.derived, tune=part.tune, predict=(block,), uses_output=True)


def _bound(step: Step, block: Block, arguments: list[np.ndarray]) -> Bound:
    """A block that reads the time gives rates, along which its places move until the next sample."""
    arrays = {place: array for (place, _), array in zip(block.reads, arguments, strict=True)}
    if arrays.pop(TIME, None) is None:
        return casadi_block(block, arguments)
    moving = {place: arrays.pop(place) for place in block.writes}
    results = [np.zeros_like(array) for array in moving.values()]
    ends = np.cumsum([len(array) for array in results])[:-1]
    sizes = dict(block.reads)
    state, fixed = (ca.vertcat(*(sym(*place, sizes[place]) for place in places)) for places in (moving, arrays))
    ode = {"x": state, "p": fixed, "t": sym(*TIME), "ode": ca.vertcat(*block.writes.values())}
    solver = ca.integrator("flow", "cvodes", ode, 0.0, step.dt, OPTIONS)

    def run() -> None:
        try:
            end = solver(x0=np.concatenate([*moving.values()]), p=np.concatenate([*arrays.values()]))["xf"]
        except RuntimeError:
            doubt = "they may escape in finite time or lose S > 0 to rounding; check gains, ranges and the record"
            raise CannotIntegrate(step.observer.name, f"{step.dt:g}: {doubt}") from None
        for result, values in zip(results, np.split(np.array(end)[:, 0], ends), strict=True):
            result[:] = values

    return run, results
