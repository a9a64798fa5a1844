"""What measurement noise does to an estimate: the frequency response of the linear error core.

    continuous   H(j w) = E (j w - M)^-1 B                    x' = M x + B y,  estimate = E x
    a step       H(z) = E (z - Phi)^-1 (Gamma_1 z + Gamma_0)  x+ = Phi x + Gamma_1 y+ + Gamma_0 y,  z = e^(j w dt)

|H| is the amplitude of the steady error over that of a sinusoidal noise, the model's nonlinear terms left out: the
larger theta, the less they count. Phi and Gamma are those of the method's own update, y on the line between samples. A
gain that adapts is taken where the core is the fastest, a saturation as not active. Beyond pi/dt a tone aliases: H is
then what is seen at the samples. Source: Astolfi, Marconi, Praly, Teel, "Sensitivity to high-frequency measurement
noise of nonlinear high-gain observers", NOLCOS (2016).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import casadi as ca
import numpy as np

from hgogen.errors import BadArgument
from hgogen.estimators.core import Core, core, nominal, numbers
from hgogen.graph import Graph
from hgogen.observer import Observer
from hgogen.part import Clock, Ode
from hgogen.program import Place, address, sym
from hgogen.reading.given import Misfit, reals
from hgogen.step import Step
from hgogen.stepping.machine import Reading

Values = Mapping[Place, np.ndarray]


class NoResponse(BadArgument):
    """An observer that has no frequency response."""

    text = "the {what} observer has no frequency response: {reason}"


class BadFrequency(BadArgument):
    """Frequencies that are none."""


@dataclass(frozen=True, eq=False)
class Response:
    """The complex response H (K, n, p) at the frequencies `omega` (K, rad/s), from the noise of each of the p `outputs`
    to each of the n `states`.

    `dt` (s) is that of the step, None in continuous time. `coordinates` is "plant", or "form" where the plant's states
    are nonlinear in the form's, which `states` then names. `held` has the fields that adapt, at the values taken.
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
        """|H| (K, n, p)."""
        return np.asarray(np.abs(self.H))

    @property
    def aliased(self) -> np.ndarray:
        """Which frequencies (K,) are beyond the Nyquist frequency pi/dt of a step: H is then that of the alias."""
        return np.asarray(self.omega > (np.inf if self.dt is None else np.pi / self.dt))


def response(source: Observer | Step, omega: Any) -> Response:
    """The response of an observer in continuous time, or as discretised by a step, at the frequencies `omega` (K,)
    (rad/s), all gains and parameters as declared. Raises: `NoResponse` for an observer without a linear error core;
    `BadFrequency`, `BadGain`."""
    step = source if isinstance(source, Step) else None
    observer = step.observer if step else source
    if not isinstance(observer, Observer):
        raise Misfit("response", source, "an observer or a step")
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
    """The least and the largest |eigenvalue| (rad/s) of the linear error core. Raises: `NoResponse`."""
    _, line = _linear_core(observer)
    sizes = np.abs(np.linalg.eigvals(numbers(line.M, nominal(observer))))
    return float(sizes.min()), float(sizes.max())


def _linear_core(observer: Observer) -> tuple[Ode, Core]:
    """The part that has a linear error core, and that core. Raises: `NoResponse`."""
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
    """E (n, N), the names of its rows, and whose coordinates they are."""
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
    """Phi (N, N), Gamma_0 and Gamma_1 (N, p): the method's update of the linear part alone, at unit vectors."""
    p, m, N = len(step.outputs), len(step.inputs), line.x.numel()
    linear = _linear(part)
    pieces = step.method.ode(linear, Clock(step.dt, step.clock.between, m, p))
    reading = Reading((*pieces.tune, *pieces.predict))
    reading.give({**values, Place("work", "valid"): np.ones(p)})
    reading.action(pieces.tune)()
    predict, ends = reading.action(pieces.predict), np.cumsum([field.size for field in linear.fields])[:-1]

    def moved(unit: np.ndarray) -> np.ndarray:
        x, before, now = np.split(unit, [N, N + p])
        start = {Place("state", f.name): piece for f, piece in zip(linear.fields, np.split(x, ends), strict=True)}
        reading.give({**start, Place("work", "y_last"): before, Place("work", "y"): now})
        predict()
        return np.concatenate([reading.memory[Place("state", field.name)] for field in linear.fields])

    Phi, before, now = np.split(np.column_stack([moved(unit) for unit in np.eye(N + 2 * p)]), [N, N + p], axis=1)
    return Phi, before, now


def _linear(part: Ode) -> Ode:
    """The part without what is nonlinear, its adapting fields as constants."""
    linear, moving = part.linear, tuple(field for field in part.fields if field.name not in part.frozen)
    fixed = {name: ca.SX(ca.DM(values)) for name, values in part.frozen.items()}
    assert linear is not None

    def lines(values: Mapping[str, Graph], y: Graph, valid: Graph) -> dict[str, Graph]:
        return {name: line for name, line in linear({**values, **fixed}, y, valid).items() if name not in fixed}

    def nothing(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        return {field.name: ca.SX(field.size, 1) for field in moving}

    return Ode(moving, nothing, lines, derived=part.derived, tune=part.tune)
