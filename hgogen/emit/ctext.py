"""The statements of a program as C text, and the structs they work on.

Memory in C: `in`, `out` (what a call is given), `p` (parameters), `s` (state), `x` (estimate); work values are locals
at the top of a function; a member of a group is reached through a pointer named after the group.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import casadi as ca

from hgogen.emit.cnames import c_name
from hgogen.emit.cprint import Number, Printer, Real, Target, body, literal
from hgogen.program import (
    INF,
    Block,
    Call,
    Copy,
    Field,
    Group,
    Kernel,
    Loop,
    Program,
    Section,
    Statement,
    When,
    address,
    lines_of,
    places,
    scope,
    walk,
)
from hgogen.step import Step

_STRUCTS = {"state": "s->", "plant": "p->plant.", "gain": "p->gain.", "derived": "p->derived.", "input": "in->"}
_STRUCTS |= {"output": "out->", "estimate": "x->"}
_SIGNALS = ("input", "output", "plant", "estimate")  # structs whose members a user has named
ARGUMENTS = ("s", "p", "in", "out", "x", "status", "i", "k")


def status_type(step: Step) -> str:
    """C type of a status: `unsigned`, 16 bits wide on the smallest targets, where that is enough."""
    return "unsigned" if len(step.bits) <= 16 else "uint32_t"


@dataclass
class Writer:
    """C text of a step's programs; collects the helper functions they call in `used`."""

    step: Step
    real: Real
    used: set[str] = field(default_factory=set)
    kernels: set[tuple[str, int]] = field(default_factory=set)

    @property
    def prefix(self) -> str:
        """What every C name begins with."""
        return self.step.name

    @cached_property
    def _fields(self) -> dict[str, Field]:
        step = self.step
        kinds = {"state": step.state, "plant": step.plant, "gain": step.gains, "derived": step.derived}
        kinds |= {name: line[-1].fields for name, line in self._groups.items()}
        return {f"{kind}.{f.name}": f for kind, fields in kinds.items() for f in fields}

    @cached_property
    def _groups(self) -> dict[str, tuple[Group, ...]]:
        return {line[-1].name: line for line in lines_of(self.step.groups)}

    def _array(self, group: str) -> str:
        """C text of the array of a group: in the state, or in the member of the group around it."""
        above = self._groups[group][:-1]
        return f"{above[-1].name}->{group}" if above else f"s->{group}"

    @cached_property
    def flags(self) -> set[str]:
        """Work places that are truth values."""
        return {s.flag for s in walk(self._all) if isinstance(s, When)}

    @cached_property
    def _indices(self) -> set[str]:
        """Work places that count or index."""
        loops = [s for s in walk(self._all) if isinstance(s, Loop)]
        found = {place for loop in loops for place in (loop.start, loop.active, loop.index) if place}
        found = {place for place in found if scope(place) == "work"}
        while more := self._work - self.flags - found - self._reals(found):
            found |= more
        return found

    def _reals(self, indices: set[str]) -> set[str]:
        """Work places that take more than a copy of a counter, or of one of `indices`."""
        counters = {place for place, item in self._fields.items() if item.kind == "index"} | indices
        values = ((place, v) for s in walk(self._all) if isinstance(s, Block) for place, v in s.writes.items())
        written = self._work - {place for s in walk(self._all) if isinstance(s, Block) for place in s.writes}
        return written | {place for place, value in values if not _copied(value, counters)}

    @cached_property
    def _work(self) -> set[str]:
        return {place for place, _ in places(self._all) if scope(place) == "work"}

    @cached_property
    def _all(self) -> Program:
        timed = (s for section in self.step.timed for s in section.program)
        return (*self.step.program, *self.step.tuning, *timed)

    def is_index(self, place: str) -> bool:
        """Whether C holds the place as `unsigned`."""
        known = self._fields.get(place)
        counts = known is not None and known.kind == "index"
        return counts or place in self._indices or scope(place) == "argument"

    def lvalue(self, place: str, index: int, size: int) -> str:
        """C text of one element of a place."""
        kind, name = place.split(".", 1)
        start = "" if kind in ("work", "argument") else _STRUCTS.get(kind, f"{kind}->")
        name = c_name(name) if kind in _SIGNALS else name
        return f"{start}{name}" if size == 1 else f"{start}{name}[{index}]"

    def function(self, program: Program) -> list[str]:
        """The body of a function: its work values, then its statements."""
        work = sorted((p, n) for p, n in places(program) if scope(p) == "work")
        lines = [self._declaration(place, size) for place, size in work]
        taken = {place.split(".", 1)[1] for place, _ in work} | set(ARGUMENTS) | set(self._groups)
        taken |= {f"{letter}{depth}" for letter in "ik" for depth in range(2, self._depth(program) + 1)}
        return lines + self.statements(program, frozenset(taken))

    def _depth(self, program: Program) -> int:
        """How deep the loops lie in each other."""
        return max((len(self._groups[s.group]) for s in walk(program) if isinstance(s, Loop)), default=0)

    def _declaration(self, place: str, size: int) -> str:
        name = place.split(".", 1)[1]
        if place in self.flags and size == 1:
            return f"bool {name} = false;"
        if place in self._indices:
            return f"unsigned {name} = 0u;"
        zero = literal(0, self.real)
        return f"{self.real} {name} = {zero};" if size == 1 else f"{self.real} {name}[{size}];"

    def statements(self, program: Iterable[Statement], taken: frozenset[str]) -> list[str]:
        """Every statement in order."""
        lines: list[str] = []
        for statement in program:
            lines += self._statement(statement, taken)
        return lines

    def _statement(self, statement: Statement, taken: frozenset[str]) -> list[str]:
        match statement:
            case Block():
                return self._block(statement, taken)
            case Loop():
                return self._loop(statement, taken)
            case When():
                return self._when(statement, taken)
            case Copy():
                return self._copy(statement)
            case Call():
                return [called(self.step, statement.section)]
            case Kernel():
                return self._kernel(statement)

    def _when(self, when: When, taken: frozenset[str]) -> list[str]:
        name = when.flag.split(".", 1)[1]
        lines = [f"if ({name}) {{", *indented(self.statements(when.body, taken))]
        if when.otherwise:
            lines += ["} else {", *indented(self.statements(when.otherwise, taken))]
        return [*lines, "}"]

    def _loop(self, loop: Loop, taken: frozenset[str]) -> list[str]:
        group, array = loop.group, self._array(loop.group)
        depth, total = len(self._groups[group]), self._groups[group][-1].count
        k, i = (letter if depth == 1 else f"{letter}{depth}" for letter in "ki")
        kind = f"{self.prefix}_{group} *const {group}"
        inner = self.statements(loop.body, taken)
        test = f"{k} < {loop.count}u" + (f" && {k} < {self.lvalue(loop.active, 0, 1)}" if loop.active else "")
        number = [f"{self.lvalue(loop.index, 0, 1)} = {k if loop.start is None else i};"] if loop.index else []
        if loop.start is None:
            pointer = f"{kind} = &{array}[{k}];"
            return [f"for (unsigned {k} = 0u; {test}; ++{k}) {{", *indented([pointer, *number, *inner]), "}"]
        start = self.lvalue(loop.start, 0, 1)
        if loop.count == 1:
            return ["{", *indented([f"{kind} = &{array}[{within(start, total)}];", *inner]), "}"]
        wrap = [f"if ({i} >= {total}u) {{", f"    {i} = 0u;", "}"]
        body = [*wrap, f"{kind} = &{array}[{i}];", *number, *inner, f"++{i};"]
        looped = [f"for (unsigned {k} = 0u; {test}; ++{k}) {{", *indented(body), "}"]
        return ["{", *indented([f"unsigned {i} = {start};", *looped]), "}"]

    def _copy(self, copy: Copy) -> list[str]:
        array, total = self._array(copy.group), self._groups[copy.group][-1].count
        target, source = (f"{array}[{within(self.lvalue(p, 0, 1), total)}]" for p in (copy.target, copy.source))
        return [f"{target} = {source};"]

    def _kernel(self, kernel: Kernel) -> list[str]:
        self.kernels.add((kernel.name, kernel.size))
        arguments = [self._array(kernel.columns.split(".", 1)[0])] if kernel.columns else []
        arguments += [
            self.lvalue(place, 0, 1 if size == 1 else 0).removesuffix("[0]") for place, size in kernel.arguments
        ]
        call = f"{self.prefix}_{kernel.name}({', '.join(arguments)})"
        return [f"{kernel.result.split('.', 1)[1]} = {call};" if kernel.result else f"{call};"]

    def _block(self, block: Block, taken: frozenset[str]) -> list[str]:
        reads, written = block.reads, set(block.writes)
        real: Number = "unsigned" if self.counts(block) else self.real
        printer = Printer(
            real=real,
            prefix=self.prefix,
            inputs=lambda argument, element: self._read(*reads[argument], element, real),
            local=lambda argument, element: self._local(*reads[argument], element),
            is_flag=lambda argument: reads[argument][0] in self.flags,
            used=self.used,
            taken=set(taken),
        )
        sources = {place: argument for argument, (place, _) in enumerate(reads)}
        targets = [
            self._target(place, element, size, sources.get(place), real)
            for place, size in ((place, ca.SX(value).numel()) for place, value in block.writes.items())
            for element in range(size)
        ]
        names = [
            name if size == 1 else f"{name}{element + 1}"
            for name, size in ((name, ca.SX(value).numel()) for name, value in block.names.items())
            for element in range(size)
        ]
        hoist = [argument for place, argument in sources.items() if place in written]
        lines = body(printer, block.graph, targets, names, hoist)
        if not lines:
            return []
        if any(line.startswith("const ") for line in lines):
            return [comment(block.title), "{", *indented(lines), "}"]
        return [comment(block.title), *lines]

    def counts(self, block: Block) -> bool:
        """Whether a block works on counters and flags only, and so computes in `unsigned`."""
        touched = [place for place, _ in block.reads] + [p for p in block.writes if scope(p) != "status"]
        return bool(touched) and all(self.is_index(place) or place in self.flags for place in touched)

    def _read(self, place: str, size: int, element: int, real: Number) -> str:
        text = self.lvalue(place, element, size)
        narrow = scope(place) == "argument" or (self.is_index(place) and real != "unsigned")
        return f"({real}){text}" if narrow else text

    def _local(self, place: str, size: int, element: int) -> str:
        """Name of an element as a local: z1, L21, or that of the scalar."""
        kind, name = place.split(".", 1)
        if kind == "argument":
            return f"{name}_given"
        if (
            kind != "work" and f"work.{name}" in self._work
        ):  # u: the input now; u_given: as it came; u_before: at the last call
            name += {"input": "_given", "output": "_given", "state": "_before"}.get(kind, f"_{kind}")
        known = self._fields.get(place)
        label = known.labels[element] if known and known.labels else ""
        if _element(name, label) != label:
            return _element(name, label)
        return name if size == 1 else f"{name}{element + 1}"

    def _target(self, place: str, element: int, size: int, argument: int | None, real: Number) -> Target:
        kind, name = place.split(".", 1)
        if kind == "status":
            bit = f"{self.prefix.upper()}_{name}"

            def raise_bit(text: str) -> list[str]:
                if text in ("false", "true"):
                    return [f"status |= {bit};"] if text == "true" else []
                return [f"if ({text}) {{", f"    status |= {bit};", "}"]

            return Target(raise_bit, flag=True)
        target = self.lvalue(place, element, size)
        source = None if argument is None else (argument, element)
        if self.is_index(place) and real != "unsigned":
            return Target(lambda text: [f"{target} = (unsigned)({text});"], source=source)
        return Target(lambda text: [f"{target} = {text};"], flag=place in self.flags and size == 1, source=source)


def _copied(value: Any, places: set[str]) -> bool:
    """Whether each element of an SX is that of one of the places."""
    elements = (ca.SX(value)[i] for i in range(ca.SX(value).numel()))
    return all(element.is_symbolic() and address(element)[0] in places for element in elements)


def arguments(step: Step, program: Program | None = None) -> list[str]:
    """The C parameters of the function of a section; of the whole step for None."""
    used = {"input", "output"}
    if program is not None:
        inner = (s.section.program for s in walk(program) if isinstance(s, Call))
        used = {scope(place) for each in (program, *inner) for place, _ in places(each)}
    kinds = [("input", "in", step.inputs), ("output", "out", step.outputs)]
    given = [f"const {step.name}_{kind} *{short}" for kind, short, signals in kinds if signals and kind in used]
    given += ["uint16_t at"] if "argument" in used else []
    return [f"{step.name}_state *s", f"const {step.name}_params *p", *given]


def called(step: Step, section: Section) -> str:
    """The call of a section, its status taken over."""
    given = ", ".join(text.rsplit("*", 1)[1] for text in arguments(step, section.program))
    return f"status |= {step.name}_{section.name}({given});"


def within(index: str, total: int) -> str:
    """C text of an index, the first member's where it is beyond the last."""
    return f"({index} < {total}u) ? {index} : 0u"


def indented(lines: Iterable[str], by: int = 4) -> list[str]:
    """Every line four blanks to the right."""
    return [" " * by + line if line else line for line in lines]


def member(real: str, item: Field) -> str:
    """A struct member with its comment: meaning, elements, range, unit."""
    kind = "unsigned" if item.kind == "index" else real
    size = "" if item.size == 1 else f"[{item.size}]"
    return f"{kind} {item.name}{size}; {comment(describe(item))}".rstrip()


def named(item: Field) -> Field:
    """A field of the plant's parameters by its name in C, with its own beside it where that is another."""
    name = c_name(item.name)
    return item if name == item.name else replace(item, name=name, meaning=beside(item.name, item.meaning))


def beside(name: str, text: str) -> str:
    """What is said of a member that has another name in C: its own, then the rest."""
    return f"{name}: {text}" if text else name


def describe(item: Field) -> str:
    """Meaning, elements, unit and range of a field."""
    parts = [item.meaning] if item.meaning else []
    if item.labels:
        parts.append(", ".join(_element(item.name, label) for label in item.labels))
    text = ": ".join(parts)
    ranges = {(low, high) for low, high in item.box if low > -INF and high < INF}
    if item.unit:
        text += f" [{item.unit}]"
    if item.kind == "real" and len(ranges) == 1 and all(low > -INF for low, _ in item.box):
        low, high = ranges.pop()
        text += f", {low:g} .. {high:g}" if low < high else f", fixed at {low:g}"
    return text


def _element(name: str, label: str) -> str:
    """`L21` of "2,1"."""
    return name + label.replace(",", "") if re.fullmatch(r"\d+,\d+", label) else label


def comment(text: str) -> str:
    """A C comment that its text cannot end."""
    return f"/* {harmless(text)} */" if text else ""


def harmless(text: str) -> str:
    """Text that neither ends nor opens a comment, on one line and without trigraphs."""
    return " ".join(text.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?").splitlines())


def struct(name: str, members: Sequence[str]) -> list[str]:
    """typedef struct { ... } name; with the comments of the members in one column."""
    code = [line.split("; /*", 1) for line in members]
    width = max((len(parts[0]) for parts in code), default=0) + 1
    body_lines = [f"{p[0] + ';':{width}} /*{p[1]}" if len(p) == 2 else p[0] for p in code]
    return ["typedef struct {", *indented(body_lines), f"}} {name};"]
