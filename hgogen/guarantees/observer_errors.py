"""The error of an observer of any equations as a system of its own, driven by inputs that the observer does not know.

    x' = f(x, u, w),   y = h(x, u, w),   xhat' = g(xhat, y, u),   e = x - xhat
    e' = f(x, u, w) - g(x - e, h(x, u, w), u) = F(e, x, u) + G(e, x, u) w

It may hold on a set x_k = a_k(x) alone, which the plant keeps to: f_k = sum_j da_k/dx_j f_j on it. It holds wherever
both sides have a value; nothing is saturated. Source: Alessandri, "On Hamilton-Jacobi approaches to state
reconstruction for dynamic systems", Mathematical Problems in Engineering (2020), (19), (29), (30).
"""

from collections.abc import Iterable, Mapping
from typing import Any

import sympy as sp

from hgogen.algebra.identity import is_zero
from hgogen.algebra.points import exact
from hgogen.analysis.written import written
from hgogen.guarantees.error_system import BadErrorSystem, Equations, ErrorSystem
from hgogen.intervals.box import box
from hgogen.intervals.search import is_defined
from hgogen.intervals.singular import lost, put_apart
from hgogen.intervals.slope import JUMPS
from hgogen.reading.door import asks_a_plant
from hgogen.reading.given import signals_named
from hgogen.reading.named import BadNames, in_order, names_of
from hgogen.signal import Signal
from hgogen.system import System


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
