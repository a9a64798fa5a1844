"""High-gain extended Kalman filter with constant, decaying or adaptive theta.

    z' = A(u) z + b(z, u) + S^-1 C' R_theta^-1 (y - C z)
    S' = -(A + b*)' S - S (A + b*) + C' R_theta^-1 C - S Q_theta S
    Q_theta = theta Delta^-1 Q Delta^-1,  R_theta = R/theta,  Delta = diag(1, 1/theta, ..., 1/theta^(n-1))

theta = 1 is the extended Kalman filter; theta adapts to the innovation over a sliding window. Source: Boizot, Busvelle,
Gauthier, "An adaptive high-gain observer for nonlinear systems", Automatica 46 (2010), (4)-(6). The observer of the
paper is continuous; the default method realises it as continuous-discrete (the authors' ECC 2009 paper).
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from hgogen.check import Check, Verdict
from hgogen.clamped import clamped
from hgogen.covariance import factor
from hgogen.dynamics import Dynamics
from hgogen.form import Form
from hgogen.kalman_theorems import OTHER_COORDINATES
from hgogen.observer import HUGE, BadGain, Observer, Riccati, founded, gain, reals, state_field
from hgogen.program import Field, sym
from hgogen.stability import steady_covariance
from hgogen.theta import Theta, constant

REFERENCE = "Boizot, Busvelle, Gauthier, An adaptive high-gain observer for nonlinear systems, Automatica 46 (2010)"
EQUATIONS = (
    "z' = A(u) z + b(z, u) + S^-1 C' R_theta^-1 (y - C z)",
    "S' = -(A + b*)' S - S (A + b*) + C' R_theta^-1 C - S Q_theta S",
    "P = S^-1, Q_theta = theta Delta^-1 Q Delta^-1, R_theta = R/theta, Delta = diag(1, 1/theta, ..)",
)


def riccati(
    form: Form,
    *,
    Q: Sequence[float] | np.ndarray,
    R: float | Sequence[float],
    theta: Theta | float = 1.0,
    initial: Mapping[str, float] | Sequence[float] | None = None,
    covariance: Sequence[float] | np.ndarray | None = None,
    accept: Iterable[str] = (),
) -> Observer:
    """The high-gain extended Kalman filter of `form`.

    Args: `Q` diagonal (n) or symmetric positive definite (n, n), in the form's coordinates, unit z^2/s; `R` positive,
    one for each output, unit y^2 s (spectral densities: for white noise of variance v per sample, R = v dt); `theta` a
    number or a value of `hgogen.theta`; `initial` the plant's state (by name, or n numbers in the plant's order);
    `covariance` P(0) = S(0)^-1, diagonal (n) or (n, n), default the unit matrix; `accept` ids of refuted checks to
    build on all the same.

    Checks: `riccati.convergence` (unknown); `riccati.lipschitz` in coordinates other than the plant's states (b on the
    whole box of z).

    Raises: `Refuted` for a refuted hypothesis that is not accepted; `BadGain`; `Singular` for a model whose Jacobian is
    not finite somewhere on the box.
    """
    accept = founded("riccati", form, accept)
    theta = theta if isinstance(theta, Theta) else constant(theta)
    n, outputs = form.n, len(form.output)
    if outputs > 1 and theta.peak != 1:
        raise BadGain(f"theta up to {theta.peak:g}", f"is defined for one output, {form.system.name} has {outputs}")
    noise, start = spd("Q", Q, n), spd("covariance", np.ones(n) if covariance is None else covariance, n)
    given = reals("R", R)
    variances = tuple(map(float, given if given.ndim else [given] * outputs))
    if given.ndim > 1 or len(variances) != outputs:
        raise BadGain(f"R of shape {given.shape}", f"must have one number for each of {outputs} outputs")
    shape, weights = factor(noise)
    if any(not HUGE**-2 <= value <= HUGE**2 for value in variances):
        raise BadGain(f"R = {R}", f"must be positive, from {HUGE**-2:g} to {HUGE**2:g}")
    top, bottom = 1e6, 1e-6
    gains = (
        gain(
            "Q",
            weights,
            bottom * weights.min(),
            top * weights.max(),
            "process noise, diagonal factor",
            "z^2/s",
        ),
        gain(
            "R",
            variances if outputs > 1 else variances[0],
            bottom * min(variances),
            top * max(variances),
            "output noise",
            "y^2 s",
        ),
        *theta.gains,
    )
    dynamics = Dynamics(form)
    z = state_field(form, initial, theta.peak)
    part = Riccati(
        dynamics=dynamics,
        z=z,
        theta=theta,
        weights=sym("gain.Q", n),
        factor=shape,
        R=sym("gain.R", outputs),
        covariance=start,
        cap=_cap(dynamics, z, noise, variances, start, theta.peak),
        nominal=(noise, np.array(variances)),
    )
    return Observer(
        form=form,
        name="riccati",
        parts=(part, *theta.parts(dynamics, z)),
        gains=gains,
        z=sym("state.z", n),
        dynamics=dynamics,
        checks=(*form.checks, *clamped("riccati", form), _theorem(theta)),
        accepted=accept,
        theorem=theta.theorem if form.jacobian is None else theta.theorem.under(OTHER_COORDINATES),
        equations=(*EQUATIONS, theta.equation),
        reference=REFERENCE,
        traces=theta.traces,
    )


def _cap(
    dynamics: Dynamics, z: Field, noise: np.ndarray, variances: Sequence[float], start: np.ndarray, peak: float
) -> np.ndarray:
    """The largest P_ii (n) that is not absurd: the square of the outer box's half-width, a hundred times the steady
    variance at the largest theta anywhere in the box, and four times P(0); without a range, 1e12 P(0).
    """
    half = np.array([(high - low) / 2 for low, high in z.box])
    cap = np.where(np.isfinite(half), half**2, 1e12 * np.diag(start))
    F, C = dynamics.linearised(12)
    steady = np.diagonal(steady_covariance(F, C, noise, np.array(variances), peak), axis1=1, axis2=2)
    largest = np.nanmax(np.where(np.isfinite(steady), steady, 0.0), axis=0)
    return np.asarray(np.minimum(np.maximum.reduce([cap, 100 * largest, 4 * np.diag(start)]), HUGE * HUGE))


def spd(name: str, value: Any, n: int) -> np.ndarray:
    """A diagonal (n) or a matrix (n, n) as symmetric positive definite matrix.

    Raises: `BadGain`.
    """
    matrix = reals(name, value)
    if matrix.ndim == 1:
        matrix = np.diag(matrix)
    if matrix.shape != (n, n):
        raise BadGain(f"{name} of shape {np.shape(value)}", f"must be a diagonal of {n} numbers or a {n} x {n} matrix")
    if not (np.abs(matrix) <= HUGE**2).all():
        raise BadGain(name, f"must be finite, none of its numbers beyond {HUGE**2:g}")
    if not np.allclose(matrix, matrix.T, rtol=1e-12, atol=0):
        raise BadGain(name, "must be symmetric")
    if np.linalg.eigvalsh(matrix).min() <= 0:
        raise BadGain(name, "must be positive definite; a state believed constant takes a small positive number")
    return matrix


def _theorem(theta: Theta) -> Check:
    return Check(
        "riccati.convergence",
        theta.theorem.conclusion,
        Verdict.UNKNOWN,
        "the theorem's constants are existential: no number for theta, d, gamma can be proved from it",
        fix="validate by trials over noise seeds and jumps",
    )
