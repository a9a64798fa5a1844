"""Dead-zone high-gain observer: a persistently small output error, such as noise, is not injected.

    w' = A w + c(w, u) + diag(theta, .., theta^n) K (e - sat e),   e = y - w_1,   |sat e| <= sqrt sigma
    sigma' = theta (-lambda sigma + r e^2),   sigma >= 0,   0 < r < lambda

in the coordinates of `integrators`, the argument of c saturated to the declared box; theta is l of the paper. For a
constant e, sigma tends to (r/lambda) e^2: without r < lambda no constant error would be injected. Source: Astolfi,
Alessandri, Zaccarian, "Stubborn and dead-zone redesign for nonlinear observers and filters", IEEE TAC 66(2) (2021).
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from hgogen.check import Claims, Verdict
from hgogen.form import Form
from hgogen.observer import Observer
from hgogen.prove.limited_injection import DEAD_ZONE, REFERENCE, limited
from hgogen.starting import starts
from hgogen.theorem import FORM, OPERATION, Hypothesis, Theorem

THEOREM = Theorem(
    "the estimate converges exponentially from any initial state, for theta large enough; noise that stays within the "
    "adapted dead zone is not injected",
    (
        *FORM,
        Hypothesis("A - K C is Hurwitz", verdict=Verdict.PROVED, reason="others are refused"),
        Hypothesis("r < lambda", verdict=Verdict.PROVED, reason="others are refused, and tuning keeps it"),
        Hypothesis("the linear core decays with its dead zone", (Claims("dead_zone", "core"),)),
        Hypothesis("theta is large enough", (Claims("dead_zone", "theta"),), reason="of its declared value"),
        *OPERATION,
    ),
    REFERENCE,
)


@starts(
    "small noise should have no effect on the estimate",
    "how fast the dead zone adapts",
    "n + 1",
    lambda s: s.high | {"decay": 1, "r": 0.3},
)
def dead_zone(
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
    """The observer w' = A w + c(w, u) + diag(theta, .., theta^n) K (e - sat e), e = y - w_1, of a chain of integrators
    (a form of one output with constant a_i); |sat e| <= sqrt sigma, sigma' = theta (-lambda sigma + r e^2).

    Checks: `dead_zone.core` (the error of the linear part w' = A w + .. decays with the dead zone, for these lambda, r,
    K); `dead_zone.convergence` (a bound on theta is proved), `dead_zone.theta` (theta is above it).

    Args: `theta` >= 1; `decay` lambda > 0 and `r`, 0 < r < lambda, both without unit; `poles` (n) of A - K C, or
    `gains` K (n) in their place; `sigma` sigma(0) >= 0 (y^2); `initial` the plant's state; `accept` ids of refuted
    checks to ignore.

    Raises: `Refuted`; `BadPoles`; `NotHurwitz`; `BadGain` for r >= decay, other numbers that do not fit, or a form that
    is no chain of integrators.
    """
    return limited(
        "dead_zone",
        DEAD_ZONE,
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
