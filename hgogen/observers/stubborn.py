"""Stubborn high-gain observer: the injection of an output error is saturated at its usual size, which rejects outliers.

    w' = A w + c(w, u) + diag(theta, .., theta^n) K sat e,   e = y - w_1,   |sat e| <= sqrt sigma
    sigma' = theta (-lambda sigma + r e^2),   sigma >= 0,   lambda > 0,   r > 0

in the coordinates of `integrators`, the argument of c saturated to the declared box; theta is l of the paper. A lasting
error raises the saturation level: one sample adds theta r e^2 dt to sigma by the methods of Euler and Heun, and two
thirds of that by rk4, which interpolates e linearly between samples. Source: Astolfi, Alessandri, Zaccarian, "Stubborn
and dead-zone redesign for nonlinear observers and filters", IEEE TAC 66(2) (2021).
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from hgogen.check import Claims, Verdict
from hgogen.form import Form
from hgogen.observer import Observer
from hgogen.prove.limited_injection import REFERENCE, SATURATION, limited
from hgogen.starting import starts
from hgogen.theorem import FORM, OPERATION, Hypothesis, Theorem

THEOREM = Theorem(
    "the estimate converges exponentially from any initial state, for theta large enough; of an outlier no more than "
    "sqrt sigma is injected, which one sample of it raises by theta r e^2 dt under the root, two thirds of that by rk4",
    (
        *FORM,
        Hypothesis("A - K C is Hurwitz", verdict=Verdict.PROVED, reason="others are refused"),
        Hypothesis("the linear core decays with its saturation: r is large enough", (Claims("stubborn", "core"),)),
        Hypothesis("theta is large enough", (Claims("stubborn", "theta"),), reason="of its declared value"),
        *OPERATION,
    ),
    REFERENCE,
)


@starts(
    "the sensor has outliers",
    "how fast the saturation of the output error opens",
    "n + 1",
    lambda s: s.high | {"decay": 0.5, "r": 3},
)
def stubborn(
    form: Form,
    *,
    theta: float,
    decay: float,
    r: float,
    poles: Sequence[complex] | None = None,
    gains: Sequence[float] | np.ndarray | None = None,
    sigma: float = 0.0,
    initial: Mapping[str, float] | Sequence[float] | None = None,
    accept: Iterable[str] = (),
) -> Observer:
    """The observer w' = A w + c(w, u) + diag(theta, .., theta^n) K sat e, e = y - w_1, of a chain of integrators (a
    form of one output with constant a_i); |sat e| <= sqrt sigma, sigma' = theta (-lambda sigma + r e^2).

    Checks: `stubborn.core` (the error of the linear part w' = A w + .. decays with the saturation, for these lambda, r,
    K); `stubborn.convergence` (a bound on theta is proved), `stubborn.theta` (theta is above it).

    Args: `theta` >= 1; `decay` lambda > 0 and `r` > 0, both without unit; `poles` (n) of A - K C, or `gains` K (n) in
    their place; `sigma` sigma(0) >= 0 (y^2); `initial` the plant's state; `accept` ids of refuted checks to ignore.

    Raises: `Refuted`; `BadPoles`; `NotHurwitz`; `BadGain` for other numbers that do not fit, or a form that is no chain
    of integrators.
    """
    return limited(
        "stubborn",
        SATURATION,
        form,
        theta=theta,
        decay=decay,
        r=r,
        sigma=sigma,
        poles=poles,
        gains=gains,
        initial=initial,
        accept=accept,
        theorem=THEOREM,
    )
