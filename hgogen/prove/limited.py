"""High-gain observers that inject the output error through a saturation, or a dead zone, whose level adapts.

    w' = A w + c(w, u) + D_l K i(e),   i(e) = sat e or e - sat e,   |sat e| <= sqrt sigma,   l = theta
    sigma' = l (-lambda sigma + r e^2),   sigma >= 0

Neither has a linear error core that noise goes through: the level follows the noise. What limits the step length is the
core with all of e injected, the fastest there is, beside the decay of sigma.
"""

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np

from hgogen.analysis.dynamics import HUGE
from hgogen.check import Check
from hgogen.estimators.injection import companion, injection_gains, listed, scaled
from hgogen.estimators.integrators import Integrators, integrators, observer_on, shifted
from hgogen.form import Form
from hgogen.observer import Observer, founded, gain, high_gain_parameter
from hgogen.part import Ode
from hgogen.program import Block, Field, Place, scalar, sym
from hgogen.prove.behind_sector import Adaptation, Shape, behind, core_check, decays
from hgogen.prove.bounded_theta import Nothing, nothing
from hgogen.prove.continuous_time import claims
from hgogen.reading.given import BadGain, positive, real
from hgogen.theorem import Theorem

REFERENCE = (
    "Astolfi, Alessandri, Zaccarian, Stubborn and dead-zone redesign for nonlinear observers and filters, "
    "IEEE TAC 66(2) (2021)"
)
EQUATION = "w' = A w + c(w, u) + diag(theta, .., theta^n) K {}, |sat(e)| <= sqrt(sigma), e = y - w_1"
LEVEL = "sigma' = theta (-decay sigma + r e^2)"


def limited(
    name: str,
    shape: Shape,
    form: Form,
    *,
    theta: Any,
    decay: Any,
    r: Any,
    sigma: Any,
    poles: Sequence[complex] | None,
    gains: Sequence[float] | np.ndarray | None,
    initial: Mapping[str, float] | Sequence[float] | None,
    accept: Iterable[str],
    theorem: Theorem,
) -> Observer:
    """The observer of that name and shape; its checks `NAME.core`, `.convergence` and `.theta` are by `behind_sector`.

    Raises: `Refuted`; `BadPoles`; `NotHurwitz`; `BadGain`.
    """
    accept = founded(name, form, accept, takes=integrators)
    high, chain = high_gain_parameter(theta), integrators(name, form)
    K = injection_gains(name, poles, gains, chain.n)
    slow, fast, start = positive("decay", decay), positive("r", r), real("sigma", sigma)
    if not 0 <= start < np.inf:
        raise BadGain(f"sigma = {sigma!r}", "must be a finite number, not negative: the square of the first level")
    least = slow * 1e-3
    if shape.below:
        if not fast < slow:
            raise BadGain(f"r = {r!r}", f"must be below decay = {slow:g}, or nothing would ever be injected")
        least = (slow + fast) / 2  # so that r stays below it however they are tuned
    adaptation = Adaptation(shape, Fraction(slow), Fraction(fast))
    return observer_on(
        chain,
        name,
        parts=(_part(chain, chain.field(initial, high.initial[0]), K, high.initial[0], shape, slow, start),),
        gains=(
            high,
            gain("decay", slow, least, slow, "lambda, theta times it is the rate at which sigma decays"),
            gain("r", fast, 1e-3 * fast, fast if shape.below else 1e3 * fast, "weight of e^2 in sigma'"),
        ),
        w=sym("state", "w", chain.n),
        theorem=theorem,
        equations=(EQUATION.format(shape.text), LEVEL, f"K = {listed(K)}"),
        reference=REFERENCE,
        claims=lambda: _claims(name, chain, high.initial[0], K, adaptation),
        accepted=accept,
        traces=("sigma",),
    )


def _claims(name: str, chain: Integrators, theta: float, K: np.ndarray, adaptation: Adaptation) -> tuple[Check, ...]:
    proofs = decays(adaptation, K)
    numbers = {"theta": theta, "decay": adaptation.decay, "r": adaptation.r, "gains": K}
    sought, core = behind(chain, theta, K, proofs, numbers), core_check(name, adaptation, proofs, numbers)
    if isinstance(sought, Nothing):
        return core, *nothing(name, theta, sought.reason)
    return core, *claims(name, chain.form, sought, numbers)


def _part(chain: Integrators, w: Field, K: np.ndarray, theta: float, shape: Shape, decay: float, start: float) -> Ode:
    level = sym("gain", "theta")
    square = scalar("sigma", start, low=0.0, unit="y^2", meaning=f"square of the level of the {shape.name}")

    def rest(values: Mapping[str, Any], u: Any, y: Any, valid: Any) -> dict[str, Any]:
        w_, sigma = values["w"], values["sigma"]
        e, most = valid * (y - chain.offset(u) - w_[0]), ca.sqrt(ca.fmax(sigma, 0))
        sat = ca.fmin(ca.fmax(e, -most), most)
        return {
            "w": shifted(w_) + chain.nonlinear(w_, u) + sym("derived", "K", chain.n) * shape.injected(e, sat),
            "sigma": level * (sym("gain", "r") * (e * e) - sym("gain", "decay") * sigma),
        }

    n = chain.n
    labels = tuple(f"theta^{i} K_{i}" if i > 1 else "theta K_1" for i in range(1, n + 1))
    return Ode(
        (w, square),
        rest,
        derived=(Field("K", (0.0,) * n, labels=labels, meaning="observer gain"),),
        frozen={"sigma": (0.0 if shape.below else HUGE,)},  # all of the error is injected
        tune=(Block("observer gain", {Place("derived", "K"): scaled(K, level)}),),
        core=theta * np.block([[companion(K), np.zeros((n, 1))], [np.zeros((1, n)), -decay]]),
    )
