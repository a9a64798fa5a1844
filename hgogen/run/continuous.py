"""An observer in continuous time: a reference solution for its steps, and its frequency response.

    Ode       field' = rhs
    Riccati   z' = f(z, u) + S^-1 C' R_theta^-1 (y - h),  S' = -F'S - S F + C' R_theta^-1 C - S Q_theta S

Between samples u is interpolated linearly or constant, and y interpolated between two valid samples, as in a step.
Guards, the innovation and an adaptive theta act at the samples, as in a step: theta is constant between them, but a
decaying theta decays continuously. The predictors of the innovation use 16 steps of classical Runge-Kutta a sample.

So with a constant theta, Euler, Heun and RK4 converge to it with orders 1, 2 and 4 as dt -> 0. With an adaptive theta
RK4 does if the innovation also uses RK4 (its default, Heun, gives order 2). Continuous-discrete converges with order 1,
because it applies dt (y - h) at the samples in place of the integral. So does a decaying theta, which is constant
during a step. Source: Boizot, Busvelle, Gauthier, Automatica 46 (2010), (4)-(6).

The frequency response of the linear error core describes the effect of measurement noise on an estimate:

    continuous   H(j w) = E (j w - M)^-1 B                    x' = M x + B y,  estimate = E x
    a step       H(z) = E (z - Phi)^-1 (Gamma_1 z + Gamma_0)  x+ = Phi x + Gamma_1 y+ + Gamma_0 y,  z = e^(j w dt)

|H| is the amplitude of the steady error over that of a sinusoidal noise, without the model's nonlinear terms, which
matter less for a larger theta. Phi and Gamma are those of the method's update, with y interpolated between samples. A
gain that adapts has the value of the fastest core, and saturations are inactive. Beyond pi/dt a tone aliases: H is then
the response at the samples. Source: Astolfi, Marconi, Praly, Teel, "Sensitivity to high-frequency measurement noise of
nonlinear high-gain observers", NOLCOS (2016).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any

import casadi as ca
import numpy as np

from hgogen.discretisation.runge_kutta import RK4, repeated
from hgogen.discretisation.stability import Lengths
from hgogen.errors import BadArgument
from hgogen.estimators.core import Core, core, nominal, numbers
from hgogen.estimators.innovation import Predictors
from hgogen.estimators.riccati_part import Riccati, riccati_ode
from hgogen.estimators.theta import Decaying
from hgogen.graph import CVODES, Graph
from hgogen.observer import Observer
from hgogen.part import Clock, Ode, Pieces
from hgogen.program import INF, Block, Place, address, sym
from hgogen.reading.given import Misfit, reals, requires
from hgogen.run.samples import Run, table
from hgogen.step import Step, plan
from hgogen.stepping.machine import Bound, Interpreter, Machine, casadi_block
from hgogen.system import demand_continuous

FINE = repeated(RK4, 16)
TIME = Place("work", "time")  # since the last sample
# CVODES bounds a step's local error; it restarts at each sample, where u and y have a kink.
OPTIONS = {**CVODES, "abstol": 1e-12, "reltol": 1e-12}


class CannotIntegrate(BadArgument):
    """The error for a continuous observer that CVODES cannot integrate between two samples."""

    text = "the continuous equations of {what} cannot be integrated over a sample of {reason}"


@requires((Observer, Step), "an observer, one of hg.observers, or a step, as hg.sample makes it")
def reference(source: Observer | Step, u: Any = (), y: Any = (), dt: float = 0.0, *, between: str = "line") -> Run:
    """Return the run of the continuous observer, integrated by CVODES, at the samples of a log; gains and parameters
    have their nominal values.

    Args: `source`: an observer, or a step, whose dt and between are used; `u` (N) or (N, m), `y` (N) or (N, p), NaN for
    a missing sample, `dt` (s) apart; `between` as in `hg.sample`. The run's engine is "cvodes".

    Raises: `BadStep`, `BadShape`, `BadWindow`; `CannotIntegrate`.
    """
    observer = source.observer if isinstance(source, Step) else source
    demand_continuous(observer.form.system, "reference", "; run the step itself")
    if isinstance(source, Step):
        dt, between = source.clock.dt, source.clock.between
    elif isinstance(dt, int | float) and 0 < dt < INF:
        observer = observer.sampled(float(dt), (float(dt),) * len(observer.form.output))
    fine = [
        replace(part, predictor=replace(part.predictor, tableau=FINE)) if isinstance(part, Predictors) else part
        for part in observer.parts
    ]
    step = plan(replace(observer, parts=tuple(fine), at_period=None), Continuous(), dt, between)
    y = table("y", y, step.outputs, None)
    u = table("u", u, step.inputs, len(y))
    x, traces, status = Machine(step, partial(_bound, step)).record(u, y)
    return Run(
        t=np.arange(len(y)) * dt,
        x=x,
        names=tuple(s.name for s in step.states),
        traces={name: traces[:, j] for j, name in enumerate(step.traces)},
        status=status,
        engine="cvodes",
    )


@dataclass(frozen=True)
class Continuous:
    """A discretisation method that keeps the observer's differential equations unchanged, for CVODES to integrate."""

    name: str = "CVODES"
    equations: tuple[str, ...] = ()
    prediction: None = None

    def ode(self, part: Ode, clock: Clock) -> Pieces:
        """Return the equations of a part of an observer, for all its fields together, as pieces of a program."""
        return self._flow_pieces(part, clock, lambda graph, time: graph)

    def riccati(self, part: Riccati, clock: Clock) -> Pieces:
        """Return the equations of z and the Riccati matrix S as pieces, theta constant or decaying in a sample."""

        def now(graph: Graph, time: Graph) -> Graph:
            if not isinstance(part.theta, Decaying):
                return graph  # theta is constant
            theta = 1 + (part.theta.value - 1) * ca.exp(-sym("gain", "rate") * time)
            return ca.substitute(graph, part.theta.value, theta)

        return self._flow_pieces(riccati_ode(part, "information"), clock, now)

    def ode_lengths(self, part: Ode, observer: Observer, dt: float) -> Lengths:
        """Return no limits of the step length: CVODES chooses its steps."""
        return Lengths()

    def riccati_lengths(self, part: Riccati, dt: float) -> Lengths:
        """Return no limits of the step length: CVODES chooses its steps."""
        return Lengths()

    def _flow_pieces(self, part: Ode, clock: Clock, now: Callable[[Graph, Graph], Graph]) -> Pieces:
        time, start = sym(*TIME), {field.name: sym("state", field.name, field.size) for field in part.fields}
        share = time / clock.dt
        u = clock.u(0.0) + share * (clock.u(1.0) - clock.u(0.0))
        y = clock.y(0.0) + share * (clock.y(1.0) - clock.y(0.0))
        rates = part.rhs(start, u, y, clock.valid)
        block = Block(
            f"{', '.join(start)} by CVODES: their rates",
            {Place("state", name): now(ca.SX(rate), time) for name, rate in rates.items()},
            {"time": time, **start},  # named, so that the block reads them even if no rate does
        )
        return Pieces(fields=part.fields, derived=part.derived, tune=part.tune, predict=(block,), uses_output=True)


def _bound(step: Step, block: Block, arguments: list[np.ndarray]) -> Bound:
    """Return the function of a block of a program on the places of memory `arguments`. If the block
    depends on time, CVODES integrates its values, as time derivatives, until the next sample."""
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
            reason = "they may escape in finite time or lose S > 0 to rounding; check gains, ranges and the record"
            raise CannotIntegrate(step.observer.name, f"{step.dt:g}: {reason}") from None
        for result, values in zip(results, np.split(np.array(end)[:, 0], ends), strict=True):
            result[:] = values

    return run, results


Values = Mapping[Place, np.ndarray]


class NoResponse(BadArgument):
    """The error for an observer without a frequency response, mostly since its error core is not linear."""

    text = "the {what} observer has no frequency response: {reason}"


class BadFrequency(BadArgument):
    """The error for an argument `omega` that is no list of frequencies."""


@dataclass(frozen=True, eq=False)
class Response:
    """The complex response H (K, n, p) at the frequencies `omega` (K, rad/s), from the noise of each of the p `outputs`
    to each of the n `states`.

    `dt` (s) is that of the step, None in continuous time. `coordinates` is "plant", or "form" where the plant's states
    are nonlinear in the form's, which `states` then names. `held`: the adapting fields at their constant values.
    """

    omega: np.ndarray
    H: np.ndarray
    states: tuple[str, ...]
    outputs: tuple[str, ...]
    dt: float | None
    coordinates: Annotated[str, "plant, or form where the plant's states are nonlinear in the form's"]
    held: Mapping[str, tuple[float, ...]]

    @property
    def gain(self) -> np.ndarray:
        """The magnitude |H| (K, n, p) of the frequency response."""
        return np.asarray(np.abs(self.H))

    @property
    def aliased(self) -> np.ndarray:
        """The mask of the frequencies (K,) beyond the Nyquist frequency pi/dt, where H is that of the alias."""
        return np.asarray(self.omega > (np.inf if self.dt is None else np.pi / self.dt))


def response(source: Observer | Step, omega: Any) -> Response:
    """Return the frequency response of an observer in continuous time, or of a step, from the noise of each output to
    each estimate, at the frequencies `omega` (K,) (rad/s), with all gains and parameters as declared. Raises:
    `NoResponse` for an observer without a linear error core; `BadFrequency`, `BadGain`."""
    step = source if isinstance(source, Step) else None
    observer = step.observer if step else source
    if not isinstance(observer, Observer):
        raise Misfit("response", source, "an observer or a step")
    demand_continuous(observer.form.system, "response")
    frequencies = np.atleast_1d(reals("omega", omega))
    if frequencies.ndim > 1 or not frequencies.size or not (np.isfinite(frequencies) & (frequencies > 0)).all():
        unit = f"rad/{observer.form.system.time}"
        raise BadFrequency(f"omega = {omega!r}", f"must be positive numbers ({unit}), such as (50, 100, 300)")
    part, line, values = *_linear_core(observer), nominal(observer)
    E, states, coordinates = _estimate(observer, part, line, values)
    if step:
        M, before, now = _discretised(part, line, step, values)
        s = np.exp(1j * frequencies * step.dt)
    else:
        M, before, now = numbers(line.M, values), numbers(line.B, values), np.zeros(line.B.shape)
        s = 1j * frequencies
    H = np.array([E @ np.linalg.solve(z * np.eye(len(M)) - M, before + z * now) for z in s])
    outputs = tuple(signal.name for signal in observer.form.system.outputs)
    return Response(frequencies, H, states, outputs, step.dt if step else None, coordinates, part.frozen)


def pace(observer: Observer) -> tuple[float, float]:
    """Return the smallest and the largest |eigenvalue| (rad/s) of N in the observer's linear error dynamics e' = N e.
    Raises: `NoResponse`."""
    _, line = _linear_core(observer)
    sizes = np.abs(np.linalg.eigvals(numbers(line.M, nominal(observer))))
    return float(sizes.min()), float(sizes.max())


def around_poles(observer: Observer, count: int = 200) -> np.ndarray:
    """Return `count` frequencies (rad/s) on a logarithmic scale, from a tenth of the slowest pole of the observer's
    linear error dynamics to ten times the fastest. Raises: `NoResponse`."""
    slow, fast = pace(observer)
    return np.geomspace(max(slow, fast / 1e4) / 10, 10 * fast, count)


def _linear_core(observer: Observer) -> tuple[Ode, Core]:
    """Return the part of an observer whose error obeys e' = N e with a constant N, and N."""
    odes = [part for part in observer.parts if isinstance(part, Ode)]
    for part in odes:
        line = core(part, len(observer.form.output))
        if line is not None:
            return part, line
    reason = "it has no linear error core with constant coefficients; try it on a trial whose noise is a Sine"
    if observer.form.jacobian is not None and any(part.core is not None for part in odes):
        reason = "its error core is linear in other coordinates only; build it on the form phase without original"
    raise NoResponse(observer.name, reason)


def _estimate(observer: Observer, part: Ode, line: Core, values: Values) -> tuple[np.ndarray, tuple[str, ...], str]:
    """Return the matrix E (n, N) of x = E z from the observer's states z to the
    estimate x, the names of its rows, and their coordinates, "plant" or "form"."""
    form = observer.form
    known = {**values, **{Place("state", field.name): np.array(field.initial) for field in part.fields}}
    strange = {address(symbol)[0] for symbol in ca.symvar(observer.z)} - known.keys()
    if strange:
        raise NoResponse(observer.name, f"its estimate reads {min(strange)}, which is not in its linear error core")
    E = numbers(ca.jacobian(observer.z, line.x), known)
    z, u = sym("form", "z", form.n), sym("form", "u", len(form.system.inputs))
    back = ca.jacobian(observer.dynamics.estimate(z, u), z)
    if any(address(symbol)[0].struct == "form" for symbol in ca.symvar(back)):
        return E, tuple(signal.name for signal in form.states), "form"
    return numbers(back, values) @ E, tuple(signal.name for signal, _ in form.estimates), "plant"


def _discretised(part: Ode, line: Core, step: Step, values: Values) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Phi (N, N), Gamma_0 and Gamma_1 (N, p) of the step's linear update
    z+ = Phi z + Gamma_0 y + Gamma_1 y+, computed from unit vectors."""
    p, m, N = len(step.outputs), len(step.inputs), line.x.numel()
    linear = _linear(part)
    pieces = step.method.ode(linear, Clock(step.clock.dt, step.clock.between, m, p))
    reading = Interpreter((*pieces.tune, *pieces.predict))
    reading.set({**values, Place("work", "valid"): np.ones(p)})
    reading.action(pieces.tune)()
    predict, ends = reading.action(pieces.predict), np.cumsum([field.size for field in linear.fields])[:-1]

    def update(unit: np.ndarray) -> np.ndarray:
        x, before, now = np.split(unit, [N, N + p])
        start = {Place("state", f.name): piece for f, piece in zip(linear.fields, np.split(x, ends), strict=True)}
        reading.set({**start, Place("work", "y_last"): before, Place("work", "y"): now})
        predict()
        return np.concatenate([reading.memory[Place("state", field.name)] for field in linear.fields])

    Phi, before, now = np.split(np.column_stack([update(unit) for unit in np.eye(N + 2 * p)]), [N, N + p], axis=1)
    return Phi, before, now


def _linear(part: Ode) -> Ode:
    linear, moving = part.linear, tuple(field for field in part.fields if field.name not in part.frozen)
    fixed = {name: ca.SX(ca.DM(values)) for name, values in part.frozen.items()}
    assert linear is not None

    def lines(values: Mapping[str, Graph], y: Graph, valid: Graph) -> dict[str, Graph]:
        return {name: line for name, line in linear({**values, **fixed}, y, valid).items() if name not in fixed}

    def nothing(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        return {field.name: ca.SX(field.size, 1) for field in moving}

    return Ode(moving, nothing, lines, derived=part.derived, tune=part.tune)
