"""Which states reach an output, by following dependencies: the others are hidden from it, whatever the inputs are."""

from collections.abc import Sequence

import sympy as sp

from hgogen.check import Check, ClaimId, Verdict
from hgogen.sentence import because
from hgogen.structure.chain import Rows, of_plant
from hgogen.system import System


def reached(rows: Rows, *, sure: bool = False) -> list[sp.Symbol]:
    """The states that reach an output on the box, or may, breadth first; with `sure` those that are proved to."""

    def read(row: sp.Expr) -> tuple[sp.Symbol, ...]:
        known, maybe = rows.reads(row, rows.states)
        return tuple(x for x in rows.states if x in known or (x in maybe and not sure))

    order = list(dict.fromkeys(x for row in rows.output for x in read(row)))
    for x in order:  # it grows while it is read
        order.extend(other for other in read(rows.rate(x)) if other not in order)
    return order


def connected(maker: str, hidden: Sequence[sp.Symbol], doubtful: Sequence[sp.Symbol] = ()) -> Check:
    """`MAKER.connected`, that no state is `hidden`; of the `doubtful` ones it is not known."""
    id = ClaimId(maker, "connected")
    claim = "every state appears in an output or in the derivative of one that counts"
    if not hidden and doubtful:
        doubt = because("it is not shown that {states} matters where it is read", states=doubtful)
        return Check(id, claim, Verdict.UNKNOWN, doubt)
    if not hidden:
        return Check(id, claim, Verdict.PROVED, because("by following dependencies from the outputs"))
    names = ", ".join(x.name for x in hidden)
    fix = f"Leave {names} out of the model, or measure something that depends on it."
    return Check(id, claim, Verdict.REFUTED, because("no output ever shows {states}", states=hidden), fix=fix)


def cut_off(maker: str, plant: System) -> tuple[Check, ...]:
    """The refuted check `connected` of a plant with hidden states; none of another plant."""
    shown = reached(of_plant(plant))
    hidden = [x for x in plant.states if x not in shown]
    return (connected(maker, hidden),) if hidden else ()
