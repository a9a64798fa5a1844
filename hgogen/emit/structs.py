"""The structs of emitted code, in a `Syntax`: how their members are declared, what is said of them, how they begin."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from hgogen.emit.described import MEANINGS, described, of_signal, parameters
from hgogen.emit.manual import remembered
from hgogen.emit.syntax import Number, Real, Syntax
from hgogen.program import Field, Group, lines_of
from hgogen.step import Step
from hgogen.stepping.ready import OF_PARAMETERS

SIGNALS = {
    "input": "the input now",
    "output": "the measurement now",
    "estimate": "the estimate of the plant's state; ranges are the declared ones, beyond which it may peak",
}


@dataclass(frozen=True)
class Member:
    """A member: its name, its declaration, what is said of it. It begins with the numbers `begins`, as text; or it is
    of the struct `kind`, and of an array `count` of them."""

    name: str
    declared: str
    said: str
    begins: Sequence[str] = ()
    kind: str = ""
    count: int = 0


@dataclass(frozen=True)
class Struct:
    """A struct by its kind: input, output, estimate, parameters, the plant, gain and derived among these, state, or
    the name of a group."""

    kind: str
    said: str
    members: tuple[Member, ...]


def structs(step: Step, syntax: Syntax, real: Real, *, marked: bool) -> dict[str, Struct]:
    """All that there are by kind, each after those that are in it; `marked`: with the mark, where the step has one."""
    return {each.kind: each for each in _Structs(step, syntax, real).every(marked)}


@dataclass(frozen=True)
class _Structs:
    step: Step
    syntax: Syntax
    real: Real

    def every(self, marked: bool) -> Iterator[Struct]:
        """All that there are."""
        step, marks = self.step, [self.step.layout.mark] if marked and self.step.layout.mark else []
        for kind, signals in (("input", step.inputs), ("output", step.samples), ("estimate", step.states)):
            if signals:
                yield Struct(kind, SIGNALS[kind], self.named(of_signal(step, signal) for signal in signals))
        for kind, fields in parameters(step):
            ours = self.in_time(fields)
            yield Struct(kind, MEANINGS[kind], self.named(ours) if kind == "plant" else tuple(map(self.member, ours)))
        mark = (self.member(replace(each, meaning=OF_PARAMETERS)) for each in marks)
        inner = (self.inner(kind, MEANINGS[kind]) for kind, _ in parameters(step))
        yield Struct("parameters", "parameters: change plant or gain, then call tune", (*mark, *inner))
        for *_, group in lines_of(step.layout.groups):
            yield Struct(group.name, group.meaning, self.memory(group.fields, group.groups))
        yield Struct("state", remembered(step), self.memory((*marks, *step.layout.state), step.layout.groups))

    def memory(self, fields: Iterable[Field], groups: Iterable[Group]) -> tuple[Member, ...]:
        """Fields, and arrays of structs after them."""
        arrays = (self.inner(group.name, group.meaning, group.count) for group in groups)
        return (*map(self.member, self.in_time(fields)), *arrays)

    def in_time(self, fields: Iterable[Field]) -> Iterator[Field]:
        """Fields with their units in the model's time."""
        return (replace(item, unit=self.step.unit(item)) for item in fields)

    def inner(self, kind: str, said: str, count: int = 0) -> Member:
        """A member that is a struct, or an array of them."""
        return Member(kind, self.declared(self.syntax.struct(self.step.name, kind), kind, count), said, (), kind, count)

    def named(self, fields: Iterable[Field]) -> tuple[Member, ...]:
        """Numbers that a user has named; where the language has another name, the own one is said first."""
        named = ((item, self.syntax.name(item.name)) for item in fields)
        return tuple(self.member(item, name, "" if name == item.name else f"{item.name}: ") for item, name in named)

    def member(self, item: Field, name: str = "", own: str = "") -> Member:
        """Numbers of one name."""
        kind: Number = "unsigned" if item.kind == "index" else self.real
        text = self.declared(self.syntax.types[kind], name or item.name, item.size if item.size > 1 else 0)
        begins = tuple(self.syntax.literal(value, kind) for value in item.initial)
        return Member(name or item.name, text, f"{own}{described(item)}", begins)

    def declared(self, kind: str, name: str, size: int = 0) -> str:
        """The declaration of a member, an array where it has a size."""
        return self.syntax.struct_member[size > 0].format(type=kind, name=name, size=size)
