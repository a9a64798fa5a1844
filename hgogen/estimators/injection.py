"""The output error injected into a chain of integrators through the powers of a gain that may move.

    w' = A w + c(w, u) + D_l K i(e),   D_l = diag(l, .., l^n),   e = y - o(u) - w_1

in the coordinates of `integrators`, A the shift. s^n + K_1 s^(n-1) + .. + K_n is the characteristic polynomial of
A - K C; with i(e) = e the linear error core is l D_l (A - K C) D_l^-1, whose eigenvalues are l times its roots.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.scaling import mean
from hgogen.estimators.gains import coefficients
from hgogen.estimators.integrators import Integrators, shifted
from hgogen.estimators.scaled_gain import ScaledGain
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.part import Clock, Jump, Ode, Pieces
from hgogen.program import Bit, Block, Field, Place, sym
from hgogen.reading.given import BadGain, reals
from hgogen.rigor.definite import demand_hurwitz
from hgogen.sentence import same

GAIN_LIMITED = Bit(
    "GAIN_LIMITED",
    "the gain is at its cap; the convergence theorem, which has none, is suspended",
    "none if brief; if it stays, declare a higher cap, and a shorter dt for it",
)


def injection_gains(observer: str, poles: Any, gains: Any, n: int) -> np.ndarray:
    """K (n) from the `poles` of A - K C, or the `gains` in their place; an exact test shows that A - K C is Hurwitz.

    Raises: `BadPoles`; `NotHurwitz`; `BadGain` for both or none of the two, or gains of another length.
    """
    if (poles is None) == (gains is None):
        raise BadGain(observer, "takes either the poles of A - K C or the gains K; give one of the two")
    K = coefficients(poles, n) if gains is None else reals("gains", gains)
    if K.shape != (n,) or not np.isfinite(K).all():
        raise BadGain(f"gains = {gains!r}", f"must be {n} finite numbers, one for each state")
    fix = "take the coefficients of a polynomial whose roots decay, or give poles"
    demand_hurwitz("poles" if gains is None else "gains", companion(K), fix)
    return K


def listed(K: np.ndarray) -> str:
    """Gains for a banner, from which they can be built again."""
    return f"({', '.join(map(same, K))})"


def companion(K: Any) -> Any:
    """A - K C (n, n) of an array of gains K (n), floats or rationals."""
    N = np.diag(K[1:] * 0 + 1, 1)
    N[:, 0] -= K
    return N


def scaled(K: Sequence[float] | np.ndarray, level: Graph) -> Graph:
    """The column D_l K (n) for the SX scalar l = `level`."""
    power, gains = ca.SX(1), []
    for k in K:
        power = power * level
        gains.append(float(k) * power)
    return ca.vertcat(*gains)


def moving_gain(
    chain: Integrators, w: Field, K: np.ndarray, level: Field, law: Callable[[Graph], Graph] = lambda e: ca.SX(1, 1)
) -> Ode:
    """The observer with i(e) = e whose gain is the field `level`, l' = law(e); by default a jump moves it."""

    def linear(values: Mapping[str, Graph], y: Graph, valid: Graph) -> dict[str, Graph]:
        w_ = values[w.name]
        return {w.name: shifted(w_) + scaled(K, values[level.name]) * (valid * (y - w_[0]))}

    def rest(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        w_ = values[w.name]
        return {w.name: chain.nonlinear(w_, u), level.name: law(valid * (y - chain.offset(u) - w_[0]))}

    return Ode((w, level), rest, linear, chain.offset, frozen={level.name: level.high})


def capped(level: Field, bit: Bit = GAIN_LIMITED) -> Jump:
    """The status bit of a gain that has reached its cap, the upper end of its field."""
    reached = {Place("status", "GAIN_LIMITED"): sym("state", level.name) >= level.high[0]}
    return Jump(lambda clock: Pieces(bits=(bit,), adapt=(Block("has the gain reached its cap?", reached),)))


def unmodelled(form: Form) -> Jump:
    """What a missing sample means to an observer without the last row of the model, which has nothing to predict by."""
    bits = tuple(
        Bit(
            f"MISSING_{y}",
            f"{y} is not finite, or beyond 3e38: the estimate goes on at its last rates, without a model of them",
            "do not act on it for longer than those rates hold; watch for a sensor that stays silent",
        )
        for y in form.system.outputs
    )
    return Jump(lambda clock: Pieces(bits=bits))


def last_error(chain: Integrators, w: Field, clock: Clock) -> Graph:
    """The error y - o(u) - w_1 at the last valid sample, once the estimate has come to its time; SX scalar."""
    return sym("state", "y") - chain.offset(clock.u_now) - sym("state", w.name, chain.n)[0]


Rest = Callable[[Mapping[str, Graph], Graph, Graph, Graph], Mapping[str, Graph]]


def injected_chains(dynamics: Dynamics, K: ScaledGain, weights: Sequence[float], rest: Rest) -> Ode:
    """z' = A z + K (y - C z - offset) + rest, of a form whose A and C read no input, the errors of outputs that show
    one state in their mean by `weights` (p); the fields and K's values are left to the observer."""
    n, still = dynamics.n, ca.SX.zeros(len(dynamics.form.system.inputs))
    A, C = dynamics.linear(still), dynamics.output_jacobian(ca.SX.zeros(n), still)

    def linear(values: Mapping[str, Graph], y: Graph, valid: Graph) -> dict[str, Graph]:
        return {"z": A @ values["z"] + K.onto(mean(dynamics.form, weights, y - C @ values["z"], valid), n)}

    return Ode((), rest, linear, lambda u: dynamics.output(ca.SX.zeros(n), u))
