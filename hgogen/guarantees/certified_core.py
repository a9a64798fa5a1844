"""Certified lower bound on theta of an estimator with a linear error core of its own, on a chain of integrators.

    w_i' = w_(i+1) + c_i(w, u),   y = w_1;   x' = M_theta x + B y + G c(E x, u),   c with its argument clamped

Field x_k estimates w_i(k), or belongs to the estimator alone; E picks one field for each w_i; c_i(k) enters where it is
fed. In the errors e_k = s_i(k) theta^-p(k) (x_k - w_i(k)), p(k) = i(k) - 1 for fields that estimate, the core is
theta N, N constant. Then, with P > 0, N'P + P N <= -I at every vertex of a polytope that holds N, and G the 0/1 matrix
of what is fed, the error converges exponentially for every

    theta > max(1, 2 |P G| L_b),   L_b >= |S dc/dw S^-1| on the box.

Proof. e' = theta N e + G d, d = S_theta (c(sat E x) - c(w)), S_theta = diag(s_i theta^(1-i)); as for a constant gain
(`certified`) |d| <= L_b |S_theta (E x - w)| <= L_b |e|, E picking different fields. V = e'P e has V' <=
-(theta - 2 |P G| L_b) |e|^2. N may move inside the polytope: a saturation of a field to the range of its w_i(k), in
which the plant is, is a factor in [0, 1] on the field's error, and N is affine in these factors.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import sympy as sp

from hgogen.algebra.definite import Matrix, exact, number, positive, rationals, unit
from hgogen.chains.integrators import Integrators
from hgogen.evidence.enclosing import Steep
from hgogen.evidence.grounds import Evidence
from hgogen.form import Form
from hgogen.guarantees.bounded_theta import Nothing
from hgogen.guarantees.certified import GROWTHS, slope
from hgogen.guarantees.lmi import Lyapunov, NoSolver, common
from hgogen.intervals import outward
from hgogen.intervals.digits import Up
from hgogen.sentence import Reason, because
from hgogen.structure.polytope import chains

# Beyond these the exact Lyapunov equation, or the inequality's program, is too large for a check that answers at once.
FIELDS = 14
VERTICES = 16
_SLACK = Fraction(1, 2**16)


@dataclass(frozen=True)
class Layout:
    """The fields of an estimator in its core's order: `index` (N), i(k) from 0, by whose units a field is scaled;
    `power` (N), p(k); `fed` (N): whether c_i(k) enters; `picks` (n): the field that stands for w_i where c reads it."""

    index: tuple[int, ...]
    power: tuple[int, ...]
    fed: tuple[bool, ...]
    picks: tuple[int, ...]


@dataclass(frozen=True)
class CoreBound:
    """A proof that every theta > `theta` = max(1, 2 `push` `lipschitz`) converges, where `push` >= |P G|.

    `steep` proves the bound `lipschitz`, in units s_i; `numbers` are what the observer is built with.
    """

    theta: Fraction
    lyapunov: Lyapunov
    push: Fraction
    lipschitz: Fraction
    steep: Steep
    numbers: Mapping[str, Any]

    def evidence(self, form: Form) -> Evidence:
        """The matrix P for the core in scaled coordinates, |P G|, and the bound of dc/dw in them."""
        return {"P": self.lyapunov.P, "push": self.push, "slope": self.steep}

    def rate(self, theta: float) -> float:
        """r (1/s) with |error(t)| <= c exp(-r t) |error(0)| at a theta above the bound; it is rounded down."""
        return outward.number((Fraction(theta) - 2 * self.push * self.lipschitz) / (2 * self.lyapunov.peak))[0]

    @property
    def reason(self) -> Reason:
        """How the bound comes about."""
        pattern = "{theta} = max(1, 2 |P G| L_b), |P G| <= {push}, L_b <= {L_b} in scaled states"
        return because(pattern, theta=Up(self.theta), push=Up(self.push), L_b=Up(self.lipschitz))

    def __str__(self) -> str:
        return str(self.reason)


def of_core(
    chain: Integrators, layout: Layout, vertices: Iterable[np.ndarray], numbers: Mapping[str, Any]
) -> CoreBound | Nothing:
    """The bound of an estimator on a chain with the cores `vertices` (N, N) at theta = 1, floats taken as they are, of
    the `numbers` that it is built with, by name.

    The scales are searched among geometric ones: s_i = s_1 g^(i-1) in the units of z.
    """
    cores = tuple(map(rationals, vertices))
    if len(layout.index) > FIELDS or len(cores) > VERTICES:
        pattern = "the bound is computed for up to {fields} fields and {vertices} vertices of the core"
        return Nothing(because(pattern, fields=FIELDS, vertices=VERTICES))
    units = nominal_units(chain)
    if isinstance(units, Nothing):
        return units
    best: CoreBound | Nothing = Nothing(because("no scale was tried"))
    for growth in GROWTHS[: 4 if len(cores) == 1 else 2]:  # each costs a convex program where there are several
        bound = _scaled(chain, layout, cores, tuple(u * growth**i for i, u in enumerate(units)), numbers)
        if isinstance(bound, Nothing):
            return best if isinstance(best, CoreBound) else bound
        if isinstance(best, Nothing) or bound.theta < best.theta:
            best = bound
    return best


def _scaled(
    chain: Integrators,
    layout: Layout,
    cores: tuple[Matrix, ...],
    units: tuple[Fraction, ...],
    numbers: Mapping[str, Any],
) -> CoreBound | Nothing:
    """The bound with the scales s_i given."""
    scale = from_form(chain.form, units)
    steep = slope(chain.form, scale)
    if isinstance(steep, Nothing):
        return steep
    assert steep.high is not None
    t = [units[i] for i in layout.index]
    fields = range(len(t))
    moved = (tuple(tuple(t[i] * N[i][j] / t[j] for j in fields) for i in fields) for N in cores)
    try:
        lyapunov = common(moved)
    except NoSolver as missing:
        return Nothing(missing.reason)
    if lyapunov is None:
        return Nothing(because("no P with N'P + P N <= -I was found for the core"))
    push = _push(lyapunov.P, layout)
    theta = max(Fraction(1), 2 * push * steep.high)
    return CoreBound(theta, lyapunov, push, steep.high, Steep(units, scale, steep), numbers)


def nominal_units(chain: Integrators) -> list[Fraction] | Nothing:
    """The s_i (n) near 1/(a_1 .. a_i) at the nominal parameters, in which w is near z; or why there are none."""
    units = [Fraction(f"{float(1 / product):.6g}") for product in chain.nominal]
    if any(unit_ <= 0 for unit_ in units):
        return Nothing(because("the bound is for a_i shown to be positive"))
    return units


def from_form(form: Form, units: Sequence[Fraction]) -> tuple[sp.Expr, ...]:
    """s_i a_1 .. a_i (n) of each chain, which scale z to s_i w_i."""
    products = (sp.Mul(*each[: i + 1]) for each in chains(form) for i in range(len(each)))
    return tuple(sp.Rational(s) * product for s, product in zip(units, products, strict=True))


def _push(P: Matrix, layout: Layout) -> Fraction:
    """A short rational above |P G|: its square less G'P^2 G is positive definite, in exact arithmetic."""
    n = max(layout.index) + 1
    fed = [[k for k in range(len(P)) if layout.fed[k] and layout.index[k] == i] for i in range(n)]
    columns = exact([[sum((P[row][k] for k in each), Fraction(0)) for each in fed] for row in range(len(P))])
    gram = columns.transpose() * columns
    size = float(np.linalg.norm([[float(sum(P[row][k] for k in each)) for each in fed] for row in range(len(P))], 2))
    bound = Fraction(f"{size:.6g}") + Fraction(1, 2**60)
    while not positive(unit(n) * number(bound * bound) - gram):
        bound *= 1 + _SLACK
    return bound
