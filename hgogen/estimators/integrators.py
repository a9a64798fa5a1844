"""A form with constant a_i as chains of integrators, the coordinates in which the papers write their observers.

    z_(i,j)' = a_(i,j+1) z_(i,j+1) + b_(i,j)(z, u),   y_i = a_(i,1) z_(i,1) + o_i(u)
    w_(i,j) = a_(i,1) .. a_(i,j) z_(i,j):   w_(i,j)' = w_(i,j+1) + c_(i,j)(w, u),   y_i = w_(i,1) + o_i(u)

c_(i,j) = a_(i,1) .. a_(i,j) b_(i,j) takes the argument of b saturated to the declared box: phi_s of the papers. The a_i
are free of inputs and states; they may contain parameters. The output error is injected into a chain through the powers
of a gain l that may vary with time,

    w' = A w + c(w, u) + D_l K i(e),   D_l = diag(l, .., l^n),   e = y - o(u) - w_1

A the shift. s^n + K_1 s^(n-1) + .. + K_n is the characteristic polynomial of A - K C; with i(e) = e the linear error
core is l D_l (A - K C) D_l^-1, whose eigenvalues are l times its roots.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.hypotheses import clamped_lipschitz
from hgogen.analysis.ranges import fixed_parameters, limit_lines, span
from hgogen.analysis.scaling import chain_errors
from hgogen.check import Check
from hgogen.estimators.gains import ScaledGain, coefficients
from hgogen.form import Form
from hgogen.graph import Graph, to_casadi
from hgogen.observer import Observer, state_field
from hgogen.part import Clock, Jump, Ode, Part, Pieces
from hgogen.program import INF, Bit, Block, Field, Place, sym
from hgogen.reading.given import BadGain, reals
from hgogen.rigor.box import exact
from hgogen.rigor.definite import demand_hurwitz
from hgogen.sentence import same
from hgogen.theorem import Theorem

T = TypeVar("T")
_INSTEAD = "take the form triangular, or the observer riccati"
_PLANT = "in chains of integrators the plant is w' = A w + c(w, u), A the shift"
_CLAMPED = f"{_PLANT}; c takes w clamped to its ranges"


@dataclass(frozen=True)
class Integrators:
    """The `form` z_i' = a_i z_(i+1) + b_i as chains of integrators, in the coordinates w_i = a_1 .. a_i z_i: w_i' =
    w_(i+1) + c_i(w, u). Each w is an SX column (n), chain after chain. `gains`: the a_i of each chain."""

    form: Form
    gains: tuple[tuple[sp.Expr, ...], ...]

    @cached_property
    def dynamics(self) -> Dynamics:
        """The right-hand sides of the form as SX graphs."""
        return Dynamics(self.form)

    @property
    def n(self) -> int:
        """Number of states."""
        return self.form.n

    @cached_property
    def products(self) -> tuple[sp.Expr, ...]:
        """The products a_1 .. a_i (n) of each chain, which scale z to w: w_i = a_1 .. a_i z_i."""
        return tuple(sp.prod(chain[: j + 1]) for chain in self.gains for j in range(len(chain)))

    @cached_property
    def scale(self) -> Graph:
        """The factors w_i/z_i (n), SX of parameters; parameters without a range are replaced by their values."""
        system = self.form.system
        places = {s: sym("plant", s.name) for s in system.parameters if s.bounded}
        fixed = {s: value for s, value in system.nominal.items() if not s.bounded}
        return ca.vertcat(*to_casadi([sp.sympify(p).subs(fixed) for p in self.products], places))

    @cached_property
    def nominal(self) -> np.ndarray:
        """The factors w_i/z_i (n) at the nominal parameters."""
        return np.array([float(p.subs(self.form.system.nominal)) for p in self.products])

    @cached_property
    def reach(self) -> np.ndarray:
        """The least and largest factors w_i/z_i (2, n) over the ranges of parameters; the nominal factor where these
        are not finite."""
        ends = []
        for product, nominal in zip(self.products, self.nominal, strict=True):
            exactly = exact(sp.sympify(product).xreplace(fixed_parameters(self.form)))
            extent = None if exactly.is_number else span(exactly, self.form)
            finite = extent if extent and extent.defined and extent.finite else None
            ends.append((finite.low, finite.high) if finite else (nominal, nominal))
        return np.array(ends).T

    def z(self, w: Graph) -> Graph:
        """Return the form's state z_i = w_i/(a_1 .. a_i) (n)."""
        return w / self.scale

    def nonlinear(self, w: Graph, u: Graph) -> Graph:
        """Return c (n) of w' = A w + c(w, u), the argument w saturated to the declared ranges."""
        return self.scale * self.dynamics.nonlinear(self.z(w), u)

    def offset(self, u: Graph) -> Graph:
        """Return o(u) (p) of the outputs y = w_1 + o(u)."""
        return self.dynamics.output(ca.SX.zeros(self.n), u)

    def saturated(self, w: Graph, i: int) -> Graph:
        """Return w_i clamped to its declared range, an SX scalar; w_i itself if it has no range."""
        if self.form.states[i].limits[0] == -INF:
            return w
        low, high = self.form.states[i].interval[:: 1 if self.nominal[i] > 0 else -1]
        return ca.fmin(ca.fmax(w, self.scale[i] * low), self.scale[i] * high)

    def field(self, initial: Mapping[str, float] | Sequence[float] | None, peak: float) -> Field:
        """Return the memory field of the estimate w (n), with the outer box of `state_field` for the gain `peak`. The
        box contains the plant's w for all parameters in their ranges. Raises: `BadGain` for a bad initial state."""
        z, scale = state_field(self.form, initial, peak), self.nominal
        ends = np.array([product * side for product in self.reach for side in (z.low, z.high)])
        names = (label if p == 1 else f"({p})*({label})" for p, label in zip(self.products, z.labels, strict=True))
        return replace(
            z,
            name="w",
            initial=tuple(map(float, scale * z.initial)),
            low=tuple(map(float, ends.min(axis=0))),
            high=tuple(map(float, ends.max(axis=0))),
            labels=tuple(names),
            periods=tuple(period and abs(s) * period for s, period in zip(scale, z.turns, strict=True))
            if z.periods
            else (),
            meaning="estimate, in chains of integrators",
        )


def shifted(w: Graph) -> Graph:
    """Return the SX column w_2, .., w_n, 0."""
    return ca.vertcat(*(w[i] for i in range(1, w.numel())), 0)


def observer_on(
    chain: Integrators,
    name: str,
    *,
    parts: tuple[Part, ...],
    gains: tuple[Field, ...],
    w: Graph,
    theorem: Theorem,
    equations: tuple[str, ...],
    reference: str,
    claims: Callable[[], tuple[Check, ...]] = tuple,
    accepted: tuple[str, ...] = (),
    traces: tuple[str, ...] = (),
    practical: bool = False,
    error: Any | None = None,
) -> Observer:
    """Return an observer on a chain, with the further arguments as in `Observer`. `w` (n): the estimate, SX of its
    state; `claims`: returns the checks beyond those of the form."""
    form = chain.form
    return Observer(
        form=form,
        name=name,
        parts=parts,
        gains=gains,
        z=chain.z(w),
        dynamics=chain.dynamics,
        claims=lambda: (*form.checks, *clamped_lipschitz(name, form), *claims()),
        accepted=accepted,
        theorem=theorem,
        equations=(*equations, *limit_lines(form), _PLANT if form.free else _CLAMPED),
        reference=reference,
        practical=practical,
        traces=traces,
        error=error,
    )


def rows(field: Field, name: str, wanted: Iterable[int], meaning: str) -> Field:
    """Return a field `name` of only those elements of `field` whose indices are in `wanted`."""
    wanted = tuple(wanted)

    def cut(values: tuple[T, ...]) -> tuple[T, ...]:
        return tuple(values[i] for i in wanted)

    return replace(
        field,
        name=name,
        meaning=meaning,
        initial=cut(field.initial),
        low=cut(field.low),
        high=cut(field.high),
        labels=cut(field.labels),
        periods=cut(field.periods) if field.periods else (),
    )


def integrators(observer: str, form: Form) -> Integrators:
    """Return the form as chains w_i' = w_(i+1) + c_i(w, u), for the observer of that name; no a_i is 0 at the nominal
    parameters. Raises: `BadGain` for another form, or several outputs."""
    if len(form.output) > 1:
        raise BadGain(observer, f"takes one output, {form.system.name} has {len(form.output)}; use riccati")
    demand_linear_rows(observer, form)
    if form.jacobian is not None:
        reason = "works in chains of integrators, this form keeps the plant's coordinates; use high_gain or riccati"
        raise BadGain(observer, reason)
    gains = form.gains
    chain = {(h + j, h + j + 1) for h, c in zip(form.heads, gains, strict=True) for j in range(len(c) - 1)}
    if any(form.A[i, j] != 0 and (i, j) not in chain for i in range(form.n) for j in range(form.n)):
        raise no_chain(observer, form)
    for names, each in zip(form.gain_names, gains, strict=True):
        for name, a in zip(names, each, strict=True):
            if a == 0:
                raise BadGain(observer, f"takes a triangular form, here {name} = 0", fix=_INSTEAD)
            if a.free_symbols - {*form.system.parameters}:
                signal = "input" if a.free_symbols & {*form.system.inputs} else "state"
                raise BadGain(f"{name} = {a}", f"depends on the {signal}, {observer} wants it constant; use riccati")
            demand_divisor(name, a, form)
    return Integrators(form, gains)


def demand_linear_rows(observer: str, form: Form) -> None:
    """Raise `BadGain` for a uniform form, whose z_i' = F_i(z_1..z_(i+1), u) may be nonlinear in z_(i+1)."""
    if form.kind == "uniform":
        fix = "use the form uniform_chain if the plant is in it, else riccati"
        raise BadGain(observer, "wants constant slopes, which a uniform form need not have", fix=fix)


def demand_divisor(name: str, a: sp.Expr, form: Form) -> None:
    """Raise `BadGain` for an a_i = `a` that is 0 or not finite at the nominal parameters: observers divide by it."""
    value = a.subs(form.system.nominal)
    if not (value.is_extended_real and value.is_finite and float(value)):
        reason = f"is {value} at the nominal parameters, and the observer divides by it; choose others, or use riccati"
        raise BadGain(f"{name} = {a}", reason)


def no_chain(observer: str, form: Form) -> BadGain:
    """Return the error for a form z' = A z + b whose A is no superdiagonal, or whose structure is not proved."""
    if form.structured:
        return BadGain(observer, f"takes a triangular form, this one is {form.kind}", fix=_INSTEAD)
    reason = f"takes a form in chains, and {form.system.name} is not shown to be in {form.kind} form"
    return BadGain(observer, reason, because=form.about("structure")[0], fix="use riccati")


GAIN_LIMITED = Bit(
    "GAIN_LIMITED",
    "the gain is at its cap; the convergence theorem, which has none, is suspended",
    "none if brief; if it stays, declare a higher cap, and a shorter dt for it",
)


def injection_gains(observer: str, poles: Any, gains: Any, n: int) -> np.ndarray:
    """Return K (n) from the `poles` of A - K C, or from `gains`; A - K C is tested exactly to be Hurwitz. Raises:
    `BadPoles`; `NotHurwitz`; `BadGain` for both or neither, or gains of another length."""
    if (poles is None) == (gains is None):
        raise BadGain(observer, "takes either the poles of A - K C or the gains K; give one of the two")
    K = coefficients(poles, n) if gains is None else reals("gains", gains)
    if K.shape != (n,) or not np.isfinite(K).all():
        raise BadGain(f"gains = {gains!r}", f"must be {n} finite numbers, one for each state")
    fix = "take the coefficients of a polynomial whose roots decay, or give poles"
    demand_hurwitz("poles" if gains is None else "gains", companion(K), fix)
    return K


def listed(K: np.ndarray) -> str:
    """Return the text "(K_1, .., K_n)", in which each number reads back as an equal float."""
    return f"({', '.join(map(same, K))})"


def companion(K: Any) -> Any:
    """Return A - K C (n, n), A the shift and C = (1, 0, .., 0), for gains K (n), floats or rationals."""
    N = np.diag(K[1:] * 0 + 1, 1)
    N[:, 0] -= K
    return N


def scaled(K: Sequence[float] | np.ndarray, level: Graph) -> Graph:
    """Return the column (l K_1, .., l^n K_n) for the SX scalar l = `level`."""
    power, gains = ca.SX(1), []
    for k in K:
        power = power * level
        gains.append(float(k) * power)
    return ca.vertcat(*gains)


def time_varying_gain(
    chain: Integrators, w: Field, K: np.ndarray, level: Field, law: Callable[[Graph], Graph] = lambda e: ca.SX(1, 1)
) -> Ode:
    """Return the part w' = A w + c(w, u) + diag(l, .., l^n) K (y - w_1) with the time-varying gain l, the field
    `level`, l' = law(y - w_1); by default l is constant between samples."""

    def linear(values: Mapping[str, Graph], y: Graph, valid: Graph) -> dict[str, Graph]:
        w_ = values[w.name]
        return {w.name: shifted(w_) + scaled(K, values[level.name]) * (valid * (y - w_[0]))}

    def remainder(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        w_ = values[w.name]
        return {w.name: chain.nonlinear(w_, u), level.name: law(valid * (y - chain.offset(u) - w_[0]))}

    return Ode((w, level), remainder, linear, chain.offset, frozen={level.name: level.high})


def capped(level: Field, bit: Bit = GAIN_LIMITED) -> Jump:
    """Return the part that raises a status bit while the gain `level` is at its cap, the upper end of its range."""
    reached = {Place("status", "GAIN_LIMITED"): sym("state", level.name) >= level.high[0]}
    return Jump(lambda clock: Pieces(bits=(bit,), adapt=(Block("has the gain reached its cap?", reached),)))


def unmodelled(form: Form) -> Jump:
    """Return the part that defines the status bits of missing samples, for an observer that has no model of w_n' and
    cannot predict."""
    bits = tuple(
        Bit(
            f"MISSING_{y}",
            f"{y} is not finite: the estimate continues at its last rates, without the model",
            "use the estimate only as long as these rates can be right; watch for a sensor that stays silent",
        )
        for y in form.system.outputs
    )
    return Jump(lambda clock: Pieces(bits=bits))


def last_error(chain: Integrators, w: Field, clock: Clock) -> Graph:
    """Return y - o(u) - w_1 at the last valid sample, with the estimate predicted to its time; SX scalar."""
    return chain.dynamics.error(sym("state", "y"), chain.offset(clock.u_now) + sym("state", w.name, chain.n)[0])


Remainder = Callable[[Mapping[str, Graph], Graph, Graph, Graph], Mapping[str, Graph]]


def injected_chains(dynamics: Dynamics, K: ScaledGain, weights: Sequence[float], remainder: Remainder) -> Ode:
    """Return the part z' = A z + K (y - C z - offset) + remainder for a form with constant A and C, without fields: the
    observer adds these, and that of K. If several outputs measure one state, the mean of their errors is injected, with
    the `weights` (p)."""
    n, still = dynamics.n, ca.SX.zeros(len(dynamics.form.system.inputs))
    A, C = dynamics.linear(still), dynamics.output_jacobian(ca.SX.zeros(n), still)

    def linear(values: Mapping[str, Graph], y: Graph, valid: Graph) -> dict[str, Graph]:
        return {"z": A @ values["z"] + K.injection(chain_errors(dynamics.form, weights, y - C @ values["z"], valid), n)}

    return Ode((), remainder, linear, lambda u: dynamics.output(ca.SX.zeros(n), u))
