"""The plant in its own coordinates, for any number of outputs.

    z' = A(u) z + b(z, u),   y = h(z, u),

z is the plant's state in another order, A holds the coefficients of terms linear in a state, b the rest. It
serves the plain extended Kalman filter and plants without a triangular form; no theorem promises convergence.

The shape that a high gain needs is that of H. Hammouri, M. Farza, "Nonlinear observers for locally uniformly
observable systems", ESAIM: COCV 9 (2003): y = h(z_1, u), z_i' of z_1..z_{i+1} and u, with a slope in z_{i+1}.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from hgogen.algebra.identity import reads
from hgogen.check import Check, Verdict
from hgogen.errors import HgogenError
from hgogen.form import Form
from hgogen.signal import Signal
from hgogen.structure.connected import connected, outwards
from hgogen.structure.coordinates import Coordinates, coordinates, form_in, split
from hgogen.structure.lipschitz import lipschitz
from hgogen.system import System


@dataclass(eq=False)
class BadOrder(HgogenError):
    """An order that is not the plant's states, each once."""

    system: str
    order: tuple[str, ...]
    states: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"system {self.system!r}: the order ({', '.join(self.order)}) must hold each of the states "
            f"{', '.join(self.states)} once"
        )


def original(plant: System, order: Sequence[Signal] | None = None) -> Form:
    """The plant in its own coordinates, its states in `order`.

    Default order: from the outputs outwards, a state before those that appear in its derivative.

    Checks: `original.connected` (no state is hidden from the outputs), `original.order` (the shape that a
    high gain needs: generic, or unknown), `original.lipschitz`, `original.convergence` (unknown).

    Raises: `BadOrder`.
    """
    needs = {x: reads(rate, plant.states) for x, rate in zip(plant.states, plant.flow, strict=True)}
    seen = [reads(h, plant.states) for h in plant.output]
    shown = outwards(seen, needs)
    hidden = [x for x in plant.states if x not in shown]
    order = tuple(order) if order is not None else (*shown, *hidden)
    if len(order) != len(plant.states) or set(order) != set(plant.states):
        raise BadOrder(plant.name, tuple(map(str, order)), tuple(x.name for x in plant.states))
    z = coordinates(plant, order)
    A, b = split(z.flow, z.states)
    terms = (a * z.states[j] for (_, j), a in A.todok().items())
    checks = (
        connected("original.connected", hidden),
        _shape(z, seen, needs),
        lipschitz("original.lipschitz", map(z.back, (*terms, *b, *z.output)), plant, "A x + b with the output"),
        Check(
            "original.convergence",
            "the estimate converges from everywhere in the box",
            Verdict.UNKNOWN,
            "no theorem here covers the plant in its own coordinates",
        ),
    )
    return form_in(z, "original", checks, "the plant's own coordinates", parts=(A, b, z.output))


def _shape(z: Coordinates, seen: Sequence[tuple[Signal, ...]], needs: dict[Signal, tuple[Signal, ...]]) -> Check:
    """Whether row i reads z_1..z_{i+1} only, and z_{i+1} indeed."""
    id, claim = "original.order", "y = h(z_1, u) and z_i' reads z_1..z_{i+1}, with a slope in z_{i+1}"
    if len(seen) > 1:
        return Check(id, claim, Verdict.UNKNOWN, "the shape is for one output")
    for i, row in enumerate((seen[0], *(needs[x] for x in z.order[:-1]))):
        name = f"z_{i}'" if i else "y"
        if z.order[i] not in row:
            return Check(id, claim, Verdict.UNKNOWN, f"{name} does not read {z.order[i]}")
        later = [x.name for x in row if x in z.order[i + 1 :]]
        if later:
            return Check(id, claim, Verdict.UNKNOWN, f"{name} reads {', '.join(later)} too early")
    return Check(id, claim, Verdict.GENERIC, "no slope is zero identically; zeros on the box are not excluded")
