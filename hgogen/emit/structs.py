"""The structs of emitted code: how their members are declared, what is said of them, how they begin; in C and Rust."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from hgogen.emit.code import indented
from hgogen.emit.described import MEANINGS, described, of_signal, parameters
from hgogen.emit.manual import remembered
from hgogen.emit.syntax import Number, Real, Syntax
from hgogen.emit.syntaxes import RUST, C, documented, line, trailing_doc
from hgogen.program import Field, Group, lines_of
from hgogen.step import Step
from hgogen.stepping.guards import OF_PARAMETERS

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
    """The structs by kind, each after those that are in it; `marked`: with the mark, where the step has one."""
    return {each.kind: each for each in _Structs(step, syntax, real).every(marked)}


@dataclass(frozen=True)
class _Structs:
    step: Step
    syntax: Syntax
    real: Real

    def every(self, marked: bool) -> Iterator[Struct]:
        """The structs."""
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


def typedefs(prefix: str, structs: Mapping[str, Struct], none: str, said: Callable[[str], str]) -> Iterator[list[str]]:
    """typedef struct { ... } PREFIX_KIND; for each, those of the parameters in theirs, where `none` stands for there is
    none; `said`: what is said beside a member, of its text."""
    inside = structs["parameters"].members
    for kind, each in structs.items():
        if kind in {member.kind for member in inside if member.kind}:
            continue
        inner = _members(each.members, said)
        if kind == "parameters":
            inner = _members((member for member in inside if not member.kind), said)
            inner += [line for member in inside if member.kind for line in _nested(structs[member.kind], said)]
            inner = inner or [none]
        about = list(filter(None, [documented(said(each.said))]))
        yield [*about, "typedef struct {", *indented(inner), f"}} {C.struct(prefix, kind)};"]


def _nested(struct: Struct, said: Callable[[str], str]) -> list[str]:
    inner = indented(_members(struct.members, said))
    return ["struct {", *inner, f"}} {struct.kind}; {trailing_doc(said(struct.said))}".rstrip()]


def _members(members: Iterable[Member], said: Callable[[str], str]) -> list[str]:
    members = tuple(members)
    width = max((len(member.declared) for member in members), default=0)
    return [f"{member.declared:{width}} {trailing_doc(said(member.said))}".rstrip() for member in members]


_SAID = {
    "input": "the inputs now",
    "output": "the measurements now",
    "parameters": "change `plant` or `gain`, then call `tune`",
}


def declared(step: Step, structs: Mapping[str, Struct]) -> list[str]:
    """The structs of a step, declared."""
    groups, lines = {line[-1].name for line in lines_of(step.layout.groups)}, list[str]()
    for kind, struct in structs.items():
        said = _SAID.get(kind, struct.said)
        lines += doc(said if kind in groups else f"{said[0].upper()}{said[1:]}.")
        inner = [text for member in struct.members for text in (*doc(member.said), member.declared)]
        lines += ["#[derive(Clone, Copy, Debug, PartialEq)]", f"pub struct {RUST.struct('', kind)} {{"]
        lines += [*indented(inner), "}", ""]
    return lines


def doc(text: str) -> list[str]:
    """A documentation comment of one line, which is folded later."""
    return [f"/// {line(text)}"] if text else []


def initial(structs: Mapping[str, Struct], kind: str) -> list[str]:
    """The members of a struct with the values that it begins with."""
    lines: list[str] = []
    for member in structs[kind].members:
        if member.kind:
            start, end = ("[", f"; {member.count}]") if member.count else ("", "")
            inner = indented(initial(structs, member.kind))
            lines += [f"{member.name}: {start}{RUST.struct('', member.kind)} {{", *inner, f"}}{end},"]
        else:
            first, *others = member.begins
            values = f"{first}; {len(member.begins)}" if set(others) == {first} else ", ".join(member.begins)
            lines.append(f"{member.name}: {f'[{values}]' if others else first},")
    return lines
