"""The structs of emitted code in C and Rust: declarations, comments and initial values of their members."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from hgogen.emit.code import indented
from hgogen.emit.interface import MEMBERS, entry, of_signal, parameters
from hgogen.emit.manual import remembered, tunable
from hgogen.emit.syntax import Number, Real, Syntax, shortest
from hgogen.emit.syntaxes import RUST, C, documented, line, trailing_doc
from hgogen.program import INF, Field, Group, lines_of
from hgogen.step import Step
from hgogen.stepping.guards import OF_PARAMETERS

SIGNALS = {
    "input": "the input now",
    "output": "the measurement now",
    "estimate": "the estimate of the plant's state; ranges are the declared ones, beyond which it may peak",
}
ONE_TURN = "give an angle in one turn: a float near 1e6 is a multiple of 0.0625"


@dataclass(frozen=True)
class Member:
    """A member of a struct: name, declaration, comment, and initial numbers as text. A nested struct has its `kind`,
    and `count` for an array of them."""

    name: str
    declared: str
    comment: str
    initial: Sequence[str] = ()
    kind: str = ""
    count: int = 0


@dataclass(frozen=True)
class Struct:
    """A struct of emitted code with its comment. Its `kind` is input, output, estimate, parameters, a part of the
    parameters (plant, gain, derived), state, or the name of a group."""

    kind: str
    comment: str
    members: tuple[Member, ...]


def structs(
    step: Step, syntax: Syntax, real: Real, *, marked: bool, notes: Mapping[str, str] | None = None
) -> dict[str, Struct]:
    """Return the structs of a step by kind, each after the structs that it contains. `marked`: whether to include the
    number that tags initialised memory, if the step has one; `notes`: additions to the comments of gains, by name."""
    return {each.kind: each for each in _Structs(step, syntax, real, notes or {}).every(marked)}


@dataclass(frozen=True)
class _Structs:
    step: Step
    syntax: Syntax
    real: Real
    notes: Mapping[str, str]

    def every(self, marked: bool) -> Iterator[Struct]:
        step, marks = self.step, [self.step.layout.mark] if marked and self.step.layout.mark else []
        for kind, signals in (("input", step.given), ("output", step.samples), ("estimate", step.states)):
            if signals:
                counted = kind != "estimate" and self.real == "float" and any(s.period for s in signals)
                comment = f"{SIGNALS[kind]}; {ONE_TURN}" if counted else SIGNALS[kind]
                yield Struct(kind, comment, self.named(of_signal(step, signal) for signal in signals))
        for report in step.code.reports:
            yield Struct(report.struct, report.meaning, self.named(self.in_time(report.fields)))
        for kind, fields in parameters(step):
            ours = self.in_time(fields)
            members = self.named(ours) if kind == "plant" else tuple(map(self.member, ours))
            noted = (replace(each, comment=f"{each.comment}{self.notes.get(each.name, '')}") for each in members)
            yield Struct(kind, MEMBERS[kind], tuple(noted) if kind == "gain" else members)
        mark = (self.member(replace(each, meaning=OF_PARAMETERS)) for each in marks)
        inner = (self.inner(kind, MEMBERS[kind]) for kind, _ in parameters(step))
        yield Struct("parameters", changing(step), (*mark, *inner))
        for *_, group in lines_of(step.layout.groups):
            yield Struct(group.name, group.meaning, self.memory(group.fields, group.groups))
        yield Struct("state", remembered(step), self.memory((*marks, *step.layout.state), step.layout.groups))

    def memory(self, fields: Iterable[Field], groups: Iterable[Group]) -> tuple[Member, ...]:
        arrays = (self.inner(group.name, group.meaning, group.count) for group in groups)
        return (*map(self.member, self.in_time(fields)), *arrays)

    def in_time(self, fields: Iterable[Field]) -> Iterator[Field]:
        return (replace(item, unit=self.step.unit(item)) for item in fields)

    def inner(self, kind: str, comment: str, count: int = 0) -> Member:
        declared = self.declared(self.syntax.struct(self.step.name, kind), kind, count)
        return Member(kind, declared, comment, (), kind, count)

    def named(self, fields: Iterable[Field]) -> tuple[Member, ...]:
        named = ((item, self.syntax.name(item.name)) for item in fields)
        return tuple(self.member(item, name, "" if name == item.name else f"{item.name}: ") for item, name in named)

    def member(self, item: Field, name: str = "", before: str = "") -> Member:
        kind: Number = "unsigned" if item.kind == "index" else self.real
        text = self.declared(self.syntax.types[kind], name or item.name, item.size if item.size > 1 else 0)
        initial = tuple(self.syntax.literal(value, kind) for value in item.initial)
        return Member(name or item.name, text, f"{before}{described(item, self.real)}", initial)

    def declared(self, kind: str, name: str, size: int = 0) -> str:
        return self.syntax.struct_member[size > 0].format(type=kind, name=name, size=size)


FEW = 3  # entries of a matrix that a comment lists


def described(item: Field, real: Real) -> str:
    """Return the comment of a member of a struct: meaning, names of its elements, unit and range as `real` has it."""
    parts = [item.meaning] if item.meaning else []
    entries = tuple(entry(item.name, each) for each in item.entries)
    entries = (f"{entries[0]} .. {entries[-1]}",) if len(entries) > FEW else entries
    if elements := item.labels or entries:
        parts.append(", ".join(elements))
    text = ": ".join(parts)
    ranges = {(low, high) for low, high in item.box if low > -INF and high < INF}
    if item.unit:
        text += f" [{item.unit}]"
    if item.kind == "real" and len(ranges) == 1 and all(low > -INF for low, _ in item.box):
        low, high = ranges.pop()
        turn = "one turn, " if item.periods and all(item.periods) else ""
        ends = shortest(low, real), shortest(high, real)
        text += f", {turn}{' .. '.join(ends)}" if low < high else f", fixed at {ends[0]}"
    return text.strip(", ")


def changing(step: Step, quoted: str = "{}") -> str:
    """Return the comment of the parameter struct on how to change its members; `quoted`: the markup of a name, with
    {}."""
    members = " or ".join(quoted.format(kind) for kind in tunable(step))
    return f"parameters: change {members}, then call {quoted.format('tune')}" if members else "parameters"


# --- as C


def typedefs(prefix: str, structs: Mapping[str, Struct], none: str, text: Callable[[str], str]) -> Iterator[list[str]]:
    """Yield the lines `typedef struct { ... } PREFIX_KIND;` for each struct; the parts of the parameters (plant, gain,
    derived) are nested in the parameter struct.

    `none`: the member written into a struct without members; `text`: converts the text of a comment.
    """
    inside = structs["parameters"].members
    for kind, each in structs.items():
        if kind in {member.kind for member in inside if member.kind}:
            continue
        inner = _members(each.members, text)
        if kind == "parameters":
            inner = _members((member for member in inside if not member.kind), text)
            for part in (structs[member.kind] for member in inside if member.kind):
                inner += ["struct {", *indented(_members(part.members, text))]
                inner.append(f"}} {part.kind}; {trailing_doc(text(part.comment))}".rstrip())
            inner = inner or [none]
        about = list(filter(None, [documented(text(each.comment))]))
        yield [*about, "typedef struct {", *indented(inner), f"}} {C.struct(prefix, kind)};"]


def _members(members: Iterable[Member], text: Callable[[str], str]) -> list[str]:
    members = tuple(members)
    width = max((len(member.declared) for member in members if not member.count), default=0)
    return [f"{member.declared:{width}} {trailing_doc(text(member.comment))}".rstrip() for member in members]


# --- as Rust


def rust_structs(step: Step, structs: Mapping[str, Struct]) -> list[str]:
    """Return the lines of Rust that declare the structs of a step."""
    comments = {"input": "the inputs now", "output": "the measurements now", "parameters": changing(step, "`{}`")}
    groups, lines = {line[-1].name for line in lines_of(step.layout.groups)}, list[str]()
    for kind, struct in structs.items():
        comment = comments.get(kind, struct.comment)
        lines += doc(comment if kind in groups else f"{comment[0].upper()}{comment[1:]}.")
        inner = [text for member in struct.members for text in (*doc(member.comment), member.declared)]
        lines += ["#[derive(Clone, Copy, Debug, PartialEq)]", f"pub struct {RUST.struct('', kind)} {{"]
        lines += [*indented(inner), "}", ""]
    return lines


def doc(text: str) -> list[str]:
    """Return a documentation comment of Rust on one line."""
    return [f"/// {line(text)}"] if text else []


def rust_initial(structs: Mapping[str, Struct], kind: str) -> list[str]:
    """Return the lines of Rust that initialise the members of the struct `kind`."""
    lines: list[str] = []
    for member in structs[kind].members:
        if member.kind:
            start, end = ("[", f"; {member.count}]") if member.count else ("", "")
            inner = indented(rust_initial(structs, member.kind))
            lines += [f"{member.name}: {start}{RUST.struct('', member.kind)} {{", *inner, f"}}{end},"]
        else:
            first, *others = member.initial
            values = f"{first}; {len(member.initial)}" if set(others) == {first} else ", ".join(member.initial)
            lines.append(f"{member.name}: {f'[{values}]' if others else first},")
    return lines
