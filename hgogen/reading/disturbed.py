"""A plant with an unknown input to one of its rows, as states of their own.

    x_i' = f_i(x, u) + d,    d' = d_dot,    d_dot' = d_ddot,    ..,    the last of `order` of them has the rate 0

An observer of the new plant estimates d with the rest. That the last rate is 0 stands for an input of which nothing
else is known: what is proved holds while it is so, a jump of d is a new start, and a filter gives its row noise by Q.
"""

from dataclasses import replace

import sympy as sp

from hgogen.errors import nearest
from hgogen.reading.door import asks_a_plant
from hgogen.signal import Signal
from hgogen.system import BadSystem, System


@asks_a_plant
def with_disturbance(
    plant: System, on: str | sp.Symbol, order: int = 1, *, signal: Signal | None = None, name: str | None = None
) -> System:
    """The plant with an unknown input d that is added to the rate of a state.

    Args: `on` that state, or its name; `order` how many states the input has: d, and from 2 on its derivatives, named
    NAME_dot, NAME_ddot, ..; `signal` the input, whose range is that of its estimate, and whose `rates` are the ranges
    of the derivatives, one for each from order 2 on; `name` the new plant's, by default the plant's own.

    Whether the outputs show d as well is a question to the new plant: `hg.observability`, `hg.survey` and the checks of
    its form answer it. Raises: `BadSystem` for a state that it does not have, a range that is missing, a recast plant;
    for a name that is taken.
    """
    if plant.origin is not None:
        fix = "give the disturbance to the plant that it was recast from, and recast that"
        raise BadSystem(plant.name, f"is recast, and its rows are not those of what is reported; {fix}")
    row = plant.states.index(_state(plant, on))
    unknown = _chain(plant, plant.states[row], order, signal)
    flow = [f + unknown[0] if i == row else f for i, f in enumerate(plant.flow)]
    new = plant.name if name is None else name
    return replace(plant, name=new, states=(*plant.states, *unknown), flow=(*flow, *unknown[1:], sp.S.Zero))


def _state(plant: System, on: str | sp.Symbol) -> Signal:
    name, known = str(on), {x.name: x for x in plant.states}
    if name in known and on in (name, known[name]):
        return known[name]
    what, fix = "no state of it", nearest(name, known, f"its states are {', '.join(known)}")
    if name in known:
        what, fix = "a symbol of that name, and not the state", "give the state, or its name"
    elif name in {u.name for u in plant.inputs}:
        what = "an input, which has no row"
    raise BadSystem(plant.name, f"on = {name[:60]!r} is {what}; {fix}")


def _chain(plant: System, state: Signal, order: int, signal: Signal | None) -> tuple[Signal, ...]:
    if isinstance(order, bool) or not isinstance(order, int) or order < 1:
        raise BadSystem(plant.name, f"order = {order!r} must be a whole number, at least 1, which is for d' = 0")
    if not isinstance(signal, Signal):
        unit = f', "({state.unit})/{plant.time}"' if state.unit else ""
        example = f'hg.Signal("d_{state}"{unit}, low=-1, high=1)'
        raise BadSystem(plant.name, f"the disturbance on {state} needs a range; give it by signal={example}")
    if not signal.bounded:
        fix = "give low= and high=, on which every proof and the estimate's clamps rest"
        raise BadSystem(plant.name, f"the disturbance {signal} has no range; {fix}")
    if len(signal.rates) != order - 1:
        fix = "give a pair for each derivative that is a state, order - 1 of them" if order > 1 else "leave them out"
        have = f"{len(signal.rates)} rates, and order = {order}"
        raise BadSystem(plant.name, f"the disturbance {signal} has {have}; {fix}")
    chain = [Signal(signal.name, signal.unit, signal.meaning, signal.nominal, signal.low, signal.high)]
    for k in range(1, order):
        rate = signal.derivative(k, plant.time)
        what = "derivative" if k == 1 else f"derivative of order {k}"  # which is estimated, not given as of an input
        chain.append(Signal(rate.name, rate.unit, f"{what} of {signal.name}", low=rate.low, high=rate.high))
    return tuple(chain)
