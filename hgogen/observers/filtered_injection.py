"""High-gain observer with a linear filter in its output injection, which the user supplies.

    x' = A x + c(x, u) + D N H eta,   eta' = k F eta + k G (y - x_1),   D = diag(k, .., k^n),   k = theta

in the coordinates of `integrators` (A the shift), the argument of c saturated to the declared box; eta (m) of any size.
The linear error core is similar to k Q, Q = [[A, N H], [-G C, F]], which must be Hurwitz. With F = -(alpha I - k beta
A'), N = D^-1, H = diag L, G = k beta C' it is the observer `filtered` (the paper prints the opposite sign of F, which
does not decay). The same observer results from numbers free of k, F = -alpha I + beta A', N = I, H = diag L, G = beta
C': Q is then the M of `gains`. Source: Astolfi, Jungers, Zaccarian, "Output injection filtering redesign in high-gain
observers", ECC 2018, (18), (19), Theorem 2, with c_n alone; the rows c_1..c_(n-1) of a triangular form are an
extension.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from hgogen.analysis.ranges import Limits, saturated
from hgogen.check import Claims, Verdict
from hgogen.estimators.integrators import integrators, listed, observer_on, scaled, shifted
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.observer import Observer, demand_form, positive_theta
from hgogen.part import Ode
from hgogen.program import Field, sym
from hgogen.prove.filter_design import core, injected
from hgogen.prove.region import theta_checks
from hgogen.reading.given import BadGain, reals
from hgogen.rigor.definite import demand_hurwitz
from hgogen.starting import Gains, Scale, starts, two_digits, whole
from hgogen.theorem import FORM, OPERATION, Hypothesis, Theorem

REFERENCE = "Astolfi, Jungers, Zaccarian, Output injection filtering redesign in high-gain observers, ECC (2018)"
EQUATIONS = ("w' = A w + c(w, u) + diag(theta, .., theta^n) N H eta, eta' = theta F eta + theta G (y - w_1)",)
THEOREM = Theorem(
    "the estimate converges exponentially from any initial state, for theta large enough",
    (
        *FORM,
        Hypothesis(
            "Q = [[A, N H], [-G C, F]] is Hurwitz",
            verdict=Verdict.PROVED,
            reason="in exact arithmetic; others are refused",
            reference="(19)",
        ),
        Hypothesis("theta is large enough", (Claims("filtered_injection", "theta"),), reason="of its declared value"),
        *OPERATION,
    ),
    f"{REFERENCE}, Theorem 2",
)
Matrix = Sequence[Sequence[float]] | np.ndarray


def _starting(scale: Scale) -> Gains:
    """Return initial F, G, H: n first-order lags in series of gain 1/3, three times as fast as the error."""
    n, third = scale.n, two_digits(scale.corner / 3)
    F = -scale.corner * np.eye(n) + third * np.eye(n, k=-1)
    H = np.diag([math.comb(n, i) for i in range(1, n + 1)])
    rows: list[Any] = [tuple(tuple(map(whole, row)) for row in matrix.tolist()) for matrix in (F, H)]
    return {"theta": scale.theta, "F": rows[0], "G": (whole(third), *(0,) * (n - 1)), "H": rows[1]}


@starts(
    "you have a filter of your own for the output error",
    "the filter's matrices F, G, H, N; the linear error core must be Hurwitz",
    "n + filter",
    _starting,
)
def filtered_injection(
    form: Form,
    *,
    theta: float,
    F: Matrix,
    G: Sequence[float] | np.ndarray,
    H: Matrix,
    N: Matrix | None = None,
    initial: Mapping[str, float] | Sequence[float] | None = None,
    saturate: Limits = None,
    arguments: bool = True,
    accept: Iterable[str] = (),
) -> Observer:
    """The observer x' = A x + c(x, u) + D N H eta, eta' = k F eta + k G (y - x_1), D = diag(k, .., k^n), k = theta, of
    a chain of integrators (a form of one output with constant a_i); Q = [[A, N H], [-G C, F]] must be Hurwitz.

    Checks: `filtered_injection.convergence` (a bound on theta is proved), `filtered_injection.theta` (theta is above
    it).

    Args: `theta` > 0, the paper's k; `F` (m, m), `G` (m), `H` (n, m) of the filter, `N` (n, n), by default the unit
    matrix; `initial` the plant's state; `saturate` limits of the values of b, by the state of the row, and `arguments`
    whether its argument is clamped as well; `accept` ids of refuted checks to ignore.

    Raises: `Refuted`; `NotHurwitz` where Q is not; `BadGain` for theta <= 0, matrices that do not fit, or a form that
    is no chain of integrators.
    """
    accept = demand_form("filtered_injection", form, accept, requires=integrators)
    high, chain = positive_theta(theta), integrators("filtered_injection", saturated(form, saturate, arguments))
    n, level, source = chain.n, sym("gain", "theta"), reals("G", G)
    m = source.size
    source, filter_ = _matrix("G", source, (m,)), _matrix("F", F, (m, m))
    outer, inner = _matrix("N", np.eye(n) if N is None else N, (n, n)), _matrix("H", H, (n, m))
    pushed = outer @ inner
    demand_hurwitz("N, F, G, H", core(filter_, source, pushed), "choose them such that Q decays")
    eta = Field("eta", (0.0,) * m, meaning="state of the injection's filter")
    fields = (chain.field(initial, high.initial[0]), eta)

    def linear(values: Mapping[str, Graph], y: Graph, valid: Graph) -> dict[str, Graph]:
        w, eta = values["w"], values["eta"]
        return {
            "w": shifted(w) + scaled(np.ones(n), level) * (_sparse(pushed) @ eta),
            "eta": level * (_sparse(filter_) @ eta + _sparse(source) * (valid * (y - w[0]))),
        }

    def remainder(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        return {"w": chain.nonlinear(values["w"], u), "eta": ca.SX(m, 1)}

    error = injected(chain, filter_, source, pushed)
    return observer_on(
        chain,
        "filtered_injection",
        parts=(Ode(fields, remainder, linear, chain.offset),),
        gains=(high,),
        w=sym("state", "w", n),
        theorem=THEOREM,
        equations=(
            *EQUATIONS,
            f"F = {_printed(filter_)}",
            f"G = {listed(source)}",
            f"N = {_printed(outer)}",
            f"H = {_printed(inner)}",
        ),
        reference=REFERENCE,
        claims=lambda: theta_checks("filtered_injection", form, high.initial[0], error),
        accepted=accept,
        error=error,
    )


def _matrix(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    matrix = reals(name, value)
    if matrix.shape != shape or not np.isfinite(matrix).all():
        size = " x ".join(map(str, shape))
        reason = f"must be {size} finite numbers; the length of G is the filter's size"
        raise BadGain(f"{name} of shape {matrix.shape}", reason)
    return matrix


def _printed(matrix: np.ndarray) -> str:
    return f"({', '.join(map(listed, matrix))})"


def _sparse(matrix: np.ndarray) -> Graph:
    return ca.sparsify(ca.SX(ca.DM(matrix)))
