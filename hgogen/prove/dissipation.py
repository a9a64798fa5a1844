"""The error of an observer as a system driven by disturbances, and its L2 gain by a Hamilton-Jacobi inequality.

    x' = f(x, u) + G1(x) w,   y = h(x, u) + G2(x) w,   xhat' = f(xhat, u) + l(xhat, u) (y - h(xhat, u))
    e = x - xhat:   e' = f(x) - f(x - e) - l(x - e) (h(x) - h(x - e)) + (G1(x) - l(x - e) G2(x)) w

The observer may also have any other equations, with inputs w that it does not know,

    x' = f(x, u, w),   y = h(x, u, w),   xhat' = g(xhat, y, u)
    e' = f(x, u, w) - g(x - e, h(x, u, w), u) = F(e, x, u) + G(e, x, u) w

This equation may be restricted to an invariant set x_k = a_k(x) of the plant: f_k = sum_j da_k/dx_j f_j on it. It holds
wherever both sides have a value. Nothing is saturated: where x - e leaves the ranges of x, the expressions of f, h and
l still apply. Source: Alessandri, "On Hamilton-Jacobi approaches to state reconstruction for dynamic systems",
Mathematical Problems in Engineering (2020), (19), (24), (25), (29), (30).

    V(0) = 0,  V(e) > 0,   dV/de F(e, x) + |dV/de G(e, x)|^2/(2 mu^2) + |e|^2/2 < 0     for e other than 0

gives V' <= -|e|^2/2 + mu^2 |w|^2/2 along e' = F + G w: input-to-state stability, with the L2 gain mu from w to e, while
e is where it holds. If it holds on a box of e, e remains in the part of {V <= level} in the box, which touches none of
its faces, as long as V(e(0)) + mu^2/2 times the integral of |w|^2 is below the level.

With V_ee the Hessian of V and F_e the Jacobian of F, V_e(e) and F(e) are averages of V_ee e and F_e e over the segment
from 0 to e, and P G G'P is a convex function of P: the left side is at most - e'N e, N an average of

    N(c, d) = -(V_ee(c) F_e(d) + F_e(d)'V_ee(c) + V_ee(c) G G'V_ee(c)/mu^2 + I)/2

over such points c and d, which `rigor.slope` decides. Source: the same, theorem 1, (21), (38), (39).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

import sympy as sp

from hgogen.analysis.evidence import Evidence, bisection_text, end_text, text_with_names
from hgogen.analysis.undefined import equations_as_written
from hgogen.check import Check, ClaimId, Verdict
from hgogen.errors import BadArgument
from hgogen.form import Form
from hgogen.reading.given import (
    BadNames,
    Misfit,
    demand_limits,
    in_order,
    names_of,
    quadratic,
    requires_plant,
    signals_named,
)
from hgogen.rigor.bounds import Proof, bound
from hgogen.rigor.box import Box, box, exact, sign_at
from hgogen.rigor.definite import symmetric, unsymmetric
from hgogen.rigor.field import is_zero
from hgogen.rigor.search import is_defined
from hgogen.rigor.singular import lost_part, mapped_parts
from hgogen.rigor.slope import JUMPS, KINKS, Answer, SecondOrder, lipschitz_bound, negative
from hgogen.sentence import NONE, Down, Reason, because, down, up
from hgogen.signal import Signal
from hgogen.system import System

_NOT_INVARIANT = "is not kept by the plant: its flow leaves it"


class BadErrorSystem(BadArgument):
    """The error that parts of an error system do not fit together; the message names the part and the fix."""


@dataclass(frozen=True)
class Injection:
    """The matrices of an observer xhat' = f(xhat) + l (y - h(xhat)) and of the disturbances w in x' = f(x) + G1 w, y =
    h(x) + G2 w: `gain` l (n, p), `G1` (n, k), `G2` (p, k), whose entries are expressions of the plant's signals."""

    gain: sp.ImmutableDenseMatrix
    G1: sp.ImmutableDenseMatrix
    G2: sp.ImmutableDenseMatrix

    @property
    def names(self) -> frozenset[sp.Symbol]:
        """The symbols that occur in `gain`, `G1` and `G2`."""
        return frozenset().union(*(M.free_symbols for M in (self.gain, self.G1, self.G2)))


@dataclass(frozen=True)
class Equations:
    """An observer xhat' = g(xhat, y, u) with any right-hand side. `observer`: g (n), in which the plant's states mean
    their estimates; `outputs`: the plant's y; `unknown`: inputs that the observer does not know; `along`: pairs (x_k,
    a_k) of the invariant set x_k = a_k(x) in which the plant runs."""

    observer: tuple[sp.Expr, ...]
    outputs: tuple[Signal, ...]
    unknown: tuple[Signal, ...]
    along: tuple[tuple[Signal, sp.Expr], ...] = ()

    @property
    def names(self) -> frozenset[sp.Symbol]:
        """The symbols that occur in the observer's rows, the unknown inputs and the pairs of `along`."""
        read = frozenset().union(*(e.free_symbols for e in (*self.observer, *(a for _, a in self.along))))
        return read.union(self.unknown, (x for x, _ in self.along))

    @property
    def condition(self) -> str:
        """The text "x_k = a_k and .." of the invariant set, "" without one."""
        return " and ".join(f"{x} = {sp.sstr(a)}" for x, a in self.along)


@dataclass(frozen=True)
class ErrorSystem:
    """The error system e' = flow(e, x) + noise(e, x) w, where flow = 0 at e = 0 and w are disturbances.

    `errors`: the symbols e (n); `flow` (n); `noise` (n, k); `box`: the closed range of every other symbol; `states`:
    the x (n) that belong to the e, where x - e is the estimate, or none; `origin`: its construction from a plant, None
    for an error system from the user; `lost`: a part of the plant that cancels in e' and may have no value on the box;
    `caveat`: a reason why it may differ from the error system of the plant as first declared, or `NONE`. Raises:
    `BadErrorSystem`.
    """

    name: str
    errors: tuple[sp.Symbol, ...]
    flow: tuple[sp.Expr, ...]
    noise: sp.ImmutableDenseMatrix
    box: Box = field(default_factory=dict, hash=False)
    states: tuple[sp.Symbol, ...] = ()
    origin: Injection | Equations | None = None
    lost: sp.Expr | None = None
    caveat: Reason = NONE

    def __post_init__(self) -> None:
        """Make numbers exact, and check lengths and symbols."""
        errors, n = tuple(self.errors), len(self.errors)
        noise = sp.ImmutableDenseMatrix(self.noise)
        object.__setattr__(self, "errors", errors)
        object.__setattr__(self, "flow", tuple(exact(sp.sympify(row)) for row in self.flow))
        object.__setattr__(self, "noise", noise.applyfunc(exact))
        if not errors or len(self.flow) != n or noise.rows != n:
            lengths = f"{n} errors, {len(self.flow)} rows of flow and {noise.rows} of noise"
            raise BadErrorSystem(self.name, f"has {lengths}; give one of each for every error")
        if any(not e.is_real for e in errors):
            raise BadErrorSystem(self.name, "has errors that are no real symbols; write sp.symbols('e1 e2', real=True)")
        known = {*errors, *self.box}
        strange = sorted(map(str, (sp.Tuple(*self.flow).free_symbols | noise.free_symbols) - known))
        if strange:
            raise BadErrorSystem(self.name, f"uses {strange[0]}, which is no error and has no range; put it in the box")

    @property
    def plain(self) -> Box:
        """The ranges, by symbol, of states, inputs and parameters: `box` without the errors."""
        return {s: ends for s, ends in self.box.items() if s not in self.errors}

    @property
    def aliases(self) -> dict[str, str]:
        """The name of the error of each state, by the name of the state."""
        return {x.name: e.name for x, e in zip(self.states, self.errors, strict=bool(self.states))}


@requires_plant
def error_system(plant: System, gain: Any, G1: Any = None, G2: Any = None) -> ErrorSystem:
    """Return the error system of the observer xhat' = f(xhat, u) + gain (y - h(xhat, u)) on the plant x' = f + G1 w, y
    = h + G2 w, with errors named e_STATE.

    Args: `gain` l (n, p): numbers, or expressions of the plant's states, which mean the estimate here, inputs and
    parameters (for one output a sequence of n); `G1` (n, k), `G2` (p, k): expressions of states, inputs and parameters,
    by default (I, 0) and (0, I), which is a disturbance on every row of f and on every output. Rows, and columns of
    `gain`, may be given by the names of states and outputs. Inputs, parameters and states have their declared ranges; a
    parameter without one has its value.

    Raises: `Misfit`; `BadNames`; `BadErrorSystem` for matrices of another shape.
    """
    if plant.wraps:
        raise BadErrorSystem(plant.name, f"has no error system: {plant.wraps}; leave periods and invariants out")
    n, p = len(plant.states), len(plant.outputs)
    states, outputs = names_of(plant.states), names_of(plant.outputs)
    by_row = in_order("gain", gain, states)
    if by_row is not gain:
        by_row = [in_order(f"gain of {x}", row, outputs) for x, row in zip(states, by_row, strict=True)]
    ell = _matrix("gain", by_row, (n, p), plant)
    first = sp.eye(n).row_join(sp.zeros(n, p)) if G1 is None else G1
    G_1 = _matrix("G1", in_order("G1", first, states), (n, None), plant)
    second = sp.zeros(p, n).row_join(sp.eye(p)) if G2 is None and G1 is None else sp.zeros(p, G_1.cols)
    G_2 = _matrix("G2", second if G2 is None else in_order("G2", G2, outputs), (p, G_1.cols), plant)
    errors = tuple(sp.Symbol(f"e_{x}", real=True) for x in plant.states)
    estimate = {x: x - e for x, e in zip(plant.states, errors, strict=True)}
    fixed = {s: value for s, value in plant.nominal.items() if not s.bounded}
    f, h, behind = sp.Matrix(plant.flow), sp.Matrix(plant.output), ell.xreplace(estimate)
    flow = f - f.xreplace(estimate) - behind * (h - h.xreplace(estimate))
    noise = G_1 - behind * G_2
    signals = (*plant.states, *plant.inputs, *plant.parameters)
    around = box(signals, plant.nominal)
    return ErrorSystem(
        plant.name,
        errors,
        tuple(flow.xreplace(fixed)),
        noise.xreplace(fixed).as_immutable(),
        {s: ends for s, ends in around.items() if s not in fixed},
        plant.states,
        Injection(*(M.as_immutable() for M in (ell, G_1, G_2))),
        lost_part(equations_as_written(plant), flow, around),
        plant.caveat,
    )


def _matrix(name: str, entries: Any, shape: tuple[int, int | None], plant: System) -> sp.Matrix:
    rows, columns = shape
    try:
        if columns == 1 and isinstance(entries, Sequence) and not any(isinstance(row, Sequence) for row in entries):
            entries = [[row] for row in entries]
        matrix = sp.Matrix(entries).applyfunc(lambda value: exact(sp.sympify(value)))
    except (ValueError, TypeError, sp.SympifyError):
        reason = f"is no matrix; give {rows} rows of numbers or expressions"
        raise BadErrorSystem(f"{name} = {entries!r}", reason) from None
    if matrix.rows != rows or (columns is not None and matrix.cols != columns):
        wanted = f"{rows} x {'k' if columns is None else columns}"
        raise BadErrorSystem(f"{name} of shape {matrix.shape}", f"must be {wanted}")
    strange = matrix.free_symbols - {*plant.states, *plant.inputs, *plant.parameters}
    if strange:
        raise BadErrorSystem(name, f"uses {min(map(str, strange))}, which is none of the plant's signals")
    return matrix


def _error_box(system: ErrorSystem, within: Any) -> Box:
    """Return the box of the errors by symbol, from half widths (n) or ranges (low, high), low < 0 < high: a sequence in
    the order of the errors, or a mapping by the name of the error or of its state. Raises: `BadErrorSystem`,
    `BadNames`."""
    errors, names = system.errors, names_of(system.errors)
    values = in_order("within", within, names, aliases=system.aliases)
    values = list(values) if isinstance(values, Sequence) else [values]
    if len(values) != len(errors):
        wanted = f"must have a half width for each of {', '.join(names)}"
        raise BadErrorSystem(f"within of length {len(values)}", wanted)
    return {e: _ends(e.name, value) for e, value in zip(errors, values, strict=True)}


def _ends(name: str, value: Any) -> tuple[Any, Any]:
    fix = "give a half width above 0, or a range (low, high) with low < 0 < high"
    pair = tuple(value) if isinstance(value, Sequence) and not isinstance(value, str) else (-value, value)
    try:
        low, high = (exact(sp.sympify(end)) for end in pair)
        if not (low.is_Rational and high.is_Rational and low < 0 < high):
            raise ValueError
    except (ValueError, TypeError, AttributeError, sp.SympifyError):
        raise BadErrorSystem(f"within: the range {value!r} of {name}", f"is none around 0; {fix}") from None
    return Fraction(low), Fraction(high)


@requires_plant
def observer_errors(
    plant: System, observer: Any, *, unknown: Iterable[Any] | Signal | str, along: Mapping[Any, Any] | None = None
) -> ErrorSystem:
    """Return the error system of an observer xhat' = g(xhat, y, u) of any form on the plant, with errors named e_STATE.

    Args: `observer`: g (n), expressions of the plant's states, which mean the estimate here, outputs, known inputs and
    parameters, in the order of the states or by their names; `unknown`: the inputs that the observer does not know, or
    their names, or a single one: they are the disturbances w; `along`: the states that are functions of others while
    the plant runs, by name, such as {"x2": x1**2}.

    Raises: `Misfit`; `BadNames`; `BadGain` for an `unknown` that is no name; `BadErrorSystem` where `along` is not
    invariant, or the error system is not affine in w.
    """
    states = names_of(plant.states)
    rows = [_expression("observer", row) for row in in_order("observer", observer, states)]
    if len(rows) != len(states):
        raise BadErrorSystem(f"observer of length {len(rows)}", f"must have a row for each of {', '.join(states)}")
    w = signals_named(
        "unknown",
        unknown,
        plant.inputs,
        lambda name, fix: BadNames("unknown", f"names {name!r}, which is none of the inputs; {fix}"),
    )
    constraints = _along(plant, along or {})
    known = {*plant.states, *plant.outputs, *plant.parameters, *plant.inputs} - {*w}
    if strange := sorted(map(str, sp.Tuple(*rows).free_symbols - known)):
        raise BadErrorSystem("observer", f"uses {strange[0]}, which is no state, output, known input or parameter")
    equations = Equations(tuple(rows), tuple(plant.outputs), w, constraints)
    return _error_system(plant, equations)


def _error_system(plant: System, equations: Equations) -> ErrorSystem:
    fixed = {s: value for s, value in plant.nominal.items() if not s.bounded}
    errors = tuple(sp.Symbol(f"e_{x}", real=True) for x in plant.states)
    estimate = {x: x - e for x, e in zip(plant.states, errors, strict=True)}
    known = estimate | dict(zip(plant.outputs, plant.output, strict=True))
    on, signals = dict(equations.along), (*plant.states, *plant.inputs, *plant.parameters)

    def on_way(e: sp.Expr) -> sp.Expr:
        return exact(e.xreplace(fixed).xreplace(on))

    def reduced(e: sp.Expr) -> sp.Expr:
        return _cancelled(on_way(e), plant)

    around = {s: ends for s, ends in box(signals, plant.nominal).items() if s not in fixed}
    for x, a in equations.along:
        drift = sum((x - a).diff(other) * rate for other, rate in zip(plant.states, plant.flow, strict=True))
        if fault := _fault(a, fixed, around) or ("" if reduced(drift) == 0 else _NOT_INVARIANT):
            raise BadErrorSystem(f"along {x} = {a}", fault)
    rates = [reduced(f - g.xreplace(known)) for f, g in zip(plant.flow, equations.observer, strict=True)]
    flow = [reduced(rate.xreplace(dict.fromkeys(equations.unknown, sp.S.Zero))) for rate in rates]
    noise = [[reduced(rate.diff(w)) for w in equations.unknown] for rate in rates]
    for x, rate, drift, pushed in zip(plant.states, rates, flow, noise, strict=True):
        driven = sum(p * w for p, w in zip(pushed, equations.unknown, strict=True))
        if not is_zero(rate - drift - driven, around):
            raise BadErrorSystem(f"e_{x}' = {rate}", "is not shown to be affine in the unknown inputs")
    others = {s: ends for s, ends in around.items() if s not in {*equations.unknown, *on}}
    pushes = sp.ImmutableDenseMatrix(len(noise), len(equations.unknown), [entry for row in noise for entry in row])
    # not of the observer's own: without a value of it there is no estimate to speak of, as of x/sqrt(y) at y = 0
    part = lost_part(mapped_parts(equations_as_written(plant), on_way), (*flow, *pushes), around)
    return ErrorSystem(
        plant.name, errors, tuple(flow), pushes, others, origin=equations, lost=part, caveat=plant.caveat
    )


def _cancelled(e: sp.Expr, plant: System) -> sp.Expr:
    """Return the expression with common factors cancelled; symbols with a
    range >= 0 count as nonnegative, so that roots of squares simplify."""
    signs = {s: "nonnegative" if s.low is not None and s.low >= 0 else "real" for s in plant.signals}
    real = {s: sp.Dummy(s.name, **{sign: True}) for s, sign in signs.items()}
    return sp.cancel(e.xreplace(real)).xreplace({dummy: s for s, dummy in real.items()})


def _fault(a: sp.Expr, fixed: Mapping[sp.Symbol, sp.Expr], around: Box) -> str:
    """Return why x_k = a(x), one of `along`, may jump, or "": its derivative would miss the jump."""
    if a.has(*JUMPS):
        return "may jump; write it with Abs, Min and Max"
    # such as atan(tan(x)) at a pole
    defined = is_defined(a.xreplace(fixed), around)
    return "" if defined else "may have no value on the box, and jump there; narrow the ranges"


def _along(plant: System, along: Mapping[Any, Any]) -> tuple[tuple[Signal, sp.Expr], ...]:
    states = {x.name: x for x in plant.states}
    constraints = {str(getattr(key, "name", key)): _expression("along", value) for key, value in along.items()}
    if strange := [name for name in constraints if name not in states]:
        raise BadNames("along", f"names {strange[0]!r}, which is none of the states {', '.join(states)}")
    free = {*plant.states, *plant.parameters} - {states[name] for name in constraints}
    for name, value in constraints.items():
        if strange := sorted(map(str, value.free_symbols - free)):
            raise BadErrorSystem(f"along {name}", f"uses {strange[0]}, which is no other state or parameter")
    return tuple((states[name], value) for name, value in constraints.items())


def _expression(what: str, value: Any) -> sp.Expr:
    try:
        expression = exact(sp.sympify(value, strict=True))
    except (sp.SympifyError, TypeError, AttributeError):
        raise BadErrorSystem(f"{what}: {value!r}", "is no expression") from None
    return expression


LIMIT = 4000
_SHARP = 1e-2  # of V's range on a face


@dataclass(frozen=True)
class Dissipates:
    """The evidence of one claim about the Hamilton-Jacobi inequality dV/de F + |dV/de G|^2/(2 mu^2) + |e|^2/2 < 0 (38)
    of an error system. `answer`: the result of the interval search about its left side `lhs`, or about V > 0 where
    `lhs` is None; or `floor`: a number c_0 such that no set {V <= c}, c < c_0, touches a face of the box `within` of
    e."""

    system: ErrorSystem
    V: sp.Expr
    mu: sp.Rational
    within: Box = field(hash=False)
    answer: Answer | None = field(default=None, hash=False)
    lhs: sp.Expr | None = None
    floor: Fraction | None = None

    @property
    def unwritten(self) -> str:
        """The reason why a certificate cannot hold the evidence, "" where it can."""
        return "" if self.system.origin else "of an error system that is given and not made of the plant"

    def evidence(self, form: Form) -> Evidence | None:
        """Return the error system, V and mu, and the floor or the bisections, under the keys of a certificate; None
        where a certificate cannot hold them."""
        if self.system.origin is None:
            return None
        system = {"system": self._about(self.system.origin)}
        if self.floor is not None:
            return {**system, "floor": self.floor}
        answer = self.answer
        if answer is None or answer.basis is None:
            return None
        whole = self.lhs is None or answer.share == 1
        return {
            **system,
            "share": answer.share,
            "basis": answer.basis.tolist(),
            "slabs": [_slab(proof, -1 if self.lhs is None else 1) for proof in answer.proofs[1:]],
            **({} if whole else {"left": text_with_names(self.lhs, self._names)}),
        }

    @property
    def _names(self) -> set[str]:
        return {s.name for s in (*self.system.errors, *self.system.box)}

    def _about(self, origin: Injection | Equations) -> dict[str, Any]:
        names = self._names | {s.name for s in origin.names}
        if isinstance(origin, Equations):
            system, outputs = self.system, {y: sp.Symbol(f"y_{k}", real=True) for k, y in enumerate(origin.outputs, 1)}
            known = names | {y.name for y in outputs.values()}
            parts: dict[str, Any] = {
                "observer": [text_with_names(row.xreplace(outputs), known) for row in origin.observer],
                "unknown": [w.name for w in origin.unknown],
                "along": {x.name: text_with_names(value, names) for x, value in origin.along},
                "flow": [text_with_names(row, names) for row in system.flow],
                "noise": _rows(system.noise, names),
            }
        else:
            parts = {key: _rows(M, names) for key, M in (("gain", origin.gain), ("G1", origin.G1), ("G2", origin.G2))}
        errors = [
            {"name": s.name, "low": end_text(low), "high": end_text(high)} for s, (low, high) in self.within.items()
        ]
        return {**parts, "errors": errors, "V": text_with_names(self.V, names), "mu": str(self.mu)}


@dataclass(frozen=True)
class Dissipation:
    """The verdicts about V > 0 (21) and dV/de F + |dV/de G|^2/(2 mu^2) + |e|^2/2 < 0 (38) on the box `within` of the
    errors. `checks`: `dissipation.positive`, `.inequality`, `.level`; `level`: a number c_0 such that no set {V <= c},
    c < c_0, touches a face of the box, None where not proved; `witness`: the exact point that refutes (38), or (21)."""

    system: ErrorSystem
    V: sp.Expr
    mu: sp.Rational
    within: Box = field(hash=False)
    checks: tuple[Check, ...]
    level: Fraction | None
    witness: Mapping[sp.Symbol, Fraction] = field(default_factory=dict, hash=False)

    @property
    def proved(self) -> bool:
        """Whether every check is proved."""
        return all(check.verdict is Verdict.PROVED for check in self.checks)

    @property
    def conclusion(self) -> str:
        """The sentence that states the set in which the error stays and its L2 gain, or "nothing is concluded"."""
        if not self.proved or self.level is None:
            return "nothing is concluded"
        origin = self.system.origin
        condition = f" and {origin.condition}" if isinstance(origin, Equations) and origin.condition else ""
        power, gain = (up(Fraction(x), 9) for x in (self.mu**2 / 2, self.mu))
        return (
            f"in continuous time, from e(0) in the box with V(e(0)) + {power} * integral of |w|^2 < "
            f"{down(float(self.level), 9)} on, the error stays in the box, with the L2 gain {gain} from w "
            f"to e; without w it tends to 0; as long as the plant keeps to its ranges{condition}"
        )

    def __str__(self) -> str:
        return "\n".join([f"{self.system.name}: {self.conclusion}", *(f"  {check}" for check in self.checks)])


def dissipation(system: ErrorSystem, V: Any, *, mu: Any, within: Any, boxes: int = LIMIT) -> Dissipation:
    """Prove or refute the Hamilton-Jacobi inequality (38) of an error system, dV/de F + |dV/de G|^2/(2 mu^2) + |e|^2/2
    < 0, which bounds the L2 gain from disturbances to the error by `mu`, on a box.

    Args: `V`: a candidate function: an expression of the system's errors, or a matrix P (n, n) for e'P e, symmetric but
    for rounding (1e-12), in the order of the errors or with rows by name; `mu` > 0; `within`: the box of the errors:
    half widths (n), or ranges (low, high) around 0, in order or by name, of the error or of its state; `boxes`: the
    most boxes of a bisection for each question of a sign.

    Raises: `BadErrorSystem`; `BadNames`; `Misfit`.
    """
    if not isinstance(system, ErrorSystem):
        raise Misfit("dissipation", system, "an error system: hg.error_system(plant, gain)")
    demand_limits("dissipation", boxes)
    around, level, mu = _error_box(system, within), _function(system, V), _positive("mu", mu)
    obstacle = _obstacle(system, level, around, boxes)
    zero = dict.fromkeys(system.errors, sp.S.Zero)
    if sign_at(level, zero) in ("> 0", "< 0"):
        point = dict.fromkeys(system.errors, Fraction(0))
        positive = Answer(Verdict.REFUTED, because("V(0) is not 0"), point)
    else:
        positive = negative(_positive_function(system, level, around), boxes, obstacle)
    lost = because("{part} of the plant may have no value, and cancels in e'", part=system.lost)
    mismatch = system.caveat if system.lost is None else lost  # whether e' is that of the plant
    inequality = _inequality(system, level, mu, around)
    answers = (positive, negative(inequality, boxes, mismatch or obstacle))
    floor = _floor(level, around, boxes)
    subject = Dissipates(system, level, mu, around)
    checks = (
        _check("positive", "V(0) = 0 and V(e) > 0 for every other e of the box (21)", answers[0], "-V", subject),
        _check(
            "inequality",
            f"dV/de F + |dV/de G|^2/(2 mu^2) + |e|^2/2 < 0 for every e of the box but 0, mu = {mu} (38)",
            answers[1],
            "the left side",
            replace(subject, lhs=inequality.value),
        ),
        Check(
            ClaimId("dissipation", "level"),
            "a set {V <= c} lies in the box and touches none of its faces",
            Verdict.UNKNOWN if floor is None else Verdict.PROVED,
            because("V is not shown to be positive on the faces")
            if floor is None
            else because("for every c < {floor}", floor=Down(float(floor), 9)),
            proofs=() if floor is None else (replace(subject, floor=floor),),
        ),
    )
    witness = next((answer.point for answer in answers[::-1] if answer.point), {})
    return Dissipation(system, level, mu, around, checks, floor, witness)


def _function(system: ErrorSystem, V: Any) -> sp.Expr:
    n, V = len(system.errors), quadratic("V", V, names_of(system.errors), aliases=system.aliases)
    try:
        level = sp.sympify(V, strict=True) if isinstance(V, sp.Basic | int | float) else sp.Matrix(V)
    except (sp.SympifyError, ValueError, TypeError):
        raise BadErrorSystem(f"V = {V!r}", "is neither an expression of the errors nor a matrix") from None
    if isinstance(level, sp.MatrixBase):
        if level.shape != (n, n):
            raise BadErrorSystem(f"V of shape {level.shape}", f"must be a symmetric {n} x {n} matrix, for V = e'V e")
        P, e = level.applyfunc(exact), sp.Matrix(system.errors)
        # but for rounding: e'P e is that of (P + P')/2
        rational = all(entry.is_Rational for entry in P)
        even = symmetric([[Fraction(x) for x in row] for row in P.tolist()]) is not None if rational else P == P.T
        if not even:
            raise BadErrorSystem("V", unsymmetric("V"))
        level = (e.T * P * e)[0, 0]
    strange = level.free_symbols - {*system.errors}
    if strange:
        names = ", ".join(e.name for e in system.errors)
        raise BadErrorSystem("V", f"uses {min(map(str, strange))}; it is a function of the errors {names} alone")
    return sp.expand(exact(level))


def _positive(name: str, value: Any) -> sp.Rational:
    try:
        number = exact(sp.sympify(value))
    except (sp.SympifyError, TypeError):
        number = None
    if number is None or not number.is_Rational or not number > 0:
        raise BadErrorSystem(f"{name} = {value!r}", "must be a positive number")
    return number


def _obstacle(system: ErrorSystem, V: sp.Expr, around: Box, boxes: int) -> Reason:
    """Return why F or dV/de may differ from an average of its Jacobian times e, or `NONE`: they
    and V must vanish at e = 0, have no kinks or jumps, and bounded derivatives on the box."""
    zero, box = dict.fromkeys(system.errors, sp.S.Zero), {**system.plain, **around}
    slopes = tuple(V.diff(e) for e in system.errors)
    for what, rows in (("V", (V,)), ("dV/de", slopes)):
        if any(sign_at(row, zero) != "= 0" for row in rows):
            return because("{what} does not vanish at e = 0", what=what)
    if not all(is_zero(row.xreplace(zero), system.plain) for row in system.flow):
        return because("F is not shown to vanish at e = 0")
    for what, rows in (("F", system.flow), ("dV/de", slopes)):
        if any(row.has(*JUMPS, *KINKS) for row in rows):
            return because("{what} has kinks or jumps", what=what)
        if lipschitz_bound(rows, system.errors, box, boxes=boxes, relative=1.0).verdict is not Verdict.PROVED:
            return because("{what} is not shown to have a bounded slope", what=what)
    return NONE


def _copies(system: ErrorSystem, label: str) -> tuple[sp.Symbol, ...]:
    return tuple(sp.Dummy(f"{e.name}_{label}", real=True) for e in system.errors)


def _positive_function(system: ErrorSystem, V: sp.Expr, around: Box) -> SecondOrder:
    """Return -V with the matrix V_ee(c)/2, V_ee the Hessian:
    V(e) = e'(average of V_ee/2) e, for the proof of V > 0."""
    copy = _copies(system, "c")
    hessian = sp.hessian(V, system.errors).xreplace(dict(zip(system.errors, copy, strict=True))) / 2
    return SecondOrder(-V, hessian, (copy,), system.errors, around, {})


def _inequality(system: ErrorSystem, V: sp.Expr, mu: sp.Rational, around: Box) -> SecondOrder:
    """Return the left side of dV/de F + |dV/de G|^2/(2 mu^2) + |e|^2/2 < 0 (38),
    with the matrix N(c, d) for which it is at most -e'(average of N) e."""
    errors, G = system.errors, sp.Matrix(system.noise)
    here, there, c, d = sp.Matrix(errors), _copies(system, "e"), _copies(system, "c"), _copies(system, "d")
    F = sp.Matrix(system.flow)
    slope = sp.Matrix([[V.diff(e) for e in errors]])
    value = (slope * F)[0, 0] + (slope * G * G.T * slope.T)[0, 0] / (2 * mu**2) + (here.T * here)[0, 0] / 2
    hessian = sp.hessian(V, errors).xreplace(dict(zip(errors, c, strict=True)))
    steep = F.jacobian(errors).xreplace(dict(zip(errors, d, strict=True)))
    pushed = hessian * G.xreplace(dict(zip(errors, there, strict=True)))
    N = -(hessian * steep + steep.T * hessian + pushed * pushed.T / mu**2 + sp.eye(len(errors))) / 2
    return SecondOrder(value, N, (c, d, there), errors, around, system.plain, system.states)


def _floor(V: sp.Expr, around: Box, boxes: int) -> Fraction | None:
    """Return a lower bound of V on the faces of the box `around`, rounded
    to few digits; None if it is not positive. For V = e'P e it is min_i
    end_i^2/(P^-1)_ii, where the ellipsoid first touches a face."""
    e = sp.Matrix(list(around))
    P = sp.hessian(V, list(around)) / 2
    other = P.free_symbols or sp.expand(V - (e.T * P * e)[0, 0]) != 0
    if other or not P.is_positive_definite:
        faces = [{**around, e: (end, end)} for e, ends in around.items() for end in ends]
        lowest = min(bound(V, face, boxes=boxes, relative=_SHARP).low for face in faces)
        return Fraction(down(lowest, 9)) if lowest > 0 else None
    nearest = (sp.Rational(min(Fraction(end) ** 2 for end in ends)) for ends in around.values())
    least = min(end / share for end, share in zip(nearest, P.inv().diagonal(), strict=True))
    return Fraction(down(Fraction(least), 9))


def _check(what: str, claim: str, answer: Answer, side: str, subject: Dissipates) -> Check:
    there = because("{side} is {value:.3g} there", side=side, value=answer.value)
    reason = answer.reason if answer.value is None else there
    witness = {s.name: float(number) for s, number in answer.point.items()}
    proofs = (replace(subject, answer=answer),)
    return Check(ClaimId("dissipation", what), claim, answer.verdict, reason, witness, proofs=proofs)


def _rows(M: sp.ImmutableDenseMatrix, names: set[str]) -> list[list[str]]:
    return [[text_with_names(cell, names) for cell in row] for row in M.tolist()]


def _slab(proof: Proof, way: int) -> dict[str, Any]:
    """Return the bisection that proves an expression negative and half of its
    bound, so that a weaker arithmetic can verify it; `way` = -1 for -V < 0."""
    assert proof.high is not None  # it is negative
    return {"tree": bisection_text(proof), "bound": way * Fraction(f"{float(proof.high) / 2:.6g}")}
