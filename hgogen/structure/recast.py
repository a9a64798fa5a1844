"""A plant in other coordinates: w = w(x), x = x(w), w' = (dw/dx f)(x(w), u).

The recast plant is a System of its own, whose estimates are reported in the coordinates of the plant it came from.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import sympy as sp

from hgogen.algebra.points import exact
from hgogen.intervals.box import box
from hgogen.intervals.singular import lost
from hgogen.reading.door import Misfit, asks_a_plant
from hgogen.signal import Signal
from hgogen.structure.diffeomorphism import Change, checks, stand_ins
from hgogen.system import BadSystem, Origin, System


@asks_a_plant
def recast(plant: System, coordinates: Mapping[Signal, Any], inverse: Mapping[Signal, Any]) -> System:
    """The plant with some states replaced.

    Args: `coordinates` maps each new state (a Signal with its own range) to an expression of the plant's states;
    `inverse` maps each replaced state of the plant to an expression of the new and the unchanged states. New states
    stand in the place of the replaced ones, in order. A plant that is recast already is recast from where it was first
    declared, by both changes at once.

    Raises: `Misfit`; `BadSystem` where the numbers differ, a map reads an input or an unknown name, or a new state has
    the name of one that is reported. Whether the maps are smooth and inverse to each other is a Check,
    `recast.inverse`; whether the new ranges are wide enough another, `recast.range`.
    """
    for what, maps in (("coordinates", coordinates), ("inverse", inverse)):
        if not isinstance(maps, Mapping):
            raise Misfit(f"recast, {what}=", maps, "a mapping from states to their expressions, such as {w: x1 + x2}")
    new, old = tuple(coordinates), tuple(inverse)
    for state in old:
        if state not in plant.states:
            raise BadSystem(plant.name, f"the inverse names {state}, which is no state of it")
    if len(new) != len(old):
        raise BadSystem(plant.name, f"{len(new)} new states for {len(old)} replaced ones; give as many")
    change = Change(plant, *({s: exact(sp.sympify(e)) for s, e in maps.items()} for maps in (coordinates, inverse)))
    _readable(change)
    reported = {s.name for s in (*plant.states, *plant.declared.states)}
    for w in new:  # what is proved of a state goes by its name, new or reported
        if w.name in reported:
            raise BadSystem(plant.name, f"the new state {w} has the name of one of its states; give it another")
    return _recast(change if plant.origin is None else _at_once(change, plant.origin))


def _at_once(change: Change, before: Origin) -> Change:
    """Of a plant that is recast: the change of the plant that it was recast `before` from, which does both."""
    first, forward = before.plant, dict(zip(change.plant.states, before.forward, strict=True))
    forward |= {w: e.xreplace(forward) for w, e in change.forward.items()}
    back = {x: e.xreplace(change.backward) for x, e in zip(first.states, before.backward, strict=True)}
    new = [w for w in change.states if w not in first.states]
    return Change(first, {w: forward[w] for w in new}, {x: e for x, e in back.items() if x not in change.states})


def _recast(change: Change) -> System:
    """The plant in the new states."""
    plant, states = change.plant, change.states
    plain = stand_ins((*plant.states, *change.forward))
    back = {dummy: signal for signal, dummy in plain.items()}
    forward = {s: change.forward.get(s, s).xreplace(plain) for s in states}
    backward = {plain[x]: e.xreplace(plain) for x, e in change.backward.items()}
    flow = [exact(f).xreplace(plain) for f in plant.flow]  # a product of floats is a float, and none of the decimals
    ones = [plain[s] for s in plant.states]
    rates = [sum(sp.diff(forward[w], x) * f for x, f in zip(ones, flow, strict=True)) for w in states]
    moved = [_moved(sp.sympify(rate), backward, back, plant, sp.powdenest) for rate in rates]
    for w, rate in zip(states, moved, strict=True):
        if rate.has(sp.DiracDelta, sp.Derivative) and w in change.forward:
            what = f"{w} = {change.forward[w]} jumps, so that it has no rate there; take one that is continuous"
            raise BadSystem(plant.name, what)
    result = System(
        plant.name,
        states=states,
        inputs=plant.inputs,
        outputs=plant.outputs,
        parameters=plant.parameters,
        flow=moved,
        output=[_moved(exact(h).xreplace(plain), backward, back, plant) for h in plant.output],
        time=plant.time,
    )
    reported = tuple(backward.get(x, x).xreplace(back) for x in ones)
    to = tuple(forward[w].xreplace(back) for w in states)
    return replace(result, origin=Origin(plant, to, reported, checks(change)))


def _moved(
    row: sp.Expr,
    backward: Mapping[sp.Symbol, sp.Expr],
    back: Mapping[sp.Symbol, Signal],
    plant: System,
    tidy: Callable[[sp.Expr], sp.Expr] = sp.sympify,
) -> sp.Expr:
    """A row in the new states: expanded, but for one that has a value then where it may have none as it stands."""
    plain = row.subs(backward)
    moved, expanded = plain.xreplace(back), sp.expand(tidy(plain)).xreplace(back)
    signals = (s for s in moved.free_symbols if isinstance(s, Signal))
    part = lost((moved,), (expanded,), box(signals, plant.nominal))
    return expanded if part is None else moved


def _readable(change: Change) -> None:
    """The maps read states and parameters: an input has a derivative, which the plant does not know."""
    plant = change.plant
    for maps, states in ((change.forward, {*plant.states}), (change.backward, {*change.states})):
        for s, e in maps.items():
            for symbol in sorted(e.free_symbols - states - {*plant.parameters}, key=str):
                what = f"the input {symbol}, whose derivative is not known" if symbol in plant.inputs else symbol
                allowed = ", ".join(sorted(map(str, states)))
                raise BadSystem(plant.name, f"{s} = {e} reads {what}; write it in {allowed} and parameters")
