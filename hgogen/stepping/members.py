"""Statements of a single observer as statements of one member of a group: other places, the same operations.

`state.z` becomes `member.z`; a group of the observer becomes a group in each member. Places of the whole step, such as
`state.u`, the gains and the status, do not change.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from hgogen.graph import Graph
from hgogen.part import Pieces
from hgogen.program import (
    Block,
    Copy,
    Field,
    Group,
    Kernel,
    Loop,
    Place,
    Program,
    Repeat,
    Statement,
    address,
    column,
    sym,
)


@dataclass(frozen=True)
class Substitution:
    """A map of the places in programs: `places` maps a place to another one, or a place that is only read to an SX
    column; `groups` maps names of groups."""

    places: Mapping[Place, Graph]
    groups: Mapping[str, str]

    def program(self, program: Iterable[Statement]) -> Program:
        """Return the statements with every place replaced by its image under the map."""
        return tuple(self._statement(statement) for statement in program)

    def place(self, place: Place) -> Place:
        """Return the new place of a place that may be written."""
        if place.struct in self.groups:
            return place._replace(struct=self.groups[place.struct])
        substituted = self.places.get(place, place)
        assert isinstance(substituted, Place), f"{place} is only read"
        return substituted

    def value(self, place: Place, size: int) -> Graph:
        """Return the SX column that replaces a place that is read."""
        substituted = self.places.get(place)
        return sym(*self.place(place), size) if substituted is None or isinstance(substituted, Place) else substituted

    def values(self, *graphs: Graph) -> list[Graph]:
        """Return the SX graphs with the substituted places in place of the original ones."""
        symbols = ca.symvar(ca.veccat(*graphs))
        if not symbols:
            return list(graphs)
        now = [self.value(place, size)[index] for place, index, size in map(address, symbols)]
        substituted: list[Graph] = ca.substitute([ca.SX(graph) for graph in graphs], symbols, now)
        return substituted

    def _statement(self, statement: Statement) -> Statement:
        if isinstance(statement, Block):
            values = self.values(*statement.writes.values(), *statement.names.values())
            writes = dict(zip(map(self.place, statement.writes), values, strict=False))
            names = dict(zip(statement.names, values[len(writes) :], strict=True))
            return Block(statement.title, writes, names, part=statement.part, notes=statement.notes)
        changed: dict[str, Any] = {name: self.program(body) for name, body in statement.bodies.items()}
        changed |= {name: self.place(value) for name, value in vars(statement).items() if isinstance(value, Place)}
        if isinstance(statement, Loop | Copy):
            changed["group"] = self.groups.get(statement.group, statement.group)
        if isinstance(statement, Repeat):
            changed["given"] = {self.place(place): row for place, row in statement.given.items()}
        if isinstance(statement, Kernel):
            changed["arguments"] = tuple((self.place(place), size) for place, size in statement.arguments)
        return replace(statement, **changed) if changed else statement


_PROGRAMS = ("tune", "predict", "adapt", "project", "gate", "correct")
_IN_ORDER = ("fields", "groups", "derived", "bits", "inner", *_PROGRAMS)


def renamed(pieces: Pieces, name: Callable[[str], str], places: Mapping[Place, Graph]) -> Pieces:
    """Return `pieces` in which a field or group called x is called name(x); `places`: further substitutions of
    places."""
    fields = {Place("state", field.name): Place("state", name(field.name)) for field in pieces.fields}
    substituted = Substitution({**places, **fields}, {group.name: name(group.name) for group in pieces.groups})
    programs: dict[str, Any] = {name: substituted.program(getattr(pieces, name)) for name in _PROGRAMS}
    return replace(
        pieces,
        fields=tuple(replace(field, name=name(field.name)) for field in pieces.fields),
        groups=tuple(replace(group, name=name(group.name)) for group in pieces.groups),
        update=tuple(map(substituted.program, pieces.update)),
        covariance=None if pieces.covariance is None else substituted.values(pieces.covariance)[0],
        congruence=None,
        projected=None,
        joint=None,
        **programs,
    )


def joined(pieces: Iterable[Pieces]) -> Pieces:
    """Return the memory and statements of several parts in sequence as one `Pieces`."""
    pieces = tuple(pieces)
    correcting = [piece for piece in pieces if piece.update]
    uncertain = [piece for piece in pieces if piece.projected]
    sole = uncertain[0] if len(uncertain) == 1 else Pieces()
    outputs = range(len(correcting[0].update) if correcting else 0)
    every: dict[str, Any] = {n: tuple(item for piece in pieces for item in getattr(piece, n)) for n in _IN_ORDER}
    return Pieces(
        **every,
        update=tuple(tuple(s for piece in correcting for s in piece.update[j]) for j in outputs),
        uses_output=any(piece.uses_output for piece in pieces),
        rule=next((piece.rule for piece in pieces if piece.rule), ""),
        covariance=next((piece.covariance for piece in pieces if piece.covariance is not None), None),
        projected=sole.projected,
        joint=sole.joint,
        inside=sole.inside,
        congruence=next((piece.congruence for piece in pieces if piece.covariance is not None), None),
        verdicts={j: name for piece in pieces for j, name in piece.verdicts.items()},
    )


def reset_fields(group: str, fields: Iterable[Field], part: str = "") -> Program:
    """Return the program that resets `fields` of the struct `group` to their initial values, counters in a separate
    block; `part`: prefix of the names of these blocks' functions."""
    programs = list[Block]()
    for kind, title in (("real", "as after a reset"), ("index", "counters as after a reset")):
        writes = {Place(group, field.name): ca.SX(column(field.initial)) for field in fields if field.kind == kind}
        programs += [Block(title, writes, part="" if programs else part)] if writes else []
    return tuple(programs)


def reset_groups(above: str, fields: Iterable[Field], groups: Iterable[Group], z: Graph) -> Program:
    """Return the program that resets the groups nested in the struct `above`, which has these `fields`, except lasting
    fields. A copy of the estimate in a nested group is set to the estimate of `above`; `z` is the observer's estimate,
    an SX of places of the state."""
    loops = []
    for group in groups:
        copied, start = _copied(above, fields, group, z)
        others = reset_fields(group.name, [f for f in group.fields if f not in copied and not f.lasting])
        inner = reset_groups(group.name, group.fields, group.groups, z)
        loops.append(Loop(group.name, group.count, (*start, *others, *inner)))
    return tuple(loops)


def copy_estimate(above: str, fields: Iterable[Field], groups: Iterable[Group], z: Graph) -> Program:
    """Return the program that sets each copy of the estimate in the groups nested in `above` to the estimate of
    `above`, and nothing else; arguments as in `reset_groups`."""
    loops = []
    for group in groups:
        _, start = _copied(above, fields, group, z)
        body = (*start, *copy_estimate(group.name, group.fields, group.groups, z))
        loops += [Loop(group.name, group.count, body)] if body else []
    return tuple(loops)


def _copied(above: str, fields: Iterable[Field], group: Group, z: Graph) -> tuple[list[Field], Program]:
    known = {field.name for field in fields} | {"z"}
    inside = Substitution({Place("state", name): Place(above, name) for name in read_fields([z])}, {})
    source = {f.name: inside.values(z)[0] if f.name == "z" else sym(above, f.name, f.size) for f in group.fields}
    copied = [f for f in group.fields if f.outer and f.name in known]
    start = Block("from the estimate", {Place(group.name, f.name): source[f.name] for f in copied})
    return copied, (start,) if copied else ()


def read_fields(graphs: Iterable[Graph]) -> set[str]:
    """Return the names of the state's fields that the SX graphs read."""
    places = {address(symbol)[0] for symbol in ca.symvar(ca.veccat(*graphs))}
    return {place.name for place in places if place.struct == "state"}
