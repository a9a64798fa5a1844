"""The error of an observer as a system of its own, driven by the disturbances.

    x' = f(x, u) + G1(x) w,   y = h(x, u) + G2(x) w,   xhat' = f(xhat, u) + l(xhat, u) (y - h(xhat, u))
    e = x - xhat:   e' = f(x) - f(x - e) - l(x - e) (h(x) - h(x - e)) + (G1(x) - l(x - e) G2(x)) w

or of an observer of any equations, driven by inputs that it does not know,

    x' = f(x, u, w),   y = h(x, u, w),   xhat' = g(xhat, y, u)
    e' = f(x, u, w) - g(x - e, h(x, u, w), u) = F(e, x, u) + G(e, x, u) w

which may hold on a set x_k = a_k(x) alone, which the plant keeps to: f_k = sum_j da_k/dx_j f_j on it; and holds
wherever both sides have a value. Nothing is saturated: where x - e leaves the ranges of x, f, h and l are taken as
their expressions are there. Source: Alessandri, "On Hamilton-Jacobi approaches to state reconstruction for dynamic
systems", Mathematical Problems in Engineering (2020), (19), (24), (25), (29), (30).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import sympy as sp

from hgogen.analysis.written import written
from hgogen.errors import BadArgument
from hgogen.reading.door import asks_a_plant
from hgogen.reading.given import signals_named
from hgogen.reading.named import BadNames, in_order, names_of
from hgogen.rigor.box import Box, box
from hgogen.rigor.identity import is_zero
from hgogen.rigor.points import exact
from hgogen.rigor.search import is_defined
from hgogen.rigor.singular import lost, put_apart
from hgogen.rigor.slope import JUMPS
from hgogen.sentence import NONE, Reason
from hgogen.signal import Signal
from hgogen.system import System


class BadErrorSystem(BadArgument):
    """Parts of an error system that do not fit together; the sentence names the part and the fix."""


@dataclass(frozen=True)
class Injection:
    """How a plant makes an error system: `gain` l (n, p), `G1` (n, k), `G2` (p, k), of the plant's signals."""

    gain: sp.ImmutableDenseMatrix
    G1: sp.ImmutableDenseMatrix
    G2: sp.ImmutableDenseMatrix

    @property
    def names(self) -> frozenset[sp.Symbol]:
        """The symbols that they read."""
        return frozenset().union(*(M.free_symbols for M in (self.gain, self.G1, self.G2)))


@dataclass(frozen=True)
class Equations:
    """The equations by which a plant and an observer make an error system: `observer` g (n), of states, which
    stand for the estimate, of outputs and known inputs; the inputs `unknown` to it; and pairs `along` of a state and
    its value."""

    observer: tuple[sp.Expr, ...]
    outputs: tuple[Signal, ...]
    unknown: tuple[Signal, ...]
    along: tuple[tuple[Signal, sp.Expr], ...] = ()

    @property
    def names(self) -> frozenset[sp.Symbol]:
        """The symbols that it reads."""
        read = frozenset().union(*(e.free_symbols for e in (*self.observer, *(a for _, a in self.along))))
        return read.union(self.unknown, (x for x, _ in self.along))

    @property
    def condition(self) -> str:
        """Where it holds, or ""."""
        return " and ".join(f"{x} = {sp.sstr(a)}" for x, a in self.along)


@dataclass(frozen=True)
class ErrorSystem:
    """e' = flow(e, x) + noise(e, x) w with flow = 0 at e = 0.

    `errors`: the symbols e (n); `flow` (n); `noise` (n, k); `box`: the closed range of every other symbol; `states`:
    the x (n) that belong to the e, where x - e is the estimate, or none; `origin`: how it was made of a plant, None
    where it is given; `lost`: a part of the plant that cancels in e' and may have no value on the box; `doubt`: why it
    may not be that of the plant as first declared, or `NONE`.

    Raises: `BadErrorSystem`.
    """

    name: str
    errors: tuple[sp.Symbol, ...]
    flow: tuple[sp.Expr, ...]
    noise: sp.ImmutableDenseMatrix
    box: Box = field(default_factory=dict, hash=False)
    states: tuple[sp.Symbol, ...] = ()
    origin: Injection | Equations | None = None
    lost: sp.Expr | None = None
    doubt: Reason = NONE

    def __post_init__(self) -> None:
        """Numbers exact, lengths and symbols as they should be."""
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
        """The box, without ranges of the errors."""
        return {s: ends for s, ends in self.box.items() if s not in self.errors}

    @property
    def aliases(self) -> dict[str, str]:
        """The name of each state's error."""
        return {x.name: e.name for x, e in zip(self.states, self.errors, strict=bool(self.states))}


@asks_a_plant
def error_system(plant: System, gain: Any, G1: Any = None, G2: Any = None) -> ErrorSystem:
    """The error system of xhat' = f(xhat, u) + gain (y - h(xhat, u)) on the plant, its errors named e_STATE.

    Args: `gain` l (n, p) of numbers or expressions, of the plant's states, which stand for the estimate there, inputs
    and parameters (for one output n of them will do); `G1` (n, k), `G2` (p, k) of states, inputs and parameters, by
    default (I, 0) and (0, I): a disturbance on every row of f and on every output. Rows, and of `gain` columns, may be
    given by the names of states and outputs. Inputs, parameters and states take their declared ranges; a parameter
    without one has its value.

    Raises: `Misfit`; `BadNames`; `BadErrorSystem` for matrices of another shape.
    """
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
        lost(written(plant), flow, around),
        plant.doubt,
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


def error_box(system: ErrorSystem, within: Any) -> Box:
    """The box of the errors: of half widths (n) or ranges (low, high), low < 0 < high, in their order, or by the name
    of the error or of its state.

    Raises: `BadErrorSystem`, `BadNames`.
    """
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


@asks_a_plant
def observer_errors(
    plant: System, observer: Any, *, unknown: Iterable[Any] | Signal | str, along: Mapping[Any, Any] | None = None
) -> ErrorSystem:
    """The error system of xhat' = observer on the plant, its errors named e_STATE.

    Args: `observer` (n) expressions of the plant's states, which stand for the estimate, outputs, known inputs and
    parameters, in the order of the states or by their names; `unknown` inputs or their names, or one alone:
    they are the disturbances w; `along` the states that others tell while the plant runs, by name, such as
    {"x2": x1**2}.

    Raises: `Misfit`; `BadNames`; `BadGain` for an `unknown` that is no names; `BadErrorSystem` where the plant does not
    keep to `along`, or the error system is not affine in w.
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
    made = Equations(tuple(rows), tuple(plant.outputs), w, constraints)
    return _made(plant, made)


def _made(plant: System, made: Equations) -> ErrorSystem:
    fixed = {s: value for s, value in plant.nominal.items() if not s.bounded}
    errors = tuple(sp.Symbol(f"e_{x}", real=True) for x in plant.states)
    estimate = {x: x - e for x, e in zip(plant.states, errors, strict=True)}
    seen = dict(zip(plant.outputs, plant.output, strict=True))
    behind = [g.xreplace({**estimate, **seen}) for g in made.observer]
    on, signals = dict(made.along), (*plant.states, *plant.inputs, *plant.parameters)
    # of each is known what its range says of its sign, so that the root of a square is known
    signs = {s: "nonnegative" if s.low is not None and s.low >= 0 else "real" for s in plant.signals}
    real = {s: sp.Dummy(s.name, **{sign: True}) for s, sign in signs.items()}
    plain = {dummy: s for s, dummy in real.items()}

    def on_way(e: sp.Expr) -> sp.Expr:
        return exact(e.xreplace(fixed).xreplace(on))

    def reduced(e: sp.Expr) -> sp.Expr:
        return sp.cancel(on_way(e).xreplace(real)).xreplace(plain)

    around = {s: ends for s, ends in box(signals, plant.nominal).items() if s not in fixed}
    for x, a in made.along:  # a jump of which the plant's state has no part, and its slope does not see it
        if a.has(*JUMPS):
            raise BadErrorSystem(f"along {x} = {a}", "may jump; write it with Abs, Min and Max")
        if not is_defined(a.xreplace(fixed), around):  # as of atan(tan(x)) at a pole
            raise BadErrorSystem(f"along {x} = {a}", "may have no value on the box, and jump there; narrow the ranges")
        drift = plant.flow[plant.states.index(x)] - sum(
            a.diff(other) * rate for other, rate in zip(plant.states, plant.flow, strict=True)
        )
        if reduced(drift) != 0:
            raise BadErrorSystem(f"along {x} = {a}", "is not kept by the plant: its flow leaves it")
    rates = [reduced(f - g) for f, g in zip(plant.flow, behind, strict=True)]
    still = dict.fromkeys(made.unknown, sp.S.Zero)
    flow = [reduced(rate.xreplace(still)) for rate in rates]
    noise = [[reduced(rate.diff(w)) for w in made.unknown] for rate in rates]
    for x, rate, drift, pushed in zip(plant.states, rates, flow, noise, strict=True):
        moved = sum(p * w for p, w in zip(pushed, made.unknown, strict=True))
        if not is_zero(rate - drift - moved, around):
            raise BadErrorSystem(f"e_{x}' = {rate}", "is not shown to be affine in the unknown inputs")
    away = {*made.unknown, *on}
    shown = {s: ends for s, ends in around.items() if s not in away}
    pushes = sp.ImmutableDenseMatrix(len(noise), len(made.unknown), [entry for row in noise for entry in row])
    # not of the observer's own: without a value of it there is no estimate to speak of, as of x/sqrt(y) at y = 0
    part = lost(put_apart(written(plant), on_way), (*flow, *pushes), around)
    return ErrorSystem(plant.name, errors, tuple(flow), pushes, shown, origin=made, lost=part, doubt=plant.doubt)


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
