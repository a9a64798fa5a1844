"""A plant in other coordinates: w = w(x), x = x(w), w' = (dw/dx f)(x(w), u).

The recast plant is a System of its own, whose estimates are reported in the coordinates of the plant it came from.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import sympy as sp

from hgogen.check import Check, Verdict
from hgogen.signal import Signal
from hgogen.system import BadSystem, Origin, System


def _sign(signal: Signal) -> dict[str, bool]:
    low, high = signal.interval
    if low > 0 or high < 0:
        return {"positive" if low > 0 else "negative": True}
    return {"nonnegative": True} if low == 0 else {}


def recast(plant: System, coordinates: Mapping[Signal, Any], inverse: Mapping[Signal, Any]) -> System:
    """The plant with some states replaced.

    Args: `coordinates` maps each new state (a Signal with its own range) to an expression of the plant's states;
    `inverse` maps each replaced state of the plant to an expression of the new states and those kept. New states stand
    in the place of the replaced ones, in order.

    Raises: `BadSystem` where the numbers differ or a name is unknown. Whether the maps are inverse to each other is a
    Check, `recast.inverse`.
    """
    new, old = tuple(coordinates), tuple(inverse)
    for state in old:
        if state not in plant.states:
            raise BadSystem(plant.name, f"the inverse names {state}, which is no state of it")
    if len(new) != len(old):
        raise BadSystem(plant.name, f"{len(new)} new states for {len(old)} replaced ones; give as many")
    kept = [s for s in plant.states if s not in old]
    states = tuple(dict(zip(old, new, strict=True)).get(s, s) for s in plant.states)
    # stand-ins that carry the sign of their range, so that sqrt(w^2) can become w
    plain = {s: sp.Dummy(s.name, real=True, **_sign(s)) for s in (*plant.states, *new)}
    back = {dummy: signal for signal, dummy in plain.items()}
    forward = {w: sp.sympify(e).xreplace(plain) for w, e in coordinates.items()} | {s: plain[s] for s in kept}
    backward = {plain[x]: sp.sympify(e).xreplace(plain) for x, e in inverse.items()}
    flow = [f.xreplace(plain) for f in plant.flow]
    ones = [plain[s] for s in plant.states]
    rates = [sum(sp.diff(forward[w], x) * f for x, f in zip(ones, flow, strict=True)) for w in states]
    check = _inverse(forward, backward, plain, states)
    result = System(
        plant.name,
        states=states,
        inputs=plant.inputs,
        outputs=plant.outputs,
        parameters=plant.parameters,
        flow=[sp.expand(sp.powdenest(sp.sympify(r).subs(backward))).xreplace(back) for r in rates],
        output=[sp.expand(h.xreplace(plain).subs(backward)).xreplace(back) for h in plant.output],
    )
    reported = tuple(backward.get(x, x).xreplace(back) for x in ones)
    to = tuple(forward[w].xreplace(back) for w in states)
    return replace(result, origin=Origin(plant, to, reported, check))


def _inverse(
    forward: Mapping[Signal, sp.Expr],
    backward: Mapping[sp.Dummy, sp.Expr],
    plain: Mapping[Signal, sp.Dummy],
    states: tuple[Signal, ...],
) -> Check:
    gaps = [sp.simplify(e.subs({plain[w]: f for w, f in forward.items()}) - x) for x, e in backward.items()]
    gaps += [sp.simplify(forward[w].subs(backward) - plain[w]) for w in states]
    claim = "the change of coordinates and its inverse undo each other on the declared ranges"
    if all(gap == 0 for gap in gaps):
        return Check("recast.inverse", claim, Verdict.PROVED, "exact substitution both ways")
    left = next(gap for gap in gaps if gap != 0)
    return Check("recast.inverse", claim, Verdict.UNKNOWN, f"{left} was not shown to be 0")
