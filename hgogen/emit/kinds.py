"""What each place of a step is in every language: a field or a group of its memory, a truth value, a counter."""

from dataclasses import dataclass
from functools import cached_property

from hgogen.program import Block, Field, Group, Loop, Place, Program, When, blocks, lines_of, places, walk
from hgogen.step import Step


@dataclass(frozen=True, eq=False)
class Kinds:
    """The kinds of the places of a step."""

    step: Step

    @cached_property
    def fields(self) -> dict[Place, Field]:
        """The fields of state, parameters and groups by place."""
        layout = self.step.layout
        kinds = {"state": layout.state, "plant": layout.plant, "gain": layout.gains, "derived": layout.derived}
        kinds |= {name: line[-1].fields for name, line in self.groups.items()}
        return {Place(kind, f.name): f for kind, fields in kinds.items() for f in fields}

    @cached_property
    def groups(self) -> dict[str, tuple[Group, ...]]:
        """The groups, each with those that it lies in, the outermost first."""
        return {line[-1].name: line for line in lines_of(self.step.layout.groups)}

    @cached_property
    def flags(self) -> set[Place]:
        """Work places that are truth values."""
        return {s.flag for s in walk(self._all) if isinstance(s, When)}

    @cached_property
    def indices(self) -> set[Place]:
        """Work places that count or index."""
        loops = [s for s in walk(self._all) if isinstance(s, Loop)]
        counters = {place for loop in loops for place in (loop.start, loop.active, loop.index) if place}
        counters = {place for place in counters if place.struct == "work"}
        while more := self.work - self.flags - counters - self._reals(counters):
            counters |= more
        return counters

    @cached_property
    def members(self) -> dict[Place, int]:
        """Work places that are the number of a member that a loop is at, and nothing else: how many members there
        are."""
        written = {place for block in blocks(self._all) for place in block.writes}
        loops = [s for s in walk(self._all) if isinstance(s, Loop) and s.index]
        counts = [(s.index, self.groups[s.group][-1].count) for s in loops if s.index]
        return {p: max(n for q, n in counts if q == p) for p, _ in counts if p.struct == "work" and p not in written}

    @cached_property
    def work(self) -> set[Place]:
        """The work places."""
        return {place for place, _ in places(self._all) if place.struct == "work"}

    def is_index(self, place: Place) -> bool:
        """Whether the place is an unsigned whole number."""
        known = self.fields.get(place)
        counts = known is not None and known.kind == "index"
        return counts or place in self.indices or place.struct == "argument"

    def counts(self, block: Block) -> bool:
        """Whether a block works on counters and flags only, and so computes in unsigned numbers."""
        touched = [place for place, _ in block.reads] + [p for p in block.writes if p.struct != "status"]
        return bool(touched) and all(self.is_index(place) or place in self.flags for place in touched)

    def _reals(self, indices: set[Place]) -> set[Place]:
        """Work places that take more than a copy of a counter, or of one of `indices`."""
        counters = {place for place, item in self.fields.items() if item.kind == "index"} | indices
        unwritten = self.work - {place for block in blocks(self._all) for place in block.writes}
        return unwritten | {
            place
            for block in blocks(self._all)
            for place in block.writes
            if place not in block.copies or not block.copies[place] <= counters
        }

    @cached_property
    def _all(self) -> Program:
        sections = (s for section in self.step.code.called for s in section.program)
        return (*sections, *self.step.code.estimate, *self.step.code.tuning)
