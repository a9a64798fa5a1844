"""What a Kalman filter of a form is declared by: noises, a first covariance, and a first estimate, checked at the door.

Shared by the observers that carry a covariance of the plant's state with its noises as gains.
"""

from dataclasses import dataclass

import numpy as np

from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.linearised import jacobians_on_box
from hgogen.analysis.scaling import scaling
from hgogen.estimators.covariance import factor
from hgogen.estimators.riccati_part import Riccati
from hgogen.estimators.theta import Theta, constant
from hgogen.estimators.weights import cap, positive, reached_by, spd, wide
from hgogen.form import Form
from hgogen.observer import state_field
from hgogen.program import Bit, Field, sym
from hgogen.reading.given import Matrix, Values, names_of, of_coordinates, of_outputs, whole

LIMITED = Bit(
    "COVARIANCE_LIMITED",
    "the covariance reached its cap: a long loss of measurements, or Q and R much too large for the declared ranges",
    "wait for measurements; if it stays while they come, scale Q and R down together",
)


@dataclass(frozen=True, eq=False)
class Extended:
    """The filter as a part, its `gains` Q and R, and `equations`: lines for the banner, of a Q that is no diagonal."""

    part: Riccati
    gains: tuple[Field, ...]
    equations: tuple[str, ...]


def extended(
    form: Form,
    Q: Matrix,
    R: float | Values,
    covariance: Matrix | None,
    initial: Values | None,
    theta: Theta | None = None,
    tangent: bool = True,
) -> Extended:
    """The filter of what `observers.riccati` says of its arguments; theta = 1 without one. `tangent`: whether outputs
    go on by their tangents outside of the box, as Jacobians have it.

    Raises: `BadGain`, `BadNames`.
    """
    n, outputs, theta = form.n, len(form.output), theta or constant(1.0)
    dynamics = Dynamics(form, tangent)

    def reaches(noise: np.ndarray) -> bool:
        return reached_by(noise, jacobians_on_box(dynamics, 1)[0])

    noise = spd("Q", of_coordinates("Q", Q, form), n, reaches)
    start = spd("covariance", np.ones(n) if covariance is None else of_coordinates("covariance", covariance, form), n)
    variances = positive("R", of_outputs("R", R, form), outputs)
    shape, weights = factor(noise)
    z = state_field(form, initial, theta.peak)
    part = Riccati(
        dynamics=dynamics,
        z=z,
        theta=theta,
        weights=sym("gain", "Q", n),
        factor=shape,
        R=sym("gain", "R", outputs),
        covariance=start,
        cap=cap(dynamics, z, noise, variances, start, theta.peak, scaling(form, theta.scaled)),
        limited=LIMITED,
        nominal=(noise, np.array(variances)),
    )
    gains = (
        wide("Q", weights, "process noise, diagonal factor", "z^2/s", form.names),
        wide("R", variances, "output noise", "y^2 s", names_of(form.system.outputs)),
    )
    return Extended(part, gains, whole("Q", noise, form))
