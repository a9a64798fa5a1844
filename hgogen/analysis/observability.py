"""What a plant's outputs tell of its states and unknown parameters, what hides the rest, and what would show it.

Observable is said locally: a state nearby gives another output, a far one may not, as -x where y = x**2. Answers are
generic: they hold at almost every state, parameter value and input. Full rank at one point proves full rank almost
everywhere. A deficiency is proved by a symmetry, a vector field that no output sees; without one it is known but for
the chance that a random point lies on a thin set.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import flint
import sympy as sp

from hgogen.algebra.balls import Undecided
from hgogen.algebra.echelon import kernel, new_rows
from hgogen.algebra.rank import NowhereDefined, Rank, at_values, matrix_rows, modulus, plant_of, somewhere
from hgogen.algebra.rank import observability as ranks
from hgogen.algebra.series import Arithmetic, Point, first_gradients
from hgogen.analysis.on_box import within_tables
from hgogen.analysis.symmetry import Symmetry, symmetries
from hgogen.check import Check, ClaimId, Verdict
from hgogen.reading.door import asks_a_plant, remembers
from hgogen.reading.given import BadGain, signals_named
from hgogen.sentence import because, joined
from hgogen.system import System


@dataclass(frozen=True)
class Answer:
    """One question, states alone or states with unknown parameters.

    `orders`: the order of derivatives of the outputs at which each observable unknown is first observable;
    `symmetries`: what hides the others; `direction`: where these are fewer than the deficiency, an unobservable
    direction at a random point, `point`; `repairs`: each unknown whose measurement alone would make all observable.
    """

    rank: Rank
    orders: tuple[tuple[sp.Symbol, int], ...]
    symmetries: tuple[Symmetry, ...]
    direction: tuple[tuple[sp.Symbol, float], ...]
    point: tuple[tuple[sp.Symbol, float], ...]
    repairs: tuple[sp.Symbol, ...]

    def as_dict(self) -> dict[str, Any]:
        """The answer as plain data for JSON."""
        rank = self.rank
        return {
            "rank": rank.rank,
            "dimension": rank.dimension,
            "order": rank.order,
            "observable": [s.name for s in rank.observable],
            "unobservable": [s.name for s in rank.unobservable],
            "symmetries": [str(symmetry) for symmetry in self.symmetries],
            "repairs": [s.name for s in self.repairs],
        }

    def __str__(self) -> str:
        rank = self.rank
        lines = [f"rank {rank.rank} of {rank.dimension}, by derivatives up to order {rank.order}"]
        if self.orders:
            lines.append("observable, from derivative: " + ", ".join(f"{s} ({k})" for s, k in self.orders))
        if rank.unobservable:
            lines.append("not observable: " + ", ".join(s.name for s in rank.unobservable))
            lines += [f"not seen: {symmetry}" for symmetry in self.symmetries]
            if self.direction:
                lines.append(f"an unobservable direction: {_values(self.direction)}, at {_values(self.point)}")
            names = " or ".join(s.name for s in self.repairs) or "no single unknown"
            lines.append(f"measuring {names} as well would show all")
        return "\n".join(lines)


@dataclass(frozen=True)
class Observability:
    """What is generically observable of a plant: `known` with known parameters, `joint` with those that have a range.

    `joint` is None where no parameter has a range; `method` names the arithmetic; `local`: the functions with
    branches for which the answer holds on an open set only, "" without.
    """

    system: System
    known: Answer
    joint: Answer | None
    method: str
    local: str

    @property
    def n(self) -> int:
        """Number of states."""
        return self.known.rank.dimension

    @property
    def rank(self) -> int:
        """Generic rank with known parameters."""
        return self.known.rank.rank

    @property
    def order(self) -> int:
        """Order of the outputs' derivatives that attains it."""
        return self.known.rank.order

    @property
    def observable(self) -> tuple[sp.Symbol, ...]:
        """The states that are individually observable, parameters known."""
        return self.known.rank.observable

    @property
    def unobservable(self) -> tuple[sp.Symbol, ...]:
        """The states that are not."""
        return self.known.rank.unobservable

    @property
    def checks(self) -> tuple[Check, ...]:
        """`observability.states`, and `observability.joint` where a parameter has a range."""
        checks = [
            _check(
                ClaimId("observability", "states"),
                "the states are locally observable, parameters known",
                self.known,
                self,
            )
        ]
        if self.joint is not None:
            claim = "states and ranged parameters are locally observable together"
            checks.append(_check(ClaimId("observability", "joint"), claim, self.joint, self))
        return tuple(checks)

    def as_dict(self) -> dict[str, Any]:
        """The answer as plain data for JSON."""
        joint = self.joint.as_dict() if self.joint else None
        checks = [check.as_dict() for check in self.checks]
        return {"known": self.known.as_dict(), "joint": joint, "method": self.method, "checks": checks}

    def __str__(self) -> str:
        parts = [("parameters known", self.known), ("with the parameters that have a range", self.joint)]
        lines = [f"{self.system.name}: generic observability, {self.method}"]
        for title, answer in parts:
            if answer is not None:
                lines += [f"  {title}:", *(f"    {line}" for line in str(answer).splitlines())]
        return "\n".join(lines + ([f"  on an open set only, because of {self.local}"] if self.local else []))


@asks_a_plant
@remembers
def observability(plant: System, *, unknown: tuple[str, ...] | None = None) -> Observability:
    """The generic observability of a plant; `unknown`: the parameters of the joint question, by default those with a
    range. The others stand at their nominal values.

    Raises: `BadGain` for names of no parameter; `NowhereDefined` for a plant that is nowhere defined; `NoTape` for a
    function without a rule.
    """
    loose = tuple(p for p in plant.parameters if p.bounded) if unknown is None else _named(plant, unknown)
    fixed = {p: value for p, value in plant.nominal.items() if p not in loose}
    flow, output = (at_values(part, fixed) for part in within_tables(plant))
    generic = ranks(flow, output, plant.states, plant.inputs, loose)
    parts = (flow, output, plant.states, plant.inputs)
    known = _answer(generic.known, generic.local, *parts, ())
    joint = _answer(generic.joint, generic.local, *parts, loose) if loose else None
    return Observability(plant, known, joint, generic.method, generic.local)


def _named(plant: System, unknown: Any) -> tuple[sp.Symbol, ...]:
    """The parameters of these names. Raises: `BadGain`."""
    return signals_named(
        "unknown",
        unknown,
        plant.parameters,
        lambda name, fix: BadGain(f"unknown names {name!r}", f"which is no parameter; {fix}"),
    )


Exprs = Sequence[sp.Expr]
Symbols = Sequence[sp.Symbol]


def _answer(
    rank: Rank, local: str, flow: Exprs, output: Exprs, states: Symbols, inputs: Symbols, parameters: Symbols
) -> Answer:
    """The answer; where there are branches, the derivatives of `rank` may not be enough on those of another point."""
    parts = (flow, output, states, inputs, parameters)
    order = max(rank.order, rank.dimension - 1) if local else rank.order
    ordered, hidden = _orders(rank, *parts), rank.unobservable
    if not hidden:
        return Answer(rank, ordered, (), (), (), ())
    fields = symmetries(*parts, hidden=hidden, order=order)
    few = len(fields) < rank.dimension - rank.rank
    direction, point = _direction(order, *parts) if few else ((), ())
    return Answer(rank, ordered, fields, direction, point, _repairs(rank, *parts))


def _orders(
    rank: Rank, flow: Exprs, output: Exprs, states: Symbols, inputs: Symbols, parameters: Symbols
) -> tuple[tuple[sp.Symbol, int], ...]:
    """Each observable unknown with the order of derivatives at which its unit vector enters the row space."""
    plant, unknowns = plant_of(flow, output, states, inputs, parameters)

    def answer(numbers: Arithmetic, point: Point) -> dict[sp.Symbol, int]:
        orders: dict[sp.Symbol, int] = {}
        rows: list[Any] = []
        for k, y in enumerate(first_gradients(plant, numbers, point, rank.order + 1)):
            rows += matrix_rows(y)
            basis = kernel(rows, plant.wide, modulus(numbers))
            seen = (s for i, s in enumerate(unknowns) if all(vector[i] == 0 for vector in basis))
            orders |= {s: k for s in seen if s not in orders}
        return orders

    orders = somewhere(plant, answer)
    return tuple((s, orders[s]) for s in rank.observable if s in orders)


def _repairs(
    rank: Rank, flow: Exprs, output: Exprs, states: Symbols, inputs: Symbols, parameters: Symbols
) -> tuple[sp.Symbol, ...]:
    """The hidden unknowns whose measurement alone gives full rank; all measured in one run, taken one by one.

    Each order of derivatives up to the stationary one adds to the rank, so `rank.order` and as many more as the
    deficiency suffice.
    """
    hidden, p = rank.unobservable, len(output)
    plant, _ = plant_of(flow, (*output, *hidden), states, inputs, parameters)

    def answer(numbers: Arithmetic, point: Point) -> tuple[sp.Symbol, ...]:
        count = rank.order + rank.dimension - rank.rank + 1
        orders = [matrix_rows(y) for y in first_gradients(plant, numbers, point, count)]

        def full(i: int) -> bool:
            rows = [row for y in orders for row in (*y[:p], y[p + i])]
            return len(new_rows(rows, modulus(numbers))) == rank.dimension

        return tuple(s for i, s in enumerate(hidden) if full(i))

    return somewhere(plant, answer)


def _direction(
    order: int, flow: Exprs, output: Exprs, states: Symbols, inputs: Symbols, parameters: Symbols
) -> tuple[Any, Any]:
    """An unobservable direction at a random real point, largest entry 1, and the point; none where the points tried are
    all on branches where everything is seen."""
    plant, unknowns = plant_of(flow, output, states, inputs, parameters)

    def answer(numbers: Arithmetic, point: Point) -> tuple[Any, Any]:
        rows = [row for y in first_gradients(plant, numbers, point, order + 1) for row in matrix_rows(y)]
        basis = kernel(rows, plant.wide, 0)
        if not basis:  # a point on a branch where all is seen
            raise Undecided
        vector = [float(e.mid()) for e in map(flint.arb, basis[0])]
        largest = max(vector, key=abs)
        values = (*point.states, *point.constants[: plant.q])
        moved = tuple((s, v / largest) for s, v in zip(unknowns, vector, strict=True) if v)
        return moved, tuple((s, float(v.mid())) for s, v in zip(unknowns, values, strict=True))

    try:
        return somewhere(plant, answer, balls=True)
    except NowhereDefined:
        return (), ()


def _check(id: ClaimId, claim: str, answer: Answer, whole: Observability) -> Check:
    rank = answer.rank
    pattern = "rank {rank} of {dimension} at a random point, {method}"
    reason = because(pattern, rank=rank.rank, dimension=rank.dimension, method=whole.method)
    if whole.local:
        reason = joined(reason, because("on an open set only, because of {branches}", branches=whole.local))
    if not rank.unobservable:
        return Check(id, claim, Verdict.GENERIC, reason)
    proof = next((symmetry for symmetry in answer.symmetries if symmetry.proved), None)
    blind = not any(e.free_symbols & {*whole.system.states} for e in whole.system.output)
    verdict = Verdict.REFUTED if proof or blind else Verdict.UNKNOWN
    shown = " or ".join(s.name for s in answer.repairs)
    fix = f"Measure {shown} as well." if shown else "Measure more: no single state or parameter would do."
    chance = because("{names} not seen, but for the chance of a special point", names=rank.unobservable)
    why = because("no output sees {symmetry}", symmetry=proof) if proof else chance
    why = because("no output reads a state") if blind else why
    return Check(id, claim, verdict, joined(reason, why), fix=fix)


def _values(pairs: Sequence[tuple[sp.Symbol, float]]) -> str:
    return ", ".join(f"{s} = {value:.3g}" for s, value in pairs)
