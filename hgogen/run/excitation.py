"""Persistence of excitation of a state-affine plant: observability Gramians of windows along a log.

    Phi' = A(u, y) Phi,  Phi(s) = I,   W(s, d) = D (integral_s^(s+d) Phi' C' R^-1 C Phi) D

along inputs and measurements, D the half-widths of the states' ranges (1 without one). With a smallest eigenvalue e a
window d determines the least observable direction with a standard deviation of 1/sqrt(e) half-widths. A log may refute
that every window makes every state observable; it proves nothing about another log. Source: `estimators.persistence`.
"""

from typing import Any

import casadi as ca
import numpy as np

from hgogen.analysis.chain import with_measured_states
from hgogen.analysis.dynamics import Dynamics
from hgogen.check import Check, ClaimId, Verdict
from hgogen.estimators.riccati_part import positive_numbers
from hgogen.form import Form
from hgogen.program import sym
from hgogen.reading.given import BadGain, Misfit, by_output, positive, reals
from hgogen.run.gramian import Gramian, window
from hgogen.sentence import because, joined
from hgogen.signal import with_times
from hgogen.system import demand_continuous

HIDDEN = 1e-12  # of the largest eigenvalue: smaller ones are rounding


def along(form: Form, R: Any, u: Any, y: Any, dt: float, d: float) -> Gramian:
    """Return the observability Gramians W of all windows of length `d` (s) along a log, for a plant in the form
    `forms.state_affine` (x' = A(u, y) x + b(u, y)).

    Args: `R` (p) the noise densities of the outputs, as for the observer, also by name, y^2 s; `u` (N, m), `y` (N, p),
    all finite, `dt` (s) apart; t is 0 at the first sample.

    Raises: `BadGain`; `Misfit` for an argument that is no form.
    """
    if not isinstance(form, Form):
        raise Misfit("excitation.along", form, "a form: hg.forms.state_affine(plant)")
    demand_continuous(form.system, "excitation.along")
    dynamics, outputs = Dynamics(form), len(form.output)
    dt, d = positive("dt", dt), positive("d", d)
    plant, m = form.system, len(form.system.supplied)
    variances = np.array(positive_numbers("R", by_output("R", R, form), outputs))
    inputs, samples = (_record(name, value, size) for name, value, size in (("u", u, m), ("y", y, outputs)))
    pieces = round(d / dt)
    if len(samples) <= pieces or pieces < 1 or (m and len(inputs) != len(samples)):
        raise BadGain(
            f"d = {d:g} {form.system.time} on {len(samples)} samples", "must be shorter than the record of u and y"
        )
    inputs = with_times(
        plant.inputs,
        inputs if m else np.zeros((len(samples), 0)),
        [0.0] * len(plant.times),
        dt * np.arange(len(samples)),
    )
    A, C = _numbers(dynamics, inputs, samples)
    half = np.array([(s.interval[1] - s.interval[0]) / 2 if s.bounded else 1.0 for s in form.states])
    steps = _pieces(A * half / half[:, None], C * half, variances, dt)
    return window(tuple(map(str, form.to_form)), steps, dt, pieces)


def shown(id: str, gramian: Gramian) -> Check:
    """Return the check with the name `id` that every window of a log makes every state observable: refuted, or unknown
    since a log proves nothing about others. Raises: `Misfit`."""
    if not isinstance(id, str):
        raise Misfit("excitation.shown, id=", id, "the name of the claim")
    if not isinstance(gramian, Gramian):
        raise Misfit("excitation.shown, gramian=", gramian, "what excitation.along gave")
    name = ClaimId("", id)
    claim = f"every window d = {gramian.d:g} of the record shows every state, to {HIDDEN:g} of the one seen best"
    share = gramian.smallest / np.maximum(gramian.largest, np.finfo(float).tiny)
    k = int(np.argmin(share))
    least, direction = float(gramian.smallest[k]), gramian.direction[k]
    weak = gramian.states[int(np.argmax(np.abs(direction)))]
    pattern = "the smallest eigenvalue, in units of the box, is {least:.2g}, mostly {weak}"
    reason = because(pattern, least=least, weak=weak)
    if share[k] > HIDDEN:
        return Check(name, claim, Verdict.UNKNOWN, joined(reason, because("a log proves nothing about another one")))
    return Check(
        name, claim, Verdict.REFUTED, reason, {"t": float(gramian.start[k])}, "Excite the plant, or wait longer."
    )


def _record(name: str, values: Any, size: int) -> np.ndarray:
    array = reals(name, values)
    if not array.ndim:
        raise BadGain(f"{name} = {values!r}", "must be a record, a row for each sample")
    array = array[:, None] if array.ndim == 1 and size == 1 else array.reshape(len(array), -1)
    if size and array.shape[1] != size:
        raise BadGain(f"{name} of shape {np.shape(values)}", f"must have {size} columns")
    if not np.isfinite(array).all():
        raise BadGain(name, "must hold numbers alone, no missing samples")
    return array


def _numbers(dynamics: Dynamics, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return A (N - 1, n, n) and C (N - 1, p, n) of x' = A x + b, y = C x,
    half way between samples u (N, m), y (N, p), at nominal parameters."""
    m, p = len(dynamics.form.system.inputs), y.shape[1]
    inputs, outputs = ca.SX.sym("u", m), ca.SX.sym("y", p)
    z = with_measured_states(dynamics)(ca.SX.zeros(dynamics.n), inputs, outputs, ca.SX.ones(p))
    graphs = [ca.densify(dynamics.affine(z, inputs)[0]), ca.densify(dynamics.output_jacobian(z, inputs))]
    plant = [s for s in dynamics.form.system.parameters if s.bounded]
    evaluate = ca.Function("pair", [inputs, outputs, *(sym("plant", s.name) for s in plant)], graphs)
    middle = [(a[:-1] + a[1:]) / 2 for a in (u, y)]
    nominal = [float(s.nominal or 0) for s in plant]
    pairs = [evaluate(*point, *nominal) for point in zip(*middle, strict=True)]
    A, C = (np.array([np.array(pair[k]) for pair in pairs]) for k in (0, 1))
    return A, C


def _pieces(A: np.ndarray, C: np.ndarray, R: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the transition matrix Phi and the observability Gramian W (N - 1, n, n) of each
    step of length `dt`, for constant A and C: the exponential to order 4, Simpson's rule."""
    weight = np.swapaxes(C, 1, 2) @ np.diag(1 / R) @ C
    hA, half = dt * A, dt / 2 * A

    def exponential(X: np.ndarray) -> np.ndarray:
        one = np.eye(X.shape[-1])
        return np.asarray(one + X @ (one + X @ (one + X @ (one + X / 4) / 3) / 2))

    middle, end = exponential(half), exponential(hA)
    parts = [weight, *(np.swapaxes(Phi, 1, 2) @ weight @ Phi for Phi in (middle, end))]
    return end, dt / 6 * (parts[0] + 4 * parts[1] + parts[2])
