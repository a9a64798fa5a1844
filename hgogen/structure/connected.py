"""Which states reach an output, by following dependencies: the others are hidden from it, whatever the inputs are."""

from collections.abc import Mapping, Sequence

from hgogen.algebra.identity import reads
from hgogen.check import Check, ClaimId, Verdict
from hgogen.signal import Signal
from hgogen.system import System


def outwards(seen: Sequence[tuple[Signal, ...]], needs: Mapping[Signal, tuple[Signal, ...]]) -> list[Signal]:
    """The states that reach an output, breadth first; `seen` by the outputs, `needs` of each state's derivative."""
    order = list(dict.fromkeys(x for states in seen for x in states))
    for x in order:  # it grows while it is read
        order.extend(other for other in needs[x] if other not in order)
    return order


def connected(maker: str, hidden: Sequence[Signal]) -> Check:
    """`MAKER.connected`, that no state is `hidden`."""
    id = ClaimId(maker, "connected")
    claim = "every state appears in an output or in the derivative of one that counts"
    if not hidden:
        return Check(id, claim, Verdict.PROVED, "by following dependencies from the outputs")
    names = ", ".join(x.name for x in hidden)
    fix = f"Leave {names} out of the model, or measure something that depends on it."
    return Check(id, claim, Verdict.REFUTED, f"no output ever shows {names}", fix=fix)


def cut_off(maker: str, plant: System) -> tuple[Check, ...]:
    """The refuted check `connected` of a plant with hidden states; none of another plant."""
    needs = {x: reads(rate, plant.states) for x, rate in zip(plant.states, plant.flow, strict=True)}
    shown = outwards([reads(h, plant.states) for h in plant.output], needs)
    hidden = [x for x in plant.states if x not in shown]
    return (connected(maker, hidden),) if hidden else ()
